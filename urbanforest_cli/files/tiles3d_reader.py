"""Read the 3D Tiles that this program writes, trusting nothing in them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.geodesy import from_earth_centred
from urbanforest_cli.core.placed import PlacedPlants
from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.tiles import CODE_LEVELS_MAX, from_z_order, z_order
from urbanforest_cli.files.gltf_reader import columns_of, open_gltf, plants_of
from urbanforest_cli.files.tiles3d_subtree import Subtree, read_subtree, tiles_in
from urbanforest_cli.files.words import in_words, kind_of

TILESET = "tileset.json"
TILESET_LIMIT_BYTES = 1 << 28
TILES_MAX = 10_000_000
DEPTH_MAX = 32
SUBTREE_LEVELS_LIMIT = 10
GLB_HEADER = struct.Struct("<4sII")
GLB_MAGIC, GLB_VERSION = b"glTF", 2
TRANSFORM_NUMBERS = 16


@dataclass(frozen=True)
class Quadtree:
    """The tiles of an implicit quadtree that are there: (t,) each, parents before children.

    Parameters
    ----------
    is_leaf
        No tile below.
    boxes_m
        (t, 12) centre and half axes.
    content
        Template of the contents' paths.
    """

    level: NDArray[np.int64]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    is_leaf: NDArray[np.bool_]
    boxes_m: NDArray[np.float64]
    content: str

    def __len__(self) -> int:
        return len(self.level)

    def uri(self, tile: int) -> str:
        """Return the path of a tile's content, relative to the tileset."""
        return _filled(self.content, int(self.level[tile]), int(self.x[tile]), int(self.y[tile]))


@dataclass(frozen=True)
class Tileset:
    """A tileset opened and checked: what `tileset.json` says, and its quadtree, None where it has no plants."""

    folder: Path
    text: dict[str, Any]
    quadtree: Quadtree | None
    subtrees: tuple[str, ...]
    fixed: tuple[str, ...]

    @property
    def extras(self) -> dict[str, Any]:
        """What the program that wrote it says of it."""
        return dict(self.text["asset"]["extras"])


def open_tileset(path: Path) -> Tileset:
    """Open a folder of 3D Tiles, or its `tileset.json`, and read which tiles there are.

    Raises
    ------
    InputError
        A file is missing, torn or foreign, or names one outside the folder.
    """
    folder = path if path.is_dir() else path.parent
    name = folder / TILESET if path.is_dir() else path
    text = _json(name)
    try:
        if text["asset"]["version"] != "1.1" or not isinstance(text["asset"]["extras"], dict):
            raise ValueError("no tileset of version 1.1 with extras")
        nodes = list(_nodes(text["root"]))
        forests = [node for node in nodes if "implicitTiling" in node]
        fixed = [node["content"]["uri"] for node in nodes if "content" in node and "implicitTiling" not in node]
        if len(forests) > 1:
            raise ValueError("several quadtrees")
        quadtree, subtrees = _quadtree(folder, forests[0]) if forests else (None, ())
        for uri in fixed:
            _inside(folder, uri)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise _broken(name, in_words(error)) from error
    return Tileset(folder, text, quadtree, tuple(subtrees), tuple(fixed))


def read_plants(path: Path) -> PlacedPlants:
    """Read the plants of a folder of 3D Tiles from its leaves, in the CRS that it names.

    Raises
    ------
    InputError
        Besides what `open_tileset` raises: a plant lies in several leaves, or a tile above holds a plant that none of
        the leaves below it does, or one plant twice.
    """
    tileset = open_tileset(path)
    extras = tileset.extras
    try:
        origin = Origin(
            CRS.from_wkt(extras["crs"]["wkt"]),
            *(float(extras["origin"][name]) for name in ("easting_m", "northing_m", "height_m")),
        )
        ground_height_m = float(extras["ground_height_m"])
        numbers = np.array(tileset.text["root"]["transform"], dtype=np.float64)
        if numbers.shape != (TRANSFORM_NUMBERS,) or not np.isfinite(numbers).all():
            raise ValueError("a transform that is not 16 numbers")
    except (KeyError, TypeError, ValueError, CRSError) as error:
        raise _broken(tileset.folder / TILESET, in_words(error)) from error
    ids, places, heights, columns = _plants_of_leaves(tileset)
    matrix = numbers.reshape(4, 4).T
    on_earth = places @ matrix[:3, :3].T + matrix[:3, 3]
    xyz_m = from_earth_centred(origin, on_earth, ground_height_m=ground_height_m)
    return PlacedPlants(ids, xyz_m, origin.crs, heights, columns)


