"""Sizes come from growth: open-grown plants of every species against measured ones, and what makes that check fail."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.crown_looks import cover, looks_at, sector_radius
from benchmarks.growth_check import MEASURES, check, held_rows, judge
from benchmarks.open_grown import AGES, Sizes, grow_open, sizes_at
from benchmarks.urban_tree_medians import TABLE, read_records, read_table, rows_for
from urbanforest_cli.core.config import Species
from urbanforest_cli.files.species import load_catalogue


def as_measured(species_id: str, plants: int = 24, factor: float = 1.0) -> Sizes:
    """Sizes as the table has them, trunks scaled by a factor."""
    rows = held_rows(species_id)
    columns = {name: np.tile([getattr(row, name) for row in rows], (plants, 1)) for name in MEASURES}
    columns["dbh_cm"] = columns["dbh_cm"] * factor
    rest = dict.fromkeys(("crown_base_m", "internode_count", "crown_middle"), np.ones((plants, len(rows))))
    return Sizes(ages=AGES, **columns, **rest)


def test_the_table_holds_every_shipped_species_to_four_ages() -> None:
    for item in load_catalogue(Species()):
        assert [row.age_years for row in held_rows(item.id)] == list(AGES)
        assert all(row.basis != "horticultural" for row in held_rows(item.id)) or item.habit == "shrub"


def test_the_table_is_what_the_records_give() -> None:
    root = os.environ.get("URBANFOREST_REAL_DATA")
    if not root:
        pytest.skip("URBANFOREST_REAL_DATA is not set")
    records = read_records(Path(root) / "urban_tree_database" / "utd_raw.csv")
    rows = [row for item in load_catalogue(Species()) for row in rows_for(item, records)]
    shipped = read_table(TABLE)
    assert len(rows) == len(shipped)
    for made, kept in zip(rows, shipped, strict=True):
        assert (made.species, made.age_years, made.held, made.basis, made.n) == (
            kept.species, kept.age_years, kept.held, kept.basis, kept.n,
        )  # fmt: skip
        for name in (*MEASURES, "height_dbh_p10", "crown_dbh_p90", "height_exponent"):
            assert getattr(made, name) == pytest.approx(getattr(kept, name), abs=0.006)


def test_plants_as_measured_pass_and_thin_trunks_fail() -> None:
    assert judge("tilia_cordata", as_measured("tilia_cordata")).failures == []
    failures = judge("tilia_cordata", as_measured("tilia_cordata", factor=0.5)).failures
    assert any("dbh_cm at 10 years is 0.50" in line for line in failures)
    assert any("band of height/dbh" in line for line in failures)


def test_a_full_crown_covers_its_outline_and_tufts_do_not() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(4000, 3))
    ball *= 4 * rng.uniform(size=(4000, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)
    tufts = 0.15 * ball + rng.choice([[4, 0, 0], [-4, 0, 0], [0, 4, 0], [0, -4, 0], [0, 0, 4]], size=4000)
    ball[:, 2] += 6
    tufts[:, 2] += 6
    assert cover(ball, 10.0) > 0.9
    assert cover(tufts, 10.0) < 0.35
    assert cover(ball[:3], 10.0) == 0.0
    assert 3.0 < sector_radius(ball) < 4.0 < 8 * sector_radius(np.array([[5.0, 0.0, 1.0]])) < 5.1


def test_looks_of_an_oak_are_those_of_a_tree() -> None:
    species = load_catalogue(Species())["quercus_rubra"]
    looks = looks_at(grow_open(species.id, species.growth, species.open_grown, count=2, age=30), 30)
    assert (looks.cover > 0.85).all()
    assert (looks.dome > 0.15).all()
    assert (looks.lean < 0.15).all()


def test_each_age_of_one_run_is_no_smaller_than_the_age_before() -> None:
    species = load_catalogue(Species())["gleditsia_triacanthos"]
    skeletons = grow_open(species.id, species.growth, species.open_grown, count=2, age=20)
    sizes = sizes_at(skeletons, (5, 10, 15, 20))
    assert (np.diff(sizes.height_m) > 0).all()
    assert (np.diff(sizes.dbh_cm) > 0).all()
    assert (np.diff(sizes.crown_diameter_m) > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("species_id", load_catalogue(Species()).ids)
def test_open_grown_plants_are_as_large_as_measured_ones(species_id: str) -> None:
    (verdict,) = check([species_id])
    assert verdict.failures == []


@pytest.mark.slow
@pytest.mark.parametrize("species_id", load_catalogue(Species()).ids)
def test_files_state_the_sizes_that_growth_leads_to(species_id: str) -> None:
    species = load_catalogue(Species())[species_id]
    ages = np.array(AGES, float)
    sizes = sizes_at(grow_open(species.id, species.growth, species.open_grown, count=12, age=AGES[-1], seed=3))
    assert np.median(sizes.height_m, axis=0) == pytest.approx(species.open_grown.height_at(ages), rel=0.15)
    radius_m = np.median(sizes.crown_diameter_m, axis=0) / 2
    assert radius_m == pytest.approx(species.open_grown.crown_radius_at(ages), rel=0.2)


@pytest.mark.slow
def test_scaled_copies_of_young_trees_fail() -> None:
    verdicts = check(["acer_platanoides", "tilia_cordata"], count=8, ablation="scaled")
    assert all(verdict.failures for verdict in verdicts)


@pytest.mark.slow
def test_trees_that_feel_no_shade_fail() -> None:
    verdicts = check(["acer_platanoides", "quercus_rubra"], count=6, ablation="light")
    assert all(verdict.failures for verdict in verdicts)
