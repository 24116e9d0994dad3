"""Models of any kind on disk: read once as bytes, tried in a process of their own, written whole."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from urbanforest_cli.core.errors import InputError, LimitError, OutputError
from urbanforest_cli.core.publish import publish, sha256_of
from urbanforest_cli.files.vector_formats import refuse_remote

PATIENCE_S = 240
FOUND_CHARACTERS = 300
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

Refusal = Callable[[Path, str], InputError]


def read_model_bytes(path: Path, *, most_bytes: int, refusal: Refusal, next_step: str) -> bytes:
    """Read a regular file whole.

    Parameters
    ----------
    refusal
        Makes the error of a path and what was found.

    Raises
    ------
    InputError
        It is no regular file, empty, remote or cannot be read.
    LimitError
        It is larger than `most_bytes`.
    """
    refuse_remote(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer never blocks
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise refusal(path, "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, a device or the like")
            if status.st_size > most_bytes:
                raise LimitError(
                    "the model is too large", where=path, found=f"{status.st_size:,} bytes",
                    expected=f"at most {most_bytes:,} bytes", next_step=next_step,
                )  # fmt: skip
            with open(descriptor, "rb", closefd=False) as stream:
                content = stream.read(most_bytes)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise InputError(
            "the model cannot be read", where=path, found=error.strerror or str(error), next_step=next_step
        ) from error
    if not content:
        raise refusal(path, "an empty file")
    return content


def tried(probe: Path, content: bytes, expected: Mapping[str, Any], what: str, *, seconds: int) -> str | None:
    """Try a model in a process of its own; return what is wrong with it, or None.

    Parameters
    ----------
    probe
        Script that takes `expected` as JSON and the model by the standard input.
    what
        What it is tried on, in words.
    seconds
        Of processor time that the script allows itself.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(probe), json.dumps(expected)], input=content, capture_output=True, check=False,
            timeout=PATIENCE_S, env={**os.environ, **ONE_THREAD},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"trying it on {what} did not end in {PATIENCE_S} s"
    except OSError as error:
        return f"it could not be tried: {error.strerror or error}"
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"trying it on {what} takes more than {seconds} s, or memory that is not there"
    if done.returncode:
        return f"trying it on {what} failed: {_last_line(done.stderr)}"
    return done.stdout.decode("utf-8", "replace") or None


def publish_model(path: Path, content: bytes) -> None:
    """Write a model, whole or not at all.

    Raises
    ------
    OutputError
        It could not be written whole.
    """

    def verify(part: Path) -> None:
        if sha256_of(part) != hashlib.sha256(content).hexdigest():
            raise OutputError("the model was not written whole", where=path)

    with publish(path, verify=verify) as part:
        part.write_bytes(content)


def _last_line(stderr: bytes) -> str:
    """Return the reason that ends a traceback, without names of types and of others' source files."""
    lines = stderr.decode("utf-8", "replace").strip().splitlines() or ["the process crashed"]
    if any(name in lines[-1] for name in ("bad_alloc", "bad allocation", "MemoryError", "Failed to allocate memory")):
        return "it takes far more memory than an input of that size should"
    text = re.sub(r"^[\w.]+: (?:\[ONNXRuntimeError\] : \d+ : )?", "", lines[-1])
    text = re.sub(r"/\S+\.(?:cc|h):\d+ \S*\s?", "", text)
    return text[:FOUND_CHARACTERS] or lines[-1][:FOUND_CHARACTERS]
