"""A planted city in arrays: what stands where, in metres of the working CRS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.core.species import Species

FloatArray = NDArray[np.float64]
ShapeArray = NDArray[np.object_]
SkeletonSource = Callable[[NDArray[np.int64]], Skeletons]
"""Reads skeletons by id, in the order asked for."""


@dataclass(frozen=True)
class Plants:
    """Plants that stand, in the order of the register: (n,) each.

    Parameters
    ----------
    plant_id, lot_id
        Object arrays of str.
    species
        Place in the city's species.
    xy_m
        (n, 2) easting and northing in the working CRS.
    age_years, height_m, crown_radius_m, crown_base_m, dbh_m, pruning_factor
        As grown; crown_base_m is the height of the lowest branch.
    skeleton_id
        Whose shape it has.
    yaw_rad, mirror, scale
        How that shape is placed: mirrored (y to -y) where told, turned counter-clockwise, scaled.
    is_library
        Whether the shape is another plant's.
    """

    plant_id: NDArray[np.object_]
    lot_id: NDArray[np.object_]
    species: NDArray[np.int64]
    xy_m: FloatArray
    age_years: FloatArray
    height_m: FloatArray
    crown_radius_m: FloatArray
    crown_base_m: FloatArray
    dbh_m: FloatArray
    pruning_factor: FloatArray
    skeleton_id: NDArray[np.int64]
    yaw_rad: FloatArray
    mirror: NDArray[np.bool_]
    scale: FloatArray
    is_library: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.plant_id)

    def take(self, rows: NDArray[Any]) -> Plants:
        """Return some of them."""
        return Plants(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class City:
    """A planted city.

    Parameters
    ----------
    name
        For titles.
    origin
        About which 3D files state positions: whole metres near the middle of the plants.
    register_crs
        CRS of the register, for formats that are written in it.
    plants, species
        What stands, and the species that `plants.species` counts in.
    skeletons_of
        Reads the shapes.
    years_ago
        How many seasons before their last the skeletons are shown; 0 is today.
    buildings, building_height_m, building_id
        (b,) polygons in the working CRS, heights of the walls, ids.
    lots, lot_colour
        (l,) polygons and fills as the map has them ("#rrggbb").
    roads
        (r,) polygons in the working CRS, lines widened to their width.
    unknown_height_count
        Of buildings, whose height is the config's.
    """

    name: str
    origin: Origin
    register_crs: CRS
    plants: Plants
    species: tuple[Species, ...]
    skeletons_of: SkeletonSource
    years_ago: int
    buildings: ShapeArray
    building_height_m: FloatArray
    building_id: NDArray[np.object_]
    lots: ShapeArray
    lot_colour: NDArray[np.object_]
    roads: ShapeArray
    unknown_height_count: int = 0

    @property
    def crs(self) -> CRS:
        """The working CRS, projected, in metres."""
        return self.origin.crs

    def local(self, xy_m: FloatArray) -> FloatArray:
        """Return (n, 3) positions about the origin, on the ground."""
        place = np.array([self.origin.easting_m, self.origin.northing_m])
        return np.column_stack([xy_m - place, np.full(len(xy_m), -self.origin.height_m)])

    def local_shapes(self, shapes: ShapeArray) -> ShapeArray:
        """Return polygons about the origin."""
        place = np.array([self.origin.easting_m, self.origin.northing_m])
        return np.asarray(shapely.transform(shapes, lambda xy: xy - place))

    def season_end(self, skeletons: Skeletons) -> NDArray[np.int32]:
        """Return (s,) the season that each skeleton is shown at."""
        return np.asarray(np.maximum(skeletons.seasons - self.years_ago, 0), np.int32)
