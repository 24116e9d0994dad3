"""Whether a JSON file is GeoJSON: the readers below accept much that is not, and drop it without a word.

The file is walked one feature at a time, so that memory stays near the size of its text.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices

TEXT_LIMIT_BYTES = 2 * 2**30
FAULTS_SHOWN = 5
BBOX_TOLERANCE = 1e-4

# How many lists lie around a position of each type.
DEPTHS = {"Point": 0, "MultiPoint": 1, "LineString": 1, "Polygon": 2, "MultiLineString": 2, "MultiPolygon": 3}
_CURVES = {"LineString", "CircularString", "CompoundCurve"}
# JSON-FG: types made of other geometries, and which.
_CHILDREN = {
    "CompoundCurve": {"LineString", "CircularString"},
    "CurvePolygon": _CURVES,
    "MultiCurve": _CURVES,
    "MultiSurface": {"Polygon", "CurvePolygon"},
}
_BLANK = re.compile(r"[ \t\r\n]*")
_FINER_THAN_HELD = re.compile(r"\.\d{12}")


class _Fault(ValueError):
    """What a file breaks, in words."""


@dataclass
class _Walk:
    """What was seen on the way through a file."""

    faults: list[str] = field(default_factory=list)
    fault_count: int = 0
    crs_stated: bool = False
    is_json_fg: bool = False
    heights: int = 0
    measures: int = 0
    wrong_boxes: int = 0
    too_fine: int = 0
    single_part: int = 0

    def blame(self, where: str, fault: object) -> None:
        self.fault_count += 1
        if len(self.faults) < FAULTS_SHOWN:
            self.faults.append(f"{where}: {fault}")


def check_geojson(path: Path, notices: Notices, *, assumed: bool = False) -> bool:
    """Check that a file is GeoJSON (RFC 7946) or JSON-FG from its first to its last feature.

    Oddities that do no harm are counted as notices: a ``crs`` member, a ``bbox`` that contradicts the coordinates,
    third and fourth coordinates.

    Parameters
    ----------
    assumed
        The caller knows the CRS, so the file need not say it.

    Returns
    -------
    Whether the file is JSON-FG.

    Raises
    ------
    InputError
        Not JSON, not GeoJSON, or a member that would make a reader fetch something; the first faults are listed.
    CrsError
        A JSON-FG file that names no CRS.
    """
    if path.stat().st_size > TEXT_LIMIT_BYTES:
        raise LimitError(
            "the file is too long for GeoJSON",
            where=path,
            found=f"{path.stat().st_size / 2**30:.1f} GiB",
            expected=f"at most {TEXT_LIMIT_BYTES / 2**30:.0f} GiB",
            next_step="convert it to GeoPackage: ogr2ogr OUT.gpkg IN.geojson",
        )
    # Bytes that are not UTF-8 are let through here and counted where the text they stand in is read.
    text = path.read_bytes().removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="surrogateescape")
    walk = _Walk()
    try:
        _walk_document(text, walk)
    except RecursionError:
        walk.blame("file", "nested too deeply")
    except ValueError as fault:  # JSONDecodeError is one
        walk.blame("file", fault)
    if walk.faults:
        more = walk.fault_count - len(walk.faults)
        raise InputError(
            "not GeoJSON",
            where=path,
            found="; ".join(walk.faults) + (f"; and {more} more" if more else ""),
            expected="a FeatureCollection, Feature or geometry of RFC 7946",
            next_step="repair it, or convert the source again with ogr2ogr",
        )
    if walk.is_json_fg and not walk.crs_stated and not assumed:
        raise CrsError(
            "JSON-FG without a coordinate reference system",
            where=path,
            expected="a member 'coordRefSys'",
            next_step="give it with --assume-crs EPSG:...",
        )
    _count(walk, notices, path)
    return walk.is_json_fg


def _count(walk: _Walk, notices: Notices, path: Path) -> None:
    name = path.name
    if walk.crs_stated and not walk.is_json_fg:
        notices.add("W_CRS_MEMBER", "files with a 'crs' member, which GeoJSON no longer has; it was obeyed", 1, [name])
    notices.add("W_BBOX", "features whose 'bbox' contradicts their coordinates, ignored", walk.wrong_boxes, [name])
    notices.add("W_HEIGHT", "features with a third coordinate, which was dropped", walk.heights, [name])
    notices.add("W_MEASURE", "features with more than three coordinates a position, two kept", walk.measures, [name])
    notices.add("W_PRECISION", "features written with more decimals than a coordinate holds", walk.too_fine, [name])
    notices.add("W_SINGLE_PART", "multi-part features of a single part, taken as simple ones", walk.single_part, [name])


class _Scanner:
    """A place in a JSON text; values are decoded one by one, so that a list of features is never held whole."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.place = 0
        self.decoder = json.JSONDecoder()

    def peek(self) -> str:
        """Return the next character that is not blank, or an empty text at the end."""
        match = _BLANK.match(self.text, self.place)
        self.place = match.end() if match else self.place
        return self.text[self.place : self.place + 1]

    def expect(self, *characters: str) -> str:
        """Step over the next character, which must be one of these."""
        found = self.peek()
        if found not in characters or not found:
            wanted = " or ".join(repr(character) for character in characters)
            raise _Fault(f"{wanted} expected at character {self.place}, found {found or 'the end'!r}")
        self.place += 1
        return found

    def value(self) -> Any:
        """Decode one value."""
        self.peek()
        value, self.place = self.decoder.raw_decode(self.text, self.place)
        return value

    def elements(self, closing: str) -> Iterator[int]:
        """Step through a list or object whose opening bracket is behind, stopping before each element."""
        if self.peek() == closing:
            self.place += 1
            return
        number = 0
        while True:
            yield number
            number += 1
            if self.expect(",", closing) == closing:
                return


