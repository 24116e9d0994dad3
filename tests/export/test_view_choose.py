"""Where a city is seen from."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.reference.planted import planted_city
from urbanforest_cli.export.view.choose import CELL_M, EYE_M, SUN_SIDE_DEG, aerial, chart_of, from_above, in_street

SIZE = (320, 200)


def grown_up(city, **more):
    """Return the city with plants the size of trees."""
    count = len(city.plants)
    sizes = {"height_m": np.full(count, 12.0), "crown_radius_m": np.full(count, 4.0)}
    return replace(city, plants=replace(city.plants, **(sizes | more)))


@pytest.fixture(scope="module")
def avenue():
    """Trees along both sides of a road that runs east, few along one that runs north, many far from any road."""
    city = planted_city(count=120)
    place = np.array([city.origin.easting_m, city.origin.northing_m])
    steps = np.arange(40) * 5.0
    rows = np.vstack([np.column_stack((steps, np.full(40, 6.0))), np.column_stack((steps, np.full(40, -6.0))),
                      np.random.default_rng(1).uniform(400, 480, (40, 2))])  # fmt: skip
    roads = [(-20, -4, 220, 4), (96, -200, 104, 200)]
    shapes = np.array([shapely.box(*(np.array(box) + np.tile(place, 2))) for box in roads], dtype=object)
    return grown_up(replace(city, plants=replace(city.plants, xy_m=rows + place), roads=shapes))


def test_the_street_with_the_trees_is_looked_along_from_eye_height(avenue):
    camera = in_street(avenue, size_px=SIZE, sun=None).camera
    assert camera.eye_m[2] == EYE_M
    assert abs(camera.eye_m[1]) < 3.0
    assert min(abs(camera.azimuth_deg - way) for way in (90.0, 270.0)) <= 10.0


def test_a_box_says_where_to_stand(avenue):
    camera = in_street(avenue, size_px=SIZE, sun=None, bounds=np.array([90.0, -190.0, 110.0, -60.0])).camera
    assert 95.0 < camera.eye_m[0] < 105.0
    assert -190.0 <= camera.eye_m[1] <= -60.0


def test_without_roads_a_place_before_the_trees_is_found(avenue):
    camera = in_street(replace(avenue, roads=np.zeros(0, dtype=object)), size_px=SIZE, sun=None).camera
    assert camera.eye_m[2] == EYE_M


def test_without_roads_trees_are_in_sight_and_none_in_the_way(avenue):
    shot = in_street(replace(avenue, roads=np.zeros(0, dtype=object)), size_px=SIZE, sun=None)
    assert not shot.on_road
    assert in_street(avenue, size_px=SIZE, sun=None).on_road
    seen = shot.camera.seen(avenue.local(avenue.plants.xy_m))
    in_sight = (seen[:, 2] > 3) & (seen[:, 2] < 60) & (seen[:, 0] > 0) & (seen[:, 0] < SIZE[0])
    assert in_sight.sum() >= 5


@pytest.mark.parametrize("box", [(400, 400, 480, 480), (0, -20, 200, 20), (0, -15, 60, 220)])
@pytest.mark.parametrize("size", [SIZE, (200, 320)])
def test_a_box_fills_most_of_the_view_from_the_air_and_is_whole(avenue, box, size):
    west, south, east, north = box
    for sun in (None, (250.0, 12.0)):
        camera = aerial(avenue, size_px=size, sun=sun, bounds=np.array(box, float)).camera
        corners = np.array([[x, y, 0.0] for x, y in ((west, south), (east, south), (east, north), (west, north))])
        seen = camera.seen(corners)
        assert (seen[:, 2] > 0).all()
        assert (seen[:, :2] >= 0).all()
        assert (seen[:, :2] <= np.array(size)).all()
        span = np.ptp(seen[:, :2], axis=0) / np.array(size)
        assert span.max() > 0.8  # with the crowns on its far side it just fits
        assert camera.eye_m[2] > 5.0


def test_from_above_all_plants_are_inside_and_north_is_up(avenue):
    camera = from_above(avenue, size_px=SIZE, sun=None).camera
    seen = camera.seen(avenue.local(avenue.plants.xy_m))
    assert (seen[:, :2] > 0).all()
    assert (seen[:, :2] < np.array(SIZE)).all()
    north, south = camera.seen(np.array([[0.0, 10.0, 0.0], [0.0, 0.0, 0.0]]))
    assert north[1] == pytest.approx(south[1] - 10.0 * camera.scale_px)
    assert north[0] == pytest.approx(south[0])


def test_a_box_fills_the_view_from_above(avenue):
    camera = from_above(avenue, size_px=SIZE, sun=None, bounds=np.array([0.0, 0.0, 80.0, 50.0])).camera
    corners = camera.seen(np.array([[0.0, 0.0, 0.0], [80.0, 50.0, 0.0]]))[:, :2]
    assert corners == pytest.approx(np.array([[0.0, 200.0], [320.0, 0.0]]))


def test_from_the_air_the_wood_is_in_sight_and_the_sun_shines_from_beside(avenue):
    shot = aerial(avenue, size_px=SIZE, sun=None)
    assert shot.camera.eye_m[2] > 20.0
    assert 0 < shot.camera.pitch_deg < 45
    aside = abs((shot.weather.azimuth_deg - shot.camera.azimuth_deg + 180) % 360 - 180)
    assert aside == pytest.approx(SUN_SIDE_DEG)
    assert 80.0 <= shot.weather.azimuth_deg <= 280.0
    place = avenue.local(avenue.plants.xy_m)
    seen = shot.camera.seen(place)
    inside = (seen[:, 2] > 0) & (seen[:, :2] > 0).all(axis=1) & (seen[:, :2] < np.array(SIZE)).all(axis=1)
    assert inside.sum() >= 40


def test_a_sun_that_is_asked_for_stays(avenue):
    for view in (aerial, in_street, from_above):
        weather = view(avenue, size_px=SIZE, sun=(200.0, 33.0)).weather
        assert (weather.azimuth_deg, weather.elevation_deg) == (200.0, 33.0)


def test_a_box_is_the_middle_of_the_view_from_the_air(avenue):
    camera = aerial(avenue, size_px=SIZE, sun=None, bounds=np.array([400.0, 400.0, 480.0, 480.0])).camera
    x, y, depth, _ = camera.seen(np.array([[440.0, 440.0, 0.0]]))[0]
    assert depth > 0
    assert x == pytest.approx(160.0, abs=1)
    assert 60 < y < 200


def test_the_chart_counts_crowns_where_they_are(avenue):
    chart = chart_of(avenue)
    at_plants = chart.at(avenue.local(avenue.plants.xy_m)[:, :2])
    assert at_plants[0].min() > 0.1
    assert at_plants[3].all()
    assert chart.green.sum() * CELL_M**2 == pytest.approx(120 * np.pi * 16.0)
    green, built, height, inside = chart.at(np.array([[100.0, 300.0], [9000.0, 0.0]]))
    assert not inside.any()
    assert max(green.max(), built.max(), height.max()) == 0
