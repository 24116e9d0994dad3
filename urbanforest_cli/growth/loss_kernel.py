"""Loss: branches shed in the dark, lifted over roads, cut to a volume; plants that die.

Shedding after Takenaka 1994: a branch whose light for each internode falls below a threshold is dropped. What is lost
stays in the arrays with the season of its loss.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.light_kernel import cast_shade, voxel_of
from urbanforest_cli.growth.marker_kernel import take_markers, taken_within
from urbanforest_cli.growth.shoot_kernel import side_vectors
from urbanforest_cli.growth.state_kernel import (
    FREE,
    RESERVE,
    RESERVE_NUMBER,
    TAKEN,
    buds_with_room,
    hash_bits,
    season_key,
    uniform,
)

KEPT, SHED, PRUNED = 0, 1, 2
SHED_AFTER_SEASONS = 2
DARK_SEASONS = 3
LIMB_SHARE = 0.3  # a branch that bears this share of a plant is its crown: neither cleared nor lifted
CLEAR_SHARE = 0.3  # of a plant's height that its own clear stem reaches at most
LIFT_SHARE = 0.45  # of a plant's height that its crown is lifted to at most
BOX, ELLIPSOID = 0, 1
LEAST_HALF_M = 0.25  # a volume is never narrower to either side: a whip is no crown


@njit(cache=True, nogil=True, error_model="numpy")
def mark_shed(nodes, live_count, plants, traits, falls):
    """Mark branches that are dark, or start too low, and all that stands on them; dying plants whole."""
    for p in range(len(plants.key)):
        root = plants.root[p]
        if root < 0 or plants.state[p] != 0 or plants.years[p] == 0.0:
            continue
        plants.dark[p] = plants.dark[p] + 1 if nodes.light[root] <= 0.0 else 0
        if plants.dark[p] >= DARK_SEASONS:
            plants.state[p] = 1
            plants.death[p] = plants.now[p]
            falls[root] = SHED
    trunk_top = np.zeros(len(plants.key), np.float64)
    for i in range(live_count):
        node = nodes.live[i]
        if nodes.order[node] == 0:
            plant = nodes.plant[node]
            trunk_top[plant] = max(trunk_top[plant], nodes.xyz[node, 2])
    for i in range(live_count):
        node = nodes.live[i]
        parent = nodes.parent[node]
        if parent < 0:
            continue
        if falls[parent] != KEPT:
            falls[node] = falls[parent]
            continue
        plant = nodes.plant[node]
        if nodes.leads[node] == 1 or plants.years[plant] == 0.0:
            continue
        if plants.now[plant] - nodes.birth[node] < SHED_AFTER_SEASONS:
            continue
        species = plants.species[plant]
        if nodes.light[node] < traits[species].shed_light * nodes.above[node]:
            falls[node] = SHED
        elif nodes.order[node] > 0 and nodes.above[node] < LIMB_SHARE * nodes.above[plants.root[plant]]:
            height = min(plants.height[plant], trunk_top[plant])
            start = nodes.xyz[parent, 2]
            if start < min(traits[species].clear_stem_m, CLEAR_SHARE * height):
                falls[node] = SHED
            elif start < min(plants.clearance[plant], LIFT_SHARE * height):
                falls[node] = PRUNED


@njit(cache=True, nogil=True, error_model="numpy")
def mark_cut(nodes, live_count, plants, shape, falls):
    """Mark what reaches out of the pruning volume of plants whose season of cutting it is.

    The volume is that of the plant's own crown (its bounding box along the row, or the half ellipsoid in it). Its
    sides are scaled by the pruning factor about the foot of the crown's axis, which is above the root (paper, section
    Structural Parameters). The clear stem stays.

    Returns
    -------
    Whether any plant was cut.
    """
    count = len(plants.key)
    low = np.zeros((count, 3))  # the root's own vertical is always inside
    high = np.zeros((count, 3))
    low[:, 2] = np.inf
    due = np.zeros(count, np.bool_)
    any_due = False
    for p in range(count):
        if plants.pruned_at[p] == plants.now[p] and plants.now[p] > 0 and plants.state[p] == 0:
            due[p] = True
            any_due = True
    if not any_due:
        return False
    for i in range(live_count):
        node = nodes.live[i]
        p = nodes.plant[node]
        if not due[p] or nodes.parent[node] < 0 or nodes.above[node] > 1:  # the ends of twigs bound a crown
            continue
        u, v = _along_row(nodes, plants, p, node)
        low[p, 0], high[p, 0] = min(low[p, 0], u), max(high[p, 0], u)
        low[p, 1], high[p, 1] = min(low[p, 1], v), max(high[p, 1], v)
        low[p, 2], high[p, 2] = min(low[p, 2], nodes.xyz[node, 2]), max(high[p, 2], nodes.xyz[node, 2])
    for i in range(live_count):
        node = nodes.live[i]
        parent = nodes.parent[node]
        p = nodes.plant[node]
        if not due[p] or parent < 0:
            continue
        if falls[parent] != KEPT:
            falls[node] = falls[parent]
            continue
        z = nodes.xyz[node, 2]
        if nodes.order[node] == 0 and z <= low[p, 2]:
            continue
        u, v = _along_row(nodes, plants, p, node)
        factor = plants.pruning_factor[p]
        top = low[p, 2] + factor * (high[p, 2] - low[p, 2])
        along = u / max(factor * (high[p, 0] if u > 0.0 else -low[p, 0]), LEAST_HALF_M)
        across = v / max(factor * (high[p, 1] if v > 0.0 else -low[p, 1]), LEAST_HALF_M)
        outside = abs(along) > 1.0 or abs(across) > 1.0 or z > top
        if shape == ELLIPSOID and not outside:
            middle = 0.5 * (low[p, 2] + top)
            above = (z - middle) / max(top - middle, LEAST_HALF_M)
            outside = above > 0.0 and along * along + across * across + above * above > 1.0
        if outside:
            falls[node] = PRUNED
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _along_row(nodes, plants, p, node):
    """Return where a node is from its plant's root, along the row and across it."""
    x = nodes.xyz[node, 0] - plants.root_xy[p, 0]
    y = nodes.xyz[node, 1] - plants.root_xy[p, 1]
    cosine, sine = np.cos(plants.azimuth[p]), np.sin(plants.azimuth[p])
    return x * cosine + y * sine, y * cosine - x * sine


