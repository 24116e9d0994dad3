"""What things look like from the air: grounds, roofs, leaves and paints as the sensor counts them in full sun."""

from __future__ import annotations

import numpy as np

FIELD, LAWN, SOIL, GRAVEL, CONCRETE, ASPHALT, PAVERS, MULCH, WATER, POOL, BALLAST, ROAD = range(12)
"""Grounds."""

GROUNDS = np.array(
    [
        (154, 138, 111, 150),  # FIELD: dry grass
        (82, 103, 71, 158),  # LAWN
        (146, 129, 107, 142),  # SOIL
        (156, 149, 136, 148),  # GRAVEL
        (164, 160, 150, 146),  # CONCRETE
        (112, 112, 109, 98),  # ASPHALT
        (150, 126, 110, 136),  # PAVERS
        (98, 84, 70, 104),  # MULCH
        (60, 76, 86, 30),  # WATER
        (104, 170, 182, 70),  # POOL
        (122, 113, 104, 118),  # BALLAST
        (104, 105, 104, 90),  # ROAD
    ],
    dtype=np.float64,
)
"""(grounds, 4) red, green, blue, near infrared, 0-255."""

STALL_M, STALL_DEEP_M, AISLE_M = 2.7, 5.2, 6.4
"""Stalls of parking places, in pairs with an aisle between the pairs."""

SHINGLE, TILE, METAL, MEMBRANE = range(4)
"""Sorts of roofs."""

ROOFS = {
    SHINGLE: np.array(
        [
            (128, 125, 122, 128), (104, 103, 103, 108), (86, 84, 84, 90), (124, 105, 92, 124), (106, 88, 78, 108),
            (148, 138, 124, 148), (138, 136, 132, 138), (96, 100, 108, 102), (100, 112, 102, 112), (160, 154, 144, 158),
        ],
        dtype=np.float64,
    ),
    TILE: np.array(
        [(172, 116, 88, 168), (160, 104, 80, 156), (184, 136, 104, 176), (150, 106, 88, 150)], dtype=np.float64
    ),
    METAL: np.array(
        [(172, 176, 180, 166), (150, 156, 162, 148), (186, 184, 176, 182), (128, 138, 148, 130), (156, 140, 128, 152)],
        dtype=np.float64,
    ),
    MEMBRANE: np.array(
        [
            (204, 201, 195, 192), (186, 182, 174, 176), (166, 163, 156, 158), (150, 147, 142, 144),
            (128, 126, 124, 126), (176, 166, 150, 168), (212, 211, 208, 200), (142, 132, 122, 138),
        ],
        dtype=np.float64,
    ),
}  # fmt: skip
"""Colours each sort comes in."""

LEAVES = np.array(
    [
        (74, 102, 66, 172), (68, 94, 66, 162), (84, 104, 70, 174), (62, 86, 64, 152), (94, 110, 74, 178),
        (70, 98, 74, 166), (82, 102, 74, 164), (62, 94, 60, 172), (96, 114, 78, 176), (76, 94, 70, 158),
    ],
    dtype=np.float64,
)  # fmt: skip
"""Foliage of trees and shrubs, one a kind."""

PAINTS = np.array(
    [
        (206, 207, 208, 190), (188, 189, 190, 172), (150, 152, 154, 138), (96, 98, 102, 86), (58, 60, 64, 52),
        (46, 48, 52, 42), (146, 56, 52, 130), (62, 80, 128, 90), (176, 166, 146, 164), (112, 116, 110, 104),
    ],
    dtype=np.float64,
)  # fmt: skip
"""Cars."""

DARK_SUN = np.array([20.0, 31.0, 46.0, 12.0])
"""What the air adds: the count of a black thing."""
SKY_SHARE = np.array([0.16, 0.21, 0.28, 0.14])
"""Light in a shadow as a share of that on level ground in the sun."""
