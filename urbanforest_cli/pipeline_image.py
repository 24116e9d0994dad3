"""What `populate` does with an image: which part of it lies over the lots, what its map is, and whether that is there.

All of it is cheap beside mapping, and done before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError, OutputExistsError, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.canopy import read_provenance
from urbanforest_cli.files.coverage import FORMAT
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.image_checks import open_raster
from urbanforest_cli.files.image_places import raster_grid
from urbanforest_cli.files.mosaics import images_of, open_mosaic
from urbanforest_cli.files.provenance import Record, provenance_frame, require_record
from urbanforest_cli.files.vectors import list_vector_layers, read_vector
from urbanforest_cli.imagery.stage import CoverOptions, cover_image, cover_key

COVERAGE = "coverage.tif"
MARGIN_M = 40.0
"""What is mapped around the lots: crowns that reach in, and what the network sees beside a place."""
SNAP_PX = 256
"""The part mapped begins and ends at multiples of this, so that it stays when a lot changes."""
WHOLE_SHARE = 0.75
"""An image of which at least this share lies over the lots is mapped whole."""

Boxes = NDArray[np.float64]


@dataclass(frozen=True)
class Mapping:
    """The map of an image that `populate` makes.

    Parameters
    ----------
    images, model, options
        As `cover_image` takes them.
    key
        Hash of all that decides the map.
    grid
        Of the whole image.
    """

    images: tuple[Path, ...]
    model: Path | None
    options: CoverOptions
    key: str
    grid: RasterGrid

    def is_made(self, path: Path) -> bool:
        """Tell whether a file is this map."""
        return _made_by(path).get("key") == self.key

    def make(self, path: Path, workers: int, progress: Progress) -> StageSummary:
        """Write the map, unless it is there."""
        return cover_image(
            self.images, path, model=self.model, options=self.options, workers=workers,
            overwrite=not self.is_made(path), progress=progress,
        )  # fmt: skip


def mapping_of(
    images: Sequence[Path], model: Path | None, city: Path, lots_layer: str | None, assume_crs: str | None
) -> Mapping:
    """Look at images and lots, and say which part is to be mapped.

    Raises
    ------
    InputError
        An image, the lots or the model cannot be used, or no lot lies in the image; also CrsError and LimitError.
    """
    notices = Notices()
    files = list({f.resolve(): f for path in images for f in images_of(path, but=(), notices=notices)}.values())
    with open_mosaic(files, assume_crs=assume_crs, notices=notices) as reader:
        grid = reader.grid
    boxes = refuse_apart(city, lots_layer, assume_crs, grid, "image", files[0])
    options = CoverOptions(assume_crs=assume_crs, bbox=part_over(boxes, grid))
    return Mapping(tuple(files), model, options, cover_key(files, model=model, options=options), grid)


def grid_of(path: Path, assume_crs: str | None) -> RasterGrid:
    """Return where a raster file lies."""
    with open_raster(path, Notices()) as (file, _):
        return raster_grid(file, path, assume_crs=assume_crs, notices=Notices())[0]


def refuse_apart(
    city: Path, lots_layer: str | None, assume_crs: str | None, grid: RasterGrid, what: str, where: Path
) -> Boxes:
    """Return the boxes of lots, in the CRS of an image or a map; refuse one that no lot lies in.

    Raises
    ------
    InputError
        No lot lies in it; the text names both extents.
    """
    boxes = lot_boxes(city, lots_layer, assume_crs, grid.crs)
    west, south, east, north = grid.bounds
    inside = (boxes[:, 0] < east) & (boxes[:, 2] > west) & (boxes[:, 1] < north) & (boxes[:, 3] > south)
    if len(boxes) and not inside.any():
        lots = (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0))
        raise InputError(
            f"no lot lies in the {what}", where=where, found=f"{what} {_extent(grid.bounds)}",
            expected=f"lots {_extent(lots)}, in {grid.crs.name}",
            next_step="check that both are of the same place, and their CRS",
        )  # fmt: skip
    return np.asarray(boxes[inside])


def lot_boxes(city: Path, lots_layer: str | None, assume_crs: str | None, crs: CRS) -> Boxes:
    """Return west, south, east and north of every lot that has a place, in a CRS."""
    if lots_layer is None:
        plain = {name.casefold(): name for name, kind in reversed(list_vector_layers(city)) if kind is not None}
        lots_layer = plain.get("lots")
    frame = read_vector(city, layer=lots_layer, columns=(), assume_crs=assume_crs, notices=Notices())
    bounds = shapely.bounds(frame.geometry.to_numpy())
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    corners = bounds[:, [0, 1, 0, 3, 2, 1, 2, 3]].reshape(-1, 2)
    xy = reproject_xy(corners, CRS.from_user_input(frame.crs), crs).reshape(-1, 4, 2)
    boxes = np.concatenate((xy.min(axis=1), xy.max(axis=1)), axis=1)
    return np.asarray(boxes[np.isfinite(boxes).all(axis=1)])


def part_over(boxes: Boxes, grid: RasterGrid) -> tuple[float, float, float, float] | None:
    """Return the part of an image over lots and what is around them, in the image's CRS; None for all of it."""
    if not len(boxes):
        return None
    a, _, c, _, e, f = grid.transform
    wide_m, high_m = grid.resolution_m
    margin = (math.ceil(MARGIN_M / wide_m), math.ceil(MARGIN_M / high_m))
    cols = ((boxes[:, 0].min() - c) / a - margin[0], (boxes[:, 2].max() - c) / a + margin[0])
    rows = ((boxes[:, 3].max() - f) / e - margin[1], (boxes[:, 1].min() - f) / e + margin[1])
    left, right = _snapped(*cols, grid.width_px)
    top, bottom = _snapped(*rows, grid.height_px)
    if (right - left) * (bottom - top) >= WHOLE_SHARE * grid.width_px * grid.height_px:
        return None
    inset = 1e-3  # pixels, so that no rounding takes in one more
    return (c + a * (left + inset), f + e * (bottom - inset), c + a * (right - inset), f + e * (top + inset))


