import json
import shutil
import struct
from dataclasses import replace

import numpy as np
import pytest
from pyproj import CRS, Transformer

from tests.reference.gltf_scenes import MATERIALS, MODELS, cone, properties_of
from tests.reference.tiles_checks import Content, faults, positions
from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.scenery import Fixed, Instances, Mesh, Origin, Points, Scenery
from urbanforest_cli.export.scene.tiling import tile_scene
from urbanforest_cli.files.tiles3d import write_tiles
from urbanforest_cli.files.tiles3d_reader import check_tiles, open_tileset, read_plants, read_provenance
from urbanforest_cli.files.tiles3d_subtree import HEADER, Subtree, read_subtree, subtree_bytes, tiles_in

ORIGIN = Origin(CRS.from_epsg(25832), 700_000.0, 5_800_000.0)
PROVENANCE = {"stage": "export", "seed": "7"}
CITY_M = 1200.0
COUNT = 900


def ground(side_m):
    half = side_m / 2
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32)
    up = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))
    white = np.full((4, 3), 255, np.uint8)
    return Mesh(corners, up, np.zeros((4, 2), np.float32), white, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def sceneries(count=COUNT, side_m=CITY_M, *, origin=ORIGIN, with_fixed=True, seed=4):
    """The same plants at three details, the coarsest of them points; ground and two blocks."""
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.uniform(-side_m / 2, side_m / 2, (count, 2)), np.zeros(count)])
    instances = Instances(
        rng.integers(0, len(MODELS), count).astype(np.int32),
        xyz,
        rng.uniform(-np.pi, 2 * np.pi, count),
        rng.random(count) < 0.5,
        rng.uniform(0.8, 1.2, count),
    )
    columns = properties_of(count, rng)
    fixed = (
        Fixed("ground", ground(side_m), 2),
        Fixed("block 1", cone(9.0, 12.0, 4), 2, (40.0, -20.0, 0.0)),
        Fixed("block 2", cone(19.0, 15.0, 4), 0, (-440.0, 420.0, 0.0)),
    )
    fine = Scenery(origin, MATERIALS, MODELS, instances, columns, fixed if with_fixed else (), None, {})
    crowns = xyz + np.array([0.0, 0.0, 4.0])
    dots = Points(crowns, np.tile(np.array([[60, 110, 40]], np.uint8), (count, 1)))
    none = instances.take(np.zeros(0, np.int64))
    return {"point": replace(fine, models=(), instances=none, points=dots), "low": fine, "medium": fine}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("city") / "tiles"
    given = sceneries()
    summary = write_tiles(folder, tile_scene(given, ground_height_m=47.5), provenance=PROVENANCE)
    return folder, given, summary


@pytest.fixture
def copy(written, tmp_path):
    return shutil.copytree(written[0], tmp_path / "tiles")


def edit(folder, change):
    path = folder / "tileset.json"
    text = json.loads(path.read_text())
    change(text)
    path.write_text(json.dumps(text))


def forest(text):
    return next(child for child in text["root"]["children"] if "implicitTiling" in child)


def some(folder, pattern):
    return sorted(folder.glob(pattern))[0]


def test_independent_checks_find_nothing_wrong(written):
    assert faults(written[0]) == []


def test_leaves_give_back_every_plant_where_it_stands(written):
    folder, given, _ = written
    fine = given["medium"]
    found = read_plants(folder)
    order = np.argsort(fine.properties["plant_id"].values.astype(str))
    assert found.plant_id.tolist() == fine.properties["plant_id"].values[order].tolist()
    expected = fine.instances.xyz_m[order] + np.array([ORIGIN.easting_m, ORIGIN.northing_m, 0.0])
    assert np.abs(found.xyz_m - expected).max() < 1e-3
    assert found.crs == ORIGIN.crs
    assert np.allclose(found.height_m, fine.properties["height_m"].values[order], rtol=1e-6)
    assert len(read_plants(folder / "tileset.json")) == COUNT


