import json
import re
import sqlite3
import xml.etree.ElementTree as ElementTree
from contextlib import closing

import geopandas as gpd
import pandas as pd
import pyogrio
import pytest
import shapely

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.zones import ZONE_COLOURS
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.files.styles import write_styles

CRS = 2263


def frames(zone: str = "residential", species: str = "tilia_cordata") -> dict[str, pd.DataFrame]:
    square = shapely.box(0, 0, 10, 10)
    lots = {"lot_id": ["a"], "zone": [zone], "origin": ["register"], "area_m2": [9.0], "plantable_area_m2": [9.0]}
    plants = {"plant_id": ["a-0"], "lot_id": ["a"], "species": [species], "habit": ["tree"], "age_years": [3.0],
              "envelope_radius_m": [2.0], "pruning_factor": [1.0]}  # fmt: skip
    return {
        "lots": gpd.GeoDataFrame(
            {**lots, "covered_fraction": [float("nan")], "seen_fraction": [float("nan")]}, geometry=[square], crs=CRS
        ),
        "active_areas": gpd.GeoDataFrame(
            {"lot_id": ["a"], "kind": ["lot"], "area_m2": [9.0]}, geometry=[square], crs=CRS
        ),
        "plants": gpd.GeoDataFrame(plants, geometry=[shapely.Point(5, 5)], crs=CRS),
    }


def rows(path, query="SELECT * FROM layer_styles ORDER BY f_table_name"):
    with closing(sqlite3.connect(path)) as database:
        database.row_factory = sqlite3.Row
        return [dict(row) for row in database.execute(query)]


def style(path, layer):
    (row,) = rows(path, f"SELECT * FROM layer_styles WHERE f_table_name = '{layer}' AND styleName = 'urbanforest'")
    return ElementTree.fromstring(row["styleQML"].split("\n", 1)[1])


def colours_by_value(qml):
    symbols = {symbol.get("name"): symbol for symbol in qml.iter("symbol")}
    found = {}
    for category in qml.iter("category"):
        red, green, blue, _ = symbols[category.get("symbol")].find("layer/prop[@k='color']").get("v").split(",")
        found[category.get("value")] = f"#{int(red):02x}{int(green):02x}{int(blue):02x}"
    return found


@pytest.fixture
def register(tmp_path):
    path = tmp_path / "register.gpkg"
    write_layers(path, frames(), fresh=True)
    return path


@pytest.fixture
def grown(tmp_path):
    """A register with one tree of an unknown species, grown, and a building."""
    path = tmp_path / "register.gpkg"
    tree = {"plant_id": "a-0", "lot_id": "a", "species": "<oak>", "habit": "tree", "age_years": 3.0, "height_m": 4.0,
            "crown_radius_m": 1.5, "crown_base_m": 1.0, "dbh_m": 0.03, "internode_count": 40, "skeleton_id": 7,
            "grown": "unique", "reason": None, "key_distance": float("nan"), "yaw_deg": 0.0, "mirror": 0,
            "scale": 1.0}  # fmt: skip
    house = gpd.GeoDataFrame(
        {"building_id": ["h"], "height_m": [6.0]}, geometry=[shapely.MultiPolygon([shapely.box(0, 0, 1, 1)])], crs=CRS
    )
    trees = gpd.GeoDataFrame({name: [value] for name, value in tree.items()}, geometry=[shapely.Point(5, 5)], crs=CRS)
    write_layers(path, {"trees": trees, "buildings": house}, fresh=True)
    return path


def test_each_layer_has_one_default_style_under_its_own_geometry_column(register):
    found = rows(register)
    assert [row["f_table_name"] for row in found] == ["active_areas", "lots", "plants"]
    assert {row["f_geometry_column"] for row in found} == {"geom"}
    assert {row["useAsDefault"] for row in found} == {1}


def test_lots_are_coloured_by_zone_and_plants_by_species(register):
    lots = style(register, "lots")
    assert lots.find("renderer-v2").get("attr") == "zone"
    assert {zone: colours_by_value(lots)[zone] for zone in ZONE_COLOURS} == ZONE_COLOURS
    plants = style(register, "plants")
    assert plants.find("renderer-v2").get("attr") == "species"
    catalogue = {item.id: item.colour for item in load_catalogue(settings.Species())}
    assert {name: colours_by_value(plants)[name] for name in catalogue} == catalogue


def test_crowns_are_as_wide_on_the_ground_as_the_envelope_in_any_unit(register):
    for symbol in style(register, "plants").iter("symbol"):
        properties = {prop.get("k"): prop.get("v") for prop in symbol.iter("prop")}
        assert properties["size_unit"] == "RenderMetersInMapUnits"
        assert properties["scale_method"] == "diameter"
        expression = symbol.find(".//Option[@name='size']/Option[@name='expression']").get("value")
        assert expression == '2 * "envelope_radius_m"'


def test_colours_of_the_config_inside_are_used(tmp_path):
    path = tmp_path / "register.gpkg"
    config = {"zones": {"residential": {"colour": "#123456"}, "moat": {"colour": "#654321"}}}
    record = {"stage": "stencil", "register_version": 1, "program_version": "0", "seed": "0", "stage_key": "k",
              "working_crs": "", "config": json.dumps(config), "inputs": "[]", "counts": "{}", "warnings": "[]",
              "written_at": "2026-01-01"}  # fmt: skip
    write_layers(path, {**frames(zone="moat"), "provenance": pd.DataFrame([record])}, fresh=True)
    found = colours_by_value(style(path, "lots"))
    assert found["residential"] == "#123456"
    assert found["moat"] == "#654321"


