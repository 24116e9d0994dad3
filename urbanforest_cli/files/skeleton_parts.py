"""The parts of ``skeletons/``: which belong to a register, and how they come and go without a torn moment.

A part's name holds a digest of all that decided its content, so that an old and a new one never have the same name. The
register names those in force, with their hashes; new ones are there before the register that names them, and those it
names no longer go only after it.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

from urbanforest_cli.core.errors import SchemaError, UrbanForestError
from urbanforest_cli.core.publish import output_error, publish, sha256_of, sync_file, sync_folder
from urbanforest_cli.core.skeleton import Skeletons, select
from urbanforest_cli.files.geopackage import layer_names, read_layer, row_count
from urbanforest_cli.files.skeletons import iterate_batches, read_parts, read_provenance

FOLDER = "skeletons"
LAYER = "skeleton_parts"
PART_NAME = re.compile(r"part-[0-9a-f]{24}\.parquet")


@dataclass(frozen=True)
class PartFile:
    """A part as a register knows it."""

    name: str
    sha256: str
    bytes: int

    def is_in(self, folder: Path) -> bool:
        """Tell whether the very file is in a folder."""
        return is_intact(folder / self.name, self.sha256, self.bytes)


def part_name(digest: str) -> str:
    """Return the name of the part with a digest of 24 hexadecimal digits."""
    return f"part-{digest}.parquet"


def parts_folder(register: Path) -> Path:
    """Return the folder with a register's skeletons: beside it."""
    return register.parent / FOLDER


def named_parts(register: Path) -> dict[str, PartFile]:
    """Return the parts that a register names; none where there is no register or nothing has grown."""
    try:
        if not register.is_file() or LAYER not in layer_names(register):
            return {}
        table = read_layer(register, LAYER, geometry=False)
    except (UrbanForestError, RuntimeError):  # half-written or foreign: it names nothing
        return {}
    rows = zip(table["part"], table["sha256"], table["bytes"], strict=True)
    return {name: PartFile(name, sha, int(size)) for name, sha, size in rows if PART_NAME.fullmatch(name)}


def parts_are_there(register: Path) -> bool:
    """Tell whether every part that a register names is beside it and unchanged."""
    parts = named_parts(register)
    folder = parts_folder(register)
    whole = len(parts) == row_count(register, LAYER)
    return whole and all(part.is_in(folder) for part in parts.values())


def is_intact(path: Path, sha256: str, size: int) -> bool:
    """Tell whether a file is there with this size and hash."""
    try:
        state = path.stat()
        return state.st_size == size and _hash_of(path, size, state.st_mtime_ns, state.st_ino) == sha256
    except OSError:
        return False


@lru_cache(maxsize=100_000)
def _hash_of(path: Path, size: int, changed: int, inode: int) -> str:
    """Return a file's hash, once as long as nothing tells that it changed."""
    return sha256_of(path)


def hash_of(path: Path) -> str:
    """Return the hash of a part."""
    state = path.stat()
    return _hash_of(path, state.st_size, state.st_mtime_ns, state.st_ino)


