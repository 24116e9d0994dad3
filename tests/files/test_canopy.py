import warnings

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.errors import NotGeoreferencedWarning
from rio_cogeo import cog_validate

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.canopy import ABOUT, read_provenance, write_canopy

RECORD = {"stage": "export", "seed": "7", "city": "Köln"}
PLACE = {"west_m": 459_000.0, "north_m": 5_549_000.0, "cell_m": 0.5, "crs": CRS.from_epsg(32633), "provenance": RECORD}


def values(kind, shape=(700, 1300)):
    rng = np.random.default_rng(4)
    if kind == "cover":
        return rng.integers(0, 101, shape).astype(np.uint8)
    return np.where(rng.random(shape) < 0.5, 0.0, np.round(rng.uniform(0, 30, shape), 2)).astype(np.float32)


@pytest.mark.parametrize("kind", list(ABOUT))
def test_a_raster_is_a_valid_cog_with_its_place_unit_and_provenance(tmp_path, kind):
    path = tmp_path / "canopy.tif"
    written = values(kind)
    write_canopy(path, written, kind, **PLACE)
    valid, errors, warnings = cog_validate(str(path), strict=True)
    assert valid, (errors, warnings)
    with rasterio.open(path) as file:
        assert (file.read(1) == written).all()
        assert file.crs.to_epsg() == 32633
        assert file.bounds == (459_000.0, 5_549_000.0 - 350.0, 459_000.0 + 650.0, 5_549_000.0)
        assert file.units == (ABOUT[kind][1],)
        assert file.descriptions == (ABOUT[kind][0],)
        assert file.nodata not in written
        assert file.overviews(1)
    assert read_provenance(path) == RECORD
    assert [item.name for item in tmp_path.iterdir()] == ["canopy.tif"]


def test_equal_values_are_equal_bytes(tmp_path):
    for name in ("a.tif", "b.tif"):
        write_canopy(tmp_path / name, values("height"), "height", **PLACE)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_the_smallest_raster_has_one_cell(tmp_path):
    path = tmp_path / "canopy.tif"
    write_canopy(path, np.zeros((1, 1), np.uint8), "cover", **PLACE)
    assert cog_validate(str(path), strict=True)[0]


def test_missing_torn_and_foreign_files_are_refused_in_words(tmp_path):
    path = tmp_path / "canopy.tif"
    with pytest.raises(InputError):
        read_provenance(path)
    write_canopy(path, values("height"), "height", **PLACE)
    head = path.read_bytes()[:300]
    for text in (b"", head, b"II*\0" + b"x" * 500, b"<VRTDataset/>"):
        path.write_bytes(text)
        with pytest.raises(InputError, match="not a raster of urbanforest"):
            read_provenance(path)


def test_a_raster_of_others_has_no_provenance(tmp_path):
    path = tmp_path / "other.tif"
    for place in (None, rasterio.Affine(1, 0, 5, 0, -1, 7)):
        with (
            warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
            rasterio.open(
                path, "w", driver="GTiff", height=2, width=2, count=1, dtype="uint8", transform=place
            ) as file,
        ):
            file.write(np.zeros((1, 2, 2), np.uint8))
        assert read_provenance(path) is None