def read_provenance(path: Path) -> dict[str, Any]:
    """Return the record that a folder of 3D Tiles keeps of how it was made."""
    found = open_tileset(path).extras.get("provenance")
    if not isinstance(found, dict):
        raise _broken(path, "no provenance")
    return found


def check_tiles(folder: Path, *, plants: int) -> None:
    """Refuse a folder that is not whole: a tile without its file, a file cut short, a file that no tile names.

    Raises
    ------
    InputError
        See above; or there are plants but no tiles.
    """
    tileset = open_tileset(folder)
    named = {TILESET, *tileset.subtrees, *tileset.fixed}
    if tileset.quadtree is not None:
        named |= {tileset.quadtree.uri(tile) for tile in range(len(tileset.quadtree))}
    elif plants:
        raise _broken(folder / TILESET, f"no tiles of {plants} plants")
    for name in sorted(named):
        if name.endswith(".glb"):
            _check_glb(_inside(folder, name))
    there = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    foreign = sorted(name for name in there - named if not name.startswith("models/"))
    if foreign:
        raise _broken(folder, f"a file that no tile names: {foreign[0]}")


def _plants_of_leaves(
    tileset: Tileset,
) -> tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64], dict[str, NDArray[Any]]]:
    """Return ids, (n, 3) places in the tiles' frame, heights and what else leaves state, in the order of ids."""
    quadtree = tileset.quadtree
    if quadtree is None:
        return np.zeros(0, dtype=object), np.zeros((0, 3)), np.zeros(0), {}
    deepest = int(quadtree.level.max())
    shift = 2 * (deepest - quadtree.level)
    code = z_order(quadtree.x, quadtree.y) << shift
    leaf_ids, leaf_code, places, heights, others = [], [], [], [], []
    above: list[tuple[int, NDArray[np.object_]]] = []
    for tile in range(len(quadtree)):
        path = _inside(tileset.folder, quadtree.uri(tile))
        file = open_gltf(path, root=tileset.folder)
        found = plants_of(file)
        try:
            ids = np.asarray(found.columns["plant_id"], dtype=object)
            height = np.asarray(found.columns.get("height_m", np.full(len(ids), np.nan)), dtype=np.float64)
        except KeyError as error:
            raise _broken(path, "no column plant_id") from error
        if quadtree.is_leaf[tile]:
            leaf_ids.append(ids)
            leaf_code.append(np.full(len(ids), code[tile]))
            places.append(found.xyz_m)
            heights.append(height)
            others.append(columns_of(file, found))
        else:
            above.append((tile, ids))
    ids, codes = np.concatenate(leaf_ids), np.concatenate(leaf_code)
    order = np.argsort(ids.astype(np.str_), kind="stable")
    text, codes = ids[order].astype(np.str_), codes[order]
    same = np.flatnonzero(text[1:] == text[:-1])
    if len(same):
        raise _broken(tileset.folder, f"plant {text[same[0]]} in several leaves")
    for tile, held in above:
        names = np.sort(held.astype(np.str_))
        row = np.minimum(np.searchsorted(text, names), len(text) - 1)
        astray = (text[row] != names) | (codes[row] >> shift[tile] != code[tile] >> shift[tile])
        astray[1:] |= names[1:] == names[:-1]
        if astray.any():
            path = tileset.folder / quadtree.uri(tile)
            raise _broken(path, f"plant {names[np.argmax(astray)]} once more, or in none of the leaves below")
    stated = set(others[0])
    if any(set(columns) != stated for columns in others):
        raise _broken(tileset.folder, "leaves that do not all state the same of plants")
    columns = {name: np.concatenate([found[name] for found in others])[order] for name in sorted(stated)}
    return ids[order], np.concatenate(places)[order], np.concatenate(heights)[order], columns


