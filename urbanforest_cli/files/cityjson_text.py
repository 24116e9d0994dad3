"""The text of what a CityJSON holds: plants, templates, materials and buildings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from json.encoder import encode_basestring
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Material, Model, Property, Scenery
from urbanforest_cli.files.cityjson_blocks import STEP_M, Block
from urbanforest_cli.files.flat_colours import mean_light, srgb
from urbanforest_cli.files.text_kernel import decimal_rows

THEME = "plants"
DECIMALS, MATRIX_DECIMALS = 3, 6
BUILDING_LOD = "1.2"  # walls that go straight up from the footprint to one height
CHUNK_ROWS = 50_000
STANDARD = {"height": ("height_m", 1.0), "trunkDiameter": ("dbh_m", 1.0), "crownDiameter": ("crown_radius_m", 2.0)}
"""CityGML's own names of attributes, of which column and what multiple of it they are."""
SURFACES = ("GroundSurface", "RoofSurface", "WallSurface")
PLANT = '{"type":"SolitaryVegetationObject","attributes":{'
_INSTANCE = (
    '{"type":"GeometryInstance","template":%d,"boundaries":[%d],"transformationMatrix":'
    "[%s,%s,0,0,%s,%s,0,0,0,0,%s,0,0,0,0,1]}"
)


