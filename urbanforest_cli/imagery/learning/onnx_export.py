"""A trained network as one ONNX file that gives the same numbers without torch."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import INPUT_NAME, OUTPUT_NAME, CoverageModelInfo
from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.onnx_bytes import sealed
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.learning.network import OPSET, Generator, frozen, probabilities, traced

PARITY_LIMIT = 1e-4
"""Largest difference of a probability between torch and onnxruntime."""
BATCHES = (1, 3)
SIDE_PX = 64
SILENT = 4


def export_onnx(
    network: Generator, info: CoverageModelInfo, *, sizes_px: tuple[tuple[int, int], ...] | None = None
) -> bytes:
    """Write a network in use as ONNX, and prove before returning it that it gives what the network gives.

    The graph holds the network in `eval()` mode, norms folded into convolutions and the probability computed inside;
    batch, height and width are open. The network itself stays as it is. `training` of the metadata gets `parity_max`,
    the largest difference met, and `opset`.

    Parameters
    ----------
    sizes_px
        Rows and columns of the images compared, each alone and as three; by default a square, a wide and a high one.

    Raises
    ------
    ValueError
        The metadata cannot be; says why.
    OutputError
        The two differ by more than `PARITY_LIMIT`, or values are not probabilities.
    """
    if faults := info.faults():
        raise ValueError("; ".join(faults))
    side = info.multiple_px * math.ceil(SIDE_PX / info.multiple_px)
    sizes_px = sizes_px or ((side, side), (side, side + info.multiple_px), (side + 2 * info.multiple_px, side))
    graph = traced(frozen(network), side_px=side)
    parity_max = _parity(frozen(network, fold=False), graph, info, sizes_px)
    if not parity_max <= PARITY_LIMIT:
        raise OutputError(
            "the network as ONNX does not give what it gives in torch; no model was written",
            found=f"probabilities differ by {parity_max:.3g}", expected=f"at most {PARITY_LIMIT:g}",
            next_step="train longer or with a lower learning rate: huge weights, or norms without statistics, do this",
        )  # fmt: skip
    stated = dataclasses.replace(info, training={**info.training, "parity_max": parity_max, "opset": OPSET})
    return sealed(graph, stated.as_metadata())


def _parity(network: Generator, graph: bytes, info: CoverageModelInfo, sizes_px: tuple[tuple[int, int], ...]) -> float:
    """Return the largest difference between torch and onnxruntime; infinite where values are no probabilities."""
    session = _session(graph)
    largest = 0.0
    for rows, columns in sizes_px:
        for batch in BATCHES:
            images = _images(info, batch, rows, columns)
            expected = probabilities(network, images)
            found = session.run([OUTPUT_NAME], {INPUT_NAME: images})[0]
            if found.shape != (batch, len(info.classes), rows, columns) or found.shape != expected.shape:
                raise OutputError(
                    "the network does not give the classes of its metadata; no model was written",
                    found=f"shape {found.shape}", expected=f"shape {(batch, len(info.classes), rows, columns)}",
                )  # fmt: skip
            difference = float(np.abs(found - expected).max())
            if not math.isfinite(difference) or found.min() < 0.0 or found.max() > 1.0:
                return math.inf
            largest = max(largest, difference)
    return largest


def _images(info: CoverageModelInfo, batch: int, rows: int, columns: int) -> NDArray[np.float32]:
    """Draw images as the model gets them, from black to white in every pixel and channel."""
    rng = rng_for(0, "onnx_export", f"{batch}x{rows}x{columns}")
    values = rng.integers(0, 256, (batch, 3, rows, columns))
    mean = np.asarray(info.channel_mean)[:, None, None]
    scale = np.asarray(info.channel_scale)[:, None, None]
    return np.asarray((values - mean) / scale, dtype=np.float32)


def _session(content: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = SILENT
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
