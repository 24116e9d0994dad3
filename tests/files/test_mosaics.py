import numpy as np
import pytest
from pyproj import CRS

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files import mosaics
from urbanforest_cli.files.mosaics import images_of, lay_out, open_mosaic

GRID = RasterGrid(60, 40, PLACE, CRS.from_user_input(UTM))


def moved(row, col):
    a, b, c, d, e, f = PLACE
    return a, b, c + a * col, d, e, f + e * row


def part(path, values, row, col, height, width, **more):
    return write_raster(
        path, values[:, row : row + height, col : col + width], place=moved(row, col), meanings="rgb", **more
    )


def read_all(paths, **options):
    notices = Notices()
    with open_mosaic(paths, notices=notices, **options) as reader:
        rgb, valid = reader.read(0, 0, reader.grid.height_px, reader.grid.width_px)
        return rgb, valid, reader.grid, notices


def test_an_image_cut_into_parts_is_put_together_again(tmp_path, monkeypatch):
    monkeypatch.setattr(mosaics, "OPEN_MOST", 2)
    values = colours(90, 70)
    paths = [
        part(tmp_path / f"{row}_{col}.tif", values, row, col, 30, 35)
        for row, col in [(60, 35), (0, 0), (30, 0), (0, 35), (60, 0), (30, 35)]
    ]
    rgb, valid, grid, notices = read_all(paths)
    assert valid.all()
    assert np.array_equal(rgb, values)
    assert grid.transform == pytest.approx(PLACE)
    assert len(notices) == 0
    with open_mosaic(paths, notices=notices) as reader:
        assert np.array_equal(reader.read(25, 30, 40, 10)[0], values[:, 25:65, 30:40])


def test_the_first_image_that_has_a_pixel_gives_it(tmp_path):
    first, second = np.full((3, 20, 20), 50, np.uint8), np.full((3, 20, 20), 90, np.uint8)
    first[:, 5:8, 15:18] = 7
    paths = [
        write_raster(tmp_path / "b.tif", first, meanings="rgb", nodata=7),
        write_raster(tmp_path / "a.tif", second, place=moved(0, 10), meanings="rgb"),
    ]
    rgb, valid, grid, _ = read_all(paths)
    assert (grid.width_px, bool(valid.all())) == (30, True)
    assert (rgb[0, 5:8, 15:18] == 90).all()
    assert ((rgb[0] == 50).sum(), (rgb[0] == 90).sum()) == (400 - 9, 200 + 9)


def test_between_images_there_is_nothing(tmp_path):
    values = colours(10, 40)
    paths = [part(tmp_path / f"{col}.tif", values, 0, col, 10, 10) for col in (0, 30)]
    _, valid, _, _ = read_all(paths)
    assert valid.any(axis=0).tolist() == [True] * 10 + [False] * 20 + [True] * 10
    with open_mosaic(paths, notices=Notices()) as reader:
        assert not reader.has_pixels(range(10), range(10, 30))
        assert reader.has_pixels(range(10), range(9, 11))


def test_images_between_pixels_are_moved_and_it_is_said(tmp_path):
    values = colours(10, 20)
    paths = [
        part(tmp_path / "a.tif", values, 0, 0, 10, 10),
        write_raster(tmp_path / "b.tif", values[:, :, 10:], place=moved(0.3, 10.2), meanings="rgb"),
    ]
    rgb, _, _, notices = read_all(paths)
    assert np.array_equal(rgb, values)
    assert notices.count("W_MOSAIC_SHIFT") == 1


def test_parts_of_sixteen_bits_get_one_range(tmp_path):
    values = colours(20, 40).astype(np.uint16) * 9
    values[:, :, 20:] //= 4
    paths = [part(tmp_path / f"{col}.tif", values, 0, col, 20, 20) for col in (0, 20)]
    rgb, _, _, notices = read_all(paths)
    assert "W_MOSAIC_STRETCH" in notices
    seen, meant = rgb[rgb > 0].astype(float), values[rgb > 0].astype(float)
    assert np.corrcoef(np.clip(seen, 1, 254), meant)[0, 1] > 0.99


def test_parts_of_several_types_keep_their_own_range(tmp_path):
    values = colours(20, 80)
    deep, reals = values.astype(np.uint16) * 9, values.astype(np.float32) / 255
    paths = [
        part(tmp_path / "0.tif", values, 0, 0, 20, 20),
        part(tmp_path / "1.tif", deep, 0, 20, 20, 20),
        part(tmp_path / "2.tif", deep // 4, 0, 40, 20, 20),
        part(tmp_path / "3.tif", reals, 0, 60, 20, 20),
    ]
    rgb, _, _, notices = read_all(paths)
    assert np.array_equal(rgb[:, :, :20], values[:, :, :20])
    assert np.array_equal(rgb[:, :, 60:], values[:, :, 60:])
    assert np.array_equal(rgb[:, :, 20:60], read_all(paths[1:3])[0])
    assert notices.count("W_MOSAIC_TYPES") == notices.count("W_MOSAIC_STRETCH") == 1
    rgb = read_all(paths[:2], stretch=(0, 255 * 9))[0]
    assert np.array_equal(rgb, values[:, :, :40])


@pytest.mark.parametrize(
    ("grid", "what"),
    [
        (RasterGrid(60, 40, PLACE, CRS.from_epsg(26910)), "one CRS"),
        (RasterGrid(60, 40, (0.61, *PLACE[1:]), GRID.crs), "one size"),
        (RasterGrid(60, 40, (*PLACE[:4], -0.7, PLACE[5]), GRID.crs), "one size"),
    ],
)
def test_images_that_do_not_fit_are_refused_by_name(grid, what):
    with pytest.raises(InputError, match=what) as caught:
        lay_out([GRID, grid], ["good.tif", "odd.tif"])
    assert "odd.tif" in str(caught.value)
    assert "good.tif" in str(caught.value)


def test_pixel_sizes_may_differ_by_what_no_pixel_notices():
    lay_out([GRID, RasterGrid(60, 40, (0.6000001, *PLACE[1:]), GRID.crs)], ["a", "b"])


def test_images_at_two_ends_of_the_zone_are_too_much(tmp_path):
    values = colours(8, 8)
    paths = [
        write_raster(tmp_path / "a.tif", values, meanings="rgb"),
        write_raster(tmp_path / "b.tif", values, place=moved(2_000_000, 0), meanings="rgb"),
    ]
    with pytest.raises(LimitError, match="too far apart"):
        read_all(paths)


def test_a_folder_stands_for_its_images_by_name(tmp_path):
    for name in ("b.TIF", "a.png", ".hidden.tif", "notes.txt", "out.tif"):
        (tmp_path / name).touch()
    found = images_of(tmp_path, but=(tmp_path / "out.tif", None), notices=Notices())
    assert [path.name for path in found] == ["a.png", "b.TIF"]
    assert images_of(tmp_path / "b.TIF", notices=Notices()) == [tmp_path / "b.TIF"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no images"):
        images_of(tmp_path / "empty", notices=Notices())
