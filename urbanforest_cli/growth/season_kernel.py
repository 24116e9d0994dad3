"""The seasons of a grove, one after another: sense, share, grow, lose.

One season after Palubicki et al. 2009: buds sense light and room; light is summed toward the root and turned into
vigour; vigour is shared out; buds with enough of it grow; dark branches are shed. All plants of a grove are planted so
that they reach their ages in the same last season.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.light_kernel import canopy_light, cast_shade, is_solid, sense_light, voxel_of
from urbanforest_cli.growth.loss_kernel import (
    NEIGHBOUR_RADIUS_M,
    drop_spent,
    let_fall,
    mark_cut,
    mark_shed,
    release_markers,
    wake_reserves,
)
from urbanforest_cli.growth.marker_kernel import block_built, perceive, take_markers, taken_within
from urbanforest_cli.growth.resource_kernel import (
    choose_buds,
    gather_light,
    share_borchert_honda,
    share_by_priority,
)
from urbanforest_cli.growth.shoot_kernel import grow_shoots
from urbanforest_cli.growth.state_kernel import (
    APICAL,
    APICAL_NUMBER,
    STEM,
    TAKEN,
    buds_with_room,
    deviate,
    hash_bits,
    new_buds,
    new_nodes,
    nodes_with_room,
    season_key,
)

YOUNG_YEARS, MIDDLE_YEARS = 25, 50  # growth each season up to the first, each second to the other, then each fourth
REGROWTH_VITALITY_YEARS = 12.0  # age by which the shoots after a cut shorten, at the cut
NODE_BYTES, BUD_BYTES = 56, 35  # of one row of Nodes and of Buds


@njit(cache=True, nogil=True, error_model="numpy")
def grow_seasons(plants, traits, grids, neighbours, neighbour_season, neighbour_shade, rule):
    """Grow a grove through all its seasons.

    Parameters
    ----------
    neighbours, neighbour_season, neighbour_shade
        (g, 3) points in the frame, the season each appears in, ascending, and the shade it casts in internodes.
    rule
        (senses_shade, senses_room, by_priority, reach of perception and taking in internodes, cosine of half the cone,
        pruning shape).

    Returns
    -------
    nodes, their count, the season log (t, p, 4), the memory of nodes and buds in bytes.
    """
    senses_shade, senses_room, by_priority, reach, taking, cone, shape = rule
    senses = (senses_shade, senses_room)
    plant_count = len(plants.key)
    seasons = 0
    for p in range(plant_count):
        seasons = max(seasons, plants.seasons[p])
    log = np.zeros((seasons, plant_count, 4), np.float32)
    nodes = new_nodes(256 * plant_count)
    buds = new_buds(512 * plant_count)
    node_count = live_count = bud_count = neighbour_count = 0
    live_bytes = 0
    if senses_room:
        block_built(grids)
    for season in range(1, seasons + 1):
        while neighbour_count < len(neighbours) and neighbour_season[neighbour_count] <= season:
            _place_neighbour(grids, neighbours[neighbour_count], neighbour_shade[neighbour_count], senses)
            neighbour_count += 1
        nodes, buds, node_count, live_count, bud_count = _plant_seeds(
            nodes, buds, node_count, live_count, bud_count, plants, traits, grids, season, seasons, senses, taking
        )
        if not _begin_season(plants, season, seasons):
            continue
        canopy = np.ones((1, 1, 1), np.float64)
        if senses_shade:
            canopy = canopy_light(nodes, live_count, plants, grids, neighbours, neighbour_shade, neighbour_count)
        sense_light(nodes, buds, bud_count, plants, grids, canopy, senses_shade)
        if senses_room and not senses_shade:
            everyone = np.arange(bud_count).astype(np.int32)
            room = np.zeros((bud_count, 4), np.float32)
            perceive(nodes, buds, everyone, bud_count, plants, traits, grids, reach, cone, room)
            for b in range(bud_count):
                own = room[b, 0] != 0.0 or room[b, 1] != 0.0 or room[b, 2] != 0.0
                buds.light[b] = 1.0 if own else 0.0
        gather_light(nodes, live_count, buds, bud_count, plants, traits)
        for p in range(plant_count):
            if plants.years[p] > 0.0:
                log[season - 1, p, 0] = nodes.light[plants.root[p]]
        falls = np.zeros(node_count, np.uint8)
        mark_shed(nodes, live_count, plants, traits, falls)
        lost_before = plants.shed + plants.pruned
        if falls.any():
            live_count, bud_count = let_fall(nodes, live_count, buds, bud_count, plants, grids, falls, senses_shade)
        if by_priority:
            share_by_priority(nodes, live_count, buds, bud_count, plants, traits)
        else:
            share_borchert_honda(nodes, live_count, buds, bud_count, plants, traits)
        chosen = np.empty(bud_count, np.int32)
        chosen_count = choose_buds(nodes, buds, bud_count, plants, traits, chosen)
        room = np.zeros((chosen_count if senses_room else 1, 4), np.float32)
        if senses_room:
            perceive(nodes, buds, chosen, chosen_count, plants, traits, grids, reach, cone, room)
        before = node_count
        nodes, buds, node_count, live_count, bud_count = grow_shoots(
            nodes, node_count, live_count, buds, bud_count, chosen, chosen_count, room, plants, traits, grids, taking,
            senses,
        )  # fmt: skip
        for node in range(before, node_count):
            log[season - 1, nodes.plant[node], 2] += 1
        live_bytes = max(live_bytes, len(nodes.parent) * NODE_BYTES + len(buds.node) * BUD_BYTES)
        bud_count = drop_spent(buds, bud_count)
        falls = np.zeros(node_count, np.uint8)
        if mark_cut(nodes, live_count, plants, shape, falls):
            live_count, bud_count = let_fall(nodes, live_count, buds, bud_count, plants, grids, falls, senses_shade)
            if senses_room:
                release_markers(
                    nodes, node_count, live_count, plants, traits, grids, neighbours, neighbour_count, taking
                )
            buds, bud_count = wake_reserves(nodes, live_count, buds, bud_count, plants, grids)
        for p in range(plant_count):
            if plants.years[p] > 0.0:
                log[season - 1, p, 1] = nodes.vigour[plants.root[p]]
                log[season - 1, p, 3] = plants.shed[p] + plants.pruned[p] - lost_before[p]
    for p in range(plant_count):
        if plants.state[p] == 0 and plants.node_count[p] == plants.shed[p] + plants.pruned[p]:
            plants.state[p] = 2 if plants.node_count[p] == 0 else 1  # nothing could grow; or nothing of it is left
            plants.death[p] = plants.now[p] if plants.state[p] == 1 else 0
    return nodes, node_count, log, live_bytes


@njit(cache=True, nogil=True, error_model="numpy")
def _place_neighbour(grids, point, internodes, senses):
    """Let a leafy point of a neighbour's crown shade and take room."""
    x, y, z = point[0], point[1], point[2]
    if x < 0.0 or y < 0.0 or x >= grids.size[0] or y >= grids.size[1] or z >= grids.size[2] or z < 0.0:
        return
    if senses[0]:
        times = int(internodes + 0.5)
        if times > 0:
            cast_shade(grids, voxel_of(grids, x, y, z), len(grids.cast) - 1, times)
    if senses[1]:
        take_markers(grids, x, y, z, NEIGHBOUR_RADIUS_M, TAKEN)


