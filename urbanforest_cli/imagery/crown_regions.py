"""The weak label of canopy: which part of the vegetation stands above the ground.

The rule, in plain words. A person has marked every visible tree with a point; nobody has drawn outlines.

1. What is green. A pixel counts as green by its NDVI against the group's threshold; close to a tree point a NDVI that
   is lower by 0.06 does, since crowns are thin, dry or shaded there more often than lawns are.
2. What looks like a tree. `tree_likeness` gives each pixel the log odds of a tree against a lawn: half of those from
   colour, texture and shadow around it, fitted on vegetation within 3.5 m of a point against vegetation beyond 12 m of
   all, and 0.8 of those from the colour under it alone, fitted within 1.8 m against the same.
3. What belongs to a point. From every point a region grows over the image; a metre of way counts once on ground that
   is green and looks like a tree, up to five times where it is not green and up to three times where it looks like
   lawn. A pixel's evidence gains 5 at the point itself, 2 close to it, nothing at 6 such metres, and loses up to 2.
4. The sum of both is the canopy's log odds (times 1.5), and times the greenness its percentage.
5. What cannot be told is unknown (255): green pixels whose evidence is within +-0.4 of even; that look like a tree
   but lie beyond 15 grown metres of every point (a hedge, shrubs, or a tree nobody marked); and those within 8 m of
   the image's border that lean to a tree, since a tree outside the image has no point in it.
6. A person's eye outweighs an index: the 0.9 m around a point are canopy of 70 % at least, be it green or not, and up
   to 1.8 m are never surely not. Gaps below 12 square metres that canopy encloses are canopy where green, and below
   3 square metres in any case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.imagery.growing import cost_distance_m
from urbanforest_cli.imagery.tree_likeness import Examples
from urbanforest_cli.imagery.vegetation_index import greenness, logistic

SEED_M, STEM_SEED_M, FAR_M = 3.5, 1.8, 12.0
BORDER_M = 8.0
EXAMPLES_AN_IMAGE = 160
SURELY_GREEN = 0.6
LOWERED_NDVI = 0.06
SMOOTHING_M = 0.5
GROWN_M = 15.0
EVEN = 0.4
STEM_M, DOUBT_M = 0.9, 1.8
STEM_PERCENT = 70
GREEN_GAP_M2, GAP_M2 = 12.0, 3.0


@dataclass(frozen=True)
class Surface:
    """An image as the rule sees it.

    Parameters
    ----------
    index
        NDVI, (row, col).
    features
        (row, col, feature) of `tree_features`.
    trees_px
        (n, 2) row and column of tree points from the outer corner of the first pixel; those outside are ignored.
    ndvi_threshold
        Of the image's group.
    resolution_m
        Width and height of a pixel.
    valid
        (row, col), false where the image holds nothing.
    """

    index: NDArray[np.float32]
    features: NDArray[np.float32]
    trees_px: NDArray[np.float64]
    ndvi_threshold: float
    resolution_m: tuple[float, float]
    valid: NDArray[np.bool_]

    @property
    def points(self) -> NDArray[np.bool_]:
        """Pixels that hold a tree point."""
        mask = np.zeros(self.index.shape, np.bool_)
        cells = np.floor(self.trees_px).astype(np.int64)
        mask[tuple(cells[np.all((cells >= 0) & (cells < np.array(mask.shape)), axis=1)].T)] = True
        return mask

    @property
    def pixel_m2(self) -> float:
        """Area of a pixel."""
        return self.resolution_m[0] * self.resolution_m[1]

    def straight_m(self) -> NDArray[np.float32]:
        """Distance of each pixel to the nearest tree point; infinite where there is none."""
        points = self.points
        if not points.any():
            return np.full(points.shape, np.inf, np.float32)
        found = ndimage.distance_transform_edt(~points, sampling=self.resolution_m[::-1])
        return np.asarray(found, np.float32)

    def border_m(self) -> NDArray[np.float32]:
        """Distance of each pixel to the image's border."""
        sides = [
            (np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5) * size_m
            for count, size_m in zip(self.index.shape, self.resolution_m[::-1], strict=True)
        ]
        return np.minimum(sides[0][:, None], sides[1][None, :]).astype(np.float32)


