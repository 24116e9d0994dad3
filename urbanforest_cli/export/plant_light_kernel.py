"""Where the leaves of twigs sit, and numbers by chance that hang on places alone."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def hash_pair(a, b):
    """Hash two whole numbers to 64 bits (finaliser of SplitMix64; Steele, Lea and Flood 2014)."""
    z = (np.uint64(a) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + (np.uint64(b) + np.uint64(1)) * np.uint64(
        0xD1B54A32D192ED03
    )
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True, error_model="numpy")
def chance(bits):
    """Return a number in [0, 1) from hashed bits."""
    return float(bits >> np.uint64(11)) * 1.1102230246251565e-16


@njit(cache=True, nogil=True, error_model="numpy")
def scatter_leaves(base, tip, outward, count, key, blade_m, spray_m, droop):
    """Set leaves around twigs.

    Parameters
    ----------
    base, tip
        (n, 3) ends of the twigs.
    outward
        (n, 3) unit vectors out of the crown.
    count
        (n,) leaves of each.
    key
        (n,) one number a twig, that its leaves' places hang on.
    blade_m
        (n, 2) length and width of a blade.
    spray_m
        (n,) how far from the twig leaves sit, on twiglets and petioles that are not drawn.
    droop
        (n,) 0 blades held flat to 1 hanging.

    Returns
    -------
    twig
        (k,) whose leaf it is.
    centre, along, across
        (k, 3) middle of the blade, and half of it along and across.
    tone
        (k,) 0 to 1, by tone_here.
    """
    total = 0
    for n in range(len(count)):
        total += count[n]
    twig = np.empty(total, np.int32)
    centre = np.empty((total, 3), np.float32)
    along = np.empty((total, 3), np.float32)
    across = np.empty((total, 3), np.float32)
    tone = np.empty(total, np.float32)
    filled = 0
    for n in range(len(count)):
        length = blade_m[n, 0]
        for leaf in range(count[n]):
            bits = hash_pair(key[n], leaf)
            more = hash_pair(bits >> np.uint64(3), leaf + 11)
            share = float(bits & np.uint64(0xFFFF)) / 65535.0
            turn = float((bits >> np.uint64(16)) & np.uint64(0xFFFF)) / 65535.0 * 2 * np.pi
            lift = float((bits >> np.uint64(32)) & np.uint64(0xFFFF)) / 65535.0 * 2 - 1
            tone_here = float((bits >> np.uint64(48)) & np.uint64(0xFFFF)) / 65535.0
            flat = np.sqrt(1 - lift * lift)
            sx, sy, sz = flat * np.cos(turn), flat * np.sin(turn), 0.6 * lift - 0.35 * droop[n]
            reach = 0.45 * length + spray_m[n] * np.sqrt(float(more & np.uint64(0xFFFF)) / 65535.0)
            for c in range(3):
                centre[filled, c] = base[n, c] + (tip[n, c] - base[n, c]) * (0.15 + 0.95 * share)
            centre[filled, 0] += sx * reach
            centre[filled, 1] += sy * reach
            centre[filled, 2] += sz * reach
            # Its normal looks upward and out of the crown, the more so the less it droops.
            jx = float((more >> np.uint64(16)) & np.uint64(0xFFFF)) / 32767.5 - 1
            jy = float((more >> np.uint64(32)) & np.uint64(0xFFFF)) / 32767.5 - 1
            jz = float((more >> np.uint64(48)) & np.uint64(0xFFFF)) / 32767.5 - 1
            nx = 0.75 * outward[n, 0] + 0.8 * jx
            ny = 0.75 * outward[n, 1] + 0.8 * jy
            nz = 0.75 * outward[n, 2] + 0.8 * jz + 0.7 * (1 - droop[n])
            size = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-6
            nx, ny, nz = nx / size, ny / size, nz / size
            dot = sx * nx + sy * ny + sz * nz
            lx, ly, lz = sx - dot * nx, sy - dot * ny, sz - dot * nz
            size = np.sqrt(lx * lx + ly * ly + lz * lz) + 1e-6
            half, wide = 0.5 * length * (0.8 + 0.4 * tone_here), 0.5 * blade_m[n, 1] * (0.8 + 0.4 * tone_here)
            lx, ly, lz = lx / size, ly / size, lz / size
            along[filled, 0], along[filled, 1], along[filled, 2] = lx * half, ly * half, lz * half
            across[filled, 0] = (ny * lz - nz * ly) * wide
            across[filled, 1] = (nz * lx - nx * lz) * wide
            across[filled, 2] = (nx * ly - ny * lx) * wide
            tone[filled] = tone_here
            twig[filled] = n
            filled += 1
    return twig, centre, along, across, tone


@njit(cache=True, nogil=True, error_model="numpy")
def colour_leaves(twig, plant, tone, of_twig, old, young, petal, flowering):
    """Return (k, 3) linear colours of leaves: those of a twig resemble one another; some give way to petals.

    Parameters
    ----------
    twig, tone
        (k,) from `scatter_leaves`.
    plant, of_twig
        (n,) whose twig it is, and a number by chance from 0 to 1.
    old, young, petal
        (s, 3) linear colours of each plant.
    flowering
        (s,) leaves with a lower number than this are petals.
    """
    rgb = np.empty((len(twig), 3), np.float32)
    for k in range(len(twig)):
        here, whose = of_twig[twig[k]], plant[twig[k]]
        t = float(tone[k])
        if 0.5 * t + 0.5 * ((here * 7.0) % 1.0) < flowering[whose]:
            for c in range(3):
                rgb[k, c] = petal[whose, c] * (0.8 + 0.3 * t)
            continue
        share = min(max(0.55 * here + 0.45 * t, 0.0), 1.0)
        for c in range(3):
            rgb[k, c] = (old[whose, c] + (young[whose, c] - old[whose, c]) * share) * (0.82 + 0.36 * t)
    return rgb
