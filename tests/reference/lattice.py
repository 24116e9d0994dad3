"""Readable, slow twin of the lattice kernel."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray


def lattice_by_shapely(
    lot: shapely.Geometry, area: shapely.Geometry, cell_m: float, orientation_deg: float, guard_m: float = 0.001
) -> NDArray[np.float64]:
    """Return (n, 2) the centred lattice's points in a lot, found with shapely alone, in no order."""
    box = np.asarray(shapely.oriented_envelope(lot).exterior.coords)
    along = box[1] - box[0]
    angle = np.arctan2(along[1], along[0]) + np.radians(orientation_deg)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    uv = shapely.get_coordinates(lot) @ axes.T
    rows = []
    for low, high in zip(uv.min(axis=0), uv.max(axis=0), strict=True):
        count = max(1, int(np.ceil((high - low) / cell_m - 0.5 - 1e-5)))
        rows.append((low + high) / 2 + cell_m * (np.arange(count) - (count - 1) / 2))
    u, v = (grid.ravel() for grid in np.meshgrid(*rows))
    points = np.column_stack([u, v]) @ axes
    inside = shapely.contains_xy(area, points[:, 0], points[:, 1])
    inside &= shapely.distance(shapely.boundary(area), shapely.points(points)) >= guard_m
    return np.asarray(points[inside])
