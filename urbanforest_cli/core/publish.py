"""Every output appears whole under its name or not at all: write beside, verify, sync, rename."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from urbanforest_cli.core.errors import BusyError, OutputError

PART_PREFIX = ".urbanforest-part-"
REPLACED = ".urbanforest-replaced"
AT_FDCWD, RENAME_EXCHANGE = -100, 2


@contextlib.contextmanager
def publish(path: Path, *, verify: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Yield a path to write to, and rename it to `path` once it is verified and on disk.

    The temporary file lies in a hidden folder of its own beside the target and bears the target's name, since
    some formats store it. It is removed whatever happens.

    Raises
    ------
    OutputError
        The disk is full, the folder cannot be written, or `verify` found the file wanting.
    """
    path = Path(path)
    folder = path.parent / f"{PART_PREFIX}{os.getpid()}-{path.name}"
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            part = folder / path.name
            yield part
            if verify is not None:
                verify(part)
            sync_file(part)
            os.replace(part, path)
            sync_folder(path.parent)
        except OSError as error:
            raise output_error(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def publish_folder(path: Path, *, verify: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Yield an empty folder to write to, and put it in the place of `path` once it is verified and on disk.

    Where the system can exchange two names in one step, a reader sees the old folder or the new one and nothing else.
    Elsewhere the old one steps aside first; if the run is killed just then, `folder_lock` of the next one brings it
    back. Whatever stood under the name goes, links are not followed.

    Raises
    ------
    OutputError
        The disk is full, the folder cannot be written, or `verify` found it wanting.
    """
    path = Path(path)
    folder = path.parent / f"{PART_PREFIX}{os.getpid()}-{path.name}"
    try:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(folder, ignore_errors=True)
            part = folder / path.name
            part.mkdir(parents=True)
            yield part
            if verify is not None:
                verify(part)
            sync_tree(part)
            _swap_in(part, path)
            sync_folder(path.parent)
        except OSError as error:
            raise output_error(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _swap_in(part: Path, path: Path) -> None:
    """Give a folder a name that may be taken; what had it ends beside where the folder was."""
    if not os.path.lexists(path):
        os.rename(part, path)
    elif not _exchange(part, path):
        aside = part.parent / REPLACED
        os.rename(path, aside)
        try:
            os.rename(part, path)
        except OSError:
            os.rename(aside, path)
            raise


def _bring_back(leftover: Path, path: Path) -> None:
    """Put back what a dead run put aside, where it did not come to put the new in its place."""
    aside = leftover / REPLACED
    if os.path.lexists(aside) and not os.path.lexists(path):
        try:
            os.rename(aside, path)
        except OSError as error:
            raise output_error(path, error) from error


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names in one step; tell whether the system did."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):  # not Linux, or a C library without it
        return False
    names = os.fsencode(first), os.fsencode(second)
    return bool(renameat2(AT_FDCWD, names[0], AT_FDCWD, names[1], ctypes.c_uint(RENAME_EXCHANGE)) == 0)


def write_text(path: Path, text: str) -> None:
    """Publish a text file."""
    with publish(path) as part:
        part.write_text(text, encoding="utf-8")


def output_error(path: Path, error: OSError) -> OutputError:
    """Turn an operating system's refusal into a message with the space left."""
    found = error.strerror or str(error)
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    if full:
        with contextlib.suppress(OSError):
            found += f"; {shutil.disk_usage(path.parent).free / 1e6:.1f} MB free"
    return OutputError(
        "the output could not be written; what stood there before is untouched",
        where=path,
        found=found,
        next_step=(
            "make room or name another folder with -o" if full else "name a folder with -o that can be written to"
        )
        + ", then run the same command again",
    )


def sync_file(path: Path) -> None:
    """Force a file's bytes to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path: Path) -> None:
    """Force a folder's entries to disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(path: Path) -> None:
    """Force all files and entries of a folder, and of those in it, to disk."""
    for folder, _, names in os.walk(path):
        for name in names:
            sync_file(Path(folder, name))
        sync_folder(Path(folder))


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal text."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _alive(pid: str) -> bool:
    """Tell whether the process that a part is named after still runs; a name without one is nobody's."""
    try:
        os.kill(int(pid), 0)
    except (ValueError, ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return int(pid) != os.getpid()


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder for one run; the lock is freed by the system even if the run is killed.

    The folder itself is locked, so no lock file stays behind; a folder made for a run that then wrote nothing
    is removed again. Parts that dead runs left behind are removed; a folder that one had put aside, to put a new one
    in its place, is put back.

    Raises
    ------
    BusyError
        Another run holds the folder.
    OutputError
        The folder cannot be made.
    """
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise BusyError(
                "another run is writing here",
                where=folder,
                next_step="wait for it to end, or name another folder with -o",
            ) from error
        for leftover in folder.glob(f"{PART_PREFIX}*"):
            pid, _, name = leftover.name.removeprefix(PART_PREFIX).partition("-")
            if not _alive(pid):
                _bring_back(leftover, folder / name)
                shutil.rmtree(leftover, ignore_errors=True)
        yield
    finally:
        os.close(descriptor)
        if made:
            with contextlib.suppress(OSError):
                folder.rmdir()
