"""Search the traits with which a species grows as measured: `python -m benchmarks.calibrate_growth SPECIES...`.

Few plants grow alone to 80 years for each try. The loss sums the squared log errors of median height, trunk and crown
diameter at 10, 20, 30 and 50 years, in units of the tolerance of `make check-growth`, with penalties for plants outside
the measured bands, for crowns that do not look as the species does when old (`crown_looks.py`: closed, round at the
top, on a straight trunk, neither too heavy nor too light), and a slight pull to the values searched from.
Trunks cost nothing to fit: da Vinci's rule makes them 2 * tip * pipes ** (1 / exponent), so that tip radius and
exponent are solved for each try from the same plants.

With `--write` the winner goes into the species' file, with the sizes by age that plants then reach in 100 years.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.crown_looks import OLD_AGES, looks_loss
from benchmarks.evolution import Vector, evolve
from benchmarks.growth_check import TOLERANCE, exponent, held_rows, judge, show
from benchmarks.open_grown import AGES, Sizes, grow_open, sizes_at, trunks_at
from benchmarks.urban_tree_medians import Row
from urbanforest_cli.core.config import Species as SpeciesChoice
from urbanforest_cli.core.skeleton import Skeletons, standing
from urbanforest_cli.core.species import Species
from urbanforest_cli.core.traits import OpenGrown, Traits
from urbanforest_cli.files.species import load_catalogue, species_folder

COUNT, TRIES = 6, 300
PIPE_EXPONENTS = (2.0, 2.15, 2.3, 2.5, 2.75, 3.0)
TIP_FACTORS = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15)  # about the tip radius that fits trunks in the mean
TIP_RADII_M = {"tree": (0.002, 0.009), "shrub": (0.0015, 0.0055)}
STEMS_KEPT = 0.75  # share of a shrub's stems that should still stand at 50 years
ROOM = 1.35  # the frame of a try is that of plants this much larger than measured ones
OPEN_GROWN_AGES = (1, 5, 10, 15, 20, 30, 40, 50, 65, 80, 100)
OPEN_GROWN_COUNT = 12


@dataclass(frozen=True)
class Unknown:
    """A trait to search between bounds; in the logarithm where it acts as a factor."""

    name: str
    low: float
    high: float
    log: bool = False

    def value(self, share: float) -> float:
        """Return the value at a share of the way from low to high."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + (self.high - self.low) * share)

    def share(self, value: float) -> float:
        """Return the share at a value."""
        ends = np.array([self.low, self.high])
        at = float(np.clip(value, *ends))
        return float(np.interp(np.log(at), np.log(ends), [0, 1]) if self.log else np.interp(at, ends, [0, 1]))


