import numpy as np
import pytest
import shapely
from pyproj import CRS

from tests.register.covering import (
    SOUTH,
    UTM,
    WEST,
    disc,
    sampled_map,
    shares_of,
    square_grid,
    write_map,
    write_percent,
)
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.coverage_windows import MetricCoverage

DISCS = [disc(30, 40, 7), disc(90, 95, 12), disc(150, 20, 3)]


def opened(path, working=UTM, **options):
    return MetricCoverage(path, working=working, band="canopy", notices=Notices(), **options)


def box_of(west, south, east, north):
    return WEST + west, SOUTH + south, WEST + east, SOUTH + north


@pytest.fixture
def ragged(tmp_path):
    """A map of noise, 31 x 47 pixels of 0.6 m that begin between two cells."""
    values = np.random.default_rng(3).integers(0, 101, (31, 47)).astype(np.uint8)
    values[4:9, 6:11] = 255
    return write_map(tmp_path / "map.tif", [], bounds=(0.2, 0.4, 0.2 + 47 * 0.6, 0.4 + 31 * 0.6), values=values), values


def test_pixels_that_are_cells_come_back_as_they_are(tmp_path):
    values = np.random.default_rng(1).integers(0, 101, (20, 30)).astype(np.uint8)
    values[3, 4] = 255
    path = write_map(tmp_path / "map.tif", [], bounds=(0, 0, 15, 10), size=0.5, values=values)
    with opened(path) as coverage:
        assert coverage.resolution_m == 0.5
        assert coverage.bounds_m == pytest.approx(box_of(0, 0, 15, 10))
        cells, (west, north) = coverage.read(*box_of(0.1, 0.1, 14.9, 9.9))
    assert (west, north) == (WEST, SOUTH + 10)
    assert (cells == values).all()


def test_a_cell_is_the_same_in_every_window(ragged):
    path, _ = ragged
    with opened(path) as coverage:
        whole, (west, north) = coverage.read(*box_of(-5, -5, 40, 30))
        rng = np.random.default_rng(0)
        for _ in range(20):
            x, y = rng.uniform(-5, 30, 2)
            part, (left, top) = coverage.read(*box_of(x, y, x + 7, y + 6))
            row, col = round((north - top) / 0.6), round((left - west) / 0.6)
            shown = whole[max(row, 0) : row + part.shape[0], max(col, 0) : col + part.shape[1]]
            assert (part[max(-row, 0) :, max(-col, 0) :][: shown.shape[0], : shown.shape[1]] == shown).all()


def test_beyond_the_map_and_in_its_gaps_nothing_is_known(ragged):
    path, _ = ragged
    with opened(path) as coverage:
        far, _ = coverage.read(*box_of(1000, 1000, 1010, 1010))
        whole, (west, north) = coverage.read(*box_of(-5, -5, 40, 30))
    assert (far == 255).all()
    gap_row, gap_col = (north - (SOUTH + 0.4 + 31 * 0.6)) / 0.6 + 6.5, (WEST + 0.2 - west) / 0.6 + 8.5
    assert whole[int(gap_row), int(gap_col)] == 255
    assert 31 * 47 - 25 - 60 < (whole != 255).sum() < 31 * 47 - 25 + 100


@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_cells_of_any_size_keep_the_area_under_canopy(tmp_path, size):
    path = write_map(tmp_path / "map.tif", DISCS)
    with opened(path, resolution_m=size) as coverage:
        cells, _ = coverage.read(*box_of(-30, -30, 210, 210))
    known = np.where(cells == 255, 0, cells)
    assert known.sum() / 100 * size**2 == pytest.approx(sum(item.area for item in DISCS), rel=0.005)


