"""What must hold of a folder of 3D Tiles, checked from its bytes alone, without the package's reader or writer."""

import json
import math
import struct
from pathlib import Path

import numpy as np

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
OFFSETS = {"UINT8": "u1", "UINT16": "<u2", "UINT32": "<u4"}
SLACK_M = 2e-3


def faults(folder: Path) -> list[str]:
    """Return what is wrong, in words; nothing where all is well."""
    found: list[str] = []
    text = json.loads((folder / "tileset.json").read_text(encoding="utf-8"))
    named = {"tileset.json"}
    if text["asset"]["version"] != "1.1":
        found.append("version")
    found += transform_faults(text["root"])
    if text["geometricError"] < text["root"]["geometricError"]:
        found.append("the tileset's error is less than its root's")
    found += explicit_faults(folder, text["root"], named)
    leaves: list[str] = []
    for node in implicit_nodes(text["root"]):
        found += quadtree_faults(folder, node, text["schema"], named, leaves)
    if len(leaves) != len(set(leaves)):
        found.append("a plant in several leaves")
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    found += [f"not listed: {name}" for name in sorted(there - named)]
    found += [f"not there: {name}" for name in sorted(named - there)]
    return found


def transform_faults(root: dict) -> list[str]:
    matrix = np.array(root["transform"]).reshape(4, 4).T
    turn = matrix[:3, :3]
    found = [] if np.allclose(turn @ turn.T, np.eye(3), atol=1e-12) and np.linalg.det(turn) > 0 else ["no rotation"]
    x, y, z = matrix[:3, 3]
    latitude = math.atan2(z, math.hypot(x, y) * (1 - 0.00669437999014))
    up = [math.cos(latitude) * math.cos(math.atan2(y, x)), math.cos(latitude) * math.sin(math.atan2(y, x))]
    if not np.allclose(turn[:, 2], [*up, math.sin(latitude)], atol=1e-9):
        found.append("up is not up")
    return found


def implicit_nodes(node: dict) -> list[dict]:
    own = [node] if "implicitTiling" in node else []
    return own + [one for child in node.get("children", []) for one in implicit_nodes(child)]


