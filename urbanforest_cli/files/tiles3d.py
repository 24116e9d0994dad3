"""3D Tiles 1.1 of a scene: an implicit quadtree of plants, explicit cells of ground and buildings.

::

    tiles/tileset.json
    tiles/subtrees/LEVEL/X/Y.subtree     which tiles there are, and the box of each, crowns included
    tiles/content/LEVEL/X/Y.glb          plants of a square at the detail of its level
    tiles/content/ground/X_Y.glb, tiles/content/buildings/X_Y.glb
    tiles/models/DETAIL-NUMBER.bin       models that several tiles use, some neighbours a file
    tiles/models/HASH.png                textures

A model that one tile alone uses lies within that tile, so each is stored once. Contents are y up, as glTF is; viewers
turn them. Their frame is east, north and up about the origin, which the root's transform stands on the ellipsoid.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli import __version__
from urbanforest_cli.core.geodesy import root_transform
from urbanforest_cli.core.publish import publish_folder
from urbanforest_cli.core.scenery import Fixed, Instances, Material, Model, Points, Scenery
from urbanforest_cli.core.tiles import FixedCell, TiledScene, TilePlan, z_order
from urbanforest_cli.files.gltf import External, PackedModels, glb_bytes, model_bytes, pack_models
from urbanforest_cli.files.tiles3d_reader import check_tiles
from urbanforest_cli.files.tiles3d_subtree import (
    BOX_NUMBERS,
    BOX_PROPERTY,
    TILE_CLASS,
    Subtree,
    subtree_bytes,
    tiles_in,
)

SUBTREE_LEVELS_MAX = 6
MODELS_FILE_BYTES = 1 << 17
MODELS_AT_ONCE = 64
BUILDINGS_ERROR_M = 48.0
"""Geometric error of ground without its buildings: they appear within 5 km."""
SEEN_FROM_SIDES = 1.0
"""Geometric error of nothing at all: a side of the scene, so that it is drawn within a hundred sides."""
BOX_PADDING_M = 0.01
"""What quantised corners may lie beyond the models', and more."""
UP_FROM_CONTENT, UP_FROM_CELL = "../../../", "../../"
AXES = "x east, y up, z south about the origin, on the plane that touches the ellipsoid there"
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TilesSummary:
    """What was written: `shared_models` lie in files of their own."""

    tiles: int
    cells: int
    models: int
    shared_models: int


def write_tiles(path: Path, scene: TiledScene, *, provenance: Mapping[str, Any]) -> TilesSummary:
    """Publish a folder of 3D Tiles whole; equal scenes are equal bytes.

    Raises
    ------
    OutputError
        The folder could not be written, or the scene cannot be told in glTF.
    InputError
        What was written is not whole; what stood there before is untouched.
    """
    plants = len(next(iter(scene.sceneries.values())).properties["plant_id"].values)
    with publish_folder(path, verify=lambda part: check_tiles(part, plants=plants)) as folder:
        textures = _Textures(folder)
        low = np.full((len(scene.plan), 3), np.inf)
        high = np.full((len(scene.plan), 3), -np.inf)
        models, shared = 0, 0
        for number, detail in enumerate(scene.plan.details):
            tiles = np.flatnonzero(scene.plan.detail == number)
            if len(tiles):
                writer = _Detail(folder, scene, detail, tiles, textures)
                low[tiles], high[tiles] = writer.write()
                models, shared = models + writer.used, shared + len(writer.external)
        low, high = _holding_children(scene.plan, low - BOX_PADDING_M, high + BOX_PADDING_M)
        _write_subtrees(folder, scene.plan, low, high)
        _write_cells(folder, scene, textures)
        text = json.dumps(
            _tileset(scene, low, high, provenance), ensure_ascii=False, allow_nan=False, separators=(",", ":")
        )
        (folder / "tileset.json").write_text(text + "\n", encoding="utf-8")
    return TilesSummary(len(scene.plan), len(scene.cells), models, shared)