@njit(cache=True, nogil=True, error_model="numpy")
def _begin_season(plants, season, seasons):
    """Advance the plants' ages, and tell whether any of them grows this season."""
    growing = False
    for p in range(len(plants.key)):
        plants.years[p] = 0.0
        own = season - (seasons - plants.seasons[p])
        if own < 1 or plants.state[p] != 0:
            continue
        plants.now[p] = own
        plants.age[p] = plants.first_year[p] + own - 1.0
        left = plants.seasons[p] - own
        cut = plants.pruned_at[p]
        gap = 1 if own <= YOUNG_YEARS or (0 < cut <= own) else (2 if own <= MIDDLE_YEARS else 4)
        if own != cut and left % gap != 0:
            continue
        since = own - plants.grown_at[p]
        plants.years[p] = plants.first_year[p] if own == 1 else float(since)
        plants.grown_at[p] = own
        plants.vitality[p] = plants.age[p]
        if 0 < cut < own:
            plants.vitality[p] = min(plants.age[p], REGROWTH_VITALITY_YEARS + own - cut)
        growing = True
    return growing


@njit(cache=True, nogil=True, error_model="numpy")
def _plant_seeds(
    nodes, buds, node_count, live_count, bud_count, plants, traits, grids, season, seasons, senses, taking
):
    """Set the root and the first buds of plants whose first season it is."""
    for p in range(len(plants.key)):
        if seasons - plants.seasons[p] + 1 != season:
            continue
        nodes = nodes_with_room(nodes, node_count, 1)
        species = plants.species[p]
        stems = int(traits[species].stem_count)
        buds = buds_with_room(buds, bud_count, stems)
        x, y = plants.root_xy[p, 0], plants.root_xy[p, 1]
        nodes.parent[node_count] = -1
        nodes.plant[node_count] = p
        nodes.xyz[node_count, 0], nodes.xyz[node_count, 1] = x, y
        nodes.live[live_count] = node_count
        plants.root[p] = node_count
        node_count += 1
        live_count += 1
        if is_solid(grids, x, y, 0.0):
            plants.state[p] = 2
            continue
        if senses[1]:
            take_markers(
                grids,
                x,
                y,
                0.0,
                taken_within(taking, traits[species].internode_length_m, grids.marker_m),
                TAKEN,
            )
        plants.now[p] = 0
        key = season_key(plants, p)
        turn = 2.0 * np.pi * (hash_bits(key, 0, 0, 5) >> np.uint64(40)) / 16777216.0
        for stem in range(stems):
            lean = traits[species].stem_angle_deg * (1.0 + 0.25 * deviate(hash_bits(key, 0, stem, 6)))
            lean = min(max(lean, 0.0), 80.0) * (np.pi / 180.0)
            away = turn + 2.0 * np.pi * (stem + 0.3 * deviate(hash_bits(key, 0, stem, 7)) / 3.0) / stems
            buds.node[bud_count] = plants.root[p]
            buds.voxel[bud_count] = voxel_of(grids, x, y, 0.0)
            buds.direction[bud_count, 0] = np.sin(lean) * np.cos(away)
            buds.direction[bud_count, 1] = np.sin(lean) * np.sin(away)
            buds.direction[bud_count, 2] = np.cos(lean)
            buds.roll[bud_count] = away
            buds.kind[bud_count] = APICAL if stem == 0 else STEM
            buds.number[bud_count] = APICAL_NUMBER if stem == 0 else stem
            buds.spent[bud_count] = 0
            bud_count += 1
    return nodes, buds, node_count, live_count, bud_count