def ends(box: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a box whose half axes lie along the frame's."""
    values = np.array(box)
    half = np.abs(values[3:].reshape(3, 3)).sum(axis=0)
    return values[:3] - half, values[:3] + half


def holds(outer: list[float], inner: list[float]) -> bool:
    (a, b), (c, d) = ends(outer), ends(inner)
    return bool((a <= c + SLACK_M).all() and (d <= b + SLACK_M).all())


def explicit_faults(folder: Path, node: dict, named: set[str]) -> list[str]:
    found = []
    box = node["boundingVolume"]["box"]
    for child in node.get("children", []):
        if child["geometricError"] > node["geometricError"]:
            found.append("an error that grows downward")
        if not holds(box, child["boundingVolume"]["box"]):
            found.append("a box that does not hold a child's")
        found += explicit_faults(folder, child, named)
    if "content" in node and "implicitTiling" not in node:
        named.add(node["content"]["uri"])
        if (folder / node["content"]["uri"]).is_file():
            found += content_faults(folder, node["content"]["uri"], box, named, [])
    return found


def quadtree_faults(folder: Path, node: dict, schema: dict, named: set[str], leaves: list[str]) -> list[str]:
    implicit = node["implicitTiling"]
    held, available = implicit["subtreeLevels"], implicit["availableLevels"]
    box_of_root = node["boundingVolume"]["box"]
    found: list[str] = []
    boxes: dict[tuple[int, int, int], list[float]] = {}
    waiting = [(0, 0, 0)]
    while waiting:
        level, x, y = waiting.pop()
        name = filled(implicit["subtrees"]["uri"], level, x, y)
        named.add(name)
        if not (folder / name).is_file():
            continue
        tiles, children, wrong = subtree(folder / name, held, schema)
        found += [f"{name}: {fault}" for fault in wrong]
        for below in range(held):
            for place in range(4**below):
                number = (4**below - 1) // 3 + place
                if number in tiles:
                    dx, dy = unwoven(place)
                    boxes[level + below, (x << below) + dx, (y << below) + dy] = tiles[number]
        waiting += [(level + held, (x << held) + unwoven(c)[0], (y << held) + unwoven(c)[1]) for c in children]
    if not boxes or (0, 0, 0) not in boxes:
        return [*found, "no root"]
    if not holds(box_of_root, boxes[0, 0, 0]):
        found.append("the root's square does not hold what is in it")
    plants: dict[tuple[int, int, int], list[str]] = {}
    for (level, x, y), box in boxes.items():
        if level >= available:
            found.append("a tile below the last level")
        above = (level - 1, x // 2, y // 2)
        if level and above not in boxes:
            found.append("a tile without a parent")
        elif level and not holds(boxes[above], box):
            found.append("a tile's box that does not hold a child's")
        uri = filled(node["content"]["uri"], level, x, y)
        named.add(uri)
        plants[level, x, y] = []
        if (folder / uri).is_file():
            found += content_faults(folder, uri, box, named, plants[level, x, y])
            low, high = ends(square(box_of_root, level, x, y))
            centre = np.array(positions(folder, uri))
            if len(centre) and not ((centre >= low[:2] - SLACK_M) & (centre <= high[:2] + SLACK_M)).all():
                found.append(f"{uri}: a plant outside the square")
    below_of: dict[tuple[int, int, int], set[str]] = {}
    for level, x, y in sorted(boxes, reverse=True):
        kids = [k for k in ((level + 1, 2 * x + i, 2 * y + j) for i in (0, 1) for j in (0, 1)) if k in boxes]
        own = plants[level, x, y]
        if len(own) != len(set(own)):
            found.append("a plant twice in a tile")
        if not kids:
            leaves += own
            below_of[level, x, y] = set(own)
        else:
            below_of[level, x, y] = set().union(*(below_of[k] for k in kids))
            if not set(own) <= below_of[level, x, y]:
                found.append("a plant of a tile that no leaf below holds")
    return found


def square(box: list[float], level: int, x: int, y: int) -> list[float]:
    low, high = ends(box)
    side = (high - low)[:2] / 2**level
    first = low[:2] + side * [x, y]
    middle = first + side / 2
    return [*middle, box[2], side[0] / 2, 0, 0, 0, side[1] / 2, 0, 0, 0, box[11]]


def unwoven(place: int) -> tuple[int, int]:
    bits = range(0, 40, 2)
    return sum((place >> b & 1) << b // 2 for b in bits), sum((place >> (b + 1) & 1) << b // 2 for b in bits)


def filled(template: str, level: int, x: int, y: int) -> str:
    return template.replace("{level}", str(level)).replace("{x}", str(x)).replace("{y}", str(y))


def subtree(path: Path, levels: int, schema: dict) -> tuple[dict[int, list[float]], list[int], list[str]]:
    """Return the box of each tile that is there by its bit, the child subtrees, and what is wrong."""
    data, wrong = path.read_bytes(), []
    magic, version, head, body = struct.unpack_from("<4sIQQ", data)
    if magic != b"subt" or version != 1 or head % 8 or body % 8 or len(data) != 24 + head + body:
        return {}, [], ["header"]
    text, binary = json.loads(data[24 : 24 + head]), data[24 + head :]
    if text["buffers"][0]["byteLength"] != body:
        wrong.append("length of the buffer")

    def view(number: int) -> bytes:
        entry = text["bufferViews"][number]
        if entry["byteOffset"] % 8:
            wrong.append("a view that is not on 8 bytes")
        return binary[entry["byteOffset"] : entry["byteOffset"] + entry["byteLength"]]

    def bits(availability: dict, count: int) -> list[int]:
        if "constant" in availability:
            return [number for number in range(count) if availability["constant"] == 1]
        stored = view(availability["bitstream"])
        if len(stored) != math.ceil(count / 8):
            wrong.append("length of the bits")
        places = [number for number in range(8 * len(stored)) if stored[number // 8] >> (number % 8) & 1]
        if len(places) != availability["availableCount"] or (places and places[-1] >= count):
            wrong.append("count of bits")
        return places

    tiles = bits(text["tileAvailability"], (4**levels - 1) // 3)
    if bits(text["contentAvailability"][0], (4**levels - 1) // 3) != tiles:
        wrong.append("tiles without content")
    children = bits(text["childSubtreeAvailability"], 4**levels)
    table = text["propertyTables"][text["tileMetadata"]]
    ((name, entry),) = schema["classes"][table["class"]]["properties"].items()
    if entry["semantic"] != "TILE_BOUNDING_BOX" or table["count"] != len(tiles):
        wrong.append("table of boxes")
    values = np.frombuffer(view(table["properties"][name]["values"]), "<f8")
    if len(values) != 12 * len(tiles):
        return {}, children, [*wrong, "boxes"]
    return {number: values[12 * k : 12 * k + 12].tolist() for k, number in enumerate(tiles)}, children, wrong


def glb(path: Path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
    head = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + head]), data[28 + head :]


class Content:
    """A GLB with the buffers beside it."""

    def __init__(self, folder: Path, uri: str, named: set[str]) -> None:
        self.text, binary = glb(folder / uri)
        self.faults: list[str] = []
        self.buffers = []
        for buffer in self.text.get("buffers", []):
            data = binary
            if "uri" in buffer:
                data = self._file(folder, uri, buffer["uri"], named)
                if len(data) != buffer["byteLength"]:
                    self.faults.append(f"{uri}: a buffer of another length")
            self.buffers.append(data)
        for image in self.text.get("images", []):
            if "uri" in image:
                self._file(folder, uri, image["uri"], named)

    def _file(self, folder: Path, uri: str, beside: str, named: set[str]) -> bytes:
        path = ((folder / uri).parent / beside).resolve()
        if not path.is_relative_to(folder.resolve()):
            self.faults.append(f"{uri}: leads out of the folder")
            return b""
        named.add(path.relative_to(folder.resolve()).as_posix())
        return path.read_bytes() if path.is_file() else b""

    def view(self, number: int) -> bytes:
        entry = self.text["bufferViews"][number]
        start = entry.get("byteOffset", 0)
        return self.buffers[entry["buffer"]][start : start + entry["byteLength"]]

    def values(self, number: int) -> np.ndarray:
        entry = self.text["accessors"][number]
        kind, width = np.dtype(COMPONENTS[entry["componentType"]]), WIDTHS[entry["type"]]
        stride = self.text["bufferViews"][entry["bufferView"]].get("byteStride", kind.itemsize * width)
        data = self.view(entry["bufferView"])[entry.get("byteOffset", 0) :]
        rows = np.ndarray((entry["count"], width), kind, data, strides=(stride, kind.itemsize)).astype(np.float64)
        if entry.get("normalized"):
            rows = np.maximum(rows / np.iinfo(kind).max, -1.0 if kind.kind == "i" else 0.0)
        return rows

    def instances(self, node: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return translations, rotations and scales of a node's instances."""
        attributes = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
        places = self.values(attributes["TRANSLATION"])
        turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))
        if "ROTATION" in attributes:
            turns = self.values(attributes["ROTATION"])
        sizes = self.values(attributes["SCALE"]) if "SCALE" in attributes else np.ones((len(places), 3))
        return places, turns, sizes


def z_up(xyz: np.ndarray) -> np.ndarray:
    return np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=-1)


def rotated(turns: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return (i, v, 3) corners turned by unit quaternions."""
    axis, cos = turns[:, None, :3], turns[:, None, 3:]
    once = np.cross(axis, corners[None])
    return corners[None] + 2 * (cos * once + np.cross(axis, once))


def content_faults(folder: Path, uri: str, box: list[float], named: set[str], plants: list[str]) -> list[str]:
    content = Content(folder, uri, named)
    found, text = content.faults, content.text
    low, high = ends(box)
    count = 0
    for node in text.get("nodes", []):
        shift, size = np.array(node.get("translation", [0, 0, 0])), np.array(node.get("scale", [1, 1, 1]))
        for primitive in text["meshes"][node["mesh"]]["primitives"]:
            corners = content.values(primitive["attributes"]["POSITION"])
            if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
                places, turns, sizes = content.instances(node)
                stand = rotated(turns, corners) * sizes[:, None, :] + places[:, None, :]
            else:
                stand = corners[None]
            reached = z_up(stand * size + shift).reshape(-1, 3)
            if (reached < low - SLACK_M).any() or (reached > high + SLACK_M).any():
                found.append(f"{uri}: something outside its box")
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            count += len(content.instances(node)[0])
    metadata = text.get("extensions", {}).get("EXT_structural_metadata")
    if metadata is not None:
        table = metadata["propertyTables"][0]
        if table["count"] != count:
            found.append(f"{uri}: {count} plants, {table['count']} rows")
        column = table["properties"]["plant_id"]
        at = np.frombuffer(content.view(column["stringOffsets"]), OFFSETS[column.get("stringOffsetType", "UINT32")])
        letters = content.view(column["values"])
        plants += [letters[a:b].decode() for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True)]
        if len(plants) != count:
            found.append(f"{uri}: {count} plants, {len(plants)} ids")
    return found


def positions(folder: Path, uri: str) -> list[list[float]]:
    """Return where the instances of a content stand, east and north."""
    content = Content(folder, uri, set())
    found = []
    for node in content.text.get("nodes", []):
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            shift, size = np.array(node.get("translation", [0, 0, 0])), np.array(node.get("scale", [1, 1, 1]))
            found += z_up(content.instances(node)[0] * size + shift)[:, :2].tolist()
    return found
