"""Models packed for glTF: corners quantised and interleaved once, to be used by any number of files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.scenery import Material, Mesh, Model
from urbanforest_cli.files.gltf_document import (
    ARRAY_BUFFER,
    BYTE,
    ELEMENT_ARRAY_BUFFER,
    FLOAT,
    NODE_REACH_M,
    SHORT,
    UNSIGNED_BYTE,
    UNSIGNED_INT,
    UNSIGNED_SHORT,
    Document,
    accessor_text,
    numbers,
    to_json,
    y_up,
)

SHORT_MAX = np.iinfo(np.int16).max
BYTE_MAX = np.iinfo(np.int8).max
USHORT_MAX = np.iinfo(np.uint16).max
WHITE = 255
NORMAL_TOLERANCE = 1e-3
LINEAR, LINEAR_MIPMAP_LINEAR = 9729, 9987
CLAMP_TO_EDGE, REPEAT = 33071, 10497


@dataclass(frozen=True)
class PackedPart:
    """A primitive: where its corners and indices lie in its model's bytes, and what its accessors say.

    Parameters
    ----------
    corners, indices
        First byte and count of bytes.
    stride
        Bytes a corner.
    attributes
        Semantic, offset within a corner and text of the accessor.
    index_text
        Text of the indices' accessor.
    material
        Place in the scene's materials.
    """

    corners: tuple[int, int]
    stride: int
    attributes: tuple[tuple[str, int, str], ...]
    indices: tuple[int, int]
    index_text: str
    material: int


@dataclass(frozen=True)
class PackedModel:
    """A model: `data` holds its parts; corners times `scale_m` are metres, y up."""

    name: str
    data: bytes
    parts: tuple[PackedPart, ...]
    scale_m: float


@dataclass(frozen=True)
class PackedModels:
    """Models and the materials they are made of, ready for any number of files.

    Parameters
    ----------
    clamped
        A material's place for every one whose texture is not repeated.
    quantised
        Whether corners are integers, which needs KHR_mesh_quantization.
    """

    models: tuple[PackedModel, ...]
    materials: tuple[Material, ...]
    clamped: frozenset[int]
    quantised: bool


@dataclass(frozen=True)
class External:
    """Where a model's bytes lie outside a file: `model_bytes` of it at `byte_offset` (a multiple of 4) of `uri`."""

    uri: str
    byte_offset: int
    file_bytes: int


def pack_models(models: Sequence[Model], materials: Sequence[Material], *, quantise: bool = True) -> PackedModels:
    """Pack models once, to be handed to any number of `glb_bytes`.

    Quantised, a corner's place is 16 bits an axis of the model's largest extent in whole metres (a 30 m tree: 0.5 mm),
    its normal 8 bits an axis, its place on the texture 16 bits where no corner of the part lies beyond 0 to 1.
    Otherwise all are float32.

    Raises
    ------
    OutputError
        A model has no triangle, or numbers that no file can hold.
    """
    packed = tuple(_pack_model(model, materials, quantise=quantise) for model in models)
    repeated = {part.material for model in models for part in model.parts if not _within_texture(part.mesh)}
    cut_out = {number for number, material in enumerate(materials) if material.alpha_cutoff is not None}
    return PackedModels(packed, tuple(materials), frozenset(cut_out - repeated), quantise)


def model_bytes(packed: PackedModels, number: int) -> bytes:
    """Return the bytes of a model that `External` places; their length is a multiple of 4."""
    return packed.models[number].data


def _within_texture(mesh: Mesh) -> bool:
    return not len(mesh.uv) or bool(mesh.uv.min() >= 0.0 and mesh.uv.max() <= 1.0)


def _pack_model(model: Model, materials: Sequence[Material], *, quantise: bool) -> PackedModel:
    parts = [part for part in model.parts if len(part.mesh.triangle)]
    if not parts:
        raise OutputError("a model has nothing to draw", where=model.name, next_step="draw its plants as points")
    reach = max(float(np.abs(part.mesh.xyz_m).max()) for part in parts)
    scale = float(max(1.0, np.ceil(reach))) if quantise else 1.0
    chunks: list[bytes] = []
    packed, length = [], 0
    for part in parts:
        chunk, record = pack_mesh(
            part.mesh, model.name, part.material, textured=materials[part.material].texture is not None,
            scale_m=scale if quantise else None, small_normals=quantise, start=length,
        )  # fmt: skip
        chunks.append(chunk)
        packed.append(record)
        length += len(chunk)
    return PackedModel(model.name, b"".join(chunks), tuple(packed), scale)


