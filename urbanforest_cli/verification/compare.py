"""What an output says of plants against what the register says, plant by plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.placed import WORDS, PlacedPlants

TOLERANCE_M = 0.01
EXAMPLES = 3
WHAT = {
    "species": "of another species", "lot_id": "of another lot", "age_years": "of another age",
    "crown_radius_m": "of another crown radius", "crown_base_m": "of another crown base",
    "dbh_m": "of another diameter",
}  # fmt: skip
TOLERANCES = {"age_years": 0.01, "crown_radius_m": 0.01, "crown_base_m": 0.01, "dbh_m": 0.001}
"""Twice what outputs round by, or more."""
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
    columns
        What else is known of plants: (n,) each, words or float64, by the names of `core.placed.COLUMNS`.
    """

    plant_id: NDArray[np.object_]
    xy_m: FloatArray
    height_m: FloatArray
    crs: CRS
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.plant_id)

    def take(self, rows: NDArray[Any]) -> Expected:
        """Return some of them."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Expected(self.plant_id[rows], self.xy_m[rows], self.height_m[rows], self.crs, columns)


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
    stated: PlacedPlants,
    expected: Expected,
    *,
    tolerance_m: float = TOLERANCE_M,
    on_ground: bool = False,
    in_crown: bool = False,
    left_out: NDArray[np.object_] | None = None,
) -> Comparison:
    """Compare by plant id: which are missing, too many, doubled, elsewhere, or otherwise than the register has them.

    Places are compared on the map. An output that states heights must do so for all that stand, and for no other;
    the rest is compared where an output states it.

    Parameters
    ----------
    tolerance_m
        Largest distance, and difference of heights, that is no fault.
    on_ground
        Whether feet stand at height 0, and one that does not is a fault.
    in_crown
        Whether places are anywhere between a plant's foot and its top.
    left_out
        Ids of plants that the register holds beside those expected.
    """
    too_many = pd.Index(stated.plant_id, dtype=object).difference(pd.Index(expected.plant_id, dtype=object), sort=False)
    beside = too_many.isin(left_out) if left_out is not None else np.zeros(len(too_many), dtype=bool)
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
        *named("not in the register", too_many[~beside]),
        *named("dead, or outside its box", too_many[beside]),
        *named("there more than once", doubles),
        *_apart("elsewhere", names, distance, tolerance_m),
        *_apart("of another height", names, _difference(stated.height_m[both], expected.height_m[place]), tolerance_m),
        *_height_faults(names, stated.height_m[both], expected.height_m[place]),
    ]
    for name in WHAT:
        if name in stated.columns and name in expected.columns:
            pair = stated.columns[name][both], expected.columns[name][place]
            faults += _words_faults(name, names, *pair) if name in WORDS else _numbers_faults(name, names, *pair)
    if on_ground or in_crown:
        top = expected.height_m[place] if in_crown else 0.0
        faults += _apart("off the ground", names, np.maximum(-xyz[:, 2], xyz[:, 2] - top), tolerance_m)
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


def _height_faults(names: NDArray[np.object_], stated: FloatArray, expected: FloatArray) -> list[str]:
    """Tell of plants whose height one side alone knows, of an output that states heights; 0 is no height."""
    has, should = stated > 0, expected > 0
    if not has.any():
        return []
    return [
        *named("without a height", names[should & ~has]),
        *named("with a height though nothing stands there", names[has & ~should]),
    ]


def _words_faults(
    column: str, names: NDArray[np.object_], stated: NDArray[np.object_], expected: NDArray[np.object_]
) -> list[str]:
    other = np.flatnonzero(stated != expected)
    return named(WHAT[column], [f"{names[row]} is {stated[row] or 'none'}, not {expected[row]}" for row in other])


def _numbers_faults(
    column: str, names: NDArray[np.object_], stated: FloatArray, expected: FloatArray
) -> list[str]:  # fmt: skip
    """Tell of numbers further apart than outputs round them, and of some that are not stated where others are."""
    unlike = np.isnan(stated) != np.isnan(expected) if np.isfinite(stated).any() else np.zeros(len(names), dtype=bool)
    other = np.flatnonzero(unlike | (np.abs(stated - expected) > TOLERANCES[column] + SLACK_M))
    return named(WHAT[column], [f"{names[row]} has {stated[row]:g}, not {expected[row]:g}" for row in other])


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
