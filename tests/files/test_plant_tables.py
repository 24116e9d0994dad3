import json
import shutil
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files import plant_tables
from urbanforest_cli.files.plant_tables import (
    read_gpkg_plants,
    read_gpkg_provenance,
    read_parquet_plants,
    read_parquet_provenance,
    write_plants_gpkg,
    write_plants_parquet,
)

RECORD = {"stage": "export", "seed": "7", "city": "Köln"}
CATEGORIES = [("tilia_cordata", "Tilia cordata (lime)", "#336633"), ("a<b&'c", "odd & <odd>", "#aa0000")]
SYSTEM_PYTHON = Path("/usr/bin/python3")


def plants(count=40, crs="EPSG:2263"):
    rng = np.random.default_rng(2)
    ids = [f"lot {n}-{n}" for n in range(count - 2)] + ["日本-1", "quo\"te'-2"]
    return gpd.GeoDataFrame(
        {
            "plant_id": np.array(ids, dtype=object),
            "species": np.array([CATEGORIES[n % 2][0] for n in range(count)], dtype=object),
            "height_m": np.round(rng.uniform(0, 30, count), 3),
            "crown_radius_m": np.round(rng.uniform(0, 8, count), 3),
            "grown": "unique",
        },
        geometry=shapely.points(rng.uniform(1e5, 1.1e5, (count, 2))),
        crs=crs,
    )


def gpkg(path, frame=None):
    write_plants_gpkg(path, plants() if frame is None else frame, categories=CATEGORIES, provenance=RECORD)
    return path


def parquet(path, frame=None):
    write_plants_parquet(path, plants() if frame is None else frame, provenance=RECORD)
    return path


KINDS = [
    ("plants.gpkg", gpkg, read_gpkg_plants, read_gpkg_provenance),
    ("plants.parquet", parquet, read_parquet_plants, read_parquet_provenance),
]


@pytest.mark.parametrize(("name", "write", "read", "record"), KINDS)
def test_plants_and_provenance_come_back_exactly(tmp_path, name, write, read, record):
    frame = plants()
    path = write(tmp_path / name)
    found = read(path)
    assert found.plant_id.tolist() == frame["plant_id"].tolist()
    assert (found.xyz_m[:, :2] == shapely.get_coordinates(frame.geometry)).all()
    assert (found.height_m == frame["height_m"]).all()
    assert found.crs.to_epsg() == 2263
    assert record(path) == RECORD


@pytest.mark.parametrize(("name", "write", "read", "record"), KINDS)
def test_a_city_without_plants_is_a_table_without_rows(tmp_path, name, write, read, record):
    path = write(tmp_path / name, plants().iloc[:0])
    assert len(read(path)) == 0
    assert record(path) == RECORD


@pytest.mark.parametrize(("name", "write", "read", "record"), KINDS)
def test_equal_plants_are_equal_bytes(tmp_path, monkeypatch, name, write, read, record):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1735689600")
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert write(tmp_path / "a" / name).read_bytes() == write(tmp_path / "b" / name).read_bytes()


@pytest.mark.parametrize(("name", "write", "read", "record"), KINDS)
@pytest.mark.parametrize("cut", [0, 50, 3000])
def test_torn_files_are_refused_in_words(tmp_path, name, write, read, record, cut):
    path = write(tmp_path / name)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="not plants of urbanforest"):
        read(path)


@pytest.mark.parametrize(("name", "write", "read", "record"), KINDS)
def test_missing_and_foreign_files_are_refused_in_words(tmp_path, name, write, read, record):
    with pytest.raises(InputError):
        read(tmp_path / name)
    with pytest.raises(InputError):
        record(tmp_path / name)
    (tmp_path / name).write_bytes(b"not a table at all" * 100)
    with pytest.raises(InputError):
        read(tmp_path / name)
    with pytest.raises(InputError):
        record(tmp_path / name)


def test_tables_of_others_are_refused_or_have_no_provenance(tmp_path):
    frame = plants()
    frame.to_file(tmp_path / "other.gpkg", layer="trees")
    with pytest.raises(InputError):
        read_gpkg_plants(tmp_path / "other.gpkg")
    assert read_gpkg_provenance(tmp_path / "other.gpkg") is None
    frame.drop(columns="height_m").to_parquet(tmp_path / "other.parquet")
    with pytest.raises(InputError):
        read_parquet_plants(tmp_path / "other.parquet")
    assert read_parquet_provenance(tmp_path / "other.parquet") is None


def test_qgis_finds_a_style_by_species_that_draws_crowns_as_wide_as_they_are(tmp_path):
    with closing(sqlite3.connect(gpkg(tmp_path / "plants.gpkg"))) as file:
        rows = file.execute("SELECT f_table_name, useAsDefault, styleQML FROM layer_styles").fetchall()
    assert [row[:2] for row in rows] == [("plants", 1)]
    assert 'attr="species"' in rows[0][2]
    assert "crown_radius_m" in rows[0][2]
    assert "envelope_radius_m" not in rows[0][2]
    assert "Tilia cordata (lime)" in rows[0][2]
    assert "odd &amp; &lt;odd&gt;" in rows[0][2]


def test_debians_validator_passes_the_geopackage(tmp_path):
    module = "osgeo_utils.samples.validate_gpkg"
    command = [str(SYSTEM_PYTHON), "-m", module]
    probe = [str(SYSTEM_PYTHON), "-c", f"import {module}"]
    if not SYSTEM_PYTHON.exists() or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("needs Debian's python3-gdal")
    path = gpkg(tmp_path / "plants.gpkg")
    assert subprocess.run([*command, str(path)], capture_output=True, text=True).returncode == 0
    broken = shutil.copy(path, tmp_path / "broken.gpkg")
    with closing(sqlite3.connect(broken)) as file, file:
        file.execute("UPDATE gpkg_metadata_reference SET reference_scope = 'nonsense'")
    assert subprocess.run([*command, str(broken)], capture_output=True, text=True).returncode != 0


def test_the_parquet_conforms_to_geoparquet_and_names_a_box_a_row(tmp_path, monkeypatch):
    import geoparquet_validator

    monkeypatch.setattr(plant_tables, "ROW_GROUP", 16)
    path = parquet(tmp_path / "plants.parquet")
    assert geoparquet_validator.conformant(geoparquet_validator.check(str(path)))
    metadata = pq.read_metadata(path)
    assert metadata.num_row_groups == 3
    geo = json.loads(metadata.metadata[b"geo"])
    assert geo["version"] == "1.1.0"
    assert geo["columns"]["geometry"]["covering"]["bbox"]["xmin"] == ["bbox", "xmin"]


def test_geopandas_reads_the_parquet_and_its_boxes(tmp_path):
    frame = plants()
    path = parquet(tmp_path / "plants.parquet")
    back = gpd.read_parquet(path)
    assert back.crs == frame.crs
    assert back.geometry.geom_equals(frame.geometry).all()
    west, south, east, north = frame.total_bounds
    half = gpd.read_parquet(path, bbox=(west, south, (west + east) / 2, north))
    assert len(half) == (frame.geometry.x <= (west + east) / 2).sum()
