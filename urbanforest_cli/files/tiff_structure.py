"""The tags of a TIFF's first image, read without any TIFF library, and what they contradict.

A library reads a cut-off file until it comes to the missing end, fills holes with zeros without a word, and believes
numbers that make it ask for gigabytes. Here a file is held against itself before a pixel of it is read.
Source of the layout: TIFF 6.0 (Adobe, 1992) and the BigTIFF design (Joris Van Damme and others, 2004).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, LimitError

BLOCKS_MOST = 20_000_000
"""Tiles or strips of an image: 20 million tiles of 256 px are 1.3 terapixels."""
TAGS_MOST = 4096

UNCOMPRESSED = 1
_DAMAGED = "the file is damaged or was cut off: copy or download it again"
_TYPES = {
    1: "u1",
    2: "u1",
    3: "u2",
    4: "u4",
    6: "i1",
    7: "u1",
    8: "i2",
    9: "i4",
    13: "u4",
    16: "u8",
    17: "i8",
    18: "u8",
}
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_STRIP_OFFSETS, _SAMPLES, _STRIP_ROWS, _STRIP_BYTES, _PLANAR = 273, 277, 278, 279, 284
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_BYTES, _EXTRA_SAMPLES = 322, 323, 324, 325, 338
_COLOURS = {0: 1, 1: 1, 2: 3, 3: 1, 6: 3}  # samples of a pixel that its photometric interpretation accounts for
_UNREAD_COLOURS = {5: "inks (CMYK)", 8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*"}


@dataclass(frozen=True)
class TiffStructure:
    """What the tags say.

    Parameters
    ----------
    sparse
        Some tiles or strips were never written, so nobody knows their pixels.
    """

    width_px: int
    height_px: int
    samples: int
    sample_bits: int
    block_count: int
    sparse: bool


@dataclass(frozen=True)
class _Entry:
    count: int
    kind: str
    place: int  # in the file, of the first value


class _Tags:
    """The entries of a directory; values are read when asked for."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.stream, self.path = stream, path
        self.size = os.fstat(stream.fileno()).st_size
        head = stream.read(16)
        self.order = "<" if head[:2] == b"II" else ">"
        self.big = self._number(head[2:4]) == 43
        first = self._number(head[8:16] if self.big else head[4:8])
        self.entries = self._directory(first)

    def _number(self, raw: bytes) -> int:
        return int.from_bytes(raw, "little" if self.order == "<" else "big")

    def _directory(self, place: int) -> dict[int, _Entry]:
        wide = self.big
        count_bytes, entry_bytes, inline = (8, 20, 8) if wide else (2, 12, 4)
        count = self._number(self._bytes(place, count_bytes, "its table of contents"))
        if not 0 < count <= TAGS_MOST:
            raise self.fault(f"a table of contents of {count} entries")
        table = self._bytes(place + count_bytes, count * entry_bytes, "its table of contents")
        entries = {}
        for start in range(0, len(table), entry_bytes):
            raw = table[start : start + entry_bytes]
            tag, kind = self._number(raw[0:2]), _TYPES.get(self._number(raw[2:4]))
            if kind is None or tag in entries:  # text, fractions: nothing asked for here
                continue
            length = self._number(raw[4:-inline])
            held = length * np.dtype(kind).itemsize <= inline
            value_at = place + count_bytes + start + entry_bytes - inline
            entries[tag] = _Entry(length, kind, value_at if held else self._number(raw[-inline:]))
        return entries

    def _bytes(self, place: int, length: int, what: str) -> bytes:
        if place < 8 or place + length > self.size:
            raise self.fault(f"{what} would lie at byte {place:,} to {place + length:,} of {self.size:,}")
        self.stream.seek(place)
        return self.stream.read(length)

    def fault(self, found: str) -> InputError:
        """Return the error of tags that cannot be true."""
        return InputError("the TIFF file contradicts itself", where=self.path, found=found, next_step=_DAMAGED)

    def values(self, tag: int, what: str) -> NDArray[np.int64]:
        """Read the values of a tag; empty where it is not there."""
        entry = self.entries.get(tag)
        if entry is None:
            return np.zeros(0, dtype=np.int64)
        if entry.count > BLOCKS_MOST:
            raise LimitError(f"too many {what}", where=self.path, found=f"{entry.count:,}",
                             expected=f"at most {BLOCKS_MOST:,}")  # fmt: skip
        kind = np.dtype(self.order + entry.kind)
        raw = np.frombuffer(self._bytes(entry.place, entry.count * kind.itemsize, what), kind)
        if kind.kind == "u" and len(raw) and int(raw.max()) > np.iinfo(np.int64).max:
            raise self.fault(f"{what} up to {int(raw.max()):,}")
        return raw.astype(np.int64)

    def number(self, tag: int, default: int) -> int:
        """Read the first value of a tag."""
        values = self.values(tag, f"values of tag {tag}")
        return int(values[0]) if len(values) else default


