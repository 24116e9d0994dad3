"""Where the pixels of a raster lie: shape, affine transform and CRS in one immutable object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pyproj import CRS, Geod

Affine6 = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f of x = a col + b row + c, y = d col + e row + f."""


@dataclass(frozen=True)
class RasterGrid:
    """A north-up raster's place on the map.

    Parameters
    ----------
    width_px, height_px
        Columns and rows.
    transform
        From (column, row) of pixel corners to map units; b and d are 0, e is negative.
    crs
        Of any unit: metres, feet or degrees.
    """

    width_px: int
    height_px: int
    transform: Affine6
    crs: CRS

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north in map units."""
        a, _, c, _, e, f = self.transform
        return c, f + e * self.height_px, c + a * self.width_px, f

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a pixel in map units, both positive."""
        return self.transform[0], -self.transform[4]

    @cached_property
    def resolution_m(self) -> tuple[float, float]:
        """True width and height of a pixel on the ground at the raster's centre, in metres.

        Measured along the ellipsoid, so that feet, degrees and the swollen metres of Mercator all come out right.
        """
        west, south, east, north = self.bounds
        x, y = (west + east) / 2, (south + north) / 2
        wide, high = self.pixel_size
        to_degrees = _to_degrees(self.crs)
        xs = np.array([x - wide / 2, x + wide / 2, x, x])
        ys = np.array([y, y, y - high / 2, y + high / 2])
        lon, lat = to_degrees.transform(xs, ys)
        _, _, metres = Geod(ellps="WGS84").inv(lon[::2], lat[::2], lon[1::2], lat[1::2])
        return float(metres[0]), float(metres[1])

    def window(self, row: int, col: int, height_px: int, width_px: int) -> RasterGrid:
        """Return the grid of a part; it may reach beyond this one."""
        a, b, c, d, e, f = self.transform
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            transform=(a, b, c + a * col + b * row, d, e, f + d * col + e * row),
        )


def _to_degrees(crs: CRS):  # type: ignore[no-untyped-def]
    from pyproj import Transformer

    return Transformer.from_crs(crs, 4326, always_xy=True)