def pack_mesh(
    mesh: Mesh,
    name: str,
    material: int,
    *,
    textured: bool,
    scale_m: float | None,
    small_normals: bool,
    start: int = 0,
) -> tuple[bytes, PackedPart]:
    """Return a mesh's corners and indices as bytes, and where they will lie when these begin at `start`.

    Parameters
    ----------
    scale_m
        What 16 bits stand for; None keeps metres as float32.
    small_normals
        8 bits an axis instead of float32.
    """
    _refuse_unfit(mesh, name)
    fields: dict[str, tuple[NDArray[Any], int, str, bool]] = {}
    place = y_up(mesh.xyz_m)
    if scale_m is None:
        fields["POSITION"] = (place.astype("<f4"), FLOAT, "VEC3", False)
    else:
        fields["POSITION"] = (np.rint(place * (SHORT_MAX / scale_m)).astype("<i2"), SHORT, "VEC3", True)
    normal = y_up(mesh.normal)
    if small_normals:
        fields["NORMAL"] = (np.rint(normal * BYTE_MAX).astype("i1"), BYTE, "VEC3", True)
    else:
        fields["NORMAL"] = (normal.astype("<f4"), FLOAT, "VEC3", False)
    if textured:
        if scale_m is not None and _within_texture(mesh):
            fields["TEXCOORD_0"] = (np.rint(mesh.uv * USHORT_MAX).astype("<u2"), UNSIGNED_SHORT, "VEC2", True)
        else:
            fields["TEXCOORD_0"] = (mesh.uv.astype("<f4"), FLOAT, "VEC2", False)
    if (mesh.tint != WHITE).any():
        opaque = np.full((len(mesh.tint), 1), WHITE, np.uint8)
        fields["COLOR_0"] = (np.concatenate([mesh.tint, opaque], axis=1), UNSIGNED_BYTE, "VEC4", True)
    corners, stride, attributes = interleave(fields)
    index_type = "<u2" if len(place) <= USHORT_MAX else "<u4"
    indices = mesh.triangle.astype(index_type).tobytes()
    index_text = accessor_text(
        UNSIGNED_SHORT if index_type == "<u2" else UNSIGNED_INT, "SCALAR", int(mesh.triangle.size)
    )
    record = PackedPart(
        (start, len(corners)), stride, attributes, (start + len(corners), len(indices)), index_text, material
    )
    return corners + indices + bytes(-len(indices) % 4), record


