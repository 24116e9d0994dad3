"""Reads back where a CityJSON says that plants stand, line by line where its lines are those of `cityjson.py`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.placed import COLUMNS, PlacedPlants, stated_columns
from urbanforest_cli.files.cityjson import CRS_URL, OWN
from urbanforest_cli.files.words import in_words

FIRST_LINE = '{"type":"CityJSON",'
TEMPLATES, CORNERS, OBJECTS = '"geometry-templates":{"templates":[\n', '],"vertices-templates":[\n', '"CityObjects":{\n'
VERTICES = '"vertices":[\n'
TRANSLATION = (3, 7, 11)  # places in a matrix of 4 x 4, row by row
NUMBERS_A_MATRIX = 16
PLANT = "SolitaryVegetationObject"

_FAULTS = (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError)


@dataclass
class _Found:
    """Plants as they are met: ids, vertex of each, what a matrix adds, heights, other attributes."""

    ids: list[str] = field(default_factory=list)
    vertex: list[int] = field(default_factory=list)
    shift: list[tuple[float, float, float]] = field(default_factory=list)
    height: list[float] = field(default_factory=list)
    attributes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, key: str, item: dict[str, Any], templates: int, offset: int = 0) -> None:
        """Take note of an object, if it is a plant."""
        if item["type"] != PLANT:
            return
        geometry = item["geometry"][0]
        if geometry["type"] not in ("GeometryInstance", "MultiPoint"):
            raise ValueError(f"{key!r} has no place of its own")
        (vertex,) = geometry["boundaries"]
        shift = (0.0, 0.0, 0.0)
        if geometry["type"] == "GeometryInstance":
            if not 0 <= geometry["template"] < templates:
                raise ValueError(f"{key!r} has a template that is not there")
            matrix = geometry["transformationMatrix"]
            if len(matrix) != NUMBERS_A_MATRIX:
                raise ValueError(f"{key!r} has a matrix that is none")
            shift = tuple(float(matrix[place]) for place in TRANSLATION)  # type: ignore[assignment]
        if type(vertex) is not int or vertex < 0:
            raise ValueError(f"{key!r} has no vertex")
        attributes = item.get("attributes", {})
        height = attributes.get("height_m")
        self.ids.append(key)
        self.vertex.append(vertex + offset)
        self.shift.append(shift)
        self.height.append(float("nan") if height is None else float(height))
        self.attributes.append({name: attributes[name] for name in COLUMNS if name in attributes})


def read_plants(path: Path) -> PlacedPlants:
    """Read where a CityJSON or a CityJSONSeq says that plants stand.

    Raises
    ------
    InputError
        It is not there, torn, or no CityJSON whose plants have places.
    """
    found = _Found()
    vertices: list[list[float]] = []
    try:
        with path.open(encoding="utf-8") as stream:
            if path.name.endswith(".jsonl"):
                head = _read_sequence(stream, found, vertices)
            elif stream.readline().startswith(FIRST_LINE):
                stream.seek(0)
                head = _read_lines(stream, found, vertices)
            else:
                stream.seek(0)
                head = _read_whole(stream, found, vertices)
        return _placed(head, found, vertices)
    except OSError as error:
        raise _wrong(path, error.strerror or str(error)) from error
    except CRSError as error:
        raise _wrong(path, f"its CRS: {error}") from error
    except _FAULTS as error:
        raise _wrong(path, in_words(error)) from error


def read_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made a CityJSON from what; None where it does not say.

    Raises
    ------
    InputError
        It is not there, torn, or no CityJSON.
    """
    try:
        with path.open(encoding="utf-8") as stream:
            if path.name.endswith(".jsonl"):
                head = json.loads(stream.readline())
            else:
                line = stream.readline()
                head = _head(line) if _has_lines(line) else json.loads(line + stream.read())
        found = head.get(OWN, {}).get("provenance")
    except OSError as error:
        raise _wrong(path, error.strerror or str(error)) from error
    except _FAULTS as error:
        raise _wrong(path, in_words(error)) from error
    return found if isinstance(found, dict) else None


def _has_lines(line: str) -> bool:
    """Tell whether a first line is one that `cityjson.py` writes."""
    return line.startswith(FIRST_LINE) and line.endswith(",\n")


