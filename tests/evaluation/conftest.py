from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS

from urbanforest_cli.evaluation.references import even_points, uniform_points
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record, provenance_frame

UTM = CRS.from_epsg(32633)
WEST, SOUTH = 500_000.0, 5_300_000.0
LOTS = 10


@pytest.fixture
def planted(tmp_path) -> tuple[Path, Path]:
    """A register in degrees with ten planted lots, and a city in metres with real plants and a house a lot.

    The tenth lot has placed plants alone; one real plant is out in the sea and one has no position.
    """
    rng = np.random.default_rng(0)
    lots = [shapely.box(WEST + 60 * i, SOUTH, WEST + 60 * i + 50, SOUTH + 40) for i in range(LOTS)]
    ids = [f"lot {i}" for i in range(LOTS)]
    register, city = tmp_path / "register.gpkg", tmp_path / "city.gpkg"
    placed = np.concatenate([even_points(lot, 20, rng) for lot in lots])
    plants = gpd.GeoDataFrame(
        {
            "plant_id": [f"{lot}-{k}" for lot in ids for k in range(20)],
            "lot_id": np.repeat(ids, 20),
            "species": "oak",
            "habit": "tree",
            "age_years": 10.0,
            "envelope_radius_m": 3.0,
            "pruning_factor": 1.0,
        },
        geometry=shapely.points(placed),
        crs=UTM,
    ).to_crs(4326)
    cleaned = gpd.GeoDataFrame(
        {
            "lot_id": ids,
            "zone": "other",
            "origin": "register",
            "area_m2": 2000.0,
            "plantable_area_m2": 2000.0,
            "covered_fraction": np.nan,
            "seen_fraction": np.nan,
        },
        geometry=lots,
        crs=UTM,
    ).to_crs(4326)
    records = [provenance_frame(register, Record(stage, 0, stage, UTM, {}, [])) for stage in ("stencil", "place")]
    write_layers(
        register, {"lots": cleaned, "plants": plants, "provenance": pd.concat(records, ignore_index=True)}, fresh=True
    )
    real = [shapely.points(uniform_points(lot, 12, rng)) for lot in lots[:-1]]
    observed = [*np.concatenate(real), shapely.Point(WEST - 500, SOUTH), None]
    houses = [shapely.box(WEST + 60 * i + 20, SOUTH + 15, WEST + 60 * i + 30, SOUTH + 25) for i in range(LOTS)]
    write_layers(
        city,
        {
            "observed_plants": gpd.GeoDataFrame({"n": np.arange(len(observed))}, geometry=observed, crs=UTM),
            "buildings": gpd.GeoDataFrame({"height_m": np.ones(LOTS)}, geometry=houses, crs=UTM),
        },
        fresh=True,
        geometry_types={"observed_plants": "Point", "buildings": "Polygon"},
    )
    return register, city
