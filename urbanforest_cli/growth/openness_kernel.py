"""What neighbouring crowns and walls leave of a plant's room and light, direction by direction."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def crowns_in_the_way(
    plants, xyz, radius, base, height, cell_start, cell_plant, grid, reach, azimuth, tangent, depth, room, light
):
    """Lower room and light of plants by the crowns around them.

    A neighbour takes the part of a ray that is nearer to it than to the plant, both distances told in crown radii, and
    as much of that as the height of the plant's crown that its own stands beside. Its crown, an ellipsoid, lets
    exp(-depth * metres) of the light through.

    Parameters
    ----------
    plants
        (c,) the plants to be looked at.
    xyz
        (n, 3) positions, z the middle of the crown, where rays of light start.
    radius, base, height
        (n,) of crowns; bases and heights of their tops above ground.
    cell_start, cell_plant, grid
        All plants by the cells of a grid: offsets, plants, and (west, south, edge, columns, rows).
    reach
        (c,) distance beyond which no neighbour matters.
    azimuth
        (a,) directions, counter-clockwise from east.
    tangent
        (e,) slopes of the rays of light, without the one straight up, which comes last in `light`.
    depth
        Share of light taken by a metre of crown, as optical depth.
    room
        (c, a) share of the plant's own crown radius that is free, changed.
    light
        (c, a, e + 1) share of light that comes through, lowered in turn by what `walls_in_the_way` leaves and by this;
        straight up only at azimuth 0.
    """
    directions = len(azimuth)
    west, south, edge, columns, rows = grid[0], grid[1], grid[2], int(grid[3]), int(grid[4])
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    for c in range(len(plants)):
        i = plants[c]
        own, own_base, own_top = radius[i], base[i], height[i]
        x0 = max(int((xyz[i, 0] - reach[c] - west) / edge), 0)
        x1 = min(int((xyz[i, 0] + reach[c] - west) / edge), columns - 1)
        y0 = max(int((xyz[i, 1] - reach[c] - south) / edge), 0)
        y1 = min(int((xyz[i, 1] + reach[c] - south) / edge), rows - 1)
        # optical depths add up in the order of cells; a sum in integers is the same in any order
        depths = np.zeros((directions, len(tangent) + 1), dtype=np.int64)
        for cell_y in range(y0, y1 + 1):
            for slot in range(cell_start[cell_y * columns + x0], cell_start[cell_y * columns + x1 + 1]):
                j = cell_plant[slot]
                if j == i:
                    continue
                dx, dy = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1]
                distance = math.sqrt(dx * dx + dy * dy)
                other = radius[j]
                beside = min(own_top, height[j]) - max(own_base, base[j])
                if beside > 0.0 and distance < own + other:
                    share = min(beside / max(own_top - own_base, 1e-6), 1.0)
                    for a in range(directions):
                        free = _weighted_bisector(dx * cosine[a] + dy * sine[a], distance, own, other)
                        room[c, a] = min(room[c, a], 1.0 - share * (1.0 - free))
                shade_reach = other + max(height[j] - xyz[i, 2], 0.0) / max(tangent[0], 1e-6)
                if height[j] <= xyz[i, 2] or distance > shade_reach:
                    continue
                tall = max(0.5 * (height[j] - base[j]), 1e-6)
                dz = height[j] - tall - xyz[i, 2]
                for a in range(directions):
                    along = dx * cosine[a] + dy * sine[a]
                    aside = dy * cosine[a] - dx * sine[a]
                    if along <= -other or abs(aside) >= other:
                        continue
                    for e in range(len(tangent)):
                        metres = _chord(along, aside, dz, tangent[e], other, tall)
                        depths[a, e] += round(metres * 1024.0)
                if distance < other:
                    straight = tall * math.sqrt(1.0 - (distance / other) ** 2)
                    metres = max(dz + straight, 0.0) - max(dz - straight, 0.0)
                    depths[0, len(tangent)] += round(metres * 1024.0)
        for a in range(directions):
            for e in range(len(tangent) + 1):
                if depths[a, e] > 0:
                    light[c, a, e] *= math.exp(-depth * depths[a, e] / 1024.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted_bisector(along, distance, own, other):
    """Return how far a ray goes, in own crown radii up to 1, before it is nearer to the neighbour."""
    # t = |t own u - d| / other, squared: t^2 (other^2 - own^2) + 2 t own along = d^2
    square = distance * distance
    under = own * own * along * along + (other * other - own * own) * square
    if under < 0.0:
        return 1.0
    pace = own * along + math.sqrt(under)
    return square / pace if pace > square else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _chord(along, aside, dz, slope, radius, tall):
    """Return the metres that a ray from the origin goes inside an ellipsoid centred at (along, aside, dz)."""
    a = 1.0 / (radius * radius) + slope * slope / (tall * tall)
    b = along / (radius * radius) + slope * dz / (tall * tall)
    c = (along * along + aside * aside) / (radius * radius) + dz * dz / (tall * tall) - 1.0
    under = b * b - a * c
    if under <= 0.0:
        return 0.0
    root = math.sqrt(under)
    return (max((b + root) / a, 0.0) - max((b - root) / a, 0.0)) * math.sqrt(1.0 + slope * slope)


@njit(cache=True, nogil=True, error_model="numpy")
def walls_in_the_way(
    xyz, radius, base, height, pair_plant, pair_building, first, corners, top, azimuth, bands, room, light
):
    """Lower room and light of plants by the walls around them.

    Parameters
    ----------
    xyz, radius, base, height
        (c, 3), (c,) of plants, as above.
    pair_plant, pair_building
        (p,) which building may matter to which plant.
    first, corners, top
        Buildings: offsets of their walls, (w, 4) their walls' ends, (b,) their heights.
    azimuth
        (a,) evenly spaced from 0.
    bands
        (e + 2,) elevations between which each slope of light counts, the last straight up.
    room, light
        As above, lowered to what the nearest or highest wall leaves: before the crowns come.
    """
    directions = len(azimuth)
    step = 2.0 * math.pi / directions
    for p in range(len(pair_plant)):
        c = pair_plant[p]
        rise = top[pair_building[p]] - xyz[c, 2]
        beside = min(top[pair_building[p]], height[c]) - base[c]
        share = min(max(beside / max(height[c] - base[c], 1e-6), 0.0), 1.0)
        for w in range(first[pair_building[p]], first[pair_building[p] + 1]):
            ax, ay = corners[w, 0] - xyz[c, 0], corners[w, 1] - xyz[c, 1]
            bx, by = corners[w, 2] - xyz[c, 0], corners[w, 3] - xyz[c, 1]
            cross = ax * by - ay * bx
            if cross == 0.0:
                continue
            if cross < 0.0:
                ax, ay, bx, by, cross = bx, by, ax, ay, -cross
            start = math.atan2(ay, ax)
            turn = math.atan2(cross, ax * bx + ay * by)
            a = math.ceil(start / step - 1e-9)
            while a * step <= start + turn + 1e-9:
                k = a % directions
                ux, uy = math.cos(azimuth[k]), math.sin(azimuth[k])
                across = ux * (by - ay) - uy * (bx - ax)
                a += 1
                if across <= 0.0:
                    continue
                distance = max(cross / across, 0.05)
                room[c, k] = min(room[c, k], 1.0 - share * (1.0 - min(distance / radius[c], 1.0)))
                if rise <= 0.0:
                    continue
                elevation = math.atan2(rise, distance)
                for e in range(len(bands) - 2):
                    clear = (bands[e + 1] - elevation) / (bands[e + 1] - bands[e])
                    light[c, k, e] = min(light[c, k, e], min(max(clear, 0.0), 1.0))
