"""Light: the shadow pyramids of leafy internodes, what buildings leave of the sky, and the brightest spot seen.

Shadow propagation after Palubicki et al. 2009: an internode in a voxel takes a * b**-q of the light in the (2q+1)
squared voxels of each layer q below. Sums are integers, so that adding and taking away are exact in any order.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.state_kernel import SHADE_UNIT

CANOPY_M = 2.0  # edge of the cells in which the shade of a whole canopy is summed
LEAF_M2 = 1.5  # leaf area of an internode for each 1 of its leaf_shade
NURSERY_SEASONS, NURSERY_LIGHT = 3, 0.6  # a plant lives on what it brought from the nursery first, whatever the light


@njit(cache=True, nogil=True, error_model="numpy")
def voxel_of(grids, x, y, z):
    """Return the flat index of the voxel that holds a point of the frame."""
    ix = int(x / grids.voxel_m) + grids.pad
    iy = int(y / grids.voxel_m) + grids.pad
    iz = int(max(z, 0.0) / grids.voxel_m)
    return (iz * grids.voxel_shape[1] + iy) * grids.voxel_shape[2] + ix


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cast_layer(shade, voxel_shape, lean, amount, voxel, q):
    """Add to the (2q + 1) squared voxels of layer q; unsigned indices let the compiler add whole rows at once."""
    stride = voxel_shape[2]
    start = voxel - q * voxel_shape[1] * stride + (lean[q, 1] - q) * stride + lean[q, 0] - q
    at, step, width = np.uint64(start), np.uint64(stride), np.uint64(2 * q + 1)
    for _ in range(width):
        for i in range(width):
            shade[at + i] += amount
        at += step


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def cast_shade(grids, voxel, species, times):
    """Add `times` the shadow pyramid of an internode in a voxel (negative: take it away).

    Inlined, since handing over all the grids costs more than the work.
    """
    _cast_pyramid(grids.shade, grids.voxel_shape, grids.lean, grids.cast, voxel, species, times)


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_pyramid(shade, voxel_shape, lean, cast, voxel, species, times):
    depth = min(cast.shape[1] - 1, voxel // (voxel_shape[1] * voxel_shape[2]))
    shade[voxel] += times * cast[species, 0]
    for q in range(1, 6):  # a constant bound: the compiler unrolls the usual pyramid, an eighth of the time
        if q <= depth:
            _cast_layer(shade, voxel_shape, lean, np.int32(times * cast[species, q]), voxel, q)
    for q in range(6, depth + 1):
        _cast_layer(shade, voxel_shape, lean, np.int32(times * cast[species, q]), voxel, q)


@njit(cache=True, nogil=True, error_model="numpy")
def open_sky(grids, x, y, z):
    """Return the share of light that buildings leave at a point."""
    if grids.sky.size == 1:
        return 1.0
    iz = min(int(max(z, 0.0) / grids.sky_m), grids.sky.shape[0] - 1)
    iy = min(max(int(y / grids.sky_m), 0), grids.sky.shape[1] - 1)
    ix = min(max(int(x / grids.sky_m), 0), grids.sky.shape[2] - 1)
    return grids.sky[iz, iy, ix] / 255.0


@njit(cache=True, nogil=True, error_model="numpy")
def is_solid(grids, x, y, z):
    """Tell whether a point lies inside what is built, or within a hand's breadth above it."""
    if grids.solid_top.size == 1:
        return False
    iy = int(y / grids.column_m)
    ix = int(x / grids.column_m)
    if iy < 0 or ix < 0 or iy >= grids.solid_top.shape[0] or ix >= grids.solid_top.shape[1]:
        return False
    top = grids.solid_top[iy, ix]
    return top > 0.0 and z < top + 0.1


