"""Foreign vector files: what is read is whole, what is not is refused by name."""

from __future__ import annotations

import json
import os
import sqlite3
import struct
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from shapely.geometry import LineString, Point, box

from urbanforest_cli.core.errors import CrsError, InputError, LimitError, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.vectors import list_vector_layers, read_vector, split_source

CRS = "EPSG:32631"


def squares(count: int = 3, **columns: object) -> gpd.GeoDataFrame:
    shapes = [box(500_000 + 20 * i, 4_000_000, 500_010 + 20 * i, 4_000_010) for i in range(count)]
    return gpd.GeoDataFrame(dict(columns), geometry=shapes, crs=CRS)


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(frame: gpd.GeoDataFrame, name: str = "lots.gpkg", **options: object) -> Path:
        path = tmp_path / name
        pyogrio.write_dataframe(frame, path, append=path.exists(), **options)
        return path

    return write


def geojson(path: Path, *shapes: dict[str, object] | None, **members: object) -> Path:
    features = [{"type": "Feature", "properties": {"n": n}, "geometry": shape} for n, shape in enumerate(shapes)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **members}))
    return path


def ring(*corners: tuple[float, float]) -> dict[str, object]:
    return {"type": "Polygon", "coordinates": [[list(corner) for corner in (*corners, corners[0])]]}


SQUARE = ring((2.0, 41.0), (2.1, 41.0), (2.1, 41.1), (2.0, 41.1))


@pytest.mark.parametrize("name", ["a.gpkg", "a.geojson", "a.shp", "a.fgb", "a.gml", "a.gdb", "a.parquet"])
def test_every_format_gives_the_same_rows(name: str, written: Callable[..., Path], tmp_path: Path) -> None:
    frame = squares(owner=["x", "é", "z"])
    if name == "a.parquet":
        path = tmp_path / name
        frame.to_parquet(path)
    elif name == "a.geojson":
        path = written(frame.to_crs(4326), name)
    else:
        path = written(frame, name, **({"driver": "OpenFileGDB"} if name == "a.gdb" else {}))
    before = sorted(tmp_path.rglob("*"))
    found = read_vector(path, notices=Notices()).sort_values("owner")  # FlatGeobuf keeps an order of its own
    frame = frame.sort_values("owner")
    assert found["owner"].tolist() == ["x", "z", "é"]
    assert found.crs is not None
    there = found.to_crs(CRS).geometry.to_numpy()
    assert shapely.area(shapely.symmetric_difference(there, frame.geometry.to_numpy())).max() < 0.1
    assert sorted(tmp_path.rglob("*")) == before, "reading left a file behind"


def test_long_identifiers_stay_exact_beside_missing_ones(written: Callable[..., Path]) -> None:
    ids = pd.array([2**53 + 1, None, 2**62 + 1], dtype="Int64")
    found = read_vector(written(squares(parcel=ids)), notices=Notices())
    assert found["parcel"].iloc[0] == 2**53 + 1
    assert found["parcel"].iloc[2] == 2**62 + 1
    assert found["parcel"].isna().tolist() == [False, True, False]


def test_rows_beyond_a_wrong_cached_count_are_read_and_told(written: Callable[..., Path]) -> None:
    path = written(squares(5))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE gpkg_ogr_contents SET feature_count = 2")
        database.commit()
    notices = Notices()
    assert len(read_vector(path, notices=notices)) == 5
    assert notices.count("W_ROW_COUNT") == 1


def test_two_polygon_layers_are_listed_and_one_can_be_named(written: Callable[..., Path]) -> None:
    written(squares(2), layer="one")
    path = written(squares(3), layer="two")
    with pytest.raises(InputError, match="which one is meant") as caught:
        read_vector(path, notices=Notices())
    assert "one, two" in str(caught.value)
    assert len(read_vector(path, layer="two", notices=Notices())) == 3
    assert [name for name, _ in list_vector_layers(path)] == ["one", "two"]


