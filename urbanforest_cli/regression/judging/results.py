"""What judging parameter predictors finds: scores in all and by visible plants, calibration, and every reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.calibration import Calibration, calibrations
from urbanforest_cli.regression.judging.predictions import Floats, Mask, Prediction, shares
from urbanforest_cli.regression.judging.probes import Response, Shuffle, Turning
from urbanforest_cli.regression.judging.readings import readings
from urbanforest_cli.regression.judging.scores import (
    LEAST_LOTS,
    Score,
    error_sums,
    interval,
    r_squared,
    resampled,
    score,
)
from urbanforest_cli.regression.judging.zones import ZonePooling
from urbanforest_cli.regression.pair_table import PairTable

VISIBLE = {"0": (0, 0), "1": (1, 1), "2-7": (2, 7), "8-19": (8, 19), "20-63": (20, 63), "64+": (64, None)}
"""Ranges of the plants standing in a lot."""


@dataclass(frozen=True, kw_only=True)
class PredictorScores:
    """One predictor on some pairs: scores by parameter, their means, and the share of strategies told right."""

    scores: dict[str, Score]
    mean_r2: float | None
    mean_r2_low: float | None = None
    mean_r2_high: float | None = None
    mean_one_less_nmae: float | None
    mean_within: float | None
    strategy_accuracy: float | None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """R2 of the predictor judged less that of another over the same lots drawn, of a parameter or ``mean``."""

    against: str
    parameter: str
    r2: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Everything found; predictors in the order they were given, the one judged first.

    Parameters
    ----------
    pairs, lots
        How many were judged.
    total
        By predictor.
    by_visible
        By range of visible plants and predictor.
    pairs_by_visible
        How many pairs are in each range.
    differences
        Between the predictor judged and each other.
    calibration
        By predictor that tells spreads, and parameter.
    readings
        By reading of accuracy, and predictor.
    shuffle, turning, responses, zones
        See `probes` and `zones`; empty where they were not asked for.
    """

    predictors: tuple[str, ...]
    pairs: int
    lots: int
    total: dict[str, PredictorScores]
    by_visible: dict[str, dict[str, PredictorScores]]
    pairs_by_visible: dict[str, int]
    differences: list[Difference]
    calibration: dict[str, dict[str, Calibration]]
    readings: dict[str, dict[str, float]]
    shuffle: dict[str, dict[str, Shuffle]] = field(default_factory=dict)
    turning: dict[str, Turning] = field(default_factory=dict)
    responses: dict[str, Response] = field(default_factory=dict)
    zones: dict[str, list[ZonePooling]] = field(default_factory=dict)

    @property
    def judged(self) -> str:
        """Name of the predictor that the others are beside."""
        return self.predictors[0]

    def as_record(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def judge(table: PairTable, predictions: Mapping[str, Prediction], *, seed: int) -> Judgement:
    """Hold predictions against the truth of pairs.

    Parameters
    ----------
    table
        At least one pair.
    predictions
        By predictor, the one judged first.
    seed
        Root of the streams that lots are drawn by.
    """
    truth = shares(table.values)
    visible = {text: _within(table, *limits) for text, limits in VISIBLE.items()}
    total, differences = _judge_all(table, truth, predictions, seed)
    return Judgement(
        predictors=tuple(predictions),
        pairs=len(table),
        lots=len(np.unique(table.lot)),
        total=total,
        by_visible={
            text: {name: _scores(one, table, truth, rows) for name, one in predictions.items()}
            for text, rows in visible.items()
            if rows.any()
        },
        pairs_by_visible={text: int(rows.sum()) for text, rows in visible.items()},
        differences=differences,
        calibration={
            name: calibrations(one, truth, table.used, rng_for(seed, "regression/judging/cells", name))
            for name, one in predictions.items()
            if one.spreads is not None
        },
        readings=readings(predictions, truth, table),
    )


def _within(table: PairTable, low: int, high: int | None) -> Mask:
    return np.asarray((table.visible >= low) & (table.visible <= (np.iinfo(np.int32).max if high is None else high)))


def _judge_all(
    table: PairTable, truth: Floats, predictions: Mapping[str, Prediction], seed: int
) -> tuple[dict[str, PredictorScores], list[Difference]]:
    by_lot = np.stack([error_sums(one.values, truth, table.used, table.lot) for one in predictions.values()], axis=1)
    everything = np.ones(len(table), np.bool_)
    if len(by_lot) < LEAST_LOTS:
        return {name: _scores(one, table, truth, everything) for name, one in predictions.items()}, []
    drawn = r_squared(resampled(by_lot, rng_for(seed, "regression/judging/lots", "")))  # (draw, predictor, parameter)
    total = {
        name: _scores(one, table, truth, everything, drawn[:, number])
        for number, (name, one) in enumerate(predictions.items())
    }
    names = tuple(predictions)
    found = r_squared(by_lot.sum(axis=0))
    differences = []
    for number, name in enumerate(names[1:], start=1):
        apart, between = found[0] - found[number], drawn[:, 0] - drawn[:, number]
        for parameter, value, draws in [
            *zip(REGRESSED, apart, between.T, strict=True), ("mean", apart.mean(), between.mean(axis=1)),
        ]:  # fmt: skip
            if (limits := interval(draws)) is not None:
                differences.append(
                    Difference(against=name, parameter=parameter, r2=float(value), low=limits[0], high=limits[1])
                )
    return total, differences


def _scores(
    prediction: Prediction, table: PairTable, truth: Floats, rows: Mask, drawn: Floats | None = None
) -> PredictorScores:
    sums = error_sums(prediction.values[rows], truth[rows], table.used[rows], np.zeros(int(rows.sum()), np.int64))[0]
    limits = [None] * len(REGRESSED) if drawn is None else [interval(column) for column in drawn.T]
    scores = {name: score(one, limit) for name, one, limit in zip(REGRESSED, sums, limits, strict=True)}
    of_mean = interval(drawn.mean(axis=1)) if drawn is not None else None
    right = None
    if prediction.strategy is not None:
        right = float(np.mean(prediction.strategy[rows].argmax(axis=1) == table.strategy[rows]))
    return PredictorScores(
        scores=scores,
        mean_r2=_mean([one.r2 for one in scores.values()]),
        mean_r2_low=of_mean[0] if of_mean else None,
        mean_r2_high=of_mean[1] if of_mean else None,
        mean_one_less_nmae=_mean([one.one_less_nmae for one in scores.values()]),
        mean_within=_mean([one.within for one in scores.values()]),
        strategy_accuracy=right,
    )


def _mean(values: list[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if len(there) == len(values) else None
