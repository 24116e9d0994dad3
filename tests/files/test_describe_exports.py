"""What `urbanforest info` tells of exported files."""

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS

from tests.reference.gltf_scenes import scene
from urbanforest_cli.core.errors import InputError, UrbanForestError
from urbanforest_cli.files.canopy import write_canopy
from urbanforest_cli.files.cityjson import write_cityjson
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.gltf import write_glb
from urbanforest_cli.files.itree import write_itree
from urbanforest_cli.files.manifest import Export, describe_files, record_exports
from urbanforest_cli.files.plant_tables import write_plants_gpkg, write_plants_parquet

MADE = {"stage": "export", "seed": "7"}
UTM = CRS.from_epsg(32633)


def plants():
    columns = {"plant_id": ["a"], "species": ["oak"], "height_m": [3.0], "crown_radius_m": [1.0]}
    return gpd.GeoDataFrame(columns, geometry=[shapely.Point(500_000, 5_000_000)], crs=UTM)


def inventory():
    return pd.DataFrame({"User Tree ID": ["a"], "Total Height (m)": [3.0], "Latitude": [45.0], "Longitude": [15.0]})


def canopy(path):
    place = {"west_m": 500_000, "north_m": 5_000_000, "cell_m": 1, "crs": UTM}
    write_canopy(path, np.ones((4, 4), np.float32), "height", **place, provenance=MADE)


WRITERS = {
    "forest.glb": lambda path: write_glb(path, scene(5)),
    "forest.city.json": lambda path: write_cityjson(path, scene(5)),
    "plants.gpkg": lambda path: write_plants_gpkg(path, plants(), categories=[], provenance=MADE),
    "plants.parquet": lambda path: write_plants_parquet(path, plants(), provenance=MADE),
    "itree.csv": lambda path: write_itree(path, inventory(), provenance=MADE),
    "canopy_height.tif": canopy,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_export_tells_what_made_it(tmp_path, name):
    WRITERS[name](tmp_path / name)
    record = describe_output(tmp_path / name)
    assert record["file"] == name
    assert {key: record[key] for key in MADE} == MADE


@pytest.mark.parametrize("name", ["forest.glb", "plants.gpkg", "plants.parquet", "canopy_height.tif", "itree.csv"])
def test_a_file_that_only_bears_the_name_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"nothing of the kind")
    with pytest.raises(UrbanForestError):
        describe_output(tmp_path / name)


def test_the_list_of_outputs_tells_of_each(tmp_path):
    (tmp_path / "a.csv").write_text("12345")
    record_exports(tmp_path, [Export("a.csv", "itree", "k", "g", {"bbox": [1]}, describe_files(tmp_path / "a.csv"))])
    assert describe_output(tmp_path / "exports.json")["outputs"] == {
        "a.csv": {"format": "itree", "key": "k", "growth": "g", "options": {"bbox": [1]}, "files": 1, "bytes": 5}
    }
    (tmp_path / "exports.json").write_text("{")
    with pytest.raises(InputError, match="torn"):
        describe_output(tmp_path / "exports.json")


def test_a_folder_of_nothing_we_wrote_is_told(tmp_path):
    with pytest.raises(InputError, match="no provenance"):
        describe_output(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        describe_output(tmp_path / "tiles")
