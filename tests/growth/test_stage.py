import json
import shutil
import threading

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS

from tests.growth import fake
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import ConfigError, InputError, SchemaError, StaleError
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.schema import OLDEST_YEARS
from urbanforest_cli.core.skeleton import measure, select
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.geopackage import layer_names, read_layer, write_layers
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.files.skeletons import read_parts, read_texts
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.stage import grow_key, grow_plants, show_year
from urbanforest_cli.placement.stage import place_key, place_plants

SEED = 1
SIZES = ["height_m", "crown_radius_m", "crown_base_m", "dbh_m", "internode_count"]


@pytest.fixture(scope="session")
def planted(tmp_path_factory):
    """A register with plants, made once."""
    from urbanforest_cli.context.stage import diffuse_parameters
    from urbanforest_cli.register.stage import stencil_city
    from urbanforest_cli.synth.stage import make_city

    folder = tmp_path_factory.mktemp("planted")
    make_city(folder / "city.gpkg", lot_count=60, seed=3)
    register = folder / "register.gpkg"
    stencil_city(folder / "city.gpkg", register, config=Config(), seed=SEED)
    diffuse_parameters(register, config=Config(), seed=SEED)
    place_plants(register, config=Config(), seed=SEED)
    return register


class Calls:
    """The fake kernel, and which plants it was asked to grow."""

    def __init__(self):
        self.keys = []
        self.stop_after = None
        self.lock = threading.Lock()

    def __call__(self, grove, surroundings, traits, config):
        with self.lock:
            self.keys.append(grove.keys)
            if self.stop_after is not None and len(self.keys) > self.stop_after:
                raise KeyboardInterrupt
        return fake.grow_grove(grove, surroundings, traits, config)

    def plants(self, plant_ids):
        asked = set(np.concatenate([np.empty(0, np.uint64), *self.keys]).tolist())
        return {
            plant for plant, key in zip(plant_ids, keys_for(SEED, "grow", plant_ids), strict=True) if int(key) in asked
        }


@pytest.fixture
def calls(monkeypatch):
    found = Calls()
    monkeypatch.setattr("urbanforest_cli.growth.simulate.grow_grove", found)
    return found


@pytest.fixture
def register(planted, tmp_path):
    path = tmp_path / "a" / "register.gpkg"
    path.parent.mkdir()
    shutil.copyfile(planted, path)
    return path


def copy_of(register, name):
    path = register.parent.parent / name / "register.gpkg"
    path.parent.mkdir()
    shutil.copyfile(register, path)
    return path


def grow(register, *settings, **options):
    config = load_config(settings=settings, environment={}).config
    return grow_plants(register, config=config, seed=SEED, **options)


def trees_of(register):
    return read_layer(register, "trees")


def part_hashes(register):
    return {path.name: sha256_of(path) for path in (register.parent / "skeletons").iterdir()}


def same_forest(one, other):
    """All that was grown is equal, to the bit."""
    pd.testing.assert_frame_equal(trees_of(one), trees_of(other))
    for name in ("groves", "skeleton_parts"):
        pd.testing.assert_frame_equal(read_layer(one, name), read_layer(other, name))
    assert part_hashes(one) == part_hashes(other)


# every plant


def test_every_plant_has_a_skeleton_or_a_reason_and_the_counts_add_up(register, calls):
    summary = grow(register)
    plants, trees = read_layer(register, "plants"), trees_of(register)
    assert trees["plant_id"].tolist() == plants["plant_id"].tolist()
    assert trees.geometry.geom_equals(plants.geometry).all()
    assert set(trees["grown"]) == {"unique", "dead", "none"}
    assert (trees["reason"].isna() == (trees["grown"] == "unique")).all()
    assert (trees["skeleton_id"].isna() == (trees["grown"] == "none")).all()
    counts = summary.counts
    assert counts["unique"] + counts["library"] + counts["dead"] + counts["no_room"] == counts["plants"] == len(plants)
    assert counts["internodes_generated"] == sum(
        counts[f"internodes_{name}"] for name in ("retained", "shed", "pruned")
    )
    assert trees["internode_count"].sum() == counts["internodes_retained"]
    assert read_records(register)["grow"].counts["plants"] == len(plants)


