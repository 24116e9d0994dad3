"""A register of a few plants, as `grow` leaves it, and outputs beside it."""

from __future__ import annotations

import shutil
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record
from urbanforest_cli.files.skeleton_parts import hash_of, part_name
from urbanforest_cli.files.skeletons import write_part

COUNT = 40
DEAD = (3, 17)
PART = part_name("0" * 24)
UTM = CRS.from_epsg(32633)


def pole() -> Skeletons:
    """Return one skeleton of two internodes."""
    return Skeletons(
        skeleton_id=np.array([5]), first=np.array([0, 3]), seasons=np.array([2], np.int32),
        tip_radius_m=np.array([0.01]), pipe_exponent=np.array([2.0]), parent=np.array([-1, 0, 1], np.int32),
        xyz_m=np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2]], np.float32), order=np.zeros(3, np.uint8),
        birth_season=np.array([0, 1, 2], np.uint8), death_season=np.zeros(3, np.uint8),
    )  # fmt: skip


def trees_frame() -> gpd.GeoDataFrame:
    """Return what became of every plant: two are dead."""
    rng = np.random.default_rng(4)
    easting, northing = np.rint(1000 * rng.uniform(0, 600, (2, COUNT))) / 1000
    stands = ~np.isin(np.arange(COUNT), DEAD)
    height = np.where(stands, np.rint(100 * rng.uniform(3, 20, COUNT)) / 100, 0.0)
    return gpd.GeoDataFrame(
        {
            "plant_id": [f"lot {row % 4}-{row}" for row in range(COUNT)],
            "lot_id": [f"lot {row % 4}" for row in range(COUNT)],
            "species": ["tilia_cordata"] * COUNT,
            "habit": ["tree"] * COUNT,
            "age_years": np.full(COUNT, 2.0),
            "height_m": height,
            "crown_radius_m": height / 4,
            "crown_base_m": height / 5,
            "dbh_m": height / 50,
            "internode_count": np.where(stands, 2, 0),
            "skeleton_id": pd.array([5 if alive else None for alive in stands], dtype="Int64"),
            "grown": np.where(stands, "library", "dead"),
            "reason": [None if alive else "died" for alive in stands],
            "key_distance": np.where(stands, 0.1, np.nan),
            "yaw_deg": rng.uniform(0, 359, COUNT),
            "mirror": np.zeros(COUNT, dtype=np.int64),
            "scale": np.ones(COUNT),
        },
        geometry=gpd.points_from_xy(500_000 + easting, 5_300_000 + northing),
        crs=UTM,
    )


@pytest.fixture
def out(planted: Path, tmp_path: Path) -> Path:
    """A folder with a register and its skeletons."""
    return shutil.copytree(planted, tmp_path / "town-forest")


@pytest.fixture(scope="session")
def planted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, made once."""
    folder = tmp_path_factory.mktemp("planted")
    part = folder / "skeletons" / PART
    write_part(part, [pole()], {"stage": "grow", "plants": {"skeleton_id": [5]}})
    trees = trees_frame()
    plants = trees[["plant_id", "lot_id", "species", "habit", "age_years", "geometry"]].assign(
        envelope_radius_m=2.0, pruning_factor=1.0
    )
    files = pd.DataFrame({"part": [PART], "sha256": [hash_of(part)], "bytes": [part.stat().st_size],
                          "skeleton_count": [1], "internode_count": [2]})  # fmt: skip
    records = [
        Record("stencil", 3, "stencilled", UTM, {}, []),
        Record("place", 3, "placed", UTM, {}, []),
        Record("grow", 3, "grown", UTM, {}, [{"name": "place", "sha256": "placed"}]),
    ]
    write_layers(
        folder / "register.gpkg",
        {
            "plants": plants,
            "trees": trees,
            "skeleton_parts": files,
            "provenance": pd.DataFrame([record.as_row() for record in records]),
        },
        fresh=True,
    )
    return folder
