"""The ground of a city: lots in the quiet colours of their zones, roads, and a plate under all.

All is flat. The plate lies `PLATE_M` below the ground and roads `ROAD_M` above it, so that nothing flickers where
surfaces lie over each other; where a lot and a road overlap, the road is kept.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.colours import mixed
from urbanforest_cli.core.scenery import Material
from urbanforest_cli.export.scene.city import City, FloatArray, ShapeArray
from urbanforest_cli.export.scene.pieces import (
    CELL_M,
    WHITE,
    Piece,
    Triangles,
    by_cell,
    cells_of,
    centre_of,
    cut_to_triangles,
    joined,
    linear_rgb,
    pieces_of,
    sound_polygons,
)

PLATE_M, ROAD_M = 0.06, 0.03
LAWN = "#9aa87e"
LAWN_SHARE = 0.6  # of the lawn's colour in that of a lot, the rest is its zone's on the map
GROUND = Material("ground", roughness=1.0)
ROAD = Material("road", rgb=linear_rgb("#c2bfb9"), roughness=1.0)
PLATE = Material("plate", rgb=linear_rgb("#cdc9bc"), roughness=1.0)
PLATE_CELL_M = 2000.0
MARGIN_M = 60.0
AREA_MIN_M2 = 1e-6


def build_ground(city: City) -> list[Piece]:
    """Lay lots, roads and the plate, in cells.

    Lots and roads are cut where cells meet. Texture coordinates are metres from the middle of a cell.
    """
    lots, lot = sound_polygons(city.local_shapes(city.lots))
    roads, _ = sound_polygons(city.local_shapes(city.roads))
    lots, owner, lot_cell = _cut_by_cells(lots)
    roads, _, road_cell = _cut_by_cells(roads)
    roads, road_cell = _joined_by_cell(roads, road_cell)
    lots = _without(lots, lot_cell, roads, road_cell)
    colours, colour = np.unique(city.lot_colour.astype(str), return_inverse=True)
    tints = np.array([ground_tint(name) for name in colours], dtype=np.uint8).reshape(-1, 3)
    tint = tints[colour.reshape(-1)[lot[owner]]]
    ground_m = -city.origin.height_m
    flat, index = _flat(lots, 0.0, tint, lot_cell)
    pieces = pieces_of(flat, lot_cell[index], name="lots", material=GROUND, ground_m=ground_m)
    white = np.full((len(roads), 3), WHITE, dtype=np.uint8)
    flat, index = _flat(roads, ROAD_M, white, road_cell)
    pieces += pieces_of(flat, road_cell[index], name="roads", material=ROAD, ground_m=ground_m)
    return pieces + _plate(city, ground_m)


def ground_tint(colour: str) -> tuple[int, int, int]:
    """Return the tint of lots that the map fills with a colour."""
    red, green, blue = (round(WHITE * part) for part in linear_rgb(mixed(colour, LAWN, LAWN_SHARE)))
    return (red, green, blue)


def _cut_by_cells(polygons: ShapeArray) -> tuple[ShapeArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return polygons cut where cells meet, (n,) which each is of, and (n, 2) its cell."""
    bounds = shapely.bounds(polygons).reshape(-1, 4)
    low, high = cells_of(bounds[:, :2]), cells_of(bounds[:, 2:])
    wide = high - low + 1
    owner = np.repeat(np.arange(len(polygons)), wide[:, 0] * wide[:, 1])
    place = np.arange(len(owner)) - np.repeat(np.cumsum(wide[:, 0] * wide[:, 1]) - wide[:, 0] * wide[:, 1],
                                              wide[:, 0] * wide[:, 1])  # fmt: skip
    cell = low[owner] + np.column_stack([place % wide[owner, 0], place // wide[owner, 0]])
    pieces = polygons[owner]
    cut = (wide[owner] > 1).any(axis=1)
    corner = cell[cut] * CELL_M
    boxes = shapely.box(corner[:, 0], corner[:, 1], corner[:, 0] + CELL_M, corner[:, 1] + CELL_M)
    pieces[cut] = shapely.intersection(pieces[cut], boxes)
    parts, index = _parts(pieces)
    return parts, owner[index], cell[index]


def _parts(shapes: ShapeArray) -> tuple[ShapeArray, NDArray[np.int64]]:
    parts, index = shapely.get_parts(shapes, return_index=True)
    kept = (shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & (shapely.area(parts) > AREA_MIN_M2)
    return np.asarray(parts[kept]), np.asarray(index[kept], dtype=np.int64)


def _joined_by_cell(polygons: ShapeArray, cell: NDArray[np.int64]) -> tuple[ShapeArray, NDArray[np.int64]]:
    """Return one shape for each cell that has any, and (n, 2) the cells."""
    groups = list(by_cell(cell))
    shapes = np.empty(len(groups), dtype=object)
    shapes[:] = [shapely.union_all(polygons[rows]) for _, rows in groups]
    return shapes, np.array([place for place, _ in groups], dtype=np.int64).reshape(-1, 2)


def _without(
    polygons: ShapeArray, cell: NDArray[np.int64], others: ShapeArray, other_cell: NDArray[np.int64]
) -> ShapeArray:
    """Return polygons less what the shape of their cell covers."""
    row = {(east, north): number for number, (east, north) in enumerate(other_cell.tolist())}
    other = np.array([row.get((east, north), -1) for east, north in cell.tolist()], dtype=np.int64)
    shapely.prepare(others)
    near = np.flatnonzero(other >= 0)
    near = near[shapely.intersects(others[other[near]], polygons[near])]
    left = polygons.copy()
    left[near] = shapely.difference(polygons[near], others[other[near]])
    return left


def _flat(
    shapes: ShapeArray, z_m: float, tint: NDArray[np.uint8], cell: NDArray[np.int64]
) -> tuple[Triangles, NDArray[np.int64]]:
    """Cut shapes to triangles at a height; also which shape (t,) each is of."""
    xy, index = cut_to_triangles(shapes)
    corners = np.concatenate([xy, np.full((len(xy), 3, 1), z_m)], axis=2)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (len(xy), 3))
    middle = (cell[index] + 0.5) * CELL_M
    return Triangles(corners, normal, (xy - middle[:, None]) * [1.0, -1.0], tint[index]), index


def _plate(city: City, ground_m: float) -> list[Piece]:
    """Return the plate under lots, roads, buildings and plants, in squares."""
    box = _extent(city)
    if box is None:
        return []
    low, high = cells_of(box[None, :2], cell_m=PLATE_CELL_M)[0], cells_of(box[None, 2:], cell_m=PLATE_CELL_M)[0]
    pieces = []
    for north in range(low[1], high[1] + 1):
        for east in range(low[0], high[0] + 1):
            cell = np.array([east, north])
            west, south = np.maximum(cell * PLATE_CELL_M, box[:2])
            right, top = np.minimum((cell + 1) * PLATE_CELL_M, box[2:])
            corners = np.array([[west, south, -PLATE_M], [right, south, -PLATE_M], [right, top, -PLATE_M],
                                [west, top, -PLATE_M]])[[[0, 1, 2], [0, 2, 3]]]  # fmt: skip
            centre = centre_of(cell, 0.0, cell_m=PLATE_CELL_M)
            uv = (corners[:, :, :2] - np.array(centre)[:2]) * [1.0, -1.0]
            white = np.full((2, 3), WHITE, dtype=np.uint8)
            mesh = joined(Triangles(corners, np.tile([0.0, 0.0, 1.0], (2, 1)), uv, white), centre)
            pieces.append(Piece(f"plate {east} {north}", mesh, PLATE, (centre[0], centre[1], ground_m)))
    return pieces


def _extent(city: City) -> FloatArray | None:
    """Return west, south, east, north of all there is, and a margin; None where there is nothing."""
    shapes = np.concatenate([city.local_shapes(layer) for layer in (city.lots, city.roads, city.buildings)])
    bounds = shapely.bounds(shapes).reshape(-1, 4)
    places = city.local(city.plants.xy_m)[:, :2]
    corners = np.vstack([bounds[:, :2], bounds[:, 2:], places])
    corners = corners[np.isfinite(corners).all(axis=1)]
    if not len(corners):
        return None
    return np.concatenate([corners.min(axis=0) - MARGIN_M, corners.max(axis=0) + MARGIN_M])
