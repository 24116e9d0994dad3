"""Cut a forest into a quadtree of tiles with coarser details above finer ones.

A tile is replaced by its children when it would look wrong by more than a viewer's tolerance. Viewers shipped today
tolerate 16 pixels; with their default view (60 degrees across a 1920 x 1080 window, 36 degrees upward) a length of one
metre at a distance of d metres covers 1663 / d pixels. So an error of 1.44 m calls for replacement within 150 m: that
is the error of the level above the deepest, whose squares hold the finest detail. Errors double with each level above:
with four details the second finest serves from 150 to 300 m, the next to 600 m, and the coarsest beyond.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.geodesy import frame_turn_rad, to_enu
from urbanforest_cli.core.scenery import Model, Origin, Property, Scenery
from urbanforest_cli.core.tiles import CODE_LEVELS_MAX, TiledScene, TilePlan, from_z_order, z_order
from urbanforest_cli.export.scene.tile_cells import cut_cells
from urbanforest_cli.export.scene.tile_crowns import with_solid_crowns
from urbanforest_cli.export.scene.tile_textures import with_small_textures

FINEST_WITHIN_M = 150.0
FINEST_FROM_M = 15.0
"""Nearer, textures need not be sharp."""
TOLD_FROM_AFAR = ("plant_id", "species", "height_m")
TOLERANCE_PX = 16.0
PIXELS_OF_A_METRE_AT_ONE_METRE = 1080 / (2 * math.tan(math.atan(math.tan(math.radians(30)) * 1080 / 1920)))
LEAF_SIDE_M = 128.0
PLANTS_PER_TILE = 64
SHOWN_MAX = 8_192
"""CesiumJS styles no more plants a tile by what is known of them."""
HALF_MIN_M = 1.0
MARGIN_M = 0.1
HASH_START = np.uint64(0xCBF29CE484222325)
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)
HASH_SHIFT = np.uint64(29)
DEEPEST = CODE_LEVELS_MAX - 1


def tile_scene(sceneries: Mapping[str, Scenery], *, ground_height_m: float = 0.0) -> TiledScene:
    """Lay a scene on the Earth and cut it into tiles.

    Parameters
    ----------
    sceneries
        By detail, coarse to fine: the same origin and plants in the same order. Those of the finest are instances;
        points become solid crowns where height and crown are among their properties. Fixed things are taken from the
        finest, which alone tells all properties; others tell `TOLD_FROM_AFAR`. Textures are no finer than what is seen
        of them where their detail is shown.
    ground_height_m
        Height of the scene's ground above the ellipsoid of WGS 84.
    """
    finest = list(sceneries.values())[-1]
    origin = finest.origin
    standing = _places(finest)
    solid = {name: with_solid_crowns(scenery, standing) for name, scenery in sceneries.items()}
    laid_out = _LaidOut(origin, ground_height_m)
    laid: dict[str, Scenery] = {}
    for steps, (name, scenery) in enumerate(reversed(solid.items())):
        seen_from_m = FINEST_FROM_M if steps == 0 else FINEST_WITHIN_M * 2 ** (steps - 1)
        kept = scenery.properties if steps == 0 else _few(scenery.properties)
        materials = with_small_textures(scenery, PIXELS_OF_A_METRE_AT_ONE_METRE / seen_from_m)
        laid[name] = replace(laid_out.scenery(scenery), properties=kept, materials=materials)
    reach_m = max(_reach_m(scenery) for scenery in solid.values())

    def both_ways(detail: str, numbers: NDArray[np.int64]) -> Sequence[Model]:
        grown = solid[detail].models
        return [_mirrored(grown[n // 2]) if n % 2 else grown[n // 2] for n in numbers.tolist()]

    return TiledScene(
        origin=origin,
        ground_height_m=ground_height_m,
        plan=plan_tiles(
            _places(laid[list(sceneries)[-1]]),
            finest.properties["plant_id"].values,
            details=tuple(sceneries),
            reach_m=reach_m,
        ),
        sceneries=laid,
        cells=cut_cells(finest.fixed, origin, ground_height_m=ground_height_m),
        models_of=both_ways,
    )


def _few(properties: Mapping[str, Property]) -> Mapping[str, Property]:
    """Return what coarser details tell of a plant.

    CesiumJS counts a tile's property table once for every mesh of the tile, and loads no more once it counts 1 GB.
    """
    return {name: column for name, column in properties.items() if name in TOLD_FROM_AFAR}


class _LaidOut:
    """Lays plants on the Earth; those of all details stand at the same places, so it does so once."""

    def __init__(self, origin: Origin, ground_height_m: float) -> None:
        self._origin, self._ground_height_m = origin, ground_height_m
        self._known: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []

    def scenery(self, scenery: Scenery) -> Scenery:
        """Return a scene's plants in the frame that stands on the ellipsoid at its origin, models counted both ways.

        A mirrored plant gets a model of its own, twice its number and one: CesiumJS lights the two-sided leaves of
        mirrored nodes from the wrong side.
        """
        instances, points = scenery.instances, scenery.points
        if points is not None:
            points = replace(points, xyz_m=self._place(points.xyz_m)[0])
        place, turn = self._place(instances.xyz_m)
        instances = replace(
            instances,
            model=(2 * instances.model + instances.mirror).astype(np.int32),
            xyz_m=place,
            yaw_rad=instances.yaw_rad + turn,
            mirror=np.zeros(len(instances), dtype=bool),
        )
        return replace(scenery, models=(), instances=instances, points=points, fixed=())

    def _place(self, xyz_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        for known, place, turn in self._known:
            if np.array_equal(known, xyz_m):
                return place, turn
        place = to_enu(self._origin, xyz_m, ground_height_m=self._ground_height_m)
        self._known.append((xyz_m, place, frame_turn_rad(self._origin, xyz_m)))
        return self._known[-1][1:]


def _mirrored(model: Model) -> Model:
    """Return a model whose y is turned round."""
    other_side = np.array([1.0, -1.0, 1.0], dtype=np.float32)
    parts = (
        replace(
            part,
            mesh=replace(
                part.mesh,
                xyz_m=part.mesh.xyz_m * other_side,
                normal=part.mesh.normal * other_side,
                triangle=np.ascontiguousarray(part.mesh.triangle[:, ::-1]),
            ),
        )
        for part in model.parts
    )
    return Model(f"{model.name} mirrored", tuple(parts))


def _places(scenery: Scenery) -> NDArray[np.float64]:
    """Return (n, 3) places in the order of the properties' rows."""
    points = np.zeros((0, 3)) if scenery.points is None else scenery.points.xyz_m
    return np.concatenate([scenery.instances.xyz_m, points])


