"""Cut ground and buildings into square cells, curved as the Earth is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.geodesy import frame_turn_rad, to_enu
from urbanforest_cli.core.scenery import Fixed, Mesh, Origin
from urbanforest_cli.core.tiles import FixedCell

CELL_M = 512.0
EDGE_MAX_M = 256.0
"""A longer edge is halved: an edge of this length lies 1.3 mm below the curve."""
GROUND_MAX_M = 0.5
"""What is no higher is ground."""


def cut_cells(fixed: Sequence[Fixed], origin: Origin, *, ground_height_m: float = 0.0) -> list[FixedCell]:
    """Return the cells that hold anything, from south-west to north-east; each triangle lies in one of them.

    Parameters
    ----------
    fixed
        About the origin, in grid metres.
    """
    soups = [_soup(piece) for piece in fixed if len(piece.mesh.triangle)]
    if not soups:
        return []
    corners, looks, material, is_ground = (np.concatenate([soup[column] for soup in soups]) for column in range(4))
    corners, looks, material, is_ground = _halve_long_edges(corners, looks, material, is_ground)
    placed = to_enu(origin, corners.reshape(-1, 3), ground_height_m=ground_height_m).reshape(corners.shape)
    turn = frame_turn_rad(origin, corners.mean(axis=1))
    looks[:, :, :2] = _turned(looks[:, :, :2], turn)
    middle = placed.mean(axis=1)
    first = placed[:, :, :2].min(axis=(0, 1))
    cell = np.floor((middle[:, :2] - first) / CELL_M).astype(np.int64)
    order = np.lexsort((material, is_ground, cell[:, 0], cell[:, 1]))
    keys = np.column_stack([cell[:, 1], cell[:, 0], is_ground, material])[order]
    starts = np.flatnonzero((np.diff(keys, axis=0, prepend=keys[:1] - 1) != 0).any(axis=1))
    held: dict[tuple[int, int], tuple[list[Fixed], list[Fixed]]] = {}
    for start, end in zip(starts, np.append(starts[1:], len(keys)), strict=True):
        y, x, ground, number = (int(value) for value in keys[start])
        rows = order[start:end]
        centre = tuple(float(value) for value in np.rint(first + (np.array([x, y]) + 0.5) * CELL_M))
        piece = _piece(
            placed[rows], looks[rows], number, (centre[0], centre[1], 0.0), "ground" if ground else "buildings"
        )
        held.setdefault((y, x), ([], []))[0 if ground else 1].append(piece)
    return [FixedCell(x, y, tuple(ground), tuple(built)) for (y, x), (ground, built) in sorted(held.items())]


def _soup(piece: Fixed) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return a piece's triangles on their own: corners (t, 3, 3), normal, uv and tint (t, 3, 8), material, ground."""
    mesh = piece.mesh
    looks = np.concatenate([mesh.normal, mesh.uv, mesh.tint], axis=1, dtype=np.float64)
    corners = (mesh.xyz_m.astype(np.float64) + np.array(piece.centre_m))[mesh.triangle]
    is_ground = int(mesh.xyz_m[:, 2].max() + piece.centre_m[2] <= GROUND_MAX_M)
    count = len(corners)
    return corners, looks[mesh.triangle], np.full(count, piece.material), np.full(count, is_ground)


def _halve_long_edges(
    corners: NDArray[np.float64],
    looks: NDArray[np.float64],
    material: NDArray[np.int64],
    is_ground: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Cut triangles in two at the middle of their longest edge until none is too long.

    Neighbours cut an edge they share at the same place, so no gap opens.
    """
    done: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]] = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        longest = lengths.argmax(axis=1)
        is_long = lengths.max(axis=1) > EDGE_MAX_M
        done.append((corners[~is_long], looks[~is_long], material[~is_long], is_ground[~is_long]))
        turn = (longest[is_long, None] + np.arange(3)) % 3
        material, is_ground = np.tile(material[is_long], 2), np.tile(is_ground[is_long], 2)
        corners, looks = _halves(corners[is_long], turn), _halves(looks[is_long], turn)
    return (
        np.concatenate([part[0] for part in done]),
        np.concatenate([part[1] for part in done]),
        np.concatenate([part[2] for part in done]),
        np.concatenate([part[3] for part in done]),
    )


def _halves(values: NDArray[np.float64], turn: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (np.take_along_axis(values, turn[:, k, None, None], axis=1)[:, 0] for k in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _turned(xy: NDArray[np.float64], turn_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    return np.stack([xy[..., 0] * cos - xy[..., 1] * sin, xy[..., 0] * sin + xy[..., 1] * cos], axis=-1)


def _piece(
    corners: NDArray[np.float64],
    looks: NDArray[np.float64],
    material: int,
    centre_m: tuple[float, float, float],
    name: str,
) -> Fixed:
    """Return triangles as a mesh about a place, equal corners stored once."""
    flat = np.concatenate([(corners - np.array(centre_m)).reshape(-1, 3), looks.reshape(-1, 8)], axis=1)
    unique, back = np.unique(flat.astype(np.float32), axis=0, return_inverse=True)
    mesh = Mesh(
        xyz_m=np.ascontiguousarray(unique[:, :3]),
        normal=np.ascontiguousarray(unique[:, 3:6] / np.linalg.norm(unique[:, 3:6], axis=1, keepdims=True)),
        uv=np.ascontiguousarray(unique[:, 6:8]),
        tint=np.rint(unique[:, 8:]).astype(np.uint8),
        triangle=back.reshape(-1, 3).astype(np.uint32),
    )
    return Fixed(name, mesh, material, centre_m)
