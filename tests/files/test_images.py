"""Images of all makes come out as the same 8-bit colours, north up, with what is missing told apart."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.shutil import copy

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.image_bands import ImageTraits
from urbanforest_cli.files.images import open_image


def read_all(path: Path, **options) -> tuple[np.ndarray, np.ndarray, set[str], ImageTraits]:
    notices = Notices()
    with open_image(path, notices=notices, **options) as image:
        rgb, valid = image.read(0, 0, image.height_px, image.width_px)
        assert rgb.dtype == np.uint8
        assert rgb.shape == (3, *valid.shape) == (3, image.height_px, image.width_px)
        assert not rgb[:, ~valid].any()
        return rgb, valid, {notice.code for notice in notices}, image.traits


LOSSLESS = {
    "strips": {},
    "tiles": {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"},
    "planes": {"interleave": "band", "compress": "lzw"},
    "one strip": {"blockysize": 40, "compress": "zstd"},
    "big": {"BIGTIFF": "YES"},
    "big-endian": {"ENDIANNESS": "BIG"},
    "png": {"driver": "PNG", "worldfile": "yes"},
    "jpeg 2000": {"driver": "JP2OpenJPEG", "QUALITY": "100", "REVERSIBLE": "YES"},
}


@pytest.mark.parametrize("make", LOSSLESS)
def test_every_lossless_make_gives_the_samples_and_the_place(tmp_path, make):
    values = colours()
    rgb, valid, codes, _ = read_all(write_raster(tmp_path / "image", values, **LOSSLESS[make]))
    assert np.array_equal(rgb, values)
    assert valid.all()
    assert codes <= {"W_BANDS_ASSUMED"}  # JPEG 2000 as GDAL writes it does not say
    with open_image(tmp_path / "image", notices=Notices()) as image:
        assert image.grid is not None
        assert image.grid.bounds == pytest.approx((500_000, 3_700_000 - 24, 500_036, 3_700_000))
        assert image.grid.crs.to_epsg() == 32611


@pytest.mark.parametrize("options", [{"compress": "jpeg", "photometric": "ycbcr"}, {"driver": "JPEG"}])
def test_jpeg_gives_nearly_the_samples(tmp_path, options):
    values = np.repeat(np.repeat(colours(5, 8), 8, axis=1), 8, axis=2)
    rgb, valid, _, _ = read_all(write_raster(tmp_path / "image", values, **options))
    assert valid.all()
    assert np.abs(rgb.astype(int) - values).mean() < 25


def test_cloud_optimised_files_are_read_at_full_resolution(tmp_path):
    values = colours(600, 700)
    plain = write_raster(tmp_path / "plain.tif", values)
    copy(str(plain), str(tmp_path / "cog.tif"), driver="COG", compress="DEFLATE")
    assert np.array_equal(read_all(tmp_path / "cog.tif")[0], values)


def test_windows_agree_with_the_whole(tmp_path):
    path = write_raster(tmp_path / "image.tif", colours(), place=(0.6, 0, 5e5, 0, 0.6, 37e5), nodata=9)
    whole, valid, _, _ = read_all(path)
    with open_image(path, notices=Notices()) as image:
        for row, col, high, wide in ((0, 0, 1, 1), (3, 5, 30, 17), (39, 59, 1, 1), (0, 20, 40, 40)):
            part, inside = image.read(row, col, high, wide)
            assert np.array_equal(part, whole[:, row : row + high, col : col + wide])
            assert np.array_equal(inside, valid[row : row + high, col : col + wide])
        for window in ((-1, 0, 2, 2), (0, 0, 41, 1), (0, 0, 0, 1), (0, 59, 1, 2)):
            with pytest.raises(ValueError, match="window"):
                image.read(*window)


def test_south_up_files_are_turned_pixels_and_place(tmp_path):
    values = colours(bands=4)
    turned = write_raster(
        tmp_path / "up.tif", values[:, ::-1], meanings="rgbn", place=(0.6, 0, 5e5, 0, 0.6, PLACE[5] - 0.6 * 40)
    )
    rgb, _, codes, _ = read_all(turned)
    assert np.array_equal(rgb, values[:3])
    assert codes == {"W_SOUTH_UP"}
    with open_image(turned, notices=Notices()) as image:
        assert image.grid.transform == pytest.approx(PLACE)
        assert np.array_equal(image.read_nir(3, 0, 5, 60), values[3, 3:8])
        assert np.array_equal(image.read_values(3, 0, 5, 60), values[:, 3:8])


def test_bands_are_found_by_what_the_file_calls_them(tmp_path):
    values = colours(bands=4)
    rgb, _, _, traits = read_all(write_raster(tmp_path / "a.tif", values[:3], meanings="bgr", photometric="MINISBLACK"))
    assert (traits.red, traits.green, traits.blue) == (3, 2, 1)
    assert np.array_equal(rgb, values[[2, 1, 0]])
    named = write_raster(tmp_path / "b.tif", values, names=("B02", "B03", "B04", "B08"), photometric="MINISBLACK")
    rgb, _, codes, traits = read_all(named)
    assert (*traits.bands, traits.nir) == (3, 2, 1, 4)
    assert not codes
    assert traits.sentence() == "red 3, green 2, blue 1 of 4 bands, near infrared 4"


def test_bands_without_names_are_taken_in_order_and_told(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours(bands=16), photometric="MINISBLACK")
    _, _, codes, traits = read_all(path)
    assert (*traits.bands, traits.nir) == (1, 2, 3, None)
    assert codes == {"W_BANDS_ASSUMED"}


def test_chosen_bands_are_read_and_bands_that_are_not_there_refused(tmp_path):
    values = colours(bands=5)
    path = write_raster(tmp_path / "a.tif", values)
    assert np.array_equal(read_all(path, bands=(5, 4, 2))[0], values[[4, 3, 1]])
    assert np.array_equal(read_all(path, bands=(4,))[0], values[[3, 3, 3]])
    clear = write_raster(tmp_path / "b.tif", np.concatenate([values[:3], values[3:4] // 128]), meanings="rgba")
    assert read_all(clear, bands=(4,))[1].all()  # looked at, it makes nothing transparent
    for wrong in ((0, 1, 2), (1, 2, 6), (1, 2), ()):
        with pytest.raises(ConfigError, match="--bands"):
            read_all(path, bands=wrong)


def test_one_band_is_gray(tmp_path):
    values = colours(bands=1)
    path = write_raster(tmp_path / "a.tif", values)
    rgb, _, codes, traits = read_all(path)
    assert traits.gray
    assert codes == {"W_GRAY"}
    assert np.array_equal(rgb, values[[0, 0, 0]])
    assert not read_all(path, georeferenced=False)[2]


def test_gray_kept_as_three_bands_is_told_too(tmp_path):
    values = colours(bands=1)[[0, 0, 0]]
    assert "W_GRAY" in read_all(write_raster(tmp_path / "a.tif", values))[2]
    values[2, 0, 0] ^= 1
    assert "W_GRAY" not in read_all(write_raster(tmp_path / "b.tif", values))[2]


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_white_is_zero_where_the_file_says_so(tmp_path, dtype):
    values = colours(bands=1).astype(dtype) * np.array(257 if dtype == "uint16" else 1, dtype)
    path = write_raster(tmp_path / "a.tif", values, photometric="MINISWHITE")
    rgb = read_all(path, stretch=(0, 65535) if dtype == "uint16" else None)[0]
    assert np.array_equal(rgb[0], 255 - colours(bands=1)[0])


PALETTE = {0: (9, 8, 7, 255), 1: (10, 200, 10, 255), 2: (0, 0, 255, 255), 3: (5, 5, 5, 0)}


@pytest.mark.parametrize("driver", ["GTiff", "PNG"])
def test_palettes_become_their_colours(tmp_path, driver):
    index = colours(bands=1) % 3
    path = write_raster(tmp_path / "a", index, palette=PALETTE, driver=driver)
    rgb, valid, codes, _ = read_all(path)
    assert valid.all()
    assert not codes
    table = np.array([PALETTE[i][:3] for i in range(4)], dtype=np.uint8)
    assert np.array_equal(rgb, np.moveaxis(table[index[0]], -1, 0))
    with open_image(path, notices=Notices()) as image:
        assert np.array_equal(image.read_values(0, 0, 40, 60), index)


def test_clear_colours_of_a_palette_are_missing(tmp_path):
    index = colours(bands=1) % 4
    _, valid, _, _ = read_all(write_raster(tmp_path / "a.png", index, palette=PALETTE, driver="PNG"))
    assert np.array_equal(valid, index[0] != 3)


def test_nodata_is_missing_only_where_all_colours_have_it(tmp_path):
    values = colours()
    values[:, 5, 5] = 0
    values[0, 6, 6] = 0
    _, valid, codes, traits = read_all(write_raster(tmp_path / "a.tif", values, nodata=0))
    assert np.argwhere(~valid).tolist() == [[5, 5]]
    assert not codes
    assert "no data 0" in traits.sentence()


@pytest.mark.parametrize("marker", [np.nan, -3.4028234663852886e38, -9999.0, np.inf])
def test_floats_that_are_no_numbers_are_missing(tmp_path, marker):
    values = (colours() / np.float32(255)).astype(np.float32)
    values[:, :10] = marker
    path = write_raster(tmp_path / "a.tif", values, nodata=-9999.0 if marker == -9999.0 else None)
    rgb, valid, _, traits = read_all(path)
    assert not valid[:10].any()
    assert valid[10:].all()
    assert (traits.low, traits.high) == (0.0, 1.0)
    assert np.array_equal(rgb[:, 10:], colours()[:, 10:])


def test_nodata_that_bytes_cannot_hold_is_left_out_and_told(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours(), nodata=200)
    raw = path.read_bytes()
    assert raw.count(b"200\0") == 1
    path.write_bytes(raw.replace(b"200\0", b"2.5\0"))
    _, valid, codes, traits = read_all(path)
    assert valid.all()
    assert codes == {"W_NODATA"}
    assert traits.nodata is None


def test_own_masks_are_kept(tmp_path):
    mask = colours()[0] > 100
    path = write_raster(tmp_path / "a.tif", colours(), mask=mask)
    _, valid, _, traits = read_all(path)
    assert traits.masked
    assert np.array_equal(valid, mask)
    turned = write_raster(tmp_path / "b.tif", colours(), mask=mask, place=(0.6, 0, 5e5, 0, 0.6, 37e5))
    assert np.array_equal(read_all(turned)[1], mask[::-1])


@pytest.mark.parametrize("opaque", [255, 1])
def test_transparent_pixels_are_missing(tmp_path, opaque):
    alpha = (colours()[0] > 100).astype(np.uint8) * opaque
    path = write_raster(tmp_path / "a.tif", np.concatenate([colours(), alpha[None]]), meanings="rgba")
    _, valid, codes, traits = read_all(path)
    assert traits.alpha == 4
    assert np.array_equal(valid, alpha > 0)
    assert not codes


def test_alpha_of_half_tones_is_near_infrared(tmp_path):
    values = colours(bands=4)
    path = write_raster(tmp_path / "a.tif", values, meanings="rgba")
    _, valid, codes, traits = read_all(path)
    assert (traits.nir, traits.alpha) == (4, None)
    assert valid.all()
    assert codes == {"W_ALPHA_IS_NIR"}
    with open_image(path, notices=Notices(), georeferenced=False) as image:
        assert np.array_equal(image.read_nir(0, 0, 40, 60), values[3])


def test_no_near_infrared_is_told(tmp_path):
    with (
        open_image(write_raster(tmp_path / "a.tif", colours()), notices=Notices()) as image,
        pytest.raises(InputError, match=r"a\.tif: no band of near infrared"),
    ):
        image.read_nir(0, 0, 1, 1)


DEEP = {
    "16 bits full": (np.uint16, 257, 65535.0),
    "12 bits full": (np.uint16, 16, 4080.0),
    "8 bits in 16": (np.uint16, 1, 255.0),
    "8 bits in floats": (np.float32, 1, 255.0),
    "0 to 1": (np.float64, 1 / 255, 1.0),
    "signed": (np.int16, 100, 0.0),
    "32 bits": (np.uint32, 257, 65535.0),
}


@pytest.mark.parametrize("kind", DEEP)
def test_the_same_picture_of_more_bits_gives_the_same_colours(tmp_path, kind):
    dtype, factor, top = DEEP[kind]
    values = (colours() * float(factor)).astype(dtype)
    stretch = None if top else (0.0, 25500.0)
    rgb, valid, codes, traits = read_all(write_raster(tmp_path / "a.tif", values, meanings="rgb"), stretch=stretch)
    assert valid.all()
    assert np.abs(rgb.astype(int) - colours()).max() <= 1
    assert traits.high == (top or 25500.0)
    assert ("W_STRETCHED" in codes) == (top not in (0.0, 255.0))


def test_raw_counts_are_stretched_to_where_photographs_lie(tmp_path):
    values = np.random.default_rng(0).normal(500, 60, (3, 200, 200)).clip(0, 4095).astype(np.uint16)
    rgb, _, codes, traits = read_all(write_raster(tmp_path / "a.tif", values, meanings="rgb"))
    assert np.percentile(rgb, (1, 99)) == pytest.approx((32, 205), abs=3)
    assert codes == {"W_STRETCHED"}
    assert "uint16 from" in traits.sentence()
    fixed = read_all(tmp_path / "a.tif", stretch=(traits.low, traits.high))
    assert np.array_equal(fixed[0], rgb)
    assert not fixed[2]


def test_a_chosen_stretch_cuts_off_and_a_stretch_of_no_width_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours())
    rgb = read_all(path, stretch=(100, 200))[0]
    assert np.array_equal(rgb, np.rint(np.clip((colours() - 100.0) * 2.55, 0, 255)).astype(np.uint8))
    for wrong in ((5, 5), (9, 1), (0, float("nan")), (float("-inf"), 1)):
        with pytest.raises(ConfigError, match="--stretch"):
            read_all(path, stretch=wrong)


def test_black_edges_are_missing_in_images_and_zero_in_masks(tmp_path):
    values = colours(200, 200)
    values[:, :, :60] = 0
    values[:, 100, 100] = 0
    path = write_raster(tmp_path / "a.tif", values)
    _, valid, codes, traits = read_all(path)
    assert codes == {"W_BLACK"}
    assert traits.black_is_missing
    assert np.array_equal(valid, values.any(axis=0))
    assert read_all(path, georeferenced=False)[1].all()


def test_black_spots_are_shadows(tmp_path):
    values = colours(200, 200)
    values[:, 90:110, 90:110] = 0
    _, valid, codes, _ = read_all(write_raster(tmp_path / "a.tif", values))
    assert valid.all()
    assert not codes


def test_tiles_never_written_are_missing(tmp_path):
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=300, height=300, count=3, dtype="uint8", crs=UTM, tiled=True, blockxsize=16,
        blockysize=16, transform=rasterio.Affine(*PLACE), SPARSE_OK=True,
    ) as file:  # fmt: skip
        file.write(colours(16, 16), window=rasterio.windows.Window(16, 32, 16, 16))
    _, valid, codes, _ = read_all(path)
    assert valid.sum() == 256
    assert valid[32:48, 16:32].all()
    assert "W_BLACK" in codes


def test_a_tile_never_written_between_others_is_missing(tmp_path):
    path = tmp_path / "a.tif"
    values = colours(800, 800)
    values[:, 64:80, 64:80] = 0
    write_raster(path, values, tiled=True, blockxsize=16, blockysize=16, SPARSE_OK=True)
    _, valid, codes, _ = read_all(path)
    assert codes == {"W_BLACK"}
    assert (~valid).sum() == 256
    assert not valid[64:80, 64:80].any()


def test_images_without_a_pixel_are_read_and_told(tmp_path):
    _, valid, codes, _ = read_all(write_raster(tmp_path / "a.tif", np.zeros((3, 50, 50), np.uint16), nodata=0))
    assert not valid.any()
    assert "W_ALL_MISSING" in codes


@pytest.mark.parametrize("value", [0, 90, 255])
def test_one_pixel_is_an_image(tmp_path, value):
    rgb, valid, codes, _ = read_all(write_raster(tmp_path / "a.tif", np.full((3, 1, 1), value, np.uint8)))
    assert valid.all()
    assert rgb.ravel().tolist() == [value] * 3
    assert not codes


def test_images_of_one_colour_have_a_range(tmp_path):
    rgb, valid, _, _ = read_all(write_raster(tmp_path / "a.tif", np.full((3, 50, 50), 7000, np.uint16)))
    assert valid.all()
    assert (rgb == 128).all()


def test_names_of_files_are_no_instructions(tmp_path):
    for name in ("a?b#c d.tif", "é\n%20.tif", "x.vrt", "no suffix", "[1].tif", "&{}.tif"):
        assert np.array_equal(read_all(write_raster(tmp_path / "plain.tif", colours()).rename(tmp_path / name))[0],
                              colours())  # fmt: skip


def test_a_name_that_gdal_would_take_for_a_page_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_raster(tmp_path / "b.tif", 255 - colours())
    write_raster(tmp_path / "c.tif", colours()).rename("GTIFF_DIR:1:b.tif")
    assert np.array_equal(read_all(Path("GTIFF_DIR:1:b.tif"))[0], colours())


def test_several_images_in_a_file_are_told(tmp_path):
    write_raster(tmp_path / "a.tif", colours())
    write_raster(tmp_path / "a.tif", colours(), APPEND_SUBDATASET="YES")
    assert read_all(tmp_path / "a.tif")[2] == {"W_PAGES"}


def test_images_that_lie_nowhere_are_read_where_they_may(tmp_path):
    path = write_raster(tmp_path / "a.png", colours(), crs=None, place=None, driver="PNG")
    with open_image(path, georeferenced=False, notices=Notices()) as image:
        assert image.grid is None
        assert np.array_equal(image.read(0, 0, 40, 60)[0], colours())
    with pytest.raises(InputError, match="no place on the map"):
        read_all(path)
    placed = write_raster(tmp_path / "b.tif", colours())
    with open_image(placed, georeferenced=False, notices=Notices()) as image:
        assert image.grid is not None


def test_reading_leaves_nothing_beside_the_image(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours().astype(np.uint16) * 9)
    before = path.read_bytes()
    read_all(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.tif"]
    assert path.read_bytes() == before


def test_a_file_cut_off_after_it_was_opened_is_told(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours(1500, 900), compress="deflate")
    with open_image(path, notices=Notices()) as image:
        path.write_bytes(path.read_bytes()[:500])
        with pytest.raises(InputError, match=r"a\.tif: its pixels cannot be read"):
            image.read(0, 0, 1500, 900)


READ_BY_WINDOWS = """
import resource, sys
from pathlib import Path
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.images import open_image

