"""Draws a view: houses and ground first, then plants a batch of shapes at a time, then light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.skeleton import Skeletons, select
from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_scene import FloatArray, Look
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view import light_kernel
from urbanforest_cli.export.view.draw_kernel import (
    Canvas,
    Instances,
    Models,
    View,
    draw_plants,
)
from urbanforest_cli.export.view.faces_kernel import draw_faces, draw_plain
from urbanforest_cli.export.view.ground import Surfaces
from urbanforest_cli.export.view.light import Weather, light_of, rings_for
from urbanforest_cli.export.view.models import build_models, place_models
from urbanforest_cli.export.view.shade_kernel import shade_rows

BANDS = 16
BATCH, READ = 160, 960  # shapes built and read at a time
SHORTEST_LEAF_PX = 2.4  # of the drawn picture, before it is averaged
THINNEST_WOOD_PX, THINNEST_BARE_PX = 0.12, 0.015  # radius; of bare crowns, that are nothing but thin wood
SHADE_LEAVES = (6000, 900, 150)  # most leaves a plant that cast shade in each ring
LEAF_EXTINCTION = 0.6


@dataclass(frozen=True)
class Setting:
    """What is drawn: plants (n,) rows of the city, surfaces, where it is seen from and in what light.

    `plain` is the colour, as bytes of the canvas, and the kind of the ground beyond the city.
    """

    rows: NDArray[np.int64]
    plain: tuple[NDArray[np.uint8], int]
    ground: Surfaces
    houses: Surfaces
    camera: Camera
    weather: Weather
    leafy: bool = True


def draw_setting(
    city: City, looks: Sequence[Look], setting: Setting, *, supersampling: int = 2, workers: int = 1,
    progress: Progress = silent,
) -> NDArray[np.float32]:  # fmt: skip
    """Draw it.

    Parameters
    ----------
    looks
        One a species of the city.

    Returns
    -------
    (h, w, 3) float32
        Light, linear.
    """
    camera = setting.camera.enlarged(supersampling)
    view = view_of(camera)
    width, height = camera.size_px
    canvas = blank_canvas(camera)
    rings = rings_for(city, setting.camera, setting.weather, setting.rows)
    edges = np.linspace(0, height // supersampling, BANDS + 1).astype(int) * supersampling
    edges[-1] = height
    bands = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    with ThreadPoolExecutor(workers) as pool:

        def each(work: Callable[..., Any], items: Sequence[Any]) -> None:
            for done in pool.map(lambda item: work(*item), items):
                del done

        def paint(top: int, bottom: int) -> None:
            draw_plain(canvas, view, *setting.plain, top, bottom)
            for surfaces, painted in ((setting.ground, True), (setting.houses, False)):
                draw_faces(canvas, view, surfaces.corners, surfaces.uv, surfaces.normal, surfaces.rgb, surfaces.kind,
                           painted, top, bottom)  # fmt: skip

        each(paint, bands)
        for ring in rings:
            light_kernel.raise_faces(ring.solid, ring.low, ring.cell, ring.slant, setting.houses.corners)
            light_kernel.raise_faces(ring.roof, ring.low, ring.sky_cell, np.zeros(2), setting.houses.corners)
        _draw_all_plants(city, looks, setting, canvas, view, rings, camera, pool, bands, progress)
        rays = sky_rays()
        each(lambda ring: (light_kernel.sum_up(ring), light_kernel.open_up(ring, rays)), [(ring,) for ring in rings])
        out = np.empty((height // supersampling, width // supersampling, 3), np.float32)
        light = light_of(setting.weather, camera)
        each(lambda top, bottom: shade_rows(canvas, view, rings, light, supersampling, out, top // supersampling,
                                            bottom // supersampling), bands)  # fmt: skip
    return out


def _draw_all_plants(
    city: City, looks: Sequence[Look], setting: Setting, canvas: Canvas, view: View,
    rings: tuple[light_kernel.Ring, ...], camera: Camera, pool: ThreadPoolExecutor, bands: Sequence[tuple[int, int]],
    progress: Progress,
) -> None:  # fmt: skip
    """Draw plants and count them into the light's maps; while a batch is drawn, the next one is read and built."""
    plants = city.plants.take(setting.rows)
    place = city.local(plants.xy_m)
    need = px_per_m(camera, place, plants.height_m, plants.crown_radius_m) * plants.scale
    shapes, which = np.unique(plants.skeleton_id, return_inverse=True)
    most = np.full(len(shapes), 1e-9)
    np.maximum.at(most, which, need)
    species = np.zeros(len(shapes), np.int64)
    species[which] = plants.species

    thinnest_px = THINNEST_WOOD_PX if setting.leafy else THINNEST_BARE_PX
    held: dict[int, Skeletons] = {}  # the block read last

    def batch(start: int) -> tuple[Models, Instances]:
        block = start // READ * READ
        if block not in held:
            held.clear()
            held[block] = city.skeletons_of(shapes[block : block + READ])
        many = held[block]
        skeletons = select(many, np.arange(start - block, min(start - block + BATCH, len(many))))
        kinds = [looks[number] for number in species[start : start + BATCH]]
        scale_px = most[start : start + BATCH]
        models = build_models(skeletons, city.season_end(skeletons), kinds, shortest_m=SHORTEST_LEAF_PX / scale_px,
                              thinnest_m=thinnest_px / scale_px, leafy=setting.leafy)  # fmt: skip
        mine = np.flatnonzero((which >= start) & (which < start + BATCH))
        model = which[mine] - start
        blade = np.maximum([look.blade_m[0] for look in kinds], SHORTEST_LEAF_PX / scale_px)[model]
        share = np.minimum(blade * need[mine] / SHORTEST_LEAF_PX, 1.0) ** 2
        return models, place_models(
            models, model, place[mine], yaw_rad=plants.yaw_rad[mine], mirror=plants.mirror[mine],
            scale=plants.scale[mine], leaf_share=share, thinnest_m=thinnest_px / need[mine],
        )  # fmt: skip

    starts = range(0, len(shapes), BATCH)
    coming = pool.submit(batch, 0)
    for start in starts:
        progress("draw plants", start, len(shapes))
        models, instances = coming.result()
        if start + BATCH < len(shapes):
            coming = pool.submit(batch, start + BATCH)
        work = [pool.submit(draw_plants, canvas, view, models, instances, *band) for band in bands]
        work += [
            pool.submit(light_kernel.splat_plants, ring, models, instances, LEAF_EXTINCTION, most_leaves, *part)
            for ring, most_leaves in zip(rings, SHADE_LEAVES, strict=True)
            for part in _parts(ring)
        ]
        for item in work:
            item.result()
    progress("draw plants", len(shapes), len(shapes))


