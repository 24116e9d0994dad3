"""Skeletons to chains of rings, compiled: the first pass of `wood.py`.

A chain is what is drawn of one axis as one tube: a row of samples, each a place, a radius and a number of sides. A
radius of 0 is a point that closes the tube. Nodes of skeleton s are rows ``first[s]`` to ``first[s + 1]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

SMOOTH = 0.5  # how far a node moves to the middle of its neighbours on the axis, as in pictures
FOOT_DEPTH_M = 0.1  # trunks go on below the ground
FLARE, FLARE_RADII, FLARE_LEAST_M = 0.5, 6.0, 0.05  # a trunk is thicker by this at the ground; up to how many radii
FLARE_RINGS = (0.1, 0.25, 0.5)  # of the flare's height, where the first internode is long enough
COLLAR, COLLAR_END = 1.6, 1.1  # a branch is thicker by these on the axis that bears it, and where it is clear of it
COLLAR_ERRORS = 6.0  # wood has to be this many errors thick for branches to leave it in a bow
CLEAR = 1.5  # how many radii of what bears it a branch takes to be clear of it, as they are inclined
FOOT_COLLAR = 1.3  # a stem is thicker by this at the root than at its first node, at most
BACK, BACK_SHARE = 0.6, 0.7  # how many radii back in what bears it a branch begins, and most of the way back
INSIDE = 0.9  # of the room inside a tube that a branch's first ring takes
FOLLOW_SHARE = 4  # a branch goes on as the axis that ended where it bears one of this many twig ends or more
STUMP_RADII, STUMP_ERRORS = 2.0, 2.0  # an end thicker than so many twig ends and errors is cut off, not pointed
SLIGHT = 0.35  # of a plant's own radius at the root: thicker wood than that is drawn at every level
DOME = ((0.3, 0.7), (0.45, 0.0))  # shape of cut ends: radii ahead, share of the radius
BREAK = 0.45  # share of an internode that two tubes' mitre may take; beyond that the tube ends and another begins
FOLD = -0.99  # cosine of a bend at which no mitre can be
STEP_MIN_M = 5e-4  # what is nearer than this to the sample before counts as the same place
WINDOW = 24  # most samples left out in a row
SAMPLES_A_NODE, CHAINS_A_NODE = 12, 2  # most that a node can come to, all rare cases at once
RADII_KNOWN = 64  # radii of small pipe counts are looked up
ABSENT, PLAIN, FORKED = 0, 1, 2  # whether a node stands, and bears two children or more

# Helpers neither make nor keep arrays: counting references to what they are given takes a third of the time.
BARE: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}


@njit(cache=True, nogil=True, error_model="numpy")
def trace_wood(
    first, parent, xyz, order, birth, death, tip_radius, exponent, season_end, begin, stop, radius_min, error, sides,
    side_radius, inner, outer, texture_m,
):  # fmt: skip
    """Find the chains of skeletons begin to stop.

    `sides` are the numbers of sides to choose from, `side_radius` up to which radius each is round enough, `inner` and
    `outer` the radii of the circles inside and around such a polygon over that of the branch.

    Returns samples (k, 4) of place and radius, the choice of sides (k,), first samples of chains (c + 1,), turns of
    the texture around each (c,), first chains of skeletons (m + 1,), and corners and triangles of each (m, 2).
    """
    largest = 1
    for s in range(begin, stop):
        largest = max(largest, first[s + 1] - first[s])
    most = SAMPLES_A_NODE * (first[stop] - first[begin]) + SAMPLES_A_NODE  # what is never touched costs nothing
    samples, choice = np.empty((most, 4), np.float32), np.empty(most, np.uint8)
    most = CHAINS_A_NODE * (first[stop] - first[begin]) + 1
    chain_first, turns = np.empty(most, np.int64), np.empty(most, np.uint8)
    skeleton_first = np.zeros(stop - begin + 1, np.int64)
    counts = np.zeros((stop - begin, 2), np.int64)
    sample_count = _trace(
        first, parent, xyz, order, birth, death, tip_radius, exponent, season_end, begin, stop, radius_min, error,
        sides, side_radius, inner, outer, texture_m, samples, choice, chain_first, turns, skeleton_first, counts,
        np.empty(largest, np.int32), np.empty(largest, np.int32), np.empty(largest, np.int32),
        np.empty(largest, np.uint8), np.empty((largest, 7)), np.empty((largest + 16, 4)), np.empty(largest, np.int32),
        np.empty(largest, np.int32), np.empty(largest + 16, np.int32), np.empty(largest + 16, np.uint8),
        np.empty(RADII_KNOWN),
    )  # fmt: skip
    chain_count = skeleton_first[-1]
    return (
        samples[:sample_count].copy(), choice[:sample_count].copy(), chain_first[: chain_count + 1].copy(),
        turns[:chain_count].copy(), skeleton_first, counts,
    )  # fmt: skip


@njit(**BARE)
def _trace(
    first, parent, xyz, order, birth, death, tip_radius, exponent, season_end, begin, stop, radius_min, error, sides,
    side_radius, inner, outer, texture_m, samples, choice, chain_first, turns, skeleton_first, counts, pipes, axis,
    thick, state, drawn, path, node, slot, kept, side, known,
):  # fmt: skip
    """Do the work of `trace_wood` in arrays that are there; return the number of samples.

    `drawn` is where a node is drawn, how large a ball fits into the tube there (below 0 where the tube ends, and then
    minus its radius), and how far back in the tube branches begin.
    """
    sample_count, chain_count = 0, 0
    for s in range(begin, stop):
        root, size, season = first[s], first[s + 1] - first[s], season_end[s]
        tip, power = tip_radius[s], 1.0 / exponent[s]
        for count in range(RADII_KNOWN):
            known[count] = tip * np.float64(count) ** power
        if death[root] != 0 and death[root] <= season:
            size = 0
        _survey(parent, order, birth, death, root, size, season, pipes, axis, thick, state)
        pipes_min = _pipes_min(radius_min, pipes[0], tip, power) if size > 0 else 1

        for start in range(1, size):
            below = parent[root + start]
            if state[start] == ABSENT or pipes[start] < pipes_min:
                continue
            from_root = below == 0
            if not from_root and _next(below, pipes, axis, thick, pipes_min) == start:
                continue
            x, y, z = _place(xyz, parent, axis, root, start)
            radius = _radius(pipes[start], known, tip, power)
            if from_root:
                length, girth = _start_foot(path, x, y, z, radius, _radius(pipes[0], known, tip, power))
            else:
                length, girth = _start_branch(path, drawn, below, x, y, z, radius, error, side_radius, outer), radius
            flare_radius = girth if from_root else 0.0

            # The axis, node by node.
            last, forks, head = start, 0, length
            while True:
                x, y, z = _place(xyz, parent, axis, root, last)
                radius = _radius(pipes[last], known, tip, power)
                if from_root:
                    radius *= _flare(z, flare_radius)
                dx, dy, dz = x - path[length - 1, 0], y - path[length - 1, 1], z - path[length - 1, 2]
                if dx * dx + dy * dy + dz * dz > STEP_MIN_M * STEP_MIN_M:
                    path[length, 0], path[length, 1], path[length, 2], path[length, 3] = x, y, z, radius
                    length += 1
                after = _next(last, pipes, axis, thick, pipes_min)
                if state[last] == FORKED or (after < 0 and _bears(last, pipes, thick, pipes_min)):
                    node[forks] = last
                    slot[forks] = length - 1
                    forks += 1
                if after < 0:
                    break
                last = after
            if length == head:  # all of it lies in one place
                for k in range(forks):
                    for c in range(3):
                        drawn[node[k], c] = path[length - 1, c]
                    drawn[node[k], 3] = -radius
                continue
            is_cut = axis[last] >= 0 and pipes[axis[last]] < pipes_min
            end_radius = path[length - 1, 3]
            is_thick = end_radius > max(STUMP_RADII * tip, STUMP_ERRORS * error)
            is_stump = _bears(last, pipes, thick, pipes_min) or (is_thick and not is_cut)
            if is_stump:
                length = _close(path, length)
            else:
                path[length - 1, 3] = 0.0

            kept_count = _thin_out(path, length, error, from_root, kept)
            n = 0
            for k in range(kept_count - 1, -1, -1):
                while n < len(sides) - 1 and path[kept[k], 3] > side_radius[n]:
                    n += 1
                side[k] = n
            if forks > 0:
                _note_drawn(path, kept, side, kept_count, node, slot, forks, last, is_stump, tip, inner, drawn)

            # The tube, and where it bends too sharply for its girth, another.
            chain_first[chain_count] = sample_count
            turns[chain_count] = min(max(1, np.int64(np.rint(2.0 * np.pi * girth / texture_m))), 255)
            for k in range(kept_count):
                i = kept[k]
                is_break = (
                    0 < k < kept_count - 1
                    and path[i, 3] > 0.0
                    and path[kept[k - 1], 3] > 0.0
                    and _breaks(path, kept[k - 1], i, kept[k + 1])
                )
                if is_break:
                    sample_count = _put(samples, choice, sample_count, path, i, side[k])
                    sample_count = _put_cap(samples, choice, sample_count, path, i, kept[k - 1], side[k])
                    vertices, triangles = _sizes(samples, choice, chain_first[chain_count], sample_count, sides)
                    counts[s - begin, 0] += vertices
                    counts[s - begin, 1] += triangles
                    chain_count += 1
                    chain_first[chain_count] = sample_count
                    turns[chain_count] = turns[chain_count - 1]
                    sample_count = _put_cap(samples, choice, sample_count, path, i, kept[k + 1], side[k])
                sample_count = _put(samples, choice, sample_count, path, i, side[k])
            vertices, triangles = _sizes(samples, choice, chain_first[chain_count], sample_count, sides)
            counts[s - begin, 0] += vertices
            counts[s - begin, 1] += triangles
            chain_count += 1
        skeleton_first[s - begin + 1] = chain_count
    chain_first[chain_count] = sample_count
    return sample_count


@njit(**BARE)
def _survey(parent, order, birth, death, root, size, season, pipes, axis, thick, state):
    """Count pipes; find which standing child goes on as the axis, which bears most, and where are two or more."""
    for i in range(size):
        pipes[i] = 0
        axis[i] = -1
        thick[i] = -1
        state[i] = PLAIN
    for i in range(size - 1, -1, -1):
        row = root + i
        born = birth[row] <= season
        if not born:
            state[i] = ABSENT
            continue
        stands = death[row] == 0 or death[row] > season
        state[i] = ABSENT if not stands else (FORKED if state[i] == FORKED else PLAIN)
        count = max(1, pipes[i])
        pipes[i] = count
        if i == 0:
            continue
        p = parent[row]
        pipes[p] += count
        if stands:
            if order[row] == order[root + p] and (axis[p] < 0 or count >= pipes[axis[p]]):
                axis[p] = i
            if thick[p] >= 0:
                state[p] = FORKED
            if thick[p] < 0 or count >= pipes[thick[p]]:
                thick[p] = i


@njit(**BARE)
def _pipes_min(radius_min, root_pipes, tip, power):
    """Return how many twig ends wood has to bear to be drawn; a slight plant's are counted from its own girth."""
    wanted = min(radius_min, SLIGHT * tip * np.float64(root_pipes) ** power)
    if wanted <= tip:
        return 1
    count = max(int((wanted / tip) ** (1.0 / power)), 1)
    while tip * np.float64(count) ** power < wanted:
        count += 1
    while count > 1 and tip * np.float64(count - 1) ** power >= wanted:
        count -= 1
    return count


