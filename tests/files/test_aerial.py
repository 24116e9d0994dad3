"""Pictures on disk: places, bands, losses, and nothing half written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from rio_cogeo import cog_validate

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files import aerial
from urbanforest_cli.files.aerial import writing_aerial
from urbanforest_cli.files.images import open_image

GRID = RasterGrid(700, 600, (0.6, 0.0, 459_000.0, 0.0, -0.6, 5_549_000.0), CRS.from_epsg(32633))


def counts(bands: int) -> NDArray[np.uint8]:
    row, col = np.mgrid[:600, :700]
    smooth = [120 + 60 * np.sin(row / (40 + 9 * band)) * np.cos(col / 70) for band in range(bands)]
    return np.rint(smooth).astype(np.uint8)


def write(path: Path, values: NDArray[np.uint8]) -> None:
    with writing_aerial(path, GRID, nir=len(values) == 4, provenance={"seed": "1"}) as file:
        for row in range(0, 600, 256):
            for col in range(0, 700, 256):
                file.write(row, col, values[:, row : row + 256, col : col + 256])


def test_near_infrared_comes_back_as_it_was(tmp_path: Path) -> None:
    values = counts(4)
    write(tmp_path / "a.tif", values)
    with rasterio.open(tmp_path / "a.tif") as file:
        assert np.array_equal(file.read(), values)
        assert file.descriptions == ("red", "green", "blue", "near infrared")
        assert file.tags()["urbanforest"] == '{"seed": "1"}'
        assert file.transform[:6] == GRID.transform[:6]
    with open_image(tmp_path / "a.tif", notices=Notices()) as image:
        assert (image.traits.red, image.traits.nir, image.traits.alpha) == (1, 4, None)
        assert np.array_equal(image.read_nir(10, 20, 30, 40), values[3, 10:40, 20:60])


def test_three_bands_are_packed_small_and_nearly_the_same(tmp_path: Path) -> None:
    values = counts(3)
    write(tmp_path / "a.tif", values)
    assert (tmp_path / "a.tif").stat().st_size < values.size / 8
    with open_image(tmp_path / "a.tif", notices=Notices()) as image:
        found, valid = image.read(0, 0, 600, 700)
    assert valid.all()
    assert np.abs(found.astype(int) - values).mean() < 2


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_text("old")
    with pytest.raises(KeyError), writing_aerial(tmp_path / "a.tif", GRID, nir=False, provenance={}):
        raise KeyError
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]
    assert (tmp_path / "a.tif").read_text() == "old"


def test_counts_lost_on_the_way_to_disk_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = aerial.copy

    def lossy(source: str, target: str, **options: object) -> None:
        with rasterio.open(source, "r+") as file:
            file.write(np.zeros((4, 100, 100), np.uint8), window=rasterio.windows.Window(0, 0, 100, 100))
        whole(source, target, **options)

    monkeypatch.setattr(aerial, "copy", lossy)
    with pytest.raises(OutputError, match="not written whole"):
        write(tmp_path / "a.tif", counts(4))
    assert not list(tmp_path.iterdir())


def test_readers_in_the_cloud_find_overviews_first(tmp_path: Path) -> None:
    for bands in (3, 4):
        write(tmp_path / "a.tif", counts(bands))
        valid, faults, warnings = cog_validate(tmp_path / "a.tif", strict=True)
        assert valid, (faults, warnings)
        with rasterio.open(tmp_path / "a.tif") as file:
            assert file.overviews(1) == [2]
