"""Pictures of grown plants: skeletons in, an image out; light from the upper left, leaves shaded by those around them.

The picture is drawn at several times its size and averaged. The light that a leaf, a branch or the ground gets is
what a grid of leaf area lets through, toward the sun and toward a few directions of the sky; so crowns are dark inside
and below, and cast soft shadows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_kernel import Canvas, draw_ground, draw_leaves, draw_triangles, draw_wood
from urbanforest_cli.export.plant_light_kernel import Shade, light_of_points
from urbanforest_cli.export.plant_scene import (
    FloatArray,
    Leaves,
    Rgb,
    Standing,
    Twigs,
    Wood,
    build_leaves,
    build_twiglets,
    build_wood,
    joined_wood,
    linear,
)
from urbanforest_cli.export.plant_town import Faces, build_walls, joined_faces

SUN = (-0.52, 0.66, 0.54)  # toward it, in the camera's frame: from the upper left, behind the viewer
SUN_POWER, SKY_POWER = 1.25, 0.62
REACH_M = 24.0  # how far leaves look for what shades them
BUILDING_EXTINCTION = 30.0
LEAF_EXTINCTION = 0.5  # of each square metre of leaves: blades at all angles cover half their area
KNEE, BEND = 0.75, 1.6  # brighter light than the knee is pressed together
SHORTEST_LEAF_PX = 2.2  # of the drawn picture, before it is averaged


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
    cell_m: float = 0.5,
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
    axes = large.axes
    sun_world = axes.T @ np.array(SUN) if sun is None else np.array(sun)
    sun_world = sun_world / np.linalg.norm(sun_world)
    sun_world[2] = max(sun_world[2], 0.3)  # a view from above must not set the sun
    sun_world /= np.linalg.norm(sun_world)
    sun_seen = axes @ sun_world

    grown = [build_wood(plants) for plants in scene.plants]
    leaves = [
        build_leaves(twigs, plants.looks, shortest_m=_shortest_leaf(large, twigs)) if scene.leafy else None
        for plants, (_, twigs) in zip(scene.plants, grown, strict=True)
    ]
    parts = [part for part, _ in grown] + list(scene.things)
    if not scene.leafy:
        parts += [build_twiglets(twigs, plants.looks) for plants, (_, twigs) in zip(scene.plants, grown, strict=True)]
    wood = joined_wood(parts) if parts else None
    canvas = _blank(large, scene.backdrop)
    everything = _all_leaves([item for item in leaves if item is not None])
    empty = Wood(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty((0, 3)))
    shade = shade_of(wood or empty, everything, scene.buildings, scene.building_height_m, cell_m=cell_m)
    sky = _sky_directions(axes)
    if wood is not None:
        light = np.hstack([light_of_points(shade, ends, sun_world, sky, 1.6 * cell_m, REACH_M, 0.0)
                           for ends in (wood.start, wood.end)])  # fmt: skip
        start, end = large.seen(wood.start), large.seen(wood.end)
        start[:, 3] *= wood.start_radius
        end[:, 3] *= wood.end_radius
        draw_wood(canvas, start, end, wood.rgb, wood.start[:, 2] < 1e-3, light, sun_seen, SUN_POWER, SKY_POWER)
    for item, (_, twigs) in zip(leaves, grown, strict=True):
        if item is None or len(item.twig) == 0:
            continue
        light = light_of_points(shade, twigs.tip, sun_world, sky, 1.2 * cell_m, REACH_M, 0.8)[item.twig]
        draw_leaves(canvas, large.seen(item.centre), item.along @ axes.T, item.across @ axes.T, item.rgb, light,
                    sun_seen, SUN_POWER, SKY_POWER)  # fmt: skip
    faces = joined_faces([*scene.faces, build_walls(scene.buildings, scene.building_height_m)])
    if len(faces.corners):
        corners = large.seen(faces.corners.reshape(-1, 3))[:, :3].reshape(-1, 3, 3)
        draw_triangles(canvas, corners, faces.uv, faces.corners, faces.normal, faces.rgb, shade, sun_world, SUN_POWER,
                       SKY_POWER, large.perspective)  # fmt: skip
    if scene.backdrop.ground is not None:
        back = scene.backdrop
        _lay_ground(canvas, large, back, shade, sun_world)
    return _finished(canvas, supersampling)


def shade_of(
    wood: Wood, leaves: Leaves | None, buildings: NDArray[np.object_], height_m: FloatArray, *, cell_m: float = 0.5
) -> Shade:
    """Count what takes light away into cells: leaves, branches, buildings."""
    points = wood.end if leaves is None else np.vstack((wood.end, leaves.centre))
    bounds = shapely.total_bounds(buildings) if len(buildings) else np.full(4, np.nan)
    xs, ys = np.r_[points[:, 0], bounds[[0, 2]]], np.r_[points[:, 1], bounds[[1, 3]]]
    if not np.isfinite(xs).any():
        return Shade(np.zeros((1, 1, 1), np.float32), np.zeros(3), cell_m)
    low = np.array([np.nanmin(xs), np.nanmin(ys), 0.0]) - [cell_m, cell_m, 0.0]
    top = max(points[:, 2].max(initial=0.0), np.max(height_m, initial=0.0))
    high = np.array([np.nanmax(xs), np.nanmax(ys), top]) + cell_m
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / cell_m))
    flat = np.zeros(nx * ny * nz)

    def add(where: FloatArray, amount: FloatArray) -> None:
        cell = np.clip(((where - low) / cell_m).astype(np.int64), 0, [nx - 1, ny - 1, nz - 1])
        index = (cell[:, 2] * ny + cell[:, 1]) * nx + cell[:, 0]
        flat[:] += np.bincount(index, amount, minlength=len(flat))

    length = np.linalg.norm(wood.end - wood.start, axis=1)
    add(0.5 * (wood.start + wood.end), length * (wood.start_radius + wood.end_radius) / cell_m**3)
    if leaves is not None:
        add(leaves.centre, LEAF_EXTINCTION * leaves.area_m2 / cell_m**3)
    density = flat.reshape(nz, ny, nx)
    x, y = np.meshgrid(low[0] + (np.arange(nx) + 0.5) * cell_m, low[1] + (np.arange(ny) + 0.5) * cell_m)
    for polygon, height in zip(buildings, height_m, strict=True):
        inside = shapely.contains_xy(polygon, x, y)
        density[: int(np.ceil((height - low[2]) / cell_m)), inside] = BUILDING_EXTINCTION
    return Shade(density.astype(np.float32), low, cell_m)


def _shortest_leaf(camera: Camera, twigs: Twigs) -> float:
    """Return the length in metres of the shortest leaf worth drawing."""
    if len(twigs.tip) == 0:
        return 0.0
    return SHORTEST_LEAF_PX / max(float(np.median(camera.seen(twigs.tip[::7])[:, 3])), 1e-6)


def _all_leaves(parts: Sequence[Leaves]) -> Leaves | None:
    if not parts:
        return None
    names = ("twig", "centre", "along", "across", "rgb", "area_m2")
    return Leaves(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _sky_directions(axes: FloatArray) -> FloatArray:
    """Return (6, 3): straight up, four slanting ones, and one low toward the viewer."""
    toward = np.array([axes[2, 0], axes[2, 1], 0.0])
    toward /= np.linalg.norm(toward) + 1e-12
    up = np.array([0.0, 0.0, 1.0])
    found = np.stack((up, axes[0] + up, up - axes[0], toward + up, up - toward, toward + 0.25 * up))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _blank(camera: Camera, backdrop: Backdrop) -> Canvas:
    width, height = camera.size_px
    top, low = _unbent(linear(backdrop.sky_top)), _unbent(linear(backdrop.sky_low))
    # The lower colour is reached at the horizon, or at the lower edge where none is seen.
    horizon = float(camera.middle_px[1] - camera.scale_px * np.tan(np.deg2rad(camera.pitch_deg)))
    last = min(max(horizon, 1.0), height) if camera.perspective else height
    share = np.clip(np.arange(height) / last, 0, 1)[:, None]
    rgb = np.broadcast_to((top + (low - top) * share)[:, None], (height, width, 3)).astype(np.float32)
    return Canvas(np.full((height, width), np.inf, np.float32), np.ascontiguousarray(rgb))


def _lay_ground(canvas: Canvas, camera: Camera, backdrop: Backdrop, shade: Shade, sun_world: FloatArray) -> None:
    eye = np.array(camera.eye_m, dtype=np.float64)
    if not camera.perspective:
        eye = eye + 1e4 * camera.axes[2]
    assert backdrop.ground is not None  # asked by the caller
    draw_ground(canvas, camera.axes, eye, camera.scale_px, camera.perspective, np.array(camera.middle_px),
                linear(backdrop.ground), shade, sun_world, SUN_POWER, SKY_POWER, np.array(backdrop.ground_middle_m),
                np.array(backdrop.ground_half_m))  # fmt: skip


def _unbent(light: FloatArray) -> FloatArray:
    """Return the light that `_finished` shows as this light."""
    over = np.maximum(light - KNEE, 0.0)
    return np.asarray(np.minimum(light, KNEE) + over / (1.0 - over * BEND))


def _finished(canvas: Canvas, supersampling: int) -> NDArray[np.uint8]:
    """Average to the picture's size, bend the brightest tones, encode as sRGB."""
    height, width = (n // supersampling for n in canvas.depth.shape)
    light = canvas.rgb.reshape(height, supersampling, width, supersampling, 3).mean(axis=(1, 3))
    over = np.maximum(light - KNEE, 0.0)
    light = np.clip(np.minimum(light, KNEE) + over / (1.0 + over * BEND), 0.0, 1.0)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)
