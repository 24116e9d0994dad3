"""What stands around plants in pictures: buildings, flat areas such as roads, people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.export.plant_scene import FloatArray, Rgb, Wood, linear

WALL_RGB: Rgb = (0.86, 0.85, 0.83)
ROOF_SHADE = 0.72  # roofs lie in the sun; they are drawn darker so that they do not glare
TILE_M = 8.0  # flat areas are cut to tiles, so that those behind the viewer can be left out


@dataclass(frozen=True)
class Faces:
    """Flat triangles: (n, 3, 3) corners, (n, 3) normals and linear colours, (n, 3, 2) metres on the wall or -1."""

    corners: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    normal: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    rgb: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    uv: FloatArray = field(default_factory=lambda: np.empty((0, 3, 2)))


def build_walls(buildings: NDArray[np.object_], height_m: FloatArray, *, rgb: Rgb = WALL_RGB) -> Faces:
    """Extrude footprints to walls and flat roofs."""
    corners: list[Any] = []
    normals: list[Any] = []
    uvs: list[Any] = []
    for polygon, height in zip(shapely.orient_polygons(buildings), height_m, strict=True):
        for ring in shapely.get_rings(shapely.get_parts(polygon)):
            xy = shapely.get_coordinates(ring)
            for (x0, y0), (x1, y1) in pairwise(xy):
                length = float(np.hypot(x1 - x0, y1 - y0))
                if length < 1e-6:
                    continue
                a, b, c, d = (x0, y0, 0.0), (x1, y1, 0.0), (x1, y1, height), (x0, y0, height)
                corners += [(a, b, c), (a, c, d)]
                bays = max(round(length / 3.0), 1) * 3.0  # whole windows on each wall
                uvs += [((0, 0), (bays, 0), (bays, height)), ((0, 0), (bays, height), (0, height))]
                normals += [((y1 - y0) / length, -(x1 - x0) / length, 0.0)] * 2
        for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)):
            xy = shapely.get_coordinates(triangle)[:3]
            corners.append(tuple((x, y, height) for x, y in xy))
            uvs.append(((-1, -1),) * 3)
            normals.append((0.0, 0.0, 1.0))
    walls = _faces(corners, normals, uvs, rgb)
    walls.rgb[walls.normal[:, 2] > 0.5] *= ROOF_SHADE
    return walls


def build_slabs(areas: NDArray[np.object_], *, z_m: float, rgb: Rgb) -> Faces:
    """Lay flat areas, such as roads, a little above the ground."""
    west, south, east, north = shapely.total_bounds(areas)
    x, y = np.meshgrid(np.arange(west, east, TILE_M), np.arange(south, north, TILE_M))
    tiles = shapely.box(x.ravel(), y.ravel(), x.ravel() + TILE_M, y.ravel() + TILE_M)
    pieces = shapely.get_parts(shapely.intersection(tiles, shapely.union_all(areas)))
    pieces = pieces[shapely.get_type_id(pieces) == shapely.GeometryType.POLYGON]
    corners = [
        tuple((x, y, z_m) for x, y in shapely.get_coordinates(triangle)[:3])
        for triangle in shapely.get_parts(shapely.constrained_delaunay_triangles(pieces))
    ]
    return _faces(corners, [(0.0, 0.0, 1.0)] * len(corners), [((-1, -1),) * 3] * len(corners), rgb)


def _faces(corners: list[Any], normals: list[Any], uvs: list[Any], rgb: Rgb) -> Faces:
    count = len(corners)
    colour = np.tile(linear(rgb), (count, 1))
    return Faces(np.array(corners, dtype=np.float64).reshape(count, 3, 3), np.array(normals).reshape(count, 3),
                 colour, np.array(uvs, dtype=np.float64).reshape(count, 3, 2))  # fmt: skip


def joined_faces(parts: Sequence[Faces]) -> Faces:
    """Put faces together."""
    parts = [Faces(), *parts]
    return Faces(*(np.concatenate([getattr(part, name) for part in parts])
                   for name in ("corners", "normal", "rgb", "uv")))  # fmt: skip


def build_person(x: float, y: float, *, height_m: float = 1.75, rgb: Rgb = (0.22, 0.23, 0.26)) -> Wood:
    """Stand a person beside the plants, for scale."""
    k = height_m / 1.75
    parts = [  # from, to, radii
        ((-0.09, 0.0), (-0.08, 0.82), 0.07, 0.09), ((0.11, 0.0), (0.08, 0.82), 0.07, 0.09),
        ((0.0, 0.86), (0.0, 1.36), 0.15, 0.18), ((-0.24, 0.82), (-0.19, 1.36), 0.05, 0.065),
        ((0.24, 0.82), (0.19, 1.36), 0.05, 0.065), ((0.0, 1.40), (0.0, 1.48), 0.06, 0.06),
        ((0.0, 1.60), (0.0, 1.64), 0.115, 0.115),
    ]  # fmt: skip
    start = np.array([(x + k * a[0], y, k * a[1]) for a, _, _, _ in parts])
    end = np.array([(x + k * b[0], y, k * b[1]) for _, b, _, _ in parts])
    radii = k * np.array([(r, q) for _, _, r, q in parts])
    return Wood(start, end, radii[:, 0], radii[:, 1], np.tile(linear(rgb), (len(parts), 1)))
