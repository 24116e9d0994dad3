"""Lots of one zone share what their coverage says: an empirical Bayes estimate in three layers.

1. A neighbourhood has a mean t, which strays from the zone's value r: t ~ N(r, v_t).
2. The lots of a neighbourhood stray from its mean: x ~ N(t, v_x), within the range.
3. The coverage of a lot tells x more or less well: likelihood x^p (1 - x)^q (`regression.evidence`).

The value of a lot is the mean of x given its own evidence and that of the lots of its zone within a radius, each
counted with weight exp(-d^2 / (2 (radius / 2)^2)) and with the share v / (v + v_x) of its exponents, v being the
variance of its own likelihood: a lot tells less of its neighbourhood than of itself. Errors of maps are alike to some
extent: n lots count as n / (1 + (n - 1) ALIKE), n being the sum of their weights. All values are shares of the range of
a parameter; distributions are held on a grid of NODES values.

How far lots stray from their neighbourhood, the root of v_x, is not assumed: that one of LEVELS is taken under which
each lot's evidence is foretold best by that of the others, with a leaning to sqrt(1/2) of the spread that the config
states. Steps that coarse keep a change of one lot from being felt all over a city. v_t is what is left of the square
of the stated spread, at least half of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import Evidence, precision
from urbanforest_cli.regression.pooling_kernel import sum_around

NODES = 64
LEVELS = (0.03, 0.06, 0.1, 0.14, 0.18, 0.22, 0.26)
LEVEL_PENALTY = 3.0
"""Log likelihood that a level must be better by than the one the config suggests, each time it is e times as far."""
ALIKE = {
    "radius_mean_m": 0.0, "radius_variance_m2": 0.03, "density": 0.3, "boundary_width_m": 0.02,
    "cluster_radius_m": 0.1, "cluster_count_max": 0.2,
}  # fmt: skip
"""Correlation of what the maps of one neighbourhood get wrong, measured on zones of known values. What hides a density
(strategy, band, clusters) is common to a neighbourhood, so that many maps tell little more of it than a few."""
LOTS_ASKED = 2000
"""Lots of a zone whose evidence decides on the level."""
LOTS_A_BLOCK = 4096
DECIMALS = 4

GRID = (np.arange(NODES) + 0.5) / NODES
LOG_LOW, LOG_HIGH = np.log(GRID), np.log(1 - GRID)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Pooled:
    """Means and standard deviations of lots' parameters in shares of their ranges, (lot, parameter).

    Parameters
    ----------
    mean, spread
        Given the lot's own evidence and that of its neighbours.
    left_alone, left
        What is left of the spread that lots of a zone have without any map: given the lot's own evidence, and given
        that and its neighbours'; as if distributions were normal, so that it does not depend on the zone's value.
    heard
        (lot,) neighbours that had something to say.
    strays
        For each zone the square root of v_x, (parameter,).
    """

    mean: Floats
    spread: Floats
    left_alone: Floats
    left: Floats
    heard: Ints
    strays: dict[str, Floats]


def pool(
    centres_m: Floats,
    zones: NDArray[np.object_],
    lot_ids: NDArray[np.object_],
    evidence: Evidence,
    zone_value: Floats,
    *,
    radius_m: float,
    zone_spread: float,
) -> Pooled:
    """Estimate the parameters of lots.

    Parameters
    ----------
    centres_m
        (n, 2); a lot whose centre is not a number neither hears nor is heard.
    zones, lot_ids
        (n,) lots share with lots of the same zone; ids decide which lots are asked where there are many.
    zone_value
        (n, parameter) values of the lots' zones; those outside 0 to 1 count as 0 or 1.
    radius_m
        How far lots are heard, 0 for not at all.
    zone_spread
        How far lots stray from their zones' values.
    """
    lots, parameters = evidence.low.shape
    mean, spread, left_alone, left = (np.zeros((lots, parameters)) for _ in range(4))
    found = Pooled(mean, spread, left_alone, left, np.zeros(lots, dtype=np.int64), {})
    prior = np.clip(zone_value, 0.0, 1.0)
    for zone in sorted(set(zones)):
        rows = np.flatnonzero(zones == zone)
        placed = np.isfinite(centres_m[rows]).all(axis=1) & (radius_m > 0)
        order = rows[placed][_order(centres_m[rows[placed]], lot_ids[rows[placed]], radius_m)]
        around = _Around(centres_m[order], evidence, order, radius_m)
        asked = _asked(lot_ids[order], np.any(evidence.spoke[order], axis=1))
        strays = np.zeros(parameters)
        sums = np.zeros((lots, 2, parameters))
        for column in range(parameters):
            level = _level(around, asked, order, evidence, prior, column, zone_spread)
            strays[column] = level
            if len(order):
                summed, heard = around.sums(np.arange(len(order)), column, level)
                sums[order, :, column] = summed
                found.heard[order] = np.maximum(found.heard[order], heard)
        found.strays[zone] = strays
        for start in range(0, len(rows), LOTS_A_BLOCK):
            block = rows[start : start + LOTS_A_BLOCK]
            for column in range(parameters):
                _settle(found, block, column, evidence, sums, prior, zone_spread, strays[column])
    return found


def _settle(
    found: Pooled, rows: Ints, column: int, evidence: Evidence, sums: Floats, prior: Floats, zone_spread: float,
    level: float,
) -> None:  # fmt: skip
    """Write the moments of one parameter of some lots of a zone."""
    low, high, around = evidence.low[rows, column], evidence.high[rows, column], sums[rows, :, column]
    foretold = _foretold(prior[rows, column], around, zone_spread, level)
    found.mean[rows, column], found.spread[rows, column] = _moments(foretold * np.exp(_log_beta(low, high)))
    told, told_around = precision(low, high), precision(*around.T)
    whole = _variance(zone_spread, level) + level**2
    narrowed = 1 / (1 / _variance(zone_spread, level) + told_around) + level**2
    found.left_alone[rows, column] = np.round(1 / np.sqrt(1 + whole * told), DECIMALS)
    found.left[rows, column] = np.round(1 / np.sqrt(whole / narrowed + whole * told), DECIMALS)


class _Around:
    """The lots of one zone in spatial order, and what those around each of them say."""

    def __init__(self, centres_m: Floats, evidence: Evidence, order: Ints, radius_m: float) -> None:
        self._x, self._y = np.ascontiguousarray(centres_m[:, 0]), np.ascontiguousarray(centres_m[:, 1])
        self._radius = radius_m
        strips = _strips(centres_m, radius_m)
        self._starts = np.searchsorted(strips, np.arange(strips[-1] + 2 if len(strips) else 1)).astype(np.int64)
        self._low, self._high = evidence.low[order], evidence.high[order]
        self._speaks = evidence.spoke[order].any(axis=1)

    def sums(self, rows: Ints, column: int, level: float) -> tuple[Floats, Ints]:
        """Return the exponents of what is said around some of the lots, (m, 2), and how many lots were heard."""
        low, high = self._low[:, column], self._high[:, column]
        kept = 1 / (1 + precision(low, high) * level**2)
        total, heard = np.zeros((len(rows), 3)), np.zeros(len(rows), dtype=np.int64)
        columns = np.column_stack((low * kept, high * kept, low + high > 0))
        sum_around(
            self._x, self._y, self._starts, rows, self._radius, self._radius / 2, columns, self._speaks, total, heard
        )
        others = np.maximum(total[:, 2:] - 1, 0)
        return total[:, :2] / (1 + ALIKE[REGRESSED[column]] * others), heard


def _level(
    around: _Around, asked: Ints, order: Ints, evidence: Evidence, prior: Floats, column: int, zone_spread: float
) -> float:
    """Return how far lots stray from their neighbourhood: of LEVELS, the one that foretells their evidence best."""
    suggested = zone_spread / np.sqrt(2)
    scores = [-LEVEL_PENALTY * abs(np.log(level / suggested)) for level in LEVELS]
    rows = order[asked]
    if len(rows):
        own = np.exp(_log_beta(evidence.low[rows, column], evidence.high[rows, column]))
        for index, level in enumerate(LEVELS):
            summed, _ = around.sums(asked, column, level)
            foretold = _foretold(prior[rows, column], summed, zone_spread, level)
            scores[index] += float(np.log((foretold * own).sum(axis=1) / foretold.sum(axis=1)).sum())
    return LEVELS[int(np.argmax(scores))]


def _foretold(prior: Floats, summed: Floats, zone_spread: float, level: float) -> Floats:
    """Return the distribution of lots' values given their neighbours' exponents, (lot, 2); not normalised."""
    logs = -0.5 * (GRID - prior[:, None]) ** 2 / _variance(zone_spread, level) + summed @ np.vstack((LOG_LOW, LOG_HIGH))
    mean = np.exp(logs - logs.max(axis=1, keepdims=True))
    strays = np.exp(-0.5 * ((GRID[:, None] - GRID) / level) ** 2)
    strays /= strays.sum(axis=1, keepdims=True)
    return np.asarray(mean @ strays)


def _variance(zone_spread: float, level: float) -> float:
    """Return how far means of neighbourhoods stray from their zone's value, squared."""
    return max(zone_spread**2 - level**2, zone_spread**2 / 2)


