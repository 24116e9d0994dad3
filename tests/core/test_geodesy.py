import math

import numpy as np
import pytest
from pyproj import CRS, Proj, Transformer

from urbanforest_cli.core.geodesy import frame_turn_rad, from_earth_centred, root_transform, to_enu
from urbanforest_cli.core.scenery import Origin

PLACES = {
    "UTM 18N, New York": Origin(CRS.from_epsg(32618), 590_000.0, 4_515_000.0),
    "Lambert-93, Bondy": Origin(CRS.from_epsg(2154), 660_000.0, 6_867_000.0),
    "UTM 32N, 6 degrees off its meridian": Origin(CRS.from_epsg(25832), 920_000.0, 5_800_000.0),
    "UTM 56S, Sydney": Origin(CRS.from_epsg(32756), 334_000.0, 6_251_000.0),
    "Japan IX, Tokyo, raised": Origin(CRS.from_epsg(6677), -7_000.0, -35_000.0, 40.0),
}
pytestmark = pytest.mark.parametrize("origin", list(PLACES.values()), ids=list(PLACES))


def positions(count=200, reach_m=5000.0):
    rng = np.random.default_rng(5)
    corners = [[x, y, z] for x in (-reach_m, reach_m) for y in (-reach_m, reach_m) for z in (0.0, 60.0)]
    return np.concatenate([np.array(corners), rng.uniform(-reach_m, reach_m, (count, 3)) * [1, 1, 0.01]])


def on_earth(origin, xyz, ground_height_m=0.0):
    """Earth's axes straight from pyproj."""
    change = Transformer.from_crs(origin.crs.to_3d(), CRS.from_epsg(4978), always_xy=True)
    place = np.add(xyz, (origin.easting_m, origin.northing_m, origin.height_m + ground_height_m))
    return np.column_stack(change.transform(*place.T))


def test_the_frame_brings_positions_to_where_pyproj_has_them(origin):
    xyz = positions()
    matrix = root_transform(origin, ground_height_m=45.0)
    found = to_enu(origin, xyz, ground_height_m=45.0) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(found - on_earth(origin, xyz, 45.0)).max() < 1e-3


def test_positions_come_back(origin):
    xyz = positions()
    matrix = root_transform(origin, ground_height_m=45.0)
    centred = to_enu(origin, xyz, ground_height_m=45.0) @ matrix[:3, :3].T + matrix[:3, 3]
    back = from_earth_centred(origin, centred, ground_height_m=45.0)
    expected = np.add(xyz, (origin.easting_m, origin.northing_m, origin.height_m))
    assert np.abs(back - expected).max() < 1e-3


def test_the_frame_stands_upright_on_the_ellipsoid_with_y_to_true_north(origin):
    matrix = root_transform(origin)
    assert np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)
    assert matrix[3].tolist() == [0, 0, 0, 1]
    back = Transformer.from_crs(4978, 4979, always_xy=True)
    here = back.transform(*matrix[:3, 3])
    for axis, expected in ((0, (True, False, False)), (1, (False, True, False)), (2, (False, False, True))):
        moved = np.abs(np.subtract(back.transform(*(matrix[:3, 3] + 0.5 * matrix[:3, axis])), here))
        assert tuple(moved > [1e-7, 1e-7, 1e-3]) == expected


def test_the_ground_falls_away_as_the_earth_is_round(origin):
    away = to_enu(origin, np.array([[5000.0, 0.0, -origin.height_m], [0.0, 0.0, -origin.height_m]]))
    assert away[1, 2] - away[0, 2] == pytest.approx(5000.0**2 / (2 * 6.371e6), rel=0.01)


def test_the_grid_is_turned_by_its_convergence(origin):
    longitude, latitude = Transformer.from_crs(origin.crs, 4326, always_xy=True).transform(
        origin.easting_m, origin.northing_m
    )
    convergence = Proj(origin.crs).get_factors(longitude, latitude).meridian_convergence
    turn = frame_turn_rad(origin, np.zeros((1, 3)))[0]
    assert math.degrees(turn) == pytest.approx(-convergence, abs=1e-3)


def test_nothing_stays_nothing(origin):
    assert to_enu(origin, np.zeros((0, 3))).shape == (0, 3)
    assert from_earth_centred(origin, np.zeros((0, 3))).shape == (0, 3)
    assert frame_turn_rad(origin, np.zeros((0, 3))).shape == (0,)
