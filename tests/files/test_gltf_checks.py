"""The judge of GLB files catches every mistake planted in a good one."""

import copy

import numpy as np
import pytest

from tests.reference.gltf_checks import faults, join, split
from tests.reference.gltf_scenes import scene
from urbanforest_cli.core.scenery import Property
from urbanforest_cli.files.gltf import glb_bytes


@pytest.fixture(scope="module")
def good():
    made = scene(30, points=12)
    made.properties["girth_m"] = Property(made.properties["dbh_m"].values * np.pi, "float32", "irrational")
    return split(glb_bytes(made))


def instanced(document):
    return next(node for node in document["nodes"] if "EXT_mesh_gpu_instancing" in node.get("extensions", {}))


def attribute(document, name):
    return document["accessors"][instanced(document)["extensions"]["EXT_mesh_gpu_instancing"]["attributes"][name]]


def put(document, chunk, accessor, values):
    view = document["bufferViews"][accessor["bufferView"]]
    start = view["byteOffset"] + accessor.get("byteOffset", 0)
    data = np.asarray(values).tobytes()
    chunk[start : start + len(data)] = data


def table(document):
    return document["extensions"]["EXT_structural_metadata"]["propertyTables"][0]


def schema(document):
    return document["extensions"]["EXT_structural_metadata"]["schema"]


def put_column(document, chunk, name, values, key="values"):
    start = document["bufferViews"][table(document)["properties"][name][key]]["byteOffset"]
    data = np.asarray(values).tobytes()
    chunk[start : start + len(data)] = data


def features(document):
    return instanced(document)["extensions"]["EXT_instance_features"]["featureIds"][0]


def of_points(document):
    return document["meshes"][document["nodes"][-2]["mesh"]]["primitives"][0]


def bounds(document):
    return document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]


F4 = np.float32
MISTAKES = {
    "several lengths": lambda j, b: attribute(j, "ROTATION").update(count=attribute(j, "ROTATION")["count"] - 1),
    "a quaternion": lambda j, b: put(j, b, attribute(j, "ROTATION"), np.array([0, 9000, 0, 9000], np.int16)),
    "negative size": lambda j, b: put(j, b, attribute(j, "SCALE"), F4([1, 1, -1])),
    "an instance beyond 4 km": lambda j, b: put(j, b, attribute(j, "TRANSLATION"), F4([1e6, 0, 0])),
    "not finite": lambda j, b: put(j, b, attribute(j, "TRANSLATION"), F4([np.nan, 0, 0])),
    "a type that is not allowed": lambda j, b: attribute(j, "ROTATION").update(normalized=False),
    "is no attribute of instances": lambda j, b: instanced(j)["extensions"]["EXT_mesh_gpu_instancing"][
        "attributes"
    ].update(COLOUR=0),
    "features of instances and no instances": lambda j, b: instanced(j)["extensions"].pop("EXT_mesh_gpu_instancing"),
    "a wrong featureCount": lambda j, b: features(j).update(featureCount=1),
    "feature ids that are not there": lambda j, b: features(j).update(attribute=1),
    "a property table that is not there": lambda j, b: features(j).update(propertyTable=1),
    "beyond the property table": lambda j, b: put(j, b, attribute(j, "_FEATURE_ID_0"), np.uint16([999])),
    "feature ids that are not whole": lambda j, b: put(
        j, b, j["accessors"][of_points(j)["attributes"]["_FEATURE_ID_0"]], F4([0.5])
    ),
    "one a plant": lambda j, b: table(j).update(count=41),
    "features without ids": lambda j, b: of_points(j)["extensions"]["EXT_mesh_features"].update(featureIds=[]),
    "follow each other": lambda j, b: put_column(j, b, "plant_id", np.uint16([0, 500, 3]), "stringOffsets"),
    "not UTF-8": lambda j, b: put_column(j, b, "plant_id", np.uint8([255, 254])),
    "an offset a row": lambda j, b: table(j)["properties"]["plant_id"].update(stringOffsetType="UINT32"),
    "its enum has not": lambda j, b: put_column(j, b, "species", np.uint8([7])),
    "has a value twice": lambda j, b: schema(j)["enums"]["species"]["values"][1].update(value=0),
    "not a value a row": lambda j, b: schema(j)["classes"]["plant"]["properties"]["dbh_m"].update(
        componentType="UINT32"
    ),
    "column girth_m holds a number": lambda j, b: put_column(j, b, "girth_m", F4([np.inf])),
    "neither float nor normalised": lambda j, b: schema(j)["classes"]["plant"]["properties"]["dbh_m"].pop("normalized"),
    "is not in its class": lambda j, b: schema(j)["classes"]["plant"]["properties"].pop("height_m"),
    "is no identifier": lambda j, b: schema(j).update(id="urban forest"),
    "extensionsUsed": lambda j, b: j["extensionsUsed"].remove("EXT_mesh_features"),
    "extensionsRequired": lambda j, b: j["extensionsRequired"].append("EXT_structural_metadata"),
    "wrong bounds": lambda j, b: bounds(j)["min"].__setitem__(0, bounds(j)["min"][0] - 1),
    "normals that are not": lambda j, b: put(
        j, b, j["accessors"][j["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]], np.int8([1, 1, 1])
    ),
    "indices beyond its corners": lambda j, b: put(
        j, b, j["accessors"][j["meshes"][0]["primitives"][0]["indices"]], np.uint16([60000])
    ),
    "scales its axes differently": lambda j, b: instanced(j).update(scale=[1, 2, 1]),
    "beyond its buffer": lambda j, b: j["bufferViews"][-1].update(byteLength=10**6),
    "beyond its view": lambda j, b: bounds(j).update(count=10**6),
    "not aligned": lambda j, b: bounds(j).update(byteOffset=1),
    "no multiple of 4": lambda j, b: j["bufferViews"][0].update(byteStride=18),
}


def test_a_good_file_has_no_fault(good):
    assert faults(join(*good)) == []


@pytest.mark.parametrize("told", MISTAKES)
def test_a_planted_mistake_is_told(good, told):
    document, chunk = copy.deepcopy(good[0]), bytearray(good[1])
    MISTAKES[told](document, chunk)
    assert any(told in fault for fault in faults(join(document, chunk))), faults(join(document, chunk))
