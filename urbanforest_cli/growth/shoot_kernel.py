"""Shoots: how long, which way, and what stops them.

A bud with vigour v sets a shoot of up to v internodes (Palubicki et al. 2009), no longer than its species' strongest
shoot, shorter by branching order and with age (Stava et al. 2014: GR, AC, ILAF). Its direction is the bud's, turned
toward free room, the brightest spot and the vertical.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.light_kernel import brightest, cast_shade, is_solid, voxel_of
from urbanforest_cli.growth.marker_kernel import take_markers, taken_within
from urbanforest_cli.growth.state_kernel import (
    APICAL,
    APICAL_NUMBER,
    LATERAL,
    STEM,
    TAKEN,
    buds_with_room,
    deviate,
    hash_bits,
    nodes_with_room,
    season_key,
)

SHORTEST = 0.1  # internodes: a bud that cannot set this much stays a bud
EDGE_M = 0.3
LEAST_DIRECTION = 1e-6


@njit(cache=True, nogil=True, error_model="numpy")
def shoot_length(traits, species, order, age, years, vigour):
    """Return the length of a shoot in internodes at full vigour."""
    control = 1.0 + (traits[species].shoot_control - 1.0) * traits[species].shoot_control_aging ** age
    longest = traits[species].shoot_internodes_max / control**order
    return min(vigour, longest) * traits[species].shoot_aging ** age * years


@njit(cache=True, nogil=True, error_model="numpy")
def side_vectors(dx, dy, dz, out):
    """Write two unit vectors square to a direction and to each other (Duff et al. 2017)."""
    sign = 1.0 if dz >= 0.0 else -1.0
    a = -1.0 / (sign + dz)
    b = dx * dy * a
    out[0], out[1], out[2] = 1.0 + sign * dx * dx * a, sign * b, -sign * dx
    out[3], out[4], out[5] = b, sign + dy * dy * a, -dy


@njit(cache=True, nogil=True, error_model="numpy")
def has_place(grids, x0, y0, z0, x, y, z):
    """Tell whether an internode may stand: within the frame, above ground, outside what is built."""
    if not (x >= EDGE_M and y >= EDGE_M and x <= grids.size[0] - EDGE_M and y <= grids.size[1] - EDGE_M):
        return False
    if not (z >= 0.02 and z <= grids.size[2] - EDGE_M):
        return False
    if is_solid(grids, x, y, z):
        return False
    return not is_solid(grids, 0.5 * (x0 + x), 0.5 * (y0 + y), 0.5 * (z0 + z))


@njit(cache=True, nogil=True, error_model="numpy")
def grow_shoots(
    nodes, node_count, live_count, buds, bud_count, chosen, chosen_count, room, plants, traits, grids, reach, senses
):
    """Let the chosen buds grow.

    Parameters
    ----------
    room
        As `perceive` writes it.
    reach
        Radius in internodes within which markers are taken.
    senses
        (shade, markers): which environments are sensed.

    Returns
    -------
    nodes, buds, and their counts: internodes, living internodes, buds.
    """
    senses_shade, senses_room = senses
    lengths = np.zeros(chosen_count, np.float64)
    need = 0
    need_buds = 0
    for c in range(chosen_count):
        b = chosen[c]
        node = buds.node[b]
        plant = nodes.plant[node]
        if senses_room and room[c, 3] == 0.0:
            buds.spent[b] = 2
            continue
        if senses_room and room[c, 0] == 0.0 and room[c, 1] == 0.0 and room[c, 2] == 0.0:
            continue
        species = plants.species[plant]
        order = nodes.order[node] + (1 if buds.kind[b] != APICAL and buds.kind[b] != STEM else 0)
        length = shoot_length(traits, species, order, plants.vitality[plant], plants.years[plant], buds.vigour[b])
        if length < SHORTEST:
            continue
        lengths[c] = length
        count = max(int(length + 0.5), 1)
        need += count
        need_buds += count * int(traits[species].lateral_buds)
    nodes = nodes_with_room(nodes, node_count, need)
    buds = buds_with_room(buds, bud_count, need_buds)
    pull = np.zeros(3, np.float64)
    sides = np.zeros(6, np.float64)
    for c in range(chosen_count):
        if lengths[c] == 0.0:
            continue
        b = chosen[c]
        node = buds.node[b]
        plant = nodes.plant[node]
        species = plants.species[plant]
        key = season_key(plants, plant)
        grown_kind = buds.kind[b]
        number = buds.number[b]
        bud_serial = nodes.serial[node]
        order = min(nodes.order[node] + (1 if grown_kind != APICAL and grown_kind != STEM else 0), 255)
        count = max(int(lengths[c] + 0.5), 1)
        step = lengths[c] / count * traits[species].internode_length_m
        x, y, z = np.float64(nodes.xyz[node, 0]), np.float64(nodes.xyz[node, 1]), np.float64(nodes.xyz[node, 2])
        dx = np.float64(buds.direction[b, 0])  # the compiler's float() would leave it in 32 bits
        dy, dz = np.float64(buds.direction[b, 1]), np.float64(buds.direction[b, 2])
        spread = traits[species].apical_angle_sd_deg * (np.pi / 180.0)
        side_vectors(dx, dy, dz, sides)
        first = spread * deviate(hash_bits(key, bud_serial, number, 1))
        second = spread * deviate(hash_bits(key, bud_serial, number, 2))
        dx += first * sides[0] + second * sides[3]
        dy += first * sides[1] + second * sides[4]
        dz += first * sides[2] + second * sides[5]
        px = py = pz = 0.0
        if senses_shade and traits[species].phototropism > 0.0:
            brightest(grids, buds.voxel[b], x, y, z, dx, dy, dz, pull)
            px = traits[species].phototropism * pull[0]
            py = traits[species].phototropism * pull[1]
            pz = traits[species].phototropism * pull[2]
        if senses_room:
            px += traits[species].room_attraction * room[c, 0]
            py += traits[species].room_attraction * room[c, 1]
            pz += traits[species].room_attraction * room[c, 2]
        pz += traits[species].gravitropism_trunk if order == 0 else traits[species].gravitropism_branch
        roll = np.float64(buds.roll[b])
        tip = -1
        for m in range(count):
            dx, dy, dz = dx + px / count, dy + py / count, dz + pz / count
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            if not length > LEAST_DIRECTION:  # all pulls cancel: nowhere to go
                break
            dx, dy, dz = dx / length, dy / length, dz / length
            nx, ny, nz = x + step * dx, y + step * dy, z + step * dz
            if not has_place(grids, x, y, z, nx, ny, nz):
                break
            new = node_count
            nodes.parent[new] = node if m == 0 else tip
            nodes.plant[new] = plant
            plants.node_count[plant] += 1
            nodes.serial[new] = plants.node_count[plant]
            nodes.xyz[new, 0], nodes.xyz[new, 1], nodes.xyz[new, 2] = nx, ny, nz
            nodes.order[new] = order
            nodes.leads[new] = 1 if m > 0 or grown_kind == APICAL else 0
            nodes.birth[new] = min(plants.now[plant], 255)
            nodes.live[live_count] = new
            plants.height[plant] = max(plants.height[plant], nz)
            node_count += 1
            live_count += 1
            tip = new
            x, y, z = nx, ny, nz
            # of the place as it is kept, so that the same voxel loses the shade when the internode falls
            voxel = voxel_of(grids, nodes.xyz[new, 0], nodes.xyz[new, 1], nodes.xyz[new, 2])
            if senses_shade:
                cast_shade(grids, voxel, species, 1)
            if senses_room:
                take_markers(
                    grids,
                    x,
                    y,
                    z,
                    taken_within(reach, traits[species].internode_length_m, grids.marker_m),
                    TAKEN,
                )
            bud_count = _set_lateral_buds(
                nodes, buds, bud_count, new, voxel, dx, dy, dz, roll, key, plants, traits, sides
            )
            roll += traits[species].roll_angle_deg * (np.pi / 180.0)
            roll += (
                traits[species].roll_angle_sd_deg * (np.pi / 180.0) * deviate(hash_bits(key, nodes.serial[new], 0, 5))
            )
        if tip < 0:
            buds.spent[b] = 1 if nodes.parent[node] >= 0 else 2
            continue
        buds.node[b] = tip
        buds.voxel[b] = voxel
        buds.direction[b, 0], buds.direction[b, 1], buds.direction[b, 2] = dx, dy, dz
        buds.roll[b] = roll
        buds.kind[b] = APICAL
        buds.number[b] = APICAL_NUMBER
    return nodes, buds, node_count, live_count, bud_count


@njit(cache=True, nogil=True, error_model="numpy")
def _set_lateral_buds(nodes, buds, bud_count, node, voxel, dx, dy, dz, roll, key, plants, traits, sides):
    """Set the lateral buds of a new internode about its axis, and return how many buds there are now."""
    plant = nodes.plant[node]
    species = plants.species[plant]
    side_vectors(dx, dy, dz, sides)
    whorl = int(traits[species].lateral_buds)
    for number in range(whorl):
        angle = traits[species].branch_angle_deg + traits[species].branch_angle_sd_deg * deviate(
            hash_bits(key, nodes.serial[node], number, 3)
        )
        turn = roll + 2.0 * np.pi * number / whorl
        out = np.sin(angle * (np.pi / 180.0))
        along = np.cos(angle * (np.pi / 180.0))
        u, v = out * np.cos(turn), out * np.sin(turn)
        buds.node[bud_count] = node
        buds.voxel[bud_count] = voxel
        buds.direction[bud_count, 0] = along * dx + u * sides[0] + v * sides[3]
        buds.direction[bud_count, 1] = along * dy + u * sides[1] + v * sides[4]
        buds.direction[bud_count, 2] = along * dz + u * sides[2] + v * sides[5]
        buds.roll[bud_count] = (
            2.0 * np.pi * (hash_bits(key, nodes.serial[node], number, 4) >> np.uint64(40)) / 16777216.0
        )
        buds.kind[bud_count] = LATERAL
        buds.number[bud_count] = number
        buds.spent[bud_count] = 0
        buds.light[bud_count] = 0.0
        buds.vigour[bud_count] = 0.0
        bud_count += 1
    return bud_count
