"""Lots less what lies near them, by the exact kernel; what it gives back undone goes through overlays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.register.envelope_kernel import DONE, lots_less_envelopes
from urbanforest_cli.register.envelopes import ARC_EXCESS_M, drop_small, keep_parts, outer_buffer, subtract

COMPACT_SHARE = 0.2
"""A lot that fills less of its bounds has many things in them that are not near."""
OWN_SHARE = 0.01
"""A building belongs to every lot that holds at least this share of it; a party wall on the line makes no owner."""

Shapes = NDArray[Any]


class Near:
    """Polygons, or points, of one clearance and their index.

    Parameters
    ----------
    things
        Polygons, or points.
    only_own
        Of these a lot keeps off its own alone: those of which it holds some share.
    """

    def __init__(self, things: Shapes, distance_m: float, *, only_own: bool = False) -> None:
        whole = np.isin(shapely.get_type_id(things), (0, 3)).all()
        self.things = np.asarray(things if whole else shapely.get_parts(things), dtype=object)
        self.distance_m = distance_m
        self.only_own = only_own
        self.tree = shapely.STRtree(self.things)

    def candidates(self, lots: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return lots and things that may be near each other: by their bounds, unless the lot is long and thin."""
        if self.only_own:
            return self.pairs(lots)
        bounds = shapely.bounds(lots)
        compact = shapely.area(lots) > COMPACT_SHARE * (bounds[:, 2] - bounds[:, 0]) * (bounds[:, 3] - bounds[:, 1])
        slim, wide = np.flatnonzero(~compact), np.flatnonzero(compact)
        far = self.distance_m
        boxes = shapely.box(*(bounds[wide] + [-far, -far, far, far]).T)
        row, thing = self.tree.query(boxes)
        slim_row, slim_thing = self.pairs(lots[slim])
        return np.concatenate((wide[row], slim[slim_row])), np.concatenate((thing, slim_thing))

    def pairs(self, lots: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return lots and things that are near each other, sorted by both."""
        if self.distance_m > 0:
            row, thing = self.tree.query(lots, predicate="dwithin", distance=self.distance_m)
        else:
            row, thing = self.tree.query(lots, predicate="intersects")
        if self.only_own:
            mine = shapely.area(shapely.intersection(self.things[thing], lots[row]))
            own = mine > OWN_SHARE * shapely.area(self.things[thing])
            row, thing = row[own], thing[own]
        order = np.lexsort((thing, row))
        return row[order], thing[order]

    def around(self, lots: Shapes) -> tuple[NDArray[np.int64], Shapes]:
        """Return the rows of lots that have some of the things near, and for each one envelope around all of those."""
        row, thing = self.pairs(lots)
        rows, place = np.unique(row, return_inverse=True)
        if not len(rows):
            return rows, np.empty(0, dtype=object)
        joined = np.asarray(shapely.geometrycollections(self.things[thing], indices=place), dtype=object)
        if self.distance_m == 0:
            return rows, np.asarray(shapely.union_all(joined[:, None], axis=1), dtype=object)
        return rows, outer_buffer(joined, self.distance_m)


class NearThings:
    """Things of several clearances, all at once.

    Parameters
    ----------
    polygons, points
        Of which things are polygons, and which points.
    """

    def __init__(self, polygons: Sequence[Near], points: Sequence[Near] = ()) -> None:
        self.near = [*polygons, *points]
        areas = np.concatenate([near.things for near in polygons])
        places = np.concatenate([np.empty(0, dtype=object), *(near.things for near in points)])
        self.things = with_points(flat_of(areas), places)
        self.clearance_m = np.concatenate([np.full(len(near.things), near.distance_m) for near in self.near])

    def leave(self, lots: Shapes, least_m2: float) -> tuple[Shapes, NDArray[np.int64]]:
        """Return what they leave of lots.

        Returns
        -------
        The areas, None where nothing of `least_m2` is left, and how many smaller pieces were dropped from each.
        """
        row, thing = self._candidates(lots)
        some, place = np.unique(row, return_inverse=True)
        areas: Shapes = np.array(lots, dtype=object)
        dropped = np.zeros(len(lots), dtype=np.int64)
        parts, owner, done = exactly(lots[some], self.things, self.clearance_m, place, thing)
        areas[some[done]], dropped[some[done]] = keep_parts(
            parts, np.searchsorted(np.flatnonzero(done), owner), int(done.sum()), least_m2
        )
        undone = some[~done]
        left = areas[undone]
        for near in self.near:
            left = subtract(left, *near.around(left))
        areas[undone] = left
        rest = np.setdiff1d(np.arange(len(lots)), some[done])
        areas[rest], dropped[rest] = drop_small(areas[rest], least_m2)
        return areas, dropped

    def _candidates(self, lots: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows, things = [], []
        first = 0
        for near in self.near:
            row, thing = near.candidates(lots)
            rows.append(row)
            things.append(thing + first)
            first += len(near.things)
        row, thing = np.concatenate(rows), np.concatenate(things)
        order = np.lexsort((thing, row))
        return row[order], thing[order]


@dataclass(frozen=True)
class Flat:
    """Polygons and points as arrays: positions of rings, inside on the left; where rings and shapes begin; bounds."""

    xy: NDArray[np.float64]
    rings: NDArray[np.int64]
    offsets: NDArray[np.int64]
    boxes: NDArray[np.float64]


def flat_of(polygons: Shapes) -> Flat:
    """Return polygons as arrays."""
    if not len(polygons):
        return Flat(np.empty((0, 2)), np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty((0, 4)))
    kind, xy, starts = shapely.to_ragged_array(polygons, include_z=False)
    rings, parts = (np.asarray(values, dtype=np.int64) for values in starts[:2])
    offsets = parts[starts[2]] if kind == shapely.GeometryType.MULTIPOLYGON else parts
    outer = np.zeros(len(rings) - 1, dtype=bool)
    outer[parts[:-1]] = True
    ring = np.repeat(np.arange(len(outer)), np.diff(rings))
    local = xy - xy[rings[:-1]][ring]
    cross = np.append(local[:-1, 0] * local[1:, 1] - local[1:, 0] * local[:-1, 1], 0.0)
    backward = (np.add.reduceat(cross, rings[:-1]) > 0) != outer
    here = np.arange(len(xy))
    xy = xy[np.where(backward[ring], (rings[:-1] + rings[1:] - 1)[ring] - here, here)]
    return Flat(xy, rings, offsets, shapely.bounds(polygons))


def with_points(polygons: Flat, points: Shapes) -> Flat:
    """Return polygons followed by points, each a ring of one position."""
    count = np.arange(1, len(points) + 1)
    return Flat(
        np.concatenate((polygons.xy, shapely.get_coordinates(points))),
        np.concatenate((polygons.rings, polygons.rings[-1] + count)),
        np.concatenate((polygons.offsets, polygons.offsets[-1] + count)),
        np.concatenate((polygons.boxes, shapely.bounds(points).reshape(-1, 4))),
    )


def exactly(
    lots: Shapes,
    things: Flat,
    clearance_m: NDArray[np.float64],
    row: NDArray[np.integer],
    thing: NDArray[np.integer],
) -> tuple[Shapes, NDArray[np.int64], NDArray[np.bool_]]:
    """Return lots less the envelopes of the things paired with them.

    Returns
    -------
    The pieces that are left, the lot of each, and which of the lots that worked for.
    """
    flat = flat_of(lots)
    offsets = np.searchsorted(row, np.arange(len(lots) + 1))
    xy, rings, shell, lot, status = lots_less_envelopes(
        flat.xy, flat.rings, flat.offsets, things.xy, things.rings, things.offsets, things.boxes, clearance_m,
        offsets, np.ascontiguousarray(thing), ARC_EXCESS_M,
    )  # fmt: skip
    done = status == DONE
    if not len(shell):
        return np.empty(0, dtype=object), np.empty(0, dtype=np.int64), done
    shells = np.flatnonzero(shell == np.arange(len(shell)))
    order = np.argsort(shell, kind="stable")
    order = order[np.lexsort((order != shell[order], shell[order]))]
    size = np.diff(rings)[order]
    ends = np.cumsum(size)
    xy = xy[np.arange(len(xy)) + np.repeat(rings[order] - (ends - size), size)]
    firsts = np.append(np.searchsorted(shell[order], shells), len(shell))
    parts = shapely.from_ragged_array(shapely.GeometryType.POLYGON, xy, (np.append(0, ends), firsts))
    owner = lot[shells]
    done[owner[~shapely.is_valid(parts)]] = False
    return parts[done[owner]], owner[done[owner]], done