def test_the_parts_hold_what_the_layers_say(register, calls):
    grow(register)
    folder = register.parent / "skeletons"
    files = read_layer(register, "skeleton_parts").set_index("part")
    assert part_hashes(register) == files["sha256"].to_dict()
    assert {path.name: path.stat().st_size for path in folder.iterdir()} == files["bytes"].to_dict()
    trees = trees_of(register).dropna(subset="skeleton_id")
    found = read_parts(folder, skeleton_ids=trees["skeleton_id"].astype("int64").to_numpy())
    sizes = measure(found)
    np.testing.assert_allclose(sizes["height_m"], trees["height_m"], atol=6e-4)
    np.testing.assert_array_equal(sizes["internode_count"], trees["internode_count"])
    texts = read_texts(folder, "plant_id")
    assert [texts[int(number)] for number in trees["skeleton_id"]] == trees["plant_id"].tolist()
    groves = read_layer(register, "groves")
    assert groves["plant_count"].sum() == files["skeleton_count"].sum()
    lots = dict(zip(trees["plant_id"], trees["lot_id"], strict=True))
    for (part, group), members in groves.groupby(["part", "row_group"]):
        inside = read_parts(folder, row_groups={part: [group]})
        assert len(inside) == members["plant_count"].sum()
        assert {lots.get(texts[int(number)]) for number in inside.skeleton_id} - {None} <= set(members["lot_id"])


def test_a_plant_inside_a_building_has_no_room_and_is_nobodys_neighbour(register, calls):
    plants = read_layer(register, "plants")
    lot = plants["lot_id"].value_counts().index[0]
    inside = plants.index[plants["lot_id"] == lot][0]
    house = shapely.buffer(plants.geometry[inside], 0.3)
    buildings = read_layer(register, "buildings")
    row = gpd.GeoDataFrame({"building_id": ["shed"], "height_m": [3.0]}, geometry=[house], crs=buildings.crs)
    write_layers(register, {"buildings": pd.concat([buildings, row], ignore_index=True)})
    summary = grow(register)
    tree = trees_of(register).loc[inside]
    assert (tree["grown"], tree["reason"]) == ("none", "no_room")
    assert tree["height_m"] == 0
    assert "W_NO_ROOM" in summary.notices
    assert plants["plant_id"][inside] not in calls.plants(plants["plant_id"].tolist())


def test_street_trees_are_lifted_by_the_clearance_of_their_zone(register, monkeypatch):
    seen = {}

    def looked_at(grove, surroundings, traits, config):
        seen.update(zip(grove.keys.tolist(), grove.clearance_m.tolist(), strict=True))
        return fake.grow_grove(grove, surroundings, traits, config)

    monkeypatch.setattr("urbanforest_cli.growth.simulate.grow_grove", looked_at)
    grow(register, "growth.crown_clearance_m={street=3.5}")
    plants = read_layer(register, "plants")
    zones = read_layer(register, "lots").set_index("lot_id")["zone"]
    for plant, key in zip(plants.itertuples(), keys_for(SEED, "grow", plants["plant_id"]), strict=True):
        street_tree = zones[plant.lot_id] == "street" and plant.habit == "tree"
        assert seen.get(int(key), 3.5 * street_tree) == 3.5 * street_tree


def test_the_middle_of_the_lots_says_how_the_sun_goes(register, calls, monkeypatch):
    from urbanforest_cli.growth import sunlight

    asked = []

    def light_from(latitude, share):
        asked.append(latitude)
        return sunlight.light_from(latitude, share)

    monkeypatch.setattr("urbanforest_cli.growth.stage.light_from", light_from)
    grow(register)
    lots = read_layer(register, "lots")
    assert asked[0] == pytest.approx(lots.to_crs(CRS.from_epsg(4326)).geometry.iloc[0].centroid.y, abs=0.3)