def _walk_document(text: str, walk: _Walk) -> None:
    scanner = _Scanner(text)
    scanner.expect("{")
    members: dict[str, Any] = {}
    for _ in scanner.elements("}"):
        key = scanner.value()
        if not isinstance(key, str):
            raise _Fault(f"a name expected before character {scanner.place}")
        scanner.expect(":")
        if key == "features" and scanner.peek() == "[":
            members[key] = _walk_features(scanner, walk)
        else:
            members[key] = scanner.value()
    if scanner.peek():
        raise _Fault(f"more text after the end of the object, at character {scanner.place}")
    _check_crs(members, walk)
    kind = members.get("type")
    if kind == "FeatureCollection":
        if not isinstance(members.get("features"), int):
            raise _Fault("a FeatureCollection needs a list 'features'")
        _check_bbox(members.get("bbox"), None, walk)
    elif kind == "Feature":
        _check_feature(members, walk)
    else:
        _check_shape(members, walk)


def _walk_features(scanner: _Scanner, walk: _Walk) -> int:
    """Check every feature of the list that begins here; returns how many there are."""
    scanner.expect("[")
    count = 0
    for number in scanner.elements("]"):
        count += 1
        scanner.peek()
        start = scanner.place
        feature = scanner.value()
        try:
            if not isinstance(feature, dict) or feature.get("type") != "Feature":
                raise _Fault("not a Feature")
            _check_feature(feature, walk)
        except _Fault as fault:
            walk.blame(f"feature {number}", fault)
        walk.too_fine += _FINER_THAN_HELD.search(scanner.text, start, scanner.place) is not None
    return count


def _check_feature(feature: dict[str, Any], walk: _Walk) -> None:
    identity = feature.get("id")
    if isinstance(identity, (dict, list, bool)):
        raise _Fault("'id' is neither a text nor a number")
    if not isinstance(feature.get("properties"), (dict, type(None))):
        raise _Fault("'properties' is not an object")
    _check_crs(feature, walk)
    shape = feature.get("geometry")
    if "geometry" not in feature and "place" not in feature:
        raise _Fault("no member 'geometry'")
    if feature.get("place") is not None:
        walk.is_json_fg = True
        _check_crs(feature["place"], walk)
        _check_shape(feature["place"], walk)
    if shape is not None:
        extent = _check_shape(shape, walk)
        _check_bbox(feature.get("bbox"), extent, walk)


