"""A study made of a planted city: what is drawn, and the command around it."""

import io
import json
import re
import shutil

import geopandas as gpd
import numpy as np
import pytest
import shapely
from PIL import Image

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.main import guarded
from urbanforest_cli.pipeline_study import PICTURE_PX, make_study


@pytest.fixture
def planted(tiny_city, tmp_path):
    """A planted city, and known plants: of each lot's own, moved by a metre."""
    out = tmp_path / "forest"
    assert guarded(["populate", str(tiny_city), "-o", str(out), "--until", "place", "-q"]) == 0
    plants = read_layer(out / "register.gpkg", "plants")
    plants.geometry = plants.translate(1.0, 0.0)
    real = tmp_path / "real.geojson"
    plants[["geometry"]].to_file(real)
    return out, real


def pixels(study, name):
    return np.asarray(Image.open(study / "pictures" / f"{name}.png").convert("RGB")).astype(int)


def green(picture):
    return (picture[..., 1] > picture[..., 0] + 15) & (picture[..., 1] > picture[..., 2] + 5)


def test_pictures_of_a_lot_differ_in_plants_alone(planted, tmp_path):
    out, real = planted
    summary = make_study(out / "register.gpkg", tmp_path / "study", observed=str(real), lots_shown=2, min_plants=2)
    key = json.loads((tmp_path / "study" / "key.json").read_text())
    assert summary.counts["pairs"] == len(key["trials"]) == 4
    assert {item["category"] for item in key["pictures"]} == {"real", "placed", "random"}
    for trial in key["trials"]:
        one, other = (pixels(tmp_path / "study", trial[side]) for side in ("real", "other"))
        assert one.shape == other.shape == (PICTURE_PX, PICTURE_PX, 3)
        assert green(one).sum() > 500 < green(other).sum()
        assert (one != other).any()
        corner = slice(0, 20)  # beyond every lot: the same ground
        assert (one[corner, corner] == other[corner, corner]).all()


def test_real_plants_stand_where_they_were_seen(planted, tmp_path):
    out, _ = planted
    lots = read_layer(out / "register.gpkg", "lots").set_index("lot_id")
    west, south, east, north = shapely.bounds(lots.geometry["c"])
    spots = [(west + 10, south + 10), (east - 10, north - 10)]
    real = tmp_path / "two.geojson"
    gpd.GeoDataFrame(geometry=shapely.points(spots), crs=lots.crs).to_file(real)
    make_study(out / "register.gpkg", tmp_path / "study", observed=str(real), lots_shown=5, min_plants=2)
    key = json.loads((tmp_path / "study" / "key.json").read_text())
    assert {trial["lot_id"] for trial in key["trials"]} == {"c"}  # the only lot with two known plants
    picture = green(pixels(tmp_path / "study", key["trials"][0]["real"]))
    rim = 0.08 * 60 + 2.0
    for x, y in spots:
        col = int((x - west + rim) / (60 + 2 * rim) * PICTURE_PX)
        row = int((north + rim - y) / (60 + 2 * rim) * PICTURE_PX)
        assert picture[row - 5 : row + 5, col - 5 : col + 5].mean() > 0.9


def test_the_same_seed_makes_the_same_study(planted, tmp_path):
    out, real = planted
    for name, seed in (("one", 0), ("two", 0), ("other", 1)):
        make_study(out / "register.gpkg", tmp_path / name, observed=str(real), lots_shown=1, min_plants=2, seed=seed)
    one, two, other = (
        {path.name: path.read_bytes() for path in sorted((tmp_path / name).rglob("*")) if path.is_file()}
        for name in ("one", "two", "other")
    )
    assert one == two
    assert set(one) != set(other)


def test_the_command_writes_a_kit_beside_the_city_and_scores_what_comes_back(planted, runner, tmp_path):
    out, real = planted
    again = tmp_path / "again"
    shutil.copytree(out, again)
    line = ["study", out, "--observed", real, "--lots", 1, "--min-plants", 2, "--also", f"rules={again}"]
    assert runner(*line).exit_code == 0
    study = out / "study"
    page = (study / "questionnaire.html").read_text()
    shown = json.loads(re.search(r'id="study">(.*?)</script>', page).group(1))
    key = json.loads((study / "key.json").read_text())
    assert {item["category"] for item in key["trials"]} == {"placed", "random", "rules"}
    Image.open(io.BytesIO((study / "pictures" / f"{key['trials'][0]['real']}.png").read_bytes())).verify()
    answers = [
        {"trial_id": name, "left": left, "right": right, "choice": "left", "milliseconds": 900}
        for name, left, right in shown["trials"]
    ]
    record = {"format": shown["format"], "study_id": shown["study_id"], "rater": "x", "run": "x", "answers": answers}
    (tmp_path / "answers.json").write_text(json.dumps(record))
    told = runner("study-score", study, tmp_path / "answers.json")
    assert told.exit_code == 0
    assert "chosen over real" in told.stdout
    assert runner(*line).exit_code == 2  # it is there
    assert runner(*line, "--overwrite").exit_code == 0
    for wrong in ("rules", f"real={again}", "=x"):
        assert runner(*line[:-1], wrong, "--overwrite").exit_code == 2


def test_the_register_of_another_city_is_refused(planted, tmp_path, tiny_city):
    out, real = planted
    layers = {name: gpd.read_file(tiny_city, layer=name) for name in ("lots", "buildings")}
    elsewhere = tmp_path / "elsewhere.gpkg"
    for name, frame in layers.items():
        frame.geometry = frame.translate(500.0, 0.0)
        frame.to_file(elsewhere, layer=name)
    other = tmp_path / "other"
    assert guarded(["populate", str(elsewhere), "-o", str(other), "--until", "place", "-q"]) == 0
    with pytest.raises(InputError, match="another city"):
        make_study(out / "register.gpkg", tmp_path / "s", observed=str(real), also={"rules": other / "register.gpkg"})


def test_other_settings_make_another_study(planted, tmp_path):
    out, real = planted
    ids = []
    for name, least in (("one", 2), ("two", 1)):
        make_study(out / "register.gpkg", tmp_path / name, observed=str(real), lots_shown=1, min_plants=least)
        ids.append(json.loads((tmp_path / name / "key.json").read_text())["study_id"])
    assert ids[0] != ids[1]


def test_a_city_without_known_plants_in_its_lots_is_refused(planted, tmp_path):
    out, real = planted
    with pytest.raises(InputError, match="no lot can be shown"):
        make_study(out / "register.gpkg", tmp_path / "study", observed=str(real), min_plants=5000)
    assert not (tmp_path / "study").exists()
