import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.reference.gltf_checks import Glb, drawn, faults, split
from tests.reference.gltf_scenes import MATERIALS, MODELS, cone, scene
from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.scenery import Fixed, Mesh, Model, Part, Points, Property
from urbanforest_cli.files.gltf import External, glb_bytes, model_bytes, pack_models, write_glb
from urbanforest_cli.files.gltf_metadata import decimal_steps
from urbanforest_cli.files.gltf_points import linear_rgba

SCENES = {
    "instances": lambda: scene(60),
    "one plant": lambda: scene(1, fixed=False),
    "points": lambda: scene(0, points=40),
    "both": lambda: scene(30, points=40, scaled=False),
    "empty": lambda: scene(0, fixed=False),
    "no plants": lambda: scene(0),
    "winter": lambda: scene(20, models=bare(MODELS)),
    "far": lambda: scene(90, points=30, reach_m=9000.0),
    "wide as allowed": lambda: scene(40, reach_m=3900.0),
}


def bare(models):
    nothing = Mesh(*(values[:0] for values in vars(cone()).values()))
    return tuple(
        Model(model.name, (*(Part(nothing, part.material) for part in model.parts[1:]), model.parts[0]))
        for model in models
    )


def as_defined(scenery):
    """Corners of each instance's parts: mirrored, turned, scaled, placed, z up."""
    instances = scenery.instances
    for row in range(len(instances)):
        yaw, side = instances.yaw_rad[row], -1.0 if instances.mirror[row] else 1.0
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        move = instances.scale[row] * turn @ np.diag([1.0, side, 1.0])
        model = scenery.models[instances.model[row]]
        yield row, [part.mesh.xyz_m @ move.T + instances.xyz_m[row] for part in model.parts if len(part.mesh.triangle)]


@pytest.mark.parametrize("kind", SCENES)
def test_files_have_no_fault(kind):
    made = SCENES[kind]()
    assert faults(glb_bytes(made)) == []
    assert faults(glb_bytes(made, plain=True)) == []


@pytest.mark.parametrize("kind", ["instances", "far", "wide as allowed", "winter"])
def test_instances_stand_turned_mirrored_and_scaled_as_defined(kind):
    made = SCENES[kind]()
    found = {row: (parts, flipped) for _, row, parts, flipped in drawn(glb_bytes(made)) if row is not None}
    for row, parts in as_defined(made):
        assert found[row][1] == made.instances.mirror[row]
        for there, wanted in zip(found[row][0], parts, strict=True):
            assert np.abs(there - wanted).max() < 1e-3


def test_plain_nodes_stand_turned_mirrored_and_scaled_as_defined():
    made = scene(60)
    plants = {name: (parts, flipped) for name, _, parts, flipped in drawn(glb_bytes(made, plain=True))}
    for row, parts in as_defined(made):
        there, flipped = plants[made.properties["plant_id"].values[row]]
        assert flipped == made.instances.mirror[row]
        assert max(np.abs(one - other).max() for one, other in zip(there, parts, strict=True)) < 2e-4


def test_points_and_fixed_things_stand_where_they_are():
    made = scene(0, points=50, reach_m=9000.0)
    things = drawn(glb_bytes(made))
    at = np.concatenate([parts[0] for name, _, parts, _ in things if name == "plants as points"])
    assert np.abs(at[np.lexsort(at.T)] - made.points.xyz_m[np.lexsort(made.points.xyz_m.T)]).max() < 1e-3
    block = next(parts[0] for name, _, parts, _ in things if name == "block 1")
    assert np.abs(block - made.fixed[0].mesh.xyz_m - made.fixed[0].centre_m).max() < 1e-5


def test_what_lies_far_from_a_fixed_centre_stays_exact():
    made = scene(0)
    far = replace(made, fixed=(Fixed("far", cone(), 2, (123_456.789, -98_765.432, 3.0)),))
    node = split(glb_bytes(far))[0]["nodes"][0]
    assert node["translation"] == [123_456.789, 3, 98_765.432]


