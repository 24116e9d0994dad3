"""Just enough of the OpenStreetMap PBF format to write a street corner."""

from __future__ import annotations

import struct
from pathlib import Path

Tags = dict[str, str]


def varint(number: int) -> bytes:
    number &= (1 << 64) - 1
    out = bytearray()
    while True:
        number, low = number >> 7, number & 0x7F
        out.append(low | (0x80 if number else 0))
        if not number:
            return bytes(out)


def zigzag(number: int) -> bytes:
    return varint((number << 1) ^ (number >> 63))


def field(tag: int, value: int | bytes) -> bytes:
    if isinstance(value, int):
        return varint(tag << 3) + varint(value)
    return varint(tag << 3 | 2) + varint(len(value)) + value


def block(kind: bytes, payload: bytes) -> bytes:
    blob = field(1, payload)
    header = field(1, kind) + field(3, len(blob))
    return struct.pack(">I", len(header)) + header + blob


def write_pbf(path: Path, nodes: dict[int, tuple[float, float, Tags]], ways: dict[int, tuple[list[int], Tags]]) -> None:
    """Write nodes (longitude, latitude, tags) and ways (node ids, tags)."""
    texts = [""]

    def number(text: str) -> int:
        if text not in texts:
            texts.append(text)
        return texts.index(text)

    def tags_of(tags: Tags) -> bytes:
        keys = b"".join(varint(number(key)) for key in tags)
        values = b"".join(varint(number(value)) for value in tags.values())
        return field(2, keys) + field(3, values) if tags else b""

    group_nodes = b"".join(
        field(1, varint(1 << 3) + zigzag(n) + tags_of(tags)
              + varint(8 << 3) + zigzag(round(lat * 1e7)) + varint(9 << 3) + zigzag(round(lon * 1e7)))
        for n, (lon, lat, tags) in nodes.items()
    )  # fmt: skip
    group_ways = b""
    for n, (refs, tags) in ways.items():
        steps = [b - a for a, b in zip([0, *refs], refs, strict=False)]
        group_ways += field(3, varint(1 << 3) + varint(n) + tags_of(tags) + field(8, b"".join(map(zigzag, steps))))
    strings = field(1, b"".join(field(1, text.encode()) for text in texts))
    data = strings + field(2, group_nodes) + field(2, group_ways)
    header = field(4, b"OsmSchema-V0.6")
    path.write_bytes(block(b"OSMHeader", header) + block(b"OSMData", data))
