"""Known plants that are kept as they are."""

from __future__ import annotations

import numpy as np
from shapely.geometry import box

from urbanforest_cli.placement.observed import NUMBERS_FROM, Observed, apart_from_fixed
from urbanforest_cli.placement.sites import Positions, Sites


def observed_of(ids, lot, radius=2.0):
    count = len(ids)
    return Observed(
        np.array(ids, dtype=object), np.array(lot, dtype=np.int64),
        np.column_stack((np.arange(count, dtype=float), np.zeros(count))), np.full(count, radius),
        np.full(count, np.nan), np.full(count, -1),
    )  # fmt: skip


def sites_of(count):
    lots = np.full(count, box(0, 0, 50, 50), dtype=object)
    keys = np.arange(count).astype(np.uint64)
    return Sites(np.arange(count).astype(str).astype(object), keys, lots, lots, {})


def test_discs_stand_beside_the_lots_they_belong_to():
    known = observed_of(["a", "b", "c", "d"], [0, 2, 2, 5])
    sites = known.beside(sites_of(3), np.array([5, 1, 2]))
    assert sites.fixed_offsets.tolist() == [0, 1, 1, 3]
    assert sites.fixed_xy[:, 0].tolist() == [3.0, 1.0, 2.0]
    assert sites.fixed_radius_m.tolist() == [2.0] * 3
    nobody = Observed.none().beside(sites_of(2), np.array([0, 1]))
    assert nobody.fixed_offsets.tolist() == [0, 0, 0]
    assert nobody.fixed_xy.shape == (0, 2)


def test_a_plant_keeps_its_number_among_others():
    few, more = observed_of(["7", "elm"], [0, 0]).numbers(), observed_of(["elm", "9", "7", "ü"], [0, 0, 1, 1]).numbers()
    assert few.tolist() == [more[2], more[0]]
    assert len(set(more.tolist())) == 4
    assert (more >= NUMBERS_FROM).all()
    assert (more < NUMBERS_FROM + 2**32).all()


def test_positions_that_meet_a_disc_of_their_own_lot_are_left_out():
    known = observed_of(["a", "b"], [0, 1])  # at 0, 0 in the first lot, at 1, 0 in the second, both of 2 m
    sites = known.beside(sites_of(3), np.array([0, 1, 2]))
    found = Positions(
        np.array([0, 0, 1, 1, 2]), np.array([[3.0, 0.0], [2.9, 0.0], [3.0, 0.0], [4.0, 0.0], [0.0, 0.0]]), np.ones(5),
        np.array([2]),
    )  # fmt: skip
    kept = apart_from_fixed(found, sites)
    assert kept.site.tolist() == [0, 1, 2]
    assert kept.xy[:, 0].tolist() == [3.0, 4.0, 0.0]  # touching is apart
    assert kept.refused.tolist() == [2]
    assert apart_from_fixed(found, sites_of(3)) is found