def tiff_structure(path: Path) -> TiffStructure:
    """Read the tags of the first image of a TIFF or BigTIFF, and hold them against each other and the file's length.

    Raises
    ------
    InputError
        A table or a tile would lie beyond the end, tables are missing or too short, or samples are counted in two ways.
    LimitError
        More tiles than any image has.
    """
    with path.open("rb") as stream:
        tags = _Tags(stream, path)
        width, height = tags.number(_WIDTH, 0), tags.number(_HEIGHT, 0)
        samples, bits = tags.number(_SAMPLES, 1), tags.number(_BITS, 1)
        if width < 1 or height < 1 or samples < 1:
            raise InputError("no picture in the TIFF file", where=path, found=f"{width} x {height} px, {samples} bands")
        _check_samples(tags, samples)
        blocks, raw_bytes = _blocks(tags, width, height, samples, bits)
        sparse = _check_places(tags, blocks, raw_bytes)
    return TiffStructure(width, height, samples, bits, blocks, sparse)


def _check_samples(tags: _Tags, samples: int) -> None:
    photometric = tags.number(_PHOTOMETRIC, 1)
    if photometric in _UNREAD_COLOURS:
        raise InputError(
            "colours are stored in a way that is not read", where=tags.path, found=_UNREAD_COLOURS[photometric],
            expected="red, green and blue", next_step="convert it to RGB, for instance with GIMP",
        )  # fmt: skip
    # Where bands are named after writing, GDAL leaves stale ones behind: harmless while none of them says it is alpha.
    extra, colours = tags.values(_EXTRA_SAMPLES, "meanings of further bands"), _COLOURS.get(photometric, samples)
    if extra.any() and colours + len(extra) > samples:
        raise InputError(
            "it is not clear what the bands are", where=tags.path,
            found=f"{samples} bands, but {colours} of colour and {len(extra)} further ones, transparency among them",
            expected="numbers that agree", next_step="write it anew, for instance with gdal_translate",
        )  # fmt: skip


def _blocks(tags: _Tags, width: int, height: int, samples: int, bits: int) -> tuple[int, NDArray[np.int64] | int]:
    """Return how many tiles or strips there are, and the bytes of each when not compressed."""
    planes = samples if tags.number(_PLANAR, 1) == 2 else 1
    pixel_bits = bits * samples // planes
    if _TILE_WIDTH in tags.entries:
        wide, high = tags.number(_TILE_WIDTH, 0), tags.number(_TILE_HEIGHT, 0)
        if wide < 1 or high < 1:
            raise tags.fault(f"tiles of {wide} x {high} px")
        across, down = -(-width // wide), -(-height // high)
        _check_count(tags, across * down * planes)
        return across * down * planes, (wide * pixel_bits + 7) // 8 * high
    rows = min(tags.number(_STRIP_ROWS, height), height)
    if rows < 1:
        raise tags.fault(f"strips of {rows} rows")
    down = -(-height // rows)
    _check_count(tags, down * planes)
    row_bytes = (width * pixel_bits + 7) // 8
    heights = np.full(down, rows, dtype=np.int64)
    heights[-1] = height - rows * (down - 1)
    return down * planes, np.tile(heights * row_bytes, planes)


def _check_count(tags: _Tags, count: int) -> None:
    if count > BLOCKS_MOST or count > tags.size:  # a place takes more than a byte
        raise LimitError(
            "more tiles or strips than the file could hold", where=tags.path,
            found=f"{count:,} in {tags.size:,} bytes", next_step=_DAMAGED,
        )  # fmt: skip


def _check_places(tags: _Tags, count: int, raw_bytes: NDArray[np.int64] | int) -> bool:
    """Hold the places of all tiles or strips against the file's length; tell whether some are not there."""
    tiled = _TILE_WIDTH in tags.entries
    offsets = tags.values(_TILE_OFFSETS if tiled else _STRIP_OFFSETS, "places of tiles or strips")
    lengths = tags.values(_TILE_BYTES if tiled else _STRIP_BYTES, "lengths of tiles or strips")
    if len(offsets) < count or len(lengths) < count:
        raise tags.fault(f"{count:,} tiles or strips, {len(offsets):,} places and {len(lengths):,} lengths")
    offsets, lengths = offsets[:count], lengths[:count]
    if tags.number(_COMPRESSION, UNCOMPRESSED) == UNCOMPRESSED:  # some writers state more than there is to the last
        present = (lengths > 0) & (offsets > 0)
        short = int((present & (lengths < raw_bytes)).sum())
        if short:
            raise tags.fault(f"{short:,} tiles or strips shorter than their pixels")
        lengths = np.minimum(lengths, raw_bytes)
    if len(offsets) and (offsets.min() < 0 or lengths.min() < 0):
        raise tags.fault("tiles or strips at negative places")
    present = (lengths > 0) & (offsets > 0)
    # Compared without a sum: of two numbers near 2^63 it would turn negative.
    beyond = int((present & ((offsets > tags.size) | (lengths > tags.size - np.minimum(offsets, tags.size)))).sum())
    if beyond:
        raise InputError(
            "the TIFF file ends before its pixels do", where=tags.path,
            found=f"{beyond:,} of {count:,} tiles or strips beyond its {tags.size:,} bytes", next_step=_DAMAGED,
        )  # fmt: skip
    return bool((~present).any())
