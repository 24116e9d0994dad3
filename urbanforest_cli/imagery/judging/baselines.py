"""What a network must beat: everything covered, a greenness threshold, and gradient-boosted pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.judging.pixel_features import NAMES, excess_green, pixel_features
from urbanforest_cli.imagery.judging.scores import Ints, Mask, hard_truth

Image = NDArray[np.uint8]

ALL, INDEX, BOOSTED = "all covered", "excess green", "boosted pixels"
BINS = 3000
LOWEST, HIGHEST = -1.0, 2.0
"""Range of the excess green of chromaticities."""
SAMPLED_PX = 200_000
"""Pixels that boosting learns from, in all."""
ROUNDS = 150
BLOCK_PX = 1 << 18


class Baseline(Protocol):
    """Tells covered pixels by their colours alone."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    def covered(self, rgb: Image, resolution_m: tuple[float, float]) -> Mask:
        """Return (class, rows, cols) of an image (3, rows, cols) whose pixels are so many metres wide and high."""
        ...


@dataclass(frozen=True)
class AllCovered:
    """The simplest map there is."""

    classes: int
    name: str = ALL

    def covered(self, rgb: Image, resolution_m: tuple[float, float]) -> Mask:
        """Return true everywhere."""
        return np.ones((self.classes, *rgb.shape[1:]), dtype=np.bool_)


@dataclass(frozen=True)
class GreenIndex:
    """Covered is what is greener than a threshold, one a class."""

    thresholds: tuple[float, ...]
    name: str = INDEX

    def covered(self, rgb: Image, resolution_m: tuple[float, float]) -> Mask:
        """Return where the excess green reaches the threshold of each class."""
        index = excess_green(rgb)
        return np.stack([index >= threshold for threshold in self.thresholds])


@dataclass(frozen=True)
class BoostedPixels:
    """Covered is what a classifier of each class says of a pixel's colour and texture."""

    classifiers: tuple[Any, ...]
    name: str = BOOSTED

    def covered(self, rgb: Image, resolution_m: tuple[float, float]) -> Mask:
        """Return where each class is the likelier answer."""
        values = pixel_features(rgb, resolution_m).reshape(-1, len(NAMES))
        blocks = [values[start : start + BLOCK_PX] for start in range(0, len(values), BLOCK_PX)]
        found = [np.concatenate([one.predict(block) for block in blocks]) for one in self.classifiers]
        return np.stack(found).astype(np.bool_).reshape(len(found), *rgb.shape[1:])


@dataclass
class BaselineTraining:
    """Gathers what baselines learn from, an image at a time, and fits them.

    Parameters
    ----------
    classes
        Names of the classes, in the order of the truth.
    images
        How many images will be added, so that each gives its share of `SAMPLED_PX`.
    seed
        Root of the streams by which pixels are drawn, one stream an image, keyed by its name.
    """

    classes: tuple[str, ...]
    images: int
    seed: int
    _hits: Ints = field(init=False, repr=False)
    _drawn: dict[str, tuple[NDArray[np.float32], NDArray[np.int8]]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self._hits = np.zeros((len(self.classes), 2, BINS), dtype=np.int64)

    def add(self, name: str, rgb: Image, valid: Mask, truth: Image, resolution_m: tuple[float, float]) -> None:
        """Take in one image (3, rows, cols) with its truth (class, rows, cols) in percent."""
        covered, known = hard_truth(truth)
        known = known & valid
        index = excess_green(rgb)
        for number in range(len(self.classes)):
            for value in (False, True):
                picked = index[known[number] & (covered[number] == value)]
                self._hits[number, int(value)] += _histogram(picked)
        row, col = np.nonzero(known.any(axis=0))
        if len(row) == 0:
            return
        quota = min(-(-SAMPLED_PX // max(self.images, 1)), len(row))
        drawn = rng_for(self.seed, "judging/pixels", name).choice(len(row), quota, replace=False)
        row, col = row[drawn], col[drawn]
        labels = np.where(known, covered, -1)[:, row, col].astype(np.int8)
        self._drawn[name] = pixel_features(rgb, resolution_m)[row, col], labels

    def green_index(self) -> GreenIndex:
        """Return thresholds of greatest intersection over union on all known pixels added.

        Raises
        ------
        InputError
            A class covers no pixel, or all of them.
        """
        self._refuse_one_sided()
        return GreenIndex(tuple(best_threshold(*hits) for hits in self._hits))

    def boosted_pixels(self) -> BoostedPixels:
        """Return histogram gradient boosting (Ke et al. 2017) fitted to the pixels drawn.

        Raises
        ------
        ConfigError
            scikit-learn is not installed.
        InputError
            A class covers no pixel, or all of them.
        """
        try:
            from sklearn.ensemble import HistGradientBoostingClassifier
        except ImportError as error:
            raise ConfigError(
                "gradient-boosted pixels need scikit-learn", next_step="pip install 'urbanforest[train]'"
            ) from error
        self._refuse_one_sided()
        in_order = [self._drawn[name] for name in sorted(self._drawn)]
        features = np.concatenate([values for values, _ in in_order])
        labels = np.concatenate([answers for _, answers in in_order], axis=1)
        fitted = []
        for name, answers in zip(self.classes, labels, strict=True):
            used = answers >= 0
            if len(np.unique(answers[used])) < 2:
                raise InputError(f"none of the pixels drawn tells what is {name} and what is not")
            classifier = HistGradientBoostingClassifier(max_iter=ROUNDS, early_stopping=False, random_state=0)
            fitted.append(classifier.fit(features[used], answers[used]))
        return BoostedPixels(tuple(fitted))

    def _refuse_one_sided(self) -> None:
        for name, (without, covered) in zip(self.classes, self._hits.sum(axis=2), strict=True):
            if without == 0 or covered == 0:
                raise InputError(
                    f"baselines cannot learn {name}", where="training pairs",
                    found=f"{covered:,} pixels covered, {without:,} not", expected="both",
                    next_step="name more pairs with --train",
                )  # fmt: skip


def best_threshold(without: Ints, covered: Ints) -> float:
    """Return the value from which on to call a pixel covered, for the greatest intersection over union.

    Parameters
    ----------
    without, covered
        (BINS,) known pixels by their index from `LOWEST` to `HIGHEST`, those not covered and those covered.
    """
    both = np.cumsum(covered[::-1])[::-1]
    predicted_only = np.cumsum(without[::-1])[::-1]
    best = int(np.argmax(both / (covered.sum() + predicted_only)))
    return LOWEST + best * (HIGHEST - LOWEST) / BINS


def _histogram(index: NDArray[np.float32]) -> Ints:
    place = np.floor((index.astype(np.float64) - LOWEST) * (BINS / (HIGHEST - LOWEST))).astype(np.int64)
    return np.bincount(np.clip(place, 0, BINS - 1), minlength=BINS)
