"""What a value rests on: the lot's own coverage, its neighbourhood's, or the zone.

For each parameter and lot:

- ``own``: the lot's own column, or the sketch that a person drew, sets it. It stays, whatever the map says.
- ``map``: the lot's own coverage narrows the spread down to `known_share` of what it is without a map. The
  variance of radii needs PLANTS_FOR_VARIANCE plants that can be told apart besides.
- ``neighbourhood``: the lot's own coverage does not, but together with that of other lots around it does.
- ``zone``: neither does. The value is the zone's, its spread what the config says of lots in zones.

A value that rests on the map rests on the neighbourhood too, as far as that is surer than the lot's own coverage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import Evidence
from urbanforest_cli.regression.pooling import Pooled
from urbanforest_cli.regression.shares import Ranges

PLANTS_FOR_VARIANCE = 8
"""Of fewer plants the variance is not known whatever their coverage looks like: of 8 exact radii, R2 is about 0.5."""
OWN, MAP, NEIGHBOURHOOD, ZONE = "own", "map", "neighbourhood", "zone"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Settled:
    """Values of lots in their units, their standard deviations, and what they rest on; each (lot, parameter)."""

    values: Floats
    spreads: Floats
    origins: NDArray[np.object_]


def settle(
    pooled: Pooled,
    evidence: Evidence,
    given: Floats,
    own: NDArray[np.bool_],
    ranges: Ranges,
    *,
    known_share: float,
    zone_spread: float,
) -> Settled:
    """Decide what each value rests on.

    Parameters
    ----------
    given
        (lot, parameter) values as resolved, in their units.
    own
        (lot, parameter) whether a person set that value for that very lot.
    """
    enough = np.ones(given.shape, dtype=bool)
    enough[:, REGRESSED.index("radius_variance_m2")] = evidence.visible >= PLANTS_FOR_VARIANCE
    by_map = evidence.spoke & enough & (pooled.left_alone <= known_share)
    by_others = (pooled.heard > 0)[:, None] & (pooled.left <= known_share)
    origins = np.select([own, by_map, by_others], [OWN, MAP, NEIGHBOURHOOD], ZONE).astype(object)
    read = (origins == MAP) | (origins == NEIGHBOURHOOD)
    unread = np.where(own, 0.0, ranges.value_spreads(np.full(given.shape, zone_spread)))
    return Settled(
        np.where(read, ranges.values(pooled.mean), given),
        np.where(read, ranges.value_spreads(pooled.spread), unread),
        origins,
    )
