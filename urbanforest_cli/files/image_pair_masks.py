"""Masks beside images: how a whole set of them is to be read, and the truth of a block out of one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import CANOPY, CLASSES
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.image_checks import open_raster, reader_errors
from urbanforest_cli.files.image_pair_blocks import Block, Image
from urbanforest_cli.files.images import ImageReader, open_image
from urbanforest_cli.files.mask_values import FRACTIONS, MaskValues, Scale, percent_of, percent_of_colours

STRIP_PX = 4 << 20
SAME_PLACE_PX = 0.5
_VALUES = "0 and 1, 0 and 255, or percent from 0 to 100"
_PALETTE = "say which colour is which class: --palette canopy=#00ff00"


@dataclass(frozen=True)
class MaskReading:
    """How the masks of a set are read.

    Parameters
    ----------
    classes
        Of the truth.
    bands
        From 0, for each class, where bands are classes; None where colours are.
    scale
        What their values mean.
    palette
        Colour by class.
    side_by_side
        Whether the mask is the right half of the image's own file.
    """

    classes: tuple[str, ...]
    bands: tuple[int, ...] | None
    scale: Scale
    palette: Mapping[str, str]
    side_by_side: bool

    def truth(self, block: Block) -> NDArray[np.uint8]:
        """Read the truth of a block, (class, row, col) in percent, 255 where unknown."""
        right = block.image.width_px if self.side_by_side else 0
        with _open_mask(_mask_of(block.image, self.side_by_side)) as mask:
            row, col, height_px, width_px = block.window
            window = (row, col + right, height_px, width_px)
            if self.bands is None:
                return percent_of_colours(_colours(mask, window), self.palette, self.classes)
            return np.stack([percent_of(_values(mask, window)[band], self.scale) for band in self.bands])


def reading_of(
    images: Sequence[Image], classes: tuple[str, ...] | None, palette: Mapping[str, str], *, side_by_side: bool
) -> MaskReading:
    """Look at all masks of a set and decide how they are read.

    Bands that are called by classes are these. A single band, or colours that are all gray, is the one class asked for,
    else canopy; several bands without names are the classes asked for, in their order. Colours need a palette.

    Raises
    ------
    InputError
        A mask cannot be read or is not its image's, masks differ in kind, or nobody can tell what they mean.
    ConfigError
        A class is asked for that is not in them.
    """
    seen = MaskValues()
    kinds: dict[tuple[str, ...] | int, Path] = {}
    for image in images:
        path = _mask_of(image, side_by_side)
        with _open_mask(path) as mask:
            if not side_by_side:
                _check_fit(image, mask)
            kinds.setdefault(_kind(mask, path, palette), path)
            if not palette:
                for strip in _strips(mask, image.width_px if side_by_side else 0):
                    seen.add(_values(mask, strip))
    if len(kinds) > 1:
        first, second = list(kinds.items())[:2]
        raise InputError("masks are not of one kind", where=second[1], found=_sentence(second[0]),
                         expected=f"{_sentence(first[0])}, as in {first[1].name}")  # fmt: skip
    kind, path = next(iter(kinds.items()))
    if palette:
        return MaskReading(_wanted(classes, tuple(palette), path), None, FRACTIONS, palette, side_by_side)
    names = _band_names(kind, classes, path)
    wanted = _wanted(classes, names, path)
    try:
        scale = seen.scale()
    except ValueError as error:
        raise InputError("it cannot be told what the masks' values mean", where=path.parent, found=str(error),
                         expected=_VALUES, next_step=_PALETTE) from error  # fmt: skip
    return MaskReading(wanted, tuple(names.index(name) for name in wanted), scale, {}, side_by_side)


def _mask_of(image: Image, side_by_side: bool) -> Path:
    path = image.files.image if side_by_side else image.files.mask
    assert path is not None
    return path


@contextmanager
def _open_mask(path: Path) -> Iterator[ImageReader]:
    with open_image(path, stretch=(0.0, 255.0), georeferenced=False, notices=Notices()) as reader:
        if reader.traits.nodata == 0 or (reader.traits.nodata == 255 and reader.traits.palette is None):
            reader.traits = replace(reader.traits, nodata=None)  # bare or covered ground, whatever the tag calls it
        yield reader


def _check_fit(image: Image, mask: ImageReader) -> None:
    if (mask.width_px, mask.height_px) != (image.width_px, image.height_px):
        raise InputError("the mask is not of its image's size", where=mask.path,
                         found=f"{mask.width_px} x {mask.height_px} px",
                         expected=f"{image.width_px} x {image.height_px} px, as {image.files.image}",
                         next_step="bring both to the same pixels: gdalwarp -te ... -ts ...")  # fmt: skip
    if mask.grid is None or image.grid is None or mask.grid.crs != image.grid.crs:
        return
    tolerance = SAME_PLACE_PX * min(image.grid.pixel_size)
    apart = max(abs(a - b) for a, b in zip(mask.grid.bounds, image.grid.bounds, strict=True))
    if apart > tolerance:
        raise InputError("the mask does not lie where its image does", where=mask.path, found=mask.grid.bounds,
                         expected=f"{image.grid.bounds}, as {image.files.image}")  # fmt: skip


def _kind(mask: ImageReader, path: Path, palette: Mapping[str, str]) -> tuple[str, ...] | int:
    """Return the names of a mask's bands if they are classes, else how many bands there are; 3 for colours."""
    if palette:
        return 3
    with open_raster(path, Notices()) as (dataset, _), reader_errors(path):
        names = tuple((text or "").strip().lower() for text in dataset.descriptions)
    if set(names) <= set(CLASSES) and len(set(names)) == len(names):
        return names
    traits = mask.traits
    count = traits.band_count - (traits.alpha is not None)
    return 1 if traits.palette is not None or traits.band_count in (3, 4) else count


