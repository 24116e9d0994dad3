"""Make a procedural city file."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from urbanforest_cli.core.config import Config, Species
from urbanforest_cli.core.crs import is_metric
from urbanforest_cli.core.errors import CrsError, LimitError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record, stage_key
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.synth.city import STAGE, SynthCity, build_city
from urbanforest_cli.synth.picture.stage import PictureSettings, take_picture
from urbanforest_cli.synth.plan import Geometries

LOT_COUNT_MIN, LOT_COUNT_MAX = 10, 1_000_000
DEFAULT_CRS = "EPSG:32633"
DEFAULT_PLACE = (459_000.0, 5_549_000.0)
"""Easting and northing of the city's centre in the default CRS, in Bohemia."""

GEOMETRY_TYPES = {
    "lots": "MultiPolygon",
    "buildings": "Polygon",
    "roads": "LineString",
    "driveways": "Polygon",
    "entrances": "Point",
    "obstacles": "Unknown",
    "sketches": "Polygon",
    "observed_plants": "Point",
}


def make_city(
    output: Path,
    *,
    lot_count: int,
    seed: int,
    crs: str = DEFAULT_CRS,
    squares: bool = False,
    picture: PictureSettings | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StageSummary:
    """Make a procedural city and publish it as a GeoPackage.

    Writes layers ``lots``, ``buildings``, ``roads``, ``driveways``, ``entrances``, ``obstacles``, ``sketches`` and
    ``observed_plants``. The city depends on the number of lots and the seed alone.

    Parameters
    ----------
    output
        The city file.
    lot_count
        Lots it shall have, exactly.
    crs
        A projected CRS in metres.
    squares
        Make one lot, and another for every twenty thousand, a square of the street zone. Without squares the street
        zone is what `stencil` derives from the roads; with them it is these lots.
    picture
        Take an aerial picture of the city, too.
    overwrite
        Replace a file that stands in the way.

    Raises
    ------
    LimitError
        Fewer than 10 lots, or more than a million; or no such picture can be taken.
    CrsError
        The CRS is unknown, not projected, or not in metres.
    OutputExistsError
        The file is there already, or the picture, or both have one name.
    OutputError
        It could not be written whole.
    """
    started = time.perf_counter()
    if not LOT_COUNT_MIN <= lot_count <= LOT_COUNT_MAX:
        raise LimitError(
            "this many lots cannot be made",
            where="--lots",
            found=lot_count,
            expected=f"{LOT_COUNT_MIN} to {LOT_COUNT_MAX:,}",
        )
    if output.exists() and not overwrite:
        raise OutputExistsError("the file is there already", where=output, next_step="add --overwrite to replace it")
    if picture is not None:
        picture.check(output, overwrite=overwrite)
    target, place = city_place(crs)
    catalogue = load_catalogue(Species())
    city = build_city(lot_count, seed, catalogue, squares=squares, progress=progress)
    frames = _frames(city, target, place)
    counts: dict[str, int | float | str] = {name: len(frame) for name, frame in frames.items()}
    settings: dict[str, object] = {"lots": lot_count, "crs": crs, "squares": squares}
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=stage_key(STAGE, config=Config(), seed=seed, inputs=[json.dumps(settings)], sections=()),
        working_crs=target,
        config=settings,
        inputs=[],
        counts=dict(counts),
    )
    frames["provenance"] = pd.DataFrame([record.as_row()])
    progress("writing", 0, 1)
    write_layers(output, frames, fresh=True, geometry_types=GEOMETRY_TYPES)
    progress("writing", 1, 1)
    if picture is not None:
        counts |= take_picture(
            city, catalogue, picture, seed=seed, crs=target, place=place, provenance=_picture_record(record, picture),
            progress=progress,
        )  # fmt: skip
    return StageSummary(STAGE, output, counts, Notices(), time.perf_counter() - started)


def _picture_record(record: Record, picture: PictureSettings) -> dict[str, Any]:
    """Return what made a picture from what."""
    return {
        "stage": f"{STAGE} --image", "seed": str(record.seed), "stage_key": record.stage_key,
        "program_version": record.program_version, "resolution_m": picture.resolution_m, **record.config,
    }  # fmt: skip


def city_place(text: str) -> tuple[CRS, tuple[float, float]]:
    """Return a CRS and where in it the city lies: the middle of its area of use, to a kilometre.

    Raises
    ------
    CrsError
        The CRS is unknown, not projected, or not in metres.
    """
    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise CrsError("unknown CRS", where="--crs", found=text, expected="for example EPSG:32633") from error
    if not is_metric(crs):
        raise CrsError(
            "not a projected CRS in metres",
            where="--crs",
            found=f"{text} ({crs.name}), axes in {', '.join(axis.unit_name for axis in crs.axis_info)}",
            expected="for example EPSG:32633, or the UTM zone of your place",
        )
    if crs == CRS.from_user_input(DEFAULT_CRS):
        return crs, DEFAULT_PLACE
    area = crs.area_of_use
    if area is None:
        return crs, (0.0, 0.0)
    longitude, latitude = (area.west + area.east) / 2, (area.south + area.north) / 2
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(longitude, latitude)
    if not (math.isfinite(x) and math.isfinite(y)):
        return crs, (0.0, 0.0)
    return crs, (round(x, -3), round(y, -3))


def _frames(city: SynthCity, crs: CRS, place: tuple[float, float]) -> dict[str, pd.DataFrame]:
    """Lay the city down at its place, a frame a layer; a layer without rows is left out."""

    def layer(shapes: Geometries, columns: dict[str, Any] | None = None) -> gpd.GeoDataFrame:
        return gpd.GeoDataFrame(columns or {}, geometry=_moved(shapes, place), crs=crs)

    lots, buildings, trees, sketches = city.lots, city.buildings, city.inventory, city.sketches
    layers = {
        "lots": layer(lots.shapes, {"lot_id": [f"L{number:06d}" for number in range(len(lots))], "zone": city.zones}),
        "buildings": layer(
            buildings.shapes,
            {
                "building_id": [f"B{number:06d}" for number in range(len(buildings.shapes))],
                "height_m": buildings.heights_m,
            },
        ),
        "roads": layer(city.roads.lines, {"kind": city.roads.kinds, "width_m": city.roads.widths_m}),
        "driveways": layer(buildings.driveways),
        "entrances": layer(buildings.entrances, {"kind": buildings.entrance_kinds}),
        "obstacles": layer(
            city.obstacles.shapes, {"kind": city.obstacles.kinds, "clearance_m": city.obstacles.clearances_m}
        ),
        "sketches": layer(
            sketches.shapes,
            {
                "sketch_id": [f"S{number + 1}" for number in range(len(sketches.shapes))],
                "strategy": sketches.strategies,
                "coverage": sketches.coverage,
                "spacing_m": sketches.spacing_m,
                "radius_mean_m": sketches.radius_mean_m,
                "cluster_radius_m": sketches.cluster_radius_m,
                "note": sketches.notes,
            },
        ),
        "observed_plants": layer(
            trees.points,
            {"species": trees.species, "height_m": trees.heights_m, "crown_diameter_m": trees.crown_diameters_m},
        ),
    }
    return {name: frame for name, frame in layers.items() if len(frame)}


def _moved(shapes: Geometries, place: tuple[float, float]) -> Geometries:
    return np.asarray(shapely.transform(shapes, lambda xy: xy + np.asarray(place)))
