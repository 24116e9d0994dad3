import numpy as np
import pytest
import shapely

from tests.regression.painted_lots import SQUARE, window_of
from urbanforest_cli.core.polygon_raster import raster_shares
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.regression.degrade import SMALLEST_REGION_M2, map_faults

CLEAN = np.array([[0.0, 0.0, 0.2, 0.0, 0.5, 0.0]])


def area_m2(window):
    return window.coverage.sum(dtype=int) * 0.25 / 100


def test_discs_cover_what_they_are_large():
    radius = [0.7, 1.5, 3.0, 5.0]
    window = window_of(SQUARE, [(5, 5), (10, 10), (20, 10), (25, 25)], radius)
    assert area_m2(window) == pytest.approx(np.pi * np.square(radius).sum(), rel=0.01)
    disc = shapely.Point(25, 25).buffer(5, quad_segs=64)
    true = raster_shares(np.array([disc]), -12, 52, 0.5, 128, 128)[0]
    assert np.abs(window.coverage[0][:60] / 100 - true[:60]).max() < 0.06


def test_a_clean_map_keeps_crowns_and_loses_what_is_too_small():
    window = window_of(SQUARE, [(5, 5), (20, 10), (25, 25)], [0.6, 3.0, 5.0], faults=CLEAN)
    assert np.pi * 0.6**2 < SMALLEST_REGION_M2
    assert area_m2(window) == pytest.approx(np.pi * (3.0**2 + 5.0**2), rel=0.02)


def test_small_holes_are_filled_and_larger_ones_stay():
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = 20 + 3.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    wide = 20 + 7.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    assert window_of(SQUARE, ring, np.full(8, 2.35), faults=CLEAN).coverage[0, 64, 64] == 100
    assert window_of(SQUARE, wide, np.full(8, 3.5), faults=CLEAN).coverage[0, 64, 64] == 0


def test_a_low_threshold_joins_crowns_and_a_high_one_shrinks_them():
    places, radius = [(15, 20), (22, 20)], [3.0, 3.0]
    low, high = CLEAN.copy(), CLEAN.copy()
    low[0, 2], low[0, 4] = 1.2, 0.3
    high[0, 2], high[0, 4] = 1.2, 0.62
    clean, joined, shrunk = (window_of(SQUARE, places, radius, faults=faults) for faults in (CLEAN, low, high))
    assert clean.coverage[0, 63:65, 61].max() < 50 <= joined.coverage[0, 63:65, 61].min()
    assert area_m2(shrunk) < area_m2(clean) < area_m2(joined)


def test_lumps_and_grain_change_rims_and_hardly_areas():
    rough = np.array([[0.16, 0.0, 0.6, 0.25, 0.5, 12345.0]])
    window = window_of(SQUARE, [(20, 20)], [6.0], faults=rough)
    clean = window_of(SQUARE, [(20, 20)], [6.0], faults=CLEAN)
    assert area_m2(window) == pytest.approx(area_m2(clean), rel=0.12)
    assert (np.abs(window.coverage.astype(int) - clean.coverage) > 50).sum() > 5


def test_small_crowns_are_missed_more_often_than_large_ones():
    rng = np.random.default_rng(0)
    blind = np.array([[0.0, 0.6, 0.2, 0.0, 0.5, 0.0]])
    places = np.column_stack([v.ravel() for v in np.meshgrid(np.arange(2, 40, 4.0), np.arange(2, 40, 4.0))])
    shown = {
        r: area_m2(window_of(SQUARE, places + rng.uniform(-0.1, 0.1, 2), np.full(len(places), r), faults=blind))
        / (np.pi * r * r * len(places))
        for r in (1.0, 1.9)
    }
    assert 0.3 < shown[1.0] < 0.55
    assert shown[1.0] + 0.2 < shown[1.9] < 0.95


def test_faults_are_drawn_from_none_to_strong():
    faults = map_faults(keys_for(0, "test", map(str, range(4000))))
    clean = (faults[:, [0, 1, 3]] == 0).all(axis=1)
    assert clean.mean() == pytest.approx(0.3, abs=0.03)
    assert (faults[clean, 4] == 0.5).all()
    assert faults[:, 2].min() >= 0.2
    assert 0.3 <= faults[:, 4].min() < 0.35
    assert 0.58 < faults[:, 4].max() <= 0.62
