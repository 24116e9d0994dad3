"""Every format, with a fault planted in what is written."""

import dataclasses
import re
import shutil

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.reference.gltf_scenes import MATERIALS, MODELS, properties_of
from tests.verification.conftest import COUNT, DEAD, UTM, trees_frame
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.placed import COLUMNS
from urbanforest_cli.core.scenery import Instances, Origin, Points, Property, Scenery
from urbanforest_cli.export.scene.tiling import tile_scene
from urbanforest_cli.files.cityjson import write_cityjson
from urbanforest_cli.files.gltf import write_glb
from urbanforest_cli.files.itree import write_itree
from urbanforest_cli.files.obj import write_species_library
from urbanforest_cli.files.plant_tables import write_plants_gpkg, write_plants_parquet
from urbanforest_cli.files.tiles3d import write_tiles
from urbanforest_cli.verification.stage import verify_outputs

ORIGIN = Origin(UTM, 500_300.0, 5_300_300.0)


@dataclasses.dataclass
class Rows:
    """Plants to write: ids, places in the working CRS, heights, other columns."""

    plant_id: np.ndarray
    xy: np.ndarray
    height_m: np.ndarray
    columns: dict[str, np.ndarray]

    def take(self, rows):
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Rows(self.plant_id[rows], self.xy[rows], self.height_m[rows], columns)


def standing():
    trees = trees_frame().drop(index=list(DEAD))
    xy = np.column_stack([trees.geometry.x, trees.geometry.y])
    columns = {name: trees[name].to_numpy(copy=True) for name in COLUMNS}
    return Rows(trees["plant_id"].to_numpy(dtype=object, copy=True), xy, columns=columns,
                height_m=trees["height_m"].to_numpy(copy=True))  # fmt: skip


def scene(rows):
    rng = np.random.default_rng(1)
    count = len(rows.plant_id)
    local = np.column_stack([rows.xy - (ORIGIN.easting_m, ORIGIN.northing_m), np.zeros(count)])
    placed = Instances(
        rng.integers(0, len(MODELS), count).astype(np.int32), local, rng.uniform(0, 6, count),
        rng.random(count) < 0.5, rng.uniform(0.8, 1.2, count),
    )  # fmt: skip
    columns = properties_of(count, rng)
    for name, values in (("plant_id", rows.plant_id), ("height_m", rows.height_m.astype(np.float32))):
        columns[name] = dataclasses.replace(columns[name], values=values)
    for name, values in rows.columns.items():
        is_word = values.dtype == object
        words, places = np.unique(values.astype(str), return_inverse=True) if is_word else ((), None)
        columns[name] = Property(
            places.astype(np.uint8) if is_word else values.astype(np.float32),
            "enum" if is_word else "float32", name, tuple(map(str, words)),
        )  # fmt: skip
    return Scenery(ORIGIN, MATERIALS, MODELS, placed, columns)


def table(rows):
    frame = {"plant_id": rows.plant_id, "height_m": rows.height_m, **rows.columns}
    return gpd.GeoDataFrame(frame, geometry=gpd.points_from_xy(*rows.xy.T), crs=UTM)


def write_inventory(path, rows):
    degrees = reproject_xy(rows.xy, UTM, CRS.from_epsg(4326))
    columns = {
        "User Tree ID": rows.plant_id, "Total Height (m)": rows.height_m, "DBH 1 (cm)": 100 * rows.columns["dbh_m"],
        "Crown Base Height (m)": rows.columns["crown_base_m"], "Crown Width (m)": 2 * rows.columns["crown_radius_m"],
    }  # fmt: skip
    write_itree(path, pd.DataFrame({**columns, "Latitude": degrees[:, 1], "Longitude": degrees[:, 0]}), provenance={})


WRITERS = {
    "forest.glb": lambda path, rows: write_glb(path, scene(rows)),
    "plain.glb": lambda path, rows: write_glb(path, scene(rows), plain=True),
    "forest.city.json": lambda path, rows: write_cityjson(path, scene(rows)),
    "forest.city.jsonl": lambda path, rows: write_cityjson(path, scene(rows)),
    "plants.gpkg": lambda path, rows: write_plants_gpkg(path, table(rows), categories=[], provenance={}),
    "plants.parquet": lambda path, rows: write_plants_parquet(path, table(rows), provenance={}),
    "itree.csv": write_inventory,
    "species": lambda path, rows: write_species_library(path, scene(rows), crs=UTM),
    "tiles": lambda path, rows: write_tiles(path, tile_scene({"low": scene(rows)}), provenance={}),
}
NAMES_OF_PYTHON = r"[A-Z]\w*Error|NoneType|\b(dict|str|int)\b"
FILES = [name for name in WRITERS if "." in name]


def move(rows):
    rows.xy[5, 0] += 0.02
    return rows


def rename(rows):
    rows.plant_id[6] = "lot 9-9"
    return rows


def drop(rows):
    return rows.take(np.arange(len(rows.plant_id)) != 7)


def double(rows):
    return rows.take([*range(len(rows.plant_id)), 8, 9])


def stretch(rows):
    rows.height_m[4] += 0.02
    return rows


def replant(rows):
    rows.columns["species"][3] = "acer_platanoides"
    return rows


def thicken(rows):
    rows.columns["dbh_m"][3] += 0.01
    return rows


