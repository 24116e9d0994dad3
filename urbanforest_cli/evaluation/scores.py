"""One number: how far a model stands between points at random and the real plants' own variation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

Floats = NDArray[np.float64]

SPLITS = 20
LOTS_MIN = 8
OUTLIER_SD = 5.0


@dataclass(frozen=True)
class Score:
    """Energy distances to the real plants, and score = (random - model) / (random - ceiling).

    1 is as near to real lots as other real lots are, 0 as far as points at random, below 0 farther.
    `error` is the standard deviation of the score over splits.
    """

    score: float | None
    error: float | None
    distances: dict[str, float]
    ceiling: float
    splits: int


def energy_distance(one: Floats, two: Floats) -> float:
    """Return the energy distance of two samples (Szekely and Rizzo 2013), unbiased, so 0 on average for one law.

    Parameters
    ----------
    one, two
        (n, features) and (m, features), at least two rows each.
    """

    def within(sample: Floats) -> float:
        return float(cdist(sample, sample).sum() / (len(sample) * (len(sample) - 1)))

    return float(2 * cdist(one, two).mean()) - within(one) - within(two)


def score_against(
    real: Floats,
    candidates: dict[str, Floats],
    rng: np.random.Generator,
    *,
    floor: str = "random",
    model: str = "model",
) -> Score | None:
    """Score a model on features of lots: candidates on one half of the lots against real plants on the other.

    The ceiling is the real plants of the one half against those of the other.

    Parameters
    ----------
    real
        (lots, features).
    candidates
        The same for each candidate, by name; `floor` and `model` among them.
    rng
        Splits the lots.
    floor, model
        Names of the candidates that the score is made of.

    Returns
    -------
    None where there are fewer than `LOTS_MIN` lots.
    """  # fmt: skip
    lots = len(real)
    if lots < LOTS_MIN:
        return None
    centre, spread = real.mean(axis=0), real.std(axis=0)
    kept = spread > 1e-12
    every = {
        name: ((rows - centre)[:, kept] / spread[kept]).clip(-OUTLIER_SD, OUTLIER_SD)
        for name, rows in {**candidates, "ceiling": real}.items()
    }
    found: dict[str, list[float]] = {name: [] for name in every}
    for _ in range(SPLITS):
        order = rng.permutation(lots)
        one, two = order[: lots // 2], order[lots // 2 :]
        for name, rows in every.items():
            found[name].append(energy_distance(rows[one], every["ceiling"][two]))
    means = {name: float(np.mean(values)) for name, values in found.items()}
    room = means[floor] - means["ceiling"]
    score = error = None
    if room > 2 * np.std(found["ceiling"]) / np.sqrt(SPLITS) + 1e-12:
        score = (means[floor] - means[model]) / room
        error = float(np.std((np.array(found[floor]) - np.array(found[model])) / room))
    ceiling = means.pop("ceiling")
    return Score(score, error, means, ceiling, SPLITS)
