"""Which of a set of pairs are judged and which baselines learn from, never the same place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.imagery.pairs import PairSet
from urbanforest_cli.imagery.splits import fits

NAMES_SHOWN = 12


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


def _groups(pairs: PairSet) -> str:
    names = sorted(set(pairs.groups))
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return ", ".join(names[:NAMES_SHOWN]) + more