def test_mesh_beyond_four_kilometres_is_refused():
    made = scene(0)
    with pytest.raises(OutputError, match="too far from its own origin"):
        glb_bytes(replace(made, fixed=(Fixed("ground", cone(radius=4100.0), 2),)))


def test_plant_high_above_everything_is_refused():
    made = scene(3)
    made.instances.xyz_m[1, 2] = 5000.0
    with pytest.raises(OutputError, match="above or below"):
        glb_bytes(made)


def test_broken_scenes_are_refused():
    made = scene(5)
    short = replace(made.properties["height_m"], values=made.properties["height_m"].values[:4])
    with pytest.raises(OutputError, match="not one value a plant"):
        glb_bytes(replace(made, properties={**made.properties, "height_m": short}))
    wild = replace(made.properties["species"], names=("Tilia",), values=np.full(5, 1, np.uint8))
    with pytest.raises(OutputError, match="none of its enum"):
        glb_bytes(replace(made, properties={**made.properties, "species": wild}), plain=True)
    made.instances.yaw_rad[2] = np.nan
    with pytest.raises(OutputError, match="stands nowhere"):
        glb_bytes(made)
    with pytest.raises(OutputError, match="nothing to draw"):
        pack_models([Model("bare", ())], MATERIALS)
    for name, wrong, told in (
        ("xyz_m", np.inf, "finite"), ("normal", 0.0, "of length 1"), ("normal", np.nan, "of length 1"),
        ("triangle", 999, "a corner that is not there"),
    ):  # fmt: skip
        broken = cone()
        getattr(broken, name)[4] = wrong
        with pytest.raises(OutputError, match=f"a mesh is broken(?s:.*){told}"):
            pack_models([Model("torn", (Part(broken, 0),))], MATERIALS)


def test_equal_scenes_are_equal_bytes_however_often_models_are_packed():
    packed = pack_models(MODELS, MATERIALS)
    first = glb_bytes(scene(60, points=9))
    assert glb_bytes(scene(60, points=9)) == first
    assert glb_bytes(scene(60, points=9), packed=packed) == first
    assert glb_bytes(scene(60, points=9), packed=packed) == first
    assert glb_bytes(scene(60), plain=True) == glb_bytes(scene(60), plain=True, packed=packed)


def test_only_models_and_materials_in_use_are_stored():
    made = scene(40, fixed=False)
    made.instances.model[:] = 1
    document, _ = split(glb_bytes(made, packed=pack_models(MODELS, MATERIALS)))
    assert [mesh["name"] for mesh in document["meshes"]] == ["oak 2"]
    assert [material["name"] for material in document["materials"]] == ["leaf"]
    assert len(document["images"]) == 1
    assert len(document["nodes"]) == 2


def test_models_and_textures_may_lie_in_other_files():
    made = scene(50)
    packed = pack_models(MODELS, MATERIALS)
    blocks = [model_bytes(packed, number) for number in (0, 2)]
    assert all(len(block) % 4 == 0 for block in blocks)
    shared = b"\1" * 8 + blocks[0] + blocks[1]
    external = {
        0: External("../models/1.bin", 8, len(shared)),
        2: External("../models/1.bin", 8 + len(blocks[0]), len(shared)),
    }
    glb = glb_bytes(made, packed=packed, external=external, texture_uris={1: "../leaf.png"}, extras={})
    files = {"../models/1.bin": shared}
    assert faults(glb, files) == []
    document = Glb(glb, files).json
    assert [buffer.get("uri") for buffer in document["buffers"]] == [None, "../models/1.bin"]
    assert {"uri": "../leaf.png"} in document["images"]
    assert "extras" not in document["asset"]
    for (_, row, parts, _), (_, same, others, _) in zip(drawn(glb, files), drawn(glb_bytes(made)), strict=True):
        assert row == same
        assert all(np.array_equal(one, other) for one, other in zip(parts, others, strict=True))


