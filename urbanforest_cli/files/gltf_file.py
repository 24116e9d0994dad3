"""A glTF file opened without trust: every offset, count and name is checked before it is used."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.gltf_document import BIN_CHUNK, GLB_VERSION, JSON_CHUNK, MAGIC
from urbanforest_cli.files.words import kind_of

HEADER, CHUNK_HEADER = struct.Struct("<4sII"), struct.Struct("<I4s")
JSON_BYTES_MAX = 1 << 30
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
KINDS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
STRIDE_MAX = 252
NUMBER_MAX = 1e9
KNOWN_EXTENSIONS = frozenset(
    {
        "EXT_instance_features",
        "EXT_mesh_features",
        "EXT_mesh_gpu_instancing",
        "EXT_structural_metadata",
        "KHR_materials_unlit",
        "KHR_mesh_quantization",
    }
)
EXPECTED = "glTF as urbanforest writes it"
NEXT_STEP = "write it again with `urbanforest export`"


class GltfFile:
    """A glTF file whose parts are read when they are asked for.

    Parameters
    ----------
    path
        A GLB, or glTF as JSON.
    root
        Folder that other files it names must lie in; its own folder where None.

    Raises
    ------
    InputError
        No such file; torn; not glTF 2.0; or it names a file outside `root`.
    """

    json: dict[str, Any]

    def __init__(self, path: Path, *, root: Path | None = None) -> None:
        self.path = Path(path)
        self._root = (self.path.parent if root is None else Path(root)).resolve()
        try:
            self._open()
        except OSError as error:
            raise InputError("the file cannot be read", where=self.path, found=error.strerror or str(error)) from error

    def fault(self, what: str, found: object = None) -> NoReturn:
        """Raise an `InputError` about this file."""
        raise InputError(what, where=self.path, found=found, expected=EXPECTED, next_step=NEXT_STEP)

    def whole(self, value: object, what: str, *, below: int | None = None) -> int:
        """Return a number that must be whole, not negative and below a bound."""
        if not isinstance(value, int) or isinstance(value, bool) or value < 0 or (below is not None and value >= below):
            self.fault(f"{what} is out of bounds", str(value)[:50])
        return value

    def numbers(self, value: object, count: int, what: str) -> NDArray[np.float64]:
        """Return a list that must hold so many numbers, none beyond any place on Earth."""
        entries = self.items(value, what)
        fit = (
            isinstance(entry, int | float) and not isinstance(entry, bool) and -NUMBER_MAX <= entry <= NUMBER_MAX
            for entry in entries
        )
        if len(entries) != count or not all(fit):
            self.fault(f"{what} is not {count} numbers", str(value)[:100])
        return np.array(entries, np.float64)

    def members(self, value: object, what: str) -> dict[str, Any]:
        """Return a value that must be an object."""
        if not isinstance(value, dict):
            self.fault(f"{what} is not an object", kind_of(value))
        return value

    def items(self, value: object, what: str) -> list[Any]:
        """Return a value that must be a list."""
        if not isinstance(value, list):
            self.fault(f"{what} is not a list", kind_of(value))
        return value

    def element(self, name: str, number: object) -> dict[str, Any]:
        """Return an entry of one of the document's lists."""
        entries = self.items(self.json.get(name, []), name)
        return self.members(entries[self.whole(number, f"a number of {name}", below=len(entries))], f"one of {name}")

    def view(self, number: object) -> NDArray[np.uint8]:
        """Return the bytes of a buffer view, not copied."""
        view = self.element("bufferViews", number)
        data = self._buffer(view.get("buffer"))
        start = self.whole(view.get("byteOffset", 0), "byteOffset")
        length = self.whole(view.get("byteLength"), "byteLength")
        if length == 0 or start + length > len(data):
            self.fault("a buffer view reaches beyond its buffer", f"{start} + {length} of {len(data)} bytes")
        return data[start : start + length]

    def accessor(self, number: object) -> NDArray[Any]:
        """Return an accessor's values: (n,) of scalars, (n, k) of vectors, normalised ones as float64."""
        accessor = self.element("accessors", number)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if not isinstance(kind, str) or kind not in KINDS or component not in tuple(COMPONENTS):
            self.fault("an accessor of a type not in use", f"{str(kind)[:20]} of {str(component)[:20]}")
        if "sparse" in accessor:
            self.fault("a sparse accessor")
        dtype, width = np.dtype(COMPONENTS[component]), KINDS[kind]
        size = dtype.itemsize * width
        view = self.element("bufferViews", accessor.get("bufferView"))
        data = self.view(accessor.get("bufferView"))
        stride = self.whole(view.get("byteStride", size), "byteStride", below=STRIDE_MAX + 1)
        start = self.whole(accessor.get("byteOffset", 0), "byteOffset")
        count = self.whole(accessor.get("count"), "count")
        if count == 0 or stride < size or start + (count - 1) * stride + size > len(data):
            self.fault("an accessor reaches beyond its buffer view", f"{count} of {size} bytes in {len(data)}")
        rows = np.lib.stride_tricks.as_strided(data[start:], (count, size), (stride, 1), writeable=False)
        values = np.ascontiguousarray(rows).view(dtype).reshape(count, width)
        if accessor.get("normalized") is True and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        elif dtype.kind == "f" and not np.isfinite(values).all():
            self.fault("a number that is not finite")
        return values[:, 0] if kind == "SCALAR" else values

    def _open(self) -> None:
        if not self.path.is_file():
            raise InputError("no such file", where=self.path, next_step=NEXT_STEP)
        size = self.path.stat().st_size
        self._chunk = (0, 0)
        with self.path.open("rb") as stream:
            head = stream.read(HEADER.size)
            if head[:4] == MAGIC:
                text = self._read_chunks(stream, head, size)
            elif size <= JSON_BYTES_MAX:
                text = head + stream.read()
            else:
                self.fault("too large for glTF as JSON", f"{size} bytes")
        self.json = self._parsed(text)
        asset = self.members(self.json.get("asset"), "asset")
        if asset.get("version") != "2.0":
            self.fault("not glTF 2.0", str(asset.get("version"))[:50])
        unknown = [
            str(name)[:50]
            for name in self.items(self.json.get("extensionsRequired", []), "extensionsRequired")
            if not isinstance(name, str) or name not in KNOWN_EXTENSIONS
        ]
        if unknown:
            self.fault("extensions that this program does not read", ", ".join(unknown[:5]))
        self._buffers: dict[int, NDArray[np.uint8]] = {}
        self._places = [
            self._place_of(number, self.members(buffer, "a buffer"))
            for number, buffer in enumerate(self.items(self.json.get("buffers", []), "buffers"))
        ]

    def _read_chunks(self, stream: Any, head: bytes, size: int) -> bytes:
        if len(head) < HEADER.size:
            self.fault("a torn GLB", f"{size} bytes")
        _, version, length = HEADER.unpack(head)
        if version != GLB_VERSION or length != size:
            self.fault("a torn GLB or one of another version", f"version {version}, {length} bytes of {size}")
        chunks: list[tuple[bytes, int, int]] = []
        start = HEADER.size
        while start < size:
            stream.seek(start)
            header = stream.read(CHUNK_HEADER.size)
            if len(header) < CHUNK_HEADER.size:
                self.fault("a torn GLB", f"a chunk's header at {start} of {size} bytes")
            chunk, kind = CHUNK_HEADER.unpack(header)
            start += CHUNK_HEADER.size
            if start + chunk > size or chunk % 4:
                self.fault("a torn GLB", f"a chunk of {chunk} bytes at {start} of {size}")
            chunks.append((kind, start, chunk))
            start += chunk
            if len(chunks) == 2:  # what may follow is of no use here
                break
        if not chunks or chunks[0][0] != JSON_CHUNK or chunks[0][2] > JSON_BYTES_MAX:
            self.fault("a GLB that does not begin with its JSON")
        if len(chunks) > 1 and chunks[1][0] == BIN_CHUNK:
            self._chunk = chunks[1][1:]
        stream.seek(chunks[0][1])
        text: bytes = stream.read(chunks[0][2])
        return text

    def _parsed(self, text: bytes) -> dict[str, Any]:
        try:
            parsed = json.loads(text.decode("utf-8"), parse_constant=lambda word: self.fault("no JSON", word))
        except (ValueError, RecursionError) as error:
            self.fault("not glTF: its JSON cannot be read", str(error)[:200])
        return self.members(parsed, "the document")

    def _place_of(self, number: int, buffer: dict[str, Any]) -> tuple[Path, int, int]:
        """Return the file, first byte and count of bytes of a buffer."""
        length = self.whole(buffer.get("byteLength"), "byteLength of a buffer")
        if "uri" not in buffer:
            start, chunk = self._chunk
            if number or not length <= chunk <= length + 3:
                self.fault("the binary chunk is not as long as stated", f"{chunk} bytes, stated {length}")
            return self.path, start, length
        path = self.beside(buffer["uri"])
        size = path.stat().st_size if path.is_file() else -1
        if length == 0 or size < length:
            self.fault("a file of its data is missing or torn", f"{path.name}: {size} bytes, stated {length}")
        return path, 0, length

    def beside(self, uri: object) -> Path:
        """Return the file that a relative address names.

        Raises
        ------
        InputError
            The address is absolute, a web address, or leads out of the root.
        """
        name = unquote(uri) if isinstance(uri, str) else ""
        if not name or name.startswith("/") or any(mark in name for mark in ":\\?#\0"):
            self.fault("the address of its data is not a file beside it", str(uri)[:100])
        try:
            path = (self.path.parent / name).resolve()
        except (OSError, RuntimeError, ValueError):
            self.fault("the address of its data is not a file beside it", str(uri)[:100])
        if not path.is_relative_to(self._root):
            self.fault("the address of its data leads out of its folder", str(uri)[:100])
        return path

    def _buffer(self, number: object) -> NDArray[np.uint8]:
        place = self.whole(number, "a buffer's number", below=len(self._places))
        if place not in self._buffers:
            path, start, length = self._places[place]
            try:
                data = np.memmap(path, np.uint8, mode="r", offset=start, shape=(length,))
            except (OSError, ValueError) as error:
                self.fault("its data cannot be read", str(error)[:100])
            self._buffers[place] = np.asarray(data)
        return self._buffers[place]
