from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer

from urbanforest_cli.files.geopackage import read_layer

UTM = CRS.from_epsg(32633)
CELL_M = 0.5


def write_map(path: Path, bounds, function, *, crs=UTM, cell=CELL_M) -> Path:
    """Write a map of percentages, 255 where unknown; the function takes positions in UTM."""
    west, south, east, north = bounds
    width, height = round((east - west) / cell), round((north - south) / cell)
    x, y = np.meshgrid(west + (np.arange(width) + 0.5) * cell, north - (np.arange(height) + 0.5) * cell)
    if crs != UTM:
        x, y = Transformer.from_crs(crs, UTM, always_xy=True).transform(x, y)
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, count=1, dtype="uint8", nodata=255, crs=crs.to_wkt(),
        transform=rasterio.Affine(cell, 0, west, 0, -cell, north),
    ) as file:  # fmt: skip
        file.write(function(x, y).astype(np.uint8), 1)
        file.descriptions = ["canopy"]
        file.units = ["percent"]
    return path


@pytest.fixture
def map_file():
    """How to write a map of percentages."""
    return write_map


@pytest.fixture
def crowned(planted, tmp_path):
    """The planted register, and a map of its own crowns, 3 m around every plant."""
    register, _ = planted
    plants = read_layer(register, "plants").to_crs(UTM)
    spots = np.column_stack((plants.geometry.x, plants.geometry.y))

    def under(x, y):
        near = np.zeros(x.shape, dtype=bool)
        for px, py in spots:
            near |= (x - px) ** 2 + (y - py) ** 2 <= 9.0
        return np.where(near, 100, 0)

    lots = read_layer(register, "lots").to_crs(UTM)
    west, south, east, north = lots.total_bounds
    bounds = (np.floor(west) - 10, np.floor(south) - 10, np.ceil(east) + 10, np.ceil(north) + 10)
    return register, write_map(tmp_path / "map.tif", bounds, under), under, bounds