@njit(cache=True, nogil=True, error_model="numpy")
def canopy_light(nodes, live_count, plants, grids, neighbours, neighbour_shade, neighbour_count):
    """Return the light that reaches each coarse cell through all leaves above it, near or high.

    The pyramids end a few voxels below a leaf; below a closed canopy it is dark much deeper. Shade is summed from the
    top, spreading by a cell a layer, and dims light by the law of Beer and Lambert.

    Returns
    -------
    (nz, ny, nx) share of light, cells of CANOPY_M.
    """
    top = 0.0
    for p in range(len(plants.key)):
        top = max(top, plants.height[p])
    for g in range(neighbour_count):
        top = max(top, min(neighbours[g, 2], grids.size[2]))
    nz, ny, nx = int(top / CANOPY_M) + 1, int(grids.size[1] / CANOPY_M) + 1, int(grids.size[0] / CANOPY_M) + 1
    leaves = np.zeros((nz, ny + 2, nx + 2), np.float64)  # with a rim of one cell
    for i in range(live_count):
        node = nodes.live[i]
        x, y, z = nodes.xyz[node, 0], nodes.xyz[node, 1], nodes.xyz[node, 2]
        own = grids.cast[plants.species[nodes.plant[node]], 0]
        leaves[int(z / CANOPY_M), int(y / CANOPY_M) + 1, int(x / CANOPY_M) + 1] += own
    for g in range(neighbour_count):
        x, y, z = neighbours[g, 0], neighbours[g, 1], neighbours[g, 2]
        if x < 0.0 or y < 0.0 or z < 0.0 or x >= grids.size[0] or y >= grids.size[1] or z >= grids.size[2]:
            continue
        shade = int(neighbour_shade[g] + 0.5) * grids.cast[len(grids.cast) - 1, 0]
        leaves[int(z / CANOPY_M), int(y / CANOPY_M) + 1, int(x / CANOPY_M) + 1] += shade
    light = np.ones((nz, ny, nx), np.float64)
    scale = LEAF_M2 / (SHADE_UNIT * CANOPY_M * CANOPY_M * 9.0)
    across = np.zeros((ny + 2, nx + 2), np.float64)
    for z in range(nz - 2, -1, -1):
        for y in range(ny + 2):
            for x in range(1, nx + 1):
                across[y, x] = leaves[z + 1, y, x - 1] + leaves[z + 1, y, x] + leaves[z + 1, y, x + 1]
        for y in range(1, ny + 1):
            for x in range(1, nx + 1):
                depth = across[y - 1, x] + across[y, x] + across[y + 1, x]
                if depth > 0.0:
                    light[z, y - 1, x - 1] = np.exp(-scale * depth)
                    leaves[z, y, x] += depth / 9.0
    return light


@njit(cache=True, nogil=True, error_model="numpy")
def sense_light(nodes, buds, bud_count, plants, grids, canopy, senses_shade):
    """Write into each bud of a growing plant the light it catches: max(C - s + a, 0), C = 1, times the open sky."""
    self_shade = grids.cast[:, 0]
    for b in range(bud_count):
        node = buds.node[b]
        plant = nodes.plant[node]
        if plants.years[plant] == 0.0:
            continue
        if not senses_shade:
            buds.light[b] = 1.0
            continue
        shade = grids.shade[buds.voxel[b]] - self_shade[plants.species[plant]]
        light = max(1.0 - max(shade, 0) / SHADE_UNIT, 0.0)
        if light > 0.0 and grids.sky.size > 1:
            light *= open_sky(grids, nodes.xyz[node, 0], nodes.xyz[node, 1], nodes.xyz[node, 2])
        x, y, z = nodes.xyz[node, 0], nodes.xyz[node, 1], nodes.xyz[node, 2]
        light *= canopy[int(z / CANOPY_M), int(y / CANOPY_M), int(x / CANOPY_M)]
        if plants.now[plant] <= NURSERY_SEASONS:
            light = max(light, NURSERY_LIGHT)
        buds.light[b] = light


@njit(cache=True, nogil=True, error_model="numpy")
def brightest(grids, voxel, x, y, z, dx, dy, dz, out):
    """Write the direction of the brightest part of the sky that a bud sees within 90 degrees of its own direction.

    Each direction's light is dimmed by the shade in the voxels 1, 2 and 4 edges away from the bud's own, and by what is
    built within 12 m.
    """
    sx = sy = sz = 0.0
    for k in range(grids.ray.shape[0]):
        rx, ry, rz = grids.ray[k, 0], grids.ray[k, 1], grids.ray[k, 2]
        if rx * dx + ry * dy + rz * dz <= 0.0:
            continue
        light = 1.0
        for s in range(grids.ray_step.shape[1]):
            light *= max(1.0 - grids.shade[voxel + grids.ray_step[k, s]] * (1.0 / SHADE_UNIT), 0.05)
        if grids.solid_top.size > 1:
            length = 1.0
            for _ in range(8):
                if is_solid(grids, x + rx * length, y + ry * length, z + rz * length):
                    light = 0.0
                    break
                length += 1.5
        weight = grids.ray_light[k] * light * light
        sx += rx * weight
        sy += ry * weight
        sz += rz * weight
    length = np.sqrt(sx * sx + sy * sy + sz * sz)
    if length > 0.0:
        out[0], out[1], out[2] = sx / length, sy / length, sz / length
    else:
        out[0], out[1], out[2] = 0.0, 0.0, 0.0
