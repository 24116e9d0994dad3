import json
import re
from dataclasses import replace

import pandas as pd
import pytest

from urbanforest_cli.export.map_layers import RegisterTables, SpeciesStyle
from urbanforest_cli.export.page import render_html
from urbanforest_cli.export.report import build_report

NASTY = "<script>alert('x')</script>\"&"


def tables(lot: str = "a", empty: bool = False) -> RegisterTables:
    lots = pd.DataFrame(
        {
            "lot_id": [lot, "b", "c"],
            "zone": ["residential", "residential", "other"],
            "area_m2": [6000.0, 4000.0, 20_000.0],
            "plantable_area_m2": [3000.0, 0.0, 10_000.0],
        }
    )
    parameters = pd.DataFrame({"lot_id": [lot, "b", "c"], "strategy": ["random", "random", "single"],
                               "radius_mean_m": [2.0, 2.0, 3.0]})  # fmt: skip
    plants = pd.DataFrame({"lot_id": [lot, lot, lot, "c"], "species": ["oak", "oak", "elder", "oak"],
                           "habit": ["tree", "tree", "shrub", "tree"], "age_years": [10.0, 20.0, 5.0, 30.0],
                           "envelope_radius_m": [1.0, 3.0, 2.0, 3.0]})  # fmt: skip
    placements = pd.DataFrame(
        {"lot_id": [lot, "b", "c"], "position_count": [6, 0, 1], "radius_mean_m": [2.0, None, 3.0]}
    )
    skipped = pd.DataFrame({"lot_id": ["b"], "stage": ["stencil"], "reason": ["no_room"], "detail": [NASTY]})
    if empty:
        plants, placements, skipped = plants.iloc[:0], placements.iloc[:0], skipped.iloc[:0]
    return RegisterTables(lots, parameters, plants, placements, skipped)


def report(**changes):
    arguments = {
        "title": "Town",
        "species": [SpeciesStyle("oak", "Quercus", "#112233", True)],
        "provenance": {"program_version": "9", "seed": 4, "inputs": [{"name": "town.gpkg", "sha256": "ab" * 32}]},
        "stages": [{"stage": "stencil", "seconds": 1.25, "counts": {"lots": 3},
                    "warnings": [{"code": "W_X", "message": "odd lots", "count": 2, "examples": ["b"]}]}],
        "config": {"seed": 4},
    }  # fmt: skip
    return build_report(changes.pop("tables", tables()), **{**arguments, **changes})


def test_headline_counts_and_densities_are_those_of_the_tables():
    found = report()["headline"]
    assert (found["lots"], found["lots_planted"], found["lots_skipped"]) == (3, 2, 1)
    assert (found["plants"], found["trees"], found["shrubs"], found["species"]) == (4, 3, 1, 2)
    assert found["area_ha"] == 3.0
    assert found["plants_per_hectare"] == pytest.approx(4 / 3, abs=0.01)
    assert found["crown_share"] == pytest.approx(3.14159 * (1 + 9 + 4 + 9) / 30_000, abs=1e-4)


def test_zones_strategies_and_species_add_up_to_the_whole():
    found = report()
    for table in ("zones", "strategies", "species"):
        assert sum(row["plants"] for row in found[table]) == 4
    assert sum(row["lots"] for row in found["zones"]) == sum(row["lots"] for row in found["strategies"]) == 3
    residential = next(row for row in found["zones"] if row["zone"] == "residential")
    assert residential["plants_per_hectare"] == 3.0
    assert residential["plantable_share"] == 0.3
    random = next(row for row in found["strategies"] if row["strategy"] == "random")
    assert (random["radius_asked_m"], random["radius_realised_m"], random["plants_per_lot"]) == (2.0, 2.0, 3.0)
    oak = found["species"][0]
    assert (oak["label"], oak["colour"], oak["share"], oak["age_mean_years"]) == ("Quercus", "#112233", 0.75, 20.0)


def test_skipped_lots_are_told_with_reason_meaning_and_examples():
    (row,) = report()["skipped"]
    assert (row["reason"], row["stage"], row["lots"]) == ("no_room", "stencil", 1)
    assert "cover the whole lot" in row["meaning"]
    assert row["examples"] == [{"lot_id": "b", "detail": NASTY}]


def test_a_city_without_plants_has_a_report_and_a_page():
    found = report(tables=tables(empty=True))
    assert found["headline"]["plants"] == 0
    assert found["species"] == []
    json.dumps(found, allow_nan=False)
    assert "No plants." in render_html(found, {})


def test_the_share_that_the_map_shows_green_is_of_the_ground_it_knows():
    mapped = tables()
    assert report(tables=mapped)["headline"]["map_share"] is None
    assert "the map" not in render_html(report(tables=mapped), {})
    lots = mapped.lots.assign(covered_fraction=[0.5, None, 0.1], seen_fraction=[1.0, 0.0, 0.5])
    found = report(tables=replace(mapped, lots=lots))
    assert found["headline"]["map_share"] == pytest.approx((3000 + 1000) / (6000 + 10_000))
    zones = {row["zone"]: row["map_share"] for row in found["zones"]}
    assert zones == {"residential": 0.5, "other": 0.1}
    page = render_html(found, {})
    assert "of the lots green in the map" in page
    assert "Green in the map" in page
    json.dumps(found, allow_nan=False)


def test_the_page_names_what_was_counted():
    page = render_html(report(), {"map": b"png", "lots": b"png"})
    for text in ("Town", "residential", "Quercus", "no room", "odd lots", "W_X", "town.gpkg", "ab" * 32, "1.2"):
        assert text in page


def test_the_page_needs_nothing_from_elsewhere():
    page = render_html(report(), {"map": b"png", "lots": b"png"})
    assert not re.search(r"https?://|//[a-z]", page)
    assert "@import" not in page
    assert "url(" not in page
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="([^"]*)"', page))
    assert not re.findall(r'href="', page)
    assert re.findall(r"<script[^>]*>", page) == ['<script type="application/json" id="urbanforest-provenance">']


def test_names_from_data_are_escaped_wherever_they_stand():
    found = report(
        tables=tables(lot=NASTY),
        title=NASTY,
        species=[SpeciesStyle("oak", NASTY, "#112233", True)],
        provenance={"program_version": NASTY, "seed": NASTY, "inputs": [{"name": NASTY, "sha256": NASTY}]},
        stages=[{"stage": NASTY, "counts": {NASTY: NASTY},
                 "warnings": [{"code": NASTY, "message": NASTY, "count": 1, "examples": [NASTY]}]}],
        config={"zones": {NASTY: NASTY}},
    )  # fmt: skip
    page = render_html(found, {"map": b"x"})
    assert "<script>alert" not in page
    assert page.count("<script") == page.count("</script>") == 1
    text = page[page.index('id="urbanforest-provenance">') :].split(">", 1)[1].split("</script>", 1)[0]
    assert json.loads(text)["seed"] == NASTY
