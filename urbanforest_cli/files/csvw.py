"""CSV tables with a description beside them, as W3C's "CSV on the Web" has it: units, what columns mean, provenance.

A CSV has no room for any of that, and programs that take tables in choke on comments; so the description lies beside
the table as ``NAME.csv-metadata.json``, and states the table's SHA-256, by which a mixed-up pair is found out.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.publish import sha256_of, write_text

CONTEXT = "http://www.w3.org/ns/csvw"
OWN = "urbanforest"
CELL_MAX = 1 << 20  # letters of a cell


def description_path(table: Path) -> Path:
    """Return where a table's description lies."""
    return table.with_name(table.name + "-metadata.json")


def write_table(path: Path, frame: pd.DataFrame, decimals: Mapping[str, int]) -> None:
    """Write a table; numbers are given the digits after the point that `decimals` names for their column.

    Missing and infinite numbers are left empty.

    Raises
    ------
    OutputError
        The table was not written whole.
    """
    texts = {
        name: _fixed(frame[name].to_numpy(dtype=np.float64), decimals[name])
        if name in decimals
        else frame[name].to_numpy(dtype=object)
        for name in frame.columns
    }
    # The line ends of RFC 4180; with any other, a cell that holds but one half of them would not be quoted.
    text = pd.DataFrame(texts, columns=frame.columns).to_csv(index=False, lineterminator="\r\n")
    encoded = text.encode("utf-8", "backslashreplace")
    path.write_bytes(encoded)
    if path.stat().st_size != len(encoded):
        raise OutputError("the table was not written whole", where=path, next_step="check the disk and run again")


def _fixed(values: NDArray[np.float64], decimals: int) -> list[str]:
    form = f"%.{decimals}f"
    rounded = np.round(values, decimals) + 0.0  # no negative zero
    return [form % value if np.isfinite(value) else "" for value in rounded.tolist()]


def write_description(
    path: Path,
    *,
    columns: Mapping[str, tuple[str, str]],
    about: Mapping[str, Any],
    table: Path | None = None,
    key: str | None = None,
) -> None:
    """Publish the description of a table.

    Parameters
    ----------
    path
        The table.
    columns
        For each column its type of XML Schema ("string", "decimal", "integer", "boolean") and what it means.
    about
        What the program says of the table: its provenance, its CRS.
    table
        Where the table lies now, if not at `path` yet.
    key
        Column whose values are unique.
    """
    schema: dict[str, Any] = {
        "columns": [
            {"titles": name, "name": f"column_{number}", "datatype": kind, "dc:description": doc}
            for number, (name, (kind, doc)) in enumerate(columns.items(), 1)
        ]
    }
    if key is not None:
        schema["primaryKey"] = f"column_{list(columns).index(key) + 1}"
    content = {
        "@context": [CONTEXT, {"@language": "en"}],
        "url": path.name,
        "dialect": {"encoding": "utf-8", "header": True, "delimiter": ","},
        "tableSchema": schema,
        "dc:identifier": sha256_of(table or path),
        OWN: dict(about),
    }
    write_text(description_path(path), json.dumps(content, ensure_ascii=False, indent=1) + "\n")


def read_table(path: Path, columns: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    """Read columns of a table.

    Parameters
    ----------
    columns
        For each column wanted "text" or "number".

    Raises
    ------
    InputError
        It is not there, is no CSV, or lacks a column or a value.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            csv.field_size_limit(CELL_MAX)
            rows = csv.reader(stream, strict=True)
            header = next(rows, [])
            if missing := [name for name in columns if name not in header]:
                raise _wrong(path, f"no column {', '.join(repr(name) for name in missing)}")
            places = [header.index(name) for name in columns]
            found: list[list[str]] = []
            for number, row in enumerate(rows, 2):
                if len(row) != len(header):
                    raise _wrong(path, f"{len(row)} cells in row {number}, {len(header)} in the header")
                found.append([row[place] for place in places])
    except OSError as error:
        raise _wrong(path, error.strerror or str(error)) from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise _wrong(path, str(error)) from error
    texts = np.array(found, dtype=object).reshape(len(found), len(columns))
    values: dict[str, NDArray[Any]] = {}
    for place, (name, kind) in enumerate(columns.items()):
        if kind == "text":
            values[name] = texts[:, place]
            continue
        try:
            values[name] = texts[:, place].astype(np.float64)
        except ValueError as error:
            raise _wrong(path, f"column {name!r}: {error}") from error
    return values


def read_description(path: Path) -> dict[str, Any] | None:
    """Read what the program said of a table; None where no description lies beside it, or not one of this program.

    Raises
    ------
    InputError
        The description is no JSON, or was made for another table.
    """
    beside = description_path(path)
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _wrong(beside, error.strerror or str(error)) from error
    except (ValueError, RecursionError) as error:
        raise _wrong(beside, str(error)) from error
    about = content.get(OWN) if isinstance(content, dict) else None
    if not isinstance(about, dict):
        return None
    if not path.is_file() or content.get("dc:identifier") != sha256_of(path):
        raise InputError(
            "the table is not the one that this describes",
            where=beside,
            found=f"another SHA-256 than that of {path.name}",
            next_step="run `urbanforest export` again",
        )
    return about


def _wrong(path: Path, found: str) -> InputError:
    return InputError(
        "not a table of urbanforest, or not a whole one", where=path, found=found,
        next_step="run `urbanforest export` again",
    )  # fmt: skip
