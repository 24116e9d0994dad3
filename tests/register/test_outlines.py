import numpy as np
import pytest
import shapely

from urbanforest_cli.register.outline_kernel import outlines
from urbanforest_cli.register.region_polygons import Outlines, joined_tiles, polygons_of_outlines

SIZE_M = 0.6
TOLERANCE = 0.08 / SIZE_M


def shares_of_disc(radius_m, rng, *, mask):
    """Shares (n, n) of cells that a disc covers, its centre anywhere in a cell; 0 and 1 as a mask has them."""
    radius, fine = radius_m / SIZE_M, 16
    n = int(2 * radius + 10)
    centre = n / 2 + rng.uniform(-0.5, 0.5, 2)
    at = (np.arange(n * fine) + 0.5) / fine - 0.5
    inside = (at[None] - centre[0]) ** 2 + (at[:, None] - centre[1]) ** 2 < radius**2
    share = inside.reshape(n, fine, n, fine).mean(axis=(1, 3))
    return (share >= 0.5).astype(float) if mask else share


def polygon_of(share):
    field = (share - 0.5).astype(np.float32)
    field[field == 0] = 1e-3
    xy, rings, part, _ = outlines(field, TOLERANCE)
    (shape,) = polygons_of_outlines([Outlines(xy, rings, part)], SIZE_M, 0.0)
    return shape


@pytest.mark.parametrize(("mask", "perimeter", "area"), [(False, 0.01, 0.005), (True, 0.03, 0.03)])
def test_a_disc_of_five_metres_has_neither_stairs_nor_another_size(mask, perimeter, area):
    rng = np.random.default_rng(2)
    found = [polygon_of(shares_of_disc(5.0, rng, mask=mask)) for _ in range(12)]
    assert max(abs(shape.length / (2 * np.pi * 5) - 1) for shape in found) < perimeter
    assert max(abs(shape.area / (np.pi * 25) - 1) for shape in found) < area
    assert all(len(shapely.get_coordinates(shape)) < 60 for shape in found)


def test_small_crowns_keep_their_area_on_average():
    rng = np.random.default_rng(4)
    for mask in (False, True):
        area = np.mean([polygon_of(shares_of_disc(1.2, rng, mask=mask)).area for _ in range(40)])
        assert area == pytest.approx(np.pi * 1.44, rel=0.03)


@pytest.mark.parametrize(("coarse", "within"), [(1, 0.25), (4, 0.02)])
def test_outlines_of_noise_are_valid_and_their_areas_those_of_the_cells(coarse, within):
    rng = np.random.default_rng(0)
    for least in (0.35, 0.5, 0.65):
        noise = rng.random((15 * 4 // coarse, 17 * 4 // coarse)).repeat(coarse, axis=0).repeat(coarse, axis=1)
        field = np.full((64, 72), -0.5, dtype=np.float32)
        field[2:-2, 2:-2] = np.where(noise < least, 0.5, -0.5)
        xy, rings, part, count = outlines(field, TOLERANCE)
        (shape,) = polygons_of_outlines([Outlines(xy, rings, part)], 1.0, 0.0)
        assert shapely.is_valid(shape)
        assert count == part.max() + 1
        assert shape.area == pytest.approx((field > 0).sum(), rel=within)


def test_holes_stay_holes_and_islands_in_them_stay_parts():
    row, col = np.mgrid[:61, :61] - 30
    far = np.hypot(row, col)
    field = np.where((far < 25) & (far > 15) | (far < 6), 0.5, -0.5).astype(np.float32)
    xy, rings, part, _ = outlines(field, TOLERANCE)
    (shape,) = polygons_of_outlines([Outlines(xy, rings, part)], 1.0, 0.0)
    assert len(shape.geoms) == 2
    assert sorted(len(piece.interiors) for piece in shape.geoms) == [0, 1]
    assert shape.area == pytest.approx((field > 0).sum(), rel=0.01)


def test_cells_that_touch_at_a_corner_are_two_parts():
    field = np.full((12, 12), -0.5, dtype=np.float32)
    field[2:5, 2:5] = field[5:8, 5:8] = 0.5
    xy, rings, part, count = outlines(field, TOLERANCE)
    assert count == 2
    (shape,) = polygons_of_outlines([Outlines(xy, rings, part)], 1.0, 0.0)
    assert shapely.is_valid(shape)


def test_rows_run_south_and_cells_are_counted_from_the_origin():
    field = np.full((9, 9), -0.5, dtype=np.float32)
    field[2:4, 3:8] = 0.5
    xy, rings, part, _ = outlines(field, TOLERANCE)
    shifted = Outlines(xy + np.array([1000.0, -2000.0]), rings, part)
    (shape,) = polygons_of_outlines([shifted], 0.5, 0.0)
    assert shape.bounds == pytest.approx((501.5, 998.0, 504.0, 999.0), abs=0.25)


def test_parts_below_the_least_are_dropped_and_nothing_is_none():
    field = np.full((20, 20), -0.5, dtype=np.float32)
    field[2:4, 2:4] = 0.5
    field[8:16, 8:16] = 0.5
    xy, rings, part, _ = outlines(field, TOLERANCE)
    found = polygons_of_outlines([Outlines(xy, rings, part), Outlines(xy[:0], rings[:1], part[:0])], 1.0, 20.0)
    assert len(found[0].geoms) == 1
    assert found[0].area == pytest.approx(64, rel=0.05)
    assert found[1] is None


def test_tiles_join_without_a_seam():
    disc = shapely.buffer(shapely.Point(10, 10), 6, quad_segs=32)
    boxes = [shapely.box(0, 0, 10, 20), shapely.box(10, 0, 20, 20)]
    joined = joined_tiles([shapely.multipolygons([disc]), shapely.multipolygons([disc])], boxes, 0.0)
    assert len(joined.geoms) == 1
    assert joined.area == pytest.approx(disc.area)
    assert joined_tiles([None, None], boxes, 0.0) is None
