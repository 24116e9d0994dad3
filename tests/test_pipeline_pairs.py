"""Pairs of coverage and parameters, made of planted lots."""

from dataclasses import fields

import geopandas as gpd
import numpy as np
import pytest
import shapely

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.pipeline_pairs import make_pairs
from urbanforest_cli.pipeline_towns import PLAIN_LOTS, SYNTHETIC_LOTS
from urbanforest_cli.regression.features import FEATURES

TAU, MU = REGRESSED.index("density"), REGRESSED.index("radius_mean_m")


@pytest.fixture(scope="module")
def pairs():
    return make_pairs(240, seed=3)


def assert_same(one, other):
    for item in fields(one):
        np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name), err_msg=item.name)


def test_arrays_have_the_shapes_and_ranges_they_are_said_to_have(pairs):
    assert len(pairs) == 240
    assert pairs.windows.shape == (240, 3, 64, 64)
    assert pairs.features.shape == (240, len(FEATURES))
    assert np.isfinite(pairs.features).all()
    assert pairs.windows[:, :2].max() <= 100
    assert pairs.windows[:, 2].max() <= 120
    assert set(pairs.pixel_m) == {1, 2}
    assert (pairs.visible <= pairs.placed).all()
    assert (pairs.visible == 0).mean() < 0.35
    assert pairs.lot.min() >= 0
    assert pairs.lot.max() < SYNTHETIC_LOTS + PLAIN_LOTS
    assert len(set(pairs.lot)) == 240


def test_a_pair_hangs_on_seed_and_number_alone(pairs):
    assert_same(make_pairs(60, seed=3, workers=3), pairs.take(np.arange(60)))
    other = make_pairs(60, seed=4)
    assert (other.values != pairs.values[:60]).mean() > 0.9


def test_values_and_strategies_may_be_set_and_lots_stay(pairs):
    values = np.full((240, 6), np.nan)
    values[:, TAU] = 1.0
    full = make_pairs(240, seed=3, values=values)
    np.testing.assert_array_equal(full.lot, pairs.lot)
    np.testing.assert_array_equal(full.placed, pairs.placed)
    np.testing.assert_array_equal(full.visible, pairs.placed)
    rest = np.arange(6) != TAU
    np.testing.assert_array_equal(full.values[:, rest], pairs.values[:, rest])
    band = make_pairs(240, seed=3, strategies=np.where(np.arange(240) < 100, 1, -1))
    assert (band.strategy[:100] == 1).all()
    np.testing.assert_array_equal(band.strategy[100:], pairs.strategy[100:])
    assert band.used[:100].tolist() == [[True, True, True, True, False, False]] * 100


def test_what_is_shown_is_what_was_planted():
    pairs = make_pairs(300, seed=1, design="P", degraded=False)
    read = dict(zip(FEATURES, pairs.features.T, strict=True))
    told = np.expm1(read["crown_count_log"])
    large = pairs.values[:, MU] > 2.5
    assert told[large].sum() == pytest.approx(pairs.visible[large].sum(), rel=0.1)
    assert np.corrcoef(told[large], pairs.visible[large])[0, 1] > 0.98
    many = large & (pairs.visible >= 5)
    error = read["crown_radius_mean_m"][many] - pairs.values[many, MU]
    assert abs(error.mean()) < 0.15
    assert (pairs.lot == np.arange(300)).all()


def test_the_share_left_standing_is_the_density():
    pairs = make_pairs(300, seed=2, design="S", degraded=False)
    off = pairs.visible - pairs.values[:, TAU] * pairs.placed
    assert abs(off).max() < 1
    assert abs(off.mean()) < 0.06


def test_three_lots_in_ten_have_no_house():
    pairs = make_pairs(400, seed=6, design="S", degraded=False)
    free = pairs.features[:, FEATURES.index("ground_share")]
    assert (free > 0.999).mean() == pytest.approx(0.32, abs=0.06)
    assert free.min() > 0.3


def test_maps_with_faults_differ_and_show_the_same_lots():
    clean, degraded = (make_pairs(120, seed=5, design="S", degraded=faults) for faults in (False, True))
    np.testing.assert_array_equal(clean.values, degraded.values)
    np.testing.assert_array_equal(clean.visible, degraded.visible)
    np.testing.assert_array_equal(clean.windows[:, 1:], degraded.windows[:, 1:])
    shift = degraded.windows[:, 0].mean(axis=(1, 2)) - clean.windows[:, 0].mean(axis=(1, 2))
    assert abs(shift.mean()) < 2
    assert (shift != 0).mean() > 0.5


def grid_of_lots(path, crs, scale, place):
    x, y = (values.ravel() * scale for values in np.meshgrid(np.arange(6) * 30.0, np.arange(4) * 40.0))
    lots = gpd.GeoDataFrame(geometry=shapely.box(x, y, x + 28 * scale, y + 38 * scale), crs=crs)
    lots.geometry = lots.translate(*place)
    lots.to_file(path, layer="parcels", driver="GPKG")
    houses = lots.copy()
    houses.geometry = lots.buffer(-9 * scale)
    houses.to_file(path, layer="buildings", driver="GPKG", mode="a")


@pytest.mark.parametrize(
    ("crs", "scale", "place"),
    [("EPSG:32611", 1.0, (500_000, 4_000_000)), ("EPSG:2229", 3.2808333, (6_480_000, 1_840_000))],
)
def test_real_lots_of_any_crs_are_planted_too(tmp_path, crs, scale, place):
    path = tmp_path / "lots.gpkg"
    grid_of_lots(path, crs, scale, place)
    count = SYNTHETIC_LOTS + PLAIN_LOTS + 24
    pairs = make_pairs(count // 12, lots=[f"{path}:parcels"], seed=7)
    again = make_pairs(10, lots=[f"{path}:parcels"], seed=7)
    assert_same(again, pairs.take(np.arange(10)))
    real = pairs.lot >= SYNTHETIC_LOTS + PLAIN_LOTS
    area = np.expm1(pairs.features[real, FEATURES.index("lot_area_log")])
    assert len(area) > 0
    assert area == pytest.approx(np.full(len(area), 28 * 38.0), rel=0.01)
    ground = pairs.features[real, FEATURES.index("ground_share")]
    assert (np.isclose(ground, 1.0) | (abs(ground - 0.81) < 0.02)).all()


def test_a_file_without_usable_lots_is_refused(tmp_path):
    path = tmp_path / "tiny.geojson"
    gpd.GeoDataFrame(geometry=[shapely.box(0, 0, 2, 2)], crs="EPSG:32633").to_crs(4326).to_file(path, driver="GeoJSON")
    with pytest.raises(InputError, match="no lot"):
        make_pairs(10, lots=[path])