def _band_names(kind: tuple[str, ...] | int, classes: tuple[str, ...] | None, path: Path) -> tuple[str, ...]:
    if isinstance(kind, tuple):
        return kind
    names = classes or ((CANOPY,) if kind == 1 else ())
    if len(names) != kind:
        raise InputError(
            "it cannot be told which class each band of the masks is", where=path, found=_sentence(kind),
            expected=f"bands called {' and '.join(CLASSES)}, or as many classes as bands",
            next_step="name them in the order of the bands: --classes canopy,vegetation",
        )  # fmt: skip
    return names


def _wanted(classes: tuple[str, ...] | None, there: tuple[str, ...], path: Path) -> tuple[str, ...]:
    unknown = [name for name in (*there, *(classes or ())) if name not in CLASSES]
    if unknown or not set(classes or ()) <= set(there):
        possible = [name for name in CLASSES if name in there] or CLASSES
        raise ConfigError("no such class in the masks", where=path, found=", ".join(unknown or classes or ()),
                          expected=f"some of {', '.join(possible)}")  # fmt: skip
    return classes or tuple(name for name in CLASSES if name in there)


def _sentence(kind: tuple[str, ...] | int) -> str:
    if isinstance(kind, tuple):
        return f"bands called {', '.join(kind)}"
    return "one band, or one gray" if kind == 1 else f"{kind} bands without names of classes"


def _strips(mask: ImageReader, first_col: int) -> Iterator[tuple[int, int, int, int]]:
    width_px = mask.width_px - first_col
    rows = max(1, STRIP_PX // width_px)
    for row in range(0, mask.height_px, rows):
        yield row, first_col, min(rows, mask.height_px - row), width_px


def _values(mask: ImageReader, window: tuple[int, int, int, int]) -> NDArray[Any]:
    """Return the values of a mask by band; one band of a palette or of colours that are all gray; NaN is unknown."""
    traits = mask.traits
    if traits.palette is not None or traits.band_count in (3, 4):
        colours, valid = mask.read(*window)
        if (colours != colours[:1]).any():
            raise InputError("the mask has colours", where=mask.path, expected=_VALUES, next_step=_PALETTE)
        return np.where(valid, colours[:1].astype(np.float32), np.nan)
    values = mask.read_values(*window)
    if traits.alpha is not None:
        values = np.delete(values, traits.alpha - 1, axis=0)
    if traits.nodata is not None:
        values = np.where(values == traits.nodata, np.nan, values.astype(np.float64))
    return values


def _colours(mask: ImageReader, window: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    return mask.read(*window)[0]