def test_the_one_polygon_layer_is_taken_among_others(written: Callable[..., Path]) -> None:
    written(gpd.GeoDataFrame(geometry=[Point(0, 0)], crs=CRS), layer="trees")
    path = written(squares(2), layer="parcels")
    assert len(read_vector(path, notices=Notices())) == 2


def test_a_layer_of_lines_holds_no_lots(written: Callable[..., Path]) -> None:
    path = written(gpd.GeoDataFrame(geometry=[LineString([(0, 0), (9, 9)])], crs=CRS))
    with pytest.raises(InputError, match="no polygon layer"):
        read_vector(path, notices=Notices())
    assert len(read_vector(path, kinds=("line",), notices=Notices())) == 1


def test_a_mistyped_layer_gets_a_suggestion(written: Callable[..., Path]) -> None:
    with pytest.raises(InputError, match="did you mean 'parcels'"):
        read_vector(written(squares(), layer="parcels"), layer="parcel", notices=Notices())


def test_heights_are_dropped_and_missing_geometries_counted(written: Callable[..., Path]) -> None:
    frame = squares()
    frame.geometry = [shapely.force_3d(frame.geometry[0], 7.0), None, frame.geometry[2]]
    notices = Notices()
    found = read_vector(written(frame), notices=notices)
    assert not found.geometry.iloc[0].has_z
    assert found.geometry.iloc[1] is None
    assert notices.count("W_NO_GEOMETRY") == 1


def test_an_open_ring_costs_its_own_row_only(tmp_path: Path) -> None:
    open_ring = {"type": "Polygon", "coordinates": [[[2, 41], [3, 41], [3, 42], [2, 42]]]}
    notices = Notices()
    found = read_vector(geojson(tmp_path / "a.geojson", SQUARE, open_ring, SQUARE), notices=notices)
    assert [shape is None for shape in found.geometry] == [False, True, False]
    assert notices.count("W_BROKEN_RING") == 1


