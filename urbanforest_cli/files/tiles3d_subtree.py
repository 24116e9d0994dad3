"""Subtree files of 3D Tiles 1.1: which tiles of a quadtree are there, as bits, and the box of each."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.words import in_words

MAGIC, VERSION, HEADER = b"subt", 1, struct.Struct("<4sIQQ")
ALIGNMENT = 8
BOX_NUMBERS = 12
BOX_PROPERTY = "bounding_box"
TILE_CLASS = "tile"
FILE_LIMIT_BYTES = 1 << 26


@dataclass(frozen=True)
class Subtree:
    """Part of a quadtree, some levels of it below one tile.

    Parameters
    ----------
    tiles
        (tiles_in(levels),) bool whether each tile is there: by level, then along the Z-order curve. A tile that is
        there has content.
    children
        (4 ** levels,) bool whether a subtree follows below each place of the level after the last.
    boxes_m
        (count of tiles there, 12) float64 centre and half axes of each, in the order of the bits.
    """

    tiles: NDArray[np.bool_]
    children: NDArray[np.bool_]
    boxes_m: NDArray[np.float64]


def tiles_in(levels: int) -> int:
    """Return how many tiles a full quadtree of so many levels has."""
    return int((4**levels - 1) // 3)


def subtree_bytes(subtree: Subtree) -> bytes:
    """Return a subtree as a binary file."""
    blocks: list[bytes] = []
    views: list[dict[str, int]] = []

    def stored(data: bytes) -> int:
        offset = sum(len(block) for block in blocks)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data)})
        blocks.append(data + bytes(-len(data) % ALIGNMENT))
        return len(views) - 1

    def availability(bits: NDArray[np.bool_]) -> dict[str, int]:
        if bits.all() or not bits.any():
            return {"constant": int(bits.all())}
        packed = np.packbits(bits, bitorder="little").tobytes()
        return {"bitstream": stored(packed), "availableCount": int(np.count_nonzero(bits))}

    boxes = stored(np.ascontiguousarray(subtree.boxes_m, dtype="<f8").tobytes())
    tiles = availability(subtree.tiles)
    text: dict[str, Any] = {
        "buffers": [{"byteLength": 0}],
        "bufferViews": views,
        "propertyTables": [
            {"class": TILE_CLASS, "count": len(subtree.boxes_m), "properties": {BOX_PROPERTY: {"values": boxes}}}
        ],
        "tileAvailability": tiles,
        "contentAvailability": [tiles],
        "childSubtreeAvailability": availability(subtree.children),
        "tileMetadata": 0,
    }
    binary = b"".join(blocks)
    text["buffers"] = [{"byteLength": len(binary)}]
    head = json.dumps(text, separators=(",", ":")).encode()
    head += b" " * (-len(head) % ALIGNMENT)
    return HEADER.pack(MAGIC, VERSION, len(head), len(binary)) + head + binary


def read_subtree(path: Path, levels: int) -> Subtree:
    """Read a subtree that `subtree_bytes` wrote.

    Raises
    ------
    InputError
        The file is torn, or says what this program does not write.
    """
    data = _bytes(path)
    if len(data) < HEADER.size:
        raise _broken(path, f"{len(data)} bytes", f"a header of {HEADER.size} bytes")
    magic, version, head_bytes, binary_bytes = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION or HEADER.size + head_bytes + binary_bytes != len(data):
        raise _broken(path, f"{len(data)} bytes", "a subtree of version 1, whole")
    binary = data[HEADER.size + head_bytes :]
    try:
        text = json.loads(data[HEADER.size : HEADER.size + head_bytes])
        tiles = _bits(text, binary, text["tileAvailability"], tiles_in(levels))
        contents = _bits(text, binary, text["contentAvailability"][0], tiles_in(levels))
        children = _bits(text, binary, text["childSubtreeAvailability"], 4**levels)
        table = text["propertyTables"][text["tileMetadata"]]
        boxes = np.frombuffer(_view(text, binary, table["properties"][BOX_PROPERTY]["values"]), dtype="<f8")
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise _broken(path, in_words(error), "availability of tiles and a box for each") from error
    count = int(np.count_nonzero(tiles))
    if boxes.size != count * BOX_NUMBERS or table.get("count") != count or not np.isfinite(boxes).all():
        raise _broken(path, f"{boxes.size} numbers of boxes", f"{BOX_NUMBERS} for each of {count} tiles")
    if (tiles != contents).any():
        raise _broken(path, "tiles without content", "content for every tile")
    return Subtree(tiles, children, boxes.reshape(-1, BOX_NUMBERS))


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > FILE_LIMIT_BYTES:
            raise _broken(path, f"{path.stat().st_size} bytes", f"at most {FILE_LIMIT_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise _broken(path, error.strerror or str(error), "a subtree file") from error


def _bits(text: dict[str, Any], binary: bytes, availability: dict[str, Any], count: int) -> NDArray[np.bool_]:
    if "constant" in availability:
        return np.full(count, _whole(availability["constant"]) == 1)
    packed = np.frombuffer(_view(text, binary, availability["bitstream"]), dtype=np.uint8)
    if len(packed) != (count + 7) // 8:
        raise ValueError(f"{len(packed)} bytes of bits for {count} tiles")
    bits = np.unpackbits(packed, bitorder="little")
    if bits[count:].any() or availability.get("availableCount", int(bits.sum())) != int(bits.sum()):
        raise ValueError("the count of bits is not the count stated")
    return bits[:count].astype(bool)


def _view(text: dict[str, Any], binary: bytes, number: object) -> bytes:
    view = text["bufferViews"][_whole(number)]
    start, length = _whole(view["byteOffset"]), _whole(view["byteLength"])
    if _whole(view["buffer"]) != 0 or start + length > len(binary):
        raise ValueError("a view beyond the file's bytes")
    return binary[start : start + length]


def _whole(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _broken(path: Path, found: str, expected: str) -> InputError:
    return InputError(
        "this subtree file of 3D Tiles is torn or foreign",
        where=path,
        found=found,
        expected=expected,
        next_step="write the tiles again: urbanforest export OUT --to 3dtiles",
    )