def test_plain_uses_no_extension_and_a_node_a_plant():
    made = scene(40, points=5)
    document, _ = split(glb_bytes(made, plain=True))
    assert not {"extensions", "extensionsUsed", "extensionsRequired"} & set(document)
    assert '"extensions"' not in json.dumps(document)
    plants = [node for node in document["nodes"] if "plant_id" in node.get("extras", {})]
    assert [node["name"] for node in plants] == made.properties["plant_id"].values[:40].tolist()
    words = made.properties["species"].names
    assert [node["extras"]["species"] for node in plants] == [
        words[value] for value in made.properties["species"].values[:40]
    ]
    heights = [node["extras"]["height_m"] for node in plants]
    assert np.allclose(heights, made.properties["height_m"].values[:40], rtol=1e-6)
    assert all("translation" in node for node in plants)
    assert len(document["meshes"]) == len(MODELS) + 2


def test_trimesh_loads_the_plain_file_with_a_node_a_plant(tmp_path):
    made = scene(25)
    write_glb(tmp_path / "forest.glb", made, plain=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pillow and others below trimesh
        loaded = trimesh.load_scene(tmp_path / "forest.glb")
    primitives = [len(made.models[model].parts) for model in made.instances.model]
    assert len(loaded.graph.nodes_geometry) == sum(primitives) + 1
    low, high = loaded.bounds
    corners = np.concatenate([np.concatenate(parts) for _, parts in as_defined(made)])
    corners = np.concatenate([corners, made.fixed[0].mesh.xyz_m + made.fixed[0].centre_m])
    wanted = np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], axis=1)
    assert np.abs(low - wanted.min(axis=0)).max() < 1e-3
    assert np.abs(high - wanted.max(axis=0)).max() < 1e-3


def test_file_tells_where_it_lies_and_what_made_it():
    made = scene(3)
    extras = split(glb_bytes(made))[0]["asset"]["extras"]
    assert extras["crs"]["authority"] == "EPSG:32631"
    assert extras["crs"]["wkt"].startswith("PROJCRS")
    assert (extras["origin"]["easting_m"], extras["origin"]["northing_m"]) == (452_300.5, 5_411_200.25)
    assert extras["origin"]["longitude"] == pytest.approx(2.3513, abs=0.01)
    assert extras["origin"]["latitude"] == pytest.approx(48.8523, abs=0.01)
    assert extras["provenance"] == {"stage": "export", "seed": "7"}
    assert extras["unit"] == "metre"


