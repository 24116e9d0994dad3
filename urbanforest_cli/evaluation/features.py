"""What a pattern looks like, in a row of numbers that do not know its lot's size or count."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.evaluation.patterns import Patterns

Floats = NDArray[np.float64]

FEATURES = (
    "neighbour_q10", "neighbour_q50", "neighbour_q90", "second_neighbour", "third_neighbour",
    "pairs_within_half", "pairs_within_one", "pairs_within_two",
    "edge_mean", "edge_spread", "gap_mean", "gap_q90", "right_angles", "off_centre",
    "building_mean",
)  # fmt: skip


def pattern_features(
    patterns: Patterns,
    windows: NDArray[np.object_],
    area_m2: Floats,
    test_points: Patterns,
    edge_m: Floats,
    building_m: Floats | None,
) -> Floats:
    """Return the features of each lot's pattern; shape (lots, 14), or 15 where buildings are known.

    Lengths between plants are in units of sqrt(A / n), lengths to what bounds them in units of sqrt(A).

    Parameters
    ----------
    patterns
        Points in metres, at least four a lot.
    windows, area_m2
        Open ground of each lot and its area.
    test_points
        Uniform points in each window, from which gaps are measured.
    edge_m, building_m
        Distances of each point, from `evaluation.edges`.
    """
    unit = np.sqrt(patterns.counts / area_m2)
    scaled = patterns.scaled(unit)
    near = scaled.neighbour_distances(3)
    nearest = scaled.quantiles(near[:, 0], np.array([0.1, 0.5, 0.9]))
    pairs = scaled.pair_counts(np.array([0.5, 1.0, 2.0])) * 2 / patterns.counts[:, None]
    gaps = patterns.nearest_to(test_points) * unit[test_points.lot]
    side = np.sqrt(area_m2)
    edge = edge_m / side[patterns.lot]
    edge_mean = patterns.means(edge)
    vectors = scaled.neighbour_vectors(1)
    heading = np.exp(4j * np.arctan2(vectors[:, 1], vectors[:, 0]))
    right_angles = np.hypot(patterns.means(heading.real), patterns.means(heading.imag))
    centre = np.column_stack([patterns.means(patterns.xy[:, axis]) for axis in (0, 1)])
    middle = shapely.get_coordinates(shapely.centroid(windows))
    columns = [
        *nearest.T, patterns.means(near[:, 1]), patterns.means(near[:, 2]),
        *pairs.T,
        edge_mean, np.sqrt((patterns.means(edge**2) - edge_mean**2).clip(0)),
        test_points.means(gaps), test_points.quantiles(gaps, np.array([0.9]))[:, 0],
        right_angles, np.linalg.norm(centre - middle, axis=1) / side,
    ]  # fmt: skip
    if building_m is not None:
        columns.append(patterns.means(building_m) / side)
    return np.column_stack(columns)
