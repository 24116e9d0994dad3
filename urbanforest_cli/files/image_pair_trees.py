"""Positions of trees on the pixels of images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.image_pair_blocks import Block, Image
from urbanforest_cli.files.vectors import read_vector, split_source

Points = tuple[NDArray[np.float64], CRS]


def trees_by_image(
    images: list[Image], source: Path | None, *, looked_for: bool, assume_crs: str | None, notices: Notices
) -> dict[str, NDArray[np.float64]]:
    """Read tree points and bring them to the pixels of their images.

    Parameters
    ----------
    source
        A file of the points of all images; those of each image's own file otherwise.
    looked_for
        Whether an image without a file has no trees; else nobody looked.

    Returns
    -------
    dict
        By image: (n, 2) row and column from the outer corner of the first pixel. Images that lie nowhere, or where
        nobody looked, are left out.

    Raises
    ------
    InputError
        A file cannot be used, or none of its points lies on its image.
    """
    everywhere = None if source is None else _read(source, assume_crs, notices)
    found: dict[str, NDArray[np.float64]] = {}
    for image in images:
        if image.grid is None:
            continue
        own = image.files.trees
        if everywhere is not None:
            found[image.files.name] = _on(image.grid, *everywhere)
        elif own is not None:
            points = _read(own, assume_crs, notices)
            found[image.files.name] = _on(image.grid, *points)
            outside = len(points[0]) - len(found[image.files.name])
            if outside and outside == len(points[0]):
                raise InputError("none of the trees lies on its image", where=own, found=f"{outside} points",
                                 expected=f"points on {image.files.image}",
                                 next_step="check their CRS, and that both are of one place")  # fmt: skip
            notices.add("W_TREES_OUTSIDE", "trees that lie beside their image", outside, [image.files.name])
        elif looked_for:
            found[image.files.name] = np.empty((0, 2))
    if everywhere is not None and not any(map(len, found.values())):
        raise InputError("none of the trees lies on an image", where=source, found=f"{len(everywhere[0])} points",
                         next_step="check their CRS, and that both are of one place")  # fmt: skip
    return found


def trees_of(block: Block, trees: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Return the trees of a block on its own pixels; None where nobody looked."""
    points = trees.get(block.image.files.name)
    if points is None:
        return None
    moved = points - (block.row, block.col)
    return np.asarray(moved[_inside(moved, block.height_px, block.width_px)])


def _read(path: Path, assume_crs: str | None, notices: Notices) -> Points:
    file, layer = split_source(str(path))
    frame = read_vector(file, layer=layer, columns=(), kinds=("point",), assume_crs=assume_crs, notices=notices)
    shapes = frame.geometry.to_numpy()
    shapes = shapely.get_parts(shapes[~(shapely.is_missing(shapes) | shapely.is_empty(shapes))])
    xy = shapely.get_coordinates(shapes)
    kept = np.isfinite(xy).all(axis=1)
    notices.add("W_TREES_EMPTY", "trees without a place", len(frame) - int(kept.sum()), [path.name])
    return xy[kept], CRS.from_user_input(frame.crs)


def _on(grid: RasterGrid, xy: NDArray[np.float64], crs: CRS) -> NDArray[np.float64]:
    moved = reproject_xy(xy, crs, grid.crs)
    west, _, _, north = grid.bounds
    wide, high = grid.pixel_size
    place = np.column_stack(((north - moved[:, 1]) / high, (moved[:, 0] - west) / wide))
    return np.asarray(place[_inside(place, grid.height_px, grid.width_px)])


def _inside(place: NDArray[np.float64], height_px: int, width_px: int) -> NDArray[np.bool_]:
    return np.asarray(((place >= 0.0) & (place < (height_px, width_px))).all(axis=1))