UNKNOWNS = {
    "tree": (
        Unknown("internode_length_m", 0.18, 0.45, log=True),
        Unknown("shoot_internodes_max", 1.8, 4.5, log=True),
        Unknown("shoot_aging", 0.93, 0.985),
        Unknown("shoot_control", 1.1, 1.7),
        Unknown("apical_control_young", 0.48, 0.72),
        Unknown("apical_control_old", 0.47, 0.56),
        Unknown("apical_control_years", 6.0, 40.0, log=True),
        Unknown("vigour_max", 1000.0, 6000.0, log=True),
        Unknown("lateral_bud_death", 0.01, 0.20),
        Unknown("auxin_inhibition", 0.1, 2.0, log=True),
        Unknown("leaf_shade", 0.015, 0.07, log=True),
        Unknown("phototropism", 0.05, 0.3, log=True),
        Unknown("gravitropism_branch", -0.05, 0.06),
    ),
    "shrub": (
        Unknown("internode_length_m", 0.16, 0.36, log=True),
        Unknown("shoot_internodes_max", 1.5, 6.0, log=True),
        Unknown("shoot_aging", 0.82, 0.985),
        Unknown("shoot_control", 1.02, 1.7),
        Unknown("apical_control_young", 0.42, 0.60),
        Unknown("apical_control_old", 0.40, 0.54),
        Unknown("apical_control_years", 4.0, 30.0, log=True),
        Unknown("vigour_max", 100.0, 3000.0, log=True),
        Unknown("lateral_bud_death", 0.01, 0.30),
        Unknown("auxin_inhibition", 0.1, 2.0, log=True),
        Unknown("leaf_shade", 0.008, 0.15, log=True),
        Unknown("gravitropism_trunk", 0.2, 1.5, log=True),
    ),
}
AIMS = {"corylus_avellana": 0.9, "syringa_vulgaris": 0.9}
"""Share of measured heights and crowns aimed at: hazel and lilac stay smaller than crape myrtle, their measure."""
CLOSE = (
    ("branch_angle_deg", 6.0, 20.0),
    ("gravitropism_branch", 0.04, -0.1),
    ("phototropism", 0.10, 0.02),
    ("room_attraction", 0.10, 0.05),
    ("stem_angle_deg", 10.0, 12.0),
)
"""Traits that make a species look like its kind, searched near the value in its file: how far, and the lowest value."""
TOLERANT, INTERMEDIATE, INTOLERANT = (4.0, 0.02), (3.2, 0.03), (2.5, 0.04)
SHADE_TOLERANCE = {
    "acer_platanoides": TOLERANT, "tilia_cordata": TOLERANT, "cornus_sanguinea": TOLERANT,
    "corylus_avellana": INTERMEDIATE, "ligustrum_vulgare": TOLERANT, "quercus_rubra": INTERMEDIATE,
    "platanus_acerifolia": INTERMEDIATE, "syringa_vulgaris": INTERMEDIATE, "gleditsia_triacanthos": INTOLERANT,
    "prunus_serrulata": INTOLERANT,
}  # fmt: skip
"""Least vigour and most shed_light: a bud needs vigour for one internode, so that a plant stands still where the light
falls below 1 / vigour, and loses branches where a branch's mean light an internode falls below shed_light."""
CROWN_MIDDLES = {
    "acer_platanoides": 0.60, "gleditsia_triacanthos": 0.63, "platanus_acerifolia": 0.60, "prunus_serrulata": 0.66,
    "quercus_rubra": 0.61, "tilia_cordata": 0.55, "cornus_sanguinea": 0.57, "corylus_avellana": 0.58,
    "ligustrum_vulgare": 0.55, "syringa_vulgaris": 0.60,
}  # fmt: skip
"""Where the middle of the crown is wanted at 20 to 50 years, as a share of height: by eye, from the species' habit."""


def unknowns_of(species: Species) -> list[Unknown]:
    """Return what is searched for a species."""
    close = [
        Unknown(name, max(at - reach, lowest), at + reach)
        for name, reach, lowest in CLOSE
        if (at := getattr(species.growth, name)) or name != "stem_angle_deg"
    ]
    vigour, shed_light = SHADE_TOLERANCE.get(species.id, INTERMEDIATE)
    shade = (
        Unknown("vigour", vigour, 8.0, log=True),
        Unknown("shed_light", 0.008, shed_light, log=True),
    )
    return [*UNKNOWNS[species.habit], *shade, *close]


def room_for(rows: list[Row]) -> OpenGrown:
    """Return sizes that leave a try room to overshoot what was measured."""
    return OpenGrown(
        age_years=(0.0, *(float(row.age_years) for row in rows)),
        height_m=(1.0, *(ROOM * row.height_m for row in rows)),
        crown_radius_m=(0.5, *(ROOM * row.crown_diameter_m / 2 for row in rows)),
        crown_base_m=(0.0,) * (len(rows) + 1),
    )


