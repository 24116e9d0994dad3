"""From a planted city to a scene: shapes that many plants share, what stands where, what is known of each plant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.core.scenery import (
    Fixed,
    Instances,
    Material,
    Meshes,
    Model,
    Part,
    Points,
    Property,
    Scenery,
)
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.export.mesh.billboards import bake_billboards
from urbanforest_cli.export.mesh.leaves import build_leaves
from urbanforest_cli.export.mesh.levels import LEVELS
from urbanforest_cli.export.mesh.textures import ALPHA_CUTOFF, bark_texture, leaf_texture
from urbanforest_cli.export.mesh.wood import build_wood
from urbanforest_cli.export.plant_looks import Season, look_of
from urbanforest_cli.export.plant_scene import Look
from urbanforest_cli.export.scene.city import City, Plants
from urbanforest_cli.export.scene.pieces import Piece
from urbanforest_cli.export.scene.prototypes import Prototypes

SKELETONS_AT_ONCE = 100
TRIANGLES_MAX = 60_000_000  # some 4 GB in memory, and all that a GLB can hold
HABITS = ("tree", "shrub")


@dataclass(frozen=True)
class Shapes:
    """Models of plants at one level of detail, and the materials they are made of."""

    materials: list[Material]
    models: list[Model]


def build_shapes(city: City, prototypes: Prototypes, *, detail: str, season: Season) -> Shapes:
    """Turn the skeletons that a scene needs into models.

    Parameters
    ----------
    prototypes
        Which skeletons.
    detail
        A name of `LEVELS` but point.
    season
        See `mesh.leaves`.
    """
    looks = [look_of(item) for item in city.species]
    species = prototypes.species
    names = [f"{city.species[s].id} {number}" for s, number in zip(species, prototypes.skeleton_id, strict=True)]
    if detail == "billboard":
        return _billboards(city, prototypes, names, looks, season)
    used = np.unique(species)
    materials: list[Material] = []
    bark_of: dict[int, int] = {}
    leaf_of: dict[int, int] = {}
    for row in used.tolist():
        item, look = city.species[row], looks[row]
        bark_of[row] = len(materials)
        materials.append(Material(f"bark of {item.id}", texture=_bark(item, look)))
        leaf_of[row] = len(materials)
        leaves = _leaves(item, look, season)
        materials.append(Material(f"leaves of {item.id}", texture=leaves, alpha_cutoff=ALPHA_CUTOFF, two_sided=True))
    models = []
    triangles = 0
    for start, skeletons in _batches(city, prototypes):
        rows = range(start, start + len(skeletons))
        end = city.season_end(skeletons)
        wood = build_wood(skeletons, end, LEVELS[detail])
        own = [looks[species[row]] for row in rows]
        leaves_of = build_leaves(skeletons, end, own, LEVELS[detail], season=season)
        triangles += len(wood.triangle) + len(leaves_of.triangle)
        if triangles > TRIANGLES_MAX:
            raise LimitError(
                "too many triangles for one file",
                found=f"more than {TRIANGLES_MAX:,} after {rows.stop} of {len(names)} shapes",
                next_step="take a part of the city with --bbox, fewer --prototypes, or a lower --detail",
            )
        for number, row in enumerate(rows):
            parts = [(wood, bark_of[int(species[row])]), (leaves_of, leaf_of[int(species[row])])]
            models.append(Model(names[row], _parts(parts, number)))
    return Shapes(materials, models)


_bark = lru_cache(maxsize=None)(bark_texture)
_leaves = lru_cache(maxsize=None)(leaf_texture)


def _batches(city: City, prototypes: Prototypes) -> Iterator[tuple[int, Skeletons]]:
    for start in range(0, len(prototypes.skeleton_id), SKELETONS_AT_ONCE):
        yield start, city.skeletons_of(prototypes.skeleton_id[start : start + SKELETONS_AT_ONCE])


def _parts(meshes: Sequence[tuple[Meshes, int]], number: int) -> tuple[Part, ...]:
    found = [Part(batch.mesh(number), material) for batch, material in meshes]
    return tuple(part for part in found if len(part.mesh.triangle))


def _billboards(
    city: City, prototypes: Prototypes, names: Sequence[str], looks: Sequence[Look], season: Season
) -> Shapes:
    materials: list[Material] = []
    models = []
    for start, skeletons in _batches(city, prototypes):
        own = [looks[prototypes.species[row]] for row in range(start, start + len(skeletons))]
        baked = bake_billboards(skeletons, city.season_end(skeletons), own, season=season)
        first = len(materials)
        materials += [
            Material(
                f"plants seen from three sides {first + number}",
                texture=png,
                alpha_cutoff=ALPHA_CUTOFF,
                two_sided=True,
                unlit=True,
            )
            for number, png in enumerate(baked.atlases)
        ]
        models += [
            Model(names[start + number], _parts([(baked.meshes, first + int(baked.atlas_of[number]))], number))
            for number in range(len(skeletons))
        ]
    return Shapes(materials, models)


def instances_of(city: City, prototypes: Prototypes) -> Instances:
    """Return what stands where, a row a plant."""
    return Instances(
        model=prototypes.model,
        xyz_m=city.local(city.plants.xy_m),
        yaw_rad=prototypes.yaw_rad,
        mirror=prototypes.mirror,
        scale=prototypes.scale,
    )


def no_instances() -> Instances:
    """Return none."""
    return Instances(np.empty(0, np.int32), np.empty((0, 3)), np.empty(0), np.empty(0, np.bool_), np.empty(0))


def points_of(city: City) -> Points:
    """Return plants as points in the middle of their crowns, in the colour of their leaves."""
    plants = city.plants
    place = city.local(plants.xy_m)
    place[:, 2] += 0.5 * (plants.crown_base_m + plants.height_m)
    colour = np.array([look_of(item).leaf for item in city.species]).reshape(-1, 3)
    return Points(place, np.rint(255 * colour[plants.species]).astype(np.uint8))


def properties_of(city: City) -> dict[str, Property]:
    """Return what is known of each plant."""
    plants = city.plants
    used, species = np.unique(plants.species, return_inverse=True)
    trees = np.array([item.habit == "tree" for item in city.species] or [True])
    found = {
        "plant_id": Property(plants.plant_id, "text", "plant of the register"),
        "lot_id": Property(plants.lot_id, "text", "lot it stands on"),
        "species": Property(
            species.astype(np.min_scalar_type(max(len(used) - 1, 0))),
            "enum",
            "species identifier",
            tuple(city.species[row].id for row in used),
        ),
        "habit": Property(np.where(trees[plants.species], 0, 1).astype(np.uint8), "enum", "tree or shrub", HABITS),
    }
    return found | _numbers(plants)


def _numbers(plants: Plants) -> dict[str, Property]:
    columns = {
        "age_years": "age in years",
        "height_m": "height in metres",
        "crown_radius_m": "mean reach of the crown in metres",
        "crown_base_m": "height of the lowest branch in metres",
        "dbh_m": "diameter of the stems at 1.3 m, in metres",
    }
    return {name: Property(getattr(plants, name).astype(np.float32), "float32", text) for name, text in columns.items()}


def _fixed(pieces: Sequence[Piece], first_material: int) -> tuple[list[Material], list[Fixed]]:
    """Return what is not a plant, and its materials, which are to follow `first_material` others."""
    materials: list[Material] = []
    for piece in pieces:
        if piece.material not in materials:
            materials.append(piece.material)
    fixed = [
        Fixed(piece.name, piece.mesh, first_material + materials.index(piece.material), piece.centre_m)
        for piece in pieces
    ]
    return materials, fixed


def build_scenery(
    city: City,
    prototypes: Prototypes,
    *,
    detail: str,
    season: Season,
    pieces: Sequence[Piece],
    provenance: Mapping[str, Any],
) -> Scenery:
    """Put a scene together.

    Parameters
    ----------
    detail
        A name of `LEVELS`.
    pieces
        Buildings and ground.
    """
    as_points = detail == "point"
    shapes = Shapes([], []) if as_points else build_shapes(city, prototypes, detail=detail, season=season)
    materials, fixed = _fixed(pieces, len(shapes.materials))
    return Scenery(
        origin=city.origin,
        materials=[*shapes.materials, *materials],
        models=shapes.models,
        instances=no_instances() if as_points else instances_of(city, prototypes),
        properties=properties_of(city),
        fixed=fixed,
        points=points_of(city) if as_points else None,
        provenance=provenance,
    )
