"""The compiled part of the saturated Poisson-disc sampler; `poisson.py` says what it computes.

One area at a time. Ground that may still take a plant is a list of square cells, all of one size. A cell carries an
upper bound on the clearance of its points, min(|y - x| - r(x)) over the discs x, cut at the largest radius of the
law; clearance is 1-Lipschitz, so the value at the middle plus half a diagonal is such a bound. A cell whose bound
falls under the stop radius is dropped; where misses pile up all cells are split in four; when none is left, no gap
is left (flat quadtree of Ebeida et al. 2012, here with radii that vary). Cells lie in the order of their bounds, in
`BUCKETS` classes, so that those that may hold a plant of a given radius are a prefix of the list, and an even choice
of a cell in it is an even choice of ground.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BUCKETS = 14
BUCKETS_A_HALVING = 1.5
SMALLEST_SHARE = 2.0 ** (-(BUCKETS - 2) / BUCKETS_A_HALVING)
CELL_SIDE = 0.9  # of the mean radius, at the start
SMALLEST_CELL_M = 5e-4  # ground in cells smaller than this is given up, and its area reported
PATIENCE = 16  # misses among cells that might hold a large plant, before the search for its place is given up
OUTSIDE_REFUSAL = 0.2  # of a miss: a point outside the area says less about gaps than one too near a disc
SWEEP_SHARE = 0.75  # misses, as a share of the cells, before all cells are looked at and split
SHIFT_X, SHIFT_Y = 0.3819660112501051, 0.2763932022500210  # where the grid starts: irrational, no vertex lies on it
STREAM_SALT = 0xA0761D6478BD642F  # keeps this stream apart from others that start at the same key

GOLDEN_TURN = 0.6180339887498949
MEMORY = 32.0  # plants over which the coin of an area of `MANY_PLANTS` or more makes up for a surplus
MANY_PLANTS = 250.0

KEPT, REDRAWN = 0, 1
SATURATED, EMPTY, REFUSED = 0, 1, 2


class Law(NamedTuple):
    """Radii mean + d and mean - d alike, d of a half normal of parent `scale` cut at `width`; the stop radius."""

    mean: float
    width: float
    scale: float
    variance: float
    stop: float
    order: float


class Ground(NamedTuple):
    """An area's edges, filed under the squares of a coarse grid, with the side that each square's middle lies on."""

    edges: NDArray[np.float64]
    starts: NDArray[np.int64]
    members: NDArray[np.int32]
    inside: NDArray[np.uint8]
    x0: float
    y0: float
    side: float
    cols: int
    rows: int
    guard: float


class Discs(NamedTuple):
    """Discs in a grid of linked lists."""

    xyr: NDArray[np.float64]
    following: NDArray[np.int32]
    heads: NDArray[np.int32]
    x0: float
    y0: float
    side: float
    cols: int
    largest: float


kernel: Any = njit(cache=True, nogil=True)


@kernel
def _uniform(stream):
    """Step a SplitMix64 stream (Steele, Lea and Flood 2014) and return a number in [0, 1)."""
    stream[0] += np.uint64(0x9E3779B97F4A7C15)
    z = stream[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return float(z >> np.uint64(11)) * 2.0**-53


@kernel
def _share_within(d, law):
    """Return the share of plants whose radius is within d of the mean."""
    if d >= law.width:
        return 1.0
    a = law.scale * math.sqrt(2.0)
    return math.erf(d / a) / math.erf(law.width / a)


@kernel
def _spread_at(share, law):
    """Invert `_share_within` by Newton's method, which rises to the root from 0 as the function is concave."""
    a = law.scale * math.sqrt(2.0)
    target = share * math.erf(law.width / a)
    d = 0.0
    for _ in range(100):
        step = (target - math.erf(d / a)) * 0.5 * math.sqrt(math.pi) * a * math.exp((d / a) ** 2)
        d += step
        if step < 1e-13 * law.width or d >= law.width:
            break
    return min(d, law.width)


@kernel
def _share_below(radius, law):
    if radius < law.mean:
        return 0.5 - 0.5 * _share_within(law.mean - radius, law)
    return 0.5 + 0.5 * _share_within(radius - law.mean, law)


