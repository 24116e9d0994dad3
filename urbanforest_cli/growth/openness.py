"""How open a plant stands: the room and light it has in eight sectors and overhead, in 0 to 1.

Sector k is centred k * 45 degrees counter-clockwise from east: east, north-east, north and so on. An openness of 1
means that nothing stands there until the plant's own crown is full-grown and that no other sector is brighter; 0 that
nothing is left. It is room * (1 - LIGHT_PART * (1 - light)):

- room is the share of the plant's own open-grown crown radius that neighbours and walls leave it (a neighbour takes
  what is nearer to it, both distances told in crown radii, in the height where both have crowns);
- light is what crowns and walls let through of the light of that sector, as a share of all light of the brightest
  one. So a wall on the sunny side takes more than the same wall on the other, and a plant in the open is less open to
  the shaded side: crowns lean toward the sun, and a plant turned about its stem would lean another way.

Overhead is the share of light from above 45 degrees that reaches the upper crown. All sizes are those of open-grown
plants at the ages they have, as if all were full-grown side by side.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.growth.openness_kernel import crowns_in_the_way, walls_in_the_way
from urbanforest_cli.growth.solids import Footprints
from urbanforest_cli.growth.surroundings import Site

SECTORS = 8
RAYS_PER_SECTOR = 3
AZIMUTHS_RAD = np.arange(SECTORS * RAYS_PER_SECTOR) * (2 * np.pi / (SECTORS * RAYS_PER_SECTOR))
SECTOR_OF_RAY = (np.arange(len(AZIMUTHS_RAD)) + RAYS_PER_SECTOR // 2) // RAYS_PER_SECTOR % SECTORS
OVERHEAD = SECTORS
OVERHEAD_ELEVATION_DEG = 45.0
LOWEST_LIGHT_BELOW_DEG = 10.0  # how far below the lowest ray a wall starts to take its light
CROWN_DEPTH_PER_M = 0.08  # a crown 8 m across lets half of the light through
LIGHT_PART = 0.7  # how much of its openness a sector with all its room loses without light
UPPER_CROWN = 0.75  # share of the crown's depth at which light from overhead is told
SMALLEST_RADIUS_M = 0.02
CHUNK = 20_000


@dataclass(frozen=True)
class Crowns:
    """Plants of a city with the sizes they would have in the open at their age.

    Parameters
    ----------
    xy_m
        (n, 2) positions.
    height_m, radius_m, base_m
        (n,) open-grown height, crown radius and height of the lowest branch.
    """

    xy_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    base_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.xy_m)

    def in_grid(self, edge_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Sort the plants into square cells: offsets by cell, plants, and (west, south, edge, columns, rows)."""
        corner = self.xy_m.min(axis=0)
        span = self.xy_m.max(axis=0) - corner
        edge_m = max(edge_m, float(np.sqrt(max(span.prod(), 1.0) / (4 * len(self) + 16))), float(span.max()) / 30_000)
        columns, rows = (int(side / edge_m) + 1 for side in span)
        cell = ((self.xy_m - corner) / edge_m).astype(np.int64)
        flat = np.minimum(cell[:, 1], rows - 1) * columns + np.minimum(cell[:, 0], columns - 1)
        order = np.argsort(flat, kind="stable")
        start = np.searchsorted(flat[order], np.arange(columns * rows + 1))
        return start, order, np.array([corner[0], corner[1], edge_m, columns, rows])


def openness_of(site: Site) -> NDArray[np.float64]:
    """Return the keys (n, 9) of all plants of a site, as `openness_keys` tells them."""
    radius, middle, half = site.crown.T
    crowns = Crowns(xy_m=site.plants.xy_m, height_m=middle + half, radius_m=radius, base_m=middle - half)
    return openness_keys(crowns, site.footprints, ray=site.light.ray, ray_light=site.light.ray_light)


