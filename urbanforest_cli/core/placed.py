"""Plants as any output states them, to be compared with the register."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

if TYPE_CHECKING:
    import pandas as pd

WORDS = ("lot_id", "species")
NUMBERS = ("age_years", "crown_radius_m", "crown_base_m", "dbh_m")
COLUMNS = (*WORDS, *NUMBERS)
"""What outputs may state of each plant beside its place and height, by the names of the register's columns."""
STANDING = ("unique", "library")
"""What a plant that stands has grown as."""


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
    columns
        Those of `COLUMNS` that the output states: (n,) words, None where there is none, or float64, NaN where unknown.
    """

    plant_id: NDArray[np.object_]
    xyz_m: NDArray[np.float64]
    crs: CRS
    height_m: NDArray[np.float64]
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.plant_id)


def stated_columns(values: Mapping[str, Iterable[Any]]) -> dict[str, NDArray[Any]]:
    """Take those of `COLUMNS` that are among columns of any kind, as `PlacedPlants` has them.

    Raises
    ------
    TypeError, ValueError
        A number is none.
    """
    words = {name: list(values[name]) for name in WORDS if name in values}
    found: dict[str, NDArray[Any]] = {}
    for name, texts in words.items():
        found[name] = np.empty(len(texts), dtype=object)
        found[name][:] = [text if isinstance(text, str) else None for text in texts]
    return found | {name: np.array(list(values[name]), dtype=np.float64) for name in NUMBERS if name in values}


def standing(trees: pd.DataFrame) -> NDArray[np.bool_]:
    """Tell which plants of the register's layer `trees` stand, so that exports hold them."""
    stands = trees["grown"].isin(STANDING) & (trees["height_m"] > 0) & trees["skeleton_id"].notna()
    return np.asarray(stands & trees["reason"].isna(), dtype=bool)
