"""The lie of the land on fine cells: what is topmost, how high it reaches, and how it faces the sun.

All stamps write into the arrays of one window. Row 0 is northernmost; the middle of cell (r, c) lies at
(west + (c + 0.5) step, north - (r + 0.5) step).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from urbanforest_cli.synth.picture.grain_kernel import CODE, chance, speck

GROUND_TOP, ROOF_TOP, PLANT_TOP, BOX_TOP = 0, 1, 2, 3
HIP, GABLE, FLAT = 0, 1, 2
_PARAPET_M, _PARAPET_HIGH_M = 0.45, 0.5
_GOLDEN = 2.399963229728653
_LEAF_M = 0.45


@njit(**CODE)
def fill_polygons(xy, ring_ends, polygon_ends, chosen, labels, west, north, step, out):
    """Write labels into the cells whose middles lie in polygons; holes stay free.

    Parameters
    ----------
    xy, ring_ends, polygon_ends
        (points, 2) corners of closed rings one after the other, where each ring ends, and at which ring each polygon.
    chosen, labels
        (k,) numbers of polygons, and what to write for each.
    """
    rows, cols = out.shape
    crossings = np.empty(256)
    for k in range(len(chosen)):
        polygon = chosen[k]
        first_ring = polygon_ends[polygon - 1] if polygon > 0 else 0
        last_ring = polygon_ends[polygon]
        start = ring_ends[first_ring - 1] if first_ring > 0 else 0
        end = ring_ends[last_ring - 1]
        low, high = xy[start, 1], xy[start, 1]
        for p in range(start, end):
            low, high = min(low, xy[p, 1]), max(high, xy[p, 1])
        r0 = max(math.floor((north - high) / step - 0.5), 0)
        r1 = min(math.ceil((north - low) / step + 0.5), rows)
        for r in range(r0, r1):
            y = north - (r + 0.5) * step
            count = 0
            for ring in range(first_ring, last_ring):
                begin = ring_ends[ring - 1] if ring > 0 else 0
                for p in range(begin, ring_ends[ring] - 1):
                    ya, yb = xy[p, 1], xy[p + 1, 1]
                    if (ya > y) != (yb > y) and count < 256:
                        crossings[count] = xy[p, 0] + (y - ya) / (yb - ya) * (xy[p + 1, 0] - xy[p, 0])
                        count += 1
            inside = np.sort(crossings[:count])
            for pair in range(0, count - 1, 2):
                c0 = max(math.ceil((inside[pair] - west) / step - 0.5), 0)
                c1 = min(math.ceil((inside[pair + 1] - west) / step - 0.5), cols)
                for c in range(c0, c1):
                    out[r, c] = labels[k]


@njit(**CODE)
def raise_roofs(building, edges, edge_ends, form, eave_m, pitch, sun, west, north, step, z, top, owner, facing):
    """Raise buildings over the cells that carry their number; roofs rise from the edges inward.

    Parameters
    ----------
    building
        (rows, cols) number of the building, -1 where there is none.
    edges, edge_ends
        (edges, 6) start x, y, unit inward normal x, y, length, and whether a roof rises from it; ends by building.
    sun
        (3,) toward the sun.
    """
    rows, cols = z.shape
    for r in range(rows):
        y = north - (r + 0.5) * step
        for c in range(cols):
            b = building[r, c]
            if b < 0:
                continue
            x = west + (c + 0.5) * step
            nearest, rim, nx, ny = 1e9, 1e9, 0.0, 0.0
            for e in range(edge_ends[b - 1] if b > 0 else 0, edge_ends[b]):
                dx, dy = x - edges[e, 0], y - edges[e, 1]
                off = dx * edges[e, 2] + dy * edges[e, 3]
                along = dx * edges[e, 3] - dy * edges[e, 2]
                beyond = max(-along, along - edges[e, 4], 0.0)
                distance = math.sqrt(off * off + beyond * beyond)
                rim = min(rim, distance)
                if edges[e, 5] > 0 and distance < nearest:
                    nearest, nx, ny = distance, edges[e, 2], edges[e, 3]
            top[r, c] = ROOF_TOP
            owner[r, c] = b
            if form[b] == FLAT:
                z[r, c] = eave_m[b] + (_PARAPET_HIGH_M if rim < _PARAPET_M else 0.0)
                facing[r, c] = 1.0
            else:
                z[r, c] = eave_m[b] + pitch[b] * nearest
                length = math.sqrt(1.0 + pitch[b] * pitch[b])
                light = (sun[2] - pitch[b] * (nx * sun[0] + ny * sun[1])) / length
                facing[r, c] = max(light, 0.0) / sun[2]


@njit(**CODE)
def raise_boxes(boxes, chosen, west, north, step, z, top, owner):
    """Lay boxes where they rise above what is there.

    Parameters
    ----------
    boxes
        (boxes, 7 or more) middle x, y, unit direction x, y, half length, half width, height of the top.
    """
    rows, cols = z.shape
    for k in range(len(chosen)):
        b = chosen[k]
        x, y, ux, uy = boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3]
        half_l, half_w, high = boxes[b, 4], boxes[b, 5], boxes[b, 6]
        reach_x, reach_y = abs(ux) * half_l + abs(uy) * half_w, abs(uy) * half_l + abs(ux) * half_w
        for r in range(max(int((north - y - reach_y) / step), 0), min(int((north - y + reach_y) / step) + 1, rows)):
            dy = north - (r + 0.5) * step - y
            for c in range(max(int((x - reach_x - west) / step), 0), min(int((x + reach_x - west) / step) + 1, cols)):
                dx = west + (c + 0.5) * step - x
                if abs(dx * ux + dy * uy) <= half_l and abs(dy * ux - dx * uy) <= half_w and high > z[r, c]:
                    z[r, c] = high
                    top[r, c] = BOX_TOP
                    owner[r, c] = b


@njit(**CODE)
def raise_plants(plants, chosen, sun, west, north, step, z, top, owner, facing):
    """Raise crowns, each a heap of round lumps of leaves whose outline is ragged.

    Parameters
    ----------
    plants
        (plants, 6) x, y, height, crown radius, crown base, and a whole number to draw its lumps with.
    """
    rows, cols = z.shape
    for k in range(len(chosen)):
        plant = chosen[k]
        x, y, height, radius = plants[plant, 0], plants[plant, 1], plants[plant, 2], plants[plant, 3]
        base, salt = plants[plant, 4], int(plants[plant, 5])
        radius *= 1.07 + 0.21 / (1.0 + (radius / 3.4) ** 3)  # ragged heaps cover less than their discs
        deep = height - base
        lumps = int(min(max(3.0 + 2.4 * radius * radius, 4.0), 90.0))
        turn, squeeze = 6.283 * chance(salt, 1, 71), 0.78 + 0.22 * chance(salt, 2, 71)
        lobe, second = 6.283 * chance(salt, 3, 71), 6.283 * chance(salt, 4, 71)
        for lump in range(lumps):
            share = math.sqrt((lump + 0.5) / lumps)
            angle = lump * _GOLDEN + turn + 1.1 * (chance(salt, lump, 73) - 0.5)
            size = radius * (0.17 + 0.24 * chance(salt, lump, 74)) * (1.35 - 0.45 * share)
            size = max(min(size, 2.4), min(0.5 * radius, 0.55))
            out = max(radius - 0.92 * size, 0.0) * share * (0.86 + 0.2 * chance(salt, lump, 75))
            out *= 1.0 + share * (0.12 * math.sin(2 * angle + lobe) + 0.15 * math.sin(3 * angle + second))
            px, py = out * math.cos(angle), squeeze * out * math.sin(angle)
            cx = x + px * math.cos(turn) - py * math.sin(turn)
            cy = y + px * math.sin(turn) + py * math.cos(turn)
            dome = math.sqrt(max(1.0 - share * share * 0.86, 0.0))
            cz = base + deep * dome * (0.74 + 0.26 * chance(salt, lump, 76)) - size * 0.9
            cz = max(cz, 0.25 * size)
            reach = size * 1.12
            for r in range(max(int((north - cy - reach) / step), 0), min(int((north - cy + reach) / step) + 1, rows)):
                wy = north - (r + 0.5) * step
                dy = wy - cy
                for c in range(max(int((cx - reach - west) / step), 0), min(int((cx + reach - west) / step) + 1, cols)):
                    wx = west + (c + 0.5) * step
                    dx = wx - cx
                    ragged = speck(wx + 0.31 * wy, wy - 0.23 * wx, _LEAF_M, salt)
                    limit = size * (0.76 + 0.38 * ragged)
                    d2 = (dx * dx + dy * dy) / (limit * limit)
                    if d2 >= 1.0:
                        continue
                    up = math.sqrt(1.0 - d2)
                    here = cz + size * (0.92 * up + 0.22 * (ragged - 0.5))
                    if here > z[r, c]:
                        z[r, c] = here
                        top[r, c] = PLANT_TOP
                        owner[r, c] = plant
                        nx, ny, nz = dx / limit, dy / limit, max(up, 0.15)
                        length = math.sqrt(nx * nx + ny * ny + nz * nz)
                        light = (nx * sun[0] + ny * sun[1] + nz * sun[2]) / length
                        facing[r, c] = max(0.48 + 0.56 * light, 0.2) / sun[2]


@njit(**CODE)
def highest_around(z, size):
    """Return the greatest height of each square of cells and the eight about it."""
    rows, cols = (z.shape[0] + size - 1) // size, (z.shape[1] + size - 1) // size
    own = np.zeros((rows, cols), dtype=np.float32)
    for r in range(z.shape[0]):
        for c in range(z.shape[1]):
            own[r // size, c // size] = max(own[r // size, c // size], z[r, c])
    out = np.zeros_like(own)
    for r in range(rows):
        for c in range(cols):
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    out[r, c] = max(out[r, c], own[i, j])
    return out


@njit(**CODE)
def in_sun(z, top, high, size, r, c, sun, step, highest):
    """Tell how much of the sun reaches a cell: 1, 0, or what leaves let through."""
    level = math.sqrt(sun[0] * sun[0] + sun[1] * sun[1])
    dc, dr = sun[0] / level, -sun[1] / level
    rise = sun[2] / level * step
    here = z[r, c] + 0.12
    reach = 1.0
    rows, cols = z.shape
    while here + rise * reach < highest:
        i, j = int(r + 0.5 + dr * reach), int(c + 0.5 + dc * reach)
        if i < 0 or j < 0 or i >= rows or j >= cols:
            return 1.0
        if high[i // size, j // size] <= here + rise * reach:
            reach += size
            continue
        if z[i, j] > here + rise * reach:
            return 0.1 if top[i, j] == PLANT_TOP else 0.0
        reach += 1.0
    return 1.0
