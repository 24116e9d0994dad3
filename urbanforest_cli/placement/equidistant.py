"""Strategy equidistant: rows of plants along the middle of a lot (paper, parameter delta)."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.placement.inside import inside_by_margin
from urbanforest_cli.placement.medial_axis import MedialAxes, medial_axes
from urbanforest_cli.placement.radii import truncated_radii
from urbanforest_cli.placement.row_kernel import rows_along_chains
from urbanforest_cli.placement.sites import Positions, Sites


def equidistant(sites: Sites, settings: Placement) -> Positions:
    """Set plants at equal distances along the medial axis of each lot, kept where there is ground for them.

    The axis is that of the lot, not of the ground left in it, so a house does not bend the row. A distance under
    twice the smallest radius, which includes the table's 0, is raised to that.
    """
    spacing = np.maximum(sites.values["spacing_m"], 2 * settings.radius_min_m)
    # An axis is at most about half as long as the edge.
    over = shapely.length(sites.lots) / (2 * spacing) > settings.max_plants_per_lot
    lots = sites.lots.copy()
    lots[over] = shapely.Polygon()
    xy, site = equidistant_positions(medial_axes(lots), spacing)
    number = np.arange(len(site)) - np.searchsorted(site, site)
    inside = inside_by_margin(sites.areas, site, xy)
    xy, site, number = xy[inside], site[inside], number[inside]
    radius = truncated_radii(
        sites.keys[site],
        number,
        sites.values["radius_mean_m"][site],
        sites.values["radius_variance_m2"][site],
        settings,
    )
    return Positions(site, xy, radius, np.flatnonzero(over))


def equidistant_positions(
    axes: MedialAxes, spacing_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Set points along axes, `spacing_m` apart along each chain, what is left over shared by its two ends.

    A chain shorter than the spacing gets one point, in its middle. Chains are done in their order, and a point
    nearer than the spacing to one that the same part of the polygon has already, its own predecessor aside, is left
    out: at a bend neighbours are nearer than the spacing as the crow flies.

    Parameters
    ----------
    spacing_m
        (polygons,) distances above 0.

    Returns
    -------
    (n, 2) positions, and (n,) index of the polygon, non-decreasing.
    """
    xy, site = rows_along_chains(
        axes.xy,
        axes.chain_offsets,
        axes.chain_part,
        axes.chain_site,
        axes.chain_closed,
        np.ascontiguousarray(spacing_m, dtype=np.float64),
    )
    return xy, site
