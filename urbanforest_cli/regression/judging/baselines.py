"""What a network must beat: the mean, classical measures of blobs, and boosting on features worked out by hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.blobs import MEASURES, blob_measures
from urbanforest_cli.regression.judging.predictions import Floats, Prediction, shares
from urbanforest_cli.regression.pair_table import PairTable

MEAN, CLOSED_FORM, BOOSTED_HAND, BOOSTED_ALL = "mean", "closed form", "boosting, hand", "boosting, all"
LEARNT_BY = {
    "radius_mean_m": ("blob_radius_m", "depth_radius_m"),
    "radius_variance_m2": ("blob_radius_variance_m2", "depth_radius_variance_m2"),
    "density": ("area_fraction", "nearest_m"),
    "boundary_width_m": ("edge_depth_m", "blob_radius_m"),
    "cluster_radius_m": ("reach_m", "nearest_m"),
    "cluster_count_max": ("groups", "area_fraction"),
}
"""Measures by which classical estimators tell each parameter."""
ROUNDS, RATE, LEAF = 200, 0.05, 20
LEAST_PAIRS = 50


@dataclass(frozen=True)
class MeanPredictor:
    """Says the same of every lot: means and standard deviations of the pairs learnt from."""

    values: Floats
    spreads: Floats

    def __call__(self, table: PairTable) -> Prediction:
        """Predict pairs."""
        lines = len(table)
        return Prediction(np.tile(self.values, (lines, 1)), np.tile(self.spreads, (lines, 1)))


@dataclass(frozen=True)
class ClosedForm:
    """A plane through two classical measures a parameter; lots without coverage get the mean of their like."""

    planes: Floats
    bare: Floats

    def __call__(self, table: PairTable) -> Prediction:
        """Predict pairs."""
        measures = blob_measures(table.windows, table.pixel_m)
        values = np.column_stack([
            _design(measures, name) @ plane for name, plane in zip(REGRESSED, self.planes, strict=True)
        ])  # fmt: skip
        return Prediction(np.where(_covered(measures)[:, None], np.clip(values, 0.0, 1.0), self.bare))


@dataclass(frozen=True)
class BoostedFeatures:
    """Histogram gradient boosting (Ke et al. 2017) on the first `columns` features: no spread, but strategies."""

    regressors: tuple[Any, ...]
    classifier: Any
    columns: int

    def __call__(self, table: PairTable) -> Prediction:
        """Predict pairs."""
        features = table.features[:, : self.columns]
        values = np.column_stack([regressor.predict(features) for regressor in self.regressors])
        strategy = np.zeros((len(table), 3))
        strategy[:, self.classifier.classes_] = self.classifier.predict_proba(features)
        return Prediction(np.clip(values, 0.0, 1.0).astype(np.float64), None, strategy)


def fit_mean(table: PairTable) -> MeanPredictor:
    """Return the mean predictor of pairs.

    Raises
    ------
    InputError
        There are too few pairs to learn from.
    """
    _refuse_few(table)
    truth = np.where(table.used, shares(table.values), np.nan)
    return MeanPredictor(np.nanmean(truth, axis=0), np.nanstd(truth, axis=0))


def fit_closed_form(table: PairTable) -> ClosedForm:
    """Return classical estimators, their planes set by least squares.

    Raises
    ------
    InputError
        There are too few pairs to learn from.
    """
    _refuse_few(table)
    truth = shares(table.values)
    measures = blob_measures(table.windows, table.pixel_m)
    covered = _covered(measures)
    planes, bare = [], []
    for number, name in enumerate(REGRESSED):
        seen, unseen = (table.used[:, number] & rows for rows in (covered, ~covered))
        planes.append(np.linalg.lstsq(_design(measures[seen], name), truth[seen, number])[0])
        bare.append(truth[unseen, number].mean() if unseen.any() else truth[table.used[:, number], number].mean())
    return ClosedForm(np.array(planes), np.array(bare))


def fit_boosting(table: PairTable, columns: int) -> BoostedFeatures:
    """Return boosting on the first features, one model a parameter and one for the strategy.

    Raises
    ------
    ConfigError
        scikit-learn is not installed.
    InputError
        There are too few pairs to learn from.
    """
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier, HistGradientBoostingRegressor
    except ImportError as error:
        raise ConfigError(
            "gradient boosting needs scikit-learn", next_step="pip install 'urbanforest[train]'"
        ) from error
    _refuse_few(table)
    settings = {"max_iter": ROUNDS, "learning_rate": RATE, "min_samples_leaf": LEAF, "early_stopping": False,
                "random_state": 0}  # fmt: skip
    features, truth = table.features[:, :columns], shares(table.values)
    regressors = []
    for number in range(len(REGRESSED)):
        rows = table.used[:, number]
        regressors.append(HistGradientBoostingRegressor(**settings).fit(features[rows], truth[rows, number]))
    classifier = HistGradientBoostingClassifier(**settings).fit(features, table.strategy)
    return BoostedFeatures(tuple(regressors), classifier, columns)


def _design(measures: Floats, name: str) -> Floats:
    columns = [measures[:, MEASURES.index(measure)] for measure in LEARNT_BY[name]]
    return np.column_stack([np.ones(len(measures)), *columns])


def _covered(measures: Floats) -> NDArray[np.bool_]:
    return np.asarray(measures[:, MEASURES.index("area_fraction")] > 0)


def _refuse_few(table: PairTable) -> None:
    least = int(table.used.sum(axis=0).min()) if len(table) else 0
    if least < LEAST_PAIRS:
        raise InputError(
            "baselines have too few pairs to learn from", found=f"{least} that use one of the parameters",
            expected=f"{LEAST_PAIRS}", next_step="let them learn from more with --baseline-pairs",
        )  # fmt: skip
