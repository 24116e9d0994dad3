"""Make `docs/growth/urban_tree_medians.csv` from the Urban Tree Database: `python -m benchmarks.urban_tree_medians`.

The records are those of McPherson, van Doorn and Peper 2016, Urban Tree Database, USDA Forest Service RDS-2016-0005
(public domain); their folder is read from URBANFOREST_REAL_DATA. What a row's sizes rest on stands in its `basis`:

- window: medians of the records of the reference species aged `age_from_years` to `age_to_years`;
- local fit: fewer than 8 records there, so a power law of age through the records a third to three times as old;
- oldest: the database has none so old; medians of its oldest records;
- horticultural: a share of the mature size of the species' own file, as these shrubs are full-grown at 5 to 10 years.

The bands of height and crown diameter over trunk diameter are those of all records of 5 cm trunk diameter or more, and
so are the exponents: height, or crown diameter, = a * trunk diameter ** exponent, by least squares of the logarithms.
"""

from __future__ import annotations

import csv
import os
import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.config import Species as SpeciesChoice
from urbanforest_cli.core.species import Species
from urbanforest_cli.files.species import load_catalogue

TABLE = Path(__file__).parent.parent / "docs" / "growth" / "urban_tree_medians.csv"
WINDOWS = {10: (8, 12), 20: (18, 22), 30: (27, 33), 50: (45, 55)}
RECORDS_MIN = 8
TRUNK_MIN_CM = 5.0
COLUMNS = ("Age", "TreeHt (m)", "DBH (cm)", "AvgCdia (m)")
NEAREST = {  # no shrub of ours is in the database; crape myrtle is its commonest plant of several stems from the ground
    "cornus_sanguinea": ("Lagerstroemia indica", "Cornus florida"),
    "corylus_avellana": ("Lagerstroemia indica",),
    "ligustrum_vulgare": ("Lagerstroemia indica",),
    "syringa_vulgaris": ("Lagerstroemia indica",),
}
NOT_BELIEVED = {  # floras and nurseries give these shrubs half the size of their nearest species at 50 years
    "cornus_sanguinea": "common dogwood stays at 2-5 m (RHS 1.5-2.5 m, hedges to 5 m)",
    "ligustrum_vulgare": "wild privet stays at 3-5 m",
}
HORTICULTURAL_SHARES = {10: 0.9, 20: 1.0, 30: 1.0, 50: 1.0}  # of mature size; RHS: full-grown after 5 to 10 years


@dataclass(frozen=True, kw_only=True)
class Row:
    """The sizes that a species' open-grown plants are held against at one age."""

    species: str
    age_years: int
    held: str  # yes: the check holds the species to this row; no: told for comparison
    basis: str
    reference_species: str
    age_from_years: float
    age_to_years: float
    n: int
    height_m: float
    dbh_cm: float
    crown_diameter_m: float
    bands_n: int
    height_dbh_p10: float
    height_dbh_p50: float
    height_dbh_p90: float
    crown_dbh_p10: float
    crown_dbh_p50: float
    crown_dbh_p90: float
    height_exponent: float
    crown_exponent: float
    note: str


BAND_COLUMNS = [item.name for item in fields(Row)][11:20]


def read_records(path: Path) -> dict[str, NDArray[np.float64]]:
    """Return (n, 4) age, height m, trunk diameter cm, crown diameter m by species; unknown ages are nan."""
    found: dict[str, list[list[float]]] = {}
    with path.open(encoding="latin-1", newline="") as stream:
        for record in csv.DictReader(stream):
            try:
                values = [float(record[name]) for name in COLUMNS]
            except ValueError:
                continue
            if min(values[1:]) > 0:
                values[0] = values[0] if values[0] >= 0 else np.nan
                found.setdefault(record["ScientificName"].strip(), []).append(values)
    return {name: np.array(values) for name, values in found.items()}


def local_fit(records: NDArray[np.float64], age: float) -> NDArray[np.float64]:
    """Return height, trunk and crown diameter at an age from a power law through the records around it."""
    slopes = np.polyfit(np.log(records[:, 0] / age), np.log(records[:, 1:]), 1)
    return np.exp(slopes[1])


