"""What a coverage model says of itself: the metadata inside its ONNX file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

FORMAT = "urbanforest-coverage-model"
FORMAT_VERSION = 1
CANOPY, VEGETATION = "canopy", "vegetation"
CLASSES = (CANOPY, VEGETATION)
"""Classes by their names: above-ground vegetation, which the pipeline uses, and all vegetation, lawns included."""
INPUT_NAME, OUTPUT_NAME = "image", "coverage"
UNKNOWN = 255
"""Value of a coverage map where nothing is known; 0-100 is the covered percentage."""


@dataclass(frozen=True, kw_only=True)
class CoverageModelInfo:
    """How a coverage model is to be fed and read.

    The input `image` is float32 (batch, 3, row, col), red, green, blue, each `(value - mean) / scale` of 0-255 values;
    rows and columns are multiples of `multiple_px`. The output `coverage` is float32 (batch, class, row, col), the
    probability from 0 to 1 that a pixel is covered.
    """

    classes: tuple[str, ...]
    resolution_m: float
    multiple_px: int
    halo_px: int
    channel_mean: tuple[float, float, float]
    channel_scale: tuple[float, float, float]
    thresholds: tuple[float, ...]
    preset: str
    program_version: str
    training: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)

    def as_metadata(self) -> dict[str, str]:
        """Return text by key, as ONNX stores it."""
        return {
            "format": FORMAT,
            "format_version": str(FORMAT_VERSION),
            "model": json.dumps(asdict(self), sort_keys=True),
        }

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> CoverageModelInfo:
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
            text = json.loads(metadata["model"])
            info = cls(
                classes=tuple(str(name) for name in text["classes"]),
                resolution_m=float(text["resolution_m"]),
                multiple_px=int(text["multiple_px"]),
                halo_px=int(text["halo_px"]),
                channel_mean=_three(text["channel_mean"]),
                channel_scale=_three(text["channel_scale"]),
                thresholds=tuple(float(value) for value in text["thresholds"]),
                preset=str(text["preset"]),
                program_version=str(text["program_version"]),
                training=dict(text["training"]),
                scores=dict(text["scores"]),
            )
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            raise ValueError(f"its metadata cannot be read: {error!r}") from error
        if faults := info.faults():
            raise ValueError("; ".join(faults))
        return info

    def faults(self) -> list[str]:
        """Return a sentence for each value that cannot be."""
        numbers = (self.resolution_m, *self.channel_mean, *self.channel_scale, *self.thresholds)
        checks = {
            "numbers must be finite": all(math.isfinite(value) for value in numbers),
            f"classes must be distinct names out of {', '.join(CLASSES)}": 0
            < len(self.classes)
            == len(set(self.classes))
            and set(self.classes) <= set(CLASSES),
            "resolution_m must lie within 0.05 and 10": 0.05 <= self.resolution_m <= 10.0,
            "multiple_px must lie within 1 and 1024": 1 <= self.multiple_px <= 1024,
            "halo_px must lie within 0 and 1024": 0 <= self.halo_px <= 1024,
            "channel_scale must be above 0": all(value > 0 for value in self.channel_scale),
            "thresholds must be one a class, within 0 and 1": len(self.thresholds) == len(self.classes)
            and all(0 < value < 1 for value in self.thresholds),
        }
        return [text for text, holds in checks.items() if not holds]


def _three(values: Any) -> tuple[float, float, float]:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