class _Textures:
    """Stores each texture once, whatever details and tiles use it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: dict[bytes, str] = {}

    def uris(self, materials: Sequence[Material], used: Iterable[int], above: str) -> dict[int, str]:
        """Return where the textures of the materials in use lie, seen from a folder that is `above` below the root."""
        found = {}
        for number in sorted(set(used)):
            texture = materials[number].texture
            if texture is not None:
                found[number] = f"{above}models/{self._name(texture)}"
        return found

    def _name(self, png: bytes) -> str:
        if png not in self._names:
            self._names[png] = f"{hashlib.sha256(png).hexdigest()[:16]}.png"
            _write(self._folder / "models" / self._names[png], png)
        return self._names[png]


class _Detail:
    """Writes the tiles of one detail: first the models that several of them use, then tile after tile."""

    def __init__(
        self, folder: Path, scene: TiledScene, detail: str, tiles: NDArray[np.int64], textures: _Textures
    ) -> None:
        self._folder, self._scene, self._detail, self._tiles = folder, scene, detail, tiles
        self._scenery = scene.sceneries[detail]
        self._textures = textures
        model = self._scenery.instances.model
        self._models_of_tile = [np.unique(model[self._split(tile)[0]]).astype(np.int64) for tile in tiles]
        every = np.concatenate([np.zeros(0, np.int64), *self._models_of_tile])
        numbers, counts = np.unique(every, return_counts=True)
        size = int(numbers.max(initial=-1)) + 1
        self._extent = np.zeros((size, 3))
        self._packed: dict[int, PackedModels] = {}
        self.used = len(numbers)
        self.external: dict[int, External] = {}
        self._store_shared(numbers[counts > 1])

    def write(self) -> tuple[FloatArray, FloatArray]:
        """Write the tiles and return the corners of their boxes: (t, 3) each, metres in the tiles' frame."""
        corners = [
            self._write_tile(tile, models) for tile, models in zip(self._tiles, self._models_of_tile, strict=True)
        ]
        return np.array([low for low, _ in corners]), np.array([high for _, high in corners])

    def _split(self, tile: np.int64) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the instances and points of a tile."""
        rows, count = self._scene.plan.rows(int(tile)), len(self._scenery.instances)
        return rows[rows < count], rows[rows >= count] - count

    def _models(self, numbers: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], Sequence[Model]]]:
        for start in range(0, len(numbers), MODELS_AT_ONCE):
            some = numbers[start : start + MODELS_AT_ONCE]
            models = self._scene.models_of(self._detail, some)
            self._extent[some] = [_extent(model) for model in models]
            yield some, models

    def _store_shared(self, numbers: NDArray[np.int64]) -> None:
        held: list[tuple[int, bytes]] = []
        for some, models in self._models(numbers):
            packed = pack_models(models, self._scenery.materials)
            for place, number in enumerate(some.tolist()):
                held.append((number, model_bytes(packed, place)))
                emptied = replace(packed.models[place], data=b"")
                self._packed[number] = replace(packed, models=(emptied,))
                if sum(len(data) for _, data in held) >= MODELS_FILE_BYTES:
                    held = self._store(held)
        self._store(held)

    def _store(self, held: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
        if held:
            name = f"{self._detail}-{held[0][0]}.bin"
            content = b"".join(data for _, data in held)
            _write(self._folder / "models" / name, content)
            offset = 0
            for number, data in held:
                self.external[number] = External(f"{UP_FROM_CONTENT}models/{name}", offset, len(content))
                offset += len(data)
        return []

    def _write_tile(self, tile: np.int64, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        plan = self._scene.plan
        own = [number for number in numbers.tolist() if number not in self.external]
        packed = {number: self._packed[number] for number in numbers.tolist() if number in self.external}
        for some, models in self._models(np.array(own, dtype=np.int64)):
            fresh = pack_models(models, self._scenery.materials)
            packed |= {
                number: replace(fresh, models=(fresh.models[place],)) for place, number in enumerate(some.tolist())
            }
        scenery = self._of_tile(tile, numbers)
        joined = _joined([packed[number] for number in numbers.tolist()], self._scenery)
        used = [part.material for model in joined.models for part in model.parts]
        content = glb_bytes(
            scenery,
            packed=joined,
            external={
                place: self.external[number] for place, number in enumerate(numbers.tolist()) if number in self.external
            },
            texture_uris=self._textures.uris(self._scenery.materials, used, UP_FROM_CONTENT),
            extras={},
        )
        _write(self._folder / "content" / str(plan.level[tile]) / str(plan.x[tile]) / f"{plan.y[tile]}.glb", content)
        return self._corners(scenery, numbers)

    def _of_tile(self, tile: np.int64, numbers: NDArray[np.int64]) -> Scenery:
        stands, dots = self._split(tile)
        whole = self._scenery
        instances = whole.instances.take(stands)
        instances = replace(
            instances,
            model=np.searchsorted(numbers, instances.model).astype(np.int32),
            scale=instances.scale * self._scene.plan.size_factor[tile],
        )
        points = None
        if whole.points is not None and len(dots):
            points = Points(whole.points.xyz_m[dots], whole.points.rgb[dots])
        rows = self._scene.plan.rows(int(tile))
        return replace(
            whole,
            models=(),
            instances=instances,
            points=points,
            properties={name: column.take(rows) for name, column in whole.properties.items()},
            fixed=(),
            provenance={},
        )

    def _corners(self, scenery: Scenery, numbers: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        lows, highs = [], []
        instances = scenery.instances
        if len(instances):
            reach, bottom, top = (self._extent[numbers[instances.model]] * instances.scale[:, None]).T
            lows.append(instances.xyz_m + np.column_stack([-reach, -reach, bottom]))
            highs.append(instances.xyz_m + np.column_stack([reach, reach, top]))
        if scenery.points is not None:
            lows.append(scenery.points.xyz_m)
            highs.append(scenery.points.xyz_m)
        return np.concatenate(lows).min(axis=0), np.concatenate(highs).max(axis=0)


def _joined(packed: Sequence[PackedModels], scenery: Scenery) -> PackedModels:
    """Return models packed apart as one; a texture is clamped where all of them clamp it."""
    if not packed:
        return pack_models((), scenery.materials)
    clamped = frozenset.intersection(*(one.clamped for one in packed))
    return replace(packed[0], models=tuple(one.models[0] for one in packed), clamped=clamped)


def _extent(model: Model) -> tuple[float, float, float]:
    """Return how far a model reaches from its axis, and its lowest and highest height."""
    corners = np.concatenate([part.mesh.xyz_m for part in model.parts]).astype(np.float64)
    return float(np.hypot(corners[:, 0], corners[:, 1]).max()), float(corners[:, 2].min()), float(corners[:, 2].max())


def _holding_children(plan: TilePlan, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return boxes (corners (t, 3)) that hold those of their children too."""
    low, high = low.copy(), high.copy()
    code = z_order(plan.x.astype(np.int64), plan.y.astype(np.int64))
    for level in range(plan.levels - 1, 0, -1):
        parents, children = np.flatnonzero(plan.level == level - 1), np.flatnonzero(plan.level == level)
        above = parents[np.searchsorted(code[parents], code[children] >> 2)]
        np.minimum.at(low, above, low[children])
        np.maximum.at(high, above, high[children])
    return low, high


