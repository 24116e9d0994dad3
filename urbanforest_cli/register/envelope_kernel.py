"""Lots less the envelopes around walls, exactly: straight offsets and true arcs, no general overlay.

The edge of what is left of a lot is made of pieces of curves: the lot's own edges, each wall moved outward by its
clearance, and an arc around each outer corner. All curves that come near the lot are split where they cross, a piece
is kept if its middle lies in the lot and no nearer to any wall than its clearance, and the pieces kept are joined
end to end. Distances are measured, not derived from the curves, so a piece that should not be there has nothing to
join. Wherever a join is ambiguous or a loop stays open, the lot is given back undone, for an overlay to do.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.register.curve_kernel import (
    MOST_CROSSINGS,
    SAME_M,
    SHORTEST_PIECE_M,
    all_crossings,
    arc_bounds,
    boxes,
    place,
    right_of,
)

JOIN_M = 4e-5
"""Ends of pieces nearer than this are one point."""
BESIDE_M = 1e-4
"""How far off a curve it is seen what lies beside it."""
MOST_CURVES = 3000
DONE, UNDONE = 0, 1

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def lots_less_envelopes(
    lot_xy: Floats,
    lot_rings: Ints,
    lot_offsets: Ints,
    thing_xy: Floats,
    thing_rings: Ints,
    thing_offsets: Ints,
    thing_box: Floats,
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
        The same of the things to keep away from; a point is a ring of one position.
    thing_box
        Their bounds.
    clearance
        How far from each thing; 0 for things that are areas to be kept free themselves.
    pair_offsets, pair_things
        For each lot the things near it.
    arc_excess
        How far the corners of chords may lie outside an arc.

    Returns
    -------
    Coordinates of closed rings, where each begins, the place of its shell, its lot, and for each lot whether it is
    done.
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
        boxes(curve, kind, box, count)
        crossings = all_crossings(curve, kind, owner, box, lot_curves, count, cross_curve, cross_at)
        if crossings < 0:
            status[lot] = UNDONE
            continue
        pieces = _keep_pieces(
            curve, kind, owner, count, cross_curve, cross_at, crossings,
            lot_xy, lot_rings, lot_offsets[lot], lot_offsets[lot + 1],
            thing_xy, thing_rings, thing_offsets, thing_box, clearance, near, west, south,
            piece_curve, piece_at, piece_end,
        )  # fmt: skip
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


@njit(cache=True, nogil=True, error_model="numpy")
def _longer(values: Any) -> Any:
    """Return a copy with room for as many again."""
    return np.concatenate((values, values))


@njit(cache=True, nogil=True, error_model="numpy")
def _bounds(xy: Floats, first: int, last: int) -> tuple[float, float, float, float]:
    west, south, east, north = np.inf, np.inf, -np.inf, -np.inf
    for i in range(first, last):
        west, east = min(west, xy[i, 0]), max(east, xy[i, 0])
        south, north = min(south, xy[i, 1]), max(north, xy[i, 1])
    return west, south, east, north


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def _add_envelope(
    xy: Floats, first: int, last: int, radius: float, thing: int,
    west: float, south: float, width: float, height: float,
    curve: Floats, kind: Ints, owner: Ints, count: int,
) -> int:  # fmt: skip
    """Add walls moved outward and arcs around outer corners, those that come near the lot; -1 if that is impossible."""
    edges = last - 1 - first
    if edges == 0:
        x, y = xy[first, 0] - west, xy[first, 1] - south
        if count >= MOST_CURVES:
            return -1
        if radius > 0.0 and -radius <= x <= width + radius and -radius <= y <= height + radius:
            curve[count, 0], curve[count, 1], curve[count, 2] = x, y, radius
            curve[count, 3], curve[count, 4] = 0.0, 2 * math.pi
            kind[count], owner[count] = 1, thing
            count += 1
        return count
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
            low_x, low_y, high_x, high_y = arc_bounds(curve[count])
            if low_x <= width and high_x >= 0.0 and low_y <= height and high_y >= 0.0:
                count += 1
        ax, ay = x + radius * vy, y - radius * vx
        bx, by = ax + dx, ay + dy
        if min(ax, bx) <= width and max(ax, bx) >= 0 and min(ay, by) <= height and max(ay, by) >= 0:
            curve[count, 0], curve[count, 1], curve[count, 2], curve[count, 3] = ax, ay, bx, by
            kind[count], owner[count] = 0, thing
            count += 1
        ux, uy = vx, vy
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _keep_pieces(
    curve: Floats, kind: Ints, owner: Ints, count: int, cross_curve: Ints, cross_at: Floats, crossings: int,
    lot_xy: Floats, lot_rings: Ints, ring_first: int, ring_last: int,
    thing_xy: Floats, thing_rings: Ints, thing_offsets: Ints, thing_box: Floats, clearance: Floats, near: Ints,
    west: float, south: float, piece_curve: Ints, piece_at: Floats, piece_end: Floats,
) -> int:  # fmt: skip
    """Cut curves at their crossings and keep the pieces that bound what is left."""
    start = np.zeros(count + 1, dtype=np.int64)
    for k in range(crossings):
        start[cross_curve[k] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    cuts = np.empty(crossings)
    filled = start.copy()
    for k in range(crossings):
        cuts[filled[cross_curve[k]]] = cross_at[k]
        filled[cross_curve[k]] += 1
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
            x, y = place(curve[i], kind[i], (before + after) / 2)
            nx, ny = right_of(curve[i], kind[i], (before + after) / 2)
            if owner[i] < 0:
                nx, ny = -nx, -ny
            if _is_edge(
                x, y, nx, ny, owner[i], lot_xy, lot_rings, ring_first, ring_last,
                thing_xy, thing_rings, thing_offsets, thing_box, clearance, near, west, south,
            ):  # fmt: skip
                tail, head = before, after
                if owner[i] >= 0:  # walked backward: what is left lies on the other side of an envelope's edge
                    tail, head = after, before
                piece_curve[pieces] = i
                piece_at[pieces, 0], piece_at[pieces, 1] = tail, head
                piece_end[pieces, 0], piece_end[pieces, 1] = place(curve[i], kind[i], tail)
                piece_end[pieces, 2], piece_end[pieces, 3] = place(curve[i], kind[i], head)
                pieces += 1
            before = after
    return pieces


@njit(cache=True, nogil=True, error_model="numpy")
def _is_edge(
    x: float, y: float, nx: float, ny: float, owner: int,
    lot_xy: Floats, lot_rings: Ints, ring_first: int, ring_last: int,
    thing_xy: Floats, thing_rings: Ints, thing_offsets: Ints, thing_box: Floats, clearance: Floats, near: Ints,
    west: float, south: float,
) -> bool:  # fmt: skip
    """Tell whether a point on a curve is on the edge of what is left, which lies to the side (nx, ny).

    Where curves coincide, one of them stands for all: the lot's edge, else the first thing's; but none does where
    another envelope begins on the side of what is left.
    """
    for thing in near:
        reach = clearance[thing]
        if thing == owner and reach == 0.0:
            continue
        wide = reach + SAME_M
        if (
            x + west < thing_box[thing, 0] - wide
            or x + west > thing_box[thing, 2] + wide
            or y + south < thing_box[thing, 1] - wide
            or y + south > thing_box[thing, 3] + wide
        ):
            continue
        first, last = thing_offsets[thing], thing_offsets[thing + 1]
        gap = _distance(x, y, thing_xy, thing_rings, first, last, reach, west, south)
        if gap < reach - SAME_M:
            return False
        if thing != owner and gap < wide:
            beside = _distance(
                x + BESIDE_M * nx, y + BESIDE_M * ny, thing_xy, thing_rings, first, last, reach, west, south
            )
            if beside < reach or 0 <= thing < owner:
                return False
    return owner < 0 or _distance(x, y, lot_xy, lot_rings, ring_first, ring_last, 0.0, west, south) < -SAME_M


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(
    x: float, y: float, xy: Floats, rings: Ints, first: int, last: int, reach: float, west: float, south: float
) -> float:
    """Return the distance of a point to a polygon, below 0 inside; stop as soon as it is below `reach`."""
    least = np.inf
    limit = reach - SAME_M
    limit = limit * limit if limit > 0.0 else -1.0
    inside = False
    for ring in range(first, last):
        if rings[ring + 1] - rings[ring] == 1:
            px, py = x - (xy[rings[ring], 0] - west), y - (xy[rings[ring], 1] - south)
            least = min(least, px * px + py * py)
        for i in range(rings[ring], rings[ring + 1] - 1):
            px, py = x - (xy[i, 0] - west), y - (xy[i, 1] - south)
            dx, dy = xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1]
            square = dx * dx + dy * dy
            share = 0.0
            if square > 0.0:
                share = min(1.0, max(0.0, (px * dx + py * dy) / square))
            gap = (px - share * dx) ** 2 + (py - share * dy) ** 2
            least = min(least, gap)
            if least < limit:
                return math.sqrt(least)
            if (py < 0.0) != (py < dy) and px < dx * py / dy:
                inside = not inside
    return -math.sqrt(least) if inside else math.sqrt(least)


@njit(cache=True, nogil=True, error_model="numpy")
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
                n = math.ceil(abs(b - a) / (2 * math.acos(radius / (radius + arc_excess))))
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


@njit(cache=True, nogil=True, error_model="numpy")
def _area(xy: Floats, first: int, last: int) -> float:
    """Return twice a ring's area, below 0 for a ring that runs clockwise: a hole."""
    total = 0.0
    for i in range(first, last - 1):
        total += (xy[i, 0] - xy[first, 0]) * (xy[i + 1, 1] - xy[first, 1])
        total -= (xy[i + 1, 0] - xy[first, 0]) * (xy[i, 1] - xy[first, 1])
    return total


@njit(cache=True, nogil=True, error_model="numpy")
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
