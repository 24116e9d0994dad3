"""The plan of a city: districts between main roads, a boulevard, a river and a railway.

Districts are the Voronoi cells of jittered seeds; main roads run along their edges. Everything is laid out on a plain
sheet and then bent by a smooth warp, so that no street is quite straight. Coordinates are metres from the city's
centre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Voronoi

Floats = NDArray[np.float64]
Geometries = NDArray[Any]

CENTRE, DENSE, SUBURB, GARDEN, INDUSTRIAL, PARK = range(6)

STREET_WIDTH_M, LANE_WIDTH_M = 7.0, 5.0
COLLECTOR_WIDTH_M, AVENUE_WIDTH_M, BOULEVARD_WIDTH_M = 9.0, 14.0, 22.0
SIDEWALK_M = 4.9
"""From the curb to the lots: a verge with trees and the way for people on foot."""

RAIL_CORRIDOR_M = 9.0
RIVER_FROM_LOTS = 120
"""Cities of fewer lots have neither river nor railway."""

_STEP_M = 30.0
_DISTRICT_MIN_M = 240.0
_WORKS_SHARE = 0.11
_BRIDGE_EVERY_M = 340.0
_DISTRICTS_WITH_PARKS = 30


@dataclass(frozen=True)
class Warp:
    """A smooth displacement of the plane: a few long sine waves, with gradients far below 1, so that nothing folds."""

    waves: Floats  # (waves, 2) radians per metre
    shifts: Floats  # (waves, 2) metres
    phases: Floats  # (waves,)

    def __call__(self, xy: Floats) -> Floats:
        """Move (n, 2) points."""
        return np.asarray(xy + np.sin(xy @ self.waves.T + self.phases) @ self.shifts)


@dataclass(frozen=True)
class MainRoads:
    """Roads that bound districts or cross them."""

    lines: Geometries
    kinds: NDArray[np.object_]
    widths_m: Floats


@dataclass(frozen=True)
class Plan:
    """Districts and what divides them; a district's `region` is where its lots may lie."""

    warp: Warp
    centres: Floats  # (districts, 2) on the plain sheet
    reaches_m: Floats  # (districts,) farthest corner from the centre
    angles_rad: Floats  # (districts,) direction of the longer streets
    edge_offsets_m: Floats  # (districts,) distance of the centre from the main road that the streets run along
    uses: NDArray[np.int64]  # (districts,) CENTRE ... PARK
    cells: Geometries  # (districts,) out to the middle of the main roads
    regions: Geometries
    street_regions: Geometries  # (districts,) where side streets may run
    main_roads: MainRoads
    river: Any  # polygon or None
    river_course: Any  # line or None
    river_half_width_m: float
    railway: Any  # line or None