def _reach_m(scenery: Scenery) -> float:
    """Return how far a plant of a scene reaches beyond its stem, at most."""
    reach = 0.0
    if "crown_radius_m" in scenery.properties:
        reach = float(np.max(scenery.properties["crown_radius_m"].values, initial=0.0))
    if scenery.models and len(scenery.instances):
        ends = [
            max((float(np.hypot(*part.mesh.xyz_m[:, :2].T).max(initial=0.0)) for part in model.parts), default=0.0)
            for model in scenery.models
        ]
        reach = max(reach, float(np.max(np.array(ends)[scenery.instances.model] * scenery.instances.scale)))
    return reach


def plan_tiles(
    xyz_m: NDArray[np.float64],
    plant_id: NDArray[np.object_],
    *,
    details: Sequence[str],
    reach_m: float,
    plants_per_tile: int = PLANTS_PER_TILE,
    shown_max: int = SHOWN_MAX,
    leaf_side_m: float = LEAF_SIDE_M,
    finest_within_m: float = FINEST_WITHIN_M,
) -> TilePlan:
    """Plan the tiles of a forest.

    Squares are halved until their side is near `leaf_side_m`, less often where no square would hold more than
    `plants_per_tile`, and once less where a square holds no more. Deepest squares are leaves: each plant is in just
    one, at the finest detail. Every square above holds its plants too, a detail coarser for each level above the
    deepest. Above `shown_max` plants it holds a share drawn by a hash of their ids, larger by the square root of what
    each stands for: crowns then cover as much of the ground as before, and as squares are seen from twice as far with
    each level, a crown as many pixels. A plant held by a square is held by squares below it.

    Parameters
    ----------
    xyz_m
        (n, 3) positions in the frame of the tiles (`core.geodesy.to_enu`).
    plant_id
        (n,) str.
    details
        Names, coarse to fine.
    reach_m
        How far a plant reaches beyond its stem; the root's square is larger by that, so that it holds all crowns.
    plants_per_tile
        So many plants are not worth another halving.
    """
    count = len(xyz_m)
    centre, half = _square(xyz_m[:, :2], reach_m * math.sqrt(max(count / shown_max, 1.0)))
    depth = round(math.log2(2 * half / leaf_side_m)) if 2 * half > leaf_side_m else 0
    depth = min(max(depth, len(details) - 1), DEEPEST)
    cells = np.floor((xyz_m[:, :2] - (np.array(centre) - half)) * (2.0**depth / (2 * half))).astype(np.int64)
    cells = np.clip(cells, 0, (1 << depth) - 1)
    while depth >= len(details) and _most(z_order(*(cells >> 1).T)) <= plants_per_tile:
        depth, cells = depth - 1, cells >> 1
    code = z_order(*cells.T)
    rank = _rank_by_hash(plant_id)
    by_code = np.argsort(code, kind="stable")
    code = code[by_code]
    is_spared = np.zeros(count, dtype=bool)
    parts = []
    for level in range(depth + 1):
        kept_rows = by_code[~is_spared] if level == depth else by_code
        kept_code = (code[~is_spared] if level == depth else code) >> (2 * (depth - level))
        starts = np.flatnonzero(np.diff(kept_code, prepend=-1))
        sizes = np.diff(np.append(starts, len(kept_code)))
        leaf = np.full(len(starts), level == depth)
        if level == depth - 1:
            leaf = sizes <= plants_per_tile
            is_spared = np.repeat(leaf, sizes)
        shown = np.where(leaf, sizes, np.minimum(sizes, shown_max))
        rows = _rows_of_tiles(kept_rows, rank, starts, sizes, shown)
        x, y = from_z_order(kept_code[starts])
        coarser = np.where(leaf, 0, depth - level)
        parts.append((np.full(len(starts), level), x, y, leaf, coarser, np.sqrt(sizes / shown), shown, rows))
    level_of, x, y, leaf, coarser, factor, shown, rows = (
        np.concatenate([part[column] for part in parts]) for column in range(len(parts[0]))
    )
    return TilePlan(
        centre_m=centre,
        half_m=half,
        levels=int(level_of.max(initial=0)) + 1,
        details=tuple(details),
        level=level_of.astype(np.int32),
        x=x.astype(np.int32),
        y=y.astype(np.int32),
        is_leaf=leaf,
        detail=np.maximum(len(details) - 1 - coarser, 0).astype(np.int8),
        size_factor=factor,
        first=np.concatenate([[0], np.cumsum(shown)]).astype(np.int64),
        row=rows.astype(np.int64),
        root_error_m=float(np.ldexp(finest_within_m * TOLERANCE_PX / PIXELS_OF_A_METRE_AT_ONE_METRE, depth - 1)),
    )


