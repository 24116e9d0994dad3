"""`evaluate-coverage` as a user calls it: a model that is one line of arithmetic, pairs and maps made here."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from PIL import Image
from shapely.geometry import Point, box

from urbanforest_cli.core.coverage_model import CoverageModelInfo
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.onnx_bytes import sealed
from urbanforest_cli.imagery.pairing.stage import read_pairs

WEST, NORTH, PIXEL_M = 500_000.0, 5_300_000.0, 0.6
SIDE = 64


def about(**more: object) -> CoverageModelInfo:
    return CoverageModelInfo(
        classes=("canopy",), resolution_m=0.6, multiple_px=4, halo_px=4, channel_mean=(0.0, 0.0, 0.0),
        channel_scale=(1.0, 1.0, 1.0), thresholds=(0.5,), preset="small", program_version="0", **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """Return a model that calls vegetation what is green enough, pixel by pixel."""
    onnx = pytest.importorskip("onnx")
    helper, floats = onnx.helper, onnx.TensorProto.FLOAT
    weight = np.array([[-0.1, 0.2, -0.1]], np.float32).reshape(1, 3, 1, 1)
    nodes = [helper.make_node("Conv", ["image", "weight", "bias"], ["raw"]),
             helper.make_node("Sigmoid", ["raw"], ["coverage"])]  # fmt: skip
    graph = helper.make_graph(
        nodes, "graph", [helper.make_tensor_value_info("image", floats, ["batch", 3, "rows", "columns"])],
        [helper.make_tensor_value_info("coverage", floats, ["batch", 1, "rows", "columns"])],
        [onnx.numpy_helper.from_array(weight, "weight"),
         onnx.numpy_helper.from_array(np.array([-3], np.float32), "bias")],
    )  # fmt: skip
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path = tmp_path_factory.mktemp("model") / "green.onnx"
    path.write_bytes(sealed(made.SerializeToString(), about().as_metadata()))
    return path


def write_tif(path: Path, values: np.ndarray, west: float, *, pixel_m: float = PIXEL_M, nodata=None) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    layers = values if values.ndim == 3 else values[None]
    with rasterio.open(
        path, "w", driver="GTiff", height=layers.shape[1], width=layers.shape[2], count=len(layers), dtype=values.dtype,
        crs="EPSG:32633", transform=rasterio.Affine(pixel_m, 0, west, 0, -pixel_m, NORTH), nodata=nodata,
    ) as file:  # fmt: skip
        file.write(layers)
    return path


@pytest.fixture
def pairs(tmp_path: Path) -> Path:
    """Two cities of four images; the lowest rows of each are dead grass, which no colour tells from paving."""
    rng = np.random.default_rng(0)
    for city, west in (("north", WEST), ("south", WEST + 10_000)):
        for number in range(4):
            rgb = np.full((3, SIDE, SIDE), 120.0) + rng.normal(0, 4, (1, SIDE, SIDE))
            mask = np.zeros((SIDE, SIDE), np.uint8)
            mask[8 : 24 + 4 * number, 8:40] = 255
            rgb[:, mask > 0] = np.array([[80.0], [140.0], [70.0]]) * rng.uniform(0.6, 1.3, (mask > 0).sum())
            mask[-6:] = 255
            values = np.clip(np.round(rgb), 0, 255).astype(np.uint8)
            write_tif(tmp_path / "pairs" / "images" / f"{city}_{number}.tif", values, west + 100 * number)
            write_tif(tmp_path / "pairs" / "masks" / f"{city}_{number}.tif", mask, west + 100 * number)
    return tmp_path / "pairs"


def judged(runner, *arguments: object) -> dict:
    outcome = runner("evaluate-coverage", *arguments, "--json", "-q")
    assert outcome.exit_code == 0, outcome.stderr
    return json.loads(outcome.stdout)


def test_a_model_is_scored_as_counted_by_hand(runner, pairs, model):
    record = judged(runner, pairs, "-m", model)
    found = record["judgement"]["total"]["canopy"]
    green = sum(32 * (16 + 4 * number) for number in range(4)) * 2
    dead = 8 * 6 * SIDE
    assert found["scores"]["green.onnx"]["iou"] == pytest.approx(green / (green + dead), abs=0.003)
    assert found["scores"]["green.onnx"]["bias"] == pytest.approx(-dead / (8 * SIDE * SIDE), abs=0.003)
    assert found["scores"]["all covered"]["iou"] == pytest.approx((green + dead) / (8 * SIDE * SIDE))
    assert (found["tiles"], found["places"]) == (8, 8)
    assert sorted(record["judgement"]["groups"]) == ["north", "south"]
    assert [row["name"] for row in record["judgement"]["tiles"]] == [
        f"{city}_{n}" for city in ("north", "south") for n in range(4)
    ]
    assert record["about"]["thresholds"] == {"canopy": 0.5}
    assert record["about"]["model"]["sha256"]


def test_baselines_are_fitted_to_one_city_and_judged_on_the_other(runner, pairs, model):
    pytest.importorskip("sklearn")
    record = judged(runner, pairs, "-m", model, "--train", "north", "--workers", "2")
    total = record["judgement"]["total"]["canopy"]
    assert list(total["scores"]) == ["green.onnx", "all covered", "excess green", "boosted pixels"]
    assert list(record["judgement"]["groups"]) == ["south"]
    assert record["about"]["baselines_learnt_from"] == 4
    assert total["scores"]["excess green"]["iou"] > total["scores"]["all covered"]["iou"] + 0.1
    assert [row["against"] for row in total["differences"]] == ["all covered", "excess green", "boosted pixels"]
    assert judged(runner, pairs, "-m", model, "--train", "north", "--workers", "1")["judgement"] == record["judgement"]


def test_baselines_learn_from_another_folder_less_what_is_judged(runner, pairs, model, tmp_path):
    more = tmp_path / "more"
    shutil.copytree(pairs, more)
    for number in range(2):  # another image of a judged place
        for kind in ("images", "masks"):
            with rasterio.open(pairs / kind / f"south_{number}.tif") as file:
                write_tif(more / kind / f"later_{number}.tif", file.read()[:, ::-1], WEST + 10_000 + 100 * number)
    (more / "images" / "south_3.tif").unlink()
    record = judged(runner, pairs, "-m", model, "--train", more, "--group", "south")
    assert record["about"]["baselines_learnt_from"] == 4
    assert record["counts"]["tiles"] == 4
    assert [(one["code"], one["count"]) for one in record["warnings"]] == [("W_TRAINING_PLACES", 5)]


def test_baselines_learn_from_the_rest_of_the_same_folder(runner, pairs, model):
    record = judged(runner, pairs, "-m", model, "--train", pairs, "--group", "south_[01]")
    assert (record["about"]["baselines_learnt_from"], record["counts"]["tiles"]) == (6, 2)
    refused = runner("evaluate-coverage", pairs, "-m", model, "--train", pairs)
    assert refused.exit_code == 2
    assert "nothing to learn from" in refused.stderr
    assert "no pair fits" in runner("evaluate-coverage", pairs, "-m", model, "--train", "").stderr


def test_an_image_that_lies_nowhere_is_known_by_its_pixels(runner, pairs, model, tmp_path):
    bare = tmp_path / "bare"
    for kind in ("images", "masks"):
        (bare / kind).mkdir(parents=True)
        for name in ("north_0", "south_0", "south_1"):
            with rasterio.open(pairs / kind / f"{name}.tif") as file:
                Image.fromarray(np.squeeze(np.moveaxis(file.read(), 0, -1))).save(bare / kind / f"copy_of_{name}.png")
    record = judged(runner, pairs, "-m", model, "--train", bare, "--group", "south")
    assert record["about"]["baselines_learnt_from"] == 1


def test_without_scikit_learn_the_other_baselines_stay_and_its_install_is_named(runner, pairs, model, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    outcome = runner("evaluate-coverage", pairs, "-m", model, "--train", "north", "--json")
    record = json.loads(outcome.stdout)
    assert record["judgement"]["predictors"] == ["green.onnx", "all covered", "excess green"]
    assert "pip install 'urbanforest[train]'" in record["warnings"][-1]["message"]


def test_pairs_that_the_model_has_seen_are_counted(runner, pairs, model, tmp_path):
    notices = Notices()
    data = {"fingerprint": read_pairs(pairs, notices=notices).fingerprint, "hold_out": ["south"]}
    path = tmp_path / "seen.onnx"
    path.write_bytes(sealed(model.read_bytes(), about(training={"data": data}).as_metadata()))
    warnings = {row["code"]: row["count"] for row in judged(runner, pairs, "-m", path)["warnings"]}
    assert warnings == {"W_SEEN_IN_TRAINING": 4}
    assert judged(runner, pairs, "-m", path, "--group", "south")["warnings"] == []


def test_images_that_the_model_has_seen_are_known_whatever_the_options(runner, pairs, model, tmp_path):
    read = read_pairs(pairs, notices=Notices())
    data = {"fingerprint": "another", "image_hashes": [read.content(index) for index in (0, 2, 5)]}
    path = tmp_path / "seen.onnx"
    path.write_bytes(sealed(model.read_bytes(), about(training={"data": data}).as_metadata()))
    shutil.copy(pairs / "images" / "north_0.tif", pairs / "images" / "copy.tif")
    shutil.copy(pairs / "masks" / "north_0.tif", pairs / "masks" / "copy.tif")
    for more in ([], ["--classes", "canopy"], ["--assume-crs", "EPSG:32633"]):
        warnings = {row["code"]: row["count"] for row in judged(runner, pairs, "-m", path, *more)["warnings"]}
        assert warnings == {"W_SEEN_IN_TRAINING": 4}


def test_the_table_names_predictors_groups_and_the_worst_tiles(runner, pairs, model):
    outcome = runner("evaluate-coverage", pairs, "-m", model)
    assert outcome.exit_code == 0, outcome.stderr
    for text in ("canopy: 8 tiles of 8 places", "green.onnx", "all covered", "canopy by group", "north", "worst tiles",
                 "green.onnx less all covered: IoU +"):  # fmt: skip
        assert text in outcome.stdout
    assert "north_3" not in outcome.stdout
    assert "north_3" in runner("evaluate-coverage", pairs, "-m", model, "-v").stdout
    assert runner("evaluate-coverage", pairs, "-m", model, "-q").stdout == ""


def test_the_page_is_a_picture_and_nothing_else_is_written_over(runner, pairs, model, tmp_path):
    page = tmp_path / "page.png"
    page.write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    record = judged(runner, pairs, "-m", model, "--plot", page)
    assert record["output"] == str(page)
    with Image.open(page) as picture:
        assert picture.width > 1000
    (tmp_path / "notes.png").write_text("mine", encoding="utf-8")
    outcome = runner("evaluate-coverage", pairs, "-m", model, "--plot", tmp_path / "notes.png")
    assert outcome.exit_code == 2
    assert (tmp_path / "notes.png").read_text(encoding="utf-8") == "mine"
    assert runner("evaluate-coverage", pairs, "-m", model, "--plot", tmp_path / "page.jpg").exit_code == 2


def test_a_map_is_held_against_a_mask_finer_than_itself(runner, tmp_path):
    found = np.zeros((300, 300), np.uint8)
    found[:, :150] = 80
    fine = np.zeros((600, 600), np.uint8)
    fine[:300, :300] = 255
    path = write_tif(tmp_path / "map.tif", found, WEST)
    truth = write_tif(tmp_path / "truth.tif", fine, WEST, pixel_m=PIXEL_M / 2)
    record = judged(runner, path, "--truth", truth)
    score = record["judgement"]["total"]["canopy"]["scores"]["map.tif"]
    assert (score["iou"], score["recall"], score["bias"]) == pytest.approx((0.5, 1.0, 0.25), abs=0.01)
    assert record["judgement"]["total"]["canopy"]["scores"]["all covered"]["iou"] == pytest.approx(0.25, abs=0.01)
    assert (
        judged(runner, path, "--truth", truth, "--threshold", "0.9")["judgement"]["total"]["canopy"]["scores"][
            "map.tif"
        ]["recall"]
        == 0
    )


def test_a_map_is_held_against_polygons_and_trees(runner, tmp_path):
    found = np.zeros((100, 100), np.uint8)
    found[:50] = 100
    path = write_tif(tmp_path / "map.tif", found, WEST)
    gpd.GeoDataFrame(geometry=[box(WEST, NORTH - 30, WEST + 60, NORTH)], crs=32633).to_file(
        tmp_path / "truth.gpkg", layer="canopy"
    )
    trees = [Point(WEST + 5, NORTH - 5), Point(WEST + 50, NORTH - 50), Point(WEST + 30, NORTH - 29)]
    gpd.GeoDataFrame(geometry=trees, crs=32633).to_crs(4326).to_file(tmp_path / "trees.geojson")
    page = tmp_path / "page.png"
    record = judged(runner, path, "--truth", f"{tmp_path / 'truth.gpkg'}:canopy", "--trees", tmp_path / "trees.geojson",
                    "--plot", page)  # fmt: skip
    total = record["judgement"]["total"]["canopy"]
    assert total["scores"]["map.tif"]["iou"] == 1
    assert total["scores"]["map.tif"]["trees_on"] == total["truth_trees_on"] == pytest.approx(2 / 3)
    assert page.exists()


def test_map_and_truth_of_different_places_or_classes_are_refused(runner, tmp_path):
    path = write_tif(tmp_path / "map.tif", np.full((50, 50), 100, np.uint8), WEST)
    away = write_tif(tmp_path / "away.tif", np.full((50, 50), 100, np.uint8), WEST + 5000)
    outcome = runner("evaluate-coverage", path, "--truth", away)
    assert (outcome.exit_code, "share no known pixel" in outcome.stderr) == (2, True)
    gpd.GeoDataFrame(geometry=[box(WEST, NORTH - 30, WEST + 30, NORTH)], crs=32633).to_file(tmp_path / "t.gpkg")
    outcome = runner("evaluate-coverage", path, "--truth", tmp_path / "t.gpkg", "--classes", "vegetation")
    assert (outcome.exit_code, "no class in common" in outcome.stderr) == (2, True)


def test_what_belongs_to_the_other_kind_is_refused(runner, pairs, tmp_path):
    path = write_tif(tmp_path / "map.tif", np.full((50, 50), 100, np.uint8), WEST)
    for arguments, text in (
        ((path,), "a map needs a truth"),
        ((pairs, "--truth", path), "--truth is for a map"),
        ((path, "--truth", path, "--group", "a"), "--group and --truth do not go together"),
        ((path, "--truth", path, "--classes", "shrubs"), "canopy, vegetation"),
        ((tmp_path / "nowhere",), "nowhere"),
    ):
        outcome = runner("evaluate-coverage", *arguments)
        assert outcome.exit_code == 2
        assert text in outcome.stderr
        assert "Traceback" not in outcome.stderr


def test_a_model_of_other_classes_and_patterns_that_fit_nothing_are_refused(runner, pairs, model):
    outcome = runner("evaluate-coverage", pairs, "-m", model, "--classes", "vegetation")
    assert (outcome.exit_code, "no class in common" in outcome.stderr) == (2, True)
    outcome = runner("evaluate-coverage", pairs, "-m", model, "--group", "sout_*")
    assert (outcome.exit_code, "north, south" in outcome.stderr) == (2, True)