@njit(**BARE)
def _bears(i, pipes, thick, pipes_min):
    """Tell whether a node has children that are drawn."""
    return thick[i] >= 0 and pipes[thick[i]] >= pipes_min


@njit(**BARE)
def _next(i, pipes, axis, thick, pipes_min):
    """Return the node that goes on in the same tube, -1 where it ends."""
    after = axis[i]
    if after >= 0 and pipes[after] >= pipes_min:
        return after
    after = thick[i]
    if _bears(i, pipes, thick, pipes_min) and FOLLOW_SHARE * pipes[after] >= pipes[i]:
        return after
    return -1


@njit(**BARE)
def _place(xyz, parent, axis, root, i):
    row = root + i
    x, y, z = np.float64(xyz[row, 0]), np.float64(xyz[row, 1]), np.float64(xyz[row, 2])
    after = axis[i]
    if after < 0 or i == 0:
        return x, y, z
    p, a = root + parent[row], root + after
    x += SMOOTH * (0.5 * (np.float64(xyz[p, 0]) + np.float64(xyz[a, 0])) - x)
    y += SMOOTH * (0.5 * (np.float64(xyz[p, 1]) + np.float64(xyz[a, 1])) - y)
    z += SMOOTH * (0.5 * (np.float64(xyz[p, 2]) + np.float64(xyz[a, 2])) - z)
    return x, y, z


