import contextlib
import json
import os
import random
import struct
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.gltf_checks import join, split
from tests.reference.gltf_scenes import MATERIALS, MODELS, scene
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.scenery import Property
from urbanforest_cli.files.gltf import External, glb_bytes, model_bytes, pack_models, write_glb
from urbanforest_cli.files.gltf_reader import open_gltf, plants_of, read_plants, read_provenance

KINDS = {
    "instances": lambda: scene(60),
    "points": lambda: scene(0, points=40),
    "both": lambda: scene(30, points=40),
    "far": lambda: scene(90, points=30, reach_m=9000.0),
    "no plants": lambda: scene(0),
    "empty": lambda: scene(0, fixed=False),
}


def places(made):
    both = [made.instances.xyz_m] + ([made.points.xyz_m] if made.points is not None else [])
    return np.concatenate(both)


@pytest.fixture
def put(tmp_path):
    def write(glb, name="forest.glb"):
        (tmp_path / name).write_bytes(glb)
        return tmp_path / name

    return write


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_plants_read_are_those_written(tmp_path, kind, plain):
    made = KINDS[kind]()
    write_glb(tmp_path / "forest.glb", made, plain=plain)
    found = read_plants(tmp_path / "forest.glb")
    order = np.argsort(found.plant_id)  # of a far scene without extensions, points come cell by cell
    wanted = np.argsort(made.properties["plant_id"].values)
    assert found.plant_id[order].tolist() == made.properties["plant_id"].values[wanted].tolist()
    origin = (made.origin.easting_m, made.origin.northing_m, made.origin.height_m)
    assert np.abs(found.xyz_m[order] - places(made)[wanted] - origin).max(initial=0) < 1e-3
    assert np.allclose(found.height_m[order], made.properties["height_m"].values[wanted], rtol=1e-6)
    assert found.crs == made.origin.crs
    assert read_provenance(tmp_path / "forest.glb") == {"stage": "export", "seed": "7"}


def test_columns_come_back_with_their_words_and_gaps(put):
    made = scene(12, points=3)
    made.properties["lot_id"] = Property(np.array(["木", "à", ""] * 5, np.object_), "text", "lot")
    made.properties["count"] = Property(np.arange(15), "uint16", "a count")
    made.properties["dbh_m"].values[4] = np.nan
    columns = plants_of(open_gltf(put(glb_bytes(made)))).columns
    assert columns["lot_id"].tolist() == made.properties["lot_id"].values.tolist()
    assert np.allclose(columns["height_m"], made.properties["height_m"].values, rtol=1e-12)
    assert columns["count"].tolist() == list(range(15))
    assert np.array_equal(columns["dbh_m"], made.properties["dbh_m"].values.astype(np.float32), equal_nan=True)
    species = made.properties["species"]
    assert columns["species"].tolist() == [species.names[value] for value in species.values]
    plain = plants_of(open_gltf(put(glb_bytes(made, plain=True)))).columns
    assert plain["species"].tolist() == columns["species"].tolist()
    assert np.array_equal(np.isnan(plain["dbh_m"]), np.isnan(columns["dbh_m"]))


def test_file_without_properties_gives_places_and_no_plants(put):
    path = put(glb_bytes(replace(scene(5), properties={})))
    found = plants_of(open_gltf(path))
    assert len(found) == 5
    assert found.columns == {}
    with pytest.raises(InputError, match="no plant_id"):
        read_plants(path)


def test_json_with_its_data_beside_it(put, tmp_path):
    document, chunk = split(glb_bytes(scene(9)))
    document["buffers"][0]["uri"] = "data/all%20of%20it.bin"
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "all of it.bin").write_bytes(chunk)
    assert len(read_plants(put(json.dumps(document).encode(), "forest.gltf"))) == 9


@pytest.fixture
def tile(tmp_path):
    packed = pack_models(MODELS, MATERIALS)
    block = model_bytes(packed, 0)
    external = {0: External("../models/0.bin", 0, len(block))}
    (tmp_path / "models").mkdir()
    (tmp_path / "content").mkdir()
    (tmp_path / "models" / "0.bin").write_bytes(block)
    path = tmp_path / "content" / "0.glb"
    path.write_bytes(glb_bytes(scene(20), packed=packed, external=external, extras={}))
    return path


def test_tile_reads_shared_models_within_the_root_alone(tile, tmp_path):
    file = open_gltf(tile, root=tmp_path)
    assert len(plants_of(file)) == 20
    meshes = [mesh for mesh in file.json["meshes"] if mesh["name"] == "oak 1"]
    assert len(file.accessor(meshes[0]["primitives"][0]["attributes"]["POSITION"])) == 27
    with pytest.raises(InputError, match="leads out of its folder"):
        open_gltf(tile)


