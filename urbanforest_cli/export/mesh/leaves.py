"""Leaves as textured cards: one a leaf, a spray or a clump, from skeletons in flat arrays.

Which twigs bear leaves, how much and where, follows the pictures (`plant_scene`): the cards of level "full" are the
leaves that pictures show. Coarser cards hold more leaves each; their leaf area stays that of all leaves, and they sit
on the outermost twigs of those whose leaves they hold, so that the crown keeps its outline.

A card is one rectangle: of equal cost, twice as many plain ones hide each other better than half as many bent ones.
Normals are turned from the card's own toward the direction out of the crown's middle (`BEND`), so that a crown is lit
as a body and not as confetti; the front of each card looks out of the crown. The tint holds a leaf's own colour
between old and young, and the light that the leaves around leave it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Meshes
from urbanforest_cli.core.skeleton import Skeletons, pipe_count, preorder
from urbanforest_cli.export.mesh import leaf_kernel as kernel
from urbanforest_cli.export.mesh import leaf_shapes as shapes
from urbanforest_cli.export.mesh import twig_kernel
from urbanforest_cli.export.mesh.levels import Level
from urbanforest_cli.export.plant_looks import Season, in_season
from urbanforest_cli.export.plant_scene import LEAF_M2_A_METRE, TWIG_PIPES, TWIG_SEASONS, Look, linear

FloatArray = NDArray[np.float64]
MODES = {"leaf": kernel.LEAF, "spray": kernel.SPRAY, "clump": kernel.CLUMP}
CELLS = {"leaf": shapes.LEAF_CELLS, "spray": shapes.SPRAY_CELLS, "clump": shapes.CLUMP_CELLS}
COVER = {"leaf": shapes.LEAF_COVER, "spray": shapes.SPRAY_COVER, "clump": shapes.CLUMP_COVER}
LEAVES = {"leaf": 1, "spray": 6, "clump": 70}  # a card holds at least
CARDS_MIN = 12  # a small plant has as many, unless it has fewer leaves
BLADE_SHARE = 0.72  # of its length times its width that a leaf's area is, as pictures draw it
GROWN_SQUARE = 0.64 + 0.32 + 0.16 / 3  # mean of the square of a leaf's size, 0.8 to 1.2 of the species'
SMOOTH = 0.5  # as pictures move twigs
JITTER = {"leaf": 0.8, "spray": 0.8, "clump": 0.6}
UPWARD = {"leaf": 0.7, "spray": 0.6, "clump": 0.15}  # large cards would show their edges to who stands beside
BEND = 0.65
DARK = 0.42
BRIGHTEST = 1.18  # of the tone of leaves, which the tint brings down


def texture_rgb(look: Look) -> FloatArray:
    """Return (3,) the linear colour that a species' leaf textures are painted in.

    Tints only darken, so it is that of the brightest leaf; where flowers are in the picture, which keep their colour,
    it is that of a leaf in the middle.
    """
    old, young = linear(look.leaf), linear(look.leaf_young)
    colour = 0.5 * (old + young) if look.blossom is not None else BRIGHTEST * np.maximum(old, young)
    return np.asarray(np.minimum(colour, 1.0))


def tint_factors(look: Look) -> tuple[FloatArray, FloatArray]:
    """Return (3,) factors on the texture that make leaves old and young; none where flowers are in the picture."""
    if look.blossom is not None:
        return np.ones(3), np.ones(3)
    return linear(look.leaf) / texture_rgb(look), linear(look.leaf_young) / texture_rgb(look)


def blossom_share(look: Look) -> float:
    """Return the share of leaves that flowers take the place of."""
    return look.blossom_fraction if look.blossom is not None else 0.0


def find_twigs(
    skeletons: Skeletons, season_end: NDArray[np.integer], leaf_area_index: FloatArray
) -> twig_kernel.Twigs:  # fmt: skip
    """Find the twigs that bear leaves, and the area of leaves on each."""
    end = np.asarray(season_end, np.int32)
    return twig_kernel.find_twigs(  # type: ignore[no-any-return]
        skeletons.first, preorder(skeletons), skeletons.parent, skeletons.xyz_m, skeletons.order,
        skeletons.birth_season, skeletons.death_season, pipe_count(skeletons, end), end,
        np.asarray(leaf_area_index, np.float64), TWIG_PIPES, TWIG_SEASONS, SMOOTH, LEAF_M2_A_METRE,
    )  # fmt: skip


def build_leaves(
    skeletons: Skeletons,
    season_end: NDArray[np.integer],
    looks: Sequence[Look],
    level: Level,
    *,
    season: Season = "summer",
) -> Meshes:
    """Return the leaves of each skeleton as cards that show cells of its species' `leaf_texture` of that season.

    Parameters
    ----------
    skeletons, season_end
        What grew, and (s,) the season each is shown at.
    looks
        (s,) of its species.
    level
        How many leaves a card holds, and most cards a plant.
    season
        None bears leaves in winter.

    Returns
    -------
    Meshes
        Four corners and two triangles a card; a mesh hangs on its own skeleton, look and level alone.
    """
    plants = len(skeletons)
    if season == "winter" or level.leaf_mode == "none" or plants == 0:
        return _cards(np.zeros(plants, np.int64))
    mode = level.leaf_mode
    turned = {id(look): in_season(look, season) for look in looks}
    looks = [turned[id(look)] for look in looks]
    twigs = find_twigs(skeletons, season_end, np.array([look.leaf_area_index for look in looks]))
    blade = np.array([look.blade_m for look in looks], np.float64).reshape(plants, 2)
    spray = np.array([look.spray_m for look in looks], np.float64)
    leaf_m2 = BLADE_SHARE * GROWN_SQUARE * blade[:, 0] * blade[:, 1]
    total_m2 = np.add.reduceat(np.append(twigs.area_m2, 0.0).astype(np.float64), twigs.first[:-1])
    total_m2[np.diff(twigs.first) == 0] = 0.0
    wanted = np.maximum(total_m2 / (LEAVES[mode] * leaf_m2), np.minimum(CARDS_MIN, total_m2 / leaf_m2))
    count = np.minimum(np.ceil(wanted), level.cards_max).astype(np.int64)
    card_m2 = total_m2 / np.maximum(count, 1) / (GROWN_SQUARE * COVER[mode])
    length = np.sqrt(card_m2 * (blade[:, 0] / blade[:, 1] if mode == "leaf" else 1.0))
    factors = {id(look): tint_factors(look) for look in looks}
    old, young = (np.array([factors[id(look)][part] for look in looks]).reshape(plants, 3) for part in (0, 1))
    style = kernel.Style(
        cards=count,
        length_m=length,
        width_m=card_m2 / np.maximum(length, 1e-9),
        reach_m=spray + 0.75 * blade[:, 0],
        spray_m=spray,
        droop=np.array([look.droop for look in looks], np.float64),
        old=old,
        young=young,
        flowers=np.array([blossom_share(look) for look in looks]),
        jitter=JITTER[mode],
        upward=UPWARD[mode],
        bend=BEND,
        dark=DARK,
    )
    twig, number = kernel.share_out(twigs, count)
    meshes = _cards(count)
    kernel.set_cards(
        twigs, skeletons.skeleton_id, style, MODES[mode], twig, number,
        np.array(CELLS[mode] + shapes.FLOWER_CELLS), np.array([len(CELLS[mode]), len(shapes.FLOWER_CELLS)]),
        meshes.xyz_m, meshes.normal, meshes.uv, meshes.tint, meshes.triangle,
    )  # fmt: skip
    return meshes


def _cards(count: NDArray[np.int64]) -> Meshes:
    """Return room for cards."""
    before = np.concatenate([np.zeros(1, np.int64), np.cumsum(count)])
    cards = int(before[-1])
    return Meshes(
        first_vertex=4 * before,
        first_triangle=2 * before,
        xyz_m=np.empty((4 * cards, 3), np.float32),
        normal=np.empty((4 * cards, 3), np.float32),
        uv=np.empty((4 * cards, 2), np.float32),
        tint=np.empty((4 * cards, 3), np.uint8),
        triangle=np.empty((2 * cards, 3), np.uint32),
    )
