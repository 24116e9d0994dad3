"""A glTF document as it grows: JSON beside the binary chunk, and both put together as GLB."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli import __version__
from urbanforest_cli.core.errors import OutputError

BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
MAGIC, JSON_CHUNK, BIN_CHUNK, GLB_VERSION = b"glTF", b"JSON", b"BIN\0", 2
ALIGNMENT = 8
GLB_BYTES_MAX = (1 << 32) - 1
NODE_REACH_M = 4000.0
"""Farthest that anything may lie from its node along an axis, so that float32 keeps it to a quarter of a millimetre."""

Bytes = bytes | memoryview


def y_up(xyz: NDArray[Any]) -> NDArray[Any]:
    """Turn (n, 3) x east, y north, z up into glTF's axes: x east, y up, z south."""
    return np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1)


def to_json(value: object) -> str:
    """Return compact JSON; what JSON cannot hold raises ValueError."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def numbers(values: Sequence[float] | NDArray[Any]) -> str:
    """Return a JSON list of numbers, exact to the last bit, whole ones without a point, none minus nought."""
    return "[" + ",".join(repr(float(value) + 0.0).removesuffix(".0") for value in values) + "]"


def accessor_text(
    component: int,
    kind: str,
    count: int,
    *,
    normalised: bool = False,
    low: NDArray[Any] | None = None,
    high: NDArray[Any] | None = None,
) -> str:
    """Return the members of an accessor that do not depend on where its data lie, for `Document.accessor`."""
    text = f'"componentType":{component},"count":{count},"type":"{kind}"'
    if normalised:
        text += ',"normalized":true'
    if low is not None and high is not None:
        text += f',"min":{numbers(low)},"max":{numbers(high)}'
    return text


class Document:
    """Collects what a file holds; each `add` returns the number by which others refer to it.

    Lists that may be long are kept as JSON text, one entry an element.
    """

    def __init__(self) -> None:
        self._chunks: list[Bytes] = []
        self._length = 0
        self._lists: dict[str, list[str]] = {}
        self._external: dict[str, tuple[int, int]] = {}
        self._used: dict[str, bool] = {}
        self.extensions: dict[str, object] = {}
        self.extras: dict[str, object] = {}

    def add(self, name: str, text: str) -> int:
        """Append an object, as JSON text, to one of the document's lists."""
        entries = self._lists.setdefault(name, [])
        entries.append(text)
        return len(entries) - 1

    def use(self, extension: str, *, required: bool = False) -> None:
        """Note that the file uses an extension, and whether a reader must know it."""
        self._used[extension] = self._used.get(extension, False) or required

    def append(self, data: Bytes) -> int:
        """Append bytes to the binary chunk and return where they begin."""
        padding = -self._length % ALIGNMENT
        if padding:
            self._chunks.append(bytes(padding))
        start = self._length + padding
        self._chunks.append(data)
        self._length = start + len(data)
        return start

    def view(self, data: Bytes, *, target: int | None = None, stride: int | None = None) -> int:
        """Append bytes to the binary chunk as a buffer view."""
        return self.view_at(0, self.append(data), len(data), target=target, stride=stride)

    def view_at(
        self, buffer: int, start: int, length: int, *, target: int | None = None, stride: int | None = None
    ) -> int:
        """Add a view of bytes that lie in a buffer already."""
        text = f'{{"buffer":{buffer},"byteOffset":{start},"byteLength":{length}'
        if stride is not None:
            text += f',"byteStride":{stride}'
        if target is not None:
            text += f',"target":{target}'
        return self.add("bufferViews", text + "}")

    def external(self, uri: str, length: int) -> int:
        """Return the number of the buffer that another file holds."""
        if uri not in self._external:
            self._external[uri] = (len(self._external) + 1, length)
        return self._external[uri][0]

    def accessor(self, view: int, text: str, *, start: int = 0) -> int:
        """Add an accessor made by `accessor_text`, beginning at a byte of a view."""
        place = f'{{"bufferView":{view},"byteOffset":{start},' if start else f'{{"bufferView":{view},'
        return self.add("accessors", place + text + "}")

    def node(self, *members: str) -> None:
        """Add a node to the scene; each member is JSON text or empty."""
        self.add("nodes", "{" + ",".join(member for member in members if member) + "}")

    def json_text(self) -> str:
        """Return the whole JSON."""
        asset: dict[str, object] = {"version": "2.0", "generator": f"urbanforest {__version__}"}
        if self.extras:
            asset["extras"] = self.extras
        members = [f'"asset":{to_json(asset)}']
        if self._used:
            members.append(f'"extensionsUsed":{to_json(sorted(self._used))}')
        required = sorted(name for name, needed in self._used.items() if needed)
        if required:
            members.append(f'"extensionsRequired":{to_json(required)}')
        if self.extensions:
            members.append(f'"extensions":{to_json(self.extensions)}')
        members.append('"scene":0')
        nodes = len(self._lists.get("nodes", ()))
        members.append(f'"scenes":[{{"nodes":[{",".join(map(str, range(nodes)))}]}}]' if nodes else '"scenes":[{}]')
        members += [f'"{name}":[{",".join(entries)}]' for name, entries in self._lists.items()]
        if self._length:
            buffers = [f'{{"byteLength":{self._length}}}']
            buffers += [f'{{"uri":{to_json(uri)},"byteLength":{size}}}' for uri, (_, size) in self._external.items()]
            members.append(f'"buffers":[{",".join(buffers)}]')
        return "{" + ",".join(members) + "}"

    def glb(self) -> bytes:
        """Return the file.

        Raises
        ------
        OutputError
            It would be larger than GLB can be.
        """
        text = self.json_text().encode("utf-8", "backslashreplace")  # a lone surrogate's JSON escape
        text += b" " * (-len(text) % 4)
        padding = -self._length % 4
        chunk = self._length + padding
        total = 12 + 8 + len(text) + (8 + chunk if chunk else 0)
        if total > GLB_BYTES_MAX:
            raise OutputError(
                "the scene is larger than a GLB can be",
                found=f"{total / 1e9:.1f} GB",
                expected="at most 4.29 GB",
                next_step="export a part with --bbox, a lower --detail, or 3D Tiles with --to 3dtiles",
            )
        head = struct.pack("<4sII", MAGIC, GLB_VERSION, total) + struct.pack("<I4s", len(text), JSON_CHUNK)
        if not chunk:
            return head + text
        return b"".join([head, text, struct.pack("<I4s", chunk, BIN_CHUNK), *self._chunks, bytes(padding)])