def test_missing_or_torn_shared_models_are_told(tile, tmp_path):
    models = tmp_path / "models" / "0.bin"
    models.write_bytes(models.read_bytes()[:-1])
    with pytest.raises(InputError, match="missing or torn"):
        open_gltf(tile, root=tmp_path)
    models.unlink()
    with pytest.raises(InputError, match="missing or torn"):
        open_gltf(tile, root=tmp_path)


@pytest.mark.parametrize(
    "uri",
    ["../../secret", "/etc/passwd", "https://example.org/x.bin", "data:application/octet-stream;base64,AAAA",
     "%2e%2e/%2e%2e/secret", "..\\secret", "link/secret", "a?b", "", 7, None, "x\0y", "n" * 5000],
)  # fmt: skip
def test_data_elsewhere_are_never_opened(put, tmp_path, uri):
    outside = tmp_path / "secret"
    outside.write_bytes(bytes(10**6))
    home = tmp_path / "home"
    home.mkdir()
    os.symlink(tmp_path, home / "link")
    document, chunk = split(glb_bytes(scene(3)))
    document["buffers"].append({"byteLength": 10, "uri": uri})
    with pytest.raises(InputError):
        open_gltf(put(join(document, chunk), "home/forest.glb"))


def test_no_file_and_other_files_are_told(put, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_plants(tmp_path / "none.glb")
    with pytest.raises(InputError, match="no such file"):
        read_plants(tmp_path)
    for content in (b"", b"glTF", b"hello", b"[]", b"{}", b'{"asset":{"version":"1.0"}}', b"\xff" * 40):
        with pytest.raises(InputError):
            read_plants(put(content))


@pytest.mark.parametrize("plain", [False, True])
def test_every_torn_file_is_told(put, plain):
    glb = glb_bytes(scene(6, points=2), plain=plain)
    for length in {*range(60), *range(60, len(glb), 97), len(glb) - 1}:
        with pytest.raises(InputError):
            read_plants(put(glb[:length]))
        with pytest.raises(InputError):
            read_plants(put(glb[:8] + struct.pack("<I", length) + glb[12:length]))


def walk(value, path=()):
    yield path
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from walk(inner, (*path, key))


WRONG = (None, -1, 10**9, 10**400, 1.5, float("1e308"), True, "words", [], {}, [[]], [None], [10**400] * 3, {"": 0})


@pytest.mark.parametrize("plain", [False, True])
def test_no_wrong_value_anywhere_breaks_the_reader(put, plain):
    document, chunk = split(glb_bytes(scene(4, points=2), plain=plain))
    text, chance = json.dumps(document), random.Random(1)
    paths = [path for path in walk(document) if path and "wkt" not in path]
    for path in chance.sample(paths, min(len(paths), 120)):
        changed = json.loads(text)
        inner = changed
        for key in path[:-1]:
            inner = inner[key]
        for wrong in chance.sample(WRONG, 4):
            inner[path[-1]] = wrong
            file = put(join(changed, chunk))
            with contextlib.suppress(InputError):
                read_plants(file)
                read_provenance(file)


def test_no_wrong_byte_breaks_the_reader(put):
    glb, chance = glb_bytes(scene(6, points=2)), random.Random(2)
    for _ in range(400):
        changed = bytearray(glb)
        for _ in range(chance.choice((1, 1, 8))):
            changed[chance.randrange(len(glb))] = chance.randrange(256)
        with contextlib.suppress(InputError):
            read_plants(put(bytes(changed)))


def test_nested_and_endless_json_is_told(put):
    for text in (b'{"asset":' * 100_000, b'{"asset":{"version":"2.0"},"scene":' + b"9" * 6000 + b"}", b'{"asset":NaN}'):
        with pytest.raises(InputError):
            read_plants(put(text))


def test_accessor_that_claims_the_world_takes_no_memory(put):
    document, chunk = split(glb_bytes(scene(4)))
    for accessor in document["accessors"]:
        accessor["count"] = 10**12
    with pytest.raises(InputError, match="reaches beyond"):
        read_plants(put(join(document, chunk)))


def test_plant_without_a_place_is_told(put):
    document, chunk = split(glb_bytes(scene(8)))
    document["scenes"][0]["nodes"].pop(0)
    with pytest.raises(InputError, match="do not match"):
        read_plants(put(join(document, chunk)))


def test_files_that_need_more_than_we_know_are_told(put):
    document, chunk = split(glb_bytes(scene(2)))
    document["extensionsRequired"].append("EXT_meshopt_compression")
    with pytest.raises(InputError, match="EXT_meshopt_compression"):
        open_gltf(put(join(document, chunk)))