def _box(low: FloatArray, high: FloatArray) -> list[float]:
    """Return the box of 3D Tiles: centre, half axes east, north and up."""
    half = np.diag((high - low) / 2)
    return [float(value) for value in np.concatenate([(low + high) / 2, half.ravel()])]


def _box_around(tiles: Sequence[Mapping[str, Any]]) -> list[float]:
    """Return the box that holds those of tiles; a small one at the origin where there are none."""
    if not tiles:
        return _box(np.full(3, -1.0), np.full(3, 1.0))
    boxes = np.array([tile["boundingVolume"]["box"] for tile in tiles])
    middle, half = boxes[:, :3], boxes[:, [3, 7, 11]]
    return _box((middle - half).min(axis=0), (middle + half).max(axis=0))


def subtree_levels(levels: int) -> int:
    """Return how many levels of a tree a subtree holds: as few subtrees as can be above one another, alike in depth."""
    return -(-levels // -(-levels // SUBTREE_LEVELS_MAX))


def _write_subtrees(folder: Path, plan: TilePlan, low: FloatArray, high: FloatArray) -> None:
    if not len(plan):
        return
    held = subtree_levels(plan.levels)
    code = z_order(plan.x.astype(np.int64), plan.y.astype(np.int64))
    below = plan.level % held
    root_code = code >> (2 * below)
    place = code - (root_code << (2 * below)) + np.array([tiles_in(level) for level in range(held)])[below]
    root_level = plan.level - below
    order = np.lexsort((place, root_code, root_level))
    keys = np.column_stack([root_level, root_code])[order]
    starts = np.flatnonzero((np.diff(keys, axis=0, prepend=keys[:1] - 1) != 0).any(axis=1))
    half = (high - low) / 2
    boxes = np.zeros((len(plan), BOX_NUMBERS))
    boxes[:, :3] = (low + high) / 2
    boxes[:, [3, 7, 11]] = half
    roots = {(int(level), int(root)) for level, root in keys[starts]}
    children: dict[tuple[int, int], list[int]] = {}
    for level, root in sorted(roots):
        if level:
            children.setdefault((level - held, root >> (2 * held)), []).append(root & (4**held - 1))
    for start, end in zip(starts, np.append(starts[1:], len(order)), strict=True):
        level, root = int(keys[start, 0]), int(keys[start, 1])
        rows = order[start:end]
        tiles, follow = np.zeros(tiles_in(held), dtype=bool), np.zeros(4**held, dtype=bool)
        tiles[place[rows]] = True
        follow[children.get((level, root), [])] = True
        shift = int(below[rows[0]])
        x, y = int(plan.x[rows[0]]) >> shift, int(plan.y[rows[0]]) >> shift
        content = subtree_bytes(Subtree(tiles, follow, boxes[rows]))
        _write(folder / "subtrees" / str(level) / str(x) / f"{y}.subtree", content)


def _write_cells(folder: Path, scene: TiledScene, textures: _Textures) -> None:
    if not scene.cells:
        return
    finest = scene.sceneries[scene.plan.details[-1]]
    packed = pack_models((), finest.materials)
    nothing = np.zeros(0, np.int64)
    bare = replace(
        finest, models=(), instances=_no_instances(), points=None,
        properties={name: column.take(nothing) for name, column in finest.properties.items()}, provenance={},
    )  # fmt: skip
    for cell in scene.cells:
        for kind, pieces in (("ground", cell.ground), ("buildings", cell.buildings)):
            if pieces:
                uris = textures.uris(finest.materials, [piece.material for piece in pieces], UP_FROM_CELL)
                content = glb_bytes(replace(bare, fixed=pieces), packed=packed, texture_uris=uris, extras={})
                _write(folder / "content" / kind / f"{cell.x}_{cell.y}.glb", content)


def _no_instances() -> Instances:
    return Instances(np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool), np.zeros(0))


