"""Plants of a glTF as GPU instances: a node a model and side of the mirror, and their rows of the property table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.scenery import Instances
from urbanforest_cli.files.gltf_document import (
    FLOAT,
    NODE_REACH_M,
    SHORT,
    UNSIGNED_SHORT,
    Document,
    accessor_text,
    numbers,
    y_up,
)
from urbanforest_cli.files.gltf_pack import SHORT_MAX, USHORT_MAX, PackedModels, translation

CELL_M = 2000.0
"""Side of the squares whose plants share nodes, in a scene that reaches beyond `NODE_REACH_M`."""


def cells(xyz: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return (n,) the cell of each place and (c, 3) the cells' centres: one at the origin where all lie near it."""
    if not len(xyz) or float(np.abs(xyz).max()) <= NODE_REACH_M:
        return np.zeros(len(xyz), np.int64), np.zeros((1, 3))
    if float(np.abs(xyz[:, 2]).max()) > NODE_REACH_M:
        raise OutputError(
            "a plant stands too far above or below the scene's origin",
            found=f"{float(np.abs(xyz[:, 2]).max()):.0f} m",
            expected=f"at most {NODE_REACH_M:.0f} m",
        )
    squares, cell = np.unique(np.rint(xyz[:, :2] / CELL_M), axis=0, return_inverse=True)
    centres = np.concatenate([squares * CELL_M, np.zeros((len(squares), 1))], axis=1)
    return cell.reshape(-1).astype(np.int64), centres


def add_instances(
    document: Document, instances: Instances, packed: PackedModels, meshes: Mapping[int, int], *, features: bool
) -> None:
    """Add a node for each cell, model and side of the mirror.

    A node scales its model's corners to metres by s, so that its instances' places are divided by s. A mirrored
    plant is first mirrored along the third axis (M), then turned. Its node scales by (s, s, -s), which is s M, and
    since R(yaw) M = M R(-yaw), its instance turns the other way round and lies at the mirrored place. So no instance
    has a negative scale, which renderers would draw inside out.
    """
    if not len(instances):
        return
    document.use("EXT_mesh_gpu_instancing", required=True)
    if features:
        document.use("EXT_instance_features")
    cell, centres = cells(instances.xyz_m)
    group = (cell * len(packed.models) + instances.model) * 2 + instances.mirror
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    ends = np.append(starts[1:], len(order))
    scale_m = np.array([model.scale_m for model in packed.models])[instances.model[order]]
    side = np.where(instances.mirror[order], -1.0, 1.0)
    place = y_up(instances.xyz_m[order] - centres[cell[order]]) / scale_m[:, None]
    place[:, 2] *= side
    half = 0.5 * side * instances.yaw_rad[order]
    turn = np.zeros((len(order), 4))
    turn[:, 1], turn[:, 3] = np.sin(half), np.cos(half)
    turned = np.abs(turn[:, 1]) > 0.5 / SHORT_MAX
    id_type, id_component = ("<u2", UNSIGNED_SHORT) if len(order) <= USHORT_MAX + 1 else ("<f4", FLOAT)
    rows = {
        "TRANSLATION": (place.astype("<f4"), accessor_parts(FLOAT, "VEC3")),
        "ROTATION": (np.rint(turn * SHORT_MAX).astype("<i2"), accessor_parts(SHORT, "VEC4", normalised=True)),
        "SCALE": (np.repeat(instances.scale[order].astype("<f4")[:, None], 3, axis=1), accessor_parts(FLOAT, "VEC3")),
        "_FEATURE_ID_0": (order.astype(id_type), accessor_parts(id_component, "SCALAR")),
    }
    resized = rows["SCALE"][0][:, 0] != 1.0
    left_out = {"ROTATION": ~np.logical_or.reduceat(turned, starts), "SCALE": ~np.logical_or.reduceat(resized, starts)}
    firsts = order[starts]
    for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        first = int(firsts[number])
        data: list[bytes] = []
        attributes: list[tuple[str, int, str]] = []
        length = 0
        for name, (values, (before, after)) in rows.items():
            if (name in left_out and left_out[name][number]) or (name == "_FEATURE_ID_0" and not features):
                continue
            data.append(values[start:end].tobytes())
            attributes.append((name, length, f"{before}{end - start}{after}"))
            length += len(data[-1])
        view = document.view(b"".join(data))
        members = ",".join(
            f'"{name}":{document.accessor(view, text, start=offset)}' for name, offset, text in attributes
        )
        model = int(instances.model[first])
        size = packed.models[model].scale_m
        extensions = f'"EXT_mesh_gpu_instancing":{{"attributes":{{{members}}}}}'
        if features:
            extensions += f',"EXT_instance_features":{{"featureIds":[{feature_id(end - start)}]}}'
        document.node(
            f'"mesh":{meshes[model]}',
            translation(y_up(centres[cell[first]][None, :])[0]),
            f'"scale":{numbers((size, size, -size if instances.mirror[first] else size))}',
            f'"extensions":{{{extensions}}}',
        )


def accessor_parts(component: int, kind: str, *, normalised: bool = False) -> tuple[str, str]:
    """Return what stands before and after an accessor's count."""
    before, _, after = accessor_text(component, kind, 0, normalised=normalised).partition('"count":0')
    return before + '"count":', after


def feature_id(count: int) -> str:
    """Return the JSON that ties `count` things to rows of the property table."""
    return f'{{"featureCount":{count},"attribute":0,"propertyTable":0}}'
