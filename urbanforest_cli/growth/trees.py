"""The layer ``trees``: which skeleton stands for each plant, and how large it is in a year."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.schema import GROW_REASONS
from urbanforest_cli.core.schema import GROWN as GROWN_WORDS
from urbanforest_cli.core.skeleton import MEASURES
from urbanforest_cli.growth.accounts import DIGITS, Accounts
from urbanforest_cli.growth.grove import DIED, GROWN
from urbanforest_cli.growth.library import Library

NO_SKELETON = -1


@dataclass
class Stand:
    """Which skeleton stands for each plant of a city, and how it is put there.

    Parameters
    ----------
    skeleton_id
        (n,) `NO_SKELETON` for none.
    reason
        (n,) why there is none, None where there is one.
    library
        (n,) whether the skeleton grew for many plants.
    key_distance
        (n,) how far the skeleton's own place is from the plant's, NaN where it grew in the plant's place.
    yaw_deg, mirror, scale
        (n,) how a skeleton of the library is turned, mirrored and scaled.
    """

    skeleton_id: NDArray[np.int64]
    reason: NDArray[np.object_]
    library: NDArray[np.bool_]
    key_distance: NDArray[np.float64]
    yaw_deg: NDArray[np.float64]
    mirror: NDArray[np.int64]
    scale: NDArray[np.float64]

    @classmethod
    def bare(cls, count: int) -> Stand:
        """Return plants none of which has a skeleton."""
        return cls(
            skeleton_id=np.full(count, NO_SKELETON, dtype=np.int64),
            reason=np.full(count, None, dtype=object),
            library=np.zeros(count, dtype=bool),
            key_distance=np.full(count, np.nan),
            yaw_deg=np.zeros(count),
            mirror=np.zeros(count, dtype=np.int64),
            scale=np.ones(count),
        )

    def put_own(self, rows: NDArray[np.int64], skeleton_id: NDArray[np.int64]) -> None:
        """Put skeletons that grew in the place of these plants."""
        self.skeleton_id[rows], self.reason[rows], self.library[rows] = skeleton_id, None, False
        self.key_distance[rows], self.yaw_deg[rows], self.mirror[rows], self.scale[rows] = np.nan, 0.0, 0, 1.0

    def put_library(self, rows: NDArray[np.int64], skeleton_id: NDArray[np.int64], library: Library) -> None:
        """Put skeletons of a library in the place of these plants."""
        self.skeleton_id[rows], self.reason[rows], self.library[rows] = skeleton_id, None, True
        self.key_distance[rows] = np.round(library.key_distance, 4)
        self.yaw_deg[rows], self.mirror[rows] = library.yaw_deg, library.mirror
        self.scale[rows] = np.round(library.scale, 4)

    def taken(self, rows: NDArray[np.int64]) -> Stand:
        """Return a copy of some plants' rows."""
        return Stand(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})

    @classmethod
    def read(cls, trees: pd.DataFrame, library_ids: NDArray[np.int64]) -> Stand:
        """Read it back from the layer, whatever the year that shows."""
        skeleton = trees["skeleton_id"].to_numpy(dtype=np.float64, na_value=NO_SKELETON).astype(np.int64)
        reason = np.array(trees["reason"].astype(object).where(trees["reason"].notna(), None), dtype=object)
        reason[skeleton != NO_SKELETON] = None
        return cls(
            skeleton_id=skeleton,
            reason=reason,
            library=np.isin(skeleton, library_ids),
            key_distance=trees["key_distance"].to_numpy(dtype=np.float64, na_value=np.nan),
            yaw_deg=trees["yaw_deg"].to_numpy(dtype=np.float64),
            mirror=trees["mirror"].to_numpy(dtype=np.int64),
            scale=trees["scale"].to_numpy(dtype=np.float64),
        )


def tree_counts(columns: Mapping[str, Any]) -> dict[str, int]:
    """Return how many plants are what: every plant is one of these."""
    grown, reason = (pd.Series(columns[name], dtype=object) for name in ("grown", "reason"))
    counts = {name: int((grown == name).sum()) for name in GROWN_WORDS if name != "none"}
    bare = reason[grown == "none"]
    return counts | {name: int((bare == name).sum()) for name in GROW_REASONS if name != "died"}


def seasons_shown(seasons: NDArray[np.int64], years_ago: int) -> NDArray[np.int32]:
    """Return the season of each skeleton that shows it some years ago: its first at the earliest."""
    return np.maximum(seasons - years_ago, 1).astype(np.int32)


def tree_columns(
    stand: Stand,
    accounts: Accounts,
    plant_seasons: NDArray[np.int64],
    *,
    years_ago: int = 0,
    sizes: Mapping[str, NDArray[Any]] | None = None,
) -> dict[str, Any]:
    """Return what the layer tells beyond the plants themselves.

    Parameters
    ----------
    accounts
        One entry a skeleton.
    plant_seasons
        (n,) seasons that each plant has lived through today.
    years_ago
        Which year is told: one that many years before today.
    sizes
        Sizes of the skeletons in that year; those of today, which the accounts hold, where none are given.
    """
    sizes = sizes if sizes is not None else accounts.columns()
    by_id = np.argsort(accounts.skeleton_id, kind="stable")
    row = np.full(len(stand.skeleton_id), -1, dtype=np.int64)
    there = stand.skeleton_id != NO_SKELETON
    row[there] = by_id[np.searchsorted(accounts.skeleton_id, stand.skeleton_id[there], sorter=by_id)]

    season = seasons_shown(accounts.seasons, years_ago)
    gone = np.append((accounts.outcome == DIED) & (accounts.death_season <= season), False)  # the last: no skeleton
    fit = np.append(np.isin(accounts.outcome, (GROWN, DIED)), False)
    unborn = there & (plant_seasons - years_ago < 1)
    dead = there & ~unborn & gone[row]
    roomless = there & ~fit[row]
    alive = there & ~unborn & ~dead & ~roomless
    grown = np.select([dead, alive & stand.library, alive], ["dead", "library", "unique"], "none").astype(object)
    reason = stand.reason.copy()
    reason[dead], reason[unborn], reason[roomless] = "died", "unborn", "no_room"
    skeleton = np.where(roomless, NO_SKELETON, stand.skeleton_id)
    columns: dict[str, Any] = {}
    for name in MEASURES:
        values = sizes[name]
        told = np.zeros(len(row), dtype=values.dtype)
        told[alive] = values[row[alive]]
        columns[name] = np.round(told * stand.scale, DIGITS[name]) if name in DIGITS else told
    return columns | {
        "skeleton_id": pd.arrays.IntegerArray(skeleton, skeleton == NO_SKELETON),
        "grown": grown,
        "reason": reason,
        "key_distance": stand.key_distance,
        "yaw_deg": stand.yaw_deg,
        "mirror": stand.mirror,
        "scale": stand.scale,
    }