def _parts(ring: light_kernel.Ring) -> list[tuple[int, int, int, int]]:
    """Cut a ring into rows that are filled side by side: first and last of the sun's map, and of the sky's."""
    parts = 4
    sun = np.linspace(0, ring.shade.shape[1], parts + 1).astype(int)
    sky = np.linspace(0, ring.leaf.shape[1], parts + 1).astype(int)
    return [(int(sun[n]), int(sun[n + 1]), int(sky[n]), int(sky[n + 1])) for n in range(parts)]


def px_per_m(camera: Camera, place: FloatArray, height_m: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return (n,) how large plants are seen, at the part of them nearest to the viewer."""
    if not camera.perspective:
        return np.full(len(place), camera.scale_px)
    away = place - np.array(camera.eye_m)
    flat = np.maximum(np.hypot(away[:, 0], away[:, 1]) - radius_m, 0.0)
    up = np.maximum(np.maximum(away[:, 2], -(away[:, 2] + height_m)), 0.0)
    return np.asarray(camera.scale_px / np.maximum(np.hypot(flat, up), 3.0))


def blank_canvas(camera: Camera) -> Canvas:
    """Return a canvas on which nothing is drawn."""
    width, height = camera.size_px
    return Canvas(np.full((height, width), np.inf, np.float32), np.zeros((height, width, 3), np.uint8),
                  np.zeros((height, width, 3), np.int8), np.zeros((height, width), np.uint8))  # fmt: skip


def view_of(camera: Camera) -> View:
    """Return a camera as kernels take it."""
    return View(np.array(camera.eye_m, dtype=np.float64), np.ascontiguousarray(camera.axes), float(camera.scale_px),
                np.array(camera.middle_px, dtype=np.float64), camera.perspective)  # fmt: skip


def sky_rays() -> FloatArray:
    """Return (9, 3) directions that stand for equal shares of an overcast sky."""
    turns = np.arange(5) * 2 * np.pi / 5
    low = np.column_stack((np.cos(turns) * 0.83, np.sin(turns) * 0.83, np.full(5, 0.557)))
    turns = np.arange(3) * 2 * np.pi / 3 + 0.3
    high = np.column_stack((np.cos(turns) * 0.5, np.sin(turns) * 0.5, np.full(3, 0.866)))
    return np.vstack((low, high, [[0.0, 0.0, 1.0]]))
