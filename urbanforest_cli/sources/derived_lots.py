"""Lots for a city that has none: blocks between streets, each shared out among its buildings.

The idea is that of enclosed tessellation (Fleischmann et al. 2020; momepy): ground belongs to the building whose walls
are nearest, within what the streets enclose. Here the street's own corridor belongs to nobody, and ground farther
from any building than a lot is deep stays a lot without a building.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Voronoi

from urbanforest_cli.core.errors import LimitError

STREET_WIDTH_LEAST_M = 4.0
WALL_STEP_M = 2.0
WALL_INSET_M = 0.25
REACH_M = 40.0
EDGE_REACH_M = 15.0
LOT_AREA_LEAST_M2 = 10.0
GRID_M = 0.001
BORDER_TOLERANCE_M = 0.2
BLOCK_POINTS_MOST = 1_000_000

Shapes = NDArray[Any]
Report = Callable[[int, int], None]


@dataclass(frozen=True)
class DerivedLots:
    """Lots made from blocks.

    Parameters
    ----------
    shapes
        (n,) polygons or multipolygons.
    names
        (n,) text: number of the block, and of the lot in it.
    built
        (n,) bool: whether the lot bears a building.
    block_count
        Number of blocks they were cut from.
    sliver_count
        Pieces below `LOT_AREA_LEAST_M2` that were left out.
    """

    shapes: Shapes
    names: NDArray[Any]
    built: NDArray[np.bool_]
    block_count: int
    sliver_count: int


def derive_lots(
    road_lines: Shapes, road_widths_m: NDArray[np.float64], road_areas: Shapes, buildings: Shapes, *, report: Report
) -> DerivedLots:
    """Make lots from streets and buildings.

    Parameters
    ----------
    road_lines, road_widths_m
        Centre lines and widths. Narrower ones than `STREET_WIDTH_LEAST_M` are paths: they neither bound a block nor
        take ground.
    road_areas
        Roads drawn as polygons.
    buildings
        Valid footprints. All in one CRS in metres.
    report
        Called with the number of blocks done and in all.
    """
    streets = road_widths_m >= STREET_WIDTH_LEAST_M
    blocks = find_blocks(road_lines[streets], road_widths_m[streets], road_areas, buildings)
    inside, block_of = _buildings_by_block(blocks, buildings)
    shapes: list[Any] = []
    names: list[str] = []
    built: list[bool] = []
    slivers = 0
    for number, block in enumerate(blocks):
        mine = buildings[inside[block_of == number]]
        pieces = share_out(block, mine)
        for place, (piece, has_building) in enumerate(pieces):
            if shapely.area(piece) < LOT_AREA_LEAST_M2:
                slivers += 1
                continue
            shapes.append(piece)
            names.append(f"{number + 1}-{place + 1}")
            built.append(has_building)
        report(number + 1, len(blocks))
    found = np.empty(len(shapes), dtype=object)
    found[:] = shapes
    return DerivedLots(found, np.array(names, dtype=object), np.array(built, dtype=bool), len(blocks), slivers)


def find_blocks(lines: Shapes, widths_m: NDArray[np.float64], road_areas: Shapes, buildings: Shapes) -> Shapes:
    """Find the ground that streets enclose, their corridors taken out.

    Buildings outside every closed block stand in blocks of their own, as wide as `EDGE_REACH_M` around them.
    """
    faces = np.empty(0, dtype=object)
    if len(lines):
        network = shapely.union_all(lines)
        faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(network)))
    corridors = shapely.buffer(lines, widths_m / 2, quad_segs=4, cap_style="round")
    solid = np.concatenate((corridors, road_areas))
    open_ground = _ground_outside(faces, buildings)
    # A road drawn as a polygon bounds blocks as its centre line would.
    grounds = _subtract(np.concatenate((faces, open_ground)), solid)
    blocks = shapely.get_parts(grounds[~shapely.is_missing(grounds)])
    blocks = blocks[(shapely.get_type_id(blocks) == shapely.GeometryType.POLYGON) & (shapely.area(blocks) > 0)]
    corners = shapely.bounds(blocks)
    order = np.lexsort((np.round(corners[:, 0], 3), np.round(corners[:, 1], 3)))
    return np.asarray(blocks[order], dtype=object)


def _ground_outside(faces: Shapes, buildings: Shapes) -> Shapes:
    """Return the surroundings of buildings that stand in no closed block."""
    if len(buildings) == 0:
        return np.empty(0, dtype=object)
    loose = np.ones(len(buildings), dtype=bool)
    if len(faces):
        held, _ = shapely.STRtree(faces).query(shapely.point_on_surface(buildings), predicate="intersects")
        loose[held] = False
    around = shapely.union_all(shapely.buffer(buildings[loose], EDGE_REACH_M, quad_segs=4))
    return _subtract(shapely.get_parts(around), faces)


def _subtract(grounds: Shapes, solid: Shapes) -> Shapes:
    """Take the solid shapes out of each ground that they touch."""
    grounds = grounds.copy()
    if len(grounds) == 0 or len(solid) == 0:
        return grounds
    ground, thing = shapely.STRtree(solid).query(grounds, predicate="intersects")
    if len(ground) == 0:
        return grounds
    order = np.argsort(ground, kind="stable")
    ground, thing = ground[order], thing[order]
    rows, starts = np.unique(ground, return_index=True)
    for row, things in zip(rows, np.split(thing, starts[1:]), strict=True):
        grounds[row] = shapely.difference(grounds[row], shapely.union_all(solid[things]))
    return grounds


def _buildings_by_block(blocks: Shapes, buildings: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs (building, block): each building belongs to the block that holds most of it."""
    nothing = np.empty(0, dtype=np.int64)
    if len(blocks) == 0 or len(buildings) == 0:
        return nothing, nothing
    building, block = shapely.STRtree(blocks).query(buildings, predicate="intersects")
    common = shapely.area(shapely.intersection(buildings[building], blocks[block]))
    order = np.lexsort((block, -common, building))
    _, first = np.unique(building[order], return_index=True)
    best = order[first]
    best = best[common[best] > 0]
    return building[best], block[best]


