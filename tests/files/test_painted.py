from pathlib import Path

import numpy as np
import pytest

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files import painted
from urbanforest_cli.files.painted import is_painting, read_painting


def read(path, **options):
    return read_painting(path, notices=Notices(), **options)


def sheet(*channels):
    """Channels of 8 bits, 20 rows of 30, zero but for a block."""
    values = np.zeros((len(channels), 20, 30), np.uint8)
    for band, value in enumerate(channels):
        values[band, 5:10, 5:15] = value
    return values


def image_grid(width_px=30, height_px=20):
    from pyproj import CRS

    return RasterGrid(width_px, height_px, (0.6, 0.0, 1000.0, 0.0, -0.6, 2000.0), CRS.from_epsg(32633))


@pytest.mark.parametrize(
    ("channels", "meanings", "percent"),
    [
        ((255,), None, 100), ((128,), None, 50), ((0, 128, 0), "rgb", 100), ((90, 90, 90), "rgb", 35),
        ((0, 128, 0, 255), "rgba", 100), ((0, 0, 0, 255), "rgba", 100), ((128, 128, 128, 255), "rgba", 50),
    ],
)  # fmt: skip
def test_paint_is_told_from_ground(tmp_path, channels, meanings, percent):
    path = write_raster(tmp_path / "s.png", sheet(*channels), driver="PNG", crs=None, place=None, meanings=meanings)
    found = read(path, like=image_grid())
    expected = np.zeros((20, 30))
    expected[5:10, 5:15] = percent
    assert (found.percent == expected).all()


def test_half_transparent_paint_counts_from_the_middle_on(tmp_path):
    values = np.zeros((4, 4, 5), np.uint8)
    values[:3] = 255
    values[3] = [0, 100, 127, 128, 255]
    path = write_raster(tmp_path / "s.png", values, driver="PNG", crs=None, place=None, meanings="rgba")
    assert read(path, like=image_grid(5, 4)).percent[0].tolist() == [0, 0, 0, 100, 100]


def test_a_palette_is_read_by_its_colours(tmp_path):
    palette = {0: (0, 0, 0, 0), 1: (30, 160, 40, 255), 2: (255, 255, 255, 255)}
    values = sheet(1)
    values[0, 15:18, 2:9] = 2
    path = write_raster(tmp_path / "s.png", values, driver="PNG", crs=None, place=None, palette=palette)
    found = read(path, like=image_grid()).percent
    assert (found == np.where(values[0] > 0, 100, 0)).all()


def test_the_dim_edge_of_a_coloured_brush_is_no_paint(tmp_path):
    values = sheet(0, 160, 0)
    values[1, 5:10, 4] = 60
    path = write_raster(tmp_path / "s.png", values, driver="PNG", crs=None, place=None, meanings="rgb")
    found = read(path, like=image_grid()).percent
    assert found[7, 4] == 0
    assert found[7, 5] == 100


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (sheet(1), 100), (sheet(255), 100), (sheet(60), 60), (sheet(180), 71),
        (sheet(1).astype(np.float32) * np.float32(0.3), 30),
    ],
)  # fmt: skip
def test_a_geotiff_holds_a_mask_percentages_shades_or_shares(tmp_path, values, expected):
    found = read(write_raster(tmp_path / "s.tif", values))
    assert (found.percent[5:10, 5:15] == expected).all()
    assert not found.percent[:5].any()
    assert found.grid.bounds == pytest.approx((PLACE[2], PLACE[5] - 12, PLACE[2] + 18, PLACE[5]))


def test_a_coverage_map_is_painted_where_it_shows_canopy(tmp_path):
    canopy = sheet(100)
    canopy[0, 5, 5:9] = [0, 49, 50, 255]
    values = np.concatenate((np.full_like(canopy, 100), canopy))
    path = write_raster(tmp_path / "c.tif", values, names=("vegetation", "canopy"), nodata=255)
    found = read(path).percent
    assert found[5, 5:9].tolist() == [0, 0, 100, 0]
    assert not found[:5].any()


def test_a_picture_whose_first_row_is_the_south_is_turned(tmp_path):
    path = write_raster(tmp_path / "s.tif", sheet(255), place=(0.6, 0, 500_000.0, 0, 0.6, 3_700_000.0))
    found = read(path)
    assert found.percent[10:15, 5:15].all()
    assert not found.percent[5:10].any()


