"""Chains of rings to triangles, compiled: the second pass of `wood.py`. Chains are those of `wood_chain_kernel.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

FOOT_SHADE, FOOT_SHADE_M = 60, 0.8  # how much darker the foot of a trunk is, and up to which height
SAME = 1e-20  # square of what is between two directions that are one

# Helpers neither make nor keep arrays: counting references to what they are given takes time.
BARE: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}


@njit(cache=True, nogil=True, error_model="numpy")
def fill_wood(
    samples, choice, chain_first, turns, skeleton_first, sides, outer, table_first, circle, texture_m, first_vertex,
    first_triangle, xyz, normal, uv, tint, triangle,
):  # fmt: skip
    """Write the corners and triangles of chains into arrays of all.

    `circle` (., 5) holds cosine and sine at each corner of a polygon, then half a side on, and the share of a turn;
    that of choice k from ``table_first[k]`` on. Skeleton m of these begins at ``first_vertex[m]``.
    """
    for m in range(len(skeleton_first) - 1):
        v, q = first_vertex[m], first_triangle[m]
        base = v
        for chain in range(skeleton_first[m], skeleton_first[m + 1]):
            begin, end = chain_first[chain], chain_first[chain + 1]
            turn = np.float32(turns[chain])
            along = 0.0
            x, y, z, r = _sample(samples, begin)
            bx, by, bz, back = 0.0, 0.0, 0.0, 0.0  # from the sample before, as a unit vector, and how far
            tx, ty, tz = 0.0, 0.0, 1.0
            ux, uy, uz = 1.0, 0.0, 0.0
            r_before, before, n_before, was_point = r, 0, 0, False
            for k in range(begin, end):
                is_last = k == end - 1
                fx, fy, fz, far = bx, by, bz, 0.0
                nx, ny, nz, nr = x, y, z, r
                if not is_last:
                    nx, ny, nz, nr = _sample(samples, k + 1)
                    fx, fy, fz = nx - x, ny - y, nz - z
                    far = np.sqrt(fx * fx + fy * fy + fz * fz)
                    fx, fy, fz = fx / far, fy / far, fz / far
                if k == begin:
                    sx, sy, sz = fx, fy, fz
                    ux, uy, uz = _across(sx, sy, sz)
                else:
                    sx, sy, sz = bx + fx, by + fy, bz + fz
                    norm = np.sqrt(sx * sx + sy * sy + sz * sz)
                    sx, sy, sz = sx / norm, sy / norm, sz / norm
                    # Double reflection: Wang et al. 2008, table 1; b is a unit vector.
                    c = 2.0 * (bx * ux + by * uy + bz * uz)
                    ux, uy, uz = ux - c * bx, uy - c * by, uz - c * bz
                    c = 2.0 * (bx * tx + by * ty + bz * tz)
                    tx, ty, tz = tx - c * bx, ty - c * by, tz - c * bz
                    gx, gy, gz = sx - tx, sy - ty, sz - tz
                    square = gx * gx + gy * gy + gz * gz
                    if square > SAME:
                        c = 2.0 * (gx * ux + gy * uy + gz * uz) / square
                        ux, uy, uz = ux - c * gx, uy - c * gy, uz - c * gz
                tx, ty, tz = sx, sy, sz
                along += back
                wx, wy, wz = ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux
                is_point = r == 0.0
                slope = (nr - r_before) / (far + back)
                shorter = 1.0 / np.sqrt(1.0 + slope * slope)
                which = choice[k]
                if is_point:
                    which = choice[k + 1] if k == begin else choice[k - 1]
                n = sides[which]
                at = table_first[which]
                px, py, pz = np.float32(x), np.float32(y), np.float32(z)
                u0, u1, u2 = np.float32(ux), np.float32(uy), np.float32(uz)
                w0, w1, w2 = np.float32(wx), np.float32(wy), np.float32(wz)
                lean = -slope * shorter
                l0, l1, l2 = np.float32(lean * tx), np.float32(lean * ty), np.float32(lean * tz)
                flat = np.float32(shorter)
                high = np.float32(along / texture_m)
                shade = np.uint8(255 - np.int64(FOOT_SHADE * min(max(1.0 - z / FOOT_SHADE_M, 0.0), 1.0) + 0.5))
                v_ring = v
                if is_point:
                    for j in range(n):
                        c, d = circle[at + j, 2], circle[at + j, 3]
                        e0, e1, e2 = c * u0 + d * w0, c * u1 + d * w1, c * u2 + d * w2
                        xyz[v, 0], xyz[v, 1], xyz[v, 2] = px, py, pz
                        normal[v, 0], normal[v, 1], normal[v, 2] = e0 * flat + l0, e1 * flat + l1, e2 * flat + l2
                        uv[v, 0], uv[v, 1] = np.float32(0.5) * (circle[at + j, 4] + circle[at + j + 1, 4]) * turn, high
                        tint[v, 0], tint[v, 1], tint[v, 2] = shade, shade, shade
                        v += 1
                else:
                    wide = np.float32(r * outer[which])
                    for j in range(n + 1):
                        c, d = circle[at + j, 0], circle[at + j, 1]
                        e0, e1, e2 = c * u0 + d * w0, c * u1 + d * w1, c * u2 + d * w2
                        xyz[v, 0], xyz[v, 1], xyz[v, 2] = px + wide * e0, py + wide * e1, pz + wide * e2
                        normal[v, 0], normal[v, 1], normal[v, 2] = e0 * flat + l0, e1 * flat + l1, e2 * flat + l2
                        uv[v, 0], uv[v, 1] = circle[at + j, 4] * turn, high
                        tint[v, 0], tint[v, 1], tint[v, 2] = shade, shade, shade
                        v += 1
                if k > begin:
                    q = _join(triangle, q, before - base, n_before, was_point, v_ring - base, n, is_point)
                before, n_before, was_point = v_ring, n, is_point
                x, y, z, r_before, r = nx, ny, nz, r, nr
                bx, by, bz, back = fx, fy, fz, far


@njit(**BARE)
def _sample(samples, k):
    return np.float64(samples[k, 0]), np.float64(samples[k, 1]), np.float64(samples[k, 2]), np.float64(samples[k, 3])


@njit(**BARE)
def _across(x, y, z):
    """Return a unit vector across another, from which a frame starts."""
    if abs(x) < 0.7:
        norm = np.sqrt(y * y + z * z)
        return 0.0, z / norm, -y / norm
    norm = np.sqrt(x * x + z * z)
    return -z / norm, 0.0, x / norm


@njit(**BARE)
def _join(triangle, q, a, n, a_is_point, b, m, b_is_point):
    """Join ring a of n sides to the ring b of m sides above it; return the place of the next triangle."""
    if a_is_point:
        for j in range(m):
            triangle[q, 0], triangle[q, 1], triangle[q, 2] = a + j, b + j + 1, b + j
            q += 1
    elif b_is_point:
        for j in range(n):
            triangle[q, 0], triangle[q, 1], triangle[q, 2] = a + j, a + j + 1, b + j
            q += 1
    elif n == m:
        for j in range(n):
            triangle[q, 0], triangle[q, 1], triangle[q, 2] = a + j, a + j + 1, b + j
            triangle[q + 1, 0], triangle[q + 1, 1], triangle[q + 1, 2] = a + j + 1, b + j + 1, b + j
            q += 2
    else:
        i, j = 0, 0
        while i < n or j < m:
            if j == m or (i < n and (2 * i + 1) * m <= (2 * j + 1) * n):
                triangle[q, 0], triangle[q, 1], triangle[q, 2] = a + i, a + i + 1, b + j
                i += 1
            else:
                triangle[q, 0], triangle[q, 1], triangle[q, 2] = a + i, b + j + 1, b + j
                j += 1
            q += 1
    return q
