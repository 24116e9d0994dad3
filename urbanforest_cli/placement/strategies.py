"""The six placement strategies, and those that other packages bring (paper, section Placement Strategies).

A strategy takes a batch of lots and returns positions with radii, before any thinning by density. Random,
boundary and cluster are one saturated sampling each, in ground that the strategy cuts out of the lot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import entry_points
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.params import ENTRY_POINT_GROUP, strategy_names
from urbanforest_cli.core.randomness import hash_uniform, rng_from_key
from urbanforest_cli.placement.axis_kernel import axes_of_parts
from urbanforest_cli.placement.equidistant import equidistant
from urbanforest_cli.placement.inside import inside_by_margin
from urbanforest_cli.placement.lattice import regular
from urbanforest_cli.placement.poisson import SampleState, sample_saturated
from urbanforest_cli.placement.poisson_kernel import fill_areas
from urbanforest_cli.placement.radii import truncated_radii
from urbanforest_cli.placement.row_kernel import rows_along_chains
from urbanforest_cli.placement.sites import Positions, Sites
from urbanforest_cli.placement.uniform import uniform_points

Strategy = Callable[[Sites, Placement], Positions]

ARC_SEGMENTS = 16


def random(sites: Sites, settings: Placement) -> Positions:
    """Fill the whole ground of each lot with a saturated variable-radius Poisson-disc sample."""
    sample = sample_saturated(
        sites.areas,
        sites.values["radius_mean_m"],
        sites.values["radius_variance_m2"],
        sites.keys,
        radius_law=settings.radius_law,
        radius_stop=settings.radius_stop,
        sigma_is=settings.sigma_is,
        radius_cut_sd=settings.radius_cut_sd,
        radius_min_m=settings.radius_min_m,
        max_plants=settings.max_plants_per_lot,
        fixed_xy=sites.fixed_xy,
        fixed_radius_m=sites.fixed_radius_m,
        fixed_offsets=sites.fixed_offsets,
    )
    return Positions(sample.site, sample.xy, sample.radius_m, np.flatnonzero(sample.state == SampleState.REFUSED))


def boundary(sites: Sites, settings: Placement) -> Positions:
    """Fill the band along each lot's edge, inward (parameter beta)."""
    bands = boundary_bands(sites.lots, sites.areas, sites.values["boundary_width_m"], edge_of=settings.boundary_of)
    return random(replace(sites, areas=bands), settings)


def boundary_bands(
    lots: NDArray[np.object_], areas: NDArray[np.object_], width_m: NDArray[np.float64], *, edge_of: str = "lot"
) -> NDArray[np.object_]:
    """Cut out of each area what lies within a width of the lot's outer edge.

    Parameters
    ----------
    lots, areas
        (n,) polygons: the lots, and the ground left in them.
    edge_of
        Follow the edge of the lot, its courtyards left aside, or of the area.

    Returns
    -------
    (n,) polygons, empty where the width is 0, the whole area where it reaches the lot's middle.
    """
    outer = without_holes(lots) if edge_of == "lot" else areas
    cores = shapely.buffer(outer, -np.asarray(width_m), quad_segs=ARC_SEGMENTS)
    bands = shapely.difference(areas, cores)
    bands[np.asarray(width_m) <= 0] = shapely.Polygon()
    return np.asarray(bands)


def without_holes(polygons: NDArray[np.object_]) -> NDArray[np.object_]:
    """Fill the holes of polygons and multipolygons."""
    parts, owner = shapely.get_parts(polygons, return_index=True)
    if len(parts) == 0:
        return polygons
    filled = np.asarray(shapely.polygons(shapely.get_exterior_ring(parts)))
    return np.asarray(shapely.multipolygons(filled, indices=owner))


def cluster(sites: Sites, settings: Placement) -> Positions:
    """Fill discs around random points of each lot's ground (parameters kappa and pi)."""
    return random(replace(sites, areas=cluster_areas(sites, settings)), settings)


