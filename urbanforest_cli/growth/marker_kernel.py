"""Room: markers scattered in space, one a cell, that buds perceive and internodes take.

After Runions et al. 2007 and Palubicki et al. 2009: a bud perceives free markers within a range and a cone about its
direction; each goes to the nearest bud that perceives it; markers near an internode are taken.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.light_kernel import is_solid
from urbanforest_cli.growth.state_kernel import BLOCKED, FREE, TAKEN

JITTER_PERIOD = 16
NOBODY = np.float32(1e30)
LEAST_PERCEIVED_CELLS, LEAST_TAKEN_CELLS = 2.0, 0.7


@njit(cache=True, nogil=True, error_model="numpy")
def marker_jitter(cell_m):
    """Return (4096, 3) places of the markers within their cells, repeated every 16 cells of the world."""
    jitter = np.empty((JITTER_PERIOD**3, 3), np.float32)
    for cell in range(JITTER_PERIOD**3):
        for axis in range(3):
            z = np.uint64(cell * 3 + axis + 1) * np.uint64(0x9E3779B97F4A7C15)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z ^= z >> np.uint64(31)
            jitter[cell, axis] = cell_m * float(z >> np.uint64(11)) * 1.1102230246251565e-16
    return jitter


@njit(cache=True, nogil=True, error_model="numpy")
def perceived_within(internodes, internode_m, cell):
    """Return the range in metres of a bud's perception, never so short that the markers' spacing hides all room."""
    return max(internodes * internode_m, LEAST_PERCEIVED_CELLS * cell)


@njit(cache=True, nogil=True, error_model="numpy")
def taken_within(internodes, internode_m, cell):
    """Return the radius in metres within which an internode takes markers."""
    return max(internodes * internode_m, LEAST_TAKEN_CELLS * cell)


@njit(cache=True, nogil=True, error_model="numpy")
def block_built(grids):
    """Mark the markers inside what is built."""
    if grids.solid_top.size == 1:
        return
    nz, ny, nx = grids.marker_shape
    for iy in range(ny):
        for ix in range(nx):
            for iz in range(nz):
                place = grids.jitter[((iz % 16) * 16 + iy % 16) * 16 + ix % 16]
                x, y, z = ix * grids.marker_m + place[0], iy * grids.marker_m + place[1], iz * grids.marker_m + place[2]
                if is_solid(grids, x, y, z):
                    grids.marker[(iz * ny + iy) * nx + ix] = BLOCKED


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def take_markers(grids, x, y, z, radius, state):
    """Set the markers within a radius of a point from free to taken, or back.

    Inlined, since handing over all the grids costs more than the work.
    """
    _set_markers(grids.marker, grids.marker_shape, grids.marker_m, grids.jitter, x, y, z, radius, state)


@njit(cache=True, nogil=True, error_model="numpy")
def _set_markers(marker, shape, cell, jitter, x, y, z, radius, state):
    nz, ny, nx = shape
    before = FREE if state == TAKEN else TAKEN
    limit = radius * radius
    for iz in range(max(int((z - radius) / cell), 0), min(int((z + radius) / cell) + 1, nz)):
        for iy in range(max(int((y - radius) / cell), 0), min(int((y + radius) / cell) + 1, ny)):
            row = (iz * ny + iy) * nx
            table = ((iz & 15) * 16 + (iy & 15)) * 16
            for ix in range(max(int((x - radius) / cell), 0), min(int((x + radius) / cell) + 1, nx)):
                if marker[row + ix] != before:
                    continue
                place = table + (ix & 15)
                mx = ix * cell + jitter[place, 0] - x
                my = iy * cell + jitter[place, 1] - y
                mz = iz * cell + jitter[place, 2] - z
                if mx * mx + my * my + mz * mz < limit:
                    marker[row + ix] = state


@njit(cache=True, nogil=True, error_model="numpy")
def perceive(nodes, buds, chosen, chosen_count, plants, traits, grids, reach, cone, room):
    """Find for each chosen bud the direction of its own free markers.

    Parameters
    ----------
    reach
        Range of perception in internodes.
    cone
        Cosine of half the angle of perception.
    room
        (chosen_count, 4) written: unit direction or zero, and how many free markers are in the cone, own or not.
    """
    seen_cell = np.empty(64 * chosen_count + 64, np.int32)
    seen_to = np.empty((len(seen_cell), 3), np.float32)
    first = np.zeros(chosen_count + 1, np.int64)
    count = 0
    for c in range(chosen_count):
        b = chosen[c]
        node = buds.node[b]
        internode = traits[plants.species[nodes.plant[node]]].internode_length_m
        radius = perceived_within(reach, internode, grids.marker_m)
        first[c] = count
        most = int(2.0 * radius / grids.marker_m + 2.0) ** 3
        if count + most > len(seen_cell):
            seen_cell = np.concatenate((seen_cell, np.empty(len(seen_cell) + most, np.int32)))
            seen_to = np.concatenate((seen_to, np.empty((len(seen_to) + most, 3), np.float32)))
        count = _see(
            grids.marker, grids.marker_shape, grids.marker_m, grids.jitter, grids.near, grids.owner,
            nodes.xyz[node], buds.direction[b], radius, cone, c, seen_cell, seen_to, count,
        )  # fmt: skip
    first[chosen_count] = count
    for c in range(chosen_count):
        sx = sy = sz = 0.0
        for k in range(first[c], first[c + 1]):
            if grids.owner[seen_cell[k]] == c:
                sx += seen_to[k, 0]
                sy += seen_to[k, 1]
                sz += seen_to[k, 2]
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        own = 1.0 / length if length > 1e-6 else 0.0
        room[c, 0], room[c, 1], room[c, 2] = sx * own, sy * own, sz * own
        room[c, 3] = first[c + 1] - first[c]
    for k in range(count):
        grids.near[seen_cell[k]] = NOBODY


@njit(cache=True, nogil=True, error_model="numpy")
def _see(marker, shape, cell, jitter, near, owner, xyz, direction, radius, cone, c, seen_cell, seen_to, count):
    """List the free markers in one bud's cone with their directions, and note where it is the nearest bud so far."""
    x, y, z = float(xyz[0]), float(xyz[1]), float(xyz[2])
    dx, dy, dz = float(direction[0]), float(direction[1]), float(direction[2])
    limit = radius * radius
    narrow = cone > 0.707  # the cone's box then leaves out the half space behind it
    lx = max(int((x + radius * (max(min(dx - 0.77, 0.0), -1.0) if narrow else -1.0)) / cell), 0)
    ly = max(int((y + radius * (max(min(dy - 0.77, 0.0), -1.0) if narrow else -1.0)) / cell), 0)
    lz = max(int((z + radius * (max(min(dz - 0.77, 0.0), -1.0) if narrow else -1.0)) / cell), 0)
    hx = min(int((x + radius * (min(max(dx + 0.77, 0.0), 1.0) if narrow else 1.0)) / cell) + 1, shape[2])
    hy = min(int((y + radius * (min(max(dy + 0.77, 0.0), 1.0) if narrow else 1.0)) / cell) + 1, shape[1])
    hz = min(int((z + radius * (min(max(dz + 0.77, 0.0), 1.0) if narrow else 1.0)) / cell) + 1, shape[0])
    for iz in range(lz, hz):
        for iy in range(ly, hy):
            row = (iz * shape[1] + iy) * shape[2]
            table = ((iz & 15) * 16 + (iy & 15)) * 16
            for ix in range(lx, hx):
                if marker[row + ix] != FREE:
                    continue
                place = table + (ix & 15)
                mx = ix * cell + jitter[place, 0] - x
                my = iy * cell + jitter[place, 1] - y
                mz = iz * cell + jitter[place, 2] - z
                square = mx * mx + my * my + mz * mz
                ahead = mx * dx + my * dy + mz * dz
                if square >= limit or ahead <= 0.0 or ahead * ahead < cone * cone * square:
                    continue
                length = np.sqrt(square) + 1e-9
                seen_cell[count] = row + ix
                seen_to[count, 0], seen_to[count, 1], seen_to[count, 2] = mx / length, my / length, mz / length
                count += 1
                if square < near[row + ix]:
                    near[row + ix] = square
                    owner[row + ix] = c
    return count
