"""Lots as they come, made fit for work: what cannot be used is named, what is repaired is counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Geod
from pyproj.exceptions import ProjError

from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.core.notices import Notices

VERTEX_CAP = 20_000
VERTEX_LIMIT = 2_000_000
EXTENT_LIMIT_M = 500_000.0
STRAY_LIMIT_M = 500_000.0
FIRST_TOLERANCE_M = 0.02
LAST_TOLERANCE_M = 5.0
SAME_AREA = 1e-6

POINT_OR_LINE = (0, 1, 2, 4, 5)
COLLECTION = 7

Shapes = NDArray[Any]
Names = Sequence[str] | NDArray[Any]


@dataclass
class Checked:
    """Shapes fit for work, None where there is none, and for those a reason and a detail."""

    shapes: Shapes
    reasons: NDArray[Any]
    details: NDArray[Any]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Tell which rows have a shape."""
        return np.asarray(~shapely.is_missing(self.shapes))

    def drop(self, rows: NDArray[np.bool_], reason: str, detail: str) -> None:
        """Take the shape from rows and say why."""
        self.shapes[rows] = None
        self.reasons[rows] = reason
        self.details[rows] = detail


def first_look(
    shapes: Shapes, names: Names, notices: Notices, *, what: str = "lots", note_missing: bool = True
) -> Checked:
    """Check shapes before any of them meets the geometry engine, which throws on coordinates that are no numbers.

    Heights are dropped, of collections the polygons are kept, and points and lines are refused.

    Parameters
    ----------
    shapes
        (n,) geometries in the CRS of their file.
    names
        (n,) names for messages.
    note_missing
        Count shapes that are None; whoever read the file may have done so.

    Raises
    ------
    LimitError
        A shape has more than two million vertices.
    """
    labels = np.asarray(names, dtype=object)
    counts = shapely.get_num_coordinates(shapes)
    _refuse_huge(counts, labels, what)
    flat = flat_copy(shapes)
    checked = Checked(flat, np.full(len(flat), "", object), np.full(len(flat), "", object))
    empty = shapely.is_empty(checked.shapes)
    missing = shapely.is_missing(checked.shapes)
    checked.drop(missing | empty, "no_geometry", "no geometry, or an empty one")
    noted = (missing | empty) if note_missing else empty
    notices.add("W_NO_GEOMETRY", f"{what} without a geometry", int(noted.sum()), labels[noted])

    kinds = shapely.get_type_id(checked.shapes)
    mixed = kinds == COLLECTION
    for row in np.flatnonzero(mixed):
        checked.shapes[row] = polygons_of(checked.shapes[row])
    notices.add("W_COLLECTION", f"{what} with mixed geometry, polygons kept", int(mixed.sum()), labels[mixed])
    other = np.isin(kinds, POINT_OR_LINE) | (mixed & shapely.is_missing(checked.shapes))
    checked.drop(other, "not_polygon", "a point or a line, no polygon")
    notices.add("W_NOT_POLYGON", f"{what} that are no polygons", int(other.sum()), labels[other])

    broken = ~finite(checked.shapes)
    checked.drop(broken, "not_finite", "a coordinate is not a number or infinite")
    notices.add("W_NOT_FINITE", f"{what} with a coordinate that is no number", int(broken.sum()), labels[broken])
    return checked


def flat_copy(shapes: Shapes) -> Shapes:
    """Return a copy of an array whose shapes have no heights."""
    flat: Shapes = np.array(shapes, dtype=object)
    high = shapely.has_z(flat)
    flat[high] = shapely.force_2d(flat[high])
    return flat


def _refuse_huge(counts: NDArray[np.integer], labels: NDArray[Any], what: str) -> None:
    if counts.size and counts.max() > VERTEX_LIMIT:
        worst = int(counts.argmax())
        raise LimitError(
            f"one of the {what} has too many vertices",
            where=labels[worst],
            found=f"{counts[worst]:,} vertices",
            expected=f"at most {VERTEX_LIMIT:,}",
            next_step="simplify or split it",
        )


