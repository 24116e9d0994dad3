"""Which lots are shown, and which pictures beside which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.randomness import hash_uniform, keys_for, rng_for

STREAM = "study"
REAL, RANDOM = "real", "random"
"""Known positions, and as many anywhere in the lot: raters who cannot tell these apart are not looking."""
LOTS_SHOWN = 28
"""As many as the paper showed."""


@dataclass(frozen=True)
class Picture:
    """One picture: its name tells nothing of what it shows."""

    name: str
    lot_id: str
    category: str


@dataclass(frozen=True)
class Trial:
    """Two pictures of a lot: the real planting and another."""

    trial_id: str
    lot_id: str
    category: str
    real: str
    other: str


@dataclass(frozen=True)
class Design:
    """All pictures and trials of a study."""

    study_id: str
    pictures: tuple[Picture, ...]
    trials: tuple[Trial, ...]

    def as_record(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Design:
        """Return the design that `as_record` told.

        Raises
        ------
        KeyError, TypeError, ValueError
            The record is of something else.
        """
        pictures = tuple(Picture(**{key: str(value) for key, value in item.items()}) for item in record["pictures"])
        trials = tuple(Trial(**{key: str(value) for key, value in item.items()}) for item in record["trials"])
        names, ids = {item.name for item in pictures}, {item.trial_id for item in trials}
        if len(names) != len(pictures) or len(ids) != len(trials) or not trials:
            raise ValueError("pictures or trials repeat, or there are none")
        if any({trial.real, trial.other} - names for trial in trials):
            raise ValueError("a trial shows a picture that is not there")
        return cls(str(record["study_id"]), pictures, trials)


def choose_lots(
    lot_ids: Sequence[str], counts: NDArray[np.int64], *, count: int, min_plants: int, seed: int
) -> list[int]:
    """Choose lots of all sizes of plantings: one at random of each of `count` groups by number of real plants.

    Parameters
    ----------
    lot_ids
        (n,) ids.
    counts
        (n, set) plants of each set, the real one first.
    count, min_plants
        How many lots, and how many plants every set must have in them.

    Raises
    ------
    InputError
        No lot has enough plants in every set.
    """
    eligible = np.flatnonzero((counts >= min_plants).all(axis=1))
    if not len(eligible):
        most = int(counts.min(axis=1).max()) if len(counts) else 0
        raise InputError(
            "no lot can be shown",
            found=f"at most {most} plants in the poorest set of any lot",
            expected=f"some lots with {min_plants} plants or more in every set",
            next_step="lower --min-plants, or name other plants with --observed",
        )
    ids = np.asarray(lot_ids, dtype=object)[eligible]
    draws = hash_uniform(keys_for(seed, STREAM, [str(lot) for lot in ids]), np.zeros(len(ids), dtype=np.int64))
    order = eligible[np.lexsort((draws, counts[eligible, 0]))]
    groups = np.array_split(order, min(count, len(order)))
    uniform = rng_for(seed, STREAM, "groups").random(len(groups))
    return [int(group[int(share * len(group))]) for group, share in zip(groups, uniform, strict=True)]


def design(lot_ids: Sequence[str], categories: Sequence[str], *, seed: int, fingerprint: str) -> Design:
    """Pair the real planting of every lot with that of each category.

    Parameters
    ----------
    lot_ids
        Lots shown.
    categories
        What stands beside the real planting.
    fingerprint
        Of all that is shown, so that answers find their own study again.
    """
    study_id = blake2b(f"{fingerprint}\x1f{seed}".encode(), digest_size=6).hexdigest()
    names = {
        (lot, category): blake2b(f"{study_id}\x1f{lot}\x1f{category}".encode(), digest_size=8).hexdigest()
        for lot in lot_ids
        for category in (REAL, *categories)
    }
    pictures = [Picture(name, lot, category) for (lot, category), name in names.items()]
    trials = [
        Trial(f"{index:04d}", lot, category, names[lot, REAL], names[lot, category])
        for index, (lot, category) in enumerate((lot, category) for lot in lot_ids for category in categories)
    ]
    return Design(study_id, tuple(sorted(pictures, key=lambda item: item.name)), tuple(trials))


def sizes_by_room(xy: NDArray[np.float64], pool_m: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Give every plant one of a pool's sizes, the larger to those that stand farther from the others.

    Known plants rarely state their crowns; drawn at random, theirs would overlap more than any placed ones and give
    the picture away.

    Parameters
    ----------
    xy
        (n, 2) metres.
    pool_m
        (m,) radii to draw from, with repetition.

    Returns
    -------
    (n,) rows of the pool.
    """
    drawn = rng.integers(len(pool_m), size=len(xy))
    if len(xy) < 2:
        return np.asarray(drawn)
    room = cKDTree(xy).query(xy, k=2)[0][:, 1]
    rows = np.empty(len(xy), dtype=np.int64)
    rows[np.argsort(room, kind="stable")] = drawn[np.argsort(pool_m[drawn], kind="stable")]
    return rows
