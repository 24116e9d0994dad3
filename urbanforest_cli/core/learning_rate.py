"""The rate at which a network learns, as a function of the step alone."""

from __future__ import annotations

import math


def one_cycle(step: int, steps: int, *, highest: float, warm_up_fraction: float) -> tuple[float, float]:
    """Return the learning rate and Adam's first beta of a step, counted from 0, of so many.

    The cycle of Smith and Topin (2018) with PyTorch's defaults: by cosines from 1/25 of the rate up and down to
    1/250,000, the beta from 0.95 to 0.85 and back.
    """
    last = steps - 1
    peak = warm_up_fraction * (last + 1) - 1.0
    lowest = highest / 25.0
    if step <= peak:
        share = step / peak if peak > 0 else 1.0
        return _cosine(lowest, highest, share), _cosine(0.95, 0.85, share)
    share = (step - peak) / (last - peak) if last > peak else 1.0
    return _cosine(highest, lowest / 1e4, share), _cosine(0.85, 0.95, share)


def _cosine(start: float, end: float, share: float) -> float:
    return end + (start - end) * (1.0 + math.cos(math.pi * share)) / 2.0