def make_plan(lot_count: int, radius_m: float, rng: np.random.Generator) -> Plan:
    """Lay out a city of a given radius.

    Parameters
    ----------
    lot_count
        Lots the city shall have: larger cities have larger districts.
    radius_m
        Radius of the built-up area.
    rng
        Stream of all chance in the plan.
    """
    district_count = max(1.0, lot_count**0.8 / 16)
    spacing_m = max(radius_m * math.sqrt(math.pi / district_count / (math.sqrt(3) / 2)), _DISTRICT_MIN_M)
    warp = _draw_warp(min(max(radius_m, 350.0), 2500.0), rng)
    seeds = _draw_seeds(radius_m, spacing_m, rng)
    voronoi = Voronoi(seeds)
    wet = lot_count >= RIVER_FROM_LOTS
    half_width_m = float(np.clip(6 + 0.012 * radius_m, 9, 60))
    direction = rng.uniform(0, 2 * math.pi)
    river_course = _course(radius_m, direction, 0.52, 0.10, warp, rng) if wet else None
    railway = _course(radius_m, direction + rng.uniform(0.75, 1.3) * math.pi, 0.6, 0.03, warp, rng) if wet else None
    river = river_course.buffer(half_width_m, quad_segs=4) if river_course is not None else None
    boulevards = _boulevards(lot_count, radius_m, warp, rng)

    members = [d for d in range(len(seeds)) if _inside(voronoi, d, radius_m + 0.8 * spacing_m)]
    ridges, ridge_lines, avenue = _ridges(voronoi, warp, rng)
    main_roads = _main_roads(ridge_lines, avenue, boulevards, river_course, half_width_m)
    cells, outlines = [], []
    for district in members:
        outline = voronoi.vertices[voronoi.regions[voronoi.point_region[district]]]
        outlines.append(outline)
        cells.append(shapely.transform(shapely.segmentize(shapely.Polygon(outline), _STEP_M), warp))
    cell_array = np.array(cells, dtype=object)
    own_ridges = _ridges_of(members, ridges)
    centres = seeds[members]
    obstacles, street_obstacles = _linear_obstacles(boulevards, river_course, half_width_m, railway)
    regions = np.array(
        [
            _cut(
                cell.buffer(-(COLLECTOR_WIDTH_M / 2 + SIDEWALK_M)),
                [ridge_lines[r].buffer(AVENUE_WIDTH_M / 2 + SIDEWALK_M, quad_segs=2) for r in own if avenue[r]],
                obstacles,
            )
            for cell, own in zip(cells, own_ridges, strict=True)
        ],
        dtype=object,
    )
    street_regions = np.array([_cut(cell, [], street_obstacles) for cell in cells], dtype=object)
    angles, offsets = _orientations(outlines, centres, rng)
    railway_distance = shapely.distance(shapely.points(warp(centres)), railway) if railway is not None else None
    return Plan(
        warp=warp,
        centres=centres,
        reaches_m=np.array([np.hypot(*(o - c).T).max() for o, c in zip(outlines, centres, strict=True)]),
        angles_rad=angles,
        edge_offsets_m=offsets,
        uses=_district_uses(centres, radius_m, railway_distance, lot_count, rng),
        cells=cell_array,
        regions=regions,
        street_regions=street_regions,
        main_roads=main_roads,
        river=river,
        river_course=river_course,
        river_half_width_m=half_width_m,
        railway=railway,
    )


def _draw_warp(scale_m: float, rng: np.random.Generator) -> Warp:
    lengths_m = scale_m * np.array([1.1, 1.7, 2.6, 4.0])
    directions = rng.uniform(0, 2 * np.pi, 4)
    waves = (2 * np.pi / lengths_m)[:, None] * np.column_stack((np.cos(directions), np.sin(directions)))
    towards = rng.uniform(0, 2 * np.pi, 4)
    shifts = (0.055 * lengths_m / (2 * np.pi))[:, None] * np.column_stack((np.cos(towards), np.sin(towards)))
    return Warp(waves, shifts, rng.uniform(0, 2 * np.pi, 4))


def _draw_seeds(radius_m: float, spacing_m: float, rng: np.random.Generator) -> Floats:
    """Draw jittered points of a triangular lattice, the first of them the centre, ordered outwards."""
    reach = radius_m + 3 * spacing_m
    row_m = spacing_m * math.sqrt(3) / 2
    rows = np.arange(-math.ceil(reach / row_m), math.ceil(reach / row_m) + 1)
    columns = np.arange(-math.ceil(reach / spacing_m), math.ceil(reach / spacing_m) + 1)
    row, column = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    lattice = np.column_stack(((column + 0.5 * (row % 2)) * spacing_m, row * row_m))
    lattice += rng.uniform(-0.32, 0.32, lattice.shape) * spacing_m
    lattice -= lattice[np.argmin(np.hypot(*lattice.T))]
    distance = np.hypot(*lattice.T)
    near = distance <= reach
    return np.asarray(lattice[near][np.argsort(distance[near], kind="stable")])


def _inside(voronoi: Voronoi, district: int, reach_m: float) -> bool:
    region = voronoi.regions[voronoi.point_region[district]]
    return -1 not in region and len(region) > 2 and bool(np.hypot(*voronoi.points[district]) <= reach_m)


