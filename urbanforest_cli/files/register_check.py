"""Whether a register, or another GeoPackage, is whole: its pages, its layers' counts, the skeletons it names."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from urbanforest_cli.core.errors import UrbanForestError
from urbanforest_cli.core.schema import LAYERS
from urbanforest_cli.files.geopackage import check_counts, layer_names, read_layer, row_count
from urbanforest_cli.files.skeleton_parts import LAYER, named_parts, parts_folder

EMPTY_FLAG = 0x10
"""Of the fourth byte of a shape in a GeoPackage."""


def register_faults(register: Path) -> list[str]:
    """Return in words where a register is damaged, or its rows, cached counts, spatial index and skeletons disagree.

    Raises
    ------
    sqlite3.Error
        It is damaged so that nothing can be said.
    """
    faults = geopackage_faults(register)
    for name in layer_names(register) if not faults else ():
        try:
            if name in LAYERS:
                read_layer(register, name)
        except UrbanForestError as error:
            faults.append(f"layer {name!r}: {error.found}")
    return faults + skeleton_faults(register)


def geopackage_faults(path: Path) -> list[str]:
    """Return in words where a GeoPackage is damaged, or rows, cached counts and spatial index of its layers disagree.

    Raises
    ------
    sqlite3.Error
        It is damaged so that nothing can be said.
    """
    with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)) as database:
        page, pages = (database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count"))
        if path.stat().st_size < page * pages:
            return [f"the database is cut, {path.stat().st_size} of {page * pages} bytes"]
        state = database.execute("PRAGMA quick_check(1)").fetchone()[0]
        if state != "ok":
            return [f"the database is damaged: {' '.join(str(state).split())}"]
        contents = [row[0] for row in database.execute("SELECT table_name FROM gpkg_contents")]
        blanks = {name: _blank_count(database, name) for name in contents}
    faults = []
    for name, blank in blanks.items():
        try:
            check_counts(path, {name: (row_count(path, name), blank)})
        except UrbanForestError as error:
            faults.append(f"layer {name!r}: {error.found}")
    return faults


def _blank_count(database: sqlite3.Connection, layer: str) -> int:
    """Count the rows of a layer without a shape: none at all, or one whose header says that it is empty."""
    found = database.execute("SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?", (layer,)).fetchone()
    if found is None:
        return 0
    column, table = ('"' + name.replace('"', '""') + '"' for name in (found[0], layer))
    flags = database.execute(f"SELECT substr({column}, 4, 1) FROM {table}")
    return sum(not flag or bool(flag[0] & EMPTY_FLAG) for (flag,) in flags)


def skeleton_faults(register: Path) -> list[str]:
    """Return in words which parts of a register's skeletons are missing or were changed, or are no parts at all."""
    parts, folder = named_parts(register), parts_folder(register)
    faults = [
        f"{folder.name}/{name} is missing or was changed" for name, part in parts.items() if not part.is_in(folder)
    ]
    if len(parts) != row_count(register, LAYER):
        faults.append(f"layer {LAYER!r} names files that are no parts of skeletons")
    return faults


def part_faults(register: Path, part: Path) -> list[str]:
    """Return in words what is wrong with one part of a register's skeletons."""
    known = named_parts(register).get(part.name)
    if known is None:
        return [f"{part.name} is no part that the register names"]
    return [] if known.is_in(part.parent) else [f"{part.name} was changed"]