def misfit(sizes: Sizes, rows: list[Row]) -> float:
    """Return the loss of plants against the rows their species is held to."""
    loss = 0.0
    for column, row in enumerate(rows):
        for name in ("height_m", "dbh_cm", "crown_diameter_m"):
            grown = max(float(np.median(getattr(sizes, name)[:, column])), 0.05)
            aim = 1.0 if name == "dbh_cm" else AIMS.get(row.species, 1.0)
            error = abs(np.log(grown / getattr(row, name) / aim)) / (np.log(1 + TOLERANCE) * aim**3)
            loss += error**2 + 10 * max(error - 0.6, 0) ** 2
    trunk_m = np.maximum(sizes.dbh_cm, 1e-3) / 100
    slender, broad = sizes.height_m / trunk_m, sizes.crown_diameter_m / trunk_m
    for values, low, high in (
        (slender, rows[0].height_dbh_p10, rows[0].height_dbh_p90),
        (broad, rows[0].crown_dbh_p10, rows[0].crown_dbh_p90),
    ):
        loss += 150 * max(0.95 - float(np.mean((values >= low) & (values <= high))), 0) ** 2
    slope = exponent(sizes.height_m, sizes.dbh_cm)
    if np.isfinite(slope):
        loss += 30 * max(abs(slope - rows[0].height_exponent) - 0.10, 0) ** 2
    return loss


def with_pipes(skeletons: Skeletons, pipe_exponent: float, tip_radius_m: float) -> Skeletons:
    """Return the same wood with other radii."""
    count = len(skeletons)
    return replace(skeletons, pipe_exponent=np.full(count, pipe_exponent), tip_radius_m=np.full(count, tip_radius_m))


def stems_at(skeletons: Skeletons, age: int) -> Vector:
    """Return how many stems of each plant stand at an age."""
    there = standing(skeletons, np.full(len(skeletons), age, np.int64)) & (skeletons.parent == 0)
    return np.add.reduceat(there, skeletons.first[:-1]).astype(float)


def best_pipes(skeletons: Skeletons, rows: list[Row], habit: str) -> tuple[float, float, float, Sizes]:
    """Return the smallest misfit that any tip radius and pipe exponent give, these two, and the sizes."""
    low, high = TIP_RADII_M[habit]
    target = np.log([row.dbh_cm for row in rows])
    sizes = sizes_at(skeletons)
    found = []
    for pipe_exponent in PIPE_EXPONENTS:
        dbh_cm = trunks_at(with_pipes(skeletons, pipe_exponent, low), sizes.ages)
        grown = np.maximum(np.median(dbh_cm, axis=0), 1e-3)
        middle = low * np.exp(np.mean(target - np.log(grown)))
        for factor in TIP_FACTORS:
            tip = float(np.clip(middle * factor, low, high))
            fitted = replace(sizes, dbh_cm=dbh_cm * tip / low)
            found.append((misfit(fitted, rows), pipe_exponent, tip, fitted))
    return min(found, key=lambda item: item[0])


def search(species: Species, *, scan: int, tries: int, count: int, seed: int, step: float) -> tuple[float, Traits]:
    """Return the least loss found and its traits."""
    rows = held_rows(species.id)
    unknowns = unknowns_of(species)
    room = room_for(rows)
    start = np.array([item.share(getattr(species.growth, item.name)) for item in unknowns])

    def traits_at(point: Vector) -> Traits:
        values = {item.name: item.value(share) for item, share in zip(unknowns, point, strict=True)}
        return replace(species.growth, **values)

    solved: dict[bytes, tuple[float, float]] = {}

    def loss(point: Vector) -> float:
        skeletons = grow_open(species.id, traits_at(point), room, count=count, age=OLD_AGES[-1], seed=seed)
        wrong, pipe_exponent, tip, sizes = best_pipes(skeletons, rows, species.habit)
        solved[point.tobytes()] = (pipe_exponent, tip)
        wrong += looks_loss(skeletons, species.id, lean=species.habit == "tree")
        middle = float(np.nanmedian(sizes.crown_middle[:, 1:])) - CROWN_MIDDLES.get(species.id, 0.6)
        wrong += 2 * (max(abs(middle) - 0.02, 0) / 0.05) ** 2
        kept = float(np.median(stems_at(skeletons, AGES[-1]))) / species.growth.stem_count
        wrong += (max(STEMS_KEPT - kept, 0) / 0.15) ** 2
        return wrong + 0.3 * float(np.mean((point - start) ** 2))

    rng = np.random.default_rng(seed)
    points = [start, *np.clip(start + rng.normal(0, 2 * step, (scan, len(start))), 0, 1)]
    for found in evolve(loss, min(points, key=loss) if scan else start, step=step, tries=tries, seed=seed):
        print(f"  {species.id} {found.tries:4d} tries: loss {found.loss:.2f}", flush=True)
    pipe_exponent, tip = solved[found.point.tobytes()]
    return found.loss, replace(traits_at(found.point), pipe_exponent=pipe_exponent, tip_radius_m=tip)