@njit(**BARE)
def _radius(count, known, tip, power):
    return known[count] if count < RADII_KNOWN else tip * np.float64(count) ** power


@njit(**BARE)
def _flare(z, radius):
    rest = 1.0 - z / max(FLARE_RADII * radius, FLARE_LEAST_M)
    return 1.0 + FLARE * min(max(rest, 0.0), 1.0) ** 3


@njit(**BARE)
def _start_foot(path, x, y, z, radius, root_radius):
    """Begin a trunk below the ground; return how many samples that took and its radius without the flare."""
    girth = min(max(root_radius, radius), FOOT_COLLAR * radius)
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = 0.0, 0.0, -FOOT_DEPTH_M, girth * (1.0 + FLARE)
    path[1, 0], path[1, 1], path[1, 2], path[1, 3] = 0.0, 0.0, 0.0, girth * (1.0 + FLARE)
    length = 2
    run = np.sqrt(x * x + y * y + z * z)
    height = max(FLARE_RADII * girth, FLARE_LEAST_M)
    for share in FLARE_RINGS:
        t = share * height / run if run > STEP_MIN_M else 1.0
        if t < 0.8:
            path[length, 0], path[length, 1], path[length, 2] = t * x, t * y, t * z
            path[length, 3] = (girth + t * (radius - girth)) * _flare(t * z, girth)
            length += 1
    return length, girth