def test_plants_of_an_unknown_species_are_refused(register, calls):
    plants = read_layer(register, "plants")
    plants.loc[0, "species"] = "yggdrasil"
    write_layers(register, {"plants": plants})
    with pytest.raises(ConfigError, match="yggdrasil"):
        grow(register)


def test_a_register_without_plants_names_the_command(register):
    for missing, command in (("place", "urbanforest place"),):
        records = read_layer(register, "provenance", geometry=False)
        write_layers(register, {"provenance": records[records["stage"] != missing]})
        with pytest.raises(SchemaError, match=command):
            grow(register)


# the same bits


@pytest.mark.parametrize("workers", [2, 4])
def test_the_number_of_workers_does_not_matter(register, calls, workers):
    other = copy_of(register, "b")
    grow(register)
    grow(other, workers=workers)
    same_forest(register, other)


def test_the_order_of_rows_does_not_matter(register, calls):
    other = copy_of(register, "b")
    shuffled = {
        name: read_layer(other, name).sample(frac=1, random_state=2) for name in ("plants", "lots", "buildings")
    }
    write_layers(other, shuffled)
    grow(register)
    grow(other)
    assert part_hashes(register) == part_hashes(other)
    order = trees_of(register)["plant_id"].tolist()
    assert (
        trees_of(other)
        .set_index("plant_id")
        .loc[order]
        .reset_index()
        .equals(trees_of(register)[trees_of(other).set_index("plant_id").reset_index().columns])
    )


def test_the_size_of_parts_and_row_groups_changes_no_skeleton(register, calls, monkeypatch):
    other = copy_of(register, "b")
    grow(register)
    monkeypatch.setattr("urbanforest_cli.growth.batches.PLANTS_A_PART", 20)
    monkeypatch.setattr("urbanforest_cli.growth.parts.NODES_A_ROW_GROUP", 100)
    grow(other)
    assert len(part_hashes(other)) > len(part_hashes(register))
    pd.testing.assert_frame_equal(trees_of(register), trees_of(other))
    ids = trees_of(register)["skeleton_id"].dropna().astype("int64").to_numpy()
    one, two = (read_parts(path.parent / "skeletons", skeleton_ids=ids) for path in (register, other))
    np.testing.assert_array_equal(one.xyz_m, two.xyz_m)
    np.testing.assert_array_equal(one.parent, two.parent)


# only what changed


def test_a_second_run_grows_nothing(register, calls):
    grow(register)
    before = part_hashes(register)
    calls.keys.clear()
    summary = grow(register)
    assert calls.keys == []
    assert summary.counts["groves_reused"] == summary.counts["groves"]
    assert part_hashes(register) == before


def older(register, lot):
    """Let the plants of a lot be ten years older."""
    plants = read_layer(register, "plants")
    plants.loc[plants["lot_id"] == lot, "age_years"] += 10.0
    write_layers(register, {"plants": plants})
    return plants


def test_a_changed_lot_grows_again_with_its_neighbours_alone_and_the_bits_are_those_of_a_full_run(register, calls):
    grow(register)
    plants = read_layer(register, "plants")
    lot = plants["lot_id"].value_counts().index[3]
    older(register, lot)
    full = copy_of(register, "full")
    calls.keys.clear()
    summary = grow(register)
    again = calls.plants(plants["plant_id"].tolist())
    own = plants[plants["lot_id"] == lot]
    grown_again = plants[plants["plant_id"].isin(again)]
    assert set(own["plant_id"]) <= again
    reach = own.geometry.union_all().buffer(45.0)
    for _, members in grown_again.groupby("lot_id"):
        assert members.geometry.union_all().distance(reach) == 0
    assert 0 < summary.counts["groves"] - summary.counts["groves_reused"] < 0.5 * summary.counts["groves"]
    grow(full)
    same_forest(register, full)


