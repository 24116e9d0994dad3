"""Lots less the envelopes around walls, exactly: straight offsets and true arcs, no general overlay.

The edge of what is left of a lot is made of pieces of curves: the lot's own edges, each wall moved outward by its
clearance, and an arc around each outer corner. All curves that come near the lot are split where they cross, a piece
is kept if its middle lies in the lot and no nearer to any wall than its clearance, and the pieces kept are joined end to
end. Distances are measured, not derived from the curves, so a piece that should not be there has nothing to join.
Wherever curves coincide, a join is ambiguous or a loop stays open, the lot is given back undone, for an overlay to do.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

SAME_M = 1e-9
"""Distances that differ by less are equal."""
SHORTEST_PIECE_M = 1e-5
JOIN_M = 4e-5
"""Ends of pieces nearer than this are one point."""
MOST_CURVES = 3000
MOST_CROSSINGS = 12000
DONE, UNDONE = 0, 1

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def lots_less_envelopes(
    lot_xy: Floats,
    lot_rings: Ints,
    lot_offsets: Ints,
    thing_xy: Floats,
    thing_rings: Ints,
    thing_offsets: Ints,
    clearance: Floats,
    pair_offsets: Ints,
    pair_things: Ints,
    arc_excess: float,
) -> Any:
    """Return what is left of lots, as rings.

    Parameters
    ----------
    lot_xy, lot_rings, lot_offsets
        Coordinates of closed rings with the inside on their left, where each ring begins (and the last ends), and
        where the rings of each lot begin.
    thing_xy, thing_rings, thing_offsets
        The same of the things to keep away from.
    clearance
        How far from each thing; 0 for things that are areas to be kept free themselves.
    pair_offsets, pair_things
        For each lot the things near it.
    arc_excess
        How far the corners of chords may lie outside an arc.

    Returns
    -------
    Coordinates of closed rings, where each begins, the polygon of each (its shell's place), the lot of each, and for each lot
    whether it is done.
    """
    lots = len(lot_offsets) - 1
    status = np.zeros(lots, dtype=np.int64)
    out_xy = np.empty((max(1024, 8 * len(lot_xy)), 2))
    out_rings = np.empty(max(64, 4 * lots) + 1, dtype=np.int64)
    out_shell = np.empty(len(out_rings), dtype=np.int64)
    out_lot = np.empty(len(out_rings), dtype=np.int64)
    counts = np.zeros(2, dtype=np.int64)  # rings, coordinates
    out_rings[0] = 0

    curve = np.empty((MOST_CURVES, 5))
    box = np.empty((MOST_CURVES, 4))
    kind = np.empty(MOST_CURVES, dtype=np.int64)
    owner = np.empty(MOST_CURVES, dtype=np.int64)
    cross_curve = np.empty(MOST_CROSSINGS, dtype=np.int64)
    cross_at = np.empty(MOST_CROSSINGS)
    piece_curve = np.empty(MOST_CROSSINGS + MOST_CURVES, dtype=np.int64)
    piece_at = np.empty((MOST_CROSSINGS + MOST_CURVES, 2))
    piece_end = np.empty((MOST_CROSSINGS + MOST_CURVES, 4))
    used = np.empty(MOST_CROSSINGS + MOST_CURVES, dtype=np.bool_)

    for lot in range(lots):
        first, last = lot_rings[lot_offsets[lot]], lot_rings[lot_offsets[lot + 1]]
        west, south, east, north = _bounds(lot_xy, first, last)
        near = pair_things[pair_offsets[lot] : pair_offsets[lot + 1]]
        count = 0
        for ring in range(lot_offsets[lot], lot_offsets[lot + 1]):
            count = _add_ring(lot_xy, lot_rings[ring], lot_rings[ring + 1], west, south, curve, kind, owner, count)
        lot_curves = count
        for thing in near:
            if count < 0:
                break
            for ring in range(thing_offsets[thing], thing_offsets[thing + 1]):
                count = _add_envelope(
                    thing_xy, thing_rings[ring], thing_rings[ring + 1], clearance[thing], thing,
                    west, south, east - west, north - south, curve, kind, owner, count,
                )  # fmt: skip
                if count < 0:
                    break
        if count < 0:
            status[lot] = UNDONE
            continue
        _boxes(curve, kind, box, count)
        crossings = _all_crossings(curve, kind, owner, box, lot_curves, count, cross_curve, cross_at)
        if crossings < 0:
            status[lot] = UNDONE
            continue
        pieces = _keep_pieces(
            curve, kind, owner, count, cross_curve, cross_at, crossings,
            lot_xy, lot_rings, lot_offsets[lot], lot_offsets[lot + 1],
            thing_xy, thing_rings, thing_offsets, clearance, near, west, south,
            piece_curve, piece_at, piece_end,
        )  # fmt: skip
        if pieces < 0:
            status[lot] = UNDONE
            continue
        before_rings, before_xy = counts[0], counts[1]
        while True:
            done = _join(
                curve, kind, pieces, piece_curve, piece_at, piece_end, used, arc_excess, lot, west, south,
                out_xy, out_rings, out_shell, out_lot, counts,
            )  # fmt: skip
            if done >= 0:
                break
            counts[0], counts[1] = before_rings, before_xy
            out_xy = _longer(out_xy)
            out_rings, out_shell, out_lot = _longer(out_rings), _longer(out_shell), _longer(out_lot)
        if done == UNDONE:
            status[lot] = UNDONE
            counts[0], counts[1] = before_rings, before_xy
    rings, total = counts[0], counts[1]
    return out_xy[:total], out_rings[: rings + 1], out_shell[:rings], out_lot[:rings], status


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _longer(values: Any) -> Any:
    """Return a copy with room for as many again."""
    return np.concatenate((values, values))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _bounds(xy: Floats, first: int, last: int) -> tuple[float, float, float, float]:
    west, south, east, north = np.inf, np.inf, -np.inf, -np.inf
    for i in range(first, last):
        west, east = min(west, xy[i, 0]), max(east, xy[i, 0])
        south, north = min(south, xy[i, 1]), max(north, xy[i, 1])
    return west, south, east, north


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _add_ring(
    xy: Floats, first: int, last: int, west: float, south: float, curve: Floats, kind: Ints, owner: Ints, count: int
) -> int:
    """Add a lot's edges as curves; return how many there are now, -1 if there is no room."""
    for i in range(first, last - 1):
        if count < 0 or count >= MOST_CURVES:
            return -1
        if xy[i, 0] == xy[i + 1, 0] and xy[i, 1] == xy[i + 1, 1]:
            continue
        curve[count, 0], curve[count, 1] = xy[i, 0] - west, xy[i, 1] - south
        curve[count, 2], curve[count, 3] = xy[i + 1, 0] - west, xy[i + 1, 1] - south
        kind[count], owner[count] = 0, -1
        count += 1
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _add_envelope(
    xy: Floats, first: int, last: int, radius: float, thing: int,
    west: float, south: float, width: float, height: float,
    curve: Floats, kind: Ints, owner: Ints, count: int,
) -> int:  # fmt: skip
    """Add walls moved outward and arcs around outer corners, those that come near the lot; -1 if that is impossible."""
    edges = last - 1 - first
    previous = -1
    for k in range(edges - 1, -1, -1):
        if xy[first + k, 0] != xy[first + k + 1, 0] or xy[first + k, 1] != xy[first + k + 1, 1]:
            previous = first + k
            break
    if previous < 0:
        return count
    dx, dy = xy[previous + 1, 0] - xy[previous, 0], xy[previous + 1, 1] - xy[previous, 1]
    length = math.sqrt(dx * dx + dy * dy)
    ux, uy = dx / length, dy / length
    for i in range(first, last - 1):
        dx, dy = xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1]
        if dx == 0.0 and dy == 0.0:
            continue
        if count + 2 > MOST_CURVES:
            return -1
        length = math.sqrt(dx * dx + dy * dy)
        vx, vy = dx / length, dy / length
        x, y = xy[i, 0] - west, xy[i, 1] - south
        turn = math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
        if abs(turn) > math.pi - 1e-6:
            return -1
        if radius > 0.0 and turn > 0.0 and -radius <= x <= width + radius and -radius <= y <= height + radius:
            curve[count, 0], curve[count, 1], curve[count, 2] = x, y, radius
            curve[count, 3], curve[count, 4] = math.atan2(-ux, uy), turn
            kind[count], owner[count] = 1, thing
            count += 1
        ax, ay = x + radius * vy, y - radius * vx
        bx, by = ax + dx, ay + dy
        if min(ax, bx) <= width and max(ax, bx) >= 0 and min(ay, by) <= height and max(ay, by) >= 0:
            curve[count, 0], curve[count, 1], curve[count, 2], curve[count, 3] = ax, ay, bx, by
            kind[count], owner[count] = 0, thing
            count += 1
        ux, uy = vx, vy
    return count


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _boxes(curve: Floats, kind: Ints, box: Floats, count: int) -> None:
    for i in range(count):
        if kind[i] == 0:
            box[i, 0], box[i, 2] = min(curve[i, 0], curve[i, 2]), max(curve[i, 0], curve[i, 2])
            box[i, 1], box[i, 3] = min(curve[i, 1], curve[i, 3]), max(curve[i, 1], curve[i, 3])
        else:
            x, y, r = curve[i, 0], curve[i, 1], curve[i, 2]
            box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x - r, y - r, x + r, y + r


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _all_crossings(
    curve: Floats,
    kind: Ints,
    owner: Ints,
    box: Floats,
    lot_curves: int,
    count: int,
    cross_curve: Ints,
    cross_at: Floats,
) -> int:
    """List where curves cross, as metres along each; -1 where two coincide or there is no room."""
    found = 0
    at = np.empty((4, 2))
    for i in range(count):
        for j in range(max(i + 1, lot_curves), count):
            if (
                box[i, 0] > box[j, 2] + SAME_M
                or box[j, 0] > box[i, 2] + SAME_M
                or box[i, 1] > box[j, 3] + SAME_M
                or box[j, 1] > box[i, 3] + SAME_M
            ):
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
            if n < 0 or found + 2 * n > MOST_CROSSINGS:
                return -1
            for k in range(n):
                cross_curve[found], cross_at[found] = i, at[k, 0]
                cross_curve[found + 1], cross_at[found + 1] = j, at[k, 1]
                found += 2
    return found


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _segments(a: Floats, b: Floats, at: Floats) -> int:
    """Return the number of crossings of two segments, and where along each; -1 where they run in each other."""
    ax, ay, bx, by = a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1]
    la, lb = math.sqrt(ax * ax + ay * ay), math.sqrt(bx * bx + by * by)
    ax, ay, bx, by = ax / la, ay / la, bx / lb, by / lb
    dx, dy = b[0] - a[0], b[1] - a[1]
    sine = ax * by - ay * bx
    if abs(sine) < 1e-9:
        if abs(dx * ay - dy * ax) > 1e-6:
            return 0
        one, other = dx * ax + dy * ay, (b[2] - a[0]) * ax + (b[3] - a[1]) * ay
        if min(max(one, other), la) - max(min(one, other), 0.0) > SHORTEST_PIECE_M:
            return -1
        return 0
    s = (dx * by - dy * bx) / sine
    t = (dx * ay - dy * ax) / sine
    if s < -SAME_M or s > la + SAME_M or t < -SAME_M or t > lb + SAME_M:
        return 0
    at[0, 0], at[0, 1] = s, t
    return 1


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _along_arc(arc: Floats, x: float, y: float) -> float:
    """Return how far along an arc a point of its circle lies, in metres; -1 where the arc does not reach."""
    angle = (math.atan2(y - arc[1], x - arc[0]) - arc[3]) % (2 * math.pi)
    if angle > arc[4]:
        if (angle - arc[4]) * arc[2] <= SAME_M:
            return arc[4] * arc[2]
        if (2 * math.pi - angle) * arc[2] <= SAME_M:
            return 0.0
        return -1.0
    return angle * arc[2]


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _segment_arc(a: Floats, arc: Floats, at: Floats) -> int:
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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _arcs(a: Floats, b: Floats, at: Floats) -> int:
    dx, dy = b[0] - a[0], b[1] - a[1]
    gap = math.sqrt(dx * dx + dy * dy)
    if gap < 1e-6 and abs(a[2] - b[2]) < 1e-6:
        low = (b[3] - a[3]) % (2 * math.pi)
        if low < a[4] - 1e-6 or (low + b[4] > 2 * math.pi + 1e-6):
            return -1
        return 0
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


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _place(curve: Floats, kind: int, at: float) -> tuple[float, float]:
    """Return the point that lies so many metres along a curve."""
    if kind == 1:
        angle = curve[3] + at / curve[2]
        return curve[0] + curve[2] * math.cos(angle), curve[1] + curve[2] * math.sin(angle)
    dx, dy = curve[2] - curve[0], curve[3] - curve[1]
    share = at / math.sqrt(dx * dx + dy * dy)
    return curve[0] + share * dx, curve[1] + share * dy


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _keep_pieces(
    curve: Floats, kind: Ints, owner: Ints, count: int, cross_curve: Ints, cross_at: Floats, crossings: int,
    lot_xy: Floats, lot_rings: Ints, ring_first: int, ring_last: int,
    thing_xy: Floats, thing_rings: Ints, thing_offsets: Ints, clearance: Floats, near: Ints, west: float, south: float,
    piece_curve: Ints, piece_at: Floats, piece_end: Floats,
) -> int:  # fmt: skip
    """Cut curves at their crossings and keep the pieces that bound what is left; -1 where one cannot be judged."""
    start = np.zeros(count + 1, dtype=np.int64)
    for k in range(crossings):
        start[cross_curve[k] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    cuts = np.empty(crossings)
    place = start.copy()
    for k in range(crossings):
        cuts[place[cross_curve[k]]] = cross_at[k]
        place[cross_curve[k]] += 1
    pieces = 0
    for i in range(count):
        own = cuts[start[i] : start[i + 1]]
        own.sort()
        if kind[i] == 1:
            length = curve[i, 2] * curve[i, 4]
        else:
            length = math.sqrt((curve[i, 2] - curve[i, 0]) ** 2 + (curve[i, 3] - curve[i, 1]) ** 2)
        before = 0.0
        for k in range(len(own) + 1):
            after = length
            if k < len(own):
                after = own[k]
                if length - after < SHORTEST_PIECE_M:
                    continue
            if after - before < SHORTEST_PIECE_M and k < len(own):
                continue
            x, y = _place(curve[i], kind[i], (before + after) / 2)
            verdict = _is_edge(
                x + west, y + south, owner[i], lot_xy, lot_rings, ring_first, ring_last,
                thing_xy, thing_rings, thing_offsets, clearance, near,
            )  # fmt: skip
            if verdict < 0:
                return -1
            if verdict > 0:
                ax, ay = _place(curve[i], kind[i], before)
                bx, by = _place(curve[i], kind[i], after)
                piece_curve[pieces] = i
                if owner[i] < 0:
                    piece_at[pieces, 0], piece_at[pieces, 1] = before, after
                    piece_end[pieces, 0], piece_end[pieces, 1], piece_end[pieces, 2], piece_end[pieces, 3] = (
                        ax,
                        ay,
                        bx,
                        by,
                    )
                else:  # walked backward: what is left lies on the other side of an envelope's edge
                    piece_at[pieces, 0], piece_at[pieces, 1] = after, before
                    piece_end[pieces, 0], piece_end[pieces, 1], piece_end[pieces, 2], piece_end[pieces, 3] = (
                        bx,
                        by,
                        ax,
                        ay,
                    )
                pieces += 1
            before = after
    return pieces


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _is_edge(
    x: float, y: float, owner: int, lot_xy: Floats, lot_rings: Ints, ring_first: int, ring_last: int,
    thing_xy: Floats, thing_rings: Ints, thing_offsets: Ints, clearance: Floats, near: Ints,
) -> int:  # fmt: skip
    """Tell whether a point on a curve is on the edge of what is left: 1 yes, 0 no, -1 undecided."""
    for thing in near:
        reach = clearance[thing]
        if thing == owner and reach == 0.0:
            continue
        gap = _distance(x, y, thing_xy, thing_rings, thing_offsets[thing], thing_offsets[thing + 1], reach)
        if gap < reach - SAME_M:
            return 0
        if thing != owner and gap < reach + SAME_M:
            return -1
    if owner < 0:
        return 1
    inside = False
    for ring in range(ring_first, ring_last):
        for i in range(lot_rings[ring], lot_rings[ring + 1] - 1):
            if (lot_xy[i, 1] > y) != (lot_xy[i + 1, 1] > y):
                share = (y - lot_xy[i, 1]) / (lot_xy[i + 1, 1] - lot_xy[i, 1])
                if x < lot_xy[i, 0] + share * (lot_xy[i + 1, 0] - lot_xy[i, 0]):
                    inside = not inside
    return 1 if inside else 0


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _distance(x: float, y: float, xy: Floats, rings: Ints, first: int, last: int, reach: float) -> float:
    """Return the distance of a point to a polygon, below 0 inside; stop as soon as it is below `reach`."""
    least = np.inf
    limit = max(reach - SAME_M, 0.0) ** 2
    inside = False
    for ring in range(first, last):
        for i in range(rings[ring], rings[ring + 1] - 1):
            ax, ay = xy[i, 0], xy[i, 1]
            dx, dy = xy[i + 1, 0] - ax, xy[i + 1, 1] - ay
            px, py = x - ax, y - ay
            square = dx * dx + dy * dy
            share = 0.0
            if square > 0.0:
                share = min(1.0, max(0.0, (px * dx + py * dy) / square))
            gap = (px - share * dx) ** 2 + (py - share * dy) ** 2
            least = min(least, gap)
            if least < limit:
                return math.sqrt(least)
            if (ay > y) != (ay + dy > y) and px < dx * (y - ay) / dy:
                inside = not inside
    return -math.sqrt(least) if inside else math.sqrt(least)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _join(
    curve: Floats, kind: Ints, pieces: int, piece_curve: Ints, piece_at: Floats, piece_end: Floats, used: Any,
    arc_excess: float, lot: int, west: float, south: float,
    out_xy: Floats, out_rings: Ints, out_shell: Ints, out_lot: Ints, counts: Ints,
) -> int:  # fmt: skip
    """Join pieces to rings and write them; UNDONE where they do not join, -1 where there is no room to write."""
    used[:pieces] = False
    first_ring = counts[0]
    rings, total = counts[0], counts[1]
    for seed in range(pieces):
        if used[seed]:
            continue
        piece, begin = seed, total
        while True:
            used[piece] = True
            if total + 2 >= len(out_xy):
                return -1
            out_xy[total, 0], out_xy[total, 1] = piece_end[piece, 0], piece_end[piece, 1]
            total += 1
            i = piece_curve[piece]
            if kind[i] == 1:
                radius = curve[i, 2]
                a, b = curve[i, 3] + piece_at[piece, 0] / radius, curve[i, 3] + piece_at[piece, 1] / radius
                n = int(math.ceil(abs(b - a) / (2 * math.acos(radius / (radius + arc_excess)))))
                step = (b - a) / n
                wide = radius / math.cos(step / 2)
                if total + n + 2 >= len(out_xy):
                    return -1
                for k in range(n):
                    angle = a + (k + 0.5) * step
                    out_xy[total, 0] = curve[i, 0] + wide * math.cos(angle)
                    out_xy[total, 1] = curve[i, 1] + wide * math.sin(angle)
                    total += 1
            following = -1
            for other in range(pieces):
                if (
                    abs(piece_end[other, 0] - piece_end[piece, 2]) < JOIN_M
                    and abs(piece_end[other, 1] - piece_end[piece, 3]) < JOIN_M
                ):
                    if following >= 0:
                        return UNDONE
                    following = other
            if following < 0:
                return UNDONE
            if following == seed:
                break
            if used[following]:
                return UNDONE
            piece = following
        out_xy[total] = out_xy[begin]
        total += 1
        if total - begin < 4:
            total = begin
            continue
        if rings + 2 >= len(out_rings):
            return -1
        out_lot[rings], out_rings[rings + 1] = lot, total
        rings += 1
    for ring in range(first_ring, rings):
        out_shell[ring] = ring
        if _area(out_xy, out_rings[ring], out_rings[ring + 1]) < 0.0:
            out_shell[ring] = _shell_of(out_xy, out_rings, first_ring, rings, ring)
            if out_shell[ring] < 0:
                return UNDONE
    for k in range(counts[1], total):
        out_xy[k, 0] += west
        out_xy[k, 1] += south
    counts[0], counts[1] = rings, total
    return DONE


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _area(xy: Floats, first: int, last: int) -> float:
    """Return twice a ring's area, below 0 for a ring that runs clockwise: a hole."""
    total = 0.0
    for i in range(first, last - 1):
        total += (xy[i, 0] - xy[first, 0]) * (xy[i + 1, 1] - xy[first, 1])
        total -= (xy[i + 1, 0] - xy[first, 0]) * (xy[i, 1] - xy[first, 1])
    return total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _shell_of(xy: Floats, rings: Ints, first_ring: int, last_ring: int, hole: int) -> int:
    """Return the smallest shell around a hole, -1 if there is none."""
    x, y = xy[rings[hole], 0], xy[rings[hole], 1]
    best, best_area = -1, np.inf
    for ring in range(first_ring, last_ring):
        area = _area(xy, rings[ring], rings[ring + 1])
        if area <= 0.0 or area >= best_area:
            continue
        inside = False
        for i in range(rings[ring], rings[ring + 1] - 1):
            if (xy[i, 1] > y) != (xy[i + 1, 1] > y):
                share = (y - xy[i, 1]) / (xy[i + 1, 1] - xy[i, 1])
                if x < xy[i, 0] + share * (xy[i + 1, 0] - xy[i, 0]):
                    inside = not inside
        if inside:
            best, best_area = ring, area
    return best


KERNELS = (lots_less_envelopes,)
