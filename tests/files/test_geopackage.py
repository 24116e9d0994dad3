import os
import resource
import sqlite3
import subprocess
import sys
from contextlib import closing

import geopandas as gpd
import pandas as pd
import pyogrio
import pytest
import shapely

from urbanforest_cli.core.errors import BusyError, InputError, OutputError, SchemaError
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.schema import LAYERS, REGISTER_VERSION
from urbanforest_cli.files.geopackage import check_counts, layer_names, read_layer, write_layers


def plants(count: int = 3, crs: int = 32633) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(
        {
            "plant_id": [f"a-{i}" for i in range(count)],
            "lot_id": "a",
            "species": "tilia_cordata",
            "habit": "tree",
            "age_years": 10.0,
            "envelope_radius_m": 2.0,
            "pruning_factor": 1.0,
        },
        geometry=shapely.points([[500_000.0 + 10 * i, 5_300_000.0] for i in range(count)]),
        crs=crs,
    )


def provenance(version: int = REGISTER_VERSION) -> pd.DataFrame:
    row = dict.fromkeys(LAYERS["provenance"].columns, "x") | {"register_version": version}
    return pd.DataFrame([row])


@pytest.fixture
def register(tmp_path):
    path = tmp_path / "register.gpkg"
    write_layers(path, {"plants": plants(), "provenance": provenance()}, fresh=True)
    return path


def test_layers_come_back_as_they_were_written(register):
    back = read_layer(register, "plants")
    assert back["plant_id"].tolist() == ["a-0", "a-1", "a-2"]
    assert back.crs.to_epsg() == 32633
    assert back.geometry.x.tolist() == [500_000.0, 500_010.0, 500_020.0]


def test_replacing_one_layer_leaves_the_others(register):
    write_layers(register, {"plants": plants(5)})
    assert len(read_layer(register, "plants")) == 5
    assert len(read_layer(register, "provenance", geometry=False)) == 1


def test_layers_that_are_dropped_leave_nothing_behind(register):
    trees = plants().rename(columns={"envelope_radius_m": "radius"})
    write_layers(register, {"mine": trees, "table": provenance()}, geometry_types={"mine": "Point"})
    before = set(layer_names(register))
    write_layers(register, {"plants": plants(5)}, drop=("mine", "table", "never there"))
    assert set(layer_names(register)) == before - {"mine", "table"}
    with closing(sqlite3.connect(register)) as inside:
        names = [row[0] for row in inside.execute("SELECT name FROM sqlite_master")]
        assert not [name for name in names if "mine" in name]
        for table in ("gpkg_contents", "gpkg_geometry_columns", "gpkg_extensions", "gpkg_ogr_contents"):
            assert not [row for row in inside.execute(f"SELECT table_name FROM {table}") if row[0] in ("mine", "table")]
        assert inside.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    write_layers(register, {"mine": trees}, geometry_types={"mine": "Point"})
    assert len(read_layer(register, "mine")) == 3


def test_rows_cached_count_and_index_agree_after_every_write(register):
    with sqlite3.connect(register) as db:
        rows = db.execute("SELECT count(*) FROM plants").fetchone()[0]
        cached = db.execute("SELECT feature_count FROM gpkg_ogr_contents WHERE table_name='plants'").fetchone()[0]
        indexed = db.execute("SELECT count(*) FROM rtree_plants_geom").fetchone()[0]
    db.close()
    assert rows == cached == indexed == 3


def test_a_lost_row_is_noticed(register):
    with pytest.raises(OutputError, match="not written whole"):
        check_counts(register, {"plants": (4, 0)})


def test_rows_without_a_shape_are_counted_as_such(tmp_path):
    frame = gpd.GeoDataFrame({"n": [1, 2, 3]}, geometry=[shapely.Point(0, 0), None, shapely.Point()], crs=32633)
    write_layers(tmp_path / "a.gpkg", {"x": frame}, fresh=True, geometry_types={"x": "Point"})
    assert len(pyogrio.read_dataframe(tmp_path / "a.gpkg", layer="x")) == 3


def test_a_frame_that_breaks_the_schema_is_not_written_and_all_faults_are_told(register):
    bad = plants()
    bad["plant_id"] = "same"
    bad["age_years"] = -1.0
    del bad["habit"]
    before = sha256_of(register)
    with pytest.raises(SchemaError) as caught:
        write_layers(register, {"plants": bad})
    assert all(word in str(caught.value) for word in ("plant_id", "age_years", "habit"))
    assert sha256_of(register) == before


def test_a_missing_layer_names_the_command_that_writes_it(register):
    with pytest.raises(SchemaError, match="urbanforest stencil"):
        read_layer(register, "active_areas")


def test_a_register_of_another_version_is_refused_untouched(tmp_path):
    path = tmp_path / "register.gpkg"
    write_layers(path, {"plants": plants(), "provenance": provenance(REGISTER_VERSION + 1)}, fresh=True)
    before = sha256_of(path)
    with pytest.raises(SchemaError, match="another version"):
        read_layer(path, "plants")
    assert sha256_of(path) == before


@pytest.mark.parametrize("content", [b"", b"hello", b"SQLite format 3\0" + b"\0" * 84])
def test_what_is_no_register_is_refused(tmp_path, content):
    path = tmp_path / "register.gpkg"
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_layer(path, "plants")


def test_somebody_elses_geopackage_is_refused(tmp_path):
    path = tmp_path / "theirs.gpkg"
    pyogrio.write_dataframe(plants(), path, layer="plants", driver="GPKG")
    with pytest.raises(InputError, match="not a register"):
        read_layer(path, "plants")


def test_a_file_open_in_another_program_is_not_replaced(register):
    other = sqlite3.connect(register)
    other.execute("PRAGMA journal_mode=WAL")
    other.execute("CREATE TABLE note (x)")
    other.commit()
    try:
        with pytest.raises(BusyError, match="another program"):
            write_layers(register, {"plants": plants(5)})
    finally:
        other.close()


def test_a_full_disk_is_an_error_and_the_old_register_stays(register):
    before = sha256_of(register)
    code = (
        "import sys, pathlib; sys.path.insert(0, sys.argv[2])\n"
        "from test_geopackage import plants\n"
        "from urbanforest_cli.core.errors import OutputError\n"
        "from urbanforest_cli.files.geopackage import write_layers\n"
        "try:\n    write_layers(pathlib.Path(sys.argv[1]), {'plants': plants(20000)})\n"
        "except OutputError as error:\n    print(error); sys.exit(error.exit_code)\n"
    )
    for limit in (1 << 16, 1 << 18, 1 << 20):
        outcome = subprocess.run(
            [sys.executable, "-c", code, str(register), os.path.dirname(__file__)],
            preexec_fn=lambda limit=limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
            capture_output=True,
            text=True,
            check=False,
        )
        assert outcome.returncode == 74, outcome.stderr
        assert "register.gpkg" in outcome.stdout
        assert sha256_of(register) == before
        assert [p.name for p in register.parent.iterdir()] == ["register.gpkg"]


def test_equal_content_is_equal_bytes_when_the_date_is_given(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    hashes = []
    for name in ("a", "b"):
        path = tmp_path / name / "register.gpkg"
        write_layers(path, {"plants": plants(), "provenance": provenance()}, fresh=True)
        hashes.append(sha256_of(path))
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
    assert hashes[0] == hashes[1]


def test_layer_names_lists_layers_and_tables(register):
    assert {"plants", "provenance"} <= set(layer_names(register))
