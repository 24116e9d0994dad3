"""A TIFF that contradicts itself is refused before a library believes it."""

import struct

import numpy as np
import pytest

from tests.files.rasters import colours, write_raster
from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.files.tiff_structure import tiff_structure

MAKES = {
    "strips": {},
    "tiles": {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "lzw"},
    "planes": {"interleave": "band"},
    "big": {"BIGTIFF": "YES", "compress": "deflate"},
    "big-endian": {"ENDIANNESS": "BIG"},
    "big big-endian": {"ENDIANNESS": "BIG", "BIGTIFF": "YES"},
}


@pytest.mark.parametrize("make", MAKES)
def test_tags_are_read_in_every_layout(tmp_path, make):
    found = tiff_structure(write_raster(tmp_path / "a.tif", colours(), **MAKES[make]))
    assert (found.width_px, found.height_px, found.samples, found.sample_bits) == (60, 40, 3, 8)
    assert found.block_count == {"tiles": 12, "planes": 3}.get(make, 1)
    assert not found.sparse


@pytest.mark.parametrize("make", MAKES)
def test_every_shorter_file_is_refused(tmp_path, make):
    whole = write_raster(tmp_path / "a.tif", colours(), crs=None, place=None, **MAKES[make]).read_bytes()
    path = tmp_path / "short.tif"
    ends = max(_ends(whole))
    for length in [*range(16, ends, max(1, ends // 60)), ends - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"short\.tif"):
            tiff_structure(path)
    path.write_bytes(whole[:ends])
    tiff_structure(path)


def _ends(raw: bytes) -> list[int]:
    """Where the directory, its tables and the pixels end; a slow twin for little and big TIFFs of one image."""
    order = "<" if raw[:2] == b"II" else ">"
    big = struct.unpack(order + "H", raw[2:4])[0] == 43
    start = struct.unpack(order + ("Q" if big else "I"), raw[8:16] if big else raw[4:8])[0]
    count = struct.unpack_from(order + ("Q" if big else "H"), raw, start)[0]
    step, head, inline = (20, 8, 8) if big else (12, 2, 4)
    letters = {1: "B", 2: "B", 3: "H", 4: "I", 16: "Q", 5: "Q", 12: "d"}
    ends, tables = [start + head + count * step], {}
    for entry in range(count):
        at = start + head + entry * step
        tag, kind = struct.unpack_from(order + "HH", raw, at)
        length = struct.unpack_from(order + ("Q" if big else "I"), raw, at + 4)[0]
        place = at + step - inline
        size = length * struct.calcsize(letters[kind])
        if size > inline:
            place = struct.unpack_from(order + ("Q" if big else "I"), raw, place)[0]
        if tag in (256, 257, 258, 259, 262, 273, 277, 278, 279, 284, 322, 323, 324, 325, 338):
            ends.append(place + size)
            tables[tag] = struct.unpack_from(f"{order}{length}{letters[kind]}", raw, place)
    offsets, lengths = tables.get(273) or tables[324], tables.get(279) or tables[325]
    return ends + [offset + length for offset, length in zip(offsets, lengths, strict=True)]


def _patched(raw: bytes, tag: int, value: int) -> bytes:
    """Put a number in place of the first value of a tag, in a small little-endian TIFF."""
    start = struct.unpack("<I", raw[4:8])[0]
    out = bytearray(raw)
    for entry in range(struct.unpack_from("<H", raw, start)[0]):
        at = start + 2 + 12 * entry
        if struct.unpack_from("<H", raw, at)[0] == tag:
            struct.pack_into("<HII", out, at + 2, 4, 1, value)
            return bytes(out)
    raise AssertionError(f"no tag {tag}")


LIES = {
    "no width": (256, 0, "no picture"),
    "no bands": (277, 0, "no picture"),
    "as many strips as rows": (278, 1, "contradicts itself"),
    "strips of no rows": (278, 0, "contradicts itself"),
    "four billion rows": (257, 2**32 - 1, "more tiles or strips"),
    "forty million rows": (257, 40_000_000, "more tiles or strips"),
    "pixels beyond the end": (273, 2**31, "ends before"),
    "too many bytes for the file": (279, 2**31, None),
    "too few bytes for the pixels": (279, 100, "contradicts itself"),
    "inks": (262, 5, "colours"),
    "L*a*b*": (262, 8, "colours"),
}


@pytest.mark.parametrize("lie", LIES)
def test_lies_are_told(tmp_path, lie):
    tag, value, message = LIES[lie]
    path = write_raster(tmp_path / "a.tif", colours())
    path.write_bytes(_patched(path.read_bytes(), tag, value))
    if message is None:  # some writers state more than there is of uncompressed pixels, and nothing is lost
        tiff_structure(path)
        return
    with pytest.raises(InputError, match=message):
        tiff_structure(path)


def test_more_tiles_than_bytes_are_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours(), tiled=True, blockxsize=16, blockysize=16)
    raw = _patched(_patched(path.read_bytes(), 256, 2**31), 257, 2**31)
    path.write_bytes(raw)
    with pytest.raises(LimitError, match="more tiles"):
        tiff_structure(path)


def test_tiles_never_written_are_noticed(tmp_path):
    zeros = np.zeros((1, 64, 64), np.uint8)
    path = write_raster(tmp_path / "a.tif", zeros, tiled=True, blockxsize=16, blockysize=16, SPARSE_OK=True)
    assert tiff_structure(path).sparse


def test_files_of_other_writers_pass(real_data):
    paths = [path for path in real_data.rglob("*.tif") if path.parent.name != "images" or path.stem.endswith("0")]
    assert len(paths) > 20
    for path in paths:
        assert not tiff_structure(path).sparse