def test_other_settings_traits_and_seeds_grow_all_again(register, calls):
    grow(register)
    for settings, seed in ((("growth.voxel_m=0.5",), SEED), ((), 2)):
        config = load_config(settings=settings, environment={}).config
        summary = grow_plants(register, config=config, seed=seed)
        assert summary.counts["groves_reused"] == 0
    assert len(part_hashes(register)) == summary.counts["parts"]


def test_a_plant_older_than_any_lives_as_long_as_the_oldest_does(register, calls):
    other = copy_of(register, "b")
    plants = read_layer(register, "plants")
    for path, age in ((register, OLDEST_YEARS), (other, 250.0)):
        plants.loc[plants.index[0], "age_years"] = age
        write_layers(path, {"plants": plants})
        grow(path)
    assert trees_of(register).drop(columns="age_years").equals(trees_of(other).drop(columns="age_years"))
    assert part_hashes(register) == part_hashes(other)
    plants.loc[plants.index[0], "age_years"] = 1.01 * OLDEST_YEARS
    with pytest.raises(SchemaError, match="age_years"):
        write_layers(register, {"plants": plants})


def test_settings_that_choose_who_grows_leave_what_has_grown(register, calls):
    first = grow(register)
    again = grow(register, "growth.unique_plants_max=4000", "growth.library_size_max=7")
    assert again.counts["groves_reused"] == first.counts["groves"]


def test_the_key_knows_growth_and_the_key_of_place_does_not():
    catalogue = load_catalogue(Config().species)
    base = {"config": Config(), "seed": 1, "catalogue": catalogue}
    config = Config.model_validate({"growth": {"environment": "shadow"}})
    assert grow_key("a", **base) != grow_key("b", **base)
    assert grow_key("a", **base) != grow_key("a", **base | {"config": config})
    assert place_key("a", **base) == place_key("a", **base | {"config": config})


# torn runs


def test_a_run_that_is_stopped_leaves_the_old_and_the_next_goes_on(register, calls, monkeypatch):
    monkeypatch.setattr("urbanforest_cli.growth.batches.PLANTS_A_PART", 30)
    old = grow(register, "growth.voxel_m=0.5")
    before, layers = part_hashes(register), sha256_of(register)
    calls.keys.clear()
    calls.stop_after = old.counts["groves"] // 2
    with pytest.raises(KeyboardInterrupt):
        grow(register)
    assert sha256_of(register) == layers
    between = part_hashes(register)
    assert before.items() <= between.items()
    assert len(between) > len(before)
    calls.stop_after = None
    calls.keys.clear()
    summary = grow(register)
    assert 0 < len(calls.keys) < summary.counts["groves"]
    assert len(part_hashes(register)) == summary.counts["parts"]
    full = copy_of(register, "full")
    grow(full)
    same_forest(register, full)


@pytest.mark.parametrize("damage", ["removed", "cut", "changed", "foreign"])
def test_a_damaged_part_is_grown_again(register, calls, damage):
    grow(register)
    before = part_hashes(register)
    path = sorted((register.parent / "skeletons").iterdir())[0]
    content = path.read_bytes()
    if damage == "removed":
        path.unlink()
    else:
        changed = {"cut": content[:-200], "changed": content[:300] + b"x" + content[301:], "foreign": b"hello"}
        path.write_bytes(changed[damage])
    summary = grow(register)
    assert part_hashes(register) == before
    assert "W_SKELETONS_CHANGED" in summary.notices
    assert "W_SKELETONS_CHANGED" not in read_records(register)["grow"].notices


def test_a_broken_part_that_no_register_names_is_not_trusted(register, calls):
    grow(register)
    before = part_hashes(register)
    place_plants(register, config=Config(), seed=SEED)
    path = sorted((register.parent / "skeletons").iterdir())[0]
    content = bytearray(path.read_bytes())
    content[200:260] = bytes(60)  # within the first pages: the file's own account at its end stays whole
    path.write_bytes(content)
    summary = grow(register)
    assert part_hashes(register) == before
    assert summary.notices.count("W_SKELETONS_CHANGED") == 1
    assert 0 < summary.counts["groves_reused"] < summary.counts["groves"]


