"""What plants stand on and between, in pictures of cities: lots, roads with kerbs, houses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.core.zones import ZONE_COLOURS
from urbanforest_cli.export.plant_scene import Rgb, linear
from urbanforest_cli.export.scene.buildings import build_buildings
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view.draw_kernel import GROUND, KERB, LAWN, PAVING, ROAD, ROOF, WALL
from urbanforest_cli.export.view.faces_kernel import BAY_M

FloatArray = NDArray[np.float64]
PLAIN_RGB: Rgb = (0.60, 0.63, 0.48)
PAPER_RGB: Rgb = (0.80, 0.795, 0.765)
ROAD_RGB: Rgb = (0.60, 0.605, 0.62)
KERB_RGB: Rgb = (0.86, 0.855, 0.84)
WALL_RGB: Rgb = (0.975, 0.97, 0.955)
ROOF_RGB: Rgb = (0.82, 0.815, 0.80)
ZONE_GROUND: dict[str, tuple[Rgb, int]] = {
    "residential": ((0.55, 0.61, 0.40), LAWN),
    "commercial": ((0.75, 0.72, 0.66), PAVING),
    "industrial": ((0.70, 0.70, 0.69), PAVING),
    "street": ((0.72, 0.715, 0.69), PAVING),
    "other": ((0.46, 0.56, 0.32), LAWN),
}
TILE_RGB: Rgb = (0.755, 0.725, 0.695)
WALL_MATERIAL = "wall"
UPRIGHT, FLAT = 0.1, 0.95  # share of a normal that looks up: less is a wall, more a flat roof
KERB_M = 0.25
LOT_TONE = 0.06  # lots of a zone differ in lightness by this share


@dataclass(frozen=True)
class Surfaces:
    """Flat triangles: (n, 3, 3) corners, (n, 3) normals, (n, 3) bytes of colour, (n,) kinds, (n, 3, 2) metres on walls.

    Colours are square roots of linear light.
    """

    corners: FloatArray
    normal: FloatArray
    rgb: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    uv: FloatArray


def no_surfaces() -> Surfaces:
    """Return none."""
    return Surfaces(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3), np.uint8), np.empty(0, np.uint8),
                    np.empty((0, 3, 2)))  # fmt: skip


def joined_surfaces(parts: Sequence[Surfaces]) -> Surfaces:
    """Put surfaces behind each other; of paint the last lies on top."""
    parts = [no_surfaces(), *parts]
    return Surfaces(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ("corners", "normal", "rgb", "kind", "uv")))  # fmt: skip


def colour_bytes(rgb: Rgb | FloatArray) -> NDArray[np.uint8]:
    """Return sRGB colours from 0 to 1 as bytes of the canvas."""
    return np.asarray(np.clip(np.sqrt(linear(rgb)) * 255 + 0.5, 0, 255), dtype=np.uint8)


def build_ground(city: City) -> Surfaces:
    """Paint lots in the quiet colours of their zones, then roads and their kerbs."""
    parts = []
    lots = city.local_shapes(city.lots)
    if len(lots):
        parts.append(_paint(lots, *_lot_colours(city)))
    roads = city.local_shapes(city.roads)
    if len(roads):
        whole = np.array([shapely.union_all(roads)], dtype=object)
        kerb = shapely.buffer(whole, KERB_M, join_style="mitre")
        parts.append(_paint(kerb, colour_bytes(KERB_RGB)[None], np.array([KERB], np.uint8)))
        parts.append(_paint(whole, colour_bytes(ROAD_RGB)[None], np.array([ROAD], np.uint8)))
    return joined_surfaces(parts)


def _lot_colours(city: City) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    of_hex: dict[str, tuple[Rgb, int]] = {ZONE_COLOURS[zone]: look for zone, look in ZONE_GROUND.items()}
    looks = []
    for number, colour in zip(_own_numbers(city.lots), city.lot_colour, strict=True):
        rgb, kind = of_hex.get(str(colour), _quiet(str(colour)))
        tone = 1.0 + LOT_TONE * (((number * 2654435761) % 1024) / 511.5 - 1.0)
        looks.append((tuple(min(part * tone, 1.0) for part in rgb), kind))
    return colour_bytes(np.array([rgb for rgb, _ in looks])), np.array([kind for _, kind in looks], np.uint8)


def _own_numbers(lots: NDArray[np.object_]) -> list[int]:
    """Return a number by chance for each lot, from where its middle lies: other lots and their order do not count."""
    middle = np.nan_to_num(shapely.get_coordinates(shapely.centroid(lots)))
    return [int(x) * 73856093 ^ int(y) * 19349663 for x, y in np.rint(10 * middle)]


def _quiet(colour: str) -> tuple[Rgb, int]:
    """Return the ground of a lot whose zone's colour is the user's own: green ones are lawns."""
    rgb = to_rgb(colour)
    if rgb[1] >= max(rgb[0], rgb[2]):
        return ZONE_GROUND["other"]
    return (0.8 * rgb[0], 0.8 * rgb[1], 0.8 * rgb[2]), PAVING


def _paint(shapes: NDArray[np.object_], rgb: NDArray[np.uint8], kind: NDArray[np.uint8]) -> Surfaces:
    triangles, owner = shapely.get_parts(shapely.constrained_delaunay_triangles(shapes), return_index=True)
    xy = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    count = len(xy)
    corners = np.concatenate((xy, np.zeros((count, 3, 1))), axis=2)
    return Surfaces(corners, np.tile([0.0, 0.0, 1.0], (count, 1)), rgb[owner], kind[owner],
                    np.full((count, 3, 2), -1.0))  # fmt: skip


def build_houses(city: City) -> Surfaces:
    """Raise houses with walls, windows and roofs."""
    parts = [no_surfaces()]
    for piece in build_buildings(city).pieces:
        mesh = piece.mesh
        corners = (mesh.xyz_m.astype(np.float64) + np.array(piece.centre_m))[mesh.triangle]
        normal = mesh.normal[mesh.triangle[:, 0]].astype(np.float64)
        uv = mesh.uv.astype(np.float64)[mesh.triangle]
        upright = np.abs(normal[:, 2]) < UPRIGHT
        is_wall = upright & (piece.material.name == WALL_MATERIAL)
        pitched = ~upright & (normal[:, 2] < FLAT)
        rgb = np.where(is_wall[:, None], colour_bytes(WALL_RGB),
                       np.where(pitched[:, None], colour_bytes(TILE_RGB), colour_bytes(ROOF_RGB)))  # fmt: skip
        kind = np.where(is_wall, WALL, ROOF)
        parts.append(Surfaces(corners, normal, rgb.astype(np.uint8), kind.astype(np.uint8),
                              _whole_windows(corners, uv, is_wall)))  # fmt: skip
    return joined_surfaces(parts)


def _whole_windows(corners: FloatArray, uv: FloatArray, is_wall: NDArray[np.bool_]) -> FloatArray:
    """Return (n, 3, 2) metres along and up each wall, stretched so that windows fit; negative where there are none."""
    along, up = uv[:, :, 0], corners[:, :, 2]
    length, height = np.ptp(along, axis=1), up.max(axis=1)
    has = is_wall & (length > 0.6 * BAY_M) & (up.min(axis=1) < 0.1) & (height > 0.8 * BAY_M)
    bays, floors = np.maximum(np.rint(length / BAY_M), 1), np.maximum(np.rint(height / BAY_M), 1)
    wide = (along - along.min(axis=1)[:, None]) / np.maximum(length, 1e-9)[:, None] * (bays * BAY_M)[:, None]
    high = up / np.maximum(height, 1e-9)[:, None] * (floors * BAY_M)[:, None]
    return np.where(has[:, None, None], np.stack((wide, np.maximum(high, 0.0)), axis=2), -1.0)


def plain_ground(paper: bool) -> tuple[NDArray[np.uint8], int]:
    """Return colour and kind of the ground beyond the city: pale as paper, or fields."""
    return (colour_bytes(PAPER_RGB), ROOF) if paper else (colour_bytes(PLAIN_RGB), GROUND)
