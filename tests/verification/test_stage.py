import contextlib
import fcntl
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing

import numpy as np
import pandas as pd
import pytest
import rasterio
from pyproj import CRS

from tests.verification.conftest import COUNT, DEAD, PART, UTM, trees_frame
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import BusyError, InputError, UrbanForestError
from urbanforest_cli.core.publish import folder_lock
from urbanforest_cli.export.view.stage import png_with
from urbanforest_cli.files.geojson import write_points
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.manifest import Export, describe_files, record_exports
from urbanforest_cli.files.plant_tables import write_plants_gpkg
from urbanforest_cli.verification.stage import verify_outputs
from urbanforest_cli.verification.verdicts import DiffersError, refuse_faults

STANDING = COUNT - len(DEAD)


def write_geojson(out, name="plants.geojson", change=None):
    """Write all plants, after a change to their rows and places."""
    trees = trees_frame()
    xy = np.column_stack([trees.geometry.x, trees.geometry.y])
    frame = pd.DataFrame(trees[["plant_id", "height_m"]]).assign(easting=xy[:, 0], northing=xy[:, 1])
    frame.loc[list(DEAD), "height_m"] = np.nan
    frame = frame if change is None else change(frame)
    degrees = reproject_xy(frame[["easting", "northing"]].to_numpy(), UTM, CRS.from_epsg(4326))
    write_points(out / name, degrees, frame[["plant_id", "height_m"]])


def record(out, name, growth="grown", **values):
    record_exports(out, [Export(name, "any", "k", growth, files=describe_files(out / name), **values)])


@pytest.fixture
def whole(out):
    """A folder in which all is well."""
    write_geojson(out)
    record(out, "plants.geojson")
    return out


def judged(out, name, *files):
    return next(verdict for verdict in verify_outputs(out, files) if verdict.name == name)


def test_a_whole_folder_is_the_same_throughout(whole):
    register, plants = verify_outputs(whole)
    assert (register.name, register.state, register.plants, register.recorded) == (
        "register.gpkg",
        "same",
        COUNT,
        False,
    )
    assert (plants.name, plants.state, plants.plants, plants.recorded) == ("plants.geojson", "same", COUNT, True)
    assert 0 < plants.largest_distance_m < 0.01
    refuse_faults(whole, [register, plants])


def test_an_output_that_says_other_things_differs_even_if_its_hash_is_recorded(whole):
    def spoil(frame):
        frame.loc[5, "easting"] += 0.02
        frame.loc[6, "plant_id"] = "lot 9-6"
        frame.loc[7, "height_m"] += 1
        return pd.concat([frame.drop(index=8), frame.loc[[9, 10]]])

    write_geojson(whole, change=spoil)
    record(whole, "plants.geojson")
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.plants) == ("differs", COUNT + 1)
    assert [fault.split(" (")[0] for fault in verdict.faults] == [
        "2 plants missing",
        "1 plant not in the register",
        "2 plants there more than once",
        "1 plant elsewhere",
        "1 plant of another height",
    ]
    with pytest.raises(DiffersError, match="lot 9-6") as caught:
        refuse_faults(whole, [verdict])
    assert caught.value.exit_code == 2
    assert caught.value.as_record()["outputs"][0]["plants"] == COUNT + 1


def test_a_file_cut_is_told_with_its_bytes_and_is_unreadable(whole):
    path = whole / "plants.geojson"
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[:-100])
    verdict = judged(whole, "plants.geojson")
    assert verdict.state == "changed"
    assert verdict.faults[0] == f"plants.geojson is cut, {size - 100} of {size} bytes"
    assert "not a whole GeoJSON" in verdict.faults[1]


def test_a_byte_flipped_where_it_changes_no_plant_is_a_change_all_the_same(whole):
    path = whole / "plants.geojson"
    path.write_bytes(path.read_bytes().replace(b"FeatureCollection", b"featureCollection"))
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.faults) == ("changed", ("plants.geojson was changed since it was written",))


def test_a_recorded_output_that_is_gone_is_missing(whole):
    (whole / "plants.geojson").unlink()
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.faults) == ("changed", ("plants.geojson is missing",))


def test_an_output_of_an_earlier_growth_is_stale_and_not_compared(whole):
    write_geojson(whole, change=lambda frame: frame.head(3))
    record(whole, "plants.geojson", growth="grown before")
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.plants) == ("stale", None)
    assert verdict.faults == ("shows another growth than the register",)