@kernel
def _radius_up_to(most, law, stream):
    """Draw from the law cut at a largest radius."""
    share = _uniform(stream) * _share_below(most, law)
    if share < 0.5:
        return law.mean - _spread_at(1.0 - 2.0 * share, law)
    return law.mean + _spread_at(2.0 * share - 1.0, law)


@kernel
def _share_of_spreads(q, late, order):
    """Return the share of spreads under quantile q among plants placed at a moment (Frank's copula)."""
    if order < 1e-9:
        return q
    early = 1.0 - late
    g = math.expm1(-order * q)
    return math.exp(-order * early) * g / (math.expm1(-order) + math.expm1(-order * early) * g)


@kernel
def _spread_quantile(share, late, order):
    """Invert `_share_of_spreads` in q."""
    if order < 1e-9:
        return share
    e = math.exp(-order * (1.0 - late))
    return -math.log1p(share * math.expm1(-order) / (share + (1.0 - share) * e)) / order


# ---- ground ----------------------------------------------------------------------------------------------------


@kernel
def _columns_in_row(edge, low, high, ground_x0, side, margin):
    """Return the first and last column that an edge passes through in a band of y, widened by a margin."""
    ax, ay, bx, by = edge
    low -= margin
    high += margin
    t0, t1 = 0.0, 1.0
    if ay != by:
        t0 = (low - ay) / (by - ay)
        t1 = (high - ay) / (by - ay)
        if t0 > t1:
            t0, t1 = t1, t0
        t0 = min(max(t0, 0.0), 1.0)
        t1 = min(max(t1, 0.0), 1.0)
    x_from = ax + t0 * (bx - ax)
    x_to = ax + t1 * (bx - ax)
    if x_from > x_to:
        x_from, x_to = x_to, x_from
    return math.floor((x_from - margin - ground_x0) / side), math.floor((x_to + margin - ground_x0) / side)


@kernel
def _file_edges(edges, x0, y0, side, cols, rows, guard):
    """List for each square the edges that come within the guard of it, as starts and members."""
    starts = np.zeros(cols * rows + 1, np.int64)
    members = np.empty(0, np.int32)
    cursor = starts
    margin = guard + 1e-6
    for filling in range(2):
        for k in range(len(edges)):
            edge = (edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3])
            first_row = math.floor((min(edge[1], edge[3]) - margin - y0) / side)
            last_row = math.floor((max(edge[1], edge[3]) + margin - y0) / side)
            for row in range(max(first_row, 0), min(last_row, rows - 1) + 1):
                below = y0 + row * side
                first, last = _columns_in_row(edge, below, below + side, x0, side, margin)
                for square in range(row * cols + max(first, 0), row * cols + min(last, cols - 1) + 1):
                    if filling == 0:
                        starts[square + 1] += 1
                    else:
                        members[cursor[square]] = k
                        cursor[square] += 1
        if filling == 0:
            starts = np.cumsum(starts)
            cursor = starts.copy()
            members = np.empty(starts[-1], np.int32)
    return starts, members


@kernel
def _middles_inside(edges, x0, y0, side, cols, rows):
    """Say which squares' middles lie inside, by the edges that cross the middle line of a row to their left."""
    inside = np.zeros(cols * rows, np.uint8)
    for k in range(len(edges)):
        ax, ay, bx, by = edges[k, 0], edges[k, 1], edges[k, 2], edges[k, 3]
        first_row = math.floor((min(ay, by) - y0) / side - 0.5)
        last_row = math.floor((max(ay, by) - y0) / side - 0.5) + 1
        for row in range(max(first_row, 0), min(last_row, rows - 1) + 1):
            middle = y0 + (row + 0.5) * side
            if (ay > middle) != (by > middle):
                x = ax + (middle - ay) / (by - ay) * (bx - ax)
                col = max(math.ceil((x - x0) / side - 0.5), 0)
                if col < cols:
                    inside[row * cols + col] ^= np.uint8(1)
    for row in range(rows):
        for square in range(row * cols + 1, (row + 1) * cols):
            inside[square] ^= inside[square - 1]
    return inside


