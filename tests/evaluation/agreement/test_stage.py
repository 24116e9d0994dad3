from __future__ import annotations

import json
import shutil
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from PIL import Image
from pyproj import CRS, Transformer

from urbanforest_cli.core.errors import InputError, SchemaError
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.evaluation.agreement.sets import PLACED, RANDOM, RULES, SHUFFLED
from urbanforest_cli.evaluation.stage import ENVELOPE, GROWN, evaluate_register
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.provenance import Record, provenance_frame

UTM = CRS.from_epsg(32633)


def named(summary):
    return {one.name: one for one in summary.coverage.sets}


def test_crowns_are_found_in_the_map_that_was_made_of_them(crowned):
    register, path, _, _ = crowned
    before = sha256_of(register)
    summary = evaluate_register(register, coverage=path)
    found = named(summary)
    assert list(found) == [PLACED, SHUFFLED, RANDOM]
    placed = found[PLACED]
    assert placed.error_mean.value < 0.005
    assert placed.near_share.value == 1
    assert placed.iou.value > 0.98
    assert placed.total_ratio.value == pytest.approx(1, abs=0.01)
    assert found[SHUFFLED].iou.value < 0.6
    assert found[RANDOM].iou.value < 0.6
    assert all(gain.iou.low > 0.2 for gain in summary.coverage.gains)
    assert summary.coverage.crowns == ENVELOPE
    assert summary.evaluation is None
    assert sha256_of(register) == before


def test_a_map_of_another_crs_and_resolution_says_the_same(crowned, map_file, tmp_path):
    register, path, under, bounds = crowned
    own = named(evaluate_register(register, coverage=path))[PLACED]
    feet = CRS.from_epsg(3857)
    box = Transformer.from_crs(UTM, feet, always_xy=True).transform_bounds(*bounds)
    other = map_file(tmp_path / "mercator.tif", box, under, crs=feet, cell=0.37)
    found = named(evaluate_register(register, coverage=other))[PLACED]
    assert found.iou.value == pytest.approx(own.iou.value, abs=0.03)
    assert found.total_ratio.value == pytest.approx(1, abs=0.02)
    assert found.near_share.value == 1


def test_a_map_of_another_place_is_refused_with_both_extents(crowned, map_file, tmp_path):
    register, _, under, (west, south, east, north) = crowned
    away = map_file(tmp_path / "away.tif", (west + 9000, south, east + 9000, north), under)
    with pytest.raises(InputError, match="knows nothing of the lots") as caught:
        evaluate_register(register, coverage=away)
    assert "509" in str(caught.value.found)
    assert "500000" in str(caught.value.expected)
    blank = map_file(tmp_path / "blank.tif", (west, south, east, north), lambda x, y: np.full(x.shape, 255))
    with pytest.raises(InputError, match="knows nothing of the lots"):
        evaluate_register(register, coverage=blank)


def test_a_map_of_some_lots_compares_those_and_counts_the_others(crowned, map_file, tmp_path):
    register, _, under, (west, south, _, north) = crowned
    part = map_file(tmp_path / "part.tif", (west, south, west + 10 + 60 * 4 + 10, north), under)
    summary = evaluate_register(register, coverage=part)
    assert summary.coverage.lots_compared == 4
    assert summary.coverage.lots_unknown == 6
    assert summary.notices.count("W_LOTS_UNSEEN") == 6
    assert named(summary)[PLACED].near_share.value == 1


def test_nothing_or_everything_covered_is_told_without_a_fault(crowned, map_file, tmp_path):
    register, _, _, bounds = crowned
    bare = map_file(tmp_path / "bare.tif", bounds, lambda x, y: np.zeros(x.shape))
    placed = named(evaluate_register(register, coverage=bare))[PLACED]
    assert placed.total_ratio.value is None
    assert placed.iou.value == 0
    full = map_file(tmp_path / "full.tif", bounds, lambda x, y: np.full(x.shape, 100))
    placed = named(evaluate_register(register, coverage=full))[PLACED]
    assert placed.bias.value < -0.5
    json.dumps(evaluate_register(register, coverage=full).as_record(), allow_nan=False)


