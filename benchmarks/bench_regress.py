"""Measure how fast parameters are read off coverage, and what memory it takes.

Run as ``python -m benchmarks.bench_regress [--lots 20000] [--workers 2]``.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import RESOLVED_PREFIX
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record, provenance_frame
from urbanforest_cli.regression.stage import regress_register

UTM = CRS.from_epsg(32633)
SIDE_M = 25.0
PLANTS_A_LOT = 6


def main() -> None:
    """Run the measurement and print one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lots", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--model", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        small, register = Path(folder) / "small.gpkg", Path(folder) / "register.gpkg"
        options = {"model": arguments.model, "config": Config(), "seed": 1, "workers": arguments.workers}
        write_city(small, 64)
        regress_register(small, **options)
        write_city(register, arguments.lots)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        cpu, start = time.process_time(), time.perf_counter()
        summary = regress_register(register, **options)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    lots = int(summary.counts["lots"])
    print(
        f"regress of {lots:,} lots, {PLANTS_A_LOT} crowns each, {arguments.workers} workers: {seconds:.1f} s, "
        f"{lots / seconds:,.0f} lots/s, {cpu:.1f} CPU s, peak {peak / 1024:.0f} MB "
        f"({(peak - before) / 1024:.0f} MB of it here)"
    )


def write_city(path: Path, count: int) -> None:
    """Write a register of square lots with a house and some crowns each."""
    rng = np.random.default_rng(1)
    side = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), side)
    west, south = 4e5 + SIDE_M * column, 5e6 + SIDE_M * row
    owner = np.repeat(np.arange(count), PLANTS_A_LOT)
    x, y = rng.uniform(0, SIDE_M, (2, len(owner)))
    crowns = shapely.buffer(
        shapely.points(west[owner] + x, south[owner] + y), rng.uniform(1, 4, len(owner)), quad_segs=4
    )
    green = shapely.union_all(shapely.geometrycollections(crowns, indices=owner)[:, None], axis=1)
    ids = np.char.add("lot ", np.arange(count).astype(str)).astype(object)
    lots = gpd.GeoDataFrame(
        {
            "lot_id": ids,
            "zone": "residential",
            "origin": "register",
            "area_m2": SIDE_M**2,
            "plantable_area_m2": SIDE_M**2,
            "covered_fraction": 0.3,
            "seen_fraction": 1.0,
        },
        geometry=shapely.box(west, south, west + SIDE_M, south + SIDE_M),
        crs=UTM,
    )
    area = shapely.area(green)
    regions = gpd.GeoDataFrame(
        {"lot_id": ids, "area_m2": area, "inside_m2": area, "region_count": 1, "coverage": 1.0}, geometry=green, crs=UTM
    )
    buildings = gpd.GeoDataFrame(
        {"building_id": ids, "height_m": 8.0},
        geometry=shapely.box(west + 8, south + 8, west + 17, south + 17),
        crs=UTM,
    )
    values = {p.name: np.full(count, p.default) for p in PARAMETERS.values()}
    parameters = pd.DataFrame(
        {"lot_id": ids, "strategy": "random", "source": "zone", "context_lot_count": 1}
        | values
        | {RESOLVED_PREFIX + name: column for name, column in values.items()}
    )
    provenance = provenance_frame(path, Record("stencil", 1, "key", UTM, {}, []))
    layers = {"lots": lots, "regions": regions, "buildings": buildings, "parameters": parameters}
    write_layers(path, {**layers, "provenance": provenance}, fresh=True)


if __name__ == "__main__":
    main()
