"""``exports.json``: what a folder of outputs holds, what decided it, and the hash of every file.

It is written after the outputs it names, so that it never vouches for what is not there. What it says is input like any
other: names that lead out of the folder, torn text and fields of a wrong kind are faults to tell, never paths to open.
"""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from urbanforest_cli import __version__
from urbanforest_cli.core.publish import publish, sha256_of, write_text

MANIFEST = "exports.json"
TORN = "exports.json.torn"
MANIFEST_VERSION = 1
SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class FileState:
    """A file as it was written."""

    sha256: str
    bytes: int


@dataclass(frozen=True)
class Export:
    """One output: a file, or a folder of files.

    Parameters
    ----------
    name
        Of the file or folder in the folder of outputs.
    format
        As ``urbanforest export --to`` calls it.
    key
        Text that decides the content.
    growth
        Stage key of the growth it shows, as the register's record of `grow` states it; empty where that is no matter.
    options
        As asked for, plain values: detail, bbox, year and the like.
    files
        What was written, by path from the folder of outputs: ``{"forest.glb": ...}`` for a file, with what describes it
        beside it if there is such (``itree.csv-metadata.json``); ``{"tiles/tileset.json": ..., ...}`` for a folder.
    """

    name: str
    format: str
    key: str
    growth: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, FileState] = field(default_factory=dict)

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return self.name not in self.files


def describe_files(path: Path, *beside: Path) -> dict[str, FileState]:
    """Hash a file and those that belong to it beside it, or all files of a folder and of those in it.

    Returns
    -------
    Hashes and sizes by path from the folder that holds `path`, as `Export` takes them.
    """
    names = {file.name: file for file in (path, *beside)} if path.is_file() else dict(sorted(_files_in(path)))
    return {name: FileState(sha256_of(file), file.stat().st_size) for name, file in names.items()}


def read_manifest(out: Path) -> dict[str, Export]:
    """Return the outputs that the manifest of a folder names; of one that is torn, those that can be read."""
    return _read(out)[0]


def manifest_faults(out: Path) -> list[str]:
    """Return what is wrong with a folder's manifest itself; nothing where there is none."""
    return _read(out)[1]


def record_exports(out: Path, exports: Iterable[Export], remove: Iterable[str] = ()) -> None:
    """Publish a manifest that names these outputs beside those it named before.

    One that is torn is kept aside as `TORN`, since the hashes of other outputs may stand in it.

    Parameters
    ----------
    exports
        Written, and in place; one that was named before is replaced.
    remove
        Names of outputs that are no more.

    Raises
    ------
    OutputError
        It could not be written.
    """
    gone = set(remove)
    before, faults = _read(out)
    if faults and (out / MANIFEST).is_file():
        with publish(out / TORN) as part:
            shutil.copyfile(out / MANIFEST, part)
        logging.getLogger(__name__).warning("%s was torn, and is kept as %s: %s", MANIFEST, TORN, "; ".join(faults))
    merged = {name: export for name, export in before.items() if name not in gone}
    merged |= {export.name: export for export in exports}
    content = {
        "manifest_version": MANIFEST_VERSION,
        "program": "urbanforest",
        "program_version": __version__,
        "exports": [_as_record(merged[name]) for name in sorted(merged)],
    }
    write_text(out / MANIFEST, json.dumps(content, indent=1, ensure_ascii=True, allow_nan=False) + "\n")


def faults_of(out: Path, export: Export) -> list[str]:
    """Return in words how an output differs from what was written: files missing, cut, changed, and strays."""
    faults = [fault for name, state in export.files.items() if (fault := _fault(out, name, state))]
    if export.is_folder:
        strays = sorted({name for name, _ in _files_in(out / export.name)} - set(export.files))
        faults += [f"{name} was not written with the others" for name in strays]
    return faults


def is_intact(out: Path, export: Export) -> bool:
    """Tell whether an output is as it was written."""
    return bool(export.files) and not faults_of(out, export)


def _fault(out: Path, name: str, state: FileState) -> str | None:
    path = out / name
    try:
        found = path.lstat() if "/" in name else path.stat()  # an output may be a link, what it holds may not
        if not stat.S_ISREG(found.st_mode):
            return f"{name} is no file"
        if found.st_size < state.bytes:
            return f"{name} is cut, {found.st_size} of {state.bytes} bytes"
        if found.st_size > state.bytes:
            return f"{name} has {found.st_size} bytes, {state.bytes} were written"
        if sha256_of(path) != state.sha256:
            return f"{name} was changed since it was written"
    except FileNotFoundError:
        return f"{name} is missing"
    except (OSError, ValueError) as error:
        return f"{name} cannot be read: {getattr(error, 'strerror', None) or error}"
    return None


def _files_in(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield what a folder and those in it hold, links to folders as well, by path from where it stands."""
    for place, folders, names in os.walk(folder):
        for name in (*names, *(name for name in folders if os.path.islink(os.path.join(place, name)))):
            path = Path(place, name)
            yield path.relative_to(folder.parent).as_posix(), path


def _as_record(export: Export) -> dict[str, object]:
    return {
        "name": export.name,
        "format": export.format,
        "key": export.key,
        "growth": export.growth,
        "options": dict(export.options),
        "files": {name: {"sha256": state.sha256, "bytes": state.bytes} for name, state in sorted(export.files.items())},
    }


def _read(out: Path) -> tuple[dict[str, Export], list[str]]:
    try:
        content = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, []
    except (OSError, ValueError, RecursionError) as error:
        return {}, [f"{MANIFEST} cannot be read: {error}"]
    if not isinstance(content, dict) or not isinstance(content.get("exports"), list):
        return {}, [f"{MANIFEST} is not a list of outputs"]
    if content.get("manifest_version") != MANIFEST_VERSION:
        return {}, [f"{MANIFEST} was written by another version"]
    exports: dict[str, Export] = {}
    faults = []
    for number, record in enumerate(content["exports"]):
        try:
            export = _export_of(record)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            faults.append(f"{MANIFEST}, output {number + 1}: {error}")
            continue
        if export.name in exports:
            faults.append(f"{MANIFEST}, output {number + 1}: {export.name!r} is named twice")
        exports.setdefault(export.name, export)
    return exports, faults


def _export_of(record: Any) -> Export:
    name = _text(record["name"], "name")
    if not _is_safe(name) or "/" in name:
        raise ValueError(f"{name!r} is no name of an output")
    if not isinstance(record["options"], dict) or not isinstance(record["files"], dict):
        raise TypeError("options or files are not what they should be")
    files = {}
    for path, state in record["files"].items():
        if not _is_safe(path) or not (path.startswith(f"{name}/") or (path.startswith(name) and "/" not in path)):
            raise ValueError(f"{path!r} does not lie in {name!r}")
        sha256, size = _text(state["sha256"], "sha256"), state["bytes"]
        if not SHA256.fullmatch(sha256) or type(size) is not int or size < 0:
            raise ValueError(f"no hash and size of {path!r}")
        files[path] = FileState(sha256, size)
    if name in files and any("/" in path for path in files):
        raise ValueError(f"{name!r} cannot be both a file and a folder")
    return Export(
        name=name,
        format=_text(record["format"], "format"),
        key=_text(record["key"], "key"),
        growth=_text(record["growth"], "growth"),
        options=record["options"],
        files=files,
    )


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{what} is no text")
    return value


def _is_safe(path: str) -> bool:
    """Tell whether a path stays in its folder, in the one spelling it has."""
    parts = path.split("/")
    return "\0" not in path and all(part not in ("", ".", "..") for part in parts)
