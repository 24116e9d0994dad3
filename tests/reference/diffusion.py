"""Context diffusion over all pairs, as one reads it in the paper: the judge of the kernel."""

from __future__ import annotations

import math

from urbanforest_cli.core.params import PARAMETERS, STRATEGIES


def uses(strategy: str, name: str) -> bool:
    """Tell whether a strategy uses a parameter; a strategy nobody knows uses all."""
    return strategy not in STRATEGIES or strategy in PARAMETERS[name].strategies


def diffuse_all_pairs(
    centres: list[tuple[float, float]],
    values: dict[str, list[float]],
    strategies: list[str],
    *,
    passes: int,
    sigma_fraction: float,
    scopes: list[str] | None = None,
) -> tuple[dict[str, list[float]], list[int]]:
    """Return the values after some passes, counts not yet rounded, and the number of lots each lot heard."""
    reach = values["context_radius_m"]
    heard = [1] * len(centres)
    for _ in range(passes):
        fresh = {name: list(column) for name, column in values.items()}
        for i, centre in enumerate(centres):
            if reach[i] <= 0 or math.isnan(centre[0]):
                continue
            s = reach[i] * sigma_fraction
            context = [
                (k, math.exp(-(math.dist(centre, other) ** 2) / (2 * s * s)))
                for k, other in enumerate(centres)
                if math.dist(centre, other) <= reach[i] and (scopes is None or scopes[k] == scopes[i])
            ]
            heard[i] = len(context)
            for name in values:
                sharing = [(k, w) for k, w in context if uses(strategies[k], name)]
                if uses(strategies[i], name) and len(sharing) > 1:
                    fresh[name][i] = weighted_mean(name, [(values[name][k], w) for k, w in sharing], values[name][i])
        values = fresh
    return values, heard


def weighted_mean(name: str, pairs: list[tuple[float, float]], own: float) -> float:
    """Average values, or for angles the directions of a square lattice."""
    total = sum(w for _, w in pairs)
    if PARAMETERS[name].kind != "angle":
        return sum(v * w for v, w in pairs) / total
    x = sum(w * math.cos(math.radians(4 * v)) for v, w in pairs) / total
    y = sum(w * math.sin(math.radians(4 * v)) for v, w in pairs) / total
    return math.degrees(math.atan2(y, x)) / 4 if math.hypot(x, y) > 1e-9 else own
