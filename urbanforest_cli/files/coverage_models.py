"""Coverage models on disk: ONNX files of this program, read only after everything that can be wrong was looked for.

A model is another's work that runs here. Nothing is unpickled; the file is read once, as bytes, so that it can reach
no other file; its checksum, metadata and operators are looked at before any library sees it; and a process of its own,
with limits on memory and time, tries it on a small image.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import stat
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from urbanforest_cli.core.coverage_model import INPUT_NAME, OUTPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.errors import InputError, LimitError, OutputError
from urbanforest_cli.core.onnx_bytes import foreign_parts, sealed_metadata
from urbanforest_cli.core.publish import publish, sha256_of
from urbanforest_cli.files.vector_formats import refuse_remote

SHIPPED = Path(__file__).parents[1] / "models" / "coverage.onnx"
PROBE = Path(__file__).with_name("coverage_model_probe.py")
MOST_BYTES = 1 << 30
PROBE_PX = 64
PROBE_SECONDS = 30
PROBE_PATIENCE_S = 240
PROBE_BYTES, PROBE_BYTES_A_PX = 384 << 20, 16 << 10
"""Memory that trying a model may take, besides four times its size; the widest Pix2Pix takes 1.1 kB a pixel."""
FOUND_CHARACTERS = 300
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_NEXT = "name a model that `urbanforest train-coverage` wrote, or leave -m out for the one that comes with the program"


@dataclass(frozen=True)
class CoverageModel:
    """A model that passed all checks; `content` is what was checked, whatever happens to the file later."""

    path: Path
    content: bytes = field(repr=False)
    sha256: str
    info: CoverageModelInfo


def load_coverage_model(path: Path | None = None) -> CoverageModel:
    """Read a coverage model and refuse one that is damaged, foreign or misbehaves.

    Parameters
    ----------
    path
        An ONNX file that `train-coverage` wrote; None for the one that comes with the program, which is looked at as
        any other but not tried out.

    Raises
    ------
    InputError
        It is no regular file, no ONNX model, damaged, no coverage model, or does not do what it says; tells which.
    LimitError
        It is larger than `MOST_BYTES`.
    """
    if path is None and not SHIPPED.is_file():
        raise InputError(
            "this installation has no coverage model of its own", where=SHIPPED,
            next_step="name one with -m; `urbanforest train-coverage` makes one from images and masks",
        )  # fmt: skip
    content = _read(path or SHIPPED)
    try:
        info = CoverageModelInfo.from_metadata(sealed_metadata(content))
        foreign = foreign_parts(content)
    except (ValueError, OverflowError) as error:
        raise _refusal(path or SHIPPED, str(error)) from error
    if foreign:
        raise _refusal(path or SHIPPED, f"it asks for {', '.join(foreign)}, which no coverage model needs")
    if path is not None and (fault := _probe(content, info)):
        raise _refusal(path, fault)
    return CoverageModel(path or SHIPPED, content, hashlib.sha256(content).hexdigest(), info)


def write_coverage_model(path: Path, content: bytes) -> None:
    """Publish a model, which must have its metadata and its seal.

    Raises
    ------
    ValueError
        It has not.
    OutputError
        It could not be written whole.
    """
    CoverageModelInfo.from_metadata(sealed_metadata(content))

    def verify(part: Path) -> None:
        if sha256_of(part) != hashlib.sha256(content).hexdigest():
            raise OutputError("the model was not written whole", where=path)

    with publish(path, verify=verify) as part:
        part.write_bytes(content)


def _read(path: Path) -> bytes:
    refuse_remote(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer never blocks
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise _refusal(path, "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, a device or the like")
            if status.st_size > MOST_BYTES:
                raise LimitError(
                    "the model is too large", where=path, found=f"{status.st_size:,} bytes",
                    expected=f"at most {MOST_BYTES:,} bytes", next_step=_NEXT,
                )  # fmt: skip
            with open(descriptor, "rb", closefd=False) as stream:
                content = stream.read(MOST_BYTES)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise InputError(
            "the model cannot be read", where=path, found=error.strerror or str(error), next_step=_NEXT
        ) from error
    if not content:
        raise _refusal(path, "an empty file")
    return content


def _probe(content: bytes, info: CoverageModelInfo) -> str | None:
    """Try a model in a process of its own; return what is wrong with it, or None."""
    # Odd multiples: a model that needs coarser ones than it says cannot pass.
    times = next(times for times in range(1, PROBE_PX + 2, 2) if times * info.multiple_px >= PROBE_PX)
    rows, columns = times * info.multiple_px, (times + 1) * info.multiple_px
    size = f"{rows} x {columns} pixels"
    expected = {
        "input": INPUT_NAME,
        "output": OUTPUT_NAME,
        "classes": len(info.classes),
        "rows": rows,
        "columns": columns,
        "mean": info.channel_mean,
        "scale": info.channel_scale,
        "bytes_more": PROBE_BYTES + PROBE_BYTES_A_PX * rows * columns + 4 * len(content),
        "seconds": PROBE_SECONDS,
    }
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(PROBE), json.dumps(expected)], input=content, capture_output=True, check=False,
            timeout=PROBE_PATIENCE_S, env={**os.environ, **ONE_THREAD},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"trying it on {size} did not end in {PROBE_PATIENCE_S} s"
    except OSError as error:
        return f"it could not be tried: {error.strerror or error}"
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"trying it on {size} takes more than {PROBE_SECONDS} s, or memory that is not there"
    if done.returncode:
        return f"trying it on {size} failed: {_last_line(done.stderr)}"
    return done.stdout.decode("utf-8", "replace") or None


def _last_line(stderr: bytes) -> str:
    """Return the reason that ends a traceback, without names of types and of others' source files."""
    lines = stderr.decode("utf-8", "replace").strip().splitlines() or ["the process crashed"]
    if any(name in lines[-1] for name in ("bad_alloc", "bad allocation", "MemoryError", "Failed to allocate memory")):
        return "it takes far more memory than an image of that size should"
    text = re.sub(r"^[\w.]+: (?:\[ONNXRuntimeError\] : \d+ : )?", "", lines[-1])
    text = re.sub(r"/\S+\.(?:cc|h):\d+ \S*\s?", "", text)
    return text[:FOUND_CHARACTERS] or lines[-1][:FOUND_CHARACTERS]


def _refusal(path: Path, found: str) -> InputError:
    return InputError("not a coverage model that can be used", where=path, found=found, next_step=_NEXT)
