"""How much of the sun's and the sky's light reaches each place of a city.

Leaves and houses are counted into maps seen from the sun: a point (x, y, z) lies on the map where the sun's ray through
it meets the ground. So a crown's shade is one sum along a column of the map, whatever the size of the city. Maps come
in rings, fine where the viewer is near and coarse farther away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.export.view.draw_kernel import matrix_of

OPAQUE = 4.0  # optical depth a metre of a house, for the light of the sky
RIM_SHARE, SEAM_SHARE = 0.004, 0.07  # of a ring's width: what is not used, and what is mixed with the next ring


class Ring(NamedTuple):
    """The light in a square part of the city."""

    low: NDArray[np.float64]  # (2,) corner
    cell: float  # metres
    layer: float  # metres of height
    slant: NDArray[np.float64]  # (2,) metres that the sun's ray moves a metre of height
    shade: NDArray[np.float32]  # (layers + 1, ny, nx) optical depth of leaves from a layer's floor up to the sun
    solid: NDArray[np.float32]  # (ny, nx) height below which houses hide the sun
    sky_cell: float
    sky_layer: float
    leaf: NDArray[np.float32]  # (sky layers, sy, sx) optical depth of leaves in each cell, straight up
    roof: NDArray[np.float32]  # (sy, sx) height of houses
    open: NDArray[np.float32]  # (sky layers, sy, sx) share of the sky that is seen


@njit(cache=True, nogil=True, error_model="numpy")
def splat(ring, x, y, z, power, top, bottom, sky_top, sky_bottom):
    """Add square metres of leaves at a place, to rows from `top` to `bottom` of the sun's map, and to the sky's."""
    layer = int(z / ring.layer)
    if z >= 0 and layer < ring.shade.shape[0] - 1:
        u = (x - z * ring.slant[0] - ring.low[0]) / ring.cell - 0.5
        v = (y - z * ring.slant[1] - ring.low[1]) / ring.cell - 0.5
        i, j = int(np.floor(u)), int(np.floor(v))
        if 0 <= i < ring.shade.shape[2] - 1 and top - 1 <= j < bottom:
            fu, fv = u - i, v - j
            amount = power / (ring.cell * ring.cell)
            if j >= top:
                ring.shade[layer, j, i] += amount * (1 - fu) * (1 - fv)
                ring.shade[layer, j, i + 1] += amount * fu * (1 - fv)
            if j + 1 < bottom and j + 1 >= top:
                ring.shade[layer, j + 1, i] += amount * (1 - fu) * fv
                ring.shade[layer, j + 1, i + 1] += amount * fu * fv
    i, j = int((x - ring.low[0]) / ring.sky_cell), int((y - ring.low[1]) / ring.sky_cell)
    k = int(z / ring.sky_layer)
    if 0 <= i < ring.leaf.shape[2] and sky_top <= j < sky_bottom and 0 <= k < ring.leaf.shape[0] and x >= ring.low[0]:
        ring.leaf[k, j, i] += power / (ring.sky_cell * ring.sky_cell)


@njit(cache=True, nogil=True, error_model="numpy")
def splat_plants(ring, models, instances, extinction, leaves_max, top, bottom, sky_top, sky_bottom):
    """Count the leaves and branches of plants into a ring; at most `leaves_max` leaves a plant stand for all."""
    for n in range(len(instances.model)):
        model, k = instances.model[n], instances.scale[n]
        reach, height = models.reach[model] * k, models.top[model] * k
        x, y = instances.place[n, 0], instances.place[n, 1]
        sun_low, sun_high = min(y, y - height * ring.slant[1]) - reach, max(y, y - height * ring.slant[1]) + reach
        in_sun = sun_high >= ring.low[1] + (top - 2) * ring.cell and sun_low < ring.low[1] + (bottom + 2) * ring.cell
        in_sky = (
            y + reach >= ring.low[1] + (sky_top - 2) * ring.sky_cell
            and y - reach < ring.low[1] + (sky_bottom + 2) * ring.sky_cell
        )
        if not (in_sun or in_sky):
            continue
        side = ring.cell * ring.shade.shape[2]
        far = height * abs(ring.slant[0]) + reach
        if x + far < ring.low[0] or x - far > ring.low[0] + side:
            continue
        m = matrix_of(instances, n)
        first = models.first_leaf[model]
        count = models.first_leaf[model + 1] - first
        if instances.leaf_count[n] > 0 and count > 0:
            used = min(count, leaves_max)
            power = extinction * models.leaf_area[model] * k * k * count / used
            for s in range(first, first + used):
                a, b, c = float(models.leaf[s, 0]), float(models.leaf[s, 1]), float(models.leaf[s, 2])
                splat(ring, m[0, 0] * a + m[0, 1] * b + x, m[1, 0] * a + m[1, 1] * b + y, m[2, 2] * c, power,
                      top, bottom, sky_top, sky_bottom)  # fmt: skip
        first = models.first_wood[model]
        for s in range(first, first + instances.wood_count[n]):
            thick = (models.wood[s, 6] + models.wood[s, 7]) * k
            if thick < 0.15 * ring.cell:
                break
            dx = models.wood[s, 3] - models.wood[s, 0]
            dy = models.wood[s, 4] - models.wood[s, 1]
            dz = models.wood[s, 5] - models.wood[s, 2]
            length = k * np.sqrt(dx * dx + dy * dy + dz * dz)
            parts = int(length / max(0.7 * ring.cell, 0.05)) + 1
            for part in range(parts):
                t = (part + 0.5) / parts
                a, b = models.wood[s, 0] + t * dx, models.wood[s, 1] + t * dy
                c = models.wood[s, 2] + t * dz
                splat(ring, m[0, 0] * a + m[0, 1] * b + x, m[1, 0] * a + m[1, 1] * b + y, m[2, 2] * c,
                      1.5 * thick * length / parts, top, bottom, sky_top, sky_bottom)  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def raise_faces(height, low, cell, slant, corners):
    """Keep, at each cell of a map, the height of the highest of flat triangles (n, 3, 3) that a slanting ray meets."""
    ny, nx = height.shape
    for n in range(len(corners)):
        x0 = (corners[n, 0, 0] - corners[n, 0, 2] * slant[0] - low[0]) / cell
        y0 = (corners[n, 0, 1] - corners[n, 0, 2] * slant[1] - low[1]) / cell
        x1 = (corners[n, 1, 0] - corners[n, 1, 2] * slant[0] - low[0]) / cell
        y1 = (corners[n, 1, 1] - corners[n, 1, 2] * slant[1] - low[1]) / cell
        x2 = (corners[n, 2, 0] - corners[n, 2, 2] * slant[0] - low[0]) / cell
        y2 = (corners[n, 2, 1] - corners[n, 2, 2] * slant[1] - low[1]) / cell
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        left, right = max(int(np.floor(min(x0, x1, x2))), 0), min(int(max(x0, x1, x2)) + 1, nx - 1)
        top, bottom = max(int(np.floor(min(y0, y1, y2))), 0), min(int(max(y0, y1, y2)) + 1, ny - 1)
        for j in range(top, bottom + 1):
            for i in range(left, right + 1):
                px, py = i + 0.5, j + 0.5
                w0 = ((x1 - px) * (y2 - py) - (x2 - px) * (y1 - py)) / area
                w1 = ((x2 - px) * (y0 - py) - (x0 - px) * (y2 - py)) / area
                w2 = 1.0 - w0 - w1
                if w0 < -1e-9 or w1 < -1e-9 or w2 < -1e-9:
                    continue
                z = w0 * corners[n, 0, 2] + w1 * corners[n, 1, 2] + w2 * corners[n, 2, 2]
                if z > height[j, i]:
                    height[j, i] = z


@njit(cache=True, nogil=True, error_model="numpy")
def sum_up(ring):
    """Turn leaves in layers of the sun's map into sums from the top down."""
    layers, ny, nx = ring.shade.shape
    for k in range(layers - 2, -1, -1):
        for j in range(ny):
            for i in range(nx):
                ring.shade[k, j, i] += ring.shade[k + 1, j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def open_up(ring, rays):
    """Fill in what share of the sky each cell sees; `rays` (n, 3) directions, upward, each of the same share."""
    layers, ny, nx = ring.leaf.shape
    ring.open[:] = 0.0
    above = np.empty((ny, nx), np.float32)
    here = np.empty((ny, nx), np.float32)
    for d in range(len(rays)):
        above[:] = 1.0
        long = 1.0 / rays[d, 2]  # metres of ray a metre of height
        dx = rays[d, 0] * long * ring.sky_layer / ring.sky_cell
        dy = rays[d, 1] * long * ring.sky_layer / ring.sky_cell
        path = min(long, 2.5)
        for k in range(layers - 1, -1, -1):
            floor = k * ring.sky_layer
            for j in range(ny):
                for i in range(nx):
                    u, v = i + dx, j + dy
                    p, q = int(np.floor(u)), int(np.floor(v))
                    if k == layers - 1 or p < 0 or q < 0 or p >= nx - 1 or q >= ny - 1:
                        light = 1.0
                    else:
                        fu, fv = u - p, v - q
                        light = ((above[q, p] * (1 - fu) + above[q, p + 1] * fu) * (1 - fv)
                                 + (above[q + 1, p] * (1 - fu) + above[q + 1, p + 1] * fu) * fv)  # fmt: skip
                    filled = min(max((ring.roof[j, i] - floor) / ring.sky_layer, 0.0), 1.0)
                    through = np.exp(-(ring.leaf[k, j, i] * path + OPAQUE * filled * ring.sky_layer * path))
                    half = np.exp(-0.5 * ring.leaf[k, j, i] * path) if filled <= 0 else 1.0 - 0.5 * filled
                    ring.open[k, j, i] += light * half / len(rays)
                    here[j, i] = light * through
            above, here = here, above


@njit(cache=True, nogil=True, error_model="numpy")
def inside_by(ring, x, y, z):
    """Return how far from a ring's rim a place and its shade lie, in shares of its width; below 0 outside."""
    width = ring.cell * ring.shade.shape[2]
    low_x, high_x = min(x, x - z * ring.slant[0]), max(x, x - z * ring.slant[0])
    low_y, high_y = min(y, y - z * ring.slant[1]), max(y, y - z * ring.slant[1])
    west, south = low_x - ring.low[0], low_y - ring.low[1]
    east, north = ring.low[0] + width - high_x, ring.low[1] + width - high_y
    return min(min(west, east), min(south, north)) / width


@njit(cache=True, nogil=True, error_model="numpy")
def ring_at(rings, x, y, z):
    """Return which ring lights a place, the finest that holds it, and what share of its light is the next one's."""
    for r in range(len(rings)):
        far = inside_by(rings[r], x, y, z)
        if far > RIM_SHARE:
            seam = 0.0
            if r < len(rings) - 1:
                seam = max(1.0 - (far - RIM_SHARE) / SEAM_SHARE, 0.0)
            return r, seam
    return len(rings), 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def leaf_depth(ring, x, y, z):
    """Return the optical depth of leaves between a place and the sun."""
    u = (x - z * ring.slant[0] - ring.low[0]) / ring.cell - 0.5
    v = (y - z * ring.slant[1] - ring.low[1]) / ring.cell - 0.5
    i, j = int(np.floor(u)), int(np.floor(v))
    if i < 0 or j < 0 or i >= ring.shade.shape[2] - 1 or j >= ring.shade.shape[1] - 1:
        return 0.0
    fu, fv = u - i, v - j
    w = max(z, 0.0) / ring.layer
    k = int(w)
    if k >= ring.shade.shape[0] - 1:
        return 0.0
    fw = w - k
    low = (ring.shade[k, j, i] * (1 - fu) + ring.shade[k, j, i + 1] * fu) * (1 - fv) + (
        ring.shade[k, j + 1, i] * (1 - fu) + ring.shade[k, j + 1, i + 1] * fu
    ) * fv
    high = (ring.shade[k + 1, j, i] * (1 - fu) + ring.shade[k + 1, j, i + 1] * fu) * (1 - fv) + (
        ring.shade[k + 1, j + 1, i] * (1 - fu) + ring.shade[k + 1, j + 1, i + 1] * fu
    ) * fv
    return low * (1 - fw) + high * fw


@njit(cache=True, nogil=True, error_model="numpy")
def beside_houses(ring, x, y, z):
    """Return the share of the sun that houses leave; its edge is soft, by a quadratic spline over three cells."""
    u = (x - z * ring.slant[0] - ring.low[0]) / ring.cell - 0.5
    v = (y - z * ring.slant[1] - ring.low[1]) / ring.cell - 0.5
    i, j = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    if i < 1 or j < 1 or i >= ring.solid.shape[1] - 1 or j >= ring.solid.shape[0] - 1:
        return 1.0
    fu, fv = u - i, v - j  # from -0.5 to 0.5
    along = (0.5 * (0.5 - fu) ** 2, 0.75 - fu * fu, 0.5 * (0.5 + fu) ** 2)
    across = (0.5 * (0.5 - fv) ** 2, 0.75 - fv * fv, 0.5 * (0.5 + fv) ** 2)
    lit, all_lit = 0.0, True
    for q in range(3):
        for p in range(3):
            if ring.solid[j + q - 1, i + p - 1] <= z:
                lit += across[q] * along[p]
            else:
                all_lit = False
    return 1.0 if all_lit else lit


@njit(cache=True, nogil=True, error_model="numpy")
def open_sky(ring, x, y, z):
    """Return the share of the sky that a place sees."""
    u = (x - ring.low[0]) / ring.sky_cell - 0.5
    v = (y - ring.low[1]) / ring.sky_cell - 0.5
    w = z / ring.sky_layer - 0.5
    layers, ny, nx = ring.open.shape
    i, j = int(np.floor(u)), int(np.floor(v))
    if i < 0 or j < 0 or i >= nx - 1 or j >= ny - 1:
        return 1.0
    w = max(w, 0.0)
    k = int(w)
    if k >= layers - 1:
        return 1.0
    fu, fv, fw = u - i, v - j, w - k
    low = (ring.open[k, j, i] * (1 - fu) + ring.open[k, j, i + 1] * fu) * (1 - fv) + (
        ring.open[k, j + 1, i] * (1 - fu) + ring.open[k, j + 1, i + 1] * fu
    ) * fv
    high = (ring.open[k + 1, j, i] * (1 - fu) + ring.open[k + 1, j, i + 1] * fu) * (1 - fv) + (
        ring.open[k + 1, j + 1, i] * (1 - fu) + ring.open[k + 1, j + 1, i + 1] * fu
    ) * fv
    return low * (1 - fw) + high * fw