def take_part(source: Path, target: Path) -> None:
    """Put a part under another name, as a second link to the same file where the file system has such."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        os.link(source, target)
    except OSError:
        with publish(target) as part:
            shutil.copyfile(source, part)


def link_parts(register: Path, copy: Path) -> None:
    """Put the parts that a register names beside a copy of it."""
    for name in named_parts(register):
        take_part(parts_folder(register) / name, parts_folder(copy) / name)


def move_parts(register: Path, folder: Path) -> None:
    """Move the parts that a register names from beside it to a folder; those that are there already stay.

    The register itself is to follow: until then the folder holds what both the old and the new one name.
    """
    parts = named_parts(register)
    if not parts:
        return
    source = parts_folder(register)
    try:
        folder.mkdir(exist_ok=True)
        for part in parts.values():
            if not part.is_in(folder):
                sync_file(source / part.name)
                os.replace(source / part.name, folder / part.name)
        sync_folder(folder)
    except OSError as error:
        raise output_error(folder, error) from error


def remove_strays(register: Path) -> None:
    """Remove the parts beside a register that it does not name: those of earlier runs, and of killed ones.

    A register that has grown nothing leaves them: they are what the next growth may use again.
    """
    if not register.is_file() or LAYER not in layer_names(register):
        return
    named = named_parts(register)
    folder = parts_folder(register)
    for path in parts_in(folder):
        if path.name not in named:
            path.unlink(missing_ok=True)
    if not named:
        with contextlib.suppress(OSError):  # not there, or something of the user's own is in it
            folder.rmdir()


def parts_in(folder: Path) -> list[Path]:
    """Return all parts in a folder, whoever names them."""
    names: Iterable[Path] = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in names if PART_NAME.fullmatch(path.name) and path.is_file())


@dataclass(frozen=True)
class StoredGrove:
    """Where the skeletons of a grove lie: file, row group, and their places among all skeletons of the file."""

    path: Path
    row_group: int
    places: slice
    ids: tuple[int, ...]


class GroveStore:
    """Groves of earlier runs by the hash of what decided them, to be taken instead of growing them again.

    Parts that a register names must be as it knows them; others, of a killed run, are taken by their own word. A part
    that cannot be read is none.
    """

    def __init__(self, registers: Iterable[Path]) -> None:
        self._groves: dict[str, StoredGrove] = {}
        self._records: dict[Path, dict[str, Any]] = {}
        self._held: tuple[tuple[Path, int], Skeletons] | None = None
        self._lock = Lock()
        registers = list(registers)
        named: dict[str, PartFile] = {}
        for register in registers:
            named |= named_parts(register)
        for register in registers:
            folder = parts_folder(register)
            for path in parts_in(folder):
                if path.name not in named or named[path.name].is_in(folder):
                    self._add(path)
        self._named = frozenset(named)
        self._changed = set(named) - {path.name for path in self._records}

    @property
    def changed(self) -> list[str]:
        """Parts that are not what a register, or they themselves, say."""
        return sorted(self._changed)

    def distrust(self, path: Path) -> None:
        """Take nothing more from a part that turned out to be broken."""
        with self._lock:
            self._changed.add(path.name)
            self._records.pop(path, None)
            self._groves = {key: grove for key, grove in self._groves.items() if grove.path != path}

    def _add(self, path: Path) -> None:
        try:
            record = read_provenance(path)
            ids = [int(number) for number in record["plants"]["skeleton_id"]]
            start = 0
            for grove in record["groves"]:
                places = slice(start, start + int(grove["plant_count"]))
                stored = StoredGrove(path, int(grove["row_group"]), places, tuple(ids[places]))
                self._groves.setdefault(str(grove["grow_key"]), stored)
                start = places.stop
        except (UrbanForestError, KeyError, TypeError, ValueError):
            return
        self._records[path] = record

    def __contains__(self, grow_key: object) -> bool:
        return grow_key in self._groves

    def part(self, name: str) -> Path | None:
        """Return where a part of this name lies, None where there is none or it is broken."""
        path = next((path for path in self._records if path.name == name), None)
        if path is None or name in self._named:  # one that is named is known by its hash
            return path
        try:
            for _ in iterate_batches(path):
                pass
        except UrbanForestError:
            self.distrust(path)
            return None
        return path

    def plants(self, grove: StoredGrove) -> dict[str, Any]:
        """Return what is written of a grove's plants beside their skeletons: columns by name."""
        columns = self._records.get(grove.path, {}).get("plants", {})
        return {name: values[grove.places] for name, values in columns.items() if isinstance(values, list)}

    def find(self, grow_key: str) -> StoredGrove | None:
        """Return where a grove lies, None where it is not stored."""
        return self._groves.get(grow_key)

    def skeletons(self, grove: StoredGrove) -> Skeletons:
        """Read the skeletons of a grove; the row group read last is held for the next grove in it.

        Raises
        ------
        SchemaError
            The part is not what it says.
        """
        with self._lock:
            place = grove.path, grove.row_group
            if self._held is None or self._held[0] != place:
                self._held = place, read_parts(grove.path, row_groups={grove.path.name: [grove.row_group]})
            held = self._held[1]
        where = {int(number): row for row, number in enumerate(held.skeleton_id)}
        if not set(grove.ids) <= set(where):
            raise SchemaError("skeletons are missing", where=grove.path, next_step="remove it and grow again")
        return select(held, [where[number] for number in grove.ids])
