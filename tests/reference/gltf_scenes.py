"""Small scenes for tests of files: lopsided cone trees, so that a turn or a mirror shows."""

import struct
import zlib

import numpy as np
from pyproj import CRS

from urbanforest_cli.core.scenery import (
    Fixed,
    Instances,
    Material,
    Mesh,
    Model,
    Origin,
    Part,
    Points,
    Property,
    Scenery,
)

ORIGIN = Origin(CRS.from_epsg(32631), 452_300.5, 5_411_200.25, 12.5)


def png(rgba=(90, 140, 60, 255), side=4):
    """A PNG of one colour, written by hand."""
    rows = b"".join(b"\0" + bytes(rgba) * side for _ in range(side))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", side, side, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def cone(height=8.0, radius=2.0, sides=9, *, foot=0.0, lean=(0.7, 0.3), repeat=1.0, tint=255):
    """A cone that leans, with flat normals, its texture `repeat` times round."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, foot)], axis=1)
    tip = np.array([lean[0], lean[1], foot + height])
    corners = np.stack([ring, np.roll(ring, -1, axis=0), np.broadcast_to(tip, ring.shape)], axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u = np.arange(sides) / sides * repeat
    uv = np.stack(
        [np.stack([u, u + repeat / sides, u], axis=1), np.broadcast_to([1.0 * repeat, 1.0 * repeat, 0.0], (sides, 3))],
        axis=2,
    )
    return Mesh(
        corners.reshape(-1, 3).astype(np.float32),
        np.repeat(normal, 3, axis=0).astype(np.float32),
        uv.reshape(-1, 2).astype(np.float32),
        np.full((3 * sides, 3), tint, np.uint8),
        np.arange(3 * sides, dtype=np.uint32).reshape(-1, 3),
    )


MATERIALS = (
    Material("bark", rgb=(0.8, 0.7, 0.6), texture=png((120, 90, 60, 255))),
    Material("leaf", texture=png(), alpha_cutoff=0.5, two_sided=True),
    Material("wall", rgb=(0.9, 0.9, 0.9)),
    Material("baked", texture=png((60, 90, 60, 255)), alpha_cutoff=0.4, two_sided=True, unlit=True),
)
MODELS = (
    Model("oak 1", (Part(cone(3.0, 0.4, repeat=2.5, tint=180), 0), Part(cone(foot=2.0), 1))),
    Model("oak 2", (Part(cone(27.3, 6.0, lean=(-2.0, 1.0)), 1),)),
    Model("shrub", (Part(cone(0.7, 0.5), 3), Part(cone(0.2, 0.1, repeat=3.0), 0))),
)


def properties_of(count, rng):
    """The columns every output has, of made-up plants."""

    def column(values, doc, kind="float32", names=()):
        return Property(values, kind, doc, names)

    ids = np.array([f"L{n // 7:06d}-{n % 7}" for n in range(count)], np.object_)
    lots = np.array([f"L{n // 7:06d}" for n in range(count)], np.object_)
    low = {"age_years": 3.0, "height_m": 2.0, "crown_radius_m": 0.5, "crown_base_m": 0.3, "dbh_m": 0.02}
    return {
        "plant_id": column(ids, "identifier", "text"),
        "lot_id": column(lots, "lot", "text"),
        "species": column(rng.integers(0, 3, count).astype(np.uint8), "species", "enum", ("Tilia", "Quercus", "Acer")),
        "habit": column(rng.integers(0, 2, count).astype(np.uint8), "habit", "enum", ("tree", "shrub")),
        **{name: column(np.round(least * rng.uniform(1, 9, count), 3), name) for name, least in low.items()},
    }


def scene(count=60, *, points=0, reach_m=300.0, scaled=True, fixed=True, models=MODELS, seed=3):
    """A scene of `count` instances and `points` points within a square."""
    rng = np.random.default_rng(seed)
    xyz = np.concatenate([rng.uniform(-reach_m, reach_m, (count, 2)), rng.uniform(-2, 2, (count, 1))], axis=1)
    instances = Instances(
        rng.integers(0, len(models), count).astype(np.int32),
        xyz,
        rng.uniform(-np.pi, 2 * np.pi, count),
        rng.random(count) < 0.5,
        rng.uniform(0.8, 1.2, count) if scaled else np.ones(count),
    )
    dots = None
    if points:
        at = np.concatenate([rng.uniform(-reach_m, reach_m, (points, 2)), rng.uniform(2, 9, (points, 1))], axis=1)
        dots = Points(at, rng.integers(0, 256, (points, 3)).astype(np.uint8))
    things = (Fixed("block 1", cone(9.0, 12.0, 4), 2, (40.0, -20.0, 0.0)),) if fixed else ()
    columns = properties_of(count + points, rng)
    return Scenery(ORIGIN, MATERIALS, models, instances, columns, things, dots, {"stage": "export", "seed": "7"})