def _head(line: str) -> dict[str, Any]:
    head: dict[str, Any] = json.loads(line[: -len(",\n")] + "}")
    return head


def _read_lines(stream: TextIO, found: _Found, vertices: list[list[float]]) -> dict[str, Any]:
    """Read a file whose objects have a line each; what is not a plant is read and let go."""
    line = stream.readline()
    if not _has_lines(line):
        stream.seek(0)
        return _read_whole(stream, found, vertices)
    head = _head(line)
    templates = 0
    line = stream.readline()
    if line == TEMPLATES:
        templates = sum(1 for text in _until(stream, CORNERS) if json.loads(text))
        for text in _until(stream, "]},\n"):
            json.loads(text)
        line = stream.readline()
    if line != OBJECTS:
        raise ValueError("no CityObjects where they should be")
    for text in _until(stream, "},\n"):
        ((key, item),) = json.loads("{" + text + "}").items()
        found.add(key, item, templates)
    if stream.readline() != VERTICES:
        raise ValueError("no vertices where they should be")
    vertices.extend(json.loads(text) for text in _until(stream, "]}\n"))
    if stream.read(1):
        raise ValueError("text after the end")
    return head


def _until(stream: TextIO, end: str) -> Iterator[str]:
    """Yield lines without the comma at their end, up to a last one that must come."""
    for line in stream:
        if line == end:
            return
        text = line.rstrip("\n").removesuffix(",")
        if text:
            yield text
    raise ValueError("it ends too early")


def _read_whole(stream: TextIO, found: _Found, vertices: list[list[float]]) -> dict[str, Any]:
    """Read any other CityJSON, all at once."""
    head: dict[str, Any] = json.load(stream)
    if head["type"] != "CityJSON":
        raise ValueError("no CityJSON")
    templates = len(head.get("geometry-templates", {}).get("templates", []))
    for key, item in head["CityObjects"].items():
        found.add(key, item, templates)
    vertices.extend(head["vertices"])
    return head


def _read_sequence(stream: TextIO, found: _Found, vertices: list[list[float]]) -> dict[str, Any]:
    head: dict[str, Any] = json.loads(stream.readline())
    if head["type"] != "CityJSON":
        raise ValueError("no CityJSONSeq")
    templates = len(head.get("geometry-templates", {}).get("templates", []))
    for line in stream:
        if not line.endswith("\n"):
            raise ValueError("it ends too early")
        feature = json.loads(line)
        for key, item in feature["CityObjects"].items():
            if item["type"] == PLANT:
                found.add(key, item, templates, offset=len(vertices))
                vertices.extend(feature["vertices"])
                if found.vertex[-1] >= len(vertices):
                    raise ValueError(f"{key!r} has a vertex that is not there")
    return head


def _placed(head: dict[str, Any], found: _Found, vertices: list[list[float]]) -> PlacedPlants:
    transform = head["transform"]
    scale, translate = (np.array(transform[name], dtype=np.float64).reshape(3) for name in ("scale", "translate"))
    steps = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    if found.vertex and max(found.vertex) >= len(steps):
        raise ValueError("a plant has a vertex that is not there")
    shift = np.array(found.shift, dtype=np.float64).reshape(-1, 3)
    xyz = steps[np.array(found.vertex, dtype=np.int64)] * scale + translate + shift
    if not np.isfinite(xyz).all():
        raise ValueError("places that are no numbers")
    ids = np.array(found.ids, dtype=object)
    height = np.array(found.height, dtype=np.float64)
    names = {name for attributes in found.attributes for name in attributes}
    columns = stated_columns({name: [item.get(name) for item in found.attributes] for name in names})
    return PlacedPlants(ids, xyz, _crs(head), height, columns)


def _crs(head: dict[str, Any]) -> CRS:
    url = head.get("metadata", {}).get("referenceSystem")
    if isinstance(url, str) and url.startswith(CRS_URL):
        return CRS.from_epsg(int(url.removeprefix(CRS_URL)))
    return CRS.from_wkt(head[OWN]["crs_wkt"])


def _wrong(path: Path, found: str) -> InputError:
    return InputError(
        "not a CityJSON of urbanforest, or not a whole one", where=path, found=found,
        next_step="run `urbanforest export` again",
    )  # fmt: skip