@kernel
def _lay_out(edges, width, height, side, guard):
    x0, y0 = -SHIFT_X * side, -SHIFT_Y * side
    cols = int((width - x0) / side) + 1
    rows = int((height - y0) / side) + 1
    starts, members = _file_edges(edges, x0, y0, side, cols, rows, guard)
    inside = _middles_inside(edges, x0, y0, side, cols, rows)
    return Ground(edges, starts, members, inside, x0, y0, side, cols, rows, guard)


@kernel
def _depth(x, y, ground):
    """Return the distance to the nearest edge filed under a point's square, negative outside.

    The side follows from the known side of the square's middle and the edges between it and the point.
    """
    col = int((x - ground.x0) / ground.side)
    row = int((y - ground.y0) / ground.side)
    square = row * ground.cols + col
    px = ground.x0 + (col + 0.5) * ground.side
    py = ground.y0 + (row + 0.5) * ground.side
    is_inside = ground.inside[square] != 0
    ux, uy = x - px, y - py
    nearest = np.inf
    for m in range(ground.starts[square], ground.starts[square + 1]):
        k = ground.members[m]
        ax, ay = ground.edges[k, 0], ground.edges[k, 1]
        ex, ey = ground.edges[k, 2] - ax, ground.edges[k, 3] - ay
        wx, wy = x - ax, y - ay
        t = (wx * ex + wy * ey) / (ex * ex + ey * ey)
        t = min(max(t, 0.0), 1.0)
        dx, dy = wx - t * ex, wy - t * ey
        nearest = min(nearest, dx * dx + dy * dy)
        vx, vy = ax - px, ay - py
        ends_apart = (ux * vy - uy * vx > 0.0) != (ux * (vy + ey) - uy * (vx + ex) > 0.0)
        if ends_apart and (ey * vx - ex * vy > 0.0) != (ex * wy - ey * wx > 0.0):
            is_inside = not is_inside
    return math.sqrt(nearest) if is_inside else -math.sqrt(nearest)


# ---- discs -----------------------------------------------------------------------------------------------------


@kernel
def _disc_grid(width, height, reach, largest, capacity, squares_at_most):
    """Make an empty grid that reaches far enough round the area for every search."""
    side = reach
    while ((width + 2.0 * reach) / side + 3.0) * ((height + 2.0 * reach) / side + 3.0) > squares_at_most:
        side *= 2.0
    cols = int((width + 2.0 * reach) / side) + 3
    rows = int((height + 2.0 * reach) / side) + 3
    heads = np.full(cols * rows, -1, np.int32)
    start = -reach - side
    return Discs(np.empty((capacity, 3)), np.empty(capacity, np.int32), heads, start, start, side, cols, largest)


@kernel
def _add_disc(discs, index, x, y, radius):
    """Add a disc; return the discs, which are others than before where they had to grow."""
    if index == len(discs.following):
        xyr = np.empty((2 * index, 3))
        xyr[:index] = discs.xyr
        following = np.empty(2 * index, np.int32)
        following[:index] = discs.following
        discs = Discs(xyr, following, discs.heads, discs.x0, discs.y0, discs.side, discs.cols, discs.largest)
    discs.xyr[index, 0] = x
    discs.xyr[index, 1] = y
    discs.xyr[index, 2] = radius
    square = int((y - discs.y0) / discs.side) * discs.cols + int((x - discs.x0) / discs.side)
    discs.following[index] = discs.heads[square]
    discs.heads[square] = index
    return discs


@kernel
def _clearance(x, y, most, enough, discs):
    """Return the clearance of a point, at most `most`, and the disc that sets it, -1 if none does.

    The search ends at the first disc that leaves less than `enough`.
    """
    reach = most + discs.largest
    first_col = int((x - reach - discs.x0) / discs.side)
    last_col = int((x + reach - discs.x0) / discs.side)
    clearance, nearest = most, -1
    for row in range(int((y - reach - discs.y0) / discs.side), int((y + reach - discs.y0) / discs.side) + 1):
        for square in range(row * discs.cols + first_col, row * discs.cols + last_col + 1):
            k = discs.heads[square]
            while k >= 0:
                dx, dy = x - discs.xyr[k, 0], y - discs.xyr[k, 1]
                limit = clearance + discs.xyr[k, 2]
                apart = dx * dx + dy * dy
                if apart < limit * limit:
                    clearance, nearest = math.sqrt(apart) - discs.xyr[k, 2], k
                    if clearance < enough:
                        return clearance, nearest
                k = discs.following[k]
    return clearance, nearest


