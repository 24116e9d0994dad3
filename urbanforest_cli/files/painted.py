"""Pictures that a person painted over a map: which ground is painted, and how much of it crowns shall cover."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import CLASSES
from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.coverage import open_coverage
from urbanforest_cli.files.image_bands import ImageTraits, find_bands
from urbanforest_cli.files.image_checks import open_raster, raster_driver, reader_errors
from urbanforest_cli.files.image_places import raster_grid
from urbanforest_cli.files.image_values import valid_pixels
from urbanforest_cli.files.mask_values import MaskValues, percent_of

PIXELS_MOST = 36_000_000
SUFFIXES = (".png", ".tif", ".tiff")
COLOURED = 24
"""Difference of a pixel's channels from which on it is a colour and no shade of gray."""
FLAT_LEAST, GRAIN_SPEAKS_FROM = 0.3, 1000
"""Least share of painted neighbours that are alike: aerial images have at most 0.09, paint 0.99 and more."""
KINDS_MOST = 32
"""Colours, or shades, that a painting has at most where it cannot be told from a photograph otherwise."""
SCARCE = 0.01
"""Share of unpainted ground below which many shades are a photograph."""
TONES = 8
COVERED_PERCENT = 50


@dataclass(frozen=True)
class Painting:
    """Painted ground.

    Parameters
    ----------
    grid
        Where the pixels lie, north up.
    percent
        (row, col) uint8, the share of the ground that crowns shall cover; 0 where nothing is painted.
    """

    grid: RasterGrid
    percent: NDArray[np.uint8]


def is_painting(path: Path) -> bool:
    """Tell by its name whether a sketch is a painted picture and no file of polygons."""
    return path.suffix.lower() in SUFFIXES


def read_painting(
    path: Path, *, like: RasterGrid | None = None, assume_crs: str | None = None, notices: Notices
) -> Painting:
    """Read a painted PNG or GeoTIFF.

    What is transparent, or black, is not painted. A shade of gray says how much of the ground crowns shall cover, white
    all of it; any colour is paint that covers all of it. Black alone on a transparent sheet is paint too. A GeoTIFF of
    one band holds shares, percentages, shades or a mask; in one of `urbanforest cover`, and others whose bands are
    described as its are, ground is painted where canopy reaches 50 %.

    Parameters
    ----------
    like
        Place of a picture that has none of its own and as many pixels: that of the image it was painted over.
    assume_crs
        CRS of a file that states none.

    Raises
    ------
    InputError
        No such picture, nothing or everything of it painted, a photograph, or numbers that cannot be understood.
    CrsError
        It has no place on the map.
    LimitError
        It has over 36 million pixels: 6,000 x 6,000.
    """
    driver = raster_driver(path)
    if driver not in ("PNG", "GTiff"):
        raise InputError("a sketch is a painted PNG or GeoTIFF", where=path, found=driver,
                         expected="a format that keeps colours as they were painted",
                         next_step="save it as PNG")  # fmt: skip
    with open_raster(path, notices) as (file, _):
        if file.width * file.height > PIXELS_MOST:
            raise LimitError(
                "the sketch has too many pixels", where=path, found=f"{file.width:,} x {file.height:,}",
                expected=f"at most {PIXELS_MOST:,}", next_step="paint at a coarser resolution",
            )  # fmt: skip
        grid, south_up = _place(file, path, like, assume_crs, notices)
        words = {(text or "").strip().lower() for text in file.descriptions}
        percent = None if words & set(CLASSES) else _percent(file, path, numbers=driver == "GTiff")
    if percent is None:
        percent = _canopy(path, assume_crs, notices)
    elif south_up:
        percent = percent[::-1]
    if not percent.any():
        raise InputError("nothing is painted in this sketch", where=path, found="transparent or black all over",
                         expected="ground that is painted: white, gray or in any colour")  # fmt: skip
    return Painting(grid, np.ascontiguousarray(percent))


def _place(
    file: Any, path: Path, like: RasterGrid | None, assume_crs: str | None, notices: Notices
) -> tuple[RasterGrid, bool]:
    """Return the picture's own place, or that of the image it was painted over."""
    if not file.transform.is_identity or file.gcps[0] or file.rpcs:
        if file.crs is None and assume_crs is None and like is not None:
            assume_crs = like.crs.to_wkt()
        return raster_grid(file, path, assume_crs=assume_crs, notices=notices)
    size = (int(file.width), int(file.height))
    if like is not None and size == (like.width_px, like.height_px):
        return replace(like), False
    over = "" if like is None else f", and not as many as the image: {like.width_px:,} x {like.height_px:,}"
    raise CrsError(
        "the sketch has no place on the map", where=path, found=f"{size[0]:,} x {size[1]:,} pixels{over}",
        expected="a GeoTIFF, a world file beside it (.pgw), or as many pixels as the image it was painted over",
        next_step="give that image with --image, or georeference the sketch, for instance with QGIS",
    )  # fmt: skip


def _canopy(path: Path, assume_crs: str | None, notices: Notices) -> NDArray[np.uint8]:
    """Return where a coverage map, whose bands say what they are, shows canopy."""
    with open_coverage(path, assume_crs=assume_crs, notices=notices) as reader:
        canopy = reader.read(0, 0, reader.grid.height_px, reader.grid.width_px)[0]
    return np.where((canopy >= COVERED_PERCENT) & (canopy <= 100), np.uint8(100), np.uint8(0))


