"""Leaves of species as outlines and veins, and where a species' atlas of leaves holds what.

A leaf lies on a square from 0 to 1: its foot in the middle of the lower edge, its tip at the upper one, y upward. A
blade's true length and width stretch that square.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Cell = tuple[float, float, float, float]  # left, top, right, bottom on the atlas, 0 to 1, v downward
Margin = Literal["entire", "serrate", "doubly serrate"]

ATLAS_PX = 512
PAD = 4 / ATLAS_PX  # a rim of each cell that stays clear, so that coarse mip levels do not mix neighbours


def _cell(left: float, top: float, size: float) -> Cell:
    return (left + PAD, top + PAD, left + size - PAD, top + size - PAD)


SPRAY_CELLS: tuple[Cell, ...] = (_cell(0.0, 0.0, 0.5), _cell(0.5, 0.0, 0.5))
CLUMP_CELLS: tuple[Cell, ...] = (_cell(0.0, 0.5, 0.5),)
LEAF_CELLS: tuple[Cell, ...] = (_cell(0.5, 0.5, 0.25), _cell(0.75, 0.5, 0.25))
FLOWER_CELLS: tuple[Cell, ...] = (_cell(0.5, 0.75, 0.25), _cell(0.75, 0.75, 0.25))  # more leaves where none flowers
LEAF_COVER, SPRAY_COVER, CLUMP_COVER = 0.46, 0.38, 0.48  # share of a cell, without its rim, that is leaf
SPRAY_LEAVES, CLUMP_LEAVES = 14, 90  # as many leaves as the pictures show


@dataclass(frozen=True)
class LeafShape:
    """How a species' leaf is cut.

    Parameters
    ----------
    outline
        Corners of the right half from the foot to the tip, x from the midrib (0) to the edge (0.5), y from 0 to 1.
    lobed
        Whether those corners are points and bays of lobes; drawn with straight sides, else rounded.
    lobe_tips
        Where side veins end: tips of lobes; none for a plain blade, whose veins are set evenly.
    palmate
        Whether side veins all leave from the foot, or one after another along the midrib.
    margin, teeth
        Teeth of the edge, and how many on each side.
    leaflets
        Pairs of leaflets along a stalk; 0 for a simple leaf.
    """

    outline: tuple[tuple[float, float], ...]
    lobed: bool = False
    lobe_tips: tuple[tuple[float, float], ...] = ()
    palmate: bool = False
    margin: Margin = "entire"
    leaflets: int = 0
    teeth: int = 13


OVATE = ((0.0, 0.0), (0.20, 0.03), (0.40, 0.16), (0.49, 0.34), (0.45, 0.55), (0.29, 0.78), (0.10, 0.94), (0.0, 1.0))
HEART = ((0.0, 0.10), (0.10, 0.02), (0.27, 0.0), (0.44, 0.12), (0.49, 0.32), (0.41, 0.56), (0.23, 0.78),
         (0.06, 0.92), (0.0, 1.0))  # fmt: skip
ROUNDISH = ((0.0, 0.06), (0.12, 0.0), (0.32, 0.10), (0.46, 0.34), (0.48, 0.56), (0.37, 0.78), (0.14, 0.91),
            (0.04, 0.95), (0.0, 1.0))  # fmt: skip
CHERRY = ((0.0, 0.0), (0.20, 0.05), (0.39, 0.20), (0.48, 0.42), (0.44, 0.62), (0.26, 0.80), (0.08, 0.90), (0.0, 1.0))
LANCE = ((0.0, 0.0), (0.20, 0.08), (0.42, 0.28), (0.49, 0.48), (0.41, 0.70), (0.20, 0.90), (0.0, 1.0))
MAPLE = ((0.0, 0.14), (0.10, 0.12), (0.20, 0.03), (0.24, 0.15), (0.36, 0.11), (0.33, 0.22), (0.29, 0.28),
         (0.37, 0.37), (0.50, 0.40), (0.46, 0.48), (0.49, 0.63), (0.40, 0.62), (0.33, 0.68), (0.30, 0.58),
         (0.20, 0.52), (0.15, 0.56), (0.16, 0.70), (0.23, 0.78), (0.12, 0.84), (0.06, 0.87), (0.0, 1.0))  # fmt: skip
PLANE = ((0.0, 0.10), (0.10, 0.07), (0.22, 0.0), (0.27, 0.09), (0.38, 0.09), (0.37, 0.20), (0.34, 0.30),
         (0.42, 0.40), (0.50, 0.46), (0.45, 0.53), (0.47, 0.66), (0.38, 0.64), (0.31, 0.66), (0.27, 0.58),
         (0.19, 0.56), (0.21, 0.68), (0.27, 0.74), (0.18, 0.82), (0.07, 0.88), (0.0, 1.0))  # fmt: skip
RED_OAK = ((0.0, 0.0), (0.10, 0.06), (0.22, 0.05), (0.27, 0.15), (0.22, 0.18), (0.15, 0.22), (0.26, 0.28),
           (0.43, 0.27), (0.42, 0.35), (0.50, 0.43), (0.36, 0.43), (0.20, 0.44), (0.22, 0.51), (0.37, 0.58),
           (0.47, 0.58), (0.42, 0.65), (0.46, 0.74), (0.33, 0.70), (0.18, 0.65), (0.15, 0.71), (0.22, 0.80),
           (0.33, 0.83), (0.22, 0.88), (0.10, 0.86), (0.06, 0.91), (0.0, 1.0))  # fmt: skip

SHAPES: dict[str, LeafShape] = {
    "acer_platanoides": LeafShape(MAPLE, lobed=True, palmate=True,
                                  lobe_tips=((0.34, 0.12), (0.49, 0.42), (0.46, 0.60))),
    "tilia_cordata": LeafShape(HEART, margin="serrate", teeth=20),
    "platanus_acerifolia": LeafShape(PLANE, lobed=True, palmate=True, lobe_tips=((0.36, 0.10), (0.49, 0.47))),
    "quercus_rubra": LeafShape(RED_OAK, lobed=True,
                               lobe_tips=((0.25, 0.12), (0.46, 0.36), (0.44, 0.66), (0.28, 0.83))),
    "gleditsia_triacanthos": LeafShape(LANCE, leaflets=9),
    "prunus_serrulata": LeafShape(CHERRY, margin="serrate", teeth=18),
    "corylus_avellana": LeafShape(ROUNDISH, margin="doubly serrate", teeth=12),
    "cornus_sanguinea": LeafShape(OVATE),
    "ligustrum_vulgare": LeafShape(LANCE),
    "syringa_vulgaris": LeafShape(HEART),
}  # fmt: skip
PLAIN = LeafShape(OVATE)


def shape_of(species_id: str) -> LeafShape:
    """Return a species' leaf; a plain egg-shaped one where none is known."""
    return SHAPES.get(species_id, PLAIN)