def test_an_output_of_a_box_is_compared_with_the_plants_in_it(whole):
    box = [500_000, 5_300_000, 500_300, 5_300_600]
    write_geojson(whole, change=lambda frame: frame[frame["easting"] < 500_300])
    record(whole, "plants.geojson", options={"bbox": box})
    verdict = judged(whole, "plants.geojson")
    assert verdict.state == "same"
    assert 0 < verdict.plants < COUNT


def test_a_file_elsewhere_is_compared_without_a_hash(whole, tmp_path):
    write_geojson(tmp_path, "other.geojson", change=lambda frame: frame.drop(index=8))
    (verdict,) = verify_outputs(whole, [tmp_path / "other.geojson"])
    assert (verdict.name, verdict.recorded) == (str(tmp_path / "other.geojson"), False)
    assert verdict.faults == ("1 plant missing (lot 0-8)",)
    (verdict,) = verify_outputs(whole / "register.gpkg", [whole / "plants.geojson"])
    assert (verdict.name, verdict.state, verdict.recorded) == ("plants.geojson", "same", True)
    with pytest.raises(InputError, match="no such output"):
        verify_outputs(whole, [tmp_path / "nowhere.glb"])


def test_an_output_without_plants_is_intact_or_changed(whole):
    (whole / "map.png").write_bytes(b"png")
    record(whole, "map.png")
    assert judged(whole, "map.png").state == "intact"
    (whole / "map.png").write_bytes(b"gnp")
    assert judged(whole, "map.png").state == "changed"


def test_a_torn_manifest_is_a_fault_of_its_own(whole):
    (whole / "exports.json").write_text("{")
    assert judged(whole, "exports.json").faults[0].startswith("exports.json cannot be read")
    assert judged(whole, "plants.geojson").state == "same"


def test_no_register_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="no such register"):
        verify_outputs(tmp_path)


def sql(out, *statements):
    with closing(sqlite3.connect(out / "register.gpkg")) as database, database:
        for statement in statements:
            database.execute(statement)


@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        ("UPDATE gpkg_ogr_contents SET feature_count = 3 WHERE table_name = 'trees'", "'trees': rows 40, cached"),
        ("DELETE FROM rtree_plants_geom WHERE id = 1", "spatial index 39"),
        ("UPDATE skeleton_parts SET bytes = -5", "column 'bytes'"),
        ("UPDATE skeleton_parts SET part = '../../secret'", "names files that are no parts"),
    ],
)  # fmt: skip
def test_a_register_at_odds_with_itself_is_told(whole, statement, fault):
    sql(whole, statement)
    verdict = judged(whole, "register.gpkg")
    assert verdict.state != "same"
    assert fault in " ".join(verdict.faults)


def test_a_tree_that_stands_elsewhere_than_its_plant_is_a_fault_of_the_register(whole):
    frame = trees_frame()
    frame.loc[2, "geometry"] = frame.geometry[3]
    write_layers(whole / "register.gpkg", {"trees": frame})
    assert "other places" in judged(whole, "register.gpkg").faults[0]


def test_a_part_of_skeletons_that_changed_or_is_gone_is_told(whole):
    part = whole / "skeletons" / PART
    content = part.read_bytes()
    part.write_bytes(content[:-1] + b"x")
    assert judged(whole, "register.gpkg").faults == (f"skeletons/{PART} is missing or was changed",)
    part.unlink()
    assert judged(whole, "register.gpkg").faults == (f"skeletons/{PART} is missing or was changed",)


def test_a_register_cut_short_is_unreadable_and_the_others_are_held_against_their_hashes(whole):
    path = whole / "register.gpkg"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    try:
        verdicts = verify_outputs(whole)
    except InputError:  # cut so that it no longer says that it is a register
        return
    assert verdicts[0].state in ("unreadable", "differs")
    assert verdicts[0].faults


