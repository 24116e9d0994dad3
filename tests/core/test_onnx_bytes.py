"""The seal of a model, and what it may ask for."""

from __future__ import annotations

import pytest

from urbanforest_cli.core import onnx_bytes
from urbanforest_cli.core.onnx_bytes import SEAL, foreign_parts, sealed, sealed_metadata

METADATA = {"format": "tried", "model": '{"name": "Baum ä"}'}


def part(number: int, value: bytes) -> bytes:
    """Write a field of bytes, short or long."""
    length = len(value)
    head = bytes([length]) if length < 128 else bytes([length & 0x7F | 0x80, length >> 7])
    tag = number << 3 | 2
    return (bytes([tag]) if tag < 128 else bytes([tag & 0x7F | 0x80, tag >> 7])) + head + value


def model(*nodes: bytes, inside: bytes = b"", beside: bytes = b"") -> bytes:
    graph = b"".join(part(1, node) for node in nodes) + inside + part(2, b"graph")
    return b"\x08\x08" + part(7, graph) + part(8, b"\x10\x11") + beside


def node(operator: str, *, domain: str = "", inside: bytes = b"") -> bytes:
    return part(4, operator.encode()) + (part(7, domain.encode()) if domain else b"") + inside


def test_a_seal_gives_back_the_metadata_and_replaces_earlier_ones() -> None:
    first = sealed(model(node("Relu")), {"format": "other"})
    assert sealed_metadata(sealed(first, METADATA)) == METADATA
    assert sealed(first, METADATA) == sealed(model(node("Relu")), METADATA)


def test_every_single_flipped_bit_is_seen() -> None:
    content = sealed(model(node("Relu"), node("Sigmoid")), METADATA)
    for at in range(len(content)):
        for bit in range(8):
            flipped = bytearray(content)
            flipped[at] ^= 1 << bit
            with pytest.raises(ValueError, match=r"\w"):
                sealed_metadata(bytes(flipped))


def test_every_cut_and_every_tail_is_seen() -> None:
    content = sealed(model(node("Relu")), METADATA)
    for length in range(len(content)):
        with pytest.raises(ValueError, match=r"\w"):
            sealed_metadata(content[:length])
    for tail in (b"\x00", b"\x08\x08", part(14, part(1, b"note") + part(2, b"added")), part(7, b"")):
        with pytest.raises(ValueError, match=r"\w"):
            sealed_metadata(content + tail)


def test_metadata_written_twice_or_otherwise_are_refused() -> None:
    entry = part(14, part(1, b"format") + part(2, b"tried"))
    with pytest.raises(ValueError, match="twice"):
        sealed_metadata(model(node("Relu"), beside=entry + entry))
    with pytest.raises(ValueError, match="does not write"):
        sealed_metadata(model(node("Relu"), beside=part(14, part(2, b"tried") + part(1, b"format"))))
    with pytest.raises(ValueError, match="cannot be read"):
        sealed_metadata(model(node("Relu"), beside=part(14, part(1, b"format"))))
    with pytest.raises(ValueError, match=SEAL):
        sealed(model(node("Relu")), {SEAL: "mine"})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"PK\x03\x04archive", "pickle"),
        (b"\x80\x04\x95pickle", "pickle"),
        (b"", "0 graphs"),
        (b"a text that is no model at all", "no ONNX model"),
        (model(node("Relu")) + part(7, b""), "2 graphs"),
        (b"\xff" * 40, "without end"),
        (b"\x3a\x7f", "ends after the file"),
        (b"\x02\x00", "no field"),
        (b"\x08", "cut off"),
    ],
)
def test_what_is_no_model_is_told_why(content: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        sealed_metadata(content)


def test_a_file_of_fields_without_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_bytes, "MOST_FIELDS", 1000)
    with pytest.raises(ValueError, match="more than 1000 fields"):
        sealed_metadata(b"\x08\x00" * 1001)
    with pytest.raises(ValueError, match="more than 1000 fields"):
        foreign_parts(model(inside=b"\x68\x00" * 1001))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (model(node("Conv"), node("ConvTranspose"), node("Sigmoid", domain="ai.onnx")), []),
        (model(node("Conv"), node("Loop"), node("Loop")), ["operator Loop"]),
        (model(node("RandomNormalLike")), ["operator RandomNormalLike"]),
        (model(node("Conv", domain="com.example")), ["operator com.example.Conv"]),
        (model(node("Relu", inside=part(5, part(6, b"")))), ["a graph inside a graph"]),
        (model(node("Relu", inside=part(5, part(11, b"")))), ["a graph inside a graph"]),
        (model(inside=part(5, part(13, b""))), ["weights in another file"]),
        (model(inside=part(5, b"\x70\x01")), ["weights in another file"]),
        (model(node("Constant", inside=part(5, part(5, b"\x70\x01")))), ["weights in another file"]),
        (model(inside=part(5, b"\x70\x00")), []),
        (model(inside=part(15, b"")), ["sparse weights"]),
        (model(beside=part(25, b"")), ["field 25 of the model"]),
    ],
)
def test_what_no_coverage_model_needs_is_named(content: bytes, expected: list[str]) -> None:
    assert foreign_parts(content) == expected