def test_materials_say_what_surfaces_are():
    document, _ = split(glb_bytes(scene(60)))
    materials = {material["name"]: material for material in document["materials"]}
    assert materials["leaf"]["alphaMode"] == "MASK"
    assert materials["leaf"]["doubleSided"]
    assert "alphaMode" not in materials["bark"]
    assert materials["baked"]["extensions"] == {"KHR_materials_unlit": {}}
    assert "baseColorTexture" not in materials["wall"]["pbrMetallicRoughness"]

    def wrap(name):
        texture = document["textures"][materials[name]["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
        return document["samplers"][texture["sampler"]]["wrapS"]

    assert wrap("bark") == 10497
    assert wrap("leaf") == 33071


def test_corners_are_small_integers_and_white_tints_are_left_out():
    document, _ = split(glb_bytes(scene(60)))
    meshes = {mesh["name"]: mesh["primitives"] for mesh in document["meshes"]}

    def form(primitive, name):
        accessor = document["accessors"][primitive["attributes"][name]]
        return accessor["componentType"], accessor["type"]

    bark, leaf = meshes["oak 1"]
    assert form(bark, "POSITION") == (5122, "VEC3")
    assert form(bark, "NORMAL") == (5120, "VEC3")
    assert form(bark, "TEXCOORD_0") == (5126, "VEC2")
    assert form(bark, "COLOR_0") == (5121, "VEC4")
    assert form(leaf, "TEXCOORD_0") == (5123, "VEC2")
    assert "COLOR_0" not in leaf["attributes"]
    assert "TEXCOORD_0" not in meshes["block 1"][0]["attributes"]


def test_many_corners_take_wide_indices():
    fine = cone(sides=22_000)
    made = scene(2, models=(Model("fine", (Part(fine, 0),)),))
    assert len(fine.xyz_m) > 65_535
    glb = glb_bytes(made)
    assert faults(glb) == []
    document, _ = split(glb)
    assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == 5125


def test_a_plant_costs_sixty_bytes():
    few, many = scene(2000, reach_m=2000.0, scaled=False), scene(20_000, reach_m=2000.0, scaled=False)
    assert len(glb_bytes(many)) - len(glb_bytes(few)) < 61 * 18_000


def test_rows_beyond_two_bytes_are_floats():
    made = scene(70_000, scaled=False, models=MODELS[2:])
    document = Glb(glb_bytes(made))
    rows = [
        document.values(node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["_FEATURE_ID_0"])
        for node in document.json["nodes"]
        if "extensions" in node
    ]
    assert np.array_equal(np.sort(np.concatenate(rows)[:, 0]), np.arange(70_000))


def test_sizes_of_one_and_turns_of_nought_are_left_out():
    made = scene(30, scaled=False, models=MODELS[:1])
    made.instances.yaw_rad[:] = 0.0
    document, _ = split(glb_bytes(made))
    nodes = [node for node in document["nodes"] if "extensions" in node]
    attributes = [set(node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]) for node in nodes]
    assert attributes == [{"TRANSLATION", "_FEATURE_ID_0"}] * 2


def test_colours_of_points_are_in_linear_light():
    rgba = linear_rgba(np.array([[0, 128, 255]], np.uint8))
    assert rgba.tolist() == [[0, round(0.21586 * 65535), 65535, 65535]]


def test_text_of_any_script_and_missing_numbers_are_kept():
    made = scene(4)
    words = np.array(["tilleul à l'angle", "", "木", "broken \ud800"], np.object_)
    made.properties["lot_id"] = Property(words, "text", "lot")
    made.properties["dbh_m"].values[1] = np.nan
    assert faults(glb_bytes(made)) == []
    column = split(glb_bytes(made))[0]["extensions"]["EXT_structural_metadata"]["schema"]["classes"]["plant"]
    assert column["properties"]["dbh_m"]["noData"] == -9999.0
    document, _ = split(glb_bytes(made, plain=True))
    plants = [node["extras"] for node in document["nodes"] if "extras" in node]
    assert plants[2]["lot_id"] == "木"
    assert plants[1]["dbh_m"] is None


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([0.0, 655.35, 12.5], 0.01),
        ([0.001, 65.535], 0.001),
        ([6.5535, 0.0, 0.0123], 0.0001),
        ([65.536, 0.001], None),
        ([0.12345], None),
        ([-0.01], None),
        ([np.nan, 0.01], None),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_decimals_of_the_register_take_two_bytes_and_stay_what_they_are(values, step, dtype):
    found = decimal_steps(np.array(values, dtype))
    if step is None:
        assert found is None
    else:
        assert found[1] == step
        assert np.allclose(found[0] * step, values, rtol=1e-12)


def test_enum_of_many_words_takes_two_bytes():
    made = scene(300, fixed=False)
    names = tuple(f"Species {number}" for number in range(300))
    made.properties["species"] = Property(np.arange(300).astype(np.uint16), "enum", "species", names)
    glb = glb_bytes(made)
    assert faults(glb) == []
    assert split(glb)[0]["extensions"]["EXT_structural_metadata"]["schema"]["enums"]["species"]["valueType"] == "UINT16"


def test_scene_without_properties_has_no_table():
    made = replace(scene(5, points=3), properties={})
    glb = glb_bytes(made)
    assert faults(glb) == []
    assert split(glb)[0]["extensionsUsed"] == [
        "EXT_mesh_gpu_instancing",
        "KHR_materials_unlit",
        "KHR_mesh_quantization",
    ]
    assert faults(glb_bytes(made, plain=True)) == []


def test_no_points_are_no_points():
    made = replace(scene(4), points=Points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8)))
    assert glb_bytes(made) == glb_bytes(replace(made, points=None))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "forest.glb"
    path.write_bytes(b"old")
    made = scene(5)
    made.instances.scale[0] = -1.0
    with pytest.raises(OutputError):
        write_glb(path, made)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["forest.glb"]
