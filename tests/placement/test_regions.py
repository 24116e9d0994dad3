"""Crowns fitted to the covered ground of lots."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.core.config import Coverage, Placement
from urbanforest_cli.placement import regions
from urbanforest_cli.placement.regions import Regions, fill_regions
from urbanforest_cli.placement.sites import Sites

EAST, NORTH = 459_000.0, 5_549_000.0
LOT = shapely.box(EAST, NORTH, EAST + 60, NORTH + 60)
WOOD = shapely.box(EAST + 5, NORTH + 5, EAST + 55, NORTH + 50)


def crowns_of(*discs):
    return shapely.union_all([shapely.Point(EAST + x, NORTH + y).buffer(r, quad_segs=32) for x, y, r in discs])


APART = [(10, 10, 3.0), (30, 12, 2.0), (50, 15, 4.0), (15, 40, 5.0), (40, 45, 1.5)]


def sites_of(shapes, *, keys=None, mean=3.0, variance=0.5, grounds=None, fixed=None):
    count = len(shapes)
    areas = [shapely.intersection(shape, LOT) for shape in shapes] if grounds is None else grounds
    sites = Sites(
        lot_ids=np.array([str(i) for i in range(count)], dtype=object),
        keys=np.arange(1, count + 1).astype(np.uint64) if keys is None else np.array(keys, dtype=np.uint64),
        lots=np.full(count, LOT, dtype=object),
        areas=np.array(areas, dtype=object),
        values={"radius_mean_m": np.full(count, mean), "radius_variance_m2": np.full(count, variance)},
    )
    if fixed is None:
        return sites
    xy = np.array([(EAST + x, NORTH + y) for lot in fixed for x, y, _ in lot]).reshape(-1, 2)
    radius = np.array([r for lot in fixed for *_, r in lot], dtype=np.float64)
    offsets = np.concatenate([[0], np.cumsum([len(lot) for lot in fixed])])
    return Sites(**{**sites.__dict__, "fixed_xy": xy, "fixed_radius_m": radius, "fixed_offsets": offsets})


def fill(shapes, *, coverage=None, settings=None, overlap=0.25, **options):
    share = np.ones(len(shapes)) if coverage is None else np.array(coverage, dtype=np.float64)
    found = fill_regions(
        sites_of(shapes, **options), Regions(np.array(shapes, dtype=object), share),
        Placement(**(settings or {})), Coverage(crown_overlap=overlap),
    )  # fmt: skip
    return found


def union_of(found, row=0):
    of_row = found.site == row
    return shapely.union_all(shapely.buffer(shapely.points(found.xy[of_row]), found.radius_m[of_row], quad_segs=32))


def test_crowns_that_stand_apart_are_found_again():
    found = fill([crowns_of(*APART)])
    assert len(found) == len(APART)
    for x, y, radius in APART:
        apart = np.hypot(*(found.xy - (EAST + x, NORTH + y)).T)
        assert apart.min() < 0.2
        assert found.radius_m[apart.argmin()] == pytest.approx(radius, abs=0.15)


def test_closed_canopy_is_filled_to_what_the_map_shows():
    found = fill([WOOD], mean=3.0)
    assert shapely.area(union_of(found)) == pytest.approx(WOOD.area, rel=0.03)
    assert shapely.area(shapely.intersection(union_of(found), WOOD)) > 0.9 * WOOD.area
    assert found.radius_m.mean() == pytest.approx(3.0, rel=0.3)
    assert 1.0 < np.pi * (found.radius_m**2).sum() / WOOD.area < 1.8  # crowns share ground, but do not pile up


def test_seeds_vary_what_the_map_does_not_show():
    one, same, other = (fill([WOOD], keys=[key]) for key in (3, 3, 4))
    assert np.array_equal(one.xy, same.xy)
    assert np.array_equal(one.radius_m, same.radius_m)
    assert not {tuple(place) for place in np.round(one.xy, 3)} & {tuple(place) for place in np.round(other.xy, 3)}
    first, second = (fill([crowns_of(*APART)], keys=[key]) for key in (3, 4))
    assert np.abs(np.sort(first.xy, axis=0) - np.sort(second.xy, axis=0)).max() < 0.1


def test_stems_stand_in_their_ground_though_crowns_reach_beyond():
    ground = shapely.box(EAST + 5, NORTH + 5, EAST + 22.17, NORTH + 50)
    found = fill([WOOD], grounds=[ground])
    assert len(found) > 10
    assert shapely.covers(ground, shapely.points(found.xy)).all()
    assert not shapely.covers(ground, union_of(found))
    across = fill([crowns_of((0.0, 30, 4.0))])  # half of it lies beyond the lot
    assert shapely.covers(LOT, shapely.points(across.xy)).all()
    assert shapely.area(union_of(across)) > 0.6 * np.pi * 16


def test_a_stem_a_fraction_of_a_cell_outside_moves_into_its_ground():
    ground = shapely.box(0, 0, 10, 10)
    moved = regions._into_ground(np.array([[5.0, 5.0], [10.2, 4.0], [9.9999, 7.0]]), ground)
    assert moved[0].tolist() == [5.0, 5.0]
    assert shapely.covers(ground, shapely.points(moved)).all()
    assert moved[1:, 0] == pytest.approx(10 - regions.INSET_M)
    sliver = shapely.box(0, 0, 0.01, 5)
    assert shapely.covers(sliver, shapely.points(regions._into_ground(np.array([[0.3, 2.0]]), sliver))).all()


def test_lots_do_not_depend_on_one_another():
    shapes = [crowns_of(*APART), WOOD, crowns_of((30, 30, 6))]
    together = fill(shapes, coverage=[1, 0.6, 1], keys=[5, 6, 7])
    for row, key in enumerate((5, 6, 7)):
        alone = fill([shapes[row]], coverage=[(1, 0.6, 1)[row]], keys=[key])
        assert np.array_equal(together.xy[together.site == row], alone.xy)
        assert np.array_equal(together.radius_m[together.site == row], alone.radius_m)


def test_a_lot_larger_than_a_grid_is_filled_square_by_square(monkeypatch):
    whole = fill([crowns_of(*APART)])
    sizes = []
    rastered = regions.raster_shares
    monkeypatch.setattr(
        regions, "raster_shares", lambda *arguments: sizes.append(arguments[-2:]) or rastered(*arguments)
    )
    monkeypatch.setattr(regions, "CELLS_MAX", 2_000)
    monkeypatch.setattr(regions, "SQUARE_CELLS", 80)
    cut = fill([crowns_of(*APART)])
    assert len(sizes) > 2
    assert set(sizes) == {(80, 80)}
    for (x, y), radius_m in zip(whole.xy, whole.radius_m, strict=True):
        near = np.hypot(*(cut.xy - (x, y)).T) < radius_m
        assert near.any()
        assert cut.radius_m[near].max() == pytest.approx(radius_m, rel=0.35)
    assert shapely.area(union_of(cut)) == pytest.approx(shapely.area(union_of(whole)), rel=0.12)


def test_squares_of_a_wood_hold_as_many_crowns_as_one_grid(monkeypatch):
    whole = fill([WOOD, WOOD, WOOD], mean=2.0)
    monkeypatch.setattr(regions, "CELLS_MAX", 2_000)
    monkeypatch.setattr(regions, "SQUARE_CELLS", 64)
    cut = fill([WOOD, WOOD, WOOD], mean=2.0)
    assert len(cut) == pytest.approx(len(whole), rel=0.15)
    assert cut.radius_m.mean() == pytest.approx(whole.radius_m.mean(), rel=0.1)
    assert shapely.area(shapely.intersection(union_of(cut), WOOD)) / WOOD.area > 0.93
    assert shapely.covers(WOOD, shapely.points(cut.xy)).all()


def test_a_lot_with_too_many_plants_gets_none_and_is_named():
    found = fill([crowns_of(*APART), WOOD, crowns_of((30, 30, 4))], settings={"max_plants_per_lot": 10})
    assert found.refused.tolist() == [1]
    assert set(found.site) == {0, 2}
    every = fill([WOOD], settings={"max_plants_per_lot": 10})
    assert (every.refused.tolist(), len(every)) == ([0], 0)


def test_a_share_below_one_leaves_that_much_bare():
    found = fill([WOOD, WOOD, WOOD], coverage=[0.3, 0.6, 0.0])
    for row, share in enumerate((0.3, 0.6)):
        assert shapely.area(shapely.intersection(union_of(found, row), WOOD)) / WOOD.area == pytest.approx(
            share, abs=0.05
        )
    assert not (found.site == 2).any()


def test_crowns_that_stand_already_are_not_planted_again():
    shape = crowns_of(*APART)
    found = fill([shape, shape], fixed=[[APART[0], APART[3]], []])
    assert (found.site == 0).sum() == 3
    assert (found.site == 1).sum() == 5
    rest = union_of(found, 0)
    assert shapely.area(shapely.intersection(rest, crowns_of(APART[0], APART[3]))) < 1.0


def test_crowns_fill_what_those_that_stand_leave():
    fixed = [(20, 20, 6.0), (40, 35, 5.0)]
    found = fill([WOOD], fixed=[fixed])
    assert shapely.area(shapely.union(union_of(found), crowns_of(*fixed))) == pytest.approx(WOOD.area, rel=0.04)
    apart = np.hypot(*(found.xy[:, None] - [(EAST + x, NORTH + y) for x, y, _ in fixed]).transpose(2, 0, 1))
    assert (apart > [6.0, 5.0]).all()  # no stem under their crowns


def test_no_ground_or_no_region_means_no_crowns():
    found = fill([WOOD, shapely.MultiPolygon()], grounds=[shapely.MultiPolygon(), LOT])
    assert (len(found), len(found.refused)) == (0, 0)


def test_sigma_is_what_the_config_says():
    as_variance = fill([WOOD], variance=1.2)
    as_sd = fill([WOOD], variance=1.2**0.5, settings={"sigma_is": "sd"})
    assert np.array_equal(as_variance.xy, as_sd.xy)
    assert not np.array_equal(as_variance.xy, fill([WOOD], variance=1.2**0.5).xy)