def test_files_of_others_in_the_folder_stay(register, calls):
    folder = register.parent / "skeletons"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "part-mine.parquet").write_text("mine")
    (folder / f"part-{'0' * 24}.parquet").write_text("an older part, torn")
    grow(register)
    assert {"notes.txt", "part-mine.parquet"} <= set(part_hashes(register))
    assert f"part-{'0' * 24}.parquet" not in part_hashes(register)


def test_place_takes_the_trees_out_and_grow_finds_its_groves_again(register, calls):
    first = grow(register)
    place_plants(register, config=Config(), seed=SEED)
    assert not {"trees", "groves", "skeleton_parts"} & set(layer_names(register))
    assert "grow" not in read_records(register)
    assert grow(register).counts["groves_reused"] == first.counts["groves"]


# who grows in its own place


def test_only_lots_in_focus_grow_and_the_rest_keeps_what_it_has(register, calls):
    plants = read_layer(register, "plants")
    first, second = plants["lot_id"].value_counts().index[:2]
    summary = grow(register, focus_lots=[first])
    trees = trees_of(register)
    assert set(trees["lot_id"][trees["grown"] == "unique"]) == {first}
    assert set(trees["reason"][trees["lot_id"] != first]) <= {"out_of_focus", "no_room"}
    assert summary.counts["out_of_focus"] == (trees["reason"] == "out_of_focus").sum() > 0
    assert read_records(register)["grow"].stage_key != key_of(register)
    grow(register, focus_lots=[second])
    trees = trees_of(register)
    assert set(trees["lot_id"][trees["grown"] == "unique"]) == {first, second}
    full = copy_of(register, "full")
    grow(register)
    grow(full)
    same_forest(register, full)
    grow(register, focus_lots=[second])
    assert read_records(register)["grow"].stage_key == key_of(register)


def key_of(register):
    catalogue = load_catalogue(Config().species)
    return grow_key(read_records(register)["place"].stage_key, config=Config(), seed=SEED, catalogue=catalogue)


def test_a_box_puts_the_lots_of_its_plants_in_focus(register, calls):
    plants = read_layer(register, "plants")
    x, y = plants.geometry[0].x, plants.geometry[0].y
    grow(register, bbox=(x - 1, y - 1, x + 1, y + 1))
    trees = trees_of(register)
    assert set(trees["lot_id"][trees["grown"] == "unique"]) == {plants["lot_id"][0]}
    with pytest.raises(InputError, match="--bbox"):
        grow(register, bbox=(x, y, x, y))


@pytest.mark.parametrize("settings", [(), ("growth.detail=library",)])
def test_a_focus_without_a_plant_is_refused(register, calls, settings):
    lots = read_layer(register, "lots", geometry=False)["lot_id"]
    bare = sorted(set(lots) - set(read_layer(register, "plants")["lot_id"]))[0]
    for place, focus in (("--bbox", {"bbox": (0, 0, 1, 1)}), ("--only", {"focus_lots": [bare]})):
        with pytest.raises(InputError, match=place) as refused:
            grow(register, *settings, **focus)
        assert refused.value.found
        assert refused.value.expected
    assert "trees" not in layer_names(register)


@pytest.mark.parametrize("detail", ["unique", "library"])
def test_a_city_whose_plants_all_stand_inside_a_building_has_no_room_for_any(register, calls, detail):
    plants, buildings = read_layer(register, "plants"), read_layer(register, "buildings")
    hall = shapely.MultiPolygon([shapely.box(*plants.total_bounds).buffer(5.0)])
    row = gpd.GeoDataFrame({"building_id": ["hall"], "height_m": [9.0]}, geometry=[hall], crs=buildings.crs)
    write_layers(register, {"buildings": row})
    summary = grow(register, f"growth.detail={detail}")
    trees = trees_of(register)
    assert set(trees["grown"]) == {"none"}
    assert set(trees["reason"]) == {"no_room"}
    assert summary.counts["no_room"] == len(plants)
    assert summary.counts["groves"] == summary.counts["parts"] == 0
    show_year(register, -3)
    assert set(trees_of(register)["reason"]) == {"no_room"}
    assert calls.keys == []


