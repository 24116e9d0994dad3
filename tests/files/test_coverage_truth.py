from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from pyproj import CRS
from shapely.geometry import GeometryCollection, LineString, Point, Polygon, box

from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files import coverage_truth
from urbanforest_cli.files.coverage_truth import open_truth, read_points, window_over

UTM = CRS.from_epsg(32633)
WEST, NORTH = 500_000.0, 5_300_000.0
GRID = RasterGrid(40, 30, (1.0, 0.0, WEST, 0.0, -1.0, NORTH), UTM)
WHOLE = (0, 0, 30, 40)


def write_raster(path: Path, values: np.ndarray, pixel_m: float, *, west=WEST, north=NORTH, crs="EPSG:32633") -> Path:
    layers = values if values.ndim == 3 else values[None]
    with rasterio.open(
        path, "w", driver="GTiff", height=layers.shape[1], width=layers.shape[2], count=len(layers), dtype=values.dtype,
        crs=crs, transform=rasterio.Affine(pixel_m, 0, west, 0, -pixel_m, north), nodata=255,
    ) as file:  # fmt: skip
        file.write(layers)
        if len(layers) == 2:
            file.descriptions = ("canopy", "vegetation")
    return path


def read(source: object, window=WHOLE, classes=None, grid: RasterGrid = GRID) -> tuple[tuple[str, ...], np.ndarray]:
    with open_truth(str(source), grid, classes, None, Notices()) as (names, reads):
        return names, reads(window)


def test_a_mask_on_the_same_pixels_comes_as_it_is(tmp_path):
    values = np.random.default_rng(0).integers(0, 101, (2, 30, 40), dtype=np.uint8)
    values[0, :3] = 255
    path = write_raster(tmp_path / "truth.tif", values, 1.0)
    names, found = read(path)
    assert names == ("canopy", "vegetation")
    assert np.array_equal(found, values)
    assert np.array_equal(read(path, (5, 7, 11, 13))[1], values[:, 5:16, 7:20])


def test_a_finer_mask_is_averaged_over_the_map_s_pixels(tmp_path):
    fine = np.random.default_rng(1).integers(0, 101, (120, 160), dtype=np.uint8)
    fine[:8, :8] = 255  # two by two pixels of the map, and a part of the next one's neighbours stay known
    fine[8:10, 0:4] = 255  # half of one pixel: the rest counts
    names, found = read(write_raster(tmp_path / "fine.tif", fine, 0.25))
    parts = np.where(fine == 255, np.nan, fine).reshape(30, 4, 40, 4).transpose(0, 2, 1, 3).reshape(30, 40, 16)
    known = ~np.isnan(parts).all(axis=2)
    assert names == ("canopy",)
    assert np.array_equal(found[0] != 255, known)
    expected = np.nanmean(parts[known], axis=1)
    assert np.abs(found[0][known] - expected).max() <= 1


def test_windows_far_finer_than_the_map_are_read_in_parts_and_refused_when_a_pixel_is_too_much(tmp_path, monkeypatch):
    fine = np.random.default_rng(2).integers(0, 101, (120, 160), dtype=np.uint8)
    path = write_raster(tmp_path / "fine.tif", fine, 0.25)
    _, whole = read(path)
    monkeypatch.setattr(coverage_truth, "SOURCE_LIMIT_PX", 400)
    assert np.array_equal(read(path)[1], whole)
    monkeypatch.setattr(coverage_truth, "SOURCE_LIMIT_PX", 20)
    with pytest.raises(LimitError, match="too fine for the map"):
        read(path)


def test_beyond_a_raster_nothing_is_known(tmp_path):
    values = np.full((10, 10), 100, dtype=np.uint8)
    values[0, 0] = 0
    path = write_raster(tmp_path / "part.tif", values, 1.0, west=WEST + 20, north=NORTH - 5)
    _, found = read(path)
    expected = np.full((30, 40), 255)
    expected[5:15, 20:30] = values
    assert np.array_equal(found[0], expected)
    assert (read(path, (20, 0, 10, 10))[1] == 255).all()


