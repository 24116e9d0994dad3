from fractions import Fraction

import numpy as np
import pytest

from urbanforest_cli.imagery.resampling import pixels_per_cell, resample, resample_valid, taps

RATIOS = [Fraction(2), Fraction(5, 3), Fraction(7), Fraction(3, 4), Fraction(1, 3)]


@pytest.mark.parametrize(
    ("pixel_m", "expected"),
    [(0.6, 1), (0.65, 1), (0.56, 1), (0.3, 2), (0.5 * 0.3048, 4), (0.1, 6), (0.05, 12), (0.4, Fraction(3, 2)),
     (1.2, Fraction(1, 2)), (5.0, Fraction(1, 8))],
)  # fmt: skip
def test_ratios_are_the_simplest_that_are_near(pixel_m, expected):
    assert pixels_per_cell(pixel_m, 0.6) == expected


def test_no_ratio_is_far_from_the_true_one():
    for pixel_m in np.geomspace(0.01, 5.0, 400):
        ratio = pixels_per_cell(pixel_m, 0.6)
        assert abs(float(ratio) * pixel_m / 0.6 - 1) <= (0.1112 if 1 in ratio.as_integer_ratio() else 0.053)


def by_area(values, ratio, targets, sources):
    """Averages by cutting every source into as many equal parts as it takes."""
    parts = ratio.denominator
    fine = np.repeat(values, parts)
    result = []
    for target in targets:
        low = max(target * ratio.numerator, sources.start * parts) - sources.start * parts
        high = min((target + 1) * ratio.numerator, sources.stop * parts) - sources.start * parts
        result.append(fine[low:high].mean())
    return np.array(result)


@pytest.mark.parametrize("ratio", [ratio for ratio in RATIOS if ratio > 1])
@pytest.mark.parametrize("first", [0, 11, -5])
def test_averages_are_those_of_the_shared_lengths(ratio, first):
    sources = range(first, first + 33)
    targets = range(int(np.floor(first / ratio)), int(np.ceil((first + 33) / ratio)))
    values = np.random.default_rng(0).random(33).astype(np.float32)
    found = resample(values[None, :], None, taps(ratio, targets, sources, first))[0]
    assert found == pytest.approx(by_area(values, ratio, targets, sources), abs=1e-6)


@pytest.mark.parametrize("ratio", [ratio for ratio in RATIOS if ratio < 1])
def test_a_ramp_stays_a_ramp_between_the_outermost_centres(ratio):
    sources = range(4, 24)
    targets = range(int(np.floor(4 / ratio)), int(np.ceil(24 / ratio)))
    values = (np.arange(4, 24) + 0.5).astype(np.float32)
    found = resample(values[:, None], taps(ratio, targets, sources, 4), None)[:, 0]
    centres = (np.array(targets) + 0.5) * float(ratio)
    assert found == pytest.approx(np.clip(centres, 4.5, 23.5), abs=1e-5)


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_part_is_resampled_as_within_the_whole(ratio):
    sources = range(-7, 83)
    targets = range(int(np.floor(-7 / ratio)), int(np.ceil(83 / ratio)))
    values = np.random.default_rng(1).random((2, 90)).astype(np.float32)
    whole = resample(values, None, taps(ratio, targets, sources, -7))
    third = len(targets) // 3
    part = range(targets.start + third, targets.stop - third)
    given = range(int(np.floor(part.start * ratio)) - 1, int(np.ceil(part.stop * ratio)) + 1)
    found = resample(values[:, given.start + 7 : given.stop + 7], None, taps(ratio, part, sources, given.start))
    assert np.array_equal(found, whole[:, third : len(targets) - third])


def test_what_is_not_valid_has_no_say():
    values = np.array([[[10.0, 20.0, 30.0, 40.0]]], np.float32)
    valid = np.array([[True, False, False, False]])
    found, known = resample_valid(values, valid, None, taps(Fraction(2), range(2), range(4), 0))
    assert found[0, 0].tolist() == [10.0, 0.0]
    assert known[0].tolist() == [True, False]
