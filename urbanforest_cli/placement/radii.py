"""Radii of plants that stand where they stand: each by its own uniform number."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.placement.radius_law import RadiusLaw, fit_radius_law

RADII_SALT = np.uint64(0x7261646969)


def truncated_radii(
    keys: NDArray[np.uint64],
    index: NDArray[np.integer],
    mean_m: ArrayLike,
    variance_m2: ArrayLike,
    settings: Placement,
) -> NDArray[np.float64]:
    """Draw radii from the cut normal law of `fit_radius_law`, by inverting its distribution function.

    Nothing is redrawn, and the clip only mends rounding: a radius is a monotone function of the uniform number of
    (key, index), so it depends neither on how many radii are drawn nor on their order.

    Parameters
    ----------
    keys, index
        (n,) stream key of the plant's lot, and the plant's number in it.
    mean_m, variance_m2
        Scalars or (n,) values of the parameters mu and sigma (paper, table 1).

    Returns
    -------
    (n,) float64. A variance of 0 gives the mean.
    """
    uniform = hash_uniform(keys ^ RADII_SALT, index)
    mean, variance, _ = np.broadcast_arrays(mean_m, variance_m2, uniform)
    # plants of a lot share one law and stand together: fit it once
    starts = np.flatnonzero(np.r_[True, (np.diff(mean) != 0) | (np.diff(variance) != 0)][: len(uniform)])
    run = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(uniform)]))
    law = _law(mean[starts], variance[starts], settings)
    width, scale = law.width_m[run], law.scale_m[run]
    below = ndtr(-width / scale)
    drawn = scale * ndtri(below + uniform * (1 - 2 * below))
    return np.asarray(law.mean_m[run] + np.clip(drawn, -width, width))


def radius_limits(
    mean_m: ArrayLike, variance_m2: ArrayLike, settings: Placement
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and largest radius that can be drawn, in metres."""
    law = _law(mean_m, variance_m2, settings)
    return law.mean_m - law.width_m, law.mean_m + law.width_m


def _law(mean_m: ArrayLike, variance_m2: ArrayLike, settings: Placement) -> RadiusLaw:
    return fit_radius_law(
        mean_m,
        variance_m2,
        sigma_is=settings.sigma_is,
        radius_cut_sd=settings.radius_cut_sd,
        radius_min_m=settings.radius_min_m,
    )
