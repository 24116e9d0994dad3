"""How much a pixel of vegetation looks like a tree: a small classifier fitted on the surroundings of annotated trees.

Trees and lawns are equally green to a near-infrared band. What tells them apart is texture (crowns are lumpy, lawns are
smooth), shadow (crowns hold and cast some) and, within one city and one flight, colour. None of these has a
fixed threshold from city to city, so a logistic regression learns them: vegetation close to an annotated tree
is an example of a tree, vegetation far from every one an example of a lawn.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

FINE_M, MIDDLE_M, COARSE_M = 0.6, 1.5, 3.6
"""Standard deviations of the Gaussian windows in which colour, texture and shadow are measured."""
DARK_SHARE = 0.55
"""A pixel darker than this share of its group's median brightness counts as shadow."""
RIDGE = 30.0
"""Pull of a group's weights towards the weights common to all groups, in examples."""
FITTING_STEPS = 12
MIN_EXAMPLES = 200
GROUP_EXAMPLES_MOST, ALL_EXAMPLES_MOST = 40_000, 160_000
LARGEST_LOGIT, LARGEST_CLOSE_LOGIT = 6.0, 3.0
WIDE_WEIGHT, CLOSE_WEIGHT = 0.5, 0.8
CLOSE_FEATURES = (0, 2, 4, 5, 7, 8)
"""Those of `tree_features` measured in the finest window."""
HELD = 4.0
PRODUCT_WEIGHT = 0.3


@dataclass(frozen=True)
class Examples:
    """Pixels of vegetation of one group: features (n, k), whether each lies near a tree (n,), and if so very near."""

    features: NDArray[np.float32]
    is_tree: NDArray[np.bool_]
    is_stem: NDArray[np.bool_]

    @property
    def close(self) -> Examples:
        """Return those very near to a tree and far from all, with the features of the finest window alone."""
        kept = self.is_stem | ~self.is_tree
        return Examples(self.features[kept][:, CLOSE_FEATURES], self.is_tree[kept], self.is_stem[kept])

    @classmethod
    def joined(cls, parts: Iterable[Examples]) -> Examples:
        """Put the examples of several images together."""
        kept = list(parts)
        return cls(
            np.concatenate([part.features for part in kept]),
            np.concatenate([part.is_tree for part in kept]),
            np.concatenate([part.is_stem for part in kept]),
        )

    def thinned(self, most: int) -> Examples:
        """Return so many at most, evenly picked from all."""
        if len(self.is_tree) <= most:
            return self
        picked = np.linspace(0, len(self.is_tree) - 1, most).astype(np.int64)
        return Examples(self.features[picked], self.is_tree[picked], self.is_stem[picked])


