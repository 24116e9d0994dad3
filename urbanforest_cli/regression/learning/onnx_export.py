"""A trained parameter network as one ONNX file that gives the same numbers without torch."""

from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.onnx_bytes import sealed
from urbanforest_cli.core.parameter_input import network_input
from urbanforest_cli.core.parameter_metadata import as_metadata, faults_of
from urbanforest_cli.core.parameter_model import FEATURE_INPUT, WINDOW_INPUT, ParameterModelInfo
from urbanforest_cli.regression.learning.network import (
    OPSET,
    InformedNetwork,
    PaperNetwork,
    frozen,
    readings,
    traced,
)
from urbanforest_cli.regression.pair_table import PairTable

PARITY_LIMIT = 1e-4
"""Largest difference, in shares of the range, between torch and onnxruntime."""
COMPARED = (1, 3, 256)
SILENT = 4


def export_onnx(network: PaperNetwork | InformedNetwork, info: ParameterModelInfo, pairs: PairTable) -> bytes:
    """Write a network in use as ONNX, and prove before returning it that it gives what the network gives.

    `training` of the metadata gets `parity_max`, the largest difference met, and `opset`.

    Parameters
    ----------
    pairs
        Pairs that the two are compared on, the first of them.

    Raises
    ------
    ValueError
        The metadata cannot be; says why.
    OutputError
        The two differ by more than `PARITY_LIMIT`.
    """
    if faults := faults_of(info):
        raise ValueError("; ".join(faults))
    used = frozen(network)
    graph = traced(used, len(info.features))
    parity_max = _parity(used, graph, pairs)
    if not parity_max <= PARITY_LIMIT:
        raise OutputError(
            "the network as ONNX does not give what it gives in torch; no model was written",
            found=f"shares of the range differ by {parity_max:.3g}", expected=f"at most {PARITY_LIMIT:g}",
            next_step="train longer or with a lower learning rate: huge weights do this",
        )  # fmt: skip
    stated = dataclasses.replace(info, training={**info.training, "parity_max": parity_max, "opset": OPSET})
    return sealed(graph, as_metadata(stated))


def _parity(network: PaperNetwork | InformedNetwork, graph: bytes, pairs: PairTable) -> float:
    """Return the largest difference between torch and onnxruntime, infinite where a value is none."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = SILENT
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    names = {one.name for one in session.get_inputs()}
    largest = 0.0
    for count in COMPARED:
        rows: NDArray[np.int64] = np.arange(count) % len(pairs)
        part = pairs.take(rows)
        given = {WINDOW_INPUT: network_input(part.windows, part.pixel_m), FEATURE_INPUT: part.features}
        expected = readings(network, given[WINDOW_INPUT], given[FEATURE_INPUT])
        found = session.run(None, {name: value for name, value in given.items() if name in names})
        for one, other in zip(found, expected, strict=True):
            difference = float(np.abs(one - other).max())
            largest = max(largest, difference if np.isfinite(difference) else np.inf)
    return largest
