"""Buildings on their lots, the ways to them, and their doors and windows.

A building is laid out on its lot's own axes, x along the street and y away from it, and stays inside the lot. Every
ground plan has an unbroken front at y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.lots import CAMPUS, ENCLAVE, FLAG, Lots
from urbanforest_cli.synth.plan import CENTRE, DENSE, GARDEN, PARK, SIDEWALK_M, SUBURB, Floats, Geometries

Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

BLOCK, ELL, TEE, YOU, COURT = range(5)
"""Ground plans: a box, letters, and a box around a courtyard."""

HOUSE, VILLA, ROW, FLATS, SHOP, WORKS, SCHOOL, PAVILION = range(8)
"""Sorts of buildings."""

_SLIMMEST_WING_M = 5.0
_NARROWEST_M = 8.0
"""Where a lot has it, a house takes this much of the street and leaves less beside it."""


@dataclass(frozen=True)
class _Sort:
    setback_m: tuple[float, float]
    side_m: tuple[float, float]  # free ground on either side
    width_m: tuple[float, float]  # largest extent along the street
    depth_m: tuple[float, float]
    storeys: tuple[float, float]
    storey_m: float
    plans: tuple[float, float, float, float, float]  # shares of BLOCK, ELL, TEE, YOU, COURT
    arm_m: tuple[float, float]  # thickness of wings
    built: float  # share of lots that are built on
    driveway: float
    driveway_m: float


_SORTS = {
    HOUSE: _Sort(
        (4.0, 7.0), (1.3, 2.8), (9.0, 13.0), (8.0, 12.5), (1.4, 2.6), 3.1,
        (0.62, 0.26, 0.07, 0.05, 0.0), (4.8, 6.0), 0.97, 0.85, 3.0,
    ),
    VILLA: _Sort(
        (5.0, 9.0), (2.2, 4.0), (12.0, 18.0), (10.0, 15.0), (1.5, 2.8), 3.2,
        (0.38, 0.32, 0.15, 0.15, 0.0), (5.2, 7.0), 0.96, 0.9, 3.2,
    ),
    ROW: _Sort(
        (2.0, 4.0), (0.15, 0.15), (30.0, 30.0), (9.5, 12.0), (2.0, 3.4), 3.0,
        (0.8, 0.2, 0.0, 0.0, 0.0), (4.0, 5.0), 0.99, 0.25, 2.8,
    ),
    FLATS: _Sort(
        (0.6, 2.5), (0.3, 1.2), (60.0, 60.0), (11.0, 19.0), (3.5, 6.4), 3.1,
        (0.45, 0.27, 0.06, 0.12, 0.1), (8.0, 10.5), 0.97, 0.3, 3.2,
    ),
    SHOP: _Sort(
        (0.8, 4.0), (0.6, 4.5), (70.0, 70.0), (14.0, 28.0), (2.0, 7.0), 3.6,
        (0.5, 0.2, 0.06, 0.12, 0.12), (8.5, 12.0), 0.96, 0.5, 5.0,
    ),
    WORKS: _Sort(
        (7.0, 13.0), (5.0, 10.0), (75.0, 75.0), (20.0, 40.0), (1.0, 1.7), 6.5,
        (0.66, 0.2, 0.1, 0.04, 0.0), (14.0, 19.0), 0.93, 0.95, 7.0,
    ),
    SCHOOL: _Sort(
        (8.0, 14.0), (6.0, 14.0), (62.0, 62.0), (26.0, 38.0), (2.0, 3.4), 3.6,
        (0.05, 0.3, 0.15, 0.3, 0.2), (10.0, 13.0), 1.0, 0.8, 5.0,
    ),
    PAVILION: _Sort(
        (6.0, 20.0), (4.0, 10.0), (7.0, 12.0), (5.0, 8.0), (1.0, 1.3), 3.6,
        (0.9, 0.1, 0.0, 0.0, 0.0), (3.0, 4.0), 0.4, 0.0, 3.0,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Buildings:
    """Ground plans with heights, driveways, and points on walls."""

    shapes: Geometries
    lot: Integers
    heights_m: Floats
    driveways: Geometries
    entrances: Geometries
    entrance_kinds: NDArray[np.object_]


@dataclass(frozen=True)
class _Frame:
    """Axes on the ground, one a building: metres along the street and away from it."""

    origin: Floats  # (n, 2)
    along: Floats  # (n, 2) unit
    inward: Floats  # (n, 2) unit
    width_m: Floats
    depth_m: Floats

    @classmethod
    def of(cls, site: Floats) -> _Frame:
        along = site[:, 1] - site[:, 0]
        front_m = np.hypot(*along.T)
        along = along / np.maximum(front_m, 1e-9)[:, None]
        inward = np.column_stack((-along[:, 1], along[:, 0]))
        left, right = site[:, 3] - site[:, 0], site[:, 2] - site[:, 1]
        lean_left = np.sum(left * along, axis=1)
        lean_right = np.sum(right * along, axis=1)
        low = np.maximum(lean_left, 0.0)
        high = front_m + np.minimum(lean_right, 0.0)
        depth_m = np.minimum(np.sum(left * inward, axis=1), np.sum(right * inward, axis=1))
        return cls(site[:, 0] + low[:, None] * along, along, inward, np.maximum(high - low, 0.0), depth_m)

    def take(self, index: Any) -> _Frame:
        return _Frame(*(getattr(self, column.name)[index] for column in fields(self)))

    def points(self, x: Floats, y: Floats) -> Floats:
        """Return (n, k, 2) points of (n, k) places."""
        return np.asarray(
            self.origin[:, None] + x[..., None] * self.along[:, None] + y[..., None] * self.inward[:, None]
        )


@dataclass(frozen=True)
class _Footprints:
    """Ground plans before they are placed: an extent, a form, and where on the lot they begin."""

    form: Integers
    x_m: Floats
    y_m: Floats
    width_m: Floats
    depth_m: Floats
    arm_m: Floats

    def take(self, index: Any) -> _Footprints:
        return _Footprints(*(getattr(self, column.name)[index] for column in fields(self)))

    def polygons(self, frame: _Frame) -> Geometries:
        shapes = np.empty(len(self.form), dtype=object)
        for form, outline in _OUTLINES.items():
            index = np.flatnonzero(self.form == form)
            if not len(index):
                continue
            x, y = outline(self.width_m[index], self.depth_m[index], self.arm_m[index])
            ring = frame.take(index).points(self.x_m[index, None] + x, self.y_m[index, None] + y)
            shapes[index] = shapely.polygons(ring)
        index = np.flatnonzero(self.form == COURT)
        if len(index):
            arm, width, depth = self.arm_m[index], self.width_m[index], self.depth_m[index]
            inner_x = self.x_m[index, None] + np.column_stack((arm, width - arm, width - arm, arm))
            inner_y = self.y_m[index, None] + np.column_stack((arm, arm, depth - arm, depth - arm))
            courts = np.asarray(shapely.linearrings(frame.take(index).points(inner_x, inner_y)))
            shapes[index] = shapely.polygons(shapely.get_exterior_ring(shapes[index]), holes=courts[:, None])
        return shapes


def _box_outline(width: Floats, depth: Floats, arm: Floats) -> tuple[Floats, Floats]:
    zero = np.zeros_like(width)
    return np.column_stack((zero, width, width, zero)), np.column_stack((zero, zero, depth, depth))


def _ell_outline(width: Floats, depth: Floats, arm: Floats) -> tuple[Floats, Floats]:
    zero = np.zeros_like(width)
    return (
        np.column_stack((zero, width, width, arm, arm, zero)),
        np.column_stack((zero, zero, arm, arm, depth, depth)),
    )


def _tee_outline(width: Floats, depth: Floats, arm: Floats) -> tuple[Floats, Floats]:
    zero, low, high = np.zeros_like(width), (width - arm) / 2, (width + arm) / 2
    return (
        np.column_stack((zero, width, width, high, high, low, low, zero)),
        np.column_stack((zero, zero, arm, arm, depth, depth, arm, arm)),
    )


def _you_outline(width: Floats, depth: Floats, arm: Floats) -> tuple[Floats, Floats]:
    zero = np.zeros_like(width)
    return (
        np.column_stack((zero, width, width, width - arm, width - arm, arm, arm, zero)),
        np.column_stack((zero, zero, depth, depth, arm, arm, depth, depth)),
    )


_OUTLINES = {BLOCK: _box_outline, ELL: _ell_outline, TEE: _tee_outline, YOU: _you_outline, COURT: _box_outline}


def make_buildings(lots: Lots, zones: NDArray[np.object_], radius_m: float, rng: np.random.Generator) -> Buildings:
    """Build on the lots.

    Parameters
    ----------
    radius_m
        Radius of the city: towards its centre buildings are higher.
    """
    sort = _sorts(lots, zones, rng)
    frame = _Frame.of(lots.site)
    plans, heights_m, built = _draw_footprints(lots, sort, frame, radius_m, rng)
    shapely.prepare(lots.shapes)
    shapes, plans, standing = _fit(lots, plans, frame, built)
    main = np.flatnonzero(standing)
    sheds, shed_lot, shed_heights = _sheds(lots, sort, plans, frame, standing, rng)
    driveways = _driveways(lots, sort, shapes, plans, frame, standing, rng)
    entrances, kinds = _entrances(sort[main], plans.take(main), frame.take(main), rng)
    order = np.argsort(np.concatenate((main, shed_lot)), kind="stable")
    return Buildings(
        np.concatenate((shapes[main], sheds))[order],
        np.concatenate((main, shed_lot))[order],
        np.concatenate((heights_m[main], shed_heights))[order],
        driveways,
        entrances,
        kinds,
    )


def _sorts(lots: Lots, zones: NDArray[np.object_], rng: np.random.Generator) -> Integers:
    width_m = np.linalg.norm(lots.site[:, 1] - lots.site[:, 0], axis=1)
    sort = np.full(len(lots), HOUSE)
    sort[(lots.use == GARDEN) | (width_m > 24)] = VILLA
    sort[width_m < 12.5] = ROW
    sort[np.isin(lots.use, (DENSE, CENTRE))] = FLATS
    sort[zones == "commercial"] = SHOP
    sort[zones == "industrial"] = WORKS
    sort[np.isin(zones, ("other", "street"))] = PAVILION
    sort[lots.kind == CAMPUS] = SCHOOL
    small_shop = (zones == "commercial") & np.isin(lots.use, (SUBURB, GARDEN)) & (width_m < 24)
    sort[small_shop & (rng.random(len(lots)) < 0.5)] = HOUSE
    return sort


def _draw_footprints(
    lots: Lots, sort: Integers, frame: _Frame, radius_m: float, rng: np.random.Generator
) -> tuple[_Footprints, Floats, Booleans]:
    def between(name: str) -> Floats:
        low, high = np.array([getattr(_SORTS[s], name) for s in range(len(_SORTS))]).T
        return np.asarray(rng.uniform(low[sort], high[sort]))

    def of(name: str) -> Floats:
        return np.array([getattr(_SORTS[s], name) for s in range(len(_SORTS))])[sort]

    setback, side, arm = between("setback_m"), between("side_m"), between("arm_m")
    side = np.minimum(side, np.maximum((frame.width_m - _NARROWEST_M) / 2, 0.3))
    width = np.minimum(between("width_m"), frame.width_m - 2 * side)
    depth = np.minimum(between("depth_m"), frame.depth_m - setback - 2.0)
    shares = np.cumsum([_SORTS[s].plans for s in range(len(_SORTS))], axis=1)[sort]
    form = (rng.random(len(sort))[:, None] >= shares[:, :4]).sum(axis=1)
    arm = np.minimum(arm, 0.62 * depth)
    slim = np.minimum(arm, np.minimum(depth / 2.7, width / 2.9))
    form[np.isin(form, (YOU, COURT)) & (slim < _SLIMMEST_WING_M)] = ELL
    arm = np.where(np.isin(form, (YOU, COURT)), slim, arm)
    form[(width < 1.7 * arm) | (depth < 1.5 * arm)] = BLOCK
    free = np.maximum(frame.width_m - width, 0.0)
    x = np.where(sort == ROW, free / 2, side + (free - 2 * side) * rng.random(len(sort)))
    x = np.where(lots.kind == FLAG, np.minimum(x, 1.0), x)
    middle = np.hypot(*lots.site.mean(axis=1).T) / radius_m
    storeys = between("storeys") * np.where(sort == SHOP, np.clip(1.7 - 1.3 * middle, 0.6, 1.7), 1.0)
    storeys[(sort == SHOP) & (lots.use == CENTRE) & (rng.random(len(sort)) < 0.06)] *= 2.0
    heights = np.maximum(np.rint(storeys * 2) / 2, 1.0) * of("storey_m") + rng.uniform(0.4, 1.4, len(sort))
    built = (rng.random(len(sort)) < of("built")) & (width > 3.0) & (depth > 3.0)
    built &= (lots.kind != ENCLAVE) & (lots.use != PARK)
    return _Footprints(form, x, setback, width, depth, arm), np.round(heights, 1), built


def _fit(lots: Lots, plans: _Footprints, frame: _Frame, built: Booleans) -> tuple[Geometries, _Footprints, Booleans]:
    """Place buildings as drawn where the lot holds them, else smaller and nearer to the lot's middle, else not."""
    shapes = np.empty(len(built), dtype=object)
    index = np.flatnonzero(built)
    shapes[index] = plans.take(index).polygons(frame.take(index))
    fits = shapely.contains_properly(lots.shapes[index], shapes[index])
    standing = np.zeros(len(built), dtype=bool)
    standing[index[fits]] = True
    left = index[~fits]
    ground = lots.shapes[left]
    centroid = shapely.centroid(ground)
    middles = np.where(shapely.contains(ground, centroid), centroid, shapely.point_on_surface(ground))
    middle = shapely.get_coordinates(middles)
    side_m = 0.75 * np.sqrt(shapely.area(ground))
    x0 = np.sum((middle - frame.origin[left]) * frame.along[left], axis=1)
    y0 = np.sum((middle - frame.origin[left]) * frame.inward[left], axis=1)
    form, x, y, width, depth, arm = (getattr(plans, column.name).copy() for column in fields(plans))
    width[left], depth[left] = np.minimum(width[left], side_m), np.minimum(depth[left], side_m)
    for scale in (1.0, 0.85, 0.7, 0.55, 0.4):
        if not len(left):
            break
        smaller = _Footprints(
            np.full(len(left), BLOCK), x0 - scale * width[left] / 2, y0 - scale * depth[left] / 2,
            scale * width[left], scale * depth[left], arm[left],
        )  # fmt: skip
        placed = smaller.polygons(frame.take(left))
        fits = shapely.contains_properly(lots.shapes[left], placed) & (smaller.width_m > 4) & (smaller.depth_m > 4)
        done = left[fits]
        shapes[done], standing[done], form[done] = placed[fits], True, BLOCK
        x[done], y[done] = smaller.x_m[fits], smaller.y_m[fits]
        width[done], depth[done] = smaller.width_m[fits], smaller.depth_m[fits]
        left, x0, y0 = left[~fits], x0[~fits], y0[~fits]
    return shapes, _Footprints(form, x, y, width, depth, arm), standing


