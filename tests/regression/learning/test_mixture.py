"""All kinds of lots are there, numbered through, and none is of the frozen test designs."""

from __future__ import annotations

from tests.regression.learning.pairs import squares
from urbanforest_cli.regression.learning.mixture import SHARES, mixed_pairs


def test_kinds_have_their_shares_and_lots_of_their_own():
    asked = []

    def make(count, kind, seed):
        asked.append((count, kind, seed))
        return squares(count, seed % 1000)

    pairs = mixed_pairs(make, 101, 0)
    assert len(pairs) == 101
    assert [(count, kind) for count, kind, _ in asked] == [(61, ""), (20, "S"), (20, "P")]
    assert sum(share for _, share in SHARES) == 1.0
    lots = [set(pairs.lot[part].tolist()) for part in (slice(0, 61), slice(61, 81), slice(81, 101))]
    assert not lots[0] & lots[1] | lots[0] & lots[2] | lots[1] & lots[2]
    seeds = [seed for _, _, seed in asked]
    assert seeds[0] == 0
    assert 0 not in seeds[1:]
    assert len(set(seeds)) == 3
    assert max(seeds) < 2**63
