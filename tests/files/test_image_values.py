"""What numbers mean is decided by rules that can be checked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from urbanforest_cli.files.image_bands import ImageTraits
from urbanforest_cli.files.image_values import check_alpha, find_range, scaled, valid_pixels

RGB = ImageTraits(band_count=4, red=1, green=2, blue=3, nir=None, alpha=4, dtype="uint8", nodata=None)


def ramp(low: float, high: float, dtype) -> np.ndarray:
    return np.linspace(low, high, 1001).astype(dtype)


@pytest.mark.parametrize(
    ("low", "high", "dtype", "full"),
    [
        (0, 255, np.uint16, 255.0),
        (30, 200, np.float32, 255.0),
        (0, 1, np.float32, 1.0),
        (0.1, 0.9, np.float64, 1.0),
        (0, 1000, np.uint16, 1023.0),
        (100, 4000, np.uint16, 4095.0),
        (0, 65535, np.uint16, 65535.0),
        (5000, 60000, np.uint32, 65535.0),
    ],
)
def test_finished_pictures_keep_their_range(low, high, dtype, full):
    assert find_range(np.dtype(dtype).name, ramp(low, high, dtype)) == (0.0, full)


@pytest.mark.parametrize(
    ("low", "high", "dtype"),
    [
        (300, 900, np.uint16),
        (0.02, 0.3, np.float32),
        (-200, 3000, np.int16),
        (20_000, 30_000, np.uint16),
        (0, 1e9, float),
    ],
)
def test_raw_counts_put_their_percentiles_where_photographs_have_them(low, high, dtype):
    values = ramp(low, high, dtype)
    black, white = find_range(np.dtype(dtype).name, values)
    first, last = (255 * (np.percentile(values, share) - black) / (white - black) for share in (1, 99))
    assert (first, last) == pytest.approx((32, 205), abs=0.5)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.int32, np.float32])
def test_bytes_in_a_wider_type_are_taken_as_they_are(dtype):
    dark = np.arange(20, 90).astype(dtype)
    assert find_range(np.dtype(dtype).name, dark) == (0.0, 255.0)
    assert find_range(np.dtype(dtype).name, np.append(dark, dark.dtype.type(256))) != (0.0, 255.0)
    if dark.dtype.kind == "f":
        assert find_range("float32", dark / 2) != (0.0, 255.0)


@pytest.mark.parametrize("step", [16, 256, 257])
def test_bytes_that_were_multiplied_keep_the_range_of_bytes(step):
    dark = np.arange(20, 90).astype(np.uint16) * np.uint16(step)
    assert find_range("uint16", dark) == (0.0, 255.0 * step)
    dark[3] += 1
    assert find_range("uint16", dark) != (0.0, 255.0 * step)


def test_bytes_are_never_stretched_and_empty_or_flat_images_have_a_range():
    assert find_range("uint8", np.arange(100, 110, dtype=np.uint8)) == (0.0, 255.0)
    assert find_range("uint16", np.zeros(0, np.uint16)) == (0.0, 255.0)
    assert find_range("float32", np.full(9, 0.5, np.float32)) == (0.0, 255.0)
    low, high = find_range("uint16", np.full(9, 900, np.uint16))
    assert low < 900 < high


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.int32, np.float32, np.float64])
def test_samples_are_scaled_rounded_and_cut_off(dtype):
    traits = replace(RGB, low=50.0, high=101.0)
    values = np.array([0, 49, 50, 51, 75, 100, 101, 102, 127], dtype=dtype)
    assert scaled(values, traits).tolist() == [0, 0, 0, 5, 125, 250, 255, 255, 255]


def test_nodata_beyond_what_floats_hold_does_no_harm():
    colours = np.array([[1.0, 2.0]] * 3, np.float32)
    assert valid_pixels(colours, None, replace(RGB, nodata=-1.7976931348623157e308)).all()


def test_negative_samples_are_below_black():
    traits = replace(RGB, low=-100.0, high=155.0)
    values = np.array([-32768, -101, -100, -99, 0, 155, 32767], dtype=np.int16)
    assert scaled(values, traits).tolist() == [0, 0, 0, 1, 100, 255, 255]


def test_what_is_no_number_is_black():
    values = np.array([np.nan, np.inf, -np.inf, 127], dtype=np.float32)
    assert scaled(values, RGB).tolist() == [0, 255, 0, 127]


@pytest.mark.parametrize(
    ("alpha", "is_alpha"),
    [
        (np.r_[np.zeros(500), np.full(500, 255)], True),
        (np.full(1000, 255), True),
        (np.zeros(1000), True),
        (np.r_[np.zeros(500), np.ones(500)], True),
        (np.r_[np.zeros(400), np.arange(200), np.full(400, 255)], True),  # soft edges
        (np.linspace(20, 240, 1000), False),
        (np.r_[np.zeros(100), np.linspace(20, 200, 900)], False),
        (np.full(1000, 90), True),  # evenly half clear, but nothing to see in it
    ],
)
def test_transparency_is_clear_or_opaque_nearly_everywhere(alpha, is_alpha):
    colours = np.full((3, 1000), 80, np.uint8)
    traits = check_alpha(RGB, colours, alpha.astype(np.uint8))
    assert (traits.alpha, traits.nir) == ((4, None) if is_alpha else (None, 4))


def test_near_infrared_in_a_wide_black_collar_is_still_found():
    colours = np.zeros((3, 1000), np.uint8)
    colours[:, :100] = 80
    alpha = np.zeros(1000, np.uint8)
    alpha[:100] = np.linspace(20, 240, 100)
    assert check_alpha(RGB, colours, alpha).nir == 4


def test_each_mark_of_a_missing_pixel_is_seen():
    colours = np.array([[7, 7, 0, 0], [7, 1, 0, 2], [7, 2, 0, 3]], np.uint8)
    assert valid_pixels(colours, None, RGB).all()
    assert valid_pixels(colours, None, replace(RGB, nodata=7.0)).tolist() == [False, True, True, True]
    assert valid_pixels(colours, None, replace(RGB, black_is_missing=True)).tolist() == [True, True, False, True]
    assert valid_pixels(colours, np.array([0, 127, 128, 255]), RGB).tolist() == [False, False, True, True]
    palette = np.array([[1, 1, 1, 0], [2, 2, 2, 255]], np.uint8)
    index = np.array([[0, 1, 5, 1]] * 3, np.uint8)
    assert valid_pixels(index, None, replace(RGB, palette=palette)).tolist() == [False, True, False, True]
