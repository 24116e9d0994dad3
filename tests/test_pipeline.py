import contextlib
import json
import shutil
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely

from tests.growth import fake
from urbanforest_cli.core.errors import BusyError, InputError, OutputExistsError, PartlyDoneError
from urbanforest_cli.core.publish import folder_lock, sha256_of
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.skeleton_parts import parts_are_there
from urbanforest_cli.pipeline import WORK_FOLDER, Request, plan, populate

ROOT = Path(__file__).parents[1]

OUTPUTS = ["exports.json", "forest.glb", "map.png", "plants.geojson", "register.gpkg", "report.html", "report.json",
           "view.png"]  # fmt: skip
SMALL = ["export.map_width_px=300", "export.view_width_px=200", "export.view_height_px=200", "export.detail=low",
         "export.prototypes_max=10"]  # fmt: skip
PUBLISHED = sorted([*OUTPUTS, "skeletons"])


@pytest.fixture
def _real_growth():
    """Let plants grow as they do."""


@pytest.fixture(autouse=True)
def _quick_growth(request, monkeypatch):
    """Let plants be poles, but where a test asks for more."""
    if "_real_growth" not in request.fixturenames:
        monkeypatch.setattr("urbanforest_cli.growth.simulate.grow_grove", fake.grow_grove)


@pytest.fixture(scope="session")
def sample_city(tmp_path_factory):
    from urbanforest_cli.synth.stage import make_city

    path = tmp_path_factory.mktemp("sample") / "city.gpkg"
    make_city(path, lot_count=60, seed=3)
    return path


def request(city, out, seed=1, **changes):
    settings = changes.pop("settings", ())
    config = load_config(settings=[*SMALL, *settings], environment={}).config
    return Request(city=city, out=out, config=config, seed=seed, **changes)


def hashes_of(out):
    """Return the hash of every file that was published, skeletons too."""
    return {
        str(path.relative_to(out)): sha256_of(path)
        for path in out.rglob("*")
        if path.is_file() and WORK_FOLDER not in path.parts
    }


def plants_of(out):
    plants = read_layer(out / "register.gpkg", "plants")
    return plants.sort_values("plant_id").reset_index(drop=True)


def same(one, other, tolerance_m=0.0):
    assert one["plant_id"].tolist() == other["plant_id"].tolist()
    assert one["species"].tolist() == other["species"].tolist()
    gap = np.hypot(one.geometry.x - other.geometry.x, one.geometry.y - other.geometry.y)
    assert gap.max() <= tolerance_m


def test_a_city_in_a_planted_city_out(sample_city, tmp_path):
    summaries = populate(request(sample_city, tmp_path / "out"))
    assert [summary.stage for summary in summaries] == ["stencil", "diffuse", "place", "grow", "export"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == PUBLISHED
    register = tmp_path / "out" / "register.gpkg"
    lots = read_layer(register, "lots")
    plants = read_layer(register, "plants")
    skipped = read_layer(register, "skipped", geometry=False)
    planted = set(plants["lot_id"])
    assert len(plants) > 100
    assert planted | set(skipped["lot_id"]) == set(lots["lot_id"])
    assert not planted & set(skipped["lot_id"])
    assert len(skipped) == len(set(skipped["lot_id"]))
    assert read_layer(register, "trees")["plant_id"].tolist() == plants["plant_id"].tolist()


def test_plants_stand_in_their_ground_and_apart(sample_city, tmp_path):
    populate(request(sample_city, tmp_path / "out", until="place", settings=["zones.default.strategy=random"]))
    register = tmp_path / "out" / "register.gpkg"
    plants = read_layer(register, "plants")
    areas = read_layer(register, "active_areas").set_index("lot_id").geometry
    own = shapely.prepare(areas.to_numpy())
    own = areas.reindex(plants["lot_id"]).to_numpy()
    assert shapely.contains(own, plants.geometry.to_numpy()).all()
    strategies = read_layer(register, "parameters", geometry=False).set_index("lot_id")["strategy"]
    for lot_id, group in plants.groupby("lot_id"):
        if strategies[lot_id] in {"random", "boundary", "cluster"} and len(group) > 1:
            xy = shapely.get_coordinates(group.geometry.to_numpy())
            r = group["envelope_radius_m"].to_numpy()
            gap = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) - r[:, None] - r[None]
            assert gap[np.triu_indices(len(r), 1)].min() >= 0


