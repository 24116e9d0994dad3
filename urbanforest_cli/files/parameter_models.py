"""Parameter models on disk: ONNX files of this program, looked at before they run as coverage models are."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.onnx_bytes import foreign_parts, sealed_metadata
from urbanforest_cli.core.parameter_input import network_input
from urbanforest_cli.core.parameter_metadata import PARAMETER_OPERATORS, from_metadata
from urbanforest_cli.core.parameter_model import (
    CHANNELS,
    FEATURE_INPUT,
    SPREAD_OUTPUT,
    STRATEGIES_READ,
    STRATEGY_OUTPUT,
    VALUE_OUTPUT,
    WINDOW_INPUT,
    ParameterModelInfo,
)
from urbanforest_cli.files.model_files import publish_model, read_model_bytes, tried

SHIPPED = Path(__file__).parents[1] / "models" / "parameters.onnx"
PROBE = Path(__file__).with_name("parameter_model_probe.py")
MOST_BYTES = 64 << 20
PROBE_SECONDS = 20
PROBE_BYTES = 384 << 20
"""Memory that trying a model may take, besides eight times its size."""

_NEXT = (
    "name a model that `urbanforest train-regression` wrote, or leave it out for the one that comes with the program"
)


@dataclass(frozen=True)
class ParameterModel:
    """A model that passed all checks; `content` is what was checked, whatever happens to the file later."""

    path: Path
    content: bytes = field(repr=False)
    sha256: str
    info: ParameterModelInfo


def load_parameter_model(path: Path | None = None) -> ParameterModel:
    """Read a parameter model and refuse one that is damaged, foreign or misbehaves.

    Parameters
    ----------
    path
        An ONNX file that `train-regression` wrote; None for the one that comes with the program, which is looked at
        as any other but not tried out.

    Raises
    ------
    InputError
        It is no regular file, no ONNX model, damaged, no parameter model, or does not do what it says; tells which.
    LimitError
        It is larger than `MOST_BYTES`.
    """
    if path is None and not SHIPPED.is_file():
        raise InputError(
            "this installation has no parameter model of its own", where=SHIPPED,
            next_step="name one with --parameter-model or -m; `urbanforest train-regression` makes one",
        )  # fmt: skip
    content = read_model_bytes(path or SHIPPED, most_bytes=MOST_BYTES, refusal=_refusal, next_step=_NEXT)
    try:
        info = from_metadata(sealed_metadata(content))
        foreign = foreign_parts(content, PARAMETER_OPERATORS)
    except (ValueError, OverflowError) as error:
        raise _refusal(path or SHIPPED, str(error)) from error
    if foreign:
        raise _refusal(path or SHIPPED, f"it asks for {', '.join(foreign)}, which no parameter model needs")
    if path is not None and (fault := _probe(content, info)):
        raise _refusal(path, fault)
    return ParameterModel(path or SHIPPED, content, hashlib.sha256(content).hexdigest(), info)


def write_parameter_model(path: Path, content: bytes) -> None:
    """Publish a model, which must have its metadata and its seal.

    Raises
    ------
    ValueError
        It has not.
    OutputError
        It could not be written whole.
    """
    from_metadata(sealed_metadata(content))
    publish_model(path, content)


class ParameterSession:
    """A loaded model at work, on the processor and always the same; several threads may use it at once.

    Raises
    ------
    InputError
        The runtime does not take the model.
    """

    def __init__(self, content: bytes, info: ParameterModelInfo, *, threads: int = 1) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        options.use_deterministic_compute = True
        self.info = info
        self._low = np.array(info.low, np.float64)
        self._range = np.array(info.high, np.float64) - self._low
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime's classes of errors share no parent but this one
            raise InputError(
                "the runtime does not take this model", found=str(error).splitlines()[0], next_step="train it again"
            ) from error

    def predict(
        self, windows: NDArray[np.uint8], pixel_m: NDArray[np.float32], features: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Read parameters off windows.

        Parameters
        ----------
        windows
            (n, 3, row, col): coverage and plantable ground in percent, distance to the lot's edge in decimetres.
        pixel_m
            (n,): side of a pixel of these windows, at most 2.
        features
            (n, feature) in the order of `info.features`; not read by a model that has none.

        Returns
        -------
        values, spreads
            (n, parameter) means and standard deviations in the parameters' units, under a prior that is uniform
            within `info.low` and `info.high`, and given that the lot's strategy uses the parameter.
        strategy
            (n, 3) probabilities in the order of `core.parameter_model.STRATEGIES_READ`.

        Raises
        ------
        InputError
            The network failed.
        """
        given = {WINDOW_INPUT: network_input(windows, pixel_m)}
        if self.info.features:
            given[FEATURE_INPUT] = np.ascontiguousarray(features, np.float32)
        try:
            values, spreads, strategy = self._session.run([VALUE_OUTPUT, SPREAD_OUTPUT, STRATEGY_OUTPUT], given)
        except Exception as error:  # see above
            raise InputError("the model failed", found=str(error).splitlines()[0], next_step=_NEXT) from error
        return (
            np.asarray(values, np.float64) * self._range + self._low,
            np.asarray(spreads, np.float64) * self._range,
            np.asarray(strategy, np.float64),
        )


def _probe(content: bytes, info: ParameterModelInfo) -> str | None:
    """Try a model in a process of its own; return what is wrong with it, or None."""
    parameters = [len(info.parameters)]
    inputs = {WINDOW_INPUT: [len(CHANNELS), info.window_px, info.window_px]}
    if info.features:
        inputs[FEATURE_INPUT] = [len(info.features)]
    outputs = {VALUE_OUTPUT: parameters, SPREAD_OUTPUT: parameters, STRATEGY_OUTPUT: [len(STRATEGIES_READ)]}
    expected = {
        "inputs": inputs,
        "outputs": outputs,
        "probabilities": STRATEGY_OUTPUT,
        "spread": SPREAD_OUTPUT,
        "bytes_more": PROBE_BYTES + 8 * len(content),
        "seconds": PROBE_SECONDS,
    }
    return tried(PROBE, content, expected, "a few windows", seconds=PROBE_SECONDS)


def _refusal(path: Path, found: str) -> InputError:
    return InputError("not a parameter model that can be used", where=path, found=found, next_step=_NEXT)
