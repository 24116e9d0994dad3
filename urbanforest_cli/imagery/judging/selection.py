"""Which of a set of pairs are judged and which baselines learn from, never the same place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import shapely

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.imagery.pairs import PairSet
from urbanforest_cli.imagery.splits import fits, places_of

NAMES_SHOWN = 12


class PlacedPairs(PairSet, Protocol):
    """Pairs that say where they lie, and whose images can be told from each other."""

    @property
    def footprints(self) -> Sequence[shapely.Polygon | None]:
        """Of each pair, in longitude and latitude; None for one that lies nowhere."""

    def content(self, index: int) -> str:
        """Return a hash of an image."""


@dataclass(frozen=True)
class Selection:
    """Indices of pairs; `dropped` would be learnt from were they not of places that are judged."""

    judged: tuple[int, ...]
    training: tuple[int, ...]
    dropped: tuple[int, ...]


def select_pairs(pairs: PairSet, groups: Sequence[str], training: Sequence[str], *, where: object) -> Selection:
    """Part a set by patterns of shells, such as ``long_beach_*``, that a pair's group or its name fits.

    Parameters
    ----------
    groups
        What is judged; all but what is learnt from where none is given.
    training
        What baselines learn from.
    where
        What messages call the set.

    Raises
    ------
    InputError
        A pattern fits nothing, nothing is left to judge, or nothing to learn from.
    """
    learnt = [fits(pairs, index, training) for index in range(len(pairs))]
    for pattern in (*groups, *training):
        if not any(fits(pairs, index, [pattern]) for index in range(len(pairs))):
            raise InputError(
                "no pair fits this pattern", where=where, found=pattern, expected=f"some of {_groups(pairs)}",
                next_step="name a group or a pair, or a pattern such as 'rome_*'",
            )  # fmt: skip
    judged = [index for index in range(len(pairs)) if not learnt[index] and (not groups or fits(pairs, index, groups))]
    if not judged:
        raise InputError("no pair is left to judge", where=where, found=f"all fit {', '.join(training)}",
                         next_step="name fewer with --train")  # fmt: skip
    places = {pairs.places[index] for index in judged}
    wanted = [index for index in range(len(pairs)) if learnt[index]]
    kept = [index for index in wanted if pairs.places[index] not in places]
    if wanted and not kept:
        raise InputError(
            "baselines have nothing to learn from", where=where,
            found=f"all {len(wanted)} pairs that fit {', '.join(training)} show places that are judged",
            next_step="judge less with --group, or name other places with --train",
        )  # fmt: skip
    return Selection(tuple(judged), tuple(kept), tuple(index for index in wanted if pairs.places[index] in places))


def unseen(others: PlacedPairs, pairs: PlacedPairs, judged: Sequence[int], *, where: object) -> tuple[int, ...]:
    """Return which of other pairs baselines may learn from: those of no place and no image that is judged.

    Parameters
    ----------
    pairs, judged
        The set that is judged, and the indices in it.
    where
        What messages call the others.

    Raises
    ------
    InputError
        None is left.
    """
    shown = [pairs.footprints[index] for index in judged]
    numbers = [f"{number:09d}" for number in range(len(shown) + len(others))]
    places = places_of(numbers, [*shown, *others.footprints])
    seen = set(places[: len(shown)])
    known = {pairs.content(index) for index in judged}
    kept = tuple(
        index for index in range(len(others))
        if places[len(shown) + index] not in seen and others.content(index) not in known
    )  # fmt: skip
    if not kept:
        raise InputError(
            "baselines have nothing to learn from", where=where, found=f"all {len(others)} pairs show what is judged",
            next_step="judge less with --group, or name another folder with --train",
        )  # fmt: skip
    return kept


def _groups(pairs: PairSet) -> str:
    names = sorted(set(pairs.groups))
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return ", ".join(names[:NAMES_SHOWN]) + more
