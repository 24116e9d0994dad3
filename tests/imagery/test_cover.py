"""The stage `cover`: images of any make in, maps out."""

import csv
import json
import signal

import numpy as np
import pytest
import rasterio
from PIL import Image

from tests.reference.tiny_coverage import (
    PLACE,
    WIDE_HALO,
    WIDE_STEP,
    garden,
    greenness,
    greenness_of,
    info_of,
    wide,
    write_image,
)
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError
from urbanforest_cli.files.coverage_models import SHIPPED, load_coverage_model
from urbanforest_cli.imagery import stage
from urbanforest_cli.imagery.stage import CoverOptions, cover_image

HEIGHT, WIDTH = 210, 190


@pytest.fixture(scope="module", autouse=True)
def models_read_once():
    """Trying a model in a process of its own is for the tests of `load_coverage_model`."""
    with pytest.MonkeyPatch.context() as patch:
        read = {}

        def load(path):
            content = path.read_bytes()
            if content not in read:
                read[content] = load_coverage_model(path)
            return read[content]

        patch.setattr(stage, "load_coverage_model", load)
        yield


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    seeing = info_of(multiple_px=WIDE_STEP, halo_px=WIDE_HALO)
    for name, content in (("plain", greenness(info_of())), ("wide", wide(seeing))):
        (folder / f"{name}.onnx").write_bytes(content)
    return {name: folder / f"{name}.onnx" for name in ("plain", "wide")}


@pytest.fixture
def image(tmp_path):
    return write_image(tmp_path / "image.tif", garden(HEIGHT, WIDTH))


def moved(row, col, place=PLACE):
    a, b, c, d, e, f = place
    return a, b, c + a * col, d, e, f + e * row


def read_map(path):
    with rasterio.open(path) as file:
        return file.read()


def cover(image, output, model, **more):
    options = {name: more.pop(name) for name in list(more) if name in CoverOptions.__dataclass_fields__}
    images = image if isinstance(image, list) else [image]
    return cover_image(images, output, model=model, options=CoverOptions(**options), **more)


def test_a_map_lies_on_the_image_and_says_what_it_is(tmp_path, image, models):
    summary = cover(image, tmp_path / "map.tif", models["plain"])
    expected = np.rint(100 * greenness_of(garden(HEIGHT, WIDTH)))
    assert np.abs(read_map(tmp_path / "map.tif") - expected).max() <= 1
    with rasterio.open(tmp_path / "map.tif") as file, rasterio.open(image) as source:
        assert (file.transform, file.crs, file.shape) == (source.transform, source.crs, source.shape)
        assert (file.descriptions, file.units) == (("canopy", "vegetation"), ("percent", "percent"))
        told = json.loads(file.tags()["urbanforest"])
    assert told["model"]["thresholds"] == {"canopy": 0.4, "vegetation": 0.5}
    assert [given["name"] for given in told["inputs"]] == ["image.tif"]
    assert summary.counts["canopy_percent"] == pytest.approx(expected[0].mean(), abs=0.3)


def test_same_bytes_for_any_number_of_workers(tmp_path, image, models):
    for workers in (1, 2, 5):
        cover(image, tmp_path / f"{workers}.tif", models["wide"], workers=workers, window_px=64)
    assert len({(tmp_path / f"{workers}.tif").read_bytes() for workers in (1, 2, 5)}) == 1


@pytest.mark.parametrize("scale", [1, 2])
def test_windows_and_boxes_cut_the_same_map(tmp_path, models, scale):
    place = (PLACE[0] / scale, 0.0, PLACE[2], 0.0, PLACE[4] / scale, PLACE[5])
    image = write_image(tmp_path / "image.tif", garden(HEIGHT, WIDTH), transform=place)
    cover(image, tmp_path / "whole.tif", models["wide"], window_px=4096)
    whole = read_map(tmp_path / "whole.tif")
    assert np.ptp(whole) > 60
    for window in (64, 100):
        cover(image, tmp_path / f"{window}.tif", models["wide"], window_px=window)
        assert np.array_equal(read_map(tmp_path / f"{window}.tif"), whole)
    west, north = moved(21, 33, place)[2::3]
    east, south = moved(121, 173, place)[2::3]
    cover(image, tmp_path / "part.tif", models["wide"], bbox=(west + 1e-6, south + 1e-6, east - 1e-6, north - 1e-6))
    assert np.array_equal(read_map(tmp_path / "part.tif"), whole[:, 21:121, 33:173])
    with rasterio.open(tmp_path / "part.tif") as file:
        assert tuple(file.transform)[2:6:3] == pytest.approx((west, north))


