"""Fixed things of a scene in pieces: cells of a grid, so that the numbers of each stay small and viewers can cull."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.core.scenery import Material, Mesh
from urbanforest_cli.export.scene.city import FloatArray, ShapeArray

CELL_M = 500.0
WHITE = 255


@dataclass(frozen=True)
class Piece:
    """One material's surface in one cell; `mesh` is about `centre_m`, which is about the scene's origin."""

    name: str
    mesh: Mesh
    material: Material
    centre_m: tuple[float, float, float]


@dataclass(frozen=True)
class Triangles:
    """Loose triangles about the scene's origin, z above the ground.

    Parameters
    ----------
    corners
        (t, 3, 3) metres, counter-clockwise seen from outside.
    normal
        (t, 3) of length 1.
    uv
        (t, 3, 2) place on the texture.
    tint
        (t, 3) uint8 as `Mesh` has it.
    """

    corners: FloatArray
    normal: FloatArray
    uv: FloatArray
    tint: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.corners)

    def take(self, rows: NDArray[np.integer]) -> Triangles:
        """Return some of them."""
        return Triangles(self.corners[rows], self.normal[rows], self.uv[rows], self.tint[rows])


def put_together(parts: Sequence[Triangles]) -> Triangles:
    """Return triangles behind each other."""
    parts = [Triangles(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3, 2)), np.empty((0, 3), np.uint8)), *parts]
    return Triangles(*(np.concatenate([getattr(part, name) for part in parts])
                       for name in ("corners", "normal", "uv", "tint")))  # fmt: skip


def cells_of(xy_m: FloatArray, *, cell_m: float = CELL_M) -> NDArray[np.int64]:
    """Return (n, 2) the cell, east and north of the origin's, that each place (n, 2) lies in."""
    return np.floor(xy_m / cell_m).astype(np.int64)


def centre_of(cell: NDArray[np.int64], ground_m: float, *, cell_m: float = CELL_M) -> tuple[float, float, float]:
    """Return the middle of a cell, on the ground."""
    return (float((cell[0] + 0.5) * cell_m), float((cell[1] + 0.5) * cell_m), ground_m)


def linear_rgb(colour: str) -> tuple[float, float, float]:
    """Return a colour ``#rrggbb`` as linear light from 0 to 1."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour))
    return (red, green, blue)


def cut_to_triangles(polygons: ShapeArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Cut polygons into triangles that use no corners but theirs.

    Returns
    -------
    (t, 3, 2) corners, counter-clockwise, and (t,) which polygon each is of.
    """
    parts, index = shapely.get_parts(shapely.constrained_delaunay_triangles(polygons), return_index=True)
    xy = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    turns = doubled_area(xy) < 0
    xy[turns] = xy[turns][:, ::-1]
    return xy, np.asarray(index, dtype=np.int64)


def doubled_area(xy: FloatArray) -> FloatArray:
    """Return twice the area of triangles (t, 3, 2), above zero if they are counter-clockwise."""
    (ax, ay), (bx, by) = (xy[:, 1] - xy[:, 0]).T, (xy[:, 2] - xy[:, 0]).T
    return np.asarray(ax * by - ay * bx)


def sound_polygons(shapes: ShapeArray) -> tuple[ShapeArray, NDArray[np.int64]]:
    """Return the flat polygons that shapes are made of, mended where they cross themselves, and whose each is."""
    flat = shapely.force_2d(shapes)
    broken = ~shapely.is_valid(flat)
    if broken.any():
        flat = flat.copy()
        flat[broken] = shapely.make_valid(flat[broken])
    parts, index = shapely.get_parts(flat, return_index=True)
    inner, place = shapely.get_parts(parts, return_index=True)  # a mended shape may hold a multipolygon in a collection
    index = index[place]
    kept = (shapely.get_type_id(inner) == shapely.GeometryType.POLYGON) & (shapely.area(inner) > 0)
    return np.asarray(shapely.orient_polygons(inner[kept])), np.asarray(index[kept], dtype=np.int64)


def by_cell(cell: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield each cell (2,) that holds anything, from south to north and west to east, and its rows."""
    order = np.lexsort((cell[:, 0], cell[:, 1]))
    begin = 1 + np.flatnonzero((cell[order][1:] != cell[order][:-1]).any(axis=1))
    for rows in np.split(order, begin) if len(order) else []:
        yield cell[rows[0]], rows  # of equal cells in their order: the sort is stable


def pieces_of(
    triangles: Triangles, cell: NDArray[np.int64], *, name: str, material: Material, ground_m: float
) -> list[Piece]:
    """Put triangles of the same cell (t, 2) together; the ground lies at `ground_m` about the origin."""
    pieces = []
    for place, rows in by_cell(cell):
        centre = centre_of(place, ground_m)
        mesh = joined(triangles.take(rows), (centre[0], centre[1], 0.0))
        pieces.append(Piece(f"{name} {place[0]} {place[1]}", mesh, material, centre))
    return pieces


def joined(triangles: Triangles, centre_m: tuple[float, float, float]) -> Mesh:
    """Return a mesh about a place; corners that are alike in all are stored once, in the order of their first use.

    Triangles are left out that are too narrow for float32 to tell two of their corners apart.
    """
    count = 3 * len(triangles)
    xyz = (triangles.corners - np.array(centre_m)).reshape(count, 3)
    numbers = np.hstack([xyz, np.repeat(triangles.normal, 3, axis=0), triangles.uv.reshape(count, 2)])
    corner = numbers.astype(np.float32) + np.float32(0.0)  # so that -0 is 0
    tint = np.repeat(triangles.tint, 3, axis=0)
    kept, back = _first_of_alike(np.hstack([corner.view(np.uint32), tint.astype(np.uint32)]))
    triangle = back.reshape(-1, 3)
    place = corner[kept[triangle], :3]
    apart = (place != np.roll(place, 1, axis=1)).any(axis=2).all(axis=1)
    return Mesh(
        xyz_m=np.ascontiguousarray(corner[kept, :3]),
        normal=np.ascontiguousarray(corner[kept, 3:6]),
        uv=np.ascontiguousarray(corner[kept, 6:]),
        tint=np.ascontiguousarray(tint[kept]),
        triangle=triangle[apart].astype(np.uint32),
    )


def _first_of_alike(rows: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first of each kind of row, in order, and (n,) which of them each row is like."""
    mixed = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:
        mixed = (mixed ^ column) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    _, first, back = np.unique(mixed, return_index=True, return_inverse=True)
    if (rows[first[back]] != rows).any():  # two kinds with one hash
        _, first, back = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[back.reshape(-1)]
