import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from tests.reference.tiny_coverage import garden, greenness, info_of, write_image


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.onnx"
    path.write_bytes(greenness(info_of()))
    return path


@pytest.fixture
def image(tmp_path):
    return write_image(tmp_path / "image.tif", garden(60, 70))


def test_an_image_is_mapped_and_told_as_json(runner, tmp_path, image, model):
    output = tmp_path / "new" / "coverage.tif"
    arguments = ("cover", image, "-o", output, "-m", model, "--preview", tmp_path / "new" / "coverage.png")
    outcome = runner(*arguments, "--json", "--workers", 2)
    assert outcome.exit_code == 0, outcome.stderr
    told = json.loads(outcome.stdout)
    assert told["counts"]["width_px"] == 70
    assert sorted(path.name for path in output.parent.iterdir()) == ["coverage.png", "coverage.tif"]
    with rasterio.open(output) as file:
        assert file.descriptions == ("canopy", "vegetation")
        assert np.ptp(file.read(1)) > 50
    again = runner(*arguments)
    assert again.exit_code == 0
    assert "up to date" in again.stdout
    assert "70 x 60 pixels of 0.6 m" in again.stdout
    assert outcome.stderr.split() == ["coverage", "..."]
    assert "format: cover" in runner("info", output).stdout


def test_another_map_is_not_written_over_unasked(runner, tmp_path, image, model):
    arguments = ("cover", image, "-o", tmp_path / "map.tif", "-m", model, "-q")
    assert runner(*arguments).exit_code == 0
    refused = runner(*arguments, "--bands", "3,2,1")
    assert refused.exit_code == 2
    assert "--overwrite" in refused.stderr
    assert runner(*arguments, "--bands", "3,2,1", "--overwrite").exit_code == 0


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["-o", "map.png"], "must end in .tif"),
        (["-o", "map.tif", "--preview", "map.jpg"], "must end in .png"),
        (["-o", "map.tif", "--bands", "1,2"], "names no bands"),
        (["-o", "map.tif", "--bands", "0,1,2"], "counted from 1"),
        (["-o", "map.tif", "--stretch", "9,9"], "is no range"),
        (["-o", "map.tif", "--stretch", "nan,9"], "is no range"),
        (["-o", "map.tif", "--bbox", "5", "0", "1", "9"], "west must be below east"),
        (["-o", "map.tif", "--bbox", "0", "0", "inf", "9"], "finite"),
        (["-o", "map.tif", "--bbox", "0", "nan", "1", "9"], "finite"),
        (["second.tif", "-o", "map.tif"], "--mosaic"),
        ([], "-o"),
    ],
)
def test_wrong_usage_is_told_before_anything_is_read(runner, image, more, told):
    outcome = runner("cover", image, *more)
    assert outcome.exit_code == 2
    assert told in outcome.stderr


@pytest.mark.parametrize("name", ["missing.tif", "text.tif"])
def test_what_is_no_image_is_refused_by_name(runner, tmp_path, model, name):
    (tmp_path / "text.tif").write_text("no image")
    outcome = runner("cover", tmp_path / name, "-o", tmp_path / "map.tif", "-m", model)
    assert outcome.exit_code == 2
    assert name in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert not (tmp_path / "map.tif").exists()


WITHOUT_TRAINING = """
import sys
for name in ("torch", "onnx", "sklearn", "tensorboardX"):
    sys.modules[name] = None  # an import of it fails
from urbanforest_cli.main import run
run()
"""


def test_the_shipped_model_needs_nothing_of_the_extra_train(tmp_path, image):
    """Mapping with the model of the program, in a process that has no torch, and judging the map."""
    output = tmp_path / "map.tif"
    for words in (["cover", image, "-o", output], ["evaluate-coverage", output, "--truth", output]):
        done = subprocess.run(
            [sys.executable, "-c", WITHOUT_TRAINING, *map(str, words)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.descriptions == ("canopy", "vegetation")
        assert file.read(2).max() > 50


def test_the_shipped_model_finds_the_trees_of_the_sample_city(runner, tmp_path):
    sample = Path(__file__).parents[2] / "data_samples" / "sample_city.tif"
    truth = sample.with_name("sample_city_coverage.tif")
    assert runner("cover", sample, "-o", tmp_path / "map.tif", "-q").exit_code == 0
    outcome = runner("evaluate-coverage", tmp_path / "map.tif", "--truth", truth, "--json")
    counts = json.loads(outcome.stdout)["counts"]
    assert counts["canopy_iou"] > 0.55
    assert counts["vegetation_iou"] > 0.65
