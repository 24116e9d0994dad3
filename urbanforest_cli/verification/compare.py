"""What an output says of plants against what the register says, plant by plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.placed import PlacedPlants

TOLERANCE_M = 0.01
EXAMPLES = 3
MM = 1000.0
SLACK_M = 1e-9

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Expected:
    """Plants as the register states them.

    Parameters
    ----------
    plant_id
        (n,) object array of str, each once.
    xy_m
        (n, 2) in `crs`.
    height_m
        (n,), NaN where nothing stands.
    crs
        The working CRS, projected, in metres.
    """

    plant_id: NDArray[np.object_]
    xy_m: FloatArray
    height_m: FloatArray
    crs: CRS

    def __len__(self) -> int:
        return len(self.plant_id)

    def take(self, rows: NDArray[Any]) -> Expected:
        """Return some of them."""
        return Expected(self.plant_id[rows], self.xy_m[rows], self.height_m[rows], self.crs)


@dataclass(frozen=True)
class Comparison:
    """How an output compares.

    Parameters
    ----------
    plants
        How many the output holds.
    largest_distance_m
        Over the plants that both have; 0 where there is none.
    faults
        In words, with examples; empty where both say the same.
    """

    plants: int
    largest_distance_m: float
    faults: tuple[str, ...]


def compare(
    stated: PlacedPlants, expected: Expected, *, tolerance_m: float = TOLERANCE_M, on_ground: bool = False
) -> Comparison:
    """Compare by plant id: which are missing, too many, doubled, elsewhere, or of another height.

    Heights are compared where both state one.

    Parameters
    ----------
    tolerance_m
        Largest distance, and difference of heights, that is no fault.
    on_ground
        Whether feet stand at height 0, and one that does not is a fault.
    """
    row = pd.Index(expected.plant_id, dtype=object).get_indexer(pd.Index(stated.plant_id, dtype=object))
    times = np.bincount(row[row >= 0], minlength=len(expected))
    doubles = pd.Index(stated.plant_id[pd.Index(stated.plant_id, dtype=object).duplicated()]).unique()
    both = np.flatnonzero(row >= 0)
    place = row[both]
    names = expected.plant_id[place]
    xyz = _positions(stated, expected.crs)[both]
    distance = np.hypot(*(xyz[:, :2] - expected.xy_m[place]).T)
    faults = [
        *named("missing", expected.plant_id[times == 0]),
        *named("not in the register", stated.plant_id[row < 0]),
        *named("there more than once", doubles),
        *_apart("elsewhere", names, distance, tolerance_m),
        *_apart("of another height", names, _difference(stated.height_m[both], expected.height_m[place]), tolerance_m),
    ]
    if on_ground:
        faults += _apart("off the ground", names, np.abs(xyz[:, 2]), tolerance_m)
    finite = distance[np.isfinite(distance)]
    return Comparison(len(stated), float(finite.max()) if len(finite) else 0.0, tuple(faults))


def _positions(stated: PlacedPlants, working: CRS) -> FloatArray:
    """Return (n, 3) in the working CRS; heights go through where the output's CRS has none."""
    if stated.crs == working or not len(stated):
        return stated.xyz_m
    solid = len(stated.crs.axis_info) > 2
    target = working.to_3d() if solid else working
    change = transformer(stated.crs.to_wkt(), target.to_wkt())
    return np.column_stack(change.transform(*stated.xyz_m.T))


def _difference(stated: FloatArray, expected: FloatArray) -> FloatArray:
    """Return how far heights are apart, 0 where one of the two is not stated."""
    apart = np.abs(stated - expected)
    return np.where(np.isnan(stated) | np.isnan(expected), 0.0, apart)


def named(what: str, ids: Sequence[Any] | NDArray[np.object_] | pd.Index[Any]) -> list[str]:
    """Return a fault that counts plants and names the first of them; none where there is none."""
    if len(ids) == 0:
        return []
    return [f"{counted(len(ids), 'plant')} {what} ({_some(list(ids))})"]


def _apart(what: str, names: NDArray[np.object_], apart_m: FloatArray, tolerance_m: float) -> list[str]:
    """Tell of plants further apart than allowed, those furthest first; what is no number is furthest of all."""
    far = np.flatnonzero(~(apart_m <= tolerance_m + SLACK_M))
    if len(far) == 0:
        return []
    size = np.where(np.isfinite(apart_m[far]), apart_m[far], np.inf)
    first = far[np.argsort(-size, kind="stable")]
    shown = [f"{names[row]} by {apart_m[row] * MM:.1f} mm" for row in first]
    return [f"{counted(len(far), 'plant')} {what} ({_some(shown)})"]


def _some(items: list[Any]) -> str:
    left = len(items) - EXAMPLES
    return ", ".join(map(str, items[:EXAMPLES])) + (f" and {left} more" if left > 0 else "")


def counted(number: int, noun: str) -> str:
    """Return "1 plant", "2 plants"."""
    return f"{number:,} {noun}" + ("" if number == 1 else "s")
