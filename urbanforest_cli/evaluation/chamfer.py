"""Chamfer distance, made comparable: by direction, per lot area, at equal counts.

The sum of squared distances over the lot's area does not depend on size or count: against points at random it is
1/pi = 0.318 a direction, against a square lattice 1/6. It is *not* a proper score: an even set that knows nothing of
the real positions beats the true model wherever the truth is clustered. It is reported beside its references only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.evaluation.patterns import Patterns

Floats = NDArray[np.float64]


def chamfer(source: Patterns, target: Patterns, area_m2: Floats) -> Floats:
    """Return the sum of squared distances from each point of `source` to the nearest of `target`, per lot area."""
    squared = target.nearest_to(source) ** 2
    return np.asarray(np.bincount(source.lot, weights=squared, minlength=len(area_m2)) / area_m2)


def rms_in_spacings(source: Patterns, target: Patterns, area_m2: Floats) -> Floats:
    """Return the root mean square distance to the nearest in units of sqrt(A / n), by lot."""
    return np.asarray(np.sqrt(chamfer(source, target, area_m2)))
