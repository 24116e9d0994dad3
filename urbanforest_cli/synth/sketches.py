"""Sketches: a few zones that somebody might have drawn into the greens of the city."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.lots import CAMPUS, Lots
from urbanforest_cli.synth.plan import Floats, Geometries

_SMALLEST_M2 = 1200.0
_LOTS_A_SKETCH = 40_000


@dataclass(frozen=True)
class Sketches:
    """Drawn polygons; a number is NaN and a strategy None where the sketch does not say."""

    shapes: Geometries
    strategies: NDArray[np.object_]
    coverage: Floats
    spacing_m: Floats
    radius_mean_m: Floats
    cluster_radius_m: Floats
    notes: NDArray[np.object_]


_DRAWN = (
    ("equidistant", np.nan, 7.0, 3.0, np.nan, "an avenue of equal trees"),
    (None, 0.65, np.nan, np.nan, np.nan, "a grove that covers two thirds of its ground"),
    ("cluster", np.nan, np.nan, 2.2, 7.0, "a few groups of small trees"),
)


def draw_sketches(lots: Lots, zones: NDArray[np.object_]) -> Sketches:
    """Draw sketches into the largest greens: an avenue, a grove, and groups of trees, one a green.

    In a city of fewer than three greens large enough they share them, one at either end.
    """
    area = shapely.area(lots.shapes)
    greens = np.flatnonzero((zones == "other") & (lots.kind != CAMPUS) & (area >= _SMALLEST_M2))
    greens = greens[np.argsort(-area[greens], kind="stable")]
    wanted = 3 + len(zones) // _LOTS_A_SKETCH
    drawn: list[tuple[object, tuple[object, ...]]] = []
    for number in range(wanted if len(greens) else 0):
        site = lots.site[greens[number % len(greens)]]
        kind = _DRAWN[number % len(_DRAWN)]
        depth = 0.10 if (number // len(greens)) % 2 == 0 else 0.72
        outline = _avenue(site, depth) if kind[0] == "equidistant" else _blob(site, depth + 0.10, 0.14)
        shape = shapely.intersection(
            shapely.Polygon(outline), shapely.buffer(lots.shapes[greens[number % len(greens)]], -1.0)
        )
        if shape.geom_type == "Polygon" and shape.area > 60 and not any(shape.intersects(other) for other, _ in drawn):
            drawn.append((shape, kind))
    shapes = np.empty(len(drawn), dtype=object)
    shapes[:] = [shape for shape, _ in drawn]

    def numbers(column: int) -> Floats:
        return np.array([kind[column] for _, kind in drawn], dtype=np.float64)

    def words(column: int) -> NDArray[np.object_]:
        return np.array([kind[column] for _, kind in drawn], dtype=object)

    return Sketches(shapes, words(0), numbers(1), numbers(2), numbers(3), numbers(4), words(5))


def _at(site: Floats, s: Floats, t: Floats) -> Floats:
    s, t = s[:, None], t[:, None]
    return np.asarray((site[0] * (1 - s) + site[1] * s) * (1 - t) + (site[3] * (1 - s) + site[2] * s) * t)


def _avenue(site: Floats, depth: float) -> Floats:
    return _at(site, np.array([0.08, 0.92, 0.92, 0.08]), depth + np.array([0.0, 0.0, 0.12, 0.12]))


def _blob(site: Floats, depth: float, size: float) -> Floats:
    angle = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    radius = size * (1 + 0.18 * np.sin(2 * angle + 0.6) + 0.12 * np.sin(3 * angle))
    return _at(site, 0.3 + radius * np.cos(angle), depth + radius * np.sin(angle))
