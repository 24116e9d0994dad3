"""Roofs: hips and gables on small houses, flat ones with a parapet on large buildings, plain flat ones on the rest.

Which roof a building gets follows from its footprint and height alone. What stands low and small is a shed or a garage,
what is much taller than wide a tower: both are flat. All other footprints that are small, have few corners and no
courtyard get a pitched roof that follows the outline; its narrow ends are gables, its wide ones hips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.export.scene.city import FloatArray, ShapeArray
from urbanforest_cli.export.scene.pieces import WHITE, Triangles, cut_to_triangles, put_together
from urbanforest_cli.export.scene.roofs_kernel import pitch_roofs

PITCH = 0.67  # rise over run: 34 degrees
RISE_MAX_M = 5.0
GABLE_WIDTH_M = 10.0
PITCHED_AREA_M2 = (16.0, 320.0)
PITCHED_HEIGHT_MAX_M = 12.0
PITCHED_CORNERS_MAX = 12
SHED_HEIGHT_M, SHED_AREA_M2 = 3.5, 60.0
TOWER_SLENDERNESS = 1.6  # height over the root of the area
PARAPET_AREA_M2, PARAPET_HEIGHT_M = 80.0, 5.0  # of the building, at least
PARAPET_WIDTH_M, PARAPET_RISE_M = 0.35, 0.45
DECK_SHARE_MIN = 0.6  # of the footprint that is left inside a parapet
BAY_M = 3.0


@dataclass(frozen=True)
class Pitched:
    """Hip and gable roofs.

    Parameters
    ----------
    triangles
        z is height above the eaves.
    polygon
        (t,) whose roof each triangle is of.
    peak
        (m, 3) tip of the gable over each wall, its height 0 where there is none: see `pitch_roofs`.
    done
        (p,) whether a roof could be made.
    """

    triangles: Triangles
    polygon: NDArray[np.int64]
    peak: FloatArray
    done: NDArray[np.bool_]


def may_be_pitched(
    area_m2: FloatArray, height_m: FloatArray, corners: NDArray[np.integer], has_hole: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Tell of each footprint whether it gets a pitched roof if one can be made."""
    small = (area_m2 >= PITCHED_AREA_M2[0]) & (area_m2 <= PITCHED_AREA_M2[1]) & (height_m <= PITCHED_HEIGHT_MAX_M)
    shed = (height_m < SHED_HEIGHT_M) & (area_m2 < SHED_AREA_M2)
    tower = height_m > TOWER_SLENDERNESS * np.sqrt(area_m2)
    return np.asarray(small & ~shed & ~tower & (corners <= PITCHED_CORNERS_MAX) & ~has_hole)


def pitched_roofs(xy_m: FloatArray, first: NDArray[np.int64]) -> Pitched:
    """Make hip and gable roofs.

    Parameters
    ----------
    xy_m
        (m, 2) corners, counter-clockwise, none repeated at the end.
    first
        (p + 1,) offsets of polygons.
    """
    corners, edge, peak, done = pitch_roofs(xy_m, first, GABLE_WIDTH_M)
    polygon = np.searchsorted(first, edge, side="right") - 1
    run = np.zeros(len(first) - 1)
    np.maximum.at(run, polygon, corners[:, :, 2].max(axis=1))
    pitch = np.minimum(PITCH, RISE_MAX_M / np.maximum(run, RISE_MAX_M / PITCH))
    end = np.arange(1, len(xy_m) + 1)
    end[first[1:] - 1] = first[:-1]
    along = (xy_m[end] - xy_m)[edge]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    steep = pitch[polygon]
    slope = np.sqrt(1.0 + steep**2)
    from_start = corners[:, :, :2] - xy_m[edge][:, None]
    uv = np.stack([(from_start * along[:, None]).sum(axis=2), -corners[:, :, 2] * slope[:, None]], axis=2)
    corners[:, :, 2] *= steep[:, None]
    normal = np.column_stack([along[:, 1] * steep, -along[:, 0] * steep, np.ones(len(edge))]) / slope[:, None]
    of_corner = np.repeat(np.arange(len(first) - 1), np.diff(first))
    peak[:, 2] *= pitch[of_corner]
    return Pitched(Triangles(corners, normal, uv, _white(len(edge))), polygon, peak, done)


