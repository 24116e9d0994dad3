"""Tiny inputs every test may use, and the folders of real and of bad data."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import pytest
from shapely.geometry import LineString, box


def _folder(variable: str, what: str) -> Path:
    value = os.environ.get(variable)
    if not value:
        pytest.skip(f"{variable} is not set: it names the folder of {what}")
    folder = Path(value)
    if not folder.is_dir():
        pytest.skip(f"{variable} names {value}, which is no folder")
    return folder


@pytest.fixture(scope="session")
def real_data() -> Path:
    return _folder("URBANFOREST_REAL_DATA", "real cities")


@pytest.fixture(scope="session")
def bad_inputs() -> Path:
    return _folder("URBANFOREST_BAD_INPUTS", "bad input files")


@pytest.fixture
def tiny_city(tmp_path: Path) -> Path:
    """Three lots of 60 x 60 m in a row, a house in the first two, a road along all."""
    from urbanforest_cli.files.geopackage import write_layers

    west, south = 500_000.0, 5_300_000.0
    lots = gpd.GeoDataFrame(
        {"lot_id": ["a", "b", "c"], "zone": ["residential", "commercial", "other"]},
        geometry=[box(west + 60 * i, south, west + 60 * (i + 1), south + 60) for i in range(3)],
        crs="EPSG:32633",
    )
    buildings = gpd.GeoDataFrame(
        {"height_m": [6.0, 9.0]},
        geometry=[box(west + 60 * i + 22, south + 22, west + 60 * i + 38, south + 36) for i in range(2)],
        crs="EPSG:32633",
    )
    roads = gpd.GeoDataFrame(
        {"width_m": [6.0]}, geometry=[LineString([(west, south - 10), (west + 180, south - 10)])], crs="EPSG:32633"
    )
    path = tmp_path / "tiny.gpkg"
    write_layers(
        path,
        {"lots": lots, "buildings": buildings, "roads": roads},
        fresh=True,
        geometry_types={"lots": "Polygon", "buildings": "Polygon", "roads": "LineString"},
    )
    return path


@dataclass(frozen=True)
class Outcome:
    """What a command line left: its exit code and both streams."""

    exit_code: int
    stdout: str
    stderr: str


@pytest.fixture
def runner() -> Callable[..., Outcome]:
    """Run the program as a user would, errors turned into messages and exit codes."""
    from urbanforest_cli.main import guarded

    def run(*arguments: object) -> Outcome:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = guarded([str(argument) for argument in arguments])
        return Outcome(code, out.getvalue(), err.getvalue())

    return run
