"""Roofs: hipped, gabled or flat, of shingles, tiles, metal or membrane, after what stands beneath them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.grounds import HOME, SHOP, USE, WORKS, Grounds
from urbanforest_cli.synth.picture.looks import MEMBRANE, METAL, ROOFS, SHINGLE, TILE
from urbanforest_cli.synth.picture.relief_kernel import FLAT, GABLE, HIP
from urbanforest_cli.synth.plan import Floats

_SMALL_M2, _LARGE_M2 = 40.0, 330.0
_PITCH = (0.28, 0.55)
_LOW_PITCH = 0.12
_EAVE_LEAST_M = 2.2


@dataclass(frozen=True)
class Roofs:
    """A roof a building."""

    edges: Floats  # (edges, 6) start x, y, unit inward normal x, y, length, whether the roof rises from it
    edge_ends: NDArray[np.int64]  # (buildings,)
    form: NDArray[np.int64]
    sort: NDArray[np.int64]
    colour: Floats  # (buildings, 4)
    eave_m: Floats
    pitch: Floats
    salt: NDArray[np.int64]
    area_m2: Floats

    def patterns(self) -> Floats:
        """Return (buildings, 10) colour, sort, salt, and a corner and the direction of a wall, x and y."""
        first = self.edges[np.append(0, self.edge_ends[:-1])[: len(self.form)]]
        return np.column_stack((self.colour, self.sort, self.salt, first[:, 0], first[:, 1], first[:, 3], -first[:, 2]))

    def top_m(self) -> float:
        """Return a height that nothing built exceeds."""
        return float(np.max(self.eave_m, initial=0.0) + 15.0)


def lay_roofs(buildings: Buildings, grounds: Grounds, seed: int) -> Roofs:
    """Choose a roof for each building."""
    count = len(buildings.shapes)
    draw = Draws(seed, "building", count)
    area = np.asarray(shapely.area(buildings.shapes))
    half_m = 2 * area / np.maximum(shapely.length(buildings.shapes), 1e-6)
    use = grounds.table[buildings.lot, USE]
    chance, kind = draw.uniform("form"), draw.uniform("sort")
    box = shapely.get_num_coordinates(buildings.shapes) == 5
    low = buildings.heights_m < 11.5
    home = (use == HOME) & low & (area < _LARGE_M2)
    form = np.where(chance < 0.5, HIP, np.where((chance < 0.76) & box, GABLE, FLAT))
    form = np.where((chance >= 0.5) & ~box & (chance < 0.86), HIP, form)
    form[~home] = np.where((use[~home] == HOME) & low[~home] & (chance[~home] < 0.5), HIP, FLAT)
    works = use == WORKS
    form[works & box & (chance < 0.6)] = GABLE
    form[area < _SMALL_M2] = np.where(chance[area < _SMALL_M2] < 0.5, GABLE, FLAT)
    form[(form == GABLE) & ~box] = HIP
    sort = np.where(form == FLAT, MEMBRANE, np.where(kind < 0.8, SHINGLE, TILE))
    sort[works & (form == GABLE)] = METAL
    sort[works & (form == FLAT) & (kind < 0.3)] = METAL
    sort[(use == SHOP) & (form != FLAT)] = TILE
    pitch = draw.uniform("pitch", *_PITCH)
    pitch[works] = _LOW_PITCH
    pitch[form == FLAT] = 0.0
    colour = np.empty((count, 4))
    for number, colours in ROOFS.items():
        mine = sort == number
        colour[mine] = colours[draw.pick("colour", len(colours))[mine]]
    colour *= draw.uniform("shade", 0.9, 1.08)[:, None]
    eave_m = np.maximum(buildings.heights_m - pitch * half_m, np.minimum(_EAVE_LEAST_M, buildings.heights_m))
    edges, edge_ends = _edges(buildings, form)
    return Roofs(edges, edge_ends, form, sort, colour, eave_m, pitch, draw.pick("salt", 1 << 20), area)


def _edges(buildings: Buildings, form: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """List the walls; from the two shorter ones of a gabled box no roof rises."""
    rings, of = shapely.get_rings(shapely.orient_polygons(buildings.shapes), return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    start, end, building = xy[:-1][same], xy[1:][same], of[ring[:-1][same]]
    length = np.hypot(*(end - start).T)
    along = (end - start) / np.maximum(length, 1e-9)[:, None]
    longest = np.zeros(len(buildings.shapes))
    np.maximum.at(longest, building, length)
    rises = (form[building] != GABLE) | (length > 0.999 * longest[building])
    first = np.flatnonzero(form == GABLE)
    opposite = _longer_pairs(first, building, length)
    rises[opposite] = True
    edges = np.column_stack((start, -along[:, 1], along[:, 0], length, rises))
    return edges, np.cumsum(np.bincount(building, minlength=len(buildings.shapes)))


def _longer_pairs(gabled: NDArray[np.int64], building: NDArray[np.int64], length: Floats) -> NDArray[np.int64]:
    """Return the two longer edges of each gabled box, whose four lie one after the other."""
    start = np.searchsorted(building, gabled)
    pair = np.where(length[start] + length[start + 2] >= length[start + 1] + length[start + 3], 0, 1)
    return np.concatenate((start + pair, start + pair + 2))
