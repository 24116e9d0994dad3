"""Read the plants of our own glTF files back, trusting nothing in them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from urbanforest_cli.core.placed import PlacedPlants, stated_columns
from urbanforest_cli.files.gltf_file import GltfFile
from urbanforest_cli.files.gltf_plain import PLANTS_MEMBER
from urbanforest_cli.files.words import in_words

__all__ = ["FoundPlants", "GltfFile", "columns_of", "open_gltf", "plants_of", "read_plants", "read_provenance"]

OFFSETS = {"UINT8": "u1", "UINT16": "<u2", "UINT32": "<u4", "UINT64": "<u8"}
NUMBERS = {"FLOAT32": "<f4", "UINT8": "u1", "UINT16": "<u2", "UINT32": "<u4"}
ROW_MAX = np.iinfo(np.uint32).max
ENUMS = {"UINT8": "u1", "UINT16": "<u2"}


@dataclass(frozen=True)
class FoundPlants:
    """Plants of one file: rows as its property table has them.

    Parameters
    ----------
    xyz_m
        (n, 3) float64 x east, y north, z up about the file's origin, or in the frame of a tile's content.
    columns
        Properties by name: words as object arrays of str, numbers as stored, NaN where a float is not known.
    """

    xyz_m: NDArray[np.float64]
    columns: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.xyz_m)


def open_gltf(path: Path, *, root: Path | None = None) -> GltfFile:
    """Open a GLB, or glTF as JSON, and check the files that it names.

    Parameters
    ----------
    root
        Folder that those must lie in; the file's own where None.

    Raises
    ------
    InputError
        No such file; torn; not glTF 2.0; or it names a file that is missing or outside `root`.
    """
    return GltfFile(path, root=root)


def read_plants(path: Path) -> PlacedPlants:
    """Read the plants of a scene that says in its asset's ``extras`` where it lies.

    Raises
    ------
    InputError
        The file is not whole, not ours, or its plants have no id.
    """
    file = open_gltf(path)
    found = plants_of(file)
    extras = _extras(file)
    origin = file.members(extras.get("origin"), "asset.extras.origin")
    names = ("easting_m", "northing_m", "height_m")
    offset = file.numbers([origin.get(name) for name in names], len(names), "asset.extras.origin")
    wkt = file.members(extras.get("crs"), "asset.extras.crs").get("wkt")
    try:
        crs = CRS.from_wkt(wkt if isinstance(wkt, str) else "")
    except CRSError:
        file.fault("asset.extras.crs is no CRS", str(wkt)[:100])
    count = len(found)
    ids = found.columns.get("plant_id", np.zeros(0, np.object_))
    if len(ids) != count or ids.dtype != np.object_:
        file.fault("its plants have no plant_id")
    heights = found.columns.get("height_m", np.full(count, np.nan))
    if heights.dtype.kind not in "fiu":
        file.fault("height_m is no number")
    return PlacedPlants(ids, found.xyz_m + offset, crs, heights.astype(np.float64), columns_of(file, found))


def read_provenance(path: Path) -> dict[str, Any]:
    """Read the provenance in a scene's asset.

    Raises
    ------
    InputError
        The file is not whole, or states none.
    """
    file = open_gltf(path)
    return file.members(_extras(file).get("provenance"), "asset.extras.provenance")


def _extras(file: GltfFile) -> dict[str, Any]:
    return file.members(file.json["asset"].get("extras"), "asset.extras")


def columns_of(file: GltfFile, found: FoundPlants) -> dict[str, NDArray[Any]]:
    """Return what a file states of each plant beside its place and height, as `PlacedPlants` has it."""
    try:
        return stated_columns(found.columns)
    except (TypeError, ValueError) as error:
        file.fault("a size that is no number", in_words(error))


def plants_of(file: GltfFile) -> FoundPlants:
    """Return a file's plants: instances, points and nodes that are plants, each once.

    Raises
    ------
    InputError
        A row of the property table has no place or several, or the file is broken.
    """
    places: list[NDArray[np.float64]] = []
    rows: list[NDArray[np.int64]] = []
    alone: list[dict[str, Any]] = []
    alone_at: list[NDArray[np.float64]] = []
    listed: list[FoundPlants] = []
    for node in _nodes(file):
        if "mesh" not in node:
            continue
        extensions = file.members(node.get("extensions", {}), "a node's extensions")
        extras = node.get("extras", {})
        origin, scale = _transform(file, node)
        if "EXT_mesh_gpu_instancing" in extensions:
            if "rotation" in node:
                file.fault("instances of a node that is turned")
            attributes = file.members(
                file.members(extensions["EXT_mesh_gpu_instancing"], "instances").get("attributes"), "attributes"
            )
            place = _vectors(file, attributes.get("TRANSLATION"))
            places.append(origin + scale * place)
            rows.append(_rows(file, attributes, len(place), extensions.get("EXT_instance_features")))
        elif isinstance(extras, dict) and PLANTS_MEMBER in extras:
            place = origin + scale * _vectors(file, _primitive(file, node)["attributes"].get("POSITION"))
            columns = {
                name: _column(file, file.items(values, name))
                for name, values in file.members(extras[PLANTS_MEMBER], "a list of plants").items()
            }
            if any(len(values) != len(place) for values in columns.values()):
                file.fault("a list of plants that is not as long as its points")
            listed.append(FoundPlants(_z_up(place), columns))
        elif isinstance(extras, dict) and "plant_id" in extras:
            alone.append(extras)
            alone_at.append(origin)
        else:
            primitive = _primitive(file, node)
            features = file.members(primitive.get("extensions", {}), "extensions").get("EXT_mesh_features")
            if features is not None:
                place = _vectors(file, primitive["attributes"].get("POSITION"))
                places.append(origin + scale * place)
                rows.append(_rows(file, primitive["attributes"], len(place), features))
    if alone or listed:
        return _joined(file, ([_from_nodes(file, alone, alone_at)] if alone else []) + listed)
    return _in_rows(file, places, rows)


def _nodes(file: GltfFile) -> list[dict[str, Any]]:
    scene = file.element("scenes", file.json.get("scene", 0))
    numbers = file.items(scene.get("nodes", []), "the scene's nodes")
    if len(numbers) > len(file.items(file.json.get("nodes", []), "nodes")):
        file.fault("a node that is twice in the scene")
    nodes = [file.element("nodes", number) for number in numbers]
    if any("children" in node or "matrix" in node for node in nodes):
        file.fault("nodes within nodes, or moved by a matrix")
    return nodes


def _transform(file: GltfFile, node: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    origin = file.numbers(node["translation"], 3, "translation") if "translation" in node else np.zeros(3)
    scale = file.numbers(node["scale"], 3, "scale") if "scale" in node else np.ones(3)
    return origin, scale


def _primitive(file: GltfFile, node: dict[str, Any]) -> dict[str, Any]:
    primitives = file.items(file.element("meshes", node["mesh"]).get("primitives"), "primitives")
    if not primitives:
        file.fault("a mesh without primitives")
    primitive = file.members(primitives[0], "a primitive")
    file.members(primitive.get("attributes"), "attributes")
    return primitive


def _vectors(file: GltfFile, number: object) -> NDArray[np.float64]:
    values = file.accessor(number)
    if values.ndim != 2 or values.shape[1] != 3:
        file.fault("places that are not three numbers each")
    return values.astype(np.float64)


def _rows(file: GltfFile, attributes: dict[str, Any], count: int, features: object) -> NDArray[np.int64]:
    """Return each thing's row of the property table; -1 where the file ties it to none."""
    if features is None:
        return np.full(count, -1, np.int64)
    entries = file.items(file.members(features, "features").get("featureIds"), "featureIds")
    first = file.members(entries[0] if entries else None, "featureIds")
    if first.get("attribute") != 0 or first.get("propertyTable") != 0:
        file.fault("feature ids that do not lead to the table of plants")
    ids = file.accessor(attributes.get("_FEATURE_ID_0"))
    if ids.shape != (count,) or (ids != np.rint(ids)).any() or ids.min() < 0 or ids.max() > ROW_MAX:
        file.fault("feature ids that are no rows")
    return ids.astype(np.int64)


