"""The city file: layers, columns, places, refusals, and the sample that ships."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import shapely
from click.testing import Result

from urbanforest_cli.core.errors import CrsError, LimitError, OutputExistsError
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.synth.stage import make_city

SAMPLE = Path(__file__).parents[2] / "data_samples" / "sample_city.gpkg"
LAYERS = {"lots", "buildings", "roads", "driveways", "entrances", "obstacles", "sketches", "observed_plants"}


def layers_of(path: Path) -> set[str]:
    return set(pyogrio.list_layers(path)[:, 0])


def test_the_file_has_every_layer_with_the_columns_of_a_city(tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    summary = make_city(path, lot_count=350, seed=63)
    assert layers_of(path) >= LAYERS
    lots = gpd.read_file(path, layer="lots")
    assert summary.counts["lots"] == len(lots) == 350
    assert lots["lot_id"].is_unique
    assert lots["lot_id"].iloc[123] == "L000123"
    for layer, columns in {
        "buildings": {"building_id", "height_m"}, "roads": {"kind", "width_m"}, "entrances": {"kind"},
        "obstacles": {"kind", "clearance_m"}, "observed_plants": {"species", "height_m"},
        "sketches": {"strategy", "coverage", "spacing_m"},
    }.items():  # fmt: skip
        frame = gpd.read_file(path, layer=layer)
        assert columns <= set(frame.columns), layer
        assert frame.crs == lots.crs == "EPSG:32633"


def test_the_file_says_what_made_it(tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    make_city(path, lot_count=12, seed=99)
    record = read_records(path)["synth"]
    assert record.seed == 99
    assert record.config["lots"] == 12


def test_the_same_city_stands_at_a_place_of_its_crs(tmp_path: Path) -> None:
    shapes = {}
    for crs in ("EPSG:32633", "EPSG:2154", "EPSG:26911"):
        path = tmp_path / f"{crs[5:]}.gpkg"
        make_city(path, lot_count=20, seed=3, crs=crs)
        lots = gpd.read_file(path, layer="lots")
        assert lots.crs == crs
        west, south, east, north = lots.crs.area_of_use.bounds
        middle = shapely.MultiPoint(lots.to_crs(4326).representative_point().to_numpy()).centroid
        assert west < middle.x < east
        assert south < middle.y < north
        shapes[crs] = lots.area.to_numpy()
    assert np.allclose(shapes["EPSG:32633"], shapes["EPSG:2154"])
    assert np.allclose(shapes["EPSG:32633"], shapes["EPSG:26911"])


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:2263", "EPSG:99999999", "nonsense"])
def test_a_crs_that_is_not_projected_in_metres_is_refused(tmp_path: Path, crs: str) -> None:
    with pytest.raises(CrsError, match="EPSG:32633"):
        make_city(tmp_path / "city.gpkg", lot_count=10, seed=0, crs=crs)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("count", [-1, 0, 9, 1_000_001])
def test_too_few_or_too_many_lots_are_refused(tmp_path: Path, count: int) -> None:
    with pytest.raises(LimitError, match="1,000,000"):
        make_city(tmp_path / "city.gpkg", lot_count=count, seed=0)


def test_a_file_in_the_way_is_kept_unless_it_may_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    path.write_text("mine")
    with pytest.raises(OutputExistsError, match="--overwrite"):
        make_city(path, lot_count=10, seed=0)
    assert path.read_text() == "mine"
    make_city(path, lot_count=10, seed=0, overwrite=True)
    assert len(gpd.read_file(path, layer="lots")) == 10


def test_the_sample_is_the_city_its_command_makes(tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    make_city(path, lot_count=350, seed=63)
    assert SAMPLE.stat().st_size < 1_500_000
    assert layers_of(SAMPLE) == layers_of(path)
    for layer in LAYERS:
        made, shipped = gpd.read_file(path, layer=layer), gpd.read_file(SAMPLE, layer=layer)
        assert len(made) == len(shipped), layer
        gap_m = shapely.hausdorff_distance(made.geometry.to_numpy(), shipped.geometry.to_numpy())
        assert gap_m.max() < 1e-3, layer
        for column in set(made.columns) - {"geometry", "note"}:
            assert made[column].equals(shipped[column]), (layer, column)


def test_the_command_writes_a_city_and_tells_its_counts(runner: Callable[..., Result], tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    outcome = runner("synth", "--lots", 15, "--seed", 2, "-o", path, "--squares", "--json")
    assert outcome.exit_code == 0
    assert '"lots": 15' in outcome.stdout
    assert set(gpd.read_file(path, layer="lots")["zone"]) == {
        "residential", "commercial", "industrial", "street", "other"
    }  # fmt: skip
    again = runner("synth", "--lots", 15, "--seed", 2, "-o", path)
    assert again.exit_code == 2


@pytest.mark.slow
def test_a_large_city_is_exact_too(tmp_path: Path) -> None:
    path = tmp_path / "city.gpkg"
    assert make_city(path, lot_count=30_000, seed=8).counts["lots"] == 30_000
