"""How points stand to one another: nearest neighbours and Ripley's L."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.evaluation.patterns import Patterns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEIGHBOUR_SHARES = np.array([0.1, 0.25, 0.5, 0.75, 0.9])
RADII_M = np.arange(1.0, 21.0)


def neighbour_quantiles(patterns: Patterns, area_m2: Floats) -> Floats:
    """Return quantiles of d sqrt(n / A), the nearest neighbour's distance in units of the mean room of a plant.

    0.5 is the mean for points at random, 1.07 that of a triangular lattice (Clark and Evans 1954). Shape
    (lots, quantiles).
    """
    scaled = patterns.scaled(np.sqrt(patterns.counts / area_m2))
    return scaled.quantiles(scaled.neighbour_distances(1)[:, 0], NEIGHBOUR_SHARES)


def lot_l(patterns: Patterns, area_m2: Floats) -> Floats:
    """Return each lot's L(r) at `RADII_M` without edge correction; shape (lots, radii).

    L = sqrt(K / pi) with K = A c / (n (n - 1) / 2), c the pairs within r (Ripley 1976, Besag 1977). For two sets in
    the same lot with the same count the edge takes the same share of both, so their difference needs no correction.
    """
    pairs = patterns.counts * (patterns.counts - 1) / 2
    return np.asarray(np.sqrt(patterns.pair_counts(RADII_M) * (area_m2 / pairs.clip(1) / np.pi)[:, None]))


def pair_share(test_points: Patterns) -> Floats:
    """Return the share of pairs of uniform points that lie within `RADII_M`, by lot; shape (lots, radii).

    It is the lot's edge correction: the integral of its set covariance, estimated by the points given.
    """
    pairs = test_points.counts * (test_points.counts - 1) / 2
    return np.asarray(test_points.pair_counts(RADII_M) / pairs[:, None].clip(1))


def pooled_l(pair_counts: Ints, counts: Ints, share: Floats) -> Floats:
    """Return L(r) over all lots with their edges accounted for, each plant weighing the same; r where at random.

    Parameters
    ----------
    pair_counts
        (lots, radii) from `Patterns.pair_counts`.
    counts
        (lots,) points.
    share
        (lots, radii) from `pair_share`.
    """
    found = (pair_counts * (2 / (counts - 1).clip(1))[:, None]).sum(axis=0)
    expected = (share * counts[:, None]).sum(axis=0)
    return np.asarray(RADII_M * np.sqrt(np.divide(found, expected, out=np.ones_like(found), where=expected > 0)))


def l_envelope(
    model: Ints, real: Ints, counts: Ints, share: Floats, rng: np.random.Generator, *, replicates: int = 99
) -> tuple[Floats, Floats]:
    """Return the band that the pooled L of either set stays in while labels are swapped at random lot by lot.

    The band is a global one: as wide as the largest studentised deviation at any radius of all replicates
    (Myllymaki et al. 2017), so a curve that leaves it anywhere is rejected at 1 / (replicates + 1).
    """
    swapped = rng.random((replicates, len(counts))) < 0.5
    curves = np.array([pooled_l(np.where(s[:, None], model, real), counts, share) for s in swapped])
    centre, spread = curves.mean(axis=0), curves.std(axis=0).clip(1e-12)
    reach = np.abs((curves - centre) / spread).max()
    return centre - reach * spread, centre + reach * spread
