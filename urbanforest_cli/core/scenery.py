"""A scene as every writer of 3D files takes it: models stored once, what stands where, and what is known of each plant.

Metres about a stated origin: x east (grid), y north (grid), z up. Writers turn axes where their format wants others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

PropertyType = Literal["text", "enum", "float32", "uint8", "uint16", "uint32"]


@dataclass(frozen=True)
class Mesh:
    """Triangles that share corners, counter-clockwise seen from outside.

    Parameters
    ----------
    xyz_m
        (v, 3) float32 corners.
    normal
        (v, 3) float32 of length 1.
    uv
        (v, 2) float32 place on the texture, (0, 0) its upper left corner; beyond 0 to 1 the texture repeats.
    tint
        (v, 3) uint8 factor on the texture's colour in linear light, 255 for none.
    triangle
        (t, 3) uint32 corners.
    """

    xyz_m: NDArray[np.float32]
    normal: NDArray[np.float32]
    uv: NDArray[np.float32]
    tint: NDArray[np.uint8]
    triangle: NDArray[np.uint32]


@dataclass(frozen=True)
class Meshes:
    """Several meshes in flat arrays, as `Mesh` has them; corners of a triangle count from its own mesh's first.

    Parameters
    ----------
    first_vertex, first_triangle
        (s + 1,) int64 offsets.
    """

    first_vertex: NDArray[np.int64]
    first_triangle: NDArray[np.int64]
    xyz_m: NDArray[np.float32]
    normal: NDArray[np.float32]
    uv: NDArray[np.float32]
    tint: NDArray[np.uint8]
    triangle: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.first_vertex) - 1

    def mesh(self, number: int) -> Mesh:
        """Return one of them, as views."""
        corners = slice(self.first_vertex[number], self.first_vertex[number + 1])
        return Mesh(
            self.xyz_m[corners],
            self.normal[corners],
            self.uv[corners],
            self.tint[corners],
            self.triangle[self.first_triangle[number] : self.first_triangle[number + 1]],
        )


@dataclass(frozen=True)
class Material:
    """What a surface looks like.

    Parameters
    ----------
    name
        Unique in a scene.
    rgb
        Factor on the texture's colour, in linear light.
    texture
        A PNG, colours as sRGB; its alpha cuts leaves out of cards. None for plain colour.
    alpha_cutoff
        Alpha below which nothing is drawn; None where all is opaque.
    two_sided
        Whether the back is drawn.
    unlit
        Whether light is in the texture already, as on baked pictures of plants.
    """

    name: str
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: bytes | None = None
    alpha_cutoff: float | None = None
    two_sided: bool = False
    unlit: bool = False
    roughness: float = 0.9


@dataclass(frozen=True)
class Part:
    """A mesh and its material's place in the scene's list."""

    mesh: Mesh
    material: int


@dataclass(frozen=True)
class Model:
    """A plant's shape, its root collar at (0, 0, 0); `name` is unique in a scene and says species and skeleton."""

    name: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Instances:
    """Plants that stand in a scene: (n,) each; a model is mirrored (y to -y), then turned, then scaled, then placed.

    Parameters
    ----------
    model
        int32 place in the scene's models.
    xyz_m
        (n, 3) float64 about the scene's origin.
    yaw_rad
        Counter-clockwise turn.
    mirror
        bool.
    scale
        Factor on size.
    """

    model: NDArray[np.int32]
    xyz_m: NDArray[np.float64]
    yaw_rad: NDArray[np.float64]
    mirror: NDArray[np.bool_]
    scale: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.model)

    def take(self, rows: NDArray[Any]) -> Instances:
        """Return some of them."""
        return Instances(self.model[rows], self.xyz_m[rows], self.yaw_rad[rows], self.mirror[rows], self.scale[rows])


@dataclass(frozen=True)
class Points:
    """Plants drawn as nothing but points: (n, 3) float64 about the scene's origin, (n, 3) uint8 sRGB colours."""

    xyz_m: NDArray[np.float64]
    rgb: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.xyz_m)


@dataclass(frozen=True)
class Property:
    """One column of what is known of each plant.

    Parameters
    ----------
    values
        (n,) numbers; for text an object array of str; for an enum uint8 or uint16 places in `names`.
    type, doc
        How it is stored, and what it means with its unit.
    names
        Words of an enum.
    """

    values: NDArray[Any]
    type: PropertyType
    doc: str
    names: tuple[str, ...] = ()

    def take(self, rows: NDArray[Any]) -> Property:
        """Return the column of some plants."""
        return Property(self.values[rows], self.type, self.doc, self.names)


@dataclass(frozen=True)
class Fixed:
    """What is not a plant: buildings, ground; `mesh` is about `centre_m`, so that its numbers stay small."""

    name: str
    mesh: Mesh
    material: int
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Origin:
    """Where (0, 0, 0) of a scene lies on Earth.

    Parameters
    ----------
    crs
        Projected, metres.
    easting_m, northing_m, height_m
        In that CRS; heights are above the ground of the scene, which is flat.
    """

    crs: CRS
    easting_m: float
    northing_m: float
    height_m: float = 0.0


@dataclass(frozen=True)
class Scenery:
    """All a 3D file holds.

    Parameters
    ----------
    origin
        Where it lies.
    materials, models
        What instances and fixed things are made of; each is stored once.
    instances
        Plants, one a row.
    points
        Plants that are only points.
    properties
        Columns of the plants, ``plant_id`` first; rows are `instances`, then `points`.
    fixed
        Buildings and ground.
    provenance
        Goes into the file.
    """

    origin: Origin
    materials: Sequence[Material]
    models: Sequence[Model]
    instances: Instances
    properties: Mapping[str, Property]
    fixed: Sequence[Fixed] = ()
    points: Points | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
