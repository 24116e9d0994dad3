"""Segments and arcs: where they cross each other.

A curve is a row of five numbers: a segment (kind 0) its two ends, an arc (kind 1) its centre, radius, first angle and
sweep, which runs counter-clockwise. A place on a curve is named by the metres walked along it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

SAME_M = 1e-9
"""Distances that differ by less are equal."""
SHORTEST_PIECE_M = 1e-5
MOST_CROSSINGS = 12000

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def arc_bounds(arc: Floats) -> tuple[float, float, float, float]:
    """Return west, south, east, north of an arc: of its ends, and of where it passes a direction of the compass."""
    x, y, radius, first, last = arc[0], arc[1], arc[2], arc[3], arc[3] + arc[4]
    ax, ay = x + radius * math.cos(first), y + radius * math.sin(first)
    bx, by = x + radius * math.cos(last), y + radius * math.sin(last)
    west, south, east, north = min(ax, bx), min(ay, by), max(ax, bx), max(ay, by)
    quarter = math.ceil(first / (math.pi / 2))
    while quarter * (math.pi / 2) < last:
        side = int(quarter) % 4
        if side == 0:
            east = x + radius
        elif side == 1:
            north = y + radius
        elif side == 2:
            west = x - radius
        else:
            south = y - radius
        quarter += 1
    return west, south, east, north


@njit(cache=True, nogil=True, error_model="numpy")
def boxes(curve: Floats, kind: Ints, box: Floats, count: int) -> None:
    """Write the bounds of curves."""
    for i in range(count):
        if kind[i] == 0:
            box[i, 0], box[i, 2] = min(curve[i, 0], curve[i, 2]), max(curve[i, 0], curve[i, 2])
            box[i, 1], box[i, 3] = min(curve[i, 1], curve[i, 3]), max(curve[i, 1], curve[i, 3])
        else:
            box[i, 0], box[i, 1], box[i, 2], box[i, 3] = arc_bounds(curve[i])


@njit(cache=True, nogil=True, error_model="numpy")
def all_crossings(
    curve: Floats,
    kind: Ints,
    owner: Ints,
    box: Floats,
    lot_curves: int,
    count: int,
    cross_curve: Ints,
    cross_at: Floats,
) -> int:
    """List where curves cross, as metres along each; -1 where there is no room for so many."""
    found = 0
    at = np.empty((4, 2))
    order = np.argsort(box[:count, 0])
    for one in range(count):
        for two in range(one + 1, count):
            i, j = order[one], order[two]
            if box[j, 0] > box[i, 2] + SAME_M:
                break
            if i > j:
                i, j = j, i
            if j < lot_curves or box[i, 1] > box[j, 3] + SAME_M or box[j, 1] > box[i, 3] + SAME_M:
                continue
            if kind[i] == 0 and kind[j] == 0:
                n = _segments(curve[i], curve[j], at)
            elif kind[i] == 1 and kind[j] == 1:
                n = _arcs(curve[i], curve[j], at)
            elif kind[i] == 0:
                n = _segment_arc(curve[i], curve[j], at)
            else:
                n = _segment_arc(curve[j], curve[i], at)
                for k in range(n):
                    at[k, 0], at[k, 1] = at[k, 1], at[k, 0]
            if found + 2 * n > MOST_CROSSINGS:
                return -1
            for k in range(n):
                cross_curve[found], cross_at[found] = i, at[k, 0]
                cross_curve[found + 1], cross_at[found + 1] = j, at[k, 1]
                found += 2
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _segments(a: Floats, b: Floats, at: Floats) -> int:
    """Return the number of crossings of two segments, and where along each; of two that coincide, where that ends."""
    ax, ay, bx, by = a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1]
    la, lb = math.sqrt(ax * ax + ay * ay), math.sqrt(bx * bx + by * by)
    ax, ay, bx, by = ax / la, ay / la, bx / lb, by / lb
    dx, dy = b[0] - a[0], b[1] - a[1]
    sine = ax * by - ay * bx
    if abs(sine) < 1e-9:
        if abs(dx * ay - dy * ax) > 1e-6:
            return 0
        one, other = dx * ax + dy * ay, (b[2] - a[0]) * ax + (b[3] - a[1]) * ay
        way = 1.0 if other > one else -1.0
        n = 0
        for s in (0.0, la, one, other):
            if min(one, other) <= s <= max(one, other) and 0.0 <= s <= la:
                at[n, 0], at[n, 1] = s, (s - one) * way
                n += 1
        return n
    s = (dx * by - dy * bx) / sine
    t = (dx * ay - dy * ax) / sine
    if s < -SAME_M or s > la + SAME_M or t < -SAME_M or t > lb + SAME_M:
        return 0
    at[0, 0], at[0, 1] = s, t
    return 1


@njit(cache=True, nogil=True, error_model="numpy")
def _along_arc(arc: Floats, x: float, y: float) -> float:
    """Return how far along an arc a point of its circle lies, in metres; -1 where the arc does not reach."""
    angle = (math.atan2(y - arc[1], x - arc[0]) - arc[3]) % (2 * math.pi)
    if angle > arc[4]:
        if (angle - arc[4]) * arc[2] <= SAME_M:
            return float(arc[4] * arc[2])
        if (2 * math.pi - angle) * arc[2] <= SAME_M:
            return 0.0
        return -1.0
    return float(angle * arc[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _segment_arc(a: Floats, arc: Floats, at: Floats) -> int:
    """Return the number of crossings of a segment and an arc, and where along each."""
    dx, dy = a[2] - a[0], a[3] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / length, dy / length
    along = (arc[0] - a[0]) * dx + (arc[1] - a[1]) * dy
    off = (arc[0] - a[0]) * dy - (arc[1] - a[1]) * dx
    square = arc[2] * arc[2] - off * off
    if square < 0.0:
        return 0
    half = math.sqrt(square)
    n = 0
    for side in (-1.0, 1.0):
        s = along + side * half
        if -SAME_M <= s <= length + SAME_M:
            t = _along_arc(arc, a[0] + s * dx, a[1] + s * dy)
            if t >= 0.0:
                at[n, 0], at[n, 1] = s, t
                n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _arcs(a: Floats, b: Floats, at: Floats) -> int:
    """Return the number of crossings of two arcs, and where along each; of two that coincide, where that ends."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    gap = math.sqrt(dx * dx + dy * dy)
    if gap < 1e-6 and abs(a[2] - b[2]) < 1e-6:
        n = 0
        for end in (0.0, a[4] * a[2]):
            x, y = place(a, 1, end)
            t = _along_arc(b, x, y)
            if t >= 0.0:
                at[n, 0], at[n, 1] = end, t
                n += 1
        for end in (0.0, b[4] * b[2]):
            x, y = place(b, 1, end)
            s = _along_arc(a, x, y)
            if s >= 0.0:
                at[n, 0], at[n, 1] = s, end
                n += 1
        return n
    if gap > a[2] + b[2] or gap < abs(a[2] - b[2]):
        return 0
    along = (gap * gap + a[2] * a[2] - b[2] * b[2]) / (2 * gap)
    square = a[2] * a[2] - along * along
    if square < 0.0:
        return 0
    half = math.sqrt(square)
    n = 0
    for side in (-1.0, 1.0):
        x = a[0] + (along * dx - side * half * dy) / gap
        y = a[1] + (along * dy + side * half * dx) / gap
        s, t = _along_arc(a, x, y), _along_arc(b, x, y)
        if s >= 0.0 and t >= 0.0:
            at[n, 0], at[n, 1] = s, t
            n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def place(curve: Floats, kind: int, at: float) -> tuple[float, float]:
    """Return the point that lies so many metres along a curve."""
    if kind == 1:
        angle = curve[3] + at / curve[2]
        return curve[0] + curve[2] * math.cos(angle), curve[1] + curve[2] * math.sin(angle)
    dx, dy = curve[2] - curve[0], curve[3] - curve[1]
    share = at / math.sqrt(dx * dx + dy * dy)
    return curve[0] + share * dx, curve[1] + share * dy


@njit(cache=True, nogil=True, error_model="numpy")
def right_of(curve: Floats, kind: int, at: float) -> tuple[float, float]:
    """Return the unit vector to the right of a curve, which for an envelope is away from the wall."""
    if kind == 1:
        angle = curve[3] + at / curve[2]
        return math.cos(angle), math.sin(angle)
    dx, dy = curve[2] - curve[0], curve[3] - curve[1]
    length = math.sqrt(dx * dx + dy * dy)
    return dy / length, -dx / length
