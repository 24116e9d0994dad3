import json

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.files import geojson
from urbanforest_cli.files.geojson import bounding_box, read_plants, write_points

NASTY = [
    "plain",
    'quo"te',
    "back\\slash",
    "new\nline",
    "\x00\x01\x1f",
    "</script>",
    "日本語",
    "😀",
    "\u2028",
    "%s%%",
    "",
]


def frame(count: int) -> tuple[np.ndarray, pd.DataFrame]:
    rng = np.random.default_rng(0)
    degrees = np.column_stack((rng.uniform(-180, 180, count) / 10, rng.uniform(-80, 80, count)))
    return degrees, pd.DataFrame({"plant_id": [f"a-{i}" for i in range(count)], "age_years": rng.random(count) * 50})


def test_points_come_back_where_they_were(tmp_path):
    degrees, properties = frame(500)
    write_points(tmp_path / "p.geojson", degrees, properties)
    back = gpd.read_file(tmp_path / "p.geojson")
    assert back.crs.to_epsg() == 4326
    assert back["plant_id"].tolist() == properties["plant_id"].tolist()
    assert np.abs(np.column_stack((back.geometry.x, back.geometry.y)) - degrees).max() <= 5.1e-8
    assert np.abs(back["age_years"] - properties["age_years"]).max() <= 5.1e-4


def test_chunks_make_no_difference(tmp_path, monkeypatch):
    degrees, properties = frame(23)
    write_points(tmp_path / "one.geojson", degrees, properties)
    monkeypatch.setattr(geojson, "CHUNK_ROWS", 5)
    write_points(tmp_path / "many.geojson", degrees, properties)
    assert (tmp_path / "one.geojson").read_bytes() == (tmp_path / "many.geojson").read_bytes()


def test_any_text_comes_back_exactly(tmp_path):
    texts = [*NASTY, "lone \ud800 surrogate"]
    degrees = np.zeros((len(texts), 2))
    write_points(tmp_path / "p.geojson", degrees, pd.DataFrame({'a%b"c': pd.Series(texts, dtype=object)}))
    content = json.loads((tmp_path / "p.geojson").read_text(encoding="utf-8"))
    assert [feature["properties"]['a%b"c'] for feature in content["features"]] == texts


def test_missing_and_infinite_values_are_null(tmp_path):
    properties = pd.DataFrame(
        {"x": [1.5, np.nan, np.inf], "t": ["a", None, "nan"], "n": [1, 2, 3], "b": [True, False, True]}
    )
    write_points(tmp_path / "p.geojson", np.zeros((3, 2)), properties)
    rows = [f["properties"] for f in json.loads((tmp_path / "p.geojson").read_text())["features"]]
    assert rows == [
        {"x": 1.5, "t": "a", "n": 1, "b": True},
        {"x": None, "t": None, "n": 2, "b": False},
        {"x": None, "t": "nan", "n": 3, "b": True},
    ]


def test_the_collection_follows_rfc_7946(tmp_path):
    degrees = np.array([[2.5, 48.9], [2.1, 49.25]])
    write_points(tmp_path / "p.geojson", degrees, pd.DataFrame({"n": [1, 2]}), members={"provenance": {"seed": 3}})
    content = json.loads((tmp_path / "p.geojson").read_text())
    assert content["type"] == "FeatureCollection"
    assert content["bbox"] == [2.1, 48.9, 2.5, 49.25]
    assert content["provenance"] == {"seed": 3}
    assert "crs" not in content
    assert content["features"][0]["geometry"] == {"type": "Point", "coordinates": [2.5, 48.9]}


def test_coordinates_have_at_most_seven_decimals_and_no_exponent(tmp_path):
    write_points(tmp_path / "p.geojson", np.array([[1e-9, -1e-9], [1 / 3, 2e-7]]), pd.DataFrame(index=range(2)))
    text = (tmp_path / "p.geojson").read_text()
    assert "[0.0000000,0.0000000]" in text
    assert "[0.3333333,0.0000002]" in text


def test_points_on_both_sides_of_longitude_180_have_west_above_east():
    assert bounding_box(np.array([[179.5, -17.0], [-179.5, -16.0]])) == [179.5, -17.0, -179.5, -16.0]


def test_no_points_make_an_empty_collection(tmp_path):
    write_points(tmp_path / "p.geojson", np.zeros((0, 2)), pd.DataFrame({"a": []}))
    content = json.loads((tmp_path / "p.geojson").read_text())
    assert content == {"type": "FeatureCollection", "features": []}


def test_a_file_that_lost_features_is_not_published(tmp_path, monkeypatch):
    path = tmp_path / "p.geojson"
    path.write_text("old")
    lines = geojson.feature_lines
    monkeypatch.setattr(geojson, "feature_lines", lambda *a: list(lines(*a))[:-1])
    with pytest.raises(OutputError, match="not written whole"):
        write_points(path, *frame(7))
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["p.geojson"]


def test_plants_are_read_with_their_heights_and_those_that_do_not_stand_have_none(tmp_path):
    degrees, properties = frame(50)
    write_points(tmp_path / "p.geojson", degrees, properties.assign(height_m=[np.nan, *range(1, 50)]))
    plants = read_plants(tmp_path / "p.geojson")
    assert plants.crs.to_epsg() == 4326
    assert plants.plant_id.tolist() == properties["plant_id"].tolist()
    assert np.abs(plants.xyz_m[:, :2] - degrees).max() <= 5.1e-8
    assert np.isnan(plants.height_m[0])
    assert plants.height_m[1:].tolist() == list(range(1, 50))


def test_an_empty_collection_has_no_plants(tmp_path):
    write_points(tmp_path / "p.geojson", *(part[:0] for part in frame(3)))
    assert len(read_plants(tmp_path / "p.geojson")) == 0


@pytest.mark.parametrize(
    "text",
    ["", "[]", "5", '{"features": 5}', '{"features": [{}]}', '{"features": [{"properties": null, "geometry": null}]}',
     '{"features": [{"properties": {"plant_id": "a"}, "geometry": {"coordinates": [1]}}]}',
     '{"features": [{"properties": {"plant_id": "a"}, "geometry": {"coordinates": [[1], "x"]}}]}', "[" * 100_000],
)  # fmt: skip
def test_what_is_no_collection_of_plants_is_an_input_error(tmp_path, text):
    (tmp_path / "p.geojson").write_text(text)
    with pytest.raises(InputError, match="not a whole GeoJSON"):
        read_plants(tmp_path / "p.geojson")
    with pytest.raises(InputError, match="cannot be read"):
        read_plants(tmp_path / "nowhere.geojson")
