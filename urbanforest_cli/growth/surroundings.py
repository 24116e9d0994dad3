"""What stands around any grove of a city: the frame to grow in, buildings, light and the crowns of other plants."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.grove import FRAME_STEP_M, Surroundings, season_count
from urbanforest_cli.growth.neighbour_kernel import CELLS_A_STEP, POINT_CELL_M, crown_points
from urbanforest_cli.growth.neighbours import INTERNODES_PER_M3, crown_history, crown_sizes, crown_table, ellipsoids
from urbanforest_cli.growth.solids import SHADE_REACH_M, footprints_of, sky_field, solid_top, within_shade
from urbanforest_cli.growth.sunlight import Light

MARGIN_SHARE, MARGIN_M = 1.35, 2.0
"""A crown may grow to this share of the open-grown radius, plus this."""
HEADROOM_SHARE, HEADROOM_M = 1.25, 3.0

Frame = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Plants:
    """All plants of a city as arrays, in any order.

    Parameters
    ----------
    keys
        (n,) unique random streams: what names a plant whatever its row.
    xy_m
        (n, 2) positions in the working CRS.
    species
        (n,) rows of the list of open-grown sizes.
    age_years, pruning_factor
        (n,) pruning_factor scales the sides of a plant's crown.
    """

    keys: NDArray[np.uint64]
    xy_m: NDArray[np.float64]
    species: NDArray[np.int64]
    age_years: NDArray[np.float64]
    pruning_factor: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.keys)


class Site:
    """A city as its plants see it; made once, then asked for the surroundings of groves, from any thread.

    Parameters
    ----------
    open_grown
        Sizes by age of each species.
    buildings, height_m
        (b,) polygons or multipolygons in the working CRS, (b,) heights, NaN where none is known.
    """

    def __init__(
        self,
        plants: Plants,
        open_grown: list[OpenGrown],
        buildings: NDArray[Any],
        height_m: NDArray[np.float64],
        light: Light,
        growth: Growth,
    ) -> None:
        self.plants, self.light, self.growth = plants, light, growth
        oldest = int(season_count(plants.age_years).max(initial=1))
        self.table = crown_table(open_grown, oldest + 1)
        self.scale = np.asarray(plants.pruning_factor, dtype=np.float64)
        full = crown_sizes(self.table, plants.species, plants.age_years, np.ones(len(plants)))
        cut = crown_sizes(self.table, plants.species, plants.age_years, self.scale)
        self.margin, self.headroom = margin_of(full[:, 0]), headroom_of(full[:, 1])
        self.crown = ellipsoids(cut)
        self.widest = float(self.crown[:, 0].max()) if len(plants) else 0.0
        self.footprints = footprints_of(buildings, np.asarray(height_m, dtype=np.float64), growth.building_height_m)
        self._plant_tree = cKDTree(plants.xy_m)
        self._building_tree = shapely.STRtree(np.asarray(shapely.box(*self.footprints.bounds.T), dtype=object))
        self._buildings_near(np.zeros(2), np.ones(2))  # a tree is built by its first query: not in several threads

    def around(self, indices: NDArray[np.int64]) -> Surroundings:
        """Return what stands around a grove of the plants in these rows; their order changes nothing."""
        own = self.plants.xy_m[indices]
        origin, size = frame_of(own, self.margin[indices], self.headroom[indices])
        buildings = self._buildings_near(origin, size)
        solid = solid_top(self.footprints, buildings, origin, size)
        sky = sky_field(self.footprints, buildings, origin, size, self.light)
        points, season = self._leafy_points(indices, origin, size, solid)
        return _assembled(origin, size, self.light, solid, sky, points, season)

    def reach_print(self, indices: NDArray[np.int64]) -> bytes:
        """Return a digest of a grove and of all around it that can change how it grows.

        It knows neither rows nor their order; traits and config are not in it.
        """
        own, neighbours = self._by_key(indices), self.neighbours_of(indices)
        origin, size = frame_of(self.plants.xy_m[own], self.margin[own], self.headroom[own])
        digest = blake2b(b"".join(part.tobytes() for part in (origin, size, *self.light)), digest_size=16)
        for rows in (own, neighbours):
            history, first = self._history(rows)
            for part in (self.plants.keys[rows], self.plants.xy_m[rows], self.plants.age_years[rows], first, history):
                digest.update(np.ascontiguousarray(part).tobytes())
        for part in (self.plants.pruning_factor[own], self.margin[own], self.headroom[own]):
            digest.update(np.ascontiguousarray(part).tobytes())
        digest.update(b"".join(sorted(self._building_print(part) for part in self._buildings_near(origin, size))))
        return digest.digest()

    def neighbours_of(self, indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the rows of other plants whose crowns may meet those of a grove, in the order of their keys."""
        if not self.growth.neighbours:
            return np.empty(0, dtype=np.int64)
        own, margin = self.plants.xy_m[indices], self.margin[indices]
        middle = (own.min(axis=0) + own.max(axis=0)) / 2
        reach = float((np.hypot(*(own - middle).T) + margin).max())
        near = np.array(self._plant_tree.query_ball_point(middle, reach + self.widest), dtype=np.int64)
        near = near[~np.isin(near, indices)]
        gap = self.plants.xy_m[near][:, None] - own
        meets = (np.hypot(gap[..., 0], gap[..., 1]) < margin + self.crown[near, :1]).any(axis=1)
        return self._by_key(near[meets])

    def _leafy_points(
        self,
        indices: NDArray[np.int64],
        origin: NDArray[np.float64],
        size: NDArray[np.float64],
        solid: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        near = self.neighbours_of(indices)
        if not len(near):
            return np.empty((0, 3), dtype=np.float32), np.empty(0, dtype=np.int32)
        history, first = self._history(near)
        points, season = crown_points(
            self.plants.xy_m[indices] - origin, self.crown[indices], self.margin[indices],
            self.plants.xy_m[near] - origin, history, first,
            int(season_count(self.plants.age_years[indices]).max()),
            size, np.round(origin / FRAME_STEP_M).astype(np.int64) * CELLS_A_STEP, solid,
        )  # fmt: skip
        return points, season

    def _history(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        plants = self.plants
        return crown_history(self.table, plants.species[rows], plants.age_years[rows], self.scale[rows])

    def _by_key(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        return rows[np.argsort(self.plants.keys[rows], kind="stable")]

    def _buildings_near(self, origin: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the rows of footprints that stand in a frame or may throw shade on it."""
        low, high = origin - SHADE_REACH_M, origin + size[:2] + SHADE_REACH_M
        near = np.sort(self._building_tree.query(shapely.box(*low, *high)))
        return within_shade(self.footprints, near, origin, size, self.light)

    def _building_print(self, part: int) -> bytes:
        shapes = self.footprints
        first, last = shapes.parts[part], shapes.parts[part + 1]
        rings = shapes.rings[first : last + 1]
        outline = shapes.xy_m[rings[0] : rings[-1]]
        return blake2b(
            outline.tobytes() + np.diff(rings).tobytes() + shapes.top_m[part].tobytes(), digest_size=16
        ).digest()


def margin_of(crown_radius_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far from its stem a plant of an open-grown radius is given room in a frame."""
    return MARGIN_SHARE * crown_radius_m + MARGIN_M


def headroom_of(height_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how high a plant of an open-grown height is given room in a frame."""
    return HEADROOM_SHARE * height_m + HEADROOM_M


def frame_of(xy_m: NDArray[np.float64], margin_m: NDArray[np.float64], headroom_m: NDArray[np.float64]) -> Frame:
    """Return origin (2,), a multiple of `FRAME_STEP_M`, and size (3,), whole metres, that hold plants and margins."""
    origin = np.floor((xy_m - margin_m[:, None]).min(axis=0) / FRAME_STEP_M) * FRAME_STEP_M
    extent = (xy_m + margin_m[:, None]).max(axis=0) - origin
    return origin, np.ceil(np.append(extent, headroom_m.max()))


def empty_surroundings(
    xy_m: NDArray[np.float64], crown_radius_m: NDArray[np.float64], height_m: NDArray[np.float64], light: Light
) -> Surroundings:
    """Return surroundings without anything in them, for plants of these open-grown sizes."""
    origin, size = frame_of(xy_m, margin_of(crown_radius_m), headroom_of(height_m))
    nothing = np.empty((0, 3), dtype=np.float32), np.empty(0, dtype=np.int32)
    solid = np.zeros((1, 1), dtype=np.float32)
    return _assembled(origin, size, light, solid, np.full((1, 1, 1), 255, dtype=np.uint8), *nothing)


def _assembled(
    origin: NDArray[np.float64],
    size: NDArray[np.float64],
    light: Light,
    solid: NDArray[np.float32],
    sky: NDArray[np.uint8],
    points: NDArray[np.float32],
    season: NDArray[np.int32],
) -> Surroundings:
    internodes = np.full(len(season), INTERNODES_PER_M3 * POINT_CELL_M**3, dtype=np.float32)
    return Surroundings(
        origin_m=origin, size_m=size, solid_top_m=solid, sky=sky, ray=light.ray, ray_light=light.ray_light,
        shade_lean=light.lean, neighbour_xyz_m=points, neighbour_season=season, neighbour_internodes=internodes,
    )  # fmt: skip