@njit(**BARE)
def _start_branch(path, drawn, below, x, y, z, radius, error, side_radius, outer):
    """Begin a branch inside the wood that bears it, or closed where that wood ends; return how many samples it took."""
    ox, oy, oz, room = drawn[below, 0], drawn[below, 1], drawn[below, 2], drawn[below, 3]
    dx, dy, dz = x - ox, y - oy, z - oz
    run = np.sqrt(dx * dx + dy * dy + dz * dz)
    start = COLLAR * radius
    length = 0
    if room < 0.0:
        start = min(start, max(-room, 0.5 * radius))
        if run > STEP_MIN_M:
            back = DOME[1][0] * start / run
            path[0, 0], path[0, 1], path[0, 2], path[0, 3] = ox - back * dx, oy - back * dy, oz - back * dz, 0.0
            length = 1
    else:
        n = 0
        while n < len(outer) - 1 and start > side_radius[n]:
            n += 1
        start = min(start, INSIDE * room / outer[n])
    path[length, 0], path[length, 1], path[length, 2], path[length, 3] = ox, oy, oz, start
    length += 1
    if room <= COLLAR_ERRORS * error:
        return length
    path[0, 0], path[0, 1], path[0, 2] = ox + drawn[below, 4], oy + drawn[below, 5], oz + drawn[below, 6]
    leave = CLEAR * room + radius
    if run > CLEAR * leave:
        t = leave / run
        path[length, 0], path[length, 1], path[length, 2] = ox + t * dx, oy + t * dy, oz + t * dz
        path[length, 3] = COLLAR_END * radius
        length += 1
    return length


