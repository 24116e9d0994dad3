"""Where light comes from over a growing season."""

import math

import numpy as np
import pytest

from urbanforest_cli.growth.sunlight import clear_beam, gather_in_rings, light_from, overcast_sky, sun_path


@pytest.mark.parametrize("latitude", [-60.0, -33.0, 0.0, 17.0, 48.0, 70.0])
def test_light_is_shared_out_whole_over_unit_directions_above_ground(latitude):
    light = light_from(latitude, 0.5)
    for ray, share in ((light.ray, light.ray_light), (light.sky_ray, light.sky_light)):
        assert share.sum() == pytest.approx(1, abs=1e-6)
        assert share.min() >= 0
        assert np.linalg.norm(ray, axis=1) == pytest.approx(1, abs=1e-6)
        assert ray[:, 2].min() > 0
    assert len(light.ray) == 17
    assert len(light.sky_ray) == 65


def test_noon_sun_stands_as_high_as_latitude_and_declination_say():
    sun, _ = sun_path(50.0)
    assert math.degrees(math.asin(sun[:, 2].max())) == pytest.approx(90 - 50 + 23.45, abs=0.2)
    sun, _ = sun_path(-35.0)
    assert math.degrees(math.asin(sun[:, 2].max())) == pytest.approx(90 - 35 + 23.45, abs=0.2)
    noon = sun[sun[:, 2].argmax()]
    assert noon[1] > 0  # north of the plant in the south


def test_morning_and_evening_weigh_the_same():
    for latitude in (-40.0, 5.0, 55.0):
        sun, beam = sun_path(latitude)
        assert beam @ sun[:, 0] == pytest.approx(0, abs=1e-12)


def test_hemispheres_mirror_each_other_within_the_year_s_asymmetry():
    north, south = light_from(42.0, 0.6), light_from(-42.0, 0.6)
    mirror = [int(np.abs(south.ray - ray * [1, -1, 1]).sum(axis=1).argmin()) for ray in north.ray]
    assert north.ray_light == pytest.approx(south.ray_light[mirror], abs=0.006)
    assert north.lean[1] == pytest.approx(-south.lean[1], abs=0.02)


def test_shadows_lean_from_the_sun_and_not_at_all_at_the_equator():
    assert light_from(50.0, 0.5).lean[1] > 0.15  # sun in the south, shadow to the north
    assert light_from(-50.0, 0.5).lean[1] < -0.15
    assert light_from(0.0, 0.5).lean == pytest.approx([0, 0], abs=1e-6)
    assert light_from(50.0, 0.0).lean == pytest.approx([0, 0], abs=1e-12)
    leans = [float(light_from(latitude, 1.0).lean[1]) for latitude in (30.0, 40.0, 50.0, 60.0, 70.0)]
    assert leans == sorted(leans)
    assert max(leans) <= 1


def test_light_changes_gently_with_latitude():
    steps = np.arange(-66.0, 66.5, 0.5)
    light = np.array([light_from(latitude, 0.5).sky_light for latitude in steps])
    crossing = np.flatnonzero(steps == 0)[0]
    assert np.abs(np.diff(light, axis=0)).max() < 0.01
    assert np.abs(light[crossing] - light[crossing - 1]).max() < 0.01


def test_overcast_sky_is_three_times_as_bright_at_the_zenith():
    direction, light = overcast_sky(bands=200)
    highest, lowest = direction[:, 2].argmax(), direction[:, 2].argmin()
    assert light[highest] / light[lowest] == pytest.approx(3, rel=0.01)
    above_45 = light[direction[:, 2] > math.sin(math.pi / 4)].sum()
    assert above_45 == pytest.approx(1 - (math.sqrt(0.5) + 0.5) / 2, abs=0.01)  # integral of (1 + 2 s) ds / 2


def test_beam_is_known_at_the_zenith_and_falls_to_the_horizon():
    assert clear_beam(np.array([1.0]))[0] == pytest.approx(0.7, abs=0.001)
    beam = clear_beam(np.sin(np.radians(np.linspace(-5, 90, 96))))
    assert (np.diff(beam) >= 0).all()
    assert beam[0] == 0


def test_gathering_keeps_all_light_and_puts_it_near_where_it_came_from():
    def toward(azimuth, elevation):
        a, e = math.radians(azimuth), math.radians(elevation)
        return [math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)]

    rings = ((20.0, 8), (60.0, 4))
    ray, light = gather_in_rings(
        np.array([toward(45, 20), toward(0, 90), toward(90, 40)]), np.array([1.0, 2, 4]), rings
    )
    found = {
        tuple(np.round(direction, 6)): amount for direction, amount in zip(ray, light, strict=True) if amount > 1e-9
    }
    expected = {(45, 20): 1.0, (0, 90): 2.0, (90, 20): 2.0, (90, 60): 2.0}
    assert len(found) == len(expected)
    for (azimuth, elevation), amount in expected.items():
        nearest = int((ray @ toward(azimuth, elevation)).argmax())
        assert ray[nearest] == pytest.approx(toward(azimuth, elevation), abs=1e-9)
        assert light[nearest] == pytest.approx(amount)
