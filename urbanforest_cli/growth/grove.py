"""What growth takes and gives: plants that grow together, what stands around them, and what became of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.skeleton import Skeletons

SKY_CELL_M = 1.0
COLUMN_M = 0.25
LONGEST_SEASONS = 250
FRAME_STEP_M = 16.0  # origins are multiples of it, so that the markers of the world are the same in every frame

GROWN, DIED, NO_ROOM = 0, 1, 2
OUTCOMES = ("grown", "died", "no_room")


@dataclass(frozen=True)
class Grove:
    """Plants that grow jointly; all reach their ages in the same last season.

    Parameters
    ----------
    keys
        (p,) one random stream a plant.
    xy_m
        (p, 2) positions in the working CRS.
    species
        (p,) rows of the traits table.
    age_years, pruning_factor
        (p,) of each plant.
    clearance_m
        (p,) branches that start below it are lifted; 0 for none.
    row_azimuth_rad
        (p,) direction, counter-clockwise from east, along which a box that prunes the plant lies.
    """

    keys: NDArray[np.uint64]
    xy_m: NDArray[np.float64]
    species: NDArray[np.int64]
    age_years: NDArray[np.float64]
    pruning_factor: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    row_azimuth_rad: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.keys)


def season_count(age_years: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return how many seasons plants of these ages live through: 1 to 250, parts of a year counted whole."""
    return np.clip(np.ceil(np.asarray(age_years) - 1e-9), 1, LONGEST_SEASONS).astype(np.int64)


class Surroundings(NamedTuple):
    """What stands around a grove, in a frame of its own: metres from `origin_m`, z from the ground.

    Seasons are those of the grove: 1 is the first season of its oldest plant.
    """

    origin_m: NDArray[np.float64]  # (2,) easting and northing of the frame's corner, multiples of FRAME_STEP_M
    size_m: NDArray[np.float64]  # (3,) extent of the frame along x, y, z
    solid_top_m: NDArray[np.float32]  # (ny, nx) height of what is built in columns of COLUMN_M; (1, 1) zero if nothing
    sky: NDArray[np.uint8]  # (nz, ny, nx) share of light that buildings leave, 255 all; SKY_CELL_M; (1, 1, 1) if all
    ray: NDArray[np.float32]  # (k, 3) directions in which a bud looks for light, unit vectors, z above 0
    ray_light: NDArray[np.float32]  # (k,) light from each direction with nothing in the way, sum 1
    shade_lean: NDArray[np.float32]  # (2,) metres that a shadow leans, away from the sun, for each metre of depth
    neighbour_xyz_m: NDArray[np.float32]  # (g, 3) leafy points of plants of other groves
    neighbour_season: NDArray[np.int32]  # (g,) season in which each is there, ascending
    neighbour_internodes: NDArray[np.float32]  # (g,) how many internodes' shade each casts


@dataclass(frozen=True)
class GrownGrove:
    """What became of a grove.

    Parameters
    ----------
    skeletons
        One a plant, in the grove's order, numbered from 0.
    outcome
        (p,) index in OUTCOMES. A plant that died keeps its dead skeleton; where there was no room it is the root alone.
    death_season
        (p,) season of its own in which a plant died, 0 if it did not.
    generated, retained, shed, pruned
        (p,) internodes; generated = retained + shed + pruned.
    season_log
        (t, p, 4) for each season of the grove and each plant: light caught by all buds, resource, internodes new, lost.
    markers
        Counts: alive, taken, blocked (inside what is built), total.
    live_bytes
        Memory held at the end by internodes, lost ones included, and buds; `grid_bytes` that of the grids.
    """

    skeletons: Skeletons
    outcome: NDArray[np.int8]
    death_season: NDArray[np.int32]
    generated: NDArray[np.int64]
    retained: NDArray[np.int64]
    shed: NDArray[np.int64]
    pruned: NDArray[np.int64]
    season_log: NDArray[np.float32]
    markers: dict[str, int]
    live_bytes: int
    grid_bytes: int


TraitsTable = NDArray[Any]
