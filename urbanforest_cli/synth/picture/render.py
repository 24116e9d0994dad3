"""Pictures of windows: fine cells are raised, lit, averaged to pixels, and seen through a lens and a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.synth.picture.camera_kernel import DRIVEWAY, HIGH_CELLS, WET, Land, Looks, expose
from urbanforest_cli.synth.picture.draws import STAGE
from urbanforest_cli.synth.picture.looks import DARK_SUN, GROUNDS, SKY_SHARE
from urbanforest_cli.synth.picture.relief_kernel import (
    fill_polygons,
    highest_around,
    raise_boxes,
    raise_plants,
    raise_roofs,
)
from urbanforest_cli.synth.picture.scene import Scene
from urbanforest_cli.synth.picture.streets_kernel import near_roads

TILE_PX = 256
CELL_M = 0.15
_LENS_PX = 2
_BLUR_PX = 0.5
_NOISE = 2.4
_BESIDE_ROADS_M = 6.0
_WIDEST_M = 20.0
"""From the middle of the widest road to where its sidewalk ends, at least."""
_FAR_M = 1e6


@dataclass(frozen=True)
class Frame:
    """Where the pixels of a picture lie, in metres from the city's centre."""

    west_m: float
    north_m: float
    resolution_m: float
    rows: int
    cols: int

    @property
    def factor(self) -> int:
        """Cells along a pixel's side."""
        return max(round(self.resolution_m / CELL_M), 2)

    def tiles(self) -> list[tuple[int, int, int, int]]:
        """Return row, column, height and width of the tiles in order; pictures are the same whatever was cut from."""
        return [
            (row, col, min(TILE_PX, self.rows - row), min(TILE_PX, self.cols - col))
            for row in range(0, self.rows, TILE_PX)
            for col in range(0, self.cols, TILE_PX)
        ]


def looks_of(scene: Scene) -> Looks:
    """Gather the tables the camera reads."""
    roofs, plants, props = scene.roofs.patterns(), scene.plants, scene.props
    return Looks(
        GROUNDS, scene.grounds.table, scene.road_looks, roofs, plants.colour, plants.table, props.colour, props.table,
        DARK_SUN, SKY_SHARE,
    )  # fmt: skip


def render_tile(
    scene: Scene, looks: Looks, frame: Frame, tile: tuple[int, int, int, int], seed: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Take the picture of one tile.

    Returns
    -------
    (4, rows, cols) uint8, (2, rows, cols) uint8
        Red, green, blue and near infrared; and the percentage of each pixel under canopy and under vegetation.
    """
    row, col, height, width = tile
    pad, factor = _LENS_PX, frame.factor
    step = frame.resolution_m / factor
    counts = np.zeros((4, height + 2 * pad, width + 2 * pad), dtype=np.float64)
    green = np.zeros((2, height + 2 * pad, width + 2 * pad), dtype=np.float64)
    east_m, sunward_m = scene.shadow_reach_m
    left, right = (math.ceil(max(value, 0.0) / step) + 2 for value in (-east_m, east_m))
    above, below = (math.ceil(max(value, 0.0) / step) + 2 for value in (sunward_m, -sunward_m))
    west = frame.west_m + (col - pad) * frame.resolution_m - left * step
    north = frame.north_m - (row - pad) * frame.resolution_m + above * step
    cells = counts.shape[1] * factor + above + below, counts.shape[2] * factor + left + right
    land = _land(scene, west, north, step, *cells)
    high = highest_around(land.z, HIGH_CELLS)
    expose(land, looks, high, scene.sun, above, left, west, north, step, factor, counts, green)
    lens = gaussian_filter(counts, (0, _BLUR_PX, _BLUR_PX), truncate=_LENS_PX / _BLUR_PX)[:, pad:-pad, pad:-pad]
    noise = rng_for(seed, STAGE, f"noise {row} {col}").standard_normal(lens.shape)
    picture = np.clip(np.rint(lens + _NOISE * noise), 0, 255).astype(np.uint8)
    truth = np.clip(np.rint(100 * green[:, pad:-pad, pad:-pad]), 0, 100).astype(np.uint8)
    return picture, truth


def _land(scene: Scene, west: float, north: float, step: float, rows: int, cols: int) -> Land:
    """Raise everything that stands in a window."""

    def flat(value: float, kind: type) -> NDArray[Any]:
        return np.full((rows, cols), value, dtype=kind)

    box = (west, north - rows * step, west + cols * step, north)
    land = Land(
        flat(0, np.float32), flat(0, np.uint8), flat(-1, np.int32), flat(1, np.float32), flat(-1, np.int32),
        flat(0, np.uint8), flat(-1, np.int32), flat(_FAR_M, np.float32), flat(0, np.float32), flat(0, np.float32),
        flat(_FAR_M, np.float32), flat(_FAR_M, np.float32), flat(0, np.float32), flat(0, np.float32),
    )  # fmt: skip
    place = (west, north, step)
    for outlines, label, out in (
        (scene.lots, None, land.lot),
        (scene.water, WET, land.over),
        (scene.driveways, DRIVEWAY, land.over),
    ):
        chosen = outlines.within(box)
        labels = chosen if label is None else np.full(len(chosen), label)
        fill_polygons(outlines.xy, outlines.ring_ends, outlines.polygon_ends, chosen, labels, *place, out)
    near = (box[0] - _WIDEST_M, box[1] - _WIDEST_M, box[2] + _WIDEST_M, box[3] + _WIDEST_M)
    near_roads(
        scene.roads.segments, scene.roads.within(near), _BESIDE_ROADS_M, *place,
        land.road, land.beyond, land.offset, land.along, land.other, flat(0, np.float32),
    )  # fmt: skip
    near_roads(
        scene.rails.segments, scene.rails.within(near), 0.0, *place,
        flat(-1, np.int32), land.rail_beyond, land.rail_offset, land.rail_along, flat(_FAR_M, np.float32),
        flat(0, np.float32),
    )  # fmt: skip
    building = flat(-1, np.int32)
    chosen = scene.buildings.within(box)
    outlines = scene.buildings
    fill_polygons(outlines.xy, outlines.ring_ends, outlines.polygon_ends, chosen, chosen, *place, building)
    roofs = scene.roofs
    raise_roofs(
        building, roofs.edges, roofs.edge_ends, roofs.form, roofs.eave_m, roofs.pitch, scene.sun, *place,
        land.z, land.top, land.owner, land.facing,
    )  # fmt: skip
    raise_boxes(scene.props.table, scene.props_nearby.within(box), *place, land.z, land.top, land.owner)
    raise_plants(
        scene.plants.table, scene.plants_nearby.within(box), scene.sun, *place,
        land.z, land.top, land.owner, land.facing,
    )  # fmt: skip
    return land
