"""The skeletons of PNG, JPEG and JPEG 2000 files: whether they are whole, and whether they unpack row by row."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

from urbanforest_cli.core.errors import InputError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_BOXES_MOST = 100_000
_DEPTH_MOST = 8
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_PROGRESSIVE = (0xC2, 0xC6, 0xCA, 0xCE)
_BOXES_OF_BOXES = (b"jp2h", b"asoc", b"res ", b"uinf", b"jpch", b"jplh", b"cgrp", b"drep", b"ftbl")
_DAMAGED = "the file is damaged or was cut off: copy or download it again"


def check_picture(path: Path, driver: str) -> None:
    """Refuse a picture whose parts do not add up to the file.

    GDAL reads what a PNG lacks as black, and never comes back from some boxes of JPEG 2000 that have no length.

    Raises
    ------
    InputError
        Cut off, or of parts that lie outside each other.
    """
    with path.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if driver == "PNG" and not _png_ends(stream, size):
            raise InputError("the PNG file ends before its picture does", where=path, found=f"{size:,} bytes",
                             next_step=_DAMAGED)  # fmt: skip
        if driver == "JP2OpenJPEG" and stream.read(4) == b"\0\0\0\x0c" and _count_boxes(stream, 0, size, 0) < 0:
            raise InputError("the JPEG 2000 file contradicts itself", where=path, found="boxes of impossible lengths",
                             next_step=_DAMAGED)  # fmt: skip


def unpacks_whole(path: Path, driver: str) -> bool:
    """Tell whether a file lists its picture coarse to fine, so that the last row needs all of it."""
    with path.open("rb") as stream:
        if driver == "PNG":
            return stream.read(29)[28:] == b"\x01"  # Adam7
        if driver != "JPEG":
            return False
        stream.seek(2)
        while len(head := stream.read(4)) == 4 and head[0] == 0xFF:
            if head[1] in _JPEG_FRAMES:
                return head[1] in _JPEG_PROGRESSIVE
            stream.seek(int.from_bytes(head[2:], "big") - 2, os.SEEK_CUR)
    return False


def _png_ends(stream: BinaryIO, size: int) -> bool:
    place = len(PNG_SIGNATURE)
    while place + 12 <= size:
        stream.seek(place)
        head = stream.read(8)
        place += 12 + int.from_bytes(head[:4], "big")
        if head[4:] == b"IEND":
            return place <= size
    return False


def _count_boxes(stream: BinaryIO, place: int, end: int, depth: int) -> int:
    """Walk the boxes from a place to an end, and those within; -1 where one does not fit into what holds it."""
    count = 0
    while place < end:
        stream.seek(place)
        head = stream.read(16)
        length, kind, inside = int.from_bytes(head[:4], "big"), head[4:8], place + 8
        if length == 1:
            length, inside = int.from_bytes(head[8:], "big"), place + 16
        elif length == 0 and depth == 0:
            length = end - place
        if place + length > end or inside > place + length or depth > _DEPTH_MOST:
            return -1
        within = _count_boxes(stream, inside, place + length, depth + 1) if kind in _BOXES_OF_BOXES else 0
        count += 1 + within
        if within < 0 or count > _BOXES_MOST:
            return -1
        place += length
    return count
