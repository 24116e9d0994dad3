"""The bytes of an ONNX model: its metadata, a seal over all of it, and which operators it asks for.

An ONNX file is a protocol buffer and carries no checksum: most flipped bits change results and nothing else. A model
of this program therefore holds the SHA-256 of all its other bytes among its metadata. That guards against damage, not
against malice; what a sealed model may do is limited by the operators allowed here. They neither draw numbers, branch,
loop nor reach outside the file, and their memory grows no faster than the image.

Field numbers are those of onnx.proto.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

SEAL = "sha256"
GRAPH, METADATA = 7, 14
MODEL_FIELDS = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 14})
"""Versions, names, texts, the graph, opsets and metadata; not training, local functions or placement on devices."""
NODE, INITIALIZER, SPARSE_INITIALIZER = 1, 5, 15
OPERATOR, ATTRIBUTE, DOMAIN = 4, 5, 7
TENSOR, SUBGRAPH, TENSORS, SUBGRAPHS = 5, 6, 10, 11
EXTERNAL_DATA, DATA_LOCATION = 13, 14
MOST_FIELDS = 200_000
LENGTH_DELIMITED = 2

OPERATORS = frozenset(
    {
        "Add", "AveragePool", "BatchNormalization", "Cast", "Clip", "Concat", "Constant", "Conv", "ConvTranspose",
        "DequantizeLinear", "Div", "Elu", "HardSigmoid", "HardSwish", "Identity", "LeakyRelu", "MaxPool", "Mul",
        "PRelu", "QuantizeLinear", "Relu", "Sigmoid", "Softplus", "Sub", "Tanh",
    }
)  # fmt: skip
"""What a network of convolutions needs, in full precision or quantised."""


@dataclass(frozen=True)
class Field:
    """A field of a protocol buffer: its number, its kind on the wire, all its bytes, and its value."""

    number: int
    wire: int
    raw: memoryview
    value: memoryview | int


def sealed(content: bytes, metadata: Mapping[str, str]) -> bytes:
    """Return a model with these metadata in place of its own, and the seal.

    Raises
    ------
    ValueError
        The content is no ONNX model, or a key is taken.
    """
    if SEAL in metadata:
        raise ValueError(f"metadata cannot have the key {SEAL}")
    kept = [field.raw for field in model_fields(content) if field.number != METADATA]
    entries = [_entry(key, metadata[key]) for key in sorted(metadata)]
    seal = _digest(kept, entries)
    return b"".join([*kept, *entries, _entry(SEAL, seal)])


def sealed_metadata(content: bytes) -> dict[str, str]:
    """Return the metadata of a model whose seal holds, without the seal.

    Raises
    ------
    ValueError
        The content is no ONNX model, has no seal or another one; says which.
    """
    fields = model_fields(content)
    metadata: dict[str, str] = {}
    for field in fields:
        if field.number == METADATA:
            key, text = _read_entry(field)
            if key in metadata:
                raise ValueError(f"its metadata have {key!r} twice")
            metadata[key] = text
    if SEAL not in metadata:
        raise ValueError("it does not hold its checksum, which this program writes into each model it trains")
    seal = metadata.pop(SEAL)
    kept = [field.raw for field in fields if field.number != METADATA]
    if seal != _digest(kept, [_entry(key, metadata[key]) for key in sorted(metadata)]):
        raise ValueError("its checksum does not match: the file is damaged, or was changed after training")
    return metadata


def foreign_parts(content: bytes, operators: frozenset[str] = OPERATORS) -> list[str]:
    """Return what a model asks for beside these operators, each once, sorted.

    Raises
    ------
    ValueError
        The content is no ONNX model.
    """
    fields = model_fields(content)
    found = {f"field {field.number} of the model" for field in fields if field.number not in MODEL_FIELDS}
    left = [MOST_FIELDS]
    try:
        for field in fields:
            if field.number == GRAPH:
                found |= _foreign_to_graph(_inside(field), left, operators)
    except ValueError as error:
        raise ValueError(f"it is no ONNX model, or not a whole one ({error})") from error
    return sorted(found)


def model_fields(content: bytes) -> list[Field]:
    """Split a model into its outermost fields.

    Raises
    ------
    ValueError
        The content is no ONNX model; says why as far as can be told.
    """
    if content.startswith((b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")):
        raise ValueError(
            "it is a pickle or an archive, as PyTorch saves weights; such files can run code and are not read"
        )
    try:
        fields = list(_fields(memoryview(content), [MOST_FIELDS]))
    except ValueError as error:
        raise ValueError(f"it is no ONNX model, or not a whole one ({error})") from error
    graphs = [field for field in fields if field.number == GRAPH and field.wire == LENGTH_DELIMITED]
    if len(graphs) != 1:
        raise ValueError(f"it is no ONNX model, or not a whole one (it has {len(graphs)} graphs)")
    return fields


def _fields(content: memoryview, left: list[int]) -> Iterator[Field]:
    at = 0
    while at < len(content):
        left[0] -= 1
        if left[0] < 0:
            raise ValueError(f"more than {MOST_FIELDS} fields")
        start = at
        tag, at = _varint(content, at)
        number, wire = tag >> 3, tag & 7
        value: memoryview | int
        if wire == 0:
            value, at = _varint(content, at)
        elif wire in (1, 5):
            width = 8 if wire == 1 else 4
            value, at = content[at : at + width], at + width
        elif wire == LENGTH_DELIMITED:
            length, at = _varint(content, at)
            value, at = content[at : at + length], at + length
        else:
            raise ValueError(f"a field of kind {wire} at byte {start}")
        if number == 0 or at > len(content):
            raise ValueError(
                f"a field that ends after the file at byte {start}" if number else f"no field at byte {start}"
            )
        yield Field(number, wire, content[start:at], value)


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    result = 0
    for shift in range(0, 70, 7):
        if at >= len(content):
            raise ValueError(f"a number cut off at byte {at}")
        byte = content[at]
        at += 1
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result, at
    raise ValueError(f"a number without end at byte {at}")


def _foreign_to_graph(graph: memoryview, left: list[int], operators: frozenset[str]) -> set[str]:
    found: set[str] = set()
    for field in _fields(graph, left):
        if field.number == NODE:
            found |= _foreign_to_node(_inside(field), left, operators)
        elif field.number == INITIALIZER:
            found |= _foreign_to_tensor(_inside(field), left)
        elif field.number == SPARSE_INITIALIZER:
            found.add("sparse weights")
    return found


def _foreign_to_node(node: memoryview, left: list[int], operators: frozenset[str]) -> set[str]:
    found: set[str] = set()
    operator, domain = "", ""
    for field in _fields(node, left):
        if field.number == OPERATOR:
            operator = _text(_inside(field))
        elif field.number == DOMAIN:
            domain = _text(_inside(field))
        elif field.number == ATTRIBUTE:
            for part in _fields(_inside(field), left):
                if part.number in (SUBGRAPH, SUBGRAPHS):
                    found.add("a graph inside a graph")
                elif part.number in (TENSOR, TENSORS):
                    found |= _foreign_to_tensor(_inside(part), left)
    if domain not in ("", "ai.onnx"):
        found.add(f"operator {domain}.{operator}")
    elif operator not in operators:
        found.add(f"operator {operator}")
    return found


def _foreign_to_tensor(tensor: memoryview, left: list[int]) -> set[str]:
    for field in _fields(tensor, left):
        if field.number == EXTERNAL_DATA or (field.number == DATA_LOCATION and field.value != 0):
            return {"weights in another file"}
    return set()


def _inside(field: Field) -> memoryview:
    if not isinstance(field.value, memoryview):
        raise ValueError(f"field {field.number} is a number")
    return field.value


def _text(value: memoryview) -> str:
    return bytes(value[:100]).decode("utf-8", "replace")


def _number(value: int) -> bytes:
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*result, value])


def _part(number: int, value: bytes) -> bytes:
    return _number(number << 3 | LENGTH_DELIMITED) + _number(len(value)) + value


def _entry(key: str, text: str) -> bytes:
    return _part(METADATA, _part(1, key.encode()) + _part(2, text.encode()))


def _read_entry(field: Field) -> tuple[str, str]:
    parts = {part.number: part for part in _fields(_inside(field), [MOST_FIELDS])}
    try:
        key, text = str(_inside(parts[1]), "utf-8"), str(_inside(parts[2]), "utf-8")
    except (KeyError, UnicodeDecodeError) as error:
        raise ValueError("its metadata cannot be read") from error
    if _entry(key, text) != field.raw:
        raise ValueError("its metadata are written in a way that this program does not write")
    return key, text


def _digest(kept: list[memoryview], entries: list[bytes]) -> str:
    digest = hashlib.sha256()
    parts: list[memoryview | bytes] = [*kept, *entries]
    for part in parts:
        digest.update(part)
    return digest.hexdigest()