def _log_beta(low: Floats, high: Floats) -> Floats:
    """Return log likelihoods on the grid, their maximum 0, (lot, node)."""
    logs = low[:, None] * LOG_LOW + high[:, None] * LOG_HIGH
    return np.asarray(logs - logs.max(axis=1, keepdims=True))


def _moments(density: Floats) -> tuple[Floats, Floats]:
    weight = density / density.sum(axis=1, keepdims=True)
    mean = weight @ GRID
    spread = np.sqrt(np.maximum((weight * (GRID - mean[:, None]) ** 2).sum(axis=1), 1 / (12 * NODES**2)))
    return np.round(mean, DECIMALS), np.round(spread, DECIMALS)


def _strips(centres_m: Floats, radius_m: float) -> Ints:
    lowest = centres_m[:, 1].min() if len(centres_m) else 0.0
    return np.floor((centres_m[:, 1] - lowest) / max(radius_m, 1.0)).astype(np.int64)


def _order(centres_m: Floats, lot_ids: NDArray[Any], radius_m: float) -> Ints:
    """Return the order by strip, x, y and id: one that knows places, not rows."""
    ranks = np.argsort(np.argsort(lot_ids.astype(str), kind="stable"), kind="stable")
    return np.lexsort((ranks, centres_m[:, 1], centres_m[:, 0], _strips(centres_m, radius_m)))


def _asked(lot_ids: NDArray[Any], spoke: Any) -> Ints:
    """Return which lots decide on the level: all that spoke, or the same some of them in every run."""
    chance = hash_uniform(keys_for(0, "pooling", lot_ids), np.zeros(len(lot_ids), dtype=np.int64))
    asked = np.flatnonzero(spoke)
    if len(asked) > LOTS_ASKED:
        asked = np.sort(asked[np.argsort(chance[asked], kind="stable")[:LOTS_ASKED]])
    return asked
