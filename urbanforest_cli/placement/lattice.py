"""Strategy regular: plants on a square lattice that lies along the lot (paper, parameters omega, eta and psi)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.placement.inside import inside_by_margin
from urbanforest_cli.placement.lattice_kernel import cells_of_strips, frames_of_lots, rows_and_columns
from urbanforest_cli.placement.radii import truncated_radii
from urbanforest_cli.placement.sites import Positions, Sites

PHASE_SALT = np.uint64(0x7068617365)
JITTER_SALT = np.uint64(0x6A6974746572)
CELLS_A_BLOCK = 1_000_000


@dataclass(frozen=True)
class LatticePoints:
    """Lattice plants of a batch: (n,) lot, (n, 2) row and column of the cell, (n, 2) position in metres."""

    site: NDArray[np.int64]
    cell: NDArray[np.int64]
    xy: NDArray[np.float64]


def regular(sites: Sites, settings: Placement) -> Positions:
    """Set a plant in each cell of a lattice along the lot, kept where there is ground for it."""
    cell = sites.values["grid_size_m"]
    over = shapely.area(sites.areas) / cell**2 > settings.max_plants_per_lot
    areas = sites.areas.copy()
    areas[over] = shapely.Polygon()
    points = lattice_positions(
        sites.lots,
        areas,
        cell,
        sites.values["grid_orientation_deg"],
        sites.values["grid_jitter"],
        sites.keys,
        random_phase=settings.lattice_phase == "random",
    )
    radius = truncated_radii(
        sites.keys[points.site],
        cell_index(points.cell),
        sites.values["radius_mean_m"][points.site],
        sites.values["radius_variance_m2"][points.site],
        settings,
    )
    return Positions(points.site, points.xy, radius, np.flatnonzero(over))


def lattice_positions(
    lots: NDArray[np.object_],
    areas: NDArray[np.object_],
    cell_m: NDArray[np.float64],
    orientation_deg: NDArray[np.float64],
    jitter: NDArray[np.float64],
    keys: NDArray[np.uint64],
    *,
    random_phase: bool = False,
) -> LatticePoints:
    """Lay square lattices over lots and keep the plants that stand in the lots' ground.

    The lattice lies along the smallest rectangle around the lot, turned by `orientation_deg` (90 degrees change
    nothing), and a plant stands at the centre of each cell, moved within it by `jitter` times the cell's side times
    a uniform number in -1/2 .. 1/2 along each axis. That number hangs on the lot and the cell alone.

    Parameters
    ----------
    lots, areas
        (n,) polygons: the lots, and the ground left in them.
    cell_m
        (n,) sides of the cells, above 0.
    jitter
        (n,) shares of the cell, 0 to 1.
    keys
        (n,) stream keys.
    random_phase
        Shift each lattice by a random part of a cell instead of centring it in the lot.
    """
    corners, owner = shapely.get_coordinates(lots, return_index=True)
    offsets = np.searchsorted(owner, np.arange(len(lots) + 1))
    origin, direction, sides = frames_of_lots(corners, offsets, np.radians(orientation_deg))
    phase = np.full((len(lots), 2), -1.0)
    if random_phase:
        for axis in range(2):
            phase[:, axis] = hash_uniform(keys ^ PHASE_SALT, np.full(len(keys), axis))
    cell = np.ascontiguousarray(cell_m, dtype=np.float64)
    nowhere = shapely.is_missing(areas) | shapely.is_empty(areas) | ~np.isfinite(sides).all(axis=1)
    sides[nowhere] = (0.0, -1.0, 0.0, -1.0)
    found: list[LatticePoints] = []
    for strips in _blocks(*rows_and_columns(sides, cell, phase)):
        site, number, centre = cells_of_strips(sides, cell, phase, *strips)
        reach = (jitter * cell)[site]
        index = cell_index(number)
        u = centre[:, 0] + reach * (hash_uniform(keys[site] ^ JITTER_SALT, 2 * index) - 0.5)
        v = centre[:, 1] + reach * (hash_uniform(keys[site] ^ JITTER_SALT, 2 * index + 1) - 0.5)
        dx, dy = direction[site].T
        xy = origin[site] + np.column_stack((dx * u - dy * v, dy * u + dx * v))
        first, last = site[0], site[-1] + 1
        inside = inside_by_margin(areas[first:last], site - first, xy)
        found.append(LatticePoints(site[inside], number[inside], xy[inside]))
    return LatticePoints(
        np.concatenate([np.zeros(0, dtype=np.int64), *(points.site for points in found)]),
        np.concatenate([np.zeros((0, 2), dtype=np.int64), *(points.cell for points in found)]),
        np.concatenate([np.zeros((0, 2)), *(points.xy for points in found)]),
    )


def cell_index(cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for each (row, column), the same whatever the size of the lattice."""
    return (cell[:, 0] << 30) + cell[:, 1]


def _blocks(
    rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Cut lattices into strips of rows, and gather strips into blocks of bounded size."""
    strips = np.maximum(1, -(-rows * columns // CELLS_A_BLOCK))
    strips[rows * columns == 0] = 0
    site = np.repeat(np.arange(len(rows)), strips)
    part = np.arange(len(site)) - np.repeat(np.cumsum(strips) - strips, strips)
    begin = part * rows[site] // strips[site]
    end = (part + 1) * rows[site] // strips[site]
    block = np.cumsum((end - begin) * columns[site]) // CELLS_A_BLOCK
    cuts = np.flatnonzero(np.diff(block)) + 1
    bounds = [0, *cuts.tolist(), len(site)] if len(site) else [0]
    for a, b in pairwise(bounds):
        yield site[a:b], begin[a:b], end[a:b]
