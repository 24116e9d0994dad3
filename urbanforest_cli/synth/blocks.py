"""Blocks and side streets: each district's own grid, bent with the plan and cut to the district."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.plan import (
    CENTRE,
    DENSE,
    GARDEN,
    INDUSTRIAL,
    LANE_WIDTH_M,
    PARK,
    SIDEWALK_M,
    STREET_WIDTH_M,
    SUBURB,
    Floats,
    Geometries,
    Plan,
)

#            length  depth  (metres between streets)
_BLOCK_M = {
    CENTRE: (92.0, 74.0),
    DENSE: (112.0, 62.0),
    SUBURB: (122.0, 54.0),
    GARDEN: (124.0, 56.0),
    INDUSTRIAL: (165.0, 112.0),
    PARK: (200.0, 200.0),
}


@dataclass(frozen=True)
class Blocks:
    """Blocks as bent quadrilaterals; corners run counter-clockwise from (u, v) = (0, 0)."""

    district: NDArray[np.int64]  # (blocks,)
    use: NDArray[np.int64]  # (blocks,) of the district
    corners: Floats  # (blocks, 4, 2)
    whole: NDArray[np.bool_]  # (blocks,) lies within its district's region; else its lots must be cut

    def take(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> Blocks:
        """Return some of the blocks."""
        return Blocks(self.district[index], self.use[index], self.corners[index], self.whole[index])

    def at(self, block: NDArray[np.integer], u: Floats, v: Floats) -> Floats:
        """Return points given in their blocks' own coordinates, both 0 to 1; straight in u and in v."""
        corner = self.corners[block]
        u, v = u[..., None], v[..., None]
        low = corner[..., 0, :] * (1 - u) + corner[..., 1, :] * u
        high = corner[..., 3, :] * (1 - u) + corner[..., 2, :] * u
        return np.asarray(low * (1 - v) + high * v)

    def centres(self) -> Floats:
        """Return (blocks, 2) centres."""
        return np.asarray(self.corners.mean(axis=1))


@dataclass(frozen=True)
class SideStreets:
    """Side streets before they are cut to the blocks that are kept; one line may cross its whole district."""

    lines: Geometries
    kinds: NDArray[np.object_]
    widths_m: Floats
    district: NDArray[np.int64]


def make_blocks(plan: Plan, block_scale: float, rng: np.random.Generator) -> tuple[Blocks, SideStreets]:
    """Lay a grid of streets and blocks into every district.

    Parameters
    ----------
    block_scale
        Share of the usual block length; small cities have short blocks, so that they have several.
    """
    district, corners, lines, lanes, line_district = [], [], [], [], []
    for number in range(len(plan.centres)):
        if plan.uses[number] == PARK:
            district.append(np.array([number]))
            corners.append(_park_square(plan, number)[None])
            continue
        grid = _Grid.draw(plan, number, block_scale, rng)
        own = grid.block_corners()
        district.append(np.full(len(own), number))
        corners.append(own)
        own_lines = grid.street_lines()
        lines += own_lines
        lanes += [grid.lane] * len(own_lines)
        line_district += [number] * len(own_lines)
    blocks = _cut_to_regions(plan, np.concatenate(district), np.concatenate(corners))
    lane = np.array(lanes, dtype=bool)
    streets = SideStreets(
        np.array(lines, dtype=object),
        np.where(lane, "lane", "street").astype(object),
        np.where(lane, LANE_WIDTH_M, STREET_WIDTH_M),
        np.array(line_district, dtype=np.int64),
    )
    return blocks, streets


def _park_square(plan: Plan, number: int) -> Floats:
    west, south, east, north = plan.cells[number].bounds
    return np.array([(west, south), (east, south), (east, north), (west, north)])


