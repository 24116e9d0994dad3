"""Readable, slow twins of the medial axis kernel."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Delaunay, Voronoi


def boundary_samples(polygon: shapely.Polygon, step_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sample the rings evenly, corners included; return (n, 2) points and the index of the next one on the ring."""
    points: list[NDArray[np.float64]] = []
    following: list[NDArray[np.int64]] = []
    count = 0
    for ring in (polygon.exterior, *polygon.interiors):
        corners = np.asarray(ring.coords)
        on_ring = []
        for a, b in pairwise(corners):
            pieces = max(1, int(np.ceil(np.hypot(*(b - a)) / step_m)))
            on_ring.append(a + (b - a) * np.arange(pieces)[:, None] / pieces)
        ring_points = np.concatenate(on_ring)
        points.append(ring_points)
        following.append(count + np.roll(np.arange(len(ring_points)), -1))
        count += len(ring_points)
    return np.concatenate(points), np.concatenate(following)


def voronoi_axis(polygon: shapely.Polygon, step_m: float) -> NDArray[np.float64]:
    """Return (n, 2, 2) the Voronoi edges of boundary samples that lie inside and part no two neighbours of a ring.

    As the samples grow dense this becomes the whole medial axis (Brandt and Algazi 1992).
    """
    points, following = boundary_samples(polygon, step_m)
    voronoi = Voronoi(points - points.mean(axis=0))
    vertices = voronoi.vertices + points.mean(axis=0)
    ends = np.asarray(voronoi.ridge_vertices)
    one, other = voronoi.ridge_points.T
    keep = (ends >= 0).all(axis=1) & (following[one] != other) & (following[other] != one)
    inside = shapely.contains_xy(polygon, vertices[:, 0], vertices[:, 1])
    keep &= inside[ends].all(axis=1)
    return np.asarray(vertices[ends[keep]])


def delaunay_triangles(points: NDArray[np.float64]) -> set[frozenset[int]]:
    """Return the triangles of points in general position."""
    return {frozenset(triangle.tolist()) for triangle in Delaunay(points).simplices}
