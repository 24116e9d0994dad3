"""Geometries made fit for a city layer; what is left out or repaired is counted."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.notices import Notices

KIND_OF_TYPE = {0: "point", 1: "line", 2: "line", 3: "polygon", 4: "point", 5: "line", 6: "polygon"}
COLLECTION = 7
VERTICES_MANY = 20_000

Shapes = NDArray[Any]


def usable(shapes: Shapes, kinds: Collection[str], names: NDArray[Any], what: str, notices: Notices) -> Shapes:
    """Return valid geometries of the kinds wanted, None for rows that have none.

    Parts of a collection that are of a kind wanted are kept. Broken polygons are repaired so that holes stay holes.

    Parameters
    ----------
    names
        What notices call the rows.
    what
        What they are, in the plural.
    """
    shapes = shapes.copy()
    present = ~(shapely.is_missing(shapes) | shapely.is_empty(shapes))
    empty = ~present & ~shapely.is_missing(shapes)  # the reader has counted those that are missing
    _leave(shapes, empty, "W_EMPTY_SHAPE", f"{what} with an empty geometry, left out", names, notices)
    bounds = shapely.bounds(shapes)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(bounds).all(axis=1))
    # A single bad coordinate hides in the bounds of a shape, which skip it; adding them all up shows it.
    finite[finite] = np.isfinite(_coordinate_sums(shapes[finite]))
    bad = present & ~finite
    _leave(shapes, bad, "W_NOT_FINITE", f"{what} with a coordinate that is no number, left out", names, notices)
    shapes = _of_kinds(shapes, kinds, names, what, notices)
    if "polygon" in kinds:
        shapes = _sound(shapes, names, what, notices)
    return shapes


def _coordinate_sums(shapes: Shapes) -> NDArray[np.float64]:
    xy, owner = shapely.get_coordinates(shapes, return_index=True)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.bincount(owner, weights=xy[:, 0] + xy[:, 1], minlength=len(shapes)).astype(np.float64)


def _leave(
    shapes: Shapes, rows: NDArray[np.bool_], code: str, message: str, names: NDArray[Any], notices: Notices
) -> None:
    shapes[rows] = None
    notices.add(code, message, int(rows.sum()), names[rows][:5])


def _of_kinds(shapes: Shapes, kinds: Collection[str], names: NDArray[Any], what: str, notices: Notices) -> Shapes:
    types = shapely.get_type_id(shapes)
    collected = types == COLLECTION
    for row in np.flatnonzero(collected):
        shapes[row] = _parts_of_kinds(shapes[row], kinds)
    some = collected & ~shapely.is_missing(shapes)
    text = f"{what} given as collections, of which only {' and '.join(kinds)} parts were taken"
    notices.add("W_COLLECTION", text, int(some.sum()), names[some][:5])
    wanted = [kind for kind, name in KIND_OF_TYPE.items() if name in kinds]
    types = shapely.get_type_id(shapes)
    other = (types >= 0) & ~np.isin(types, wanted) | (collected & ~some)
    _leave(shapes, other, "W_OTHER_KIND", f"{what} that are no {' or '.join(kinds)}, left out", names, notices)
    return shapes


def _parts_of_kinds(shape: Any, kinds: Collection[str]) -> Any:
    parts = shapely.get_parts(shape)
    while np.isin(shapely.get_type_id(parts), (4, 5, 6, COLLECTION)).any():
        parts = shapely.get_parts(parts)
    kept = [part for part in parts if KIND_OF_TYPE.get(shapely.get_type_id(part)) in kinds]
    if not kept:
        return None
    by_kind = {KIND_OF_TYPE[shapely.get_type_id(part)] for part in kept}
    if by_kind == {"polygon"}:
        return shapely.multipolygons(kept)
    return shapely.geometrycollections(kept) if len(by_kind) > 1 else shapely.union_all(kept)


def _sound(shapes: Shapes, names: NDArray[Any], what: str, notices: Notices) -> Shapes:
    polygonal = np.isin(shapely.get_type_id(shapes), (3, 6))
    heavy = shapely.get_num_coordinates(shapes) > VERTICES_MANY
    notices.add(
        "W_MANY_VERTICES", f"{what} of more than {VERTICES_MANY:,} vertices", int(heavy.sum()), names[heavy][:5]
    )
    broken = polygonal & ~shapely.is_valid(shapes)
    # The default method would fill holes that share an edge with the outline.
    shapes[broken] = shapely.make_valid(shapes[broken], method="structure", keep_collapsed=False)
    flat = polygonal & ~(shapely.area(shapes) > 0)
    _leave(shapes, flat, "W_NO_AREA", f"{what} that enclose nothing, left out", names, notices)
    repaired = broken & ~flat
    notices.add(
        "W_REPAIRED", f"{what} with crossing or touching rings, repaired", int(repaired.sum()), names[repaired][:5]
    )
    return shapes


def first_of_equal(shapes: Shapes) -> NDArray[np.bool_]:
    """Tell which rows are the first of their geometry, however its rings start or turn; None is never a double."""
    firsts = np.ones(len(shapes), dtype=bool)
    rows = np.flatnonzero(~shapely.is_missing(shapes))
    _, group, sizes = np.unique(shapely.bounds(shapes[rows]), axis=0, return_inverse=True, return_counts=True)
    rows = rows[sizes[group.ravel()] > 1]
    seen: set[bytes] = set()
    for row, text in zip(rows, shapely.to_wkb(shapely.normalize(shapes[rows])), strict=True):
        firsts[row] = text not in seen
        seen.add(text)
    return firsts


def points_along(shape: Any, spacing_m: float) -> NDArray[np.float64]:
    """Set points along the lines of a shape, from end to end, at most about `spacing_m` apart.

    Returns
    -------
    (n, 2) float64; the ends of a row bear a tree, a line shorter than half the spacing bears one in its middle.
    """
    found = [np.empty((0, 2))]
    for line in shapely.get_parts(shapely.line_merge(shape)):
        length = shapely.length(line)
        steps = round(length / spacing_m)
        distances = np.linspace(0.0, length, steps + 1) if steps else np.array([length / 2])
        if shapely.is_closed(line) and steps:
            distances = distances[:-1]
        found.append(shapely.get_coordinates(shapely.line_interpolate_point(line, distances)))
    return np.concatenate(found)
