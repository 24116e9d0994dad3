import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.image_squares import image_square
from urbanforest_cli.files.mosaics import open_mosaic

UTM = CRS.from_epsg(32611)
WEST, NORTH = 500_000.0, 3_700_000.0


def write(path, function, *, side=200, pixel=0.6, crs=UTM, west=WEST, north=NORTH):
    """Write an image whose red and green are functions of the place in UTM, its blue 40."""
    x, y = np.meshgrid(west + (np.arange(side) + 0.5) * pixel, north - (np.arange(side) + 0.5) * pixel)
    if crs != UTM:
        x, y = Transformer.from_crs(crs, UTM, always_xy=True).transform(x, y)
    red, green = function(x - WEST, NORTH - y)
    values = np.stack((red, green, np.full_like(red, 40))).clip(1, 254).astype(np.uint8)
    with rasterio.open(
        path, "w", driver="GTiff", width=side, height=side, count=3, dtype="uint8", crs=crs.to_wkt(),
        transform=rasterio.Affine(pixel, 0, west, 0, -pixel, north), photometric="RGB",
    ) as file:  # fmt: skip
        file.write(values)
    return path


def ramp(x, y):
    return 20 + 1.5 * x, 20 + 1.5 * y


def square(path, frame, side):
    with open_mosaic([path], notices=Notices()) as mosaic:
        return image_square(mosaic, frame, side, UTM)


@pytest.mark.parametrize("pixel", [0.6, 0.17])
def test_colours_are_those_of_the_place(tmp_path, pixel):
    path = write(tmp_path / "a.tif", ramp, pixel=pixel, side=round(120 / pixel))
    frame = (WEST + 20, NORTH - 90, WEST + 80, NORTH - 30)
    colours, known = square(path, frame, 100)
    assert known.all()
    middles = (np.arange(100) + 0.5) * 0.6
    np.testing.assert_allclose(colours[..., 0], np.broadcast_to(20 + 1.5 * (20 + middles), (100, 100)), atol=1.5)
    np.testing.assert_allclose(colours[..., 1], np.broadcast_to(20 + 1.5 * (30 + middles), (100, 100)).T, atol=1.5)
    assert (colours[..., 2] == 40).all()


def test_an_image_of_another_crs_is_brought_to_the_square(tmp_path):
    degrees = CRS.from_epsg(4326)
    west, south, _, north = Transformer.from_crs(UTM, degrees, always_xy=True).transform_bounds(
        WEST, NORTH - 120, WEST + 120, NORTH
    )
    path = write(tmp_path / "a.tif", ramp, crs=degrees, west=west, north=north, pixel=(north - south) / 200, side=240)
    colours, known = square(path, (WEST + 20, NORTH - 90, WEST + 80, NORTH - 30), 100)
    assert known.all()
    middles = (np.arange(100) + 0.5) * 0.6
    np.testing.assert_allclose(colours[..., 0], np.broadcast_to(20 + 1.5 * (20 + middles), (100, 100)), atol=2)


def test_what_the_image_does_not_show_is_not_known(tmp_path):
    path = write(tmp_path / "a.tif", ramp)
    colours, known = square(path, (WEST - 60, NORTH - 60, WEST + 60, NORTH + 60), 120)
    assert known[61:, 61:].all()
    assert not known[:60].any()
    assert not known[:, :60].any()
    _, beside = square(path, (WEST + 1000, NORTH, WEST + 1100, NORTH + 100), 50)
    assert not beside.any()
    assert colours.shape == (120, 120, 3)


def test_fine_detail_is_averaged_not_picked(tmp_path):
    path = write(tmp_path / "a.tif", lambda x, y: (np.where(np.rint(x / 0.3 - 0.5) % 2, 200.0, 100.0), y * 0 + 50),
                 pixel=0.3, side=400)  # fmt: skip
    colours, _ = square(path, (WEST, NORTH - 120, WEST + 120, NORTH), 100)
    assert np.abs(colours[5:-5, 5:-5, 0].astype(float) - 150).max() < 30