@cache
def blade_outline(shape: LeafShape) -> FloatArray:
    """Return (n, 2) corners around one blade, or one leaflet, with its teeth."""
    half = np.array(shape.outline, dtype=np.float64)
    half = _rounded(half, 1 if shape.lobed else 4)
    if shape.margin != "entire":
        half = _toothed(half, shape.teeth, 0.022)
    if shape.margin == "doubly serrate":
        half = _toothed(half, 3 * shape.teeth, 0.012)
    left = half[::-1][1:-1] * (-1.0, 1.0)
    return np.asarray(np.concatenate([half, left]) + np.array([0.5, 0.0]))


def _rounded(line: FloatArray, times: int) -> FloatArray:
    """Cut the corners of a line, its ends kept (Chaikin 1974); lobes keep their points."""
    for _ in range(times):
        a, b = line[:-1], line[1:]
        cut = np.empty((2 * len(a), 2))
        near = 0.12 if times == 1 else 0.25
        cut[0::2], cut[1::2] = a + near * (b - a), b - near * (b - a)
        line = np.concatenate([line[:1], cut, line[-1:]])
    return line


def _toothed(line: FloatArray, teeth: int, depth: float) -> FloatArray:
    """Cut teeth that point toward the tip into a line."""
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    run = np.concatenate([[0.0], np.cumsum(step)]) / step.sum()
    at = np.sort(np.concatenate([np.linspace(0, 1, teeth + 1), np.linspace(0, 1, teeth + 1)[:-1] + 0.82 / teeth]))
    points = np.column_stack([np.interp(at, run, line[:, c]) for c in range(2)])
    ahead = np.gradient(points, axis=0)
    out = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    out /= np.linalg.norm(out, axis=1, keepdims=True) + 1e-12
    tip = np.zeros(len(at))
    tip[1:-1:2] = depth
    points += out * tip[:, None]
    points[:, 0] = np.clip(points[:, 0], 0.0, 0.5)
    return points


@cache
def blade_veins(shape: LeafShape) -> tuple[tuple[FloatArray, float], ...]:
    """Return lines of (m, 2) points and their width: the midrib, and veins to the tips of lobes or along the edge."""
    foot = min(0.02 + shape.outline[0][1], 0.2)
    veins = [(np.array([[0.5, 0.0], [0.5, 0.985]]), 0.022)]
    if shape.lobe_tips:
        for x, y in shape.lobe_tips:
            start = foot if shape.palmate else max(y - 0.75 * x, 0.02)
            for side in (-1, 1):
                veins.append((np.array([[0.5, start], [0.5 + 0.96 * side * x, y]]), 0.014))
    else:
        count = 7
        half = np.array(shape.outline)
        for number in range(count):
            start = foot + 0.03 + (0.82 - foot) * number / count
            rise = 0.20 * (1.0 - 0.5 * number / count)
            end_y = min(start + rise, 0.97)
            width = float(np.interp(end_y, half[:, 1], half[:, 0]))
            for side in (-1, 1):
                bent = np.array([[0.5, start], [0.5 + 0.55 * side * width, start + 0.42 * rise],
                                 [0.5 + 0.93 * side * width, end_y]])  # fmt: skip
                veins.append((bent, 0.009))
    return tuple(veins)