@pytest.mark.parametrize("code", [2154, 25832, 32618])
def test_plants_of_a_city_of_10_km_stand_on_earth_where_pyproj_has_them(tmp_path, code):
    place = {2154: (660_000.0, 6_867_000.0), 25832: (900_000.0, 5_700_000.0), 32618: (590_000.0, 4_515_000.0)}[code]
    origin = Origin(CRS.from_epsg(code), *place)
    given = sceneries(60, 10_000.0, origin=origin, with_fixed=False)
    folder = tmp_path / "tiles"
    write_tiles(folder, tile_scene(given, ground_height_m=30.0), provenance=PROVENANCE)
    tileset = open_tileset(folder)
    matrix = np.array(tileset.text["root"]["transform"]).reshape(4, 4).T
    tree = tileset.quadtree
    stands = np.concatenate([_standing(folder, tree.uri(tile)) for tile in range(len(tree)) if tree.is_leaf[tile]])
    on_earth = stands @ matrix[:3, :3].T + matrix[:3, 3]
    change = Transformer.from_crs(origin.crs.to_3d(), CRS.from_epsg(4978), always_xy=True)
    xyz = np.add(given["medium"].instances.xyz_m, (*place, 30.0))
    expected = np.column_stack(change.transform(*xyz.T))
    apart = np.linalg.norm(on_earth[:, None] - expected[None], axis=2)
    assert apart.min(axis=0).max() < 0.01
    assert apart.min(axis=1).max() < 0.01


def _standing(folder, uri):
    content = Content(folder, uri, set())
    found = []
    for node in content.text["nodes"]:
        places = content.instances(node)[0] * node.get("scale", [1, 1, 1]) + node.get("translation", [0, 0, 0])
        found.append(np.stack([places[:, 0], -places[:, 2], places[:, 1]], axis=1))
    return np.concatenate(found)


def test_nothing_is_mirrored_by_a_node_and_mirrored_plants_have_mirrored_models(written):
    folder, given, _ = written
    names, counts = [], 0
    for path in sorted((folder / "content").rglob("*.glb")):
        content = Content(folder, path.relative_to(folder).as_posix(), set())
        for node in content.text["nodes"]:
            assert min(node.get("scale", [1])) > 0
            name = content.text["meshes"][node["mesh"]]["name"]
            if name.startswith("oak 1") and path.parts[-3] == str(len(list((folder / "content").glob("[0-9]"))) - 1):
                names.append(name)
                counts += len(content.instances(node)[0]) if name.endswith("mirrored") else 0
    mirrored = given["medium"].instances.mirror & (given["medium"].instances.model == 0)
    assert set(names) == {"oak 1", "oak 1 mirrored"}
    assert 0 < counts <= np.count_nonzero(mirrored)


def test_models_that_tiles_share_and_textures_lie_in_files_of_their_own(written):
    folder, _, summary = written
    assert summary.shared_models == summary.models
    assert sorted(path.suffix for path in (folder / "models").iterdir()).count(".bin") >= 3
    assert len(list((folder / "models").glob("*.png"))) == 3
    leaf = Content(folder, open_tileset(folder).quadtree.uri(len(open_tileset(folder).quadtree) - 1), set())
    assert {buffer.get("uri", "own").split("/")[-1].split("-")[0] for buffer in leaf.text["buffers"]} == {
        "own",
        "medium",
    }
    assert all("uri" in image for image in leaf.text["images"])


def test_a_model_that_one_tile_uses_lies_within_it(tmp_path):
    given = sceneries(1, with_fixed=False)
    given = {"medium": given["medium"]}
    summary = write_tiles(tmp_path / "tiles", tile_scene(given), provenance=PROVENANCE)
    assert (summary.models, summary.shared_models) == (1, 0)
    assert not list((tmp_path / "tiles" / "models").glob("*.bin"))
    assert faults(tmp_path / "tiles") == []


