from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.regression.painted_lots import SQUARE, apart, window_of
from urbanforest_cli.core.lot_windows import Surroundings, lot_windows
from urbanforest_cli.regression.crown_features_kernel import CROWN_COUNT
from urbanforest_cli.regression.features import CROWN_FEATURES, FEATURES, HAND_FEATURES, features_of, network_windows
from urbanforest_cli.regression.features_kernel import HAND_COUNT

HOUSE = shapely.box(14, 14, 26, 24)


def named(window, *names):
    found = dict(zip(FEATURES, features_of(window)[0].tolist(), strict=True))
    return found if not names else tuple(found[name] for name in names)


def crowded(seed=0, radius=2.5, spread=0.5, count=14):
    return apart(count, 40, np.random.default_rng(seed).normal(radius, spread, count).clip(1.2), seed)


def test_names_are_as_many_as_the_kernels_write_and_all_different():
    assert (len(HAND_FEATURES), len(CROWN_FEATURES)) == (HAND_COUNT, CROWN_COUNT)
    assert len(set(FEATURES)) == len(FEATURES) == HAND_COUNT + CROWN_COUNT


def test_a_bare_lot_has_no_crowns_and_no_number_that_is_none():
    window = window_of(SQUARE, np.empty((0, 2)), [])
    found = named(window)
    assert np.isfinite(list(found.values())).all()
    assert found["lot_cover"] == found["crown_count_log"] == found["region_count_log"] == 0
    assert found["lot_area_log"] == pytest.approx(np.log1p(1600), rel=1e-3)


def test_a_lot_all_covered_gives_numbers():
    window = window_of(SQUARE, np.empty((0, 2)), [])
    full = replace(window, coverage=np.full_like(window.coverage, 100))
    found = named(full)
    assert np.isfinite(list(found.values())).all()
    assert found["lot_cover"] == pytest.approx(1.0)
    assert found["cover_beyond_9m"] == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_crowns_that_stand_apart_are_told_apart_with_their_radii(seed):
    xy, radius = crowded(seed)
    count, mean, variance = named(
        window_of(SQUARE, xy, radius), "crown_count_log", "crown_radius_mean_m", "crown_radius_variance_m2"
    )
    assert np.expm1(count) == pytest.approx(len(radius))
    assert mean == pytest.approx(radius.mean(), abs=0.04)
    assert variance == pytest.approx(radius.var(ddof=1), abs=0.05)


def test_crowns_that_touch_are_still_told_apart():
    xy = [(8, 20), (16, 20), (23, 20), (29, 20)]
    count, mean, regions = named(
        window_of(SQUARE, xy, [4.0, 4.0, 3.0, 3.0]), "crown_count_log", "crown_radius_mean_m", "region_count_log"
    )
    assert np.expm1(regions) < 3
    assert np.expm1(count) == pytest.approx(4)
    assert mean == pytest.approx(3.5, abs=0.1)


def test_crowns_of_the_neighbours_are_not_counted():
    count, cover = named(window_of(SQUARE, [(20, 20), (-2, 10), (43, 30)], [3, 4, 4]), "crown_count_log", "lot_cover")
    assert np.expm1(count) == pytest.approx(1)
    assert cover > np.pi * 9 / 1600


def test_distances_to_edge_and_house_are_those_of_the_middles():
    lot = shapely.box(0, 0, 26, 60)
    xy, radius, house = [(4, 30), (13, 9), (13, 44)], [2, 2, 2], shapely.box(8, 20, 18, 39)
    found = named(window_of(lot, xy, radius, houses=[house]))
    assert found["edge_max_m"] == pytest.approx(13.0, abs=1.3)
    assert found["edge_second_m"] == pytest.approx(9.0, abs=0.3)
    assert found["edge_min_m"] == pytest.approx(4.0, abs=0.3)
    assert found["clearance_m"] == pytest.approx(4.0, abs=0.4)
    assert named(window_of(lot, xy, radius), "clearance_m") == (0.0,)


def test_a_fuller_lot_reads_as_fuller():
    xy, radius = crowded(count=40)
    half = len(radius) // 2
    few, many = (named(window_of(SQUARE, xy[:n], radius[:n]), "filled", "filled_band", "within_2") for n in (half, 40))
    assert all(a < b for a, b in zip(few, many, strict=True))
    assert 0.7 < many[0] < 1.5


def test_a_band_along_the_edge_reads_as_one():
    row = np.arange(4, 38, 5.0)
    band = np.vstack([np.column_stack((row, 0 * row + 2)), np.column_stack((row, 0 * row + 38))])
    edge, likelihood = named(window_of(SQUARE, band, np.full(len(band), 2.0)), "edge_max_m", "band_log_likelihood")
    assert edge < 2.5
    xy, radius = crowded()
    assert likelihood < -10 < named(window_of(SQUARE, xy, radius), "band_log_likelihood")[0]


def test_groups_are_counted_and_measured():
    turn = np.arange(6) * np.pi / 3
    group = 4.2 * np.column_stack((np.cos(turn), np.sin(turn)))
    xy = np.vstack((group + 8, group + 31))
    groups, reach = named(window_of(SQUARE, xy, np.full(12, 1.8)), "groups_1", "group_reach_1_m")
    assert groups == 2
    assert reach == pytest.approx(4.2, abs=0.3)


def test_turning_and_mirroring_change_next_to_nothing():
    xy, radius = crowded(3)
    window = window_of(shapely.box(0, 0, 40, 33), xy, radius, houses=[HOUSE])
    first = features_of(window)[0]
    for change in (np.rot90, np.flipud, lambda a: a.T):
        turned = replace(
            window,
            **{
                name: np.ascontiguousarray(change(getattr(window, name)[0]))[None]
                for name in ("coverage", "lot", "ground", "edge_dm")
            },
        )
        np.testing.assert_allclose(features_of(turned)[0], first, rtol=0.03, atol=0.06)


def test_features_do_not_depend_on_batch_or_threads():
    windows = [window_of(SQUARE, *crowded(seed)) for seed in range(3)]
    together = replace(
        windows[0],
        **{
            name: np.concatenate([getattr(window, name) for window in windows] * 60)
            for name in windows[0].__dataclass_fields__
        },
    )
    found = features_of(together, workers=3)
    np.testing.assert_array_equal(found[:3], np.concatenate([features_of(window) for window in windows]))
    np.testing.assert_array_equal(found[3:6], found[:3])


def test_a_network_sees_means_of_four_pixels():
    window = window_of(SQUARE, [(20, 20)], [5.0])
    seen = network_windows(window)
    assert seen.shape == (1, 3, 64, 64)
    assert seen.dtype == np.uint8
    mean = window.coverage[0].reshape(64, 2, 64, 2).mean(axis=(1, 3))
    assert np.abs(seen[0, 0] - mean).max() <= 0.5
    assert seen[0, 2].max() == pytest.approx(window.edge_dm.max(), abs=6)


def test_crowns_given_as_polygons_read_like_crowns_painted():
    xy, radius = crowded(2)
    painted = window_of(SQUARE, xy, radius, houses=[HOUSE])
    discs = shapely.buffer(shapely.points(xy), radius, quad_segs=32)
    cut = lot_windows(np.array([SQUARE], dtype=object), Surroundings(discs), Surroundings(np.array([HOUSE])))
    np.testing.assert_allclose(features_of(cut)[0], features_of(painted)[0], rtol=0.03, atol=0.06)