def test_a_second_run_does_nothing_and_a_changed_config_does_what_it_must(sample_city, tmp_path):
    out = tmp_path / "out"
    populate(request(sample_city, out))
    hashes = hashes_of(out)
    again = populate(request(sample_city, out))
    assert all(summary.up_to_date for summary in again)
    assert hashes_of(out) == hashes
    assert [step["would"] for step in plan(request(sample_city, out))] == ["keep"] * 5
    changed = request(sample_city, out, settings=["context.passes=0"])
    assert [step["would"] for step in plan(changed)] == ["keep", "run", "run", "run", "run"]
    assert [summary.up_to_date for summary in populate(changed)] == [True, False, False, False, False]
    grown = request(sample_city, out, settings=["context.passes=0", "growth.environment=shadow"])
    assert [summary.up_to_date for summary in populate(grown)] == [True, True, True, False, False]
    named = set(read_layer(out / "register.gpkg", "skeleton_parts")["part"])
    assert {path.name for path in (out / "skeletons").iterdir()} == named


def test_an_output_that_was_changed_or_removed_is_written_again(sample_city, tmp_path):
    out = tmp_path / "out"
    populate(request(sample_city, out))
    before = sha256_of(out / "plants.geojson")
    (out / "plants.geojson").write_text("{}")
    populate(request(sample_city, out))
    assert sha256_of(out / "plants.geojson") == before


@pytest.mark.parametrize("harm", ["changed", "removed"])
def test_a_part_of_the_skeletons_that_was_harmed_is_grown_again(sample_city, tmp_path, harm):
    out = tmp_path / "out"
    populate(request(sample_city, out, until="grow"))
    before = {name: sha for name, sha in hashes_of(out).items() if name != "register.gpkg"}
    part = next((out / "skeletons").iterdir())
    part.write_bytes(b"torn") if harm == "changed" else part.unlink()
    assert [step["would"] for step in plan(request(sample_city, out, until="grow"))] == ["keep"] * 3 + ["run"]
    summary = populate(request(sample_city, out, until="grow"))[-1]
    assert "W_SKELETONS_CHANGED" in summary.notices
    assert {name: sha for name, sha in hashes_of(out).items() if name != "register.gpkg"} == before


def test_one_changed_lot_grows_again_with_its_neighbours_and_the_result_is_that_of_a_full_run(sample_city, tmp_path):
    city = tmp_path / "city.gpkg"
    shutil.copy(sample_city, city)
    settings = ["context.passes=0"]
    populate(request(city, tmp_path / "out", until="grow", settings=settings))
    lots = pyogrio.read_dataframe(city, layer="lots")
    lots.loc[5, "geometry"] = shapely.buffer(lots.geometry[5], -1.0)
    pyogrio.write_dataframe(lots, city, layer="lots", driver="GPKG")
    summary = populate(request(city, tmp_path / "out", until="grow", settings=settings))[-1]
    assert 0.6 * summary.counts["groves"] < summary.counts["groves_reused"] < summary.counts["groves"]
    populate(request(city, tmp_path / "full", until="grow", settings=settings))
    for layer in ("trees", "groves", "skeleton_parts"):
        one, two = (read_layer(tmp_path / name / "register.gpkg", layer) for name in ("out", "full"))
        pd.testing.assert_frame_equal(one, two)
    parts = [{n: sha for n, sha in hashes_of(tmp_path / name).items() if "part" in n} for name in ("out", "full")]
    assert parts[0] == parts[1]