def _quadtree(folder: Path, node: dict[str, Any]) -> tuple[Quadtree, tuple[str, ...]]:
    implicit = node["implicitTiling"]
    available, held = _count(implicit["availableLevels"]), _count(implicit["subtreeLevels"])
    if implicit["subdivisionScheme"] != "QUADTREE":
        raise ValueError(f"no quadtree: {implicit['subdivisionScheme']}")
    if not (1 <= available <= CODE_LEVELS_MAX and 1 <= held <= SUBTREE_LEVELS_LIMIT):
        raise ValueError(f"{available} levels, {held} a subtree")
    template, content = str(implicit["subtrees"]["uri"]), str(node["content"]["uri"])
    levels, codes, boxes, names = [], [], [], []
    pending, total = [(0, 0)], 0
    while pending:
        level, root = pending.pop(0)
        x, y = (int(value[0]) for value in from_z_order(np.array([root])))
        names.append(_filled(template, level, x, y))
        subtree = read_subtree(_inside(folder, names[-1]), held)
        total += int(np.count_nonzero(subtree.tiles))
        if total > TILES_MAX:
            raise ValueError(f"more than {TILES_MAX} tiles")
        below, code = _places(subtree, held)
        if not len(below) or below[0] != 0 or (level + below >= available).any():
            raise ValueError(f"{names[-1]}: no tile at its root, or tiles below the last level")
        levels.append(level + below)
        codes.append((root << (2 * below)) + code)
        boxes.append(subtree.boxes_m)
        pending += [(level + held, (root << (2 * held)) + int(child)) for child in np.flatnonzero(subtree.children)]
    level_of, code_of, box_of = np.concatenate(levels), np.concatenate(codes), np.concatenate(boxes)
    order = np.lexsort((code_of, level_of))
    level_of, code_of, box_of = level_of[order], code_of[order], box_of[order]
    is_leaf = np.ones(len(order), dtype=bool)
    for level in range(1, int(level_of.max()) + 1):
        parents, children = np.flatnonzero(level_of == level - 1), code_of[level_of == level] >> 2
        at = np.searchsorted(code_of[parents], children)
        if (at >= len(parents)).any() or (code_of[parents][at] != children).any():
            raise ValueError(f"a tile of level {level} has no parent")
        is_leaf[parents[at]] = False
    x_of, y_of = from_z_order(code_of)
    return Quadtree(level_of, x_of, y_of, is_leaf, box_of, content), tuple(names)


def _places(subtree: Subtree, held: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return levels below a subtree's root and places along the Z-order curve of the tiles that are there."""
    place = np.flatnonzero(subtree.tiles).astype(np.int64)
    firsts = np.array([tiles_in(level) for level in range(held)])
    below = np.searchsorted(firsts, place, side="right") - 1
    return below.astype(np.int64), place - firsts[below]


def _nodes(node: dict[str, Any], depth: int = 0) -> Iterator[dict[str, Any]]:
    if depth > DEPTH_MAX:
        raise ValueError("tiles too deep in one another")
    yield node
    for child in node.get("children", ()):
        yield from _nodes(child, depth + 1)


def _json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > TILESET_LIMIT_BYTES:
            raise _broken(path, f"{path.stat().st_size} bytes")
        text = json.loads(path.read_bytes())
    except OSError as error:
        raise _broken(path, error.strerror or str(error)) from error
    except (ValueError, RecursionError) as error:
        raise _broken(path, str(error)) from error
    if not isinstance(text, dict):
        raise _broken(path, kind_of(text))
    return text


def _count(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise ValueError(f"{value!r} is no count")
    return value


def _filled(template: str, level: int, x: int, y: int) -> str:
    return template.replace("{level}", str(level)).replace("{x}", str(x)).replace("{y}", str(y))


def _inside(folder: Path, uri: str) -> Path:
    """Return the path that a relative uri names, refusing what leads out of the folder."""
    parts = PurePosixPath(uri).parts
    path = folder.joinpath(*parts)
    if not parts or ".." in parts or "\\" in uri or ":" in uri or uri.startswith("/"):
        raise _broken(folder / TILESET, f"a path that leads out of the folder: {uri}")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise _broken(folder / TILESET, f"a link that leads out of the folder: {uri}")
    return path


def _check_glb(path: Path) -> None:
    try:
        with path.open("rb") as stream:
            head = stream.read(GLB_HEADER.size)
        size = path.stat().st_size
    except OSError as error:
        raise _broken(path, error.strerror or str(error)) from error
    if len(head) < GLB_HEADER.size or GLB_HEADER.unpack(head) != (GLB_MAGIC, GLB_VERSION, size):
        raise _broken(path, f"{size} bytes")


def _broken(path: Path, found: str) -> InputError:
    return InputError(
        "these 3D Tiles are torn or foreign",
        where=path,
        found=found,
        expected="a folder that this program wrote, whole",
        next_step="write the tiles again: urbanforest export OUT --to 3dtiles",
    )