def test_coordinates_that_are_no_numbers_are_kept_for_the_caller(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", SQUARE)
    path.write_text(path.read_text().replace("41.1", "NaN", 1))
    found = read_vector(path, notices=Notices())
    assert not np.isfinite(shapely.get_coordinates(found.geometry.to_numpy())).all()


def test_projected_numbers_under_the_name_of_degrees_are_refused(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", ring((500_000, 4_000_000), (500_010, 4_000_000), (500_010, 4_000_010)))
    with pytest.raises(CrsError, match="--assume-crs"):
        read_vector(path, notices=Notices())
    assert read_vector(path, assume_crs=CRS, notices=Notices()).crs == CRS


def test_one_row_far_outside_is_left_and_counted(tmp_path: Path) -> None:
    far = ring((500_000, 4_000_000), (500_010, 4_000_000), (500_010, 4_000_010))
    notices = Notices()
    found = read_vector(geojson(tmp_path / "a.geojson", *[SQUARE] * 20, far), notices=notices)
    assert found.geometry.isna().sum() == 1
    assert notices.count("W_OUTSIDE") == 1


def test_coordinates_beyond_the_earth_are_refused(written: Callable[..., Path]) -> None:
    frame = squares()
    frame.geometry = frame.geometry.translate(1e12)
    with pytest.raises(LimitError, match="too large"):
        read_vector(written(frame), notices=Notices())


def test_a_shapefile_without_prj_needs_an_assumed_crs(written: Callable[..., Path]) -> None:
    path = written(squares(), "a.shp")
    path.with_suffix(".prj").unlink()
    with pytest.raises(CrsError, match="--assume-crs"):
        read_vector(path, notices=Notices())
    notices = Notices()
    assert read_vector(path, assume_crs=CRS, notices=notices).crs == CRS
    assert "W_CRS_ASSUMED" in notices


def test_an_assumed_crs_does_not_overrule_one_that_fits(written: Callable[..., Path]) -> None:
    assert read_vector(written(squares()), assume_crs="EPSG:2154", notices=Notices()).crs == CRS


def test_degrees_assumed_to_be_metres_are_found_out(written: Callable[..., Path]) -> None:
    path = written(squares().to_crs(4326), "a.shp")
    path.with_suffix(".prj").unlink()
    with pytest.raises(CrsError, match="look like degrees"):
        read_vector(path, assume_crs=CRS, notices=Notices())


def test_a_crs_nobody_knows_is_refused(written: Callable[..., Path]) -> None:
    path = written(squares(), "a.shp")
    path.with_suffix(".prj").unlink()
    with pytest.raises(CrsError, match="not known"):
        read_vector(path, assume_crs="EPSG:999999", notices=Notices())


def damage(path: Path, record: int, value: int) -> None:
    """Overwrite the number of rings of a polygon record."""
    content = bytearray(path.read_bytes())
    start = struct.unpack_from(">i", path.with_suffix(".shx").read_bytes(), 100 + 8 * record)[0] * 2
    struct.pack_into("<i", content, start + 8 + 36, value)
    path.write_bytes(bytes(content))


def test_a_damaged_shapefile_record_is_counted(written: Callable[..., Path]) -> None:
    path = written(squares(), "a.shp")
    damage(path, 1, 1 << 28)
    notices = Notices()
    found = read_vector(path, notices=notices)
    assert found.geometry.isna().tolist() == [False, True, False]
    assert notices.count("W_DAMAGED") == 1


def test_a_shapefile_of_damaged_records_alone_is_refused(written: Callable[..., Path]) -> None:
    path = written(squares(1), "a.shp")
    damage(path, 0, 1 << 28)
    with pytest.raises(InputError, match="every one of its 1 records is damaged"):
        read_vector(path, notices=Notices())


def test_text_that_is_not_utf8_is_read_and_counted(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", SQUARE)
    path.write_bytes(path.read_bytes().replace(b'"n": 0', b'"n": "caf\xe9"'))
    notices = Notices()
    assert read_vector(path, notices=notices)["n"].tolist() == ["café"]
    assert notices.count("W_ENCODING") == 1


def test_curves_become_chords_and_are_counted(written: Callable[..., Path]) -> None:
    path = written(squares(1))
    # A circle of radius 1 around (1, 0): a curve polygon of one circular string, as GeoPackage stores it.
    arc = struct.pack("<BII6d", 1, 8, 3, 0, 0, 2, 0, 0, 0)
    curve = struct.pack("<BII", 1, 10, 1) + arc
    with closing(sqlite3.connect(path)) as database:
        database.create_function("ST_IsEmpty", 1, lambda blob: 0)
        for name in ("ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):
            database.create_function(name, 1, lambda blob: 0.0)
        header = b"GP\x00\x01" + struct.pack("<i", 32631)
        database.execute("UPDATE lots SET geom = ?", (header + curve,))
        database.commit()
    notices = Notices()
    found = read_vector(path, notices=notices)
    assert found.geometry.iloc[0].area == pytest.approx(np.pi, rel=0.01)
    assert notices.count("W_CURVE") == 1


def test_a_database_left_in_wal_mode_leaves_nothing_beside_it(written: Callable[..., Path], tmp_path: Path) -> None:
    path = written(squares())
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("UPDATE gpkg_contents SET description = 'x'")
        database.commit()
    before = sorted(entry.name for entry in tmp_path.iterdir())
    read_vector(path, notices=Notices())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == before


def test_gml_without_a_schema_is_read_and_nothing_is_left_beside_it(
    written: Callable[..., Path], tmp_path: Path
) -> None:
    path = written(squares(owner=["x", "y", "z"]), "a.gml")
    path.with_suffix(".xsd").unlink()
    assert read_vector(path, notices=Notices())["owner"].tolist() == ["x", "y", "z"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.gml"]


def _vrt(path: Path) -> None:
    path.write_text('<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>b.csv</SrcDataSource></OGRVRTLayer>'
                    "</OGRVRTDataSource>")  # fmt: skip


def _zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("lots.geojson", "{}")


BAD_FILES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "nothing there": ("a.gpkg", lambda path: None, "no such file"),
    "a folder": ("a.gpkg", lambda path: path.mkdir(), "a folder"),
    "a folder that is no geodatabase": ("a.gdb", lambda path: path.mkdir(), "a folder"),
    "a pipe": ("a.geojson", os.mkfifo, "not a regular file"),
    "a loop of links": ("a.gpkg", lambda path: path.symlink_to(path), "cannot be reached"),
    "no bytes": ("a.gpkg", lambda path: path.touch(), "empty"),
    "a virtual dataset": ("a.vrt", _vrt, "virtual dataset"),
    "a virtual dataset by another name": ("a.gpkg", _vrt, "virtual dataset"),
    "a virtual dataset as JSON": ("a.json", _vrt, "virtual dataset"),
    "an archive": ("a.zip", _zip, "archive"),
    "an archive by another name": ("a.shp", _zip, "archive"),
    "an unknown format": ("a.dwg", lambda path: path.write_text("AC1032"), "unknown vector format"),
    "text as a GeoPackage": ("a.gpkg", lambda path: path.write_text("lot_id,zone"), "not a GeoPackage"),
    "GML as GeoJSON": ("a.geojson", lambda path: path.write_text("<gml xmlns='http://www.opengis.net/gml'/>"), "not"),
    "XML with an entity": ("a.gml", lambda path: path.write_text("<!DOCTYPE a [<!ENTITY b 'c'>]>"), "document type"),
    "another SQLite database": ("a.gpkg", lambda path: _database(path), "not a GeoPackage"),
    "half a Parquet file": ("a.parquet", lambda path: path.write_bytes(b"PAR1" + bytes(50)), "cannot be read"),
    "half a FlatGeobuf": ("a.fgb", lambda path: path.write_bytes(b"fgb\x03fgb\x00" + bytes(20)), "no layers"),
    "half a shapefile": ("a.shp", lambda path: path.write_bytes(b"\x00\x00\x27\x0a" + bytes(30)), "cannot be read"),
}  # fmt: skip


def _database(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE lots (geom BLOB)")


@pytest.mark.parametrize("case", BAD_FILES)
def test_what_is_no_vector_file_is_refused_by_name(case: str, tmp_path: Path) -> None:
    name, make, reason = BAD_FILES[case]
    make(tmp_path / name)
    with pytest.raises(InputError, match=reason) as caught:
        read_vector(tmp_path / name, notices=Notices())
    assert name in str(caught.value)
    assert "\n" not in caught.value.what


@pytest.mark.parametrize(
    "place", ["http://example.org/a.geojson", "/vsicurl/http://a/b.gpkg", "/vsizip/a.zip", "ftp://a/b.shp"]
)
def test_places_that_are_no_local_files_are_refused(place: str) -> None:
    with pytest.raises(InputError, match="only local files"):
        split_source(place)
    with pytest.raises(InputError, match="only local files"):
        read_vector(place, notices=Notices())


def test_a_geopackage_with_a_damaged_page_is_refused(written: Callable[..., Path]) -> None:
    path = written(squares(400))
    content = bytearray(path.read_bytes())
    content[4096 * 3 : 4096 * 12] = bytes(4096 * 9)
    path.write_bytes(bytes(content))
    with pytest.raises(InputError, match="cannot be read"):
        read_vector(path, notices=Notices())


STRUCTURES = {
    "features is an object": {"type": "FeatureCollection", "features": {}},
    "type unknown": {"type": "Collection", "features": []},
    "no type": {"features": []},
    "feature without geometry": {"type": "Feature", "properties": {}},
    "properties a list": {"type": "Feature", "properties": [], "geometry": None},
    "id an object": {"type": "Feature", "id": {}, "properties": {}, "geometry": None},
    "too few brackets": {"type": "Polygon", "coordinates": [[2, 41], [3, 41], [2, 41]]},
    "too many brackets": {"type": "Polygon", "coordinates": [[[[2, 41], [3, 41], [3, 42], [2, 41]]]]},
    "a number as text": {"type": "Point", "coordinates": ["2", 41]},
    "a truth as number": {"type": "Point", "coordinates": [True, 41]},
    "one number a position": {"type": "MultiPoint", "coordinates": [[2]]},
    "bbox a text": {"type": "Point", "coordinates": [2, 41], "bbox": "all"},
    "a CRS behind a link": {"type": "FeatureCollection", "features": [],
                            "crs": {"type": "link", "properties": {"href": "http://example.org/crs"}}},
    "an illegal child": {"type": "MultiSurface", "geometries": [{"type": "Point", "coordinates": [2, 41]}]},
}  # fmt: skip


@pytest.mark.parametrize("case", STRUCTURES)
def test_json_that_is_not_geojson_is_refused(case: str, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(STRUCTURES[case]))
    with pytest.raises(InputError, match="not GeoJSON"):
        read_vector(path, notices=Notices())


@pytest.mark.parametrize(
    "text", ["[", "{", '{"type"', "[1,]", "{}x", "nul", '{"type": "Feature"} {}', "[" * 100_000, '{"a":' * 100_000]
)
def test_text_that_is_not_json_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(text)
    with pytest.raises(InputError, match="not GeoJSON"):
        read_vector(path, notices=Notices())


def test_json_fg_without_a_crs_is_refused(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.json", SQUARE, conformsTo=["[ogc-json-fg-1-0.1:core]"])
    with pytest.raises(CrsError, match="coordRefSys"):
        read_vector(path, notices=Notices())


def test_oddities_of_geojson_are_counted_and_do_no_harm(tmp_path: Path) -> None:
    turned = ring((2.0, 41.0), (2.0, 41.1), (2.1, 41.1), (2.1, 41.1), (2.1, 41.0))
    path = geojson(tmp_path / "a.geojson", turned, bbox=[41.0, 2.0, 41.1, 2.1])
    document = json.loads(path.read_text())
    document["features"][0]["bbox"] = [41.0, 2.0, 41.1, 2.1]
    path.write_text(json.dumps(document))
    notices = Notices()
    assert len(read_vector(path, notices=notices)) == 1
    assert {notice.code for notice in notices} >= {"W_WINDING", "W_REPEATED", "W_BBOX"}


def test_a_property_named_id_or_geometry_is_kept_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    feature = {"type": "Feature", "properties": {"id": None, "geometry": "x"}, "geometry": SQUARE}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    found = read_vector(path, notices=Notices())
    assert found.geometry.iloc[0].area > 0
    assert found["geometry_column"].tolist() == ["x"]


def test_a_source_is_split_at_the_colon_after_a_file(tmp_path: Path) -> None:
    path = tmp_path / "a:b.gpkg"
    path.touch()
    assert split_source(str(path)) == (path, None)
    assert split_source(f"{path}:roads:old") == (path, "roads:old")
    assert split_source("missing.gpkg:lots") == (Path("missing.gpkg"), "lots")
    assert split_source("missing.gpkg") == (Path("missing.gpkg"), None)


def test_names_with_null_bytes_or_strange_characters_are_errors_not_faults(tmp_path: Path) -> None:
    for name in ("a\0b.gpkg", "a" * 300 + ".gpkg", "\udce9.gpkg", "-o.gpkg", "部落格.gpkg"):
        with pytest.raises(UrbanForestError):
            read_vector(tmp_path / name, notices=Notices())


def test_parquet_without_geometry_is_refused(tmp_path: Path) -> None:
    pd.DataFrame({"a": [1]}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="without geometry"):
        read_vector(tmp_path / "a.parquet", notices=Notices())
