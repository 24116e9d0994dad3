"""Plants seen from afar: a solid crown of ten triangles each, since a point of glTF is one pixel at any distance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Instances, Material, Mesh, Model, Part, Scenery

SIDES = 5
WIDEST_AT = 0.45
WIDTH_STEP = 1.6
BASE_STEP = 0.3
COLOUR_STEP = 24
WIDTH_MIN = 0.05
CROWN_BASE_MAX = 0.7
NEEDED = ("height_m", "crown_radius_m", "crown_base_m")


def with_solid_crowns(scenery: Scenery, standing_m: NDArray[np.float64]) -> Scenery:
    """Return a scene whose points are instances of solid crowns, in the points' colours.

    Crowns are drawn at the plant's height; colour, and width and foot of the crown as parts of the height, are rounded
    to steps (`COLOUR_STEP`, `WIDTH_STEP`, `BASE_STEP`), so that few shapes serve all.

    Parameters
    ----------
    scenery
        Holds points alone, with the properties `NEEDED`; is returned as it is where it has none of them.
    standing_m
        (n, 3) where the plants stand, about the scene's origin.
    """
    if scenery.points is None or not set(NEEDED) <= set(scenery.properties):
        return scenery
    height, radius, base = (scenery.properties[name].values.astype(np.float64) for name in NEEDED)
    height = np.maximum(height, WIDTH_MIN)
    width = np.rint(np.log(np.maximum(radius / height, WIDTH_MIN)) / math.log(WIDTH_STEP)).astype(np.int64)
    foot = np.rint(np.clip(base / height, 0.0, CROWN_BASE_MAX) / BASE_STEP).astype(np.int64)
    colour = np.minimum(np.rint(scenery.points.rgb / COLOUR_STEP) * COLOUR_STEP, 255).astype(np.int64)
    key = np.column_stack([colour, width, foot])
    shapes, model = np.unique(key, axis=0, return_inverse=True)
    colours, material = np.unique(shapes[:, :3], axis=0, return_inverse=True)
    materials = [
        Material(f"crowns from afar {number}", rgb=_linear(rgb)) for number, rgb in enumerate(colours.tolist())
    ]
    models = [
        Model(f"crown from afar {number}", (Part(_crown(WIDTH_STEP**wide, low * BASE_STEP), int(place)),))
        for number, ((*_, wide, low), place) in enumerate(zip(shapes.tolist(), material.ravel(), strict=True))
    ]
    count = len(height)
    stands = Instances(
        model=model.ravel().astype(np.int32),
        xyz_m=standing_m,
        yaw_rad=np.zeros(count),
        mirror=np.zeros(count, dtype=bool),
        scale=height,
    )
    return replace(scenery, materials=materials, models=models, instances=stands, points=None)


def _crown(radius: float, base: float) -> Mesh:
    """Return two pyramids of height 1 less `base`, foot to foot, with a normal a face."""
    angle = np.arange(SIDES) * (2 * math.pi / SIDES)
    middle = base + WIDEST_AT * (1.0 - base)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(SIDES, middle)])
    following = np.roll(ring, -1, axis=0)
    top, foot = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, base])
    above = np.stack([ring, following, np.broadcast_to(top, ring.shape)], axis=1)
    below = np.stack([following, ring, np.broadcast_to(foot, ring.shape)], axis=1)
    faces = np.concatenate([above, below])
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corners = faces.reshape(-1, 3)
    return Mesh(
        xyz_m=corners.astype(np.float32),
        normal=np.repeat(normal, 3, axis=0).astype(np.float32),
        uv=np.zeros((len(corners), 2), dtype=np.float32),
        tint=np.full((len(corners), 3), 255, dtype=np.uint8),
        triangle=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
    )


def _linear(rgb: list[int]) -> tuple[float, float, float]:
    """Return a colour of sRGB in linear light (IEC 61966-2-1)."""
    red, green, blue = (
        level / 12.92 if level <= 0.04045 else ((level + 0.055) / 1.055) ** 2.4 for level in (one / 255 for one in rgb)
    )
    return red, green, blue
