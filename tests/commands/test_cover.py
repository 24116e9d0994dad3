import json

import numpy as np
import pytest
import rasterio

from tests.reference.tiny_coverage import garden, greenness, info_of, write_image
from urbanforest_cli import main


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(main.COMMANDS, "cover", ("cover", "Map the vegetation in an aerial image."))


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
