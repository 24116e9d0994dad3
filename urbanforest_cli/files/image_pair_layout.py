"""Which files of a folder are images, and which masks and tree points belong to them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices

RASTERS = frozenset({".tif", ".tiff", ".png", ".jpg", ".jpeg", ".jp2"})
POINTS = frozenset({".json", ".geojson", ".gpkg", ".shp", ".fgb", ".parquet"})
IMAGE_FOLDERS = ("images", "img", "image")
MASK_FOLDERS = ("masks", "response_img", "mask")
TREE_FOLDERS = ("trees",)
MASK_ENDINGS = ("_mask", "_coverage")
FILES_MOST = 200_000
_NUMBER = re.compile(r"[_\-. ]*\d+$")
_LAYOUTS = "images/ beside masks/ with files of the same names, or X.tif beside X_mask.tif"


@dataclass(frozen=True)
class PairFiles:
    """The files of one image.

    Parameters
    ----------
    name
        Path inside the folder of images, without the ending, with `/` between folders.
    group
        Its folder's name inside the folder of images, else its name without the number at the end.
    """

    name: str
    group: str
    image: Path
    mask: Path | None
    trees: Path | None


@dataclass(frozen=True)
class PairFolder:
    """What a folder of pairs holds, by name; `looked_for_trees` where points belong to it, if only to some images."""

    files: tuple[PairFiles, ...]
    looked_for_trees: bool

    @property
    def with_masks(self) -> bool:
        """Tell whether any image has a mask."""
        return any(entry.mask for entry in self.files)


def list_pairs(folder: Path, trees: Path | None) -> PairFolder:
    """Find images, and the masks and tree points of the same names.

    Images lie in `images` (or `img`), else in the folder itself; masks in `masks` (or `response_img`), else beside
    their image as X_mask or X_coverage; tree points in `trees`. All of them may lie in folders inside these, a group
    each.

    Parameters
    ----------
    trees
        Another folder of points; a file of all points is not asked for here.

    Raises
    ------
    InputError
        No such folder, no image in it, or two files for one name.
    """
    if not folder.is_dir():
        raise InputError("no folder of images", where=folder, expected="a folder that holds " + _LAYOUTS)
    image_folder = _first(folder, IMAGE_FOLDERS) or folder
    mask_folder = _first(folder, MASK_FOLDERS)
    tree_folder = trees if trees is not None and trees.is_dir() else _first(folder, TREE_FOLDERS)
    skip = {path for path in (mask_folder, tree_folder) if path is not None and path.is_relative_to(image_folder)}
    images = _by_name(image_folder, RASTERS, skip)
    if mask_folder is not None:
        masks = _by_name(mask_folder, RASTERS, set())
        masks |= {_without_ending(name): path for name, path in masks.items() if _without_ending(name) not in masks}
    else:
        endings = {name: _without_ending(name) for name in images}
        masks = {plain: images[name] for name, plain in endings.items() if plain != name and plain in images}
        images = {name: path for name, path in images.items() if path not in set(masks.values())}
    points = _by_name(tree_folder, POINTS, set()) if tree_folder is not None else {}
    if not images:
        raise InputError("no image in this folder", where=image_folder, expected=_LAYOUTS,
                         next_step=f"images end in {', '.join(sorted(RASTERS))}")  # fmt: skip
    return PairFolder(
        tuple(
            PairFiles(name, group_of(name, folder.name), path, masks.get(name), points.get(name))
            for name, path in sorted(images.items())
        ),
        looked_for_trees=tree_folder is not None,
    )


def only_with_masks(found: PairFolder, folder: Path, notices: Notices) -> PairFolder:
    """Return the images that have a mask; the others are counted.

    Raises
    ------
    InputError
        None has.
    """
    kept = tuple(entry for entry in found.files if entry.mask is not None)
    if not kept:
        raise InputError("no image has a mask", where=folder, found=f"{len(found.files)} images", expected=_LAYOUTS,
                         next_step="or derive labels: --label ndvi, or --label polygons --polygons FILE")  # fmt: skip
    lone = [entry.name for entry in found.files if entry.mask is None]
    notices.add("W_NO_MASK", "images without a mask, left out", len(lone), lone)
    return PairFolder(kept, found.looked_for_trees)


def group_of(name: str, otherwise: str) -> str:
    """Return the group of an image: its folder, or its name without the number at the end."""
    above, _, stem = name.rpartition("/")
    return above or _NUMBER.sub("", stem) or otherwise


def _first(folder: Path, names: Iterable[str]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_dir()), None)


def _without_ending(name: str) -> str:
    return next((name.removesuffix(ending) for ending in MASK_ENDINGS if name.endswith(ending)), name)


def _by_name(folder: Path, endings: frozenset[str], skip: set[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    candidates = [
        *folder.iterdir(),
        *(path for inner in folder.iterdir() if inner.is_dir() for path in inner.iterdir()),
    ]
    if len(candidates) > FILES_MOST:
        raise InputError("too many files in one folder", where=folder, found=len(candidates), expected=FILES_MOST)
    for path in sorted(candidates):
        hidden = path.name.startswith(".") or path.parent.name.startswith(".")
        if hidden or path.parent in skip or path.suffix.lower() not in endings or path.is_dir():
            continue
        name = path.relative_to(folder).with_suffix("").as_posix()
        if name in found:
            raise InputError("two files of one name", where=folder, found=f"{found[name].name}, {path.name}",
                             expected="one", next_step="take one of them away")  # fmt: skip
        found[name] = path
    return found