def test_a_register_without_a_plant_grows_nothing(register, calls):
    write_layers(register, {"plants": read_layer(register, "plants").iloc[:0]})
    for detail in ("unique", "library"):
        assert grow(register, f"growth.detail={detail}").counts["plants"] == 0


def test_lots_out_of_focus_keep_what_they_have_whatever_the_settings(register, calls):
    grow(register)
    before = trees_of(register)
    plants = read_layer(register, "plants")
    lot, other = plants["lot_id"].value_counts().index[:2]
    old = read_layer(register, "groves").set_index("grove_id")["grow_key"]
    full = copy_of(register, "full")
    calls.keys.clear()
    summary = grow(register, "growth.voxel_m=0.5", focus_lots=[lot])
    own = before[(before["lot_id"] == lot) & (before["reason"] != "no_room")]
    assert (
        set(own["plant_id"])
        <= calls.plants(plants["plant_id"].tolist())
        <= set(plants["plant_id"][plants["lot_id"] == lot])
    )
    assert summary.counts["out_of_focus"] == 0
    assert "W_KEPT_AS_GROWN" in summary.notices
    pd.testing.assert_frame_equal(trees_of(register), before)  # voxels are nothing to these plants
    groves = read_layer(register, "groves").set_index("grove_id")
    changed = groves.index[groves["grow_key"] != old.reindex(groves.index)]
    assert set(groves["lot_id"][changed]) == {lot}
    mixed = read_records(register)["grow"].stage_key
    catalogue = load_catalogue(Config().species)
    now = load_config(settings=("growth.voxel_m=0.5",), environment={}).config
    place = read_records(register)["place"].stage_key
    assert mixed not in {key_of(register), grow_key(place, config=now, seed=SEED, catalogue=catalogue)}
    calls.keys.clear()
    grow(register, "growth.voxel_m=0.5", focus_lots=[lot])
    assert calls.keys == []
    assert read_records(register)["grow"].stage_key == mixed
    grow(register, "growth.voxel_m=0.6", focus_lots=[other])
    grow(register, "growth.voxel_m=0.5", focus_lots=[lot])  # the same words, another city
    assert read_records(register)["grow"].stage_key != mixed
    grow(register, "growth.voxel_m=0.5")
    assert "W_KEPT_AS_GROWN" not in read_records(register)["grow"].notices
    grow(full, "growth.voxel_m=0.5")
    same_forest(register, full)


def test_what_grew_of_other_plants_is_not_kept(register, calls):
    grow(register)
    plants = read_layer(register, "plants")
    first, lot = plants["lot_id"].value_counts().index[:2]
    records = read_layer(register, "provenance", geometry=False)
    records.loc[records["stage"] == "place", "stage_key"] = "another"
    write_layers(register, {"provenance": records})
    grow(register, "growth.voxel_m=0.5", focus_lots=[lot])
    trees = trees_of(register)
    assert set(trees["reason"][trees["lot_id"] == first]) <= {"out_of_focus", "no_room"}


def test_plants_placed_again_as_they_were_take_what_has_grown(register, calls):
    grow(register)
    place_plants(register, config=Config(), seed=SEED)
    calls.keys.clear()
    lot = read_layer(register, "plants")["lot_id"].value_counts().index[0]
    assert grow(register, focus_lots=[lot]).counts["out_of_focus"] == 0
    assert calls.keys == []
    assert read_records(register)["grow"].stage_key == key_of(register)


def test_what_cannot_be_kept_is_told_and_never_grown_under_its_old_name(register, calls, monkeypatch):
    grow(register)
    before = sha256_of(register)
    lot = read_layer(register, "plants")["lot_id"].value_counts().index[0]

    def broken(store, grove):
        raise SchemaError("torn")

    monkeypatch.setattr("urbanforest_cli.files.skeleton_parts.GroveStore.skeletons", broken)
    with pytest.raises(StaleError, match="without --only"):
        grow(register, "growth.voxel_m=0.5", focus_lots=[lot])
    assert sha256_of(register) == before