def polygons_of(collection: Any) -> Any:
    """Return the polygons of a collection as one shape, None where it has none."""
    parts: list[Any] = []
    waiting = [collection]
    while waiting:
        shape = waiting.pop()
        if shape.geom_type == "Polygon":
            parts.append(shape)
        elif shape.geom_type in ("MultiPolygon", "GeometryCollection"):
            waiting.extend(shapely.get_parts(shape)[::-1])
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else shapely.multipolygons(parts)


def finite(shapes: Shapes) -> NDArray[np.bool_]:
    """Tell which shapes have numbers for all coordinates; a missing shape has."""
    result = np.ones(len(shapes), dtype=bool)
    xy, owner = shapely.get_coordinates(shapes, return_index=True)
    result[np.unique(owner[~np.isfinite(xy).all(axis=1)])] = False
    return result


def unwrap_longitudes(shapes: Shapes, names: Names, notices: Notices) -> tuple[Shapes, bool]:
    """Shift western longitudes by 360 degrees where lots lie on both sides of the antimeridian.

    Parameters
    ----------
    shapes
        (n,) geometries in degrees, None for none.

    Returns
    -------
    The shapes, and whether they were shifted; if so, every other layer in degrees needs `shift_west` too.
    """
    bounds = shapely.bounds(shapes)
    with np.errstate(invalid="ignore"):
        wide = (bounds[:, 2] - bounds[:, 0] > 180) & (bounds[:, 0] >= -180) & (bounds[:, 2] <= 180)
    middles = (bounds[:, 0] + bounds[:, 2]) / 2
    middles = middles[np.isfinite(middles) & ~wide & (np.abs(middles) <= 180)]
    straddle = False
    if middles.size:
        shifted = np.where(middles < 0, middles + 360, middles)
        straddle = bool(np.ptp(middles) > 180 and np.ptp(shifted) < 180)
    if not (wide.any() or straddle):
        return shapes, False
    labels = np.asarray(names, dtype=object)
    notices.add("W_ANTIMERIDIAN", "lots across the antimeridian, joined", int(wide.sum()), labels[wide])
    return shift_west(shapes), True


