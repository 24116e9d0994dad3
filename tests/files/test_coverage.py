import resource
import subprocess
import sys

import numpy as np
import pytest
import rasterio
from pyproj import CRS

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files import coverage
from urbanforest_cli.files.coverage import CoverageWriter, open_coverage, windows

PLACE = (0.5, 0.0, 500_000.0, 0.0, -0.5, 3_700_000.0)
CLASSES = ("canopy", "vegetation")


def grid_of(height, width):
    return RasterGrid(width, height, PLACE, CRS.from_epsg(32611))


def percents(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 101, (2, height, width), dtype=np.uint8)


def write(path, values, classes=CLASSES, provenance=None, piece=300):
    _, height, width = values.shape
    with CoverageWriter(path, grid_of(height, width), classes, provenance or {"format": "cover"}) as writer:
        for row in range(0, height, piece):
            for col in range(0, width, piece):
                writer.write(row, col, values[:, row : row + piece, col : col + piece])


def raster(path, values, *, nodata=None, names=None, transform=PLACE, crs="EPSG:32611"):
    bands, height, width = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=height, width=width, count=bands, dtype=values.dtype, crs=crs, nodata=nodata,
        transform=rasterio.Affine(*transform),
    ) as file:  # fmt: skip
        file.write(values)
        if names:
            file.descriptions = names
    return path


def read_all(path):
    notices = Notices()
    with open_coverage(path, notices=notices) as reader:
        return reader.read(0, 0, reader.grid.height_px, reader.grid.width_px), reader, notices


def test_what_is_written_by_windows_is_read_again(tmp_path):
    values = percents(700, 900)
    write(tmp_path / "map.tif", values, provenance={"format": "cover", "key": "k"})
    found, reader, notices = read_all(tmp_path / "map.tif")
    assert np.array_equal(found, values)
    assert (reader.classes, reader.provenance["key"], len(notices)) == (CLASSES, "k", 0)
    assert (reader.grid.transform, reader.grid.crs.to_epsg()) == (PLACE, 32611)
    assert [path.name for path in tmp_path.iterdir()] == ["map.tif"]
    with rasterio.open(tmp_path / "map.tif") as file:
        assert (file.descriptions, file.units, file.nodata) == (CLASSES, ("percent",) * 2, 255)
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"


def test_no_name_of_a_map_is_taken(tmp_path):
    values = percents(20, 20)
    write(tmp_path / "plain.tif", values, provenance={"format": "cover"})
    assert np.array_equal(read_all(tmp_path / "plain.tif")[0], values)


