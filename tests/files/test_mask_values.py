"""What the numbers of masks mean."""

import numpy as np
import pytest

from urbanforest_cli.files.mask_values import MaskValues, percent_of, percent_of_colours


def scale_of(*masks):
    seen = MaskValues()
    for mask in masks:
        seen.add(np.asarray(mask))
    return seen.scale()


@pytest.mark.parametrize(
    ("values", "percent"),
    [
        ([0, 1, 1], [0, 100, 100]),
        ([0, 255], [0, 100]),
        ([0, 1, 255], [0, 100, 255]),
        ([0, 30, 100], [0, 30, 100]),
        ([0, 30, 100, 255], [0, 30, 100, 255]),
        ([0, 100], [0, 100]),
        ([0, 3, 128, 250, 255], [0, 1, 50, 98, 100]),
    ],
)
def test_whole_numbers_mean_what_all_of_them_fit(values, percent):
    mask = np.array(values, np.uint8)
    assert percent_of(mask, scale_of(mask)).tolist() == percent


def test_fractions_are_shares_and_no_number_is_unknown():
    mask = np.array([0.0, 0.25, 1.0, np.nan], np.float32)
    assert percent_of(mask, scale_of(mask)).tolist() == [0, 25, 100, 255]
    percents = np.array([0.0, 12.5, 99.4, np.inf], np.float32)
    assert percent_of(percents, scale_of(percents)).tolist() == [0, 12, 99, 255]


def test_whole_set_decides_not_one_mask():
    scale = scale_of(np.zeros((2, 2), np.uint8), np.array([0, 1], np.uint8))
    assert percent_of(np.array([1], np.uint8), scale).tolist() == [100]
    scale = scale_of(np.array([0, 1], np.uint8), np.array([40, 90], np.uint8))
    assert percent_of(np.array([1], np.uint8), scale).tolist() == [1]


@pytest.mark.parametrize(
    ("values", "says"),
    [([0, 0], "0 alone"), ([0, 1, 2, 3], "classes"), ([-5, 3], "-5"), ([0, 4000], "4000"), ([0.0, 300.5], "300.5")],
)
def test_numbers_that_mean_nothing_known_are_told(values, says):
    with pytest.raises(ValueError, match=says):
        scale_of(np.array(values))


def test_nearest_colour_of_the_palette_counts_and_canopy_is_vegetation():
    rgb = np.array([[10, 240, 12], [120, 250, 110], [200, 200, 200], [0, 255, 0]], np.uint8).T[:, None, :]
    palette = {"canopy": "#00ff00", "vegetation": "#80ff80"}
    found = percent_of_colours(rgb, palette, ("canopy", "vegetation"))
    assert found[:, 0].tolist() == [[100, 0, 0, 100], [100, 100, 0, 100]]
