"""Measure writing a forest as glTF: seconds and bytes a tree, beside trimesh with a node a tree.

Run as ``python -m benchmarks exports``.
"""

from __future__ import annotations

import io
import time

import numpy as np
import trimesh
from pyproj import CRS

from urbanforest_cli.core.scenery import Instances, Material, Mesh, Model, Origin, Part, Property, Scenery
from urbanforest_cli.files.gltf import glb_bytes

SIDE_M = 5000.0
MODELS = 300
SIDES = 24
PAPER_PLANTS = 54_000
MANY_PLANTS = 1_000_000
SPECIES = tuple(f"species_{number}" for number in range(10))


def cone(height_m: float) -> Mesh:
    """Return a cone with its foot on the ground."""
    turn = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SIDES)])
    xyz = np.vstack([ring, [[0.0, 0.0, height_m]], [[0.0, 0.0, 0.0]]]).astype(np.float32)
    normal = xyz - np.array([0, 0, 0.3 * height_m], np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    here, after = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    sides = np.column_stack([here, after, np.full(SIDES, SIDES)])
    foot = np.column_stack([after, here, np.full(SIDES, SIDES + 1)])
    return Mesh(xyz, normal, np.zeros((len(xyz), 2), np.float32), np.full((len(xyz), 3), 255, np.uint8),
                np.vstack([sides, foot]).astype(np.uint32))  # fmt: skip


def forest(plants: int) -> Scenery:
    """Return a scene of plants with all that a real one knows of each."""
    rng = np.random.default_rng(1)
    lot = np.sort(rng.integers(0, max(plants // 8, 1), plants))
    within = np.arange(plants) - np.searchsorted(lot, lot)
    lot_id = np.array([f"L{number:06d}" for number in range(lot.max() + 1)], dtype=object)[lot]
    plant_id = np.array([f"L{number:06d}-{row}" for row, number in zip(within, lot, strict=True)], dtype=object)
    numbers = {name: Property(np.round(rng.uniform(0, 20, plants), 3).astype(np.float32), "float32", name)
               for name in ("age_years", "height_m", "crown_radius_m", "crown_base_m", "dbh_m")}  # fmt: skip
    place = np.column_stack([rng.uniform(-SIDE_M / 2, SIDE_M / 2, (plants, 2)), np.zeros(plants)])
    return Scenery(
        origin=Origin(CRS.from_epsg(32633), 459_000.0, 5_549_000.0),
        materials=[Material("bark", rgb=(0.3, 0.25, 0.2))],
        models=[Model(f"model {number}", (Part(cone(5 + number / 30), 0),)) for number in range(MODELS)],
        instances=Instances(rng.integers(0, MODELS, plants).astype(np.int32), place,
                            rng.uniform(0, 2 * np.pi, plants), rng.random(plants) < 0.5,
                            rng.uniform(0.8, 1.2, plants)),
        properties={
            "plant_id": Property(plant_id, "text", "plant"),
            "lot_id": Property(lot_id, "text", "lot"),
            "species": Property(rng.integers(0, 10, plants).astype(np.uint8), "enum", "species", SPECIES),
            "habit": Property(np.zeros(plants, np.uint8), "enum", "habit", ("tree", "shrub")),
            **numbers,
        },
    )  # fmt: skip


def written(scenery: Scenery, *, plain: bool = False) -> tuple[float, int]:
    """Return CPU seconds and bytes of one scene."""
    start = time.process_time()
    content = glb_bytes(scenery, plain=plain)
    return time.process_time() - start, len(content)


def by_trimesh(scenery: Scenery) -> tuple[float, int]:
    """Write the same plants with trimesh: meshes shared, a node a tree."""
    meshes = [trimesh.Trimesh(model.parts[0].mesh.xyz_m, model.parts[0].mesh.triangle, process=False)
              for model in scenery.models]  # fmt: skip
    plants = scenery.instances
    start = time.process_time()
    scene = trimesh.Scene()
    names = [scene.add_geometry(mesh, geom_name=f"m{number}", node_name=f"p{number}") and f"m{number}"
             for number, mesh in enumerate(meshes)]  # fmt: skip
    for row in range(len(plants)):
        matrix = np.eye(4)
        c, s, k = np.cos(plants.yaw_rad[row]), np.sin(plants.yaw_rad[row]), plants.scale[row]
        matrix[:2, :2] = k * np.array([[c, -s], [s, c]])
        matrix[2, 2] = k
        matrix[:3, 3] = plants.xyz_m[row]
        scene.graph.update(frame_to=f"t{row}", frame_from="world", matrix=matrix, geometry=names[plants.model[row]])
    stream = io.BytesIO(scene.export(file_type="glb"))
    return time.process_time() - start, len(stream.getvalue())


def main() -> None:
    """Run the measurements and print a line each."""
    written(forest(100))
    models_alone = written(forest(2 * MODELS))[1]
    ours = forest(PAPER_PLANTS)
    seconds, size = written(ours)
    print(f"{PAPER_PLANTS:,} plants: {seconds:.2f} CPU s, {size / 1e6:.2f} MB with {MODELS} cones, "
          f"{(size - models_alone) / (PAPER_PLANTS - 2 * MODELS):.1f} bytes a tree")  # fmt: skip
    plain_seconds, plain_size = written(ours, plain=True)
    print(f"  without extensions: {plain_seconds:.2f} CPU s, {plain_size / 1e6:.2f} MB")
    their_seconds, their_size = by_trimesh(ours)
    ratio = f"{their_seconds / seconds:.0f} times as long, {their_size / size:.1f} times as large"
    print(f"  trimesh, a node a tree: {their_seconds:.2f} CPU s, {their_size / 1e6:.2f} MB: {ratio}, no ids")
    many = forest(MANY_PLANTS)
    seconds, size = written(many)
    print(f"{MANY_PLANTS:,} plants: {seconds:.2f} CPU s, {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
