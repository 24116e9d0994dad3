"""Levels of detail of a plant: how much of one skeleton is drawn."""

from __future__ import annotations

from dataclasses import dataclass

BARK_TEXTURE_M = 1.0  # width and height of what a texture of bark shows


@dataclass(frozen=True)
class Level:
    """One level.

    Parameters
    ----------
    name
        As the option `--detail` calls it.
    wood_radius_min_m
        Thinner wood is left out, save the main axes of a slight plant; leaves stay.
    wood_error_m
        How far a drawn branch may lie beside its skeleton: nodes in between are left out.
    sides
        Least and most sides of a branch; a branch takes what keeps its outline within `wood_error_m` of round.
    leaf_mode
        "leaf": a card a leaf; "spray": a card holds a twig's leaves; "clump": a card holds a branch's sprays;
        "none": no leaves, for levels that are drawn by other means.
    cards_max
        Most cards a plant; merged into fewer, larger ones of the same area.
    """

    name: str
    wood_radius_min_m: float
    wood_error_m: float
    sides: tuple[int, int]
    leaf_mode: str
    cards_max: int


LEVELS: dict[str, Level] = {
    level.name: level
    for level in (
        Level("full", 0.0, 0.002, (4, 20), "leaf", 60_000),
        Level("high", 0.0095, 0.010, (3, 14), "spray", 6_000),
        Level("medium", 0.020, 0.018, (3, 8), "spray", 1_400),
        Level("low", 0.035, 0.06, (3, 5), "clump", 160),
        Level("billboard", 0.0, 0.0, (0, 0), "none", 0),
        Level("point", 0.0, 0.0, (0, 0), "none", 0),
    )
}