def tree_examples(surface: Surface, rng: np.random.Generator) -> Examples:
    """Pick green pixels within 3.5 m of a tree point, and others farther than 12 m from all and 8 m from the border.

    At most 160 of each kind an image, so that no image rules its group.
    """
    green = (greenness(surface.index, surface.ndvi_threshold) >= SURELY_GREEN) & surface.valid
    straight_m = surface.straight_m()
    far = green & (straight_m > FAR_M) & (surface.border_m() > BORDER_M)
    trees, lawns = (
        np.sort(rng.permutation(np.flatnonzero(mask))[:EXAMPLES_AN_IMAGE])
        for mask in (green & (straight_m <= SEED_M), far)
    )
    flat = surface.features.reshape(-1, surface.features.shape[-1])
    picked = np.concatenate([trees, lawns])
    return Examples(flat[picked], np.arange(len(picked)) < len(trees), straight_m.ravel()[picked] <= STEM_SEED_M)


def canopy_label(surface: Surface, tree_logit: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return how sure a pixel is canopy by the rule above: 0-100 %, 255 where it cannot be told.

    Parameters
    ----------
    surface
        The image, its index and its tree points.
    tree_logit
        (row, col) log odds of a tree against a lawn, of `TreeLook.logit`.
    """
    plain = greenness(surface.index, surface.ndvi_threshold)
    lowered = greenness(surface.index, surface.ndvi_threshold - LOWERED_NDVI)
    sigma = (SMOOTHING_M / surface.resolution_m[1], SMOOTHING_M / surface.resolution_m[0])
    look = np.asarray(ndimage.gaussian_filter(tree_logit, sigma, truncate=2.5), np.float32)
    cost = 1.0 + 4.0 * (1.0 - lowered) + 2.0 * logistic(-look)
    grown_m = cost_distance_m(surface.points, cost, surface.resolution_m, limit_m=GROWN_M)
    evidence = look + np.maximum(5.0 - 3.0 * grown_m, np.clip(2.0 - 0.33 * grown_m, -2.0, 2.0))
    green = np.maximum(plain, lowered * np.clip(1.5 - grown_m / 4.0, 0.0, 1.0))
    percent = np.rint(100.0 * green * logistic(1.5 * evidence)).astype(np.uint8)

    unsure = np.abs(evidence) < EVEN
    unsure |= (grown_m >= GROWN_M) & (look > 1.0)
    unsure |= (surface.border_m() < BORDER_M) & (evidence < 0.0) & (look > -0.5)
    percent[unsure & (green > 0.3)] = UNKNOWN

    straight_m = surface.straight_m()
    percent[(straight_m <= DOUBT_M) & (percent < 50)] = UNKNOWN
    stem = straight_m <= STEM_M
    percent[stem & ((percent < STEM_PERCENT) | (percent == UNKNOWN))] = STEM_PERCENT
    _fill_gaps(percent, green, surface.pixel_m2)
    percent[~surface.valid] = UNKNOWN
    return np.asarray(percent)


def _fill_gaps(percent: NDArray[np.uint8], green: NDArray[np.float32], pixel_m2: float) -> None:
    names, count = ndimage.label((percent < 50) | (percent == UNKNOWN))
    size_m2 = np.bincount(names.ravel(), minlength=count + 1) * pixel_m2
    size_m2[0] = np.inf
    at_border = np.unique(np.concatenate([names[0], names[-1], names[:, 0], names[:, -1]]))
    size_m2[at_border] = np.inf
    area_m2 = size_m2[names]
    filled = ((area_m2 <= GREEN_GAP_M2) & (green > 0.5)) | (area_m2 <= GAP_M2)
    percent[filled] = np.maximum(np.rint(100.0 * green[filled]), STEM_PERCENT).astype(np.uint8)
