"""The command as a user types it, on a small city that has grown."""

import errno
import json
import shutil
from pathlib import Path

import pytest

from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.gltf_reader import read_plants, read_provenance
from urbanforest_cli.files.manifest import faults_of, read_manifest

ALL = "glb,3dtiles,cityjson,obj,geojson,gpkg,geoparquet,itree,canopy"


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    from urbanforest_cli.files.configs import load_config
    from urbanforest_cli.pipeline import Request, populate
    from urbanforest_cli.synth.stage import make_city

    folder = tmp_path_factory.mktemp("export")
    make_city(folder / "city.gpkg", lot_count=12, seed=4)
    config = load_config(settings=["zones.default.age_max_years=8.0"], environment={}).config
    populate(Request(city=folder / "city.gpkg", out=folder / "out", config=config, seed=1, until="grow"))
    return folder / "out"


@pytest.fixture
def out(grown, tmp_path):
    return shutil.copytree(grown, tmp_path / "out")


def test_every_format_is_written_and_named_in_the_manifest(out, runner):
    outcome = runner("export", out, "--to", ALL, "--json")
    assert outcome.exit_code == 0, outcome.stderr
    exports = read_manifest(out)
    assert set(exports) == {
        "forest.glb", "tiles", "forest.city.json", "species", "plants.geojson", "plants.gpkg", "plants.parquet",
        "itree.csv", "canopy_height.tif", "canopy_cover.tif",
    }  # fmt: skip
    assert not [fault for export in exports.values() for fault in faults_of(out, export)]
    told = json.loads(outcome.stdout)
    assert [item["stage"] for item in told] == ALL.split(",")
    standing = read_layer(out / "register.gpkg", "trees")["grown"].isin(["unique", "library"]).sum()
    assert {item["counts"]["plants"] for item in told} == {standing}
    assert len(read_plants(out / "forest.glb")) == standing
    assert told[0]["counts"]["bytes"] == (out / "forest.glb").stat().st_size


@pytest.mark.slow
def test_equal_inputs_are_equal_bytes_in_every_format(out, runner, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for _ in range(2):
        assert runner("export", out, "--to", ALL).exit_code == 0
        files = {name: state for item in read_manifest(out).values() for name, state in item.files.items()}
        if _ == 0:
            before = files
    assert files == before


def test_a_box_holds_the_plants_in_it(out, runner):
    trees = read_layer(out / "register.gpkg", "trees")
    west, south, _, _ = trees.total_bounds
    east, north = trees.geometry.x.median(), trees.geometry.y.median()
    outcome = runner("export", out, "--to", "glb,geojson", "--bbox", west, south, east, north)
    assert outcome.exit_code == 0, outcome.stderr
    inside = (trees.geometry.x <= east) & (trees.geometry.y <= north) & trees["grown"].isin(["unique", "library"])
    assert sorted(read_plants(out / "forest.glb").plant_id) == sorted(trees["plant_id"][inside])
    assert read_manifest(out)["forest.glb"].options["bbox"] == [west, south, east, north]


def test_a_box_beside_the_city_is_refused_with_where_it_lies(out, runner):
    outcome = runner("export", out, "--to", "glb", "--bbox", 0, 0, 1, 1)
    assert outcome.exit_code == 2
    assert "--bbox" in outcome.stderr
    assert "within" in outcome.stderr
    assert not (out / "forest.glb").exists()


def test_prototypes_are_at_most_as_many_as_asked_for(out, runner):
    few = json.loads(runner("export", out, "--to", "glb", "--prototypes", "6", "--json").stdout)["counts"]
    every = json.loads(runner("export", out, "--to", "glb", "--prototypes", "all", "--json").stdout)["counts"]
    assert few["shapes"] <= max(6, len(read_layer(out / "register.gpkg", "trees")["species"].unique()))
    assert every["shapes"] > few["shapes"]
    assert every["outline_error_worst_tenth"] == 0.0 < few["outline_error_worst_tenth"]
    assert read_provenance(out / "forest.glb")["prototypes"]["own_shape_fraction"] == 1.0


def test_plain_is_larger_and_has_no_extension(out, runner):
    assert runner("export", out, "--to", "glb", "--plain", "-o", out / "plain.glb").exit_code == 0
    content = (out / "plain.glb").read_bytes()
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert "extensionsUsed" not in document
    assert len(read_plants(out / "plain.glb")) > 0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--to", "fbx,glb,gltf"], "'fbx', 'gltf'"),
        (["--to", "glb", "--bbox", 5, 0, 1, 2], "west south east north"),
        (["--to", "obj", "--detail", "point"], "points have no shapes"),
        (["--to", "glb,gpkg", "-o", "x.glb"], "one format"),
        (["--to", "gpkg", "--plain"], "--plain"),
        (["--to", "glb", "--prototypes", "0"], "above 0"),
        (["--to", "canopy", "-o", "x.tif"], "two files"),
        ([], "--to"),
    ],
)
def test_what_makes_no_sense_is_refused(out, runner, arguments, told):
    outcome = runner("export", out, *arguments)
    assert outcome.exit_code == 2
    assert told in outcome.stderr


