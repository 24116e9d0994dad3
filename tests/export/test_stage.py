import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from PIL import Image
from pyproj import CRS

from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.export.stage import OUTPUTS, export_key, export_outputs
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record

FEET = 2263
WORKING = CRS.from_epsg(32618)
ODD_ID = "<b>$a_1$ \u65e5\u672c"


@pytest.fixture(scope="module")
def config():
    return load_config(settings=["export.map_width_px=400"], environment={}).config


@pytest.fixture(scope="module")
def register(tmp_path_factory, config):
    """Two lots in US feet, one with two plants and an odd name."""
    corner = np.array([1_005_000.0, 220_000.0])
    squares = [
        shapely.affinity.translate(shapely.box(0, 0, 190, 190), corner[0] + 200 * i, corner[1]) for i in range(2)
    ]
    ids = [ODD_ID, "b"]
    lots = gpd.GeoDataFrame(
        {
            "lot_id": ids,
            "zone": ["residential", "moat"],
            "origin": "register",
            "area_m2": 3350.0,
            "plantable_area_m2": 3000.0,
            "covered_fraction": np.nan,
        },
        geometry=squares,
        crs=FEET,
    )
    areas = gpd.GeoDataFrame({"lot_id": ids, "kind": "lot", "area_m2": 3000.0}, geometry=squares, crs=FEET)
    values = {p.name: p.default for p in PARAMETERS.values()}
    parameters = pd.DataFrame(
        {
            "lot_id": ids,
            "strategy": "random",
            "source": "zone",
            "context_lot_count": 1,
            **values,
            **{f"resolved_{name}": value for name, value in values.items()},
        }
    )
    plants = gpd.GeoDataFrame(
        {
            "plant_id": ["x-0", "x-1"],
            "lot_id": ODD_ID,
            "species": ["tilia_cordata", "unheard_of"],
            "habit": ["tree", "shrub"],
            "age_years": [10.0, 2.0],
            "envelope_radius_m": [4.0, 1.0],
            "pruning_factor": 1.0,
        },
        geometry=shapely.points(corner + np.array([[60, 60], [120, 120]])),
        crs=FEET,
    )
    placements = pd.DataFrame(
        {
            "lot_id": ids,
            "outcome": ["planted", "no_position"],
            "position_count": [2, 0],
            "plant_count": [2, 0],
            "radius_mean_m": [2.5, np.nan],
            "radius_variance_m2": [4.5, np.nan],
            "dominant_species": ["tilia_cordata", None],
            "place_key": ["k", "k"],
        }
    )
    skipped = pd.DataFrame({"lot_id": ["b"], "stage": ["place"], "reason": ["no_position"], "detail": ["none"]})
    record = {"seed": 5, "working_crs": WORKING, "config": config.model_dump(mode="json")}
    provenance = pd.DataFrame([
        Record("stencil", stage_key="k1", inputs=[{"name": "town.gpkg", "sha256": "ab" * 32}], **record).as_row(),
        Record("place", stage_key="k2", inputs=[{"name": "stencil", "sha256": "k1"}], **record).as_row(),
    ])  # fmt: skip
    path = tmp_path_factory.mktemp("register") / "register.gpkg"
    layers = {"lots": lots, "active_areas": areas, "parameters": parameters, "plants": plants}
    write_layers(path, {**layers, "placements": placements, "skipped": skipped, "provenance": provenance}, fresh=True)
    return path


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """The lots' city: one building over the second lot, with a height in words, and a road that is not finite."""
    path = tmp_path_factory.mktemp("city") / "town_of_feet.gpkg"
    house = gpd.GeoDataFrame(
        {"Height_M": ["tall"]}, geometry=[shapely.box(1_005_220, 220_020, 1_005_320, 220_120)], crs=FEET
    )
    roads = gpd.GeoDataFrame(
        {"width_m": [5.0, -1.0]},
        crs=FEET,
        geometry=[shapely.LineString([(1_005_000, 219_980), (1_005_400, 219_980)]), None],
    )
    write_layers(path, {"buildings": house, "roads": roads}, fresh=True,
                 geometry_types={"buildings": "Polygon", "roads": "LineString"})  # fmt: skip
    return path


@pytest.fixture(scope="module")
def exported(register, city, tmp_path_factory, config):
    out = tmp_path_factory.mktemp("exported")
    return out, export_outputs(register, out, config=config, city=city, key="the key")


def test_every_output_is_written_and_the_report_vouches_for_the_others(exported):
    out, summary = exported
    assert sorted(path.name for path in out.iterdir()) == sorted(OUTPUTS)
    assert summary.counts["plants"] == 2
    report = json.loads((out / "report.json").read_text())
    assert report["export_key"] == "the key"
    assert report["title"] == "Town of feet"
    named = {item["name"]: item for item in report["outputs"]}
    assert set(named) == {"register.gpkg", "plants.geojson", "map.png", "report.html"}
    for name in ("plants.geojson", "map.png", "report.html"):
        assert named[name]["sha256"] == sha256_of(out / name)
        assert named[name]["bytes"] == (out / name).stat().st_size


def test_points_in_feet_come_out_as_longitude_and_latitude(exported):
    out, _ = exported
    found = gpd.read_file(out / "plants.geojson").to_crs(FEET)
    assert found["plant_id"].tolist() == ["x-0", "x-1"]
    assert found["lot_id"].tolist() == [ODD_ID, ODD_ID]
    places = np.column_stack((found.geometry.x, found.geometry.y)) - [1_005_000, 220_000]
    assert np.abs(places - [[60, 60], [120, 120]]).max() < 0.05


def test_each_output_carries_its_provenance(exported):
    out, _ = exported
    for name in OUTPUTS:
        record = describe_output(out / name)
        assert record["seed"] == 5
        assert record["inputs"] == [{"name": "town.gpkg", "sha256": "ab" * 32}]
        assert record["stage_keys"] == {"stencil": "k1", "place": "k2"}


def test_the_map_is_as_wide_as_the_config_says(exported):
    with Image.open(exported[0] / "map.png") as picture:
        assert picture.width == 400


def test_equal_content_is_equal_bytes_where_the_date_is_fixed(register, city, tmp_path, config, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for folder, seconds in (("one", 1.0), ("two", 2.0)):
        told = {"stage": "place", "output": folder, "seconds": seconds, "counts": {"reused": seconds}, "warnings": []}
        export_outputs(register, tmp_path / folder, config=config, city=city, summaries=[told])
    for name in OUTPUTS:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_odd_names_reach_the_page_escaped(exported):
    page = (exported[0] / "report.html").read_text(encoding="utf-8")
    assert ODD_ID not in page
    assert "unheard_of" in page


def test_a_register_without_plants_names_the_command_that_makes_them(register, tmp_path, config):
    copy = shutil.copy(register, tmp_path / "copy.gpkg")
    with closing(sqlite3.connect(copy)) as database, database:
        database.execute("DELETE FROM provenance WHERE stage = 'place'")
    with pytest.raises(SchemaError, match="urbanforest place"):
        export_outputs(Path(copy), tmp_path / "out", config=config)
    assert not (tmp_path / "out").exists()


def test_the_key_hangs_on_what_is_shown_alone(config):
    wider = load_config(settings=["export.map_width_px=401"], environment={}).config
    denser = load_config(settings=["export.map_width_px=400", "context.passes=3"], environment={}).config
    assert export_key("p", config=config, seed=1) != export_key("p", config=wider, seed=1)
    assert export_key("p", config=config, seed=1) != export_key("q", config=config, seed=1)
    assert export_key("p", config=config, seed=1) == export_key("p", config=denser, seed=1)
