"""The aerial picture of a city: its truth, its light, its seams and its files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Species
from urbanforest_cli.core.errors import ConfigError, LimitError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.coverage import open_coverage
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.synth.city import SynthCity, build_city
from urbanforest_cli.synth.inventory import SURVEYED_LOTS
from urbanforest_cli.synth.picture import plants as plants_module
from urbanforest_cli.synth.picture.camera_kernel import HIGH_CELLS
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.lines import Lines, Nearby, Outlines
from urbanforest_cli.synth.picture.relief_kernel import (
    PLANT_TOP,
    fill_polygons,
    highest_around,
    in_sun,
    raise_plants,
)
from urbanforest_cli.synth.picture.render import Frame, looks_of, render_tile
from urbanforest_cli.synth.picture.scene import CROWN_REACH, Scene, set_scene
from urbanforest_cli.synth.picture.stage import PictureSettings, lay_grid
from urbanforest_cli.synth.stage import make_city

SEED, LOTS = 4, 130
SUN = np.array([math.sin(2.8) * 0.5, math.cos(2.8) * 0.5, math.sqrt(0.75)])
CATALOGUE = load_catalogue(Species())


@pytest.fixture(scope="module")
def city() -> SynthCity:
    return build_city(LOTS, SEED, CATALOGUE)


@pytest.fixture(scope="module")
def scene(city: SynthCity) -> Scene:
    return set_scene(city, CATALOGUE, SEED)


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("picture")
    picture = PictureSettings(path=folder / "town.tif", nir=True, workers=2)
    make_city(folder / "town.gpkg", lot_count=LOTS, seed=SEED, picture=picture)
    return folder


def read(path: Path) -> NDArray[np.uint8]:
    with rasterio.open(path) as file:
        return np.asarray(file.read())


def test_pixels_lie_on_multiples_of_the_resolution_about_all_of_the_city(taken: Path) -> None:
    with rasterio.open(taken / "town.tif") as image, rasterio.open(taken / "town_coverage.tif") as truth:
        assert image.transform == truth.transform
        assert image.shape == truth.shape
        assert image.crs.to_epsg() == 32633
        assert image.bounds.left / 0.6 == pytest.approx(round(image.bounds.left / 0.6), abs=1e-6)
        west, south, east, north = gpd.read_file(taken / "town.gpkg", layer="lots").total_bounds
        assert image.bounds.left < west
        assert image.bounds.right > east
        assert image.bounds.bottom < south
        assert image.bounds.top > north
    with open_coverage(taken / "town_coverage.tif", notices=Notices()) as coverage:
        assert coverage.classes == ("canopy", "vegetation")


def test_truth_is_whole_and_canopy_is_vegetation(taken: Path) -> None:
    canopy, vegetation = read(taken / "town_coverage.tif").astype(int)
    assert vegetation.max() == 100
    assert (canopy <= vegetation).all()
    assert 1 < canopy.mean() < vegetation.mean() < 60
    assert len(np.unique(canopy)) > 10


def test_counted_trees_are_canopy_and_canopy_is_near_plants(taken: Path, scene: Scene) -> None:
    canopy = read(taken / "town_coverage.tif")[0]
    trees = gpd.read_file(taken / "town.gpkg", layer="observed_plants")
    trees = trees[trees["crown_diameter_m"] > 4]
    with rasterio.open(taken / "town.tif") as image:
        row, col = rasterio.transform.rowcol(image.transform, trees.geometry.x, trees.geometry.y)
    assert (canopy[row, col] >= 50).mean() > 0.97
    assert canopy.mean() / 100 * canopy.size * 0.36 < np.pi * (scene.plants.table[:, 3] ** 2).sum()


def test_plants_shine_in_the_near_infrared_and_pavement_does_not(taken: Path) -> None:
    red, _, _, near = read(taken / "town.tif").astype(float)
    canopy, vegetation = read(taken / "town_coverage.tif")
    ndvi = (near - red) / (near + red + 1e-6)
    assert np.median(ndvi[canopy >= 90]) > 0.25
    assert (ndvi[canopy >= 90] > 0.1).mean() > 0.9
    assert (ndvi[vegetation == 0] < 0.1).mean() > 0.9


def test_counts_are_like_those_of_aerial_surveys(taken: Path) -> None:
    """The national programme's tiles of seven Californian cities: mean 90-127, deviation 31-52 by tile, here wider."""
    rgb = read(taken / "town.tif")[:3].astype(float)
    assert (np.abs(rgb.mean(axis=(1, 2)) - 110) < 25).all()
    assert (np.abs(rgb.std(axis=(1, 2)) - 40) < 15).all()
    light = rgb.mean(axis=0)
    assert 5 < np.abs(np.diff(light, axis=1)).mean() < 11


