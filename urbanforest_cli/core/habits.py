"""How a tree or shrub grows of whose growth nothing is known but its habit and its mature size."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from urbanforest_cli.core.traits import OpenGrown, Traits

TREE = Traits(
    internode_length_m=0.30, shoot_internodes_max=2.7, shoot_aging=0.955, shoot_control=1.15, shoot_control_aging=0.93,
    apical_control_young=0.62, apical_control_old=0.50, apical_control_years=14.0, vigour=2.0, vigour_max=3000.0,
    lateral_buds=1.0, branch_angle_deg=45.0, branch_angle_sd_deg=5.0, roll_angle_deg=137.5, roll_angle_sd_deg=10.0,
    apical_angle_sd_deg=4.0, apical_bud_death=0.003, lateral_bud_death=0.15, lateral_light_exponent=0.5,
    auxin_inhibition=0.4, auxin_distance_factor=0.5, auxin_aging=0.93, phototropism=0.35, room_attraction=0.25,
    gravitropism_trunk=0.25, gravitropism_branch=0.06, leaf_shade=0.06, shade_decay=1.8, shed_light=0.05,
    clear_stem_m=2.0, pipe_exponent=2.2, tip_radius_m=0.006, stem_count=1.0, stem_angle_deg=0.0,
)  # fmt: skip
SHRUB = replace(
    TREE, internode_length_m=0.20, shoot_internodes_max=2.2, shoot_aging=0.90, apical_control_young=0.47,
    apical_control_old=0.45, vigour=4.0, vigour_max=1500.0, lateral_bud_death=0.08, phototropism=0.1,
    gravitropism_branch=0.02, leaf_shade=0.03, shed_light=0.02, stem_count=6.0, stem_angle_deg=25.0, tip_radius_m=0.003,
    clear_stem_m=0.0, pipe_exponent=2.3,
)  # fmt: skip
TREE_HEIGHT_M, SHRUB_HEIGHT_M = 18.0, 3.5  # mature heights that the traits above lead to

_AGES = (0.0, 5.0, 10.0, 20.0, 30.0, 50.0, 80.0, 100.0)
_TREE_SHARES = (0.02, 0.22, 0.44, 0.67, 0.81, 0.97, 1.10, 1.14)  # of mature size; trees of the Urban Tree Database
_SHRUB_SHARES = (0.07, 0.44, 0.68, 0.90, 1.0, 1.05, 1.08, 1.08)


def usual_growth(habit: Literal["tree", "shrub"], mature_height_m: float) -> Traits:
    """Return the traits of a usual tree or shrub, its internodes as long as its mature height asks."""
    usual, height_m = (TREE, TREE_HEIGHT_M) if habit == "tree" else (SHRUB, SHRUB_HEIGHT_M)
    length_m = usual.internode_length_m * mature_height_m / height_m
    return replace(usual, internode_length_m=min(max(length_m, 0.03), 1.0))


def usual_sizes(
    habit: Literal["tree", "shrub"], *, mature_height_m: float, mature_crown_diameter_m: float, clear_stem_m: float
) -> OpenGrown:
    """Return sizes by age of an open-grown plant, guessed from its mature size."""
    shares = _TREE_SHARES if habit == "tree" else _SHRUB_SHARES
    heights_m = tuple(share * mature_height_m for share in shares)
    return OpenGrown(
        age_years=_AGES,
        height_m=heights_m,
        crown_radius_m=tuple(share * mature_crown_diameter_m / 2 for share in shares),
        crown_base_m=tuple(min(clear_stem_m, 0.3 * height_m) for height_m in heights_m),
    )