def _in_rows(file: GltfFile, places: list[NDArray[np.float64]], rows: list[NDArray[np.int64]]) -> FoundPlants:
    place = np.concatenate([*places, np.zeros((0, 3))])
    row = np.concatenate([*rows, np.zeros(0, np.int64)])
    extension = file.members(file.json.get("extensions", {}), "extensions").get("EXT_structural_metadata")
    if extension is None:
        if (row >= 0).any():
            file.fault("feature ids without a table of plants")
        return FoundPlants(_z_up(place), {})
    columns, count = _table(file, file.members(extension, "EXT_structural_metadata"))
    if len(row) != count or not np.array_equal(np.sort(row), np.arange(count)):
        file.fault("plants and rows of their table do not match", f"{len(row)} plants, {count} rows")
    xyz = np.zeros((count, 3))
    xyz[row] = place
    return FoundPlants(_z_up(xyz), columns)


def _table(file: GltfFile, extension: dict[str, Any]) -> tuple[dict[str, NDArray[Any]], int]:
    schema = file.members(extension.get("schema"), "schema")
    tables = file.items(extension.get("propertyTables"), "propertyTables")
    table = file.members(tables[0] if len(tables) == 1 else None, "the only property table")
    classes = file.members(schema.get("classes"), "classes")
    described = file.members(classes.get(str(table.get("class"))), "the table's class")
    properties = file.members(described.get("properties"), "the class's properties")
    count = file.whole(table.get("count"), "count of the property table")
    columns = {}
    for name, stored in file.members(table.get("properties"), "the table's properties").items():
        entry = file.members(properties.get(name), f"property {name[:50]!r} of the class")
        columns[name] = _stored(file, schema, entry, file.members(stored, name), count)
    return columns, count


