import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from urbanforest_cli.core.config import Placement
from urbanforest_cli.placement.radii import radius_limits, truncated_radii
from urbanforest_cli.placement.radius_law import fit_radius_law


def draw(count, mean, variance, **settings):
    return truncated_radii(np.full(count, 7, dtype=np.uint64), np.arange(count), mean, variance, Placement(**settings))


@pytest.mark.parametrize(("cut", "sigma_is"), [(2.0, "variance"), (3.0, "variance"), (1.0, "sd")])
def test_radii_have_the_mean_and_spread_asked_for(cut, sigma_is):
    radius = draw(20_000, 3.13, 0.35, radius_cut_sd=cut, sigma_is=sigma_is)
    assert radius.mean() == pytest.approx(3.13, abs=0.02)
    assert radius.std() == pytest.approx(np.sqrt(0.35) if sigma_is == "variance" else 0.35, rel=0.02)


def test_radii_follow_the_cut_normal_law():
    law = fit_radius_law(3.13, 0.35)
    cut = law.width_m / law.scale_m
    assert kstest(draw(5_000, 3.13, 0.35), truncnorm(-cut, cut, 3.13, law.scale_m).cdf).pvalue > 0.01


@pytest.mark.parametrize(("mean", "variance"), [(3.13, 0.35), (1.0, 2.0), (0.6, 1.0)])
def test_no_radius_leaves_the_limits_and_none_heaps_up_on_them(mean, variance):
    low, high = radius_limits(mean, variance, Placement())
    radius = draw(5_000, mean, variance)
    assert low >= 0.5
    assert low <= radius.min() < radius.max() <= high
    assert (radius == low).sum() + (radius == high).sum() <= 1


def test_variance_of_zero_gives_the_mean():
    assert (draw(50, 2.5, 0.0) == 2.5).all()


def test_a_radius_hangs_on_its_lot_and_number_alone():
    keys = np.repeat(np.array([3, 9], dtype=np.uint64), 40)
    index, mean = np.tile(np.arange(40), 2), np.repeat([2.0, 4.0], 40)
    together = truncated_radii(keys, index, mean, np.full(80, 0.5), Placement())
    some = np.array([5, 17, 79])
    assert np.array_equal(truncated_radii(keys[some], index[some], mean[some], 0.5, Placement()), together[some])


def test_no_plants_need_no_radii():
    assert len(draw(0, np.zeros(0), np.zeros(0))) == 0