@njit(cache=True, nogil=True, error_model="numpy")
def let_fall(nodes, live_count, buds, bud_count, plants, grids, falls, senses_shade):
    """Take what is marked from the living: its shade, its buds; return the counts of living internodes and buds."""
    kept = 0
    for i in range(live_count):
        node = nodes.live[i]
        if falls[node] == KEPT:
            nodes.live[kept] = node
            kept += 1
            continue
        plant = nodes.plant[node]
        nodes.death[node] = min(plants.now[plant], 255)
        if nodes.parent[node] < 0:
            continue
        if falls[node] == SHED:
            plants.shed[plant] += 1
        else:
            plants.pruned[plant] += 1
        if senses_shade:
            voxel = voxel_of(grids, nodes.xyz[node, 0], nodes.xyz[node, 1], nodes.xyz[node, 2])
            cast_shade(grids, voxel, plants.species[plant], -1)
    for b in range(bud_count):
        if falls[buds.node[b]] != KEPT:
            buds.spent[b] = 1
    return kept, drop_spent(buds, bud_count)


@njit(cache=True, nogil=True, error_model="numpy")
def drop_spent(buds, bud_count):
    """Close the gaps that spent buds leave; return how many there are."""
    kept = 0
    for b in range(bud_count):
        if buds.spent[b] == 1:
            continue
        if kept != b:
            buds.node[kept] = buds.node[b]
            buds.voxel[kept] = buds.voxel[b]
            buds.direction[kept, 0] = buds.direction[b, 0]
            buds.direction[kept, 1] = buds.direction[b, 1]
            buds.direction[kept, 2] = buds.direction[b, 2]
            buds.roll[kept] = buds.roll[b]
            buds.light[kept] = buds.light[b]
            buds.vigour[kept] = buds.vigour[b]
            buds.kind[kept] = buds.kind[b]
            buds.number[kept] = buds.number[b]
            buds.spent[kept] = buds.spent[b]
        kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def release_markers(nodes, node_count, live_count, plants, traits, grids, neighbours, neighbour_count, reach):
    """Free the markers near internodes lost this season, but for those that something living still holds."""
    for node in range(node_count):
        plant = nodes.plant[node]
        if nodes.death[node] != 0 and nodes.death[node] == plants.now[plant]:
            radius = taken_within(reach, traits[plants.species[plant]].internode_length_m, grids.marker_m)
            take_markers(
                grids,
                nodes.xyz[node, 0],
                nodes.xyz[node, 1],
                nodes.xyz[node, 2],
                radius,
                FREE,
            )
    for i in range(live_count):
        node = nodes.live[i]
        radius = taken_within(reach, traits[plants.species[nodes.plant[node]]].internode_length_m, grids.marker_m)
        take_markers(
            grids,
            nodes.xyz[node, 0],
            nodes.xyz[node, 1],
            nodes.xyz[node, 2],
            radius,
            TAKEN,
        )
    for g in range(neighbour_count):
        take_markers(
            grids,
            neighbours[g, 0],
            neighbours[g, 1],
            neighbours[g, 2],
            NEIGHBOUR_RADIUS_M,
            TAKEN,
        )