def _square(xy_m: NDArray[np.float64], reach_m: float) -> tuple[tuple[float, float], float]:
    """Return the middle and half the side of the root."""
    if not len(xy_m):
        return (0.0, 0.0), HALF_MIN_M
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    half = max(np.max(high - low) / 2 + reach_m + MARGIN_M, HALF_MIN_M)
    middle = (low + high) / 2
    return (float(middle[0]), float(middle[1])), float(half)


def _most(code: NDArray[np.int64]) -> int:
    """Return how many plants the fullest square holds."""
    return int(np.unique(code, return_counts=True)[1].max(initial=0))


def _rows_of_tiles(
    rows: NDArray[np.int64],
    rank: NDArray[np.int64],
    starts: NDArray[np.int64],
    sizes: NDArray[np.int64],
    shown: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the rows of the first `shown` plants of each tile by their rank, ascending within a tile."""
    tile = np.repeat(np.arange(len(starts)), sizes)
    if (shown < sizes).any():
        order = np.lexsort((rank[rows], tile))
        kept = np.arange(len(rows)) - np.repeat(starts, sizes) < np.repeat(shown, sizes)
        rows, tile = rows[order][kept], tile[kept]
    return rows[np.lexsort((rows, tile))]


def _rank_by_hash(plant_id: NDArray[np.object_]) -> NDArray[np.int64]:
    """Return (n,) the place of each plant in an order that depends on its id alone and on nothing it is about."""
    if not len(plant_id):
        return np.zeros(0, dtype=np.int64)
    text = np.asarray(plant_id, dtype=np.str_)
    letters = text.view(np.uint32).reshape(len(text), -1)
    mixed = np.full(len(text), HASH_START, dtype=np.uint64)
    for letter in letters.T:
        next_mixed = (mixed ^ letter) * HASH_FACTOR
        mixed = np.where(letter, next_mixed ^ (next_mixed >> HASH_SHIFT), mixed)
    rank = np.empty(len(text), dtype=np.int64)
    rank[np.lexsort((text, mixed))] = np.arange(len(text))
    return rank