def _sheds(
    lots: Lots, sort: Integers, plans: _Footprints, frame: _Frame, standing: Booleans, rng: np.random.Generator
) -> tuple[Geometries, Integers, Floats]:
    """Put a garage or shed, or a second hall, at the back of some lots."""
    home, works = np.isin(sort, (HOUSE, VILLA, ROW)), sort == WORKS
    wanted = standing & ((home & (rng.random(len(sort)) < 0.34)) | (works & (rng.random(len(sort)) < 0.45)))
    width = np.where(works, rng.uniform(12, 24, len(sort)), rng.uniform(2.8, 4.2, len(sort)))
    depth = np.where(works, rng.uniform(10, 18, len(sort)), rng.uniform(3.0, 5.8, len(sort)))
    gap = np.where(works, 6.0, 2.5)
    y = frame.depth_m - depth - np.where(works, 4.0, 1.3)
    wanted &= (y > plans.y_m + plans.depth_m + gap) & (frame.width_m > width + 2.5)
    right = rng.random(len(sort)) < 0.5
    x = np.where(right, frame.width_m - width - 1.2, 1.2)
    index = np.flatnonzero(wanted)
    sheds = _Footprints(np.full(len(sort), BLOCK), x, y, width, depth, plans.arm_m).take(index)
    shapes = sheds.polygons(frame.take(index))
    fits = shapely.contains_properly(lots.shapes[index], shapes)
    heights = np.where(works[index], rng.uniform(5, 9, len(index)), rng.uniform(2.3, 3.2, len(index)))
    return shapes[fits], index[fits], np.round(heights[fits], 1).astype(np.float64)