NEIGHBOUR_RADIUS_M = 0.6


@njit(cache=True, nogil=True, error_model="numpy")
def wake_reserves(nodes, live_count, buds, bud_count, plants, grids):
    """Give every internode of a plant just cut, that has no bud, a reserve bud; let all its buds grow again."""
    has_bud = np.zeros(len(nodes.parent), np.bool_)
    need = 0
    for b in range(bud_count):
        plant = nodes.plant[buds.node[b]]
        if plants.pruned_at[plant] == plants.now[plant]:
            buds.spent[b] = 0
        has_bud[buds.node[b]] = True
    for i in range(live_count):
        node = nodes.live[i]
        plant = nodes.plant[node]
        if plants.pruned_at[plant] == plants.now[plant] and not has_bud[node] and nodes.parent[node] >= 0:
            need += 1
    buds = buds_with_room(buds, bud_count, need)
    sides = np.zeros(6, np.float64)
    for i in range(live_count):
        node = nodes.live[i]
        plant = nodes.plant[node]
        parent = nodes.parent[node]
        if plants.pruned_at[plant] != plants.now[plant] or has_bud[node] or parent < 0:
            continue
        dx = np.float64(nodes.xyz[node, 0] - nodes.xyz[parent, 0])
        dy = np.float64(nodes.xyz[node, 1] - nodes.xyz[parent, 1])
        dz = np.float64(nodes.xyz[node, 2] - nodes.xyz[parent, 2])
        length = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-6)
        dx, dy, dz = dx / length, dy / length, dz / length
        side_vectors(dx, dy, dz, sides)
        draw = uniform(hash_bits(season_key(plants, plant), nodes.serial[node], RESERVE_NUMBER, 6))
        u, v = 0.766 * np.cos(2.0 * np.pi * draw), 0.766 * np.sin(2.0 * np.pi * draw)
        buds.node[bud_count] = node
        buds.voxel[bud_count] = voxel_of(grids, nodes.xyz[node, 0], nodes.xyz[node, 1], nodes.xyz[node, 2])
        buds.direction[bud_count, 0] = 0.643 * dx + u * sides[0] + v * sides[3]
        buds.direction[bud_count, 1] = 0.643 * dy + u * sides[1] + v * sides[4]
        buds.direction[bud_count, 2] = 0.643 * dz + u * sides[2] + v * sides[5]
        buds.roll[bud_count] = 2.0 * np.pi * draw
        buds.light[bud_count] = 0.0
        buds.vigour[bud_count] = 0.0
        buds.kind[bud_count] = RESERVE
        buds.number[bud_count] = RESERVE_NUMBER
        buds.spent[bud_count] = 0
        bud_count += 1
    return buds, bud_count