class SceneText:
    """The text of a scene's plants.

    Parameters
    ----------
    used
        Models that plants show, and whether turned inside out, in the order of the templates.
    steps
        (n, 3) where plants stand, in whole millimetres.
    """

    def __init__(self, scenery: Scenery, lod: str, blocks: list[Block]) -> None:
        self.scenery, self.lod, self.blocks = scenery, lod, blocks
        some = scenery.instances
        codes, template = np.unique(2 * some.model.astype(np.int64) + some.mirror, return_inverse=True)
        self.template = template.reshape(-1)
        self.used = [(int(code) // 2, bool(code % 2)) for code in codes]
        points = np.zeros((0, 3)) if scenery.points is None else scenery.points.xyz_m
        self.steps = np.rint(np.concatenate([some.xyz_m, points]) / STEP_M).astype(np.int64)

    def plants(self, *, numbered: bool) -> Iterator[tuple[list[str], list[str]]]:
        """Yield ids and objects as JSON, some at a time; a plant's vertex has its number, or 0."""
        for start in range(0, len(self.steps), CHUNK_ROWS):
            rows = np.arange(start, min(start + CHUNK_ROWS, len(self.steps)))
            columns = {name: column.take(rows) for name, column in self.scenery.properties.items()}
            keys = _texts(columns.pop("plant_id"))
            shapes = self._shapes(rows, rows if numbered else np.zeros_like(rows))
            form = PLANT + '%s},"geometry":[%s]}'
            yield keys, list(map(form.__mod__, zip(_attributes(columns, len(rows)), shapes, strict=True)))

    def _shapes(self, rows: NDArray[np.int64], vertices: NDArray[np.int64]) -> Iterator[str]:
        inside = rows[rows < len(self.scenery.instances)]
        some = self.scenery.instances.take(inside)
        along, aside = some.scale * np.cos(some.yaw_rad), some.scale * np.sin(some.yaw_rad)
        flip = np.where(some.mirror, -1.0, 1.0)
        matrix = [_numbers(values, MATRIX_DECIMALS)
                  for values in (along, -aside * flip, aside, along * flip, some.scale)]  # fmt: skip
        numbers = (self.template[inside].tolist(), vertices[: len(inside)].tolist())
        yield from map(_INSTANCE.__mod__, zip(*numbers, *matrix, strict=True))
        point = f'{{"type":"MultiPoint","lod":"{self.lod}","boundaries":[%d]}}'
        yield from map(point.__mod__, vertices[len(inside) :].tolist())


def _attributes(columns: Mapping[str, Property], count: int) -> Iterator[str]:
    """Return each plant's attributes as the inside of a JSON object."""
    texts = {name: _texts(column) for name, column in columns.items()}
    for name, (source, factor) in STANDARD.items():
        if source in columns and name not in columns:
            texts[name] = _numbers(factor * columns[source].values.astype(np.float64), DECIMALS)
    form = ",".join(f"{json_text(name)}:".replace("%", "%%") + "%s" for name in texts)
    return map(form.__mod__, zip(*texts.values(), strict=True)) if texts else iter([""] * count)


def _texts(column: Property) -> list[str]:
    if column.type == "text":
        return list(map(encode_basestring, map(str, column.values.tolist())))
    if column.type == "enum":
        names = [encode_basestring(name) for name in column.names]
        return [names[value] for value in column.values.tolist()]
    if column.type == "float32":
        return _numbers(column.values.astype(np.float64), DECIMALS)
    return list(map(str, column.values.tolist()))


def _numbers(values: NDArray[np.float64], decimals: int) -> list[str]:
    texts = list(map(repr, (np.round(values, decimals) + 0.0).tolist()))  # no negative zero
    for row in np.flatnonzero(~np.isfinite(values)):
        texts[row] = "null"
    return texts


def material_record(material: Material) -> dict[str, Any]:
    """Return a material in one colour: CityJSON's textures would need a place on the picture for every corner."""
    light = np.array(material.rgb)
    if material.texture is not None:
        light = light * mean_light(material.texture)
    colour = [round(float(value), DECIMALS) for value in srgb(light)]
    return {"name": material.name, "diffuseColor": colour, "isSmooth": True}


def surfaces_of(model: Model) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return a model's corners in steps, each once, its triangles that enclose anything, and their materials.

    Where nothing encloses anything there is one corner, the root, no material, and a "triangle" of that corner alone.
    """
    steps, triangles, materials = [np.zeros((0, 3), np.int64)], [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    first = 0
    for part in model.parts:
        steps.append(np.rint(part.mesh.xyz_m / np.float64(STEP_M)).astype(np.int64))
        triangles.append(part.mesh.triangle.astype(np.int64) + first)
        materials.append(np.full(len(part.mesh.triangle), part.material, np.int64))
        first += len(part.mesh.xyz_m)
    every = np.concatenate(steps)
    once, place = np.unique(every, axis=0, return_inverse=True)
    triangle = place.reshape(-1)[np.concatenate(triangles)]
    a, b, c = triangle.T
    sound = (a != b) & (b != c) & (c != a)
    if not sound.any():
        return np.zeros((1, 3), np.int64), np.zeros((1, 1), np.int64), np.zeros(0, np.int64)
    used, corner = np.unique(triangle[sound], return_inverse=True)
    return once[used], corner.reshape(-1, 3), np.concatenate(materials)[sound]


def template_text(triangle: NDArray[np.int64], material: NDArray[np.int64], lod: str) -> bytes:
    """Return a template as JSON, its corners by their numbers in the file; a point where it has no surface."""
    if not len(material):
        return json_text({"type": "MultiPoint", "lod": lod, "boundaries": triangle.ravel().tolist()}).encode()
    faces = decimal_rows(triangle, 0, ["[[", ",", ",", "]],"])[:-1]
    head = f'{{"type":"MultiSurface","lod":"{lod}","boundaries":['.encode()
    if (material == material[0]).all():
        value = f'"value":{material[0]}'.encode()
    else:
        value = b'"values":[' + decimal_rows(material[:, None], 0, ["", ","])[:-1] + b"]"
    return head + faces + b'],"material":{"' + THEME.encode() + b'":{' + value + b"}}}"


def building_key(number: int) -> str:
    """Return a key for a building; no plant has it, since theirs end in a dash and a number."""
    return f'"building/{number}"'


def building_text(block: Block, numbers: NDArray[np.int64]) -> str:
    """Return a building as JSON, its vertices by their numbers in the file."""
    surfaces = [[numbers[ring].tolist() for ring in surface] for surface in block.surfaces]
    kinds = block.kinds.tolist()
    geometry = {
        "type": "Solid" if block.is_solid else "MultiSurface",
        "lod": BUILDING_LOD,
        "boundaries": [surfaces] if block.is_solid else surfaces,
        "semantics": {
            "surfaces": [{"type": name} for name in SURFACES],
            "values": [kinds] if block.is_solid else kinds,
        },
    }
    attributes = {"building_id": block.id, "measuredHeight": round(block.height_m, DECIMALS)}
    return json_text({"type": "Building", "attributes": attributes, "geometry": [geometry]})


def json_text(value: object) -> str:
    """Return a value as JSON without spaces."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def utf8(text: str) -> bytes:
    """Return a text as UTF-8, lone surrogates as their escapes in JSON."""
    return text.encode("utf-8", "backslashreplace")
