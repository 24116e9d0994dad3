"""Straight skeletons of small polygons, turned to faces of hip and gable roofs.

The outline of a polygon moves inward at unit speed, each edge along its normal; the corners of what is left draw the
skeleton, and each edge sweeps its roof face, whose points lie as high as they are far from the edge. Corners end where
an edge between two of them has shrunk to nothing, or where a reflex corner meets an edge and cuts what is left in two.
Nothing is believed: a roof counts only if each face is flat, all triangles are upright, and they cover the polygon.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

NEAR_M = 1e-6  # nodes nearer than this are one
STILL = 1e-12  # speeds below this are none
PARALLEL = 1e-11  # edges whose normals' product is within this of -1 run along each other
FLAT_M = 1e-5  # how far a node may be off the plane of its face
AREA_SHARE = 1e-7  # how much of the area may be missing
GABLE_SQUARE = 0.9  # sine of the angles that a gable makes with the walls beside it, at least
GABLE_RISE = 1.3  # how much higher than the hip's a gable's peak may be


@njit(cache=True, nogil=True, error_model="numpy")
def pitch_roofs(xy, first, gable_width_m):
    """Make roof faces for polygons without holes.

    Parameters
    ----------
    xy
        (m, 2) corners, counter-clockwise, no two alike, none repeated at the end.
    first
        (p + 1,) offsets.
    gable_width_m
        A wall no wider than this gets a gable instead of a hip, where its roof face is a triangle.

    Returns
    -------
    corners (t, 3, 3)
        x, y and the distance from the eave of each triangle's corners, counter-clockwise.
    edge (t,)
        Whose face it is part of, a row of `xy`: the edge from that corner to the next.
    peak (m, 3)
        Tip of the gable on each edge: x, y and distance as above; the distance is 0 where there is none.
    done (p,)
        False where no roof could be made: such polygons have no triangles.
    """
    count = len(first) - 1
    corners = np.empty((6 * len(xy) + 6, 3, 3))
    edge = np.empty(len(corners), dtype=np.int64)
    peak = np.zeros((len(xy), 3))
    done = np.zeros(count, dtype=np.bool_)
    used = 0
    for p in range(count):
        outline = xy[first[p] : first[p + 1]]
        n = len(outline)
        if n < 3:
            continue
        nodes, arcs, fine = _skeleton(outline)
        if not fine:
            continue
        face, sizes, fine = _faces(outline, nodes, arcs)
        if not fine:
            continue
        tips = _gables(outline, nodes, face, sizes, gable_width_m)
        begin, area = used, 0.0
        for e in range(n):
            made = _cut_ears(nodes, face[e], sizes[e], corners, used)
            if made < 0:
                fine = False
                break
            for t in range(used, used + made):
                edge[t] = first[p] + e
                area += 0.5 * _cross(corners[t, 0], corners[t, 1], corners[t, 2])
            used += made
        whole = _area(outline)
        if not fine or abs(area - whole) > AREA_SHARE * whole:
            used = begin
            continue
        peak[first[p] : first[p + 1]] = tips
        done[p] = True
    return corners[:used].copy(), edge[:used].copy(), peak, done


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])


@njit(cache=True, nogil=True, error_model="numpy")
def _area(outline):
    total = 0.0
    for i in range(len(outline)):
        total += _cross(outline[0], outline[i], outline[(i + 1) % len(outline)])
    return 0.5 * total


@njit(cache=True, nogil=True, error_model="numpy")
def _axes(outline):
    """Return (n, 4) direction of each edge and its normal inward."""
    n = len(outline)
    axes = np.empty((n, 4))
    for i in range(n):
        dx, dy = outline[(i + 1) % n, 0] - outline[i, 0], outline[(i + 1) % n, 1] - outline[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        axes[i, 0], axes[i, 1], axes[i, 2], axes[i, 3] = dx / length, dy / length, -dy / length, dx / length
    return axes


@njit(cache=True, nogil=True, error_model="numpy")
def _skeleton(outline):
    """Return nodes (k, 3), those of the outline first, arcs (a, 4) and whether it worked.

    A node is x, y and time; an arc runs from a node to a node with one edge's face on its left and another's on its
    right. `wave` holds the moving corners: x, y, time and velocity at which they started; `links` their edges to the
    left and right, the corner before and after, the node where they started, and whether they still move.
    """
    n = len(outline)
    axes = _axes(outline)
    wave = np.empty((8 * n + 8, 5))
    links = np.zeros((len(wave), 6), dtype=np.int64)
    nodes = np.zeros((len(wave), 3))
    arcs = np.empty((2 * len(wave), 4), dtype=np.int64)
    counts = np.array([n, n, 0])  # corners, nodes, arcs
    for i in range(n):
        nodes[i, :2] = outline[i]
        _start(i, outline[i, 0], outline[i, 1], 0.0, (i - 1) % n, i, (i - 1) % n, (i + 1) % n, i, wave, links, axes)
    now = 0.0
    for _ in range(4 * n):
        best, first, second = np.inf, -1, -1
        moving = False
        for v in range(counts[0]):
            if not links[v, 5]:
                continue
            moving = True
            when = _shrunk(v, links[v, 3], now, wave, links, axes)
            if when < best:
                best, first, second = when, v, -1
        if not moving:
            return nodes[: counts[1]], arcs[: counts[2]], True
        for v in range(counts[0]):
            i, j = links[v, 0], links[v, 1]
            if not links[v, 5] or axes[i, 0] * axes[j, 1] - axes[i, 1] * axes[j, 0] > -STILL:
                continue
            a = links[v, 3]
            while links[a, 3] != v:
                k = links[a, 1]
                if k != i and k != j:
                    when = _meets(v, a, now, outline, wave, links, axes)
                    if when < best - NEAR_M * NEAR_M:
                        best, first, second = when, v, a
                a = links[a, 3]
        if first < 0 or counts[0] + 6 > len(wave):
            break
        now = best
        if second < 0:
            fine = _collapse(first, now, wave, links, nodes, arcs, counts, axes)
        else:
            fine = _split(first, second, now, wave, links, nodes, arcs, counts, axes)
        if not fine:
            break
    return nodes[: counts[1]], arcs[: counts[2]], False


@njit(cache=True, nogil=True, error_model="numpy")
def _start(v, x, y, now, left, right, before, after, node, wave, links, axes):
    """Set off a corner between two edges."""
    share = 1.0 + axes[left, 2] * axes[right, 2] + axes[left, 3] * axes[right, 3]
    wave[v, 0], wave[v, 1], wave[v, 2] = x, y, now
    wave[v, 3] = (axes[left, 2] + axes[right, 2]) / share if share > PARALLEL else 0.0
    wave[v, 4] = (axes[left, 3] + axes[right, 3]) / share if share > PARALLEL else 0.0
    links[v, 0], links[v, 1], links[v, 2], links[v, 3], links[v, 4], links[v, 5] = left, right, before, after, node, 1


@njit(cache=True, nogil=True, error_model="numpy")
def _place(v, now, wave):
    return wave[v, 0] + wave[v, 3] * (now - wave[v, 2]), wave[v, 1] + wave[v, 4] * (now - wave[v, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def _shrunk(v, w, now, wave, links, axes):
    """Return when the edge between a corner and the next has no length left; infinite if it grows."""
    dx, dy = axes[links[v, 1], 0], axes[links[v, 1], 1]
    (vx, vy), (wx, wy) = _place(v, now, wave), _place(w, now, wave)
    length = (wx - vx) * dx + (wy - vy) * dy
    growth = (wave[w, 3] - wave[v, 3]) * dx + (wave[w, 4] - wave[v, 4]) * dy
    if growth < -STILL:
        return now + max(length, 0.0) / -growth
    return now if length < NEAR_M and growth < STILL else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(v, a, now, outline, wave, links, axes):
    """Return when a reflex corner meets the edge that starts at corner `a`; infinite if it passes beside it."""
    k, b = links[a, 1], links[a, 3]
    nx, ny = axes[k, 2], axes[k, 3]
    x, y = _place(v, now, wave)
    gap = (x - outline[k, 0]) * nx + (y - outline[k, 1]) * ny - now
    closing = 1.0 - wave[v, 3] * nx - wave[v, 4] * ny
    if closing < STILL or gap < -NEAR_M:
        return np.inf
    when = now + max(gap, 0.0) / closing
    (x, y), (ax, ay), (bx, by) = _place(v, when, wave), _place(a, when, wave), _place(b, when, wave)
    dx, dy = axes[k, 0], axes[k, 1]
    if (x - ax) * dx + (y - ay) * dy < -NEAR_M or (bx - x) * dx + (by - y) * dy < -NEAR_M:
        return np.inf
    return when


@njit(cache=True, nogil=True, error_model="numpy")
def _node(x, y, now, nodes, counts):
    """Return the node at a place and time, a new one if there is none."""
    for i in range(counts[1]):
        if abs(nodes[i, 0] - x) < NEAR_M and abs(nodes[i, 1] - y) < NEAR_M and abs(nodes[i, 2] - now) < NEAR_M:
            return i
    nodes[counts[1], 0], nodes[counts[1], 1], nodes[counts[1], 2] = x, y, now
    counts[1] += 1
    return counts[1] - 1


@njit(cache=True, nogil=True, error_model="numpy")
def _end(v, node, links, arcs, counts):
    """Stop a corner at a node; its path is an arc."""
    links[v, 5] = 0
    if links[v, 4] != node:
        arcs[counts[2], 0], arcs[counts[2], 1] = links[v, 4], node
        arcs[counts[2], 2], arcs[counts[2], 3] = links[v, 0], links[v, 1]
        counts[2] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _collapse(v, now, wave, links, nodes, arcs, counts, axes):
    """Let the edge between a corner and the next vanish, where the slower of both is."""
    w = links[v, 3]
    slow = v if wave[v, 3] ** 2 + wave[v, 4] ** 2 <= wave[w, 3] ** 2 + wave[w, 4] ** 2 else w
    x, y = _place(slow, now, wave)
    return _vanish(v, w, x, y, now, wave, links, nodes, arcs, counts, axes)


@njit(cache=True, nogil=True, error_model="numpy")
def _vanish(v, w, x, y, now, wave, links, nodes, arcs, counts, axes):
    """Let the edge between two corners vanish at a place, and all others that then lie along each other."""
    while v >= 0:
        node = _node(x, y, now, nodes, counts)
        _end(v, node, links, arcs, counts)
        _end(w, node, links, arcs, counts)
        z = counts[0]
        counts[0] += 1
        if counts[0] >= len(wave):
            return False
        before, after = links[v, 2], links[w, 3]
        _start(z, x, y, now, links[v, 0], links[w, 1], before, after, node, wave, links, axes)
        links[before, 3], links[after, 2] = z, z
        v, w, x, y = _settle(z, now, wave, links, nodes, arcs, counts, axes)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _settle(z, now, wave, links, nodes, arcs, counts, axes):
    """Close a loop of two edges; or name an edge that vanishes now, since the corner is between edges along each other.

    Returns
    -------
    The corners at both ends of that edge and where they meet; -1 for none.
    """
    before, after = links[z, 2], links[z, 3]
    left, right = links[z, 0], links[z, 1]
    (bx, by), (ax, ay) = _place(before, now, wave), _place(after, now, wave)
    if before == after:
        node = _node(ax, ay, now, nodes, counts)
        _end(z, node, links, arcs, counts)
        _end(after, node, links, arcs, counts)
        return -1, -1, 0.0, 0.0
    if 1.0 + axes[left, 2] * axes[right, 2] + axes[left, 3] * axes[right, 3] > PARALLEL:
        return -1, -1, 0.0, 0.0
    x, y = wave[z, 0], wave[z, 1]
    if (ax - x) ** 2 + (ay - y) ** 2 <= (bx - x) ** 2 + (by - y) ** 2:
        return z, after, ax, ay
    return before, z, bx, by


@njit(cache=True, nogil=True, error_model="numpy")
def _split(v, a, now, wave, links, nodes, arcs, counts, axes):
    """Let a reflex corner cut the edge after corner `a`, so that two loops remain."""
    x, y = _place(v, now, wave)
    node = _node(x, y, now, nodes, counts)
    k, b = links[a, 1], links[a, 3]
    i, j, before, after = links[v, 0], links[v, 1], links[v, 2], links[v, 3]
    _end(v, node, links, arcs, counts)
    one, two = counts[0], counts[0] + 1
    counts[0] += 2
    _start(one, x, y, now, i, k, before, b, node, wave, links, axes)
    _start(two, x, y, now, k, j, a, after, node, wave, links, axes)
    links[before, 3], links[b, 2] = one, one
    links[a, 3], links[after, 2] = two, two
    for z in (one, two):
        v, w, x, y = _settle(z, now, wave, links, nodes, arcs, counts, axes)
        if not _vanish(v, w, x, y, now, wave, links, nodes, arcs, counts, axes):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _faces(outline, nodes, arcs):
    """Walk round each edge's face: (n, k) nodes, the edge's ends first, (n,) how many, and whether all is sound."""
    n = len(outline)
    face = np.empty((n, len(arcs) + 2), dtype=np.int64)
    sizes = np.zeros(n, dtype=np.int64)
    axes = _axes(outline)
    for e in range(n):
        face[e, 0], face[e, 1], size = e, (e + 1) % n, 2
        own = 0
        for a in range(len(arcs)):
            own += (arcs[a, 2] == e) + (arcs[a, 3] == e)
        here = face[e, 1]
        for _ in range(own):
            then = -1
            for a in range(len(arcs)):
                if arcs[a, 2] == e and arcs[a, 0] == here:
                    found = arcs[a, 1]
                elif arcs[a, 3] == e and arcs[a, 1] == here:
                    found = arcs[a, 0]
                else:
                    continue
                if then >= 0:
                    return face, sizes, False  # the face touches itself
                then = found
            if then < 0:
                return face, sizes, False
            here = then
            if here == e:
                break
            face[e, size] = here
            size += 1
        if here != e or size != own + 1:
            return face, sizes, False
        for k in range(size):
            x, y, t = nodes[face[e, k]]
            away = (x - outline[e, 0]) * axes[e, 2] + (y - outline[e, 1]) * axes[e, 3]
            if abs(away - t) > FLAT_M:
                return face, sizes, False
        sizes[e] = size
    return face, sizes, True


@njit(cache=True, nogil=True, error_model="numpy")
def _gables(outline, nodes, face, sizes, width_m):
    """Turn narrow triangular hips to gables: their tip moves out over the wall, their face goes; (n, 3) tips."""
    n = len(outline)
    axes = _axes(outline)
    tips = np.zeros((n, 3))
    for e in range(n):
        before, after = (e - 1) % n, (e + 1) % n
        x, y = outline[after, 0] - outline[e, 0], outline[after, 1] - outline[e, 1]
        width = np.sqrt(x * x + y * y)
        if sizes[e] != 3 or width > width_m or tips[before, 2] > 0.0 or tips[after, 2] > 0.0:
            continue
        rise = axes[e, 0] * axes[before, 2] + axes[e, 1] * axes[before, 3]
        fall = -axes[e, 0] * axes[after, 2] - axes[e, 1] * axes[after, 3]
        if rise < GABLE_SQUARE or fall < GABLE_SQUARE:
            continue
        tip, sharing = face[e, 2], 0
        for other in range(n):
            for k in range(sizes[other]):
                sharing += face[other, k] == tip
        along = width * fall / (rise + fall)
        if sharing != 3 or along * rise > GABLE_RISE * nodes[tip, 2]:
            continue
        tips[e, 0] = outline[e, 0] + along * axes[e, 0]
        tips[e, 1] = outline[e, 1] + along * axes[e, 1]
        tips[e, 2] = along * rise
        nodes[tip] = tips[e]
        sizes[e] = 0
    return tips


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_ears(nodes, face, size, corners, used):
    """Cut a face into triangles, the best-shaped ear first; returns how many, or -1 if it cannot be done."""
    ring = face[:size].copy()
    made = 0
    while size >= 3:
        best, ear = 0.0, -1
        for k in range(size):
            a, b, c = nodes[ring[(k - 1) % size]], nodes[ring[k]], nodes[ring[(k + 1) % size]]
            area = _cross(a, b, c)
            if area <= 0.0:
                continue
            longest = max((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2, (c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2)
            longest = max(longest, (a[0] - c[0]) ** 2 + (a[1] - c[1]) ** 2)
            shape = area / longest
            if shape <= best:
                continue
            free = True
            for m in range(size):
                if m != k and m != (k - 1) % size and m != (k + 1) % size:
                    q = nodes[ring[m]]
                    if _cross(a, b, q) >= 0.0 and _cross(b, c, q) >= 0.0 and _cross(c, a, q) >= 0.0:
                        free = False
                        break
            if free:
                best, ear = shape, k
        if ear < 0 or used + made >= len(corners):
            return -1
        corners[used + made, 0] = nodes[ring[(ear - 1) % size]]
        corners[used + made, 1] = nodes[ring[ear]]
        corners[used + made, 2] = nodes[ring[(ear + 1) % size]]
        made += 1
        for m in range(ear, size - 1):
            ring[m] = ring[m + 1]
        size -= 1
    return made
