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
from urbanforest_cli.files.provenance import Record, provenance_frame

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
            "seen_fraction": np.nan,
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
    house = gpd.GeoDataFrame(
        {"building_id": ["h"], "height_m": [None]},
        geometry=[shapely.box(1_005_220, 220_020, 1_005_320, 220_120)],
        crs=FEET,
    ).astype({"height_m": float})
    roads = gpd.GeoDataFrame(
        {"road_id": ["r"], "width_m": [5.0]}, geometry=[shapely.box(1_005_000, 219_970, 1_005_400, 219_990)], crs=FEET
    )
    layers = {"lots": lots, "active_areas": areas, "parameters": parameters, "plants": plants, "buildings": house}
    layers["roads"] = roads
    write_layers(path, {**layers, "placements": placements, "skipped": skipped, "provenance": provenance}, fresh=True)
    return path


@pytest.fixture(scope="module")
def exported(register, tmp_path_factory, config):
    out = tmp_path_factory.mktemp("exported")
    return out, export_outputs(register, out, config=config, key="the key")


def test_every_output_is_written_and_the_report_vouches_for_the_others(exported):
    out, summary = exported
    assert sorted(path.name for path in out.iterdir()) == sorted(OUTPUTS)
    assert summary.counts["plants"] == 2
    report = json.loads((out / "report.json").read_text())
    assert report["export_key"] == "the key"
    assert report["title"] == "Town"
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


