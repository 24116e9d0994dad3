"""Draws flat faces and the plain ground on a canvas: see `draw_kernel`."""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.export.view.draw_kernel import GLASS, NEAR_M, WALL, put

BAY_M = 3.0  # width of a window and the wall beside it, and height of a floor


@njit(cache=True, nogil=True, error_model="numpy")
def draw_faces(canvas, view, corners, uv, normal, rgb, kind, painted, top, bottom):
    """Draw flat triangles.

    `corners` (n, 3, 3) metres; `uv` (n, 3, 2) metres along and up a wall, for its windows, or negative for none;
    `normal` (n, 3) of the scene; `rgb` (n, 3) bytes; `kind` (n,); `painted` whether each covers what is below it as
    paint does, for flat ground, whatever is nearer.
    """
    far_add = 0.0 if view.perspective else 1e4
    points = np.empty((4, 5))
    for n in range(len(corners)):
        count = 0
        # Cut off what is too near or behind the viewer: up to four corners remain.
        for i in range(3):
            j = (i + 1) % 3
            p, q = seen_from(view, corners[n, i], far_add), seen_from(view, corners[n, j], far_add)
            if p[2] >= NEAR_M:
                points[count, 0], points[count, 1], points[count, 2] = p
                points[count, 3], points[count, 4] = uv[n, i, 0], uv[n, i, 1]
                count += 1
            if (p[2] >= NEAR_M) != (q[2] >= NEAR_M):
                t = (NEAR_M - p[2]) / (q[2] - p[2])
                points[count, 0], points[count, 1] = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
                points[count, 2] = NEAR_M
                for c in range(2):
                    points[count, 3 + c] = uv[n, i, c] + t * (uv[n, j, c] - uv[n, i, c])
                count += 1
        if count < 3:
            continue
        nx, ny, nz = 0.0, 0.0, 0.0
        for c in range(3):
            nx += view.axes[0, c] * normal[n, c]
            ny += view.axes[1, c] * normal[n, c]
            nz += view.axes[2, c] * normal[n, c]
        for i in range(count):
            scale = view.scale / points[i, 2] if view.perspective else view.scale
            points[i, 0], points[i, 1] = view.middle[0] + points[i, 0] * scale, view.middle[1] - points[i, 1] * scale
        draw_triangle(canvas, view, points[0], points[1], points[2], nx, ny, nz, rgb[n], kind[n], painted, top, bottom)
        if count == 4:
            draw_triangle(canvas, view, points[0], points[2], points[3], nx, ny, nz, rgb[n], kind[n], painted, top,
                          bottom)  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def seen_from(view, point, far_add):
    """Return a point in the camera's frame: right, up, depth."""
    px, py, pz = point[0] - view.eye[0], point[1] - view.eye[1], point[2] - view.eye[2]
    return (
        view.axes[0, 0] * px + view.axes[0, 1] * py + view.axes[0, 2] * pz,
        view.axes[1, 0] * px + view.axes[1, 1] * py + view.axes[1, 2] * pz,
        far_add - (view.axes[2, 0] * px + view.axes[2, 1] * py + view.axes[2, 2] * pz),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def draw_triangle(canvas, view, p, q, r, nx, ny, nz, rgb, kind, painted, top, bottom):
    """Draw a triangle whose corners are (5,): x, y, depth, u, v."""
    width = canvas.depth.shape[1]
    area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
    if abs(area) < 1e-9:
        return
    low_y, high_y = min(p[1], q[1], r[1]), max(p[1], q[1], r[1])
    if high_y < top or low_y >= bottom:
        return
    upper, lower = max(int(low_y), top), min(int(high_y) + 1, bottom - 1)
    low_x, high_x = max(min(p[0], q[0], r[0]), -1.0), min(max(p[0], q[0], r[0]), width + 1.0)
    left, right = max(int(low_x), 0), min(int(high_x) + 1, width - 1)
    red, green, blue = rgb[0], rgb[1], rgb[2]
    # Each weight is a plane over the picture: a value at the first pixel and steps along x and y.
    d0x, d0y = -(r[1] - q[1]) / area, (r[0] - q[0]) / area
    d1x, d1y = -(p[1] - r[1]) / area, (p[0] - r[0]) / area
    for row in range(upper, lower + 1):
        py = row + 0.5
        for column in range(left, right + 1):
            px = column + 0.5
            w0 = (px - q[0]) * d0x + (py - q[1]) * d0y
            w1 = (px - r[0]) * d1x + (py - r[1]) * d1y
            w2 = 1.0 - w0 - w1
            if w0 < 0 or w1 < 0 or w2 < 0:
                continue
            depth = w0 * p[2] + w1 * q[2] + w2 * r[2]
            if view.perspective:
                depth = 1.0 / (w0 / p[2] + w1 / q[2] + w2 / r[2])
            if not painted and depth >= canvas.depth[row, column]:
                continue
            what = kind
            if kind == WALL and p[3] >= 0:
                if view.perspective:
                    w0, w1, w2 = w0 * depth / p[2], w1 * depth / q[2], w2 * depth / r[2]
                u, v = w0 * p[3] + w1 * q[3] + w2 * r[3], w0 * p[4] + w1 * q[4] + w2 * r[4]
                bay, floor = u % BAY_M, v % BAY_M
                if 0.95 < bay < 2.05 and 0.95 < floor < 2.35:
                    what = GLASS
            put(canvas, row, column, depth, red, green, blue, nx, ny, nz, what)


@njit(cache=True, nogil=True, error_model="numpy")
def draw_plain(canvas, view, rgb, kind, top, bottom):
    """Draw the ground z = 0 to the horizon."""
    for row in range(top, bottom):
        for column in range(canvas.depth.shape[1]):
            a = (column + 0.5 - view.middle[0]) / view.scale
            b = (view.middle[1] - row - 0.5) / view.scale
            if view.perspective:
                oz = view.eye[2]
                dz = view.axes[0, 2] * a + view.axes[1, 2] * b - view.axes[2, 2]
            else:
                oz = view.eye[2] + view.axes[0, 2] * a + view.axes[1, 2] * b + 1e4 * view.axes[2, 2]
                dz = -view.axes[2, 2]
            if dz > -1e-7:
                continue
            far = -oz / dz
            if far < NEAR_M or far >= canvas.depth[row, column]:
                continue
            put(canvas, row, column, far, rgb[0], rgb[1], rgb[2], view.axes[0, 2], view.axes[1, 2], view.axes[2, 2],
                kind)  # fmt: skip
