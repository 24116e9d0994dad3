"""Try a parameter model on a few windows, in a process of its own with little memory and little time.

Run as a script, as `coverage_model_probe`: the model comes in by the standard input, what is expected of it as JSON in
the first argument, and what is wrong with it goes out by the standard output.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import onnxruntime

from urbanforest_cli.files.coverage_model_probe import SILENT, TOLERANCE, limit_self

LOTS = 3
SPREAD_MOST = 2.0
"""A spread, in shares of the range, that no value within the range can have."""


def first_fault(content: bytes, expected: dict[str, Any]) -> str | None:
    """Return what is wrong with a model, or None.

    Parameters
    ----------
    expected
        `inputs` and `outputs` map names to the shape of one lot's, `probabilities` is the name of the output that
        sums to 1, `spread` of the one that may lie above 1.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = SILENT
    options.enable_cpu_mem_arena = False
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    for kind, there in (("inputs", session.get_inputs()), ("outputs", session.get_outputs())):
        if {one.name for one in there} != set(expected[kind]):
            return f"its {kind} are {', '.join(one.name for one in there)}, not {', '.join(expected[kind])}"
        for one in there:
            shape = expected[kind][one.name]
            if one.type != "tensor(float)" or len(one.shape) != len(shape) + 1 or isinstance(one.shape[0], int):
                return f"{one.name} is {one.type} {one.shape}, not tensor(float) of any number of lots of {shape}"
            if kind == "inputs" and list(one.shape[1:]) != shape:
                return f"{one.name} takes {one.shape[1:]} a lot, not {shape}"
    rng = np.random.Generator(np.random.Philox(key=1))
    for draw in (rng.random, lambda shape: np.zeros(shape)):
        given = {name: draw((LOTS, *shape)).astype(np.float32) for name, shape in expected["inputs"].items()}
        found = dict(zip(expected["outputs"], session.run(list(expected["outputs"]), given), strict=True))
        if fault := _fault_of(found, expected):
            return fault
    return None


def _fault_of(found: dict[str, Any], expected: dict[str, Any]) -> str | None:
    for name, shape in expected["outputs"].items():
        values = found[name]
        most = SPREAD_MOST if name == expected["spread"] else 1.0 + TOLERANCE
        if values.shape != (LOTS, *shape):
            return f"{name} has the shape {values.shape}, not {(LOTS, *shape)}"
        if not np.isfinite(values).all():
            return f"{name} is not finite"
        if values.min() < -TOLERANCE or values.max() > most:
            return f"{name} lies within {values.min():.3g} and {values.max():.3g}"
    if np.abs(found[expected["probabilities"]].sum(axis=1) - 1.0).max() > 1e-3:
        return f"{expected['probabilities']} does not sum to 1"
    return None


def main() -> None:
    """Read the model, try it, and write what is wrong."""
    expected = json.loads(sys.argv[1])
    content = sys.stdin.buffer.read()
    limit_self(expected["bytes_more"], expected["seconds"])
    sys.stdout.write(first_fault(content, expected) or "")


if __name__ == "__main__":
    main()
