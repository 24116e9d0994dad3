from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.regression.judging.made_pairs import disc_pairs
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.baselines import fit_boosting, fit_closed_form, fit_mean
from urbanforest_cli.regression.judging.blobs import MEASURES, blob_measures
from urbanforest_cli.regression.judging.predictions import shares

RADIUS, DENSITY = REGRESSED.index("radius_mean_m"), REGRESSED.index("density")


def r2(said, truth):
    return 1 - np.mean((said - truth) ** 2) / truth.var()


def measured(window, pixel_m=1.0):
    found = blob_measures(window[None], np.array([pixel_m], np.float32))[0]
    return dict(zip(MEASURES, found, strict=True))


def lot_with(*discs: tuple[float, float, float]) -> np.ndarray:
    row, col = np.mgrid[:64, :64]
    window = np.zeros((3, 64, 64), np.uint8)
    window[1:] = 100
    for y, x, radius in discs:
        window[0][(row - y) ** 2 + (col - x) ** 2 <= radius**2] = 100
    return window


@pytest.mark.parametrize("pixel_m", [1.0, 2.0])
def test_measures_of_two_discs_are_those_known(pixel_m):
    found = measured(lot_with((20, 20, 8), (40, 20, 4)), pixel_m)
    assert found["blob_radius_m"] == pytest.approx(6 * pixel_m, rel=0.03)
    assert found["blob_radius_variance_m2"] == pytest.approx(4 * pixel_m**2, rel=0.1)
    assert found["nearest_m"] == pytest.approx(20 * pixel_m)
    assert found["area_fraction"] == pytest.approx(np.pi * 80 / 64**2, rel=0.03)
    assert found["edge_depth_m"] == pytest.approx(10)


def test_touching_discs_are_one_blob_but_two_places_where_it_is_widest():
    apart, touching = measured(lot_with((32, 15, 8), (32, 50, 8))), measured(lot_with((32, 24, 8), (32, 39, 8)))
    assert touching["blob_radius_m"] > 1.3 * apart["blob_radius_m"]
    assert touching["depth_radius_m"] == pytest.approx(apart["depth_radius_m"], rel=0.1)
    assert touching["nearest_m"] == pytest.approx(15, abs=1.5)


def test_cover_beyond_the_lot_is_not_measured_and_bare_lots_measure_nothing():
    window = lot_with((20, 20, 8))
    window[2, :, 32:] = 0
    with_neighbour = window.copy()
    with_neighbour[0, 10:30, 40:60] = 100
    assert measured(with_neighbour) == measured(window)
    assert set(measured(lot_with()).values()) == {0.0}


def test_closed_form_reads_radius_and_density_and_boosting_reads_features(pairs):
    new = disc_pairs(400, seed=2)
    truth = shares(new.values)
    seen = new.visible > 0
    closed = fit_closed_form(pairs)(new)
    assert r2(closed.values[seen, RADIUS], truth[seen, RADIUS]) > 0.9
    assert r2(closed.values[:, DENSITY], truth[:, DENSITY]) > 0.2
    boosted = fit_boosting(pairs, 7)(new)
    assert r2(boosted.values[:, RADIUS], truth[:, RADIUS]) > 0.95
    assert boosted.strategy.sum(axis=1) == pytest.approx(1)
    assert r2(fit_boosting(pairs, 1)(new).values[:, DENSITY], truth[:, DENSITY]) < 0.1


def test_mean_predictor_knows_only_pairs_that_use_a_parameter(pairs):
    truth = shares(pairs.values)
    found = fit_mean(pairs)(pairs)
    used = pairs.used[:, 3]
    assert not used.all()
    assert found.values[0, 3] == pytest.approx(truth[used, 3].mean())
    assert found.spreads[0, 3] == pytest.approx(truth[used, 3].std())


def test_bare_lots_get_what_bare_lots_had(pairs):
    closed = fit_closed_form(pairs)
    bare = disc_pairs(200, seed=5)
    bare.windows[:, 0] = 0
    said = closed(bare).values[:, DENSITY]
    assert said == pytest.approx(shares(pairs.values)[pairs.visible == 0, DENSITY].mean())


def test_too_few_pairs_and_a_missing_package_are_told(pairs, monkeypatch):
    few = pairs.take(np.arange(30))
    for fit in (fit_mean, fit_closed_form, lambda table: fit_boosting(table, 3)):
        with pytest.raises(InputError, match="too few pairs"):
            fit(few)
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    with pytest.raises(ConfigError, match="scikit-learn"):
        fit_boosting(pairs, 3)
