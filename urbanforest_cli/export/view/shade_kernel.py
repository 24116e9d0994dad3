"""Light on what is seen: sun, sky, what the ground gives back, and the haze between it and the viewer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.export.plant_light_kernel import chance, hash_pair
from urbanforest_cli.export.view.draw_kernel import (
    GLASS,
    GROUND,
    KERB,
    LAWN,
    LEAF,
    NOTHING,
    PAVING,
    ROAD,
    ROOF,
    WALL,
    WOOD,
)
from urbanforest_cli.export.view.light_kernel import beside_houses, leaf_depth, open_sky, ring_at

PLAIN_HAZE = 2.2  # the plain beyond the city fades so much faster than what stands on it
NOISE_MIN_PX = 1.5  # grains smaller than this many pixels are not drawn
SAME_DEPTH = 0.01  # places of a pixel that lie no farther apart than this share of their depth are lit as one,
SAME_DEPTH_PX = 2.0  # without perspective, this many widths of the pixel


class Light(NamedTuple):
    """Light and air; colours linear."""

    sun: NDArray[np.float64]  # (3,) direction toward it in the scene
    sun_seen: NDArray[np.float64]  # (3,) the same in the camera's frame
    sun_rgb: NDArray[np.float64]
    sky_rgb: NDArray[np.float64]
    bounce_rgb: NDArray[np.float64]  # from the ground
    zenith_rgb: NDArray[np.float64]
    horizon_rgb: NDArray[np.float64]
    glow_rgb: NDArray[np.float64]  # added to the horizon toward the sun
    haze_from_m: float
    haze_m: float  # beyond the start, where 1 - 1/e of the light is the air's
    plain: bool  # no haze
    back: NDArray[np.float64]  # (rows, 3) what is seen behind all in each row of the canvas; no rows: the sky
    fade: NDArray[np.float64]  # (4,) before such a back: middle of the ground, half widths beside and away from it


@njit(cache=True, nogil=True, error_model="numpy")
def grain(x, y, size, salt):
    """Return smooth noise from 0 to 1 with spots of a size."""
    u, v = x / size, y / size
    i, j = int(np.floor(u)), int(np.floor(v))
    fu, fv = u - i, v - j
    fu, fv = fu * fu * (3 - 2 * fu), fv * fv * (3 - 2 * fv)
    i, j = i + 1000003 + 7919 * salt, j + 1000003
    a, b = chance(hash_pair(i, j)), chance(hash_pair(i + 1, j))
    c, d = chance(hash_pair(i, j + 1)), chance(hash_pair(i + 1, j + 1))
    return (a * (1 - fu) + b * fu) * (1 - fv) + (c * (1 - fu) + d * fu) * fv


@njit(cache=True, nogil=True, error_model="numpy")
def sky_at(light, dx, dy, dz):
    """Return the colour of the sky in a direction."""
    up = max(dz, 0.0)
    share = 1.0 - 0.5 * np.exp(-3.0 * up) - 0.5 * np.exp(-30.0 * up)
    side = np.sqrt(dx * dx + dy * dy) + 1e-9
    flat = np.sqrt(light.sun[0] ** 2 + light.sun[1] ** 2) + 1e-9
    toward = (dx * light.sun[0] + dy * light.sun[1]) / (side * flat)
    glow = (0.5 + 0.5 * toward) ** 3 * np.exp(-6.0 * up)
    r = light.horizon_rgb[0] + (light.zenith_rgb[0] - light.horizon_rgb[0]) * share + light.glow_rgb[0] * glow
    g = light.horizon_rgb[1] + (light.zenith_rgb[1] - light.horizon_rgb[1]) * share + light.glow_rgb[1] * glow
    b = light.horizon_rgb[2] + (light.zenith_rgb[2] - light.horizon_rgb[2]) * share + light.glow_rgb[2] * glow
    return r, g, b


@njit(cache=True, nogil=True, error_model="numpy")
def light_in(ring, light, kind, x, y, z, wx, wy, wz, facing, chance_here):
    """Return the shares of sun and sky at a place whose surface looks along (wx, wy, wz).

    `facing` is the share of the normal toward the sun; by `chance_here`, from -0.5 to 0.5, leaves and twigs lie more or
    less deep in the shade of those around them.
    """
    step, off = 0.1 + 0.8 * ring.cell, 0.04
    if kind == LEAF:
        step, off = 0.9 + 0.8 * chance_here, 0.0
    elif kind == WOOD:
        step, off = 0.7 + 0.4 * chance_here, 0.35
    elif kind in (WALL, GLASS, ROOF):  # so that a face does not shade itself
        off += 1.5 * ring.cell * (1.0 - facing)
    sunny = 1.0
    if facing > 0 or kind == LEAF:
        sx, sy, sz = x + light.sun[0] * step + wx * off, y + light.sun[1] * step + wy * off, (
            z + light.sun[2] * step + wz * off)  # fmt: skip
        sunny = beside_houses(ring, sx, sy, sz)
        if sunny > 0:
            sunny *= np.exp(-leaf_depth(ring, sx, sy, sz))
    if kind in (LEAF, WOOD):
        return sunny, open_sky(ring, x, y, z + 0.3)
    lift = 0.6 * ring.sky_cell if abs(wz) > 0.5 else 1.1 * ring.sky_cell
    return sunny, open_sky(ring, x + wx * lift, y + wy * lift, z + 0.05)


@njit(cache=True, nogil=True, error_model="numpy")
def shade_rows(canvas, view, rings, light, factor, out, top, bottom):
    """Light the rows from `top` to `bottom` of the picture `out` (h, w, 3), `factor` squared places of it a pixel."""
    width = out.shape[1]
    wide = width * factor
    far_add = 0.0 if view.perspective else 1e4
    up0, up1, up2 = view.axes[0, 2], view.axes[1, 2], view.axes[2, 2]
    for out_row in range(top, bottom):
        for out_column in range(width):
            red, green, blue = 0.0, 0.0, 0.0
            count, aside = factor * factor, 0.5
            depth = one_depth(canvas, view, out_row * factor, out_column * factor, factor)
            if depth > 0:
                count, aside = 1, 0.5 * factor
            for sub in range(count):
                row, column = out_row * factor + sub // factor, out_column * factor + sub % factor
                if count > 1:
                    depth = float(canvas.depth[row, column])
                kind = canvas.kind[row, column]
                a = (column + aside - view.middle[0]) / view.scale
                b = (view.middle[1] - row - aside) / view.scale
                # Direction of sight in the scene.
                dx = view.axes[0, 0] * a + view.axes[1, 0] * b - view.axes[2, 0]
                dy = view.axes[0, 1] * a + view.axes[1, 1] * b - view.axes[2, 1]
                dz = view.axes[0, 2] * a + view.axes[1, 2] * b - view.axes[2, 2]
                if not view.perspective:
                    dx, dy, dz = -view.axes[2, 0], -view.axes[2, 1], -view.axes[2, 2]
                slope = np.sqrt(dx * dx + dy * dy + dz * dz)
                if kind == NOTHING and len(light.back):
                    red, green = red + light.back[row, 0], green + light.back[row, 1]
                    blue += light.back[row, 2]
                    continue
                if kind == NOTHING:
                    r, g, bl = sky_at(light, dx / slope, dy / slope, dz / slope)
                    red, green, blue = red + r, green + g, blue + bl
                    continue
                if view.perspective:
                    x, y, z = view.eye[0] + dx * depth, view.eye[1] + dy * depth, view.eye[2] + dz * depth
                    size = depth / view.scale
                else:
                    deep = far_add - depth
                    x = view.eye[0] + view.axes[0, 0] * a + view.axes[1, 0] * b + view.axes[2, 0] * deep
                    y = view.eye[1] + view.axes[0, 1] * a + view.axes[1, 1] * b + view.axes[2, 1] * deep
                    z = view.eye[2] + view.axes[0, 2] * a + view.axes[1, 2] * b + view.axes[2, 2] * deep
                    size = 1.0 / view.scale
                n0 = canvas.normal[row, column, 0] / 127.0
                n1 = canvas.normal[row, column, 1] / 127.0
                n2 = canvas.normal[row, column, 2] / 127.0
                facing = n0 * light.sun_seen[0] + n1 * light.sun_seen[1] + n2 * light.sun_seen[2]
                upward = n0 * up0 + n1 * up1 + n2 * up2
                chance_here = 0.0
                if kind in (LEAF, WOOD):
                    chance_here = chance(hash_pair((row + view.top) * wide + column, 11)) - 0.5
                # The normal in the scene moves the place off its own surface.
                wx = view.axes[0, 0] * n0 + view.axes[1, 0] * n1 + view.axes[2, 0] * n2
                wy = view.axes[0, 1] * n0 + view.axes[1, 1] * n1 + view.axes[2, 1] * n2
                wz = view.axes[0, 2] * n0 + view.axes[1, 2] * n1 + view.axes[2, 2] * n2
                sunny, sky = 1.0, 1.0
                which, seam = ring_at(rings, x, y, z)
                if which < len(rings):
                    sunny, sky = light_in(rings[which], light, kind, x, y, z, wx, wy, wz, facing, chance_here)
                    if seam > 0:
                        more, above = light_in(rings[which + 1], light, kind, x, y, z, wx, wy, wz, facing, chance_here)
                        sunny, sky = sunny + seam * (more - sunny), sky + seam * (above - sky)
                albedo_r = (canvas.rgb[row, column, 0] / 255.0) ** 2
                albedo_g = (canvas.rgb[row, column, 1] / 255.0) ** 2
                albedo_b = (canvas.rgb[row, column, 2] / 255.0) ** 2
                if kind == LEAF:
                    direct = 0.22 + 0.78 * abs(facing)
                    if facing < 0:  # light that came through the blade
                        albedo_r, albedo_g, albedo_b = albedo_r * 0.98, albedo_g * 1.0, albedo_b * 0.55
                        direct *= 0.6
                    ambient = 0.75 + 0.25 * upward
                    below = 0.5
                else:
                    direct = max(facing, 0.0)
                    ambient = 0.5 + 0.5 * upward
                    below = 0.5 - 0.5 * upward
                    if kind == WOOD:
                        ambient = 0.8
                    if kind in (LAWN, GROUND, PAVING, ROAD, KERB):
                        tone = ground_tone(kind, x, y, size * factor)
                        albedo_r, albedo_g, albedo_b = albedo_r * tone, albedo_g * tone, albedo_b * tone
                        ambient = 0.35 + 0.65 * ambient
                    if kind == GLASS:
                        dim = 0.45 + 0.30 * min(size / 0.06, 1.0)
                        albedo_r, albedo_g, albedo_b = albedo_r * dim, albedo_g * (dim + 0.03), albedo_b * (dim + 0.06)
                    if kind in (WALL, GLASS):
                        foot = min(max(z, 0.0) / 3.5, 1.0)
                        sky *= 0.82 + 0.18 * foot
                s = direct * sunny
                open_low = 0.25 + 0.75 * sky
                r = albedo_r * (light.sun_rgb[0] * s + light.sky_rgb[0] * ambient * sky
                                + light.bounce_rgb[0] * below * open_low)  # fmt: skip
                g = albedo_g * (light.sun_rgb[1] * s + light.sky_rgb[1] * ambient * sky
                                + light.bounce_rgb[1] * below * open_low)  # fmt: skip
                bl = albedo_b * (light.sun_rgb[2] * s + light.sky_rgb[2] * ambient * sky
                                 + light.bounce_rgb[2] * below * open_low)  # fmt: skip
                if kind == GLASS:
                    r, g, bl = r + 0.06 * light.horizon_rgb[0], g + 0.06 * light.horizon_rgb[1], (
                        bl + 0.06 * light.horizon_rgb[2])  # fmt: skip
                if kind == GROUND and len(light.back):
                    veil = 1.0 - ground_share(view, light, x, y)
                    r, g, bl = r + (light.back[row, 0] - r) * veil, g + (light.back[row, 1] - g) * veil, (
                        bl + (light.back[row, 2] - bl) * veil)  # fmt: skip
                if not light.plain:
                    far = max(depth * slope - light.haze_from_m, 0.0)
                    veil = 1.0 - np.exp(-far / light.haze_m * (PLAIN_HAZE if kind == GROUND else 1.0))
                    hr, hg, hb = sky_at(light, dx / slope, dy / slope, 0.0)
                    r, g, bl = r + (hr - r) * veil, g + (hg - g) * veil, bl + (hb - bl) * veil
                red, green, blue = red + r, green + g, blue + bl
            out[out_row, out_column, 0] = red / count
            out[out_row, out_column, 1] = green / count
            out[out_row, out_column, 2] = blue / count


@njit(cache=True, nogil=True, error_model="numpy")
def one_depth(canvas, view, top, left, factor):
    """Return the depth of a pixel whose places all show one flat surface or the sky; 0 where they do not."""
    kind = canvas.kind[top, left]
    if kind in (LEAF, WOOD):
        return 0.0
    near, far, total = np.inf, 0.0, 0.0
    for row in range(top, top + factor):
        for column in range(left, left + factor):
            if canvas.kind[row, column] != kind:
                return 0.0
            for c in range(3):
                if (canvas.rgb[row, column, c] != canvas.rgb[top, left, c]
                        or canvas.normal[row, column, c] != canvas.normal[top, left, c]):  # fmt: skip
                    return 0.0
            depth = float(canvas.depth[row, column])
            near, far, total = min(near, depth), max(far, depth), total + depth
    if kind == NOTHING:
        return np.inf
    most = SAME_DEPTH * near if view.perspective else SAME_DEPTH_PX * factor / view.scale
    return total / (factor * factor) if far - near <= most else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def ground_share(view, light, x, y):
    """Return how much of the ground is seen where it fades into what is behind all."""
    gx, gy = x - light.fade[0], y - light.fade[1]
    side = abs(gx * view.axes[0, 0] + gy * view.axes[0, 1]) / light.fade[2]
    flat = np.sqrt(1.0 - view.axes[2, 2] ** 2 + 1e-12)
    deep = abs(gx * view.axes[2, 0] + gy * view.axes[2, 1]) / flat / light.fade[3]
    return max(1.0 - side**4, 0.0) * max(1.0 - deep**4, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def ground_tone(kind, x, y, size):
    """Return a factor near 1: grass in tufts and patches, stone in grains; spots below a pixel are left out."""
    tone = 1.0
    strength = 0.20 if kind == LAWN else 0.16 if kind == GROUND else 0.07
    for octave in range(6):
        spot = 0.06 * 5.0**octave
        clear = min(max(spot / size / NOISE_MIN_PX - 1.0, 0.0), 1.0)
        if clear > 0:
            tone += strength * clear * (grain(x, y, spot, octave) - 0.5) * (0.8 if octave == 0 else 0.5)
    return tone
