"""The crowns of plants that do not grow here but stand near: leafy points that shade and take room.

A neighbour's crown is an ellipsoid between crown base and top of an open-grown plant of its species and age. How deep
a point lies in a crown, q, is its distance from the middle in units of the ellipsoid's half axes. A point belongs to
the plant in whose crown it lies deepest, of all plants near, those of the grove itself included. So two groves that
meet share the space between them by one rule, whichever of them is asked, and no space belongs to two plants. Points
are scattered one a cell of a grid over the world, by a hash of the cell alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.grove import season_count

INTERNODES_PER_M3 = 12.0
"""Leafy internodes in a cubic metre of a grown crown."""
LEAST_HALF_AXIS_M = 0.05


def crown_table(open_grown: list[OpenGrown], years: int) -> NDArray[np.float64]:
    """Return crown radius, height and crown base, (species, years + 1, 3), at each whole age from 0."""
    ages = np.arange(years + 1.0)
    sizes = [(item.crown_radius_at(ages), item.height_at(ages), item.crown_base_at(ages)) for item in open_grown]
    return np.stack([np.column_stack(columns) for columns in sizes]) if sizes else np.zeros((0, years + 1, 3))


def crown_sizes(
    table: NDArray[np.float64], species: NDArray[np.int64], age_years: NDArray[np.float64], scale: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return crown radius, height and crown base, (n, 3), of plants whose crowns are cut to a scale of their size."""
    last = table.shape[1] - 1
    age = np.clip(age_years, 0, last)
    year = np.minimum(age.astype(np.int64), max(last - 1, 0))
    part = (age - year)[:, None]
    sizes = table[species, year] * (1 - part) + table[species, np.minimum(year + 1, last)] * part
    radius, height, base = sizes.T
    base = np.minimum(base, height)
    return np.column_stack((radius * scale, base + (height - base) * scale, base))


def ellipsoids(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return horizontal half axis, height of the middle and vertical half axis, (n, 3), of crowns of these sizes."""
    radius, height, base = sizes.T
    return np.column_stack(
        (
            np.maximum(radius, LEAST_HALF_AXIS_M),
            (height + base) / 2,
            np.maximum((height - base) / 2, LEAST_HALF_AXIS_M),
        )
    )


def crown_history(
    table: NDArray[np.float64], species: NDArray[np.int64], age_years: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the ellipsoids of plants in each of their seasons, one plant after the other.

    Returns
    -------
    (s, 3) ellipsoids and (n + 1,) where each plant's begin; its last is that of its age.
    """
    seasons = season_count(age_years)
    first = np.concatenate(([0], np.cumsum(seasons)))
    plant = np.repeat(np.arange(len(seasons)), seasons)
    years_left = first[plant + 1] - 1 - np.arange(first[-1])
    sizes = crown_sizes(table, species[plant], age_years[plant] - years_left, scale[plant])
    return ellipsoids(sizes), first
