"""A small software rasteriser with light given: tapered branches and leaves into one z-buffer, for baked pictures.

Positions are in the camera's own frame: x and y in pixels from the upper left corner, y downward; depth in metres away
from the viewer, the smallest wins. Vectors have x to the right, y up and z toward the viewer. Colours are linear light.
What is thinner than a pixel is drawn in that share of its pixels, so that it fades instead of growing thick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.export.plant_light_kernel import chance, hash_pair

BARK_STREAK_PX = 3.0  # stems narrower than this show no streaks


class Canvas(NamedTuple):
    """A picture in the making."""

    depth: NDArray[np.float32]  # (h, w) metres, infinite where nothing is
    rgb: NDArray[np.float32]  # (h, w, 3) linear


@njit(cache=True, nogil=True, error_model="numpy")
def draw_wood(canvas, start, end, rgb, is_foot, light, sun, sun_power, sky_power):
    """Draw tapered round segments.

    `start` and `end` are (m, 4): x, y, depth, radius in pixels; `rgb` (m, 3); `is_foot` (m,) whether it is cut off
    flat where it starts; `light` (m, 4) shares of sun and sky at both ends; `sun` the direction to it in the camera's
    frame.
    """
    height, width = canvas.depth.shape
    for s in range(len(start)):
        x0, y0, z0, r0 = start[s]
        x1, y1, z1, r1 = end[s]
        rim = max(r0, r1, 0.5) + 1.0
        left, right = max(int(min(x0, x1) - rim), 0), min(int(max(x0, x1) + rim) + 1, width - 1)
        top, bottom = max(int(min(y0, y1) - rim), 0), min(int(max(y0, y1) + rim) + 1, height - 1)
        if left > right or top > bottom or z0 <= 0.05 or z1 <= 0.05:
            continue
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        length = np.sqrt(square)
        # Unit vector across the segment, and the sun's share on it; y of the screen runs downward.
        ax, ay = (-dy / length, dx / length) if length > 1e-6 else (1.0, 0.0)
        across = ax * sun[0] - ay * sun[1]
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                px, py = column + 0.5 - x0, row + 0.5 - y0
                t = (px * dx + py * dy) / square if square > 1e-9 else 0.0
                if t < 0.0 and is_foot[s]:
                    continue
                t = min(max(t, 0.0), 1.0)
                radius = r0 + t * (r1 - r0)
                drawn = max(radius, 0.5)
                ox, oy = px - t * dx, py - t * dy
                away = ox * ox + oy * oy
                if away > drawn * drawn:
                    continue
                depth = z0 + t * (z1 - z0)
                if depth >= canvas.depth[row, column]:
                    continue
                if radius < 0.5 and chance(hash_pair(s, row * width + column)) > 2.0 * radius:
                    continue
                u = min(max((ox * ax + oy * ay) / drawn, -1.0), 1.0)
                front = np.sqrt(1.0 - u * u)
                facing = u * across + front * sun[2]
                streak = 1.0
                if radius > BARK_STREAK_PX:
                    band = int(np.floor((np.arcsin(u) + 1.6) * min(radius * 0.4, 9.0)))
                    part = int(np.floor(t * length / (2.2 * radius) + 7 * band))
                    streak = 0.86 + 0.28 * chance(hash_pair(band * 977 + part, s // 2))
                sunny = light[s, 0] + t * (light[s, 2] - light[s, 0])
                open_sky = light[s, 1] + t * (light[s, 3] - light[s, 1])
                power = streak * (sun_power * sunny * max(facing, 0.0) + sky_power * open_sky * (0.55 + 0.45 * front))
                canvas.depth[row, column] = depth
                for c in range(3):
                    canvas.rgb[row, column, c] = rgb[s, c] * power


@njit(cache=True, nogil=True, error_model="numpy")
def draw_leaves(canvas, at, along, across, rgb, light, sun, sun_power, sky_power):
    """Draw leaves as pointed blades, lit from both sides.

    `at` is (n, 4): x, y, depth, pixels a metre; `along` and `across` (n, 3) half a blade in metres, in the camera's
    frame; `rgb` (n, 3); `light` (n, 2).
    """
    height, width = canvas.depth.shape
    for n in range(len(at)):
        x, y, depth, scale = at[n]
        if depth <= 0.05:
            continue
        a0, a1 = along[n, 0] * scale, -along[n, 1] * scale
        b0, b1 = across[n, 0] * scale, -across[n, 1] * scale
        rim_x, rim_y = np.sqrt(a0 * a0 + b0 * b0) + 0.5, np.sqrt(a1 * a1 + b1 * b1) + 0.5
        left, right = max(int(x - rim_x), 0), min(int(x + rim_x), width - 1)
        top, bottom = max(int(y - rim_y), 0), min(int(y + rim_y), height - 1)
        if left > right or top > bottom:
            continue
        area = a0 * b1 - a1 * b0
        if abs(area) < 0.3:  # seen on edge: widen it a little
            area = 0.3 if area >= 0 else -0.3
        nx = along[n, 1] * across[n, 2] - along[n, 2] * across[n, 1]
        ny = along[n, 2] * across[n, 0] - along[n, 0] * across[n, 2]
        nz = along[n, 0] * across[n, 1] - along[n, 1] * across[n, 0]
        size = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
        facing = (nx * sun[0] + ny * sun[1] + nz * sun[2]) / size
        seen = nz / size
        through = facing * seen < 0  # the sun shines on the side turned away, so we see light that came through
        direct = sun_power * light[n, 0] * (0.30 + 0.70 * abs(facing))
        red, green, blue = rgb[n]
        if through:
            red, green, blue = red * 0.85, green * 0.80, blue * 0.45
        diffuse = sky_power * light[n, 1]
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                px, py = column + 0.5 - x, row + 0.5 - y
                s = (px * b1 - py * b0) / area
                t = (py * a0 - px * a1) / area
                if abs(s) > 1.0 or abs(t) > 1.0 - 0.85 * s * s:
                    continue
                here = depth - (s * along[n, 2] + t * across[n, 2])
                if here >= canvas.depth[row, column]:
                    continue
                fold = 1.06 if t > 0 else 0.94
                power = (direct + diffuse) * fold
                canvas.depth[row, column] = here
                canvas.rgb[row, column, 0] = red * power
                canvas.rgb[row, column, 1] = green * power
                canvas.rgb[row, column, 2] = blue * power
