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
from urbanforest_cli.core.traits import TRAIT_DTYPE, OpenGrown, traits_table
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.grove import Grove, GrownGrove, Surroundings, TraitsTable
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

NAMES = (
    "tilia_cordata", "acer_platanoides", "quercus_rubra", "corylus_avellana", "ligustrum_vulgare", "cornus_sanguinea",
)  # fmt: skip
LIME, MAPLE, OAK, HAZEL, PRIVET, DOGWOOD = range(6)

# of each of NAMES: the kernels are checked with these, not with what is shipped
TRAITS: dict[str, float | tuple[float, ...]] = {
    "internode_length_m": (0.29, 0.36, 0.347, 0.26, 0.24, 0.25),
    "shoot_internodes_max": (4.02, 2.87, 2.95, 2.6, 2.2, 2.2),
    "shoot_aging": (0.958, 0.956, 0.965, 0.965, 0.9, 0.9),
    "shoot_control": (1.62, 1.24, 1.65, 1.5, 1.5, 1.5),
    "shoot_control_aging": 0.93,
    "apical_control_young": (0.637, 0.52, 0.602, 0.5, 0.47, 0.47),
    "apical_control_old": (0.51, 0.519, 0.512, 0.48, 0.46, 0.46),
    "apical_control_years": (16.0, 19.2, 26.3, 10.4, 7.15, 16.6),
    "vigour": (4.11, 4.3, 3.43, 5.0, 4.01, 4.44),
    "vigour_max": (1690.0, 2400.0, 2350.0, 900.0, 1200.0, 1200.0),
    "lateral_buds": (1.0, 2.0, 1.0, 1.0, 2.0, 2.0),
    "branch_angle_deg": (50.1, 51.3, 64.3, 50.0, 44.9, 37.8),
    "branch_angle_sd_deg": (5.0, 5.0, 7.0, 5.0, 5.0, 5.0),
    "roll_angle_deg": (137.5, 90.0, 137.5, 137.5, 90.0, 90.0),
    "roll_angle_sd_deg": (10.0, 5.0, 10.0, 10.0, 8.0, 5.0),
    "apical_angle_sd_deg": (3.5, 3.5, 3.5, 4.0, 4.0, 4.0),
    "apical_bud_death": 0.003,
    "lateral_bud_death": (0.061, 0.15, 0.0445, 0.1, 0.05, 0.05),
    "lateral_light_exponent": 0.5,
    "auxin_inhibition": (0.372, 0.517, 0.359, 0.4, 0.168, 0.22),
    "auxin_distance_factor": 0.5,
    "auxin_aging": 0.93,
    "phototropism": (0.222, 0.242, 0.222, 0.06, 0.0904, 0.08),
    "room_attraction": (0.163, 0.16, 0.15, 0.223, 0.29, 0.267),
    "gravitropism_trunk": (0.5, 0.5, 0.5, 0.8, 0.9, 0.9),
    "gravitropism_branch": (-0.0021, 0.00535, 0.0134, 0.0, -0.00377, 0.0294),
    "leaf_shade": (0.0275, 0.05, 0.0661, 0.03, 0.02, 0.02),
    "shade_decay": 1.8,
    "shed_light": (0.0162, 0.02, 0.0152, 0.0122, 0.0132, 0.0133),
    "clear_stem_m": (1.8, 2.0, 2.2, 0.0, 0.0, 0.0),
    "pipe_exponent": (2.3, 2.3, 2.15, 2.0, 2.0, 2.0),
    "tip_radius_m": (0.009, 0.00792, 0.00783, 0.00448, 0.0045, 0.0045),
    "stem_count": (1.0, 1.0, 1.0, 11.0, 9.0, 9.0),
    "stem_angle_deg": (0.0, 0.0, 0.0, 40.0, 40.0, 40.0),
}
AGES = (0.0, 1.0, 5.0, 10.0, 20.0, 30.0, 50.0)
SIZES = (  # of each of NAMES at these ages, as it grows alone: height, crown radius, crown base
    (
        (0.56, 1.12, 5.13, 9.25, 13.89, 15.76, 17.74),
        (0.05, 0.1, 1.17, 2.91, 4.84, 5.11, 5.37),
        (0.0, 0.0, 1.38, 1.92, 1.92, 1.92, 2.18),
    ),
    (
        (0.5, 0.99, 4.51, 8.12, 13.28, 16.55, 19.85),
        (0.05, 0.1, 1.56, 3.06, 4.96, 5.27, 5.6),
        (0.0, 0.0, 0.99, 2.53, 2.53, 2.53, 2.83),
    ),
    (
        (0.5, 0.99, 4.6, 8.44, 14.35, 18.46, 23.19),
        (0.05, 0.1, 0.99, 2.52, 5.56, 7.08, 8.0),
        (0.0, 0.0, 1.3, 2.24, 2.24, 2.24, 2.24),
    ),
    (
        (0.31, 0.62, 2.98, 5.34, 7.27, 8.47, 9.89),
        (0.1, 0.21, 1.7, 3.33, 3.98, 4.02, 4.23),
        (0.0, 0.0, 0.15, 0.16, 0.18, 0.53, 2.23),
    ),
    (
        (0.22, 0.45, 1.88, 2.88, 3.52, 3.65, 3.68),
        (0.07, 0.14, 1.01, 1.74, 1.97, 1.97, 1.97),
        (0.0, 0.0, 0.18, 0.18, 0.2, 0.2, 0.2),
    ),
    (
        (0.24, 0.47, 1.96, 3.05, 3.67, 3.85, 3.88),
        (0.06, 0.13, 1.0, 1.69, 1.92, 1.93, 1.93),
        (0.0, 0.0, 0.19, 0.19, 0.2, 0.2, 0.2),
    ),
)
OPEN_GROWN = [OpenGrown(age_years=AGES, height_m=h, crown_radius_m=r, crown_base_m=b) for h, r, b in SIZES]


@cache
def shipped() -> TraitsTable:
    """Return the traits of NAMES as they are shipped."""
    catalogue = load_catalogue(Species())
    found = {species.id: species for species in catalogue}
    return traits_table([found[name].growth for name in NAMES])


def traits(**changes: float) -> TraitsTable:
    """Return TRAITS, some of them changed in all species."""
    table = np.zeros(len(NAMES), TRAIT_DTYPE)
    for name, value in {**TRAITS, **changes}.items():
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
        return Site(plants, OPEN_GROWN, shapes, np.full(len(shapes), self.height_m), light, self.config)

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