FAULTS = {
    replant: ["1 plant of another species"],
    thicken: ["1 plant of another diameter"],
    move: ["1 plant elsewhere"],
    rename: ["1 plant missing", "1 plant not in the register"],
    drop: ["1 plant missing"],
    double: ["2 plants there more than once"],
    stretch: ["1 plant of another height"],
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_holds_the_plants_that_stand(out, name):
    WRITERS[name](out / name, standing())
    (verdict,) = verify_outputs(out, [out / name])
    assert (verdict.state, verdict.faults) == ("same", ())
    assert verdict.plants == COUNT - len(DEAD)
    assert verdict.largest_distance_m < 0.01


UNHEARD_OF = [
    *((name, double) for name in WRITERS if "city.json" in name or name == "tiles"),  # see the test below
    ("itree.csv", replant), ("species", thicken),  # which do not state it
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "change"), [(name, change) for name in WRITERS for change in FAULTS if (name, change) not in UNHEARD_OF]
)
def test_a_fault_planted_in_any_format_is_told(out, name, change):
    WRITERS[name](out / name, change(standing()))
    (verdict,) = verify_outputs(out, [out / name])
    assert verdict.state == "differs"
    assert [fault.split(" (")[0] for fault in verdict.faults] == FAULTS[change]


def test_a_plant_twice_is_refused_by_the_writer_of_cityjson_and_by_the_reader_of_tiles(out):
    with pytest.raises(OutputError, match="share a plant_id"):
        WRITERS["forest.city.json"](out / "forest.city.json", double(standing()))
    WRITERS["tiles"](out / "tiles", double(standing()))
    (verdict,) = verify_outputs(out, [out / "tiles"])
    assert verdict.state == "unreadable"
    assert "twice" in verdict.faults[0] or "several" in verdict.faults[0]


@pytest.mark.parametrize("name", FILES)
def test_no_format_cut_anywhere_is_a_fault_of_the_program(out, name):
    WRITERS[name](out / name, standing())
    content = (out / name).read_bytes()
    for size in (0, 10, len(content) // 3, len(content) // 2, len(content) - 20):
        (out / name).write_bytes(content[:size])
        (verdict,) = verify_outputs(out, [out / name])
        assert verdict.state in ("unreadable", "differs"), size
        assert verdict.faults
        assert not re.search(NAMES_OF_PYTHON, " ".join(verdict.faults))


@pytest.mark.parametrize("name", FILES)
def test_no_format_with_bytes_flipped_is_a_fault_of_the_program(out, name):
    WRITERS[name](out / name, standing())
    content = (out / name).read_bytes()
    for place in np.random.default_rng(2).integers(0, len(content), 12).tolist():
        (out / name).write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        (verdict,) = verify_outputs(out, [out / name])
        assert not re.search(NAMES_OF_PYTHON, " ".join(verdict.faults))


def points(rows):
    """Return a scene in which each plant is a point in the middle of its crown."""
    whole = scene(rows)
    middle = whole.instances.xyz_m + np.column_stack([np.zeros((len(rows.plant_id), 2)), rows.height_m / 2])
    dots = Points(middle, np.zeros((len(middle), 3), np.uint8))
    bare = whole.instances.take(np.zeros(0, np.int64))
    return dataclasses.replace(whole, instances=bare, points=dots, provenance={"detail": "point"})


AS_POINTS = {
    "forest.glb": write_glb,
    "forest.city.json": write_cityjson,
    "species": lambda path, made: write_species_library(path, made, crs=UTM),
}


@pytest.mark.parametrize("name", AS_POINTS)
def test_points_in_crowns_are_held_against_the_register_on_the_map(out, name):
    AS_POINTS[name](out / name, points(standing()))
    (verdict,) = verify_outputs(out, [out / name])
    assert (verdict.state, verdict.faults) == ("same", ())
    shutil.rmtree(out / name, ignore_errors=True)
    AS_POINTS[name](out / name, points(move(standing())))
    (verdict,) = verify_outputs(out, [out / name])
    assert [fault.split(" (")[0] for fault in verdict.faults] == ["1 plant elsewhere"]


def test_points_are_off_the_ground_where_the_file_does_not_say_that_they_are_points(out):
    write_glb(out / "forest.glb", dataclasses.replace(points(standing()), provenance={}))
    (verdict,) = verify_outputs(out, [out / "forest.glb"])
    assert "off the ground" in verdict.faults[0]


def test_a_tileset_without_one_of_its_contents_is_told_even_where_no_manifest_names_it(out):
    WRITERS["tiles"](out / "tiles", standing())
    content = next(iter(sorted((out / "tiles").rglob("*.glb"))))
    content.unlink()
    (verdict,) = verify_outputs(out, [out / "tiles"])
    assert (verdict.state, verdict.recorded) == ("unreadable", False)
    assert verdict.faults


def test_an_inventory_elsewhere_is_held_against_the_description_beside_it(out, tmp_path):
    path = tmp_path / "part.csv"
    WRITERS["itree.csv"](path, standing())
    for named in (path, tmp_path / "part.csv-metadata.json"):
        (verdict,) = verify_outputs(out, [named])
        assert (verdict.name, verdict.state) == (str(path), "same")
    path.write_text(path.read_text() + "\n")
    (verdict,) = verify_outputs(out, [path])
    assert "another SHA-256" in verdict.faults[0]
