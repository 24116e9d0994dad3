"""Plants that keep apart across lot borders (config ``placement.conflict = "city"``)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.placement.radii import radius_limits
from urbanforest_cli.placement.sites import Positions, Sites
from urbanforest_cli.placement.strategies import strategy_named


def place_in_waves(
    sites: Sites, strategy: NDArray[np.object_], settings: Placement, progress: Progress = silent
) -> Positions:
    """Place lots so that no plant overlaps one of another lot.

    Of two lots near enough to touch, the one whose stream key is larger comes first and the other keeps clear of
    its plants. Lots that wait for nobody make the first wave, those that wait only for them the second, and so on:
    the result depends on the keys alone, not on the order of rows.

    Parameters
    ----------
    strategy
        (n,) name of each lot's strategy.

    Returns
    -------
    Positions, lot indices non-decreasing.
    """
    reach = _largest_radii(sites, settings)
    starts, neighbours = _neighbours(sites.areas, reach)
    wave = _waves(sites.keys, starts, neighbours)
    refused: list[int] = []
    placed: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    last = int(wave.max(initial=-1))
    for number in range(last + 1):
        chosen = np.flatnonzero(wave == number)
        for name in sorted(set(strategy[chosen])):
            batch = chosen[strategy[chosen] == name]
            fixed = [
                [placed[j] for j in neighbours[starts[i] : starts[i + 1]] if j in placed and wave[j] < number]
                for i in batch
            ]
            found = _apart_from_fixed(strategy_named(name), _with_fixed(sites, batch, fixed), settings)
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


def _waves(keys: NDArray[np.uint64], starts: NDArray[np.int64], neighbours: NDArray[np.int64]) -> NDArray[np.int64]:
    wave = np.zeros(len(keys), dtype=np.int64)
    for i in np.argsort(keys, kind="stable")[::-1]:
        before = neighbours[starts[i] : starts[i + 1]]
        before = before[keys[before] > keys[i]]
        if len(before):
            wave[i] = wave[before].max() + 1
    return wave


def _with_fixed(
    sites: Sites, batch: NDArray[np.int64], fixed: list[list[tuple[NDArray[np.float64], NDArray[np.float64]]]]
) -> Sites:
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


def _apart_from_fixed(strategy: object, sites: Sites, settings: Placement) -> Positions:
    found: Positions = strategy(sites, settings)  # type: ignore[operator]
    assert sites.fixed_offsets is not None
    assert sites.fixed_xy is not None
    assert sites.fixed_radius_m is not None
    keep = np.ones(len(found.site), dtype=bool)
    for row, (i, xy, radius) in enumerate(zip(found.site, found.xy, found.radius_m, strict=True)):
        span = slice(sites.fixed_offsets[i], sites.fixed_offsets[i + 1])
        apart = np.hypot(*(sites.fixed_xy[span] - xy).T)
        keep[row] = bool(np.all(apart >= sites.fixed_radius_m[span] + radius))
    return Positions(found.site[keep], found.xy[keep], found.radius_m[keep], found.refused)