def test_same_scene_same_bytes(tmp_path, written):
    again = tmp_path / "tiles"
    write_tiles(again, tile_scene(sceneries(), ground_height_m=47.5), provenance=PROVENANCE)
    names = sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(written[0]) for path in written[0].rglob("*") if path.is_file())
    assert all((again / name).read_bytes() == (written[0] / name).read_bytes() for name in names)


def test_provenance_and_place_are_in_the_tileset(written):
    assert read_provenance(written[0]) == PROVENANCE
    extras = open_tileset(written[0]).extras
    assert extras["crs"]["authority"] == "EPSG:25832"
    assert extras["origin"] == {"easting_m": 700_000.0, "northing_m": 5_800_000.0, "height_m": 0.0}
    assert extras["ground_height_m"] == 47.5


def test_ground_lies_flat_on_the_ellipsoid_and_every_piece_is_in_one_cell(written):
    folder, _, summary = written
    area = 0.0
    for path in sorted((folder / "content" / "ground").glob("*.glb")):
        content = Content(folder, path.relative_to(folder).as_posix(), set())
        for node in content.text["nodes"]:
            primitive = content.text["meshes"][node["mesh"]]["primitives"][0]
            corners = content.values(primitive["attributes"]["POSITION"]) + node.get("translation", [0, 0, 0])
            flat = corners[:, [0, 2]]
            fall = (flat**2).sum(axis=1) / (2 * 6.39e6)
            assert np.abs(corners[:, 1] + fall).max() < 2e-3
            a, b, c = (flat[content.values(primitive["indices"]).astype(int).reshape(-1, 3)[:, k]] for k in range(3))
            area += 0.5 * np.abs(np.cross(b - a, c - a)).sum() if flat.shape[1] == 3 else _area(a, b, c)
    assert area == pytest.approx(CITY_M**2, rel=1e-3)  # the grid of UTM is 0.04 % shorter than the Earth
    assert summary.cells == 9
    assert len(list((folder / "content" / "buildings").glob("*.glb"))) >= 2


def _area(a, b, c):
    (x1, y1), (x2, y2) = (b - a).T, (c - a).T
    return 0.5 * float(np.abs(x1 * y2 - x2 * y1).sum())


def test_a_city_without_plants_is_ground_alone(tmp_path):
    write_tiles(tmp_path / "tiles", tile_scene(sceneries(0)), provenance=PROVENANCE)
    assert len(read_plants(tmp_path / "tiles")) == 0
    assert faults(tmp_path / "tiles") == []


def test_nothing_at_all_is_still_a_tileset(tmp_path):
    write_tiles(tmp_path / "tiles", tile_scene(sceneries(0, with_fixed=False)), provenance=PROVENANCE)
    assert len(read_plants(tmp_path / "tiles")) == 0
    assert faults(tmp_path / "tiles") == []


def test_plants_all_at_one_place_can_be_written(tmp_path):
    write_tiles(tmp_path / "tiles", tile_scene(sceneries(200, 0.0, with_fixed=False)), provenance=PROVENANCE)
    assert len(read_plants(tmp_path / "tiles")) == 200
    assert faults(tmp_path / "tiles") == []


def test_what_stood_there_stays_if_writing_fails(tmp_path):
    folder = tmp_path / "tiles"
    write_tiles(folder, tile_scene(sceneries(5)), provenance=PROVENANCE)
    before = (folder / "tileset.json").read_bytes()
    broken = sceneries(5)
    broken["medium"] = replace(
        broken["medium"], instances=replace(broken["medium"].instances, scale=np.full(5, np.nan))
    )
    with pytest.raises(OutputError):
        write_tiles(folder, tile_scene(broken), provenance=PROVENANCE)
    assert (folder / "tileset.json").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["tiles"]