def cluster_areas(sites: Sites, settings: Placement) -> NDArray[np.object_]:
    """Cut out of each area the union of its clusters' discs.

    A lot has from 1 to pi clusters, each number equally likely, or exactly pi, as the config says; none where pi
    is 0. Their centres are uniform in the ground, whatever parts it has.
    """
    most = np.floor(sites.values["cluster_count_max"] + 0.5).astype(np.int64)
    count = most
    if settings.cluster_count == "uniform":
        chance = hash_uniform(sites.keys ^ np.uint64(0xC1), np.zeros(len(most), dtype=np.int64))
        count = np.where(most > 0, 1 + np.floor(chance * most).astype(np.int64), 0)
    owner, centres = uniform_points(sites.areas, sites.keys ^ np.uint64(0xC2), count)
    discs = shapely.buffer(shapely.points(centres), sites.values["cluster_radius_m"][owner], quad_segs=2 * ARC_SEGMENTS)
    unions = np.full(len(sites.areas), shapely.Polygon(), dtype=object)
    discs_a_lot = np.bincount(owner, minlength=len(sites.areas))
    alone = discs_a_lot[owner] == 1
    unions[owner[alone]] = discs[alone]
    starts = np.searchsorted(owner, np.arange(len(sites.areas) + 1))
    for lot in np.flatnonzero(discs_a_lot > 1):
        unions[lot] = shapely.union_all(discs[starts[lot] : starts[lot + 1]])
    return np.asarray(shapely.intersection(sites.areas, unions))


def single(sites: Sites, settings: Placement) -> Positions:
    """Set one plant in each lot, uniform in its ground."""
    site, xy = uniform_points(sites.areas, sites.keys, np.ones(len(sites.areas), dtype=np.int64))
    radius = truncated_radii(
        sites.keys[site],
        np.zeros(len(site), dtype=np.int64),
        sites.values["radius_mean_m"][site],
        sites.values["radius_variance_m2"][site],
        settings,
    )
    return Positions(site, xy, radius)


BUILT_IN: dict[str, Strategy] = {
    "random": random,
    "boundary": boundary,
    "cluster": cluster,
    "equidistant": equidistant,
    "single": single,
    "regular": regular,
}


KERNELS: dict[str, tuple[Any, ...]] = {
    "random": (fill_areas,),
    "boundary": (fill_areas,),
    "cluster": (fill_areas,),
    "equidistant": (axes_of_parts, rows_along_chains),
}
"""Compiled functions that a strategy spends its time in, and that take time to compile."""


def strategy_named(name: str) -> Strategy:
    """Return a strategy.

    Raises
    ------
    ConfigError
        There is none of this name, or another package's cannot be loaded.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            try:
                return lot_by_lot(point.load(), name)
            except (ImportError, AttributeError) as error:
                raise ConfigError(f"strategy {name!r} cannot be loaded", where=point.value, found=str(error)) from error
    raise ConfigError(f"unknown strategy {name!r}", expected=", ".join(strategy_names()))


LotStrategy = Callable[
    [shapely.Polygon, shapely.MultiPolygon, dict[str, float], np.random.Generator],
    tuple[NDArray[np.float64], NDArray[np.float64]],
]


def lot_by_lot(place: LotStrategy, name: str) -> Strategy:
    """Turn a function of one lot into a strategy.

    ``place(lot, area, values, rng)`` gets the lot, the ground left in it, its parameters by name and a generator of
    its own, and returns (n, 2) positions in metres and (n,) radii. Positions outside the ground are left out.
    """

    def strategy(sites: Sites, settings: Placement) -> Positions:
        owners, positions, radii = [], [], []
        for index, (lot, area, key) in enumerate(zip(sites.lots, sites.areas, sites.keys, strict=True)):
            values = {name: float(column[index]) for name, column in sites.values.items()}
            xy, radius = _asked(place, name, sites.lot_ids[index], (lot, area, values, rng_from_key(int(key))))
            inside = inside_by_margin(np.array([area], dtype=object), np.zeros(len(xy), dtype=np.int64), xy)
            owners.append(np.full(int(inside.sum()), index))
            positions.append(xy[inside])
            radii.append(radius[inside])
        if not owners:
            return Positions.empty()
        return Positions(np.concatenate(owners), np.concatenate(positions), np.concatenate(radii))

    return strategy


def _asked(
    place: LotStrategy, name: str, lot_id: object, arguments: tuple[Any, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Call another package's strategy and check what it returns; whatever goes wrong is told with its name."""
    try:
        xy, radius = place(*arguments)
        xy = np.asarray(xy, dtype=float).reshape(-1, 2)
        radius = np.broadcast_to(np.asarray(radius, dtype=float), len(xy))
        fault = None if np.isfinite(xy).all() and (np.isfinite(radius) & (radius > 0)).all() else "numbers that are not"
    except Exception as error:  # noqa: BLE001 the code is another package's and may raise anything
        fault = f"{type(error).__name__}: {error}"
    if fault is not None:
        raise ConfigError(
            f"strategy {name!r}, which another package brings, failed",
            where=f"lot {lot_id}",
            found=fault,
            expected="(n, 2) finite positions and radii above 0",
            next_step="mend that package, or use another strategy",
        )
    return xy, radius
