import geopandas as gpd
import pytest
import shapely

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.city import city_inputs, inputs_beside, read_city, read_known_plants


def frame_of(*shapes, **columns):
    return gpd.GeoDataFrame(columns, geometry=list(shapes), crs="EPSG:32611")


@pytest.fixture
def city(tmp_path):
    path = tmp_path / "city.gpkg"
    frame_of(shapely.box(0, 0, 20, 30), shapely.box(20, 0, 40, 30)).to_file(path, layer="Lots")
    frame_of(shapely.box(5, 5, 10, 10)).to_file(path, layer="buildings")
    frame_of(shapely.LineString([(0, -5), (40, -5)])).to_file(path, layer="roads")
    return path


def test_lots_are_found_by_their_name_and_others_beside_them(city):
    lots, layers = read_city(city, None, None, Notices())
    assert len(lots) == 2
    assert {name: len(frame) for name, frame in layers.items()} == {"buildings": 1, "roads": 1}


def test_a_register_is_no_city(city):
    register = city.with_name("register.gpkg")
    for layer in ("lots", "active_areas"):
        frame_of(shapely.box(0, 0, 1, 1)).to_file(register, layer=layer)
    with pytest.raises(InputError, match="this is a register"):
        read_city(register, None, None, Notices())


def test_known_plants_are_asked_for_in_vain_where_there_are_none(city):
    with pytest.raises(InputError, match="observed_plants"):
        read_known_plants(city, "EPSG:32611", Notices())
    frame_of(shapely.Point(3, 3)).to_file(city, layer="observed_plants")
    assert len(read_known_plants(city, "EPSG:32611", Notices())) == 1


def test_all_files_of_a_shapefile_count_as_input(tmp_path):
    path = tmp_path / "city.shp"
    frame_of(shapely.box(0, 0, 20, 30), name=["a"]).to_file(path)
    before = city_inputs(path)
    assert {item["name"] for item in before} >= {"city.shp", "city.shx", "city.dbf", "city.prj"}
    with path.with_suffix(".dbf").open("ab") as stream:
        stream.write(b"\0")
    assert city_inputs(path) != before


def test_what_says_where_a_picture_lies_counts_as_input(tmp_path):
    picture = tmp_path / "sketch.png"
    picture.write_bytes(b"png")
    assert [item["name"] for item in inputs_beside(picture)] == ["sketch.png"]
    picture.with_suffix(".pgw").write_text("1")
    assert [item["name"] for item in inputs_beside(picture)] == ["sketch.png", "sketch.pgw"]


def test_a_map_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        inputs_beside(tmp_path / "none.tif")


def test_all_files_of_a_shapefile_count(tmp_path):
    for suffix in (".shp", ".dbf", ".shx"):
        (tmp_path / f"sketch{suffix}").write_bytes(suffix.encode())
    before = inputs_beside(tmp_path / "sketch.shp")
    (tmp_path / "sketch.dbf").write_bytes(b"changed")
    assert {item["name"] for item in before} == {"sketch.shp", "sketch.dbf", "sketch.shx"}
    assert inputs_beside(tmp_path / "sketch.shp") != before
