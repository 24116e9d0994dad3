"""Small scenes of growth: some plants, some walls, the light of a place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth, Species
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import select, standing
from urbanforest_cli.core.traits import OpenGrown, traits_table
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.grove import Grove, GrownGrove, Surroundings, TraitsTable
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

NAMES = (
    "tilia_cordata", "acer_platanoides", "quercus_rubra", "corylus_avellana", "ligustrum_vulgare", "cornus_sanguinea",
)  # fmt: skip
LIME, MAPLE, OAK, HAZEL, PRIVET, DOGWOOD = range(6)


@cache
def _species() -> tuple[TraitsTable, list[OpenGrown]]:
    catalogue = load_catalogue(Species())
    found = {species.id: species for species in catalogue}
    kinds = [found[name] for name in NAMES]
    return traits_table([kind.growth for kind in kinds]), [kind.open_grown for kind in kinds]


def traits(**changes: float) -> TraitsTable:
    """Return the traits of NAMES, some of them changed in all species."""
    table = _species()[0].copy()
    for name, value in changes.items():
        table[name] = value
    return table


@dataclass(frozen=True)
class Scene:
    """Plants of one grove or several, walls and light; `grove_of` says which plants grow together (all by default)."""

    xy_m: NDArray[np.float64]
    species: NDArray[np.int64]
    age_years: NDArray[np.float64]
    keys: NDArray[np.uint64]
    pruning_factor: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    row_azimuth_rad: NDArray[np.float64]
    buildings: tuple[Any, ...] = ()
    height_m: float = 12.0
    latitude_deg: float = 50.0
    config: Growth = field(default_factory=Growth)

    def site(self) -> Site:
        plants = Plants(self.keys, self.xy_m, self.species, self.age_years, self.pruning_factor)
        light = light_from(self.latitude_deg, self.config.sun_share)
        shapes = np.array(self.buildings, dtype=object)
        return Site(plants, _species()[1], shapes, np.full(len(shapes), self.height_m), light, self.config)

    def grove(self, rows: Sequence[int] | None = None) -> Grove:
        index = np.arange(len(self.keys)) if rows is None else np.asarray(rows)
        return Grove(
            self.keys[index], self.xy_m[index], self.species[index], self.age_years[index], self.pruning_factor[index],
            self.clearance_m[index], self.row_azimuth_rad[index],
        )  # fmt: skip

    def around(self, rows: Sequence[int] | None = None) -> Surroundings:
        return self.site().around(np.arange(len(self.keys)) if rows is None else np.asarray(rows))

    def grow(self, rows: Sequence[int] | None = None, *, table: TraitsTable | None = None) -> GrownGrove:
        """Grow the plants of these rows together, the others being plants of other groves."""
        return grow_grove(self.grove(rows), self.around(rows), traits() if table is None else table, self.config)

    def but(self, **changes: Any) -> Scene:
        return replace(self, **changes)


def scene(
    places: Sequence[tuple[float, float]], *, species: int | Sequence[int] = LIME, age: float | Sequence[float] = 25.0,
    gamma: float | Sequence[float] = 1.0, clearance: float = 0.0, azimuth: float = 0.0, seed: int = 0,
    corner: tuple[float, float] = (400_000.0, 5_500_000.0), **more: Any,
) -> Scene:  # fmt: skip
    """Make a scene; places are metres from a corner of the world."""
    count = len(places)

    def column(value: float | Sequence[float]) -> NDArray[np.float64]:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), count).copy()

    return Scene(
        xy_m=np.asarray(places, dtype=np.float64) + corner,
        species=column(species).astype(np.int64),  # type: ignore[arg-type]
        age_years=column(age), keys=keys_for(seed, "scene", [str(number) for number in range(count)]),
        pruning_factor=column(gamma), clearance_m=column(clearance), row_azimuth_rad=column(azimuth), **more,
    )  # fmt: skip


def points(grown: GrownGrove, plant: int, *, season: int | None = None) -> NDArray[np.float64]:
    """Return (n, 3) standing nodes of a plant but its root, relative to it, at the end of a season of its own."""
    one = select(grown.skeletons, [plant])
    there = standing(one, one.seasons if season is None else np.array([season]))
    there[0] = False
    return one.xyz_m[there].astype(np.float64)