def test_the_year_shown_is_that_of_the_last_command_and_nothing_grows_for_it(sample_city, tmp_path, monkeypatch):
    from urbanforest_cli.growth.stage import show_year

    out = tmp_path / "out"
    wanted = request(sample_city, out)
    populate(wanted)
    before = read_layer(out / "register.gpkg", "trees")
    picture = (out / "map.png").read_bytes()
    monkeypatch.setattr("urbanforest_cli.growth.simulate.grow_grove", None)
    show_year(out / "register.gpkg", 5)
    assert [step["would"] for step in plan(wanted)][:4] == ["keep"] * 4
    populate(wanted)
    pd.testing.assert_frame_equal(read_layer(out / "register.gpkg", "trees"), before)
    earlier = replace(wanted, year=5)
    assert [step["would"] for step in plan(earlier)] == ["keep"] * 4 + ["run"]
    assert populate(earlier)[3].counts["year"] == 5
    then = read_layer(out / "register.gpkg", "trees")
    assert then["height_m"].sum() < 0.5 * before["height_m"].sum()
    assert (out / "map.png").read_bytes() != picture
    assert "year 5" in (out / "report.html").read_text(encoding="utf-8")
    assert all(summary.up_to_date for summary in populate(earlier))
    populate(wanted)
    pd.testing.assert_frame_equal(read_layer(out / "register.gpkg", "trees"), before)
    assert (out / "map.png").read_bytes() == picture


def test_one_changed_lot_is_placed_again_and_the_result_is_that_of_a_full_run(sample_city, tmp_path):
    city = tmp_path / "city.gpkg"
    shutil.copy(sample_city, city)
    settings = ["context.passes=0"]
    populate(request(city, tmp_path / "out", until="place", settings=settings))
    lots = pyogrio.read_dataframe(city, layer="lots")
    lots.loc[5, "geometry"] = shapely.buffer(lots.geometry[5], -1.0)
    pyogrio.write_dataframe(lots, city, layer="lots", driver="GPKG")
    summary = populate(request(city, tmp_path / "out", until="place", settings=settings))[-1]
    total = summary.counts["lots_planted"] + summary.counts["lots_skipped"]
    assert summary.counts["lots_reused"] > 0.7 * total
    populate(request(city, tmp_path / "full", until="place", settings=settings))
    pd.testing.assert_frame_equal(plants_of(tmp_path / "out"), plants_of(tmp_path / "full"))


@pytest.mark.parametrize("workers", [2, 4])
def test_the_number_of_workers_does_not_matter(sample_city, tmp_path, workers, monkeypatch):
    monkeypatch.setattr("urbanforest_cli.placement.stage.LOTS_A_BATCH", 7)
    populate(request(sample_city, tmp_path / "one", until="place"))
    populate(request(sample_city, tmp_path / "many", until="place", workers=workers))
    same(plants_of(tmp_path / "one"), plants_of(tmp_path / "many"))


def test_the_order_of_lots_does_not_matter(sample_city, tmp_path):
    city = tmp_path / "shuffled.gpkg"
    shutil.copy(sample_city, city)
    for layer in ("lots", "buildings"):
        frame = pyogrio.read_dataframe(city, layer=layer).sample(frac=1, random_state=5)
        pyogrio.write_dataframe(frame, city, layer=layer, driver="GPKG")
    populate(request(sample_city, tmp_path / "one", until="place"))
    populate(request(city, tmp_path / "two", until="place"))
    same(plants_of(tmp_path / "one"), plants_of(tmp_path / "two"), tolerance_m=1e-6)


@pytest.mark.parametrize("code", [4326, 3857])
def test_the_crs_of_the_lots_does_not_matter(sample_city, tmp_path, code):
    city = tmp_path / "other.gpkg"
    frames, types = {}, {}
    for name, kind in pyogrio.list_layers(sample_city):
        if kind is not None:
            frames[name] = pyogrio.read_dataframe(sample_city, layer=name).to_crs(code)
            types[name] = kind
    write_layers(city, frames, fresh=True, geometry_types=types)
    populate(request(sample_city, tmp_path / "one", until="place"))
    populate(request(city, tmp_path / "two", until="place"))
    one, two = plants_of(tmp_path / "one"), plants_of(tmp_path / "two")
    assert two.crs.to_epsg() == code
    same(one, two.to_crs(one.crs), tolerance_m=1e-3)


