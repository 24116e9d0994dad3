"""Pairs of coverage and parameters: lots planted by the placement strategies, seen as a map shows them.

Lots are planted many times over, each time with parameters of their own, their neighbours too, whose crowns reach in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.lot_windows import Surroundings, WindowPlaces, lot_windows, window_places
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.pipeline_towns import Town, plain_town, towns_of
from urbanforest_cli.placement.sites import Positions, Sites
from urbanforest_cli.placement.strategies import KERNELS, strategy_named
from urbanforest_cli.placement.thinning import index_within, kept_by_count
from urbanforest_cli.register.envelopes import subtract
from urbanforest_cli.regression.degrade import map_faults, painted_windows
from urbanforest_cli.regression.designs import Drawn, draw_pairs, used_by
from urbanforest_cli.regression.features import features_of, network_windows
from urbanforest_cli.regression.pair_table import PairTable, joined

PAIRS_A_CHUNK, LOTS_A_BATCH = 512, 256
ARC_SEGMENTS = 6
REACH_M = 16.0
"""How far a crown of the neighbours may reach into a window."""

Shapes = NDArray[Any]
Integers = NDArray[np.int64]
Keys = NDArray[np.uint64]


@dataclass(frozen=True)
class _Grove:
    """A town planted once: plants left standing, by lot, and how many there were before thinning."""

    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    keys: NDArray[np.uint64]
    lot: Integers
    all_xy: NDArray[np.float64]
    all_lot: Integers


def make_pairs(
    count: int,
    *,
    lots: Sequence[str | Path] = (),
    seed: int = 0,
    design: str | None = None,
    degraded: bool = True,
    values: NDArray[np.float64] | None = None,
    strategies: NDArray[np.integer] | None = None,
    workers: int = 1,
    notices: Notices | None = None,
    progress: Progress = silent,
) -> PairTable:
    """Make pairs of coverage and parameters.

    Pair number i depends on the seed, the lots and i alone, not on `count` or `workers`. Parameters are uniform over
    the paper's table 1 (`regression.designs.draw_pairs`), the strategies random, boundary and cluster equally
    likely; radii follow the law that keeps them, a share of exactly the density of the positions is planted, and a
    lot has from 1 to ``cluster_count_max`` clusters, each number equally likely.

    Parameters
    ----------
    count
        Pairs to make.
    lots
        Files of real lots, ``FILE`` or ``FILE:LAYER``, used beside those of a procedural city and plain shapes;
        their layer ``buildings`` too, where there is one. A lot that is there several times, in one file or in
        several, is taken once.
    design
        ``S`` or ``P``: one of the two frozen test designs, plain lots of 10 to 60 or 60 to 100 m, a lot a pair.
    degraded
        Whether maps have faults, as `regression.degrade.map_faults` draws them; else they show discs as they are.
    values, strategies
        (count, 6) and (count,) to use instead of what is drawn for a pair; its lot, house and chance stay as they
        are. NaN and -1 leave what is drawn.
    notices
        Takes what was repaired in files of lots, and which lots were left out.

    Raises
    ------
    InputError
        A file of lots cannot be read, holds no lot that can be used, or is named twice.
    """
    towns = (
        towns_of(lots, seed, Notices() if notices is None else notices)
        if design is None
        else [plain_town(count, seed, design)]
    )
    announce_compile([kernel for name in STRATEGIES_READ for kernel in KERNELS[name]], progress)
    pool = sum(len(town.lots) for town in towns)
    tables, numbers = [], []
    done = 0
    for start in range(0, count, pool):
        number = np.arange(start, min(start + pool, count))
        lot_of = number - start
        if design is None:
            chance = keys_for(seed, "pair order", map(str, range(start, start + pool)))
            lot_of = np.argsort(chance, kind="stable")[lot_of]
        for town in towns:
            here = (lot_of >= town.first) & (lot_of < town.first + len(town.lots))
            mine = number[here][np.argsort(lot_of[here], kind="stable")]
            rows = np.sort(lot_of[here] - town.first)
            numbers.append(mine)
            keys = keys_for(seed, f"pairs {town.name}", (f"{start} {row}" for row in range(len(town.lots))))
            drawn = draw_pairs(keys)
            if values is not None:
                drawn.values[rows] = np.where(np.isnan(values[mine]), drawn.values[rows], values[mine])
            if strategies is not None:
                drawn.strategy[rows] = np.where(strategies[mine] < 0, drawn.strategy[rows], strategies[mine])
            for table in _tables(town, rows, keys, drawn, degraded, workers):
                tables.append(table)
                done += len(table)
                progress("making pairs", done, count)
    return joined(tables).take(np.argsort(np.concatenate(numbers), kind="stable"))


def _tables(town: Town, rows: Integers, keys: Keys, drawn: Drawn, degraded: bool, workers: int) -> Iterator[PairTable]:
    """Plant a town once and yield the pairs of some of its lots, in their order."""
    if not len(rows):
        return
    used = used_by(drawn.strategy)
    grove = _plant(town, _near(town, rows), keys, drawn, workers)
    buildings = Surroundings(town.buildings)
    bare = Surroundings(np.empty(0, dtype=object))
    lot_numbers = _lot_numbers(town)

    def table(start: int) -> PairTable:
        some = rows[start : start + PAIRS_A_CHUNK]
        places = _one_each(window_places(town.lots[some]), keys[some])
        faults = map_faults(keys[some]) if degraded else None
        coverage = painted_windows(places, grove.xy, grove.radius_m, grove.keys, faults)
        windows = replace(lot_windows(town.lots[some], bare, buildings, places=places), coverage=coverage)
        unbuilt = ~drawn.with_building[some]
        windows.ground[unbuilt] = windows.lot[unbuilt]
        windows = replace(windows, ground_area_m2=np.where(unbuilt, windows.lot_area_m2, windows.ground_area_m2))
        return PairTable(
            windows=network_windows(windows),
            pixel_m=2 * windows.pixel_m,
            features=features_of(windows),
            values=drawn.values[some].astype(np.float32),
            used=used[some],
            strategy=drawn.strategy[some],
            visible=_count_shown(places, some, grove.xy, grove.lot),
            placed=_count_shown(places, some, grove.all_xy, grove.all_lot),
            lot=lot_numbers[some],
        )

    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(table, range(0, len(rows), PAIRS_A_CHUNK))


def _lot_numbers(town: Town) -> NDArray[np.int32]:
    """Return the number that each lot of a town has among all."""
    return (town.first + np.arange(len(town.lots))).astype(np.int32)


def _near(town: Town, rows: Integers) -> Integers:
    """Return the lots from which a crown may reach into the windows of some lots, those included."""
    bounds = window_places(town.lots[rows]).bounds + np.array([-REACH_M, -REACH_M, REACH_M, REACH_M])
    return np.unique(shapely.STRtree(town.lots).query(shapely.box(*bounds.T))[1])


def _one_each(places: WindowPlaces, keys: Keys) -> WindowPlaces:
    """Choose one window of each lot, of several by chance."""
    first = np.searchsorted(places.owner, np.arange(len(keys)))
    number = np.bincount(places.owner, minlength=len(keys))
    return places.take(first + np.floor(number * hash_uniform(keys, np.full(len(keys), 77))).astype(np.int64))


def _plant(town: Town, rows: Integers, keys: Keys, drawn: Drawn, workers: int) -> _Grove:
    """Plant some lots of a town, each by its own strategy and parameters."""
    areas = _grounds(town, rows, drawn)
    settings = Placement()
    batches = [
        (name, batch)
        for letter, name in enumerate(STRATEGIES_READ)
        for chosen in [np.flatnonzero(drawn.strategy[rows] == letter)]
        for batch in np.array_split(chosen, max(1, -(-len(chosen) // LOTS_A_BATCH)))
    ]

    def positions_of(work: tuple[str, Integers]) -> Positions:
        name, batch = work
        mine = rows[batch]
        values = {parameter: drawn.values[mine, column] for column, parameter in enumerate(REGRESSED)}
        sites = Sites(mine.astype(str).astype(object), keys[mine], town.lots[mine], areas[batch], values)
        found = strategy_named(name)(sites, settings)
        return Positions(mine[found.site], found.xy, found.radius_m)

    with ThreadPoolExecutor(workers) as pool:
        found = list(pool.map(positions_of, batches))
    site = np.concatenate([positions.site for positions in found])
    order = np.argsort(site, kind="stable")
    site = site[order]
    xy = np.concatenate([positions.xy for positions in found])[order]
    radius = np.concatenate([positions.radius_m for positions in found])[order]
    kept = kept_by_count(site, keys ^ np.uint64(0x7A0), drawn.values[:, REGRESSED.index("density")])
    chance = hash_uniform(keys[site] ^ np.uint64(0xC203), index_within(site))
    crowns = np.floor(chance * 2.0**53).astype(np.uint64)
    return _Grove(xy[kept], radius[kept], crowns[kept], site[kept], xy, site)


def _grounds(town: Town, rows: Integers, drawn: Drawn) -> Shapes:
    """Return the ground of some lots: all that is farther from buildings than the clearance drawn."""
    lots = town.lots[rows]
    built = np.flatnonzero(drawn.with_building[rows])
    clearance = drawn.clearance_m[rows[built]]
    if not len(town.buildings):
        return lots
    near, house = shapely.STRtree(town.buildings).query(lots[built], predicate="dwithin", distance=clearance)
    return subtract(lots, built[near], shapely.buffer(town.buildings[house], clearance[near], quad_segs=ARC_SEGMENTS))


def _count_shown(places: WindowPlaces, rows: Integers, xy: NDArray[np.float64], lot: Integers) -> NDArray[np.int32]:
    """Count the plants of each lot that its window shows."""
    place = np.full(int(max(rows.max(), lot.max(initial=0))) + 1, -1)
    place[rows] = np.arange(len(rows))
    window = place[lot]
    west, south, east, north = places.bounds[window].T
    x, y = xy.T
    shown = (window >= 0) & (x >= west) & (x <= east) & (y >= south) & (y <= north)
    return np.bincount(window[shown], minlength=len(rows)).astype(np.int32)