def test_an_image_in_parts_gives_the_map_of_the_whole(tmp_path, image, models):
    values = garden(HEIGHT, WIDTH)
    cover(image, tmp_path / "whole.tif", models["wide"])
    folder = tmp_path / "tiles"
    folder.mkdir()
    for row in range(0, HEIGHT, 70):
        for col in range(0, WIDTH, 95):
            part = values[:, row : row + 90, col : col + 110]
            write_image(folder / f"{row}_{col}.tif", part, transform=moved(row, col))
    summary = cover(folder, folder / "map.tif", models["wide"])
    assert summary.counts["images"] == 6
    assert np.array_equal(read_map(folder / "map.tif"), read_map(tmp_path / "whole.tif"))
    assert cover(folder, folder / "map.tif", models["wide"]).up_to_date


def test_feet_degrees_and_metres_tell_the_same(tmp_path, models):
    values = garden(HEIGHT, WIDTH)
    cover(write_image(tmp_path / "metres.tif", values), tmp_path / "m.tif", models["plain"])
    foot = 1200 / 3937
    feet = (0.6 / foot, 0.0, 6_500_000.0, 0.0, -0.6 / foot, 1_850_000.0)
    summary = cover(write_image(tmp_path / "feet.tif", values, transform=feet, crs="EPSG:2229"), tmp_path / "f.tif",
                    models["plain"])  # fmt: skip
    assert summary.notices.count("W_CRS_UNIT") == 1
    degrees = (0.6 / 92_385, 0.0, -118.3, 0.0, -0.6 / 110_922, 34.0)
    cover(write_image(tmp_path / "degrees.tif", values, transform=degrees, crs="EPSG:4326"), tmp_path / "d.tif",
          models["plain"])  # fmt: skip
    assert np.array_equal(read_map(tmp_path / "m.tif"), read_map(tmp_path / "f.tif"))
    assert np.array_equal(read_map(tmp_path / "m.tif"), read_map(tmp_path / "d.tif"))


def test_order_of_bands_and_depth_of_samples_tell_the_same(tmp_path, image, models):
    values = garden(HEIGHT, WIDTH)
    cover(image, tmp_path / "map.tif", models["plain"])
    cover(write_image(tmp_path / "bgr.tif", values[::-1].copy(), colours=("blue", "green", "red")),
          tmp_path / "bgr_map.tif", models["plain"])  # fmt: skip
    cover(write_image(tmp_path / "odd.tif", values[[1, 0, 2]].copy(), colours=("gray", "undefined", "undefined")),
          tmp_path / "odd_map.tif", models["plain"], bands=(2, 1, 3))  # fmt: skip
    deep = (values.astype(np.uint16) * 16).astype(np.uint16)
    cover(write_image(tmp_path / "deep.tif", deep), tmp_path / "deep_map.tif", models["plain"], stretch=(0, 4080))
    expected = read_map(tmp_path / "map.tif")
    for name in ("bgr", "odd", "deep"):
        assert np.array_equal(read_map(tmp_path / f"{name}_map.tif"), expected), name


def test_where_there_is_no_pixel_nothing_is_known(tmp_path, models):
    values = np.concatenate([garden(HEIGHT, WIDTH), np.full((1, HEIGHT, WIDTH), 255, np.uint8)])
    values[3, 50:120, :40] = 0
    values[:3, 50:120, :40] = 0
    image = write_image(tmp_path / "image.tif", values, colours=("red", "green", "blue", "alpha"))
    cover(image, tmp_path / "map.tif", models["wide"])
    unknown = read_map(tmp_path / "map.tif") == 255
    assert np.array_equal(unknown[0], values[3] == 0)
    assert np.array_equal(unknown[0], unknown[1])


def test_an_image_of_nothing_gives_a_map_of_nothing_and_says_so(tmp_path, models):
    image = write_image(tmp_path / "image.tif", np.zeros((3, 40, 50), np.uint8), nodata=0)
    summary = cover(image, tmp_path / "map.tif", models["plain"], preview=tmp_path / "map.png")
    assert (read_map(tmp_path / "map.tif") == 255).all()
    assert "W_NO_PIXELS" in summary.notices
    told = summary.as_record()["counts"]
    assert (told["canopy_percent"], told["vegetation_percent"]) == (None, None)
    assert "nothing is known" in summary.sentence
    assert "%" not in summary.sentence


def test_the_result_reads_as_a_sentence(tmp_path, models):
    image = write_image(tmp_path / "image.tif", garden(40, 50))
    summary = cover(image, tmp_path / "map.tif", models["plain"])
    canopy, vegetation = (summary.counts[f"{name}_percent"] for name in ("canopy", "vegetation"))
    assert summary.sentence == (
        f"canopy {canopy:.2f} %, vegetation {vegetation:.2f} % of the ground (50 x 40 pixels of 0.6 m)"
    )
    values = garden(40, 50)
    values[:, :10] = 0
    holed = write_image(tmp_path / "image.tif", values, nodata=0)
    assert "25 % of them missing" in cover(holed, tmp_path / "map.tif", models["plain"], overwrite=True).sentence


