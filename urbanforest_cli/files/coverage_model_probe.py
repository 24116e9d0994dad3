"""Try a coverage model on a small image, in a process of its own with little memory and little time.

This file is run as a script that imports nothing of the program: the model comes in by the standard input, what is
expected of it as JSON in the first argument, and what is wrong with it goes out by the standard output, nothing where
it is as expected. A model that crashes, loops or takes all memory harms this process alone.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

TOLERANCE = 1e-5
"""By how much rounding may carry a probability out of 0 to 1."""
SILENT = 4


def first_fault(content: bytes, expected: dict[str, Any]) -> str | None:
    """Return what is wrong with a model, or None.

    Parameters
    ----------
    expected
        `input` and `output` are names, `classes` a count, `rows` and `columns` the size to try it on, `mean` and
        `scale` what images are normalised with.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = SILENT
    options.enable_cpu_mem_arena = False
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    inputs, outputs = session.get_inputs(), session.get_outputs()
    for kind, there, name in (("input", inputs, expected["input"]), ("output", outputs, expected["output"])):
        if [one.name for one in there] != [name]:
            return f"its {kind} is {', '.join(one.name for one in there) or 'nothing'}, not {name}"
        if there[0].type != "tensor(float)" or len(there[0].shape) != 4:
            return f"its {kind} is {there[0].type} {there[0].shape}, not tensor(float) of four dimensions"
    if inputs[0].shape[1] != 3 or any(isinstance(inputs[0].shape[axis], int) for axis in (0, 2, 3)):
        return f"its input takes {inputs[0].shape}, not [batch, 3, rows, columns] of any batch, rows and columns"
    found = session.run(None, {inputs[0].name: _images(expected)})[0]
    shape = (2, expected["classes"], expected["rows"], expected["columns"])
    if found.shape != shape:
        return f"its output has the shape {found.shape}, not {shape}"
    if not np.isfinite(found).all():
        return "its output is not finite"
    if found.min() < -TOLERANCE or found.max() > 1.0 + TOLERANCE:
        return f"its output lies within {found.min():.3g} and {found.max():.3g}, not 0 and 1"
    return None


def _images(expected: dict[str, Any]) -> NDArray[np.float32]:
    """Return two images, one of noise, one from black to white."""
    rows, columns = expected["rows"], expected["columns"]
    noise = np.random.Generator(np.random.Philox(key=1)).integers(0, 256, (3, rows, columns))
    slope = np.broadcast_to(np.linspace(0, 255, columns), (3, rows, columns))
    mean, scale = (np.asarray(expected[name])[:, None, None] for name in ("mean", "scale"))
    return np.asarray((np.stack([noise, slope]) - mean) / scale, dtype=np.float32)


def limit_self(bytes_more: int, seconds: int) -> None:
    """Let this process take no more than so much memory beyond what it has, and so much processor time."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        held = int(statm.read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        _lower(resource.RLIMIT_AS, held + bytes_more)
    _lower(resource.RLIMIT_CPU, seconds)
    _lower(resource.RLIMIT_CORE, 0)


def _lower(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def main() -> None:
    """Read the model, try it, and write what is wrong."""
    expected = json.loads(sys.argv[1])
    content = sys.stdin.buffer.read()
    limit_self(expected["bytes_more"], expected["seconds"])
    sys.stdout.write(first_fault(content, expected) or "")


if __name__ == "__main__":
    main()
