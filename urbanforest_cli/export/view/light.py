"""The light of a picture: the sun's place, the air, and how large the maps of shade are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.export.plant_camera import Camera
from urbanforest_cli.export.plant_scene import FloatArray
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view.light_kernel import Ring
from urbanforest_cli.export.view.shade_kernel import Light

RING_CELLS = (250, 1000)  # least and most along a side of a map; between them in step with the picture's size
RING_CELLS_A_PX = 0.62
SKY_CELLS_SHARE = 0.3  # of those of the sun's map
LAYER_M, SKY_LAYER_M = 1.25, 1.5
LAYER_CELLS, SKY_LAYER_CELLS = 0.6, 0.2  # layers are at least so many cells thick
RING_COUNT, RING_STEP = 3, 4.0  # a ring is this many times as wide as the one in it
SUN_HEIGHT_MIN = 0.25  # sine of the lowest sun; a lower one has no end of shade
SUN_POWER, SKY_POWER, BOUNCE_POWER = 3.3, 0.84, 0.62
SUN_RGB, SKY_RGB, BOUNCE_RGB = np.array([1.0, 0.915, 0.775]), np.array([0.66, 0.81, 1.0]), np.array([1.0, 0.95, 0.82])
ZENITH_RGB, HORIZON_RGB = np.array([0.52, 0.98, 1.75]), np.array([1.52, 1.80, 2.06])
GLOW_RGB = np.array([0.45, 0.30, 0.12])


@dataclass(frozen=True)
class Weather:
    """Sun and air.

    Parameters
    ----------
    azimuth_deg, elevation_deg
        Of the sun: from north over east, above the horizon.
    focus_m, sharp_m
        Middle and width of the part of the city whose shadows are finest.
    haze_from_m, haze_m
        Where haze begins, and how far on it takes 63 % of the light; 0 for clear air.
    """

    azimuth_deg: float
    elevation_deg: float
    focus_m: tuple[float, float]
    sharp_m: float
    haze_from_m: float = 0.0
    haze_m: float = 0.0

    @property
    def sun(self) -> FloatArray:
        """(3,) direction toward the sun: east, north, up."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        found = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation),
                          np.sin(elevation)])  # fmt: skip
        found[2] = max(found[2], SUN_HEIGHT_MIN)
        return np.asarray(found / np.linalg.norm(found))


def light_of(weather: Weather, camera: Camera) -> Light:
    """Return the light as kernels take it."""
    sun = weather.sun.astype(np.float64)
    return Light(
        sun, np.ascontiguousarray(camera.axes @ sun),
        SUN_POWER * SUN_RGB, SKY_POWER * SKY_RGB, BOUNCE_POWER * BOUNCE_RGB,
        ZENITH_RGB, HORIZON_RGB, GLOW_RGB,
        weather.haze_from_m, max(weather.haze_m, 1e-3), weather.haze_m <= 0, np.empty((0, 3)), np.zeros(4),
    )  # fmt: skip


def rings_for(city: City, camera: Camera, weather: Weather, rows: NDArray[np.int64]) -> tuple[Ring, ...]:
    """Lay out maps of shade around the focus, each wider than the one in it, until the city is covered."""
    plants = city.plants.take(rows)
    leafy = max(float(plants.height_m.max(initial=0.0)), 1.0) + 1
    highest = max(leafy, float(np.max(city.building_height_m, initial=0.0)) + 1)
    slant = weather.sun[:2] / weather.sun[2]
    cells = int(np.clip(RING_CELLS_A_PX * max(camera.size_px), *RING_CELLS))
    rings, width = [], weather.sharp_m
    for _ in range(RING_COUNT):
        rings.append(ring_over(np.array(weather.focus_m) - width / 2, width, highest, slant, cells=cells,
                              leafy_m=leafy))  # fmt: skip
        width *= RING_STEP
    return tuple(rings)


def ring_over(
    low: FloatArray, width_m: float, highest_m: float, slant: FloatArray, *, cells: int, leafy_m: float | None = None,
) -> Ring:  # fmt: skip
    """Return empty maps over a square.

    Parameters
    ----------
    low, width_m, highest_m
        Its corner (2,) and side, and the height of the highest that stands in it.
    slant
        (2,) how far the sun's ray moves east and north a metre of height.
    cells
        Along a side of the sun's map.
    leafy_m
        Height of the highest plant; `highest_m` if None.
    """
    sky_cells = int(SKY_CELLS_SHARE * cells)
    layer = max(LAYER_M, LAYER_CELLS * width_m / cells)
    sky_layer = max(SKY_LAYER_M, SKY_LAYER_CELLS * width_m / sky_cells)
    layers = int(np.ceil((highest_m if leafy_m is None else leafy_m) / layer))
    sky_layers = int(np.ceil(highest_m / sky_layer)) + 1
    return Ring(
        np.asarray(low, np.float64), width_m / cells, layer, np.asarray(slant, np.float64),
        np.zeros((layers + 1, cells, cells), np.float32), np.zeros((cells, cells), np.float32), width_m / sky_cells,
        sky_layer, np.zeros((sky_layers, sky_cells, sky_cells), np.float32),
        np.zeros((sky_cells, sky_cells), np.float32), np.zeros((sky_layers, sky_cells, sky_cells), np.float32),
    )  # fmt: skip
