"""Folders of images become pairs with their truth, and folders that cannot are refused with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
from rasterio import Affine
from rasterio.features import rasterize
from shapely.geometry import Point, box

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files import image_pair_store
from urbanforest_cli.imagery.pairing.stage import read_pairs
from urbanforest_cli.imagery.splits import split

SIDE = 40


def place_at(column: int) -> tuple[float, ...]:
    """Tiles of 40 px side by side."""
    return (0.6, 0.0, 500_000.0 + 0.6 * SIDE * column, 0.0, -0.6, 3_700_000.0)


def tile(path: Path, column: int = 0, bands: int = 3, **options) -> np.ndarray:
    values = colours(SIDE, SIDE, bands) if "values" not in options else options.pop("values")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_raster(path, values, place=options.pop("place", place_at(column)), **options)
    return values


def mask_of(values: np.ndarray) -> np.ndarray:
    return np.asarray(values)[None].astype(np.uint8)


def disc(high: int = 1) -> np.ndarray:
    rows, cols = np.mgrid[:SIDE, :SIDE]
    return mask_of((np.hypot(rows - 20, cols - 15) < 8) * high)


def points(path: Path, rows_cols: list[tuple[float, float]], column: int = 0, crs: int = 32611) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    west, north = place_at(column)[2], place_at(column)[5]
    shapes = [Point(west + 0.6 * col, north - 0.6 * row) for row, col in rows_cols]
    frame = gpd.GeoDataFrame(geometry=shapes, crs=UTM).to_crs(crs)
    frame.to_file(path, driver="GPKG" if path.suffix == ".gpkg" else "GeoJSON")
    return path


def masked_folder(folder: Path, high: int = 1, ending: str = ".tif") -> Path:
    make = {"driver": "PNG", "crs": None, "place": None} if ending == ".png" else {}
    for number in range(3):
        tile(folder / f"images/rome_{number}.tif", column=number)
        tile(folder / f"masks/rome_{number}{ending}", column=number, values=disc(high), **make)
    return folder


@pytest.mark.parametrize(("high", "ending"), [(1, ".tif"), (255, ".png"), (100, ".tif")])
def test_masks_of_equal_names_are_the_truth(tmp_path, high, ending):
    pairs = read_pairs(masked_folder(tmp_path, high, ending), notices=Notices())
    assert pairs.names == ("rome_0", "rome_1", "rome_2")
    assert pairs.groups == ("rome",) * 3
    assert len(set(pairs.places)) == 3
    assert pairs.classes == ("canopy",)
    pair = pairs[1]
    np.testing.assert_array_equal(pair.truth, 100 * disc())
    np.testing.assert_array_equal(pair.rgb, colours(SIDE, SIDE))
    assert pair.valid.all()
    assert pair.resolution_m == pytest.approx((0.6, 0.6), rel=1e-3)
    assert pair.trees_px is None


@pytest.mark.parametrize("bands", [1, 3])
@pytest.mark.parametrize("nodata", [None, 0, 255])
def test_bare_and_covered_ground_are_known_whatever_the_mask_calls_missing(tmp_path, bands, nodata):
    tile(tmp_path / "a.tif")
    tile(tmp_path / "a_mask.tif", values=np.repeat(disc(255), bands, axis=0), nodata=nodata)
    np.testing.assert_array_equal(read_pairs(tmp_path, notices=Notices())[0].truth, 100 * disc())


def test_masks_beside_images_and_images_without_one(tmp_path):
    tile(tmp_path / "a.tif")
    tile(tmp_path / "a_mask.tif", values=disc())
    tile(tmp_path / "b.tif", column=1)
    notices = Notices()
    pairs = read_pairs(tmp_path, notices=notices)
    assert pairs.names == ("a",)
    assert notices.count("W_NO_MASK") == 1


def test_bands_called_by_classes_are_these_in_any_order(tmp_path):
    tile(tmp_path / "city.tif")
    both = np.concatenate([np.full((1, SIDE, SIDE), 80, np.uint8), 60 * disc()])
    tile(tmp_path / "city_coverage.tif", values=both, names=("vegetation", "canopy"))
    pair = read_pairs(tmp_path, notices=Notices())[0]
    assert pair.classes == ("canopy", "vegetation")
    np.testing.assert_array_equal(pair.truth, both[::-1])
    only = read_pairs(tmp_path, classes=("vegetation",), notices=Notices())[0]
    np.testing.assert_array_equal(only.truth, both[:1])


def test_two_bands_without_names_need_classes(tmp_path):
    tile(tmp_path / "city.tif")
    tile(tmp_path / "city_mask.tif", values=np.concatenate([disc(), 1 - disc()]))
    with pytest.raises(InputError, match="which class each band"):
        read_pairs(tmp_path, notices=Notices())
    pair = read_pairs(tmp_path, classes=("vegetation", "canopy"), notices=Notices())[0]
    np.testing.assert_array_equal(pair.truth[0], 100 * disc()[0])


def test_colours_of_masks_need_a_palette(tmp_path):
    tile(tmp_path / "city.tif")
    painted = np.concatenate([np.zeros((1, SIDE, SIDE), np.uint8), 255 * disc(), np.zeros((1, SIDE, SIDE), np.uint8)])
    tile(tmp_path / "city_mask.png", values=painted, driver="PNG", crs=None, place=None)
    with pytest.raises(InputError, match="colours"):
        read_pairs(tmp_path, notices=Notices())
    pair = read_pairs(tmp_path, palette={"canopy": "#00ff00"}, notices=Notices())[0]
    np.testing.assert_array_equal(pair.truth, 100 * disc())


def test_halves_side_by_side_are_image_and_mask(tmp_path):
    left = colours(SIDE, SIDE)
    values = np.concatenate([left, np.repeat(255 * disc(), 3, axis=0)], axis=2)
    tile(tmp_path / "7.png", values=values, driver="PNG", crs=None, place=None)
    notices = Notices()
    pair = read_pairs(tmp_path, label="side-by-side", notices=notices)[0]
    np.testing.assert_array_equal(pair.rgb, left)
    np.testing.assert_array_equal(pair.truth, 100 * disc())
    assert pair.resolution_m == (0.6, 0.6)
    assert notices.count("W_RESOLUTION_ASSUMED") == 1
    assert (
        read_pairs(tmp_path, label="side-by-side", resolution_m=0.25, notices=Notices())[0].resolution_m == (0.25,) * 2
    )


def test_polygons_are_drawn_by_the_share_of_each_pixel(tmp_path):
    tile(tmp_path / "images/a_0.tif")
    tile(tmp_path / "images/a_1.tif", column=5)
    west, north = PLACE[2], PLACE[5]
    shape = box(west + 0.6 * 4.5, north - 0.6 * 20, west + 0.6 * 10, north - 0.6 * 10)
    source = tmp_path / "canopy.gpkg"
    gpd.GeoDataFrame(geometry=[shape], crs=UTM).to_file(source)
    notices = Notices()
    pairs = read_pairs(tmp_path, polygons=source, notices=notices)
    assert pairs.names == ("a_0",)
    assert notices.count("W_NO_POLYGON") == 1
    truth = pairs[0].truth[0]
    assert truth[15, 3:11].tolist() == [0, 50, 100, 100, 100, 100, 100, 0]
    exact = rasterize([shape], out_shape=(SIDE, SIDE), transform=Affine(*PLACE)) * 100.0
    assert abs(truth.mean() - exact.mean()) < 1.0


def green_tile(path: Path, column: int) -> None:
    """Grass on the left with a tree, asphalt on the right."""
    values = np.full((4, SIDE, SIDE), 90, np.uint8)
    values[3, :, :25] = 190
    values += np.random.default_rng(column).integers(0, 6, values.shape, dtype=np.uint8)
    tile(path, column, values=values, meanings="rgbn")


def test_near_infrared_and_points_become_labels(tmp_path):
    for column in range(3):
        green_tile(tmp_path / f"images/oslo_2020_{column}.tif", column)
    points(tmp_path / "trees/oslo_2020_0.json", [(10.5, 8.25), (30.0, 12.0)])
    points(tmp_path / "trees/oslo_2020_2.geojson", [(20.5, 8.5)], column=2, crs=4326)
    pairs = read_pairs(tmp_path, notices=Notices())
    assert pairs.classes == ("canopy", "vegetation")
    assert pairs.groups == ("oslo_2020",) * 3
    np.testing.assert_allclose(pairs[0].trees_px, [(10.5, 8.25), (30.0, 12.0)], atol=1e-3)
    assert len(pairs[1].trees_px) == 0, "an image without a file has no trees"
    np.testing.assert_allclose(pairs[2].trees_px, [(20.5, 8.5)], atol=1e-3)
    canopy, vegetation = pairs[0].truth
    assert (vegetation[:, :25] > 50).all()
    assert (vegetation[:, 25:] < 50).all()
    assert 50 <= canopy[10, 8] <= 100
    assert (canopy[:, 30:] < 50).all()


def test_one_file_of_points_serves_all_images(tmp_path):
    for column in range(2):
        green_tile(tmp_path / f"images/x_{column}.tif", column)
    source = points(tmp_path / "all.gpkg", [(5.5, 6.5), (5.5, 46.5)])
    pairs = read_pairs(tmp_path, trees=source, notices=Notices())
    np.testing.assert_allclose(pairs[0].trees_px, [(5.5, 6.5)], atol=1e-3)
    np.testing.assert_allclose(pairs[1].trees_px, [(5.5, 6.5)], atol=1e-3)


def test_without_points_vegetation_alone_is_told(tmp_path):
    green_tile(tmp_path / "images/a.tif", 0)
    assert read_pairs(tmp_path, notices=Notices()).classes == ("vegetation",)
    with pytest.raises(InputError, match="tree points"):
        read_pairs(tmp_path, classes=("canopy",), notices=Notices())


def test_years_of_one_place_share_it_and_folders_are_groups(tmp_path):
    for year in ("2016", "2020"):
        tile(tmp_path / f"images/rome {year}/tile.tif")
        tile(tmp_path / f"masks/rome {year}/tile.tif", values=disc())
    pairs = read_pairs(tmp_path, notices=Notices())
    assert pairs.groups == ("rome 2016", "rome 2020")
    assert len(set(pairs.places)) == 1
    assert split(pairs, validation_fraction=0.5).training == (0, 1)


def test_large_images_are_cut_into_blocks_that_make_up_the_whole(tmp_path, monkeypatch):
    values, truth = colours(700, 1100), np.random.default_rng(3).integers(0, 2, (1, 700, 1100), dtype=np.uint8)
    write_raster(tmp_path / "big.tif", values)
    write_raster(tmp_path / "big_mask.tif", truth)
    write_raster(tmp_path / "small.tif", values[:, :60, :60])
    write_raster(tmp_path / "small_mask.tif", truth[:, :60, :60])
    points(tmp_path / "trees/big.json", [(500.25, 900.75)])
    pairs = read_pairs(tmp_path, notices=Notices())
    assert len(pairs) == 7
    assert len(set(pairs.places)) == 6, "the small image lies on one block"
    whole, seen = np.zeros_like(values), np.full_like(truth, 255)
    found = []
    for pair in pairs:
        assert max(pair.valid.shape) <= 512
        if pair.name != "small":
            row, col = (int(text) for text in pair.name.removeprefix("big_r").split("c"))
            part = np.s_[:, row : row + pair.valid.shape[0], col : col + pair.valid.shape[1]]
            whole[part], seen[part] = pair.rgb, pair.truth
            found += list(pair.trees_px + np.array([row, col]))
    np.testing.assert_array_equal(whole, values)
    np.testing.assert_array_equal(seen, 100 * truth)
    np.testing.assert_allclose(found, [(500.25, 900.75)], atol=1e-3)


def test_missing_pixels_are_unknown(tmp_path):
    values = colours(SIDE, SIDE)
    values[:, :7] = 0
    tile(tmp_path / "a.tif", values=values, nodata=0)
    tile(tmp_path / "a_mask.tif", values=disc())
    pair = read_pairs(tmp_path, notices=Notices())[0]
    assert not pair.valid[:7].any()
    assert (pair.truth[:, :7] == 255).all()
    assert (pair.truth[:, 7:] <= 100).all()


def test_pairs_are_the_same_whatever_is_kept_and_however_many_work(tmp_path, monkeypatch):
    for column in range(4):
        green_tile(tmp_path / f"images/x_{column}.tif", column)
        points(tmp_path / f"trees/x_{column}.json", [(20.5, 10.5)], column)
    first = [pair.truth for pair in read_pairs(tmp_path, notices=Notices())]
    monkeypatch.setattr(image_pair_store.BlockStore.__init__, "__kwdefaults__", {"kept_bytes": 1})
    again = read_pairs(tmp_path, workers=3, notices=Notices())
    for index in (3, 0, 2, 1, 3):
        np.testing.assert_array_equal(again[index].truth, first[index])


def test_fingerprint_tells_contents_names_and_options_but_not_the_folder(tmp_path):
    first = read_pairs(masked_folder(tmp_path / "a"), notices=Notices()).fingerprint
    assert first == read_pairs(masked_folder(tmp_path / "b"), notices=Notices()).fingerprint
    seen = {first, read_pairs(tmp_path / "b", classes=("vegetation",), notices=Notices()).fingerprint}
    changed = disc()
    changed[0, 0, 0] = 1
    tile(tmp_path / "b/masks/rome_1.tif", column=1, values=changed)
    seen.add(read_pairs(tmp_path / "b", notices=Notices()).fingerprint)
    (tmp_path / "a/images/rome_2.tif").rename(tmp_path / "a/images/rome_3.tif")
    (tmp_path / "a/masks/rome_2.tif").rename(tmp_path / "a/masks/rome_3.tif")
    seen.add(read_pairs(tmp_path / "a", notices=Notices()).fingerprint)
    assert len(seen) == 4


def test_mask_of_another_size_or_place_names_both_files(tmp_path):
    tile(tmp_path / "images/a.tif")
    tile(tmp_path / "masks/a.tif", values=disc()[:, :30])
    with pytest.raises(InputError, match=r"size(.|\n)*40 x 40 px, as .*images/a\.tif") as caught:
        read_pairs(tmp_path, notices=Notices())
    assert str(caught.value.where).endswith("masks/a.tif")
    tile(tmp_path / "masks/a.tif", column=1, values=disc())
    with pytest.raises(InputError, match=r"where its image does(.|\n)*images/a\.tif"):
        read_pairs(tmp_path, notices=Notices())


def test_trees_beside_their_image_are_refused(tmp_path):
    green_tile(tmp_path / "images/a.tif", 0)
    points(tmp_path / "trees/a.json", [(10.0, 10.0)], column=9)
    with pytest.raises(InputError, match="none of the trees"):
        read_pairs(tmp_path, notices=Notices())


@pytest.mark.parametrize(
    ("make", "options", "error", "says"),
    [
        (lambda folder: None, {}, InputError, "no image"),
        (lambda folder: tile(folder / "a.tif"), {}, InputError, "near infrared"),
        (lambda folder: tile(folder / "a.tif"), {"label": "masks"}, InputError, "no image has a mask"),
        (lambda folder: tile(folder / "a.tif"), {"label": "polygons"}, ConfigError, "--polygons"),
        (lambda folder: (tile(folder / "a.tif"), tile(folder / "a.png", driver="PNG")), {}, InputError, "of one name"),
        (lambda folder: (folder / "a.tif").write_text("<VRTDataset/>"), {}, InputError, "a.tif"),
        (lambda folder: masked_folder(folder, high=7), {}, InputError, "classes are"),
        (lambda folder: masked_folder(folder, high=0), {}, InputError, "0 alone"),
        (lambda folder: masked_folder(folder), {"classes": ("canopy", "vegetation")}, InputError, "which class"),
        (lambda folder: tile(folder / "a.png", values=colours(8, 9), driver="PNG", crs=None, place=None),
         {"label": "side-by-side"}, InputError, "halved"),
    ],
)  # fmt: skip
def test_folders_that_are_no_pairs_are_refused_with_a_reason(tmp_path, make, options, error, says):
    make(tmp_path)
    with pytest.raises(error, match=says):
        read_pairs(tmp_path, notices=Notices(), **options)


def test_missing_folder_is_told(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        read_pairs(tmp_path / "nothing", notices=Notices())


def test_file_that_changes_between_looking_and_reading_is_no_traceback(tmp_path):
    pairs = read_pairs(masked_folder(tmp_path), notices=Notices())
    (tmp_path / "images/rome_0.tif").write_bytes(b"II*\0")
    with pytest.raises(InputError, match="rome_0"):
        pairs[0]


def test_zurich_masks_are_read_in_percent(real_data):
    notices = Notices()
    pairs = read_pairs(real_data / "zurich", notices=notices)
    assert len(pairs) == 4
    assert len(set(pairs.places)) == 4
    for pair in pairs:
        assert set(np.unique(pair.truth).tolist()) == {0, 100}
        assert pair.resolution_m == pytest.approx((0.5, 0.5), rel=1e-3)
        assert 0.1 < (pair.truth == 100).mean() < 0.4
    assert json.loads(json.dumps(notices.as_records()))[0]["count"] == 21