def test_a_lot_in_focus_that_is_not_there_is_refused(register, calls):
    with pytest.raises(InputError, match="nowhere"):
        grow(register, focus_lots=["nowhere"])


LIBRARY = ("growth.detail=library", "growth.library_size_max=30", "growth.library_sample=4")


def test_a_library_gives_every_plant_a_skeleton_and_tells_how_far_it_is(register, calls):
    plants = read_layer(register, "plants")
    lot = plants["lot_id"].value_counts().index[0]
    summary = grow(register, *LIBRARY, focus_lots=[lot])
    trees = trees_of(register)
    groves = read_layer(register, "groves")
    assert (groves["kind"] == "library").sum() <= 30
    assert summary.counts["library"] > summary.counts["unique"] > 0
    shared = trees[trees["grown"] == "library"]
    assert (shared["key_distance"] >= 0).all()
    assert shared["skeleton_id"].nunique() <= 30
    assert shared["scale"].between(0.7, 1.4).all()
    assert set(trees["grown"][trees["lot_id"] == lot]) <= {"unique", "dead", "none"}
    own = trees[trees["grown"] == "unique"]
    assert own["key_distance"].isna().all()
    assert (own["scale"] == 1).all()
    assert summary.counts["library_compared"] > 0
    assert 0 <= summary.counts["library_overlap_median"] <= 1
    counts = summary.counts
    assert sum(counts[name] for name in ("unique", "library", "dead", "no_room")) == counts["plants"]
    texts = read_texts(register.parent / "skeletons", "plant_id")
    species = dict(zip(plants["plant_id"], plants["species"], strict=True))
    assert [species[texts[int(number)]] for number in shared["skeleton_id"]] == shared["species"].tolist()
    again = grow(register, *LIBRARY, focus_lots=[lot])
    assert again.counts["groves_reused"] == again.counts["groves"]
    assert trees_of(register).equals(trees)


def test_the_library_counts_plants_that_stand_in_one_way_only(register, calls):
    counts = grow(register, *LIBRARY).counts
    assert counts["library_one_dead"] > 0
    assert counts["library_compared"] + counts["library_one_dead"] == 3 * 4


def aside(own_deg, entry_deg, mirror, yaw_deg):
    """How far the sides of boxes lie from those of their own rows."""
    lies = entry_deg * np.where(mirror, -1.0, 1.0) + yaw_deg
    return np.abs((own_deg - lies + 45.0) % 90.0 - 45.0)


def test_pruned_plants_of_the_library_lie_along_their_rows(register, calls, monkeypatch):
    from urbanforest_cli.growth import detail

    plants = read_layer(register, "plants")
    plants["pruning_factor"] = 0.6
    write_layers(register, {"plants": plants})
    seen, told = {}, []

    def looked_at(ground, choice, *rest):
        seen.update(ground=ground, library=choice.library)
        return detail.stand_of(ground, choice, *rest)

    def described(*columns, **more):
        told.append(more)
        return describe(*columns, **more)

    describe = detail.describe
    monkeypatch.setattr("urbanforest_cli.growth.stage.stand_of", looked_at)
    monkeypatch.setattr(detail, "describe", described)
    grow(register, *LIBRARY, "growth.crown_clearance_m={street=3.5}")
    ground, trees = seen["ground"], trees_of(register)
    city = ground.city
    own, planned = np.degrees(city.azimuth_rad[ground.rows]), seen["library"]
    assert np.ptp(own) > 30
    assert np.median(aside(own, own[planned.entry[planned.of_plant]], planned.mirror, planned.yaw_deg)) < 2.0
    azimuth = dict(zip(city.plant_id, np.degrees(city.azimuth_rad), strict=True))
    shared = trees[trees["grown"] == "library"]
    texts = read_texts(register.parent / "skeletons", "plant_id")
    entry = np.array([azimuth[texts[int(number)]] for number in shared["skeleton_id"]])
    own = np.array([azimuth[plant] for plant in shared["plant_id"]])
    assert np.median(aside(own, entry, shared["mirror"] == 1, shared["yaw_deg"].to_numpy())) < 2.0
    assert told, "no entry was left out: nothing was matched again"
    for more in told:
        np.testing.assert_array_equal(more["row_azimuth_rad"], city.azimuth_rad[ground.rows])
        np.testing.assert_array_equal(more["clearance_m"], city.clearance_m[ground.rows])
        assert more["clearance_m"].max() == 3.5


