from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import Evidence, exponents
from urbanforest_cli.regression.pooling import ALIKE, GRID, LEVELS, Pooled, pool
from urbanforest_cli.regression.pooling_kernel import sum_around

SIX = len(REGRESSED)
ALMOST_APART = [column for column, name in enumerate(REGRESSED) if ALIKE[name] < 0.05]
TRUTHS = np.array([0.5, 0.2, 0.8, 0.97, 0.35, 0.6])


class World:
    """Lots around values that their zone's config does not know, each seen through 0 to 40 coin flips."""

    def __init__(self, lots, strays, seed=1, truths=TRUTHS, flips=(0, 1, 3, 10, 40)):
        rng = np.random.default_rng(seed)
        self.centres = rng.uniform(0, np.sqrt(600 * lots), (lots, 2))
        self.ids = np.array([f"lot {i}" for i in range(lots)], dtype=object)
        self.zones = np.full(lots, "residential", dtype=object)
        self.zone_value = np.full((lots, SIX), 0.5)
        self.truth = np.clip(truths + strays * rng.standard_normal((lots, SIX)), 0.005, 0.995)
        count = rng.choice(flips, (lots, SIX))
        heads = rng.binomial(count, self.truth)
        a, b = heads + 1.0, count - heads + 1.0
        self.mean = a / (a + b)
        self.spread = np.sqrt(self.mean * (1 - self.mean) / (a + b + 1))

    def evidence(self, rows=slice(None)):
        low, high = exponents(self.mean[rows], self.spread[rows])
        return Evidence(low, high, np.full((len(low), 3), 1 / 3), np.full(len(low), 20.0))

    def pooled(self, rows=slice(None), radius_m=150.0, zone_spread=0.25) -> Pooled:
        return pool(
            self.centres[rows], self.zones[rows], self.ids[rows], self.evidence(rows), self.zone_value[rows],
            radius_m=radius_m, zone_spread=zone_spread,
        )  # fmt: skip


def rms(errors):
    return np.sqrt((errors**2).mean(axis=0))


@pytest.fixture(scope="module")
def world():
    return World(1500, 0.1)


@pytest.fixture(scope="module")
def pooled(world):
    return world.pooled()


def test_pooling_beats_the_lot_alone_and_the_zone_alone(world, pooled):
    alone, zone, ours = (rms(found - world.truth) for found in (world.mean, world.zone_value, pooled.mean))
    assert (ours < 0.8 * alone).all()
    assert (ours < zone).all()
    assert ours.max() < 0.1


def test_spreads_cover_what_they_say(world, pooled):
    inside = [(np.abs(pooled.mean - world.truth) < times * pooled.spread)[:, :2].mean() for times in (1.0, 1.645, 1.96)]
    np.testing.assert_allclose(inside, [0.68, 0.9, 0.95], atol=0.05)


def test_spreads_cover_what_they_say_where_the_maps_of_a_neighbourhood_err_alike():
    rng, hits = np.random.default_rng(2), []
    for number in range(40):
        town = World(40, 0.03, seed=number, truths=np.full(SIX, 0.5))
        town.mean = np.clip(town.truth + 0.1 * rng.standard_normal() + 0.1 * rng.standard_normal((40, SIX)), 0, 1)
        town.spread[:] = 0.141
        found = town.pooled()
        hits.append(np.abs(found.mean - town.truth) < 2 * found.spread)
    inside = np.concatenate(hits).mean(axis=0)
    assert inside[REGRESSED.index("density")] > 0.9
    assert inside[REGRESSED.index("radius_mean_m")] < 0.8


@pytest.mark.parametrize("strays", [0.04, 0.1, 0.2])
def test_how_far_lots_stray_is_found_in_the_data(strays):
    found = World(1500, strays, seed=3, truths=np.full(SIX, 0.5)).pooled().strays["residential"]
    nearest = LEVELS[int(np.argmin(np.abs(np.array(LEVELS) - strays)))]
    step = 0.05
    assert (np.abs(found - nearest) <= step)[ALMOST_APART].all()


def test_without_neighbours_the_value_is_that_of_the_prior_and_the_lots_own_evidence():
    lone = World(1, 0.1, flips=(10,))
    found = lone.pooled(radius_m=0.0)
    low, high = exponents(lone.mean, lone.spread)
    prior = np.exp(-0.5 * ((GRID - 0.5) / 0.25) ** 2)
    for column in range(SIX):
        posterior = prior * GRID ** low[0, column] * (1 - GRID) ** high[0, column]
        mean = (posterior * GRID).sum() / posterior.sum()
        assert found.mean[0, column] == pytest.approx(mean, abs=0.03)
    assert (found.heard == 0).all()
    assert (found.left_alone == found.left).all()


def test_a_surer_map_leaves_a_smaller_spread_and_a_higher_one_a_higher_value():
    world = World(1, 0.0, flips=(10,))
    values, spreads = [], []
    for shift in (0.2, 0.4, 0.6, 0.8):
        world.mean[:], world.spread[:] = shift, 0.1
        values.append(world.pooled().mean[0, 0])
    for spread in (0.28, 0.2, 0.1, 0.05):
        world.mean[:], world.spread[:] = 0.5, spread
        spreads.append(world.pooled().spread[0, 0])
    assert np.all(np.diff(values) > 0)
    assert np.all(np.diff(spreads) < 0)


