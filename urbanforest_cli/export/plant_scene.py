"""Plants as shapes: skeletons become tapered branches and leaves, in metres, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.skeleton import Skeletons, pipe_count, standing
from urbanforest_cli.export.plant_light_kernel import colour_leaves, scatter_leaves

FloatArray = NDArray[np.floating]
Rgb = tuple[float, float, float]

TWIG_PIPES = 5  # leaves sit on wood that carries no more twig ends than this,
TWIG_SEASONS = 3  # and on what grew in the last seasons
TWIGLETS, TWIGLET_SPREAD, TWIGLET_SLIMNESS = 5, 1.9, 0.007  # on each twig; length in sprays of leaves; radius a length
LEAF_M2_A_METRE = (0.25, 1.1)  # least and most area of leaves on each metre of twig


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How a species looks; colours as red, green and blue of sRGB from 0 to 1.

    Parameters
    ----------
    leaf, leaf_young, bark
        Colours of old and young leaves, and of the bark.
    blossom, blossom_fraction
        Colour of flowers, and the share of leaves that they replace.
    blade_m
        Length and width of a leaf.
    spray_m
        How far from a drawn twig its leaves sit, on twiglets too fine to be grown.
    leaf_area_index
        Area of leaves over each area of ground under the crown.
    droop
        0 leaves held flat to 1 hanging.
    """

    leaf: Rgb
    leaf_young: Rgb
    bark: Rgb
    blossom: Rgb | None = None
    blossom_fraction: float = 0.0
    blade_m: tuple[float, float] = (0.14, 0.10)
    spray_m: float = 0.16
    leaf_area_index: float = 4.0
    droop: float = 0.3


@dataclass(frozen=True)
class Standing:
    """Plants at their places.

    Parameters
    ----------
    skeletons
        What grew.
    xy_m
        (s, 2) where each stands.
    looks
        (s,) how each looks.
    season_end
        (s,) the season each is shown at; its last if None.
    turn_rad, scale
        (s,) rotation about the vertical and size; none and 1 if None.
    """

    skeletons: Skeletons
    xy_m: FloatArray
    looks: Sequence[Look]
    season_end: NDArray[np.integer] | None = None
    turn_rad: FloatArray | None = None
    scale: FloatArray | None = None


@dataclass(frozen=True)
class Wood:
    """Branches: (m, 3) ends, (m,) radii, (m, 3) linear colours, and whose they are where that is known."""

    start: FloatArray
    end: FloatArray
    start_radius: FloatArray
    end_radius: FloatArray
    rgb: FloatArray
    plant: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class Twigs:
    """Branch ends that bear leaves: (n, 3) ends, (n,) radii out of the crown, whose plant, and a number by chance."""

    base: FloatArray
    tip: FloatArray
    outward: FloatArray
    plant: NDArray[np.int64]
    key: NDArray[np.uint64]


@dataclass(frozen=True)
class Leaves:
    """Leaves: (k,) twig, (k, 3) middle and half blades, (k, 3) linear colours, and the area each stands for."""

    twig: NDArray[np.int32]
    centre: FloatArray
    along: FloatArray
    across: FloatArray
    rgb: FloatArray
    area_m2: FloatArray