def write_canopy(out, *, west=499_990.0, empty_at=None, crs=UTM):
    values = np.zeros((620, 620), dtype=np.float32)
    transform = rasterio.Affine(1, 0, west, 0, -1, 5_300_610)
    trees = trees_frame()
    for x, y, height in zip(trees.geometry.x, trees.geometry.y, trees["height_m"], strict=True):
        row, col = rasterio.transform.rowcol(transform, x, y)
        if 0 <= row < 620 and 0 <= col < 620:
            values[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = height
    if empty_at is not None:
        x, y = trees.geometry.x[empty_at], trees.geometry.y[empty_at]
        row, col = rasterio.transform.rowcol(transform, x, y)
        values[row - 8 : row + 9, col - 8 : col + 9] = 0
    options = {"driver": "GTiff", "width": 620, "height": 620, "count": 1, "dtype": "float32", "transform": transform}
    with rasterio.open(out / "canopy_height.tif", "w", crs=crs.to_wkt() if crs else None, **options) as raster:
        raster.write(values, 1)


def test_a_canopy_with_all_crowns_is_the_same(whole):
    write_canopy(whole)
    verdict = judged(whole, "canopy_height.tif")
    assert (verdict.state, verdict.plants, verdict.faults) == ("same", None, ())


def test_a_canopy_without_a_crown_or_beside_the_city_is_told(whole):
    tall = int(np.argmax(trees_frame()["height_m"]))
    write_canopy(whole, empty_at=tall)
    verdict = judged(whole, "canopy_height.tif")
    assert verdict.state == "differs"
    assert trees_frame()["plant_id"][tall] in verdict.faults[0]
    write_canopy(whole, west=499_990.0 + 300)
    assert "outside the raster" in judged(whole, "canopy_height.tif").faults[0]


def test_the_command_prints_a_table_and_exits_2_where_anything_differs(whole, runner):
    outcome = runner("verify", whole)
    assert outcome.exit_code == 0
    assert f"plants.geojson  any                {COUNT}" in outcome.stdout
    assert runner("verify", whole, "-q").stdout == ""
    assert [item["state"] for item in json.loads(runner("verify", whole, "--json").stdout)["outputs"]] == ["same"] * 2
    (whole / "plants.geojson").unlink()
    outcome = runner("verify", whole)
    assert outcome.exit_code == 2
    assert "plants.geojson is missing" in outcome.stderr
    outcome = runner("verify", whole, "--json")
    assert outcome.exit_code == 2
    assert [item["state"] for item in json.loads(outcome.stdout)["outputs"]] == ["same", "changed"]


def test_what_stands_is_what_exports_hold(whole):
    trees = read_layer(whole / "register.gpkg", "trees")
    assert int((trees["height_m"] > 0).sum()) == STANDING


def asked(out, *files):
    (verdict,) = verify_outputs(out, files)
    return verdict


@pytest.mark.parametrize("name", ["README.md", "plain.json", "bx.gltf", "notes", "other.png"])
def test_a_named_file_that_is_no_output_is_a_fault(whole, tmp_path, name):
    path = tmp_path / name
    path.write_text("{}")
    verdict = asked(whole, path)
    assert (verdict.state, verdict.faults) == ("not checked", ("cannot be checked: no output of urbanforest",))
    with pytest.raises(DiffersError, match="name files that this program wrote"):
        refuse_faults(whole, [verdict])


def test_a_named_picture_that_the_manifest_does_not_name_cannot_be_checked(whole):
    (whole / "map.png").write_bytes(b"png")
    assert "exports.json does not name it" in asked(whole, whole / "map.png").faults[0]
    assert (judged(whole, "map.png").state, judged(whole, "map.png").faults) == ("not checked", ())


def test_skeletons_named_are_held_against_the_register(whole):
    part = whole / "skeletons" / PART
    for name in ("skeletons", f"skeletons/{PART}"):
        assert (asked(whole, whole / name).state, asked(whole, whole / name).faults) == ("intact", ())
    part.write_bytes(part.read_bytes()[:-1] + b"x")
    assert asked(whole, whole / "skeletons").faults == (f"skeletons/{PART} is missing or was changed",)
    assert asked(whole, part).faults == (f"{PART} was changed",)
    other = shutil.copy(part, part.with_name("part-" + "1" * 24 + ".parquet"))
    assert asked(whole, whole / other).faults[0].endswith("is no part that the register names")


def test_the_register_and_the_manifest_can_be_named_too(whole):
    assert asked(whole, whole / "register.gpkg").format == "register"
    assert (asked(whole, whole / "exports.json").format, asked(whole, whole / "exports.json").faults) == (
        "manifest",
        (),
    )


def test_no_spelling_of_a_path_hides_a_change(whole, tmp_path):
    (whole / "map.png").write_bytes(b"png")
    record(whole, "map.png")
    (whole / "map.png").write_bytes(b"gnp")
    link = tmp_path / "link"
    link.symlink_to(whole)
    spellings = (whole / ".." / whole.name / "map.png", link / "map.png", whole / "." / "map.png")
    for path in spellings:
        assert asked(whole, path).state == "changed"
        assert asked(link, path).state == "changed"


def test_a_file_of_an_output_of_many_is_held_against_its_hash(whole):
    for name in ("tileset.json", "content/0.glb"):
        (whole / "tiles" / name).parent.mkdir(parents=True, exist_ok=True)
        (whole / "tiles" / name).write_text(name)
    record(whole, "tiles")
    assert asked(whole, whole / "tiles/content/0.glb").state == "intact"
    (whole / "tiles/content/0.glb").write_text("else")
    assert asked(whole, whole / "tiles/content/0.glb").state == "changed"
    verdict = asked(whole, whole / "tiles/tileset.json")
    assert (verdict.name, verdict.state) == ("tiles", "changed")


def test_a_lost_manifest_is_a_fault_and_pictures_are_told_as_not_checked(whole):
    for name in ("view.png", "report.html"):
        (whole / name).write_bytes(b"old")
    (whole / "sketch.png").write_bytes(png_with(np.zeros((2, 2, 3), np.uint8), {"stage": "render"}))
    (whole / "mine.png").write_bytes(b"of the user")
    (whole / "exports.json").unlink()
    verdicts = {verdict.name: verdict for verdict in verify_outputs(whole)}
    assert verdicts["exports.json"].state == "missing"
    assert "exports.json is missing" in verdicts["exports.json"].faults[0]
    states = {name: (verdict.state, verdict.recorded) for name, verdict in verdicts.items()}
    assert states["view.png"] == states["report.html"] == states["sketch.png"] == ("not checked", False)
    assert states["plants.geojson"] == ("same", False)
    assert "mine.png" not in states
    with pytest.raises(DiffersError) as caught:
        refuse_faults(whole, list(verdicts.values()))
    for command in ("populate`", "export OUT --to geojson`", "render OUT`"):
        assert command in caught.value.next_step


def test_a_folder_with_nothing_but_a_register_needs_no_manifest(out):
    (verdict,) = verify_outputs(out)
    assert (verdict.state, verdict.faults) == ("same", ())


def test_tiles_without_their_tileset_are_told_even_where_no_manifest_names_them(whole):
    (whole / "tiles" / "content").mkdir(parents=True)
    assert judged(whole, "tiles").faults == ("tiles/tileset.json is missing",)
    (whole / "species").mkdir()
    assert "species" not in {verdict.name for verdict in verify_outputs(whole)}, "it may be the user's own"


def box_frame():
    """Plants in the eastern part; one lies on the edge."""
    trees = trees_frame().drop(index=list(DEAD))
    west = sorted(trees.geometry.x)[20]
    return trees[trees.geometry.x >= west], [west, 5_300_000, 500_600, 5_300_600]


@pytest.mark.parametrize("known_by", ["provenance", "manifest"])
def test_an_output_of_a_box_holds_what_lies_in_it_and_on_its_edge(whole, known_by):
    inside, box = box_frame()
    path = whole / "part.gpkg"
    write_plants_gpkg(path, inside.drop(columns=["reason"]), categories=[], provenance={"bbox": box})
    if known_by == "manifest":
        record(whole, "part.gpkg", options={"bbox": box})
    verdict = asked(whole, path)
    assert (verdict.state, verdict.faults, verdict.is_part) == ("same", (), True)
    assert verdict.as_record()["part_of_city"]
    assert verdict.plants == len(inside)


def test_a_plant_outside_the_box_is_told_as_such(whole, tmp_path):
    inside, box = box_frame()
    box[0] += 0.5
    write_plants_gpkg(tmp_path / "p.gpkg", inside.drop(columns=["reason"]), categories=[], provenance={"bbox": box})
    verdict = asked(whole, tmp_path / "p.gpkg")
    assert "dead, or outside its box" in verdict.faults[0]
    with pytest.raises(DiffersError, match="the same -o, --bbox and --detail as before"):
        refuse_faults(whole, [verdict])


@pytest.mark.parametrize("box", [5, True, [[1], 2, 3, 4], [1, 2, 3], [1, 2, 3, True], {"west": 1}, "all"])
def test_a_box_that_is_none_is_a_fault_and_no_traceback(whole, box):
    record(whole, "plants.geojson", options={"bbox": box})
    assert "not four numbers" in judged(whole, "plants.geojson").faults[0]


def provenance(out, **stages):
    frame = read_layer(out / "register.gpkg", "provenance", geometry=False)
    return frame[frame["stage"].isin(stages)]


def test_a_register_of_plants_that_have_not_grown_says_so_and_what_needs_growth_is_stale(whole):
    (whole / "map.png").write_bytes(b"png")
    record(whole, "map.png")
    write_layers(whole / "register.gpkg", {"provenance": provenance(whole, stencil=1, place=1)},
                 drop=["trees", "skeleton_parts"])  # fmt: skip
    trees = trees_frame().drop(index=list(DEAD))
    write_plants_gpkg(whole / "plants.gpkg", trees.drop(columns=["reason"]), categories=[], provenance={})
    verdicts = {verdict.name: verdict for verdict in verify_outputs(whole)}
    assert (verdicts["register.gpkg"].state, verdicts["register.gpkg"].faults) == ("not grown", ())
    assert verdicts["register.gpkg"].plants == COUNT
    for name in ("plants.geojson", "map.png", "plants.gpkg"):
        assert verdicts[name].state == "stale"
        assert "have not grown" in verdicts[name].faults[0]


def test_a_register_without_plants_says_so_and_outputs_beside_it_are_stale(whole):
    names = ["plants", "trees", "skeleton_parts"]
    write_layers(whole / "register.gpkg", {"provenance": provenance(whole, stencil=1)}, drop=names)
    register, plants = verify_outputs(whole)
    assert (register.state, register.plants, register.faults) == ("not planted", 0, ())
    assert (plants.state, plants.faults) == (
        "stale",
        ("shows plants that grew, and the register says that no plants were placed",),
    )


def test_an_output_that_itself_tells_of_another_growth_is_stale(whole, tmp_path):
    trees = trees_frame().drop(index=list(DEAD)).drop(columns=["reason"])
    for keys, state in (({"grow": "grown"}, "same"), ({"grow": "before"}, "stale"), ({}, "stale")):
        write_plants_gpkg(tmp_path / "p.gpkg", trees, categories=[], provenance={"stage_keys": keys})
        assert asked(whole, tmp_path / "p.gpkg").state == state
    picture = png_with(np.zeros((2, 2, 3), np.uint8), {"stage_keys": {"grow": "before"}})
    (whole / "view.png").write_bytes(picture)
    assert judged(whole, "view.png").state == "stale"


@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        ("UPDATE trees SET dbh_m = dbh_m + 0.01 WHERE rowid = 2", "of another diameter"),
        ("UPDATE trees SET crown_base_m = 0.1 WHERE rowid = 2", "of another crown base"),
        ("UPDATE trees SET crown_radius_m = 9 WHERE rowid = 2", "of another crown radius"),
    ],
)
def test_sizes_changed_in_the_register_are_seen_in_the_outputs(whole, statement, fault):
    trees = trees_frame().drop(index=list(DEAD)).drop(columns=["reason"])
    write_plants_gpkg(whole / "plants.gpkg", trees, categories=[], provenance={})
    assert judged(whole, "plants.gpkg").faults == ()
    sql(whole, *triggers_dropped(whole), statement)
    assert fault in judged(whole, "plants.gpkg").faults[0]


