"""Light from sun and sky over a growing season, as a few directions with weights.

The sun's declination is that of Cooper 1969, its beam on a clear day that of Meinel and Meinel 1976 through the air
mass of Kasten and Young 1989. The rest of the light is that of an overcast sky (Moon and Spencer 1942: a zenith three
times as bright as the horizon). Leaves face all ways, so light counts without the cosine of a surface.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BUD_RINGS = ((25.0, 8), (60.0, 8))
"""Elevation in degrees and number of directions of each ring in which buds look; the zenith is added to them."""
SKY_RINGS = ((12.0, 24), (30.0, 24), (52.0, 16))
"""The same for the light that buildings leave."""

BUD_SUN_SHARE = 0.5
"""Of the sun's share of all light, its share of the blue light to which shoots bend (Briggs and Christie 2002): the
sky is bluer than the sun. Without it open-grown crowns lean too far toward the equator."""

ALL_YEAR_LATITUDE_DEG, SEASON_LATITUDE_DEG = 10.0, 25.0
"""Nearer to the equator than the first plants grow all year; farther than the second, in the summer half alone."""

Directions = NDArray[np.float64]


class Light(NamedTuple):
    """Light of a place: x east, y north, z up.

    `ray` (k, 3) and `ray_light` (k,) are what buds look for, less of it from the sun; `sky_ray` (m, 3) and `sky_light`
    (m,) all light in finer directions, for buildings to stand in; both sum to 1. `lean` (2,) is how far a shadow moves,
    away from the sun, for each metre of depth.
    """

    ray: NDArray[np.float32]
    ray_light: NDArray[np.float32]
    sky_ray: NDArray[np.float32]
    sky_light: NDArray[np.float32]
    lean: NDArray[np.float32]


def light_from(latitude_deg: float, sun_share: float) -> Light:
    """Return the light of a place over its growing season, `sun_share` of it straight from the sun."""
    sun, beam = sun_path(latitude_deg)
    sky, radiance = overcast_sky()
    towards = np.concatenate((sun, sky))

    def all_light(share: float) -> NDArray[np.float64]:
        return np.concatenate((share * beam, (1 - share) * radiance))

    ray, ray_light = gather_in_rings(towards, all_light(BUD_SUN_SHARE * sun_share), BUD_RINGS)
    sky_ray, sky_light = gather_in_rings(towards, all_light(sun_share), SKY_RINGS)
    lean = _lean(sun, beam, sun_share)
    return Light._make(values.astype(np.float32) for values in (ray, ray_light, sky_ray, sky_light, lean))


def sun_path(latitude_deg: float, step_hours: float = 0.25) -> tuple[Directions, NDArray[np.float64]]:
    """Return where the sun stands over the growing season.

    Returns
    -------
    Directions (n, 3) toward it and the share of the season's beam that comes from each, sum 1.
    """
    day = np.arange(3.0, 366.0, 5.0)
    winter = np.clip((SEASON_LATITUDE_DEG - abs(latitude_deg)) / (SEASON_LATITUDE_DEG - ALL_YEAR_LATITUDE_DEG), 0, 1)
    northern_summer = (day > 90) & (day <= 273)  # April to September
    weight = np.where(northern_summer == (latitude_deg >= 0), 1.0, winter)
    declination = np.radians(23.45) * np.sin(2 * np.pi * (284 + day) / 365)
    hour = np.radians(15 * (np.arange(-12 + step_hours / 2, 12, step_hours)))
    latitude = math.radians(latitude_deg)
    sin_d, cos_d = np.sin(declination)[:, None], np.cos(declination)[:, None]
    east = -cos_d * np.sin(hour)
    north = math.cos(latitude) * sin_d - math.sin(latitude) * cos_d * np.cos(hour)
    up = math.sin(latitude) * sin_d + math.cos(latitude) * cos_d * np.cos(hour)
    light = weight[:, None] * clear_beam(up)
    seen = light > 0
    return np.column_stack((east[seen], north[seen], up[seen])), light[seen] / light.sum()


def clear_beam(sin_elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sun's direct beam under a clear sky, as a share of that outside the air; 0 below the horizon."""
    sine = np.clip(sin_elevation, 0.0, 1.0)
    air_mass = 1 / (sine + 0.50572 * (np.degrees(np.arcsin(sine)) + 6.07995) ** -1.6364)
    return np.asarray(np.where(sin_elevation > 0, 0.7 ** (air_mass**0.678), 0.0))


def overcast_sky(bands: int = 30, azimuths: int = 48) -> tuple[Directions, NDArray[np.float64]]:
    """Return directions (n, 3) of equal parts of the sky and their share of its light, sum 1."""
    up = (np.arange(bands) + 0.5) / bands
    azimuth = 2 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    up, azimuth = (values.ravel() for values in np.meshgrid(up, azimuth, indexing="ij"))
    across = np.sqrt(1 - up**2)
    light = 1 + 2 * up
    return np.column_stack((across * np.cos(azimuth), across * np.sin(azimuth), up)), light / light.sum()


def gather_in_rings(
    towards: Directions, light: NDArray[np.float64], rings: tuple[tuple[float, int], ...]
) -> tuple[Directions, NDArray[np.float64]]:
    """Gather light from many directions into the zenith and a few rings.

    A direction between two rings, and between two directions of a ring, is shared among them in proportion to how
    near it is in angle; what comes from below the lowest ring is put there.

    Parameters
    ----------
    rings
        Elevation in degrees and number of directions, ascending.

    Returns
    -------
    Directions (k, 3), rings from low to high, each counter-clockwise from east, the zenith last; light (k,).
    """
    elevation = np.degrees(np.arcsin(np.clip(towards[:, 2], -1, 1)))
    turn = np.arctan2(towards[:, 1], towards[:, 0]) / (2 * np.pi)
    heights = np.array([*(height for height, _ in rings), 90.0])
    place = np.interp(elevation, heights, np.arange(len(heights)))
    gathered, directions = [], []
    for number, (height, count) in enumerate(rings):
        here = light * np.maximum(1 - np.abs(place - number), 0)
        slot = (turn % 1) * count
        low = np.floor(slot)
        over = slot - low
        first = low.astype(np.int64) % count
        gathered.append(
            np.bincount(first, here * (1 - over), count) + np.bincount((first + 1) % count, here * over, count)
        )
        angle = 2 * np.pi * np.arange(count) / count
        flat, up = math.cos(math.radians(height)), math.sin(math.radians(height))
        directions.append(np.column_stack((flat * np.cos(angle), flat * np.sin(angle), np.full(count, up))))
    gathered.append(np.array([(light * np.maximum(place - len(rings) + 1, 0)).sum()]))
    directions.append(np.array([[0.0, 0.0, 1.0]]))
    return np.concatenate(directions), np.concatenate(gathered)


def _lean(sun: Directions, beam: NDArray[np.float64], sun_share: float) -> NDArray[np.float64]:
    """Return the mean shift of shadows on the level, each weighted with the beam that falls on it, at most 1."""
    mean = beam @ sun
    lean = -sun_share * mean[:2] / mean[2]
    lean[np.abs(lean) < 1e-12] = 0.0
    return np.asarray(lean / max(1.0, math.hypot(*lean)))
