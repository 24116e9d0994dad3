"""How far the shape that a plant takes from the library is from the one it would have grown in its own place.

Crowns are compared as the voxels they fill: those within LEAF_REACH_M of a standing internode's end. Trunks below the
lowest branch are left out. All figures are zero or one for shapes that are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.skeleton import Skeletons, measure, standing
from urbanforest_cli.growth.library import placed

VOXEL_M = 0.5
LEAF_REACH_M = 0.3
SAMPLE_DRAW = 3
HALF_SPAN = 1 << 19  # voxels from the root to the end of what a code can tell
FIGURES = ("overlap", "height_error", "crown_radius_error", "crown_shift_m", "crown_volume_error")


@dataclass(frozen=True)
class ShapeErrors:
    """Differences of (k,) shapes from the plants' own.

    Parameters
    ----------
    overlap
        Voxels that both crowns fill, as a share of those that either does: 1 for the same crown.
    height_error, crown_radius_error, crown_volume_error
        Excess over the plant's own, as a share of its own; the volume is that of voxels.
    crown_shift_m
        Distance between the middles of both crowns.
    """

    overlap: NDArray[np.float64]
    height_error: NDArray[np.float64]
    crown_radius_error: NDArray[np.float64]
    crown_shift_m: NDArray[np.float64]
    crown_volume_error: NDArray[np.float64]

    def summary(self) -> dict[str, dict[str, float]]:
        """Return median and the value that nine of ten are no worse than of each figure, errors without their sign.

        For `overlap` that is the 10 % quantile, for all others the 90 % quantile. Empty where there is no plant.
        """
        figures = {}
        for name in FIGURES:
            values = np.abs(getattr(self, name))
            values = values[np.isfinite(values)]
            if len(values):
                worst = 0.1 if name == "overlap" else 0.9
                figures[name] = {"median": float(np.median(values)), "worst_tenth": float(np.quantile(values, worst))}
        return figures


def sample_plants(keys: NDArray[np.uint64], count: int) -> NDArray[np.int64]:
    """Choose plants to measure errors on: rows of those with the smallest hash, whatever the order of rows."""
    draw = hash_uniform(keys, np.full(len(keys), SAMPLE_DRAW))
    return np.lexsort((keys, draw))[:count]


def shape_errors(
    own: Skeletons,
    entries: Skeletons,
    entry: NDArray[np.integer],
    *,
    yaw_deg: NDArray[np.float64],
    mirror: NDArray[np.bool_],
    scale: NDArray[np.float64],
    season_end: NDArray[np.integer] | None = None,
    entry_season_end: NDArray[np.integer] | None = None,
) -> ShapeErrors:
    """Compare plants grown in their place with library entries placed there.

    Parameters
    ----------
    own
        (k,) skeletons of the plants.
    entries, entry
        Skeletons of the library, and (k,) which of them each plant takes.
    yaw_deg, mirror, scale
        (k,) how it is placed.
    season_end, entry_season_end
        Seasons at whose end they are compared, of `own` and of `entries`; by default their last.
    """
    own_size, entry_size = measure(own, season_end), measure(entries, entry_season_end)
    mine = _crowns(own, standing(own, season_end), np.arange(len(own)))
    theirs = _crowns(entries, standing(entries, entry_season_end), np.unique(entry))
    overlap, shift, volume = (np.full(len(own), np.nan) for _ in range(3))
    for k in range(len(own)):
        points = placed(theirs[int(entry[k])], yaw_deg=yaw_deg[k], mirror=mirror[k], scale=scale[k])
        a, b = filled_voxels(mine[k]), filled_voxels(points)
        if len(a) == 0 or len(b) == 0:
            overlap[k] = float(len(a) == len(b))
            continue
        both = len(np.intersect1d(a, b, assume_unique=True))
        overlap[k] = both / (len(a) + len(b) - both)
        volume[k] = len(b) / len(a) - 1.0
        shift[k] = float(np.linalg.norm(_middle(a) - _middle(b)))
    errors = {}
    for name in ("height_m", "crown_radius_m"):
        true = own_size[name]
        errors[name] = scale * entry_size[name][entry] / np.where(true > 0, true, np.nan) - 1.0
    return ShapeErrors(
        overlap=overlap,
        height_error=errors["height_m"],
        crown_radius_error=errors["crown_radius_m"],
        crown_shift_m=shift,
        crown_volume_error=volume,
    )


def filled_voxels(points_m: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the voxels, as sorted codes, that lie within the reach of leaves around points (n, 3)."""
    if len(points_m) == 0:
        return np.zeros(0, dtype=np.int64)
    points = np.asarray(points_m, dtype=np.float64) / VOXEL_M
    cell = np.floor(points).astype(np.int64)
    within = points - cell
    reach = LEAF_REACH_M / VOXEL_M
    codes = []
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            for dz in (-1, 0, 1):
                step = np.array([dx, dy, dz])
                gap = np.where(step < 0, within, np.where(step > 0, 1.0 - within, 0.0))
                near = (gap**2).sum(axis=1) <= reach**2
                codes.append(_code(cell[near] + step))
    return np.unique(np.concatenate(codes))


def _code(cell: NDArray[np.int64]) -> NDArray[np.int64]:
    x, y, z = (cell + HALF_SPAN).T
    return np.asarray((x << 40) | (y << 20) | z)


def _middle(codes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the mean position (3,) of voxels in metres."""
    span = 2 * HALF_SPAN - 1
    cells = np.column_stack([codes >> 40, (codes >> 20) & span, codes & span]) - HALF_SPAN
    return np.asarray((cells.mean(axis=0) + 0.5) * VOXEL_M)


def _crowns(
    skeletons: Skeletons, there: NDArray[np.bool_], wanted: NDArray[np.integer]
) -> dict[int, NDArray[np.float32]]:
    """Return where (n, 3) the wanted skeletons' crowns stand: branches, and stems from the lowest branch up."""
    crowns = {}
    for s in wanted:
        nodes = slice(skeletons.first[s] + 1, skeletons.first[s + 1])
        xyz, order = skeletons.xyz_m[nodes][there[nodes]], skeletons.order[nodes][there[nodes]]
        branches = xyz[order > 0, 2]
        base = branches.min() if len(branches) else -np.inf
        crowns[int(s)] = xyz[(order > 0) | (xyz[:, 2] >= base)]
    return crowns