def _course(
    radius_m: float, direction: float, offset: float, meander: float, warp: Warp, rng: np.random.Generator
) -> Any:
    """Draw a winding line across the city, `offset` radii from its centre."""
    along = np.arange(-1.6 * radius_m, 1.6 * radius_m + 40, 40.0)
    phases = rng.uniform(0, 2 * np.pi, 2)
    lengths_m = radius_m * rng.uniform([1.2, 0.6], [2.0, 0.9])
    side = offset * radius_m + meander * radius_m * (
        np.sin(2 * np.pi * along / lengths_m[0] + phases[0])
        + 0.3 * np.sin(2 * np.pi * along / lengths_m[1] + phases[1])
    )
    cos, sin = math.cos(direction), math.sin(direction)
    xy = np.column_stack((along * cos - side * sin, along * sin + side * cos))
    return shapely.LineString(warp(xy))


def _boulevards(lot_count: int, radius_m: float, warp: Warp, rng: np.random.Generator) -> Geometries:
    count = 0 if lot_count < 60 else 1 if lot_count < 20_000 else 3
    start = rng.uniform(0, np.pi)
    lines = []
    for number in range(count):
        angle = start + number * np.pi / 3 + rng.uniform(-0.2, 0.2)
        along = np.arange(-1.5 * radius_m, 1.5 * radius_m + _STEP_M, _STEP_M)
        shift = rng.uniform(-0.12, 0.12) * radius_m
        xy = np.column_stack((along * math.cos(angle), along * math.sin(angle)))
        xy += shift * np.array([-math.sin(angle), math.cos(angle)])
        lines.append(shapely.LineString(warp(xy)))
    return np.array(lines, dtype=object)


def _ridges(
    voronoi: Voronoi, warp: Warp, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Geometries, NDArray[np.bool_]]:
    """Return the pairs of districts that share an edge, the edges as bent lines, and which of them are avenues."""
    ends = np.array(voronoi.ridge_vertices)
    finite = (ends >= 0).all(axis=1)
    lines = shapely.linestrings(voronoi.vertices[ends[finite]])
    bent = shapely.transform(shapely.segmentize(lines, _STEP_M), warp)
    return voronoi.ridge_points[finite], bent, rng.random(len(bent)) < 0.35


def _ridges_of(members: list[int], ridges: NDArray[np.int64]) -> list[list[int]]:
    place = {district: number for number, district in enumerate(members)}
    own: list[list[int]] = [[] for _ in members]
    for number, pair in enumerate(ridges.tolist()):
        for district in pair:
            if district in place:
                own[place[district]].append(number)
    return own


def _main_roads(
    ridge_lines: Geometries,
    avenue: NDArray[np.bool_],
    boulevards: Geometries,
    river_course: Any,
    half_width_m: float,
) -> MainRoads:
    lines = [*ridge_lines, *boulevards]
    kinds = [*np.where(avenue, "avenue", "collector"), *["boulevard"] * len(boulevards)]
    widths = [*np.where(avenue, AVENUE_WIDTH_M, COLLECTOR_WIDTH_M), *[BOULEVARD_WIDTH_M] * len(boulevards)]
    if river_course is not None:
        offset_m = _quay_offset_m(half_width_m)
        bridges = _bridges(river_course, offset_m)
        lines += [shapely.offset_curve(river_course, side * offset_m, join_style="round") for side in (1, -1)]
        lines += bridges
        kinds += ["quay"] * 2 + ["bridge"] * len(bridges)
        widths += [STREET_WIDTH_M] * 2 + [COLLECTOR_WIDTH_M] * len(bridges)
    return MainRoads(np.array(lines, dtype=object), np.array(kinds, dtype=object), np.array(widths, dtype=np.float64))


def _quay_offset_m(half_width_m: float) -> float:
    return half_width_m + 1.0 + STREET_WIDTH_M / 2 + SIDEWALK_M