# ---- cells -----------------------------------------------------------------------------------------------------


@kernel
def _bucket(bound, top, stop):
    """Return the class of a bound: 0 for what takes the largest plant, then in geometric steps down to the stop."""
    if bound >= top:
        return 0
    share = (bound - stop) / (top - stop)
    return BUCKETS - 1 if share < SMALLEST_SHARE else 1 - int(BUCKETS_A_HALVING * math.log2(share))


@kernel
def _bucket_top(bucket, top, stop):
    """Return the largest bound of a bucket."""
    return top if bucket < 2 else stop + (top - stop) * 2.0 ** ((1 - bucket) / BUCKETS_A_HALVING)


@kernel
def _move_down(cells, ends, place, bucket, target):
    """Move a cell to a later bucket, or out of the list when target is BUCKETS."""
    for b in range(bucket, target):
        last = ends[b] - 1
        for k in range(4):
            cells[place, k], cells[last, k] = cells[last, k], cells[place, k]
        place = last
        ends[b] = last


@kernel
def _in_order(found, count, top, stop):
    """Put cells in the order of their buckets; return them and each bucket's end."""
    ends = np.zeros(BUCKETS + 1, np.int64)
    for k in range(count):
        ends[_bucket(found[k, 2], top, stop) + 1] += 1
    ends = np.cumsum(ends)
    cursor = ends.copy()
    cells = np.empty((count, 4))
    for k in range(count):
        b = _bucket(found[k, 2], top, stop)
        cells[cursor[b]] = found[k]
        cursor[b] += 1
    return cells, ends[1:]


@kernel
def _try_cell(found, count, x, y, bound, inside, side, ground, discs, stop):
    """Append a cell if it may hold a plant; return the new count."""
    half = side * math.sqrt(0.5)
    if inside == 0.0:
        depth = _depth(x, y, ground)
        if depth + half < ground.guard:
            return count
        if depth - half >= ground.guard:
            inside = 1.0
    bound = min(bound, _clearance(x, y, bound, stop - half, discs)[0] + half)
    if bound < stop:
        return count
    found[count, 0] = x
    found[count, 1] = y
    found[count, 2] = bound
    found[count, 3] = inside
    return count + 1


@kernel
def _first_cells(ground, discs, top, stop):
    count = 0
    for square in range(ground.cols * ground.rows):
        count += ground.starts[square] != ground.starts[square + 1] or ground.inside[square] != 0
    found = np.empty((count, 4))
    count = 0
    for row in range(ground.rows):
        for col in range(ground.cols):
            square = row * ground.cols + col
            inside = 0.0
            if ground.starts[square] == ground.starts[square + 1]:
                if ground.inside[square] == 0:
                    continue
                inside = 1.0
            x = ground.x0 + (col + 0.5) * ground.side
            y = ground.y0 + (row + 0.5) * ground.side
            count = _try_cell(found, count, x, y, top, inside, ground.side, ground, discs, stop)
    return _in_order(found, count, top, stop)


@kernel
def _split(cells, count, side, ground, discs, top, stop):
    """Split every cell in four and keep what may hold a plant; `side` is the old one."""
    found = np.empty((4 * count, 4))
    n = 0
    half, quarter = side * math.sqrt(0.5), 0.25 * side
    for k in range(count):
        x, y, bound, inside = cells[k, 0], cells[k, 1], cells[k, 2], cells[k, 3]
        bound = min(bound, _clearance(x, y, bound, stop - half, discs)[0] + half)
        if bound < stop:
            continue
        for j in range(4):
            child_x = x - quarter if j % 2 == 0 else x + quarter
            child_y = y - quarter if j < 2 else y + quarter
            n = _try_cell(found, n, child_x, child_y, bound, inside, 0.5 * side, ground, discs, stop)
    return _in_order(found, n, top, stop)


