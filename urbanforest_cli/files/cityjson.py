"""CityJSON 2.0: plants as SolitaryVegetationObjects whose shapes are templates stored once, buildings as solids.

Metres, x east, y north, z up and above the ground, vertices in whole millimetres about the scene's origin. The text is
written as it is made and never held whole; each object and each template has a line of its own. A name that ends in
``.jsonl`` gives a CityJSONSeq: the first line holds all that is shared, every further line one feature.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.scenery import Model, Scenery
from urbanforest_cli.files.cityjson_blocks import STEP_M, Block, blocks_of
from urbanforest_cli.files.cityjson_text import (
    DECIMALS,
    PLANT,
    SceneText,
    building_key,
    building_text,
    json_text,
    material_record,
    surfaces_of,
    template_text,
    utf8,
)
from urbanforest_cli.files.text_kernel import decimal_rows

VERSION = "2.0"
OWN = "urbanforest"
CRS_URL = "https://www.opengis.net/def/crs/EPSG/0/"
LOD = re.compile(r"[0-3](\.[0-3])?")
READ_BYTES = 1 << 22


def write_cityjson(
    path: Path,
    scenery: Scenery,
    *,
    lod: str = "2",
    title: str | None = None,
    footprints: NDArray[np.object_] | None = None,
    building_height_m: NDArray[np.float64] | None = None,
    building_id: NDArray[np.object_] | None = None,
) -> None:
    """Publish a scene as CityJSON, or as CityJSONSeq where the name ends in ``.jsonl``.

    A mirrored plant takes a second template whose faces are turned round, so that none shows its inside. Where the
    CRS has no EPSG code there is no `referenceSystem`; its WKT is in the member ``urbanforest`` in any case, beside
    `metadata`, which schema 2.0.0 keeps to the standard's own names.

    Parameters
    ----------
    scenery
        Plants and their shapes; what is fixed is not written.
    lod
        Level of detail of the plants' shapes as CityGML counts it, "0" to "3.3".
    title
        Of the data set.
    footprints, building_height_m, building_id
        (b,) polygons about the scene's origin, heights and ids of buildings.

    Raises
    ------
    OutputError
        It could not be written whole, or plants share a plant_id.
    """
    if not LOD.fullmatch(lod):
        raise ValueError(f"not a level of detail of CityGML: {lod}")
    ids = scenery.properties["plant_id"].values
    if len(set(ids.tolist())) != len(ids):
        raise OutputError(
            "plants share a plant_id, which CityJSON cannot hold", where=path,
            next_step="make the register again with `urbanforest populate`",
        )  # fmt: skip
    blocks = blocks_of(footprints, building_height_m, building_id)
    whole = not path.name.endswith(".jsonl")

    def verify(part: Path) -> None:
        found = _count_plants(part, b"]}\n" if whole else b"}\n")
        if found != len(ids):
            raise OutputError(
                "the CityJSON was not written whole", where=path, found=f"{found} of {len(ids)} plants",
                next_step="check the disk, then run the same command again",
            )  # fmt: skip

    with publish(path, verify=verify) as part, part.open("wb") as stream:
        text = SceneText(scenery, lod, blocks)
        header = _header(scenery, title, text.steps, blocks)
        (_write_whole if whole else _write_sequence)(stream, header, text)


def _write_whole(stream: BinaryIO, header: Mapping[str, Any], text: SceneText) -> None:
    """Write one JSON object: a plant's vertex has the plant's number, those of buildings follow."""
    _write_shared(stream, header, text, b"\n")
    stream.write(b'"CityObjects":{')
    vertices, first = _joined_vertices(text.blocks, len(text.steps))
    separator = "\n"
    for keys, objects in text.plants(numbered=True):
        stream.write(utf8(separator + ",\n".join(map("%s:%s".__mod__, zip(keys, objects, strict=True)))))
        separator = ",\n"
    for number, block in enumerate(text.blocks):
        stream.write(utf8(f"{separator}{building_key(number)}:{building_text(block, first[number])}"))
        separator = ",\n"
    stream.write(b'\n},\n"vertices":[\n')
    rows = decimal_rows(np.concatenate([text.steps, vertices]), 0, ["[", ",", ",", "],\n"])
    stream.write(rows[:-2] + b"\n" if rows else b"")
    stream.write(b"]}\n")


def _write_sequence(stream: BinaryIO, header: Mapping[str, Any], text: SceneText) -> None:
    """Write what is shared in one line, then a line a feature with vertices of its own."""
    _write_shared(stream, header, text, b"")
    stream.write(b'"CityObjects":{},"vertices":[]}\n')
    form = '{"type":"CityJSONFeature","id":%s,"CityObjects":{%s:%s},"vertices":[%s]}\n'
    start = 0
    for keys, objects in text.plants(numbered=False):
        rows = decimal_rows(text.steps[start : start + len(keys)], 0, ["[", ",", ",", "]\n"]).decode().splitlines()
        stream.write(utf8("".join(map(form.__mod__, zip(keys, keys, objects, rows, strict=True)))))
        start += len(keys)
    for number, block in enumerate(text.blocks):
        key = building_key(number)
        own = decimal_rows(block.steps, 0, ["[", ",", ",", "],"]).decode()[:-1]
        stream.write(utf8(form % (key, key, building_text(block, np.arange(len(block.steps))), own)))


def _write_shared(stream: BinaryIO, header: Mapping[str, Any], text: SceneText, new_line: bytes) -> None:
    """Write the header and the templates, each of these once, on a line of its own where lines are wanted."""
    stream.write(utf8(json_text(header)[:-1]) + b"," + new_line)
    if not text.used:
        return
    stream.write(b'"geometry-templates":{"templates":[')
    vertices = io.BytesIO()
    separator, first = b"", 0
    for model, ways in itertools.groupby(text.used, key=lambda used: used[0]):
        steps, triangle, material = surfaces_of(text.scenery.models[model])
        for _, turned in ways:
            corners = first + (triangle[:, ::-1] if turned else triangle)
            stream.write(separator + new_line + template_text(corners, material, text.lod))
            separator = b","
        vertices.write(decimal_rows(steps * STEP_M, DECIMALS, ["[", ",", ",", "]," + new_line.decode()]))
        first += len(steps)
    stream.write(new_line + b'],"vertices-templates":[' + new_line)
    stream.write(vertices.getvalue()[: -1 - len(new_line)] + new_line + b"]}," + new_line)


def _header(scenery: Scenery, title: str | None, steps: NDArray[np.int64], blocks: list[Block]) -> dict[str, Any]:
    origin = scenery.origin
    place = [float(origin.easting_m), float(origin.northing_m), float(origin.height_m)]
    metadata: dict[str, Any] = {"geographicalExtent": _extent(scenery, steps, blocks, place)}
    if title is not None:
        metadata["title"] = title
    code = epsg_code(origin.crs)
    if code is not None:
        metadata["referenceSystem"] = f"{CRS_URL}{code}"
    header: dict[str, Any] = {
        "type": "CityJSON",
        "version": VERSION,
        "transform": {"scale": [STEP_M] * 3, "translate": place},
        "metadata": metadata,
        OWN: {
            "crs_wkt": origin.crs.to_wkt(),
            "axes": "x east, y north, z up, metres; heights are above the ground",
            "provenance": dict(scenery.provenance),
        },
    }
    if scenery.materials and len(scenery.instances):
        header["appearance"] = {"materials": [material_record(item) for item in scenery.materials]}
    return header


def epsg_code(crs: CRS) -> int | None:
    """Return the EPSG code of a CRS, if there is one that says exactly the same."""
    code = crs.to_epsg()
    return code if code is not None and CRS.from_epsg(code).equals(crs, ignore_axis_order=True) else None


def _extent(
    scenery: Scenery, steps: NDArray[np.int64], blocks: list[Block], place: list[float]
) -> list[float]:  # fmt: skip
    """Return the least box that holds every plant whichever way it is turned, and every building."""
    low: list[NDArray[Any]] = [np.zeros((0, 3))]
    high: list[NDArray[Any]] = [np.zeros((0, 3))]
    if len(steps):
        some = scenery.instances
        sizes = np.array([_size(model) for model in scenery.models]).reshape(-1, 3)[some.model] * some.scale[:, None]
        at = steps * STEP_M
        wide, below, above = (np.pad(sizes[:, column], (0, len(at) - len(some))) for column in range(3))
        low.append(at - np.column_stack([wide, wide, below]))
        high.append(at + np.column_stack([wide, wide, above]))
    for block in blocks:
        low.append(block.steps.min(axis=0, keepdims=True) * STEP_M)
        high.append(block.steps.max(axis=0, keepdims=True) * STEP_M)
    lowest, highest = np.concatenate(low), np.concatenate(high)
    if not len(lowest):
        return [*place, *place]
    box = np.concatenate([lowest.min(axis=0) + place, highest.max(axis=0) + place])
    return [float(value) for value in np.round(box, DECIMALS) + 0.0]


def _size(model: Model) -> tuple[float, float, float]:
    """Return how far a model reaches from the vertical through its root, below it and above."""
    xyz = np.concatenate([np.zeros((1, 3)), *(part.mesh.xyz_m for part in model.parts)])
    return float(np.hypot(xyz[:, 0], xyz[:, 1]).max()), float(-xyz[:, 2].min()), float(xyz[:, 2].max())


def _joined_vertices(
    blocks: list[Block], first: int
) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:  # fmt: skip
    """Return (v, 3) corners of all buildings, each once, and their numbers by building, counted from `first`."""
    counts = np.cumsum([0] + [len(block.steps) for block in blocks])
    every = np.concatenate([np.zeros((0, 3), np.int64), *(block.steps for block in blocks)])
    once, place = np.unique(every, axis=0, return_inverse=True)
    numbers = place.reshape(-1) + first
    return once, [numbers[start:stop] for start, stop in itertools.pairwise(counts)]


def _count_plants(path: Path, end: bytes) -> int:
    """Count the plants in a file; -1 where it does not end as it should."""
    mark = PLANT.encode()
    count, tail = 0, b""
    with path.open("rb") as stream:
        while chunk := stream.read(READ_BYTES):
            text = tail + chunk
            count += text.count(mark)
            tail = text[-len(mark) + 1 :]  # enough to find a mark cut in two, too little to hold a whole one
    return count if tail.endswith(end) else -1