def test_auto_means_unique_for_few_plants_and_the_library_for_many(register, calls):
    assert grow(register).counts["detail"] == "unique"
    assert grow(register, "growth.unique_plants_max=10", *LIBRARY[1:]).counts["detail"] == "library"


# the years


def test_a_year_tells_sizes_of_then_without_growing(register, calls):
    grow(register)
    today, key, before = trees_of(register), read_records(register)["grow"].stage_key, part_hashes(register)
    newest = int(np.ceil(today["age_years"].max()))
    calls.keys.clear()
    summary = show_year(register, newest // 2)
    then = trees_of(register)
    assert calls.keys == []
    assert part_hashes(register) == before
    assert read_records(register)["grow"].stage_key != key
    assert read_records(register)["grow"].config["year"] == summary.counts["year"] == newest // 2
    ago = newest - newest // 2
    unborn = np.ceil(today["age_years"]) - ago < 1
    assert ((then["reason"] == "unborn") == (unborn & today["skeleton_id"].notna())).all()
    assert (then.loc[unborn, "height_m"] == 0).all()
    alive = (then["grown"] == "unique") & (today["grown"] == "unique")
    seasons = np.maximum(np.ceil(today["age_years"][alive]), 1)
    np.testing.assert_allclose(then["height_m"][alive], (seasons - ago) * fake.STEP_M, atol=2e-3)
    assert ((today["grown"] == "dead") & (then["grown"] == "unique")).any()
    show_year(register, -ago)
    pd.testing.assert_frame_equal(trees_of(register), then)
    show_year(register, newest)
    pd.testing.assert_frame_equal(trees_of(register), today)
    assert read_records(register)["grow"].stage_key == key


def test_a_year_of_a_library_is_that_of_its_skeletons(register, calls):
    grow(register, *LIBRARY)
    today = trees_of(register)
    show_year(register, -5)
    then = trees_of(register)
    shared = (then["grown"] == "library") & (today["grown"] == "library")
    assert shared.any()
    assert (then["height_m"][shared] < today["height_m"][shared]).mean() > 0.9
    show_year(register, None)
    pd.testing.assert_frame_equal(trees_of(register), today)


def test_a_year_without_skeletons_of_these_plants_is_refused(register, calls):
    with pytest.raises(StaleError, match="without --year"):
        show_year(register, 3)
    grow(register)
    for year in (-1000, 1000):
        with pytest.raises(InputError, match="--year"):
            show_year(register, year)
    next((register.parent / "skeletons").iterdir()).unlink()
    with pytest.raises(StaleError):
        show_year(register, 3)


# the kernel itself


def test_a_small_city_grows_for_real(register):
    plants = read_layer(register, "plants")
    write_layers(register, {"plants": plants[plants["age_years"] < 12].reset_index(drop=True)})
    summary = grow(register, workers=2)
    trees = trees_of(register)
    grown = trees[(trees["grown"] == "unique") & (trees["age_years"] >= 1)]
    assert (trees["grown"] == "unique").sum() > 0.8 * len(trees)
    assert (grown["height_m"] > 0).all()
    assert grown.groupby("habit")["height_m"].median()["tree"] > grown.groupby("habit")["height_m"].median()["shrub"]
    assert summary.counts["internodes_generated"] == read_layer(register, "skeleton_parts")["internode_count"].sum()
    skeletons = read_parts(register.parent / "skeletons")
    assert len(select(skeletons, [0])) == 1
    assert json.loads(json.dumps(summary.as_record()))["counts"]["parts"] >= 1
