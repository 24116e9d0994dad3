"""Textures of tiles no finer than what is seen of them: some viewers keep a copy for every tile."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from urbanforest_cli.core.scenery import Material, Mesh, Scenery

SHARPER = 2.0
"""Texels for each pixel of the view that details are planned for, an edge: screens may be finer."""
SIDE_MIN_PX = 64


def with_small_textures(scenery: Scenery, pixels_per_m: float) -> list[Material]:
    """Return a scene's materials, their textures halved until they are just fine enough.

    Parameters
    ----------
    scenery
        Its models tell how large a texture lies on them; where it lists none, textures stay as they are.
    pixels_per_m
        Pixels of the view that a metre covers at the nearest place where the scene is shown.
    """
    turns, square_m = np.zeros(len(scenery.materials)), np.zeros(len(scenery.materials))
    for model in scenery.models:
        for part in model.parts:
            turns[part.material] += _area(part.mesh.uv[part.mesh.triangle])
            square_m[part.material] += _surface_m2(part.mesh)
    return [
        material if not shown else _shrunk(material, covered / shown, pixels_per_m * SHARPER)
        for material, covered, shown in zip(scenery.materials, turns, square_m, strict=True)
    ]


def _shrunk(material: Material, turns_per_m2: float, texels_per_m: float) -> Material:
    """Return a material whose texture has just more than so many texels a metre, where turns are whole textures."""
    if material.texture is None:
        return material
    picture: Image.Image = Image.open(io.BytesIO(material.texture))
    width, height = picture.size
    has_per_m = float(np.sqrt(turns_per_m2 * width * height))
    factor = 1
    while has_per_m / (2 * factor) >= texels_per_m and min(width, height) // (2 * factor) >= SIDE_MIN_PX:
        factor *= 2
    return material if factor == 1 else replace(material, texture=_smaller(picture, factor))


def _smaller(picture: Image.Image, factor: int) -> bytes:
    """Return a picture reduced by a whole factor as PNG; clear texels lend no colour to their neighbours."""
    rgba = np.asarray(picture.convert("RGBA"), dtype=np.float64)
    height, width = rgba.shape[0] // factor, rgba.shape[1] // factor
    blocks = rgba[: height * factor, : width * factor].reshape(height, factor, width, factor, 4)
    alpha = blocks[..., 3:]
    weight = np.where(alpha.sum(axis=(1, 3), keepdims=True) > 0, alpha, 1.0)
    colour = (blocks[..., :3] * weight).sum(axis=(1, 3)) / weight.sum(axis=(1, 3))
    small = np.rint(np.concatenate([colour, alpha.mean(axis=(1, 3))], axis=2)).astype(np.uint8)
    stream = io.BytesIO()
    image = Image.fromarray(small if small[..., 3].min() < 255 else np.ascontiguousarray(small[..., :3]))
    image.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def _area(uv: NDArray[np.float32]) -> float:
    (x1, y1), (x2, y2) = ((uv[:, k] - uv[:, 0]).astype(np.float64).T for k in (1, 2))
    return 0.5 * float(np.abs(x1 * y2 - x2 * y1).sum())


def _surface_m2(mesh: Mesh) -> float:
    corners = mesh.xyz_m[mesh.triangle].astype(np.float64)
    sides = corners[:, 1:] - corners[:, :1]
    return 0.5 * float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())
