"""Plants of a glTF that are nothing but points, each tied to its row of the property table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Points
from urbanforest_cli.files.gltf_document import ARRAY_BUFFER, FLOAT, UNSIGNED_SHORT, Document, to_json, y_up
from urbanforest_cli.files.gltf_instances import cells, feature_id
from urbanforest_cli.files.gltf_pack import USHORT_MAX, interleave, translation

MODE_POINTS = 0


def add_points(document: Document, points: Points, first_row: int, *, features: bool) -> None:
    """Add plants that are points: a node a cell, drawn in their own colours whatever the light.

    Parameters
    ----------
    first_row
        Row of the property table of the first.
    features
        Whether there is a property table.
    """
    if not len(points):
        return
    document.use("KHR_materials_unlit")
    if features:
        document.use("EXT_mesh_features")
    unlit = {"name": "plants as points", "extensions": {"KHR_materials_unlit": {}}}
    material = document.add("materials", to_json(unlit))
    cell, centres = cells(points.xyz_m)
    for number, centre in enumerate(centres):
        rows = np.flatnonzero(cell == number)
        primitive = point_primitive(
            document, y_up(points.xyz_m[rows] - centre), points.rgb[rows],
            feature=rows + first_row if features else None, material=material,
        )  # fmt: skip
        mesh = document.add("meshes", f'{{"name":"plants as points","primitives":[{{{primitive}}}]}}')
        document.node(f'"mesh":{mesh}', translation(y_up(centre[None, :])[0]))


def point_primitive(
    document: Document,
    xyz_m: NDArray[np.float64],
    rgb: NDArray[np.uint8],
    *,
    feature: NDArray[np.int64] | None,
    material: int | None,
) -> str:
    """Add points, y up, to a document and return the members of their primitive."""
    fields: dict[str, tuple[NDArray[Any], int, str, bool]] = {
        "POSITION": (xyz_m.astype("<f4"), FLOAT, "VEC3", False),
        "COLOR_0": (linear_rgba(rgb), UNSIGNED_SHORT, "VEC4", True),
    }
    if feature is not None:
        fields["_FEATURE_ID_0"] = (feature.astype("<f4"), FLOAT, "SCALAR", False)
    data, stride, attributes = interleave(fields)
    view = document.view(data, target=ARRAY_BUFFER, stride=stride)
    members = ",".join(f'"{name}":{document.accessor(view, text, start=start)}' for name, start, text in attributes)
    text = f'"attributes":{{{members}}},"mode":{MODE_POINTS}'
    if material is not None:
        text += f',"material":{material}'
    if feature is not None:
        text += f',"extensions":{{"EXT_mesh_features":{{"featureIds":[{feature_id(len(feature))}]}}}}'
    return text


def linear_rgba(rgb: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return (n, 4) opaque colours in linear light, 65535 the brightest, of (n, 3) sRGB."""
    level = np.arange(256) / 255.0
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    table = np.rint(linear * USHORT_MAX).astype("<u2")
    return np.concatenate([table[rgb], np.full((len(rgb), 1), USHORT_MAX, "<u2")], axis=1)
