"""Maps the coverage of images: files in, a map out."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from urbanforest_cli import __version__
from urbanforest_cli.core.boxes import Bounds
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish, sha256_of
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.canopy import read_provenance
from urbanforest_cli.files.coverage import CoverageReader, CoverageWriter, open_coverage
from urbanforest_cli.files.coverage_models import CoverageModel, load_coverage_model
from urbanforest_cli.files.mosaics import MosaicReader, images_of, open_mosaic
from urbanforest_cli.imagery.inference import CoverageSession
from urbanforest_cli.imagery.mapping import map_windows
from urbanforest_cli.imagery.overview import Tally, ground_m, shrunk, tally_of
from urbanforest_cli.imagery.preview import draw_preview

STAGE = "cover"
SIDECARS = (".tfw", ".tifw", ".tiffw", ".pgw", ".pngw", ".jgw", ".jpgw", ".j2w", ".wld", ".prj")
SIDECARS_ADDED = (".aux.xml", ".msk")


@dataclass(frozen=True, kw_only=True)
class CoverOptions:
    """How images are read and what of them is mapped; see `urbanforest cover --help`."""

    bands: tuple[int, ...] | None = None
    stretch: tuple[float, float] | None = None
    assume_crs: str | None = None
    bbox: Bounds | None = None
    window_px: int | None = None


def cover_image(
    images: Sequence[Path],
    output: Path,
    *,
    model: Path | None = None,
    options: CoverOptions | None = None,
    preview: Path | None = None,
    workers: int = 1,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StageSummary:
    """Map the coverage of an image, or of several as one, into a cloud-optimised GeoTIFF.

    Nothing is drawn by chance. The map is the same for any number of workers; for a model whose halo is as wide as it
    sees, also for any size of windows, and a part of the image gives the same part of the map but for its border, as
    long as the pixels at its centre measure about as much on the ground: in degrees and Web Mercator they need not.

    Parameters
    ----------
    images
        Files, or folders of files.
    output
        One band a class, percentages, 255 where the image has no pixel; on the pixels of the image.
    model
        An ONNX file of `train-coverage`; the one that comes with the program by default.
    preview
        PNG to draw as well.
    workers
        Threads.

    Raises
    ------
    InputError
        Images or the model cannot be used; also LimitError, CrsError and ConfigError.
    OutputExistsError
        The output is there, made of something else, and is not to be overwritten.
    OutputError
        It could not be written whole.
    """
    started = time.perf_counter()
    options = options or CoverOptions()
    notices = Notices()
    paths = _distinct([file for path in images for file in images_of(path, but=(output, preview), notices=notices)])
    _refuse_inputs(paths, output, preview, model)
    made_by = load_coverage_model(model)
    files = [_fingerprint(path, index, len(paths), progress) for index, path in enumerate(paths)]
    provenance = _provenance(made_by, files, options)
    is_made = not overwrite and _is_there(output, provenance["key"])
    is_drawn = preview is None or (not overwrite and _is_there(preview, provenance["key"]))
    with open_mosaic(
        paths, bands=options.bands, assume_crs=options.assume_crs, stretch=options.stretch, notices=notices
    ) as reader:
        rows, cols = _wanted(reader.grid, options.bbox)
        grid = reader.grid.window(rows.start, cols.start, len(rows), len(cols))
        if not is_made:
            _map(reader, grid, (rows, cols), output, made_by, options, provenance, workers, progress, notices)
        with open_coverage(output, notices=Notices()) as coverage:
            tally = tally_of(coverage)
            notices.add("W_NO_PIXELS", "maps of images without a single pixel, unknown all over", tally.known_px == 0)
            if preview is not None and not is_drawn:
                _draw(reader, (rows.start, cols.start), coverage, tally, preview, provenance)
    counts: dict[str, int | float | str] = {
        "images": len(paths), "width_px": grid.width_px, "height_px": grid.height_px,
        "resolution_m": round(grid.resolution_m[0], 4),
    }  # fmt: skip
    if tally.known_px:
        counts |= {f"{name}_percent": round(100 * tally.share(name), 2) for name in tally.classes}
    return StageSummary(
        STAGE, output, counts, notices, time.perf_counter() - started, is_made and is_drawn,
        unknown=() if tally.known_px else tuple(f"{name}_percent" for name in tally.classes),
        sentence=_sentence(len(paths), grid, tally),
    )  # fmt: skip


def cover_key(images: Sequence[Path], *, model: Path | None = None, options: CoverOptions | None = None) -> str:
    """Return the hash of all that decides the map of some image files, which the map bears.

    Raises
    ------
    InputError
        An image or the model cannot be used.
    """
    files = [_fingerprint(path, 0, 1, silent) for path in _distinct(list(images))]
    return str(_provenance(load_coverage_model(model), files, options or CoverOptions())["key"])


def _sentence(images: int, grid: RasterGrid, tally: Tally) -> str:
    """Say what was found, for a user to read."""
    wide, high = (f"{side_m:.3g}" for side_m in grid.resolution_m)
    pixels = f"{wide} m" if wide == high else f"{wide} x {high} m"
    size = f"{grid.width_px:,} x {grid.height_px:,} pixels of {pixels}" + (
        f" from {images} images" if images > 1 else ""
    )
    if not tally.known_px:
        return f"nothing is known, for the image has no pixels here ({size})"
    shares = ", ".join(f"{name} {100 * tally.share(name):.2f} %" for name in tally.classes)
    missing = 100 * (1 - tally.known_px / (grid.width_px * grid.height_px))
    return f"{shares} of the ground ({size}" + (f", {missing:.3g} % of them missing)" if missing else ")")


def _map(
    reader: MosaicReader,
    grid: RasterGrid,
    wanted: tuple[range, range],
    output: Path,
    model: CoverageModel,
    options: CoverOptions,
    provenance: dict[str, Any],
    workers: int,
    progress: Progress,
    notices: Notices,
) -> None:
    session = CoverageSession(model.content, model.info)
    windows = map_windows(
        reader, wanted, session, window_px=options.window_px, workers=workers, progress=progress, notices=notices,
        where=reader.paths[0],
    )  # fmt: skip
    with closing(windows), CoverageWriter(output, grid, model.info.classes, provenance) as writer:
        for row, col, values in windows:
            writer.write(row, col, values)


def _wanted(grid: RasterGrid, bbox: Bounds | None) -> tuple[range, range]:
    """Return the rows and columns that a box touches; all without one."""
    if bbox is None:
        return range(grid.height_px), range(grid.width_px)
    a, _, c, _, e, f = grid.transform
    west, south, east, north = bbox
    cols = _touched((west - c) / a, (east - c) / a, grid.width_px)
    rows = _touched((north - f) / e, (south - f) / e, grid.height_px)
    if not rows or not cols:
        raise ConfigError(
            "the box lies beside the image", where="--bbox", found=" ".join(f"{value:.9g}" for value in bbox),
            expected="west south east north within " + " ".join(f"{value:.9g}" for value in grid.bounds),
        )  # fmt: skip
    return rows, cols


def _touched(low: float, high: float, count: int) -> range:
    """Return which of some pixels a stretch of them touches, however far it goes beyond."""
    if math.isnan(low) or math.isnan(high):
        return range(0)
    return range(math.floor(min(max(low, 0), count)), math.ceil(min(max(high, 0), count)))


def _distinct(paths: list[Path]) -> list[Path]:
    return list({path.resolve(): path for path in paths}.values())


def _refuse_inputs(paths: Sequence[Path], output: Path, preview: Path | None, model: Path | None) -> None:
    taken = {path.resolve() for path in (*paths, *([model] if model else []))}
    for path in (output, preview):
        if path is not None and (path.resolve() in taken or path.is_dir()):
            raise OutputExistsError(
                "the output is an input, or a folder", where=path, next_step="name another file with -o"
            )
        if path is not None:
            taken.add(path.resolve())


def _fingerprint(path: Path, index: int, count: int, progress: Progress) -> dict[str, object]:
    """Return name, size and hash of an image, and those of the files that say where it lies or what of it is masked."""
    beside = [path.with_suffix(end) for end in SIDECARS] + [path.with_name(path.name + end) for end in SIDECARS_ADDED]
    try:
        if not path.is_file():
            raise InputError("no such file" if not path.exists() else "not a regular file", where=path,
                             next_step="check the path")  # fmt: skip
        record: dict[str, object] = {"name": path.name, "bytes": path.stat().st_size, "sha256": sha256_of(path)}
        sidecars = {file.name: sha256_of(file) for file in beside if file.is_file()}
    except OSError as error:
        raise InputError("the image cannot be read", where=path, found=error.strerror or str(error)) from error
    if count > 1:
        progress("images", index + 1, count)
    return record | ({"beside": sidecars} if sidecars else {})


def _provenance(model: CoverageModel, files: Sequence[dict[str, object]], options: CoverOptions) -> dict[str, Any]:
    """Return what the map says of its making, with a key of all that decides its values."""
    chosen = {
        "bands": options.bands, "stretch": options.stretch, "assume_crs": options.assume_crs, "bbox": options.bbox,
        "window_px": options.window_px,
    }  # fmt: skip
    told = {name: list(value) if isinstance(value, tuple) else value for name, value in chosen.items() if value}
    key = hashlib.sha256(json.dumps([STAGE, __version__, model.sha256, list(files), told]).encode()).hexdigest()[:32]
    return {
        "program": "urbanforest",
        "program_version": __version__,
        "format": STAGE,
        "key": key,
        "model": {
            "name": model.path.name,
            "sha256": model.sha256,
            "preset": model.info.preset,
            "resolution_m": model.info.resolution_m,
            "thresholds": dict(zip(model.info.classes, model.info.thresholds, strict=True)),
        },
        "inputs": list(files),
        "options": told,
    }


def _is_there(path: Path, key: str) -> bool:
    """Tell whether an output is there and up to date.

    Raises
    ------
    OutputExistsError
        It is there and made of something else.
    """
    if not path.exists():
        return False
    try:
        found = _picture_provenance(path) if path.suffix.lower() == ".png" else read_provenance(path)
    except UrbanForestError:
        found = None
    if found is not None and found.get("key") == key:
        return True
    raise OutputExistsError(
        "the file is there already, made of something else", where=path, next_step="add --overwrite to replace it"
    )


def _picture_provenance(path: Path) -> dict[str, Any] | None:
    try:
        with Image.open(path) as picture:
            found = json.loads(picture.info.get("urbanforest", "null"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _draw(
    reader: MosaicReader,
    corner: tuple[int, int],
    coverage: CoverageReader,
    tally: Tally,
    path: Path,
    provenance: dict[str, Any],
) -> None:
    """Draw the preview from the image and its finished map."""
    rgb, covers = shrunk(reader, corner, coverage)
    width_m, height_m = ground_m(coverage.grid)
    png = draw_preview(
        rgb, covers, coverage.classes, width_m=width_m, height_m=height_m,
        size_px=(coverage.grid.height_px, coverage.grid.width_px),
        shares={name: tally.share(name) for name in coverage.classes if tally.known_px}, provenance=provenance,
    )  # fmt: skip
    with publish(path) as part:
        part.write_bytes(png)
