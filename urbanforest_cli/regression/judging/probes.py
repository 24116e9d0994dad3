"""Changes to pairs that a right predictor must follow, or must not: swapped coverage, turned lots, raised values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.predictions import (
    COUNTS,
    LOW,
    RANGE,
    USES,
    Floats,
    Prediction,
    Predictor,
    shares,
)
from urbanforest_cli.regression.pair_table import PairTable

Maker = Callable[[Floats, NDArray[np.int8]], PairTable]
"""Makes pairs of values (n, 6) in their units and strategies (n,), the same lots and streams at every call."""
STEPS = (0.15, 0.325, 0.5, 0.675, 0.85)
"""Shares of the range that a parameter is raised over."""
COVERAGE = 0
LOT_FEATURES = ("lot_area_log", "ground_area_log", "ground_share", "rim_share", "lot_depth_m", "pixel_m")
"""Features that hang on the lot and its buildings alone."""


@dataclass(frozen=True, kw_only=True)
class Shuffle:
    """What is left of a parameter's skill when lots get one another's coverage.

    `r2` must be at most 0, the mean predictor's; `correlation` of predicted and true values must vanish.
    """

    pairs: int
    r2: float
    correlation: float


@dataclass(frozen=True, kw_only=True)
class Response:
    """How a parameter is predicted on the same lots while it alone is raised over `STEPS`.

    `predicted` are means in shares of the range, `slope` that of the best line through them (1 follows in full, 0 not
    at all), `rising` the share of the lots whose line rises.
    """

    lots: int
    predicted: tuple[float, ...]
    slope: float
    rising: float


@dataclass(frozen=True, kw_only=True)
class Turning:
    """How far predictions move when a lot is turned or mirrored: shares of the range, over all eight ways to lie."""

    median: float
    most: float
    """What 99 % stay below."""


def shuffled(table: PairTable, kept_features: Sequence[int], rng: np.random.Generator) -> PairTable:
    """Return pairs with the coverage of others: the lot, its scale, its truth and `kept_features` stay.

    Coverage goes to lots shown at the same scale, so that no window is of another size than its scale says.
    """
    order = np.arange(len(table))
    for pixel_m in np.unique(table.pixel_m):
        rows = np.flatnonzero(table.pixel_m == pixel_m)
        order[rows] = rng.permutation(rows)
    windows, features = table.windows.copy(), table.features[order]
    windows[:, COVERAGE] = table.windows[order, COVERAGE]
    kept = list(kept_features)
    features[:, kept] = table.features[:, kept]
    return replace(table, windows=windows, features=features)


def shuffle_scores(prediction: Prediction, table: PairTable) -> dict[str, Shuffle]:
    """Score what was predicted of `shuffled` pairs against their truth."""
    truth, found = shares(table.values), {}
    for number, name in enumerate(REGRESSED):
        rows = table.used[:, number]
        wanted, said = truth[rows, number], prediction.values[rows, number]
        if len(wanted) > 1 and wanted.std() > 0:
            r2 = 1 - float(np.mean((said - wanted) ** 2) / wanted.var())
            together = float(np.corrcoef(said, wanted)[0, 1]) if said.std() > 0 else 0.0
            found[name] = Shuffle(pairs=len(wanted), r2=r2, correlation=together)
    return found


def turned(table: PairTable, way: int) -> PairTable:
    """Return pairs turned by `way` quarters, mirrored first from 4 on; features know no direction and stay."""
    windows = table.windows[..., ::-1] if way >= 4 else table.windows
    return replace(table, windows=np.ascontiguousarray(np.rot90(windows, way % 4, axes=(-2, -1))))


def turning(predictor: Predictor, table: PairTable) -> dict[str, Turning]:
    """Measure how far predictions of pairs in use lie from one another over the eight ways a lot can lie."""
    ways = np.stack([predictor(turned(table, way)).values for way in range(8)])  # (way, n, 6)
    apart = np.abs(ways - ways.mean(axis=0)).max(axis=0)
    found = {}
    for number, name in enumerate(REGRESSED):
        rows = table.used[:, number]
        if rows.any():
            median, most = np.quantile(apart[rows, number], [0.5, 0.99])
            found[name] = Turning(median=float(median), most=float(most))
    return found


def responses(predictor: Predictor, make: Maker, lots: int, rng: np.random.Generator) -> dict[str, Response]:
    """Raise each parameter alone on lots whose strategy uses it; all else is drawn once and stays.

    Parameters
    ----------
    predictor
        To be tried.
    make
        Makes the pairs.
    lots
        How many lots a parameter.
    rng
        Draws the other values, from their whole ranges but with density at least a half, so that something stands.
    """
    found = {}
    density = REGRESSED.index("density")
    for number, name in enumerate(REGRESSED):
        strategy = np.flatnonzero(USES[:, number])[rng.integers(USES[:, number].sum(), size=lots)]
        drawn = rng.random((lots, len(REGRESSED)))
        drawn[:, density] = 0.5 + drawn[:, density] / 2
        said = []
        for step in STEPS:
            drawn[:, number] = step
            values = LOW + drawn * RANGE
            said.append(predictor(make(_whole(values), strategy.astype(np.int8))).values[:, number])
        found[name] = _response(np.stack(said, axis=1))
    return found


def _whole(values: Floats) -> Floats:
    values[:, COUNTS] = np.round(values[:, COUNTS])
    return values


def _response(said: Floats) -> Response:
    """Fit lines through predictions (lot, step)."""
    steps = np.array(STEPS) - np.mean(STEPS)
    slopes = (said - said.mean(axis=1, keepdims=True)) @ steps / (steps @ steps)
    return Response(
        lots=len(said),
        predicted=tuple(float(value) for value in said.mean(axis=0)),
        slope=float(slopes.mean()),
        rising=float(np.mean(slopes > 0)),
    )
