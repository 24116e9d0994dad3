"""Polygons and lines taken apart, as the kernels read them, with trees to find what lies in a window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.plan import Floats, Geometries

Integers = NDArray[np.int64]
Box = tuple[float, float, float, float]
"""West, south, east, north."""

_LONGEST_M = 1e7
_SQUARE_M = 32.0


@dataclass(frozen=True)
class Outlines:
    """Polygons as flat rings, and a tree to find them by."""

    xy: Floats
    ring_ends: Integers
    polygon_ends: Integers
    tree: shapely.STRtree

    @classmethod
    def of(cls, shapes: Geometries) -> Outlines:
        """Flatten polygons and multipolygons."""
        parts, of = shapely.get_parts(shapes, return_index=True)
        rings, part = shapely.get_rings(parts, return_index=True)
        polygon = of[part]
        xy, ring = shapely.get_coordinates(rings, return_index=True)
        ring_ends = np.cumsum(np.bincount(ring, minlength=len(rings)))
        return cls(xy, ring_ends, np.cumsum(np.bincount(polygon, minlength=len(shapes))), shapely.STRtree(shapes))

    def within(self, box: Box) -> Integers:
        """Return the numbers of those that may lie in a box, ascending."""
        return np.sort(self.tree.query(shapely.box(*box)))


@dataclass(frozen=True)
class Lines:
    """Roads or tracks as segments, each road's one after the other."""

    segments: Floats  # (segments, 7) start, end, half width, metres along, number of the line
    tree: shapely.STRtree

    @classmethod
    def of(cls, lines: Geometries, half_m: Floats) -> Lines:
        """Take lines apart."""
        xy, line = shapely.get_coordinates(lines, return_index=True)
        same = line[1:] == line[:-1]
        start, end, number = xy[:-1][same], xy[1:][same], line[:-1][same]
        length = np.hypot(*(end - start).T)
        before = np.cumsum(length) - length
        first = np.append(True, number[1:] != number[:-1])[: len(number)]
        before = before - np.maximum.accumulate(np.where(first, before, 0.0))
        shapes = np.asarray(shapely.linestrings(np.stack((start, end), axis=1)), dtype=object)
        return cls(np.column_stack((start, end, half_m[number], before, number)), shapely.STRtree(shapes))

    def within(self, box: Box) -> Integers:
        """Return the numbers of the segments that may lie in a box, ascending."""
        return np.sort(self.tree.query(shapely.box(*box)))

    def clear_of(self, xy: Floats, beyond_m: float) -> NDArray[np.bool_]:
        """Tell which places lie farther than this from the edges of all lines."""
        clear = np.ones(len(xy), dtype=bool)
        reach_m = beyond_m + float(self.segments[:, 4].max(initial=0.0))
        near, segment = self.tree.query(shapely.points(xy), predicate="dwithin", distance=reach_m)
        ax, ay, bx, by = self.segments[segment, :4].T
        length2 = np.maximum((bx - ax) ** 2 + (by - ay) ** 2, 1e-12)
        t = np.clip(((xy[near, 0] - ax) * (bx - ax) + (xy[near, 1] - ay) * (by - ay)) / length2, 0.0, 1.0)
        far = np.hypot(xy[near, 0] - ax - t * (bx - ax), xy[near, 1] - ay - t * (by - ay))
        clear[near[far < beyond_m + self.segments[segment, 4]]] = False
        return clear

    def places(self, line: Integers, at_m: Floats, left_m: Floats) -> tuple[Floats, Floats]:
        """Return (n, 2) places so far along lines and left of them, and the unit directions there."""
        first = np.searchsorted(self.segments[:, 6], line)
        last = np.searchsorted(self.segments[:, 6], line, side="right") - 1
        whole = self.segments[:, 5] + self.segments[:, 6] * _LONGEST_M
        segment = np.searchsorted(whole, at_m + line * _LONGEST_M, side="right") - 1
        segment = np.clip(segment, first, last)
        row = self.segments[segment]
        way = row[:, 2:4] - row[:, :2]
        way = way / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
        ahead = (at_m - row[:, 5])[:, None]
        return row[:, :2] + ahead * way + left_m[:, None] * np.column_stack((-way[:, 1], way[:, 0])), way


@dataclass(frozen=True)
class Nearby:
    """An index of many small things by the squares their middles lie in."""

    order: Integers  # the things, square by square
    squares: Integers  # (things,) in that order, each one's square
    low: Floats  # (2,) corner of the first square
    across: int
    reach_m: float

    @classmethod
    def of(cls, xy: Floats, reach_m: Floats) -> Nearby:
        """Index things by their middles and how far each reaches."""
        low = xy.min(axis=0, initial=np.inf) if len(xy) else np.zeros(2)
        cell = ((xy - low) / _SQUARE_M).astype(np.int64)
        across = int(cell[:, 0].max(initial=0)) + 1
        square = cell[:, 1] * across + cell[:, 0]
        order = np.argsort(square, kind="stable")
        return cls(order, square[order], low, across, float(reach_m.max(initial=0.0)))

    def within(self, box: Box) -> Integers:
        """Return the numbers of those that may reach into a box, ascending."""
        west, south, east, north = box
        corners = np.array([[west - self.reach_m, south - self.reach_m], [east + self.reach_m, north + self.reach_m]])
        (col0, row0), (col1, row1) = np.floor((corners - self.low) / _SQUARE_M).astype(np.int64)
        col0, col1 = max(col0, 0), min(col1, self.across - 1)
        if col0 > col1:
            return np.empty(0, dtype=np.int64)
        rows = np.arange(max(row0, 0), max(row1, -1) + 1) * self.across
        starts = np.searchsorted(self.squares, rows + col0)
        ends = np.searchsorted(self.squares, rows + col1, side="right")
        return np.sort(np.concatenate([self.order[:0], *(self.order[a:b] for a, b in zip(starts, ends, strict=True))]))