def flat_roofs(polygons: ShapeArray, height_m: FloatArray) -> tuple[Triangles, NDArray[np.int64], NDArray[np.bool_]]:
    """Cover polygons: large ones with a deck behind a parapet that rises above their height by PARAPET_RISE_M.

    Returns
    -------
    Triangles, (t,) whose roof each is of, and (p,) whether it has a parapet.
    """
    area = shapely.area(polygons)
    deck = np.empty(len(polygons), dtype=object)
    large = np.flatnonzero((area >= PARAPET_AREA_M2) & (height_m >= PARAPET_HEIGHT_M))
    deck[large] = shapely.buffer(polygons[large], -PARAPET_WIDTH_M, join_style="mitre")
    has = shapely.area(deck) > DECK_SHARE_MIN * area  # no number where there is no deck
    whole, behind = np.flatnonzero(~has), np.flatnonzero(has)
    rim = np.asarray(shapely.difference(polygons[behind], deck[behind]))
    inner, owner = shapely.get_parts(deck[behind], return_index=True)
    rings, place = shapely.get_rings(shapely.orient_polygons(inner, exterior_cw=True), return_index=True)
    low = height_m[behind][owner][place]
    sides, ring = walls_of(rings, low, low + PARAPET_RISE_M)
    parts = [
        _lids(polygons[whole], height_m[whole], whole),
        _lids(rim, height_m[behind] + PARAPET_RISE_M, behind),
        _lids(deck[behind], height_m[behind], behind),
        (sides, behind[owner[place[ring]]]),
    ]
    return put_together([part for part, _ in parts]), np.concatenate([index for _, index in parts]), has


def _lids(polygons: ShapeArray, z_m: FloatArray, owner: NDArray[np.int64]) -> tuple[Triangles, NDArray[np.int64]]:
    xy, index = cut_to_triangles(polygons)
    corners = np.concatenate([xy, np.broadcast_to(z_m[index, None, None], (len(xy), 3, 1))], axis=2)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (len(xy), 3))
    return Triangles(corners, normal, xy * [1.0, -1.0], _white(len(xy))), owner[index]


def walls_of(rings: ShapeArray, low_m: FloatArray, high_m: FloatArray) -> tuple[Triangles, NDArray[np.int64]]:
    """Stand walls on rings, their outside on the right hand; also whose ring (t,) each triangle stands on."""
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    inside = np.flatnonzero(ring[1:] == ring[:-1])
    start, end, ring = xy[inside], xy[inside + 1], np.asarray(ring[inside], dtype=np.int64)
    return upright(start, end, low_m[ring], high_m[ring]), np.repeat(ring, 2)


def upright(start: FloatArray, end: FloatArray, low_m: FloatArray, high_m: FloatArray) -> Triangles:
    """Return two triangles for each wall from (n, 2) to (n, 2), seen from its right hand.

    Texture coordinates are metres along the wall, `stretched`, and downward from z = 0.
    """
    length = np.linalg.norm(end - start, axis=1)
    wide = stretched(length)
    a, b = (np.column_stack([xy, low_m]) for xy in (start, end))
    c, d = (np.column_stack([xy, high_m]) for xy in (end, start))
    zero = np.zeros(len(start))
    corners = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3, 3)
    u = np.stack([zero, wide, wide, zero, wide, zero], axis=1).reshape(-1, 3)
    along = (end - start) / length[:, None]
    normal = np.repeat(np.column_stack([along[:, 1], -along[:, 0], zero]), 2, axis=0)
    return Triangles(corners, normal, np.stack([u, -corners[:, :, 2]], axis=2), _white(2 * len(start)))


def stretched(length_m: FloatArray) -> FloatArray:
    """Return how wide walls are on their texture, whole bays, so that a texture's windows are whole.

    Walls too narrow for a bay show the half of their width that lies left of the first window.
    """
    bays = np.rint(length_m / BAY_M)
    return np.where(bays > 0, BAY_M * bays, 0.5 * length_m)


def _white(count: int) -> NDArray[np.uint8]:
    return np.full((count, 3), WHITE, dtype=np.uint8)
