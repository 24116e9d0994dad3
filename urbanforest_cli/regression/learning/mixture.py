"""Of what kinds of lots the pairs of a training are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from urbanforest_cli.core.randomness import key_for
from urbanforest_cli.regression.learning.samples import STREAM
from urbanforest_cli.regression.pair_table import PairTable, joined

SHARES = (("", 0.6), ("S", 0.2), ("P", 0.2))
"""Lots of a city and of all sizes, and plain lots of 10 to 60 and of 60 to 100 m, on which clusters can be told."""

MakeKind = Callable[[int, str, int], PairTable]


def mixed_pairs(make: MakeKind, count: int, seed: int) -> PairTable:
    """Return pairs of all kinds, one kind after the other, their lots numbered through.

    Parameters
    ----------
    make
        Makes so many pairs of a kind of `SHARES` with a seed. Plain lots get a seed of their own, so that those of a
        training are not those of the frozen test designs, which have the same kinds.
    """
    tables: list[PairTable] = []
    left, first = count, 0
    for number, (kind, share) in enumerate(SHARES):
        some = left if number == len(SHARES) - 1 else round(share * count)
        left -= some
        if some:
            table = make(some, kind, key_for(seed, STREAM, f"lots {kind}") >> 1 if kind else seed)
            tables.append(replace(table, lot=(table.lot + first).astype(np.int32)))
            first += int(table.lot.max()) + 1
    return joined(tables)