def test_stopping_early_and_going_on_is_a_full_run(sample_city, tmp_path):
    for until in ("stencil", "diffuse", "place", "grow"):
        populate(request(sample_city, tmp_path / "steps", until=until))
    populate(request(sample_city, tmp_path / "whole", until="grow"))
    pd.testing.assert_frame_equal(plants_of(tmp_path / "steps"), plants_of(tmp_path / "whole"))
    steps, whole = (read_layer(tmp_path / name / "register.gpkg", "trees") for name in ("steps", "whole"))
    pd.testing.assert_frame_equal(steps, whole)


KILLER = (
    f"SMALL = {SMALL}"
    + """
import os, sys
calls, target = 0, int(sys.argv[3])
def counted(function):
    def call(*arguments, **options):
        global calls
        calls += 1
        if calls == target:
            os.kill(os.getpid(), 9)
        return function(*arguments, **options)
    return call
os.replace, os.fsync, os.open = counted(os.replace), counted(os.fsync), counted(os.open)
from pathlib import Path
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.growth import batches, simulate
from urbanforest_cli.pipeline import Request, populate
from tests.growth import fake
simulate.grow_grove, batches.PLANTS_A_PART = fake.grow_grove, 60
config = load_config(settings=SMALL, environment={}).config
populate(Request(city=Path(sys.argv[1]), out=Path(sys.argv[2]), config=config, seed=int(sys.argv[4])))
print("calls", calls)
"""
)


