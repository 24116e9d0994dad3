"""The law of plant radii: a normal law cut off evenly on both sides of its mean, with the variance asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

FLATTEST = 0.01  # half width over parent scale; what is flatter is uniform to 1e-5


@dataclass(frozen=True)
class RadiusLaw:
    """Normal laws of location `mean_m` and scale `scale_m`, cut `width_m` either side of the mean.

    Attributes
    ----------
    mean_m, width_m, scale_m, variance_m2 : (n,)
        A width of 0 stands for the mean alone; the scale is 1 there. `variance_m2` is that of the cut law.
    """

    mean_m: NDArray[np.float64]
    width_m: NDArray[np.float64]
    scale_m: NDArray[np.float64]
    variance_m2: NDArray[np.float64]


def fit_radius_law(
    mean_m: ArrayLike,
    variance_m2: ArrayLike,
    *,
    sigma_is: Literal["variance", "sd"] = "variance",
    radius_cut_sd: float = 2.0,
    radius_min_m: float = 0.5,
) -> RadiusLaw:
    """Find the normal laws that have the mean and the variance asked for once they are cut.

    The cut stands `radius_cut_sd` parent standard deviations off the mean, but never below `radius_min_m`; where that
    limit is nearer it is taken on both sides, so that the mean stays what was asked for, and the parent is widened
    until the variance is right. A cut law is never wider than the uniform law on its support, whose variance is
    width^2 / 3: where more is asked for, the law is that one. A mean under `radius_min_m` stands alone.

    The variance of a normal law of scale s cut at -w and w is s^2 (1 - 2 x f(x) / erf(x / sqrt 2)), x = w / s, f the
    standard normal density (Johnson, Kotz and Balakrishnan 1994, section 10.1).

    Parameters
    ----------
    mean_m, variance_m2
        Scalars or (n,) values of mu and sigma (paper, table 1), sigma a variance or a standard deviation.
    """
    sd = np.asarray(variance_m2, dtype=np.float64)
    mean, variance = np.broadcast_arrays(np.asarray(mean_m, dtype=np.float64), sd if sigma_is == "variance" else sd**2)
    scale = np.sqrt(variance / (radius_cut_sd**2 * _relative_variance(radius_cut_sd)))
    room = np.maximum(mean - radius_min_m, 0.0)
    width = np.minimum(radius_cut_sd * scale, room)
    share = variance / np.where(width > 0, width, 1.0) ** 2
    flat, steep = np.full(mean.shape, FLATTEST), np.full(mean.shape, radius_cut_sd)
    for _ in range(50):  # bisection: the relative variance falls as the cut lies further out
        middle = 0.5 * (flat + steep)
        wide = _relative_variance(middle) > share
        flat, steep = np.where(wide, middle, flat), np.where(wide, steep, middle)
    cut = np.where(width < radius_cut_sd * scale, flat, radius_cut_sd)
    return RadiusLaw(mean, width, np.where(width > 0, width / cut, 1.0), width**2 * _relative_variance(cut))


def _relative_variance(cut: ArrayLike) -> NDArray[np.float64]:
    """Return the variance of a normal law cut at `cut` parent deviations, over the cut's square."""
    x = np.asarray(cut, dtype=np.float64)
    density = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    return np.asarray((1 - 2 * x * density / erf(x / np.sqrt(2))) / x**2)