def _driveways(
    lots: Lots,
    sort: Integers,
    shapes: Geometries,
    plans: _Footprints,
    frame: _Frame,
    standing: Booleans,
    rng: np.random.Generator,
) -> Geometries:
    """Lead a way from the curb to the building: beside it where there is room, else up to its front."""
    wide = np.array([_SORTS[s].driveway_m for s in range(len(_SORTS))])[sort]
    share = np.array([_SORTS[s].driveway for s in range(len(_SORTS))])[sort]
    chosen = standing & (rng.random(len(sort)) < share) & (lots.kind != FLAG)
    left_gap, right_gap = plans.x_m, frame.width_m - plans.x_m - plans.width_m
    beside_left, beside_right = left_gap > wide + 0.3, right_gap > wide + 0.3
    x = np.where(
        beside_left,
        plans.x_m - wide - 0.05,
        np.where(beside_right, plans.x_m + plans.width_m + 0.05, plans.x_m + 0.35),
    )
    beside = beside_left | beside_right
    y = np.where(beside, plans.y_m + 0.45 * plans.depth_m, plans.y_m)
    chosen &= (y > 1.0) & (plans.width_m > wide)
    index = np.flatnonzero(chosen)
    way = frame.take(index)
    xs = np.column_stack((x, x + wide, x + wide, x))[index]
    inner = shapely.polygons(way.points(xs, np.column_stack((y * 0 + 0.05, y * 0 + 0.05, y - 0.02, y - 0.02))[index]))
    fits = shapely.contains_properly(lots.shapes[index], inner)
    start = np.full(len(sort), -SIDEWALK_M)
    ways = np.asarray(shapely.polygons(way.points(xs, np.column_stack((start, start, y, y))[index])))[fits]
    return np.concatenate((ways, _flag_ways(lots, shapes, plans, frame, standing)))


