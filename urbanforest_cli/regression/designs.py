"""Which lots and parameters pairs are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.schema import REGRESSED

Shapes = NDArray[Any]
Keys = NDArray[np.uint64]

SIDES_M = {"S": (10.0, 60.0), "P": (60.0, 100.0), "mixed": (10.0, 128.0)}
"""Shortest and longest side of a plain lot: the two test designs, and what training draws from."""
DENSITY_LEAST = 0.05
WITH_BUILDING = 0.7
CLEARANCE_MOST_M = 6.0
ADJOINING = 0.6
_PLOT_M = 420.0


@dataclass(frozen=True)
class Drawn:
    """What is drawn for each pair.

    Parameters
    ----------
    strategy
        (n,) int8 index into `STRATEGIES_READ`, all equally likely.
    values
        (n, 6) in the order of `REGRESSED`, uniform over the ranges of the paper's table 1, the density from 0.05; a
        number of clusters is whole.
    with_building
        (n,) whether buildings stand on the lot, as they do on 70 %.
    clearance_m
        (n,) distance that plants keep from them, uniform from 0 to 6 m.
    """

    strategy: NDArray[np.int8]
    values: NDArray[np.float64]
    with_building: NDArray[np.bool_]
    clearance_m: NDArray[np.float64]


def draw_pairs(keys: Keys) -> Drawn:
    """Draw strategy and parameters of pairs, each from its key."""
    strategy = np.floor(len(STRATEGIES_READ) * _uniform(keys, 0)).astype(np.int8)
    values = np.empty((len(keys), len(REGRESSED)))
    for column, name in enumerate(REGRESSED):
        parameter = PARAMETERS[name]
        low = DENSITY_LEAST if name == "density" else parameter.low
        share = _uniform(keys, 1 + column)
        if parameter.kind == "count":
            values[:, column] = low + np.floor(share * (parameter.high - low + 1))
        else:
            values[:, column] = low + share * (parameter.high - low)
    return Drawn(strategy, values, _uniform(keys, 20) < WITH_BUILDING, CLEARANCE_MOST_M * _uniform(keys, 21))


def used_by(strategy: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Tell which parameters strategies use, (n, 6) in the order of `REGRESSED`."""
    uses = np.array([[name in PARAMETERS[item].strategies for item in REGRESSED] for name in STRATEGIES_READ])
    return np.asarray(uses[strategy])


def plain_lots(keys: Keys, design: str) -> tuple[Shapes, Shapes]:
    """Return rectangles and L-shapes, half of each, and a building on each of them.

    The lots of the test designs S (10 to 60 m) and P (60 to 100 m) lie apart and on the axes. Those of ``mixed`` are
    turned, and of three fifths of the pairs of lots the two adjoin.
    """
    count = len(keys)
    low, high = SIDES_M[design]
    if design == "mixed":  # as many lots of 10 to 40 m as of 40 to 128 m
        share = _uniform(keys, 30)
        longest = np.where(share < 0.5, low + 2 * share * (40 - low), 40 + (2 * share - 1) * (high - 40))
        wide, deep = longest, longest * (0.4 + 0.6 * _uniform(keys, 31))
        wide, deep = np.where(_uniform(keys, 39) < 0.5, (wide, deep), (deep, wide))
        deep = np.maximum(deep, low)
        wide = np.maximum(wide, low)
    else:
        wide, deep = (low + _uniform(keys, index) * (high - low) for index in (30, 31))
    boxes = shapely.box(np.zeros(count), np.zeros(count), wide, deep)
    cut_wide, cut_deep = wide * (0.3 + 0.3 * _uniform(keys, 32)), deep * (0.3 + 0.3 * _uniform(keys, 33))
    corner = np.floor(4 * _uniform(keys, 34))
    west, south = corner % 2 == 0, corner < 2
    cut = shapely.box(
        np.where(west, -1.0, wide - cut_wide),
        np.where(south, -1.0, deep - cut_deep),
        np.where(west, cut_wide, wide + 1.0),
        np.where(south, cut_deep, deep + 1.0),
    )
    ells = shapely.difference(boxes, cut)
    lots = np.where(_uniform(keys, 35) < 0.5, ells, boxes)
    house_wide, house_deep = wide * (0.25 + 0.3 * _uniform(keys, 36)), deep * (0.25 + 0.3 * _uniform(keys, 37))
    place = _uniform(keys, 38)
    x, y = place * (wide - house_wide), np.mod(7.31 * place, 1.0) * (deep - house_deep)
    houses = shapely.intersection(lots, shapely.box(x, y, x + house_wide, y + house_deep))
    number = np.arange(count)
    if design != "mixed":
        return _moved(lots, _PLOT_M * number, 0 * number), _moved(houses, _PLOT_M * number, 0 * number)
    first = number - number % 2
    second = (number % 2 == 1) & (_uniform(keys, 40) < ADJOINING)
    east = np.where(second, wide[first], np.where(number % 2 == 1, _PLOT_M / 2, 0.0))
    turn = 2 * np.pi * _uniform(keys, 41)[first]
    plot = _PLOT_M * (first // 2)
    return tuple(_turned(_moved(shapes, east, 0 * number), turn, plot) for shapes in (lots, houses))  # type: ignore[return-value]


def _uniform(keys: Keys, index: int) -> NDArray[np.float64]:
    return hash_uniform(keys ^ np.uint64(0x9A17), np.full(len(keys), index))


def _moved(shapes: Shapes, east: NDArray[Any], north: NDArray[Any]) -> Shapes:
    xy, owner = shapely.get_coordinates(shapes, return_index=True)
    moved = np.array(shapes, dtype=object)
    return np.asarray(shapely.set_coordinates(moved, xy + np.column_stack((east[owner], north[owner]))))


def _turned(shapes: Shapes, turn: NDArray[np.float64], east: NDArray[Any]) -> Shapes:
    """Return shapes turned about the origin and moved to the east."""
    xy, owner = shapely.get_coordinates(shapes, return_index=True)
    cos, sin = np.cos(turn[owner]), np.sin(turn[owner])
    x, y = xy.T
    turned = np.column_stack((cos * x - sin * y + east[owner], sin * x + cos * y))
    return np.asarray(shapely.set_coordinates(np.array(shapes, dtype=object), turned))