def _stored(
    file: GltfFile, schema: dict[str, Any], entry: dict[str, Any], stored: dict[str, Any], count: int
) -> NDArray[Any]:
    kind = entry.get("type")
    if kind == "STRING":
        return _text(file, stored, count)
    if kind == "ENUM":
        enums = file.members(schema.get("enums"), "enums")
        enum = file.members(enums.get(str(entry.get("enumType"))), "an enum")
        values = _numbers(file, stored, ENUMS.get(str(enum.get("valueType", "UINT16"))), count)
        words = {}
        for value in file.items(enum.get("values"), "an enum's values"):
            pair = file.members(value, "an enum's value")
            words[file.whole(pair.get("value"), "an enum's value")] = str(pair.get("name"))
        used, inverse = np.unique(values, return_inverse=True)
        if any(int(value) not in words for value in used):
            file.fault("a value that is none of its enum's")
        named = np.array([words[int(value)] for value in used], np.object_)
        return named[inverse.reshape(-1)] if count else np.zeros(0, np.object_)
    if kind == "SCALAR":
        values = _numbers(file, stored, NUMBERS.get(str(entry.get("componentType"))), count)
        if entry.get("normalized") is True and values.dtype == np.uint16:
            return values * (float(file.numbers([entry.get("scale", 1.0)], 1, "scale")[0]) / np.iinfo(np.uint16).max)
        if values.dtype.kind == "f":
            if "noData" in entry:
                missing = np.float32(file.numbers([entry["noData"]], 1, "noData")[0])
                values = np.where(values == missing, np.float32(np.nan), values)
            elif not np.isfinite(values).all():
                file.fault("a number that is not finite")
        return values
    file.fault("a property of a type not in use", str(kind)[:50])


def _numbers(file: GltfFile, stored: dict[str, Any], dtype: str | None, count: int) -> NDArray[Any]:
    if dtype is None:
        file.fault("a property of a type not in use")
    data = file.view(stored.get("values"))
    size = np.dtype(dtype).itemsize
    if len(data) < count * size:
        file.fault("a column is shorter than its table", f"{len(data)} bytes for {count} rows")
    return np.frombuffer(data[: count * size].tobytes(), dtype)


def _text(file: GltfFile, stored: dict[str, Any], count: int) -> NDArray[np.object_]:
    name = str(stored.get("stringOffsetType", "UINT32"))
    offsets = _numbers(file, {"values": stored.get("stringOffsets")}, OFFSETS.get(name), count + 1)
    data = file.view(stored.get("values"))
    if (offsets[1:] < offsets[:-1]).any() or int(offsets[-1]) > len(data):
        file.fault("texts of a column reach beyond its bytes")
    ends = offsets.tolist()
    whole = data[: ends[-1]].tobytes()
    texts = np.empty(count, np.object_)
    try:
        if whole.isascii():
            letters = whole.decode("ascii")
            texts[:] = [letters[start:end] for start, end in pairwise(ends)]
        else:
            texts[:] = [whole[start:end].decode("utf-8") for start, end in pairwise(ends)]
    except UnicodeDecodeError as error:
        file.fault("text that is not UTF-8", str(error)[:100])
    return texts


def _from_nodes(file: GltfFile, extras: list[dict[str, Any]], places: list[NDArray[np.float64]]) -> FoundPlants:
    names = list(extras[0])
    if any(list(entry) != names for entry in extras):
        file.fault("plants that do not all state the same properties")
    columns = {name: _column(file, [entry[name] for entry in extras]) for name in names}
    return FoundPlants(_z_up(np.array(places, np.float64).reshape(len(places), 3)), columns)


def _column(file: GltfFile, values: list[Any]) -> NDArray[Any]:
    """Return values of JSON as words or as numbers."""
    if all(isinstance(value, str) for value in values):
        words = np.empty(len(values), np.object_)
        words[:] = values
        return words
    if all(value is None or (isinstance(value, int | float) and not isinstance(value, bool)) for value in values):
        try:
            return np.array(values, np.float64)
        except OverflowError:
            file.fault("a number beyond all bounds")
    file.fault("a property that is neither words nor numbers")


def _joined(file: GltfFile, found: list[FoundPlants]) -> FoundPlants:
    names = list(found[0].columns)
    if any(list(some.columns) != names for some in found):
        file.fault("plants that do not all state the same properties")
    columns = {name: np.concatenate([some.columns[name] for some in found]) for name in names}
    return FoundPlants(np.concatenate([some.xyz_m for some in found]), columns)


def _z_up(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([xyz[:, 0], -xyz[:, 2], xyz[:, 1]], axis=1)
