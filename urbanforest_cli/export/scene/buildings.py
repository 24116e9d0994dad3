"""Buildings as solids: exact footprints, walls as high as stated, roofs that suit them.

The stated height is that of the eaves, or of a flat roof; ridges and parapets rise above it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Material
from urbanforest_cli.export.scene.city import City, FloatArray, ShapeArray
from urbanforest_cli.export.scene.pieces import (
    WHITE,
    Piece,
    Triangles,
    cells_of,
    linear_rgb,
    pieces_of,
    put_together,
    sound_polygons,
)
from urbanforest_cli.export.scene.roofs import (
    PARAPET_RISE_M,
    flat_roofs,
    may_be_pitched,
    pitched_roofs,
    stretched,
    upright,
)

WALL = Material("wall", rgb=linear_rgb("#ece9e2"), roughness=0.95)
ROOF = Material("roof", rgb=linear_rgb("#d9cfc4"), roughness=0.95)
FOOT_M = 0.1  # walls reach so far into the ground
STRAIGHT_M = 1e-6  # a corner nearer than this to the line between its neighbours is none
AREA_MIN_M2 = 0.01


@dataclass(frozen=True)
class Built:
    """Buildings of a city.

    Parameters
    ----------
    pieces
        Walls and roofs by cell.
    left_out
        Buildings without area or height.
    """

    pieces: tuple[Piece, ...]
    left_out: int


@dataclass(frozen=True)
class _Footprints:
    """Polygons (p,) without needless corners, their walls' height, and all their rings' walls.

    `start`, `end` (w, 2) walls in order, `of` (w,) their polygon.
    """

    polygon: ShapeArray
    height_m: FloatArray
    start: FloatArray
    end: FloatArray
    of: NDArray[np.int64]


@dataclass(frozen=True)
class _Roofs:
    """Roofs, `of` (t,) their polygon, and `peak` (w, 3) tips of gables above the eaves of walls."""

    triangles: Triangles
    of: NDArray[np.int64]
    peak: FloatArray
    has_parapet: NDArray[np.bool_]


def build_buildings(city: City) -> Built:
    """Build all that have area and height.

    Walls start `FOOT_M` below the ground and end at the building's height, or with the parapet. Footprints that cross
    themselves are mended. Each building lies in the cell of its footprint's middle. Texture coordinates are metres:
    along a wall (see `stretched`) and, downward, from the ground; on pitched roofs along and from the eaves.
    """
    footprints, left_out = _footprints(city)
    roofs = _roofs(footprints)
    walls, of_wall = _walls(footprints, roofs)
    cell = cells_of(shapely.get_coordinates(shapely.centroid(footprints.polygon)))
    ground_m = -city.origin.height_m
    pieces = pieces_of(walls, cell[of_wall], name="walls", material=WALL, ground_m=ground_m)
    pieces += pieces_of(roofs.triangles, cell[roofs.of], name="roofs", material=ROOF, ground_m=ground_m)
    return Built(tuple(pieces), left_out)


def _footprints(city: City) -> tuple[_Footprints, int]:
    height = np.asarray(city.building_height_m, dtype=np.float64)
    polygon, index = sound_polygons(city.local_shapes(city.buildings))
    polygon, kept = _without_straight_corners(polygon)
    index = index[kept]
    fine = (shapely.area(polygon) >= AREA_MIN_M2) & np.isfinite(height[index]) & (height[index] > 0)
    polygon, index = polygon[fine], index[fine]
    xy, ring = shapely.get_coordinates(shapely.get_rings(polygon), return_index=True)
    _, of_ring = shapely.get_rings(polygon, return_index=True)
    inside = np.flatnonzero(ring[1:] == ring[:-1])
    found = _Footprints(polygon, height[index], xy[inside], xy[inside + 1], of_ring[ring[inside]])
    return found, len(city.buildings) - len(np.unique(index))


def _without_straight_corners(polygon: ShapeArray) -> tuple[ShapeArray, NDArray[np.int64]]:
    """Leave out corners that repeat others or lie on the line between them; also which polygons remain."""
    rings, owner = shapely.get_rings(shapely.remove_repeated_points(polygon, STRAIGHT_M), return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    is_last = np.append(ring[1:] != ring[:-1], True)[: len(ring)]
    xy, ring = xy[~is_last], ring[~is_last]
    first = np.searchsorted(ring, np.arange(len(rings) + 1))
    before, after = np.arange(len(xy)) - 1, np.arange(len(xy)) + 1
    before[first[:-1]], after[first[1:] - 1] = first[1:] - 1, first[:-1]
    back, ahead = xy - xy[before], xy[after] - xy
    across = np.abs(back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0])
    bends = across > STRAIGHT_M * np.linalg.norm(xy[after] - xy[before], axis=1)
    count = np.bincount(ring[bends], minlength=len(rings))
    bends &= count[ring] >= 3
    left = np.unique(ring[bends])
    place = np.searchsorted(left, ring[bends])
    remaining = shapely.linearrings(xy[bends], indices=place)
    owners, owner_place = np.unique(owner[left], return_inverse=True)
    return np.asarray(shapely.polygons(remaining, indices=owner_place)), owners


def _roofs(footprints: _Footprints) -> _Roofs:
    polygon, height = footprints.polygon, footprints.height_m
    corners = np.bincount(footprints.of, minlength=len(polygon))
    wanted = may_be_pitched(shapely.area(polygon), height, corners, shapely.get_num_interior_rings(polygon) > 0)
    rows = np.flatnonzero(wanted)
    walls = wanted[footprints.of]
    pitched = pitched_roofs(footprints.start[walls], np.append(0, np.cumsum(corners[rows])))
    pitched.triangles.corners[:, :, 2] += height[rows][pitched.polygon][:, None]
    is_pitched = np.zeros(len(polygon), dtype=bool)
    is_pitched[rows[pitched.done]] = True
    peak = np.zeros((len(footprints.of), 3))
    peak[walls] = pitched.peak
    flat_rows = np.flatnonzero(~is_pitched)
    flat, of_flat, parapet = flat_roofs(polygon[flat_rows], height[flat_rows])
    has_parapet = np.zeros(len(polygon), dtype=bool)
    has_parapet[flat_rows] = parapet
    of = np.append(rows[pitched.polygon], flat_rows[of_flat])
    return _Roofs(put_together([pitched.triangles, flat]), of, peak, has_parapet)


def _walls(footprints: _Footprints, roofs: _Roofs) -> tuple[Triangles, NDArray[np.int64]]:
    """Return walls, with the gables on them, and (t,) their polygon."""
    high = (footprints.height_m + PARAPET_RISE_M * roofs.has_parapet)[footprints.of]
    peak = roofs.peak
    start, end = footprints.start, footprints.end
    walls = upright(start, end, np.full(len(start), -FOOT_M), high)
    rows = np.flatnonzero(peak[:, 2] > 0)
    eaves = [np.column_stack([xy[rows], high[rows]]) for xy in (start, end)]
    tip = peak[rows] + np.column_stack([np.zeros((len(rows), 2)), high[rows]])
    corners = np.stack([*eaves, tip], axis=1)
    width = np.linalg.norm(end[rows] - start[rows], axis=1)
    along = np.linalg.norm(corners[:, :, :2] - start[rows][:, None], axis=2) * (stretched(width) / width)[:, None]
    gables = Triangles(
        corners,
        walls.normal[2 * rows],
        np.stack([along, -corners[:, :, 2]], axis=2),
        np.full((len(rows), 3), WHITE, dtype=np.uint8),
    )
    return put_together([walls, gables]), np.append(np.repeat(footprints.of, 2), footprints.of[rows])