def test_a_second_run_does_nothing_unless_something_changed(tmp_path, image, models):
    output, preview = tmp_path / "map.tif", tmp_path / "map.png"
    assert not cover(image, output, models["plain"]).up_to_date
    first = output.stat()
    assert cover(image, output, models["plain"], workers=2).up_to_date
    assert not cover(image, output, models["plain"], preview=preview).up_to_date
    assert cover(image, output, models["plain"], preview=preview).up_to_date
    assert output.stat().st_ino == first.st_ino
    with pytest.raises(OutputExistsError, match="made of something else"):
        cover(image, output, models["wide"])
    with pytest.raises(OutputExistsError, match="made of something else"):
        cover(image, output, models["plain"], bands=(3, 2, 1))
    write_image(image, garden(HEIGHT, WIDTH, seed=2))
    with pytest.raises(OutputExistsError, match="made of something else"):
        cover(image, output, models["plain"])
    assert not cover(image, output, models["plain"], overwrite=True).up_to_date


def test_a_file_that_says_where_the_image_lies_counts_as_input(tmp_path, models):
    image, world = tmp_path / "image.png", tmp_path / "image.pgw"
    Image.fromarray(garden(40, 50).transpose(1, 2, 0)).save(image)
    world.write_text("0.6\n0\n0\n-0.6\n500000.3\n3699999.7\n")
    cover(image, tmp_path / "map.tif", models["plain"], assume_crs="EPSG:32611")
    world.write_text("0.6\n0\n0\n-0.6\n600000.3\n3699999.7\n")
    with pytest.raises(OutputExistsError):
        cover(image, tmp_path / "map.tif", models["plain"], assume_crs="EPSG:32611")


@pytest.mark.parametrize("what", ["image", "model", "folder", "preview"])
def test_no_input_is_written_over(tmp_path, image, models, what):
    model = tmp_path / "model.onnx"
    model.write_bytes(models["plain"].read_bytes())
    before = image.read_bytes(), model.read_bytes()
    output = {"image": image, "model": model, "folder": tmp_path, "preview": tmp_path / "map.tif"}[what]
    with pytest.raises(OutputExistsError):
        cover(image, output, model, overwrite=True, preview=tmp_path / "map.tif" if what == "preview" else None)
    assert (image.read_bytes(), model.read_bytes()) == before


@pytest.mark.parametrize(("size_m", "what"), [(6.0, "too coarse"), (0.008, "too fine")])
def test_images_of_another_scale_are_refused(tmp_path, models, size_m, what):
    place = (size_m, 0.0, 400_000.0, 0.0, -size_m, 3_700_000.0)
    image = write_image(tmp_path / "image.tif", garden(30, 30), transform=place)
    with pytest.raises(InputError, match=rf"image\.tif: .*{what}"):
        cover(image, tmp_path / "map.tif", models["plain"])
    assert not (tmp_path / "map.tif").exists()


def test_coarse_and_fine_images_are_mapped_and_the_coarse_with_a_warning(tmp_path, models):
    for size_m, warned in ((3.0, True), (0.01, False)):
        place = (size_m, 0.0, 400_000.0, 0.0, -size_m, 3_700_000.0)
        image = write_image(tmp_path / "image.tif", garden(130, 130), transform=place)
        summary = cover(image, tmp_path / "map.tif", models["wide"], overwrite=True)
        assert ("W_COARSE" in summary.notices) == warned
        assert (read_map(tmp_path / "map.tif") <= 100).all()


def test_a_box_beside_the_image_is_refused(tmp_path, image, models):
    with pytest.raises(ConfigError, match="beside the image"):
        cover(image, tmp_path / "map.tif", models["plain"], bbox=(0, 0, 10, 10))


def test_a_box_beyond_all_numbers_holds_the_whole_image(tmp_path, image, models):
    cover(image, tmp_path / "whole.tif", models["plain"])
    cover(image, tmp_path / "map.tif", models["plain"], bbox=(-1.7e308, -1.7e308, 1.7e308, 1.7e308))
    assert np.array_equal(read_map(tmp_path / "map.tif"), read_map(tmp_path / "whole.tif"))