def interleave(
    fields: Mapping[str, tuple[NDArray[Any], int, str, bool]],
) -> tuple[bytes, int, tuple[tuple[str, int, str], ...]]:
    """Lay columns side by side, each on 4 bytes: values, component type, accessor type, whether normalised.

    Returns
    -------
    Bytes, bytes a row, and semantic, offset and accessor's text of each.
    """
    offset = 0
    formats, offsets = [], []
    for values, *_ in fields.values():
        width = values.shape[1] if values.ndim > 1 else 1
        formats.append((values.dtype, (width,)))
        offsets.append(offset)
        offset += -(-values.dtype.itemsize * width // 4) * 4
    count = len(next(iter(fields.values()))[0])
    layout: Any = {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": offset}
    rows = np.zeros(count, np.dtype(layout))
    attributes = []
    for (name, (values, component, kind, normalised)), start in zip(fields.items(), offsets, strict=True):
        rows[name] = values.reshape(count, -1)
        ends = (values.min(axis=0), values.max(axis=0)) if name == "POSITION" else (None, None)
        text = accessor_text(component, kind, count, normalised=normalised, low=ends[0], high=ends[1])
        attributes.append((name, start, text))
    return rows.tobytes(), offset, tuple(attributes)


def _refuse_unfit(mesh: Mesh, name: str) -> None:
    lengths = np.linalg.norm(mesh.normal, axis=1)
    faults = {
        "a number that is not finite": not (np.isfinite(mesh.xyz_m).all() and np.isfinite(mesh.uv).all()),
        "a normal that is not of length 1": not (np.abs(lengths - 1.0) <= NORMAL_TOLERANCE).all(),
        "a corner that is not there": int(mesh.triangle.max()) >= len(mesh.xyz_m),
    }
    if any(faults.values()):
        raise OutputError(
            "a mesh is broken", where=name, found=", ".join(text for text, is_so in faults.items() if is_so)
        )
    reach = float(np.abs(mesh.xyz_m).max())
    if reach > NODE_REACH_M:
        raise OutputError(
            "a mesh reaches too far from its own origin",
            where=name,
            found=f"{reach:.0f} m",
            expected=f"at most {NODE_REACH_M:.0f} m, so that float32 places it to a millimetre",
            next_step="cut it into pieces",
        )


def add_part(document: Document, part: PackedPart, *, buffer: int, start: int, material: int) -> str:
    """Add a part whose model's bytes begin at `start` of a buffer, and return the JSON of its primitive."""
    corners = document.view_at(
        buffer, start + part.corners[0], part.corners[1], target=ARRAY_BUFFER, stride=part.stride
    )
    indices = document.view_at(buffer, start + part.indices[0], part.indices[1], target=ELEMENT_ARRAY_BUFFER)
    attributes = ",".join(
        f'"{semantic}":{document.accessor(corners, text, start=offset)}' for semantic, offset, text in part.attributes
    )
    number = document.accessor(indices, part.index_text)
    return f'{{"attributes":{{{attributes}}},"indices":{number},"material":{material}}}'


class MaterialsInUse:
    """Adds a scene's materials to a document when they are first asked for."""

    def __init__(
        self, document: Document, packed: PackedModels, texture_uris: Mapping[int, str], *, plain: bool
    ) -> None:
        self._document = document
        self._packed = packed
        self._uris = texture_uris
        self._plain = plain
        self._numbers: dict[int, int] = {}
        self._images: dict[bytes | str, int] = {}
        self._samplers: dict[int, int] = {}
        self._textures: dict[tuple[int, int], int] = {}

    def number(self, place: int) -> int:
        """Return the number in the document of the scene's material at a place."""
        if place not in self._numbers:
            material = self._packed.materials[place]
            surface: dict[str, object] = {"baseColorFactor": [*map(float, material.rgb), 1.0]}
            if material.texture is not None:
                surface["baseColorTexture"] = {"index": self._texture(place, material.texture)}
            surface |= {"metallicFactor": 0.0, "roughnessFactor": float(material.roughness)}
            entry: dict[str, object] = {"name": material.name, "pbrMetallicRoughness": surface}
            if material.alpha_cutoff is not None:
                entry |= {"alphaMode": "MASK", "alphaCutoff": float(material.alpha_cutoff)}
            if material.two_sided:
                entry["doubleSided"] = True
            if material.unlit and not self._plain:
                self._document.use("KHR_materials_unlit")
                entry["extensions"] = {"KHR_materials_unlit": {}}
            self._numbers[place] = self._document.add("materials", to_json(entry))
        return self._numbers[place]

    def _texture(self, place: int, png: bytes) -> int:
        key = self._uris.get(place, png)
        if key not in self._images:
            if isinstance(key, str):
                image = f'{{"uri":{to_json(key)}}}'
            else:
                image = f'{{"bufferView":{self._document.view(key)},"mimeType":"image/png"}}'
            self._images[key] = self._document.add("images", image)
        wrap = CLAMP_TO_EDGE if place in self._packed.clamped else REPEAT
        if wrap not in self._samplers:
            filters = f'"magFilter":{LINEAR},"minFilter":{LINEAR_MIPMAP_LINEAR}'
            self._samplers[wrap] = self._document.add("samplers", f'{{{filters},"wrapS":{wrap},"wrapT":{wrap}}}')
        pair = (self._images[key], self._samplers[wrap])
        if pair not in self._textures:
            self._textures[pair] = self._document.add("textures", f'{{"source":{pair[0]},"sampler":{pair[1]}}}')
        return self._textures[pair]


def translation(xyz: Sequence[float] | NDArray[np.float64]) -> str:
    """Return a node's member that moves it; empty where it does not."""
    return f'"translation":{numbers(xyz)}' if any(xyz) else ""
