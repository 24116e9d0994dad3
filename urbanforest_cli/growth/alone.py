"""One plant grown by itself, or beside walls and a few neighbours, without any city.

The plant stands at (0, 0). Directions are those of a compass: 0 north, 90 east, clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import Skeletons, quantise
from urbanforest_cli.core.species import Catalogue, Species
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.growth.accounts import Accounts
from urbanforest_cli.growth.grove import LONGEST_SEASONS, Grove
from urbanforest_cli.growth.groves import row_azimuth
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

WALL_LENGTH_M, WALL_THICKNESS_M = 20.0, 1.0
NEAREST_WALL_M, NEAREST_NEIGHBOUR_M = 0.3, 0.1
FARTHEST_M = 60.0
HIGHEST_M = 200.0
NEIGHBOURS_MAX = 24
THE_PLANT = "one"


@dataclass(frozen=True)
class Wall:
    """A wall that faces the plant: the distance and direction of the middle of its face, and its height.

    It is 20 m long and 1 m thick, square to its direction.
    """

    distance_m: float
    azimuth_deg: float
    height_m: float | None = None

    def footprint(self) -> shapely.Polygon:
        """Return its outline on the ground, the plant at (0, 0)."""
        half = WALL_LENGTH_M / 2
        across, along = compass(1.0, self.azimuth_deg), compass(1.0, self.azimuth_deg + 90)
        near, far = self.distance_m * across, (self.distance_m + WALL_THICKNESS_M) * across
        return shapely.Polygon([near - half * along, near + half * along, far + half * along, far - half * along])

    def text(self) -> str:
        """Return it as one writes it on the command line."""
        height = f"x{self.height_m:g}" if self.height_m is not None else ""
        return f"{self.distance_m:g}@{self.azimuth_deg:g}{height}"


@dataclass(frozen=True)
class Neighbour:
    """A plant beside the plant; as old as it where no age is told."""

    species: str
    distance_m: float
    azimuth_deg: float
    age_years: float | None = None

    def text(self) -> str:
        """Return it as one writes it on the command line."""
        age = f",{self.age_years:g}" if self.age_years is not None else ""
        return f"{self.species}@{self.distance_m:g},{self.azimuth_deg:g}{age}"


@dataclass(frozen=True)
class Company:
    """A plant, what grew beside it, and what became of them; the plant itself comes first.

    Parameters
    ----------
    names
        (n,) `THE_PLANT`, then neighbour-1, neighbour-2 and so on.
    species, age_years, xy_m
        (n,), (n,), (n, 2) kinds, ages and places.
    skeletons, accounts
        One a plant, in the same order.
    walls, wall_height_m
        (w,) outlines and heights.
    """

    names: tuple[str, ...]
    species: tuple[Species, ...]
    age_years: NDArray[np.float64]
    xy_m: NDArray[np.float64]
    skeletons: Skeletons
    accounts: Accounts
    walls: NDArray[np.object_]
    wall_height_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.names)


def compass(distance_m: float, azimuth_deg: float) -> NDArray[np.float64]:
    """Return (2,) east and north of what lies at a distance in a direction."""
    angle = math.radians(azimuth_deg)
    return distance_m * np.array([math.sin(angle), math.cos(angle)])


def species_named(catalogue: Catalogue, name: str) -> Species:
    """Return the species of an id, a scientific or a common name, whatever its capitals.

    Raises
    ------
    InputError
        There is none; the text names those that are much alike.
    """
    known = {text.casefold(): kind for kind in catalogue for text in (kind.common_name, kind.scientific_name, kind.id)}
    wanted = name.strip().casefold()
    if wanted in known:
        return known[wanted]
    near = [kind.id for text, kind in known.items() if wanted and wanted in text]
    near += [known[text].id for text in get_close_matches(wanted, known, n=3, cutoff=0.55)]
    raise InputError(
        f"no species {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""),
        expected="one of " + ", ".join(catalogue.ids),
        next_step="name one of these, or a folder with species of your own with --set species.folder=FOLDER",
    )


def grow_alone(
    catalogue: Catalogue,
    species: str,
    age_years: float,
    *,
    growth: Growth,
    walls: Sequence[Wall] = (),
    neighbours: Sequence[Neighbour] = (),
    pruning_factor: float = 1.0,
    latitude_deg: float = 48.0,
    seed: int = 0,
) -> Company:
    """Grow one plant to an age, jointly with its neighbours, beside walls.

    All plants reach their ages in the same last season.

    Parameters
    ----------
    catalogue
        The species there are.
    growth
        Environment, bud fate, pruning, and the height of walls that tell none.
    pruning_factor
        Of all plants; along a row they are cut as one.
    latitude_deg
        Where the sun's path is taken.

    Raises
    ------
    InputError
        A species is not known, an age or a place is outside what can be grown.
    """
    kinds = [species_named(catalogue, name) for name in (species, *(item.species for item in neighbours))]
    ages = np.array([age_years, *(age_years if n.age_years is None else n.age_years for n in neighbours)], float)
    xy = np.array([compass(0.0, 0.0), *(compass(n.distance_m, n.azimuth_deg) for n in neighbours)])
    shapes = np.array([wall.footprint() for wall in walls], dtype=object)
    heights = np.array(
        [growth.building_height_m if wall.height_m is None else wall.height_m for wall in walls], dtype=np.float64
    )
    _check(ages, walls, neighbours, xy, shapes, pruning_factor, latitude_deg)
    names = (THE_PLANT, *(f"neighbour-{number}" for number in range(1, len(kinds))))
    rows = np.array([catalogue.index_of(kind.id) for kind in kinds], dtype=np.int64)
    keys = keys_for(seed, "grow", names)
    factor = np.full(len(kinds), float(pruning_factor))
    light = light_from(latitude_deg, growth.sun_share)
    plants = Plants(keys, xy, rows, ages, factor)
    site = Site(plants, [kind.open_grown for kind in catalogue], shapes, heights, light, growth)
    azimuth = row_azimuth(xy, np.zeros(len(kinds), dtype=np.int64)) if pruning_factor < 1 else np.zeros(len(kinds))
    grove = Grove(keys, xy, rows, ages, factor, np.zeros(len(kinds)), azimuth)
    grown = grow_grove(
        grove, site.around(np.arange(len(kinds))), traits_table([kind.growth for kind in catalogue]), growth
    )
    skeletons = quantise(replace(grown.skeletons, skeleton_id=np.arange(len(kinds), dtype=np.int64)))
    return Company(names, tuple(kinds), ages, xy, skeletons, Accounts.of(grown, skeletons), shapes, heights)


def _check(
    ages: NDArray[np.float64],
    walls: Sequence[Wall],
    neighbours: Sequence[Neighbour],
    xy: NDArray[np.float64],
    shapes: NDArray[np.object_],
    pruning_factor: float,
    latitude_deg: float,
) -> None:
    """Refuse what cannot be grown."""
    for wall in walls:
        _within("distance of a wall, m", wall.distance_m, NEAREST_WALL_M, FARTHEST_M, f"--wall {wall.text()}")
        _within("direction, degrees", wall.azimuth_deg, -360, 360, f"--wall {wall.text()}")
        if wall.height_m is not None:
            _within("height of a wall, m", wall.height_m, 0.1, HIGHEST_M, f"--wall {wall.text()}")
    for neighbour in neighbours:
        where = f"--neighbour {neighbour.text()}"
        _within("distance of a neighbour, m", neighbour.distance_m, NEAREST_NEIGHBOUR_M, FARTHEST_M, where)
        _within("direction, degrees", neighbour.azimuth_deg, -360, 360, where)
    for age, where in zip(ages.tolist(), ("--age", *(f"--neighbour {n.text()}" for n in neighbours)), strict=True):
        _within("age, years", age, 0, LONGEST_SEASONS, where)
    _within("number of neighbours", len(neighbours), 0, NEIGHBOURS_MAX, "--neighbour")
    _within("pruning factor", pruning_factor, 0, 1, "--pruning")
    _within("latitude, degrees", latitude_deg, -90, 90, "--latitude")
    for shape in shapes:
        for place, who in zip(xy, ("the plant", *(n.text() for n in neighbours)), strict=True):
            if shapely.intersects_xy(shape, *place):
                raise InputError(f"{who} would stand in a wall", where="--wall", next_step="move one of them")


def _within(what: str, value: float, low: float, high: float, where: str) -> None:
    if not low <= value <= high:
        raise InputError(f"{what}: out of range", where=where, found=f"{value:g}", expected=f"{low:g} to {high:g}")