def _snapped(low: float, high: float, count: int) -> tuple[int, int]:
    return max(0, math.floor(low / SNAP_PX) * SNAP_PX), min(count, math.ceil(high / SNAP_PX) * SNAP_PX)


def refuse_foreign_map(path: Path) -> None:
    """Refuse to write a map over a file that `cover` did not make."""
    if path.exists() and _made_by(path).get("format") != FORMAT:
        raise OutputExistsError(
            "the file is there already, and no map of `urbanforest cover`", where=path,
            next_step="name another folder with -o, or give the file with --coverage in place of --image",
        )  # fmt: skip


def map_record(register: Path, mapping: Mapping, summary: StageSummary, path: Path, seed: int) -> None:
    """Write down in a register what its map was made from, and which file it is."""
    record = Record(
        stage=summary.stage,
        seed=seed,
        stage_key=mapping.key,
        working_crs=require_record(register, "stencil").working_crs,
        config={},
        inputs=[*({"name": image.name} for image in mapping.images), {"name": COVERAGE, "sha256": sha256_of(path)}],
        counts=dict(summary.counts),
        notices=summary.notices,
    )
    write_layers(register, {"provenance": provenance_frame(register, record)})


def is_recorded(record: Record, mapping: Mapping, path: Path) -> bool:
    """Tell whether a register was made with this map, and the file is as it was."""
    if record.stage_key != mapping.key or not path.is_file():
        return False
    return {"name": COVERAGE, "sha256": sha256_of(path)} in record.inputs


def _made_by(path: Path) -> dict[str, Any]:
    """Return what a map says of its making; nothing where there is none, or it says nothing."""
    try:
        return (read_provenance(path) if path.is_file() else None) or {}
    except UrbanForestError:
        return {}


def _extent(bounds: Sequence[float]) -> str:
    west, south, east, north = bounds
    return f"x {west:.9g} to {east:.9g}, y {south:.9g} to {north:.9g}"