@kernel
def _open_cells(ground, discs, top, stop, finest):
    """Return the cells that may hold a plant, their buckets' ends and their side, split down to a side to start at."""
    cells, ends = _first_cells(ground, discs, top, stop)
    side = ground.side
    while side > 1.5 * finest and ends[-1] > 0:
        cells, ends = _split(cells, ends[-1], side, ground, discs, top, stop)
        side *= 0.5
    return cells, ends, side


@kernel
def _throw(cell, side, wanted, top, ground, discs, stream):
    """Choose a point of a cell; return it with its clearance, -inf outside the area, and the disc that sets it."""
    x = cell[0] + (_uniform(stream) - 0.5) * side
    y = cell[1] + (_uniform(stream) - 0.5) * side
    if cell[3] == 0.0 and _depth(x, y, ground) < ground.guard:
        return x, y, -np.inf, -1
    clearance, nearest = _clearance(x, y, top, wanted, discs)
    return x, y, clearance, nearest


@kernel
def _look_again(cells, ends, place, bucket, side, near, discs, top, stop):
    """Renew a cell's bound, and its place in the list, after a miss by a disc; return whether it was dropped."""
    half = side * math.sqrt(0.5)
    x, y, bound = cells[place, 0], cells[place, 1], cells[place, 2]
    if near >= 0:
        bound = min(bound, math.hypot(x - discs.xyr[near, 0], y - discs.xyr[near, 1]) - discs.xyr[near, 2] + half)
    if bound >= stop:
        bound = min(bound, _clearance(x, y, top, stop - half, discs)[0] + half)
        cells[place, 2] = bound
    target = BUCKETS if bound < stop else _bucket(bound, top, stop)
    _move_down(cells, ends, place, bucket, target)
    return target == BUCKETS


# ---- the two laws ----------------------------------------------------------------------------------------------


@kernel
def _fill_kept(ground, discs, count, law, size, stream, most):
    """Place radii that are drawn once, where they fit, until no clearance reaches the stop radius.

    Where the stop radius is the mean, the next plant is a spread d first. A place with clearance mean + d is looked
    for; if one is found, a coin decides between mean + d, set there, and mean - d, set anywhere with clearance
    mean. If none is found, a place with clearance mean is chosen and d is drawn within what it allows.
    """
    top, stop = law.mean + law.width, law.stop
    by_spread = law.width > 0.0 and stop == law.mean
    cells, ends, side = _open_cells(ground, discs, top, stop, CELL_SIDE * law.mean)
    area_at_start = ends[-1] * side * side
    already = count
    proposals, misses, refusals = 0, 0.0, 0.0
    late, spread, radius = 0.0, 0.0, law.mean
    turn = _uniform(stream)  # spreads are spaced by the golden section, so that few of them show the whole law
    surplus = 0.0  # of all radii over as many means
    pull = min(size / MANY_PLANTS, 1.0) / MEMORY
    wanted = -1.0  # clearance that is looked for; negative while the next plant is not drawn yet
    searching = False  # for a place that takes the larger plant of a spread
    nearby = False  # the spread is drawn after the place
    while ends[-1] > 0:
        if misses > SWEEP_SHARE * ends[-1] + 8.0:
            misses = 0.0
            if 0.5 * side < SMALLEST_CELL_M:
                break
            cells, ends = _split(cells, ends[-1], side, ground, discs, top, stop)
            side *= 0.5
            continue
        if wanted < 0.0:
            wanted, searching, nearby, refusals = stop, False, False, 0.0
            if by_spread:
                late = 1.0 - ends[-1] * side * side / area_at_start
                late += 0.5 / size * (1.0 - late)
                turn = (turn + GOLDEN_TURN) % 1.0
                spread = _spread_at(_spread_quantile(turn, late, law.order), law)
                wanted, searching = law.mean + spread, True
            elif law.width > 0.0:
                radius = _radius_up_to(top, law, stream)
        choice = ends[_bucket(wanted, top, stop)]
        if searching and (choice == 0 or refusals > PATIENCE):
            wanted, searching, nearby = stop, False, True
            continue
        proposals += 1
        place = int(_uniform(stream) * choice)
        if cells[place, 2] < wanted:
            refusals += 1.0
            continue
        bucket = 0
        while place >= ends[bucket]:
            bucket += 1
        x, y, clearance, near = _throw(cells[place], side, wanted, top, ground, discs, stream)
        if clearance < wanted:
            if clearance == -np.inf:
                misses += 1.0
                refusals += OUTSIDE_REFUSAL
                continue
            refusals += 1.0
            dropped = _look_again(cells, ends, place, bucket, side, near, discs, top, stop)
            misses += 0.0 if dropped or searching else 1.0
            continue
        if nearby:
            most_share = _share_of_spreads(_share_within(clearance - law.mean, law), late, law.order)
            spread = _spread_at(_spread_quantile(_uniform(stream) * most_share, late, law.order), law)
            spread = min(spread, clearance - law.mean)
        if searching or nearby:
            lean = pull * surplus * spread / law.variance
            larger = 2.0 * _uniform(stream) - 1.0 > lean
            radius = law.mean + spread if larger else law.mean - spread
            if searching and not larger:
                wanted, searching = stop, False
                continue
        if count - already >= most:
            return discs, count, proposals, 0.0, True
        discs = _add_disc(discs, count, x, y, radius)
        count += 1
        surplus += radius - law.mean
        wanted = -1.0
    return discs, count, proposals, ends[-1] * side * side, False


