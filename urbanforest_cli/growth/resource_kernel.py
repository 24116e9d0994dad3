"""Resource: light summed toward the root, vigour shared out from there.

Extended Borchert-Honda model and priority model after Palubicki et al. 2009, sections 4.2 and 4.3; inhibition by
growing buds above after Stava et al. 2014.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.state_kernel import APICAL, LATERAL, hash_bits, season_key, uniform

PRIORITY_MAX, PRIORITY_MIN, PRIORITY_SHARE = 1.0, 0.006, 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def apical_control(traits, species, age):
    """Return lambda at an age: it goes from young to old in a straight line."""
    share = min(age / traits[species].apical_control_years, 1.0)
    young, old = traits[species].apical_control_young, traits[species].apical_control_old
    return young + (old - young) * share


@njit(cache=True, nogil=True, error_model="numpy")
def gather_light(nodes, live_count, buds, bud_count, plants, traits):
    """Sum light, internodes and inhibition toward the root (basipetal pass)."""
    live = nodes.live
    for i in range(live_count):
        node = live[i]
        nodes.light[node] = 0.0
        nodes.able[node] = 0.0
        nodes.weighted[node] = 0.0
        nodes.inhibition[node] = 0.0
        nodes.above[node] = 1
    share = np.empty(len(plants.key), np.float64)
    fade = np.empty(len(plants.key), np.float64)
    send = np.empty(len(plants.key), np.float64)
    for p in range(len(plants.key)):
        species = plants.species[p]
        share[p] = apical_control(traits, species, plants.age[p])
        fade[p] = traits[species].auxin_distance_factor
        send[p] = traits[species].auxin_inhibition * traits[species].auxin_aging ** plants.age[p]
    for b in range(bud_count):
        node = buds.node[b]
        light = buds.light[b]
        nodes.light[node] += light
        if buds.spent[b] == 0:
            part = share[nodes.plant[node]]
            nodes.able[node] += light
            nodes.weighted[node] += light * (part if buds.kind[b] == APICAL else 1.0 - part)
    for i in range(live_count - 1, -1, -1):
        node = live[i]
        parent = nodes.parent[node]
        if parent < 0:
            continue
        plant = nodes.plant[node]
        if plants.years[plant] == 0.0:
            continue
        part = share[plant] if nodes.leads[node] == 1 else 1.0 - share[plant]
        nodes.light[parent] += nodes.light[node]
        nodes.able[parent] += nodes.able[node]
        nodes.weighted[parent] += nodes.able[node] * part
        nodes.above[parent] += nodes.above[node]
        fresh = send[plant] if nodes.above[node] == 1 else 0.0
        nodes.inhibition[parent] += (nodes.inhibition[node] + fresh) * fade[plant]


@njit(cache=True, nogil=True, error_model="numpy")
def share_borchert_honda(nodes, live_count, buds, bud_count, plants, traits):
    """Share out vigour by light and apical control (acropetal pass): v_i = v w_i Q_i / sum of w Q."""
    live = nodes.live
    for i in range(live_count):
        node = live[i]
        parent = nodes.parent[node]
        plant = nodes.plant[node]
        if plants.years[plant] == 0.0:
            continue
        if parent < 0:
            species = plants.species[plant]
            nodes.vigour[node] = min(traits[species].vigour * nodes.able[node], traits[species].vigour_max)
        elif nodes.weighted[parent] > 0.0:
            part = apical_control(traits, plants.species[plant], plants.age[plant])
            if nodes.leads[node] == 0:
                part = 1.0 - part
            nodes.vigour[node] = nodes.vigour[parent] * nodes.able[node] * part / nodes.weighted[parent]
        else:
            nodes.vigour[node] = 0.0
    for b in range(bud_count):
        node = buds.node[b]
        plant = nodes.plant[node]
        if plants.years[plant] == 0.0 or buds.spent[b] != 0 or nodes.weighted[node] <= 0.0:
            buds.vigour[b] = 0.0
            continue
        part = apical_control(traits, plants.species[plant], plants.age[plant])
        if buds.kind[b] != APICAL:
            part = 1.0 - part
        buds.vigour[b] = nodes.vigour[node] * buds.light[b] * part / nodes.weighted[node]


@njit(cache=True, nogil=True, error_model="numpy")
def share_by_priority(nodes, live_count, buds, bud_count, plants, traits):
    """Share out vigour axis by axis: the end bud first, then branches and buds by their mean light.

    An axis' vigour v goes to its items by v Q_i w_i / sum of Q_j w_j; w falls in a straight line from PRIORITY_MAX to
    PRIORITY_MIN over the first half of the items, ranked, and stays there.
    """
    live = nodes.live
    total = live_count + bud_count
    axis_of = np.empty(len(nodes.parent), np.int32)  # first node of the axis a node belongs to
    bud_sum = np.zeros(len(nodes.parent), np.int32)
    for b in range(bud_count):
        if buds.spent[b] == 0:
            bud_sum[buds.node[b]] += 1
    for i in range(live_count - 1, -1, -1):
        node = live[i]
        if nodes.parent[node] >= 0:
            bud_sum[nodes.parent[node]] += bud_sum[node]
    for i in range(live_count):
        node = live[i]
        axis_of[node] = axis_of[nodes.parent[node]] if nodes.parent[node] >= 0 and nodes.leads[node] == 1 else node
    # the items of each axis, as one list sorted by axis: branches as node index, buds as -1 - bud index
    first = np.zeros(len(nodes.parent) + 1, np.int32)
    item = np.empty(total, np.int32)
    owner = np.empty(total, np.int32)
    count = 0
    for i in range(live_count):
        node = live[i]
        if nodes.parent[node] >= 0 and nodes.leads[node] == 0:
            item[count], owner[count] = node, axis_of[nodes.parent[node]]
            count += 1
    for b in range(bud_count):
        if buds.spent[b] == 0:
            item[count], owner[count] = -1 - b, axis_of[buds.node[b]]
            count += 1
    for k in range(count):
        first[owner[k] + 1] += 1
    for node in range(len(nodes.parent)):
        first[node + 1] += first[node]
    place = first.copy()
    ranked = np.empty(count, np.int32)
    for k in range(count):
        ranked[place[owner[k]]] = item[k]
        place[owner[k]] += 1
    for b in range(bud_count):
        buds.vigour[b] = 0.0
    for i in range(live_count):
        axis = live[i]
        if axis_of[axis] != axis:
            continue
        plant = nodes.plant[axis]
        if plants.years[plant] == 0.0:
            continue
        if nodes.parent[axis] < 0:
            species = plants.species[plant]
            nodes.vigour[axis] = min(traits[species].vigour * nodes.able[axis], traits[species].vigour_max)
        size = first[axis + 1] - first[axis]
        if size == 0:
            continue
        light = np.empty(size, np.float64)
        rank = np.empty(size, np.float64)
        for k in range(size):
            entry = ranked[first[axis] + k]
            if entry < 0:
                light[k] = buds.light[-1 - entry]
                rank[k] = -light[k] - (1e9 if buds.kind[-1 - entry] == APICAL else 0.0)
            else:
                light[k] = nodes.able[entry]
                rank[k] = -light[k] / max(bud_sum[entry], 1)
        order = np.argsort(rank, kind="mergesort")
        weights = np.empty(size, np.float64)
        whole = 0.0
        reach = max(PRIORITY_SHARE * size, 1.0)
        for position in range(size):
            k = order[position]
            weights[k] = light[k] * max(PRIORITY_MAX - (PRIORITY_MAX - PRIORITY_MIN) * position / reach, PRIORITY_MIN)
            whole += weights[k]
        for k in range(size):
            entry = ranked[first[axis] + k]
            vigour = nodes.vigour[axis] * weights[k] / whole if whole > 0.0 else 0.0
            if entry < 0:
                buds.vigour[-1 - entry] = vigour
            else:
                nodes.vigour[entry] = vigour


@njit(cache=True, nogil=True, error_model="numpy")
def choose_buds(nodes, buds, bud_count, plants, traits, chosen):
    """List the buds that grow: vigour for one internode, light enough and no inhibition from above.

    A lateral bud grows with chance Q**LFL * exp(-inhibition) (Stava et al. 2014); some buds die unseen.
    """
    count = 0
    for b in range(bud_count):
        node = buds.node[b]
        plant = nodes.plant[node]
        if buds.spent[b] != 0 or plants.years[plant] == 0.0:
            continue
        species = plants.species[plant]
        serial = nodes.serial[node]
        draw = uniform(hash_bits(season_key(plants, plant), serial, buds.number[b], 0))
        death = traits[species].apical_bud_death if buds.kind[b] == APICAL else traits[species].lateral_bud_death
        if buds.kind[b] != APICAL and buds.light[b] <= 0.0:
            death = max(death, 0.5)
        if draw < death:
            if nodes.parent[node] >= 0:
                buds.spent[b] = 1
            continue
        if buds.vigour[b] < 1.0:
            continue
        if buds.kind[b] == LATERAL:
            chance = buds.light[b] ** traits[species].lateral_light_exponent * np.exp(-nodes.inhibition[node])
            if (draw - death) / (1.0 - death) >= chance:
                continue
        chosen[count] = b
        count += 1
    return count
