"""Crowns to compare with a map: those that were placed, and two sets that know less."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import keys_for, rng_from_key
from urbanforest_cli.evaluation.references import uniform_points
from urbanforest_cli.evaluation.results import PlantsOfLots

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PLACED, RULES, SHUFFLED, RANDOM = "placed", "rules only", "shuffled", "random"
GROUP_LOTS = 10
"""Lots of similar size among which plants change places."""


@dataclass(frozen=True)
class CrownsOfLots:
    """Plants and their radii (n,) in metres, 0 where nothing stands."""

    plants: PlantsOfLots
    radius_m: Floats

    @classmethod
    def none(cls) -> CrownsOfLots:
        """Return a set without plants."""
        return cls(PlantsOfLots(np.zeros((0, 2)), np.zeros(0, dtype=np.int64)), np.zeros(0))


def shuffled_crowns(
    crowns: CrownsOfLots, lots: NDArray[np.object_], ids: NDArray[np.object_], seed: int
) -> CrownsOfLots:
    """Give every lot the crowns of another of similar size.

    Lots are sorted by area and taken ten by ten; within these every lot gets the plants of the next in a drawn order.
    Places are carried over by the lots' bounding boxes; a plant that falls out of its new lot is set at random in it.

    Parameters
    ----------
    lots, ids
        (lots,) polygons in metres, and names, which key the random streams.
    """
    giver = _givers(shapely.area(lots), keys_for(seed, "evaluate shuffle", ids.astype(str)))
    bounds = shapely.bounds(lots)
    order, starts = _by_lot(crowns.plants.lot, len(lots))
    lengths = np.diff(starts)[giver]
    lot = np.repeat(np.arange(len(lots)), lengths)
    if not len(lot):
        return CrownsOfLots.none()
    rows = order[np.repeat(starts[giver] - np.r_[0, np.cumsum(lengths)[:-1]], lengths) + np.arange(len(lot))]
    old, new = bounds[giver][lot], bounds[lot]
    extent = np.maximum(old[:, 2:] - old[:, :2], 1e-9)
    xy = new[:, :2] + (crowns.plants.xy[rows] - old[:, :2]) / extent * (new[:, 2:] - new[:, :2])
    lost = np.flatnonzero(~shapely.contains_xy(lots[lot], xy[:, 0], xy[:, 1]))
    xy[lost] = _anywhere(lots, lot[lost], ids, "evaluate shuffle places", seed)
    return CrownsOfLots(PlantsOfLots(xy, lot), crowns.radius_m[rows])


def random_crowns(
    crowns: CrownsOfLots, ground: NDArray[np.object_], ids: NDArray[np.object_], seed: int
) -> CrownsOfLots:
    """Set as many crowns of the same radii anywhere in each lot's open ground.

    Parameters
    ----------
    ground
        (lots,) polygons in metres; none of them is empty.
    """
    order = np.argsort(crowns.plants.lot, kind="stable")
    lot = crowns.plants.lot[order]
    xy = _anywhere(ground, lot, ids, "evaluate random places", seed)
    return CrownsOfLots(PlantsOfLots(xy, lot), crowns.radius_m[order])


def _givers(area_m2: Floats, keys: NDArray[np.uint64]) -> Ints:
    """Return for each lot whose plants it gets; itself only where it is the one lot there is."""
    count = len(area_m2)
    ranked = np.lexsort((keys, area_m2))
    group = np.minimum(np.arange(count) // GROUP_LOTS, max(count // GROUP_LOTS - 1, 0))  # no small group at the end
    drawn = ranked[np.lexsort((keys[ranked], group))]
    first, last = np.searchsorted(group, group), np.searchsorted(group, group, side="right") - 1
    place = np.arange(count)
    giver = np.empty(count, dtype=np.int64)
    giver[drawn] = drawn[np.where(place == last, first, place + 1)]
    return giver


def _by_lot(lot: Ints, lots: int) -> tuple[Ints, Ints]:
    order = np.argsort(lot, kind="stable")
    return order, np.r_[0, np.cumsum(np.bincount(lot, minlength=lots))]


def _anywhere(ground: NDArray[np.object_], lot: Ints, ids: NDArray[np.object_], stream: str, seed: int) -> Floats:
    """Draw a place for each plant in its lot's ground; `lot` is sorted."""
    xy = np.zeros((len(lot), 2))
    numbers, starts, counts = np.unique(lot, return_index=True, return_counts=True)
    keys = keys_for(seed, stream, ids[numbers].astype(str))
    for number, key, start, count in zip(numbers, keys, starts, counts, strict=True):
        xy[start : start + count] = uniform_points(ground[number], int(count), rng_from_key(int(key)))
    return xy
