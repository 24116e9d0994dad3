"""Where cells lie beside roads: how far from the curb, on which side, how far along, and how near another road."""

from __future__ import annotations

import math

from numba import njit

from urbanforest_cli.synth.picture.grain_kernel import CODE


@njit(**CODE)
def near_roads(segments, chosen, reach_m, west, north, step, road, beyond, offset, along, other, heading):
    """Measure cells against the segments of roads.

    Parameters
    ----------
    segments
        (segments, 7) start x, y, end x, y, half width, metres along the road at the start, number of the road;
        those of a road one after the other.
    chosen
        (k,) numbers of segments, ascending.
    reach_m
        How far beyond the curb cells are measured.
    road, beyond, offset, along, other, heading
        Out: the nearest road, metres beyond its curb (below 0 on it), metres left of its middle, metres along it,
        metres beyond the curb of the next nearest road that runs another way, and the road's direction.
    """
    rows, cols = beyond.shape
    for k in range(len(chosen)):
        s = chosen[k]
        ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        half, number = segments[s, 4], int(segments[s, 6])
        length = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        if length < 1e-6:
            continue
        ux, uy = (bx - ax) / length, (by - ay) / length
        angle = math.atan2(uy, ux)
        reach = half + reach_m
        r0, r1 = (
            max(int((north - max(ay, by) - reach) / step), 0),
            min(int((north - min(ay, by) + reach) / step) + 1, rows),
        )
        c0, c1 = (
            max(int((min(ax, bx) - reach - west) / step), 0),
            min(int((max(ax, bx) + reach - west) / step) + 1, cols),
        )
        for r in range(r0, r1):
            dy = north - (r + 0.5) * step - ay
            for c in range(c0, c1):
                dx = west + (c + 0.5) * step - ax
                t = dx * ux + dy * uy
                side = ux * dy - uy * dx
                past = max(-t, t - length, 0.0)
                far = math.sqrt(side * side + past * past) - half
                if far > reach_m:
                    continue
                if road[r, c] == number:
                    if far < beyond[r, c]:
                        beyond[r, c], offset[r, c], heading[r, c] = far, side, angle
                        along[r, c] = segments[s, 5] + min(max(t, 0.0), length)
                    continue
                crosses = road[r, c] >= 0 and abs(math.sin(angle - heading[r, c])) > 0.5
                if far < beyond[r, c]:
                    if crosses:
                        other[r, c] = min(other[r, c], beyond[r, c])
                    road[r, c] = number
                    beyond[r, c], offset[r, c], heading[r, c] = far, side, angle
                    along[r, c] = segments[s, 5] + min(max(t, 0.0), length)
                elif crosses:
                    other[r, c] = min(other[r, c], far)
