"""A software rasteriser that keeps, for each pixel, what is seen there; light comes later, so that it costs by pixels.

Positions on the canvas: x and y in pixels from the upper left corner, y downward; depth in metres away from the viewer,
the smallest wins. Vectors have x to the right, y up and z toward the viewer. Every function draws the rows from `top`
to `bottom` alone, so that bands can be drawn side by side; what a pixel shows does not hang on the bands.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.export.plant_light_kernel import chance, hash_pair

NOTHING, GROUND, LAWN, PAVING, ROAD, KERB, WALL, ROOF, GLASS, WOOD, LEAF = range(11)
NEAR_M = 0.25  # nothing nearer is drawn
BARK_STREAK_PX = 3.0  # stems narrower than this show no streaks
CROWN_ROUNDNESS = 0.5  # by how much the normal of a merged leaf is that of the crown


class Canvas(NamedTuple):
    """What is seen at each pixel."""

    depth: NDArray[np.float32]  # (h, w) metres, infinite where nothing is
    rgb: NDArray[np.uint8]  # (h, w, 3) colour of the surface, square root of linear
    normal: NDArray[np.int8]  # (h, w, 3) in the camera's frame, 127 long
    kind: NDArray[np.uint8]  # (h, w) one of the kinds above


class View(NamedTuple):
    """Where the canvas is seen from."""

    eye: NDArray[np.float64]  # (3,)
    axes: NDArray[np.float64]  # (3, 3) rows right, up, toward the viewer
    scale: float  # pixels a metre, in perspective at 1 m
    middle: NDArray[np.float64]  # (2,) pixel that is looked straight at
    perspective: bool
    top: int  # row of the whole picture that is the canvas's first


class Models(NamedTuple):
    """Shapes of plants about their roots: branches from thick to thin, leaves in an order by chance."""

    first_wood: NDArray[np.int64]  # (s + 1,)
    wood: NDArray[np.float32]  # (m, 8) both ends, both radii
    wood_rgb: NDArray[np.uint8]  # (m, 3)
    first_leaf: NDArray[np.int64]  # (s + 1,)
    leaf: NDArray[np.float32]  # (k, 9) middle, half a blade along, half a blade across
    leaf_rgb: NDArray[np.uint8]  # (k, 3)
    longest: NDArray[np.float32]  # (s,) no leaf reaches farther from its middle
    leaf_area: NDArray[np.float32]  # (s,) square metres that each leaf stands for
    middle: NDArray[np.float32]  # (s, 3) of the crown
    reach: NDArray[np.float32]  # (s,) of the widest branch from the root's vertical
    top: NDArray[np.float32]  # (s,)
    merged: NDArray[np.float32]  # (s,) 0 leaves as they are, to 1 tufts in place of many


class Instances(NamedTuple):
    """Plants: which model, where, how turned, and how much of it is drawn."""

    model: NDArray[np.int64]  # (n,)
    place: NDArray[np.float64]  # (n, 3)
    turn: NDArray[np.float64]  # (n, 2) cosine and sine
    scale: NDArray[np.float64]  # (n,)
    mirror: NDArray[np.float64]  # (n,) -1 where y is mirrored, else 1
    wood_count: NDArray[np.int64]  # (n,) how many of the model's branches
    leaf_count: NDArray[np.int64]  # (n,) and leaves,
    leaf_grow: NDArray[np.float64]  # (n,) and by how much those are longer


@njit(cache=True, nogil=True, error_model="numpy")
def encoded(value):
    """Return a part of a colour as a byte."""
    return np.uint8(min(max(np.sqrt(value) * 255.0 + 0.5, 0.0), 255.0))


@njit(cache=True, nogil=True, error_model="numpy")
def put(canvas, row, column, depth, red, green, blue, nx, ny, nz, kind):
    """Set what is seen at a pixel; colours as bytes."""
    canvas.depth[row, column] = depth
    canvas.rgb[row, column, 0], canvas.rgb[row, column, 1], canvas.rgb[row, column, 2] = red, green, blue
    canvas.normal[row, column, 0] = np.int8(nx * 127.0)
    canvas.normal[row, column, 1] = np.int8(ny * 127.0)
    canvas.normal[row, column, 2] = np.int8(nz * 127.0)
    canvas.kind[row, column] = kind


@njit(cache=True, nogil=True, error_model="numpy")
def matrix_of(instances, n):
    """Return (3, 3) that turns, mirrors and scales a model as plant n stands."""
    k, c, s, m = instances.scale[n], instances.turn[n, 0], instances.turn[n, 1], instances.mirror[n]
    out = np.zeros((3, 3))
    out[0, 0], out[0, 1], out[1, 0], out[1, 1], out[2, 2] = k * c, -k * s * m, k * s, k * c * m, k
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def rows_of(view, place, reach, height):
    """Return the highest and lowest row that a plant's upright cylinder may touch, and its columns; none if behind."""
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(8):
        px = place[0] + (reach if corner & 1 else -reach) - view.eye[0]
        py = place[1] + (reach if corner & 2 else -reach) - view.eye[1]
        pz = place[2] + (height if corner & 4 else -0.2) - view.eye[2]
        cx = view.axes[0, 0] * px + view.axes[0, 1] * py + view.axes[0, 2] * pz
        cy = view.axes[1, 0] * px + view.axes[1, 1] * py + view.axes[1, 2] * pz
        cz = -(view.axes[2, 0] * px + view.axes[2, 1] * py + view.axes[2, 2] * pz)
        scale = view.scale
        if view.perspective:
            if cz < NEAR_M:  # around or behind the viewer: it may be anywhere
                cz = NEAR_M
            scale = view.scale / cz
        x, y = view.middle[0] + cx * scale, view.middle[1] - cy * scale
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    return low_y - 2.0, high_y + 2.0, low_x - 2.0, high_x + 2.0