def _tileset(scene: TiledScene, low: FloatArray, high: FloatArray, provenance: Mapping[str, Any]) -> dict[str, Any]:
    origin, plan = scene.origin, scene.plan
    cells = [tile for cell in scene.cells for tile in _cell_tiles(cell)]
    children: list[dict[str, Any]] = []
    if len(plan):
        children.append(_forest(plan, low, high))
    if cells:
        children.append({"boundingVolume": {"box": _box_around(cells)}, "refine": "ADD", "children": cells})
    box = _box_around(children)
    error = max(SEEN_FROM_SIDES * 2 * max(box[3], box[7]), 2 * plan.root_error_m, 2 * BUILDINGS_ERROR_M)
    if cells:
        children[-1]["geometricError"] = error
    transform = root_transform(origin, ground_height_m=scene.ground_height_m)
    root: dict[str, Any] = {
        "transform": [float(value) for value in transform.T.ravel()],
        "boundingVolume": {"box": box},
        "geometricError": error,
        "refine": "ADD",
    }
    if children:
        root["children"] = children
    authority = origin.crs.to_authority()
    box_property = {
        "type": "SCALAR", "componentType": "FLOAT64", "array": True, "count": BOX_NUMBERS,
        "semantic": "TILE_BOUNDING_BOX", "required": True,
        "description": "centre and half axes of a box that holds all of a tile, in metres of the tiles' frame",
    }  # fmt: skip
    return {
        "asset": {
            "version": "1.1",
            "generator": f"urbanforest {__version__}",
            "extras": {
                "crs": {"authority": None if authority is None else ":".join(authority), "wkt": origin.crs.to_wkt()},
                "origin": {
                    "easting_m": float(origin.easting_m),
                    "northing_m": float(origin.northing_m),
                    "height_m": float(origin.height_m),
                },
                "ground_height_m": float(scene.ground_height_m),
                "axes": AXES,
                "unit": "metre",
                "details": list(plan.details),
                "provenance": dict(provenance),
            },
        },
        "schema": {"id": "urbanforest", "classes": {TILE_CLASS: {"properties": {BOX_PROPERTY: box_property}}}},
        "geometricError": error,
        "root": root,
    }


