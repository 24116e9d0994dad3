"""Hold open-grown plants of every species against measured ones: `make check-growth`.

24 plants a species grow alone to 50 years; their sizes at 10, 20, 30 and 50 years are read from that one run and
compared with `docs/growth/urban_tree_medians.csv`. Nothing is scaled: height, trunk and crown are what grew.
A species passes when each median lies within 25 % of its target and at least 80 % of its plants (all ages together)
lie inside the measured 10-90 % bands of height and of crown diameter over trunk diameter. The exponent of height over
trunk diameter is told beside the measured one. Exit code 1 if a species fails.

`--ablation` shows that the check can fail. `light` lets plants sense room alone, so that shade neither slows nor sheds:
every species fails. `scaled` takes the plants at 10 years, and scaled copies of them for the other ages: all trees
and lilac fail, but not the three shrubs whose proportions hardly change after 10 years.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.open_grown import Sizes, grow_species
from benchmarks.urban_tree_medians import Row, read_table
from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.config import Species as SpeciesChoice
from urbanforest_cli.files.species import load_catalogue

TOLERANCE = 0.25
BAND_SHARE_MIN = 0.80
COUNT = 24
MEASURES = ("height_m", "dbh_cm", "crown_diameter_m")


@dataclass(frozen=True)
class Verdict:
    """How a species' plants compare with the measured ones.

    `medians` and `targets` are (ages, 3): height m, trunk diameter cm, crown diameter m.
    """

    species: str
    ages: tuple[int, ...]
    medians: NDArray[np.float64]
    targets: NDArray[np.float64]
    slender_share: float
    broad_share: float
    height_exponent: float
    height_exponent_measured: float
    internodes: NDArray[np.float64]
    basis: tuple[str, ...]
    failures: list[str] = field(default_factory=list)

    @property
    def ratios(self) -> NDArray[np.float64]:
        """Medians over targets."""
        return self.medians / self.targets


def held_rows(species_id: str) -> list[Row]:
    """Return the rows that a species is held to, by age."""
    rows = [row for row in read_table() if row.species == species_id and row.held == "yes"]
    return sorted(rows, key=lambda row: row.age_years)


def share_inside(values: NDArray[np.float64], low: float, high: float) -> float:
    """Return the share of values within a band."""
    return float(np.mean((values >= low) & (values <= high)))


def exponent(height_m: NDArray[np.float64], dbh_cm: NDArray[np.float64]) -> float:
    """Return the slope of log height over log trunk diameter; nan where no trunk reaches 1.3 m."""
    there = dbh_cm > 0
    if there.sum() < 3:
        return float("nan")
    return float(np.polyfit(np.log(dbh_cm[there]), np.log(height_m[there]), 1)[0])


def judge(species_id: str, sizes: Sizes) -> Verdict:
    """Compare sizes with the table."""
    rows = held_rows(species_id)
    targets = np.array([[getattr(row, name) for name in MEASURES] for row in rows])
    medians = np.array([np.median(getattr(sizes, name), axis=0) for name in MEASURES]).T
    trunk_m = np.maximum(sizes.dbh_cm, 1e-3) / 100
    verdict = Verdict(
        species=species_id,
        ages=sizes.ages,
        medians=medians,
        targets=targets,
        slender_share=share_inside(sizes.height_m / trunk_m, rows[0].height_dbh_p10, rows[0].height_dbh_p90),
        broad_share=share_inside(sizes.crown_diameter_m / trunk_m, rows[0].crown_dbh_p10, rows[0].crown_dbh_p90),
        height_exponent=exponent(sizes.height_m, sizes.dbh_cm),
        height_exponent_measured=rows[0].height_exponent,
        internodes=np.median(sizes.internode_count, axis=0),
        basis=tuple(f"{row.reference_species}, {row.basis}" for row in rows),
    )
    for age, ratios in zip(verdict.ages, verdict.ratios, strict=True):
        for name, ratio in zip(MEASURES, ratios, strict=True):
            if not abs(ratio - 1) <= TOLERANCE:
                verdict.failures.append(f"{name} at {age} years is {ratio:.2f} of the target")
    for name, share in (("height/dbh", verdict.slender_share), ("crown/dbh", verdict.broad_share)):
        if share < BAND_SHARE_MIN:
            verdict.failures.append(f"{share:.0%} of plants inside the measured band of {name}")
    return verdict


def scaled_copies(sizes: Sizes, species_id: str) -> Sizes:
    """Return what would be measured if plants were copies of those at the first age, scaled to each age's height."""
    heights = np.array([row.height_m for row in held_rows(species_id)])
    factor = heights / np.median(sizes.height_m[:, 0])
    scaled = {name: getattr(sizes, name)[:, :1] * factor for name in (*MEASURES, "crown_base_m")}
    kept = {
        name: np.repeat(getattr(sizes, name)[:, :1], len(factor), 1) for name in ("internode_count", "crown_middle")
    }
    return Sizes(ages=sizes.ages, **kept, **scaled)


