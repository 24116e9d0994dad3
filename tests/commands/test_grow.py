import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.skeleton import measure
from urbanforest_cli.files.skeletons import read_parts, read_provenance, read_texts

LIME = ("grow", "--one", "tilia_cordata", "--age", "12")


def test_one_plant_is_told_in_words_and_written_as_a_skeleton(runner, tmp_path):
    path = tmp_path / "lime.parquet"
    outcome = runner(*LIME, "--seed", 3, "-o", path)
    assert outcome.exit_code == 0, outcome.stderr
    assert "Tilia cordata (small-leaved lime), 12 years:" in outcome.stdout
    assert f"Wrote {path}" in outcome.stdout
    skeletons = read_parts(path)
    skeletons.check()
    sizes = measure(skeletons)
    assert f"{sizes['height_m'][0]:.1f} m high" in outcome.stdout
    assert f"{sizes['internode_count'][0]:,} internodes" in outcome.stdout
    record = read_provenance(path)
    assert (record["species"], record["age_years"], record["seed"]) == ("tilia_cordata", 12.0, 3)
    assert record["height_m"] == pytest.approx(sizes["height_m"][0], abs=1e-3)
    table = pd.read_parquet(path)
    assert table["z_5mm"].max() * 0.005 == pytest.approx(sizes["height_m"][0], abs=1e-6)


def test_json_tells_the_sizes(runner):
    outcome = runner(*LIME, "--json")
    counts = json.loads(outcome.stdout)["counts"]
    assert counts["outcome"] == "grown"
    assert {"height_m", "crown_radius_m", "crown_base_m", "dbh_m", "internode_count"} <= set(counts)
    assert counts["height_m"] > 2


def test_neighbours_and_walls_are_grown_beside_and_remembered(runner, tmp_path):
    path = tmp_path / "pair.parquet"
    outcome = runner(
        *LIME, "--wall", "2.5@180x9", "--neighbour", "Norway maple @ 4, 90, 8", "--latitude", -35, "-o", path
    )
    assert outcome.exit_code == 0, outcome.stderr
    assert "Acer platanoides (Norway maple), 8 years" in outcome.stdout
    assert read_texts(path, "plant_id") == {0: "one", 1: "neighbour-1"}
    assert read_texts(path, "species") == {0: "tilia_cordata", 1: "acer_platanoides"}
    record = read_provenance(path)
    assert record["walls"] == "2.5@180x9"
    assert record["latitude_deg"] == -35
    assert [plant["x_m"] for plant in record["plants"]] == [0, 4]


def test_a_picture_tells_what_it_shows(runner, tmp_path):
    path = tmp_path / "hazel.png"
    outcome = runner("grow", "--one", "corylus_avellana", "--age", 4, "--wall", "2@270x2", "-o", path)
    assert outcome.exit_code == 0, outcome.stderr
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
        assert json.loads(picture.info["urbanforest"])["species"] == "corylus_avellana"
    green = (pixels[..., 1] > pixels[..., 0] + 12) & (pixels[..., 1] > pixels[..., 2] + 12)
    assert 0.05 < green.mean() < 0.9
    assert runner("info", path).exit_code == 0


def test_the_same_command_writes_the_same_bytes(runner, tmp_path):
    for name in ("a", "b"):
        runner(*LIME, "-o", tmp_path / f"{name}.parquet")
    assert sha256_of(tmp_path / "a.parquet") == sha256_of(tmp_path / "b.parquet")


def test_what_is_there_is_replaced_only_when_asked(runner, tmp_path):
    path = tmp_path / "lime.parquet"
    path.write_text("mine")
    refused = runner(*LIME, "-o", path)
    assert refused.exit_code == 2
    assert "--overwrite" in refused.stderr
    assert path.read_text() == "mine"
    assert runner(*LIME, "-o", path, "--overwrite").exit_code == 0
    assert len(read_parts(path)) == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["grow"], "Name a REGISTER, or a species with --one"),
        (["grow", "--one", "tilia_cordata"], "--age YEARS"),
        (["grow", "x.gpkg", "--one", "tilia_cordata", "--age", "3"], "leave REGISTER out"),
        (["grow", "x.gpkg", "--age", "0"], "--age goes with --one"),
        (["grow", "x.gpkg", "-o", "t.parquet"], "-o goes with --one"),
        (["grow", "x.gpkg", "--wall", "3@90"], "--wall goes with --one"),
        ([*LIME, "--detail", "library"], "--detail goes with a REGISTER"),
        ([*LIME, "--year", "0"], "--year goes with a REGISTER"),
        ([*LIME, "--wall", "3"], "3@180x12"),
        ([*LIME, "--wall", "3@90x"], "no wall"),
        ([*LIME, "--neighbour", "oak@3"], "no neighbour"),
        ([*LIME, "--age", "-2"], "0 to 250"),
        ([*LIME, "--age", "old"], "not a valid float"),
        (["grow", "--one", "tilia_cordta", "--age", "3"], "did you mean 'tilia_cordata'"),
        ([*LIME, "-o", "tree.obj"], "ends with .parquet"),
        (["grow", "x.gpkg", "--year", "3", "--only", "1"], "--only says how to grow"),
        (["grow", "x.gpkg", "--year", "-3", "--bbox", "0", "0", "1", "1"], "--bbox says how to grow"),
        (["grow", "x.gpkg", "--year", "0", "--environment", "shadow"], "--environment says how to grow"),
        (["grow", "x.gpkg", "--year", "3", "--detail", "library"], "--detail says how to grow"),
        (["grow", "nowhere.gpkg"], "no such register"),
    ],
)
def test_mistakes_are_told_plainly_with_exit_code_2(runner, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    outcome = runner(*arguments)
    assert outcome.exit_code == 2
    assert told in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert list(tmp_path.iterdir()) == []


def test_options_of_the_register_mode_that_make_sense_hold_for_one_plant_too(runner):
    heights = [json.loads(runner(*LIME, *more, "--json").stdout)["counts"]["height_m"] for more in (
        [], ["--environment", "shadow"], ["--set", "growth.environment=shadow"])]  # fmt: skip
    assert heights[0] != heights[1] == heights[2]


def test_info_tells_of_a_skeleton_file(runner, tmp_path):
    path = tmp_path / "lime.parquet"
    runner(*LIME, "-o", path)
    record = json.loads(runner("info", path, "--json").stdout)
    assert record["skeletons"] == 1
    assert record["species"] == {"tilia_cordata": 1}
    assert record["internodes"] > record["lost_internodes"]
    assert record["provenance"]["height_m"] > 2
    (tmp_path / "torn.parquet").write_bytes(path.read_bytes()[:-50])
    outcome = runner("info", tmp_path / "torn.parquet")
    assert outcome.exit_code == 2
    assert "urbanforest grow" in outcome.stderr