@dataclass
class _Extent:
    """Least and greatest x and y, and how many coordinates a position has at most."""

    west: float = math.inf
    south: float = math.inf
    east: float = -math.inf
    north: float = -math.inf
    dimensions: int = 2

    def take(self, position: list[Any]) -> None:
        x, y = position[0], position[1]
        self.west, self.east = min(self.west, x), max(self.east, x)
        self.south, self.north = min(self.south, y), max(self.north, y)
        self.dimensions = max(self.dimensions, len(position))


def _check_shape(shape: Any, walk: _Walk) -> _Extent:
    extent = _Extent()
    _grow_extent(shape, extent, walk)
    if isinstance(shape, dict):
        _check_bbox(shape.get("bbox"), extent, walk)
    walk.heights += extent.dimensions == 3
    walk.measures += extent.dimensions > 3
    return extent


def _grow_extent(shape: Any, extent: _Extent, walk: _Walk, allowed: set[str] | None = None) -> None:
    if not isinstance(shape, dict):
        raise _Fault("a geometry is not an object")
    kind = shape.get("type")
    if not isinstance(kind, str):
        raise _Fault("no member 'type'")
    if allowed is not None and kind not in allowed:
        raise _Fault(f"{kind!r} stands where {' or '.join(sorted(allowed))} belongs")
    if kind == "GeometryCollection" or kind in _CHILDREN:
        children = shape.get("geometries")
        if not isinstance(children, list):
            raise _Fault(f"{kind} needs a list 'geometries'")
        for child in children:
            _grow_extent(child, extent, walk, _CHILDREN.get(kind))
        return
    if kind not in DEPTHS and kind != "CircularString":
        raise _Fault(f"type {kind!r} is unknown")
    if not isinstance(shape.get("coordinates"), list):
        raise _Fault(f"{kind} needs a list 'coordinates'")
    depth = DEPTHS.get(kind, 1)
    walk.single_part += kind in ("MultiPolygon", "MultiLineString") and len(shape["coordinates"]) == 1
    _check_positions(shape["coordinates"], depth, extent, kind)


def _check_positions(value: Any, depth: int, extent: _Extent, kind: str) -> None:
    if not isinstance(value, list):
        raise _Fault(f"{kind}: too few brackets around its coordinates")
    if depth > 0:
        for inner in value:
            _check_positions(inner, depth - 1, extent, kind)
        return
    if not value and kind == "Point":
        return  # an empty point
    if len(value) < 2:
        raise _Fault(f"{kind}: a position of {len(value)} numbers")
    for number in value:
        if type(number) is not float and type(number) is not int:
            reason = "too many brackets around its coordinates" if isinstance(number, list) else "not a number"
            raise _Fault(f"{kind}: {reason}: {json.dumps(number)[:40]}")
    extent.take(value)


def _check_bbox(bbox: Any, extent: _Extent | None, walk: _Walk) -> None:
    if bbox is None:
        return
    if not isinstance(bbox, list) or len(bbox) < 4 or len(bbox) % 2:
        raise _Fault("'bbox' is not a list of four or six numbers")
    if any(type(number) is not float and type(number) is not int for number in bbox):
        raise _Fault("'bbox' holds something that is no number")
    if extent is None or not extent.west <= extent.east:
        return
    half = len(bbox) // 2
    pairs = zip(
        (extent.west, extent.south, extent.east, extent.north), (*bbox[:2], *bbox[half : half + 2]), strict=True
    )
    size = max(extent.east - extent.west, extent.north - extent.south, 1.0)
    walk.wrong_boxes += any(abs(true - stated) > BBOX_TOLERANCE * size for true, stated in pairs)


def _check_crs(members: Any, walk: _Walk) -> None:
    if not isinstance(members, dict):
        return
    if "coordRefSys" in members:
        walk.is_json_fg = walk.crs_stated = True
    if "conformsTo" in members:
        walk.is_json_fg = True
    crs = members.get("crs")
    if crs is None:
        return
    if not isinstance(crs, dict) or crs.get("type") not in ("name", "EPSG"):
        raise _Fault("'crs' does not name a CRS (links are not followed)")
    walk.crs_stated = True