@kernel
def _fill_redrawn(ground, discs, count, law, stream, most):
    """Throw darts, each with a radius of its own, until no clearance reaches the stop radius.

    A cell is chosen by its area times the share of radii that its bucket's bound lets through, a point in it is
    accepted by the share that its clearance lets through over that, and its radius is drawn under its clearance:
    rejection sampling of the next dart that a plain sampler would accept.
    """
    top, stop = law.mean + law.width, law.stop
    cells, ends, side = _open_cells(ground, discs, top, stop, CELL_SIDE * law.mean)
    shares = np.ones(BUCKETS)
    if law.width > 0.0:
        for bucket in range(2, BUCKETS):
            shares[bucket] = _share_below(_bucket_top(bucket, top, stop), law)
    already = count
    proposals, misses = 0, 0.0
    while ends[-1] > 0:
        if misses > SWEEP_SHARE * ends[-1] + 8.0:
            misses = 0.0
            if 0.5 * side < SMALLEST_CELL_M:
                break
            cells, ends = _split(cells, ends[-1], side, ground, discs, top, stop)
            side *= 0.5
            continue
        proposals += 1
        weight = ends[0] * shares[0]
        for b in range(1, BUCKETS):
            weight += (ends[b] - ends[b - 1]) * shares[b]
        chance = _uniform(stream) * weight
        bucket, before = 0, 0
        while ends[bucket] < ends[-1] and chance >= (ends[bucket] - before) * shares[bucket]:
            chance -= (ends[bucket] - before) * shares[bucket]
            before = ends[bucket]
            bucket += 1
        place = min(before + int(chance / shares[bucket]), ends[bucket] - 1)
        x, y, clearance, near = _throw(cells[place], side, stop, top, ground, discs, stream)
        if clearance == -np.inf:
            misses += 1.0
            continue
        fits = clearance >= stop
        if fits and law.width > 0.0:
            fits = _uniform(stream) * shares[bucket] < _share_below(clearance, law)
        if not fits:
            dropped = _look_again(cells, ends, place, bucket, side, near, discs, top, stop)
            misses += 0.0 if dropped else 1.0
            continue
        if count - already >= most:
            return discs, count, proposals, 0.0, True
        radius = _radius_up_to(clearance, law, stream) if law.width > 0.0 else law.mean
        discs = _add_disc(discs, count, x, y, radius)
        count += 1
    return discs, count, proposals, ends[-1] * side * side, False