@dataclass(frozen=True)
class _Grid:
    """One district's grid on its own axes: u along the streets, v across them."""

    plan: Plan
    number: int
    v_lines: Floats  # (strips + 1,) middles of the streets along u
    u_lines: Floats  # (strips, columns) middles of the cross streets, for each strip
    aligned: bool
    lane: bool
    bend_m: float
    bend_length_m: float
    bend_phase: float

    @classmethod
    def draw(cls, plan: Plan, number: int, block_scale: float, rng: np.random.Generator) -> _Grid:
        use = int(plan.uses[number])
        length_m, depth_m = _BLOCK_M[use]
        lane = use == GARDEN and rng.random() < 0.5
        way_m = (LANE_WIDTH_M if lane else STREET_WIDTH_M) + 2 * SIDEWALK_M
        depth_m *= rng.uniform(0.95, 1.08)
        length_m *= block_scale * rng.uniform(0.85, 1.2)
        reach = plan.reaches_m[number] + 1.2 * length_m
        start = plan.edge_offsets_m[number]
        rows = int(2 * reach / (depth_m + way_m)) + 2
        below = int(np.ceil((start + reach) / (depth_m + way_m)))
        v_lines = start + np.arange(-below, rows - below + 1) * (depth_m + way_m)
        columns = int(2 * reach / (length_m + way_m)) + 2
        lengths_m = length_m * rng.uniform(0.75, 1.25, columns)
        lengths_m *= length_m / lengths_m.mean()
        u_line = -reach + rng.uniform(-0.5, 0) * length_m + np.concatenate(([0.0], np.cumsum(lengths_m + way_m)))
        aligned = bool(rng.random() < (0.8 if use == GARDEN else 0.55 if use == SUBURB else 0.75))
        shifts = np.zeros(rows) if aligned else rng.uniform(0, 0.45, rows) * length_m * np.tile((1, -1), rows)[:rows]
        bend = 0.0 if not aligned else 1.0 if use == GARDEN else 0.35 if use == SUBURB else 0.0
        bend_length_m = rng.uniform(420, 700)
        return cls(
            plan, number, v_lines, u_line + shifts[:, None], aligned, lane,
            bend_m=bend * 0.22 * bend_length_m / (2 * np.pi), bend_length_m=bend_length_m,
            bend_phase=rng.uniform(0, 2 * np.pi),
        )  # fmt: skip

    @property
    def way_m(self) -> float:
        """Width from lot to lot."""
        return (LANE_WIDTH_M if self.lane else STREET_WIDTH_M) + 2 * SIDEWALK_M

    def place(self, u: Floats, v: Floats) -> Floats:
        """Bring points from the grid's axes to the city."""
        v = v + self.bend_m * np.sin(2 * np.pi * u / self.bend_length_m + self.bend_phase)
        angle = self.plan.angles_rad[self.number]
        cos, sin = np.cos(angle), np.sin(angle)
        xy = np.column_stack(((u * cos - v * sin).ravel(), (u * sin + v * cos).ravel()))
        return self.plan.warp(xy + self.plan.centres[self.number]).reshape(*u.shape, 2)

    def block_corners(self) -> Floats:
        """Return (blocks, 4, 2) corners of the blocks that may touch the district."""
        half = self.way_m / 2
        u0, u1 = self.u_lines[:, :-1] + half, self.u_lines[:, 1:] - half
        v0 = np.broadcast_to((self.v_lines[:-1] + half)[:, None], u0.shape)
        v1 = np.broadcast_to((self.v_lines[1:] - half)[:, None], u0.shape)
        near = (
            np.hypot((u0 + u1) / 2, (v0 + v1) / 2) < self.plan.reaches_m[self.number] + np.hypot(u1 - u0, v1 - v0) / 2
        )
        u0, u1, v0, v1 = u0[near], u1[near], v0[near], v1[near]
        return self.place(np.stack((u0, u1, u1, u0), axis=1), np.stack((v0, v0, v1, v1), axis=1))

    def street_lines(self) -> list[shapely.LineString]:
        """Return the middles of the streets, a point at each crossing."""
        strips = len(self.u_lines)
        lines = []
        for row, v in enumerate(self.v_lines):
            beside = self.u_lines[max(row - 1, 0) : min(row, strips - 1) + 1]
            u = np.unique(np.round(beside, 6))
            lines.append(shapely.LineString(self.place(u, np.full_like(u, v))))
        if self.aligned:
            for u in self.u_lines[0]:
                lines.append(shapely.LineString(self.place(np.full_like(self.v_lines, u), self.v_lines)))
        else:
            for row in range(strips):
                for u in self.u_lines[row]:
                    lines.append(shapely.LineString(self.place(np.array([u, u]), self.v_lines[row : row + 2])))
        return lines


def _cut_to_regions(plan: Plan, district: NDArray[np.int64], corners: Floats) -> Blocks:
    quads = np.asarray(shapely.polygons(corners))
    shapely.prepare(plan.regions)
    regions = plan.regions[district]
    touching = shapely.intersects(regions, quads)
    whole = np.zeros(len(quads), dtype=np.bool_)
    whole[touching] = shapely.contains_properly(regions[touching], quads[touching])
    return Blocks(district, plan.uses[district], corners, whole).take(touching)
