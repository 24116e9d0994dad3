"""What a parameter model reads, what it says, and what is known of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

WINDOW_INPUT, FEATURE_INPUT = "window", "features"
"""float32 (lot, channel, row, col) and (lot, feature)."""
VALUE_OUTPUT, SPREAD_OUTPUT, STRATEGY_OUTPUT = "value", "spread", "strategy"
"""float32 (lot, parameter) means and standard deviations in shares of the range, (lot, strategy) probabilities."""
CHANNELS = ("coverage", "ground", "edge", "scale")
"""Shares covered and plantable, distance to the lot's edge over 12 m clipped at 1, pixel in m: all from 0 to 1."""
STRATEGIES_READ = ("random", "boundary", "cluster")
"""Strategies that are told apart in coverage, in the order of the output."""


@dataclass(frozen=True)
class ParameterModelInfo:
    """Metadata of a parameter model, stored in the ONNX file.

    Parameters
    ----------
    network
        ``informed`` (windows and features, spreads and strategy) or ``paper`` (coverage alone; its spread is the
        error on held-out lots, its strategies equally likely).
    parameters
        Names in the order of the outputs.
    low, high
        Range of each parameter that outputs 0 and 1 stand for: the training prior is uniform between them.
    features
        Names in the order of the input, which a program must be able to compute.
    window_px
        Side of the windows.
    training, scores
        Facts for the model card.
    """

    network: str
    parameters: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    features: tuple[str, ...]
    window_px: int
    training: dict[str, Any] = field(default_factory=dict)
    scores: dict[str, Any] = field(default_factory=dict)

    def as_record(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)
