"""Plants in ground that a coverage map shows: crowns fitted to its regions (paper, Learning Plant Placements).

The paper fills regions by its random strategy. Discs that keep apart leave half of closed canopy bare and reach far
over the edge of small regions, so crowns are fitted instead: where an outline shows a crown, it stands there in its
size; closed canopy is filled at random. What the crowns cover is then what the map covers, and density, which would
count the gaps a second time, does not thin them again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Coverage, Placement
from urbanforest_cli.core.crown_fit import fit_crowns
from urbanforest_cli.core.polygon_raster import raster_shares
from urbanforest_cli.placement.inside import inside_by_margin
from urbanforest_cli.placement.sites import Positions, Sites

Shapes = NDArray[np.object_]

CELL_M = 0.3
"""Half a cell of aerial imagery of 0.6 m: outlines are told to less than that."""
CELLS_MAX = 1_000_000
"""A larger grid is cut: every region of the lot gets one of its own."""
RIM_CELLS = 3
INSET_M = 0.01


@dataclass(frozen=True)
class Regions:
    """Covered ground of a batch of lots.

    Parameters
    ----------
    shapes
        (n,) multipolygons: ground under the crowns of a lot, also where it reaches over the lot's edge.
    coverage
        (n,) share of it that crowns shall cover.
    """

    shapes: Shapes
    coverage: NDArray[np.float64]


def fill_regions(sites: Sites, regions: Regions, settings: Placement, coverage: Coverage) -> Positions:
    """Fit crowns to the regions of lots, their stems in the lots' ground.

    Parameters
    ----------
    sites
        Lots; their areas are where stems may stand, their fixed discs crowns that stand already.

    Returns
    -------
    Positions with the radii of crowns; they may overlap by `coverage.crown_overlap` of the sum of their radii, and a
    little more where an outline shows it.
    """
    site, xy, radius_m, refused = [], [], [], []
    for row in range(len(sites)):
        found = np.concatenate([np.empty((0, 3)), *_fit_lot(sites, regions, row, settings, coverage)])
        if len(found) > settings.max_plants_per_lot:
            refused.append(row)
            continue
        site.append(np.full(len(found), row, dtype=np.int64))
        xy.append(_into_ground(found[:, :2], sites.areas[row]))
        radius_m.append(found[:, 2])
    if not site:
        return Positions(*_none(), np.array(refused, dtype=np.int64))
    return Positions(
        np.concatenate(site), np.concatenate(xy), np.concatenate(radius_m), np.array(refused, dtype=np.int64)
    )


def _none() -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    empty = Positions.empty()
    return empty.site, empty.xy, empty.radius_m


def _fit_lot(
    sites: Sites, regions: Regions, row: int, settings: Placement, coverage: Coverage
) -> Iterator[NDArray[np.float64]]:
    """Yield (n, 3) easting, northing and radius, grid by grid."""
    fixed = slice(0, 0)
    if sites.fixed_offsets is not None:
        fixed = slice(int(sites.fixed_offsets[row]), int(sites.fixed_offsets[row + 1]))
    for number, (shape, ground) in enumerate(_grids(regions.shapes[row], sites.areas[row])):
        west, south, east, north = shapely.bounds(shape)
        cell_m = CELL_M * max(1.0, float(np.sqrt((east - west) * (north - south) / CELL_M**2 / CELLS_MAX)))
        x0, y_top = west - RIM_CELLS * cell_m, north + RIM_CELLS * cell_m
        width = int(np.ceil((east - west) / cell_m)) + 2 * RIM_CELLS
        height = int(np.ceil((north - south) / cell_m)) + 2 * RIM_CELLS
        both = np.array([shape, ground], dtype=object)
        covered, stems = raster_shares(both, x0, y_top, cell_m, height, width)
        crowns = fit_crowns(
            covered,
            stems >= 0.5,
            x0=x0,
            y_top=y_top,
            pixel_m=cell_m,
            radius_mean_m=float(sites.values["radius_mean_m"][row]),
            radius_variance_m2=_variance(sites, row, settings),
            radius_cut_sd=settings.radius_cut_sd,
            radius_min_m=settings.radius_min_m,
            overlap=coverage.crown_overlap,
            coverage=float(regions.coverage[row]),
            key=sites.keys[row] ^ np.uint64(number),
            fixed_xy=None if sites.fixed_xy is None else sites.fixed_xy[fixed],
            fixed_radius_m=None if sites.fixed_radius_m is None else sites.fixed_radius_m[fixed],
        )
        yield np.column_stack((crowns.xy, crowns.radius_m))


def _variance(sites: Sites, row: int, settings: Placement) -> float:
    value = float(sites.values["radius_variance_m2"][row])
    return value**2 if settings.sigma_is == "sd" else value


def _grids(region: shapely.Geometry, ground: shapely.Geometry) -> Iterator[tuple[shapely.Geometry, shapely.Geometry]]:
    """Yield the region and its ground, in one piece where a grid holds it, else part by part."""
    west, south, east, north = shapely.bounds(region)
    if (east - west) * (north - south) <= CELLS_MAX * CELL_M**2:
        yield region, ground
        return
    parts = shapely.get_parts(region)
    boxes = np.asarray(shapely.box(*shapely.bounds(parts).T))
    yield from zip(parts, np.asarray(shapely.intersection(ground, boxes)), strict=True)


def _into_ground(xy: NDArray[np.float64], ground: shapely.Geometry) -> NDArray[np.float64]:
    """Move stems that the grid let stand a fraction of a cell outside their ground to the nearest place in it."""
    area = np.array([ground], dtype=object)
    outside = ~inside_by_margin(area, np.zeros(len(xy), dtype=np.int64), xy)
    if not outside.any():
        return xy
    inner = shapely.buffer(ground, -INSET_M)
    target = shapely.point_on_surface(ground) if inner.is_empty else inner
    moved = xy.copy()
    lines = shapely.shortest_line(shapely.points(xy[outside]), target)
    moved[outside] = shapely.get_coordinates(lines)[1::2]
    return moved
