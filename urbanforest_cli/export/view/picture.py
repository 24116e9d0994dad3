"""A picture of a planted city: seen from the air, from a street, or from straight above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_looks import Season, in_season
from urbanforest_cli.export.plant_scene import FloatArray, Look
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view.choose import Shot, Sun, aerial, from_above, in_street
from urbanforest_cli.export.view.draw import Setting, draw_setting
from urbanforest_cli.export.view.furniture import with_scale
from urbanforest_cli.export.view.ground import build_ground, build_houses, plain_ground

Kind = Literal["perspective", "street", "top"]
KINDS: tuple[Kind, ...] = ("perspective", "street", "top")
SIZE_PX = (1920, 1200)
PIXELS_MAX = 8192 * 8192
SUPERSAMPLING = 2
EXPOSURE = 0.50
KNEE = 0.62  # brighter light is pressed together
PALENESS = 0.02  # how far colours go to grey
CONTRAST = 0.35
CALM = 0.45  # how far the colour of young leaves is moved toward that of old ones
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def draw_view(
    city: City,
    looks: Sequence[Look],
    *,
    kind: Kind = "perspective",
    size_px: tuple[int, int] = SIZE_PX,
    bounds_m: tuple[float, float, float, float] | None = None,
    sun: Sun | None = None,
    season: Season = "summer",
    supersampling: int = SUPERSAMPLING,
    scale_bar: bool = True,
    workers: int = 1,
    progress: Progress = silent,
    notices: Notices | None = None,
) -> NDArray[np.uint8]:
    """Draw a city.

    Parameters
    ----------
    looks
        One a species of the city, in its order.
    kind
        "perspective" from the air, "street" from the height of eyes on a road, "top" straight down with north up.
    bounds_m
        Part of the city that the picture is of: west, south, east, north about the city's origin.
    sun
        Azimuth from north over east, and elevation above the horizon, in degrees; chosen to suit the view if None.
    season
        Leaves and flowers.
    scale_bar
        Whether "top" bears a scale bar and a north arrow.
    notices
        Counts a street view that is not on a road, for want of one.

    Returns
    -------
    (h, w, 3) uint8
        sRGB; the same for any number of workers.

    Raises
    ------
    InputError
        There are no plants to be seen.
    LimitError
        The picture has more than `PIXELS_MAX` pixels.
    """
    check_size(size_px)
    if not len(city.plants):
        raise InputError("no plant stands in the part of the city to be drawn", where="render",
                         next_step="name a box with plants in it, or grow the city first")  # fmt: skip
    shot = choose_shot(city, kind=kind, size_px=size_px, bounds_m=bounds_m, sun=sun)
    rows = rows_in_sight(city, shot)
    if not len(rows):
        raise InputError("no plant is seen", where="render", next_step="name a box with plants in it")
    setting = Setting(rows, plain_ground(kind == "top"), build_ground(city), build_houses(city), shot.camera,
                      shot.weather, season != "winter")  # fmt: skip
    seen = [_calm(in_season(look, season)) for look in looks]
    if notices is not None and not shot.on_road:
        notices.add("W_NO_ROAD", "street views beside trees, for there is no straight road to stand on", 1)
    image = draw_setting(city, seen, setting, finished, supersampling=supersampling, workers=workers,
                         progress=progress)  # fmt: skip
    return with_scale(image, shot.camera.scale_px) if kind == "top" and scale_bar else image


def check_size(size_px: tuple[int, int]) -> None:
    """Refuse a picture that would take more memory than a laptop has.

    Raises
    ------
    LimitError
        It has more than `PIXELS_MAX` pixels.
    """
    width, height = size_px
    if width * height > PIXELS_MAX:
        raise LimitError(
            "the picture is too large",
            where="--size",
            found=f"{width}x{height}, {width * height:,} pixels",
            expected=f"at most {PIXELS_MAX:,} pixels, such as 8192x8192",
            next_step="draw parts of the city with --bbox, or a smaller picture",
        )


def _calm(look: Look) -> Look:
    """Return a look whose leaves differ less: in a crowd, single bright ones are unrest."""
    red, green, blue = (a + CALM * (b - a) for a, b in zip(look.leaf_young, look.leaf, strict=True))
    return replace(look, leaf_young=(red, green, blue))


def choose_shot(
    city: City, *, kind: Kind, size_px: tuple[int, int], bounds_m: tuple[float, float, float, float] | None = None,
    sun: Sun | None = None,
) -> Shot:  # fmt: skip
    """Return where a kind of picture is seen from, and in what light."""
    box = None if bounds_m is None else np.array(bounds_m, dtype=np.float64)
    if kind == "street":
        return in_street(city, size_px=size_px, sun=sun, bounds=box)
    if kind == "top":
        return from_above(city, size_px=size_px, sun=sun, bounds=box)
    return aerial(city, size_px=size_px, sun=sun, bounds=box)


def rows_in_sight(city: City, shot: Shot) -> NDArray[np.int64]:
    """Return which plants are seen, or cast shadows on what is near."""
    place = city.local(city.plants.xy_m)
    return np.flatnonzero(_in_sight(shot.camera, place, city.plants.height_m, city.plants.crown_radius_m)
                          | _near(shot, place))  # fmt: skip


def _in_sight(camera: Camera, place: FloatArray, height_m: FloatArray, radius_m: FloatArray) -> NDArray[np.bool_]:
    seen = np.zeros(len(place), dtype=bool)
    width, height = camera.size_px
    for share in (0.0, 0.5, 1.0):
        at = camera.seen(place + np.outer(height_m * share, [0.0, 0.0, 1.0]))
        rim = np.maximum(radius_m, 0.5 * height_m) * at[:, 3] + 2.0
        inside = (at[:, 0] > -rim) & (at[:, 0] < width + rim) & (at[:, 1] > -rim) & (at[:, 1] < height + rim)
        seen |= inside & (at[:, 2] > -radius_m)
    return seen


def _near(shot: Shot, place: FloatArray) -> NDArray[np.bool_]:
    away = np.abs(place[:, :2] - np.array(shot.weather.focus_m)).max(axis=1)
    return np.asarray(away < 0.7 * shot.weather.sharp_m)


def finished(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return light as a picture: bright tones bend as film's do, encoded as sRGB."""
    x = np.maximum(light.astype(np.float64) * EXPOSURE, 0.0)
    over = np.maximum(x - KNEE, 0.0)
    bent = np.minimum(x, KNEE) + (1.0 - KNEE) * (1.0 - np.exp(-over / (1.0 - KNEE)))
    grey = (bent @ LUMINANCE)[..., None]
    bent = np.clip(bent + PALENESS * (grey - bent), 0.0, 1.0)
    encoded = np.where(bent <= 0.0031308, 12.92 * bent, 1.055 * bent ** (1 / 2.4) - 0.055)
    encoded = encoded + CONTRAST * (encoded * encoded * (3.0 - 2.0 * encoded) - encoded)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)
