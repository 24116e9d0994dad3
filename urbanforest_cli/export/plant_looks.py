"""How the species look in pictures: leaves, flowers and bark of the ten shipped ones, a likeness for any other."""

from __future__ import annotations

from urbanforest_cli.core.colours import mixed, to_rgb
from urbanforest_cli.core.species import Species
from urbanforest_cli.export.plant_scene import Look

GREEN = "#55753a"
BARK = "#6f665b"

LOOKS: dict[str, Look] = {
    "acer_platanoides": Look(
        leaf=(0.29, 0.40, 0.13), leaf_young=(0.58, 0.62, 0.20), bark=(0.47, 0.43, 0.38), blade_m=(0.15, 0.14),
        leaf_area_index=5.0, spray_m=0.2, droop=0.35),
    "tilia_cordata": Look(
        leaf=(0.30, 0.44, 0.17), leaf_young=(0.55, 0.66, 0.30), bark=(0.46, 0.44, 0.41), blade_m=(0.10, 0.085),
        leaf_area_index=5.4, spray_m=0.22, droop=0.45),
    "platanus_acerifolia": Look(
        leaf=(0.33, 0.43, 0.19), leaf_young=(0.56, 0.62, 0.30), bark=(0.70, 0.66, 0.55), blade_m=(0.20, 0.18),
        leaf_area_index=5.0, spray_m=0.22, droop=0.3),
    "quercus_rubra": Look(
        leaf=(0.19, 0.32, 0.14), leaf_young=(0.40, 0.49, 0.20), bark=(0.42, 0.40, 0.38), blade_m=(0.18, 0.11),
        leaf_area_index=5.0, spray_m=0.19, droop=0.25),
    "gleditsia_triacanthos": Look(
        leaf=(0.40, 0.50, 0.18), leaf_young=(0.66, 0.70, 0.30), bark=(0.42, 0.38, 0.34), blade_m=(0.17, 0.045),
        leaf_area_index=2.8, spray_m=0.22, droop=0.5),
    "prunus_serrulata": Look(
        leaf=(0.46, 0.42, 0.22), leaf_young=(0.62, 0.50, 0.32), bark=(0.44, 0.31, 0.28), blade_m=(0.09, 0.075),
        blossom=(0.95, 0.76, 0.83), blossom_fraction=0.8, leaf_area_index=4.0, spray_m=0.1, droop=0.2),
    "corylus_avellana": Look(
        leaf=(0.32, 0.41, 0.17), leaf_young=(0.52, 0.57, 0.26), bark=(0.48, 0.40, 0.31), blade_m=(0.09, 0.08),
        leaf_area_index=4.5, spray_m=0.1, droop=0.35),
    "cornus_sanguinea": Look(
        leaf=(0.34, 0.42, 0.19), leaf_young=(0.56, 0.52, 0.27), bark=(0.55, 0.24, 0.20), blade_m=(0.07, 0.045),
        blossom=(0.93, 0.92, 0.84), blossom_fraction=0.06, leaf_area_index=4.0, spray_m=0.08, droop=0.35),
    "ligustrum_vulgare": Look(
        leaf=(0.22, 0.34, 0.17), leaf_young=(0.44, 0.54, 0.28), bark=(0.46, 0.42, 0.36), blade_m=(0.055, 0.022),
        blossom=(0.95, 0.94, 0.88), blossom_fraction=0.07, leaf_area_index=4.5, spray_m=0.06, droop=0.2),
    "syringa_vulgaris": Look(
        leaf=(0.28, 0.41, 0.21), leaf_young=(0.46, 0.57, 0.31), bark=(0.46, 0.42, 0.37), blade_m=(0.085, 0.065),
        blossom=(0.70, 0.58, 0.80), blossom_fraction=0.30, leaf_area_index=4.2, spray_m=0.09, droop=0.3),
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