def _forest(plan: TilePlan, low: FloatArray, high: FloatArray) -> dict[str, Any]:
    """Return the tile that spans the quadtree; viewers halve its square, so that is what it states."""
    bottom, top = low.min(axis=0), high.max(axis=0)
    bottom[:2], top[:2] = np.array(plan.centre_m) - plan.half_m, np.array(plan.centre_m) + plan.half_m
    return {
        "boundingVolume": {"box": _box(bottom, top)},
        "geometricError": plan.root_error_m,
        "refine": "REPLACE",
        "content": {"uri": "content/{level}/{x}/{y}.glb"},
        "implicitTiling": {
            "subdivisionScheme": "QUADTREE",
            "availableLevels": plan.levels,
            "subtreeLevels": subtree_levels(plan.levels),
            "subtrees": {"uri": "subtrees/{level}/{x}/{y}.subtree"},
        },
    }


def _cell_tiles(cell: FixedCell) -> list[dict[str, Any]]:
    """Return the tiles of a cell: ground, and buildings below a tile that lets them in from nearer.

    What holds content replaces, although nothing follows it: CesiumJS loads what adds only once the camera rests.
    """
    tiles: list[dict[str, Any]] = []
    if cell.ground:
        tiles.append(_content_tile(f"content/ground/{cell.x}_{cell.y}.glb", cell.ground))
    if cell.buildings:
        built = _content_tile(f"content/buildings/{cell.x}_{cell.y}.glb", cell.buildings)
        tiles.append(
            {
                "boundingVolume": built["boundingVolume"],
                "geometricError": BUILDINGS_ERROR_M,
                "refine": "ADD",
                "children": [built],
            }
        )
    return tiles


def _content_tile(uri: str, pieces: Sequence[Fixed]) -> dict[str, Any]:
    box = {"box": _box(*_ends(pieces))}
    return {"boundingVolume": box, "geometricError": 0.0, "refine": "REPLACE", "content": {"uri": uri}}


def _ends(pieces: Sequence[Fixed]) -> tuple[FloatArray, FloatArray]:
    low = np.min([piece.mesh.xyz_m.min(axis=0) + np.array(piece.centre_m) for piece in pieces], axis=0)
    high = np.max([piece.mesh.xyz_m.max(axis=0) + np.array(piece.centre_m) for piece in pieces], axis=0)
    return low - BOX_PADDING_M, high + BOX_PADDING_M


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