@kernel
def fill_area(edges, width, height, size, law, kind, guard, fixed, stream, most):
    """Fill one area.

    Parameters
    ----------
    edges : (m, 4), relative to the south-west corner of the area's bounds, which reach to width and height.
    size : plants expected if all had the mean radius, at least 1.
    fixed : (k, 3) x, y, radius of discs that stand already.
    stream : (1,) uint64, advanced.
    most : more plants than this are refused.

    Returns
    -------
    (n, 3) x, y, radius; proposals; ground given up in m2; state.
    """
    top = law.mean + law.width
    largest = top
    for k in range(len(fixed)):
        largest = max(largest, fixed[k, 2])
    reach = top + largest
    squares_at_most = 4096.0 + 16.0 * (size + len(edges) + len(fixed))

    side = min(CELL_SIDE * law.mean, max(width, height))
    while (width / side + 2.0) * (height / side + 2.0) > squares_at_most:
        side *= 2.0
    ground = _lay_out(edges, width, height, side, guard)
    discs = _disc_grid(width, height, reach, largest, int(size) + 16 + len(fixed), squares_at_most)
    standing = 0
    for k in range(len(fixed)):
        x, y = fixed[k, 0], fixed[k, 1]
        if -reach < x < width + reach and -reach < y < height + reach:
            discs = _add_disc(discs, standing, x, y, fixed[k, 2])
            standing += 1

    if kind == KEPT:
        first = Law(law.mean, law.width, law.scale, law.variance, max(law.stop, law.mean), law.order)
        discs, count, proposals, given_up, refused = _fill_kept(ground, discs, standing, first, size, stream, most)
        if law.stop < law.mean and not refused:
            room = most - (count - standing)
            discs, count, more, given_up, refused = _fill_redrawn(ground, discs, count, law, stream, room)
            proposals += more
    else:
        discs, count, proposals, given_up, refused = _fill_redrawn(ground, discs, standing, law, stream, most)
    if refused:
        return np.empty((0, 3)), proposals, 0.0, REFUSED
    return discs.xyr[standing:count].copy(), proposals, given_up, SATURATED if count > standing else EMPTY


@kernel
def fill_areas(edges, offsets, extent, sizes, refused, laws, kind, guard, fixed, fixed_offsets, keys, most):
    """Fill many areas one after the other.

    Parameters
    ----------
    edges : (m, 4), offsets : (n + 1,), extent : (n, 2)
        As `polygons.EdgeTable` has them.
    sizes : (n,) plants expected, at least 1.
    refused : (n,) bool, areas too large to begin with.
    laws : (n, 6), the fields of `Law`.
    fixed : (k, 3), fixed_offsets : (n + 1,)
        Discs that stand already, relative to each area's origin.
    keys : (n,) uint64.

    Returns
    -------
    (p, 3) x, y, radius relative to each area's origin; (n,) plants, proposals, ground given up in m2, state.
    """
    count = len(keys)
    plants = np.zeros(count, np.int64)
    proposals = np.zeros(count, np.int64)
    given_up = np.zeros(count)
    state = np.full(count, EMPTY)
    placed = np.empty((1024, 3))
    end = 0
    stream = np.empty(1, np.uint64)
    for i in range(count):
        if refused[i]:
            state[i] = REFUSED
            continue
        if offsets[i] == offsets[i + 1]:
            continue
        stream[0] = keys[i] ^ np.uint64(STREAM_SALT)
        high = np.uint64(_uniform(stream) * 2.0**32)
        stream[0] = (high << np.uint64(32)) | np.uint64(_uniform(stream) * 2.0**32)
        law = Law(laws[i, 0], laws[i, 1], laws[i, 2], laws[i, 3], laws[i, 4], laws[i, 5])
        found, proposals[i], given_up[i], state[i] = fill_area(
            edges[offsets[i] : offsets[i + 1]], extent[i, 0], extent[i, 1], sizes[i], law, kind, guard,
            fixed[fixed_offsets[i] : fixed_offsets[i + 1]], stream, most,
        )  # fmt: skip
        plants[i] = len(found)
        if end + len(found) > len(placed):
            larger = np.empty((2 * (end + len(found)), 3))
            larger[:end] = placed[:end]
            placed = larger
        placed[end : end + len(found)] = found
        end += len(found)
    return placed[:end].copy(), plants, proposals, given_up, state
