"""Crowns as grown, seen from above: how high they are and how much ground they cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.core.skeleton import Skeletons, pipe_count, standing
from urbanforest_cli.core.species import Species
from urbanforest_cli.export.plant_looks import look_of
from urbanforest_cli.export.plant_scene import TWIG_PIPES, TWIG_SEASONS
from urbanforest_cli.export.scene.canopy_kernel import share_covered, stamp_twigs
from urbanforest_cli.export.scene.city import City

CELL_M = 1.0
CELL_LIMIT = 200_000_000  # of 5 bytes each, and 8 in a band
BAND_CELLS = 32_000_000
SHAPES_AT_ONCE = 1000
SECTORS = 8  # a crown's radius is its mean reach over so many, so none reaches further than eight times as far
LEAF_SHARE = 0.45  # of a blade's length lies beyond its spray
HEIGHT_STEP_M = 0.01


@dataclass(frozen=True)
class Canopy:
    """Rasters of a city's canopy, the first row northernmost.

    Parameters
    ----------
    west_m, north_m
        Upper left corner in the working CRS, a multiple of the cell; beyond the raster nothing is covered.
    cell_m
        Side of a cell.
    top_m
        (rows, cols) float32 height above the ground of the highest leafy twig; 0 where there is none.
    cover_percent
        (rows, cols) uint8 share of a cell that lies under leaves, 0 to 100; gaps within crowns count as gaps.
    """

    west_m: float
    north_m: float
    cell_m: float
    top_m: NDArray[np.float32]
    cover_percent: NDArray[np.uint8]


def canopy_rasters(city: City, *, cell_m: float = CELL_M) -> Canopy:
    """Press every leafy twig of a city onto a grid.

    A twig bears leaves where the pictures have them: on wood that carries few twig ends, and on young wood. It covers
    the ground as far around it as its leaves reach, and counts with its own height, so that the highest cell of a tree
    is as high as the tree. Skeletons are read once a band of rows; a band holds 32 million cells.

    Raises
    ------
    LimitError
        The grid would have more than `CELL_LIMIT` cells.
    """
    west, north, rows, cols = _grid(city, cell_m)
    top, cover = np.zeros((rows, cols), np.float32), np.zeros((rows, cols), np.uint8)
    height = max(BAND_CELLS // cols, 1)
    for start in range(0, rows, height):
        band = slice(start, min(start + height, rows))
        _press(city, cell_m, west, north - start * cell_m, top[band], cover[band])
        _step(top[band])
    inner = tuple(_inhabited(np.atleast_1d(cover.any(axis=axis))) for axis in (1, 0))
    west, north = west + inner[1].start * cell_m, north - inner[0].start * cell_m
    return Canopy(west, north, cell_m, top[inner], cover[inner])


def _grid(city: City, cell_m: float) -> tuple[float, float, int, int]:
    """Return west, north, rows and columns of a grid that holds all crowns, its edges at multiples of the cell."""
    plants = city.plants
    if not len(plants):
        return city.origin.easting_m, city.origin.northing_m, 1, 1
    furthest = _furthest_m(city)[:, None] + cell_m
    west, south = np.floor((plants.xy_m - furthest).min(axis=0) / cell_m)
    east, north = np.ceil((plants.xy_m + furthest).max(axis=0) / cell_m)
    rows, cols = int(north - south), int(east - west)
    if rows * cols > CELL_LIMIT:
        raise LimitError(
            "a raster of the canopy would be too large",
            where="cell of the canopy",
            found=f"{rows} x {cols} cells of {cell_m:g} m",
            expected=f"at most {CELL_LIMIT:,} cells",
            next_step="take larger cells, or part of the city with --bbox",
        )
    return float(west * cell_m), float(north * cell_m), rows, cols


def _inhabited(there: NDArray[np.bool_]) -> slice:
    """Return from the first to the last that is there, with one on either side; the first if none is."""
    found = np.flatnonzero(there)
    return slice(max(found[0] - 1, 0), found[-1] + 2) if len(found) else slice(0, 1)


def _step(height_m: NDArray[np.float32]) -> None:
    """Round heights to whole centimetres, which a file packs well."""
    step = np.float32(HEIGHT_STEP_M)
    height_m /= step
    np.rint(height_m, out=height_m)
    height_m *= step


def _press(
    city: City, cell_m: float, west: float, north: float,
    top: NDArray[np.float32], cover: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Press what reaches into a band onto it."""
    plants = city.plants
    parts = np.zeros(top.shape, np.uint64)
    reach = _reach_m(city)
    furthest = _furthest_m(city) + cell_m
    south = north - len(top) * cell_m
    near = np.flatnonzero((plants.xy_m[:, 1] - furthest < north) & (plants.xy_m[:, 1] + furthest > south))
    ids, shape = np.unique(plants.skeleton_id[near], return_inverse=True)
    order = np.argsort(shape, kind="stable")
    near, shape = near[order], shape[order]
    for start in range(0, len(ids), SHAPES_AT_ONCE):
        skeletons = city.skeletons_of(ids[start : start + SHAPES_AT_ONCE])
        first, points = _twigs(skeletons, city.season_end(skeletons))
        span = slice(*np.searchsorted(shape, [start, start + SHAPES_AT_ONCE]))
        rows = near[span]
        stamp_twigs(
            first, points, shape[span] - start, plants.xy_m[rows, 0] - west, north - plants.xy_m[rows, 1],
            plants.yaw_rad[rows], np.where(plants.mirror[rows], -1.0, 1.0), plants.scale[rows], reach[rows],
            cell_m, top, parts,
        )  # fmt: skip
    share_covered(parts, cover)


def _furthest_m(city: City) -> NDArray[np.float64]:
    """Return (n,) how far from its root no leaf of a plant reaches."""
    return np.asarray(SECTORS * city.plants.crown_radius_m + _reach_m(city))


def _reach_m(city: City) -> NDArray[np.float64]:
    return np.array([leaf_reach_m(species) for species in city.species])[city.plants.species]


def leaf_reach_m(species: Species) -> float:
    """Return how far from a twig a species' leaves cover the ground: spray and half a blade."""
    look = look_of(species)
    return look.spray_m + LEAF_SHARE * look.blade_m[0]


def _twigs(skeletons: Skeletons, season_end: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return (s + 1,) offsets and (m, 3) points of the twigs that bear leaves: their tips and middles."""
    owner = np.repeat(np.arange(len(skeletons)), skeletons.node_counts())
    leafy = pipe_count(skeletons, season_end) <= TWIG_PIPES
    leafy |= season_end[owner] - skeletons.birth_season < TWIG_SEASONS
    leafy &= standing(skeletons, season_end) & (skeletons.parent >= 0)
    tip = np.flatnonzero(leafy)
    end = skeletons.xyz_m[tip]
    start = skeletons.xyz_m[skeletons.parent[tip] + skeletons.first[owner[tip]]]
    points = np.stack([end, (start + end) / 2], axis=1).reshape(-1, 3)
    first = np.concatenate([[0], np.cumsum(2 * np.bincount(owner[tip], minlength=len(skeletons)))])
    return first.astype(np.int64), np.ascontiguousarray(points, np.float32)
