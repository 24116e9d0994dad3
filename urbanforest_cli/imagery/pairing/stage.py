"""Read a folder of images as pairs with their truth, whatever that truth is made of."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import CANOPY, CLASSES, UNKNOWN, VEGETATION
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.files.image_pair_blocks import (
    Block,
    Image,
    ImageOptions,
    Pixels,
    blocks_of,
    footprint,
    look_at,
)
from urbanforest_cli.files.image_pair_layout import PairFolder, list_pairs, only_with_masks
from urbanforest_cli.files.image_pair_masks import reading_of
from urbanforest_cli.files.image_pair_polygons import PolygonTruth
from urbanforest_cli.files.image_pair_store import BlockStore
from urbanforest_cli.files.image_pair_trees import trees_by_image, trees_of
from urbanforest_cli.files.vectors import split_source
from urbanforest_cli.imagery.labels import LabelSource, derive_labels, fit_rules
from urbanforest_cli.imagery.pairs import ImagePair, PairLabel, content_of
from urbanforest_cli.imagery.splits import places_of

RULE_VERSION = 2
"""Raised whenever the same files would give other pairs."""

Truth = Callable[[Block, Pixels], NDArray[np.uint8]]


class FolderPairs:
    """Pairs of a folder, as `imagery.pairs.PairSet` describes them; made by `read_pairs`."""

    def __init__(
        self,
        blocks: Sequence[Block],
        classes: tuple[str, ...],
        truth: Truth,
        trees: Mapping[str, NDArray[np.float64]],
        store: BlockStore,
        fingerprint: str,
    ) -> None:
        self.classes = classes
        self.names = tuple(block.name for block in blocks)
        self.groups = tuple(block.image.files.group for block in blocks)
        self.footprints = tuple(footprint(block) for block in blocks)
        self.places = places_of(self.names, self.footprints)
        self.fingerprint = fingerprint
        self._blocks = tuple(blocks)
        self._truth = truth
        self._trees = dict(trees)
        self._store = store

    def __len__(self) -> int:
        return len(self._blocks)

    def __getitem__(self, index: int) -> ImagePair:
        """Read a pair; from any thread.

        Raises
        ------
        InputError
            A file changed since the folder was looked at, or is damaged.
        """
        block = self._blocks[index]
        pixels = self._store.pixels(block)
        truth = self._store.truth(block, lambda: self._truth(block, pixels))
        return ImagePair(
            name=block.name, place=self.places[index], group=self.groups[index], rgb=pixels.rgb, valid=pixels.valid,
            truth=truth, classes=self.classes, resolution_m=block.image.resolution_m,
            trees_px=trees_of(block, self._trees),
        )  # fmt: skip

    def content(self, index: int) -> str:
        """Return a hash of a pair's image, without its truth."""
        return content_of(self._store.pixels(self._blocks[index]).rgb)

    def __iter__(self) -> Iterator[ImagePair]:
        return (self[index] for index in range(len(self)))


