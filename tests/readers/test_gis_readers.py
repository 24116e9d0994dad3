"""QGIS and GDAL's validator open the GeoPackages and rasters that `populate` and `export` write."""

import json
from pathlib import Path

import pytest

from tests.readers.conftest import assert_shows_plants
from urbanforest_cli.files.geopackage import row_count

pytestmark = pytest.mark.readers

QGIS = Path(__file__).parent / "open_in_qgis.py"


def open_in_qgis(debian, picture, *files):
    outcome = debian("qgis", QGIS, picture, *files)
    assert outcome.stdout, outcome.stderr
    answer = json.loads(outcome.stdout.splitlines()[-1])
    return {Path(path).name: {layer["name"]: layer for layer in layers} for path, layers in answer.items()}


def test_qgis_opens_the_register_with_its_style_and_draws_it(debian, forest, tmp_path):
    register = forest / "register.gpkg"
    layers = open_in_qgis(debian, tmp_path / "register.png", register)["register.gpkg"]
    assert all(layer["valid"] for layer in layers.values())
    for name in ("lots", "plants", "trees"):
        assert layers[name]["rows"] == row_count(register, name) > 0
        assert layers[name]["crs"]
        assert layers[name]["renderer"] == "categorizedSymbol"
        assert layers[name]["classes"] > 1
    assert_shows_plants(tmp_path / "register.png")


def test_qgis_opens_the_exported_plants_with_their_style(debian, forest, standing, tmp_path):
    found = open_in_qgis(debian, tmp_path / "plants.png", forest / "plants.gpkg", forest / "plants.geojson")
    (plants,) = [layer for layer in found["plants.gpkg"].values() if layer["spatial"]]
    assert plants["valid"]
    assert plants["rows"] == len(standing)
    assert plants["renderer"] == "categorizedSymbol"
    assert {"plant_id", "lot_id", "species", "height_m", "crown_radius_m", "dbh_m"} <= set(plants["fields"])
    (points,) = found["plants.geojson"].values()
    assert points["valid"]
    assert points["rows"] == row_count(forest / "register.gpkg", "plants")
    assert_shows_plants(tmp_path / "plants.png")


def test_qgis_opens_the_canopy(debian, forest, tmp_path):
    names = ("canopy_height.tif", "canopy_cover.tif")
    found = open_in_qgis(debian, tmp_path / "canopy.png", *(forest / name for name in names))
    for name in names:
        (raster,) = found[name].values()
        assert raster["valid"]
        assert raster["crs"]


@pytest.mark.parametrize("name", ["register.gpkg", "plants.gpkg"])
def test_the_geopackage_is_valid(debian, forest, name):
    outcome = debian("osgeo_utils.samples.validate_gpkg", "-m", "osgeo_utils.samples.validate_gpkg", forest / name)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "error" not in (outcome.stdout + outcome.stderr).lower()
