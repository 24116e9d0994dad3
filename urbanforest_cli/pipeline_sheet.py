"""A sheet as the paper's figures are: image, coverage, regions, plants and the grown view of the same ground."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.boxes import Bounds
from urbanforest_cli.core.colours import mixed, species_colour, to_rgb
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.coverage_model import CANOPY
from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.crowns import Crowns, draw_crowns
from urbanforest_cli.export.drawing import Pane, cast_shadows, draw_roads, fill_polygons
from urbanforest_cli.export.map_page import BUILDING_EDGE, BUILDING_FILL, GROUND, ROAD_CASING, ROAD_FILL
from urbanforest_cli.export.plant_looks import look_of
from urbanforest_cli.export.png import png_of
from urbanforest_cli.export.scene.stage import read_city
from urbanforest_cli.export.sheet import (
    PANE_PX,
    Painter,
    SheetRow,
    draw_sheet,
    paint_outlines,
    paint_percent,
    paint_picture,
)
from urbanforest_cli.export.sheet_places import densest_places
from urbanforest_cli.export.stage import city_name, provenance_of
from urbanforest_cli.export.view.picture import draw_view
from urbanforest_cli.files.coverage_windows import MetricCoverage
from urbanforest_cli.files.geopackage import layer_names, read_layer
from urbanforest_cli.files.image_squares import image_square
from urbanforest_cli.files.mosaics import open_mosaic
from urbanforest_cli.files.provenance import read_records, require_record
from urbanforest_cli.files.skeleton_parts import parts_are_there

Shapes = NDArray[np.object_]

COVERAGE_FILE = "coverage.tif"
REGION_FILL, STEMS_FILL = "#8fc39b", "#3f8f58"
AROUND_M = 30.0
"""Plants so far outside of the ground shown still throw their shadows into it."""


@dataclass(frozen=True)
class _City:
    """What is drawn from the register, in metres; `regions` and `stems` are None where no map was used."""

    working: CRS
    crs: CRS
    lots: Shapes
    buildings: Shapes
    height_m: NDArray[np.float64]
    roads: Shapes
    regions: Shapes | None
    stems: Shapes
    crowns: Crowns


def write_sheet(
    register: Path,
    path: Path,
    *,
    config: Config,
    images: Sequence[Path] = (),
    coverage: Path | None = None,
    at: Sequence[tuple[float, float]] = (),
    places: int = 1,
    size_m: float = 120.0,
    assume_crs: str | None = None,
    workers: int = 1,
    progress: Progress = silent,
) -> StageSummary:
    """Write a sheet of places of a planted city: columns for what there is, one row a place.

    Parameters
    ----------
    register
        With plants; the view from above is drawn where they have grown.
    path
        PNG to write.
    images
        Aerial images, of any CRS.
    coverage
        Map; the file ``coverage.tif`` beside the register is taken where none is named.
    at
        Middles of places in the register's CRS; those with the most plants, within images and map, by default.
    places
        How many are chosen where none is named.
    size_m
        Width of a place.
    assume_crs
        CRS of images or a map that state none.

    Raises
    ------
    SchemaError
        No plants have been placed.
    InputError
        A file cannot be used, or a place lies beside the city.
    """
    started = time.perf_counter()
    notices = Notices()
    working = require_record(register, "place").working_crs
    city = _read(register, working)
    if coverage is None and (register.parent / COVERAGE_FILE).is_file():
        coverage = register.parent / COVERAGE_FILE
    known = [shapely.box(*shapely.total_bounds(city.lots))]
    if coverage is not None:
        with _opened(coverage, register, working, assume_crs, notices) as reader:
            known.append(shapely.box(*reader.bounds_m))
    if images:
        with open_mosaic(images, assume_crs=assume_crs, notices=notices) as mosaic:
            whole = np.array([shapely.box(*mosaic.grid.bounds)], dtype=object)
            known.append(reproject(shapely.segmentize(whole, np.ptp(mosaic.grid.bounds[::2]) / 8), mosaic.grid.crs,
                                   working)[0])  # fmt: skip
    middles = reproject_xy(np.array(at, dtype=np.float64).reshape(-1, 2), city.crs, working)
    if len(middles) == 0:
        within = shapely.intersection_all(known)
        if not shapely.intersects(within, city.lots[~shapely.is_missing(city.lots)]).any():
            raise InputError(
                "no lot of the city is in the image and in the map",
                where=register,
                found="; ".join(_extent(box) for box in known),
                expected="images and a map of the same place",
                next_step="name an image of this city with --image, or give --at and leave the image out",
            )
        middles = densest_places(city.crowns.xy, within, size_m, places)
    frames = [_frame(float(x), float(y), size_m, city, register) for x, y in middles]

    grown = _has_grown(register, notices)
    titles, columns = [], []
    if images:
        titles.append("image")
        columns.append(_image_painters(images, frames, working, assume_crs))
    if coverage is not None:
        titles.append("coverage")
        columns.append(_coverage_painters(coverage, register, frames, city, assume_crs))
    if city.regions is not None:
        titles.append("regions")
        columns.append([partial(_paint_regions, city=city) for _ in frames])
    titles.append("plants")
    columns.append([partial(_paint_plants, city=city) for _ in frames])
    if grown:
        titles.append("grown")
        columns.append(_view_painters(register, frames, city, config, workers, progress))
    notes = [_note(frame, city) for frame in frames]
    rows = [SheetRow(frame, notes[k], [column[k] for column in columns]) for k, frame in enumerate(frames)]
    note = f"{len(city.crowns):,} plants, {len(city.lots):,} lots; north is up, {working.name}"
    figure = draw_sheet(titles, rows, heading=city_name(register), note=note)
    provenance = provenance_of(register, plants=len(city.crowns), key="") | {
        "format": "sheet", "frames_m": [list(frame) for frame in frames],
        "images": [image.name for image in images], "coverage": coverage.name if coverage is not None else None,
    }  # fmt: skip
    content = png_of(figure, provenance)
    with publish(path) as part:
        part.write_bytes(content)
    counts: dict[str, int | float | str] = {"places": len(frames), "columns": len(titles)}
    return StageSummary("sheet", path, counts, notices, time.perf_counter() - started)


def _extent(box: shapely.Geometry) -> str:
    west, south, east, north = shapely.bounds(box)
    return f"x {west:.0f} to {east:.0f} m, y {south:.0f} to {north:.0f} m"


def _read(register: Path, working: CRS) -> _City:
    lots, plants = read_layer(register, "lots"), read_layer(register, "plants")
    buildings, roads = read_layer(register, "buildings"), read_layer(register, "roads")
    areas = read_layer(register, "active_areas")
    names = set(layer_names(register))
    regions = _shapes(read_layer(register, "regions"), working) if "regions" in names else None
    species = plants["species"].to_numpy(dtype=object)
    colours = {name: to_rgb(species_colour(str(name))) for name in set(species)}
    crowns = Crowns(
        shapely.get_coordinates(_shapes(plants, working)),
        plants["envelope_radius_m"].to_numpy(dtype=np.float64),
        np.array([colours[name] for name in species]).reshape(-1, 3),
        plants["habit"].to_numpy(dtype=object) == "tree",
    )
    heights = buildings["height_m"].to_numpy(dtype=np.float64, na_value=np.nan)
    stems = _shapes(gpd.GeoDataFrame(areas[areas["kind"] == "region"]), working)
    return _City(
        working, CRS.from_user_input(lots.crs), _shapes(lots, working), _shapes(buildings, working),
        np.where(heights > 0, heights, Config().growth.building_height_m), _shapes(roads, working),
        regions if regions is not None and len(regions) else None, stems, crowns,
    )  # fmt: skip


def _shapes(frame: gpd.GeoDataFrame, working: CRS) -> Shapes:
    return reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), working)


def _frame(x: float, y: float, size_m: float, city: _City, register: Path) -> Bounds:
    frame = (x - size_m / 2, y - size_m / 2, x + size_m / 2, y + size_m / 2)
    bounds = shapely.total_bounds(city.lots)
    if not shapely.box(*bounds).intersects(shapely.box(*frame)):
        west, south, east, north = reproject(np.array([shapely.box(*bounds)], dtype=object), city.working,
                                             city.crs)[0].bounds  # fmt: skip
        raise InputError(
            "the place lies beside the city", where=register, found=f"{x:.0f}, {y:.0f} in metres",
            expected=f"x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}",
            next_step=f"give --at in the CRS of the register, {city.crs.name}",
        )  # fmt: skip
    return frame


def _note(frame: Bounds, city: _City) -> str:
    x, y = (frame[0] + frame[2]) / 2, (frame[1] + frame[3]) / 2
    (there,) = reproject_xy(np.array([[x, y]]), city.working, city.crs)
    digits = 6 if city.crs.is_geographic else 0
    inside = (np.abs(city.crowns.xy - (x, y)) <= (frame[2] - frame[0]) / 2).all(axis=1)
    return f"{int(inside.sum()):,} plants; middle at {there[0]:.{digits}f}, {there[1]:.{digits}f}"


def _opened(path: Path, register: Path, working: CRS, assume_crs: str | None, notices: Notices) -> MetricCoverage:
    settings = require_record(register, "stencil").config.get("coverage")
    band = settings.get("band") if isinstance(settings, dict) else None
    return MetricCoverage(path, working=working, band=str(band or CANOPY), threshold_percent=None, resolution_m=None,
                          assume_crs=assume_crs, notices=notices)  # fmt: skip


def _coverage_painters(
    path: Path, register: Path, frames: Sequence[Bounds], city: _City, assume_crs: str | None
) -> list[Painter | None]:
    painters: list[Painter | None] = []
    with _opened(path, register, city.working, assume_crs, Notices()) as reader:
        for frame in frames:
            percent, (x0, y_top) = reader.read(*frame)
            cell_m = reader.resolution_m
            bounds = (x0, y_top - cell_m * percent.shape[0], x0 + cell_m * percent.shape[1], y_top)
            painters.append(partial(_paint_coverage, percent=percent, bounds=bounds, lots=city.lots))
    return painters


def _paint_coverage(pane: Pane, *, percent: NDArray[np.uint8], bounds: Bounds, lots: Shapes) -> None:
    paint_percent(pane, percent, bounds)
    paint_outlines(pane, lots, z=8.0)


def _paint_ground(pane: Pane, city: _City) -> None:
    fill_polygons(pane, city.lots, mixed(GROUND, "#ffffff", 0.6), z=1.0)
    draw_roads(pane, city.roads, fill=ROAD_FILL, casing=ROAD_CASING, z=1.5)
    paint_outlines(pane, city.lots, z=2.0)


def _paint_buildings(pane: Pane, city: _City) -> None:
    near = shapely.intersects(city.buildings, shapely.box(*pane.bounds))
    cast_shadows(pane, city.buildings[near], city.height_m[near], alpha=0.22, z=3.0)
    fill_polygons(pane, city.buildings[near], BUILDING_FILL, edge=BUILDING_EDGE, edge_px=1.2, z=3.2)


def _paint_regions(pane: Pane, city: _City) -> None:
    _paint_ground(pane, city)
    _paint_buildings(pane, city)
    assert city.regions is not None, "there is a column of regions where there are regions"
    fill_polygons(pane, city.regions, REGION_FILL, edge=mixed(REGION_FILL, "#10301a", 0.5), edge_px=1.0, z=4.0)
    fill_polygons(pane, city.stems, STEMS_FILL, alpha=0.55, z=4.5)


def _paint_plants(pane: Pane, city: _City) -> None:
    _paint_ground(pane, city)
    _paint_buildings(pane, city)
    draw_crowns(pane, city.crowns)


def _image_painters(
    paths: Sequence[Path], frames: Sequence[Bounds], working: CRS, assume_crs: str | None
) -> list[Painter | None]:
    painters: list[Painter | None] = []
    with open_mosaic(paths, assume_crs=assume_crs, notices=Notices()) as mosaic:
        for frame in frames:
            colours, known = image_square(mosaic, frame, PANE_PX, working)
            painters.append(partial(paint_picture, colours=colours, known=known) if known.any() else None)
    return painters


def _has_grown(register: Path, notices: Notices) -> bool:
    """Tell whether the plants placed last have grown, and their skeletons are there."""
    records = read_records(register)
    if "grow" not in records:
        return False
    placed = {"name": "place", "sha256": records["place"].stage_key}
    grown = placed in records["grow"].inputs and parts_are_there(register)
    if not grown:
        notices.add("W_TREES_STALE", "grown plants that are not those placed last, left out; run `grow` again")
    return grown


def _view_painters(
    register: Path, frames: Sequence[Bounds], city: _City, config: Config, workers: int, progress: Progress
) -> list[Painter | None]:
    painters: list[Painter | None] = []
    for frame in frames:
        west, south, east, north = frame
        wide = (west - AROUND_M, south - AROUND_M, east + AROUND_M, north + AROUND_M)
        box = reproject(np.array([shapely.box(*wide)], dtype=object), city.working, city.crs)[0]
        grown = read_city(register, config=config, bbox=box.bounds)
        low_x, low_y = west - grown.origin.easting_m, south - grown.origin.northing_m
        bounds = (low_x, low_y, low_x + east - west, low_y + north - south)
        if not len(grown.plants):
            painters.append(None)
            continue
        picture = draw_view(grown, [look_of(species) for species in grown.species], kind="top",
                            size_px=(2 * PANE_PX, 2 * PANE_PX), bounds_m=bounds, season=config.export.season,
                            scale_bar=False, workers=workers, progress=progress)  # fmt: skip
        painters.append(partial(paint_picture, colours=picture, known=np.ones(picture.shape[:2], dtype=bool)))
    return painters