def sizes_at(records: NDArray[np.float64], age: int) -> tuple[str, float, float, int, NDArray[np.float64]]:
    """Return basis, ages from and to, number of records, and height, trunk and crown diameter at an age."""
    aged = records[np.isfinite(records[:, 0])]
    low, high = WINDOWS[age]
    near = aged[(aged[:, 0] >= low) & (aged[:, 0] <= high)]
    if len(near) >= RECORDS_MIN:
        return "window", low, high, len(near), np.median(near[:, 1:], axis=0)
    oldest = float(aged[:, 0].max())
    if oldest < low:
        old = aged[aged[:, 0] >= 0.9 * oldest]
        return "oldest", float(old[:, 0].min()), oldest, len(old), np.median(old[:, 1:], axis=0)
    around = aged[(aged[:, 0] >= age / 3) & (aged[:, 0] <= age * 3)]
    return "local fit", float(around[:, 0].min()), float(around[:, 0].max()), len(around), local_fit(around, age)


def rows_for(species: Species, records: dict[str, NDArray[np.float64]]) -> list[Row]:
    """Return the rows of one species: held ones first, then those for comparison."""
    rows = []
    references = NEAREST.get(species.id, (species.scientific_name,))
    for place, name in enumerate(references):
        grown = records[name][records[name][:, 2] >= TRUNK_MIN_CM]
        slender = np.percentile(100 * grown[:, 1] / grown[:, 2], [10, 50, 90])
        broad = np.percentile(100 * grown[:, 3] / grown[:, 2], [10, 50, 90])
        logs = np.log(grown[:, 1:])
        exponents = [np.polyfit(logs[:, 1], logs[:, column], 1)[0] for column in (0, 2)]
        bands = dict(zip(BAND_COLUMNS, [len(grown), *slender, *broad, *exponents], strict=True))
        for age in WINDOWS:
            basis, low, high, count, size = sizes_at(records[name], age)
            believed = place == 0 and species.id not in NOT_BELIEVED
            note = "" if name == species.scientific_name else "nearest species"
            note = "beyond the species' usual life in towns" if basis == "oldest" else note
            row = Row(
                species=species.id, age_years=age, held="yes" if believed else "no", basis=basis,
                reference_species=name, age_from_years=low, age_to_years=high, n=count, height_m=size[0],
                dbh_cm=size[1], crown_diameter_m=size[2], note=note, **bands,
            )  # fmt: skip
            if place == 0 and not believed:
                rows.append(horticultural(species, row))
            rows.append(row)
    return sorted(rows, key=lambda row: row.held == "no")


def horticultural(species: Species, nearest: Row) -> Row:
    """Return the row of a shrub whose nearest species is too large to be believed; the trunk keeps its proportion."""
    share = HORTICULTURAL_SHARES[nearest.age_years]
    height_m = share * species.mature_height_m
    changes = {
        "held": "yes", "basis": "horticultural", "age_from_years": nearest.age_years,
        "age_to_years": nearest.age_years, "n": 0, "height_m": height_m,
        "dbh_cm": 100 * height_m / nearest.height_dbh_p50,
        "crown_diameter_m": share * species.mature_crown_diameter_m,
        "note": f"{NOT_BELIEVED[species.id]}; bands of the nearest species",
    }  # fmt: skip
    return Row(**(asdict(nearest) | changes))


def read_table(path: Path = TABLE) -> list[Row]:
    """Read the table back."""
    kinds = {item.name: {"int": int, "float": float, "str": str}[str(item.type)] for item in fields(Row)}
    with path.open(encoding="utf-8", newline="") as stream:
        return [Row(**{name: kinds[name](value) for name, value in row.items()}) for row in csv.DictReader(stream)]


def main() -> None:
    folder = os.environ.get("URBANFOREST_REAL_DATA")
    if not folder:
        sys.exit("URBANFOREST_REAL_DATA is not set: the folder that holds urban_tree_database/utd_raw.csv")
    records = read_records(Path(folder) / "urban_tree_database" / "utd_raw.csv")
    rows = [row for species in load_catalogue(SpeciesChoice()) for row in rows_for(species, records)]
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    with TABLE.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([item.name for item in fields(Row)])
        for row in rows:
            writer.writerow([f"{float(v):.2f}".rstrip("0").rstrip(".") if isinstance(v, float) else v
                             for v in asdict(row).values()])  # fmt: skip
    print(f"{len(rows)} rows in {TABLE}")


if __name__ == "__main__":
    main()
