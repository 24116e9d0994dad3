"""What is known of each plant, as a property table of EXT_structural_metadata."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Property
from urbanforest_cli.files.gltf_document import Document

EXTENSION = "EXT_structural_metadata"
PLANT_CLASS = "plant"
SCHEMA_ID = "urbanforest"
NO_DATA = -9999.0
"""Stands for "not known" in a column of float32, since glTF has no NaN."""

OFFSET_TYPES = (("UINT8", "<u1"), ("UINT16", "<u2"), ("UINT32", "<u4"), ("UINT64", "<u8"))
DECIMAL_STEPS = (0.01, 0.001, 0.0001)
STEPS_MAX = np.iinfo(np.uint16).max
FLOAT_TOLERANCE = 2.0**-23
NUMBER_TYPES = {"float32": "<f4", "uint8": "<u1", "uint16": "<u2", "uint32": "<u4"}


def add_property_table(document: Document, properties: Mapping[str, Property], count: int) -> None:
    """Add the plants' columns, `count` values each, to a document as its property table 0."""
    described: dict[str, object] = {}
    stored: dict[str, object] = {}
    enums: dict[str, object] = {}
    for name, column in properties.items():
        if column.type == "text":
            described[name] = {"description": column.doc, "type": "STRING"}
            stored[name] = _add_text(document, column.values)
        elif column.type == "enum":
            enums[name] = _enum(column)
            described[name] = {"description": column.doc, "type": "ENUM", "enumType": name}
            stored[name] = {"values": document.view(column.values.astype(_enum_dtype(column)).tobytes())}
        else:
            values, entry = _number(column)
            described[name] = {"description": column.doc, "type": "SCALAR"} | entry
            stored[name] = {"values": document.view(values.tobytes())}
    schema: dict[str, object] = {
        "id": SCHEMA_ID,
        "classes": {PLANT_CLASS: {"name": "plant", "description": "One plant a row.", "properties": described}},
    }
    if enums:
        schema["enums"] = enums
    table = {"name": "plants", "class": PLANT_CLASS, "count": count, "properties": stored}
    document.use(EXTENSION)
    document.extensions[EXTENSION] = {"schema": schema, "propertyTables": [table]}


def _number(column: Property) -> tuple[NDArray[Any], dict[str, object]]:
    values = column.values.astype(NUMBER_TYPES[column.type])
    entry: dict[str, object] = {"componentType": column.type.upper()}
    if column.type != "float32":
        return values, entry
    if (steps := decimal_steps(column.values)) is not None:
        return steps[0], {"componentType": "UINT16", "normalized": True, "scale": round(STEPS_MAX * steps[1], 4)}
    if not np.isfinite(values).all():
        values = np.where(np.isfinite(values), values, np.float32(NO_DATA)).astype("<f4")
        entry["noData"] = NO_DATA
    return values, entry


def decimal_steps(values: NDArray[Any]) -> tuple[NDArray[np.uint16], float] | None:
    """Return decimals as whole steps of two bytes, and the step; None where a value would be changed by that.

    As a normalised integer with a scale of 65535 steps a value takes half of a float32's bytes and stays what the
    register says, since that rounds to two, three or four decimals.
    """
    exact = values.astype(np.float64)
    if not np.isfinite(exact).all() or (exact < 0).any():
        return None
    for step in DECIMAL_STEPS:
        counts = np.rint(exact / step)
        if (counts <= STEPS_MAX).all() and (np.abs(counts * step - exact) <= FLOAT_TOLERANCE * exact).all():
            return counts.astype("<u2"), step
    return None


def _enum_dtype(column: Property) -> str:
    return "<u1" if len(column.names) <= np.iinfo(np.uint8).max + 1 else "<u2"


def _enum(column: Property) -> dict[str, object]:
    return {
        "valueType": "UINT8" if _enum_dtype(column) == "<u1" else "UINT16",
        "values": [{"name": word, "value": value} for value, word in enumerate(column.names)],
    }


def _add_text(document: Document, values: NDArray[Any]) -> dict[str, object]:
    text, offsets = packed_text(values)
    name, dtype = next(pair for pair in OFFSET_TYPES if int(offsets[-1]) <= np.iinfo(pair[1]).max)
    stored: dict[str, object] = {
        "values": document.view(text or b"\0"),  # a view holds a byte at least
        "stringOffsets": document.view(offsets.astype(dtype).tobytes()),
    }
    if name != "UINT32":
        stored["stringOffsetType"] = name
    return stored


def packed_text(values: NDArray[Any]) -> tuple[bytes, NDArray[np.int64]]:
    """Return texts end to end in UTF-8, and (n + 1,) offsets; a lone surrogate becomes its backslash form."""
    texts = values.tolist()
    whole = "".join(texts).encode("utf-8", "backslashreplace")
    lengths = np.fromiter(map(len, texts), np.int64, len(texts))
    if int(lengths.sum()) != len(whole):
        lengths = np.fromiter((len(text.encode("utf-8", "backslashreplace")) for text in texts), np.int64, len(texts))
    return whole, np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths)])