@pytest.mark.parametrize("levels", [1, 3, 6])
def test_subtrees_come_back(tmp_path, levels):
    rng = np.random.default_rng(levels)
    for share in (0.0, 0.4, 1.0):
        tiles = rng.random(tiles_in(levels)) <= share
        tiles[0] = True
        boxes = rng.normal(size=(np.count_nonzero(tiles), 12))
        given = Subtree(tiles, rng.random(4**levels) < share, boxes)
        path = tmp_path / "a.subtree"
        path.write_bytes(subtree_bytes(given))
        assert path.stat().st_size % 8 == 0
        found = read_subtree(path, levels)
        assert (found.tiles == tiles).all()
        assert (found.children == given.children).all()
        assert (found.boxes_m == boxes).all()


def test_a_full_subtree_needs_no_bits(tmp_path):
    data = subtree_bytes(Subtree(np.ones(5, bool), np.zeros(16, bool), np.zeros((5, 12))))
    head = HEADER.unpack_from(data)[2]
    text = json.loads(data[HEADER.size : HEADER.size + head])
    assert text["tileAvailability"] == {"constant": 1}
    assert text["childSubtreeAvailability"] == {"constant": 0}


def cut_short(folder):
    path = some(folder, "content/0/0/0.glb")
    path.write_bytes(path.read_bytes()[:-8])


def torn_subtree(folder):
    path = some(folder, "subtrees/**/*.subtree")
    path.write_bytes(path.read_bytes()[:-8])


def flipped_bit(folder):
    path = some(folder, "subtrees/**/*.subtree")
    data = bytearray(path.read_bytes())
    levels = forest(json.loads((folder / "tileset.json").read_text()))["implicitTiling"]["subtreeLevels"]
    head = HEADER.unpack_from(data)[2]
    text = json.loads(data[HEADER.size : HEADER.size + head])
    start = text["bufferViews"][text["tileAvailability"]["bitstream"]]["byteOffset"]
    bits = read_subtree(path, levels).tiles
    first = int(np.flatnonzero(~bits)[0])
    last = int(np.flatnonzero(bits)[-1])
    for number in (first, last):
        data[HEADER.size + head + start + number // 8] ^= 1 << (number % 8)
    path.write_bytes(data)


def missing_content(folder):
    sorted((folder / "content").glob("[0-9]/*/*.glb"))[-1].unlink()


def foreign_file(folder):
    (folder / "content" / "0" / "0" / "7.glb").write_bytes((folder / "content/0/0/0.glb").read_bytes())


def swapped_contents(folder):
    one, *_, other = sorted((folder / "content").glob("1/*/*.glb"))
    data = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(data)


def twice_at_the_leaves(folder):
    tree = open_tileset(folder).quadtree
    one, other = (tree.uri(int(tile)) for tile in np.flatnonzero(tree.is_leaf)[:2])
    (folder / one).write_bytes((folder / other).read_bytes())


def escaping(folder):
    (folder.parent / "secret.glb").write_bytes((folder / "content/0/0/0.glb").read_bytes())
    edit(folder, lambda text: forest(text)["content"].update(uri="../secret.glb"))


def linked_out(folder):
    path = folder / "content/0/0/0.glb"
    (folder.parent / "secret.glb").write_bytes(path.read_bytes())
    path.unlink()
    path.symlink_to(folder.parent / "secret.glb")


def no_json(folder):
    (folder / "tileset.json").write_text("{")


def no_tileset(folder):
    (folder / "tileset.json").unlink()


def short_transform(folder):
    edit(folder, lambda text: text["root"].update(transform=[1.0] * 15))


def many_levels(folder):
    edit(folder, lambda text: forest(text)["implicitTiling"].update(subtreeLevels=40))


def fewer_levels(folder):
    edit(folder, lambda text: forest(text)["implicitTiling"].update(availableLevels=1))


def test_reading_refuses_what_is_torn_or_foreign(written, tmp_path):
    mistakes = (
        cut_short, torn_subtree, flipped_bit, missing_content, swapped_contents, twice_at_the_leaves, escaping,
        linked_out, no_json, no_tileset, short_transform, many_levels, fewer_levels,
    )  # fmt: skip
    for mistake in mistakes:
        folder = shutil.copytree(written[0], tmp_path / mistake.__name__ / "tiles")
        mistake(folder)
        with pytest.raises(InputError):
            read_plants(folder)


def test_a_folder_that_is_not_whole_is_not_published(written, tmp_path):
    check_tiles(written[0], plants=COUNT)
    for mistake in (cut_short, torn_subtree, missing_content, foreign_file, no_tileset):
        folder = shutil.copytree(written[0], tmp_path / mistake.__name__ / "tiles")
        mistake(folder)
        with pytest.raises(InputError):
            check_tiles(folder, plants=COUNT)


def wrong_box(folder):
    path = some(folder, "subtrees/**/*.subtree")
    data = bytearray(path.read_bytes())
    head = HEADER.unpack_from(data)[2]
    text = json.loads(data[HEADER.size : HEADER.size + head])
    number = text["propertyTables"][0]["properties"]["bounding_box"]["values"]
    start = HEADER.size + head + text["bufferViews"][number]["byteOffset"] + 3 * 8
    (half,) = struct.unpack_from("<d", data, start)
    struct.pack_into("<d", data, start, half - 0.05)
    path.write_bytes(data)


def growing_error(folder):
    edit(folder, lambda text: forest(text).update(geometricError=1e6))


def small_root(folder):
    def shrink(text):
        text["root"]["boundingVolume"]["box"][3] -= 3.0

    edit(folder, shrink)


def wrong_rows(folder):
    path = some(folder, "content/0/0/0.glb")
    data = path.read_bytes()
    path.write_bytes(data.replace(b'"class":"plant","count":', b'"class":"plant","count":1', 1).replace(b"  ", b" ", 1))
    _mend_lengths(path)


def _mend_lengths(path):
    data = path.read_bytes()
    head = data.index(b"BIN\0") - 4 - 20
    binary = data[20 + head :]
    text = json.loads(data[20 : 20 + head])
    fixed = json.dumps(text, separators=(",", ":")).encode()
    fixed += b" " * (-len(fixed) % 4)
    whole = struct.pack("<I4s", len(fixed), b"JSON") + fixed + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(whole)) + whole)


