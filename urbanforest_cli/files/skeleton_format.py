"""The format of skeletons in Parquet: columns, what they mean, and how a row group is told from a bad one.

Any Parquet reader can use the files: every row carries what its plant has for all its nodes, since what repeats takes
no room, and `HOW_TO_READ` stands in each file's metadata under the key ``urbanforest``. Within a row group skeletons
follow each other whole, each with its root first and depth first after it, every axis whole before its branches, so
that neighbouring rows differ little.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from urbanforest_cli import __version__
from urbanforest_cli.core.errors import InputError, SchemaError
from urbanforest_cli.core.skeleton import POSITION_STEP_M, Skeletons, metres, pipe_count, steps

FORMAT = "urbanforest skeletons"
FORMAT_VERSION = 1
METADATA_KEY = b"urbanforest"
NODES_MAX = 1 << 24  # in a row group: more is no batch of plants, and is refused before it is read
COMPRESSION_LEVEL = 6
NEXT_STEP = "grow the plants again with `urbanforest grow`"
HOW_TO_READ = (
    "One row a node: the upper end of an internode whose lower end is the node's parent; node 0 of each skeleton_id is "
    "the root collar at (0, 0, 0). parent = node - parent_back within the skeleton (-1 for the root). "
    f"x_m = {POSITION_STEP_M} * x_5mm and so for y (north) and z (up), relative to the root. "
    "radius_m = tip_radius_m * pipes ^ (1 / pipe_exponent), where pipes counts the twig ends at or above the node that "
    "ever were (lost wood included): the larger of 1 and the sum over children. Seasons count from planting; "
    "death_season 0 means alive. What stood k seasons before the last: birth_season <= seasons - k and "
    "(death_season = 0 or death_season > seasons - k)."
)


class Column(NamedTuple):
    """A column's type, its encoding (a dictionary where None) and what it means."""

    type: Any
    encoding: str | None
    doc: str


DELTA = "DELTA_BINARY_PACKED"
COLUMNS = {
    "skeleton_id": Column(pa.int64(), None, "plant's skeleton; unique in a folder of parts"),
    "node": Column(pa.int32(), DELTA, "number within the skeleton, 0 the root"),
    "parent_back": Column(pa.int32(), None, "nodes back to the parent: parent = node - parent_back; 1 at the root"),
    "x_5mm": Column(pa.int16(), DELTA, "east of the root, steps of 5 mm"),
    "y_5mm": Column(pa.int16(), DELTA, "north of the root, steps of 5 mm"),
    "z_5mm": Column(pa.int16(), DELTA, "above the root, steps of 5 mm"),
    "pipes": Column(pa.int32(), None, "twig ends at or above, lost ones included; gives the radius"),
    "order": Column(pa.uint8(), None, "branching order, 0 trunk or stem"),
    "birth_season": Column(pa.uint8(), DELTA, "season of the plant in which the internode grew, 0 the root"),
    "death_season": Column(pa.uint8(), None, "season in which it was lost, 0 alive"),
    "seasons": Column(pa.uint8(), None, "seasons the plant lived through; the same in all rows of a skeleton"),
    "tip_radius_m": Column(pa.float64(), None, "radius of a twig's end; the same in all rows of a skeleton"),
    "pipe_exponent": Column(pa.float64(), None, "n of da Vinci's rule; the same in all rows of a skeleton"),
}
TEXTS = {
    "plant_id": Column(pa.string(), None, "the plant of the register whose skeleton it is"),
    "species": Column(pa.string(), None, "its species"),
}


def new_writer(part: Path, columns: Mapping[str, Column], metadata: Mapping[str, object]) -> pq.ParquetWriter:
    """Open a file for row groups of these columns and write its record into it."""
    record = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "program_version": __version__,
        "how_to_read": HOW_TO_READ,
        "position_step_m": POSITION_STEP_M,
        "columns": {name: column.doc for name, column in columns.items()},
        "provenance": dict(metadata),
    }
    text = json.dumps(record, ensure_ascii=False, sort_keys=True)
    writer = pq.ParquetWriter(
        part,
        pa.schema([(name, column.type) for name, column in columns.items()]),
        compression="zstd",
        compression_level=COMPRESSION_LEVEL,
        use_dictionary=[name for name, column in columns.items() if column.encoding is None],
        column_encoding={name: column.encoding for name, column in columns.items() if column.encoding},
        write_statistics=["skeleton_id"],
        write_page_checksum=True,
        store_schema=False,  # it would hold the record a second time
        version="2.6",
    )
    writer.add_key_value_metadata({METADATA_KEY: text.encode()})
    return writer


