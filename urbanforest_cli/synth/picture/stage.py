"""Take the aerial picture of a city, and write it with what in it is green."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.coverage_model import CLASSES
from urbanforest_cli.core.errors import ConfigError, LimitError, OutputExistsError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.files.aerial import writing_aerial
from urbanforest_cli.files.coverage import CoverageWriter
from urbanforest_cli.synth.city import SynthCity
from urbanforest_cli.synth.picture.camera_kernel import expose
from urbanforest_cli.synth.picture.render import Frame, looks_of, render_tile
from urbanforest_cli.synth.picture.scene import Scene, set_scene

RESOLUTION_M = (0.1, 5.0)
PIXELS_MAX = 6_000_000_000
_TILES_AHEAD = 3


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """What picture is wanted.

    Parameters
    ----------
    path
        Of the picture.
    resolution_m
        Side of a pixel.
    nir
        Whether near infrared is a fourth band.
    workers
        Threads; the picture is the same for any number.
    """

    path: Path
    resolution_m: float = 0.6
    nir: bool = False
    workers: int = 1

    @property
    def coverage_path(self) -> Path:
        """Where the truth goes."""
        return self.path.with_name(f"{self.path.stem}_coverage.tif")

    def check(self, city: Path, *, overwrite: bool) -> None:
        """Refuse what cannot be made before anything is.

        Parameters
        ----------
        city
            File that the city itself goes to.

        Raises
        ------
        LimitError
            The resolution is out of bounds.
        ConfigError
            The picture's name does not end as that of a GeoTIFF.
        OutputExistsError
            The picture or its truth is there already, or would take the place of the city.
        """
        if self.path.suffix.lower() not in (".tif", ".tiff"):
            raise ConfigError("the picture is a GeoTIFF", where="--image", found=self.path.name,
                              expected="a name that ends in .tif or .tiff")  # fmt: skip
        if not RESOLUTION_M[0] <= self.resolution_m <= RESOLUTION_M[1]:
            raise LimitError(
                "no picture can be taken at this resolution", where="--image-resolution",
                found=f"{self.resolution_m:g} m", expected=f"{RESOLUTION_M[0]:g} to {RESOLUTION_M[1]:g} m",
            )  # fmt: skip
        for path in (self.path, self.coverage_path):
            if path.resolve() == city.resolve():
                raise OutputExistsError(
                    "the picture and its truth need names of their own", where=path, found=f"the city goes to {city}",
                    next_step="name another file with --image",
                )  # fmt: skip
            if path.exists() and not overwrite:
                raise OutputExistsError(
                    "the file is there already", where=path, next_step="add --overwrite to replace it"
                )


def take_picture(
    city: SynthCity,
    catalogue: Catalogue,
    settings: PictureSettings,
    *,
    seed: int,
    crs: CRS,
    place: tuple[float, float],
    provenance: dict[str, Any],
    progress: Progress = silent,
) -> dict[str, int | float | str]:
    """Publish a city's picture, and beside it the percentages of canopy and vegetation in each pixel.

    Pixels lie on whole multiples of the resolution in `crs`.

    Returns
    -------
    dict
        Pixels of the picture, and how much of it canopy and vegetation cover.

    Raises
    ------
    LimitError
        The picture would have too many pixels.
    OutputError
        It could not be written whole.
    """
    scene = set_scene(city, catalogue, seed)
    grid, frame = lay_grid(scene, settings.resolution_m, crs, place)
    announce_compile([expose], progress)
    shares = np.zeros(2)
    with (
        writing_aerial(settings.path, grid, nir=settings.nir, provenance=provenance) as aerial,
        CoverageWriter(settings.coverage_path, grid, CLASSES, provenance) as coverage,
    ):
        tiles = frame.tiles()
        for number, (tile, picture, truth) in enumerate(_rendered(scene, frame, seed, settings.workers)):
            progress("taking the picture", number, len(tiles))
            aerial.write(tile[0], tile[1], picture if settings.nir else picture[:3])
            coverage.write(tile[0], tile[1], truth)
            shares += truth.sum(axis=(1, 2), dtype=np.int64)
        progress("taking the picture", len(tiles), len(tiles))
    canopy, vegetation = (shares / (frame.rows * frame.cols)).round(2).tolist()
    return {"image_pixels": frame.rows * frame.cols, "canopy_percent": canopy, "vegetation_percent": vegetation}


def lay_grid(scene: Scene, resolution_m: float, crs: CRS, place: tuple[float, float]) -> tuple[RasterGrid, Frame]:
    """Lay the pixels over a scene whose origin is at `place`.

    Raises
    ------
    LimitError
        There would be too many.
    """
    west, south, east, north = scene.bounds
    col0, col1 = math.floor((place[0] + west) / resolution_m), math.ceil((place[0] + east) / resolution_m)
    row0, row1 = math.floor((place[1] + south) / resolution_m), math.ceil((place[1] + north) / resolution_m)
    width, height = col1 - col0, row1 - row0
    if width * height > PIXELS_MAX:
        raise LimitError(
            "the picture would be too large", where="--image-resolution", found=f"{width} x {height} pixels",
            expected=f"at most {PIXELS_MAX:,} pixels", next_step="ask for coarser pixels or fewer lots",
        )  # fmt: skip
    left, top = col0 * resolution_m, row1 * resolution_m
    grid = RasterGrid(width, height, (resolution_m, 0.0, left, 0.0, -resolution_m, top), crs)
    return grid, Frame(left - place[0], top - place[1], resolution_m, height, width)


def _rendered(
    scene: Scene, frame: Frame, seed: int, workers: int
) -> Iterator[tuple[tuple[int, int, int, int], NDArray[np.uint8], NDArray[np.uint8]]]:
    """Yield tiles in order, with no more than a few under way or waiting."""
    looks = looks_of(scene)
    tiles = iter(frame.tiles())
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[tuple[int, int, int, int], Future[Any]]] = deque()
        try:
            while True:
                while len(waiting) < workers + _TILES_AHEAD and (tile := next(tiles, None)) is not None:
                    waiting.append((tile, pool.submit(render_tile, scene, looks, frame, tile, seed)))
                if not waiting:
                    return
                tile, future = waiting.popleft()
                yield (tile, *future.result())
        finally:
            pool.shutdown(cancel_futures=True)
