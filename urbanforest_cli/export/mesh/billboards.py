"""Plants as pictures on three flat cards: seen from the south, from the east and from above, light baked in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Meshes
from urbanforest_cli.core.skeleton import Skeletons, select
from urbanforest_cli.export.mesh import twig_kernel
from urbanforest_cli.export.mesh.leaf_painting import spread
from urbanforest_cli.export.mesh.leaves import DARK
from urbanforest_cli.export.mesh.textures import few_colours_png
from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_kernel import Canvas, draw_leaves, draw_wood
from urbanforest_cli.export.plant_looks import Season, in_season
from urbanforest_cli.export.plant_scene import (
    Leaves,
    Look,
    Standing,
    Twigs,
    Wood,
    build_leaves,
    build_twiglets,
    build_wood,
    joined_wood,
)

FloatArray = NDArray[np.float64]
Floats = NDArray[np.float32]

ATLAS_PX = 1024  # most, a side
FINER = 2  # pictures are drawn at so many times their size, and averaged
RIM_PX = 2  # clear around each picture
SHORTEST_LEAF_PX = 2.2  # of the drawn picture: smaller leaves are merged
FLAT_LIGHT = 0.86  # of leaves under the open sky; near it, viewers show lit meshes beside it
VIEWS = ((0.0, 0.0), (270.0, 0.0), (0.0, 90.0))  # azimuth and pitch looked along: north, west, down
FRONTS = ((0, -1, 0), (1, 0, 0), (0, 0, 1))  # of the cards that show them
ATLAS_COLOURS = (8, 24, 24, 24, 24, 24, 128)  # of a palette, from clear to opaque
NOWHERE = np.zeros(3)  # direction to the sun, of which there is none


@dataclass(frozen=True)
class Billboards:
    """Plants as cards.

    Parameters
    ----------
    meshes
        (s,) three cards each: two upright ones that cross, and a level one in the middle of the crown; unlit.
    atlas_of
        (s,) whose picture it shows.
    atlases
        PNGs with alpha, at most `ATLAS_PX` a side.
    """

    meshes: Meshes
    atlas_of: NDArray[np.int64]
    atlases: list[bytes]


def bake_billboards(
    skeletons: Skeletons,
    season_end: NDArray[np.integer],
    looks: Sequence[Look],
    *,
    season: Season = "summer",
    px: int = 128,
) -> Billboards:
    """Draw each plant from two sides and from above, in flat light, and set the pictures on cards.

    Parameters
    ----------
    skeletons, season_end, looks
        (s,) what grew, the season each is shown at, and how it looks.
    season
        Bare in winter.
    px
        Side of each picture.
    """
    plants, across = len(skeletons), ATLAS_PX // px
    in_atlas = max(across * across // len(VIEWS), 1)
    # Plants that look alike share atlases, so that a palette holds their colours.
    kinds = {look: number for number, look in enumerate(dict.fromkeys(looks))}
    order = np.argsort([kinds[look] for look in looks], kind="stable")
    atlas_of = np.empty(plants, np.int64)
    atlas_of[order] = np.arange(plants) // in_atlas
    meshes = _room(plants)
    atlases = []
    for atlas in range(-(-plants // in_atlas)):
        own = order[atlas * in_atlas : (atlas + 1) * in_atlas]
        width, height = across * px, -(-len(own) * len(VIEWS) // across) * px
        rgb, alpha = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
        for number, plant in enumerate(own):
            grown = _Grown(select(skeletons, [plant]), season_end[plant], in_season(looks[plant], season), season, px)
            corners = []
            for view in range(len(VIEWS)):
                row, column = divmod(number * len(VIEWS) + view, across)
                box = (slice(row * px, (row + 1) * px), slice(column * px, (column + 1) * px))
                rgb[box], alpha[box] = grown.picture(view)
                corners.append((grown.uv(view) + np.array([column, row])) * px / np.array([width, height]))
            meshes.xyz_m[12 * plant : 12 * plant + 12] = grown.corners()
            meshes.uv[12 * plant : 12 * plant + 12] = np.concatenate(corners)
        atlases.append(few_colours_png(rgb, alpha, ATLAS_COLOURS))
    return Billboards(meshes, atlas_of, atlases)


def _room(plants: int) -> Meshes:
    """Return the cards of plants, not yet put anywhere; all fronts look south, east and up."""
    card = np.array([[0, 1, 2], [0, 2, 3]])
    return Meshes(
        first_vertex=12 * np.arange(plants + 1),
        first_triangle=6 * np.arange(plants + 1),
        xyz_m=np.zeros((12 * plants, 3), np.float32),
        normal=np.tile(np.repeat(np.array(FRONTS, np.float32), 4, axis=0), (plants, 1)),
        uv=np.zeros((12 * plants, 2), np.float32),
        tint=np.full((12 * plants, 3), 255, np.uint8),
        triangle=np.tile(np.concatenate([card, card + 4, card + 8]), (plants, 1)).astype(np.uint32),
    )


class _Grown:
    """One plant, drawn."""

    def __init__(
        self, skeletons: Skeletons, season_end: np.integer, look: Look, season: Season, px: int
    ) -> None:  # fmt: skip
        standing = Standing(skeletons, np.zeros((1, 2)), [look], np.array([season_end]))
        self.wood, twigs = build_wood(standing)
        self.leaves: Leaves | None = None
        points = [_around(self.wood)]
        self.px = px
        if season == "winter":
            self.wood = joined_wood([self.wood, build_twiglets(twigs, [look])])
            points.append(_around(self.wood))
        elif len(twigs.tip):
            reach = np.ptp(np.concatenate(points), axis=0).max() + 2 * (look.spray_m + look.blade_m[0])
            shortest = SHORTEST_LEAF_PX * reach / (FINER * px)
            self.leaves = build_leaves(twigs, [look], shortest_m=shortest)
            size = np.abs(self.leaves.along) + np.abs(self.leaves.across)
            points += [self.leaves.centre - size, self.leaves.centre + size]
        everything = np.concatenate(points)
        self.low, self.high = everything.min(axis=0), everything.max(axis=0)
        self.low[2] = 0.0
        self.high = np.maximum(self.high, self.low + 0.05)
        self.scale = FINER * (px - 2 * RIM_PX) / float((self.high - self.low).max())
        self.leaf_light, self.wood_light = _light(self.wood, twigs, self.leaves)

    def picture(self, view: int) -> tuple[Floats, Floats]:
        """Return (px, px, 3) linear colours and (px, px) alpha."""
        azimuth, pitch = VIEWS[view]
        side = FINER * self.px
        middle = 0.5 * (self.low + self.high)
        eye = (float(middle[0]), float(middle[1]), float(middle[2]))
        camera = Camera(eye, azimuth, pitch, self.scale, (side, side), (side / 2, side / 2))
        canvas = Canvas(np.full((side, side), np.inf, np.float32), np.zeros((side, side, 3), np.float32))
        wood = self.wood
        start, end = camera.seen(wood.start), camera.seen(wood.end)
        start[:, 3] *= wood.start_radius
        end[:, 3] *= wood.end_radius
        draw_wood(canvas, start, end, wood.rgb, wood.start[:, 2] < 1e-3, self.wood_light, NOWHERE, 0.0, FLAT_LIGHT)
        if self.leaves is not None:
            axes = camera.axes
            leaves = self.leaves
            draw_leaves(canvas, camera.seen(leaves.centre), leaves.along @ axes.T, leaves.across @ axes.T, leaves.rgb,
                        self.leaf_light, NOWHERE, 0.0, FLAT_LIGHT)  # fmt: skip
        alpha = _averaged(np.isfinite(canvas.depth).astype(np.float32))
        alpha[int(np.ceil(self.uv(view)[0, 1] * self.px)) :] = 0.0  # leaves that hang into the ground
        total = _averaged(canvas.rgb)
        return spread(total / np.maximum(alpha, np.float32(1e-6))[..., None], alpha), alpha

    def _spans(self, view: int) -> tuple[tuple[int, float], tuple[int, float]]:
        """Return which axis runs to the right and which up in a view, and how much of it is seen."""
        size = self.high - self.low
        right, up = ((0, 2), (1, 2), (0, 1))[view]
        return (right, float(size[right])), (up, float(size[up]))

    def uv(self, view: int) -> FloatArray:
        """Return (4, 2) places in the picture, 0 to 1, of the card's corners: lower left, right, upper right, left."""
        (_, wide), (_, high) = self._spans(view)
        x, y = (0.5 * extent * self.scale / (FINER * self.px) for extent in (wide, high))
        return 0.5 + np.array([[-x, y], [x, y], [x, -y], [-x, -y]])

    def corners(self) -> FloatArray:
        """Return (12, 3) corners of the three cards, in the order of `uv`."""
        (west, south, low), (east, north, high) = self.low, self.high
        level = 0.5 * (low + high) if self.leaves is None else float(np.median(self.leaves.centre[:, 2]))
        return np.array([
            [west, 0, low], [east, 0, low], [east, 0, high], [west, 0, high],
            [0, south, low], [0, north, low], [0, north, high], [0, south, high],
            [west, south, level], [east, south, level], [east, north, level], [west, north, level],
        ])  # fmt: skip


