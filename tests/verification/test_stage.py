import json
import sqlite3
from contextlib import closing

import numpy as np
import pandas as pd
import pytest
import rasterio
from pyproj import CRS

from tests.verification.conftest import COUNT, DEAD, PART, UTM, trees_frame
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.geojson import write_points
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.manifest import Export, describe_files, record_exports
from urbanforest_cli.verification.stage import DiffersError, refuse_faults, verify_outputs

STANDING = COUNT - len(DEAD)


def write_geojson(out, name="plants.geojson", change=None):
    """Write all plants, after a change to their rows and places."""
    trees = trees_frame()
    xy = np.column_stack([trees.geometry.x, trees.geometry.y])
    frame = pd.DataFrame(trees[["plant_id", "height_m"]]).assign(easting=xy[:, 0], northing=xy[:, 1])
    frame.loc[list(DEAD), "height_m"] = np.nan
    frame = frame if change is None else change(frame)
    degrees = reproject_xy(frame[["easting", "northing"]].to_numpy(), UTM, CRS.from_epsg(4326))
    write_points(out / name, degrees, frame[["plant_id", "height_m"]])


def record(out, name, growth="grown", **values):
    record_exports(out, [Export(name, "any", "k", growth, files=describe_files(out / name), **values)])


@pytest.fixture
def whole(out):
    """A folder in which all is well."""
    write_geojson(out)
    record(out, "plants.geojson")
    return out


def judged(out, name, *files):
    return next(verdict for verdict in verify_outputs(out, files) if verdict.name == name)


def test_a_whole_folder_is_the_same_throughout(whole):
    register, plants = verify_outputs(whole)
    assert (register.name, register.state, register.plants, register.recorded) == (
        "register.gpkg",
        "same",
        COUNT,
        False,
    )
    assert (plants.name, plants.state, plants.plants, plants.recorded) == ("plants.geojson", "same", COUNT, True)
    assert 0 < plants.largest_distance_m < 0.01
    refuse_faults(whole, [register, plants])


def test_an_output_that_says_other_things_differs_even_if_its_hash_is_recorded(whole):
    def spoil(frame):
        frame.loc[5, "easting"] += 0.02
        frame.loc[6, "plant_id"] = "lot 9-6"
        frame.loc[7, "height_m"] += 1
        return pd.concat([frame.drop(index=8), frame.loc[[9, 10]]])

    write_geojson(whole, change=spoil)
    record(whole, "plants.geojson")
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.plants) == ("differs", COUNT + 1)
    assert [fault.split(" (")[0] for fault in verdict.faults] == [
        "2 plants missing",
        "1 plant not in the register",
        "2 plants there more than once",
        "1 plant elsewhere",
        "1 plant of another height",
    ]
    with pytest.raises(DiffersError, match="lot 9-6") as caught:
        refuse_faults(whole, [verdict])
    assert caught.value.exit_code == 2
    assert caught.value.as_record()["outputs"][0]["plants"] == COUNT + 1


def test_a_file_cut_is_told_with_its_bytes_and_is_unreadable(whole):
    path = whole / "plants.geojson"
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[:-100])
    verdict = judged(whole, "plants.geojson")
    assert verdict.state == "changed"
    assert verdict.faults[0] == f"plants.geojson is cut, {size - 100} of {size} bytes"
    assert "not a whole GeoJSON" in verdict.faults[1]


def test_a_byte_flipped_where_it_changes_no_plant_is_a_change_all_the_same(whole):
    path = whole / "plants.geojson"
    path.write_bytes(path.read_bytes().replace(b"FeatureCollection", b"featureCollection"))
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.faults) == ("changed", ("plants.geojson was changed since it was written",))


def test_a_recorded_output_that_is_gone_is_missing(whole):
    (whole / "plants.geojson").unlink()
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.faults) == ("changed", ("plants.geojson is missing",))


def test_an_output_of_an_earlier_growth_is_stale_and_not_compared(whole):
    write_geojson(whole, change=lambda frame: frame.head(3))
    record(whole, "plants.geojson", growth="grown before")
    verdict = judged(whole, "plants.geojson")
    assert (verdict.state, verdict.plants) == ("stale", None)
    assert verdict.faults == ("shows an earlier growth than the register",)


def test_an_output_of_a_box_is_compared_with_the_plants_in_it(whole):
    box = [500_000, 5_300_000, 500_300, 5_300_600]
    write_geojson(whole, change=lambda frame: frame[frame["easting"] < 500_300])
    record(whole, "plants.geojson", options={"bbox": box})
    verdict = judged(whole, "plants.geojson")
    assert verdict.state == "same"
    assert 0 < verdict.plants < COUNT


def test_a_file_elsewhere_is_compared_without_a_hash(whole, tmp_path):
    write_geojson(tmp_path, "other.geojson", change=lambda frame: frame.drop(index=8))
    (verdict,) = verify_outputs(whole, [tmp_path / "other.geojson"])
    assert (verdict.name, verdict.recorded) == (str(tmp_path / "other.geojson"), False)
    assert verdict.faults == ("1 plant missing (lot 0-8)",)
    (verdict,) = verify_outputs(whole / "register.gpkg", [whole / "plants.geojson"])
    assert (verdict.name, verdict.state, verdict.recorded) == ("plants.geojson", "same", True)
    with pytest.raises(InputError, match="no such output"):
        verify_outputs(whole, [tmp_path / "nowhere.glb"])