def triggers_dropped(out):
    with closing(sqlite3.connect(out / "register.gpkg")) as database:
        names = database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
    return [f'DROP TRIGGER "{name}"' for (name,) in names]


def test_a_species_changed_in_one_layer_of_the_register_is_told(whole):
    sql(whole, *triggers_dropped(whole), "UPDATE trees SET species = 'acer_rubrum' WHERE rowid = 2")
    assert "other species" in judged(whole, "register.gpkg").faults[0]


def test_trees_of_an_earlier_planting_are_told(whole):
    sql(whole, "UPDATE provenance SET stage_key = 'placed again' WHERE stage = 'place'")
    assert "other plants than those placed last" in judged(whole, "register.gpkg").faults[0]


def test_a_dead_plant_that_is_given_a_height_is_told(whole):
    def revive(frame):
        frame.loc[DEAD[0], "height_m"] = 5.0
        return frame

    write_geojson(whole, change=revive)
    record(whole, "plants.geojson")
    assert judged(whole, "plants.geojson").faults == ("1 plant with a height though nothing stands there (lot 3-3)",)


def test_no_heights_at_all_are_a_fault(whole):
    write_geojson(whole, change=lambda frame: frame.assign(height_m=np.nan))
    record(whole, "plants.geojson")
    assert judged(whole, "plants.geojson").faults == ("states no heights",)


