from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS
from shapely.geometry import Point, box

from urbanforest_cli.context.stage import diffuse_key, diffuse_parameters
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, SchemaError
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import ORIGIN_SUFFIX, REGRESSED, RESOLVED_PREFIX, SPREAD_SUFFIX
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.parameter_models import SHIPPED
from urbanforest_cli.files.provenance import Record, provenance_frame, read_records
from urbanforest_cli.regression import reading, stage
from urbanforest_cli.regression.features import FEATURES
from urbanforest_cli.regression.stage import regress_key, regress_register

UTM = CRS.from_epsg(32633)
SIDE, ROWS, COLUMNS = 40.0, 5, 8
LOTS = ROWS * COLUMNS
UNSEEN, SKETCH, OWN_RADIUS, OWN_STRATEGY = 9, 20, 22, 23
BARE = 12
CROWNS = (2.0, 4.0)
INFO = ParameterModelInfo(
    "informed", REGRESSED, (1, 0.1, 0, 0, 1, 0), (10, 2, 1, 5, 20, 5),
    ("region_radius_mean_m", "ground_cover"), 64,
)  # fmt: skip


class Formula:
    """Stands in for a network: radius from regions, density from cover, the rest unknown."""

    calls: ClassVar[list[int]] = []

    def __init__(self, content, info):
        assert content == b"model"
        assert info is INFO

    def predict(self, windows, pixel_m, features):
        self.calls.append(len(windows))
        assert windows.shape[1:] == (3, 64, 64)
        n = len(windows)
        values = np.tile(np.array([5.5, 1.05, 0.5, 2.5, 10.5, 2.5], np.float32), (n, 1))
        spreads = np.tile(np.array([9, 1.9, 1, 5, 19, 5.9], np.float32) * 12**-0.5, (n, 1))
        values[:, 0] = np.clip(features[:, 0], 1, 10)
        values[:, 2] = np.clip(2 * features[:, 1], 0, 1)
        spreads[:, 0] = np.where(features[:, 0] > 0, 0.5, 2.5)
        spreads[:, 2] = 0.1
        strategy = np.tile(np.array([0.7, 0.2, 0.1], np.float32), (n, 1))
        return values, spreads, strategy


@pytest.fixture(autouse=True)
def model(monkeypatch):
    from pathlib import Path

    loaded = SimpleNamespace(path=Path("parameters.onnx"), content=b"model", sha256="of the model", info=INFO)
    monkeypatch.setattr(stage, "load_parameter_model", lambda path: loaded)
    monkeypatch.setattr(stage, "ParameterSession", Formula)
    monkeypatch.setattr(Formula, "calls", [])
    return loaded


def crowns(west, south, radius):
    """A grid of separate crowns in a lot."""
    step = 2 * radius + 2
    at = np.arange(radius + 1, SIDE - radius - 0.5, step)
    return shapely.union_all([Point(west + x, south + y).buffer(radius) for x in at for y in at])


@pytest.fixture
def register(tmp_path):
    """Forty lots in degrees, crowns of 2 m in the west and of 4 m in the east, some lots with reasons to differ."""
    path = tmp_path / "register.gpkg"
    rows, columns = np.divmod(np.arange(LOTS), COLUMNS)
    west, south = 500_000 + SIDE * columns, 5.3e6 + SIDE * rows
    ids = [f"lot {i}" for i in range(LOTS)]
    boxes = shapely.box(west, south, west + SIDE, south + SIDE)
    east = columns >= COLUMNS // 2
    planted = [i for i in range(LOTS) if i not in (UNSEEN, BARE)]
    regions = [crowns(west[i], south[i], CROWNS[int(east[i])]) for i in planted]
    lots = gpd.GeoDataFrame(
        {
            "lot_id": ids,
            "zone": np.where(east, "commercial", "residential"),
            "origin": ["sketch" if i == SKETCH else "register" for i in range(LOTS)],
            "area_m2": SIDE**2,
            "plantable_area_m2": SIDE**2,
            "covered_fraction": 0.5,
            "seen_fraction": [0.2 if i == UNSEEN else 1.0 for i in range(LOTS)],
            "radius_mean_m": ["7" if i == OWN_RADIUS else None for i in range(LOTS)],
            "strategy": ["single" if i == OWN_STRATEGY else None for i in range(LOTS)],
        },
        geometry=boxes,
        crs=UTM,
    )
    areas = shapely.area(np.array(regions))
    green = gpd.GeoDataFrame(
        {
            "lot_id": [ids[i] for i in planted],
            "area_m2": areas,
            "inside_m2": areas,
            "region_count": 1,
            "coverage": 1.0,
        },
        geometry=regions,
        crs=UTM,
    )
    values = {p.name: np.full(LOTS, p.default) for p in PARAMETERS.values()}
    values["radius_mean_m"][OWN_RADIUS] = 7.0
    parameters = pd.DataFrame(
        {"lot_id": ids, "strategy": "random", "source": "zone", "context_lot_count": 1}
        | values
        | {RESOLVED_PREFIX + name: column for name, column in values.items()}
    )
    parameters.loc[[OWN_RADIUS, OWN_STRATEGY], "source"] = "lot"
    parameters.loc[SKETCH, "source"] = "sketch"
    buildings = gpd.GeoDataFrame({"building_id": ["b"], "height_m": [8.0]}, geometry=[box(0, 0, 1, 1)], crs=UTM)
    records = [Record(name, 3, f"key of {name}", UTM, {}, []) for name in ("stencil", "diffuse", "place")]
    provenance = pd.concat([provenance_frame(path, record) for record in records], ignore_index=True)
    layers = {"lots": lots.to_crs(4326), "regions": green.to_crs(4326), "buildings": buildings.to_crs(4326)}
    write_layers(path, {**layers, "parameters": parameters, "provenance": provenance}, fresh=True)
    return path


