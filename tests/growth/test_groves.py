"""Lots cut into groves, and rows of plants."""

import numpy as np
import pytest

from urbanforest_cli.core.config import Growth
from urbanforest_cli.growth.groves import cut_into_groves, number_in_lot, row_azimuth


def stands(rng, lots, most):
    lot, xy = [], []
    for number in range(lots):
        count = int(rng.integers(1, most))
        lot.append(np.full(count, number * 3))
        xy.append(rng.uniform(0, 1, (count, 2)) * rng.uniform(5, 200, 2) + [number * 300.0, 5e6])
    lot, xy = np.concatenate(lot), np.concatenate(xy)
    return lot, xy, rng.integers(0, 2**63, len(lot), dtype=np.uint64)


def spread_of(xy, grove):
    return np.array([np.ptp(xy[grove == number], axis=0).max() for number in range(grove.max() + 1)])


def test_groves_are_of_one_lot_neither_too_many_nor_too_long():
    lot, xy, keys = stands(np.random.default_rng(1), 40, 300)
    growth = Growth(grove_plants_max=20, grove_length_max_m=50.0)
    grove = cut_into_groves(lot, xy, keys, growth)
    counts = np.bincount(grove)
    assert counts.min() >= 1
    assert counts.max() <= 20
    assert spread_of(xy, grove).max() <= 50
    assert all(len(np.unique(lot[grove == number])) == 1 for number in range(len(counts)))
    assert np.unique(grove).tolist() == list(range(len(counts)))
    assert (np.diff(lot[np.argsort(grove, kind="stable")]) >= 0).all()


def test_groves_do_not_know_the_order_of_rows():
    rng = np.random.default_rng(2)
    lot, xy, keys = stands(rng, 20, 200)
    xy[50:80] = xy[50]  # many in one spot
    lot[50:80] = lot[50]
    growth = Growth(grove_plants_max=8)
    grove = cut_into_groves(lot, xy, keys, growth)
    shuffle = rng.permutation(len(lot))
    assert (cut_into_groves(lot[shuffle], xy[shuffle], keys[shuffle], growth) == grove[shuffle]).all()


def test_a_lot_within_the_limits_is_one_grove():
    lot, xy, keys = (
        np.repeat([4, 9], [48, 3]),
        np.random.default_rng(3).uniform(0, 59, (51, 2)),
        np.arange(51, dtype=np.uint64),
    )
    assert cut_into_groves(lot, xy, keys, Growth()).tolist() == [0] * 48 + [1] * 3


def test_a_long_row_is_cut_across_into_even_parts():
    xy = np.column_stack((np.arange(64) * 5.0, np.zeros(64)))
    grove = cut_into_groves(np.zeros(64, dtype=np.int64), xy, np.arange(64, dtype=np.uint64), Growth())
    assert np.bincount(grove).tolist() == [8] * 8
    assert (np.diff(grove) >= 0).all()


def test_two_plants_far_apart_are_two_groves_and_none_are_none():
    far = np.array([[0.0, 0.0], [500.0, 0.0]])
    assert cut_into_groves(np.zeros(2, np.int64), far, np.arange(2, dtype=np.uint64), Growth()).tolist() == [0, 1]
    none = np.empty(0, dtype=np.int64)
    assert len(cut_into_groves(none, np.empty((0, 2)), none.astype(np.uint64), Growth())) == 0
    assert len(number_in_lot(none, none)) == 0


def test_groves_are_numbered_from_0_within_their_lot():
    lot = np.array([5, 5, 2, 2, 2])
    assert number_in_lot(lot, np.array([2, 3, 0, 1, 1])).tolist() == [0, 1, 0, 1, 1]


def off_line(azimuth, expected, period=np.pi):
    """Return the largest angle between directions and one expected, as lines."""
    return np.abs((np.asarray(azimuth) - expected + period / 2) % period - period / 2).max()


@pytest.mark.parametrize("degrees", [0, 10, 45, 89.9, 90, 135, 179])
def test_plants_of_a_row_know_its_direction(degrees):
    angle = np.radians(degrees)
    along = np.arange(12)[:, None] * 3.0 * [np.cos(angle), np.sin(angle)]
    azimuth = row_azimuth(along + np.array([5e5, 5e6]), np.zeros(12, np.int64))
    assert off_line(azimuth, angle) < 1e-6
    assert ((azimuth >= 0) & (azimuth <= np.pi)).all()
    beside = along + 4.0 * np.array([-np.sin(angle), np.cos(angle)])
    both = row_azimuth(np.concatenate((along, beside)), np.zeros(24, np.int64))
    assert off_line(both, angle) < 0.35  # a second row 4 m off turns the ends of the first, and not far
    assert np.median([off_line(azimuth, angle) for azimuth in both]) < 0.05


def test_jittered_rows_change_little_and_curves_turn_smoothly():
    rng = np.random.default_rng(4)
    xy = np.column_stack((np.arange(30) * 2.5, np.zeros(30))) + rng.normal(0, 0.1, (30, 2))
    assert off_line(row_azimuth(xy, np.zeros(30, np.int64)), 0.0) < 0.12
    turn = np.arange(60) * 2 * np.pi / 60
    ring = 40 * np.column_stack((np.cos(turn), np.sin(turn)))
    azimuth = row_azimuth(ring, np.zeros(60, np.int64))
    assert off_line(azimuth, turn + np.pi / 2) < 1e-6


def test_a_square_lattice_is_seen_along_one_of_its_sides():
    i, j = np.meshgrid(np.arange(6), np.arange(6))
    angle = np.radians(25)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = 6.0 * np.column_stack((i.ravel(), j.ravel())) @ turn
    assert off_line(row_azimuth(turned, np.zeros(36, np.int64)), angle, np.pi / 2) < 1e-6


def test_plants_alone_in_their_lot_or_in_reach_look_east():
    xy = np.array([[0.0, 0], [3, 3], [6, 6], [100, 100]])
    assert row_azimuth(xy, np.array([0, 1, 1, 1])) == pytest.approx([0, np.pi / 4, np.pi / 4, 0])
    assert row_azimuth(xy[:1], np.array([0])).tolist() == [0.0]
    assert row_azimuth(np.zeros((3, 2)), np.zeros(3, np.int64)).tolist() == [0.0] * 3
    assert len(row_azimuth(np.empty((0, 2)), np.empty(0, np.int64))) == 0


def test_directions_do_not_know_the_order_of_rows():
    rng = np.random.default_rng(6)
    lot, xy, _ = stands(rng, 12, 60)
    shuffle = rng.permutation(len(lot))
    assert row_azimuth(xy[shuffle], lot[shuffle]) == pytest.approx(row_azimuth(xy, lot)[shuffle], abs=1e-9)
