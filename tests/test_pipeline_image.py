import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import geopandas as gpd
import numpy as np
import pandas as pd
import pyproj
import pytest
from shapely.geometry import Point, box

from tests.files.rasters import write_raster
from tests.growth import fake
from tests.reference.tiny_coverage import greenness, info_of, write_image
from urbanforest_cli.core.errors import CrsError, InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.coverage import open_coverage
from urbanforest_cli.files.coverage_models import load_coverage_model
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.geopackage import layer_names, read_layer, write_layers
from urbanforest_cli.files.parameter_models import load_parameter_model
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.imagery import stage as imagery_stage
from urbanforest_cli.pipeline import WORK_FOLDER, Request, plan, populate
from urbanforest_cli.pipeline_image import SNAP_PX, part_over
from urbanforest_cli.regression import stage as regression_stage

CRS = "EPSG:26911"
WEST, NORTH, PIXEL_M = 400_000.2, 3_700_000.8, 0.6
SIDE_M = 60.0
BROWN = np.array([160, 130, 150], np.uint8)
BARE, FAR = "5", "far"
SMALL = ["export.map_width_px=300", "export.view_width_px=200", "export.view_height_px=200", "export.detail=low",
         "export.prototypes_max=10"]  # fmt: skip
INFO = ParameterModelInfo("informed", REGRESSED, (1, 0.1, 0, 0, 1, 0), (10, 2, 1, 5, 20, 5), ("ground_cover",), 64)


class Unsure:
    """Stands in for a network that can tell nothing."""

    def __init__(self, content, info, **options):
        pass

    def predict(self, windows, pixel_m, features):
        low, high = np.array(INFO.low, np.float32), np.array(INFO.high, np.float32)
        n = len(windows)
        return np.tile((low + high) / 2, (n, 1)), np.tile((high - low) * 12**-0.5, (n, 1)), np.full((n, 3), 1 / 3)


@pytest.fixture(scope="module", autouse=True)
def models(tmp_path_factory):
    """A coverage model that sees green, and no trying of models, which has tests of its own."""
    path = tmp_path_factory.mktemp("models") / "green.onnx"
    path.write_bytes(greenness(info_of()))
    green = load_coverage_model(path)
    unsure = SimpleNamespace(path=Path("parameters.onnx"), content=b"model", sha256="of the model", info=INFO)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imagery_stage, "load_coverage_model", lambda path: green)
        patch.setattr("urbanforest_cli.growth.simulate.grow_grove", fake.grow_grove)
        for module in ("urbanforest_cli.pipeline", "urbanforest_cli.regression.stage"):
            patch.setattr(f"{module}.load_parameter_model", lambda path: unsure)
        patch.setattr(regression_stage, "ParameterSession", Unsure)
        yield