def test_a_folder_that_a_run_writes_to_is_busy(whole, runner):
    with folder_lock(whole):
        with pytest.raises(BusyError, match="a run is writing here"):
            verify_outputs(whole)
        assert runner("verify", whole).exit_code == 75
    assert runner("verify", whole).exit_code == 0


def test_two_may_verify_at_once_and_a_run_waits_for_them(whole):
    descriptor = os.open(whole, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_SH)
    try:
        assert verify_outputs(whole)[0].state == "same"
        with pytest.raises(BusyError), folder_lock(whole):
            pass
    finally:
        os.close(descriptor)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can take on another user's rights")
def test_a_folder_that_may_not_be_written_is_verified_and_stays_as_it_is(whole):
    for path in (whole, *whole.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = {path: path.stat().st_mtime_ns for path in (whole, *whole.rglob("*"))}
    for parent in whole.parents[:3]:
        parent.chmod(0o755)
    code = (
        "import os, sys; from pathlib import Path; from urbanforest_cli.verification.stage import verify_outputs\n"
        "os.setuid(65534); out = Path(sys.argv[1]); assert not os.access(out, os.W_OK)\n"
        "print([v.state for v in verify_outputs(out)])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(whole)], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "['same', 'same']", done.stderr
    assert {path: path.stat().st_mtime_ns for path in (whole, *whole.rglob("*"))} == before


def test_a_file_system_without_locks_is_no_hindrance(whole, monkeypatch):
    def refuse(*_):
        raise OSError("no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert verify_outputs(whole)[0].state == "same"


def test_the_next_step_names_what_writes_the_faulty_output(whole):
    for name, format_ in (("map.png", "export"), ("street.png", "render"), ("itree.csv", "itree")):
        (whole / name).write_bytes(b"one")
        record_exports(whole, [Export(name, format_, "k", "grown", files=describe_files(whole / name))])
    steps = {"map.png": "`urbanforest populate`", "street.png": "`urbanforest render OUT`",
             "itree.csv": "`urbanforest export OUT --to itree`"}  # fmt: skip
    for name, step in steps.items():
        (whole / name).write_bytes(b"two")
        with pytest.raises(DiffersError) as caught:
            refuse_faults(whole, [judged(whole, name)])
        assert step in caught.value.next_step
        assert not any(other in caught.value.next_step for key, other in steps.items() if key != name)


def test_a_manifest_that_was_torn_stays_a_fault_until_all_outputs_are_named_again(whole):
    (whole / "map.png").write_bytes(b"png")
    record(whole, "map.png")
    (whole / "exports.json").write_text("{")
    record(whole, "plants.geojson")
    assert "no longer names map.png" in judged(whole, "exports.json").faults[0]
    record(whole, "map.png")
    assert "exports.json" not in {verdict.name for verdict in verify_outputs(whole)}


def test_bytes_flipped_anywhere_in_a_register_are_no_fault_of_the_program(whole):
    path = whole / "register.gpkg"
    content = path.read_bytes()
    text = content.index(b"stencilled")
    places = [text, text - 10, *np.random.default_rng(3).integers(0, len(content), 25).tolist()]
    for place in places:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        with contextlib.suppress(UrbanForestError):
            verify_outputs(whole)


def test_the_table_tells_parts(whole, runner):
    inside, box = box_frame()
    write_plants_gpkg(whole / "part.gpkg", inside.drop(columns=["reason"]), categories=[], provenance={"bbox": box})
    assert "same, part of the city, not in exports.json" in runner("verify", whole, whole / "part.gpkg").stdout
