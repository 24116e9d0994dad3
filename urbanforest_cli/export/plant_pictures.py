"""Pictures of grown plants: skeletons in, an image out; light from the upper left, leaves shaded by those around them.

The picture is drawn at several times its size and averaged, by the kernels that draw whole cities: see `view`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_scene import FloatArray, Rgb, Standing, Wood, linear
from urbanforest_cli.export.plant_town import Faces, build_walls, joined_faces
from urbanforest_cli.export.view import light_kernel
from urbanforest_cli.export.view.draw import LEAF_EXTINCTION, blank_canvas, sky_rays, view_of
from urbanforest_cli.export.view.draw_kernel import (
    GROUND,
    ROOF,
    WALL,
    Canvas,
    Instances,
    Models,
    View,
    draw_plants,
)
from urbanforest_cli.export.view.faces_kernel import draw_faces, draw_plain
from urbanforest_cli.export.view.light import ring_over
from urbanforest_cli.export.view.light_kernel import Ring
from urbanforest_cli.export.view.models import build_models, model_of, place_models
from urbanforest_cli.export.view.shade_kernel import Light, shade_rows

SUN = (-0.52, 0.66, 0.54)  # toward it, in the camera's frame: from the upper left, behind the viewer
SUN_HEIGHT_MIN = 0.3  # a view from above must not set the sun
SUN_POWER, SKY_POWER, BOUNCE_POWER = 1.25, 0.62, 0.25
KNEE, BEND = 0.75, 1.6  # brighter light than the knee is pressed together
SHORTEST_LEAF_PX = 2.2  # of the drawn picture, before it is averaged
SHADE_CELL_M, SHADE_CELLS = 0.12, (120, 1000)  # of the maps of shade; least and most along a side
MARGIN_M = 3.0  # around all that casts shade

Drawn = tuple[Models, Instances]


@dataclass(frozen=True)
class Backdrop:
    """What is behind and below the plants; colours of sRGB from 0 to 1.

    Parameters
    ----------
    sky_top, sky_low
        Colours at the upper and lower edge, or at the horizon.
    ground
        Colour of the ground, or None for no ground.
    ground_middle_m, ground_half_m
        Where the ground lies, and how far it reaches along the picture and into it before it has faded.
    """

    sky_top: Rgb = (0.988, 0.984, 0.973)
    sky_low: Rgb = (0.988, 0.984, 0.973)
    ground: Rgb | None = (0.72, 0.74, 0.62)
    ground_middle_m: tuple[float, float] = (0.0, 0.0)
    ground_half_m: tuple[float, float] = (1e4, 9.0)


def _no_buildings() -> NDArray[np.object_]:
    return np.empty(0, dtype=object)


@dataclass(frozen=True)
class Scene:
    """Plants and what stands around them.

    Parameters
    ----------
    plants
        Several sets of plants.
    buildings, building_height_m
        (b,) footprints and heights.
    faces, things
        More flat faces, such as roads, and more round bodies, such as people.
    leafy
        False for winter.
    backdrop
        Sky and ground.
    """

    plants: Sequence[Standing]
    buildings: NDArray[np.object_] = field(default_factory=_no_buildings)
    building_height_m: FloatArray = field(default_factory=lambda: np.empty(0))
    faces: Sequence[Faces] = ()
    things: Sequence[Wood] = ()
    leafy: bool = True
    backdrop: Backdrop = field(default_factory=Backdrop)


def render(
    scene: Scene,
    camera: Camera,
    *,
    supersampling: int = 2,
    sun: tuple[float, float, float] | None = None,
) -> NDArray[np.uint8]:
    """Draw a scene.

    Parameters
    ----------
    sun
        Direction toward the sun: east, north, up. From the upper left behind the viewer where none is given.

    Returns
    -------
    (height, width, 3) uint8
        sRGB.
    """
    large = camera.enlarged(supersampling)
    view, canvas = view_of(large), blank_canvas(large)
    rows = large.size_px[1]
    drawn = [_planted(plants, large, scene.leafy) for plants in scene.plants]
    for wood in scene.things:
        model = model_of(wood)
        drawn.append((model, place_models(model, np.zeros(1, np.int64), np.zeros((1, 3)))))
    houses = build_walls(scene.buildings, scene.building_height_m)
    back = scene.backdrop
    if back.ground is not None:
        draw_plain(canvas, view, _bytes_of(linear(back.ground)), GROUND, 0, rows)
    _draw_faces(canvas, view, joined_faces([*scene.faces, houses]))
    light = _light(scene.backdrop, large, sun)
    ring = shade_of(drawn, houses, light.sun)
    for models, instances in drawn:
        draw_plants(canvas, view, models, instances, 0, rows)
    width, height = camera.size_px
    out = np.empty((height, width, 3), np.float32)
    shade_rows(canvas, view, (ring, ring, ring), light, supersampling, out, 0, height)
    return _finished(out)


def _planted(plants: Standing, camera: Camera, leafy: bool) -> Drawn:
    """Return plants as models, each at its place, their leaves as fine as they are seen."""
    skeletons, count = plants.skeletons, len(plants.skeletons)
    end = np.asarray(skeletons.seasons if plants.season_end is None else plants.season_end)
    place = np.column_stack((plants.xy_m, np.zeros(count)))
    scale = np.ones(count) if plants.scale is None else np.asarray(plants.scale)
    shortest = SHORTEST_LEAF_PX / np.maximum(camera.seen(place)[:, 3] * scale, 1e-6)
    models = build_models(skeletons, end, plants.looks, shortest_m=shortest, thinnest_m=np.zeros(count), leafy=leafy)
    return models, place_models(models, np.arange(count), place, yaw_rad=plants.turn_rad, scale=scale)


def shade_of(drawn: Sequence[Drawn], houses: Faces, sun: FloatArray) -> Ring:
    """Count what takes light away: leaves, branches, houses.

    Parameters
    ----------
    drawn
        Models and where they stand.
    houses
        Faces that no light goes through.
    sun
        (3,) direction toward it.
    """
    corners = [houses.corners.reshape(-1, 3)]
    for models, instances in drawn:
        reach, top = models.reach[instances.model], models.top[instances.model]
        for sign in (-1.0, 1.0):
            corners.append(instances.place + np.column_stack((sign * reach, sign * reach, top)))
    points = np.vstack([np.zeros((1, 3)), *corners])
    low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    slant = sun[:2] / sun[2]
    # Shade is kept where the sun's ray meets the ground.
    away = -slant * high[2]
    low[:2], high[:2] = low[:2] + np.minimum(away, 0), high[:2] + np.maximum(away, 0)
    width = float((high - low)[:2].max())
    cells = int(np.clip(width / SHADE_CELL_M, *SHADE_CELLS))
    ring = ring_over(low[:2], width, float(high[2]), slant, cells=cells)
    rows = (0, ring.shade.shape[1], 0, ring.leaf.shape[1])
    for models, instances in drawn:
        light_kernel.splat_plants(ring, models, instances, LEAF_EXTINCTION, np.iinfo(np.int64).max, *rows)
    faces = np.asarray(houses.corners, np.float64)
    light_kernel.raise_faces(ring.solid, ring.low, ring.cell, ring.slant, faces)
    light_kernel.raise_faces(ring.roof, ring.low, ring.sky_cell, np.zeros(2), faces)
    light_kernel.sum_up(ring)
    light_kernel.open_up(ring, sky_rays())
    return ring


def _draw_faces(canvas: Canvas, view: View, faces: Faces) -> None:
    has_windows = faces.uv[:, 0, 0] >= 0
    draw_faces(canvas, view, np.asarray(faces.corners, np.float64), np.asarray(faces.uv, np.float64),
               np.asarray(faces.normal, np.float64), _bytes_of(faces.rgb),
               np.where(has_windows, WALL, ROOF).astype(np.uint8), False, 0, len(canvas.depth))  # fmt: skip


def _bytes_of(rgb: FloatArray) -> NDArray[np.uint8]:
    """Return linear colours as bytes of the canvas."""
    return np.asarray(np.clip(np.sqrt(rgb) * 255.0 + 0.5, 0, 255), dtype=np.uint8)


def _light(backdrop: Backdrop, camera: Camera, sun: tuple[float, float, float] | None) -> Light:
    toward = camera.axes.T @ np.array(SUN) if sun is None else np.array(sun, dtype=np.float64)
    toward = toward / np.linalg.norm(toward)
    toward[2] = max(toward[2], SUN_HEIGHT_MIN)
    toward = np.ascontiguousarray(toward / np.linalg.norm(toward))
    white = np.ones(3)
    return Light(
        toward, np.ascontiguousarray(camera.axes @ toward), SUN_POWER * white, SKY_POWER * white, BOUNCE_POWER * white,
        white, white, np.zeros(3), 0.0, 1.0, True, _rows_behind(camera, backdrop),
        np.array([*backdrop.ground_middle_m, *backdrop.ground_half_m], dtype=np.float64),
    )  # fmt: skip


def _rows_behind(camera: Camera, backdrop: Backdrop) -> NDArray[np.float64]:
    """Return (rows, 3) the colour behind all; the lower is reached at the horizon, or at the edge if none is seen."""
    height = camera.size_px[1]
    top, low = _unbent(linear(backdrop.sky_top)), _unbent(linear(backdrop.sky_low))
    horizon = float(camera.middle_px[1] - camera.scale_px * np.tan(np.deg2rad(camera.pitch_deg)))
    last = min(max(horizon, 1.0), height) if camera.perspective else height
    share = np.clip(np.arange(height) / last, 0, 1)[:, None]
    return np.asarray(top + (low - top) * share, dtype=np.float64)


def _unbent(light: FloatArray) -> FloatArray:
    """Return the light that `_finished` shows as this light."""
    over = np.maximum(light - KNEE, 0.0)
    return np.asarray(np.minimum(light, KNEE) + over / (1.0 - over * BEND))


def _finished(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Bend the brightest tones, encode as sRGB."""
    over = np.maximum(light - KNEE, 0.0)
    light = np.clip(np.minimum(light, KNEE) + over / (1.0 + over * BEND), 0.0, 1.0)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)
