"""Zones of lots, by district, corner and road."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.zones import ZONES
from urbanforest_cli.synth.lots import CAMPUS, ENCLAVE, GREEN, Lots
from urbanforest_cli.synth.plan import CENTRE, DENSE, GARDEN, INDUSTRIAL, PARK, SUBURB, MainRoads

_SHOP_REACH_M = 34.0
_SHOP_LEAST_M2 = 480.0
_LOTS_A_SQUARE = 20_000

#             residential commercial industrial (the rest is other)
_SHARES = {
    CENTRE: (0.16, 0.80, 0.00),
    DENSE: (0.96, 0.02, 0.00),
    SUBURB: (0.98, 0.005, 0.00),
    GARDEN: (0.985, 0.005, 0.00),
    INDUSTRIAL: (0.00, 0.08, 0.89),
    PARK: (0.00, 0.00, 0.00),
}


def zone_lots(
    lots: Lots, main_roads: MainRoads, rng: np.random.Generator, *, squares: bool = False
) -> NDArray[np.object_]:
    """Give every lot its zone; no zone is missing.

    Streets are lines of their own, so no lot is of the street zone but a few squares, where they are wanted.
    """
    count = len(lots)
    shares = np.cumsum([_SHARES[use] for use in range(len(_SHARES))], axis=1)[lots.use]
    names = np.array(["residential", "commercial", "industrial", "other"], dtype=object)
    zones = names[(rng.random(count)[:, None] >= shares).sum(axis=1)]
    middles = shapely.point_on_surface(lots.shapes)
    roomy = (zones == "residential") & (shapely.area(lots.shapes) > _SHOP_LEAST_M2)
    chance = rng.random(count)
    zones[roomy & lots.corner & (lots.use == DENSE) & (chance < 0.2)] = "commercial"
    for kind, share in (("boulevard", 0.5), ("avenue", 0.15)):
        beside = _beside(middles, main_roads.lines[main_roads.kinds == kind])
        zones[roomy & beside & (chance < share)] = "commercial"
    zones[np.isin(lots.kind, (GREEN, CAMPUS, ENCLAVE))] = "other"
    if squares:
        _make_squares(zones, lots, middles)
    _fill_missing(zones, lots, middles, [zone for zone in ZONES if squares or zone != "street"])
    return np.asarray(zones)


def _beside(points: NDArray[Any], lines: NDArray[Any]) -> NDArray[np.bool_]:
    found = np.zeros(len(points), dtype=np.bool_)
    if len(lines):
        found[shapely.STRtree(points).query(lines, predicate="dwithin", distance=_SHOP_REACH_M)[1]] = True
    return found


def _make_squares(zones: NDArray[np.object_], lots: Lots, middles: NDArray[Any]) -> None:
    count = 1 + len(lots) // _LOTS_A_SQUARE
    candidates = np.flatnonzero((zones == "commercial") & lots.corner & ~lots.cut)
    nearest = np.argsort(_from_centre(middles[candidates]), kind="stable")
    chosen = candidates[nearest]
    taken: set[int] = set()
    for index in chosen:
        if len(taken) == count:
            break
        if int(lots.block[index]) not in taken:
            taken.add(int(lots.block[index]))
            zones[index] = "street"


def _fill_missing(zones: NDArray[np.object_], lots: Lots, middles: NDArray[Any], wanted: list[str]) -> None:
    """Turn one lot of the commonest zone into each zone that is missing: the largest, but shops near the centre."""
    area = shapely.area(lots.shapes)
    for zone in wanted:
        if len(lots) < len(wanted) or (zones == zone).any():
            continue
        names, counts = np.unique(zones.astype(str), return_counts=True)
        candidates = np.flatnonzero(zones == names[np.argmax(counts)])
        score = _from_centre(middles[candidates]) if zone in ("commercial", "street") else -area[candidates]
        zones[candidates[np.argmin(score)]] = zone


def _from_centre(points: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(np.hypot(shapely.get_x(points), shapely.get_y(points)))
