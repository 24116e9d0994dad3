"""Programs that other people open our files with; each test skips with a reason where its program is not there.

`make readers` installs what is missing and runs these tests.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pyproj import CRS

from urbanforest_cli.core.placed import PlacedPlants
from urbanforest_cli.verification.compare import Comparison, Expected, compare
from urbanforest_cli.verification.stage import read_truth

ROOT = Path(__file__).parents[2]
NODE = Path(__file__).parent / "node"
SYSTEM_PYTHON = Path("/usr/bin/python3")  # Debian's QGIS and GDAL belong to it
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome")
TIMEOUT_S = 240
FORMATS = "glb,3dtiles,cityjson,obj,geojson,gpkg,geoparquet,itree,canopy"
PROTOTYPES = 60  # few shapes, so that a software renderer keeps up
COLOURS_OF_A_PICTURE = 200
GREEN_SHARE = 0.02


@pytest.fixture(scope="session")
def node() -> Callable[..., dict[str, Any]]:
    """Run a script of tests/readers/node with a question, and return its answer."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (NODE / "node_modules").is_dir():
        pytest.skip("tests/readers/node/node_modules is not there: `make readers` installs it")

    def ask(script: str, **question: Any) -> dict[str, Any]:
        outcome = subprocess.run(
            ["node", str(NODE / script), json.dumps(question)],
            capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
            env=os.environ | {"CHROMIUM": _chromium() or ""},
        )  # fmt: skip
        assert outcome.returncode == 0, outcome.stderr
        answer: dict[str, Any] = json.loads(outcome.stdout)
        return answer

    return ask


def _chromium() -> str | None:
    return next((path for name in CHROMIUMS if (path := shutil.which(name))), None)


@pytest.fixture(scope="session")
def browser(node: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """Run a script that opens a page in Chromium; no request may have left the host or gone unanswered."""
    if _chromium() is None:
        pytest.skip("chromium is not installed")

    def ask(script: str, **question: Any) -> dict[str, Any]:
        answer = node(script, **question)
        assert answer["requests_elsewhere"] == []
        assert answer["requests_missing"] == []
        return answer

    return ask


@pytest.fixture(scope="session")
def debian() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the system's Python, which has what Debian packages for it, and skip where it lacks a module."""

    def run(module: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        if not SYSTEM_PYTHON.exists():
            pytest.skip(f"there is no {SYSTEM_PYTHON}")
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))}
        environment |= {"QT_QPA_PLATFORM": "offscreen"}
        found = subprocess.run(
            [SYSTEM_PYTHON, "-c", f"import {module}"], capture_output=True, env=environment, check=False
        )  # fmt: skip
        if found.returncode:
            pytest.skip(f"{SYSTEM_PYTHON} has no {module}: install python3-{'qgis' if module == 'qgis' else 'gdal'}")
        return subprocess.run(
            [SYSTEM_PYTHON, *map(str, arguments)],
            capture_output=True, text=True, timeout=TIMEOUT_S, env=environment, check=False,
        )  # fmt: skip

    return run


@pytest.fixture(scope="session")
def forest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample city, planted and exported to all formats; or the folder that URBANFOREST_READERS_CITY names."""
    given = os.environ.get("URBANFOREST_READERS_CITY")
    out = tmp_path_factory.mktemp("readers") / "forest"
    if given:
        shutil.copytree(given, out)
    else:
        urbanforest("populate", ROOT / "data_samples" / "sample_city.gpkg", "-o", out, "-q")
    urbanforest("export", out, "--to", FORMATS, "--prototypes", PROTOTYPES, "-q")
    return out


def urbanforest(*arguments: object) -> str:
    """Run the program and return what it prints."""
    outcome = subprocess.run(
        [shutil.which("urbanforest") or ROOT / ".venv/bin/urbanforest", *map(str, arguments)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


@pytest.fixture(scope="session")
def standing(forest: Path) -> Expected:
    """The plants that stand, as the register states them."""
    truth = read_truth(forest / "register.gpkg")
    return truth.placed.take(np.flatnonzero(truth.stands))


def held_against(expected: Expected, ids: list[str], xyz: Any, crs: CRS) -> Comparison:
    """Compare what a reader has shown with the register."""
    unknown = np.full(len(ids), np.nan)
    stated = PlacedPlants(np.array(ids, dtype=object), np.asarray(xyz, dtype=np.float64).reshape(-1, 3), crs, unknown)
    return compare(stated, expected)


def pixels_of(picture: Path) -> Any:
    """Return the (n, 3) pixels of a picture, which must not be blank."""
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    assert len(np.unique(pixels, axis=0)) > COLOURS_OF_A_PICTURE
    return pixels


def assert_shows_plants(picture: Path) -> None:
    """Check that a picture is not blank, and that there is green in it."""
    red, green, blue = pixels_of(picture).T
    assert np.mean((green > red) & (green > blue + 10)) > GREEN_SHARE