def read_pairs(
    folder: Path,
    *,
    label: PairLabel = "auto",
    classes: tuple[str, ...] | None = None,
    polygons: Path | None = None,
    trees: Path | None = None,
    palette: Mapping[str, str] | None = None,
    bands: tuple[int, ...] | None = None,
    stretch: tuple[float, float] | None = None,
    assume_crs: str | None = None,
    resolution_m: float | None = None,
    workers: int = 1,
    notices: Notices,
) -> FolderPairs:
    """Look through a folder of images and find out what their truth is.

    Parameters
    ----------
    folder
        Images, and masks or tree points, as `files.image_pair_layout.list_pairs` finds them.
    label
        `masks`: files of them. `polygons`: those of a layer. `ndvi`: derived from near infrared, and for canopy from
        tree points, see `imagery.labels`. `side-by-side`: image and mask are the halves of each file, as the release
        of Pix2Pix has them. `auto`: masks if any image has one, else polygons if given, else near infrared.
    classes
        Those wanted; all that the truth tells by default.
    polygons
        ``FILE[:LAYER]``.
    trees
        Folder of tree points by image, or one ``FILE[:LAYER]`` of all; `trees` in the folder by default.
    palette
        ``#rrggbb`` by class, of masks in colours.
    bands, stretch, assume_crs
        As `files.images.open_image` takes them; the CRS also for vector files.
    resolution_m
        Ground size of pixels of images that lie nowhere; 0.6 by default, which is counted in `notices`.
    workers
        Threads that labels are prepared in; no pair depends on how many.

    Raises
    ------
    InputError
        A file cannot be used, or it cannot be told what the truth is.
    ConfigError
        Options that exclude each other, or a class that the truth does not tell.
    """
    options = ImageOptions(bands, stretch, assume_crs, resolution_m, side_by_side=label == "side-by-side")
    tree_folder = trees if trees is not None and trees.is_dir() else None
    found = list_pairs(folder, tree_folder)
    if label == "auto":
        label = "masks" if found.with_masks else "polygons" if polygons is not None else "ndvi"
    if (label == "polygons") != (polygons is not None):
        raise ConfigError("polygons are a truth of their own", where="--polygons", found=f"label {label}",
                          expected="both --label polygons and --polygons FILE, or neither")  # fmt: skip
    if label == "masks":
        found = only_with_masks(found, folder, notices)
    images = [look_at(entry, options, notices) for entry in found.files]
    tree_file = trees if tree_folder is None else None
    points = trees_by_image(
        images, tree_file, looked_for=found.looked_for_trees, assume_crs=assume_crs, notices=notices
    )
    store = BlockStore(options, nir=label == "ndvi")

    if label == "ndvi":
        found_classes = _derived_classes(classes, bool(points), folder)
        blocks = [block for image in _with_nir(images) for block in blocks_of(image)]
        truth = _derived_truth(blocks, found_classes, points, store, workers)
    elif label == "polygons":
        assert polygons is not None
        found_classes = classes or (CANOPY,)
        if len(found_classes) != 1:
            raise ConfigError("polygons tell one class", where="--classes", found=", ".join(found_classes))
        drawn = PolygonTruth(polygons, images, assume_crs=assume_crs, notices=notices)
        bare = [image.files.name for image in images if not drawn.touches(image)]
        notices.add("W_NO_POLYGON", "images that no polygon touches, left out", len(bare), bare)
        blocks = [block for image in images if image.files.name not in set(bare) for block in blocks_of(image)]
        truth = _plain_truth(drawn.truth)
    else:
        reading = reading_of(images, classes, palette or {}, side_by_side=options.side_by_side)
        found_classes = reading.classes
        blocks = [block for image in images for block in blocks_of(image)]
        truth = _plain_truth(reading.truth)
    said = {"rule": RULE_VERSION, "label": label, "classes": found_classes, "palette": dict(palette or {}),
            "options": asdict(options)}  # fmt: skip
    sources = [*([polygons] if polygons else []), *([tree_file] if tree_file else [])]
    return FolderPairs(blocks, found_classes, truth, points, store, _fingerprint(found, sources, said))


def _derived_classes(classes: tuple[str, ...] | None, with_trees: bool, folder: Path) -> tuple[str, ...]:
    if classes is None:
        return CLASSES if with_trees else (VEGETATION,)
    if CANOPY in classes and not with_trees:
        raise InputError(
            "canopy cannot be told from lawns without tree points", where=folder, found="no folder trees",
            expected="points of every visible tree: trees/ with files of the images' names, or --trees FILE",
            next_step="or learn vegetation alone: --classes vegetation",
        )  # fmt: skip
    return classes


def _with_nir(images: list[Image]) -> list[Image]:
    for image in images:
        if not image.has_nir:
            raise InputError(
                "no band of near infrared to derive a label from", where=image.files.image,
                expected="a fourth band, or one called NIR",
                next_step="give masks beside the images, or polygons: --label polygons --polygons FILE",
            )  # fmt: skip
    return images


def _derived_truth(
    blocks: list[Block],
    classes: tuple[str, ...],
    points: Mapping[str, NDArray[np.float64]],
    store: BlockStore,
    workers: int,
) -> Truth:
    def source(block: Block, pixels: Pixels) -> LabelSource:
        assert pixels.nir is not None
        return LabelSource(
            name=block.name, group=block.image.files.group, rgb=pixels.rgb, nir=pixels.nir, valid=pixels.valid,
            trees_px=trees_of(block, points), resolution_m=block.image.resolution_m,
        )  # fmt: skip

    def numbered(item: int) -> LabelSource:
        return source(blocks[item], store.pixels(blocks[item]))

    with ThreadPoolExecutor(max_workers=workers) as pool:
        rules = fit_rules(len(blocks), numbered, canopy=CANOPY in classes, mapped=pool.map)
    return lambda block, pixels: derive_labels(source(block, pixels), rules[block.image.files.group], classes)


def _plain_truth(read: Callable[[Block], NDArray[np.uint8]]) -> Truth:
    def truth(block: Block, pixels: Pixels) -> NDArray[np.uint8]:
        return np.where(pixels.valid, read(block), np.uint8(UNKNOWN))

    return truth


def _fingerprint(found: PairFolder, sources: Sequence[Path], said: Mapping[str, object]) -> str:
    digest = sha256(json.dumps(said, sort_keys=True).encode())
    for entry in found.files:
        for path in (entry.image, entry.mask, entry.trees):
            text = f"{entry.name}\x1f{entry.group}\x1f{sha256_of(path) if path is not None else ''}"
            digest.update(text.encode("utf-8", "surrogatepass"))
    for path in sources:
        file, layer = split_source(str(path))
        digest.update(f"{layer}\x1f{sha256_of(file)}".encode("utf-8", "surrogatepass"))
    return digest.hexdigest()