def linear(rgb: Rgb | FloatArray) -> FloatArray:
    """Return sRGB colours from 0 to 1 as linear light."""
    value = np.asarray(rgb, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def build_wood(plants: Standing, *, smooth: float = 0.5) -> tuple[Wood, Twigs]:
    """Turn skeletons into branches and the twigs that bear leaves.

    Parameters
    ----------
    plants
        What to show.
    smooth
        How far each node moves to the middle of its neighbours on the axis, 0 to 1: bark hides the bends of pith.
    """
    skeletons = plants.skeletons
    owner = np.repeat(np.arange(len(skeletons)), np.diff(skeletons.first))
    end = np.asarray(skeletons.seasons if plants.season_end is None else plants.season_end)
    above = skeletons.parent >= 0
    parent = np.where(above, skeletons.parent + skeletons.first[owner], np.arange(len(owner)))
    seen = standing(skeletons, end)
    pipes = pipe_count(skeletons, end)
    radius = skeletons.tip_radius_m[owner] * np.maximum(pipes, 1) ** (1.0 / skeletons.pipe_exponent[owner])
    xyz = _smoothed(skeletons, parent, above, smooth)
    turn = np.zeros(len(skeletons)) if plants.turn_rad is None else np.asarray(plants.turn_rad)
    scale = np.ones(len(skeletons)) if plants.scale is None else np.asarray(plants.scale)
    c, s, k = np.cos(turn)[owner], np.sin(turn)[owner], scale[owner]
    place = np.column_stack((k * (c * xyz[:, 0] - s * xyz[:, 1]) + plants.xy_m[owner, 0],
                             k * (s * xyz[:, 0] + c * xyz[:, 1]) + plants.xy_m[owner, 1], k * xyz[:, 2]))  # fmt: skip
    radius = radius * k
    own = np.flatnonzero(seen & above)
    below = parent[own]
    goes_on = (skeletons.order[own] == skeletons.order[below]) & (skeletons.parent[below] >= 0)
    start_radius = np.where(goes_on, radius[below], np.minimum(radius[below], 1.3 * radius[own]))
    foot = 1.0 + 0.4 * np.clip(1.0 - place[below, 2] / np.maximum(6.0 * radius[below], 0.05), 0, 1) ** 2
    first = place[below, 2] < 1e-3
    start_radius = np.where(first, np.maximum(start_radius, radius[own]) * foot, start_radius)
    bark = linear(np.array([look.bark for look in plants.looks]))
    tone = 0.85 + 0.3 * _chance(skeletons, owner, own, 3)
    wood = Wood(place[below], place[own], start_radius, radius[own], bark[owner[own]] * tone[:, None], owner[own])

    fresh = end[owner[own]] - skeletons.birth_season[own].astype(np.int64) < TWIG_SEASONS
    bears = (pipes[own] <= TWIG_PIPES) | fresh
    twig = own[bears]
    middle = _crown_middles(place[twig], owner[twig], len(skeletons))
    out = place[twig] - middle[owner[twig]]
    out /= np.linalg.norm(out, axis=1, keepdims=True) + 1e-9
    key = (skeletons.skeleton_id[owner[twig]].astype(np.uint64) << np.uint64(24)) + (
        twig - skeletons.first[owner[twig]]
    ).astype(np.uint64)
    return wood, Twigs(place[parent[twig]], place[twig], out, owner[twig], key)


def _smoothed(skeletons: Skeletons, parent: NDArray[np.int64], above: NDArray[np.bool_], share: float) -> FloatArray:
    """Return positions moved toward the middle of parent and the child that continues the axis; ends stay."""
    xyz = skeletons.xyz_m.astype(np.float64)
    after = np.full(len(parent), -1, dtype=np.int64)
    goes_on = above & (skeletons.order == skeletons.order[parent]) & (skeletons.death_season == 0)
    after[parent[goes_on]] = np.flatnonzero(goes_on)
    inner = above & (after >= 0)
    middle = 0.5 * (xyz[parent[inner]] + xyz[after[inner]])
    moved = xyz.copy()
    moved[inner] += share * (middle - xyz[inner])
    return moved


def _chance(skeletons: Skeletons, owner: NDArray[np.int64], nodes: NDArray[np.int64], salt: int) -> FloatArray:
    with np.errstate(over="ignore"):
        bits = (nodes - skeletons.first[owner[nodes]]).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        bits += (skeletons.skeleton_id[owner[nodes]].astype(np.uint64) + np.uint64(salt)) * np.uint64(
            0xBF58476D1CE4E5B9
        )
        bits ^= bits >> np.uint64(31)
        bits *= np.uint64(0x94D049BB133111EB)
    return np.asarray((bits >> np.uint64(40)).astype(np.float64) / 2.0**24)


def _crown_middles(points: FloatArray, owner: NDArray[np.int64], count: int) -> FloatArray:
    number = np.maximum(np.bincount(owner, minlength=count), 1)
    middle = np.column_stack([np.bincount(owner, points[:, c], minlength=count) / number for c in range(3)])
    middle[:, 2] *= 0.8
    return middle


def build_leaves(twigs: Twigs, looks: Sequence[Look], *, shortest_m: float | FloatArray = 0.0) -> Leaves:
    """Set leaves on twigs.

    Parameters
    ----------
    twigs, looks
        From `build_wood`, and of each plant.
    shortest_m
        Leaves shorter than this, one number or one a plant, are merged into fewer, larger ones of the same area.
    """
    blade = np.array([look.blade_m for look in looks], dtype=np.float64).reshape(-1, 2)
    grown = np.maximum(shortest_m / blade[:, 0], 1.0)
    blade *= grown[:, None]
    blade_area = 0.72 * blade[:, 0] * blade[:, 1]
    length = np.clip(np.linalg.norm(twigs.tip - twigs.base, axis=1), 0.04, 0.6)
    wanted = _leaf_area_a_metre(twigs, length, np.array([look.leaf_area_index for look in looks])) / blade_area
    expected = wanted[twigs.plant] * length
    chance = (twigs.key * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(40)).astype(np.float64) / 2.0**24
    count = np.floor(expected + chance).astype(np.int64)
    droop = np.array([look.droop for look in looks], dtype=np.float64)
    spray = np.array([look.spray_m for look in looks], dtype=np.float64)
    twig, centre, along, across, tone = scatter_leaves(
        twigs.base, twigs.tip, twigs.outward, count, twigs.key, blade[twigs.plant], spray[twigs.plant],
        droop[twigs.plant],
    )  # fmt: skip
    old, young = (linear(np.array(colours).reshape(-1, 3)) for colours in
                  ([look.leaf for look in looks], [look.leaf_young for look in looks]))  # fmt: skip
    flowers = np.array([look.blossom_fraction if look.blossom else 0.0 for look in looks])
    petal = linear(np.array([look.blossom or (0.0, 0.0, 0.0) for look in looks]).reshape(-1, 3))
    rgb = colour_leaves(twig, twigs.plant, tone, chance, old, young, petal, _quantile_of_mean(flowers))
    return Leaves(twig, centre, along, across, rgb, blade_area[twigs.plant[twig]])


def build_twiglets(twigs: Twigs, looks: Sequence[Look]) -> Wood:
    """Set the twiglets, too fine to be grown, that leaves sit on in summer; a bare crown looks empty without them."""
    spray = TWIGLET_SPREAD * np.array([look.spray_m for look in looks], dtype=np.float64)[twigs.plant]
    count = np.full(len(twigs.tip), TWIGLETS, dtype=np.int64)
    twig, end, _, _, tone = scatter_leaves(
        twigs.base, twigs.tip, twigs.outward, count, twigs.key, np.zeros((len(count), 2)), spray, np.zeros(len(count))
    )
    base, run = twigs.base[twig], (twigs.tip - twigs.base)[twig]
    along = np.einsum("ij,ij->i", end - base, run) / np.maximum(np.einsum("ij,ij->i", run, run), 1e-12)
    start = base + run * np.clip(along - 0.35, 0.0, 1.0)[:, None]
    bark = linear(np.array([look.bark for look in looks]))[twigs.plant[twig]]
    thin = TWIGLET_SLIMNESS * spray[twig]
    return Wood(start, end.astype(np.float64), thin, 0.6 * thin, bark * (0.7 + 0.4 * tone)[:, None], twigs.plant[twig])


def _leaf_area_a_metre(twigs: Twigs, length: FloatArray, index: FloatArray) -> FloatArray:
    """Return (s,) square metres of leaves on a metre of twig that give each plant its leaf area index."""
    count = len(index)
    metres = np.maximum(np.bincount(twigs.plant, length, minlength=count), 1e-9)
    number = np.maximum(np.bincount(twigs.plant, minlength=count), 1)
    square = np.zeros(count)
    for c in range(2):  # a disc's second moment about its middle is half of its squared radius
        mean = np.bincount(twigs.plant, twigs.tip[:, c], minlength=count) / number
        square += np.bincount(twigs.plant, (twigs.tip[:, c] - mean[twigs.plant]) ** 2, minlength=count) / number
    return np.clip(index * 2 * np.pi * square / metres, *LEAF_M2_A_METRE)


def _quantile_of_mean(share: FloatArray) -> FloatArray:
    """Return below which value the mean of two uniform numbers lies with a probability."""
    return np.where(share < 0.5, np.sqrt(share / 2), 1 - np.sqrt((1 - share) / 2))


def joined_wood(parts: Sequence[Wood]) -> Wood:
    """Put branches together."""
    return Wood(*(np.concatenate([getattr(part, name) for part in parts])
                  for name in ("start", "end", "start_radius", "end_radius", "rgb")))  # fmt: skip
