"""Skeletons to wood: each axis one tube of rings, many skeletons at once.

An axis, from its foot to its end, is one tube that shares rings between internodes. A branch is a tube of its own: its
first ring lies inside the wood that bears it, that of a trunk below the ground; these are the only open edges. Where
the wood that bears a branch ends, the branch begins closed. Where an axis ends and a branch bears a good part of what
it bore, the branch goes on in its tube. Ends are pointed, or a dome where something thick was cut off.

Places and radii are those of the skeleton, places smoothed along the axis as in pictures. Corners stand a little
outside their circle, so that a branch looks as thick with few sides as with many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Meshes
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.export.mesh.levels import BARK_TEXTURE_M, Level
from urbanforest_cli.export.mesh.wood_chain_kernel import trace_wood
from urbanforest_cli.export.mesh.wood_kernel import fill_wood

SIDES = (3, 4, 5, 6, 8, 10, 12, 16, 20, 24)
NODES_A_PART = 100_000

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def build_wood(skeletons: Skeletons, season_end: NDArray[np.integer], level: Level, *, workers: int = 1) -> Meshes:
    """Turn skeletons into wood.

    Parameters
    ----------
    skeletons
        What grew.
    season_end
        (s,) the season each is shown at.
    level
        How fine.
    workers
        Threads; the result is the same for any number.

    Returns
    -------
    Meshes
        One a skeleton, empty where nothing stands; about its root collar. `uv` runs in whole turns around each tube,
        and in metres over `BARK_TEXTURE_M` along; `tint` darkens toward the ground.
    """
    if level.sides[1] == 0:
        return _meshes(np.zeros((len(skeletons), 2), np.int64))
    season = np.ascontiguousarray(season_end, np.int32)
    sides = choice_of_sides(level)
    side_radius = level.wood_error_m / (1.0 - inner_radius(sides))
    inner, outer = inner_radius(sides), outer_radius(sides)
    table_first, circle = circles(sides)

    def trace(part: range) -> Any:
        return trace_wood(
            skeletons.first, skeletons.parent, skeletons.xyz_m, skeletons.order, skeletons.birth_season,
            skeletons.death_season, skeletons.tip_radius_m, skeletons.pipe_exponent, season, part.start, part.stop,
            level.wood_radius_min_m, level.wood_error_m, sides, side_radius, inner, outer, BARK_TEXTURE_M,
        )  # fmt: skip

    parts = _parts(skeletons.first)
    traced = _each(trace, parts, workers)
    counts = [chains[-1] for chains in traced]
    meshes = _meshes(np.concatenate(counts) if counts else np.zeros((0, 2), np.int64))

    def fill(place: int) -> None:
        part = slice(parts[place].start, parts[place].stop + 1)
        samples, choice, chain_first, turns, skeleton_first, _ = traced[place]
        fill_wood(
            samples, choice, chain_first, turns, skeleton_first, sides, outer, table_first, circle, BARK_TEXTURE_M,
            meshes.first_vertex[part], meshes.first_triangle[part], meshes.xyz_m, meshes.normal, meshes.uv, meshes.tint,
            meshes.triangle,
        )  # fmt: skip

    _each(fill, range(len(parts)), workers)
    return meshes


def choice_of_sides(level: Level) -> NDArray[np.int64]:
    """Return the numbers of sides that branches of a level have."""
    least, most = level.sides
    return np.array(sorted({least, most} | {n for n in SIDES if least <= n <= most}), np.int64)


def outer_radius(sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the radius of corners over that of a circle that looks as wide, on average over all directions."""
    half = np.pi / sides
    return np.asarray(half / np.sin(half))


def inner_radius(sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the distance of the middles of sides over the radius of a circle that looks as wide."""
    half = np.pi / sides
    return np.asarray(half / np.tan(half))


def circles(sides: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return tables of corners: where that of each number of sides begins, and (., 5) what `fill_wood` reads."""
    rows = []
    for n in sides:
        share = np.arange(n + 1) / n
        turn = 2 * np.pi * (np.arange(n + 1) % n) / n  # the seam's corners are at the same place to the last bit
        middle = 2 * np.pi * (np.arange(n + 1) + 0.5) / n
        rows.append(np.column_stack([np.cos(turn), np.sin(turn), np.cos(middle), np.sin(middle), share]))
    first = np.concatenate([np.zeros(1, np.int64), np.cumsum(sides + 1)])[:-1]
    return first, np.concatenate(rows).astype(np.float32)


def _parts(first: NDArray[np.int64]) -> list[range]:
    """Cut skeletons into parts of about as many nodes."""
    marks = np.arange(0, first[-1] + NODES_A_PART, NODES_A_PART)
    cuts = np.unique(np.concatenate([np.searchsorted(first, marks), [len(first) - 1]]).clip(0, len(first) - 1))
    return [range(int(a), int(b)) for a, b in pairwise(cuts)]


def _each(work: Callable[[Item], Answer], items: Sequence[Item], workers: int) -> list[Answer]:
    if workers <= 1 or len(items) <= 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, items))


def _meshes(counts: NDArray[np.int64]) -> Meshes:
    """Return meshes of so many corners and triangles, to be filled."""
    first = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
    vertices, triangles = first[-1]
    return Meshes(
        first_vertex=np.ascontiguousarray(first[:, 0]),
        first_triangle=np.ascontiguousarray(first[:, 1]),
        xyz_m=np.empty((vertices, 3), np.float32),
        normal=np.empty((vertices, 3), np.float32),
        uv=np.empty((vertices, 2), np.float32),
        tint=np.empty((vertices, 3), np.uint8),
        triangle=np.empty((triangles, 3), np.uint32),
    )
