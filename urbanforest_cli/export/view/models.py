"""Plants as models to be drawn many times: branches from thick to thin, leaves of which any first part is a crown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.export.plant_scene import (
    FloatArray,
    Look,
    Standing,
    Wood,
    build_leaves,
    build_twiglets,
    build_wood,
    joined_wood,
)
from urbanforest_cli.export.view.draw_kernel import Instances, Models
from urbanforest_cli.export.view.models_kernel import order_wood, shuffle_leaves

LEAVES_MIN = 24  # of the smallest plant
TUFT_BLADES = 5.0  # a leaf this many times as long as the species' is drawn as a tuft


def build_models(
    skeletons: Skeletons, season_end: NDArray[np.integer], looks: Sequence[Look], *, shortest_m: FloatArray,
    thinnest_m: FloatArray, leafy: bool = True,
) -> Models:  # fmt: skip
    """Turn skeletons into models.

    Parameters
    ----------
    skeletons, season_end, looks
        (s,) what grew, when it is shown, how it looks.
    shortest_m
        (s,) leaves shorter than this are merged into fewer, larger ones of the same area.
    thinnest_m
        (s,) wood of a smaller radius is left out.
    leafy
        Whether there are leaves; where not, the twiglets that bear them.
    """
    count = len(skeletons)
    wood, twigs = build_wood(Standing(skeletons, np.zeros((count, 2)), looks, season_end))
    wood_owner = np.asarray(wood.plant)
    if not leafy:
        twiglets = build_twiglets(twigs, looks)
        wood_owner = np.concatenate((wood_owner, np.asarray(twiglets.plant)))
        wood = joined_wood([wood, twiglets])
    first_wood, branches, wood_rgb, reach, top = order_wood(
        wood_owner, wood.start, wood.end, wood.start_radius, wood.end_radius, wood.rgb, thinnest_m, count
    )

    blade = np.array([look.blade_m[0] for look in looks])
    merged = np.clip((shortest_m / blade - 1.0) / (TUFT_BLADES - 1.0), 0.0, 1.0)
    if leafy and len(twigs.tip):
        leaves = build_leaves(twigs, looks, shortest_m=shortest_m)
        leaf_owner = twigs.plant[leaves.twig]
        first_leaf = np.searchsorted(leaf_owner, np.arange(count + 1))
        leaf, rgb, blades, middle = shuffle_leaves(first_leaf, leaves.centre, leaves.along, leaves.across, leaves.rgb)
        area = np.zeros(count)
        area[leaf_owner] = leaves.area_m2
        longest = 0.5 * np.maximum(blade, shortest_m) + np.array([look.spray_m for look in looks])
        reach, top = reach + longest, top + longest
    else:
        leaf, rgb = np.zeros((0, 9), np.float32), np.zeros((0, 3), np.uint8)
        first_leaf, area, middle = np.zeros(count + 1, np.int64), np.zeros(count), np.zeros((count, 3))
        blades = np.zeros(count, np.float32)
    return Models(
        first_wood, branches, wood_rgb, first_leaf.astype(np.int64), leaf, rgb, blades, area.astype(np.float32),
        middle.astype(np.float32), reach.astype(np.float32), top.astype(np.float32), merged.astype(np.float32),
    )  # fmt: skip


def model_of(wood: Wood) -> Models:
    """Return one model without leaves, its root at (0, 0, 0)."""
    thick = np.maximum(wood.start_radius, wood.end_radius)
    order = np.argsort(-thick, kind="stable")
    branches = np.column_stack((wood.start, wood.end, wood.start_radius, wood.end_radius))[order]
    ends = np.vstack((wood.start, wood.end))
    reach, top = (float(np.max(size, initial=0.0)) + float(thick.max(initial=0.0))
                  for size in (np.hypot(ends[:, 0], ends[:, 1]), ends[:, 2]))  # fmt: skip
    none = np.zeros(1, np.float32)
    return Models(
        np.array([0, len(order)]), branches.astype(np.float32), _bytes_of(wood.rgb[order]), np.zeros(2, np.int64),
        np.zeros((0, 9), np.float32), np.zeros((0, 3), np.uint8), none, none, np.zeros((1, 3), np.float32),
        np.array([reach], np.float32), np.array([top], np.float32), none,
    )  # fmt: skip


def place_models(
    models: Models, model: NDArray[np.int64], place: FloatArray, *, yaw_rad: FloatArray | None = None,
    mirror: NDArray[np.bool_] | None = None, scale: FloatArray | None = None, leaf_share: FloatArray | None = None,
    thinnest_m: FloatArray | None = None,
) -> Instances:  # fmt: skip
    """Set models at places.

    Parameters
    ----------
    models, model, place
        Shapes, (n,) which of them, (n, 3) where.
    yaw_rad, mirror, scale
        (n,) mirrored where told (y to -y), then turned counter-clockwise, then scaled; as they are if None.
    leaf_share
        (n,) share of the leaves that is drawn, each so much larger; never fewer than `LEAVES_MIN`.
    thinnest_m
        (n,) thinner wood of the model is left out.
    """
    count = len(model)
    yaw = np.zeros(count) if yaw_rad is None else np.asarray(yaw_rad, np.float64)
    sign = np.ones(count) if mirror is None else np.where(mirror, -1.0, 1.0)
    size = np.ones(count) if scale is None else np.asarray(scale, np.float64)
    leaves = np.diff(models.first_leaf)[model]
    share = np.ones(count) if leaf_share is None else np.minimum(leaf_share, 1.0)
    drawn = np.minimum(np.maximum(np.ceil(share * leaves), LEAVES_MIN), leaves).astype(np.int64)
    wood = np.diff(models.first_wood)[model]
    if thinnest_m is not None:
        thick = np.maximum(models.wood[:, 6], models.wood[:, 7])
        first = models.first_wood
        wood = np.array([np.searchsorted(-thick[first[m] : first[m + 1]], -thin, side="right")
                         for m, thin in zip(model, thinnest_m, strict=True)], dtype=np.int64)  # fmt: skip
    return Instances(np.asarray(model, np.int64), np.asarray(place, np.float64), np.column_stack((np.cos(yaw),
                     np.sin(yaw))), size, sign, wood, drawn, np.sqrt(leaves / np.maximum(drawn, 1)))  # fmt: skip


def _bytes_of(rgb: FloatArray) -> NDArray[np.uint8]:
    """Return linear colours as bytes, square root of light."""
    return np.asarray(np.clip(np.sqrt(rgb) * 255.0 + 0.5, 0, 255), dtype=np.uint8)
