"""``urbanforest render``."""

import json

import geopandas as gpd
import numpy as np
import pytest
from PIL import Image

from urbanforest_cli.core.publish import sha256_of


@pytest.fixture
def planted(runner, tiny_city, tmp_path):
    register = tmp_path / "out" / "register.gpkg"
    for line in (("stencil", tiny_city, "-o", register), ("place", register), ("grow", register)):
        outcome = runner(*line)
        assert outcome.exit_code == 0, outcome.stderr
    return register


def test_pictures_of_a_city_are_written_with_their_provenance(runner, planted):
    out = planted.parent
    plants = gpd.read_file(planted, layer="trees")
    for kind in ("perspective", "street", "top"):
        outcome = runner("render", out, f"--{kind}", "--size", "160x100", "--workers", 2)
        assert outcome.exit_code == 0, outcome.stderr
        path = out / ("view.png" if kind == "perspective" else f"{kind}.png")
        with Image.open(path) as picture:
            assert picture.size == (160, 100)
            pixels = np.asarray(picture.convert("RGB")).astype(int)
            record = json.loads(picture.info["urbanforest"])
        assert pixels.std() > 10
        assert (pixels[..., 1] > pixels[..., 2] + 20).mean() > 0.01
        assert record["kind"] == kind
        assert 0 < record["plants"] <= len(plants)
        manifest = json.loads((out / "exports.json").read_text())
        assert any(path.name == item["name"] for item in manifest["exports"])
    first = sha256_of(out / "top.png")
    runner("render", out, "--top", "--size", "160x100", "--workers", 1)
    assert sha256_of(out / "top.png") == first
    own = out / "holiday.png"
    Image.new("RGB", (8, 8)).save(own)
    kept = own.read_bytes()
    refused = runner("render", out, "--top", "--size", "160x100", "-o", own)
    assert refused.exit_code == 2
    assert "would be lost" in refused.stderr
    assert own.read_bytes() == kept
    west, south = 400_000.0, 5_000_000.0
    beside = runner("render", out, "--bbox", west, south, west + 10, south + 10)
    assert beside.exit_code == 2
    assert "no plant stands in the box" in beside.stderr
    assert "within" in beside.stderr


def test_a_register_that_has_not_grown_names_the_command(runner, tiny_city, tmp_path):
    register = tmp_path / "register.gpkg"
    for line in (("stencil", tiny_city, "-o", register), ("place", register)):
        assert runner(*line).exit_code == 0
    outcome = runner("render", register)
    assert outcome.exit_code == 2
    assert "grow" in outcome.stderr
    assert not (tmp_path / "view.png").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--size", "big"), "WIDTHxHEIGHT"),
        (("--size", "10x10"), "64 to 16384"),
        (("--size", "99999x100"), "64 to 16384"),
        (("--sun", "north"), "AZIMUTH,ELEVATION"),
        (("--sun", "200,-3"), "elevation 5 to 90"),
        (("--size", "16384x16384"), "too large"),
        (("-o", "view.jpg"), "end in .png"),
        (("--top", "--street"), "name one"),
        (("--perspective", "--top"), "name one"),
        (("--season", "monsoon"), "autumn"),
    ],
)
def test_what_cannot_be_meant_is_told(runner, tmp_path, arguments, told):
    outcome = runner("render", tmp_path, *arguments)
    assert outcome.exit_code == 2
    assert told in outcome.stderr


def test_help_tells_of_every_kind(runner):
    text = runner("render", "--help").stdout
    assert "5 to 90" in " ".join(text.split())
    assert all(word in text for word in ("--top", "--street", "--perspective", "--bbox", "--sun", "--season"))
