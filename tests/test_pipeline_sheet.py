import json
import shutil
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from PIL import Image

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.export.sheet import COVERED, PANE_PX
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.main import guarded
from urbanforest_cli.pipeline_sheet import write_sheet

WEST, SOUTH = 500_000.0, 5_300_000.0
GREEN = tuple(int(COVERED[i : i + 2], 16) for i in (1, 3, 5))
MIDDLE = (WEST + 90, SOUTH + 30)


def pane(picture, column, row=0):
    """Return the colours of a pane of the sheet."""
    left, top = round(48 + column * (PANE_PX + 14)), round(116 + 40 + row * (PANE_PX + 62))
    return np.asarray(picture.convert("RGB"))[top + 3 : top + PANE_PX - 3, left + 3 : left + PANE_PX - 3].astype(int)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A register of three lots in a row, with a house in two of them, stencilled and placed."""
    folder = tmp_path_factory.mktemp("city")
    lots = [shapely.box(WEST + 60 * i, SOUTH, WEST + 60 * i + 60, SOUTH + 60) for i in range(3)]
    houses = [shapely.box(WEST + 60 * i + 22, SOUTH + 22, WEST + 60 * i + 38, SOUTH + 36) for i in range(2)]
    layers = {
        "lots": gpd.GeoDataFrame({"lot_id": list("abc"), "zone": "residential"}, geometry=lots, crs=32633),
        "buildings": gpd.GeoDataFrame({"height_m": [6.0, 9.0]}, geometry=houses, crs=32633),
    }
    write_layers(folder / "city.gpkg", layers, fresh=True, geometry_types=dict.fromkeys(layers, "Polygon"))
    for line in (
        ("stencil", folder / "city.gpkg", "-o", folder / "register.gpkg"),
        ("place", folder / "register.gpkg"),
    ):
        assert guarded([*map(str, line), "-q"]) == 0
    return folder / "register.gpkg"


@pytest.fixture
def placed(planted, tmp_path):
    (tmp_path / "out").mkdir()
    return Path(shutil.copy(planted, tmp_path / "out" / "register.gpkg"))


@pytest.fixture
def aerial(tmp_path):
    """An image whose western half is red and whose eastern half is blue; the parting is at the sheet's middle."""
    path = tmp_path / "aerial.tif"
    values = np.full((3, 300, 500), 20, np.uint8)
    values[0, :, :280], values[2, :, 280:] = 200, 200
    transform = rasterio.Affine(0.5, 0, WEST - 50, 0, -0.5, SOUTH + 100)
    with rasterio.open(path, "w", driver="GTiff", width=500, height=300, count=3, dtype="uint8", crs="EPSG:32633",
                       transform=transform, photometric="RGB") as file:  # fmt: skip
        file.write(values)
    return path


@pytest.fixture
def coverage(tmp_path):
    """A map whose southern half, up to the sheet's middle, is covered."""
    path = tmp_path / "map.tif"
    values = np.zeros((1, 300, 500), np.uint8)
    values[0, 140:] = 100
    transform = rasterio.Affine(0.5, 0, WEST - 50, 0, -0.5, SOUTH + 100)
    with rasterio.open(path, "w", driver="GTiff", width=500, height=300, count=1, dtype="uint8", nodata=255,
                       crs="EPSG:32633", transform=transform) as file:  # fmt: skip
        file.write(values)
        file.descriptions, file.units = ["canopy"], ["percent"]
    return path


