"""Bad images, collected and made, and what opening and reading all of each does."""

from __future__ import annotations

import csv
import json
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.files.rasters import colours, write_raster
from urbanforest_cli.core.errors import EXIT_BAD_INPUT, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.images import open_image

KINDS = {"tif", "vrt"}
LONGEST_S = 5.0
MOST_ABOVE_START_KB = 600_000
STRIDE_PX = 512


def read_all(path: Path, **options) -> Notices:
    """Open an image and read all of it by windows, as a command would."""
    notices = Notices()
    with open_image(path, notices=notices, **options) as image:
        for row in range(0, image.height_px, STRIDE_PX):
            for col in range(0, image.width_px, STRIDE_PX):
                image.read(row, col, min(STRIDE_PX, image.height_px - row), min(STRIDE_PX, image.width_px - col))
    return notices


def outcome(path: Path, **options) -> str:
    """Say what became of it; anything but an error of this program's own comes through as its name."""
    try:
        return "repair" if list(read_all(path, **options)) else "accept"
    except UrbanForestError as error:
        told = error.exit_code == EXIT_BAD_INPUT and path.name in str(error)
        return "reject" if told else f"reject with exit code {error.exit_code}: {error}"
    except Exception as error:  # noqa: BLE001 whatever else comes out of a library is what these tests look for
        return f"{type(error).__name__}: {error}"


EACH = """
import json, resource, sys, time
from pathlib import Path
from tests.test_bad_rasters import outcome

start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for name in sys.stdin.read().splitlines():
    began = time.process_time()
    result = outcome(Path(name))
    print(json.dumps([name, result, time.process_time() - began]), flush=True)
print(json.dumps(["", str(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start), 0]))
"""


def rows(folder: Path) -> Iterator[tuple[Path, str]]:
    with (folder / "index.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            if row["kind"] in KINDS and row["role"] == "input":
                yield folder / row["file"], row["expected"]


def test_each_raster_of_the_collection_is_treated_as_its_index_says(bad_inputs):
    """Read in a process of its own, so that a crash, a hang or a huge allocation is seen and harms nobody."""
    expected = dict(rows(bad_inputs))
    before = sorted(bad_inputs.rglob("*"))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", EACH], input="\n".join(map(str, expected)), capture_output=True,
        text=True, timeout=120, check=False, cwd=Path(__file__).parents[1],
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-2000:]
    assert "Traceback" not in run.stderr
    *each, (_, above_start_kb, _) = map(json.loads, run.stdout.splitlines())
    assert len(each) == len(expected) > 40
    wrong = [
        f"{name}: {expected[Path(name)]}, not {found}, {spent_s:.1f} s"
        for name, found, spent_s in each
        if (found != expected[Path(name)] and (found, expected[Path(name)]) != ("repair", "accept"))
        or spent_s > LONGEST_S
    ]
    assert not wrong, "\n".join(wrong)
    assert int(above_start_kb) < MOST_ABOVE_START_KB
    assert sorted(bad_inputs.rglob("*")) == before


def test_rasters_that_need_no_place_crash_nothing_either(bad_inputs):
    for path, expected in rows(bad_inputs):
        found = outcome(path, georeferenced=False)
        assert found in ("reject", "repair", "accept"), f"{path.name}: {found}"
        assert found == "reject" or expected != "reject" or path.parent.name != "vrt"


def test_images_of_one_kind_are_accepted_or_told(tmp_path):
    """All missing, all one colour, one pixel, fewer pixels than any window: none is an error."""
    told = {
        "missing": (np.zeros((3, 70, 70), np.uint8), {"nodata": 0}, "repair"),
        "black": (np.zeros((3, 70, 70), np.uint8), {}, "repair"),
        "green": (np.full((3, 70, 70), 90, np.uint8), {}, "accept"),
        "pixel": (colours(1, 1), {}, "accept"),
        "missing pixel": (np.zeros((3, 1, 1), np.uint8), {"nodata": 0}, "repair"),
        "line": (colours(1, 3000), {}, "accept"),
        "column": (colours(3000, 1), {}, "accept"),
        "not a number": (np.full((3, 9, 9), np.nan, np.float32), {}, "repair"),
    }
    for name, (values, options, expected) in told.items():
        assert outcome(write_raster(tmp_path / f"{name}.tif", values, **options)) == expected, name


def test_what_is_no_file_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    (tmp_path / "loop.tif").symlink_to("loop.tif")
    (tmp_path / "empty.tif").touch()
    for path in (tmp_path, tmp_path / "pipe.tif", tmp_path / "loop.tif", tmp_path / "empty.tif", Path("/dev/zero")):
        assert outcome(path) == "reject"


MAKES = {
    "raw": {},
    "tiles": {"tiled": True, "blockxsize": 64, "blockysize": 64, "compress": "deflate"},
    "planes": {"interleave": "band", "compress": "lzw"},
    "jpeg in tiff": {"compress": "jpeg", "photometric": "ycbcr"},
    "big": {"BIGTIFF": "YES", "compress": "zstd"},
    "png": {"driver": "PNG"},
    "jpeg": {"driver": "JPEG"},
    "jpeg 2000": {"driver": "JP2OpenJPEG"},
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("sound")
    values = colours(150, 150) // 8 * 8 + 1
    # Named .jp2, since GDAL writes JPEG 2000 under any other name without the boxes around it.
    return {make: write_raster(folder / "a.jp2", values, **options).read_bytes() for make, options in MAKES.items()}


@pytest.mark.parametrize("make", MAKES)
def test_cut_off_images_are_refused(tmp_path, sound, make):
    raw, path = sound[make], tmp_path / "cut"
    for part in range(25):
        path.write_bytes(raw[: len(raw) * part // 25])
        assert outcome(path, georeferenced=False) == "reject", f"{part} of 25"


@pytest.mark.parametrize("make", MAKES)
def test_damaged_images_are_refused_or_read_and_never_more(tmp_path, sound, make, capfd):
    rng, path = random.Random(make), tmp_path / "damaged"
    for count in range(40):
        raw = bytearray(sound[make])
        for _ in range(rng.choice((1, 1, 5, 20))):
            raw[rng.randrange(min(len(raw), rng.choice((600, len(raw)))))] = rng.randrange(256)
        path.write_bytes(raw)
        found = outcome(path, georeferenced=bool(count % 2))
        assert found in ("reject", "repair", "accept"), found
    assert "Traceback" not in capfd.readouterr().err