def regressed(register, **options):
    regress_register(register, config=Config(), seed=3, **options)
    return read_layer(register, "regressed"), read_layer(register, "parameters")


def test_values_read_off_the_map_come_in_force_and_name_their_origin(register):
    found, parameters = regressed(register)
    east = np.arange(LOTS) % COLUMNS >= COLUMNS // 2
    read = (found["radius_mean_m_from"] == "map").to_numpy()
    assert read.sum() >= LOTS - 4
    assert np.abs(found["radius_mean_m"] - np.where(east, 4, 2))[read].max() < 0.7
    assert (parameters["radius_mean_m"][read] == found["radius_mean_m"][read]).all()
    assert (parameters["source"][read] == "regressed").all()
    assert (found["radius_variance_m2_from"] == "zone").sum() >= LOTS - 4
    assert (parameters[RESOLVED_PREFIX + "radius_mean_m"].drop(OWN_RADIUS) == 3.13).all()
    assert (found.loc[read, "radius_mean_m" + SPREAD_SUFFIX] < 0.5 * 0.25 * 9).all()


def test_a_lot_that_the_map_does_not_know_hears_its_neighbourhood(register):
    found, parameters = regressed(register)
    assert found["radius_mean_m_from"][UNSEEN] == "neighbourhood"
    assert abs(parameters["radius_mean_m"][UNSEEN] - 2) < 0.7
    assert found["visible_plants"][UNSEEN] == 0
    assert found["pooled_lots"][UNSEEN] > 5
    alone, _ = (
        regress_register(register, config=Config.model_validate({"regression": {"pooling_radius_m": 0}}), seed=3),
        None,
    )
    assert alone.counts["values_from_neighbourhood"] == 0
    assert read_layer(register, "regressed")["radius_mean_m"][UNSEEN] == 3.13


def test_a_bare_lot_speaks_of_density_alone(register):
    regress_register(register, config=Config.model_validate({"regression": {"pooling_radius_m": 0}}), seed=3)
    found = read_layer(register, "regressed")
    origins = {name: found[name + ORIGIN_SUFFIX][BARE] for name in REGRESSED}
    assert origins == dict.fromkeys(REGRESSED, "zone") | {"density": "map"}
    assert found["density"][BARE] < 0.25


def test_what_a_person_set_for_a_lot_stays(register):
    found, parameters = regressed(register)
    assert found["radius_mean_m_from"][OWN_RADIUS] == "own"
    assert parameters["radius_mean_m"][OWN_RADIUS] == 7
    assert found["density_from"][OWN_RADIUS] == "map"
    assert set(found.loc[SKETCH, [name + ORIGIN_SUFFIX for name in REGRESSED]]) == {"own"}
    assert found["visible_plants"][SKETCH] == 0  # drawn, not seen
    assert found["visible_plants"][SKETCH + 1] > 0
    assert parameters["source"][SKETCH] == "sketch"
    assert (parameters.loc[SKETCH, list(PARAMETERS)] == [p.default for p in PARAMETERS.values()]).all()


def test_it_can_be_run_again_and_remembers_where_values_came_from(register):
    once = regressed(register)
    twice = regressed(register)
    for first, second in zip(once, twice, strict=True):
        pd.testing.assert_frame_equal(first, second)
    lots = read_layer(register, "lots")
    lots["seen_fraction"] = 0.0
    write_layers(register, {"lots": lots})
    found, parameters = regressed(register)
    assert parameters["source"].value_counts().to_dict() == {"zone": LOTS - 3, "lot": 2, "sketch": 1}
    assert set(found["radius_mean_m_from"]) == {"zone", "own"}
    for name in REGRESSED:
        assert (parameters[name] == parameters[RESOLVED_PREFIX + name]).all()