def unknown_model_file(folder):
    (folder / "models" / "more.bin").write_bytes(b"0123")


def short_model_file(folder):
    path = some(folder, "models/*.bin")
    path.write_bytes(path.read_bytes() + bytes(4))


def leaning(folder):
    def lean(text):
        text["root"]["transform"][8] += 1e-4

    edit(folder, lean)


def moved_plant(folder):
    tree = open_tileset(folder).quadtree
    uri = tree.uri(int(np.flatnonzero(tree.is_leaf)[0]))
    data = (folder / uri).read_bytes()
    head = struct.unpack_from("<I", data, 12)[0]
    text = json.loads(data[20 : 20 + head])
    text["nodes"][0]["translation"] = [300.0, 0.0, 0.0]
    fixed = json.dumps(text, separators=(",", ":")).encode()
    fixed += b" " * (-len(fixed) % 4)
    whole = struct.pack("<I4s", len(fixed), b"JSON") + fixed + data[20 + head :]
    (folder / uri).write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(whole)) + whole)


@pytest.mark.parametrize(
    "mistake",
    [
        flipped_bit, missing_content, foreign_file, swapped_contents, twice_at_the_leaves, wrong_box, growing_error,
        small_root, wrong_rows, unknown_model_file, short_model_file, leaning, moved_plant,
    ],
)  # fmt: skip
def test_independent_checks_catch_planted_mistakes(copy, mistake):
    mistake(copy)
    assert faults(copy)


def test_plants_of_a_tile_lie_near_what_the_reader_says(written):
    folder = written[0]
    tree = open_tileset(folder).quadtree
    low = tree.boxes_m[:, :2] - tree.boxes_m[:, [3, 7]]
    high = tree.boxes_m[:, :2] + tree.boxes_m[:, [3, 7]]
    for tile in range(len(tree)):
        places = np.array(positions(folder, tree.uri(tile)))
        assert ((places >= low[tile]) & (places <= high[tile])).all()
