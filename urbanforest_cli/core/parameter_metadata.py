"""The metadata of a parameter model as its ONNX file holds them, and the operators that such a model may ask for."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

from urbanforest_cli import __version__
from urbanforest_cli.core.onnx_bytes import OPERATORS
from urbanforest_cli.core.parameter_model import ParameterModelInfo

FORMAT = "urbanforest-parameter-model"
FORMAT_VERSION = 1
NETWORKS = ("informed", "paper")
MOST_PARAMETERS, MOST_FEATURES = 32, 1024
PARAMETER_OPERATORS = OPERATORS | {
    "Exp", "Flatten", "Gemm", "GlobalAveragePool", "GlobalMaxPool", "Log", "MatMul", "ReduceMean", "Slice", "Softmax",
    "Sqrt", "Unsqueeze",
}  # fmt: skip
"""Those of coverage models, and what brings a window to a few numbers."""


def as_metadata(info: ParameterModelInfo) -> dict[str, str]:
    """Return text by key, as ONNX stores it."""
    return {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "program_version": __version__,
        "model": json.dumps(info.as_record(), sort_keys=True),
    }


def from_metadata(metadata: Mapping[str, str]) -> ParameterModelInfo:
    """Read what `as_metadata` wrote.

    Raises
    ------
    ValueError
        It is another format or version, or a value is missing, of the wrong kind or out of range; says which.
    """
    if metadata.get("format") != FORMAT:
        raise ValueError(f"its metadata do not say format = {FORMAT}")
    if metadata.get("format_version") != str(FORMAT_VERSION):
        raise ValueError(f"format version {metadata.get('format_version')!r}, this program reads {FORMAT_VERSION}")
    try:
        record = json.loads(metadata["model"])
        info = ParameterModelInfo(
            network=str(record["network"]),
            parameters=tuple(str(name) for name in record["parameters"]),
            low=tuple(float(value) for value in record["low"]),
            high=tuple(float(value) for value in record["high"]),
            features=tuple(str(name) for name in record["features"]),
            window_px=int(record["window_px"]),
            training=dict(record["training"]),
            scores=dict(record["scores"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"its metadata cannot be read: {error!r}") from error
    if faults := faults_of(info):
        raise ValueError("; ".join(faults))
    return info


def faults_of(info: ParameterModelInfo) -> list[str]:
    """Return a sentence for each value that cannot be."""
    count = len(info.parameters)
    checks = {
        f"network must be {' or '.join(NETWORKS)}": info.network in NETWORKS,
        f"parameters must be 1 to {MOST_PARAMETERS} distinct names": 0 < count <= MOST_PARAMETERS
        and len(set(info.parameters)) == count,
        "low and high must be one a parameter, finite, the low below the high": len(info.low) == len(info.high) == count
        and all(
            math.isfinite(low) and math.isfinite(high) and low < high
            for low, high in zip(info.low, info.high, strict=True)
        ),
        f"features must be at most {MOST_FEATURES} distinct names": len(info.features) <= MOST_FEATURES
        and len(set(info.features)) == len(info.features),
        "window_px must lie within 16 and 512": 16 <= info.window_px <= 512,
    }
    return [text for text, holds in checks.items() if not holds]