@njit(**BARE)
def _close(path, length):
    """Add a dome to the end of a path."""
    i, p = length - 1, length - 2
    dx, dy, dz = path[i, 0] - path[p, 0], path[i, 1] - path[p, 1], path[i, 2] - path[p, 2]
    radius = path[i, 3]
    step = radius / np.sqrt(dx * dx + dy * dy + dz * dz)
    for ahead, share in DOME:
        path[length, 0] = path[i, 0] + ahead * step * dx
        path[length, 1] = path[i, 1] + ahead * step * dy
        path[length, 2] = path[i, 2] + ahead * step * dz
        path[length, 3] = share * radius
        length += 1
    return length


@njit(**BARE)
def _thin_out(path, length, error, from_root, kept):
    """Choose samples so that those between lie within an error of the line, and their radii of its radius."""
    kept[0] = 0
    count, a = 1, 0
    if from_root or path[0, 3] == 0.0:  # a trunk stays upright below the ground, its edge level; a cap keeps its ring
        kept[1] = 1
        count, a = 2, 1
    while a < length - 1:
        b = a + 1
        while b < length - 1 and b - a < WINDOW and _fits(path, a, b + 1, error):
            b += 1
        kept[count] = b
        count += 1
        a = b
    return count


@njit(**BARE)
def _fits(path, a, b, error):
    x, y, z, r = path[a, 0], path[a, 1], path[a, 2], path[a, 3]
    dx, dy, dz, dr = path[b, 0] - x, path[b, 1] - y, path[b, 2] - z, path[b, 3] - r
    square = dx * dx + dy * dy + dz * dz
    if square < STEP_MIN_M * STEP_MIN_M:
        return False
    for j in range(b - 1, a, -1):
        ex, ey, ez = path[j, 0] - x, path[j, 1] - y, path[j, 2] - z
        t = ex * dx + ey * dy + ez * dz  # times the square, as all that follows
        if t < 0.0 or t > square or abs((r - path[j, 3]) * square + t * dr) > error * square:
            return False
        if (ex * ex + ey * ey + ez * ez) * square - t * t > error * error * square:
            return False
    return True


