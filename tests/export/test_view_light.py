"""Maps of shade: leaves by Beer and Lambert, houses by geometry, the sky by what is open."""

import numpy as np
import pytest

from urbanforest_cli.export.view.draw import sky_rays
from urbanforest_cli.export.view.light import Weather, ring_over
from urbanforest_cli.export.view.light_kernel import (
    beside_houses,
    leaf_depth,
    open_sky,
    open_up,
    raise_faces,
    ring_at,
    splat,
    sum_up,
)

SUN = Weather(270.0, 45.0, (0.0, 0.0), 40.0)


def ring(width=40.0, cells=200, sun=SUN, highest=12.0):
    slant = sun.sun[:2] / sun.sun[2]
    return ring_over(np.array([-width / 2, -width / 2]), width, highest, slant, cells=cells)


def all_rows(held):
    return 0, held.shade.shape[1], 0, held.leaf.shape[1]


def house(height=6.0, side=4.0):
    low, high = -side / 2, side / 2
    return np.array([[[low, low, height], [high, low, height], [high, high, height]],
                     [[low, low, height], [high, high, height], [low, high, height]],
                     [[low, low, 0], [low, high, 0], [low, high, height]],
                     [[low, low, 0], [low, high, height], [low, low, height]]])  # fmt: skip


def test_the_sun_stands_where_the_weather_says():
    assert Weather(90.0, 30.0, (0, 0), 1.0).sun == pytest.approx([np.sqrt(0.75), 0.0, 0.5])
    assert Weather(180.0, 1.0, (0, 0), 1.0).sun[2] > 0.2  # a sun on the horizon has no end of shade


def test_leaves_shade_what_lies_on_the_ray_below_them():
    held = ring()
    for x in np.arange(-1.0, 1.0, 0.1):
        for y in np.arange(-1.0, 1.0, 0.1):
            splat(held, x, y, 6.2, 0.01 * 0.8, *all_rows(held))  # 0.8 square metres on each
    sum_up(held)
    for drop in (2.0, 4.0, 6.0):  # the sun is in the west, 45 degrees high: shade wanders east as it falls
        assert leaf_depth(held, drop, 0.0, 6.2 - drop) == pytest.approx(0.8, rel=0.15)
        assert leaf_depth(held, -drop, 0.0, 6.2 - drop) == 0
    assert leaf_depth(held, 0.0, 0.0, 9.0) == 0


def test_leaves_are_counted_once_however_rows_are_cut():
    whole, cut = ring(), ring()
    rng = np.random.default_rng(3)
    points = np.column_stack((rng.uniform(-15, 15, (400, 2)), rng.uniform(0, 10, 400)))
    for x, y, z in points:
        splat(whole, x, y, z, 1.0, *all_rows(whole))
        for top in range(0, 200, 50):
            splat(cut, x, y, z, 1.0, top, top + 50, top * 3 // 10, top * 3 // 10 + 15)
    assert whole.shade.sum() * whole.cell**2 == pytest.approx(400.0, rel=0.12)
    assert (whole.shade == cut.shade).all()
    assert (whole.leaf == cut.leaf).all()


def test_a_house_casts_a_shadow_as_long_as_the_sun_is_low():
    held = ring()
    raise_faces(held.solid, held.low, held.cell, held.slant, house())
    lit = [beside_houses(held, x, 0.0, 0.01) for x in np.arange(2.5, 12.0, 0.5)]
    edge = 2.0 + 6.0  # half of the house, and its height at 45 degrees
    assert all(share == 0 for share, x in zip(lit, np.arange(2.5, 12.0, 0.5), strict=True) if x < edge - 0.3)
    assert all(share == 1 for share, x in zip(lit, np.arange(2.5, 12.0, 0.5), strict=True) if x > edge + 0.3)
    assert beside_houses(held, -3.0, 0.0, 0.01) == 1
    assert beside_houses(held, 5.0, 0.0, 3.5) == 1  # above the shadow


def test_the_sky_is_open_on_a_plain_half_hidden_by_a_wall_and_closed_in_a_crown():
    held = ring(cells=400)
    open_up(held, sky_rays())
    assert open_sky(held, 5.0, 5.0, 0.1) == pytest.approx(1.0)
    raise_faces(held.roof, held.low, held.sky_cell, np.zeros(2), house(height=12.0, side=10.0))
    open_up(held, sky_rays())
    assert 0.3 < open_sky(held, 5.8, 0.0, 0.5) < 0.75
    assert open_sky(held, 17.0, 17.0, 0.5) > open_sky(held, 7.0, 0.0, 0.5)
    thick = ring(cells=400)
    thick.leaf[3:5] = 1.5
    open_up(thick, sky_rays())
    assert open_sky(thick, 0.0, 0.0, 0.5) < 0.15
    assert open_sky(thick, 0.0, 0.0, 11.0) > 0.95


def test_places_are_lit_by_the_finest_ring_that_holds_them_and_near_its_rim_by_the_next_too():
    rings = (ring(40.0), ring(160.0), ring(640.0))
    found = [ring_at(rings, x, 0.0, 0.0) for x in (0.0, 50.0, 200.0, 900.0)]
    assert [which for which, _ in found] == [0, 1, 2, 3]
    assert [share for _, share in found] == [0, 0, 0, 0]
    seams = [ring_at(rings, x, 0.0, 0.0)[1] for x in (17.0, 18.0, 19.0, 19.8)]
    assert (np.diff(seams) > 0).all()
    assert 0 < seams[-1] <= 1
    assert ring_at(rings, 19.9, 0.0, 0.0)[0] == 1