def test_what_is_left_of_the_spread_without_a_map_is_all_of_it_and_else_the_less_the_more_is_told():
    lone, left = World(1, 0.1, flips=(10,)), []
    for spread in (12.0**-0.5, 0.2, 0.1, 0.05):
        lone.mean[:], lone.spread[:] = 0.5, spread
        left.append(lone.pooled(radius_m=0.0).left_alone[0, 0])
    assert left[0] == 1
    assert np.all(np.diff(left) < 0)
    assert left[2] == pytest.approx((1 / (1 + 0.25**2 * (100 - 12))) ** 0.5, abs=0.005)
    crowd = World(200, 0.03, flips=(40,)).pooled()
    assert (crowd.left[:, 0] < 0.75 * crowd.left_alone[:, 0]).all()


def test_a_lot_without_a_map_hears_its_neighbours_but_not_another_zone(world):
    mute = World(400, 0.05, seed=5, truths=np.full(SIX, 0.8), flips=(40,))
    mute.zones[::2] = "commercial"
    silent = np.arange(0, 400, 10)
    mute.mean[silent], mute.spread[silent] = 0.5, 12.0**-0.5
    told = mute.pooled()
    assert np.abs(told.mean[silent] - 0.8).max() < 0.15
    others = mute.zones == "commercial"
    mute.mean[others], mute.spread[others] = 0.5, 12.0**-0.5
    alone = mute.pooled()
    assert np.abs(alone.mean[others] - 0.5).max() < 0.01
    assert (alone.heard[others] == 0).all()


def test_only_lots_within_the_radius_are_heard():
    world = World(2, 0.0, truths=np.full(SIX, 0.9), flips=(40,))
    world.mean[1], world.spread[1] = 0.5, 12.0**-0.5
    for apart, heard in ((100.0, 1), (149.9, 1), (150.1, 0)):
        world.centres = np.array([[0.0, 0.0], [apart, 0.0]])
        found = world.pooled()
        assert found.heard.tolist() == [0, heard]
        assert (found.mean[1, 0] > 0.51) == bool(heard)


def test_one_neighbour_however_sure_tells_no_more_than_lots_stray():
    world = World(2, 0.0, flips=(40,))
    world.centres = np.zeros((2, 2))
    world.mean[0], world.spread[0] = 0.5, 0.02
    world.mean[1], world.spread[1] = 0.5, 12.0**-0.5
    found = world.pooled()
    strays = found.strays["residential"][0] ** 2
    means = 0.25**2 - strays if strays < 0.25**2 / 2 else 0.25**2 / 2
    told = 1 / (1 / (1 / 0.02**2 - 12) + strays)
    narrowed = 1 / (1 / means + told) + strays
    assert found.left[1, 0] == pytest.approx(np.sqrt(narrowed / (means + strays)), abs=0.01)


def test_the_order_of_lots_does_not_matter_to_the_last_bit(world, pooled):
    order = np.random.default_rng(2).permutation(len(world.ids))
    shuffled = world.pooled(order)
    assert (shuffled.mean == pooled.mean[order]).all()
    assert (shuffled.spread == pooled.spread[order]).all()
    assert (shuffled.heard == pooled.heard[order]).all()


def test_a_change_of_one_lot_is_felt_within_the_radius_alone(world, pooled):
    world = World(1500, 0.1)
    world.mean[700], world.spread[700] = 0.4, 0.1
    moved = (world.pooled().mean != pooled.mean).any(axis=1)
    far = np.hypot(*(world.centres - world.centres[700]).T) > 150
    assert moved[~far].sum() > 20
    assert not moved[far].any()


def test_lots_without_a_place_and_no_lots_at_all_are_no_fault():
    world = World(3, 0.1, flips=(10,))
    world.centres[1] = np.nan
    assert np.isfinite(world.pooled().mean).all()
    assert World(0, 0.1).pooled().mean.shape == (0, SIX)


def test_the_kernel_agrees_with_its_slow_twin():
    rng = np.random.default_rng(4)
    xy = rng.uniform(0, 700, (300, 2))
    strips = np.floor((xy[:, 1] - xy[:, 1].min()) / 100).astype(np.int64)
    order = np.lexsort((xy[:, 0], strips))
    xy, strips = xy[order], strips[order]
    columns, speaks = rng.uniform(0, 5, (300, 2)), rng.random(300) < 0.7
    columns[~speaks] = 0
    starts = np.searchsorted(strips, np.arange(strips[-1] + 2)).astype(np.int64)
    total, heard = np.zeros((300, 2)), np.zeros(300, dtype=np.int64)
    sum_around(xy[:, 0].copy(), xy[:, 1].copy(), starts, np.arange(300), 100.0, 50.0, columns, speaks, total, heard)
    apart = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1))
    near = (apart <= 100) & speaks & ~np.eye(300, dtype=bool)
    np.testing.assert_array_equal(heard, near.sum(axis=1))
    np.testing.assert_allclose(total, (near * np.exp(-0.5 * (apart / 50) ** 2)) @ columns)