@njit(**BARE)
def _note_drawn(path, kept, side, kept_count, node, slot, nodes, last, is_stump, tip, inner, drawn):
    """Note where the tube's axis passes nodes that bear branches, and how large a ball fits into the tube there."""
    k = 0
    end = kept[kept_count - 1]
    for m in range(nodes):
        j = slot[m]
        while k < kept_count - 2 and kept[k + 1] <= j:
            k += 1
        a, b = kept[k], kept[k + 1]
        dx, dy, dz = path[b, 0] - path[a, 0], path[b, 1] - path[a, 1], path[b, 2] - path[a, 2]
        run = np.sqrt(dx * dx + dy * dy + dz * dz)
        t = 0.0
        if j != a:
            t = (path[j, 0] - path[a, 0]) * dx + (path[j, 1] - path[a, 1]) * dy + (path[j, 2] - path[a, 2]) * dz
            t = min(max(t / (run * run), 0.0), 1.0)
        fall = path[b, 3] - path[a, 3]
        radius = path[a, 3] + t * fall
        i = node[m]
        drawn[i, 0], drawn[i, 1], drawn[i, 2] = path[a, 0] + t * dx, path[a, 1] + t * dy, path[a, 2] + t * dz
        ball = radius * inner[min(side[k], side[k + 1])] * run / np.sqrt(run * run + fall * fall)
        way, before = t * run, a  # back in the tube
        if j == a and k > 0:
            before = kept[k - 1]
            dx, dy, dz = path[a, 0] - path[before, 0], path[a, 1] - path[before, 1], path[a, 2] - path[before, 2]
            way = np.sqrt(dx * dx + dy * dy + dz * dz)
            run, fall = way, path[a, 3] - path[before, 3]
        back = min(BACK * ball, BACK_SHARE * way) / run
        thinner = inner[min(side[max(k - 1, 0)], side[k + 1])] * run / np.sqrt(run * run + fall * fall)
        ball = min(ball, thinner * (radius - back * fall))
        drawn[i, 4], drawn[i, 5], drawn[i, 6] = -back * dx, -back * dy, -back * dz
        if is_stump and i == last:
            drawn[i, 3] = -max(radius, path[j, 3])
        elif ball < STEP_MIN_M:  # at the very point of a tube
            drawn[i, 3] = -tip
        elif (is_stump and k >= kept_count - 3 and _far(path, end, drawn, i) < ball) or (
            j == a and k > 0 and _breaks(path, kept[k - 1], a, b)
        ):
            drawn[i, 3] = -radius
        else:
            drawn[i, 3] = ball


@njit(**BARE)
def _far(path, end, drawn, i):
    x, y, z = path[end, 0] - drawn[i, 0], path[end, 1] - drawn[i, 1], path[end, 2] - drawn[i, 2]
    return np.sqrt(x * x + y * y + z * z)


@njit(**BARE)
def _breaks(path, a, b, c):
    """Tell whether a mitre at b would take too much of the ways to a and to c."""
    ax, ay, az = path[b, 0] - path[a, 0], path[b, 1] - path[a, 1], path[b, 2] - path[a, 2]
    cx, cy, cz = path[c, 0] - path[b, 0], path[c, 1] - path[b, 1], path[c, 2] - path[b, 2]
    before, after = ax * ax + ay * ay + az * az, cx * cx + cy * cy + cz * cz
    cosine = ax * cx + ay * cy + az * cz
    square, most = path[b, 3] * path[b, 3], BREAK * BREAK * min(before, after)
    if cosine >= 0.0 and square <= most:  # the tangent of half the angle is 1 at most
        return False
    cosine /= np.sqrt(before * after)
    return square * (1.0 - cosine) > most * (1.0 + cosine) or cosine < FOLD


@njit(**BARE)
def _put(samples, choice, count, path, i, n):
    for c in range(4):
        samples[count, c] = path[i, c]
    choice[count] = n
    return count + 1


@njit(**BARE)
def _put_cap(samples, choice, count, path, i, away_from, n):
    """Put the point of a dome on sample i, on the side away from another."""
    dx, dy, dz = path[i, 0] - path[away_from, 0], path[i, 1] - path[away_from, 1], path[i, 2] - path[away_from, 2]
    step = DOME[1][0] * path[i, 3] / np.sqrt(dx * dx + dy * dy + dz * dz)
    samples[count, 0], samples[count, 1] = path[i, 0] + step * dx, path[i, 1] + step * dy
    samples[count, 2], samples[count, 3] = path[i, 2] + step * dz, 0.0
    choice[count] = n
    return count + 1


@njit(**BARE)
def _sizes(samples, choice, begin, end, sides):
    """Count the corners and triangles of a chain."""
    vertices, triangles = 0, 0
    for k in range(begin, end):
        n = sides[choice[k]]
        point = samples[k, 3] == 0.0
        if point:
            n = sides[choice[k + 1]] if k == begin else sides[choice[k - 1]]
        vertices += n if point else n + 1
        if k > begin:
            if point or samples[k - 1, 3] == 0.0:
                triangles += n
            else:
                before = sides[choice[k - 1]]
                triangles += n + before
    return vertices, triangles