def test_an_output_without_plants_is_intact_or_changed(whole):
    (whole / "map.png").write_bytes(b"png")
    record(whole, "map.png")
    assert judged(whole, "map.png").state == "intact"
    (whole / "map.png").write_bytes(b"gnp")
    assert judged(whole, "map.png").state == "changed"


def test_a_torn_manifest_is_a_fault_of_its_own(whole):
    (whole / "exports.json").write_text("{")
    assert judged(whole, "exports.json").faults[0].startswith("exports.json cannot be read")
    assert judged(whole, "plants.geojson").state == "same"


def test_no_register_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="no such register"):
        verify_outputs(tmp_path)


def sql(out, *statements):
    with closing(sqlite3.connect(out / "register.gpkg")) as database, database:
        for statement in statements:
            database.execute(statement)


@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        ("UPDATE gpkg_ogr_contents SET feature_count = 3 WHERE table_name = 'trees'", "'trees': rows 40, cached"),
        ("DELETE FROM rtree_plants_geom WHERE id = 1", "spatial index 39"),
        ("UPDATE skeleton_parts SET bytes = -5", "column 'bytes'"),
        ("UPDATE skeleton_parts SET part = '../../secret'", "names files that are no parts"),
    ],
)  # fmt: skip
def test_a_register_at_odds_with_itself_is_told(whole, statement, fault):
    sql(whole, statement)
    verdict = judged(whole, "register.gpkg")
    assert verdict.state != "same"
    assert fault in " ".join(verdict.faults)


def test_a_tree_that_stands_elsewhere_than_its_plant_is_a_fault_of_the_register(whole):
    frame = trees_frame()
    frame.loc[2, "geometry"] = frame.geometry[3]
    from urbanforest_cli.files.geopackage import write_layers

    write_layers(whole / "register.gpkg", {"trees": frame})
    assert "other places" in judged(whole, "register.gpkg").faults[0]


def test_a_part_of_skeletons_that_changed_or_is_gone_is_told(whole):
    part = whole / "skeletons" / PART
    content = part.read_bytes()
    part.write_bytes(content[:-1] + b"x")
    assert judged(whole, "register.gpkg").faults == (f"skeletons/{PART} is missing or was changed",)
    part.unlink()
    assert judged(whole, "register.gpkg").faults == (f"skeletons/{PART} is missing or was changed",)


def test_a_register_cut_short_is_unreadable_and_the_others_are_held_against_their_hashes(whole):
    path = whole / "register.gpkg"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    try:
        verdicts = verify_outputs(whole)
    except InputError:  # cut so that it no longer says that it is a register
        return
    assert verdicts[0].state in ("unreadable", "differs")
    assert verdicts[0].faults


def write_canopy(out, *, west=499_990.0, empty_at=None, crs=UTM):
    values = np.zeros((620, 620), dtype=np.float32)
    transform = rasterio.Affine(1, 0, west, 0, -1, 5_300_610)
    trees = trees_frame()
    for x, y, height in zip(trees.geometry.x, trees.geometry.y, trees["height_m"], strict=True):
        row, col = rasterio.transform.rowcol(transform, x, y)
        if 0 <= row < 620 and 0 <= col < 620:
            values[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2] = height
    if empty_at is not None:
        x, y = trees.geometry.x[empty_at], trees.geometry.y[empty_at]
        row, col = rasterio.transform.rowcol(transform, x, y)
        values[row - 8 : row + 9, col - 8 : col + 9] = 0
    options = {"driver": "GTiff", "width": 620, "height": 620, "count": 1, "dtype": "float32", "transform": transform}
    with rasterio.open(out / "canopy_height.tif", "w", crs=crs.to_wkt() if crs else None, **options) as raster:
        raster.write(values, 1)


def test_a_canopy_with_all_crowns_is_the_same(whole):
    write_canopy(whole)
    verdict = judged(whole, "canopy_height.tif")
    assert (verdict.state, verdict.plants, verdict.faults) == ("same", None, ())


def test_a_canopy_without_a_crown_or_beside_the_city_is_told(whole):
    tall = int(np.argmax(trees_frame()["height_m"]))
    write_canopy(whole, empty_at=tall)
    verdict = judged(whole, "canopy_height.tif")
    assert verdict.state == "differs"
    assert trees_frame()["plant_id"][tall] in verdict.faults[0]
    write_canopy(whole, west=499_990.0 + 300)
    assert "outside the raster" in judged(whole, "canopy_height.tif").faults[0]


def test_the_command_prints_a_table_and_exits_2_where_anything_differs(whole, runner):
    outcome = runner("verify", whole)
    assert outcome.exit_code == 0
    assert f"plants.geojson  any                {COUNT}" in outcome.stdout
    assert runner("verify", whole, "-q").stdout == ""
    assert [item["state"] for item in json.loads(runner("verify", whole, "--json").stdout)["outputs"]] == ["same"] * 2
    (whole / "plants.geojson").unlink()
    outcome = runner("verify", whole)
    assert outcome.exit_code == 2
    assert "plants.geojson is missing" in outcome.stderr
    outcome = runner("verify", whole, "--json")
    assert outcome.exit_code == 2
    assert [item["state"] for item in json.loads(outcome.stdout)["outputs"]] == ["same", "changed"]


def test_what_stands_is_what_exports_hold(whole):
    trees = read_layer(whole / "register.gpkg", "trees")
    assert int((trees["height_m"] > 0).sum()) == STANDING
