"""How a tree or shrub grows of whose growth nothing is known but its habit and its mature size.

It grows like a shipped, calibrated species: a tree like the London plane, a shrub like the wild privet. A few traits
follow the size asked for, by tables fitted so that the median plant grown alone on open ground has that size at 60
years: internodes lengthen with height, branches lag behind their axis the more the narrower the crown, apical control
gives way where the crown is wide, and leaves shade less in small plants, to which a shadow voxel is large.
Within reach are trees of 4 to 40 m and shrubs of 0.5 to 6 m with crowns 0.5 to 1.2 times as wide as high.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from urbanforest_cli.core.traits import OpenGrown, Traits

TREE = Traits(
    internode_length_m=0.342, shoot_internodes_max=3.38, shoot_aging=0.941, shoot_control=1.23,
    shoot_control_aging=0.93, apical_control_young=0.717, apical_control_old=0.557, apical_control_years=29.7,
    vigour=3.65, vigour_max=1950.0, lateral_buds=1.0, branch_angle_deg=59.4, branch_angle_sd_deg=5.0,
    roll_angle_deg=137.5, roll_angle_sd_deg=10.0, apical_angle_sd_deg=3.5, apical_bud_death=0.003,
    lateral_bud_death=0.0542, lateral_light_exponent=0.5, auxin_inhibition=0.938, auxin_distance_factor=0.5,
    auxin_aging=0.93, phototropism=0.214, room_attraction=0.175, gravitropism_trunk=0.5, gravitropism_branch=-0.0224,
    leaf_shade=0.036, shade_decay=1.8, shed_light=0.0285, clear_stem_m=2.5, pipe_exponent=2.3, tip_radius_m=0.009,
    stem_count=1.0, stem_angle_deg=0.0,
)  # fmt: skip
SHRUB = Traits(
    internode_length_m=0.341, shoot_internodes_max=1.65, shoot_aging=0.9, shoot_control=1.9, shoot_control_aging=0.93,
    apical_control_young=0.512, apical_control_old=0.45, apical_control_years=13.7, vigour=5.49, vigour_max=967.0,
    lateral_buds=2.0, branch_angle_deg=40.1, branch_angle_sd_deg=5.0, roll_angle_deg=90.0, roll_angle_sd_deg=8.0,
    apical_angle_sd_deg=4.0, apical_bud_death=0.003, lateral_bud_death=0.0313, lateral_light_exponent=0.5,
    auxin_inhibition=0.288, auxin_distance_factor=0.5, auxin_aging=0.93, phototropism=0.107, room_attraction=0.225,
    gravitropism_trunk=1.5, gravitropism_branch=-0.00523, leaf_shade=0.00993, shade_decay=1.8, shed_light=0.00926,
    clear_stem_m=0.0, pipe_exponent=2.5, tip_radius_m=0.00508, stem_count=9.0, stem_angle_deg=33.1,
)  # fmt: skip
_TREE_BASE_M, _SHRUB_BASE_M = 18.0, 3.0  # heights that the traits above lead to
USUAL_SHAPE = 0.75  # crown diameter over height where no crown is stated

_SHAPES = (0.5, 0.75, 1.0, 1.2)  # crown diameter over height: the columns below; rows are heights
_TREE_HEIGHTS_M = (4.0, 7.0, 12.0, 20.0, 40.0)
_TREE_LENGTHS = (  # internode length over height
    (0.0193, 0.0193, 0.0193, 0.0212),
    (0.0193, 0.0193, 0.0194, 0.0213),
    (0.0193, 0.0193, 0.0200, 0.0228),
    (0.0192, 0.0193, 0.0218, 0.0270),
    (0.0192, 0.0197, 0.0238, 0.0300),
)
_TREE_CONTROLS = (  # shoot_control
    (3.0, 2.0, 1.2, 1.1),
    (3.0, 1.6, 1.05, 1.0),
    (3.0, 1.34, 1.0, 1.0),
    (2.9, 1.25, 1.0, 1.0),
    (2.2, 1.17, 1.0, 1.0),
)
_SHRUB_HEIGHTS_M = (0.5, 1.0, 1.6, 2.5, 4.0, 6.0)
_SHRUB_LENGTHS = (
    (0.072, 0.079, 0.082, 0.082),
    (0.076, 0.084, 0.088, 0.089),
    (0.072, 0.088, 0.093, 0.094),
    (0.072, 0.090, 0.096, 0.101),
    (0.0705, 0.109, 0.122, 0.131),
    (0.0705, 0.128, 0.132, 0.145),
)
_SHRUB_CONTROLS = (
    (2.2, 1.7, 1.5, 1.3),
    (2.5, 2.0, 1.61, 1.37),
    (2.7, 2.05, 1.61, 1.37),
    (3.0, 2.05, 1.61, 1.37),
    (3.0, 2.3, 1.64, 1.37),
    (3.0, 2.5, 1.69, 1.37),
)
_TREE_APICAL = (0.0, 0.0, -0.05, -0.1)  # added to apical control, by shape
_SHRUB_APICAL = ((0.5, 0.65, 0.75), (0.08, 0.02, 0.0))  # the same: shapes, what is added
_TREE_VIGOUR = (1.0, 1.0, 1.4, 2.0)  # factor on vigour_max, by shape

# Shares of mature height by age with the shortest internodes above; longer ones are as much ahead in years of youth.
_AGES = (0.0, 1.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0)
_TREE_SHARES = (0.03, 0.06, 0.27, 0.47, 0.62, 0.73, 0.87, 0.94, 1.0)
_SHRUB_SHARES = (0.05, 0.10, 0.43, 0.68, 0.83, 0.91, 1.0, 1.0, 1.0)
# Shares of mature crown of small narrow trees and of large wide ones; those of a shrub lag behind its height.
_SLOW_CROWN = (0.02, 0.03, 0.12, 0.28, 0.48, 0.64, 0.87, 0.98, 1.0)
_FAST_CROWN = (0.02, 0.04, 0.30, 0.77, 0.96, 0.98, 0.98, 0.98, 1.0)
_FAST_BY_HEIGHT, _FAST_BY_SHAPE = 0.34, 0.55  # weight of the large and wide: a unit of log height, a unit of shape
_SHRUB_LAG = 1.3  # exponent
_BASE_SHARE_MAX, _SHRUB_BASE_SHARE = 0.3, 0.13  # height of the lowest branch over that of the plant


def usual_growth(
    habit: Literal["tree", "shrub"], mature_height_m: float, mature_crown_diameter_m: float | None = None
) -> Traits:
    """Return the traits of a usual tree or shrub of a mature size, or of the nearest size within reach."""
    height_m, shape = _within_reach(habit, mature_height_m, mature_crown_diameter_m)
    if habit == "tree":
        size = height_m / _TREE_BASE_M
        apical = float(np.interp(shape, _SHAPES, _TREE_APICAL))
        return replace(
            TREE,
            internode_length_m=min(_between(_TREE_LENGTHS, _TREE_HEIGHTS_M, height_m, shape) * height_m, 1.0),
            shoot_control=_between(_TREE_CONTROLS, _TREE_HEIGHTS_M, height_m, shape),
            apical_control_young=TREE.apical_control_young + apical,
            apical_control_old=TREE.apical_control_old + apical,
            vigour_max=TREE.vigour_max * float(np.interp(shape, _SHAPES, _TREE_VIGOUR)),
            leaf_shade=TREE.leaf_shade * min(size, 1.0),
            clear_stem_m=TREE.clear_stem_m * min(size, 1.0),
            tip_radius_m=TREE.tip_radius_m * size**0.5,
        )
    size = height_m / _SHRUB_BASE_M
    apical = float(np.interp(shape, *_SHRUB_APICAL))
    return replace(
        SHRUB,
        internode_length_m=_between(_SHRUB_LENGTHS, _SHRUB_HEIGHTS_M, height_m, shape) * height_m,
        shoot_control=_between(_SHRUB_CONTROLS, _SHRUB_HEIGHTS_M, height_m, shape),
        apical_control_young=SHRUB.apical_control_young + apical,
        apical_control_old=SHRUB.apical_control_old + apical,
        leaf_shade=SHRUB.leaf_shade * min(size, 1.0),
        tip_radius_m=SHRUB.tip_radius_m * min(size, 1.0) ** 0.5,
    )


def usual_sizes(
    habit: Literal["tree", "shrub"], *, mature_height_m: float, mature_crown_diameter_m: float, clear_stem_m: float
) -> OpenGrown:
    """Return the sizes by age to which `usual_growth` leads on open ground."""
    height_m, shape = _within_reach(habit, mature_height_m, mature_crown_diameter_m)
    if habit == "tree":
        lengths = _between(_TREE_LENGTHS, _TREE_HEIGHTS_M, height_m, shape)
        rise = [min(share * lengths / _TREE_LENGTHS[-1][0], 1.0) for share in _TREE_SHARES]
        fast = _FAST_BY_HEIGHT * float(np.log(height_m / _TREE_HEIGHTS_M[0])) + _FAST_BY_SHAPE * (shape - USUAL_SHAPE)
        fast = min(max(fast, 0.0), 1.0)
        spread = [slow + fast * (quick - slow) for slow, quick in zip(_SLOW_CROWN, _FAST_CROWN, strict=True)]
        base_m = clear_stem_m
    else:
        lengths = _between(_SHRUB_LENGTHS, _SHRUB_HEIGHTS_M, height_m, shape)
        rise = [min(share * lengths / _SHRUB_LENGTHS[-1][0], 1.0) for share in _SHRUB_SHARES]
        spread = [share**_SHRUB_LAG for share in rise]
        base_m = max(clear_stem_m, _SHRUB_BASE_SHARE * height_m)
    heights_m = tuple(share * height_m for share in rise)
    return OpenGrown(
        age_years=_AGES,
        height_m=heights_m,
        crown_radius_m=tuple(share * shape * height_m / 2 for share in spread),
        crown_base_m=tuple(min(base_m, _BASE_SHARE_MAX * height) for height in heights_m),
    )


def _within_reach(
    habit: Literal["tree", "shrub"], height_m: float, crown_diameter_m: float | None
) -> tuple[float, float]:
    """Return the height and the crown diameter over it that come nearest to a size and can be grown."""
    heights_m = _TREE_HEIGHTS_M if habit == "tree" else _SHRUB_HEIGHTS_M
    near_m = min(max(height_m, heights_m[0]), heights_m[-1])
    if crown_diameter_m is None:
        return near_m, USUAL_SHAPE
    return near_m, min(max(crown_diameter_m / near_m, _SHAPES[0]), _SHAPES[-1])


def _between(
    table: tuple[tuple[float, ...], ...], heights_m: tuple[float, ...], height_m: float, shape: float
) -> float:
    """Interpolate a table (rows heights, columns shapes), linear in the logarithm of height and in shape."""
    column = [float(np.interp(shape, _SHAPES, row)) for row in table]
    return float(np.interp(np.log(height_m), np.log(heights_m), column))
