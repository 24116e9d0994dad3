"""Crowns fitted to covered ground: which discs make what a coverage map shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.crown_discs_kernel import SHOWN
from urbanforest_cli.core.crown_fit_kernel import fit_kernel


@dataclass(frozen=True)
class Crowns:
    """Discs.

    Parameters
    ----------
    xy
        (n, 2) float64 centres, in metres in the grid's frame.
    radius_m
        (n,) float64.
    shown
        (n,) bool: the outline shows this crown; else it fills closed canopy, where a place is as good as another.
    """

    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    shown: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.radius_m)


def fit_crowns(
    covered: NDArray[np.bool_] | NDArray[np.uint8] | NDArray[np.floating],
    stems: NDArray[np.bool_],
    *,
    x0: float,
    y_top: float,
    pixel_m: float,
    radius_mean_m: float,
    radius_variance_m2: float,
    radius_cut_sd: float = 2.0,
    radius_min_m: float = 0.5,
    overlap: float = 0.25,
    coverage: float = 1.0,
    key: int | np.uint64 = 0,
    fixed_xy: NDArray[np.float64] | None = None,
    fixed_radius_m: NDArray[np.float64] | None = None,
) -> Crowns:
    """Find discs that make what a map of covered ground shows.

    1. The radius of the largest disc inside covered ground is told for each cell (its distance to bare ground).
    2. Where it is beyond the law of radii, round ground with a bare ring around it is one large crown; all other such
       ground, with what is within a crown's radius of it, is closed canopy.
    3. Elsewhere the outline shows crowns: inscribed discs are taken from the largest down, if they keep apart and more
       than half of each is not yet covered. A blob's first crown may have any size, further ones must be larger than
       a bulge of the outline.
    4. Each is moved and sized so that its rim follows the part of the outline next to it (least squares), which tells
       discs in a row from their arcs.
    5. Closed canopy is filled at random: radii drawn of the law, kept until they find a place.
    6. Gaps between crowns that hold a further one get it, and the outline is followed again.
    7. Where only a share shall be covered, crowns are kept in random order until they do.
    8. All radii are scaled by one factor, from .75 to 1.4, so that the crowns' union has the area asked for.

    Steps 2 and 5 alone depend much on the law; elsewhere a mean wrong by a third changes few crowns. A hedge becomes a
    row of round crowns as wide as it is, which leaves its corners bare. Crowns inside closed canopy are not those that
    stand there: nothing shows them. Two crowns of one place are one, and crowns so near one another that their
    outline has no waist are taken for one longer blob. Distances are kept before steps 4 and 8: crowns may end some
    way nearer than `overlap` asks, and fixed crowns only take ground away and keep none at a distance.

    Parameters
    ----------
    covered
        (h, w) bool, share from 0 to 1, or uint8 percentage (over 100 not known), row 0 in the north. Half and more is
        covered; shares on either side of the outline tell where it runs within a cell. Nothing is known beyond the
        grid, so leave a bare rim around ground that ends.
    stems
        (h, w) bool: where stems may stand. Ground too far from it stays bare.
    x0, y_top, pixel_m
        Place of the upper left corner and side of a cell, metres. Cells of a fifth of the mean radius or less tell
        crowns apart well.
    radius_mean_m, radius_variance_m2, radius_cut_sd
        Normal law of radii, cut at so many deviations (before the cut) either side of the mean.
    radius_min_m
        No crown of a blob is smaller before radii are scaled, nor the law's least radius.
    overlap
        From 0 to 1, share of the sum of their radii by which crowns may stand nearer than touching.
    coverage
        From 0 to 1, share of covered ground that crowns shall cover.
    key
        Chance: order of crowns of one size, and all of closed canopy.
    fixed_xy, fixed_radius_m
        (m, 2) and (m,) crowns that stand already, metres; what they cover is not covered again. They are not returned.

    Returns
    -------
    Crowns whose stems stand in `stems`, in the order found. The same input gives the same crowns.
    """
    if covered.dtype == np.bool_:
        percent = covered.astype(np.uint8) * np.uint8(100)
    elif covered.dtype == np.uint8:
        percent = np.ascontiguousarray(covered)
    else:
        percent = np.round(covered * 100).astype(np.uint8)
    fixed = np.empty((0, 3))
    if fixed_xy is not None and fixed_radius_m is not None:
        fixed = np.column_stack(
            [(fixed_xy[:, 0] - x0) / pixel_m, (y_top - fixed_xy[:, 1]) / pixel_m, fixed_radius_m / pixel_m]
        )
    discs, kinds = fit_kernel(
        percent,
        np.ascontiguousarray(stems, dtype=np.uint8),
        radius_mean_m / pixel_m,
        radius_variance_m2 / pixel_m**2,
        float(radius_cut_sd),
        radius_min_m / pixel_m,
        float(overlap),
        float(coverage),
        np.uint64(key),
        np.ascontiguousarray(fixed, dtype=np.float64),
    )
    xy = np.column_stack([x0 + discs[:, 0] * pixel_m, y_top - discs[:, 1] * pixel_m])
    return Crowns(xy, discs[:, 2] * pixel_m, kinds == SHOWN)
