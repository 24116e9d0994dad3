"""Covariance matrix adaptation (Hansen 2016, arXiv:1604.00772), small and seeded, for a dozen unknowns in [0, 1]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """The best point so far."""

    loss: float
    point: Vector
    tries: int


def evolve(
    loss: Callable[[Vector], float], start: Vector, *, step: float = 0.15, tries: int = 200, seed: int = 0
) -> Iterator[Found]:
    """Yield the best point after each generation; points are folded back into [0, 1] before they are judged."""
    rng = np.random.default_rng(seed)
    n = len(start)
    size = 4 + int(3 * np.log(n))
    weights = np.log(size / 2 + 0.5) - np.log(np.arange(1, size // 2 + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    c_step = (mass + 2) / (n + mass + 5)
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1) + c_step
    c_path = (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_one = 2 / ((n + 1.3) ** 2 + mass)
    c_rank = min(1 - c_one, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    norm = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))

    mean, spread = np.array(start, float), np.eye(n)
    path_step, path = np.zeros(n), np.zeros(n)
    best = Found(loss(mean), mean.copy(), 1)
    yield best
    while best.tries + size <= tries:
        values, axes = np.linalg.eigh(spread)
        root = axes * np.sqrt(np.maximum(values, 1e-14))
        points = mean + step * rng.standard_normal((size, n)) @ root.T
        points = folded(points)
        losses = np.array([loss(point) for point in points])
        order = np.argsort(losses, kind="stable")
        winner = order[0]
        count = best.tries + size
        if losses[winner] < best.loss:
            best = Found(float(losses[winner]), points[winner].copy(), count)
        else:
            best = Found(best.loss, best.point, count)
        moves = (points[order[: len(weights)]] - mean) / step
        move = weights @ moves
        mean = mean + step * move
        whitened = axes @ ((axes.T @ move) / np.sqrt(np.maximum(values, 1e-14)))
        path_step = (1 - c_step) * path_step + np.sqrt(c_step * (2 - c_step) * mass) * whitened
        lively = np.linalg.norm(path_step) < (1.4 + 2 / (n + 1)) * norm
        path = (1 - c_path) * path + lively * np.sqrt(c_path * (2 - c_path) * mass) * move
        spread = (1 - c_one - c_rank) * spread + c_one * np.outer(path, path)
        spread += c_rank * (moves.T * weights) @ moves
        step *= float(np.exp(min(0.6, (c_step / damping) * (np.linalg.norm(path_step) / norm - 1))))
        yield best


def folded(points: Vector) -> Vector:
    """Reflect points at 0 and 1."""
    return 1 - np.abs(1 - np.abs(points) % 2)
