"""Draws a view: houses and ground first, then plants a batch of shapes at a time, then light."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.skeleton import Skeletons, select
from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_scene import FloatArray, Look
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view import light_kernel
from urbanforest_cli.export.view.draw_kernel import NEAR_M, Canvas, Instances, Models, View, draw_plants
from urbanforest_cli.export.view.faces_kernel import draw_faces, draw_plain
from urbanforest_cli.export.view.ground import Surfaces
from urbanforest_cli.export.view.light import Weather, light_of, rings_for
from urbanforest_cli.export.view.models import build_models, place_models
from urbanforest_cli.export.view.shade_kernel import Light, shade_rows

STRIP_PX = 16_000_000  # places on the canvas that are held at a time, 11 bytes each: larger pictures come in strips
BANDS = 16  # of a strip, drawn side by side
BATCH, READ = 48, 960  # shapes built and read at a time
SHORTEST_LEAF_PX = 2.8  # of the drawn picture, before it is averaged
THINNEST_WOOD_PX, THINNEST_BARE_PX = 0.12, 0.015  # radius; of bare crowns, that are nothing but thin wood
SHADE_LEAVES = (6000, 900, 150)  # most leaves a plant that cast shade in each ring
LEAF_EXTINCTION = 0.6
REACH_MORE_M = 1.0  # leaves and twigs may reach so far beyond a plant's own radius


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
    city: City, looks: Sequence[Look], setting: Setting, finish: Callable[[NDArray[np.float32]], NDArray[np.uint8]], *,
    supersampling: int = 2, workers: int = 1, progress: Progress = silent,
) -> NDArray[np.uint8]:  # fmt: skip
    """Draw it, a strip of rows after another, so that memory does not grow with the picture.

    Parameters
    ----------
    looks
        One a species of the city.
    finish
        Turns light (h, w, 3), linear, into colours.

    Returns
    -------
    (h, w, 3) uint8
        What `finish` made.
    """
    camera = setting.camera.enlarged(supersampling)
    width, height = camera.size_px
    rings = rings_for(city, setting.camera, setting.weather, setting.rows)
    light = light_of(setting.weather, camera)
    out = np.empty((height // supersampling, width // supersampling, 3), np.uint8)
    strips = strips_of(camera.size_px, supersampling)
    held = blank_canvas(replace(camera, size_px=(width, max(bottom - top for top, bottom in strips))))
    plants = [_Batches(city, looks, setting, camera, setting.rows if not number else _touching(city, setting, camera,
                       *strip)) for number, strip in enumerate(strips)]  # fmt: skip
    shapes, drawn = sum(len(part.shapes) for part in plants), 0
    with _threads(workers) as pool:
        for (top, bottom), part in zip(strips, plants, strict=True):
            canvas = _cleared(held, bottom - top)
            view = view_of(replace(camera, size_px=(width, bottom - top),
                                   middle_px=(camera.middle_px[0], camera.middle_px[1] - top)), top)  # fmt: skip
            bands = bands_of(bottom - top, supersampling)
            _finish_all([pool.submit(_paint, canvas, view, setting, *band) for band in bands])
            if not top:
                _raise_houses(rings, setting.houses)
            draw = _draw_batches(part, canvas, view, () if top else rings, pool, bands)
            for count in draw:
                progress("draw plants", drawn + count, shapes)
            drawn += len(part.shapes)
            if not top:
                rays = sky_rays()
                _finish_all([pool.submit(_sum_light, ring, rays) for ring in rings])
            lit = [pool.submit(_shade, out, canvas, view, rings, light, supersampling, finish, top, *band)
                   for band in bands]  # fmt: skip
            for work, (_, low) in zip(lit, bands, strict=True):
                work.result()
                progress("light the picture", (top + low) // supersampling, len(out))
    return out


@contextmanager
def _threads(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Yield threads; where something goes wrong, or the user stops it, what has not begun is dropped."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def strips_of(size_px: tuple[int, int], factor: int) -> list[tuple[int, int]]:
    """Return the first row and the one after the last of each strip of a canvas, in whole pixels of `factor` rows."""
    width, height = size_px
    count = -(-width * height // STRIP_PX)
    edges = np.linspace(0, height // factor, min(count, height // factor) + 1).astype(int) * factor
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def bands_of(height: int, factor: int) -> list[tuple[int, int]]:
    """Return the first row and the one after the last of each band of a strip."""
    edges = np.linspace(0, height // factor, BANDS + 1).astype(int) * factor
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _finish_all(work: Sequence[Future[Any]]) -> None:
    for item in work:
        item.result()


def _cleared(canvas: Canvas, rows: int) -> Canvas:
    """Return the first rows of a canvas, with nothing on them."""
    part = Canvas(canvas.depth[:rows], canvas.rgb[:rows], canvas.normal[:rows], canvas.kind[:rows])
    part.depth.fill(np.inf)
    part.kind.fill(0)
    part.rgb.fill(0)
    part.normal.fill(0)
    return part


def _paint(canvas: Canvas, view: View, setting: Setting, top: int, bottom: int) -> None:
    draw_plain(canvas, view, *setting.plain, top, bottom)
    for surfaces, painted in ((setting.ground, True), (setting.houses, False)):
        draw_faces(canvas, view, surfaces.corners, surfaces.uv, surfaces.normal, surfaces.rgb, surfaces.kind,
                   painted, top, bottom)  # fmt: skip


def _raise_houses(rings: tuple[light_kernel.Ring, ...], houses: Surfaces) -> None:
    for ring in rings:
        light_kernel.raise_faces(ring.solid, ring.low, ring.cell, ring.slant, houses.corners)
        light_kernel.raise_faces(ring.roof, ring.low, ring.sky_cell, np.zeros(2), houses.corners)


def _sum_light(ring: light_kernel.Ring, rays: FloatArray) -> None:
    light_kernel.sum_up(ring)
    light_kernel.open_up(ring, rays)


def _shade(
    out: NDArray[np.uint8], canvas: Canvas, view: View, rings: tuple[light_kernel.Ring, ...], light: Light, factor: int,
    finish: Callable[[NDArray[np.float32]], NDArray[np.uint8]], strip_top: int, top: int, bottom: int,
) -> None:  # fmt: skip
    """Light a band of a strip and put it into the picture."""
    rows = slice(top, bottom)
    band = Canvas(canvas.depth[rows], canvas.rgb[rows], canvas.normal[rows], canvas.kind[rows])
    x, y = view.middle
    lower = view._replace(middle=np.array([x, y - top]), top=view.top + top)
    linear = np.empty(((bottom - top) // factor, out.shape[1], 3), np.float32)
    shade_rows(band, lower, rings, light, factor, linear, 0, len(linear))
    first = (strip_top + top) // factor
    out[first : first + len(linear)] = finish(linear)


class _Batches:
    """Plants as models, a batch of shapes after another, each as fine as its largest plant is seen."""

    def __init__(
        self, city: City, looks: Sequence[Look], setting: Setting, camera: Camera, rows: NDArray[np.int64]
    ) -> None:  # fmt: skip
        self._city, self._looks, self._leafy = city, looks, setting.leafy
        plants = city.plants.take(setting.rows)
        place = city.local(plants.xy_m)
        need = px_per_m(camera, place, plants.height_m, plants.crown_radius_m) * plants.scale
        shapes, which = np.unique(plants.skeleton_id, return_inverse=True)
        most = np.full(len(shapes), 1e-9)
        np.maximum.at(most, which, need)  # of all, so that a plant looks the same in every strip
        here = np.flatnonzero(np.isin(setting.rows, rows))
        used, self._which = np.unique(which[here], return_inverse=True)
        self._plants, self._place, self._need = plants.take(here), place[here], need[here]
        self.shapes, self._most = shapes[used], most[used]
        self._species = np.zeros(len(used), np.int64)
        self._species[self._which] = self._plants.species
        self._held: dict[int, Skeletons] = {}  # the block read last

    def build(self, start: int) -> tuple[Models, Instances]:
        """Return the shapes from `start` on, and the plants that have them."""
        block = start // READ * READ
        if block not in self._held:
            self._held.clear()
            self._held[block] = self._city.skeletons_of(self.shapes[block : block + READ])
        many, plants, place, need = self._held[block], self._plants, self._place, self._need
        skeletons = select(many, np.arange(start - block, min(start - block + BATCH, len(many))))
        if start + BATCH >= min(block + READ, len(self.shapes)):
            self._held.clear()
        thinnest_px = THINNEST_WOOD_PX if self._leafy else THINNEST_BARE_PX
        kinds = [self._looks[number] for number in self._species[start : start + BATCH]]
        scale_px = self._most[start : start + BATCH]
        models = build_models(skeletons, self._city.season_end(skeletons), kinds,
                              shortest_m=SHORTEST_LEAF_PX / scale_px, thinnest_m=thinnest_px / scale_px,
                              leafy=self._leafy)  # fmt: skip
        mine = np.flatnonzero((self._which >= start) & (self._which < start + BATCH))
        model = self._which[mine] - start
        blade = np.maximum([look.blade_m[0] for look in kinds], SHORTEST_LEAF_PX / scale_px)[model]
        share = np.minimum(blade * need[mine] / SHORTEST_LEAF_PX, 1.0) ** 2
        return models, place_models(
            models, model, place[mine], yaw_rad=plants.yaw_rad[mine], mirror=plants.mirror[mine],
            scale=plants.scale[mine], leaf_share=share, thinnest_m=thinnest_px / need[mine],
        )  # fmt: skip


def _draw_batches(
    batches: _Batches, canvas: Canvas, view: View, rings: tuple[light_kernel.Ring, ...], pool: ThreadPoolExecutor,
    bands: Sequence[tuple[int, int]],
) -> Iterator[int]:  # fmt: skip
    """Draw plants and count them into the light's maps; while a batch is drawn, the next one is read and built.

    Yields how many shapes are drawn.
    """
    count = len(batches.shapes)
    if not count:
        return
    coming = pool.submit(batches.build, 0)
    for start in range(0, count, BATCH):
        yield start
        models, instances = coming.result()
        if start + BATCH < count:
            coming = pool.submit(batches.build, start + BATCH)
        work = [pool.submit(draw_plants, canvas, view, models, instances, *band) for band in bands]
        work += [
            pool.submit(light_kernel.splat_plants, ring, models, instances, LEAF_EXTINCTION, most_leaves, *part)
            for ring, most_leaves in zip(rings, SHADE_LEAVES, strict=False)
            for part in _parts(ring)
        ]
        _finish_all(work)
    yield count


def _touching(city: City, setting: Setting, camera: Camera, top: int, bottom: int) -> NDArray[np.int64]:
    """Return which of the setting's plants may be seen in a strip of rows."""
    plants = city.plants.take(setting.rows)
    place = city.local(plants.xy_m)
    reach = np.maximum(plants.crown_radius_m, 0.5 * plants.height_m) + REACH_MORE_M
    low, high = np.full(len(place), np.inf), np.full(len(place), -np.inf)
    near = np.zeros(len(place), dtype=bool)
    for corner in itertools.product((-1.0, 1.0), (-1.0, 1.0), (-0.1, 1.2)):
        at = camera.seen(place + np.column_stack((corner[0] * reach, corner[1] * reach, corner[2] * plants.height_m)))
        low, high = np.minimum(low, at[:, 1]), np.maximum(high, at[:, 1])
        near |= at[:, 2] < NEAR_M
    return np.asarray(setting.rows[near | ((high >= top - 2) & (low <= bottom + 2))])


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


def view_of(camera: Camera, top: int = 0) -> View:
    """Return a camera as kernels take it; `top` is the row of the whole picture that its first row is."""
    return View(np.array(camera.eye_m, dtype=np.float64), np.ascontiguousarray(camera.axes), float(camera.scale_px),
                np.array(camera.middle_px, dtype=np.float64), camera.perspective, top)  # fmt: skip


def sky_rays() -> FloatArray:
    """Return (9, 3) directions that stand for equal shares of an overcast sky."""
    turns = np.arange(5) * 2 * np.pi / 5
    low = np.column_stack((np.cos(turns) * 0.83, np.sin(turns) * 0.83, np.full(5, 0.557)))
    turns = np.arange(3) * 2 * np.pi / 3 + 0.3
    high = np.column_stack((np.cos(turns) * 0.5, np.sin(turns) * 0.5, np.full(3, 0.866)))
    return np.vstack((low, high, [[0.0, 0.0, 1.0]]))