def shift_west(shapes: Shapes) -> Shapes:
    """Add 360 degrees to longitudes below zero."""

    def move(xy: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack((np.where(xy[:, 0] < 0, xy[:, 0] + 360, xy[:, 0]), xy[:, 1]))

    return np.asarray(shapely.transform(shapes, move))


def repair(checked: Checked, names: Names, notices: Notices, *, what: str = "lots") -> None:
    """Make polygons in metres valid and bounded in vertices; name those that enclose nothing.

    Invalid polygons are rebuilt from their rings as areas: holes are subtracted and overlapping parts united, so a
    hole that covers its lot leaves nothing (GEOS' ``structure`` method; the older one would fill it).

    Raises
    ------
    LimitError
        All shapes are longer than 500 km.
    """
    labels = np.asarray(names, dtype=object)
    broken = ~finite(checked.shapes)
    checked.drop(broken, "not_finite", "a coordinate has no place in the CRS in metres")
    notices.add("W_NOT_FINITE", f"{what} with a coordinate that is no number", int(broken.sum()), labels[broken])
    _drop_wide(checked, labels, notices, what)

    for row in np.flatnonzero(shapely.get_num_coordinates(checked.shapes) > VERTEX_CAP):
        before = int(shapely.get_num_coordinates(checked.shapes[row]))
        checked.shapes[row] = thin_out(checked.shapes[row])
        after = int(shapely.get_num_coordinates(checked.shapes[row]))
        if after < before:
            notices.add("W_SIMPLIFIED", f"{what} simplified for their number of vertices", 1, [labels[row]])

    rows = np.flatnonzero(checked.usable)
    bad = rows[~shapely.is_valid(checked.shapes[rows])]
    if bad.size:
        causes = [str(reason).split("[")[0] for reason in shapely.is_valid_reason(checked.shapes[bad])]
        checked.shapes[bad] = sound(checked.shapes[bad])
    areas = shapely.area(checked.shapes)
    with np.errstate(invalid="ignore"):
        flat = checked.usable & ~(areas > 0)
    checked.drop(flat, "no_area", "the polygon encloses nothing")
    notices.add("W_NO_AREA", f"{what} that enclose nothing", int(flat.sum()), labels[flat])
    for row, cause in zip(bad, causes if bad.size else [], strict=True):
        if not flat[row]:
            notices.add("W_REPAIRED", f"{what} with broken geometry, repaired", 1, [f"{labels[row]} ({cause})"])


def drop_strays(checked: Checked, crs: CRS, names: Names, notices: Notices, *, what: str = "lots") -> None:
    """Take out shapes that have no place on Earth in their CRS, or lie more than 500 km from the middle one.

    If that were most of them, they are left alone: then it is the CRS that is wrong, which `working_crs` says.
    """
    rows = np.flatnonzero(checked.usable)
    if not rows.size:
        return
    bounds = shapely.bounds(checked.shapes[rows])
    try:
        change = transformer(crs.to_wkt(), "EPSG:4326")
    except ProjError:  # no way from this CRS to the Earth: `working_crs` says so
        return
    x, y = (bounds[:, 0] + bounds[:, 2]) / 2, (bounds[:, 1] + bounds[:, 3]) / 2
    longitude, latitude = (np.asarray(values) for values in change.transform(x, y))
    known = np.isfinite(longitude) & np.isfinite(latitude) & (np.abs(latitude) <= 90)
    if known.sum() * 2 <= rows.size:
        return
    middle = tuple(np.sort(values[known])[known.sum() // 2] for values in (longitude, latitude))
    far = ~known
    east = np.full(known.sum(), middle[0])
    north = np.full(known.sum(), middle[1])
    far[known] = Geod(ellps="WGS84").inv(longitude[known], latitude[known], east, north)[2] > STRAY_LIMIT_M
    if far.sum() * 2 > rows.size:
        return
    stray = np.zeros(len(checked.shapes), dtype=bool)
    stray[rows[far]] = True
    checked.drop(stray, "misplaced", "outside the area of its CRS, or more than 500 km from the others")
    notices.add("W_MISPLACED", f"{what} far from all others", int(stray.sum()), np.asarray(names, object)[stray])


def sound(shapes: Shapes) -> Shapes:
    """Return broken polygons rebuilt as areas; holes that lie outside their shell are no part of them."""
    parts, owner = shapely.get_parts(shapes, return_index=True)
    for row in np.flatnonzero(shapely.get_num_interior_rings(parts) > 0):
        shell = shapely.polygons(shapely.get_exterior_ring(parts[row]))
        rings = shapely.get_rings(parts[row])[1:]
        stray = ~shapely.intersects(sound_parts(shell), shapely.polygons(rings))
        if stray.any():
            parts[row] = shapely.polygons(shapely.get_exterior_ring(parts[row]), rings[~stray])
    joined = shapely.multipolygons(parts, indices=owner)
    result: Shapes = np.asarray(sound_parts(joined), dtype=object)
    return result


def sound_parts(shapes: Any) -> Any:
    """Return `shapely.make_valid` by areas, without what collapses to a line."""
    return shapely.make_valid(shapes, method="structure", keep_collapsed=False)


def _drop_wide(checked: Checked, labels: NDArray[Any], notices: Notices, what: str) -> None:
    """Take out shapes longer than 500 km; if nothing but such shapes is there, refuse them."""
    bounds = shapely.bounds(checked.shapes)
    extent = np.nan_to_num(np.fmax(bounds[:, 2] - bounds[:, 0], bounds[:, 3] - bounds[:, 1]))
    wide = checked.usable & (extent > EXTENT_LIMIT_M)
    if not wide.any():
        return
    if wide.sum() == checked.usable.sum():
        worst = int(extent.argmax())
        raise LimitError(
            f"the {what} are too large",
            where=labels[worst],
            found=f"{extent[worst] / 1000:,.0f} km from side to side",
            expected=f"at most {EXTENT_LIMIT_M / 1000:,.0f} km",
            next_step="split them, or check their CRS",
        )
    checked.drop(wide, "too_large", "longer than 500 km")
    notices.add("W_TOO_LARGE", f"{what} longer than 500 km, left out", int(wide.sum()), labels[wide])


def thin_out(shape: Any) -> Any:
    """Drop vertices until at most the cap is left, from a tolerance of 2 cm up, never beyond 5 m.

    Rings stay rings and do not cross. A shape of very many small rings may stay above the cap.
    """
    tolerance = FIRST_TOLERANCE_M
    while tolerance <= LAST_TOLERANCE_M:
        simple = shapely.simplify(shape, tolerance, preserve_topology=True)
        if shapely.get_num_coordinates(simple) <= VERTEX_CAP:
            return simple
        tolerance *= 4
        shape = simple
    return shape


def twins(shapes: Shapes, ids: NDArray[Any]) -> NDArray[np.int64]:
    """Return for each shape the row whose equal it is, -1 for the first of its kind by id and for all others."""
    result = np.full(len(shapes), -1, dtype=np.int64)
    rows = np.flatnonzero(~shapely.is_missing(shapes))
    _, group, sizes = np.unique(shapely.bounds(shapes[rows]), axis=0, return_inverse=True, return_counts=True)
    candidates = rows[sizes[group.ravel()] > 1]
    if not candidates.size:
        return result
    texts = shapely.to_wkb(shapely.normalize(shapes[candidates]))
    first: dict[bytes, int] = {}
    for row, text in sorted(zip(candidates, texts, strict=True), key=lambda pair: id_order(ids[pair[0]])):
        result[row] = first.setdefault(text, row)
    result[result == np.arange(len(result))] = -1
    return result


def id_order(lot_id: str) -> tuple[int, int, str]:
    """Return a sort key that puts whole numbers in their order and before texts."""
    return (0, int(lot_id), lot_id) if lot_id.isascii() and lot_id.isdigit() else (1, 0, lot_id)


def overlaps(shapes: Shapes, ids: NDArray[Any], *, least_m2: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find pairs of lots that claim the same ground.

    Lots that fit together edge to edge are ruled out as a coverage; of the others, pairs are compared. An overlap
    counts from `least_m2`, or from 1 % of the smaller lot.

    Returns
    -------
    Rows of the lots that give way, and rows of those they give way to: the smaller lot keeps the ground, of equal
    lots the one whose id comes first.
    """
    nothing = np.empty(0, np.int64)
    rows = np.flatnonzero(~shapely.is_missing(shapes))
    if rows.size < 2:
        return nothing, nothing
    edges = shapely.coverage_invalid_edges(shapes[rows])
    odd = rows[~(shapely.is_missing(edges) | shapely.is_empty(edges))]
    if not odd.size:
        return nothing, nothing
    # Of a lot inside another only the inner one has an edge where none should be.
    one, other = shapely.STRtree(shapes[rows]).query(shapes[odd])
    one, other = odd[one], rows[other]
    pairs = np.unique(np.sort(np.column_stack((one, other))[one != other], axis=1), axis=0)
    one, other = pairs[:, 0], pairs[:, 1]
    common = _common_area(shapes[one], shapes[other])
    areas = shapely.area(shapes)
    smaller = np.minimum(areas[one], areas[other])
    real = (common >= least_m2) | (common >= 0.01 * smaller)
    one, other = one[real], other[real]
    equal = np.abs(areas[one] - areas[other]) <= SAME_AREA * areas[one]
    earlier = np.array([id_order(ids[a]) < id_order(ids[b]) for a, b in zip(one, other, strict=True)], dtype=bool)
    first_wins = np.where(equal, earlier, areas[one] < areas[other])
    return np.where(first_wins, other, one), np.where(first_wins, one, other)


def _common_area(one: Shapes, other: Shapes) -> NDArray[np.float64]:
    near = np.flatnonzero(shapely.intersects(one, other) & ~shapely.touches(one, other))
    common = np.zeros(len(one))
    common[near] = shapely.area(shapely.intersection(one[near], other[near]))
    return common
