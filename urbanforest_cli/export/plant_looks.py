"""How the species look in pictures: leaves, flowers and bark of the ten shipped ones, a likeness for any other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from urbanforest_cli.core.colours import mixed, to_hex, to_rgb
from urbanforest_cli.core.species import Species
from urbanforest_cli.export.plant_scene import Look, Rgb

Season = Literal["spring", "summer", "autumn", "winter"]
SEASONS: tuple[Season, ...] = get_args(Season)

GREEN = "#55753a"
BARK = "#6f665b"
AUTUMN: Rgb = (0.52, 0.40, 0.16)
AUTUMN_LATE: Rgb = (0.72, 0.60, 0.24)
FRESHNESS = 0.35  # how far leaves of spring are on the way from the colour of old ones to that of young ones


@dataclass(frozen=True, slots=True, kw_only=True)
class SeasonLook(Look):
    """A look that knows the seasons.

    Parameters
    ----------
    summer
        Colours of old and young leaves in summer, where they are others than in spring.
    autumn, autumn_bright
        Colours between which leaves turn.
    """

    summer: tuple[Rgb, Rgb] | None = None
    autumn: Rgb = AUTUMN
    autumn_bright: Rgb = AUTUMN_LATE


LOOKS: dict[str, Look] = {
    "acer_platanoides": SeasonLook(
        leaf=(0.29, 0.40, 0.13), leaf_young=(0.58, 0.62, 0.20), bark=(0.47, 0.43, 0.38), blade_m=(0.15, 0.14),
        leaf_area_index=5.0, spray_m=0.2, droop=0.35, autumn=(0.76, 0.44, 0.10), autumn_bright=(0.90, 0.70, 0.20)),
    "tilia_cordata": SeasonLook(
        leaf=(0.30, 0.44, 0.17), leaf_young=(0.55, 0.66, 0.30), bark=(0.46, 0.44, 0.41), blade_m=(0.10, 0.085),
        leaf_area_index=5.4, spray_m=0.22, droop=0.45, autumn=(0.62, 0.54, 0.16), autumn_bright=(0.86, 0.74, 0.28)),
    "platanus_acerifolia": SeasonLook(
        leaf=(0.33, 0.43, 0.19), leaf_young=(0.56, 0.62, 0.30), bark=(0.70, 0.66, 0.55), blade_m=(0.20, 0.18),
        leaf_area_index=5.0, spray_m=0.22, droop=0.3, autumn=(0.50, 0.38, 0.18), autumn_bright=(0.70, 0.57, 0.24)),
    "quercus_rubra": SeasonLook(
        leaf=(0.19, 0.32, 0.14), leaf_young=(0.40, 0.49, 0.20), bark=(0.42, 0.40, 0.38), blade_m=(0.18, 0.11),
        leaf_area_index=5.0, spray_m=0.19, droop=0.25, autumn=(0.42, 0.20, 0.12), autumn_bright=(0.68, 0.34, 0.16)),
    "gleditsia_triacanthos": SeasonLook(
        leaf=(0.40, 0.50, 0.18), leaf_young=(0.66, 0.70, 0.30), bark=(0.42, 0.38, 0.34), blade_m=(0.17, 0.045),
        leaf_area_index=2.8, spray_m=0.22, droop=0.5, autumn=(0.78, 0.64, 0.16), autumn_bright=(0.92, 0.80, 0.30)),
    "prunus_serrulata": SeasonLook(
        leaf=(0.46, 0.42, 0.22), leaf_young=(0.62, 0.50, 0.32), bark=(0.44, 0.31, 0.28), blade_m=(0.09, 0.075),
        blossom=(0.95, 0.76, 0.83), blossom_fraction=0.8, leaf_area_index=4.0, spray_m=0.1, droop=0.2,
        summer=((0.27, 0.37, 0.15), (0.47, 0.54, 0.23)),
        autumn=(0.62, 0.25, 0.13), autumn_bright=(0.86, 0.50, 0.18)),
    "corylus_avellana": SeasonLook(
        leaf=(0.32, 0.41, 0.17), leaf_young=(0.52, 0.57, 0.26), bark=(0.48, 0.40, 0.31), blade_m=(0.09, 0.08),
        leaf_area_index=4.5, spray_m=0.1, droop=0.35, autumn=(0.60, 0.50, 0.16), autumn_bright=(0.80, 0.67, 0.26)),
    "cornus_sanguinea": SeasonLook(
        leaf=(0.34, 0.42, 0.19), leaf_young=(0.56, 0.52, 0.27), bark=(0.55, 0.24, 0.20), blade_m=(0.07, 0.045),
        blossom=(0.93, 0.92, 0.84), blossom_fraction=0.06, leaf_area_index=4.0, spray_m=0.08, droop=0.35,
        summer=((0.30, 0.41, 0.18), (0.48, 0.54, 0.26)),
        autumn=(0.37, 0.14, 0.18), autumn_bright=(0.58, 0.25, 0.22)),
    "ligustrum_vulgare": SeasonLook(
        leaf=(0.22, 0.34, 0.17), leaf_young=(0.44, 0.54, 0.28), bark=(0.46, 0.42, 0.36), blade_m=(0.055, 0.022),
        blossom=(0.95, 0.94, 0.88), blossom_fraction=0.07, leaf_area_index=4.5, spray_m=0.06, droop=0.2,
        autumn=(0.27, 0.28, 0.17), autumn_bright=(0.45, 0.42, 0.22)),
    "syringa_vulgaris": SeasonLook(
        leaf=(0.28, 0.41, 0.21), leaf_young=(0.46, 0.57, 0.31), bark=(0.46, 0.42, 0.37), blade_m=(0.085, 0.065),
        blossom=(0.70, 0.58, 0.80), blossom_fraction=0.30, leaf_area_index=4.2, spray_m=0.09, droop=0.3,
        autumn=(0.46, 0.44, 0.18), autumn_bright=(0.64, 0.57, 0.26)),
}  # fmt: skip


def look_of(species: Species) -> Look:
    """Return a species' look; one that is not known takes a green near its colour on the map."""
    if species.id in LOOKS:
        return LOOKS[species.id]
    size = 0.13 if species.habit == "tree" else 0.07
    return Look(
        leaf=to_rgb(mixed(GREEN, species.colour, 0.35)), leaf_young=to_rgb(mixed("#93a852", species.colour, 0.35)),
        bark=to_rgb(BARK), blade_m=(size, 0.75 * size), spray_m=size,
    )  # fmt: skip


def in_season(look: Look, season: Season) -> Look:
    """Return how a plant looks in a season: flowers in spring alone, leaves turned in autumn."""
    if season == "spring":
        leaf = to_rgb(mixed(to_hex(look.leaf), to_hex(look.leaf_young), FRESHNESS))
        return replace(look, leaf=leaf)
    if season == "summer":
        summer = look.summer if isinstance(look, SeasonLook) else None
        leaf, young = summer or (look.leaf, look.leaf_young)
        return replace(look, leaf=leaf, leaf_young=young, blossom=None, blossom_fraction=0.0)
    turned = (look.autumn, look.autumn_bright) if isinstance(look, SeasonLook) else (AUTUMN, AUTUMN_LATE)
    return replace(look, leaf=turned[0], leaf_young=turned[1], blossom=None, blossom_fraction=0.0)
