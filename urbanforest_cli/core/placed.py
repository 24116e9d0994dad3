"""Plants as any output states them, to be compared with the register."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS


@dataclass(frozen=True)
class PlacedPlants:
    """Where an output says that plants stand.

    Parameters
    ----------
    plant_id
        (n,) object array of str.
    xyz_m
        (n, 3) float64 in `crs`, always x (east, longitude) before y; z is 0 where the output has none.
    crs
        What x and y are in.
    height_m
        (n,) as the output states it, NaN where it does not.
    species
        (n,) object array of identifiers as the register has them, None where the output states none of a plant; None
        where it knows no such thing.
    """

    plant_id: NDArray[np.object_]
    xyz_m: NDArray[np.float64]
    crs: CRS
    height_m: NDArray[np.float64]
    species: NDArray[np.object_] | None = None

    def __len__(self) -> int:
        return len(self.plant_id)