def test_grown_crowns_are_taken_where_these_plants_have_grown(crowned, tmp_path):
    register, path, _, _ = crowned
    young = shutil.copy(register, tmp_path / "young.gpkg")
    plants = read_layer(register, "plants")
    trees = gpd.GeoDataFrame(
        plants[["plant_id", "lot_id", "species", "habit", "age_years"]].assign(
            height_m=5.0, crown_radius_m=1.5, crown_base_m=1.0, dbh_m=0.2, internode_count=10, skeleton_id=0,
            grown="unique", reason=None, key_distance=0.0, yaw_deg=0.0, mirror=0, scale=1.0,
        ),
        geometry=plants.geometry, crs=plants.crs,
    )  # fmt: skip
    trees.loc[0, "crown_radius_m"] = 0.0
    trees.loc[1, "reason"] = "out_of_focus"
    records = read_layer(register, "provenance")
    grow = provenance_frame(register, Record("grow", 0, "grow", UTM, {}, [{"name": "place", "sha256": "place"}]))
    both = pd.concat((records, grow[grow["stage"] == "grow"]), ignore_index=True)
    write_layers(register, {"trees": trees, "provenance": both})
    summary = evaluate_register(register, coverage=path)
    assert summary.coverage.crowns == GROWN
    assert 0.2 < named(summary)[PLACED].total_ratio.value < 0.45
    assert named(summary)[PLACED].plants == 199
    assert summary.notices.count("W_NOT_GROWN") == 1
    again = evaluate_register(register, coverage=path, envelopes=True)
    assert again.coverage.crowns == ENVELOPE
    assert named(again)[PLACED].total_ratio.value == pytest.approx(1, abs=0.01)
    beside = evaluate_register(register, coverage=path, rules=Path(young))
    assert beside.coverage.crowns == ENVELOPE, "sets are held against the map by the same kind of radius"
    assert named(beside)[RULES].iou == named(beside)[PLACED].iou


def test_a_register_planted_by_rules_stands_beside_it(crowned, map_file, tmp_path):
    register, path, _, _ = crowned
    rules = tmp_path / "rules.gpkg"
    shutil.copy(register, rules)
    plants = read_layer(rules, "plants")
    moved = shapely.transform(plants.geometry.to_numpy(), lambda xy: xy + np.array([0.00004, 0.00002]))
    write_layers(rules, {"plants": plants.set_geometry(moved, crs=plants.crs)})
    summary = evaluate_register(register, coverage=path, rules=rules)
    assert list(named(summary)) == [PLACED, RULES, SHUFFLED, RANDOM]
    assert named(summary)[RULES].iou.value < 0.8
    assert summary.coverage.gains[0].over == RULES
    assert summary.coverage.gains[0].iou.low > 0.1
    with pytest.raises((SchemaError, InputError)):
        evaluate_register(register, coverage=path, rules=path)


def test_tiles_are_counted_beside_the_lots(planted, tmp_path):
    register, city = planted
    tiles = gpd.GeoDataFrame(
        geometry=[shapely.box(500_000, 5_300_000, 500_170, 5_300_040),
                  shapely.box(500_180, 5_300_000, 500_700, 5_300_040)], crs=UTM,
    )  # fmt: skip
    tiles.to_crs(4326).to_file(tmp_path / "tiles.geojson")
    summary = evaluate_register(register, observed=str(city), tiles=str(tmp_path / "tiles.geojson"))
    assert summary.tiles.real == [36, 72]
    assert summary.tiles.model == [60, 140]
    assert summary.as_record()["tiles"]["ratio"] == pytest.approx(200 / 108)


def test_the_command_tells_json_tables_and_one_page(crowned, planted, runner, tmp_path):
    register, path, _, _ = crowned
    _, city = planted
    page = tmp_path / "page.png"
    text = runner("evaluate", register, "--coverage", path, "--observed", city, "--plot", page)
    assert text.exit_code == 0, text.stderr
    for words in ("Crowns against the map", "in common", "shuffled", "Better than random", "Counts"):
        assert words in text.stdout
    with Image.open(page) as picture:
        assert picture.height > 1500
    record = json.loads(runner("evaluate", register, "--coverage", path, "--json").stdout)
    assert record["evaluation"] is None
    assert record["coverage"]["sets"][0]["iou"]["value"] > 0.98
    assert runner("evaluate", register).exit_code == 2
    assert runner("evaluate", register, "--observed", city, "--rules", register).exit_code == 2
    assert runner("evaluate", register, "--coverage", path, "--tiles", city).exit_code == 2
    assert runner("evaluate", register, "--coverage", path, "--image", path).exit_code == 2
