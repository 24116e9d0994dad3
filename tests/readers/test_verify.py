"""`urbanforest verify` over all formats of a real city, and over each with a fault in it."""

import json
import shutil
import sqlite3
from contextlib import closing

import pytest

from tests.readers.conftest import urbanforest
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.verification.stage import verify_outputs

pytestmark = pytest.mark.readers

WITH_PLANTS = {
    "forest.glb", "tiles", "forest.city.json", "species", "plants.geojson", "plants.gpkg", "plants.parquet",
    "itree.csv",
}  # fmt: skip


def test_all_outputs_hold_the_same_plants_within_a_centimetre(forest, standing):
    outputs = {item["name"]: item for item in json.loads(urbanforest("verify", forest, "--json"))["outputs"]}
    assert WITH_PLANTS | {"register.gpkg", "canopy_height.tif", "canopy_cover.tif"} <= set(outputs)
    for name in WITH_PLANTS:
        assert outputs[name]["state"] == "same"
        assert outputs[name]["recorded"]
        assert outputs[name]["largest_distance_mm"] <= 10
        assert name == "plants.geojson" or outputs[name]["plants"] == len(standing)


def test_every_output_tells_what_made_it(forest):
    for name in (*WITH_PLANTS, "canopy_height.tif", "canopy_cover.tif", "register.gpkg"):
        record = describe_output(forest / name)
        told = record["stages"] if name == "register.gpkg" else record["stage_keys"]
        assert set(told) >= {"stencil", "diffuse", "place", "grow"}, name
    assert set(describe_output(forest / "exports.json")["outputs"]) >= WITH_PLANTS


@pytest.fixture
def copy(forest, tmp_path):
    return shutil.copytree(forest, tmp_path / "copy")


def test_a_tileset_without_one_of_its_contents_is_told(copy):
    content = sorted((copy / "tiles").rglob("*.glb"))[-1]
    content.unlink()
    (verdict,) = verify_outputs(copy, [copy / "tiles"])
    assert verdict.state in ("changed", "unreadable")
    assert verdict.faults[0] == f"{content.relative_to(copy).as_posix()} is missing"


@pytest.mark.parametrize("name", sorted(WITH_PLANTS - {"tiles", "species"}))
def test_a_byte_flipped_or_a_tail_cut_is_told_and_never_a_fault_of_the_program(copy, name):
    path = copy / name
    content = path.read_bytes()
    for place in (len(content) // 3, len(content) // 2, len(content) - 9):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        (verdict,) = verify_outputs(copy, [path])
        assert verdict.state == "changed"
        path.write_bytes(content[:place])
        (verdict,) = verify_outputs(copy, [path])
        assert verdict.state == "changed"
        assert "is cut" in verdict.faults[0]


def test_an_id_changed_in_the_exported_geopackage_is_told(copy):
    with closing(sqlite3.connect(copy / "plants.gpkg")) as database:
        table = database.execute("SELECT table_name FROM gpkg_geometry_columns").fetchone()[0]
        triggers = database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (trigger,) in triggers:
            database.execute(f'DROP TRIGGER "{trigger}"')
        database.execute(f'UPDATE "{table}" SET plant_id = plant_id || ? WHERE rowid = 1', ("-x",))
        database.commit()
    (verdict,) = verify_outputs(copy, [copy / "plants.gpkg"])
    assert any("not in the register" in fault for fault in verdict.faults)


def test_outputs_of_an_earlier_growth_are_stale(copy):
    urbanforest("grow", copy, "--year", "-5", "-q")
    verdicts = {verdict.name: verdict for verdict in verify_outputs(copy)}
    assert {name for name, verdict in verdicts.items() if verdict.state == "stale"} >= WITH_PLANTS
