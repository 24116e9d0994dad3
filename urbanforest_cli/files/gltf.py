"""A scene as binary glTF 2.0: models stored once, plants as GPU instances, what is known of each in a property table.

With ``plain`` no extension is used: a node a plant, its properties in the node's ``extras``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.scenery import Instances, Origin, Points, Scenery
from urbanforest_cli.files.gltf_document import Document, to_json, y_up
from urbanforest_cli.files.gltf_instances import add_instances
from urbanforest_cli.files.gltf_metadata import add_property_table
from urbanforest_cli.files.gltf_pack import (
    External,
    MaterialsInUse,
    PackedModels,
    add_part,
    model_bytes,
    pack_mesh,
    pack_models,
    translation,
)
from urbanforest_cli.files.gltf_plain import add_plain_plants, add_plain_points
from urbanforest_cli.files.gltf_points import add_points
from urbanforest_cli.files.gltf_reader import open_gltf, plants_of

__all__ = [
    "External",
    "PackedModels",
    "glb_bytes",
    "model_bytes",
    "pack_models",
    "write_glb",
]

FEATURES_MAX = 1 << 24  # float32 counts no further
DEGREE_DECIMALS = 9
NO_POINTS = Points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
AXES = "x east, y up, z south along the grid: easting = origin + x, northing = origin - z, height = origin + y"


def write_glb(path: Path, scenery: Scenery, *, plain: bool = False) -> None:
    """Publish a scene as a binary glTF; equal scenes are equal bytes.

    Raises
    ------
    OutputError
        See `glb_bytes`; or the file could not be written whole.
    """
    content = glb_bytes(scenery, plain=plain)
    expected = len(scenery.instances) + len(scenery.points or ())

    def verify(part: Path) -> None:
        found = len(plants_of(open_gltf(part)))
        if found != expected:
            raise OutputError("the GLB was not written whole", where=path, found=f"{found} plants", expected=expected)

    with publish(path, verify=verify) as part:
        part.write_bytes(content)


def glb_bytes(
    scenery: Scenery,
    *,
    packed: PackedModels | None = None,
    external: Mapping[int, External] | None = None,
    texture_uris: Mapping[int, str] | None = None,
    extras: Mapping[str, Any] | None = None,
    plain: bool = False,
) -> bytes:
    """Return a scene as a binary glTF.

    Parameters
    ----------
    scenery
        Its instances may use some of the models only; models and materials without use are left out.
    packed
        `pack_models` of the scene's models and materials, when several files share them.
    external
        By place in the models: where bytes lie that are not to be embedded.
    texture_uris
        By place in the materials: a file that holds the texture, which is embedded otherwise.
    extras
        The asset's ``extras``; where None, CRS, origin, axes and provenance of the scene.
    plain
        Without extensions: a node a plant.

    Raises
    ------
    OutputError
        A model or mesh that glTF cannot hold, something above 4 km from its node, a property without a value a
        plant, more than 16.7 million plants, or more than 4 GB.
    """
    if packed is None or packed.quantised == plain:
        packed = pack_models(scenery.models, scenery.materials, quantise=not plain)
    _refuse_unfit(scenery)
    document = Document()
    document.extras = dict(_extras(scenery) if extras is None else extras)
    materials = MaterialsInUse(document, packed, texture_uris or {}, plain=plain)
    meshes = _add_meshes(document, scenery.instances, packed, materials, external or {})
    points = scenery.points or NO_POINTS
    count = len(scenery.instances) + len(points)
    features = bool(scenery.properties) and count > 0
    if plain:
        add_plain_plants(document, scenery.instances, scenery.properties, meshes)
        add_plain_points(document, points, scenery.properties)
    else:
        if features:
            add_property_table(document, scenery.properties, count)
        add_instances(document, scenery.instances, packed, meshes, features=features)
        add_points(document, points, len(scenery.instances), features=features)
    _add_fixed(document, scenery, packed, materials)
    return document.glb()


def _refuse_unfit(scenery: Scenery) -> None:
    instances = scenery.instances
    plants = len(instances) + len(scenery.points or ())
    if plants > FEATURES_MAX:
        raise OutputError(
            "too many plants for one glTF", found=plants, expected=f"at most {FEATURES_MAX}",
            next_step="export a part with --bbox, or 3D Tiles with --to 3dtiles",
        )  # fmt: skip
    finite = all(np.isfinite(values).all() for values in (instances.xyz_m, instances.yaw_rad, instances.scale))
    if scenery.points is not None:
        finite = finite and bool(np.isfinite(scenery.points.xyz_m).all())
    if not finite or (instances.scale <= 0).any():
        raise OutputError("a plant stands nowhere or has no size", found="a place, turn or scale that is no number")
    for name, column in scenery.properties.items():
        if len(column.values) != plants:
            raise OutputError("not one value a plant", where=name, found=len(column.values), expected=plants)
        if column.type == "enum" and plants:
            low, high = int(column.values.min()), int(column.values.max())
            if low < 0 or high >= len(column.names):
                raise OutputError("a value is none of its enum's", where=name, found=low if low < 0 else high)


def _extras(scenery: Scenery) -> dict[str, object]:
    origin = scenery.origin
    authority = origin.crs.to_authority()
    return {
        "crs": {"authority": None if authority is None else ":".join(authority), "wkt": origin.crs.to_wkt()},
        "origin": _place(origin),
        "axes": AXES,
        "unit": "metre",
        "provenance": dict(scenery.provenance),
    }


def _place(origin: Origin) -> dict[str, float]:
    change = transformer(origin.crs.to_wkt(), CRS.from_epsg(4326).to_wkt())
    longitude, latitude = change.transform(origin.easting_m, origin.northing_m)
    return {
        "easting_m": float(origin.easting_m),
        "northing_m": float(origin.northing_m),
        "height_m": float(origin.height_m),
        "longitude": round(float(longitude), DEGREE_DECIMALS),
        "latitude": round(float(latitude), DEGREE_DECIMALS),
    }


def _add_meshes(
    document: Document,
    instances: Instances,
    packed: PackedModels,
    materials: MaterialsInUse,
    external: Mapping[int, External],
) -> dict[int, int]:
    meshes = {}
    for number in np.unique(instances.model).tolist():
        model = packed.models[number]
        if number in external:
            where = external[number]
            buffer, start = document.external(where.uri, where.file_bytes), where.byte_offset
        else:
            buffer, start = 0, document.append(model.data)
        primitives = [
            add_part(document, part, buffer=buffer, start=start, material=materials.number(part.material))
            for part in model.parts
        ]
        meshes[number] = document.add(
            "meshes", f'{{"name":{to_json(model.name)},"primitives":[{",".join(primitives)}]}}'
        )
    if meshes and packed.quantised:
        document.use("KHR_mesh_quantization", required=True)
    return meshes


def _add_fixed(document: Document, scenery: Scenery, packed: PackedModels, materials: MaterialsInUse) -> None:
    for thing in scenery.fixed:
        if not len(thing.mesh.triangle):
            continue
        data, part = pack_mesh(
            thing.mesh, thing.name, thing.material,
            textured=packed.materials[thing.material].texture is not None,
            scale_m=None, small_normals=packed.quantised,
        )  # fmt: skip
        if packed.quantised:
            document.use("KHR_mesh_quantization", required=True)
        primitive = add_part(
            document, part, buffer=0, start=document.append(data), material=materials.number(thing.material)
        )
        name = f'"name":{to_json(thing.name)}'
        mesh = document.add("meshes", f'{{{name},"primitives":[{primitive}]}}')
        centre = y_up(np.array([thing.centre_m], np.float64))[0]
        document.node(name, f'"mesh":{mesh}', translation(centre))
