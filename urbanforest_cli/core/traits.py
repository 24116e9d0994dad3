"""How a species grows: the numbers of the developmental model, one name for each.

The frame is Palubicki et al. 2009 (buds, metamers, one cycle a season), the species' parameters are those of Stava et
al. 2014 under plain names; each field's symbol says which.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray


def trait(low: float, high: float, symbol: str, doc: str, default: float | None = None) -> Any:
    """Declare a trait with its bounds, its symbol in the literature and what it means."""
    metadata = {"low": low, "high": high, "symbol": symbol, "doc": doc}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True, kw_only=True)
class Traits:
    """The growth parameters of one species; angles in degrees, lengths in metres."""

    internode_length_m: float = trait(0.03, 1.0, "IBL", "length of an internode at full vigour")
    shoot_internodes_max: float = trait(1.0, 8.0, "GR", "internodes that the strongest shoot sets in a season of youth")
    shoot_aging: float = trait(0.8, 1.0, "ILAF", "factor on shoot length for each year of age")
    shoot_control: float = trait(1.0, 3.0, "AC", "factor by which a branch's shoots are shorter than its parent's")
    shoot_control_aging: float = trait(0.5, 1.0, "ACAF", "factor on what exceeds 1 in shoot_control, for each year")
    apical_control_young: float = trait(0.3, 0.9, "lambda", "share of the axis that continues, when young")
    apical_control_old: float = trait(0.3, 0.9, "lambda", "the same when old")
    apical_control_years: float = trait(1.0, 100.0, "", "years over which apical control goes from young to old")
    vigour: float = trait(0.1, 20.0, "alpha", "internodes' worth of resource for each unit of light caught")
    vigour_max: float = trait(1.0, 20000.0, "v_rootmax", "largest resource of a plant in a season (Makowski 2019)")
    lateral_buds: float = trait(1.0, 4.0, "NLB", "lateral buds a node: 1 alternate, 2 opposite")
    branch_angle_deg: float = trait(5.0, 120.0, "BAM", "mean angle between a branch and its axis")
    branch_angle_sd_deg: float = trait(0.0, 30.0, "BAV", "its standard deviation")
    roll_angle_deg: float = trait(0.0, 180.0, "RAM", "mean roll from node to node: 137.5 spiral, 90 crosswise")
    roll_angle_sd_deg: float = trait(0.0, 90.0, "RAV", "its standard deviation")
    apical_angle_sd_deg: float = trait(0.0, 45.0, "AAV", "standard deviation of a shoot's turn from its axis")
    apical_bud_death: float = trait(0.0, 1.0, "ABD", "chance a season that an apical bud dies")
    lateral_bud_death: float = trait(0.0, 1.0, "LBD", "chance a season that a lateral bud dies")
    lateral_light_exponent: float = trait(0.0, 4.0, "LFL", "how much a lateral bud's flushing needs light")
    auxin_inhibition: float = trait(0.0, 10.0, "ADBF", "inhibition that a growing bud sends down its axis")
    auxin_distance_factor: float = trait(0.0, 1.0, "ADDF", "factor on inhibition for each internode of distance")
    auxin_aging: float = trait(0.5, 1.0, "ADAF", "factor on inhibition for each year of age")
    phototropism: float = trait(0.0, 2.0, "PT", "pull toward the brightest spot seen")
    room_attraction: float = trait(0.0, 2.0, "xi", "pull toward free room (markers)")
    gravitropism_trunk: float = trait(-1.0, 2.0, "GT, eta", "pull upward on the trunk")
    gravitropism_branch: float = trait(-1.0, 2.0, "GT, eta", "pull upward on branches; below 0 they droop")
    leaf_shade: float = trait(0.001, 1.0, "a", "light that a leafy internode takes from the voxel below it")
    shade_decay: float = trait(1.05, 4.0, "b", "factor by which that fades with each voxel of depth")
    shed_light: float = trait(0.0, 1.0, "PF", "mean light an internode below which a branch is shed (Takenaka)")
    clear_stem_m: float = trait(0.0, 10.0, "LBPF", "branches that start lower than this are lost with age")
    pipe_exponent: float = trait(2.0, 3.0, "n", "exponent of da Vinci's rule")
    tip_radius_m: float = trait(0.0005, 0.02, "", "radius of a twig's end")
    stem_count: float = trait(1.0, 12.0, "", "stems from one root; shrubs have several")
    stem_angle_deg: float = trait(0.0, 70.0, "", "how far those stems lean out")


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenGrown:
    """Median sizes of open-grown plants of a species by age, as its own growth gives them; ages ascend from 0."""

    age_years: tuple[float, ...]
    height_m: tuple[float, ...]
    crown_radius_m: tuple[float, ...]
    crown_base_m: tuple[float, ...]

    def height_at(self, age_years: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate the height at ages; constant beyond the last."""
        return np.interp(age_years, self.age_years, self.height_m)

    def crown_radius_at(self, age_years: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate the crown radius at ages."""
        return np.interp(age_years, self.age_years, self.crown_radius_m)

    def crown_base_at(self, age_years: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate the height of the lowest branch at ages."""
        return np.interp(age_years, self.age_years, self.crown_base_m)


TRAIT_NAMES = tuple(item.name for item in fields(Traits))
TRAIT_DTYPE = np.dtype([(name, np.float64) for name in TRAIT_NAMES])


def traits_table(species: list[Traits]) -> NDArray[Any]:
    """Put traits into a structured array, a row a species, as the kernels read it."""
    table = np.zeros(len(species), dtype=TRAIT_DTYPE)
    for row, item in enumerate(species):
        for name in TRAIT_NAMES:
            table[name][row] = getattr(item, name)
    return table