def test_maps_made_before_are_no_images(tmp_path, image, models):
    folder = tmp_path / "folder"
    folder.mkdir()
    image.rename(folder / "image.tif")
    cover(folder, folder / "a.tif", models["plain"], preview=folder / "b.png")
    write_image(folder / "c_coverage.tif", np.zeros((3, 20, 20), np.uint8))
    with rasterio.open(folder / "c_coverage.tif", "r+") as file:
        file.descriptions = ("canopy", "vegetation", "water")
    summary = cover(folder, folder / "d.tif", models["plain"])
    assert np.array_equal(read_map(folder / "d.tif"), read_map(folder / "a.tif"))
    assert (summary.counts["images"], summary.notices.count("W_MAPS_LEFT_OUT")) == (1, 3)
    for name in ("a.tif", "b.png", "c_coverage.tif"):
        with pytest.raises(InputError, match="no image") as caught:
            cover(folder / name, tmp_path / "e.tif", models["plain"])
        assert name in str(caught.value)


def test_a_damaged_image_leaves_no_map_and_no_threads_behind(tmp_path, image, models):
    content = bytearray(image.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 3000] = bytes(3000)
    image.write_bytes(content)
    with pytest.raises(InputError, match=r"image\.tif"):
        cover(image, tmp_path / "map.tif", models["plain"], window_px=64, workers=2)
    assert [path.name for path in tmp_path.iterdir()] == ["image.tif"]


def test_a_stop_on_the_way_leaves_what_was_there(tmp_path, image, models):
    (tmp_path / "map.tif").write_bytes(b"earlier")

    def stop(task, done, total):
        if task == "coverage" and done > 2:
            raise KeyboardInterrupt(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        cover(image, tmp_path / "map.tif", models["wide"], window_px=64, workers=2, overwrite=True, progress=stop)
    assert (tmp_path / "map.tif").read_bytes() == b"earlier"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.tif", "map.tif"]


def test_the_preview_shows_the_image_and_what_was_found(tmp_path, models):
    values = np.full((3, 300, 300), 140, np.uint8)
    values[1, :, :150], values[1, :, 150:] = 200, 90
    image = write_image(tmp_path / "image.tif", values)
    cover(image, tmp_path / "map.tif", models["plain"], preview=tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        assert max(picture.size) <= 2400
        assert json.loads(picture.info["urbanforest"])["format"] == "cover"
        pixels = np.asarray(picture).astype(int)
    row, half = pixels.shape[0] // 2, pixels.shape[1] // 2
    panel = half - 24 - 12
    left, right = 24 + panel // 4, half + 12 + panel // 4
    assert pixels[row, left].tolist() == [140, 200, 140]
    red, green, blue = pixels[row, right]
    assert green > red + 60
    assert green > blue + 30
    bare = pixels[row, right + panel // 2]
    assert np.ptp(bare) <= 2
    assert bare.min() > 150


def test_bad_images_give_what_the_index_says(tmp_path, bad_inputs, models):
    with (bad_inputs / "index.csv").open(encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["kind"] == "tif" and row["role"] == "input"]
    assert len(rows) > 40
    for row in rows:
        output = tmp_path / "map.tif"
        try:
            cover(bad_inputs / row["file"], output, models["plain"])
            got = "read"
        except InputError as error:
            got = "reject"
            told = str(error)
            assert not output.exists(), row["file"]
            assert (bad_inputs / row["file"]).name in told, told
        assert got == ("reject" if row["expected"] == "reject" else "read") or "too coarse" in told, row["file"]
        output.unlink(missing_ok=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(not SHIPPED.exists(), reason="no model comes with the program yet")
def test_the_shipped_model_shows_no_seams_on_real_images(tmp_path, real_data):
    tiles = sorted((real_data / "naip_california/images").glob("*.tif"))[::45][:9]
    values = []
    for tile in tiles:
        with rasterio.open(tile) as file:
            values.append(file.read((1, 2, 3)))
    whole = np.concatenate([np.concatenate(values[i : i + 3], axis=2) for i in (0, 3, 6)], axis=1)
    image = write_image(tmp_path / "image.tif", whole)
    cover(image, tmp_path / "whole.tif", SHIPPED, window_px=4096)
    expected = read_map(tmp_path / "whole.tif")
    thresholds = 100 * np.array(load_coverage_model().info.thresholds)[:, None, None]
    for window, (row, col) in ((128, (0, 0)), (300, (0, 0)), (512, (5, 9)), (256, (130, 77))):
        part = write_image(image, np.ascontiguousarray(whole[:, row:, col:]), transform=moved(row, col))
        cover(part, tmp_path / "map.tif", SHIPPED, window_px=window, overwrite=True)
        found, meant = read_map(tmp_path / "map.tif"), expected[:, row:, col:]
        inside = slice(128, -128) if row else slice(None)
        apart = (found >= thresholds)[:, inside, inside] != (meant >= thresholds)[:, inside, inside]
        assert apart.mean() <= 0.005
