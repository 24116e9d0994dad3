import numpy as np
import pytest
import shapely
from pyproj import CRS
from scipy import ndimage

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.register.painted import outline_of, painted_sketches, settled_levels

UTM = CRS.from_epsg(32633)


def grid(percent, pixel_m=0.5):
    height, width = percent.shape
    return RasterGrid(width, height, (pixel_m, 0.0, 400_000.0, 0.0, -pixel_m, 5_000_000.0), UTM)


def sketches(percent, least_m2=2.0, pixel_m=0.5):
    notices = Notices()
    percent = percent.astype(np.uint8)
    return painted_sketches(percent, grid(percent, pixel_m), least_m2=least_m2, notices=notices), notices


def disc(size, radius, oversampled=8):
    """Percent of every pixel that a disc in the middle covers."""
    at = (np.arange(size * oversampled) + 0.5) / oversampled - size / 2
    inside = np.hypot(at[:, None], at[None]) <= radius
    return np.rint(100 * inside.reshape(size, oversampled, size, oversampled).mean(axis=(1, 3)))


@pytest.mark.parametrize(("radius", "tolerance"), [(4, 0.05), (10, 0.02), (40, 0.01)])
def test_a_disc_comes_out_round_and_of_its_size(radius, tolerance):
    found, _ = sketches(disc(2 * radius + 10, radius))
    shape = found.geometry.iloc[0]
    assert len(found) == 1
    assert shape.area == pytest.approx(np.pi * radius**2 / 4, rel=tolerance)
    assert shape.length == pytest.approx(np.pi * radius, rel=0.03)
    middle = shape.centroid
    assert middle.x == pytest.approx(400_000 + (2 * radius + 10) / 4, abs=0.05)
    assert middle.y == pytest.approx(5_000_000 - (2 * radius + 10) / 4, abs=0.05)


def test_a_line_at_an_angle_has_no_stair_steps():
    percent = np.zeros((80, 200))
    for col in range(10, 190):
        row = int(20 + 0.2 * col)
        percent[row : row + 8, col] = 100
    shape = sketches(percent)[0].geometry.iloc[0]
    straight = 2 * (np.hypot(180, 36) + 8) / 2
    assert shape.length < 1.02 * straight


@pytest.mark.parametrize("size", [(1, 1), (1, 3), (2, 2), (1, 30)])
def test_the_smallest_patches_keep_their_area(size):
    patch = np.ones(size, dtype=bool)
    shape = outline_of(patch)
    assert shape.is_valid
    assert shape.area == pytest.approx(patch.sum(), rel=0.01)


def test_outlines_of_ragged_patches_are_valid_and_of_their_area():
    rng = np.random.default_rng(5)
    noise = ndimage.gaussian_filter(rng.normal(size=(150, 150)), 2.5)
    percent = np.where(noise > 0.05, 100, 0)
    found, _ = sketches(percent, least_m2=0)
    assert found.is_valid.all()
    assert found.area.sum() == pytest.approx((percent > 0).sum() / 4, rel=0.01)
    assert shapely.union_all(found.geometry.to_numpy()).area == pytest.approx(found.area.sum(), rel=0.005)


def test_holes_stay_and_small_ones_are_filled():
    percent = np.full((60, 60), 100)
    percent[:5] = percent[-5:] = percent[:, :5] = percent[:, -5:] = 0
    percent[20:40, 20:40] = 0
    percent[10, 10] = 0
    found, _ = sketches(percent)
    assert len(found.geometry.iloc[0].interiors) == 1
    assert found.area.iloc[0] == pytest.approx((2500 - 400) / 4, rel=0.01)


def test_patches_below_the_least_are_left_out_and_counted():
    percent = np.zeros((40, 40))
    percent[5:20, 5:20] = 100
    percent[30:32, 30:32] = 100
    found, notices = sketches(percent, least_m2=2.0)
    assert len(found) == 1
    assert notices.count("W_PAINT_SMALL") == 1


def test_gray_is_the_share_that_crowns_cover_and_parts_patches_that_touch():
    percent = np.zeros((40, 60))
    percent[10:30, 10:30] = 40
    percent[10:30, 30:50] = 100
    found, _ = sketches(percent)
    assert found["coverage"].tolist() == [0.4, 1.0]
    assert found.area.tolist() == pytest.approx([100, 100], rel=0.01)
    overlap = found.geometry.iloc[0].intersection(found.geometry.iloc[1]).area
    assert overlap < 1


def test_the_soft_edge_of_a_brush_belongs_to_it():
    soft = np.rint(100 * np.clip(ndimage.gaussian_filter((disc(80, 25) > 50).astype(float), 1.0), 0, 1))
    found, _ = sketches(soft)
    assert found["coverage"].tolist() == [1.0]
    assert found.area.iloc[0] == pytest.approx(np.pi * 25**2 / 4, rel=0.02)


def test_a_drawing_that_is_shaded_is_cut_into_quarters():
    percent = np.tile(np.linspace(0, 100, 200), (50, 1))
    levels = settled_levels(np.rint(percent).astype(np.uint8))
    assert set(np.unique(levels)) == {0, 25, 50, 75, 100}
    assert np.abs(levels - percent).max() <= 13


def test_a_sketch_keeps_its_name_when_another_is_painted():
    percent = np.zeros((60, 60))
    percent[30:45, 30:45] = 100
    before = sketches(percent)[0]["sketch_id"].tolist()
    percent[5:20, 5:20] = 100
    assert before[0] in sketches(percent)[0]["sketch_id"].tolist()
    assert sketches(percent)[0]["sketch_id"].is_unique


def test_a_picture_of_one_pixel_is_a_sketch():
    found, _ = sketches(np.array([[100]]), pixel_m=10.0)
    assert found.area.tolist() == pytest.approx([100], rel=0.01)