def killed_run(city, out, target, seed=1):
    arguments = [sys.executable, "-c", KILLER, str(city), str(out), str(target), str(seed)]
    return subprocess.run(arguments, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_killed_run_leaves_old_or_new_and_the_next_goes_on(sample_city, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    old, wanted, again = (tmp_path / name for name in ("old", "wanted", "again"))
    killed_run(sample_city, old, -1, seed=2)
    killed_run(sample_city, wanted, -1)
    before, after = hashes_of(old), hashes_of(wanted)
    shutil.copytree(old, again)
    calls = int(killed_run(sample_city, again, -1).stdout.split()[-1])
    assert len(after) > len(OUTPUTS) + 2
    for target in range(1, calls + 1, max(1, calls // 20)):
        out = tmp_path / f"killed-{target}"
        shutil.copytree(old, out)
        assert killed_run(sample_city, out, target).returncode == -9
        for name, sha in hashes_of(out).items():
            assert sha in (before.get(name), after.get(name)), f"{name} is torn after a kill at call {target}"
        assert parts_are_there(out / "register.gpkg"), f"a part is missing after a kill at call {target}"
        assert killed_run(sample_city, out, -1).returncode == 0
        assert sorted(path.name for path in out.iterdir()) == PUBLISHED
        assert plants_of(out).equals(plants_of(wanted))
        assert read_layer(out / "register.gpkg", "trees").equals(read_layer(wanted / "register.gpkg", "trees"))
        rewritten = ("register.gpkg", "report.html", "report.json")  # a file written in more steps has other pages
        assert hashes_of(out).keys() == after.keys()
        assert {k: v for k, v in hashes_of(out).items() if k not in rewritten}.items() <= after.items()


def test_a_run_that_was_killed_is_gone_on_with(sample_city, tmp_path, monkeypatch):
    out = tmp_path / "out"

    def stopped(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("urbanforest_cli.pipeline.place_plants", stopped)
        with pytest.raises(KeyboardInterrupt):
            populate(request(sample_city, out))
    assert [path.name for path in out.iterdir()] == [WORK_FOLDER]
    summaries = populate(request(sample_city, out))
    assert [summary.up_to_date for summary in summaries] == [True, True, False, False, False]
    assert sorted(path.name for path in out.iterdir()) == PUBLISHED


def test_a_growth_that_was_killed_is_gone_on_with(sample_city, tmp_path, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr("urbanforest_cli.growth.batches.PLANTS_A_PART", 30)
    calls = []

    def stopped(*arguments):
        calls.append(arguments)
        if len(calls) > 40:
            raise KeyboardInterrupt
        return fake.grow_grove(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr("urbanforest_cli.growth.simulate.grow_grove", stopped)
        with pytest.raises(KeyboardInterrupt):
            populate(request(sample_city, out))
    summary = populate(request(sample_city, out))[3]
    assert 0 < summary.counts["groves_reused"] <= 40
    populate(request(sample_city, tmp_path / "whole"))
    parts = [{n: sha for n, sha in hashes_of(path).items() if "part" in n} for path in (out, tmp_path / "whole")]
    assert parts[0] == parts[1]
    assert sorted(path.name for path in out.iterdir()) == PUBLISHED


def test_two_runs_in_one_folder_are_refused(sample_city, tmp_path):
    with folder_lock(tmp_path / "out"), pytest.raises(BusyError):
        populate(request(sample_city, tmp_path / "out"))


def test_output_over_input_is_refused(sample_city, tmp_path):
    for out in (sample_city, sample_city.parent):
        with pytest.raises(OutputExistsError):
            populate(request(sample_city, out))


def test_a_folder_of_other_things_is_refused(sample_city, tmp_path):
    (tmp_path / "map.png").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"map\.png"):
        populate(request(sample_city, tmp_path))
    (tmp_path / "map.png").unlink()
    (tmp_path / "register.gpkg").write_text("mine")
    with pytest.raises(InputError):
        populate(request(sample_city, tmp_path))


def test_too_many_bad_lots_are_told_with_exit_code_3_and_the_rest_is_written(tiny_city, tmp_path):
    lots = pyogrio.read_dataframe(tiny_city, layer="lots")
    lots.loc[0, "geometry"] = None
    pyogrio.write_dataframe(lots, tiny_city, layer="lots", driver="GPKG")
    for _ in range(2):  # a second run that does nothing says so too
        with pytest.raises(PartlyDoneError) as caught:
            populate(request(tiny_city, tmp_path / "out", max_bad_fraction=0))
        assert caught.value.exit_code == 3
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == PUBLISHED
    populate(request(tiny_city, tmp_path / "out"))


def test_the_report_vouches_for_every_output(sample_city, tmp_path):
    populate(request(sample_city, tmp_path / "out"))
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    for item in report["outputs"]:
        path = tmp_path / "out" / item["name"]
        assert sha256_of(path) == item["sha256"]
        assert path.stat().st_size == item["bytes"]


def test_what_a_user_exported_under_the_same_name_stays_until_the_plants_change(sample_city, tmp_path, runner):
    out = tmp_path / "out"
    populate(request(sample_city, out))
    assert runner("export", out, "--to", "glb", "--plain", "--detail", "low", "--prototypes", "5").exit_code == 0
    plain = sha256_of(out / "forest.glb")
    assert all(summary.up_to_date for summary in populate(request(sample_city, out)))
    (out / "map.png").unlink()
    assert not populate(request(sample_city, out))[-1].up_to_date
    assert sha256_of(out / "forest.glb") == plain
    assert all(summary.up_to_date for summary in populate(request(sample_city, out)))
    populate(request(sample_city, out, year=-3))
    assert sha256_of(out / "forest.glb") != plain


def test_export_goes_on_with_the_config_that_populate_last_had(sample_city, tmp_path, runner):
    out = tmp_path / "out"
    populate(request(sample_city, out))
    populate(request(sample_city, out, settings=["export.season=winter", "growth.building_height_m=21.0"]))
    outcome = runner("export", out, "--to", "glb", "--debug")
    assert outcome.exit_code == 0, outcome.stderr
    assert describe_output(out / "forest.glb")["season"] == "winter"
    from urbanforest_cli.commands import options

    config, _ = options.load(None, (), None, out / "register.gpkg")
    assert config.growth.building_height_m == 21.0
    assert config.export.detail == "low"


def test_a_city_without_lots_is_planted_with_nothing_and_said_so(tmp_path):
    city = tmp_path / "empty.geojson"
    city.write_text('{"type": "FeatureCollection", "features": []}')
    summaries = populate(request(city, tmp_path / "out"))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == OUTPUTS[:-1]
    assert "W_NO_VIEW" in summaries[-1].notices
    assert all(summary.up_to_date for summary in populate(request(city, tmp_path / "out")))
    assert "W_EMPTY" in summaries[0].notices


@pytest.mark.usefixtures("_real_growth")
def test_a_small_city_grows_up_for_real(tiny_city, tmp_path):
    summaries = populate(request(tiny_city, tmp_path / "out", settings=["zones.default.age_max_years=6"], workers=2))
    trees = read_layer(tmp_path / "out" / "register.gpkg", "trees")
    assert (trees["grown"] == "unique").mean() > 0.8
    assert summaries[3].counts["internodes_retained"] == trees["internode_count"].sum() > 0


def test_a_register_is_not_taken_for_a_city(sample_city, tmp_path):
    populate(request(sample_city, tmp_path / "out", until="place"))
    with pytest.raises(InputError, match="an output of this program"):
        populate(request(tmp_path / "out" / "register.gpkg", tmp_path / "again"))


def test_a_zone_that_no_lot_is_in_is_told_with_a_suggestion(tiny_city, tmp_path):
    summary = populate(request(tiny_city, tmp_path / "out", until="stencil", settings=["zones.residental.density=0.1"]))
    notice = next(n for n in summary[0].notices if n.code == "W_ZONE_UNUSED")
    assert "did you mean 'residential'?" in notice.examples[0]


def test_stages_by_hand_go_on_with_the_registers_own_seed_and_config(sample_city, tmp_path, runner):
    register = tmp_path / "hand" / "register.gpkg"
    assert runner("stencil", sample_city, "-o", register, "--seed", 5, "--set", "context.passes=2").exit_code == 0
    assert runner("diffuse", register).exit_code == 0
    assert runner("place", register).exit_code == 0
    assert runner("grow", register).exit_code == 0
    outcome = runner(
        "populate", sample_city, "-o", tmp_path / "whole", "--seed", 5, "--set", "context.passes=2", "--until", "grow"
    )
    assert outcome.exit_code == 0, outcome.stderr
    hand, whole = (read_layer(tmp_path / name / "register.gpkg", "trees") for name in ("hand", "whole"))
    pd.testing.assert_frame_equal(hand, whole)
    pd.testing.assert_frame_equal(plants_of(tmp_path / "hand"), plants_of(tmp_path / "whole"))
    again = runner("place", register, "--set", "zones.residential.density=0.9")
    assert "which stay in force" in again.stderr


def test_lots_are_named_by_file_and_layer_as_by_option(tiny_city, tmp_path, runner):
    lots = pyogrio.read_dataframe(tiny_city, layer="lots")
    city = tmp_path / "two.gpkg"
    for name in ("parcels", "districts"):
        pyogrio.write_dataframe(lots, city, layer=name, driver="GPKG", append=False)
    assert runner("populate", city, "-o", tmp_path / "a", "--until", "stencil").exit_code == 2
    assert runner("populate", f"{city}:parcels", "-o", tmp_path / "a", "--until", "stencil").exit_code == 0
    assert runner("populate", city, "--layer", "parcels", "-o", tmp_path / "b", "--until", "stencil").exit_code == 0


def test_plants_that_were_taken_out_by_hand_come_back(sample_city, tmp_path):
    out = tmp_path / "out"
    populate(request(sample_city, out, until="place"))
    before = plants_of(out)
    write_layers(out / "register.gpkg", {"plants": read_layer(out / "register.gpkg", "plants").iloc[::2]})
    assert not populate(request(sample_city, out, until="place"))[-1].up_to_date
    pd.testing.assert_frame_equal(plants_of(out), before)


def test_the_register_of_an_older_version_is_replaced(sample_city, tmp_path):
    out = tmp_path / "out"
    populate(request(sample_city, out, until="place"))
    before = plants_of(out)
    with contextlib.closing(sqlite3.connect(out / "register.gpkg")) as register:
        register.execute("UPDATE provenance SET register_version = register_version - 1")
        register.commit()
    populate(request(sample_city, out, until="place"))
    pd.testing.assert_frame_equal(plants_of(out), before)