def check(species_ids: list[str], *, count: int = COUNT, seed: int = 0, ablation: str = "none") -> list[Verdict]:
    """Grow and judge species."""
    catalogue = load_catalogue(SpeciesChoice())
    config = Growth(environment="markers") if ablation == "light" else Growth()
    verdicts = []
    for name in species_ids or catalogue.ids:
        sizes = grow_species(catalogue[name], count=count, seed=seed, config=config)
        verdicts.append(judge(name, scaled_copies(sizes, name) if ablation == "scaled" else sizes))
    return verdicts


def show(verdict: Verdict) -> None:
    """Print a species' table."""
    print(f"\n{verdict.species}: {'pass' if not verdict.failures else 'FAIL'}")
    print(
        "  age   height m (target, ratio)   dbh cm (target, ratio)   crown m (target, ratio)  internodes  target from"
    )
    for row, age in enumerate(verdict.ages):
        cells = "".join(
            f"{m:10.1f} ({t:5.1f}, {m / t:4.2f}){' ' if abs(m / t - 1) <= TOLERANCE else '*'}"
            for m, t in zip(verdict.medians[row], verdict.targets[row], strict=True)
        )
        print(f"  {age:3d} {cells}{verdict.internodes[row]:11,.0f}   {verdict.basis[row]}")
    print(
        f"  inside the 10-90 % bands: height/dbh {verdict.slender_share:.0%}, crown/dbh {verdict.broad_share:.0%};"
        f" height ~ dbh^{verdict.height_exponent:.2f} (measured {verdict.height_exponent_measured:.2f})"
    )
    for failure in verdict.failures:
        print(f"  * {failure}")


def as_record(verdict: Verdict) -> dict[str, object]:
    """Return a verdict as plain values."""
    return {
        "species": verdict.species, "passed": not verdict.failures, "failures": verdict.failures,
        "ages": verdict.ages, "measures": MEASURES, "medians": verdict.medians.round(3).tolist(),
        "targets": verdict.targets.tolist(), "ratios": verdict.ratios.round(3).tolist(), "basis": verdict.basis,
        "height_dbh_inside": verdict.slender_share, "crown_dbh_inside": verdict.broad_share,
        "height_exponent": verdict.height_exponent, "height_exponent_measured": verdict.height_exponent_measured,
        "internodes": verdict.internodes.tolist(),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("species", nargs="*", help="species by id; all if none is named")
    parser.add_argument("--count", type=int, default=COUNT, help="plants a species (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ablation", choices=("none", "scaled", "light"), default="none")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")
    options = parser.parse_args()
    start = time.process_time()
    verdicts = check(options.species, count=options.count, seed=options.seed, ablation=options.ablation)
    if options.json:
        print(json.dumps([as_record(verdict) for verdict in verdicts], indent=2))
    else:
        for verdict in verdicts:
            show(verdict)
        passed = sum(not verdict.failures for verdict in verdicts)
        print(f"\n{passed} of {len(verdicts)} species pass; {time.process_time() - start:.0f} CPU s")
    sys.exit(any(verdict.failures for verdict in verdicts))


if __name__ == "__main__":
    main()