def test_equal_content_is_equal_bytes_where_the_date_is_fixed(register, tmp_path, config, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for folder, seconds in (("one", 1.0), ("two", 2.0)):
        told = {"stage": "place", "output": folder, "seconds": seconds, "counts": {"reused": seconds}, "warnings": []}
        export_outputs(register, tmp_path / folder, config=config, summaries=[told])
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


SIZES = ("height_m", "crown_radius_m", "crown_base_m", "dbh_m")


@pytest.fixture(params=[("unique", None, 4.5), ("dead", "died", 0.0), ("none", "out_of_focus", 0.0)])
def fate(request):
    """What became of the second plant: the layer's grown, reason and crown radius."""
    return request.param


def grow(register, fate, *, place="k2", plant_ids=("x-0", "x-1"), year=None):
    """Give the plants grown trees, the second with a fate."""
    plants = gpd.read_file(register, layer="plants")
    grown, reason, radius = fate
    columns = {"plant_id": list(plant_ids), "lot_id": plants["lot_id"], "species": plants["species"],
               "habit": plants["habit"], "age_years": plants["age_years"], "height_m": [12.5, 3 * radius],
               "crown_radius_m": [6.0, radius], "crown_base_m": [2.0, radius / 9], "dbh_m": [0.31, 0.0],
               "internode_count": [3000, int(40 * radius)], "skeleton_id": [1, 2], "grown": ["unique", grown],
               "reason": [None, reason], "key_distance": np.nan, "yaw_deg": 0.0, "mirror": 0, "scale": 1.0}  # fmt: skip
    counts = {"plants": 2, "detail": "unique", "bytes": 900, "library_compared": 7, "library_overlap_median": 0.61,
              "library_overlap_worst_tenth": 0.4,
              **{f"internodes_{name}": n for name, n in
                 (("generated", 5000), ("retained", 3000), ("shed", 1500), ("pruned", 500))}}  # fmt: skip
    config = {"growth": {"environment": "both"}} | ({"year": year} if year is not None else {})
    record = Record("grow", seed=5, working_crs=WORKING, config=config, stage_key="k3", counts=counts,
                    inputs=[{"name": "place", "sha256": place}])  # fmt: skip
    trees = gpd.GeoDataFrame(columns, geometry=plants.geometry, crs=plants.crs)
    write_layers(register, {"trees": trees, "provenance": provenance_frame(register, record)})


@pytest.fixture
def own(register, tmp_path):
    return Path(shutil.copy(register, tmp_path / "register.gpkg"))


def features(path):
    return [feature["properties"] for feature in json.loads(path.read_text())["features"]]


def test_grown_sizes_go_out_with_the_plants(own, tmp_path, config, fate):
    grow(own, fate)
    export_outputs(own, tmp_path / "out", config=config)
    first, second = features(tmp_path / "out" / "plants.geojson")
    assert [first[name] for name in SIZES] == [12.5, 6.0, 2.0, 0.31]
    assert (first["grown"], first["reason"]) == ("unique", None)
    assert (second["grown"], second["reason"]) == fate[:2]
    radius = None if fate[1] == "out_of_focus" else fate[2]
    assert second["crown_radius_m"] == radius
    assert second["envelope_radius_m"] == 1.0


def test_the_map_draws_crowns_as_they_grew(own, tmp_path, config, fate, monkeypatch):
    seen = []
    monkeypatch.setattr("urbanforest_cli.export.stage.draw_map", lambda layers, **rest: seen.append((layers, rest)))
    monkeypatch.setattr("urbanforest_cli.export.stage.png_of", lambda *rest: (_ for _ in ()).throw(StopAsking))
    grow(own, fate)
    with pytest.raises(StopAsking):
        export_outputs(own, tmp_path / "out", config=config)
    ((layers, rest),) = seen
    envelope = 1.0
    assert layers.plant_radius_m.tolist() == [6.0, envelope if fate[1] == "out_of_focus" else fate[2]]
    assert "as they grew" in rest["notes"][0]


class StopAsking(Exception):
    """No more than the map is wanted."""


def test_the_report_tells_of_growth(own, tmp_path, config, fate):
    grow(own, fate, year=30)
    export_outputs(own, tmp_path / "out", config=config)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    growth = report["growth"]
    fates = {row["fate"]: row["plants"] for row in growth["fates"]}
    assert sum(fates.values()) == growth["plants"] == 2
    assert fates["unique"] == (2 if fate[0] == "unique" else 1)
    assert fates.get(fate[1] or "unique") >= 1
    assert growth["internodes"] == 3000 + (180 if fate[0] == "unique" else 0)
    assert growth["internodes_grown"] == {"generated": 5000, "retained": 3000, "shed": 1500, "pruned": 500}
    lime = next(row for row in growth["species"] if row["species"] == "tilia_cordata")
    assert (lime["height_median_m"], lime["crown_diameter_median_m"], lime["dbh_median_m"]) == (12.5, 12.0, 0.31)
    assert growth["library"]["compared"] == 7
    assert growth["library"]["figures"][0]["median"] == 0.61
    assert growth["year"] == report["provenance"]["year"] == 30
    radius = 1.0 if fate[1] == "out_of_focus" else fate[2]
    crowns = np.pi * (6.0**2 + radius**2) / 6700.0
    assert report["headline"]["crown_share"] == pytest.approx(crowns, abs=2e-4)
    page = (tmp_path / "out" / "report.html").read_text()
    for text in ("Growth", "light and room", "3,000 internodes" if fate[0] != "unique" else "3,180 internodes",
                 "shown in year 30", "held against 7 plants", "overlap"):  # fmt: skip
        assert text in page


@pytest.mark.parametrize("stale", [{"place": "k-older"}, {"plant_ids": ("x-1", "x-0")}])
def test_trees_of_an_older_placement_are_left_out_and_counted(own, tmp_path, config, stale):
    grow(own, ("unique", None, 4.5), **stale)
    summary = export_outputs(own, tmp_path / "out", config=config)
    assert summary.notices.count("W_TREES_STALE") == 1
    assert "height_m" not in features(tmp_path / "out" / "plants.geojson")[0]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["growth"] is None
    assert "<h2>Growth</h2>" not in (tmp_path / "out" / "report.html").read_text()


def test_a_register_that_has_not_grown_is_exported_with_envelopes(exported):
    out, summary = exported
    assert len(summary.notices) == 0
    assert "height_m" not in features(out / "plants.geojson")[0]
    assert json.loads((out / "report.json").read_text())["growth"] is None