def rounded(traits: Traits, unknowns: list[Unknown]) -> Traits:
    """Return traits with what was searched rounded to three digits."""
    names = [*(item.name for item in unknowns), "pipe_exponent", "tip_radius_m"]
    return replace(traits, **{name: float(f"{getattr(traits, name):.3g}") for name in names})


def measured_sizes(species: Species, traits: Traits, rows: list[Row]) -> OpenGrown:
    """Return the median sizes by age of plants grown to 100 years; at planting, half those of the first year."""
    room = room_for(rows)
    skeletons = grow_open(species.id, traits, room, count=OPEN_GROWN_COUNT, age=OPEN_GROWN_AGES[-1], seed=1)
    sizes = sizes_at(skeletons, OPEN_GROWN_AGES)
    columns = {
        "height_m": sizes.height_m, "crown_radius_m": sizes.crown_diameter_m / 2, "crown_base_m": sizes.crown_base_m
    }  # fmt: skip
    medians = {name: np.median(values, axis=0) for name, values in columns.items()}
    medians["crown_radius_m"] = np.maximum(medians["crown_radius_m"], 0.1)
    medians["crown_base_m"] = np.minimum(medians["crown_base_m"], medians["height_m"])
    return OpenGrown(
        age_years=(0.0, *map(float, OPEN_GROWN_AGES)),
        **{name: tuple(round(float(v), 2) for v in (values[0] / 2, *values)) for name, values in medians.items()},
    )


def write(path: Path, traits: Traits, open_grown: OpenGrown) -> None:
    """Put traits and sizes into a species file, line by line, so that all else in it stays."""
    text = path.read_text(encoding="utf-8")
    for item in (traits, open_grown):
        for name in item.__slots__:
            value = getattr(item, name)
            shown = list(value) if isinstance(value, tuple) else value
            text, lines = re.subn(rf"(?m)^{name} = [^#\n]*?( *#.*)?$", rf"{name} = {shown}\g<1>", text)
            if lines != 1:
                raise ValueError(f"{path}: {lines} lines set {name}; expected one")
    path.write_text(text, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("species", nargs="*", help="species by id; all if none is named")
    parser.add_argument("--tries", type=int, default=TRIES, help="0: keep the traits, measure their sizes alone")
    parser.add_argument(
        "--scan", type=int, default=0, help="points scattered about the start, of which the best begins"
    )
    parser.add_argument("--count", type=int, default=COUNT, help="plants a try (default: %(default)s)")
    parser.add_argument("--step", type=float, default=0.12, help="first step, as a share of the bounds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help="write the winner into the species' file")
    options = parser.parse_args()
    catalogue = load_catalogue(SpeciesChoice())
    for name in options.species or catalogue.ids:
        species = catalogue[name]
        traits = species.growth
        if options.tries:
            _, traits = search(
                species,
                scan=options.scan,
                tries=options.tries,
                count=options.count,
                seed=options.seed,
                step=options.step,
            )
            traits = rounded(traits, unknowns_of(species))
        rows = held_rows(name)
        open_grown = measured_sizes(species, traits, rows)
        show(judge(name, sizes_at(grow_open(name, traits, open_grown, count=2 * options.count, age=AGES[-1], seed=2))))
        print(traits, open_grown, sep="\n", flush=True)
        if options.write:
            write(species_folder() / f"{name}.toml", traits, open_grown)


if __name__ == "__main__":
    main()
