"""Towns whose lots pairs are made on: a procedural city, plain shapes, and real lots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Config, Species
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.zones import FALLBACK_ZONE
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.files.vector_formats import split_source
from urbanforest_cli.files.vectors import list_vector_layers, read_vector
from urbanforest_cli.register.cleaning import first_look, repair
from urbanforest_cli.register.lots import clean_lots
from urbanforest_cli.regression.designs import plain_lots
from urbanforest_cli.synth.city import build_city

SYNTHETIC_LOTS, PLAIN_LOTS, REAL_LOTS_MOST = 1600, 2400, 4000
SMALLEST_LOT_M2, LONGEST_LOT_M = 60.0, 500.0
SAME_PLACE_M, SAME_AREA = 0.5, 0.02
"""Two lots whose middles are as near and whose areas are as alike are one, however often files hold it."""

Shapes = NDArray[Any]


@dataclass(frozen=True)
class Town:
    """Lots and buildings in one plane, in metres; `first` is the number of its first lot among all.

    Real ones have a CRS. Keys of pairs hang on `name`, which no other town has.
    """

    name: str
    lots: Shapes
    buildings: Shapes
    first: int
    crs: CRS | None = None


def plain_town(count: int, seed: int, design: str) -> Town:
    """Return plain lots of a design, with houses."""
    lots, houses = plain_lots(keys_for(seed, f"plain lots {design}", map(str, range(count))), design)
    return Town(design, lots, houses, 0)


def towns_of(sources: Sequence[str | Path], seed: int, notices: Notices) -> list[Town]:
    """Return a procedural city, plain lots, and the real lots asked for, their lots numbered through.

    Parameters
    ----------
    sources
        Files of real lots, ``FILE`` or ``FILE:LAYER``.
    notices
        Takes what was repaired in them, and which lots were left out.

    Raises
    ------
    InputError
        A file cannot be read, holds no lot that can be used, or none that files before it do not hold.
    """
    _refuse_repeated(sources)
    city = build_city(SYNTHETIC_LOTS, seed, load_catalogue(Species()))
    towns = [Town("synth", city.lots.shapes, city.buildings.shapes, 0)]
    towns.append(plain_town(PLAIN_LOTS, seed, "mixed"))
    for number, source in enumerate(sources, 1):
        towns.append(_real_town(str(source), number, towns, seed, notices))
    firsts = np.cumsum([0, *(len(town.lots) for town in towns)])
    return [replace(town, first=int(first)) for town, first in zip(towns, firsts, strict=False)]


def _refuse_repeated(sources: Sequence[str | Path]) -> None:
    found = [split_source(str(source)) for source in sources]
    named = [(path.resolve(), layer) for path, layer in found]
    for number, source in enumerate(sources):
        if named[number] in named[:number]:
            raise InputError("lots named twice", where=str(source), expected="each layer of lots once")


def _real_town(source: str, number: int, before: Sequence[Town], seed: int, notices: Notices) -> Town:
    """Read real lots, cleaned as for a register, without those of the towns before; of very many, some together.

    Parameters
    ----------
    number
        Which of the sources it is; files may have one name.
    """
    path, layer = split_source(source)
    name = f"{number} {path.name} {layer or ''}"
    found = Notices()  # cleaning tells causes by what it counted before, which must not be of another file
    frame = read_vector(path, layer=layer, notices=found)
    frame = gpd.GeoDataFrame(
        {"lot_id": np.arange(len(frame)), "zone": FALLBACK_ZONE}, geometry=frame.geometry.to_numpy(), crs=frame.crs
    )
    lots = clean_lots(frame, Config(), found, path)
    shapes = lots.checked.shapes[lots.checked.usable]
    west, south, east, north = shapely.bounds(shapes).T
    small = shapely.area(shapes) < SMALLEST_LOT_M2
    long = np.maximum(east - west, north - south) > LONGEST_LOT_M
    usable = shapes[~small & ~long]
    if not len(usable):
        raise InputError(
            "no lot that pairs can be made on", where=source,
            expected=f"polygons from {SMALLEST_LOT_M2:g} m2, up to {LONGEST_LOT_M:g} m long",
        )  # fmt: skip
    shapes = usable[~_there_before(usable, lots.working, before)]
    if not len(shapes):
        raise InputError("lots named twice", where=source, expected="lots that the files before it do not hold")
    once = len(shapes)
    if once > REAL_LOTS_MOST:
        middles = shapely.centroid(shapes)
        pick = int(hash_uniform(keys_for(seed, "pairs real", [name]), np.zeros(1, np.int64))[0] * len(shapes))
        near = np.argsort(shapely.distance(middles, middles[pick]), kind="stable")[:REAL_LOTS_MOST]
        shapes = shapes[np.sort(near)]
    for code, what, count in (
        ("W_PAIRS_SMALL", f"lots below {SMALLEST_LOT_M2:g} m2, left out", int(small.sum())),
        ("W_PAIRS_LONG", f"lots longer than {LONGEST_LOT_M:g} m, left out", int((long & ~small).sum())),
        ("W_PAIRS_REPEATED", "lots that were there before, left out", len(usable) - once),
        ("W_PAIRS_MANY", f"lots beyond {REAL_LOTS_MOST:,} of a layer, left out", once - len(shapes)),
    ):
        found.add(code, what, count, [source])
    houses = np.empty(0, dtype=object)
    if "buildings" in dict(list_vector_layers(path)):
        built = read_vector(path, layer="buildings", assume_crs=frame.crs, notices=found)
        checked = first_look(lots.project(built), np.arange(len(built)).astype(str), found, what="buildings")
        repair(checked, np.arange(len(built)).astype(str), found, what="buildings")
        houses = checked.shapes[checked.usable]
    notices.merge(found)
    return Town(name, shapes, houses, 0, lots.working)


def _there_before(shapes: Shapes, crs: CRS, towns: Sequence[Town]) -> NDArray[np.bool_]:
    """Tell which lots are lots of one of some towns, or come earlier among these."""
    middles, areas = np.asarray(shapely.centroid(shapes)), shapely.area(shapes)
    again = np.zeros(len(shapes), dtype=bool)

    def same_as(others: Shapes, far: Shapes, earlier: bool) -> None:
        mine, other = shapely.STRtree(far).query(middles, predicate="dwithin", distance=SAME_PLACE_M)
        alike = abs(areas[mine] - shapely.area(others[other])) <= SAME_AREA * areas[mine]
        again[mine[alike & ((other < mine) | (not earlier))]] = True

    same_as(shapes, middles, True)
    for town in towns:
        if town.crs is not None:
            theirs = reproject(town.lots, town.crs, crs)
            theirs = theirs[np.isfinite(shapely.bounds(theirs)).all(axis=1)]  # a place far away may have none here
            same_as(theirs, np.asarray(shapely.centroid(theirs)), False)
    return again
