"""A slow judge of GLB files: what the extensions ask and the Khronos validator does not know.

Written from the specifications alone; nothing is taken from the package.
"""

import itertools
import json
import re
import struct

import numpy as np

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
METADATA_TYPES = {"UINT8": "<u1", "UINT16": "<u2", "UINT32": "<u4", "UINT64": "<u8", "FLOAT32": "<f4"}
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
REACH_M = 4000.0
MUST_BE_REQUIRED = {"EXT_mesh_gpu_instancing", "KHR_mesh_quantization"}
MUST_BE_OPTIONAL = {"EXT_instance_features", "EXT_mesh_features", "EXT_structural_metadata", "KHR_materials_unlit"}


def split(glb):
    """Return the JSON and the binary chunk of a GLB."""
    magic, version, length = struct.unpack_from("<4sII", glb)
    assert (magic, version, length) == (b"glTF", 2, len(glb))
    size, kind = struct.unpack_from("<I4s", glb, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    document = json.loads(glb[20 : 20 + size])
    if 20 + size == len(glb):
        return document, b""
    length, kind = struct.unpack_from("<I4s", glb, 20 + size)
    assert kind == b"BIN\0"
    assert length % 4 == 0
    assert 28 + size + length == len(glb)
    return document, glb[28 + size :]


def join(document, chunk):
    """Return a GLB of both."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunk = bytes(chunk) + bytes(-len(chunk) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(chunk)) + struct.pack("<I4s", len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(chunk), b"BIN\0") + chunk


class Glb:
    """A GLB with the other files it names, all in memory."""

    def __init__(self, glb, files=None):
        self.json, chunk = split(glb)
        self.buffers = [
            (files or {})[buffer["uri"]] if "uri" in buffer else chunk for buffer in self.json.get("buffers", [])
        ]

    def bytes_of(self, view):
        view = self.json["bufferViews"][view]
        start = view.get("byteOffset", 0)
        return self.buffers[view["buffer"]][start : start + view["byteLength"]]

    def stored(self, number):
        accessor = self.json["accessors"][number]
        dtype, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
        stride = self.json["bufferViews"][accessor["bufferView"]].get("byteStride", dtype.itemsize * width)
        data, start = self.bytes_of(accessor["bufferView"]), accessor.get("byteOffset", 0)
        rows = [
            np.frombuffer(data, dtype, width, start + row * stride) if width else None
            for row in range(accessor["count"])
        ]
        return np.array(rows).reshape(accessor["count"], width)

    def values(self, number):
        stored, accessor = self.stored(number), self.json["accessors"][number]
        if not accessor.get("normalized"):
            return stored.astype(np.float64)
        return np.maximum(stored / np.iinfo(stored.dtype).max, -1.0)


def matrix(translation, rotation, scale):
    """Return translation times rotation (x, y, z, w, taken as it is) times scale."""
    x, y, z, w = rotation
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    result = np.eye(4)
    result[:3, :3] = turn * np.asarray(scale)
    result[:3, 3] = translation
    return result


def node_matrix(node):
    return matrix(node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1)), node.get("scale", (1, 1, 1)))


def drawn(glb, files=None):
    """Return what is drawn: name of the mesh, row of the property table or None, primitives' corners in z up, flipped.

    `flipped` tells whether a renderer turns the triangles' winding round: by the sign of the node's determinant.
    """
    glb = Glb(glb, files)
    found = []
    for node in glb.json.get("nodes", []):
        mesh = glb.json["meshes"][node["mesh"]]
        world = node_matrix(node)
        instancing = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        placed = [(None, np.eye(4))]
        if instancing is not None:
            columns = {name: glb.values(number) for name, number in instancing["attributes"].items()}
            count = len(columns["TRANSLATION"])
            rotation = columns.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
            scale = columns.get("SCALE", np.ones((count, 3)))
            row = columns.get("_FEATURE_ID_0", np.full((count, 1), -1.0))[:, 0]
            placed = [(int(row[n]), matrix(columns["TRANSLATION"][n], rotation[n], scale[n])) for n in range(count)]
        for row, local in placed:
            both = world @ local
            parts = []
            for primitive in mesh["primitives"]:
                corner = glb.values(primitive["attributes"]["POSITION"]) @ both[:3, :3].T + both[:3, 3]
                parts.append(np.stack([corner[:, 0], -corner[:, 2], corner[:, 1]], axis=1))
            found.append((node.get("name", mesh.get("name")), row, parts, bool(np.linalg.det(world[:3, :3]) < 0)))
    return found


def faults(glb, files=None):
    """Return everything wrong with a GLB, as sentences."""
    glb = Glb(glb, files)
    found = []
    _views(glb, found)
    if found:
        return found  # nothing else can be read safely
    _meshes(glb, found)
    rows = []
    _instances(glb, found, rows)
    _metadata(glb, found, rows)
    _extensions(glb, found)
    return found


def _views(glb, found):
    for number, buffer in enumerate(glb.json.get("buffers", [])):
        if not buffer["byteLength"] <= len(glb.buffers[number]) <= buffer["byteLength"] + 3:
            found.append(f"buffer {number} is not as long as stated")
    for number, view in enumerate(glb.json.get("bufferViews", [])):
        end = view.get("byteOffset", 0) + view["byteLength"]
        if view["byteLength"] < 1 or end > glb.json["buffers"][view["buffer"]]["byteLength"]:
            found.append(f"view {number} reaches beyond its buffer")
        if view.get("byteStride", 4) % 4 or not 4 <= view.get("byteStride", 4) <= 252:
            found.append(f"view {number} has a stride that is no multiple of 4")
    if found:
        return
    for number, accessor in enumerate(glb.json.get("accessors", [])):
        view = glb.json["bufferViews"][accessor["bufferView"]]
        dtype = np.dtype(COMPONENTS[accessor["componentType"]])
        size = dtype.itemsize * WIDTHS[accessor["type"]]
        start = accessor.get("byteOffset", 0)
        if (view.get("byteOffset", 0) + start) % dtype.itemsize or start % dtype.itemsize:
            found.append(f"accessor {number} is not aligned to its component")
        if start + (accessor["count"] - 1) * view.get("byteStride", size) + size > view["byteLength"]:
            found.append(f"accessor {number} reaches beyond its view")
            continue
        if accessor["count"] < 1:
            found.append(f"accessor {number} is empty")
        stored = glb.stored(number)
        if dtype.kind == "f" and not np.isfinite(stored).all():
            found.append(f"accessor {number} holds a number that is not finite")
        if accessor.get("normalized") and (dtype.kind == "f" or dtype.itemsize == 4):
            found.append(f"accessor {number} cannot be normalised")


def _meshes(glb, found):
    for number, mesh in enumerate(glb.json.get("meshes", [])):
        for primitive in mesh["primitives"]:
            counts = set()
            for name, accessor in primitive["attributes"].items():
                entry = glb.json["accessors"][accessor]
                counts.add(entry["count"])
                size = np.dtype(COMPONENTS[entry["componentType"]]).itemsize * WIDTHS[entry["type"]]
                view = glb.json["bufferViews"][entry["bufferView"]]
                if entry.get("byteOffset", 0) % 4 or view.get("byteStride", size) % 4:
                    found.append(f"mesh {number}: {name} is not on 4 bytes")
            if len(counts) != 1:
                found.append(f"mesh {number} has attributes of several lengths")
            position = glb.json["accessors"][primitive["attributes"]["POSITION"]]
            stored = glb.stored(primitive["attributes"]["POSITION"])
            if position.get("min") != stored.min(axis=0).tolist() or position.get("max") != stored.max(axis=0).tolist():
                found.append(f"mesh {number} states wrong bounds")
            if np.abs(glb.values(primitive["attributes"]["POSITION"])).max() > REACH_M:
                found.append(f"mesh {number} reaches beyond 4 km")
            if "NORMAL" in primitive["attributes"]:
                lengths = np.linalg.norm(glb.values(primitive["attributes"]["NORMAL"]), axis=1)
                if np.abs(lengths - 1.0).max() > 0.01:
                    found.append(f"mesh {number} has normals that are not of length 1")
            if "indices" in primitive:
                indices = glb.json["accessors"][primitive["indices"]]
                if "byteStride" in glb.json["bufferViews"][indices["bufferView"]]:
                    found.append(f"mesh {number} has indices with a stride")
                most = int(glb.stored(primitive["indices"]).max())
                if most >= position["count"] or most == np.iinfo(COMPONENTS[indices["componentType"]]).max:
                    found.append(f"mesh {number} has indices beyond its corners")


def _instances(glb, found, rows):
    for number, node in enumerate(glb.json.get("nodes", [])):
        extensions = node.get("extensions", {})
        scale = np.array(node.get("scale", (1.0, 1.0, 1.0)))
        if len(np.unique(np.abs(scale))) != 1 or (scale == 0).any():
            found.append(f"node {number} scales its axes differently")
        for primitive in glb.json["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            features = primitive.get("extensions", {}).get("EXT_mesh_features")
            if features is not None:
                _features(glb, found, rows, f"node {number}", features, primitive["attributes"])
        if "EXT_instance_features" in extensions and "EXT_mesh_gpu_instancing" not in extensions:
            found.append(f"node {number} has features of instances and no instances")
        if "EXT_mesh_gpu_instancing" not in extensions:
            continue
        if "mesh" not in node:
            found.append(f"node {number} has instances of nothing")
        attributes = extensions["EXT_mesh_gpu_instancing"]["attributes"]
        entries = {name: glb.json["accessors"][accessor] for name, accessor in attributes.items()}
        if len({entry["count"] for entry in entries.values()}) != 1:
            found.append(f"node {number} has instance attributes of several lengths")
        for name, entry in entries.items():
            form = (entry["type"], entry["componentType"], entry.get("normalized", False))
            allowed = {
                "TRANSLATION": {("VEC3", 5126, False)},
                "ROTATION": {("VEC4", 5126, False), ("VEC4", 5120, True), ("VEC4", 5122, True)},
                "SCALE": {("VEC3", 5126, False)},
            }
            if name in allowed and form not in allowed[name]:
                found.append(f"node {number}: {name} has a type that is not allowed")
            if name not in allowed and not name.startswith("_"):
                found.append(f"node {number}: {name} is no attribute of instances")
            if entry.get("byteOffset", 0) % 4:
                found.append(f"node {number}: {name} is not on 4 bytes")
        if "TRANSLATION" in attributes and np.abs(glb.values(attributes["TRANSLATION"]) * scale).max() > REACH_M:
            found.append(f"node {number} has an instance beyond 4 km")
        if "ROTATION" in attributes:
            lengths = np.linalg.norm(glb.values(attributes["ROTATION"]), axis=1)
            if np.abs(lengths - 1.0).max() > 1e-4:
                found.append(f"node {number} has a quaternion that is not of length 1")
        if "SCALE" in attributes and glb.values(attributes["SCALE"]).min() <= 0:
            found.append(f"node {number} has an instance of no or negative size")
        if "EXT_instance_features" in extensions:
            _features(glb, found, rows, f"node {number}", extensions["EXT_instance_features"], attributes)


def _features(glb, found, rows, where, features, attributes):
    if not features.get("featureIds"):
        found.append(f"{where} has features without ids")
        return
    tables = glb.json.get("extensions", {}).get("EXT_structural_metadata", {}).get("propertyTables", [])
    for entry in features["featureIds"]:
        name = f"_FEATURE_ID_{entry.get('attribute')}"
        if name not in attributes:
            found.append(f"{where} names feature ids that are not there")
            continue
        accessor = glb.json["accessors"][attributes[name]]
        if accessor["type"] != "SCALAR" or accessor.get("normalized"):
            found.append(f"{where} has feature ids of a type that is not allowed")
            continue
        ids = glb.values(attributes[name])[:, 0]
        if entry.get("featureCount") != len(np.unique(ids)):
            found.append(f"{where} states a wrong featureCount")
        if (ids != np.round(ids)).any() or ids.min() < 0:
            found.append(f"{where} has feature ids that are not whole")
        if not 0 <= entry.get("propertyTable", -1) < len(tables):
            found.append(f"{where} names a property table that is not there")
        elif ids.max() >= tables[entry["propertyTable"]]["count"]:
            found.append(f"{where} has a feature id beyond the property table")
        rows.extend(ids.astype(int).tolist())


def _metadata(glb, found, rows):
    extension = glb.json.get("extensions", {}).get("EXT_structural_metadata")
    if extension is None:
        return
    schema = extension["schema"]
    enums = schema.get("enums", {})
    for name in [schema.get("id", ""), *schema["classes"], *enums]:
        if not IDENTIFIER.fullmatch(name):
            found.append(f"{name!r} is no identifier")
    for name, enum in enums.items():
        for key in ("name", "value"):
            entries = [value[key] for value in enum["values"]]
            if len(set(entries)) != len(entries):
                found.append(f"enum {name} has a {key} twice")
    for table in extension["propertyTables"]:
        count = table["count"]
        described = schema["classes"][table["class"]]["properties"]
        if count < 1:
            found.append("an empty property table")
        if sorted(rows) != list(range(count)):
            found.append("rows of the property table are not one a plant")
        for name, stored in table["properties"].items():
            if not IDENTIFIER.fullmatch(name) or name not in described:
                found.append(f"property {name!r} is not in its class")
                continue
            _column(glb, found, name, described[name], stored, count, enums)


def _column(glb, found, name, described, stored, count, enums):
    for view in (stored["values"], stored.get("stringOffsets", stored["values"])):
        if glb.json["bufferViews"][view].get("byteOffset", 0) % 8:
            found.append(f"column {name} is not on 8 bytes")
    data = glb.bytes_of(stored["values"])
    if described["type"] == "STRING":
        dtype = np.dtype(METADATA_TYPES[stored.get("stringOffsetType", "UINT32")])
        offsets = glb.bytes_of(stored["stringOffsets"])
        if len(offsets) != (count + 1) * dtype.itemsize:
            found.append(f"column {name} has not an offset a row and one more")
            return
        ends = np.frombuffer(offsets, dtype).astype(np.int64)
        if ends[0] != 0 or (np.diff(ends) < 0).any() or not ends[-1] <= len(data) <= max(ends[-1], 1):
            found.append(f"column {name} has offsets that do not follow each other")
            return
        try:
            [data[start:end].decode() for start, end in itertools.pairwise(ends)]
        except UnicodeDecodeError:
            found.append(f"column {name} is not UTF-8")
        return
    enum = enums.get(described.get("enumType"), {})
    kind = enum.get("valueType", "UINT16") if described["type"] == "ENUM" else described.get("componentType")
    dtype = np.dtype(METADATA_TYPES[kind])
    if len(data) != count * dtype.itemsize:
        found.append(f"column {name} has not a value a row")
        return
    values = np.frombuffer(data, dtype)
    if {"scale", "offset"} & set(described) and dtype.kind != "f" and not described.get("normalized"):
        found.append(f"column {name} has a scale and is neither float nor normalised")
    if described["type"] == "ENUM" and not set(values.tolist()) <= {value["value"] for value in enum.get("values", [])}:
        found.append(f"column {name} has a value that its enum has not")
    if dtype.kind == "f" and not np.isfinite(values).all():
        found.append(f"column {name} holds a number that is not finite")


def _extensions(glb, found):
    used = {"EXT_structural_metadata"} & set(glb.json.get("extensions", {}))
    for entry in glb.json.get("nodes", []) + glb.json.get("materials", []):
        used |= set(entry.get("extensions", {}))
    for mesh in glb.json.get("meshes", []):
        for primitive in mesh["primitives"]:
            used |= set(primitive.get("extensions", {}))
            for name in {"POSITION", "NORMAL", "TEXCOORD_0"} & set(primitive["attributes"]):
                accessor = glb.json["accessors"][primitive["attributes"][name]]
                core = {5126} if name != "TEXCOORD_0" else {5126, 5121, 5123}
                if accessor["componentType"] not in core:
                    used.add("KHR_mesh_quantization")
    if set(glb.json.get("extensionsUsed", [])) != used:
        found.append(f"extensionsUsed is not {sorted(used)}")
    if set(glb.json.get("extensionsRequired", [])) != used & MUST_BE_REQUIRED:
        found.append(f"extensionsRequired is not {sorted(used & MUST_BE_REQUIRED)}")