def _around(wood: Wood) -> FloatArray:
    """Return (n, 3) points around all wood, as far out as it is thick."""
    start, end = wood.start_radius[:, None], wood.end_radius[:, None]
    return np.concatenate([np.zeros((1, 3)), wood.start - start, wood.start + start, wood.end - end, wood.end + end])


def _averaged(values: Floats) -> Floats:
    """Return the means of squares of `FINER` pixels."""
    parts = [values[row::FINER, column::FINER] for row in range(FINER) for column in range(FINER)]
    return np.asarray(sum(parts[1:], parts[0]) / np.float32(len(parts)), np.float32)


def _light(wood: Wood, twigs: Twigs, leaves: Leaves | None) -> tuple[Floats, Floats]:
    """Return (k, 2) shares of sun, none, and sky that reach leaves, and (m, 4) both ends of branches."""
    if leaves is None:
        return np.zeros((0, 2), np.float32), np.tile(np.array([0, 1], np.float32), (len(wood.start), 2))
    area = np.bincount(leaves.twig, leaves.area_m2, minlength=len(twigs.tip)).astype(np.float32)
    tip = twigs.tip.astype(np.float32)
    crown = twig_kernel.Twigs(np.array([0, len(tip)]), tip, tip, area, np.zeros(len(tip), np.int32), np.zeros((1, 3)))
    of_leaves = np.zeros((len(leaves.centre), 2), np.float32)
    of_leaves[:, 1] = DARK + (1.0 - DARK) * twig_kernel.light_at(crown, leaves.centre.astype(np.float32))
    of_wood = np.zeros((len(wood.start), 4), np.float32)
    for column, ends in ((1, wood.start), (3, wood.end)):
        of_wood[:, column] = DARK + (1.0 - DARK) * twig_kernel.light_at(crown, ends.astype(np.float32))
    return of_leaves, of_wood