def test_a_picture_without_a_place_takes_that_of_the_image_of_its_size(tmp_path):
    path = write_raster(tmp_path / "s.png", sheet(255), driver="PNG", crs=None, place=None)
    assert read(path, like=image_grid()).grid == image_grid()
    with pytest.raises(CrsError, match="place"):
        read(path)
    with pytest.raises(CrsError, match="31 x 20"):
        read(path, like=image_grid(31))


def test_a_world_file_gives_the_place_and_the_image_the_crs(tmp_path):
    path = write_raster(tmp_path / "s.png", sheet(255), driver="PNG", crs=None, place=None)
    path.with_suffix(".pgw").write_text("2.0\n0\n0\n-2.0\n501\n4999\n")
    found = read(path, like=image_grid(7, 7))
    assert found.grid.bounds == pytest.approx((500, 4960, 560, 5000))
    assert found.grid.crs.to_epsg() == 32633
    assert read(path, assume_crs="EPSG:32611").grid.crs.to_epsg() == 32611


@pytest.mark.parametrize("bands", [1, 3])
def test_a_photograph_is_refused(tmp_path, bands):
    path = write_raster(tmp_path / "s.png", colours(bands=bands), driver="PNG", crs=UTM)
    with pytest.raises(InputError, match="which ground"):
        read(path, like=image_grid(60, 40))


def test_a_gray_photograph_is_no_coverage_either(tmp_path):
    with pytest.raises(InputError, match="which ground"):
        read(write_raster(tmp_path / "s.tif", colours(bands=1)))


def test_a_photograph_with_some_black_in_it_is_refused(tmp_path):
    values = colours(100, 100)
    values[:, :2] = 0
    path = write_raster(tmp_path / "s.png", values, driver="PNG", crs=UTM)
    with pytest.raises(InputError, match="which ground"):
        read(path, like=image_grid(100, 100))


def test_paint_on_white_paper_is_refused(tmp_path):
    values = np.full((3, 20, 30), 255, np.uint8)
    values[[0, 2], 5:9, 5:9] = 0
    path = write_raster(tmp_path / "s.png", values, driver="PNG", crs=None, place=None, meanings="rgb")
    with pytest.raises(InputError, match="which ground"):
        read(path, like=image_grid())


def test_ground_painted_all_over_in_one_tone_is_taken(tmp_path):
    path = write_raster(tmp_path / "s.png", np.full((1, 20, 30), 255, np.uint8), driver="PNG", crs=None, place=None)
    assert (read(path, like=image_grid()).percent == 100).all()


@pytest.mark.parametrize("driver", ["PNG", "GTiff"])
def test_nothing_painted_is_refused(tmp_path, driver):
    path = write_raster(tmp_path / "s.any", np.zeros((1, 20, 30), np.uint8), driver=driver)
    with pytest.raises(InputError, match="nothing is painted"):
        read(path, like=image_grid())


def test_numbers_of_classes_and_jpeg_are_refused(tmp_path):
    with pytest.raises(InputError, match="no coverage"):
        read(write_raster(tmp_path / "s.tif", sheet(7)))
    path = write_raster(tmp_path / "s.jpg", sheet(255), driver="JPEG", crs=None, place=None)
    with pytest.raises(InputError, match="painted PNG"):
        read(path, like=image_grid())


def test_a_sketch_of_too_many_pixels_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(painted, "PIXELS_MOST", 100)
    with pytest.raises(LimitError, match="pixels"):
        read(write_raster(tmp_path / "s.tif", sheet(255)))


def test_files_are_told_by_their_names(tmp_path):
    assert [is_painting(tmp_path / name) for name in ("a.PNG", "a.tif", "a.gpkg", "a.geojson")] == [
        True,
        True,
        False,
        False,
    ]


def test_an_aerial_image_with_dark_ground_is_refused():
    image = Path(__file__).parents[2] / "data_samples" / "sample_city.tif"
    with pytest.raises(InputError, match="photograph"):
        read_painting(image, like=None, assume_crs=None, notices=Notices())