@pytest.mark.parametrize(
    ("crs", "size"),
    [("EPSG:4326", 6e-6), ("EPSG:3857", 0.9), ("EPSG:2225", 2.0), ("EPSG:25833", 0.6)],
    ids=["degrees", "mercator", "feet", "metres"],
)
def test_a_map_in_another_crs_shows_the_same_ground(tmp_path, crs, size):
    working, shapes = UTM, DISCS
    if crs == "EPSG:2225":  # a place where these feet are at home
        working = CRS.from_epsg(26910)
        path = _californian(tmp_path / "map.tif", CRS.from_epsg(2225), size)
    else:
        path = sampled_map(tmp_path / "map.tif", shapes, CRS.from_user_input(crs), size)
    with opened(path, working=working, resolution_m=0.6) as coverage:
        cells, (west, north) = coverage.read(*box_of(-20, -20, 200, 200))
    grid = square_grid((0, 0, cells.shape[1] * 0.6, cells.shape[0] * 0.6), 0.6)
    shapes = shapely.transform(np.array(DISCS), lambda xy: xy - (west - WEST, north - SOUTH - cells.shape[0] * 0.6))
    wanted = shares_of(list(shapes), grid)
    assert (cells != 255).all()
    assert np.abs(cells.astype(int) - wanted).mean() < 0.35
    assert np.abs((cells >= 50).mean() / (wanted >= 50).mean() - 1) < 0.02


def _californian(path, crs, size):
    from urbanforest_cli.core.crs import reproject
    from urbanforest_cli.core.raster_grid import RasterGrid

    utm = CRS.from_epsg(26910)
    whole = shapely.box(WEST - 40, SOUTH - 40, WEST + 220, SOUTH + 220)
    west, south, east, north = shapely.bounds(reproject(np.array([shapely.segmentize(whole, 10)]), utm, crs))[0]
    width, height = int((east - west) / size), int((north - south) / size)
    shapes = shapely.union_all(reproject(np.array(DISCS), utm, crs))
    shapely.prepare(shapes)
    x, y = np.meshgrid(west + (np.arange(width * 5) + 0.5) / 5 * size, north - (np.arange(height * 5) + 0.5) / 5 * size)
    share = shapely.contains_xy(shapes, x, y).reshape(height, 5, width, 5).mean(axis=(1, 3))
    grid = RasterGrid(width, height, (size, 0.0, west, 0.0, -size, north), crs)
    return write_percent(path, np.rint(100 * share).astype(np.uint8), grid)


def test_its_own_resolution_is_kept_within_limits(tmp_path):
    fine = write_map(tmp_path / "fine.tif", DISCS, bounds=(0, 0, 20, 20), size=0.1)
    coarse = write_map(tmp_path / "coarse.tif", DISCS, bounds=(0, 0, 200, 200), size=10.0)
    with opened(fine) as first, opened(coarse) as second:
        assert (first.resolution_m, second.resolution_m) == (0.25, 1.0)


def test_the_maps_own_threshold_holds_unless_another_is_asked_for(tmp_path):
    path = write_map(tmp_path / "map.tif", DISCS, provenance={"threshold_percent": 35.0})
    plain = write_map(tmp_path / "other.tif", DISCS)
    with opened(path) as own, opened(path, threshold_percent=60.0) as asked, opened(plain) as without:
        assert (own.threshold_percent, asked.threshold_percent, without.threshold_percent) == (35.0, 60.0, 50.0)


def test_a_map_of_one_pixel_is_read(tmp_path):
    path = write_map(tmp_path / "map.tif", [], bounds=(0, 0, 3, 3), size=3.0, values=np.full((1, 1), 80, np.uint8))
    with opened(path) as coverage:
        cells, _ = coverage.read(*box_of(-2, -2, 5, 5))
    assert set(np.unique(cells)) == {80, 255}
    assert (cells == 80).sum() * coverage.resolution_m**2 == pytest.approx(9.0, rel=0.7)


def test_a_band_that_is_not_there_is_named_with_those_that_are(tmp_path):
    path = write_map(tmp_path / "map.tif", DISCS)
    with (
        pytest.raises(InputError, match="vegetation") as caught,
        MetricCoverage(path, working=UTM, band="vegetation", notices=Notices()),
    ):
        pass
    assert "canopy" in str(caught.value)