def write_city(path, crs=CRS, **more):
    """Six lots of 60 m in two rows, and one far away."""
    corners = {str(i): (WEST + 12 + SIDE_M * (i % 3), NORTH - 12 - SIDE_M * (1 + i // 3)) for i in range(6)}
    corners[FAR] = (WEST + 900, NORTH - 500)
    lots = gpd.GeoDataFrame(
        {"lot_id": list(corners), "zone": "residential"},
        geometry=[box(x, y, x + SIDE_M, y + SIDE_M) for x, y in corners.values()], crs=CRS,
    )  # fmt: skip
    layers = {"lots": lots.to_crs(crs), **more}
    types = {name: str(frame.geom_type.iloc[0]) for name, frame in layers.items()}
    write_layers(path, layers, fresh=True, geometry_types=types)
    return path


def crowns_image(height_px=240, width_px=340, seed=4):
    """Green discs on brown in all lots but the sixth, one of them over the line between two."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:height_px, :width_px]
    rgb = np.repeat(BROWN, height_px * width_px).reshape(3, height_px, width_px)
    places = [(20 + 100 * (lot // 3) + dy, 20 + 100 * (lot % 3) + dx) for lot in range(5)
              for dy, dx in rng.uniform(15, 85, (5, 2))] + [(60, 120)]  # fmt: skip
    for row, col in places:
        disc = np.hypot(rows - row, cols - col) <= rng.uniform(4, 9)
        rgb[:, disc] = np.array([50, 120, 60], np.uint8)[:, None]
    return rgb


@pytest.fixture
def city(tmp_path):
    (tmp_path / "city").mkdir()
    return write_city(tmp_path / "city" / "city.gpkg")


@pytest.fixture
def image(tmp_path):
    return write_image(tmp_path / "aerial.tif", crowns_image())


def request(city, out, *, settings=(), **changes):
    config = load_config(settings=[*SMALL, *settings], environment={}).config
    return Request(**{"city": city, "out": out, "config": config, "seed": 1, "until": "diffuse", **changes})


def hashes_of(out):
    return {p.name: sha256_of(p) for p in out.iterdir() if p.is_file()}


def would(wanted):
    return [step["would"] for step in plan(wanted)]


def no_mapping(monkeypatch):
    def broken(*arguments, **options):
        raise AssertionError("it was mapped again")

    monkeypatch.setattr(imagery_stage, "map_windows", broken)


def test_an_image_in_a_city_planted_where_it_shows_plants_out(city, image, tmp_path):
    out = tmp_path / "out"
    summaries = populate(request(city, out, images=(image,), until="export"))
    assert [s.stage for s in summaries] == ["cover", "stencil", "regress", "diffuse", "place", "grow", "export"]
    assert {"coverage.tif", "register.gpkg", "map.png", "report.json", "plants.geojson"} <= set(hashes_of(out))
    register = out / "register.gpkg"
    skipped = read_layer(register, "skipped").set_index("lot_id")["reason"]
    assert skipped[BARE] == "bare"
    kinds = read_layer(register, "active_areas").set_index("lot_id")["kind"]
    assert set(kinds.drop(FAR)) == {"region"}
    assert kinds[FAR] == "lot"
    assert "W_LOTS_UNSEEN" in summaries[1].notices
    plants = read_layer(register, "plants")
    regions = read_layer(register, "regions").geometry.union_all()
    seen = plants[plants["lot_id"] != FAR]
    assert len(seen) >= 15
    assert seen.within(regions.buffer(0.01)).all()
    assert set(plants["lot_id"]) >= {"0", "1", "2", "3", "4", FAR}
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert [stage["stage"] for stage in report["stages"]][:3] == ["cover", "stencil", "regress"]


def test_a_second_run_does_nothing_and_a_changed_input_does_what_it_must(city, image, tmp_path):
    out = tmp_path / "out"
    wanted = request(city, out, images=(image,))
    assert would(wanted) == ["run"] * 4
    populate(wanted)
    before = hashes_of(out)
    again = populate(wanted)
    assert [s.stage for s in again] == ["cover", "stencil", "regress", "diffuse"]
    assert all(s.up_to_date for s in again)
    assert hashes_of(out) == before
    assert would(wanted) == ["keep"] * 4
    assert would(request(city, out, images=(image,), settings=["context.passes=0"])) == ["keep"] * 3 + ["run"]
    assert would(request(city, out, images=(image,), settings=["regression.zone_spread=0.5"])) == [
        "keep", "keep", "run", "run",
    ]  # fmt: skip
    assert would(request(city, out, images=(image,), settings=["coverage.smallest_region_m2=30.0"])) == [
        "keep", "run", "run", "run",
    ]  # fmt: skip
    recut = populate(request(city, out, images=(image,), settings=["coverage.smallest_region_m2=30.0"]))
    assert [s.up_to_date for s in recut] == [True, False, False, False]
    assert "cover" in read_records(out / "register.gpkg")
    write_image(image, crowns_image(seed=5))
    assert would(wanted) == ["run"] * 4


def test_a_change_of_a_lot_maps_nothing_again(city, image, tmp_path, monkeypatch):
    out = tmp_path / "out"
    populate(request(city, out, images=(image,)))
    lots = gpd.read_file(city, layer="lots")
    lots.loc[0, "geometry"] = lots.geometry[0].buffer(-3)
    write_layers(city, {"lots": lots}, fresh=True, geometry_types={"lots": "Polygon"})
    no_mapping(monkeypatch)
    assert [s.up_to_date for s in populate(request(city, out, images=(image,)))] == [True, False, False, False]


def test_a_map_that_somebody_changed_is_made_again(city, image, tmp_path):
    out = tmp_path / "out"
    populate(request(city, out, images=(image,)))
    before = hashes_of(out)["coverage.tif"]
    with (out / "coverage.tif").open("ab") as file:
        file.write(b"more")
    assert would(request(city, out, images=(image,)))[0] == "run"
    summaries = populate(request(city, out, images=(image,)))
    assert [s.up_to_date for s in summaries] == [False, True, True, True]
    assert hashes_of(out)["coverage.tif"] == before


def test_without_the_image_the_chain_is_that_of_the_rules(city, image, tmp_path):
    plain, out = tmp_path / "plain", tmp_path / "out"
    populate(request(city, plain, until="place"))
    populate(request(city, out, images=(image,)))
    summaries = populate(request(city, out, until="place"))
    assert [s.stage for s in summaries] == ["stencil", "diffuse", "place"]
    assert "regressed" not in layer_names(out / "register.gpkg")
    assert len(read_layer(out / "register.gpkg", "regions")) == 0
    one, two = (read_layer(folder / "register.gpkg", "plants") for folder in (plain, out))
    pd.testing.assert_frame_equal(one, two)
    assert (out / "coverage.tif").exists()


def test_a_map_given_is_as_good_as_the_image_it_was_made_from(city, image, tmp_path):
    populate(request(city, tmp_path / "one", images=(image,)))
    coverage = tmp_path / "coverage.tif"
    shutil.copy(tmp_path / "one" / "coverage.tif", coverage)
    summaries = populate(request(city, tmp_path / "two", coverage=coverage))
    assert [s.stage for s in summaries] == ["stencil", "regress", "diffuse"]
    assert not (tmp_path / "two" / "coverage.tif").exists()
    for layer in ("regions", "active_areas", "parameters", "regressed"):
        one, two = (read_layer(tmp_path / name / "register.gpkg", layer) for name in ("one", "two"))
        pd.testing.assert_frame_equal(one, two)


def test_a_run_that_was_killed_after_mapping_does_not_map_again(city, image, tmp_path, monkeypatch):
    out = tmp_path / "out"

    def stopped(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("urbanforest_cli.pipeline.stencil_city", stopped)
        with pytest.raises(KeyboardInterrupt):
            populate(request(city, out, images=(image,)))
    assert [path.name for path in out.iterdir()] == [WORK_FOLDER]
    assert would(request(city, out, images=(image,))) == ["keep", "run", "run", "run"]
    no_mapping(monkeypatch)
    summaries = populate(request(city, out, images=(image,)))
    assert [s.up_to_date for s in summaries] == [True, False, False, False]
    assert sorted(path.name for path in out.iterdir()) == ["coverage.tif", "register.gpkg"]


def test_a_fault_found_after_mapping_costs_no_second_mapping(city, image, tmp_path, monkeypatch):
    out = tmp_path / "out"

    def refused(*arguments, **options):
        raise InputError("no")

    with monkeypatch.context() as patched:
        patched.setattr("urbanforest_cli.pipeline.regress_register", refused)
        with pytest.raises(InputError, match="no"):
            populate(request(city, out, images=(image,)))
    assert [path.name for path in (out / WORK_FOLDER).iterdir()] == ["coverage.tif"]
    no_mapping(monkeypatch)
    populate(request(city, out, images=(image,)))
    assert not (out / WORK_FOLDER).exists()


def test_mapping_alone_writes_the_map_alone(city, image, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert [s.stage for s in populate(request(city, out, images=(image,), until="cover"))] == ["cover"]
    assert list(hashes_of(out)) == ["coverage.tif"]
    no_mapping(monkeypatch)
    assert populate(request(city, out, images=(image,), until="cover"))[0].up_to_date
    assert not populate(request(city, out, images=(image,)))[-1].up_to_date


@pytest.mark.parametrize("what", ["images", "coverage"])
def test_an_image_or_map_of_another_place_is_refused_before_anything_is_done(city, tmp_path, monkeypatch, what):
    no_mapping(monkeypatch)
    elsewhere = (0.6, 0.0, 500_000.0, 0.0, -0.6, 3_700_000.0)
    path = tmp_path / "other.tif"
    if what == "images":
        write_image(path, crowns_image(), transform=elsewhere)
    else:
        write_raster(path, np.full((1, 20, 20), 100, np.uint8), crs=CRS, place=elsewhere)
    given = {what: (path,) if what == "images" else path}
    with pytest.raises(InputError, match="no lot lies in the") as caught:
        populate(request(city, tmp_path / "out", **given))
    assert "x 500000 " in str(caught.value)
    assert "x 400012" in str(caught.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("what", ["sketch", "parameter_model"])
def test_other_files_that_cannot_be_used_are_refused_before_the_image_is_mapped(
    city, image, tmp_path, monkeypatch, what
):
    no_mapping(monkeypatch)
    monkeypatch.setattr("urbanforest_cli.pipeline.load_parameter_model", load_parameter_model)
    path = tmp_path / ("none.gpkg" if what == "sketch" else "none.onnx")
    with pytest.raises(InputError, match="none"):
        populate(request(city, tmp_path / "out", images=(image,), **{what: path}))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("source", ["image", "coverage"])
def test_a_parameter_model_of_another_version_is_refused_before_any_work(city, image, tmp_path, monkeypatch, source):
    given = {"images": (image,)}
    if source == "coverage":
        populate(request(city, tmp_path / "mapped", images=(image,), until="cover"))
        given = {"coverage": tmp_path / "mapped" / "coverage.tif"}
    no_mapping(monkeypatch)
    other = SimpleNamespace(path=Path("m.onnx"), content=b"", sha256="0", info=replace(INFO, features=("crown_size",)))
    monkeypatch.setattr("urbanforest_cli.pipeline.load_parameter_model", lambda path: other)
    with pytest.raises(InputError, match="crown_size"):
        populate(request(city, tmp_path / "out", **given))
    assert not (tmp_path / "out").exists()


def test_lots_in_degrees_meet_an_image_in_metres(tmp_path, image):
    city = write_city(tmp_path / "degrees.gpkg", crs=4326)
    summaries = populate(request(city, tmp_path / "out", images=(image,)))
    assert summaries[1].counts["regions"] > 5


def test_the_part_of_an_image_over_the_lots_is_mapped(city, tmp_path):
    large = np.pad(crowns_image(), ((0, 0), (0, 600), (0, 1400)), constant_values=140)
    lots = gpd.read_file(city, layer="lots")
    near = lots[lots["lot_id"] != FAR]
    write_layers(city, {"lots": near}, fresh=True, geometry_types={"lots": "Polygon"})
    path = write_image(tmp_path / "large.tif", large)
    populate(request(city, tmp_path / "out", images=(path,), until="cover"))
    with open_coverage(tmp_path / "out" / "coverage.tif", notices=Notices()) as reader:
        assert (reader.grid.height_px, reader.grid.width_px) == (2 * SNAP_PX, 2 * SNAP_PX)


def test_the_part_stays_when_a_lot_changes_a_little_and_lies_within_the_image():
    grid = RasterGrid(3000, 2000, (0.5, 0.0, 0.0, 0.0, -0.5, 1000.0), pyproj.CRS.from_epsg(32633))
    one = part_over(np.array([[300.0, 410, 350, 450], [500, 600, 560, 640]]), grid)
    two = part_over(np.array([[303.0, 410, 350, 450], [500, 600, 557, 640]]), grid)
    assert one == two
    assert one == pytest.approx((256, 1000 - 1280 / 2, 640, 1000 - 512 / 2), abs=0.01)
    assert part_over(np.array([[-900.0, -900, 5000, 5000]]), grid) is None
    corner = part_over(np.array([[-50.0, 990, 10, 1200]]), grid)
    assert corner == pytest.approx((0, 1000 - 256 / 2, 128, 1000), abs=0.01)


def test_a_map_of_somebody_else_is_not_written_over(city, image, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write_raster(out / "coverage.tif", np.zeros((1, 4, 4), np.uint8))
    before = hashes_of(out)
    with pytest.raises(OutputExistsError, match=r"coverage\.tif"):
        populate(request(city, out, images=(image,)))
    assert hashes_of(out) == before


def test_a_sketch_painted_over_the_image_lies_where_the_image_does(city, image, tmp_path, monkeypatch):
    values = np.zeros((4, 240, 340), np.uint8)
    values[1:, 40:80, 40:80] = 255
    sketch = write_raster(tmp_path / "paint.png", values, driver="PNG", crs=None, place=None, meanings="rgba")
    populate(request(city, tmp_path / "out", images=(image,), sketch=sketch))
    lots = read_layer(tmp_path / "out" / "register.gpkg", "lots").set_index("lot_id")
    drawn = lots[lots["origin"] == "sketch"]
    assert len(drawn) == 1
    assert drawn["area_m2"].iloc[0] == pytest.approx(24.0**2, rel=0.01)
    middle = drawn.geometry.iloc[0].centroid
    assert middle.distance(Point(WEST + 36, NORTH - 36)) < 0.1
    small = write_raster(tmp_path / "small.png", values[:, 1:], driver="PNG", crs=None, place=None, meanings="rgba")
    no_mapping(monkeypatch)
    with pytest.raises(CrsError, match="340 x 239"):
        populate(request(city, tmp_path / "new", images=(image,), sketch=small))


def test_observed_plants_are_kept_as_they_are(tmp_path, image):
    place = Point(WEST + 12 + 30, NORTH - 12 - 30)
    known = gpd.GeoDataFrame({"id": [7], "crown_diameter_m": [6.0]}, geometry=[place], crs=CRS)
    city = write_city(tmp_path / "known.gpkg", observed_plants=known)
    populate(request(city, tmp_path / "out", images=(image,), keep_observed=True, until="place"))
    observed = read_layer(tmp_path / "out" / "register.gpkg", "observed")
    assert observed[["observed_id", "lot_id"]].to_numpy().tolist() == [["7", "0"]]
    plants = read_layer(tmp_path / "out" / "register.gpkg", "plants").set_index("plant_id")
    assert plants.loc["observed:7", "envelope_radius_m"] == pytest.approx(3.0)
    assert plants.loc["observed:7"].geometry.distance(place) < 1e-6
    populate(request(city, tmp_path / "out", images=(image,), until="place"))
    assert not read_layer(tmp_path / "out" / "register.gpkg", "plants")["plant_id"].str.startswith("observed:").any()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--image", "a.tif", "--coverage", "b.tif"], "give one of them"),
        (["--coverage-model", "m.onnx"], "add --image"),
        (["--coverage-model", "m.onnx", "--coverage", "b.tif"], "add --image"),
        (["--parameter-model", "m.onnx"], "add --image or --coverage"),
        (["--until", "cover"], "needs --image"),
        (["--until", "regress"], "needs --image or --coverage"),
    ],
)
def test_options_that_contradict_each_other_are_refused(city, runner, arguments, told):
    outcome = runner("populate", city, *arguments)
    assert outcome.exit_code == 2
    assert told in outcome.stderr


def test_the_command_tells_what_it_would_do_and_does_it(city, image, tmp_path, runner):
    out = tmp_path / "out"
    dry = runner("populate", city, "--image", image, "-o", out, "--dry-run", "--until", "regress")
    assert dry.stdout.split() == ["run", "cover", "run", "stencil", "run", "regress"]
    assert not out.exists()
    done = runner("populate", city, "--image", image, "-o", out, "--until", "regress", "--json")
    assert done.exit_code == 0, done.stderr
    assert [item["stage"] for item in json.loads(done.stdout)] == ["cover", "stencil", "regress"]
    assert describe_output(out / "register.gpkg")["stages"]["cover"]
    missing = runner("populate", city, "--image", tmp_path / "none.tif", "-o", tmp_path / "other")
    assert missing.exit_code == 2
    assert "no such" in missing.stderr


@pytest.mark.parametrize("kind", ["missing", "green", "one pixel"])
def test_images_and_maps_that_say_little_are_taken_as_they_are(city, tmp_path, kind):
    out = tmp_path / "out"
    if kind == "one pixel":
        place = (200.0, 0.0, WEST, 0.0, -150.0, NORTH)
        given = {"coverage": write_raster(tmp_path / "c.tif", np.full((1, 1, 1), 100, np.uint8), crs=CRS, place=place)}
    else:
        values = np.zeros((3, 240, 340), np.uint8)
        values[1] = 120 if kind == "green" else 0
        given = {"images": (write_image(tmp_path / "a.tif", values, nodata=None if kind == "green" else 0),)}
    summaries = populate(request(city, out, **given))
    kinds = read_layer(out / "register.gpkg", "active_areas").set_index("lot_id")["kind"].drop(FAR)
    assert set(kinds) == ({"lot"} if kind == "missing" else {"region"})
    stencil = next(s for s in summaries if s.stage == "stencil")
    assert stencil.notices.count("W_LOTS_UNSEEN") == (7 if kind == "missing" else 1)
