"""What a map and a report are made from: arrays and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.export.crowns import Crowns
from urbanforest_cli.export.drawing import FloatArray


@dataclass(frozen=True)
class ZoneStyle:
    """A zone as the legend names it."""

    name: str
    colour: str


@dataclass(frozen=True)
class SpeciesStyle:
    """A species as the legend names it."""

    id: str
    label: str
    colour: str
    tall: bool


@dataclass(frozen=True)
class MapLayers:
    """What a map shows, in one CRS in metres.

    Parameters
    ----------
    lots, lot_zone
        (n,) polygons and the index of each one's zone in `zones`.
    plant_xy, plant_radius_m, plant_species
        (m, 2) positions, (m,) radii, 0 where nothing is to be drawn, and indices into `species`.
    buildings, building_height_m, roads
        Polygons with heights, and surfaces.
    regions
        Vegetation of a coverage map that lots were filled from.
    """

    lots: NDArray[np.object_]
    lot_zone: NDArray[np.int64]
    zones: Sequence[ZoneStyle]
    plant_xy: FloatArray
    plant_radius_m: FloatArray
    plant_species: NDArray[np.int64]
    species: Sequence[SpeciesStyle]
    buildings: NDArray[np.object_] = field(default_factory=lambda: np.empty(0, dtype=object))
    building_height_m: FloatArray = field(default_factory=lambda: np.empty(0))
    roads: NDArray[np.object_] = field(default_factory=lambda: np.empty(0, dtype=object))
    regions: NDArray[np.object_] = field(default_factory=lambda: np.empty(0, dtype=object))

    def crowns(self) -> Crowns:
        """Return the plants as crowns in their species' colours."""
        colours = np.array([to_rgb(item.colour) for item in self.species]).reshape(-1, 3)
        tall = np.array([item.tall for item in self.species], dtype=bool)
        return Crowns(self.plant_xy, self.plant_radius_m, colours[self.plant_species], tall[self.plant_species])


def shown_radius_m(plants: pd.DataFrame, trees: pd.DataFrame | None) -> FloatArray:
    """Return how wide to draw each plant: as it grew, 0 where nothing stands, its envelope where it did not grow."""
    envelope = plants["envelope_radius_m"].to_numpy(dtype=float)
    if trees is None:
        return envelope
    return np.where(not_grown(trees), envelope, trees["crown_radius_m"].to_numpy(dtype=float))


def not_grown(trees: pd.DataFrame) -> NDArray[np.bool_]:
    """Tell of which plants nothing is known, since they were not among those to grow."""
    return np.asarray(trees["reason"] == "out_of_focus", dtype=bool)


@dataclass(frozen=True)
class RegisterTables:
    """The layers of a register without their geometry; frames of no rows where a stage wrote nothing.

    `trees` has a row a plant, in the order of `plants`; None where these plants have not grown.
    """

    lots: pd.DataFrame
    parameters: pd.DataFrame
    plants: pd.DataFrame
    placements: pd.DataFrame
    skipped: pd.DataFrame
    trees: pd.DataFrame | None = None