def _flag_ways(lots: Lots, shapes: Geometries, plans: _Footprints, frame: _Frame, standing: Booleans) -> Geometries:
    """Lead a way along the pole of each flag lot and on to its house."""
    index = np.flatnonzero(standing & (lots.kind == FLAG))
    if not len(index):
        return np.empty(0, dtype=object)
    pole = lots.pole[index]
    ways = []
    for side, back in ((0.12, True), (0.88, False)):
        front = pole[:, 0] * (1 - side) + pole[:, 1] * side
        end = pole[:, 3] * (1 - side) + pole[:, 2] * side
        out = front - (end - front) * (SIDEWALK_M / np.maximum(np.hypot(*(end - front).T), 1e-9))[:, None]
        beyond = end + frame.inward[index] * np.maximum(plans.y_m[index] - 0.1, 0.0)[:, None]
        ways.append(np.stack((beyond, end, out) if back else (out, end, beyond), axis=1))
    polygons = np.asarray(shapely.polygons(np.concatenate((ways[0], ways[1]), axis=1)))
    return polygons[shapely.dwithin(polygons, shapes[index], 0.12)]


def _entrances(
    sort: Integers, plans: _Footprints, frame: _Frame, rng: np.random.Generator
) -> tuple[Geometries, NDArray[np.object_]]:
    """Set a door and a window into the front, and a window into the back; large fronts get a second door."""
    count = len(sort)
    door = plans.width_m * rng.uniform(0.52, 0.62, count)
    front_window = plans.width_m * rng.uniform(0.78, 0.88, count)
    back_middle = np.choose(
        plans.form,
        [plans.width_m / 2, plans.arm_m / 2, plans.width_m / 2, plans.arm_m / 2, plans.width_m / 2],
    )
    zero = np.zeros(count)
    wide = np.flatnonzero(plans.width_m > 26)
    x = np.concatenate((door, front_window, back_middle, (plans.width_m * 0.2)[wide]))
    y = np.concatenate((zero, zero, plans.depth_m, zero[wide]))
    of = np.concatenate((np.arange(count), np.arange(count), np.arange(count), wide))
    kinds = np.repeat(np.array(["door", "window", "window", "door"], dtype=object), [count, count, count, len(wide)])
    kept = ~((kinds == "window") & (sort[of] == WORKS))
    of, kinds = of[kept], kinds[kept]
    xy = frame.take(of).points((plans.x_m[of] + x[kept])[:, None], (plans.y_m[of] + y[kept])[:, None])[:, 0]
    order = np.argsort(of, kind="stable")
    return np.asarray(shapely.points(xy[order])), kinds[order]
