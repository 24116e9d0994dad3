"""Delaunay triangulation of points on a fine grid, by incremental insertion with predicates that do not err.

Half-edges live in flat arrays: half-edge ``4 t + k``, k = 0, 1, 2, of triangle ``t`` starts at ``origin[4 t + k]``
and lies opposite ``twin[4 t + k]`` of the neighbour; the fourth place is not used, so that a half-edge's bits tell its
triangle. Triangles run counter-clockwise. The outside is filled with ghost triangles that share a vertex at infinity,
which has a number of its own, so that every half-edge has a twin.

Coordinates must be multiples of `GRID_M` below 2**20 m: then differences are exact, the orientation test is exact,
and the in-circle test errs only toward "no" for points nearer to the circle than 1e-29 of its size. An edge is
flipped only where the test says yes, every flip is one that a Delaunay triangulation needs, and so the insertion
ends with a valid triangulation whatever the ties (Lawson 1977; Guibas and Stolfi 1985).
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from numba import njit

GRID_M = 2.0**-24
ORIENT_FILTER = 3.4e-16
CIRCLE_FILTER = 1.2e-15
CIRCLE_EXTENDED_FILTER = 1e-29
SPLITTER = 134217729.0


@njit(cache=True, nogil=True, inline="always")
def snapped(value):
    """Round a coordinate to the grid."""
    return round(value / GRID_M) * GRID_M


@njit(cache=True, nogil=True)
def _two_product(a, b):
    """Return a product and its rounding error (Dekker 1971)."""
    product = a * b
    c = SPLITTER * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = SPLITTER * b
    b_high = c - (c - b)
    b_low = b - b_high
    error = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
    return product, error


@njit(cache=True, nogil=True)
def _sum2(a, a_low, b, b_low):
    """Add two double-double numbers."""
    high = a + b
    part = high - a
    low = (a - (high - part)) + (b - part) + a_low + b_low
    total = high + low
    return total, low - (total - high)


@njit(cache=True, nogil=True)
def _product2(a, a_low, b, b_low):
    """Multiply two double-double numbers."""
    high, low = _two_product(a, b)
    low += a * b_low + a_low * b
    total = high + low
    return total, low - (total - high)


@njit(cache=True, nogil=True)
def orientation(ax, ay, bx, by, cx, cy):
    """Return a number with the sign of the turn a, b, c: positive to the left, 0 straight."""
    left = (ax - cx) * (by - cy)
    right = (ay - cy) * (bx - cx)
    turn = left - right
    if abs(turn) > ORIENT_FILTER * (abs(left) + abs(right)):
        return turn
    left, left_low = _two_product(ax - cx, by - cy)
    right, right_low = _two_product(ay - cy, bx - cx)
    return (left - right) + (left_low - right_low)


@njit(cache=True, nogil=True)
def in_circle(ax, ay, bx, by, cx, cy, dx, dy):
    """Tell whether d lies inside the circle through a, b, c, given counter-clockwise."""
    adx, ady, bdx, bdy, cdx, cdy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    bc, cb, ca, ac, ab, ba = bdx * cdy, cdx * bdy, cdx * ady, adx * cdy, adx * bdy, bdx * ady
    a_lift, b_lift, c_lift = adx * adx + ady * ady, bdx * bdx + bdy * bdy, cdx * cdx + cdy * cdy
    value = a_lift * (bc - cb) + b_lift * (ca - ac) + c_lift * (ab - ba)
    size = a_lift * (abs(bc) + abs(cb)) + b_lift * (abs(ca) + abs(ac)) + c_lift * (abs(ab) + abs(ba))
    if abs(value) > CIRCLE_FILTER * size:
        return value > 0
    total, total_low = _lifted_minor(adx, ady, bdx, bdy, cdx, cdy)
    more, more_low = _lifted_minor(bdx, bdy, cdx, cdy, adx, ady)
    total, total_low = _sum2(total, total_low, more, more_low)
    more, more_low = _lifted_minor(cdx, cdy, adx, ady, bdx, bdy)
    total, total_low = _sum2(total, total_low, more, more_low)
    return total > CIRCLE_EXTENDED_FILTER * size


@njit(cache=True, nogil=True)
def _lifted_minor(ax, ay, bx, by, cx, cy):
    """Return |a|^2 (b x c) in double-double arithmetic."""
    x2, x2_low = _two_product(ax, ax)
    y2, y2_low = _two_product(ay, ay)
    lift, lift_low = _sum2(x2, x2_low, y2, y2_low)
    left, left_low = _two_product(bx, cy)
    right, right_low = _two_product(by, cx)
    cross, cross_low = _sum2(left, left_low, -right, -right_low)
    return _product2(lift, lift_low, cross, cross_low)


@njit(cache=True, nogil=True, inline="always")
def following(half_edge):
    """Return the next half-edge around the triangle."""
    return half_edge - 2 if half_edge & 3 == 2 else half_edge + 1


@njit(cache=True, nogil=True, inline="always")
def previous(half_edge):
    """Return the half-edge before around the triangle."""
    return half_edge + 2 if half_edge & 3 == 0 else half_edge - 1


@njit(cache=True, nogil=True, inline="always")
def _pair(twin, one, other):
    twin[one] = other
    twin[other] = one


@njit(cache=True, nogil=True)
def start_triangulation(x, y, a, b, c, ghost, origin, twin, start):
    """Make the first triangle and its three ghosts; a, b, c must not lie on a line.

    Parameters
    ----------
    ghost
        The number of the vertex at infinity.
    origin, twin, start
        Arrays to fill: half-edges, and one half-edge that starts at each vertex (-1 where none does).

    Returns
    -------
    The number of triangles.
    """
    if orientation(x[a], y[a], x[b], y[b], x[c], y[c]) < 0:
        b, c = c, b
    corners = (a, b, c)
    for k in range(3):
        u, w = corners[k], corners[(k + 1) % 3]
        origin[k] = u
        start[u] = k
        outer = 4 * (k + 1)
        origin[outer] = w
        origin[outer + 1] = u
        origin[outer + 2] = ghost
        _pair(twin, k, outer)
        _pair(twin, outer + 1, 4 * ((k + 2) % 3 + 1) + 2)
    start[ghost] = 6
    return 4


@njit(cache=True, nogil=True)
def _locate(x, y, p, ghost, origin, twin, hint, count):
    """Walk to the triangle that holds a point; return a half-edge of it, and whether the point is on that edge.

    The walk is bounded; where rounding should lead it in circles, every triangle is looked at instead.
    """
    edge = hint
    triangle = edge & ~3
    for k in range(3):
        if origin[triangle + k] == ghost:
            edge = twin[following(triangle + k)]
            break
    px, py = x[p], y[p]
    step = 0
    last = -1
    scan = False
    tests = 3
    while True:
        if scan:
            last += 1
            if last == count:
                return -1, False
            edge = 4 * last
            if origin[edge] == ghost or origin[edge + 1] == ghost or origin[edge + 2] == ghost:
                continue
        onto = -1
        beyond = -1
        triangle = edge & ~3
        for _ in range(tests):
            u, w = origin[edge], origin[following(edge)]
            turn = orientation(x[u], y[u], x[w], y[w], px, py)
            if turn < 0:
                beyond = edge
                break
            if turn == 0:
                onto = edge
            edge = following(edge)
        if beyond < 0:
            if onto >= 0:
                return onto, True
            return triangle, False
        outer = twin[beyond]
        if origin[previous(outer)] == ghost:
            return outer, False
        # a triangle entered through an edge has the point on the right side of it
        edge = following(outer)
        tests = 2
        step += 1
        if not scan and step > 2 * count + 100:
            scan = True
            tests = 3


@njit(cache=True, nogil=True)
def _conflict(x, y, edge, p, ghost, origin):
    """Tell whether a point lies in the circle of the triangle of a half-edge; a ghost's is a half-plane."""
    triangle = edge & ~3
    a, b, c = origin[triangle], origin[triangle + 1], origin[triangle + 2]
    if a == ghost:
        return orientation(x[b], y[b], x[c], y[c], x[p], y[p]) > 0
    if b == ghost:
        return orientation(x[c], y[c], x[a], y[a], x[p], y[p]) > 0
    if c == ghost:
        return orientation(x[a], y[a], x[b], y[b], x[p], y[p]) > 0
    return in_circle(x[a], y[a], x[b], y[b], x[c], y[c], x[p], y[p])