def _percent(file: Any, path: Path, *, numbers: bool) -> NDArray[np.uint8]:
    traits = find_bands(file, path, None, Notices())
    with reader_errors(path, "the pixels cannot be read"):
        colours = file.read([traits.red, traits.green, traits.blue])
        alpha = file.read(traits.alpha) if traits.alpha else None
        masked = file.read_masks(traits.red) > 0 if traits.masked else None
    if alpha is not None:
        traits = replace(traits, alpha_least=_full(alpha) / 2)
    seen = valid_pixels(colours, alpha, traits)
    if masked is not None:
        seen &= masked
    if traits.palette is not None:
        colours = np.moveaxis(traits.palette[np.clip(colours[0], 0, len(traits.palette) - 1), :3], -1, 0)
    elif numbers and traits.gray:
        return _of_numbers(colours[0], seen, path)
    return _of_colours(_bytes(colours, path, traits), seen, path)


def _full(samples: NDArray[Any]) -> float:
    """Return the sample that is white, or opaque."""
    return 65535.0 if samples.dtype == np.uint16 else 255.0


def _bytes(colours: NDArray[Any], path: Path, traits: ImageTraits) -> NDArray[np.uint8]:
    if colours.dtype.kind != "u" or colours.dtype.itemsize > 2:
        raise InputError("the samples are no colours", where=path, found=traits.dtype, expected="8 or 16 bits",
                         next_step="save it as PNG")  # fmt: skip
    if colours.dtype == np.uint8 and colours.max() == 1:  # pictures of one bit
        return np.asarray(colours * np.uint8(255))
    return colours if colours.dtype == np.uint8 else (colours >> 8).astype(np.uint8)


def _of_numbers(values: NDArray[Any], seen: NDArray[np.bool_], path: Path) -> NDArray[np.uint8]:
    """Return percentages of a band of shares, percentages, shades or a mask."""
    found = MaskValues()
    found.add(values[seen])
    if not (found.levels[1:].any() or found.broken):
        return np.zeros(values.shape, np.uint8)
    try:
        percent = percent_of(values, found.scale())
    except ValueError as error:
        raise InputError(
            "the values of the sketch are no coverage", where=path, found=str(error),
            expected="percentages 0 to 100, shares 0 to 1, shades 0 to 255, or a mask",
        ) from error  # fmt: skip
    percent = np.where(seen & (percent <= 100), percent, np.uint8(0))
    _refuse_photograph(percent, None, path)
    _refuse_grain(percent[None], percent > 0, path)
    return percent


def _of_colours(rgb: NDArray[np.uint8], seen: NDArray[np.bool_], path: Path) -> NDArray[np.uint8]:
    """Return what (3, row, col) colours say: shades of gray their share, any colour all of it."""
    bright = rgb.max(axis=0)
    coloured = seen & (bright - rgb.min(axis=0) >= COLOURED)
    whole = bool(seen.all())
    if not whole and not bright[seen].any():  # black ink on a transparent sheet
        return np.where(seen, np.uint8(100), np.uint8(0))
    percent = np.where(seen, np.rint(bright / 2.55), 0).astype(np.uint8)
    if coloured.any():
        # A brush is dim at its edge, where it is mixed with black.
        least = np.percentile(bright[coloured], 90) / 2
        percent[coloured] = np.where(bright[coloured] >= least, 100, 0)
    if whole:
        _refuse_photograph(percent, rgb[:, coloured], path)
    _refuse_grain(rgb, percent > 0, path)
    return percent


def _refuse_photograph(percent: NDArray[np.uint8], coloured: NDArray[np.uint8] | None, path: Path) -> None:
    """Refuse a picture whose paint cannot be told from its ground; `coloured` are its (3, n) colours that are no gray.

    Raises
    ------
    InputError
        It looks like a photograph, or like a drawing on paper.
    """
    levels = np.bincount(percent.ravel(), minlength=101)
    bare = levels[0] / percent.size
    if coloured is None or not coloured.size:
        coloured = None
    if not levels[0] and ((levels > 0).sum() > 1 or (coloured is not None and coloured.shape[1] < percent.size)):
        found = "not one pixel that is transparent or black"
    elif coloured is not None and _kinds(coloured) > KINDS_MOST:
        found = "very many colours"
    elif bare < SCARCE and (levels > 0).sum() > KINDS_MOST:
        found = f"{(levels > 0).sum()} shades, and hardly any black"
    else:
        return
    raise InputError(
        "which ground of the sketch is painted?", where=path, found=found,
        expected="paint on transparent or black ground",
        next_step="paint on a layer of its own, above the image, and save that layer alone as PNG",
    )  # fmt: skip


def _refuse_grain(bands: NDArray[np.uint8], painted: NDArray[np.bool_], path: Path) -> None:
    """Refuse (band, row, col) samples that change from pixel to pixel: paint is flat, and photographs never are.

    Raises
    ------
    InputError
        Of neighbours that are both painted, few are alike.
    """
    both = painted[:, 1:] & painted[:, :-1]
    alike = float((bands[:, :, 1:] == bands[:, :, :-1]).all(axis=0)[both].mean()) if both.any() else 1.0
    if both.sum() >= GRAIN_SPEAKS_FROM and alike < FLAT_LEAST:
        raise InputError(
            "this is a photograph, or another picture that is not painted", where=path,
            found=f"{alike:.0%} of neighbouring pixels alike", expected="paint on transparent or black ground",
            next_step="paint on a layer of its own, above the image, and save that layer alone as PNG",
        )  # fmt: skip


def _kinds(colours: NDArray[np.uint8]) -> int:
    """Return how many of (3, n) colours differ coarsely, those that are rare left out."""
    tones = (colours // (256 // TONES)).astype(np.int64)
    counts = np.bincount((tones[0] * TONES + tones[1]) * TONES + tones[2])
    return int((counts > max(colours.shape[1] // 1000, 1)).sum())
