"""Weak labels of vegetation and canopy from images with a near-infrared band and the positions of trees.

Nothing of the near-infrared band reaches the network that learns from these labels. Thresholds and the look of trees
belong to a group, a city and a flight, since light and cameras differ. `fit_rules` goes twice over all images and keeps
little of each; `derive_labels` then labels one image at a time, the same whatever was labelled before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import CANOPY, UNKNOWN, VEGETATION
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.crown_regions import Surface, canopy_label, tree_examples
from urbanforest_cli.imagery.tree_likeness import Examples, TreeLook, fit_looks, tree_features
from urbanforest_cli.imagery.vegetation_index import (
    ndvi,
    ndvi_histogram,
    otsu_threshold,
    vegetation_label,
)

__all__ = [
    "LabelRule", "LabelSource", "canopy_label", "derive_labels", "fit_rules", "ndvi", "otsu_threshold",
    "vegetation_label",
]  # fmt: skip


class Mapped(Protocol):
    """Applies a function to items and returns the results in their order, as `map` does."""

    def __call__(self, act: Callable[[int], Any], items: Iterable[int], /) -> Iterable[Any]:
        """Return the results."""


@dataclass(frozen=True)
class LabelSource:
    """An image to be labelled.

    Parameters
    ----------
    name, group
        Its own name, and that of its city and flight.
    rgb, nir, valid
        uint8 (3, row, col), uint8 (row, col) and bool (row, col).
    trees_px
        (n, 2) row and column of every visible tree, from the outer corner of the first pixel; None where nobody looked.
    resolution_m
        Width and height of a pixel on the ground.
    """

    name: str
    group: str
    rgb: NDArray[np.uint8]
    nir: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    trees_px: NDArray[np.float64] | None
    resolution_m: tuple[float, float]


@dataclass(frozen=True)
class LabelRule:
    """What the images of one group have in common.

    Parameters
    ----------
    ndvi_threshold
        Otsu's threshold over all of the group's valid pixels.
    median_brightness
        Of the mean of red, green and blue.
    look
        Tells trees from lawns; None where the group has no vegetation close to trees or far from them.
    """

    ndvi_threshold: float
    median_brightness: float
    look: TreeLook | None


def fit_rules(
    count: int, source: Callable[[int], LabelSource], *, canopy: bool, mapped: Mapped = map
) -> dict[str, LabelRule]:
    """Find the rule of every group.

    Parameters
    ----------
    count, source
        How many images there are, and how to read one; each is read once, twice where `canopy` is asked for.
    canopy
        Whether trees are to be told from lawns.
    mapped
        Applies a function to many images, in their order: `map`, or that of a pool of threads.
    """

    def counted(item: int) -> tuple[str, NDArray[np.int64], NDArray[np.int64]]:
        image = source(item)
        light = np.rint(image.rgb.mean(axis=0, dtype=np.float32)[image.valid]).astype(np.int64)
        index_counts = ndvi_histogram(ndvi(image.nir, image.rgb[0]), image.valid)
        return image.group, index_counts, np.bincount(light, minlength=256).astype(np.int64)

    counts: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    for group, index_counts, light_counts in mapped(counted, range(count)):
        before = counts.get(group, (0, 0))
        counts[group] = before[0] + index_counts, before[1] + light_counts
    rules = {group: LabelRule(otsu_threshold(index), _median(light), None) for group, (index, light) in counts.items()}
    if not canopy:
        return rules

    def picked(item: int) -> tuple[str, Examples | None]:
        image = source(item)
        if image.trees_px is None:
            return image.group, None
        surface = _surface(image, image.trees_px, rules[image.group])
        return image.group, tree_examples(surface, rng_for(0, "labels", image.name))

    examples: dict[str, list[Examples]] = {}
    for group, found in mapped(picked, range(count)):
        if found is not None:
            examples.setdefault(group, []).append(found)
    looks = fit_looks({group: Examples.joined(parts) for group, parts in examples.items()})
    return {group: replace(rule, look=looks.get(group)) for group, rule in rules.items()}


def derive_labels(image: LabelSource, rule: LabelRule, classes: Sequence[str]) -> NDArray[np.uint8]:
    """Return the truth (class, row, col) of an image: 0-100 %, 255 unknown; canopy is all unknown without points."""
    index = ndvi(image.nir, image.rgb[0])
    found: dict[str, NDArray[np.uint8]] = {VEGETATION: vegetation_label(index, rule.ndvi_threshold, image.valid)}
    if CANOPY in classes:
        if image.trees_px is None:
            found[CANOPY] = np.full(index.shape, UNKNOWN, np.uint8)
        else:
            surface = _surface(image, image.trees_px, rule)
            even = np.zeros_like(index)
            found[CANOPY] = canopy_label(surface, rule.look.logit(surface.features) if rule.look else even)
    return np.stack([found[name] for name in classes])


def _surface(image: LabelSource, trees_px: NDArray[np.float64], rule: LabelRule) -> Surface:
    features = tree_features(
        image.rgb, image.nir, median_brightness=rule.median_brightness, resolution_m=image.resolution_m
    )
    index = ndvi(image.nir, image.rgb[0])
    return Surface(index, features, trees_px, rule.ndvi_threshold, image.resolution_m, image.valid)


def _median(counts: NDArray[np.int64]) -> float:
    total = counts.sum()
    return float(np.searchsorted(np.cumsum(counts), total / 2)) if total else 128.0