@dataclass(frozen=True)
class TreeLikeness:
    """Weights of the classifier of one group, over standardised features, their squares and products."""

    mean: NDArray[np.float64]
    scale: NDArray[np.float64]
    weights: NDArray[np.float64]

    def logit(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the log odds of a tree against a lawn, for features of shape (..., k), within +-6."""
        standard = np.clip((features - self.mean) / self.scale, -HELD, HELD).astype(np.float32)
        width = standard.shape[-1]
        products = np.zeros((width, width), np.float32)
        products[np.triu_indices(width)] = PRODUCT_WEIGHT * self.weights[1 + width :]
        linear = self.weights[1 : 1 + width].astype(np.float32)
        found = self.weights[0] + np.einsum("...k,...k->...", standard @ products + linear, standard)
        return np.asarray(np.clip(found, -LARGEST_LOGIT, LARGEST_LOGIT), np.float32)


@dataclass(frozen=True)
class TreeLook:
    """How trees of a group look, from far and from close.

    The wide classifier knows texture and shadows, but takes the lawn around a crown for a part of it, since its windows
    reach over the edge. The close one knows the colour under a pixel alone, and is wrong on crowns as bright as lawns.
    """

    wide: TreeLikeness
    close: TreeLikeness

    def logit(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return 0.5 of the wide log odds and 0.8 of the close ones held within +-3, for all of `tree_features`."""
        near = np.clip(self.close.logit(features[..., CLOSE_FEATURES]), -LARGEST_CLOSE_LOGIT, LARGEST_CLOSE_LOGIT)
        return np.asarray(WIDE_WEIGHT * self.wide.logit(features) + CLOSE_WEIGHT * near, np.float32)


def fit_looks(groups: dict[str, Examples]) -> dict[str, TreeLook]:
    """Fit both classifiers of every group that has any example; see `fit_likeness`."""
    wide = fit_likeness(groups)
    close = fit_likeness({name: examples.close for name, examples in groups.items()})
    return {name: TreeLook(wide[name], close[name]) for name in wide if name in close}


def tree_features(
    rgb: NDArray[np.uint8], nir: NDArray[np.uint8], *, median_brightness: float, resolution_m: tuple[float, float]
) -> NDArray[np.float32]:
    """Measure colour, texture and shadow around each pixel.

    Parameters
    ----------
    rgb, nir
        (3, row, col) and (row, col), 0-255.
    median_brightness
        Of the group's images, the mean of red, green and blue.
    resolution_m
        Width and height of a pixel.

    Returns
    -------
    (row, col, feature) float32
    """
    bands = rgb.astype(np.float32)
    near = nir.astype(np.float32)
    bright = bands.mean(axis=0)
    index = (near - bands[0]) / (near + bands[0] + 1.0)
    light = np.log(bright + 8.0)
    near_light = np.log(near + 8.0)
    green = (2 * bands[1] - bands[0] - bands[2]) / (3 * bright + 8.0)
    warm = (bands[0] - bands[2]) / (3 * bright + 8.0)
    dark = (bright < DARK_SHARE * median_brightness).astype(np.float32)

    def blur(values: NDArray[np.float32], size_m: float) -> NDArray[np.float32]:
        sigma = (size_m / resolution_m[1], size_m / resolution_m[0])
        return np.asarray(ndimage.gaussian_filter(values, sigma, mode="nearest", truncate=2.5), np.float32)

    def roughness(values: NDArray[np.float32], size_m: float) -> NDArray[np.float32]:
        spread = blur(values * values, size_m) - blur(values, size_m) ** 2
        return np.asarray(np.log(np.sqrt(np.maximum(spread, 0.0)) + 0.01), np.float32)

    return np.stack(
        [
            blur(index, FINE_M), blur(index, COARSE_M), blur(light, FINE_M), blur(light, COARSE_M),
            blur(near_light, FINE_M), blur(green, FINE_M), blur(green, COARSE_M), blur(warm, FINE_M),
            roughness(light, FINE_M), roughness(light, MIDDLE_M), roughness(light, COARSE_M),
            roughness(near_light, MIDDLE_M), roughness(index, MIDDLE_M), blur(dark, COARSE_M),
        ],
        axis=-1,
    )  # fmt: skip


def fit_likeness(groups: dict[str, Examples]) -> dict[str, TreeLikeness]:
    """Fit one classifier a group, pulled towards what all groups have in common.

    Trees and lawns weigh the same in total, so that the log odds know nothing of how frequent they are. Features are
    standardised within each group, since flights differ in light. A group with fewer than 200 examples of either
    kind takes the common weights; where all groups together have fewer, every log odds is zero. A group without any
    example is left out.
    """
    standard: dict[str, Examples] = {}
    shares: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for name, examples in groups.items():
        if len(examples.is_tree) > 0:
            kept = examples.thinned(GROUP_EXAMPLES_MOST)
            mean = kept.features.mean(axis=0, dtype=np.float64)
            scale = kept.features.std(axis=0, dtype=np.float64) + 1e-6
            shares[name] = mean, scale
            standard[name] = replace(kept, features=((kept.features - mean) / scale).astype(np.float32))
    if not standard:
        return {}
    everything = Examples.joined(standard.values()).thinned(ALL_EXAMPLES_MOST)
    count = _terms(everything.features[:1]).shape[1]
    common = np.zeros(count)
    if _enough(everything.is_tree):
        common = _regress(_terms(everything.features), everything.is_tree, common)
    found: dict[str, TreeLikeness] = {}
    for name, examples in standard.items():
        own = _enough(examples.is_tree)
        weights = _regress(_terms(examples.features), examples.is_tree, common) if own else common
        found[name] = TreeLikeness(*shares[name], weights)
    return found


def _enough(is_tree: NDArray[np.bool_]) -> bool:
    return bool(min(is_tree.sum(), (~is_tree).sum()) >= MIN_EXAMPLES)


def _terms(standard: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return a constant, the features (held within +-4) and all their products of two."""
    held = np.clip(standard, -HELD, HELD).astype(np.float64)
    first, second = np.triu_indices(held.shape[1])
    return np.concatenate([np.ones((len(held), 1)), held, PRODUCT_WEIGHT * held[:, first] * held[:, second]], axis=1)


def _regress(
    terms: NDArray[np.float64], is_tree: NDArray[np.bool_], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Logistic regression by Newton's steps (iteratively reweighted least squares), ridge towards `centre`."""
    weight = np.where(is_tree, 0.5 / is_tree.sum(), 0.5 / (~is_tree).sum()) * len(is_tree)
    sign = np.where(is_tree, 1.0, -1.0)

    def loss(weights: NDArray[np.float64]) -> float:
        return float(
            weight @ np.logaddexp(0.0, -sign * (terms @ weights)) + 0.5 * RIDGE * np.sum((weights - centre) ** 2)
        )

    weights, now = centre, loss(centre)
    for _ in range(FITTING_STEPS):
        chance = 1.0 / (1.0 + np.exp(-np.clip(terms @ weights, -30.0, 30.0)))
        slope = terms.T @ (weight * (chance - is_tree)) + RIDGE * (weights - centre)
        curvature = (terms * (weight * chance * (1.0 - chance))[:, None]).T @ terms
        curvature[np.diag_indices_from(curvature)] += RIDGE
        step = np.linalg.solve(curvature, slope)
        size, next_one = 1.0, loss(weights - step)
        while next_one > now and size > 1e-3:
            size /= 2.0
            next_one = loss(weights - size * step)
        if next_one >= now:
            break
        weights, gain, now = weights - size * step, now - next_one, next_one
        if gain < 1e-6 * now:
            break
    return weights