def test_the_register_itself_and_folders_are_not_replaced_by_files(out, runner):
    for path in (out / "register.gpkg", out / "skeletons"):
        before = path.stat().st_mtime_ns
        assert runner("export", out, "--to", "glb", "-o", path).exit_code == 2
        assert path.stat().st_mtime_ns == before


@pytest.mark.parametrize("form", ["3dtiles", "obj"])
def test_a_folder_of_other_things_is_never_replaced(out, runner, tmp_path, form):
    kept = tmp_path / "kept"
    (kept / "sub").mkdir(parents=True)
    (kept / "sub" / "thesis.txt").write_text("precious")
    for folder in (kept, out, tmp_path):
        outcome = runner("export", out, "--to", form, "-o", folder)
        assert outcome.exit_code == 2
        assert "would be lost" in outcome.stderr
    assert (kept / "sub" / "thesis.txt").read_text() == "precious"
    assert runner("export", out, "--to", form, "-o", tmp_path / "new").exit_code == 0
    assert runner("export", out, "--to", form, "-o", tmp_path / "new").exit_code == 0
    (tmp_path / "new" / "notes.txt").write_text("mine")
    assert runner("export", out, "--to", form, "-o", tmp_path / "new").exit_code == 2


def test_files_of_others_are_never_replaced(out, runner, tmp_path):
    own = tmp_path / "city.gpkg"
    shutil.copy("data_samples/sample_city.gpkg", own)
    before = own.read_bytes()
    assert runner("export", out, "--to", "gpkg", "-o", own).exit_code == 2
    assert own.read_bytes() == before
    for form, name in (("cityjson", "exports.json"), ("glb", "forest.gltf"), ("gpkg", "register.gpkg")):
        outcome = runner("export", out, "--to", form, "-o", out / name)
        assert outcome.exit_code == 2, name
        assert "-o" in outcome.stderr
    for _ in range(2):
        assert runner("export", out, "--to", "gpkg", "-o", tmp_path / "again.gpkg").exit_code == 0
    assert runner("export", out, "--to", "gpkg").exit_code == 0
    (out / "plants.gpkg").write_bytes(b"cut")
    assert runner("export", out, "--to", "gpkg").exit_code == 0


def test_a_part_that_takes_the_place_of_the_whole_is_told(out, runner):
    box = read_layer(out / "register.gpkg", "trees").total_bounds
    assert "W_PART" not in runner("export", out, "--to", "gpkg", "--json").stdout
    assert "W_PART" in runner("export", out, "--to", "gpkg", "--json", "--bbox", *box).stdout


def test_a_city_is_not_taken_for_a_register_of_another_version(runner):
    outcome = runner("export", "data_samples/sample_city.gpkg", "--to", "glb")
    assert outcome.exit_code == 2
    assert "a city, not a register" in outcome.stderr
    assert "urbanforest populate" in outcome.stderr
    assert runner("info", "data_samples/sample_city.gpkg").exit_code == 0


def test_a_full_disk_is_told_as_such_and_leaves_the_old_raster(out, runner, monkeypatch):
    assert runner("export", out, "--to", "canopy").exit_code == 0
    before = (out / "canopy_height.tif").read_bytes()

    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert runner("export", out, "--to", "canopy", "--cell", "2").exit_code == 74
    assert (out / "canopy_height.tif").read_bytes() == before


def test_plants_that_have_not_grown_are_told_with_the_command(tmp_path, tiny_city, runner):
    assert runner("populate", tiny_city, "-o", tmp_path / "out", "--until", "place").exit_code == 0
    outcome = runner("export", tmp_path / "out", "--to", "glb")
    assert outcome.exit_code == 2
    assert "urbanforest grow" in outcome.stderr


def test_a_folder_without_a_register_is_told(tmp_path, runner):
    outcome = runner("export", tmp_path, "--to", "glb")
    assert outcome.exit_code == 2
    assert "populate" in outcome.stderr