def as_table(skeletons: Skeletons, texts: Mapping[str, Mapping[int, str]], schema: pa.Schema) -> pa.Table:
    """Return skeletons, already on the grid and depth first, as a file's columns."""
    counts = skeletons.node_counts()
    xyz = steps(skeletons.xyz_m)
    node = (np.arange(len(skeletons.parent)) - np.repeat(skeletons.first[:-1], counts)).astype(np.int32)
    arrays = {
        "skeleton_id": np.repeat(skeletons.skeleton_id, counts),
        "node": node,
        "parent_back": node - skeletons.parent,
        "x_5mm": xyz[:, 0],
        "y_5mm": xyz[:, 1],
        "z_5mm": xyz[:, 2],
        "pipes": pipe_count(skeletons),
        "order": skeletons.order,
        "birth_season": skeletons.birth_season,
        "death_season": skeletons.death_season,
        "seasons": np.repeat(skeletons.seasons.astype(np.uint8), counts),
        "tip_radius_m": np.repeat(skeletons.tip_radius_m, counts),
        "pipe_exponent": np.repeat(skeletons.pipe_exponent, counts),
    }
    for name, text in texts.items():
        values = pa.array([text.get(int(number)) for number in skeletons.skeleton_id], TEXTS[name].type)
        arrays[name] = values.take(pa.array(np.repeat(np.arange(len(values)), counts)))
    return pa.table([pa.array(arrays[name], schema.field(name).type) for name in schema.names], schema=schema)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a part; refuse what is not there, torn or somebody else's."""
    if not path.is_file():
        raise InputError("no such file", where=path, next_step=NEXT_STEP)
    with readable(path), pq.ParquetFile(path, page_checksum_verification=True) as part:
        record_of(part, path)
        yield part


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn what a Parquet reader says of a bad file into one message."""
    try:
        yield
    except PermissionError as error:
        raise InputError("the file cannot be read", where=path, found=error.strerror) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError, MemoryError) as error:
        raise SchemaError(
            "not a whole Parquet file",
            where=path,
            found=str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__,
            expected="a part written by urbanforest",
            next_step=NEXT_STEP,
        ) from error


def record_of(part: pq.ParquetFile, path: Path) -> dict[str, Any]:
    """Return the file's own description; refuse files of others and of other versions."""
    try:
        record = json.loads((part.metadata.metadata or {})[METADATA_KEY])
        name, version, provenance = record["format"], record["format_version"], record["provenance"]
    except (KeyError, ValueError, TypeError):
        name = version = provenance = None
    if name != FORMAT or not isinstance(provenance, dict):
        raise SchemaError(
            "not a file of skeletons",
            where=path,
            found="Parquet of another kind",
            expected="a part written by `urbanforest grow`",
        )
    if version != FORMAT_VERSION:
        raise SchemaError(
            "the skeletons were written by another version",
            where=path,
            found=f"format version {version}",
            expected=f"format version {FORMAT_VERSION}",
            next_step=NEXT_STEP,
        )
    return dict(record)


def read_columns(part: pq.ParquetFile, group: int, path: Path, columns: Mapping[str, Column]) -> pa.Table:
    """Read columns of a row group in their own types."""
    names = part.schema_arrow.names
    faults = [f"column {name!r} is missing" for name in columns if name not in names]
    faults += [f"column {name!r} comes twice" for name in columns if names.count(name) > 1]
    if not 0 <= group < part.num_row_groups:
        faults.append(f"row group {group} of {part.num_row_groups}")
    else:
        claimed = part.metadata.row_group(group).num_rows
        if not 0 <= claimed <= NODES_MAX:
            faults.append(f"row group {group} claims {claimed} nodes")
    if faults:
        raise _unfit(path, faults)
    with readable(path):
        table = part.read_row_group(group, columns=list(columns), use_threads=False)
    for name, column in columns.items():
        if table[name].null_count and name not in TEXTS:
            faults.append(f"column {name!r} is empty in {table[name].null_count} rows")
        if table[name].type != column.type:
            try:
                table = table.set_column(table.schema.get_field_index(name), name, table[name].cast(column.type))
            except pa.ArrowException:
                faults.append(f"column {name!r} is {table[name].type}, not {column.type}")
    if len(table) != claimed:
        faults.append(f"row group {group} holds {len(table)} nodes and claims {claimed}")
    if faults:
        raise _unfit(path, faults)
    return table


def read_group(part: pq.ParquetFile, group: int, path: Path) -> Skeletons:
    """Read the skeletons of a row group and check all that is asked of them, their pipes included."""
    table = read_columns(part, group, path, COLUMNS)
    values = {name: table[name].to_numpy() for name in COLUMNS}
    node = values["node"].astype(np.int64)
    roots = np.flatnonzero(node == 0)
    first = np.append(roots, len(node))
    counts = np.diff(first)
    faults = []
    if len(node) and (not len(roots) or roots[0] != 0):
        raise _unfit(path, [f"row group {group} does not start with a root"])
    if (node != np.arange(len(node)) - np.repeat(roots, counts)).any():
        faults.append("nodes of a skeleton are not numbered in a row")
    for name in ("skeleton_id", "seasons", "tip_radius_m", "pipe_exponent"):
        if (values[name] != np.repeat(values[name][roots], counts)).any():
            faults.append(f"{name} changes within a skeleton")
    parent = node - values["parent_back"]
    skeletons = Skeletons(
        skeleton_id=values["skeleton_id"][roots],
        first=first,
        seasons=values["seasons"][roots].astype(np.int32),
        tip_radius_m=values["tip_radius_m"][roots],
        pipe_exponent=values["pipe_exponent"][roots],
        parent=np.maximum(parent, -2).clip(max=NODES_MAX).astype(np.int32),  # what lies outside is told below
        xyz_m=metres(np.stack([values["x_5mm"], values["y_5mm"], values["z_5mm"]], axis=1)),
        order=values["order"],
        birth_season=values["birth_season"],
        death_season=values["death_season"],
    )
    faults += skeletons.faults()
    if not faults and (pipe_count(skeletons) != values["pipes"]).any():
        faults.append("pipes are not the sum over children")
    if faults:
        raise _unfit(path, faults)
    return skeletons


def _unfit(path: Path, faults: Sequence[str]) -> SchemaError:
    return SchemaError(
        "skeletons break their requirements", where=path, found="; ".join(faults[:10]), next_step=NEXT_STEP
    )
