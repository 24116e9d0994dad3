from __future__ import annotations

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS
from shapely.geometry import box

from urbanforest_cli.context.stage import diffuse_key, diffuse_parameters
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import RESOLVED_PREFIX
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.provenance import Record, provenance_frame, read_records

UTM = CRS.from_epsg(32633)
LOTS = 6


@pytest.fixture
def register(tmp_path):
    """Six lots 30 m apart given in degrees, dense in the west and sparse in the east; the last has no place."""
    path = tmp_path / "register.gpkg"
    ids = [f"lot {i}" for i in range(LOTS)]
    shapes = gpd.GeoSeries([box(500_000 + 30 * i, 5.3e6, 500_030 + 30 * i, 5.30003e6) for i in range(LOTS)], crs=UTM)
    lots = gpd.GeoDataFrame(
        {
            "lot_id": ids,
            "zone": ["residential"] * 3 + ["other"] * 3,
            "origin": "register",
            "area_m2": 900.0,
            "plantable_area_m2": 900.0,
            "covered_fraction": np.nan,
            "seen_fraction": np.nan,
        },
        geometry=shapes.to_crs(4326).to_numpy(),
        crs=4326,
    ).iloc[: LOTS - 1]
    parameters = pd.DataFrame(
        {"lot_id": ids, "strategy": "random", "source": "zone", "context_lot_count": 1}
        | {p.name: p.default for p in PARAMETERS.values()}
        | {RESOLVED_PREFIX + p.name: p.default for p in PARAMETERS.values()}
    )
    parameters[RESOLVED_PREFIX + "density"] = np.where(np.arange(LOTS) < 3, 1.0, 0.0)
    record = Record("stencil", 0, "key of stencil", UTM, {}, [])
    placed = Record("place", 0, "key of place", UTM, {}, [])
    provenance = pd.concat([provenance_frame(path, record), provenance_frame(path, placed)], ignore_index=True)
    write_layers(path, {"lots": lots, "parameters": parameters, "provenance": provenance}, fresh=True)
    return path


def test_values_in_force_change_and_resolved_ones_stay(register):
    summary = diffuse_parameters(register, config=Config(), seed=1)
    parameters = read_layer(register, "parameters")
    assert (parameters[RESOLVED_PREFIX + "density"] == [1, 1, 1, 0, 0, 0]).all()
    density = parameters["density"].to_numpy()
    assert (np.diff(density[:5]) <= 0).all()
    assert density[0] == 1
    assert 0 < density[4] < density[3] < 0.5 < density[2] < density[1] < 1
    assert parameters["context_lot_count"].tolist() == [3, 4, 5, 4, 3, 1]
    assert density[5] == 0
    assert summary.counts["lots_changed"] == 4
    assert summary.notices.count("W_NO_CONTEXT") == 1


def test_it_can_be_run_again_and_drops_the_records_of_later_stages(register):
    diffuse_parameters(register, config=Config(), seed=1)
    once = read_layer(register, "parameters")
    diffuse_parameters(register, config=Config(), seed=1)
    pd.testing.assert_frame_equal(once, read_layer(register, "parameters"))
    records = read_records(register)
    assert sorted(records) == ["diffuse", "stencil"]
    assert records["diffuse"].stage_key == diffuse_key("key of stencil", config=Config(), seed=1)


def test_scope_zone_keeps_zones_apart(register):
    diffuse_parameters(register, config=Config.model_validate({"context": {"scope": "zone"}}), seed=1)
    assert read_layer(register, "parameters")["density"].tolist() == [1, 1, 1, 0, 0, 0]


def test_a_register_without_stencil_names_the_command(tmp_path, register):
    provenance = read_layer(register, "provenance")
    write_layers(register, {"provenance": provenance[provenance["stage"] != "stencil"]})
    with pytest.raises(SchemaError, match="urbanforest stencil"):
        diffuse_parameters(register, config=Config(), seed=1)
