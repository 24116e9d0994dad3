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
"""A lot whose grid would be larger is filled square by square."""
SQUARE_CELLS = 800
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
    """Yield (n, 3) easting, northing and radius, grid by grid; crowns of earlier grids stand already."""
    standing = np.empty((0, 3))
    if sites.fixed_offsets is not None and sites.fixed_xy is not None and sites.fixed_radius_m is not None:
        fixed = slice(int(sites.fixed_offsets[row]), int(sites.fixed_offsets[row + 1]))
        standing = np.column_stack((sites.fixed_xy[fixed], sites.fixed_radius_m[fixed]))
    for grid in _grids(regions.shapes[row], sites.areas[row]):
        covered, stems = raster_shares(grid.shapes, grid.x0, grid.y_top, CELL_M, grid.height, grid.width)
        crowns = fit_crowns(
            covered,
            stems >= 0.5,
            x0=grid.x0,
            y_top=grid.y_top,
            pixel_m=CELL_M,
            radius_mean_m=float(sites.values["radius_mean_m"][row]),
            radius_variance_m2=_variance(sites, row, settings),
            radius_cut_sd=settings.radius_cut_sd,
            radius_min_m=settings.radius_min_m,
            overlap=coverage.crown_overlap,
            coverage=float(regions.coverage[row]),
            key=sites.keys[row] ^ np.uint64(grid.salt),
            fixed_xy=standing[:, :2],
            fixed_radius_m=standing[:, 2],
        )
        found = np.column_stack((crowns.xy, crowns.radius_m))
        standing = np.concatenate((standing, found))
        yield found


def _variance(sites: Sites, row: int, settings: Placement) -> float:
    value = float(sites.values["radius_variance_m2"][row])
    return value**2 if settings.sigma_is == "sd" else value


@dataclass(frozen=True)
class _Grid:
    """Cells that crowns are fitted on, and the region and the ground on them."""

    shapes: Shapes
    x0: float
    y_top: float
    height: int
    width: int
    salt: int


def _grids(region: shapely.Geometry, ground: shapely.Geometry) -> Iterator[_Grid]:
    """Yield one grid around the region, or squares of a fixed net, from the north-west on.

    A square ends where the next begins: the fit takes what lies beyond a grid for unknown, not for open ground, so
    that crowns reach over the seam, and those of the next square find them standing.
    """
    if shapely.is_empty(region):
        return
    west, south, east, north = (float(value) for value in shapely.bounds(region))
    width, height = int(np.ceil((east - west) / CELL_M)), int(np.ceil((north - south) / CELL_M))
    if width * height <= CELLS_MAX:
        shapes = np.array([region, ground], dtype=object)
        rim_m = RIM_CELLS * CELL_M
        yield _Grid(shapes, west - rim_m, north + rim_m, height + 2 * RIM_CELLS, width + 2 * RIM_CELLS, 0)
        return
    side_m = SQUARE_CELLS * CELL_M
    shapely.prepare(region)
    for line in range(int(np.floor(north / side_m)), int(np.floor(south / side_m)) - 1, -1):
        for column in range(int(np.floor(west / side_m)), int(np.floor(east / side_m)) + 1):
            x0, y_top = column * side_m, (line + 1) * side_m
            bounds = (x0, y_top - side_m, x0 + side_m, y_top)
            if not shapely.intersects(region, shapely.box(*bounds)):
                continue
            shapes = np.array([shapely.clip_by_rect(item, *bounds) for item in (region, ground)], dtype=object)
            salt = (column * 0x9E3779B1 ^ line * 0x85EBCA77) & 0xFFFFFFFF
            yield _Grid(shapes, x0, y_top, SQUARE_CELLS, SQUARE_CELLS, salt)


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
