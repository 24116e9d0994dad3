"""Grounds of lots: lawns, yards, patios and parking places, each lot after its zone and its owner's habits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.lots import CAMPUS, ENCLAVE, GREEN, Lots
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.looks import ASPHALT, CONCRETE, GRAVEL, LAWN, PAVERS, SOIL
from urbanforest_cli.synth.plan import CENTRE, DENSE, GARDEN, PARK, Floats

HOME, SHOP, WORKS, GREENS, SCHOOL, YARD, SQUARE = range(7)
"""What a lot is used as."""

(
    X, Y, ALONG_X, ALONG_Y, WIDTH, DEPTH, LEFT, RIGHT, FRONT, BACK, FRONT_GROUND, BACK_GROUND, SIDE_GROUND, FRONT_LUSH,
    BACK_LUSH, PATIO_DEPTH, PATIO_LEFT, PATIO_RIGHT, PATH_X, TONE, USE, SALT,
) = range(22)  # fmt: skip
"""Columns of the table of lots: its frame, its house in that frame, and what lies before, behind and beside it."""


@dataclass(frozen=True)
class Grounds:
    """The table of lots; lengths in metres in each lot's frame, x along the street and y away from it."""

    table: Floats  # (lots, 22)

    def places(self, lot: NDArray[np.int64], x: Floats, y: Floats) -> Floats:
        """Return (n, 2) map places of places in the frames of lots."""
        row = self.table[lot]
        ux, uy = row[:, ALONG_X], row[:, ALONG_Y]
        return np.column_stack((row[:, X] + x * ux - y * uy, row[:, Y] + x * uy + y * ux))


def lay_grounds(lots: Lots, zones: NDArray[np.object_], buildings: Buildings, seed: int) -> Grounds:
    """Choose what covers each lot."""
    count = len(lots)
    draw = Draws(seed, "lot", count)
    table = np.zeros((count, 22))
    along = lots.site[:, 1] - lots.site[:, 0]
    width = np.maximum(np.hypot(*along.T), 1e-6)
    along = along / width[:, None]
    inward = np.column_stack((-along[:, 1], along[:, 0]))
    table[:, [X, Y]] = lots.site[:, 0]
    table[:, [ALONG_X, ALONG_Y]] = along
    table[:, WIDTH] = width
    table[:, DEPTH] = np.sum((lots.site[:, 3] - lots.site[:, 0]) * inward, axis=1)
    table[:, [LEFT, RIGHT, FRONT, BACK]] = _house_extents(lots, buildings, along, inward)
    table[:, USE] = use = _uses(lots, zones)
    table[:, TONE] = draw.uniform("tone", 0.9, 1.1)
    table[:, SALT] = draw.pick("salt", 1 << 20)
    _choose(table, lots, use, draw)
    return Grounds(table)


def _house_extents(lots: Lots, buildings: Buildings, along: Floats, inward: Floats) -> Floats:
    """Return least and greatest x and y of each lot's first, its main, building; an empty one before the lot."""
    out = np.tile([0.0, 0.0, -1.0, -1.0], (len(lots), 1))
    lot, first = np.unique(buildings.lot, return_index=True)
    for column, axis in ((0, along), (2, inward)):
        xy, index = shapely.get_coordinates(buildings.shapes[first], return_index=True)
        place = np.sum((xy - lots.site[lot[index], 0]) * axis[lot[index]], axis=1)
        starts = np.flatnonzero(np.append(True, index[1:] != index[:-1])[: len(index)])
        if len(starts):
            out[lot, column] = np.minimum.reduceat(place, starts)
            out[lot, column + 1] = np.maximum.reduceat(place, starts)
    return out


def _uses(lots: Lots, zones: NDArray[np.object_]) -> Floats:
    use = np.full(len(lots), HOME, dtype=np.float64)
    use[zones == "commercial"] = SHOP
    use[zones == "industrial"] = WORKS
    use[zones == "other"] = GREENS
    use[zones == "street"] = SQUARE
    use[lots.kind == CAMPUS] = SCHOOL
    use[lots.kind == ENCLAVE] = YARD
    use[(lots.kind == GREEN) | (lots.use == PARK)] = GREENS
    return use


def _choose(table: Floats, lots: Lots, use: Floats, draw: Draws) -> None:
    """Fill the columns of grounds, patios and paths."""

    def among(name: str, grounds: tuple[int, ...], shares: tuple[float, ...]) -> NDArray[np.int64]:
        return np.array(grounds)[np.searchsorted(np.cumsum(shares[:-1]), draw.uniform(name), side="right")]

    watered = draw.uniform("watered")
    watered = np.where(lots.use == GARDEN, watered**0.6, watered)
    table[:, FRONT_LUSH] = 0.02 + 0.96 * watered
    table[:, BACK_LUSH] = np.clip(0.75 * watered + 0.3 * draw.uniform("behind") - 0.05, 0, 1)
    front = among("front", (LAWN, SOIL, GRAVEL, PAVERS, CONCRETE), (0.72, 0.09, 0.06, 0.04, 0.09))
    back = among("back", (LAWN, SOIL, GRAVEL, PAVERS, CONCRETE), (0.58, 0.17, 0.07, 0.06, 0.12))
    side = among("side", (CONCRETE, SOIL, LAWN, GRAVEL), (0.42, 0.24, 0.22, 0.12))
    tight = np.isin(lots.use, (DENSE, CENTRE)) & (use == HOME)
    paved = draw.uniform("paved")
    front[tight & (paved < 0.35)], back[tight & (paved < 0.3)] = CONCRETE, CONCRETE
    shop, works = use == SHOP, use == WORKS
    front[shop] = side[shop] = back[shop] = np.where(paved[shop] < 0.72, ASPHALT, CONCRETE)
    front[works] = side[works] = back[works] = np.where(paved[works] < 0.55, ASPHALT, CONCRETE)
    back[works & (draw.uniform("storage") < 0.4)] = SOIL
    greens, school = use == GREENS, use == SCHOOL
    front[greens] = side[greens] = back[greens] = LAWN
    table[greens, BACK_LUSH] = table[greens, FRONT_LUSH] = 0.42 + 0.4 * watered[greens]
    front[school], side[school], back[school] = ASPHALT, ASPHALT, LAWN
    table[school, BACK_LUSH] = 0.6 + 0.3 * watered[school]
    front[use == YARD] = side[use == YARD] = back[use == YARD] = GRAVEL
    front[use == SQUARE] = side[use == SQUARE] = back[use == SQUARE] = PAVERS
    table[:, FRONT_GROUND], table[:, BACK_GROUND], table[:, SIDE_GROUND] = front, back, side
    house_m = table[:, RIGHT] - table[:, LEFT]
    has_patio = (use == HOME) & (house_m > 3) & (draw.uniform("patio") < 0.75)
    table[:, PATIO_DEPTH] = np.where(has_patio, draw.uniform("patio depth", 1.8, 4.6), 0.0)
    table[:, PATIO_LEFT] = table[:, LEFT] + house_m * draw.uniform("patio left", 0.0, 0.4)
    table[:, PATIO_RIGHT] = table[:, RIGHT] - house_m * draw.uniform("patio right", 0.0, 0.4)
    has_path = (house_m > 3) & np.isin(use, (HOME, SCHOOL))
    table[:, PATH_X] = np.where(has_path, table[:, LEFT] + house_m * draw.uniform("door", 0.45, 0.65), -1e3)
