"""The compiled part of `leaves.py`: which twig each card sits on, and its corners."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.export.mesh.twig_kernel import cell_of, cells_a_side, crown_light
from urbanforest_cli.export.plant_light_kernel import hash_pair

LEAF, SPRAY, CLUMP = 0, 1, 2
SKYWARD = 0.35  # of normals, beside their way out of the crown
KEY_STEP = 0x9E3779B97F4A7C15


class Style(NamedTuple):
    """How the cards of each plant look: (s, ...) all."""

    cards: NDArray[np.int64]
    length_m: NDArray[np.float64]
    width_m: NDArray[np.float64]
    reach_m: NDArray[np.float64]  # how far leaves stand from their twig
    spray_m: NDArray[np.float64]
    droop: NDArray[np.float64]
    old: NDArray[np.float64]  # (s, 3) factors on the texture, 0 to 1
    young: NDArray[np.float64]
    flowers: NDArray[np.float64]  # share of single leaves that are flowers
    jitter: float  # how freely cards turn
    upward: float  # how much they look up
    bend: float  # how far normals turn out of the crown
    dark: float  # light deep inside the crown


@njit(cache=True, nogil=True, error_model="numpy")
def share_out(twigs, count):
    """Give each card a twig: (k,) its row, and which card of that twig it is.

    A plant's twigs are cut, in their order, into as many stretches of one leaf area as it has cards, `count` (s,), and
    a card sits on the outermost twig of its stretch.
    """
    twig = np.empty(count.sum(), np.int64)
    number = np.empty(len(twig), np.int32)
    card = 0
    for s in range(len(count)):
        begin, end = twigs.first[s], twigs.first[s + 1]
        total = 0.0
        for t in range(begin, end):
            total += twigs.area_m2[t]
        share = total / max(count[s], 1)
        done, filled, best, best_away = 0, 0.0, begin, -1.0
        for t in range(begin, end):
            away = 0.0
            for c in range(3):
                away += (np.float64(twigs.tip[t, c]) - twigs.middle[s, c]) ** 2
            if away > best_away:
                best, best_away = t, away
            filled += twigs.area_m2[t]
            on_twig = 0
            while done < count[s] and (filled >= share * (done + 1) or t == end - 1):
                twig[card], number[card] = best, on_twig
                card += 1
                done += 1
                on_twig += 1
                best, best_away = t, -1.0
    return twig, number


@njit(cache=True, nogil=True, error_model="numpy")
def set_cards(twigs, skeleton_id, style, mode, twig, number, cells, cells_of, xyz, normal, uv, tint, triangle):
    """Set cards on the twigs of `share_out`; the arrays from `xyz` on are filled, four corners a card.

    `cells` (c, 4) of the atlas: first those of leaves, then those of flowers, `cells_of` (2,) of each;
    where nothing flowers the latter show more leaves.

    Each is set as `plant_light_kernel.scatter_leaves` sets a leaf, or stands on its twig as a spray.
    """
    low, size = np.empty(3), np.empty(3)
    last = 0
    for s in range(len(style.cards)):
        first, last = last, last + style.cards[s]
        if first == last:
            continue
        n = cells_a_side(twigs, s)
        light, area = np.empty((n, n, n), np.float32), np.empty((n, n, n), np.float32)
        crown_light(twigs, s, low, size, light, area)
        droop, jitter, flowers = style.droop[s], style.jitter, style.flowers[s]
        mx, my, mz = twigs.middle[s, 0], twigs.middle[s, 1], twigs.middle[s, 2]
        for card in range(first, last):
            t = twig[card]
            key = (np.uint64(skeleton_id[s]) << np.uint64(24)) + np.uint64(twigs.node[t])
            bits = hash_pair(key, number[card])
            more = hash_pair(bits >> np.uint64(3), number[card] + 11)
            share = _part(bits, 0)
            turn = 2.0 * np.pi * _part(bits, 16)
            lift = 2.0 * _part(bits, 32) - 1.0
            tone = _part(bits, 48)
            jx, jy, jz = 2.0 * _part(more, 16) - 1.0, 2.0 * _part(more, 32) - 1.0, 2.0 * _part(more, 48) - 1.0
            bx, by, bz = np.float64(twigs.base[t, 0]), np.float64(twigs.base[t, 1]), np.float64(twigs.base[t, 2])
            ex, ey, ez = np.float64(twigs.tip[t, 0]), np.float64(twigs.tip[t, 1]), np.float64(twigs.tip[t, 2])
            ox, oy, oz = _unit(ex - mx, ey - my, ez - mz)
            flat = np.sqrt(1.0 - lift * lift)
            sx, sy, sz = flat * np.cos(turn), flat * np.sin(turn), 0.6 * lift - 0.35 * droop
            at = 0.15 + 0.95 * share
            x, y, z = bx + (ex - bx) * at, by + (ey - by) * at, bz + (ez - bz) * at
            # The card's normal looks upward and out of the crown, the more so the less leaves droop.
            nx, ny = 0.75 * ox + jitter * jx, 0.75 * oy + jitter * jy
            nz = 0.75 * oz + jitter * jz + style.upward * (1.0 - droop)
            nx, ny, nz = _unit(nx, ny, nz)
            grown = 0.8 + 0.4 * tone
            half, wide = 0.5 * style.length_m[s] * grown, 0.5 * style.width_m[s] * grown
            if mode == LEAF:
                reach = 0.45 * style.length_m[s] + style.spray_m[s] * np.sqrt(_part(more, 0))
                x, y, z = x + sx * reach, y + sy * reach, z + sz * reach
            else:
                # A spray goes on where its twig points, out of the crown and by chance.
                tx, ty, tz = _unit(ex - bx, ey - by, ez - bz)
                sx, sy, sz = 0.7 * tx + 0.5 * ox + sx, 0.7 * ty + 0.5 * oy + sy, 0.7 * tz + 0.5 * oz + sz
            dot = sx * nx + sy * ny + sz * nz
            lx, ly, lz = _unit(sx - dot * nx, sy - dot * ny, sz - dot * nz)
            ax, ay, az = ny * lz - nz * ly, nz * lx - nx * lz, nx * ly - ny * lx
            if mode != LEAF:
                x, y, z = x + 0.9 * half * lx, y + 0.9 * half * ly, z + 0.9 * half * lz
                # What would stand further out than the twig's leaves is drawn back: the crown keeps its outline.
                px, py, pz = x - mx, y - my, z - mz
                away = np.sqrt(px * px + py * py + pz * pz) + 1e-9
                # Its furthest corner is `ahead` along the card's way out of the crown, and sqrt(square) in all.
                ahead = (
                    away + (half * abs(px * lx + py * ly + pz * lz) + wide * abs(px * ax + py * ay + pz * az)) / away
                )
                square = 2.0 * away * ahead - away * away + half * half + wide * wide
                reach = np.sqrt((ex - mx) ** 2 + (ey - my) ** 2 + (ez - mz) ** 2) + style.reach_m[s]
                back = 0.0
                if square > reach * reach:
                    back = min((ahead - np.sqrt(max(ahead * ahead - square + reach * reach, 0.0))) / away, 1.0)
                x, y, z = x - back * px, y - back * py, z - back * pz
            z = max(z, half * abs(lz) + wide * abs(az))
            if nx * ox + ny * oy + nz * oz < 0.0:  # the front looks out of the crown
                nx, ny, nz, wide = -nx, -ny, -nz, -wide
            lx, ly, lz, ax, ay, az = half * lx, half * ly, half * lz, wide * ax, wide * ay, wide * az

            petal = mode == LEAF and flowers > 0.0 and _part(hash_pair(more, 5), 0) < flowers
            shown = cells_of[1] if petal else cells_of[0]
            if mode == LEAF and flowers == 0.0:
                shown += cells_of[1]
            which = np.int64((more >> np.uint64(7)) & np.uint64(0xFF)) % shown
            if petal:
                which += cells_of[0]
            left, top, right, bottom = cells[which, 0], cells[which, 1], cells[which, 2], cells[which, 3]
            if bits & np.uint64(1):
                left, right = right, left

            i = cell_of(x + size[0] * (_part(bits, 5) - 0.5), low[0], size[0], len(light))
            j = cell_of(y + size[1] * (_part(bits, 17) - 0.5), low[1], size[1], len(light))
            k = cell_of(z + size[2] * (_part(bits, 29) - 0.5), low[2], size[2], len(light))
            open_sky = style.dark + (1.0 - style.dark) * light[k, j, i]
            # Leaves of a twig resemble one another.
            of_twig = float((key * np.uint64(KEY_STEP)) >> np.uint64(40)) / 2.0**24
            young = 0.55 * of_twig + 0.45 * tone
            bright = (0.82 + 0.36 * tone) * open_sky
            red, green, blue = 1.0, 1.0, 1.0
            if not petal:
                red = style.old[s, 0] + young * (style.young[s, 0] - style.old[s, 0])
                green = style.old[s, 1] + young * (style.young[s, 1] - style.old[s, 1])
                blue = style.old[s, 2] + young * (style.young[s, 2] - style.old[s, 2])
            red, green, blue = _byte(red * bright), _byte(green * bright), _byte(blue * bright)

            # A leaf is small enough for one normal; larger cards are lit as a piece of the crown's rounding.
            bx, by, bz = _bent(x - mx, y - my, z - mz, nx, ny, nz, style.bend)
            for corner in range(4):
                up = 1.0 if corner == 1 or corner == 2 else -1.0
                side = 1.0 if corner >= 2 else -1.0
                v = 4 * card + corner
                px, py, pz = x + up * lx + side * ax, y + up * ly + side * ay, z + up * lz + side * az
                xyz[v, 0], xyz[v, 1], xyz[v, 2] = px, py, pz
                if mode != LEAF:
                    bx, by, bz = _bent(px - mx, py - my, pz - mz, nx, ny, nz, style.bend)
                normal[v, 0], normal[v, 1], normal[v, 2] = bx, by, bz
                uv[v, 0] = right if side > 0.0 else left
                uv[v, 1] = top if up > 0.0 else bottom
                tint[v, 0], tint[v, 1], tint[v, 2] = red, green, blue
            foot = np.uint32(4 * (card - first))
            for half_card in range(2):
                triangle[2 * card + half_card, 0] = foot
                triangle[2 * card + half_card, 1] = foot + np.uint32(1 + half_card)
                triangle[2 * card + half_card, 2] = foot + np.uint32(2 + half_card)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bent(x, y, z, nx, ny, nz, bend):
    """Return a card's normal turned out of the crown and up, the more so the more the card faces that way.

    A card that stands across that way is seen from both sides alike, and readers turn the normal of a back around:
    turned out of the crown as well, half of such cards would be lit from the wrong side.
    """
    x, y, z = _unit(x, y, z)
    x, y, z = _unit(x, y, z + SKYWARD)
    bend *= max(x * nx + y * ny + z * nz, 0.0)
    return _unit(nx + bend * (x - nx), ny + bend * (y - ny), nz + bend * (z - nz))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _part(bits, shift):
    """Return 16 of the bits as a number from 0 to 1."""
    return float((bits >> np.uint64(shift)) & np.uint64(0xFFFF)) / 65535.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _unit(x, y, z):
    size = 1.0 / (np.sqrt(x * x + y * y + z * z) + 1e-9)
    return x * size, y * size, z * size


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _byte(value):
    return np.uint8(min(max(255.0 * value + 0.5, 0.0), 255.0))