@njit(cache=True, nogil=True)
def _flip(edge, origin, twin, start):
    """Turn the edge a-b of the triangles (a, b, p) and (b, a, q) into q-p; `edge` and its old twin face p after."""
    en, ep = following(edge), previous(edge)
    f = twin[edge]
    fn, fp = following(f), previous(f)
    a, b, p, q = origin[edge], origin[en], origin[ep], origin[fp]
    beyond_en, beyond_fn, beyond_fp = twin[en], twin[fn], twin[fp]
    origin[en] = q
    origin[f] = q
    origin[fn] = b
    origin[fp] = p
    _pair(twin, edge, beyond_fn)
    _pair(twin, f, beyond_fp)
    _pair(twin, fn, beyond_en)
    _pair(twin, en, fp)
    start[a] = edge
    start[b] = fn
    start[q] = f
    start[p] = ep
    return f


@njit(cache=True, nogil=True)
def insert_point(x, y, p, hint, ghost, origin, twin, start, count, stack):
    """Insert a vertex and restore the Delaunay property.

    Parameters
    ----------
    p
        The vertex.
    hint
        A half-edge near it.
    stack
        Room for half-edges to be checked; `2 * len(start) + 8` is enough.

    Returns
    -------
    The new number of triangles, and the vertex at that place: `p`, or the one that was there already, or -1.
    """
    edge, on_edge = _locate(x, y, p, ghost, origin, twin, hint, count)
    if edge < 0:
        return count, -1
    if on_edge:
        u, w, o = origin[edge], origin[following(edge)], origin[previous(edge)]
        for v in (u, w, o):
            if x[v] == x[p] and y[v] == y[p]:
                return count, v
    e0 = edge
    e1, e2 = following(e0), previous(e0)
    a, b, c = origin[e0], origin[e1], origin[e2]
    beyond1, beyond2 = twin[e1], twin[e2]
    t1, t2 = 4 * count, 4 * count + 4
    origin[e2] = p
    origin[t1], origin[t1 + 1], origin[t1 + 2] = b, c, p
    origin[t2], origin[t2 + 1], origin[t2 + 2] = c, a, p
    _pair(twin, t1, beyond1)
    _pair(twin, t2, beyond2)
    _pair(twin, e1, t1 + 2)
    _pair(twin, t1 + 1, t2 + 2)
    _pair(twin, t2 + 1, e2)
    start[a] = e0
    start[b] = t1
    start[c] = t2
    start[p] = e2
    size = 3
    stack[0] = e0
    stack[1] = t1
    stack[2] = t2
    if on_edge:
        stack[0] = _flip(e0, origin, twin, start)
        stack[3] = e0
        size = 4
    while size > 0:
        size -= 1
        edge = stack[size]
        if _conflict(x, y, twin[edge], p, ghost, origin):
            f = _flip(edge, origin, twin, start)
            stack[size] = edge
            stack[size + 1] = f
            size += 2
    return count + 2, p


@njit(cache=True, nogil=True)
def find_half_edge(u, w, origin, twin, start):
    """Return the half-edge from one vertex to another, -1 where the triangulation has none."""
    first = start[u]
    edge = first
    while True:
        if origin[following(edge)] == w:
            return edge
        edge = twin[previous(edge)]
        if edge == first:
            return -1
