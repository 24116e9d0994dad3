"""What the coverage of a lot says of its parameters, freed of what the network took for granted.

The network was trained on values that are equally likely all over their range. What it says of a lot, a mean m and a
standard deviation s in shares of the range, is therefore a posterior under a uniform prior, and as a Beta distribution
of these moments it is proportional to the likelihood itself: x^p (1 - x)^q with p = a - 1 and q = b - 1. Evidence is
kept as (p, q), which add up over independent maps and are 0 where a map says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.schema import REGRESSED

UNIFORM_SPREAD = 12.0**-0.5
"""Standard deviation of a uniform distribution, as a share of its range."""
LEAST_SPREAD = 0.02
"""No single map is believed to tell a value closer than this share of the range."""
BARE_LEAST, OUTLINED_LEAST = 0.05, 3
LOWEST_DENSITY = 0.1
"""Below it too few plants are left of a strategy for its other parameters to be read."""
SURE_STRATEGY = 0.5
USED_BY = {"boundary_width_m": "boundary", "cluster_radius_m": "cluster", "cluster_count_max": "cluster"}

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Evidence:
    """What the coverage of lots says, each of the REGRESSED parameters a column.

    Parameters
    ----------
    low, high
        (lot, parameter) float64: the exponents p of x and q of 1 - x, never negative.
    strategy
        (lot, 3) float64: how likely each of STRATEGIES_READ is; equal shares where nothing is known.
    visible
        (lot,) float64: plants that can be told apart.
    """

    low: Floats
    high: Floats
    strategy: Floats
    visible: Floats

    @property
    def spoke(self) -> Flags:
        """(lot, parameter): where there is any."""
        return np.asarray(self.low + self.high > 0)


def joined(parts: list[Evidence]) -> Evidence:
    """Return the evidence of batches of lots as one."""
    if not parts:
        empty = np.zeros((0, len(REGRESSED)))
        return Evidence(empty, empty, np.zeros((0, len(STRATEGIES_READ))), np.zeros(0))
    return Evidence(
        **{item.name: np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(Evidence)}
    )


def exponents(mean: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """Return (p, q) of posteriors under a uniform prior, of any shape; 0 where they say no more than that prior.

    A Beta distribution that is as wide and as close to an end of the range would have a pole there. It is taken as
    one that falls away from that end, of the same mean square distance from it.
    """
    mean, spread = np.clip(mean, LEAST_SPREAD, 1 - LEAST_SPREAD), np.maximum(spread, LEAST_SPREAD)
    size = mean * (1 - mean) / spread**2 - 1
    low, high = mean * size - 1, (1 - mean) * size - 1
    square = np.minimum(mean, 1 - mean) ** 2 + spread**2
    falls = np.maximum((np.sqrt(1 + 8 / square) - 3) / 2 - 1, 0.0)
    plain = (low >= 0) & (high >= 0)
    return (
        np.where(plain, low, np.where(mean > 0.5, falls, 0.0)),
        np.where(plain, high, np.where(mean > 0.5, 0.0, falls)),
    )


def precision(low: Floats, high: Floats) -> Floats:
    """Return the precision of likelihoods x^low (1 - x)^high: what they add to that of a prior, 0 where both are 0."""
    size = low + high + 2
    share = (low + 1) / size
    return np.maximum((size + 1) / (share * (1 - share)) - 1 / UNIFORM_SPREAD**2, 0.0)


def evidence_of(
    owner: NDArray[np.int64], lots: int, mean: Floats, spread: Floats, strategy: Floats, visible: Floats
) -> Evidence:
    """Join what the windows of lots say.

    The windows of one lot err alike, so that n of them count as much as sqrt(n) that do not. Parameters that only one
    strategy uses are read off a window as far as that strategy is likely there: otherwise the window says nothing. A
    lot of several windows shows the number of its clusters in none of them.

    Parameters
    ----------
    owner
        (window,) row of the lot.
    mean, spread
        (window, parameter) in shares of the range, in the order of REGRESSED.
    strategy
        (window, 3) probabilities.
    visible
        (window,) plants that can be told apart.
    """
    mean, spread = mean.copy(), spread.copy()
    for name, user in USED_BY.items():
        column, likely = REGRESSED.index(name), strategy[:, STRATEGIES_READ.index(user)]
        mean[:, column], spread[:, column] = _if_used(mean[:, column], spread[:, column], likely)
    windows = np.bincount(owner, minlength=lots)
    weight = 1 / np.sqrt(np.maximum(windows, 1))

    def total(columns: Floats) -> Floats:
        return np.column_stack([np.bincount(owner, column, minlength=lots) for column in columns.T])

    low, high = (total(part) * weight[:, None] for part in exponents(mean, spread))
    low[windows > 1, -1] = high[windows > 1, -1] = 0.0
    logs = total(np.log(np.clip(strategy, 1e-6, 1))) * weight[:, None]
    likely = np.exp(logs - logs.max(axis=1, keepdims=True))
    plants = np.asarray(np.bincount(owner, visible, minlength=lots), dtype=np.float64)
    return Evidence(low, high, likely / likely.sum(axis=1, keepdims=True), plants)


def _if_used(mean: Floats, spread: Floats, likely: Floats) -> tuple[Floats, Floats]:
    """Return the moments of a value that is as said with some probability, else anything in its range."""
    mixed = likely * mean + (1 - likely) * 0.5
    second = likely * (spread**2 + mean**2) + (1 - likely) * (UNIFORM_SPREAD**2 + 0.25)
    return mixed, np.sqrt(np.maximum(second - mixed**2, 0.0))


def without_the_unknowable(evidence: Evidence, *, seen: Flags, density_read: Floats, bare_share: Floats) -> Evidence:
    """Drop what a map cannot tell, whatever the network says of it.

    Nothing is read where the map is not known. The map speaks of density alone where no plant can be told apart, where
    the density read is below LOWEST_DENSITY, and where a lot is covered all over so that no outline tells of crowns:
    less than BARE_LEAST of it bare and fewer than OUTLINED_LEAST plants told apart. Of the width of a boundary and of
    clusters it speaks only where these are the likeliest strategy by half.

    Parameters
    ----------
    seen
        (lot,) whether the map knows the lot.
    density_read
        (lot,) the network's density.
    bare_share
        (lot,) share of the lot that nothing covers.
    """
    told = np.repeat(seen[:, None], len(REGRESSED), axis=1)
    outlined = (bare_share >= BARE_LEAST) | (evidence.visible >= OUTLINED_LEAST)
    planted = (evidence.visible > 0) & (density_read >= LOWEST_DENSITY) & outlined
    for column, name in enumerate(REGRESSED):
        if name != "density":
            told[:, column] &= planted
        if name in USED_BY:
            told[:, column] &= evidence.strategy[:, STRATEGIES_READ.index(USED_BY[name])] >= SURE_STRATEGY
    return Evidence(
        np.where(told, evidence.low, 0.0),
        np.where(told, evidence.high, 0.0),
        np.where(seen[:, None], evidence.strategy, 1 / len(STRATEGIES_READ)),
        np.where(seen, evidence.visible, 0.0),
    )
