"""Draws a planted city out of a register into a PNG."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from urbanforest_cli import __version__
from urbanforest_cli.core.boxes import Bounds
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.plant_looks import Season, look_of
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.scene.stage import read_city
from urbanforest_cli.export.stage import provenance_of
from urbanforest_cli.export.view.choose import Sun
from urbanforest_cli.export.view.picture import Kind, check_size, draw_view
from urbanforest_cli.files.describe import is_output
from urbanforest_cli.files.manifest import Export, describe_files, record_exports
from urbanforest_cli.files.provenance import require_record, stage_key

STAGE = "render"
PNG_LEVEL = 6  # fixed, so that the same picture gives the same bytes


def view_city(
    city: City,
    path: Path,
    *,
    size_px: tuple[int, int],
    season: Season,
    provenance: Mapping[str, Any],
    kind: Kind = "perspective",
    sun: Sun | None = None,
    bounds_m: tuple[float, float, float, float] | None = None,
    workers: int = 1,
    progress: Progress = silent,
    notices: Notices | None = None,
) -> None:
    """Draw a city and publish the picture as PNG, with its provenance as JSON in the text chunk ``urbanforest``.

    Parameters
    ----------
    size_px
        Width and height.
    season, kind, sun, bounds_m, notices
        As `draw_view` takes them.

    Raises
    ------
    InputError
        There are no plants to be seen.
    LimitError
        The picture is larger than `picture.PIXELS_MAX`.
    OutputError
        The file could not be written whole.
    """
    looks = [look_of(species) for species in city.species]
    image = draw_view(city, looks, kind=kind, size_px=size_px, bounds_m=bounds_m, sun=sun, season=season,
                      workers=workers, progress=progress, notices=notices)  # fmt: skip
    with publish(path) as part:
        part.write_bytes(png_with(image, provenance))


def png_with(image: NDArray[np.uint8], provenance: Mapping[str, Any]) -> bytes:
    """Return an image (h, w, 3) as PNG with its provenance inside."""
    text = PngInfo()
    text.add_text("Software", f"urbanforest {__version__}")
    text.add_text("urbanforest", json.dumps(provenance, ensure_ascii=True))
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, format="PNG", pnginfo=text, compress_level=PNG_LEVEL)
    return stream.getvalue()


def render_view(
    register: Path,
    path: Path,
    *,
    config: Config,
    kind: Kind,
    size_px: tuple[int, int],
    bbox: Bounds | None = None,
    season: Season = "summer",
    sun: Sun | None = None,
    workers: int = 1,
    progress: Progress = silent,
) -> StageSummary:
    """Draw the planted city of a register.

    Parameters
    ----------
    register
        Where `grow` has run.
    path
        PNG to write; it is named in exports.json where it lies beside the register.
    bbox
        West, south, east, north in the register's CRS: what the picture is of; what stands around is seen too.

    Raises
    ------
    SchemaError, StaleError
        The register has not grown its plants; the text names the command.
    InputError
        No plant stands in the box, or none at all.
    LimitError
        The picture is larger than `picture.PIXELS_MAX`.
    OutputError
        The file could not be written whole.
    """
    started = time.perf_counter()
    if path.resolve() == register.resolve() or path.is_dir():
        raise OutputExistsError("the output is the register, or a folder", where=path, next_step="name a PNG with -o")
    if path.exists() and not is_output(path, STAGE, register.parent):
        raise OutputExistsError(
            "the file is no earlier picture of this kind, and would be lost",
            where=path,
            next_step="name another with -o, or remove it first",
        )
    check_size(size_px)
    notices = Notices()
    city = read_city(register, config=config)
    height = config.growth.building_height_m
    notices.add("W_BUILDING_HEIGHT", f"buildings without a height, drawn {height:g} m high", city.unknown_height_count)
    growth = require_record(register, "grow").stage_key
    options = {"kind": kind, "size_px": list(size_px), "season": season,
               "sun_deg": list(sun) if sun is not None else None,
               **({"bbox": list(bbox)} if bbox is not None else {})}  # fmt: skip
    key = stage_key(STAGE, config=config, seed=config.seed, inputs=[growth, json.dumps(options)],
                    sections=("species",))  # fmt: skip
    bounds = None if bbox is None else _local_bounds(city, bbox)
    provenance = provenance_of(register, plants=len(city.plants), key=key) | {"format": STAGE} | options
    view_city(city, path, size_px=size_px, season=season, provenance=provenance, kind=kind, sun=sun, bounds_m=bounds,
              workers=workers, progress=progress, notices=notices)  # fmt: skip
    if path.parent.resolve() == register.parent.resolve():
        record_exports(path.parent, [Export(path.name, STAGE, key, growth, options, describe_files(path))])
    counts: dict[str, int | float | str] = {"plants": len(city.plants), "width_px": size_px[0], "height_px": size_px[1]}
    return StageSummary(STAGE, path, counts, notices, time.perf_counter() - started)


def _local_bounds(city: City, bbox: Bounds) -> tuple[float, float, float, float]:
    """Return a box about the city's origin.

    Raises
    ------
    InputError
        No plant stands in it.
    """
    west, south, east, north = bbox
    box = np.array([shapely.box(*bbox)], dtype=object)
    there = city.local_shapes(reproject(box, city.register_crs, city.crs))
    place = city.local(city.plants.xy_m)
    if not (west < east and south < north) or not shapely.contains_xy(there[0], place[:, 0], place[:, 1]).any():
        known = shapely.MultiPoint(city.plants.xy_m) if len(place) else shapely.Point()
        around = reproject(np.array([known], dtype=object), city.crs, city.register_crs)[0].bounds
        raise InputError(
            "no plant stands in the box",
            where="--bbox",
            found=" ".join(f"{value:g}" for value in bbox),
            expected="west south east north within " + " ".join(f"{value:.7g}" for value in around),
        )
    low_x, low_y, high_x, high_y = (float(value) for value in there[0].bounds)
    return low_x, low_y, high_x, high_y
