"""What is remembered of grown plants beside their skeletons: what became of each, its sizes, its internodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.core.skeleton import Skeletons, measure
from urbanforest_cli.growth.grove import OUTCOMES, GrownGrove

ACCOUNTED = ("generated", "retained", "shed", "pruned")
DIGITS = {"height_m": 3, "crown_radius_m": 3, "crown_base_m": 3, "dbh_m": 4}
"""Decimals of sizes: a millimetre, a tenth of it for stems."""


@dataclass(frozen=True)
class Accounts:
    """One entry a skeleton, in the order of the skeletons.

    Parameters
    ----------
    outcome
        Index in OUTCOMES.
    seasons, death_season
        Seasons lived through; the one in which the plant died, 0 if it did not.
    generated, retained, shed, pruned
        Internodes; generated = retained + shed + pruned.
    height_m, crown_radius_m, crown_base_m, dbh_m, internode_count
        Sizes in the last season.
    """

    skeleton_id: NDArray[np.int64]
    outcome: NDArray[np.int64]
    seasons: NDArray[np.int64]
    death_season: NDArray[np.int64]
    generated: NDArray[np.int64]
    retained: NDArray[np.int64]
    shed: NDArray[np.int64]
    pruned: NDArray[np.int64]
    height_m: NDArray[np.float64]
    crown_radius_m: NDArray[np.float64]
    crown_base_m: NDArray[np.float64]
    dbh_m: NDArray[np.float64]
    internode_count: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.skeleton_id)

    @classmethod
    def of(cls, grown: GrownGrove, skeletons: Skeletons) -> Accounts:
        """Take the accounts of a grove, and the sizes of its skeletons as they are stored."""
        return cls(
            skeleton_id=skeletons.skeleton_id,
            outcome=grown.outcome.astype(np.int64),
            seasons=skeletons.seasons.astype(np.int64),
            death_season=grown.death_season.astype(np.int64),
            generated=grown.generated.astype(np.int64),
            retained=grown.retained.astype(np.int64),
            shed=grown.shed.astype(np.int64),
            pruned=grown.pruned.astype(np.int64),
            **sizes_of(skeletons),
        )

    def part(self, places: slice) -> Accounts:
        """Return some of the entries."""
        return Accounts(**{name: values[places] for name, values in self.columns().items()})

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def as_record(self) -> dict[str, list[Any]]:
        """Return plain lists for JSON."""
        return {name: values.tolist() for name, values in self.columns().items()}

    @classmethod
    def from_record(cls, record: Mapping[str, Sequence[Any]], *, where: object = None) -> Accounts:
        """Rebuild accounts from `as_record`.

        Raises
        ------
        SchemaError
            A column is missing, holds something else, or they differ in length.
        """
        columns = {}
        try:
            for item in fields(cls):
                columns[item.name] = np.array(record[item.name], dtype=float if item.name in DIGITS else np.int64)
            fits = len({values.shape for values in columns.values()}) == 1 and columns["outcome"].ndim == 1
            fits = fits and bool(np.isin(columns["outcome"], range(len(OUTCOMES))).all())
        except (KeyError, TypeError, ValueError, OverflowError):
            fits = False
        if not fits:
            raise SchemaError(
                "the accounts of its plants are broken", where=where, next_step="run `urbanforest grow` again"
            )
        return cls(**columns)


def sizes_of(skeletons: Skeletons, season_end: NDArray[np.int32] | None = None) -> dict[str, NDArray[Any]]:
    """Measure skeletons at the end of a season each, the last by default; rounded as they are told."""
    sizes = measure(skeletons, season_end)
    return {name: np.round(values, DIGITS[name]) if name in DIGITS else values for name, values in sizes.items()}


def joined(accounts: Sequence[Accounts]) -> Accounts:
    """Put accounts behind each other."""
    if not accounts:
        return Accounts(
            **{item.name: np.zeros(0, float if item.name in DIGITS else np.int64) for item in fields(Accounts)}
        )
    columns = [one.columns() for one in accounts]
    return Accounts(**{name: np.concatenate([one[name] for one in columns]) for name in columns[0]})