def openness_keys(
    crowns: Crowns, footprints: Footprints, *, ray: NDArray[np.floating], ray_light: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Tell how open each plant stands.

    Parameters
    ----------
    crowns, footprints
        All plants of the city, and all its buildings.
    ray, ray_light
        (k, 3) directions of light, (k,) its share from each, as `sunlight` gives them: straight up, and rings of eight.

    Returns
    -------
    (n, 9)
        Sectors 0 to 7, then overhead.
    """
    keys = np.ones((len(crowns), SECTORS + 1))
    if len(crowns) == 0:
        return keys
    sky = _Sky.of(np.asarray(ray, dtype=np.float64), np.asarray(ray_light, dtype=np.float64))
    walls = _Walls.of(footprints)
    cells = crowns.in_grid(8.0)
    for begin in range(0, len(crowns), CHUNK):
        plants = cells[1][begin : begin + CHUNK]  # neighbours in the grid, so that few buildings matter to a chunk
        keys[plants] = _keys_of(plants, crowns, walls, cells, sky)
    return keys


@dataclass(frozen=True)
class _Walls:
    """Buildings as the walls of their outlines: (b + 1,) offsets, (w, 4) both ends, (b,) heights, (b, 4) bounds."""

    first: NDArray[np.int64]
    corners_m: NDArray[np.float64]
    top_m: NDArray[np.float64]
    bounds: NDArray[np.float64]

    @classmethod
    def of(cls, footprints: Footprints) -> _Walls:
        count = len(footprints.xy_m)
        ends = np.zeros(count, dtype=bool)  # the last position of each ring starts no wall
        ends[footprints.rings[1:] - 1] = True
        starts = np.flatnonzero(~ends)
        corners = np.hstack([footprints.xy_m[starts], footprints.xy_m[starts + 1]]) if count else np.zeros((0, 4))
        first = np.searchsorted(starts, footprints.rings[footprints.parts]).astype(np.int64)
        return cls(first=first, corners_m=corners, top_m=footprints.top_m, bounds=footprints.bounds)


@dataclass(frozen=True)
class _Sky:
    """Light by slope and azimuth: `share` (a, e + 1), straight up in the last column at azimuth 0."""

    elevation_rad: NDArray[np.float64]  # (e,) ascending
    share: NDArray[np.float64]

    @classmethod
    def of(cls, ray: NDArray[np.float64], ray_light: NDArray[np.float64]) -> _Sky:
        level = np.hypot(ray[:, 0], ray[:, 1])
        elevation = np.round(np.arctan2(ray[:, 2], level), 6)
        upright = level < 1e-3
        slopes = np.unique(elevation[~upright]).astype(np.float64)
        share = np.zeros((len(AZIMUTHS_RAD), len(slopes) + 1))
        for direction, rise, light in zip(ray[~upright], elevation[~upright], ray_light[~upright], strict=True):
            sector = int(np.round(np.arctan2(direction[1], direction[0]) / (np.pi / 4))) % SECTORS
            share[sector == SECTOR_OF_RAY, np.searchsorted(slopes, rise)] += light / RAYS_PER_SECTOR
        share[0, -1] = ray_light[upright].sum()
        return cls(elevation_rad=slopes, share=share)

    @property
    def slopes(self) -> range:
        """Columns of `share` for light from aside."""
        return range(len(self.elevation_rad))

    @property
    def above(self) -> list[int]:
        """Columns of `share` for light from overhead."""
        return [e for e in self.slopes if np.degrees(self.elevation_rad[e]) > OVERHEAD_ELEVATION_DEG] + [-1]

    @property
    def brightest(self) -> float:
        """Light from aside of the sector that has most of it."""
        return float(max(self.share[k == SECTOR_OF_RAY, :-1].sum() for k in range(SECTORS)))

    @property
    def tangent(self) -> NDArray[np.float64]:
        return np.asarray(np.tan(self.elevation_rad))

    @property
    def bands_rad(self) -> NDArray[np.float64]:
        """(e + 2,) elevations between which each slope stands for the sky."""
        levels = np.append(self.elevation_rad, np.pi / 2)
        lowest = max(levels[0] - np.radians(LOWEST_LIGHT_BELOW_DEG), np.radians(5.0))
        return np.asarray(np.r_[lowest, 0.5 * (levels[1:] + levels[:-1]), np.pi / 2])


def _keys_of(
    plants: NDArray[np.int64],
    crowns: Crowns,
    walls: _Walls,
    cells: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]],
    sky: _Sky,
) -> NDArray[np.float64]:
    """Tell the keys of a chunk of plants."""
    depth_m = crowns.height_m - crowns.base_m
    room, light = _seen_from(plants, crowns, walls, cells, sky, crowns.base_m + 0.5 * depth_m)
    _, above = _seen_from(plants, crowns, walls, cells, sky, crowns.base_m + UPPER_CROWN * depth_m)
    keys = np.empty((len(plants), SECTORS + 1))
    for k in range(SECTORS):
        rays = np.flatnonzero(k == SECTOR_OF_RAY)
        free = _in_order(room[:, ray] for ray in rays) / RAYS_PER_SECTOR
        keys[:, k] = free
        if sky.brightest > 0.0:
            seen = _in_order(sky.share[a, e] * light[:, a, e] for a in rays for e in sky.slopes) / sky.brightest
            keys[:, k] *= 1.0 - LIGHT_PART * (1.0 - seen)
    high = [(a, e) for e in sky.above for a in range(len(AZIMUTHS_RAD)) if sky.share[a, e] > 0.0]
    total = sum(sky.share[a, e] for a, e in high)
    keys[:, OVERHEAD] = _in_order(sky.share[a, e] * above[:, a, e] for a, e in high) / total if high else 1.0
    return np.clip(keys, 0.0, 1.0)


def _in_order(terms: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Add columns one after the other, so that each row's sum is the same bits whatever other rows there are."""
    total = np.zeros(1)
    for term in terms:
        total = total + term
    return total


def _seen_from(
    plants: NDArray[np.int64],
    crowns: Crowns,
    walls: _Walls,
    cells: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]],
    sky: _Sky,
    eye_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return room (c, a) and light (c, a, e + 1) from heights `eye_m` in the plants' crowns."""
    room = np.ones((len(plants), len(AZIMUTHS_RAD)))
    light = np.ones((len(plants), len(AZIMUTHS_RAD), len(sky.tangent) + 1))
    xyz = np.column_stack([crowns.xy_m, eye_m])
    sizes = (np.maximum(crowns.radius_m, SMALLEST_RADIUS_M), crowns.base_m, crowns.height_m)
    if len(walls.top_m):
        room_reach = crowns.radius_m[plants].max()
        shade_reach = np.maximum(walls.top_m - eye_m[plants].min(), 0.0) / np.tan(sky.bands_rad[0])
        margin = np.maximum(shade_reach, room_reach)[:, None] * np.array([-1.0, -1.0, 1.0, 1.0])
        tree = shapely.STRtree(np.asarray(shapely.points(crowns.xy_m[plants])))
        building, plant = tree.query(shapely.box(*(walls.bounds + margin).T))
        radius, base, height = (values[plants] for values in sizes)
        walls_in_the_way(
            xyz[plants], radius, base, height, plant, building,
            walls.first, walls.corners_m, walls.top_m, AZIMUTHS_RAD, sky.bands_rad, room, light,
        )  # fmt: skip
    largest = crowns.radius_m.max()
    slope = sky.tangent[0] if sky.tangent.size else np.inf
    shade_reach = largest + np.maximum(crowns.height_m.max() - eye_m[plants], 0.0) / slope
    reach = np.maximum(crowns.radius_m[plants] + largest, shade_reach)
    crowns_in_the_way(
        plants, xyz, *sizes, *cells, reach, AZIMUTHS_RAD, sky.tangent, CROWN_DEPTH_PER_M, room, light
    )  # fmt: skip
    return room, light