def share_out(block: Any, buildings: Shapes) -> list[tuple[Any, bool]]:
    """Share a block out among its buildings: ground goes to the one whose walls are nearest.

    The borders between buildings, the end of their reach and the block's edge are one network of lines, of which
    the pieces are the meshes: so they meet corner to corner and leave nothing out.

    Returns
    -------
    Pieces of the block, each with whether it bears a building; those without one come last.
    """
    if len(buildings) == 0:
        return [(block, False)]
    # Near the origin, so that the borders are as exact for a city far from it.
    corner = shapely.bounds(block)[:2]
    ground = shapely.transform(block, lambda xy: xy - corner)
    houses = shapely.transform(buildings, lambda xy: xy - corner)
    reach = shapely.union_all(shapely.buffer(houses, REACH_M, quad_segs=4))
    lines = [shapely.boundary(ground), shapely.boundary(reach), *_borders(houses, shapely.bounds(ground))]
    network = shapely.union_all(lines, grid_size=GRID_M)
    meshes = shapely.get_parts(shapely.polygonize(shapely.get_parts(network)))
    middles = shapely.point_on_surface(meshes)
    shapely.prepare(ground)
    shapely.prepare(reach)
    inside = shapely.contains(ground, middles)
    meshes, middles = meshes[inside], middles[inside]
    near = shapely.contains(reach, middles)
    owner = shapely.STRtree(houses).nearest(middles[near])
    pieces = [(shapely.union_all(meshes[near][owner == number]), True) for number in np.unique(owner)]
    pieces += [(part, False) for part in shapely.get_parts(shapely.union_all(meshes[~near]))]
    return [(shapely.transform(piece, lambda xy: xy + corner), built) for piece, built in pieces]


def _borders(buildings: Shapes, bounds: NDArray[np.float64]) -> list[Any]:
    """Return the lines that part the ground nearest to one building from that nearest to another."""
    if len(buildings) == 1:
        return []
    xy, owner = _wall_points(buildings)
    if len(xy) > BLOCK_POINTS_MOST:
        raise LimitError(
            "a block is too large to share out among its buildings",
            found=f"{len(buildings):,} buildings in one block, {len(xy):,} points on their walls",
            expected=f"at most {BLOCK_POINTS_MOST:,} points",
            next_step="give more streets, so that blocks are smaller, or cut the city",
        )
    # Points far around bound the cells of all others.
    middle, span = (bounds[:2] + bounds[2:]) / 2, 20 * (np.ptp(bounds.reshape(2, 2), axis=0).max() + 1)
    far = middle + span * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1), (0, 1.5), (0, -1.5), (1.5, 0), (-1.5, 0)])
    owner = np.concatenate((owner, np.full(len(far), -1)))
    diagram = Voronoi(np.concatenate((xy, far)))
    sides = owner[diagram.ridge_points]
    ends = np.array(diagram.ridge_vertices)
    kept = (sides[:, 0] != sides[:, 1]) & (sides >= 0).all(axis=1) & (ends >= 0).all(axis=1)
    corners = diagram.vertices[ends[kept]]
    # A border between two buildings may run on far outside the block, where nobody needs it.
    low, high = bounds[:2] - REACH_M, bounds[2:] + REACH_M
    close = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    # Chains between meeting points, without the small steps that come from sampling the walls.
    chains = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(corners[close])))
    return list(shapely.simplify(shapely.get_parts(chains), BORDER_TOLERANCE_M, preserve_topology=False))


def _wall_points(buildings: Shapes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Set points along the walls, drawn in a little so that walls two buildings share stay apart.

    Returns
    -------
    (n, 2) positions without doubles, and (n,) the building of each.
    """
    drawn_in = shapely.buffer(buildings, -WALL_INSET_M, join_style="mitre")
    tiny = shapely.is_empty(drawn_in)
    drawn_in[tiny] = shapely.point_on_surface(buildings[tiny])
    walls = drawn_in.copy()
    walls[~tiny] = shapely.boundary(drawn_in[~tiny])
    walls = shapely.segmentize(walls, WALL_STEP_M)
    xy, owner = shapely.get_coordinates(walls, return_index=True)
    _, first = np.unique(np.round(xy, 6), axis=0, return_index=True)
    first.sort()
    return xy[first], owner[first]