def test_names_from_data_cannot_break_the_style(tmp_path):
    path = tmp_path / "register.gpkg"
    nasty = '<a b="c">&\'\n\x07'
    write_layers(path, frames(zone=nasty, species='<&">'), fresh=True)
    assert nasty not in colours_by_value(style(path, "lots"))  # no XML holds a bell: the look of all others applies
    assert '<&">' in colours_by_value(style(path, "plants"))


def test_writing_twice_changes_nothing(register):
    before = rows(register)
    write_styles(register, ["lots", "active_areas", "plants"])
    assert rows(register) == before


def test_a_style_of_the_user_stays_the_default(register):
    with closing(sqlite3.connect(register)) as database, database:
        database.execute("UPDATE layer_styles SET useAsDefault = 0 WHERE f_table_name = 'lots'")
        database.execute(
            "INSERT INTO layer_styles (f_table_name, f_geometry_column, styleName, styleQML, useAsDefault) "
            "VALUES ('lots', 'geom', 'mine', '<qgis/>', 1)"
        )
    write_styles(register, ["lots"])
    found = {row["styleName"]: row["useAsDefault"] for row in rows(register) if row["f_table_name"] == "lots"}
    assert found == {"mine": 1, "urbanforest": 0}


def test_the_table_is_registered_and_counted(register):
    assert [
        row["data_type"] for row in rows(register, "SELECT * FROM gpkg_contents WHERE table_name = 'layer_styles'")
    ] == ["attributes"]
    assert len(pyogrio.read_dataframe(register, layer="layer_styles")) == 3
    counted = rows(register, "SELECT feature_count FROM gpkg_ogr_contents WHERE table_name = 'layer_styles'")
    assert counted == [{"feature_count": 3}]


def test_layers_without_a_style_leave_the_file_alone(tmp_path):
    path = tmp_path / "city.gpkg"
    houses = gpd.GeoDataFrame({"height_m": [3.0]}, geometry=[shapely.box(0, 0, 1, 1)], crs=CRS)
    write_layers(path, {"buildings": houses}, fresh=True, geometry_types={"buildings": "Polygon"})
    assert "layer_styles" not in pyogrio.list_layers(path)[:, 0]


def test_grown_crowns_are_at_their_true_size_low_ones_under_high_ones(grown):
    trees = style(grown, "trees")
    assert trees.get("styleCategories") == "Symbology|MapTips"
    assert trees.find("renderer-v2").get("attr") == "species"
    assert trees.find("renderer-v2").get("enableorderby") == "1"
    assert trees.find("renderer-v2/orderby/orderByClause").text == '"height_m"'
    for symbol in trees.iter("symbol"):
        properties = {prop.get("k"): prop.get("v") for prop in symbol.iter("prop")}
        assert properties["size_unit"] == "RenderMetersInMapUnits"
        expression = symbol.find(".//Option[@name='size']/Option[@name='expression']").get("value")
        assert expression == '2 * "crown_radius_m"'
    assert colours_by_value(trees)["<oak>"] != colours_by_value(trees)[""]


def test_the_tip_of_a_grown_plant_names_columns_that_are_there(grown):
    tip = style(grown, "trees").find("mapTip")
    assert tip.get("enabled") == "1"
    columns = set(pyogrio.read_dataframe(grown, layer="trees").columns)
    assert set(re.findall(r'"(\w+)"', tip.text)) <= columns
    assert tip.text.count("[%") == tip.text.count("%]") > 3


def test_roads_of_a_register_are_filled_without_an_outline(tmp_path):
    road = gpd.GeoDataFrame(
        {"road_id": ["r"], "width_m": [6.0]}, geometry=[shapely.MultiPolygon([shapely.box(0, 0, 9, 6)])], crs=CRS
    )
    write_layers(tmp_path / "register.gpkg", {"roads": road}, fresh=True)
    roads = style(tmp_path / "register.gpkg", "roads")
    assert list(colours_by_value(roads)) == [""]
    assert roads.find(".//prop[@k='outline_style']").get("v") == "no"


def test_buildings_of_a_register_are_filled_without_labels(grown):
    buildings = style(grown, "buildings")
    assert list(colours_by_value(buildings)) == [""]
    assert buildings.get("styleCategories") == "Symbology"


def test_regions_and_known_plants_of_a_register_have_a_look_of_their_own(tmp_path):
    square = shapely.MultiPolygon([shapely.box(0, 0, 9, 6)])
    region = {"lot_id": ["a"], "area_m2": [5.0], "inside_m2": [4.0], "region_count": [1], "coverage": [1.0]}
    known = {
        "observed_id": ["t"],
        "lot_id": ["a"],
        "crown_radius_m": [float("nan")],
        "height_m": [4.0],
        "species": [None],
    }
    path = tmp_path / "register.gpkg"
    layers = {
        "regions": gpd.GeoDataFrame(region, geometry=[square], crs=CRS),
        "observed": gpd.GeoDataFrame(known, geometry=[shapely.Point(5, 5)], crs=CRS),
    }
    write_layers(path, layers, fresh=True)
    tip = style(path, "regions").find("mapTip").text
    assert set(re.findall(r'"(\w+)"', tip)) <= set(region)
    ring = style(path, "observed")
    assert ring.find(".//prop[@k='color']").get("v").endswith(",0")
    assert ring.find(".//Option[@name='size']/Option[@name='expression']").get("value") == (
        '2 * coalesce("crown_radius_m", 1)'
    )
