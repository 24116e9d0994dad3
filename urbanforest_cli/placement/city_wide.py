"""Plants that keep apart across lot borders (config ``placement.conflict = "city"``)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.placement.observed import apart_from_fixed
from urbanforest_cli.placement.radii import radius_limits
from urbanforest_cli.placement.sites import Positions, Sites
from urbanforest_cli.placement.strategies import strategy_named

Discs = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Positions (n, 2) and radii (n,)."""


def place_in_waves(
    sites: Sites,
    strategy: NDArray[np.object_],
    settings: Placement,
    progress: Progress = silent,
    *,
    only: NDArray[np.int64] | None = None,
    standing: Discs | None = None,
) -> Positions:
    """Place lots so that no plant overlaps one of another lot.

    Of two lots near enough to touch, the one whose stream key is larger comes first and the other keeps clear of
    its plants. Lots that wait for nobody make the first wave, those that wait only for them the second, and so on:
    the result depends on the keys alone, not on the order of rows.

    Parameters
    ----------
    strategy
        (n,) name of each lot's strategy.
    only
        Lots to place; the others count for nothing. All if None.
    standing
        Plants that stand already, whatever lot they stand in: positions and radii.

    Returns
    -------
    Positions, lot indices non-decreasing.
    """
    if only is not None:
        part = _with_fixed(sites, only, [[] for _ in only])
        found = place_in_waves(part, strategy[only], settings, progress, standing=standing)
        return Positions(only[found.site], found.xy, found.radius_m, only[found.refused])
    reach = _largest_radii(sites, settings)
    starts, neighbours = _neighbours(sites.areas, reach)
    wave = _waves(sites.keys, starts, neighbours)
    refused: list[int] = []
    before = _standing_near(sites.areas, reach, standing)
    placed: dict[int, Discs] = {}
    last = int(wave.max(initial=-1))
    for number in range(last + 1):
        chosen = np.flatnonzero(wave == number)
        for name in sorted(set(strategy[chosen])):
            batch = chosen[strategy[chosen] == name]
            fixed = [
                before[i]
                + [placed[j] for j in neighbours[starts[i] : starts[i + 1]] if j in placed and wave[j] < number]
                for i in batch
            ]
            found = _placed(name, _with_fixed(sites, batch, fixed), settings)
            refused.extend(batch[found.refused].tolist())
            ends = np.searchsorted(found.site, np.arange(len(batch) + 1))
            for k, i in enumerate(batch):
                span = slice(ends[k], ends[k + 1])
                placed[int(i)] = (found.xy[span], found.radius_m[span])
        progress("placing plants", number + 1, last + 1)
    order = sorted(i for i, (xy, _) in placed.items() if len(xy))
    left_out = np.array(sorted(refused), dtype=np.int64)
    if not order:
        return replace(Positions.empty(), refused=left_out)
    return Positions(
        np.repeat(np.array(order), [len(placed[i][0]) for i in order]),
        np.concatenate([placed[i][0] for i in order]),
        np.concatenate([placed[i][1] for i in order]),
        left_out,
    )


def _largest_radii(sites: Sites, settings: Placement) -> NDArray[np.float64]:
    _, high = radius_limits(sites.values["radius_mean_m"], sites.values["radius_variance_m2"], settings)
    return high


def _neighbours(
    areas: NDArray[np.object_], reach_m: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for each lot the lots whose plants may touch its own, as offsets and indices."""
    tree = shapely.STRtree(areas)
    one, other = tree.query(areas, predicate="dwithin", distance=reach_m + reach_m.max(initial=0.0))
    near = one != other
    one, other = one[near], other[near]
    near = shapely.dwithin(areas[one], areas[other], reach_m[one] + reach_m[other])
    one, other = one[near], other[near]
    order = np.lexsort((other, one))
    return np.searchsorted(one[order], np.arange(len(areas) + 1)), other[order]


def _standing_near(areas: NDArray[np.object_], reach_m: NDArray[np.float64], discs: Discs | None) -> list[list[Discs]]:
    """Return for each lot the discs that its plants may touch, of those that stand already."""
    near: list[list[Discs]] = [[] for _ in areas]
    if discs is None or not len(discs[1]):
        return near
    xy, radius_m = discs
    points = np.asarray(shapely.points(xy))
    lot, disc = shapely.STRtree(points).query(areas, predicate="dwithin", distance=reach_m + radius_m.max())
    touched = shapely.dwithin(areas[lot], points[disc], reach_m[lot] + radius_m[disc])
    lot, disc = lot[touched], disc[touched]
    order = np.lexsort((disc, lot))
    lot, disc = lot[order], disc[order]
    for span in np.split(np.arange(len(lot)), np.flatnonzero(np.diff(lot)) + 1):
        if len(span):
            near[int(lot[span[0]])].append((xy[disc[span]], radius_m[disc[span]]))
    return near


def _waves(keys: NDArray[np.uint64], starts: NDArray[np.int64], neighbours: NDArray[np.int64]) -> NDArray[np.int64]:
    wave = np.zeros(len(keys), dtype=np.int64)
    for i in np.argsort(keys, kind="stable")[::-1]:
        before = neighbours[starts[i] : starts[i + 1]]
        before = before[keys[before] > keys[i]]
        if len(before):
            wave[i] = wave[before].max() + 1
    return wave


def _with_fixed(sites: Sites, batch: NDArray[np.int64], fixed: list[list[Discs]]) -> Sites:
    discs = [disc for lot in fixed for disc in lot]
    counts = [sum(len(xy) for xy, _ in lot) for lot in fixed]
    return replace(
        sites,
        lot_ids=sites.lot_ids[batch],
        keys=sites.keys[batch],
        lots=sites.lots[batch],
        areas=sites.areas[batch],
        values={name: column[batch] for name, column in sites.values.items()},
        fixed_xy=np.concatenate([np.zeros((0, 2)), *(xy for xy, _ in discs)]),
        fixed_radius_m=np.concatenate([np.zeros(0), *(radius for _, radius in discs)]),
        fixed_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
    )


def _placed(name: str, sites: Sites, settings: Placement) -> Positions:
    return apart_from_fixed(strategy_named(name)(sites, settings), sites)
