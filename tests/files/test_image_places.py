"""A raster lies where its file says, north up, or is refused for a stated reason."""

import warnings
from pathlib import Path

import pytest
import rasterio

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.image_checks import open_raster
from urbanforest_cli.files.image_places import raster_grid


def placed(path: Path, assume_crs: str | None = None) -> tuple[RasterGrid, set[str]]:
    notices = Notices()
    with open_raster(path, notices) as (dataset, _):
        grid, _ = raster_grid(dataset, path, assume_crs=assume_crs, notices=notices)
    return grid, {notice.code for notice in notices}


FOOT = 1200 / 3937
GOOD = {
    "metres": (UTM, PLACE, (0.6, 0.6), set()),
    "feet": ("EPSG:2263", (0.5, 0, 990_000, 0, -0.5, 200_000), (0.5 * FOOT, 0.5 * FOOT), {"W_CRS_UNIT"}),
    "degrees": ("EPSG:4326", (5e-6, 0, 8.0, 0, -5e-6, 60.0), (0.2788, 0.5570), set()),
    "web mercator": ("EPSG:3857", (0.6, 0, 0.0, 0, -0.6, 8_399_737.89), (0.30085, 0.30085), set()),
    "east of the date line": ("EPSG:4326", (5e-6, 0, 181.0, 0, -5e-6, 0.0), (0.5566, 0.5529), set()),
    "with heights": ("EPSG:32611+5703", PLACE, (0.6, 0.6), set()),
    "its own shift of datum": ("+proj=utm +zone=11 +ellps=clrk66 +towgs84=-8,160,176", PLACE, (0.6, 0.6), set()),
    "swiss": ("EPSG:2056", (0.5, 0, 2_679_062, 0, -0.5, 1_248_000), (0.5, 0.5), set()),
    "south up": (UTM, (0.6, 0, 5e5, 0, 0.6, 3.7e6), (0.6, 0.6), {"W_SOUTH_UP"}),
    "nearly straight": (UTM, (0.6, 1e-12, 5e5, -1e-12, -0.6, 3.7e6), (0.6, 0.6), set()),
}


@pytest.mark.parametrize("kind", GOOD)
def test_pixels_have_their_true_size_on_the_ground(tmp_path, kind):
    crs, place, size_m, codes = GOOD[kind]
    grid, told = placed(write_raster(tmp_path / "a.tif", colours(), crs=crs, place=place))
    assert grid.resolution_m == pytest.approx(size_m, rel=5e-3)
    assert told == codes
    assert grid.transform[1] == grid.transform[3] == 0
    assert grid.transform[4] < 0
    assert len(grid.crs.axis_info) == 2


MOON = '+proj=longlat +R=1737400 +no_defs'  # fmt: skip
ENGINEERING = 'ENGCRS["site",EDATUM["peg"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
BAD = {
    "rotated": (UTM, (0.6, 0.1, 5e5, 0.1, -0.6, 3.7e6), InputError, "rotated"),
    "turned by a quarter": (UTM, (0, 0.6, 5e5, 0.6, 0, 3.7e6), InputError, "rotated"),
    "mirrored": (UTM, (-0.6, 0, 5e5, 0, -0.6, 3.7e6), InputError, "mirrored"),
    "no place": (UTM, None, CrsError, "no place on the map"),
    "no crs": (None, PLACE, CrsError, "no coordinate reference system"),
    "local": ('LOCAL_CS["site",UNIT["metre",1]]', PLACE, CrsError, "no map of the Earth"),
    "engineering": (ENGINEERING, PLACE, CrsError, "no map of the Earth"),
    "geocentric": ("EPSG:4978", PLACE, CrsError, "no map of the Earth"),
    "moon": (MOON, (5e-6, 0, 8.0, 0, -5e-6, 60.0), CrsError, "no map of the Earth"),
    "moon in metres": ("+proj=tmerc +R=1737400 +no_defs", PLACE, CrsError, "no map of the Earth"),
    "metres called degrees": ("EPSG:4326", PLACE, CrsError, "not degrees"),
    "a galaxy away": (UTM, (0.6, 0, 5e12, 0, -0.6, 3.7e6), CrsError, "too large"),
    "beyond the zone": (UTM, (0.6, 0, 5e7, 0, -0.6, 3.7e6), CrsError, "beyond the area"),
    "lines": (UTM, (0.6, 0, 5e5, 0, -60.0, 3.7e6), LimitError, "odd shape"),
    "atoms": (UTM, (1e-9, 0, 5e5, 0, -1e-9, 3.7e6), LimitError, "odd shape"),
    "not a number": (UTM, (0.6, 0, float("nan"), 0, -0.6, 3.7e6), InputError, "not a number"),
}


@pytest.mark.parametrize("kind", BAD)
def test_places_that_are_none_are_refused_naming_the_file(tmp_path, kind):
    crs, place, error, message = BAD[kind]
    path = write_raster(tmp_path / "a.tif", colours(), crs=crs, place=place)
    with pytest.raises(error, match=rf"a\.tif: .*{message}"):
        placed(path)


def test_control_points_are_no_grid(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours(), crs=None, place=None)
    corners = ((0, 0), (0, 9), (9, 0))
    points = [rasterio.control.GroundControlPoint(row, col, 5e5 + col, 37e5 - row) for row, col in corners]
    with warnings.catch_warnings(action="ignore"), rasterio.open(path, "r+") as file:
        file.gcps = (points, rasterio.crs.CRS.from_string(UTM))
    with pytest.raises(InputError, match="3 ground control points"):
        placed(path)


def test_an_assumed_crs_serves_where_none_fits_and_never_else(tmp_path):
    bare = write_raster(tmp_path / "bare.tif", colours(), crs=None)
    grid, codes = placed(bare, UTM)
    assert (grid.crs.to_epsg(), codes) == (32611, {"W_CRS_ASSUMED"})
    wrong = write_raster(tmp_path / "wrong.tif", colours(), crs="EPSG:4326")
    grid, codes = placed(wrong, UTM)
    assert (grid.crs.to_epsg(), codes) == (32611, {"W_CRS_ASSUMED"})
    right = write_raster(tmp_path / "right.tif", colours())
    grid, codes = placed(right, "EPSG:2056")
    assert (grid.crs.to_epsg(), codes) == (32611, {"W_CRS_KEPT"})
    assert placed(right, UTM)[1] == set()
    for path in (bare, right):
        with pytest.raises(CrsError, match="--assume-crs"):
            placed(path, "nonsense")


def test_feet_and_metres_of_the_same_ground_agree(tmp_path):
    metres, _ = placed(write_raster(tmp_path / "m.tif", colours(), crs="EPSG:32118", place=(0.6, 0, 3e5, 0, -0.6, 6e4)))
    feet_place = tuple(value / FOOT for value in (0.6, 0, 3e5, 0, -0.6, 6e4))
    feet, _ = placed(write_raster(tmp_path / "f.tif", colours(), crs="EPSG:2263", place=feet_place))
    assert feet.resolution_m == pytest.approx(metres.resolution_m, rel=1e-6)


def test_world_files_and_a_prj_give_pictures_a_place(tmp_path):
    path = write_raster(tmp_path / "a.png", colours(), driver="PNG", crs=None, place=None)
    (tmp_path / "a.pgw").write_text("0.6\n0\n0\n-0.6\n500000.3\n3699999.7\n")
    with pytest.raises(CrsError, match="no coordinate reference system"):
        placed(path)
    grid, _ = placed(path, UTM)
    assert grid.transform == pytest.approx(PLACE)