def test_it_drops_the_records_of_later_stages_and_leaves_its_own(register):
    regressed(register)
    records = read_records(register)
    assert sorted(records) == ["regress", "stencil"]
    key = regress_key("key of stencil", config=Config(), seed=3, model_sha256="of the model")
    assert records["regress"].stage_key == key
    assert key != regress_key("key of stencil", config=Config(), seed=3, model_sha256="of another model")
    other = Config.model_validate({"regression": {"pooling_radius_m": 100.0}})
    assert key != regress_key("key of stencil", config=other, seed=3, model_sha256="of the model")


def test_the_result_is_the_same_for_any_order_batch_and_number_of_workers(register, monkeypatch):
    once, _ = regressed(register)
    monkeypatch.setattr(stage, "LOTS_A_BATCH", 7)
    lots = read_layer(register, "lots").sample(frac=1, random_state=2)
    parameters = read_layer(register, "parameters").sample(frac=1, random_state=3)
    write_layers(register, {"lots": lots, "parameters": parameters})
    again, _ = regressed(register, workers=2)
    again = again.set_index("lot_id").loc[once["lot_id"]].reset_index()
    pd.testing.assert_frame_equal(once, again)


def test_the_network_always_runs_on_as_many_windows(register):
    regressed(register)
    assert Formula.calls
    assert set(Formula.calls) == {reading.WINDOWS_A_RUN}


def test_diffusion_keeps_values_read_and_lets_their_neighbours_hear_them(register):
    found, parameters = regressed(register)
    diffuse_parameters(register, config=Config(), seed=3)
    diffused = read_layer(register, "parameters")
    for name in REGRESSED:
        read = found[name + ORIGIN_SUFFIX].isin(["map", "neighbourhood"]).to_numpy()
        assert (diffused[name][read] == parameters[name][read]).all()
    assert (diffused["source"] == parameters["source"]).all()
    own = diffused["radius_mean_m"][OWN_RADIUS]
    assert 2 < own < 7
    assert own == diffused["radius_mean_m"][OWN_RADIUS]
    regress = regress_key("key of stencil", config=Config(), seed=3, model_sha256="of the model")
    assert read_records(register)["diffuse"].stage_key == diffuse_key(regress, config=Config(), seed=3)
    diffuse_parameters(register, config=Config(), seed=3)
    pd.testing.assert_frame_equal(diffused, read_layer(register, "parameters"))


def test_a_register_without_a_map_or_without_stencil_names_the_command(register):
    layers = {name: read_layer(register, name) for name in ("lots", "parameters", "provenance")}
    regions, lots = read_layer(register, "regions"), layers["lots"].copy()
    write_layers(register, layers, fresh=True)
    with pytest.raises(InputError, match="--coverage"):
        regressed(register)
    write_layers(register, {"regions": regions})
    lots["seen_fraction"] = np.nan
    write_layers(register, {"lots": lots})
    with pytest.raises(InputError, match="--coverage"):
        regressed(register)
    provenance = layers["provenance"]
    write_layers(register, {"provenance": provenance[provenance["stage"] != "stencil"]})
    with pytest.raises(SchemaError, match="urbanforest stencil"):
        regressed(register)


def test_a_map_that_shows_nothing_at_all_is_no_fault(register):
    write_layers(register, {"regions": read_layer(register, "regions").iloc[:0]})
    found, _ = regressed(register)
    assert (found["visible_plants"] == 0).all()
    assert set(found["radius_mean_m_from"]) == {"zone", "own"}


def test_features_that_the_network_asks_for_are_there():
    assert set(INFO.features) <= set(FEATURES)
    assert reading.PLANTS in FEATURES


def test_a_model_of_another_version_is_refused_and_nothing_is_written(register, model):
    before = register.read_bytes()
    model.info = replace(INFO, features=("crown_size",))
    with pytest.raises(InputError, match="crown_size"):
        regressed(register)
    assert register.read_bytes() == before


@pytest.mark.skipif(not SHIPPED.is_file(), reason="no parameter model is shipped")
def test_the_model_that_comes_with_the_program_tells_large_crowns_from_small_ones_in_any_batch(register, monkeypatch):
    monkeypatch.undo()
    once, _ = regressed(register)
    east = np.arange(LOTS) % COLUMNS >= COLUMNS // 2
    assert once["radius_mean_m"][east].median() > once["radius_mean_m"][~east].median() + 1
    monkeypatch.setattr(stage, "LOTS_A_BATCH", 7)
    again, _ = regressed(register, workers=2)
    pd.testing.assert_frame_equal(once, again)
