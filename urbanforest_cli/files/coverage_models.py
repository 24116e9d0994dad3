"""Coverage models on disk: ONNX files of this program, read only after everything that can be wrong was looked for.

A model is another's work that runs here. Nothing is unpickled; the file is read once, as bytes, so that it can reach
no other file; its checksum, metadata and operators are looked at before any library sees it; and a process of its own,
with limits on memory and time, tries it on a small image.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from urbanforest_cli.core.coverage_model import INPUT_NAME, OUTPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.onnx_bytes import foreign_parts, sealed_metadata
from urbanforest_cli.files.model_files import publish_model, read_model_bytes, tried

SHIPPED = Path(__file__).parents[1] / "models" / "coverage.onnx"
PROBE = Path(__file__).with_name("coverage_model_probe.py")
MOST_BYTES = 1 << 30
PROBE_PX = 64
PROBE_SECONDS = 30
PROBE_BYTES, PROBE_BYTES_A_PX = 384 << 20, 16 << 10
"""Memory that trying a model may take, besides four times its size; the widest Pix2Pix takes 1.1 kB a pixel."""

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
    publish_model(path, content)


def _read(path: Path) -> bytes:
    return read_model_bytes(path, most_bytes=MOST_BYTES, refusal=_refusal, next_step=_NEXT)


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
    return tried(PROBE, content, expected, size, seconds=PROBE_SECONDS)


def _refusal(path: Path, found: str) -> InputError:
    return InputError("not a coverage model that can be used", where=path, found=found, next_step=_NEXT)
