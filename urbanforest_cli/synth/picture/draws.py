"""Draws keyed by thing: each lot, building, road or plant has its own numbers, whatever is drawn beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform, key_for
from urbanforest_cli.synth.plan import Floats

STAGE = "picture"


class Draws:
    """Uniform numbers of `count` things; each call of a name gives one a thing, the same whenever it is called."""

    def __init__(self, seed: int, sort: str, count: int) -> None:
        self._seed, self._sort, self._index = seed, sort, np.arange(count)

    def uniform(self, name: str, low: float = 0.0, high: float = 1.0) -> Floats:
        """Draw evenly between two bounds."""
        key = key_for(self._seed, STAGE, f"{self._sort}/{name}")
        keys = np.full(len(self._index), key, dtype=np.uint64)
        return low + (high - low) * hash_uniform(keys, self._index)

    def pick(self, name: str, count: int) -> NDArray[np.int64]:
        """Draw whole numbers below `count`."""
        return np.minimum((self.uniform(name) * count).astype(np.int64), count - 1)

    def few(self, name: str, mean: Floats) -> NDArray[np.int64]:
        """Draw whole numbers of a mean: it rounded up or down by chance."""
        return np.floor(mean + self.uniform(name)).astype(np.int64)
