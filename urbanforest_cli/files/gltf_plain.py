"""Plants of a glTF without extensions: a node each, its properties beside it as ``extras``."""

from __future__ import annotations

from collections.abc import Mapping
from json.encoder import encode_basestring

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Instances, Points, Property
from urbanforest_cli.files.gltf_document import Document, to_json, y_up
from urbanforest_cli.files.gltf_instances import cells
from urbanforest_cli.files.gltf_pack import translation
from urbanforest_cli.files.gltf_points import point_primitive

TRANSLATION = '"translation":[%.4f,%.4f,%.4f]'
ROTATION = '"rotation":[0,%.7f,0,%.7f]'
SCALE = '"scale":[%.7g,%.7g,%.7g]'
PLANTS_MEMBER = "plants"
"""Of a node's extras: columns of properties of plants that are points of the node's mesh."""


def add_plain_plants(
    document: Document, instances: Instances, properties: Mapping[str, Property], meshes: Mapping[int, int]
) -> None:
    """Add a node a plant; a mirrored one has a negative scale on its third axis.

    Parameters
    ----------
    properties
        Columns whose first rows are the instances'.
    meshes
        The document's mesh of each model.
    """
    count = len(instances)
    place = y_up(instances.xyz_m)
    half = 0.5 * instances.yaw_rad
    mesh_of = np.zeros(max(meshes, default=0) + 1, np.int64)
    for model, mesh in meshes.items():
        mesh_of[model] = mesh
    scale = instances.scale
    third = np.where(instances.mirror, -scale, scale)
    columns = [
        *place.T.tolist(), np.sin(half).tolist(), np.cos(half).tolist(), scale.tolist(), scale.tolist(), third.tolist(),
        mesh_of[instances.model].tolist(),
    ]  # fmt: skip
    template = ",".join(["{" + TRANSLATION, ROTATION, SCALE, '"mesh":%d'])
    if properties:
        members = ",".join(encode_basestring(name).replace("%", "%%") + ":%s" for name in properties)
        texts = {name: _texts(column, count) for name, column in properties.items()}
        template += f',"name":%s,"extras":{{{members}}}'
        columns += [_names(texts, count), *texts.values()]
    for text in map((template + "}").__mod__, zip(*columns, strict=True)):
        document.add("nodes", text)


def add_plain_points(document: Document, points: Points, properties: Mapping[str, Property]) -> None:
    """Add plants that are points: a node a cell, with their properties as columns in its extras.

    Parameters
    ----------
    properties
        Columns whose last rows are the points'.
    """
    if not len(points):
        return
    cell, centres = cells(points.xyz_m)
    for number, centre in enumerate(centres):
        rows = np.flatnonzero(cell == number)
        primitive = point_primitive(
            document, y_up(points.xyz_m[rows] - centre), points.rgb[rows], feature=None, material=None
        )
        mesh = document.add("meshes", f'{{"name":"plants as points","primitives":[{{{primitive}}}]}}')
        columns = ",".join(
            f"{to_json(name)}:[{','.join(_texts(column.take(rows + len(column.values) - len(points)), len(rows)))}]"
            for name, column in properties.items()
        )
        extras = f'"extras":{{"{PLANTS_MEMBER}":{{{columns}}}}}'
        document.node(f'"mesh":{mesh}', translation(y_up(centre[None, :])[0]), extras)


def _names(texts: Mapping[str, list[str]], count: int) -> list[str]:
    return texts.get("plant_id", ['"plant"'] * count)


def _texts(column: Property, count: int) -> list[str]:
    """Return the JSON text of the first values of a column."""
    values: NDArray[np.generic] = column.values[:count]
    if column.type == "text":
        return list(map(encode_basestring, values.tolist()))
    if column.type == "enum":
        words = [encode_basestring(word) for word in column.names]
        return [words[value] for value in values.tolist()]
    if column.type == "float32":
        texts = list(map("%.7g".__mod__, values.tolist()))
        for row in np.flatnonzero(~np.isfinite(values.astype(np.float64))):
            texts[row] = "null"
        return texts
    return list(map(str, values.tolist()))