def test_another_crs_lands_on_the_same_ground(tmp_path):
    # A mask in degrees whose northern half is covered, over a map in metres.
    west, south, east, north = gpd.GeoSeries([box(*GRID.bounds)], crs=UTM).to_crs(4326).total_bounds
    step = 2e-6
    rows, cols = round((north - south) / step) + 40, round((east - west) / step) + 40
    latitude = north + 20 * step - (np.arange(rows) + 0.5) * step
    values = np.repeat((latitude > (north + south) / 2)[:, None], cols, axis=1).astype(np.uint8) * np.uint8(100)
    with rasterio.open(
        tmp_path / "degrees.tif", "w", driver="GTiff", height=rows, width=cols, count=1, dtype="uint8", crs="EPSG:4326",
        transform=rasterio.Affine(step, 0, west - 20 * step, 0, -step, north + 20 * step), nodata=255,
    ) as file:  # fmt: skip
        file.write(values, 1)
    _, found = read(tmp_path / "degrees.tif")
    assert (found[0, :14] == 100).all()
    assert (found[0, 16:] == 0).all()


def test_polygons_cover_the_share_of_a_pixel_they_cover(tmp_path):
    shapes = [
        box(WEST + 2, NORTH - 6, WEST + 8, NORTH - 2),
        box(WEST + 20.5, NORTH - 12, WEST + 24, NORTH - 10),
        Polygon([(WEST + 30, NORTH - 20), (WEST + 34, NORTH - 24), (WEST + 34, NORTH - 20), (WEST + 30, NORTH - 24)]),
    ]
    gpd.GeoDataFrame(geometry=[*shapes, None], crs=UTM).to_file(tmp_path / "c.gpkg", layer="crowns")
    notices = Notices()
    with open_truth(f"{tmp_path / 'c.gpkg'}:crowns", GRID, None, None, notices) as (names, reads):
        found = reads(WHOLE)[0]
        assert names == ("canopy",)
        assert np.array_equal(reads((3, 5, 10, 20))[0], found[3:13, 5:25])
    assert (found[2:6, 2:8] == 100).all()
    assert (found[10:12, 20] == 50).all()
    assert found[10:12, 21:24].min() == 100
    assert found.sum() / 100 == pytest.approx(24 + 7 + 8, abs=1)  # a bow tie's two triangles
    assert notices.count("W_TRUTH_EMPTY") == 1


def test_lines_within_collections_cover_nothing(tmp_path):
    line = LineString([(WEST, NORTH - 15.5), (WEST + 40, NORTH - 15.5)])
    mixed = GeometryCollection([box(WEST + 2, NORTH - 6, WEST + 8, NORTH - 2), line])
    gpd.GeoDataFrame(geometry=[mixed], crs=UTM).to_file(tmp_path / "c.gpkg")
    assert read(tmp_path / "c.gpkg")[1].sum() == 24 * 100


def test_what_polygons_show_may_be_named(tmp_path):
    gpd.GeoDataFrame(geometry=[box(*GRID.bounds)], crs=UTM).to_file(tmp_path / "c.gpkg")
    assert read(tmp_path / "c.gpkg", classes=("vegetation",))[0] == ("vegetation",)


def test_lines_are_no_truth(tmp_path):
    line = LineString([(WEST, NORTH), (WEST + 9, NORTH - 9)])
    gpd.GeoDataFrame(geometry=[line], crs=UTM).to_file(tmp_path / "l.gpkg")
    with pytest.raises(InputError):
        read(tmp_path / "l.gpkg")


def test_points_land_in_their_pixels_whatever_their_crs(tmp_path):
    points = [Point(WEST + 0.25, NORTH - 0.25), Point(WEST + 12.5, NORTH - 7.75), Point(WEST - 3, NORTH)]
    frame = gpd.GeoDataFrame(geometry=points, crs=UTM)
    frame.to_crs(4326).to_file(tmp_path / "trees.geojson")
    notices = Notices()
    found = read_points(str(tmp_path / "trees.geojson"), GRID, None, notices)
    assert found == pytest.approx(np.array([[0.25, 0.25], [7.75, 12.5]]), abs=1e-2)
    assert notices.count("W_TREES_OUTSIDE") == 1
    frame.iloc[2:].to_file(tmp_path / "beside.gpkg")
    with pytest.raises(InputError, match="none of the trees lies on the map"):
        read_points(str(tmp_path / "beside.gpkg"), GRID, None, Notices())


def test_window_over_a_finer_raster_holds_the_part_and_little_more():
    fine = RasterGrid(400, 300, (0.1, 0.0, WEST, 0.0, -0.1, NORTH), UTM)
    assert window_over(fine, GRID.window(10, 10, 5, 5)) == (99, 99, 52, 52)
    assert window_over(fine, GRID.window(0, 0, 5, 5)) == (0, 0, 51, 51)
    assert window_over(fine, GRID.window(40, 0, 5, 5)) is None