def _bridges(river_course: Any, offset_m: float) -> list[Any]:
    """Return straight lines from quay to quay, every few hundred metres."""
    at = np.arange(_BRIDGE_EVERY_M / 3, river_course.length - 5.0, _BRIDGE_EVERY_M)
    here = shapely.get_coordinates(shapely.line_interpolate_point(river_course, at))
    direction = shapely.get_coordinates(shapely.line_interpolate_point(river_course, at + 2.0)) - here
    normal = np.column_stack((-direction[:, 1], direction[:, 0])) / np.hypot(*direction.T)[:, None]
    return [shapely.LineString(ends) for ends in np.stack((here - offset_m * normal, here + offset_m * normal), axis=1)]


def _linear_obstacles(
    boulevards: Geometries, river_course: Any, half_width_m: float, railway: Any
) -> tuple[list[Any], list[Any]]:
    """Return what lots keep out of, and what side streets keep out of."""
    lots = [line.buffer(BOULEVARD_WIDTH_M / 2 + SIDEWALK_M + 1.5, quad_segs=2) for line in boulevards]
    streets = []
    if river_course is not None:
        bank_m = _quay_offset_m(half_width_m)
        lots.append(river_course.buffer(bank_m + STREET_WIDTH_M / 2 + SIDEWALK_M, quad_segs=4))
        streets.append(river_course.buffer(bank_m, quad_segs=4))
    if railway is not None:
        lots.append(railway.buffer(RAIL_CORRIDOR_M, quad_segs=2))
        streets.append(railway.buffer(RAIL_CORRIDOR_M + 2, quad_segs=2))
    for obstacle in (*lots, *streets):
        shapely.prepare(obstacle)
    return lots, streets


def _cut(ground: Any, own: list[Any], shared: list[Any]) -> Any:
    parts = own + [obstacle for obstacle in shared if obstacle.intersects(ground)]
    return shapely.difference(ground, shapely.union_all(parts)) if parts else ground


def _orientations(outlines: list[Floats], centres: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Let most districts' streets run along their longest edge, and the rest as they like."""
    angles, offsets = np.zeros(len(outlines)), np.zeros(len(outlines))
    for number, (outline, centre) in enumerate(zip(outlines, centres, strict=True)):
        edges = np.roll(outline, -1, axis=0) - outline
        longest = int(np.argmax(np.hypot(*edges.T)))
        angle = math.atan2(edges[longest, 1], edges[longest, 0])
        normal = np.array([-math.sin(angle), math.cos(angle)])
        offset = float(normal @ (outline[longest] - centre))
        own_way = rng.random() < 0.2
        angles[number] = rng.uniform(0, np.pi) if own_way else angle
        offsets[number] = rng.uniform(-60, 60) if own_way else offset
    return angles, offsets


def _district_uses(
    centres: Floats,
    radius_m: float,
    railway_distance_m: Floats | None,
    lot_count: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Give each district its character: shops in the middle, works along the railway, houses farther out."""
    count = len(centres)
    share = np.hypot(*centres.T) / max(radius_m, 1.0)
    chance = rng.random(count)
    uses = np.where(chance < np.clip(0.95 - 1.25 * share, 0.08, 0.9), DENSE, SUBURB)
    uses[(uses == SUBURB) & (rng.random(count) < np.clip(1.1 * share - 0.25, 0, 0.6))] = GARDEN
    uses[(share < 0.36) & (rng.random(count) < 0.8)] = CENTRE
    if railway_distance_m is not None:
        far = np.where((share > 0.2) & (share < 0.95), railway_distance_m, np.inf)
        works = np.argsort(far, kind="stable")[: max(1, round(_WORKS_SHARE * int((share < 1).sum())))]
        uses[works[np.isfinite(far[works])]] = INDUSTRIAL
        uses[(share > 0.5) & (rng.random(count) < 0.03) & (count >= _DISTRICTS_WITH_PARKS)] = INDUSTRIAL
    uses[0] = CENTRE if lot_count >= RIVER_FROM_LOTS else SUBURB
    if count >= _DISTRICTS_WITH_PARKS:
        green = (share > 0.15) & (uses != INDUSTRIAL) & (rng.random(count) < 0.025)
        green[np.argmin(np.abs(share - 0.35))] = True
        uses[green] = PARK
    return uses
