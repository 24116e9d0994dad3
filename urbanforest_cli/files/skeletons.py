"""Skeletons in Parquet: one row a node, one row group a batch, some 5 bytes an internode.

`skeleton_format.py` says what the columns mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, LimitError, OutputError, SchemaError
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.skeleton import Skeletons, concatenate, quantise, select
from urbanforest_cli.files.skeleton_format import (
    COLUMNS,
    NEXT_STEP,
    NODES_MAX,
    TEXTS,
    as_table,
    new_writer,
    opened,
    read_columns,
    read_group,
    readable,
    record_of,
)


def write_part(
    path: Path,
    batches: Iterable[Skeletons],
    metadata: Mapping[str, object],
    *,
    texts: Mapping[str, Mapping[int, str]] | None = None,
) -> None:
    """Write batches of skeletons, one row group each, in the order given; equal content is equal bytes.

    What is written is `quantise` of each batch. A batch is held in memory one at a time.

    Parameters
    ----------
    metadata
        Provenance, kept as JSON in the file.
    texts
        Columns ``plant_id`` and ``species``, text by skeleton_id; nothing where an id has none.

    Raises
    ------
    SchemaError
        A batch breaks the requirements of skeletons, or an id comes twice.
    LimitError
        A batch is too large.
    """
    texts = texts or {}
    columns = COLUMNS | {name: TEXTS[name] for name in texts}
    written: list[int] = []
    seen: NDArray[np.int64] = np.zeros(0, np.int64)

    def verify(part: Path) -> None:
        counts = _row_counts(part)
        if counts != written:
            raise OutputError(
                "skeletons were not written whole",
                where=path,
                found=f"{sum(counts)} nodes in {len(counts)} row groups",
                expected=f"{sum(written)} nodes in {len(written)} row groups",
                next_step="check the disk, then run the same command again",
            )

    with publish(path, verify=verify) as part, new_writer(part, columns, metadata) as writer:
        for batch in batches:
            batch.check(where=path)
            if len(batch.parent) > NODES_MAX:
                raise LimitError(
                    "too many nodes in a batch", where=path, found=len(batch.parent), expected=f"at most {NODES_MAX}"
                )
            both = np.concatenate([seen, batch.skeleton_id])
            seen = np.unique(both)
            if len(seen) < len(both):
                raise SchemaError("skeleton_id repeats over batches", where=path, found=_repeated(both))
            table = as_table(quantise(batch), texts, writer.schema)
            writer.write_table(table, row_group_size=max(1, len(table)))
            written.append(len(table))


def part_paths(source: Path | Sequence[Path]) -> list[Path]:
    """Return the parts of a folder by name; a file, or files in a row, as they are.

    Raises
    ------
    InputError
        There is no such file, or no part in the folder.
    """
    if not isinstance(source, Path):
        return list(source)
    if not source.is_dir():
        return [source]
    if paths := sorted(source.glob("*.parquet")):
        return paths
    raise InputError("no skeletons in the folder", where=source, next_step=NEXT_STEP)


def iterate_batches(
    source: Path | Sequence[Path],
    *,
    skeleton_ids: Iterable[int] | NDArray[np.integer] | None = None,
    row_groups: Mapping[str, Sequence[int]] | None = None,
) -> Iterator[tuple[str, int, Skeletons]]:
    """Yield each part's name, row group and skeletons, one row group in memory at a time.

    Parameters
    ----------
    source
        A folder of parts, a part, or several.
    skeleton_ids
        Only these; row groups without any are neither read nor yielded.
    row_groups
        Only these row groups of the parts named; parts not named are not opened.

    Raises
    ------
    InputError
        A file is not there.
    SchemaError
        A file is torn, changed, or somebody else's.
    """
    wanted = None if skeleton_ids is None else np.unique(np.asarray(list(skeleton_ids), np.int64))
    for path in part_paths(source):
        if row_groups is not None and path.name not in row_groups:
            continue
        with opened(path) as part:
            groups = range(part.num_row_groups) if row_groups is None else row_groups[path.name]
            for group in groups:
                if wanted is not None and not _may_hold(part, group, wanted, path):
                    continue
                skeletons = read_group(part, group, path)
                if wanted is not None:
                    skeletons = select(skeletons, np.flatnonzero(np.isin(skeletons.skeleton_id, wanted)))
                if wanted is None or len(skeletons):
                    yield path.name, group, skeletons


def read_parts(
    source: Path | Sequence[Path],
    *,
    skeleton_ids: Sequence[int] | NDArray[np.integer] | None = None,
    row_groups: Mapping[str, Sequence[int]] | None = None,
) -> Skeletons:
    """Read skeletons: all, or those with these ids in their order, or those of some row groups.

    See `iterate_batches`, which does the same a row group at a time.

    Raises
    ------
    SchemaError
        An id is not there, or stands there twice.
    """
    where = part_paths(source)[0].parent if isinstance(source, Path) and source.is_dir() else source
    found = concatenate(
        [batch for _, _, batch in iterate_batches(source, skeleton_ids=skeleton_ids, row_groups=row_groups)]
    )
    if len(np.unique(found.skeleton_id)) < len(found):
        raise SchemaError("skeleton_id repeats", where=where, found=_repeated(found.skeleton_id), next_step=NEXT_STEP)
    if skeleton_ids is None:
        return found
    wanted = np.asarray(skeleton_ids, np.int64)
    missing = np.setdiff1d(wanted, found.skeleton_id)
    if len(missing):
        raise SchemaError(
            f"{len(missing)} skeletons are missing",
            where=where,
            found=f"no skeleton_id {', '.join(map(str, missing[:5]))}",
            next_step=NEXT_STEP,
        )
    by_id = np.argsort(found.skeleton_id)
    return select(found, by_id[np.searchsorted(found.skeleton_id, wanted, sorter=by_id)])


def read_texts(source: Path | Sequence[Path], name: str) -> dict[int, str]:
    """Return a text column, ``plant_id`` or ``species``, by skeleton_id; empty where the parts carry none."""
    texts: dict[int, str] = {}
    for path in part_paths(source):
        with opened(path) as part:
            if name not in part.schema_arrow.names:
                continue
            for group in range(part.num_row_groups):
                table = read_columns(
                    part, group, path, {n: (COLUMNS | TEXTS)[n] for n in ("skeleton_id", "node", name)}
                )
                roots = np.flatnonzero(table["node"].to_numpy() == 0)
                texts |= {
                    number: text
                    for number, text in zip(
                        table["skeleton_id"].to_numpy()[roots].tolist(),
                        table[name].take(pa.array(roots)).to_pylist(),
                        strict=True,
                    )
                    if text is not None
                }
    return texts


def read_provenance(path: Path) -> dict[str, Any]:
    """Return the metadata that `write_part` was given, without reading any skeleton.

    Raises
    ------
    InputError, SchemaError
        There is no such file, or it is torn or somebody else's.
    """
    with opened(path) as part:
        return dict(record_of(part, path)["provenance"])


def describe(path: Path) -> dict[str, object]:
    """Return what a part holds and where it comes from, without reading its shapes."""
    internodes = lost = plants = 0
    oldest = 0
    with opened(path) as part:
        record = record_of(part, path)
        for group in range(part.num_row_groups):
            table = read_columns(part, group, path, {n: COLUMNS[n] for n in ("node", "death_season", "seasons")})
            above = table["node"].to_numpy() > 0
            plants += int((~above).sum())
            internodes += int(above.sum())
            lost += int((table["death_season"].to_numpy()[above] > 0).sum())
            oldest = max(oldest, int(table["seasons"].to_numpy().max(initial=0)))
        batches = part.num_row_groups
    species: dict[str, int] = {}
    for text in read_texts(path, "species").values():
        species[text] = species.get(text, 0) + 1
    size = path.stat().st_size
    return {
        "file": path.name,
        "format": f"{record['format']}, version {record['format_version']}",
        "program_version": record.get("program_version"),
        "skeletons": plants,
        "species": dict(sorted(species.items())),
        "internodes": internodes,
        "lost_internodes": lost,
        "seasons": oldest,
        "row_groups": batches,
        "bytes": size,
        "bytes_an_internode": round(size / max(1, internodes), 2),
        "provenance": {k: v for k, v in record["provenance"].items() if not isinstance(v, list | dict)},
        "how_to_read": record.get("how_to_read"),
    }


def _may_hold(part: pq.ParquetFile, group: int, wanted: NDArray[np.int64], path: Path) -> bool:
    """Tell whether a row group may hold one of these ids, by the range in its statistics, then by the ids alone."""
    column = part.schema_arrow.names.index("skeleton_id") if "skeleton_id" in part.schema_arrow.names else -1
    if column < 0:
        return True  # reading it says what is missing
    statistics = part.metadata.row_group(group).column(column).statistics
    if statistics is not None and statistics.has_min_max:
        place = np.searchsorted(wanted, statistics.min)
        if place == len(wanted) or wanted[place] > statistics.max:
            return False
    ids = read_columns(part, group, path, {"skeleton_id": COLUMNS["skeleton_id"]})["skeleton_id"].to_numpy()
    return bool(np.isin(wanted, ids).any())


def _row_counts(path: Path) -> list[int]:
    with readable(path):
        found = pq.read_metadata(path)
    return [found.row_group(group).num_rows for group in range(found.num_row_groups)]


def _repeated(ids: NDArray[np.int64]) -> str:
    values, counts = np.unique(ids, return_counts=True)
    return ", ".join(map(str, values[counts > 1][:5]))