def test_any_number_of_workers_takes_the_same_picture_and_leaves_the_city_as_it_is(
    taken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1735689600")
    picture = PictureSettings(path=tmp_path / "town.tif", nir=True, workers=1)
    make_city(tmp_path / "town.gpkg", lot_count=LOTS, seed=SEED, picture=picture)
    make_city(tmp_path / "alone.gpkg", lot_count=LOTS, seed=SEED)
    for name in ("town.tif", "town_coverage.tif"):
        assert (tmp_path / name).read_bytes() == (taken / name).read_bytes()
    assert (tmp_path / "town.gpkg").read_bytes() == (tmp_path / "alone.gpkg").read_bytes()


def test_tiles_cut_elsewhere_show_the_same(scene: Scene) -> None:
    """What stands outside a tile shades it just as it shades its neighbour."""
    frame = Frame(-60.0, 60.0, 0.6, 160, 160)
    looks = looks_of(scene)
    whole, truth = render_tile(scene, looks, frame, (0, 0, 160, 160), SEED)
    for row, col in ((0, 0), (70, 90)):
        part, part_truth = render_tile(scene, looks, frame, (row, col, 70, 70), SEED)
        assert np.array_equal(part_truth, truth[:, row : row + 70, col : col + 70])
        apart = part.astype(int) - whole[:, row : row + 70, col : col + 70]
        assert np.abs(apart).max() < 25
        assert apart.std() < 4.5


def test_another_seed_is_another_city_and_each_thing_keeps_its_draws() -> None:
    few, many = Draws(1, "lot", 5), Draws(1, "lot", 9)
    assert np.array_equal(few.uniform("tone"), many.uniform("tone")[:5])
    assert not np.array_equal(few.uniform("tone"), few.uniform("other"))
    assert not np.array_equal(few.uniform("tone"), Draws(2, "lot", 5).uniform("tone"))


@pytest.mark.parametrize("radius", [0.8, 2.5, 4.0, 7.0])
def test_crowns_cover_their_discs_and_nothing_far_beyond(radius: float) -> None:
    step, size, half = radius / 30, 120, 2 * radius
    covered, farthest, brightest, darkest = [], 0.0, 0.0, 1.0
    for salt in range(30):
        z, facing = np.zeros((size, size), np.float32), np.ones((size, size), np.float32)
        top, owner = np.zeros((size, size), np.uint8), np.zeros((size, size), np.int32)
        plants = np.array([[0.0, 0.0, 2.2 * radius, radius, 0.7 * radius, 500.0 + salt]])
        raise_plants(plants, np.array([0]), SUN, -half, half, step, z, top, owner, facing)
        row, col = np.nonzero(top == PLANT_TOP)
        covered.append(len(row) * step**2 / (np.pi * radius**2))
        farthest = max(farthest, float(np.hypot((col + 0.5) * step - half, half - (row + 0.5) * step).max()))
        brightest, darkest = max(brightest, float(facing.max())), min(darkest, float(facing.min()))
        assert 1.6 * radius < z.max() <= 2.4 * radius + 0.3
    assert np.mean(covered) == pytest.approx(1.0, abs=0.08)
    assert farthest < CROWN_REACH * radius
    assert darkest < 0.7 < 1.0 < brightest


def test_shadows_fall_away_from_the_sun_as_far_as_they_must() -> None:
    step = 0.15
    z, top = np.zeros((300, 300), np.float32), np.zeros((300, 300), np.uint8)
    z[140:160, 140:160] = 6.0
    high = highest_around(z, HIGH_CELLS)
    sun = np.array([0.0, -0.5, math.sqrt(0.75)])  # in the south: shadows fall north, to lower rows
    shade = [in_sun(z, top, high, HIGH_CELLS, row, 150, sun, step, 6.0) for row in range(300)]
    assert all(seen == 1.0 for seen in shade[160:])
    dark = 140 - sum(seen == 0.0 for seen in shade[:140])
    assert (140 - dark) * step == pytest.approx(6.0 * 0.5 / math.sqrt(0.75), abs=0.4)


def test_polygons_are_filled_as_shapely_sees_them_with_their_holes() -> None:
    ring = shapely.Point(3.1, 2.2).buffer(5.3).difference(shapely.Point(4.0, 2.0).buffer(2.1))
    shapes = np.array([ring, shapely.MultiPolygon([shapely.box(-9, -9, -6, -5), shapely.box(6, -9, 9, -7)])])
    outlines = Outlines.of(shapes)
    out = np.full((100, 100), -1, np.int32)
    number = np.arange(2)
    fill_polygons(outlines.xy, outlines.ring_ends, outlines.polygon_ends, number, number, -10.0, 10.0, 0.2, out)
    x, y = np.meshgrid(-10 + 0.2 * (np.arange(100) + 0.5), 10 - 0.2 * (np.arange(100) + 0.5))
    for index, shape in enumerate(shapes):
        assert np.array_equal(out == index, shapely.contains_xy(shape, x, y))


def test_what_is_nearby_is_found() -> None:
    rng = np.random.default_rng(0)
    xy, reach = rng.uniform(-300, 300, (500, 2)), rng.uniform(0, 9, 500)
    box = (-40.0, 10.0, 60.0, 90.0)
    found = Nearby.of(xy, reach).within(box)
    near = shapely.dwithin(shapely.points(xy), shapely.box(*box), reach)
    assert set(np.flatnonzero(near)) <= set(found)
    assert len(found) < 200
    assert (np.diff(found) > 0).all()
    assert not len(Nearby.of(xy, reach).within((900.0, 900.0, 950.0, 950.0)))
    assert not len(Nearby.of(np.empty((0, 2)), np.empty(0)).within(box))


def test_places_along_lines_and_clear_of_them() -> None:
    bent = shapely.LineString([(0, 0), (10, 0), (10, 20)])
    lines = Lines.of(np.array([bent, shapely.LineString([(50, 0), (60, 0)])]), np.array([3.0, 1.0]))
    xy, way = lines.places(np.array([0, 0, 1]), np.array([4.0, 15.0, 2.0]), np.array([2.0, 1.0, 0.0]))
    assert xy == pytest.approx(np.array([[4.0, 2.0], [9.0, 5.0], [52.0, 0.0]]))
    assert way == pytest.approx(np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
    clear = lines.clear_of(np.array([[4.0, 4.5], [4.0, 5.5], [55.0, 2.5], [55.0, 3.5]]), 2.0)
    assert clear.tolist() == [False, True, False, True]


def test_lots_beyond_the_survey_are_planted_too(city: SynthCity, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not plants_module.unsurveyed_plants(city, CATALOGUE, SEED)
    assert len(city.lots) < SURVEYED_LOTS
    half = len(city.lots) // 2
    monkeypatch.setattr(plants_module, "surveyed_lots", lambda lots: np.arange(half))
    monkeypatch.setattr(plants_module, "SURVEYED_LOTS", 40)
    parts = plants_module.unsurveyed_plants(city, CATALOGUE, SEED)
    assert len(parts) == math.ceil((len(city.lots) - half) / 40)
    points = shapely.points(np.concatenate([part.table[:, :2] for part in parts]))
    lot = shapely.STRtree(city.lots.shapes).query(points, predicate="within")[1]
    assert np.mean(np.isin(np.arange(half, len(city.lots)), lot)) > 0.4


@pytest.mark.parametrize("lots", [10, 40])
def test_small_cities_have_pictures(tmp_path: Path, lots: int) -> None:
    picture = PictureSettings(path=tmp_path / "t.tif", resolution_m=1.7)
    summary = make_city(tmp_path / "t.gpkg", lot_count=lots, seed=1, crs="EPSG:3857", picture=picture)
    assert read(tmp_path / "t.tif").shape[0] == 3
    assert 0 < float(summary.counts["canopy_percent"]) < float(summary.counts["vegetation_percent"])


def test_pictures_that_cannot_be_are_refused_before_anything_is_written(tmp_path: Path, scene: Scene) -> None:
    with pytest.raises(LimitError, match="resolution"):
        make_city(
            tmp_path / "t.gpkg", lot_count=10, seed=1,
            picture=PictureSettings(path=tmp_path / "t.tif", resolution_m=0.01),
        )  # fmt: skip
    (tmp_path / "t_coverage.tif").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"t_coverage\.tif"):
        make_city(tmp_path / "t.gpkg", lot_count=10, seed=1, picture=PictureSettings(path=tmp_path / "t.tif"))
    assert not (tmp_path / "t.gpkg").exists()
    with pytest.raises(LimitError, match="too large"):
        lay_grid(scene, 0.001, CRS.from_epsg(32633), (0.0, 0.0))


@pytest.mark.parametrize(
    ("city", "image"), [("t.tif", "t.tif"), ("t_coverage.tif", "t.tif"), ("t_coverage.tif", "inner/../t.tif")]
)
def test_city_and_picture_need_names_of_their_own(tmp_path: Path, city: str, image: str) -> None:
    (tmp_path / "inner").mkdir()
    with pytest.raises(OutputExistsError, match="names of their own"):
        make_city(tmp_path / city, lot_count=10, seed=1, picture=PictureSettings(path=tmp_path / image), overwrite=True)
    assert not (tmp_path / city).exists()


@pytest.mark.parametrize("name", ["t.png", "t.gpkg", "t"])
def test_a_picture_of_another_ending_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"ends in \.tif"):
        make_city(tmp_path / "t.gpkg", lot_count=10, seed=1, picture=PictureSettings(path=tmp_path / name))
    assert not (tmp_path / "t.gpkg").exists()


def test_the_command_takes_a_picture(tmp_path: Path, runner: Callable[..., Any]) -> None:
    city, image = tmp_path / "c.gpkg", tmp_path / "c.tif"
    result = runner("synth", "--lots", "10", "-o", city, "--image", image, "--image-resolution", "1", "--nir", "--json")
    assert result.exit_code == 0, result.stderr
    assert read(image).shape[0] == 4
    assert '"canopy_percent"' in result.stdout
    assert runner("synth", "--lots", "10", "-o", tmp_path / "d.gpkg", "--nir").exit_code == 2