def test_no_window_leaves_the_unknown_and_overviews_do_not_count_it(tmp_path):
    with CoverageWriter(tmp_path / "map.tif", grid_of(1100, 1100), ("canopy",), {}) as writer:
        writer.write(0, 0, np.full((1, 300, 1100), 80, np.uint8))
        writer.write(301, 0, np.full((1, 100, 1100), 255, np.uint8))
    found, _, _ = read_all(tmp_path / "map.tif")
    assert (found[0, :300] == 80).all()
    assert (found[0, 300:] == 255).all()
    with rasterio.open(tmp_path / "map.tif") as file:
        factor = file.overviews(1)[-1]
        small = file.read(1, out_shape=(1100 // factor, 1100 // factor))
        assert set(np.unique(small)) == {80, 255}


def test_same_values_same_bytes(tmp_path):
    values = percents(600, 530)
    for name in "ab":
        (tmp_path / name).mkdir()
        write(tmp_path / name / "map.tif", values)
    assert (tmp_path / "a/map.tif").read_bytes() == (tmp_path / "b/map.tif").read_bytes()


def test_an_error_on_the_way_leaves_what_was_there(tmp_path):
    path = tmp_path / "map.tif"
    path.write_bytes(b"earlier")
    writer = CoverageWriter(path, grid_of(600, 600), CLASSES, {})

    def half_a_map():
        with writer:
            writer.write(0, 0, percents(300, 300))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half_a_map()
    assert path.read_bytes() == b"earlier"
    assert [file.name for file in tmp_path.iterdir()] == ["map.tif"]


def test_bytes_lost_by_the_library_are_found(tmp_path, monkeypatch):
    values = percents(600, 600)

    def lossy(source, target, **options):
        with rasterio.open(source) as file:
            profile, pixels, tags = file.profile, file.read(), file.tags()
        pixels[1, 517, 233] ^= 1
        with rasterio.open(target, "w", **profile) as file:
            file.write(pixels)
            file.update_tags(**tags)

    monkeypatch.setattr(coverage, "copy", lossy)
    with pytest.raises(OutputError, match="not written whole"):
        write(tmp_path / "map.tif", values)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("limit", [2_000, 900_000, 1_300_000])
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path, limit):
    code = (
        "import numpy as np, sys; from pathlib import Path; from tests.files.test_coverage import percents, write\n"
        "from urbanforest_cli.core.errors import OutputError\n"
        "try: write(Path(sys.argv[1]), percents(900, 900))\n"
        "except OutputError as error: print('told', error.where); sys.exit(0)\n"
        "print('written')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "map.tif")], capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )  # fmt: skip
    assert (done.returncode, done.stdout.split()[0]) == (0, "told"), done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("values", "nodata", "expected", "code"),
    [
        ([[0, 255], [255, 0]], None, [[0, 100], [100, 0]], "W_COVERAGE_MASK"),
        ([[0, 1], [1, 0]], None, [[0, 100], [100, 0]], "W_COVERAGE_SHARE"),
        ([[0, 255], [255, 0]], 0, [[0, 100], [100, 0]], "W_COVERAGE_MASK W_COVERAGE_NODATA"),
        ([[0, 255], [255, 0]], 255, [[0, 100], [100, 0]], "W_COVERAGE_MASK W_COVERAGE_NODATA"),
        ([[0, 1], [1, 0]], 0, [[0, 100], [100, 0]], "W_COVERAGE_SHARE W_COVERAGE_NODATA"),
        ([[0, 1], [1, 255]], 255, [[0, 100], [100, 255]], "W_COVERAGE_SHARE"),
        ([[0, 25], [60, 0]], 0, [[0, 25], [60, 0]], "W_COVERAGE_NODATA"),
        ([[0, 1], [60, 255]], 255, [[0, 1], [60, 255]], None),
        ([[0.0, 0.25], [1.0, np.nan]], None, [[0, 25], [100, 255]], "W_COVERAGE_SHARE"),
        ([[0.0, 25.4], [99.6, -9999.0]], -9999.0, [[0, 25], [100, 255]], None),
    ],
)
def test_maps_of_others_are_read_as_what_they_are(tmp_path, values, nodata, expected, code):
    array = np.array([values])
    array = array.astype(np.uint8 if array.dtype.kind == "i" else np.float32)
    found, reader, notices = read_all(raster(tmp_path / "other.tif", array, nodata=nodata))
    assert found[0].tolist() == expected
    assert reader.classes == ("canopy",)
    assert "W_COVERAGE_BAND" in notices
    codes = [] if code is None else code.split()
    assert all(one in notices for one in codes)
    assert len(notices) == 1 + len(codes)


def test_a_map_in_percent_of_bare_ground_and_gaps_keeps_its_gaps(tmp_path):
    path = raster(tmp_path / "other.tif", np.array([[[0, 255], [0, 0]]], np.uint8), nodata=255)
    with rasterio.open(path, "r+") as file:
        file.units = ("percent",)
    assert read_all(path)[0].tolist() == [[[0, 255], [0, 0]]]


def test_windows_make_up_any_raster_and_none_is_large():
    for height, width in ((1, 1), (600, 400_000), (9000, 700), (513, 8193)):
        seen = np.zeros((-(-height // 512), -(-width // 512)), int)
        for window in windows(height, width):
            assert window.width * window.height <= 4 << 20
            rows, cols = (slice(start // 512, -(-stop // 512)) for start, stop in window.toranges())
            seen[rows, cols] += 1
            assert window.row_off % 512 == window.col_off % 512 == 0
        assert (seen == 1).all()


def test_bands_are_found_by_their_descriptions(tmp_path):
    values = np.stack([np.full((4, 4), value, np.uint8) for value in (7, 60, 20)])
    path = raster(tmp_path / "other.tif", values, names=("year", "Vegetation", "canopy"))
    found, reader, notices = read_all(path)
    assert (reader.classes, len(notices)) == (CLASSES, 0)
    assert found[:, 0, 0].tolist() == [20, 60]


def test_rows_from_south_to_north_are_turned(tmp_path):
    values = np.arange(100, dtype=np.uint8).reshape(1, 20, 5)
    turned = (0.5, 0.0, 500_000.0, 0.0, 0.5, 3_699_990.0)
    path = raster(tmp_path / "other.tif", values, transform=turned)
    with open_coverage(path, notices=Notices()) as reader:
        assert np.array_equal(reader.read(3, 1, 4, 2)[0], values[0, ::-1][3:7, 1:3])
        assert reader.grid.transform == PLACE


@pytest.mark.parametrize("wrong", ["three bands", "values", "negative", "no place", "text"])
def test_what_is_no_coverage_map_is_refused(tmp_path, wrong):
    path = tmp_path / "other.tif"
    values = np.full((1, 8, 8), 50, np.float32)
    if wrong == "three bands":
        raster(path, np.full((3, 8, 8), 50, np.uint8))
    elif wrong == "values":
        values[0, 3, 3] = 130
        raster(path, values)
    elif wrong == "negative":
        values[0, 3, 3] = -1
        raster(path, values)
    elif wrong == "no place":
        raster(path, values, crs=None)
    else:
        path.write_text("no raster")
    with pytest.raises(InputError) as caught:
        read_all(path)
    assert "other.tif" in str(caught.value)