def test_columns_show_the_same_ground(placed, aerial, coverage, tmp_path):
    crs = read_layer(placed, "lots").crs
    east = gpd.GeoDataFrame(
        {"lot_id": ["b"], "area_m2": [3600.0], "inside_m2": [3600.0], "region_count": [1], "coverage": [1.0]},
        geometry=[shapely.MultiPolygon([shapely.box(WEST + 90, SOUTH - 100, WEST + 300, SOUTH + 200)])], crs=crs,
    )  # fmt: skip
    write_layers(placed, {"regions": east})
    summary = write_sheet(placed, tmp_path / "sheet.png", config=Config(), images=[aerial], coverage=coverage,
                          at=[MIDDLE], size_m=80.0)  # fmt: skip
    assert summary.counts == {"places": 1, "columns": 4}
    with Image.open(tmp_path / "sheet.png") as picture:
        image, cover, regions, plants = (pane(picture, column) for column in range(4))
        record = json.loads(picture.info["urbanforest"])
    half = image.shape[1] // 2
    assert (image[:, : half - 4, 0] > 150).all()
    assert (image[:, half + 4 :, 2] > 150).all()
    green = (np.abs(cover - GREEN).max(axis=2) < 30).mean(axis=1)
    assert green[: half - 4].mean() < 0.02
    assert green[half + 4 :].mean() > 0.95
    leafy = (regions[..., 1] > regions[..., 0] + 15).mean(axis=0)
    assert leafy[: half - 4].max() < 0.5 < leafy[half + 4 :].min()
    assert (plants[..., 1] > plants[..., 0] + 15).mean() > 0.02
    assert record["frames_m"] == [[WEST + 50, SOUTH - 10, WEST + 130, SOUTH + 70]]


def test_columns_that_have_nothing_to_show_are_left_out(placed, coverage, tmp_path):
    alone = write_sheet(placed, tmp_path / "alone.png", config=Config())
    assert alone.counts["columns"] == 1
    (placed.parent / "coverage.tif").write_bytes(coverage.read_bytes())
    beside = write_sheet(placed, tmp_path / "beside.png", config=Config(), places=2, size_m=50.0)
    assert beside.counts == {"places": 2, "columns": 2}
    with Image.open(tmp_path / "alone.png") as one, Image.open(tmp_path / "beside.png") as two:
        assert two.width == one.width + PANE_PX + 14
        assert two.height > one.height + PANE_PX


def test_a_sheet_is_the_same_twice(placed, aerial, coverage, tmp_path):
    for name in ("one.png", "two.png"):
        write_sheet(placed, tmp_path / name, config=Config(), images=[aerial], coverage=coverage)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_a_place_beside_the_city_is_refused_with_where_the_city_is(placed, tmp_path):
    with pytest.raises(InputError, match="beside the city") as caught:
        write_sheet(placed, tmp_path / "sheet.png", config=Config(), at=[(WEST + 5000, SOUTH)])
    assert "500000" in str(caught.value.expected)
    assert not (tmp_path / "sheet.png").exists()


def test_the_command_writes_a_sheet_of_a_folder(placed, aerial, runner, tmp_path):
    sheet = tmp_path / "sheet.png"
    at = f"{MIDDLE[0]},{MIDDLE[1]}"
    outcome = runner("evaluate", placed.parent, "--sheet", sheet, "--image", aerial, "--at", at, "--json")
    assert outcome.exit_code == 0, outcome.stderr
    assert json.loads(outcome.stdout)["counts"] == {"places": 1, "columns": 2}
    own = tmp_path / "own.png"
    own.write_text("mine")
    assert runner("evaluate", placed, "--sheet", own).exit_code == OutputExistsError.exit_code
    assert own.read_text() == "mine"
    assert runner("evaluate", placed, "--sheet", sheet, "--at", "here").exit_code == 2


@pytest.mark.slow
def test_the_grown_view_shows_plants_where_they_stand(placed, runner, tmp_path):
    outcome = runner("grow", placed)
    assert outcome.exit_code == 0, outcome.stderr
    summary = write_sheet(placed, tmp_path / "sheet.png", config=Config(), at=[MIDDLE], size_m=80.0)
    assert summary.counts["columns"] == 2
    with Image.open(tmp_path / "sheet.png") as picture:
        view = pane(picture, 1)
    trees = read_layer(placed, "trees")
    trees = trees[(trees["height_m"] > 0) & (trees["crown_radius_m"] > 1)]
    col = (trees.geometry.x.to_numpy() - (MIDDLE[0] - 40)) / 80 * PANE_PX - 3
    row = ((MIDDLE[1] + 40) - trees.geometry.y.to_numpy()) / 80 * PANE_PX - 3
    seen = (col > 5) & (col < len(view) - 5) & (row > 5) & (row < len(view) - 5)
    leafy = view[..., 1] - view[..., 2]
    at = leafy[row[seen].astype(int), col[seen].astype(int)]
    assert np.median(at) > np.median(leafy) + 10
