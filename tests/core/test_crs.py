import numpy as np
import pytest
import shapely
from pyproj import CRS

from urbanforest_cli.core.crs import length_distortion, reproject, reproject_xy, working_crs
from urbanforest_cli.core.errors import CrsError


def test_metres_without_distortion_are_kept():
    crs = CRS.from_epsg(2154)
    assert working_crs(crs, (650_000, 6_860_000, 651_000, 6_861_000)) == crs


@pytest.mark.parametrize(
    ("code", "bounds"),
    [
        (2263, (1_000_000, 210_000, 1_010_000, 220_000)),  # US feet
        (4326, (-73.95, 40.75, -73.90, 40.78)),
        (3857, (-8_231_000, 4_975_000, -8_227_000, 4_979_000)),  # metres on paper, 1.32 too long
    ],
)
def test_feet_degrees_and_mercator_go_to_utm(code, bounds):
    assert working_crs(CRS.from_epsg(code), bounds).to_epsg() == 32618


def test_mercator_lengths_are_known_to_be_wrong():
    assert length_distortion(CRS.from_epsg(3857), 10, 50) == pytest.approx(0.5557, abs=2e-3)
    assert length_distortion(CRS.from_epsg(32632), 9, 50) < 5e-4


@pytest.mark.parametrize(
    ("crs", "bounds"),
    [
        (None, (0, 0, 1, 1)),
        (CRS.from_epsg(4326), (500_000, 5_300_000, 500_100, 5_300_100)),
        (CRS.from_wkt('LOCAL_CS["site",UNIT["metre",1]]'), (0, 0, 1, 1)),
        (CRS.from_epsg(32633), (5e7, 5e7, 5.1e7, 5.1e7)),
    ],
)
def test_unusable_coordinates_are_refused_with_a_way_out(crs, bounds):
    with pytest.raises(CrsError, match="assume-crs"):
        working_crs(crs, bounds, where="city.gpkg")


def test_reprojection_and_back_is_exact_to_a_micrometre():
    metres, feet = CRS.from_epsg(32618), CRS.from_epsg(2263)
    square = np.array([shapely.box(585_000, 4_510_000, 585_100, 4_510_100)])
    back = reproject(reproject(square, metres, feet), feet, metres)
    assert shapely.hausdorff_distance(square[0], back[0]) < 1e-6
    xy = shapely.get_coordinates(square)
    assert np.abs(reproject_xy(reproject_xy(xy, metres, feet), feet, metres) - xy).max() < 1e-6
