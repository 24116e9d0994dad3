"""Cut 100,000 synthetic lots out of a city, without and with a coverage map: lots a second and peak memory.

The map has 0.6 m pixels and discs of 2 to 6 m on a quarter of the ground. Each run is a process of its own, kernels
loaded from their cache; so are its figures, of which the time is that on the clock with two threads.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

LOTS = int(os.environ.get("BENCH_LOTS", "100000"))
PIXEL_M = 0.6
ROWS_PX = 1024
STAGE = """
import json, resource, sys, time
from pathlib import Path
from urbanforest_cli.core.config import Config
from urbanforest_cli.register.stage import stencil_city
city, out, coverage = sys.argv[1:]
begun = time.perf_counter()
summary = stencil_city(Path(city), Path(out), config=Config(), seed=1, workers=2,
                       coverage=Path(coverage) if coverage != "none" else None)
usage = resource.getrusage(resource.RUSAGE_SELF)
spent, peak = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024
print(json.dumps([time.perf_counter() - begun, spent, peak, summary.counts]))
"""


def main() -> None:
    from urbanforest_cli.synth.stage import make_city

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for lots in (200, LOTS):  # the first compiles the kernels
            city, coverage = folder / f"{lots}.gpkg", folder / f"{lots}.tif"
            make_city(city, lot_count=lots, seed=1)
            _write_map(coverage, city)
            for what, path in (("without a map", "none"), ("with a map", str(coverage))):
                wall, spent, peak, counts = _run(city, folder / "register.gpkg", path)
                if lots == LOTS:
                    told = f"{lots / wall:7,.0f} lots/s, {wall:6.1f} s, {spent:6.1f} CPU s, peak {peak:5,.0f} MB"
                    shown = f", {counts['regions']:,} regions" if "regions" in counts else ""
                    print(f"  {what:<13} {told}{shown}", flush=True)


def _run(city: Path, register: Path, coverage: str) -> tuple[float, float, float, dict[str, int]]:
    arguments = [sys.executable, "-c", STAGE, str(city), str(register), coverage]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    wall, spent, peak, counts = json.loads(done.stdout)
    return wall, spent, peak, counts


def _write_map(path: Path, city: Path) -> None:
    """Write a map of discs over a city's lots, row of pixels by row."""
    import pyogrio
    from pyproj import CRS

    from urbanforest_cli.core.raster_grid import RasterGrid
    from urbanforest_cli.files.coverage import CoverageWriter

    info = pyogrio.read_info(city, layer="lots")
    west, south, east, north = info["total_bounds"]
    width, height = int((east - west) / PIXEL_M) + 1, int((north - south) / PIXEL_M) + 1
    grid = RasterGrid(width, height, (PIXEL_M, 0.0, west, 0.0, -PIXEL_M, north), CRS.from_user_input(info["crs"]))
    rng = np.random.default_rng(1)
    count = int(0.28 * width * height * PIXEL_M**2 / (np.pi * 17.3))
    x, y, radius = rng.uniform(0, width, count), rng.uniform(0, height, count), rng.uniform(2, 6, count) / PIXEL_M
    order = np.argsort(y)
    x, y, radius = x[order], y[order], radius[order]
    with CoverageWriter(path, grid, ("canopy",), {"format": "cover"}) as out:
        for row in range(0, height, ROWS_PX):
            rows = min(ROWS_PX, height - row)
            percent = np.zeros((1, rows, width), dtype=np.uint8)
            near = slice(*np.searchsorted(y, (row - 12, row + rows + 12)))
            for col, line, reach in zip(x[near], y[near] - row, radius[near], strict=True):
                _draw(percent[0], col, line, reach)
            out.write(row, 0, percent)


def _draw(percent: np.ndarray, col: float, row: float, radius: float) -> None:
    """Draw a disc, its edge a pixel wide."""
    top, left = max(int(row - radius) - 1, 0), max(int(col - radius) - 1, 0)
    bottom, right = int(row + radius) + 2, int(col + radius) + 2
    part = percent[top:bottom, left:right]
    if part.size:
        far = np.hypot(
            np.arange(top, top + part.shape[0])[:, None] + 0.5 - row, np.arange(left, left + part.shape[1]) + 0.5 - col
        )
        np.maximum(part, np.clip(100 * (radius - far + 0.5), 0, 100).astype(np.uint8), out=part)


if __name__ == "__main__":
    main()