start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
count = 0
with open_image(Path(sys.argv[1]), notices=Notices()) as image:
    for row in range(0, image.height_px, 1024):
        for col in range(0, image.width_px, 1024):
            high, wide = min(1152, image.height_px - row), min(1152, image.width_px - col)
            count += int(image.read(row, col, high, wide)[1].sum())
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start)
"""


@pytest.mark.slow
@pytest.mark.parametrize("make", ["strips", "nothing"])
def test_memory_stays_bounded_in_20000_px_a_side(tmp_path, make):
    side = 20_000
    options = {"compress": "deflate", "zlevel": 1} if make == "strips" else {"tiled": True, "SPARSE_OK": True}
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=side, height=side, count=3, dtype="uint8", crs=UTM,
        transform=rasterio.Affine(*PLACE), **options,
    ) as file:  # fmt: skip
        band = np.tile(colours(500, 500), (1, 1, 40))
        for row in range(0, side, 500) if make == "strips" else ():
            file.write(band, window=rasterio.windows.Window(0, row, side, 500))
    run = subprocess.run(
        [sys.executable, "-c", READ_BY_WINDOWS, tmp_path / "a.tif"], capture_output=True, text=True, check=True
    )
    count, peak_kb = map(int, run.stdout.split())
    assert (count > 0) == (make == "strips")
    assert peak_kb < 300_000


def test_naip_is_four_bands_of_which_the_last_is_near_infrared(real_data):
    paths = sorted((real_data / "naip_california" / "images").glob("*.tif"))[::9]
    for path in paths:
        rgb, valid, codes, traits = read_all(path)
        assert (*traits.bands, traits.nir, traits.alpha) == (1, 2, 3, 4, None), path
        assert codes == {"W_ALPHA_IS_NIR"}
        assert valid.all()
        assert rgb.shape == (3, 256, 256)
        with open_image(path, notices=Notices()) as image:
            assert image.grid.resolution_m == pytest.approx((0.6, 0.6), rel=2e-3)
    assert paths


def test_zurich_pairs_are_images_with_a_place_and_masks_without(real_data):
    images = sorted((real_data / "zurich" / "img").glob("*.tif"))
    masks = sorted((real_data / "zurich" / "response_img").glob("*.tif"))
    assert images
    for path in images:
        _, valid, codes, traits = read_all(path)
        assert valid.all()
        assert not codes
        assert traits.bands == (1, 2, 3)
    for path in masks:
        with open_image(path, georeferenced=False, notices=Notices()) as mask:
            values = mask.read_values(0, 0, mask.height_px, mask.width_px)
            assert mask.grid is None
            assert set(np.unique(values)) <= {0, 1, 255}


@pytest.mark.parametrize("edge", range(4))
def test_a_narrow_black_collar_is_missing_and_a_dark_roof_is_not(tmp_path, edge):
    values = colours(200, 220)
    inside = [np.s_[:, :20], np.s_[:, -20:], np.s_[:, :, :20], np.s_[:, :, -20:]][edge]
    values[:, 90:120, 90:120] = 0
    assert read_all(write_raster(tmp_path / "roof.tif", values, meanings="rgb"))[1].all()
    values[inside] = 0
    _, valid, codes, _ = read_all(write_raster(tmp_path / "collar.tif", values, meanings="rgb"))
    assert codes == {"W_BLACK"}
    assert not valid[inside[1:]].any()