@njit(cache=True, nogil=True, error_model="numpy")
def draw_plants(canvas, view, models, instances, top, bottom):
    """Draw branches and leaves of plants."""
    width = canvas.depth.shape[1]
    far_add = 0.0 if view.perspective else 1e4
    for n in range(len(instances.model)):
        model = instances.model[n]
        scale = instances.scale[n]
        reach, height = models.reach[model] * scale, models.top[model] * scale
        low, high, left, right = rows_of(view, instances.place[n], reach, height)
        if high < top or low >= bottom or right < 0 or left >= width:
            continue
        matrix = view.axes @ matrix_of(instances, n)
        origin = view.axes @ (instances.place[n] - view.eye)
        first = models.first_wood[model]
        for s in range(first, first + instances.wood_count[n]):
            draw_branch(canvas, view, matrix, origin, scale, models.wood[s], models.wood_rgb[s], s - first, far_add,
                        top, bottom)  # fmt: skip
        first = models.first_leaf[model]
        grow = instances.leaf_grow[n]
        tufted = min(models.merged[model] + 0.5 * (grow - 1.0), 1.0)
        middle = matrix @ models.middle[model].astype(np.float64)
        longest = scale * models.longest[model]
        for s in range(first, first + instances.leaf_count[n]):
            draw_leaf(canvas, view, matrix, origin, models.leaf[s], longest, models.leaf_rgb[s], grow, tufted, middle,
                      far_add, top, bottom)  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def draw_branch(canvas, view, m, origin, size, branch, rgb, key, far_add, top, bottom):
    """Draw a tapered round segment; what is thinner than a pixel fades instead of growing thick."""
    width = canvas.depth.shape[1]
    a, b, c = float(branch[0]), float(branch[1]), float(branch[2])
    x0, y0 = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + origin[0], m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + origin[1]
    z0 = far_add - (m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + origin[2])
    is_foot = abs(c) < 1e-3
    a, b, c = float(branch[3]), float(branch[4]), float(branch[5])
    x1, y1 = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + origin[0], m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + origin[1]
    z1 = far_add - (m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + origin[2])
    if z0 < NEAR_M or z1 < NEAR_M:
        return
    k0 = view.scale / z0 if view.perspective else view.scale
    k1 = view.scale / z1 if view.perspective else view.scale
    r0, r1 = branch[6] * size * k0, branch[7] * size * k1
    x0, y0 = view.middle[0] + x0 * k0, view.middle[1] - y0 * k0
    x1, y1 = view.middle[0] + x1 * k1, view.middle[1] - y1 * k1
    rim = max(r0, r1, 0.5) + 1.0
    left, right = max(int(min(x0, x1) - rim), 0), min(int(max(x0, x1) + rim) + 1, width - 1)
    upper, lower = max(int(min(y0, y1) - rim), top), min(int(max(y0, y1) + rim) + 1, bottom - 1)
    if left > right or upper > lower:
        return
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    length = np.sqrt(square)
    ax, ay = (-dy / length, dx / length) if length > 1e-6 else (1.0, 0.0)
    for row in range(upper, lower + 1):
        for column in range(left, right + 1):
            px, py = column + 0.5 - x0, row + 0.5 - y0
            t = (px * dx + py * dy) / square if square > 1e-9 else 0.0
            if t < 0.0 and is_foot:
                continue
            t = min(max(t, 0.0), 1.0)
            radius = r0 + t * (r1 - r0)
            drawn = max(radius, 0.5)
            ox, oy = px - t * dx, py - t * dy
            if ox * ox + oy * oy > drawn * drawn:
                continue
            u = min(max((ox * ax + oy * ay) / drawn, -1.0), 1.0)
            front = np.sqrt(1.0 - u * u)
            depth = z0 + t * (z1 - z0)
            if depth >= canvas.depth[row, column]:
                continue
            if radius < 0.5 and chance(hash_pair(key, (row + view.top) * width + column)) > 2.0 * radius:
                continue
            streak = 1.08
            if radius > BARK_STREAK_PX:
                band = int(np.floor((np.arcsin(u) + 1.6) * min(radius * 0.4, 9.0)))
                part = int(np.floor(t * length / (2.2 * radius) + 7 * band))
                streak = 1.0 + 0.16 * chance(hash_pair(band * 977 + part, key // 2))
            red, green, blue = min(rgb[0] * streak, 255.0), min(rgb[1] * streak, 255.0), min(rgb[2] * streak, 255.0)
            put(canvas, row, column, depth, np.uint8(red), np.uint8(green), np.uint8(blue), ax * u, -ay * u, front,
                WOOD)  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def draw_leaf(canvas, view, m, origin, leaf, longest, rgb, grow, tufted, middle, far_add, top, bottom):
    """Draw a leaf as a pointed blade; its normal looks toward the viewer, or out of the crown where it is a tuft.

    No leaf reaches farther than `longest` from its middle, in metres, before it is grown.
    """
    width = canvas.depth.shape[1]
    a, b, c = float(leaf[0]), float(leaf[1]), float(leaf[2])
    ly, lz = m[1, 0] * a + m[1, 1] * b + m[1, 2] * c, m[2, 0] * a + m[2, 1] * b + m[2, 2] * c
    depth = far_add - lz - origin[2]
    if depth < NEAR_M:
        return
    scale = view.scale / depth if view.perspective else view.scale
    size = grow * scale
    y = view.middle[1] - (ly + origin[1]) * scale
    high = longest * size + 1.0
    if y < top - high or y > bottom + high:
        return
    lx = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
    x = view.middle[0] + (lx + origin[0]) * scale
    a, b, c = float(leaf[3]), float(leaf[4]), float(leaf[5])
    a0, a1, a2 = (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c, m[1, 0] * a + m[1, 1] * b + m[1, 2] * c,
                  m[2, 0] * a + m[2, 1] * b + m[2, 2] * c)  # fmt: skip
    a, b, c = float(leaf[6]), float(leaf[7]), float(leaf[8])
    b0, b1, b2 = (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c, m[1, 0] * a + m[1, 1] * b + m[1, 2] * c,
                  m[2, 0] * a + m[2, 1] * b + m[2, 2] * c)  # fmt: skip
    u0, u1, v0, v1 = a0 * size, -a1 * size, b0 * size, -b1 * size
    rim_x, rim_y = np.sqrt(u0 * u0 + v0 * v0) + 0.5, np.sqrt(u1 * u1 + v1 * v1) + 0.5
    left, right = max(int(x - rim_x), 0), min(int(x + rim_x), width - 1)
    upper, lower = max(int(y - rim_y), top), min(int(y + rim_y), bottom - 1)
    if left > right or upper > lower:
        return
    area = u0 * v1 - u1 * v0
    if abs(area) < 0.3:  # seen on edge: widen it a little
        area = 0.3 if area >= 0 else -0.3
    nx, ny, nz = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    long = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    if nz < 0:
        long = -long
    nx, ny, nz = nx / long, ny / long, nz / long
    if tufted > 0:
        ox, oy, oz = lx - middle[0], ly - middle[1], lz - middle[2]
        long = np.sqrt(ox * ox + oy * oy + oz * oz) + 1e-9
        share = CROWN_ROUNDNESS * tufted
        nx, ny, nz = nx + share * (ox / long - nx), ny + share * (oy / long - ny), nz + share * (oz / long - nz)
        long = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-9
        nx, ny, nz = nx / long, ny / long, nz / long
    u0, u1, v0, v1 = u0 / area, u1 / area, v0 / area, v1 / area
    for row in range(upper, lower + 1):
        py = row + 0.5 - y
        for column in range(left, right + 1):
            px = column + 0.5 - x
            s = px * v1 - py * v0
            t = py * u0 - px * u1
            if abs(s) > 1.0 or abs(t) > 1.0 - 0.85 * s * s:
                continue
            here = depth - grow * (s * a2 + t * b2)
            if here >= canvas.depth[row, column]:
                continue
            fold = 1.03 if t > 0 else 0.97
            put(canvas, row, column, here, np.uint8(min(rgb[0] * fold, 255.0)), np.uint8(min(rgb[1] * fold, 255.0)),
                np.uint8(min(rgb[2] * fold, 255.0)), nx, ny, nz, LEAF)  # fmt: skip
