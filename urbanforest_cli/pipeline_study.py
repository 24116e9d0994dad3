"""Write a study: lots of a planted city drawn with its own plants, with the real ones, and with random ones."""

from __future__ import annotations

import io
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.colours import mixed, species_colour, to_rgb, zone_colour
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.randomness import keys_for, rng_for
from urbanforest_cli.evaluation.results import PlantsOfLots
from urbanforest_cli.evaluation.stage import (
    RegisterLots,
    placed_plants,
    real_plants,
    refuse_another_city,
    register_lots,
)
from urbanforest_cli.evaluation.study.stage import StudySummary, refuse_other_folder, write_study
from urbanforest_cli.evaluation.study.trials import (
    LOTS_SHOWN,
    RANDOM,
    REAL,
    STREAM,
    Picture,
    choose_lots,
    design,
    sizes_by_room,
)
from urbanforest_cli.export.crowns import Crowns, draw_crowns
from urbanforest_cli.export.drawing import cast_shadows, draw_roads, fill_polygons, make_pane
from urbanforest_cli.export.map_layers import shown_radius_m
from urbanforest_cli.export.map_page import BUILDING_EDGE, BUILDING_FILL, GROUND, ROAD_CASING, ROAD_FILL
from urbanforest_cli.files.geopackage import layer_names, read_layer
from urbanforest_cli.files.provenance import require_record
from urbanforest_cli.files.vectors import split_source
from urbanforest_cli.placement.uniform import uniform_points

PLACED = "placed"
PICTURE_PX = 640
DPI = 100
POOL_LEAST = 4
"""Lots with fewer placed plants lend the sizes of all of them."""
UNKNOWN_HEIGHT_M = 8.0


@dataclass(frozen=True)
class _Looks:
    """Sizes and colours of placed plants, in the order of their positions."""

    plants: PlantsOfLots
    radius_m: NDArray[np.float64]
    colour: NDArray[np.float64]
    tall: NDArray[np.bool_]


@dataclass(frozen=True)
class _Around:
    """What is drawn in every picture of a lot, whatever stands on it; metres."""

    lots: RegisterLots
    zones: NDArray[np.object_]
    buildings: NDArray[np.object_]
    height_m: NDArray[np.float64]
    roads: NDArray[np.object_]


def make_study(
    register: Path,
    folder: Path,
    *,
    observed: str,
    also: Mapping[str, Path] | None = None,
    lots_shown: int = LOTS_SHOWN,
    min_plants: int = 4,
    seed: int = 0,
    assume_crs: str | None = None,
    title: str | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> StudySummary:
    """Write a two-alternative study of a planted city (paper, section Perceptual User Study).

    Every lot shown is drawn once with its real plants, once with those placed, once with as many at random, and once
    with those of every register in `also`: the same ground, the same style, sizes and colours from the same pool.

    Parameters
    ----------
    register
        With plants.
    folder
        To write: questionnaire.html, pictures and key.json.
    observed
        ``FILE`` or ``FILE:LAYER`` of real plants.
    also
        Registers of the same city by the name of what they show, as rules alone.

    Raises
    ------
    InputError
        No lot holds enough plants of every set.
    OutputExistsError
        The folder holds something else.
    """
    started = time.perf_counter()
    refuse_other_folder(folder, overwrite)
    notices = Notices()
    working = require_record(register, "stencil").working_crs
    require_record(register, "place")
    progress("reading plants", 0, 1)
    around = _around(register, working)
    if taken := {PLACED, REAL, RANDOM} & set(also or {}):
        raise InputError("this name is taken", found=", ".join(sorted(taken)), expected="another, as rules")
    for path in (also or {}).values():
        refuse_another_city(path, register)
    also = {PLACED: register, **(also or {})}
    looks = {name: _looks(path, around.lots, working, notices) for name, path in also.items()}
    real = real_plants(observed, around.lots, working, assume_crs, notices)
    every = [real, *(item.plants for item in looks.values())]
    counts = np.stack([np.bincount(item.lot, minlength=len(around.lots.ids)) for item in every], axis=1)
    ids = [str(lot) for lot in around.lots.ids]
    rows = choose_lots(ids, counts, count=lots_shown, min_plants=min_plants, seed=seed)
    observed_path = Path(split_source(observed)[0])
    inputs = {name: sha256_of(path) for name, path in also.items()}
    inputs["observed"] = sha256_of(observed_path) if observed_path.is_file() else observed_path.name
    fingerprint = f"{sorted(inputs.items())} {observed_path.name}:{split_source(observed)[1]} {lots_shown} {min_plants}"
    plan = design([ids[row] for row in rows], [*also, RANDOM], seed=seed, fingerprint=fingerprint)
    row_of = {ids[row]: row for row in rows}
    pictures = {}
    for done, picture in enumerate(plan.pictures, start=1):
        row = row_of[picture.lot_id]
        pictures[picture.name] = _png(around, row, _crowns(picture, row, around, looks, real, seed))
        progress("drawing lots", done, len(plan.pictures))
    write_study(
        folder,
        plan,
        pictures,
        title=title or "Which planting looks more realistic?",
        made_of={"seed": seed, "inputs": inputs},
    )
    summary_counts: dict[str, int | float | str] = {
        "lots": len(rows), "pictures": len(plan.pictures), "pairs": len(plan.trials),
        "lots_eligible": int((counts >= min_plants).all(axis=1).sum()),
    }  # fmt: skip
    return StudySummary("study", folder, summary_counts, notices, time.perf_counter() - started)


def _around(register: Path, working: CRS) -> _Around:
    lots = register_lots(register, working)
    frame = read_layer(register, "lots").set_index("lot_id")
    buildings, roads = read_layer(register, "buildings"), read_layer(register, "roads")
    return _Around(
        lots,
        frame["zone"].reindex(lots.ids).to_numpy(dtype=object),
        _shapes(buildings, working),
        buildings["height_m"].fillna(UNKNOWN_HEIGHT_M).to_numpy(dtype=np.float64),
        _shapes(roads, working),
    )


def _shapes(frame: gpd.GeoDataFrame, working: CRS) -> NDArray[np.object_]:
    return reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), working)


def _looks(register: Path, lots: RegisterLots, working: CRS, notices: Notices) -> _Looks:
    require_record(register, "place")
    plants = placed_plants(register, lots, working, notices)
    frame = read_layer(register, "plants")
    trees = read_layer(register, "trees") if "trees" in layer_names(register) else None
    known = lots.index.get_indexer(pd.Index(frame["lot_id"])) >= 0
    radius_m = np.asarray(shown_radius_m(frame, trees), dtype=np.float64)[known]
    species = frame["species"].to_numpy(dtype=object)[known]
    colours = {name: to_rgb(species_colour(str(name))) for name in set(species)}
    colour = np.array([colours[name] for name in species]).reshape(-1, 3)
    return _Looks(plants, radius_m, colour, frame["habit"].to_numpy(dtype=object)[known] == "tree")


def _crowns(
    picture: Picture,
    row: int,
    around: _Around,
    looks: Mapping[str, _Looks],
    real: PlantsOfLots,
    seed: int,
) -> Crowns:
    """Return what a picture shows; real and random plants borrow the looks of placed ones."""
    if picture.category in looks:
        own = looks[picture.category]
        mine = own.plants.lot == row
        return Crowns(own.plants.xy[mine], own.radius_m[mine], own.colour[mine], own.tall[mine])
    xy = real.xy[real.lot == row]
    if picture.category == RANDOM:
        keys = keys_for(seed, STREAM, [f"random {picture.lot_id}"])
        _, xy = uniform_points(around.lots.polygons[row : row + 1], keys, np.array([len(xy)]))
    lender = looks[PLACED]
    pool = np.flatnonzero(lender.plants.lot == row)
    if len(pool) < POOL_LEAST:
        pool = np.arange(len(lender.radius_m))
    rng = rng_for(seed, STREAM, f"looks {picture.category} {picture.lot_id}")
    lent = pool[sizes_by_room(xy, lender.radius_m[pool], rng)]
    return Crowns(xy, lender.radius_m[lent], lender.colour[lent], lender.tall[lent])


def _png(around: _Around, row: int, crowns: Crowns) -> bytes:
    lot = around.lots.polygons[row : row + 1]
    west, south, east, north = shapely.total_bounds(lot)
    rim = 0.08 * max(east - west, north - south) + 2.0
    figure = Figure(figsize=(PICTURE_PX / DPI, PICTURE_PX / DPI), dpi=DPI, facecolor=GROUND)
    FigureCanvasAgg(figure)
    bounds = (west - rim, south - rim, east + rim, north + rim)
    pane = make_pane(figure, (0, 0, PICTURE_PX, PICTURE_PX), bounds, GROUND)
    near = shapely.intersects(around.lots.polygons, shapely.box(*pane.bounds))
    colour = mixed(zone_colour(str(around.zones[row])), "#ffffff", 0.2)
    fill_polygons(pane, around.lots.polygons[near], mixed(GROUND, "#ffffff", 0.45), edge="#dedad1", edge_px=1.0, z=1.0)
    draw_roads(pane, around.roads, fill=ROAD_FILL, casing=ROAD_CASING, z=1.5)
    fill_polygons(pane, lot, colour, edge=mixed(colour, "#4a463e", 0.6), edge_px=2.0, z=2.0)
    cast_shadows(pane, around.buildings, around.height_m, alpha=0.26, z=3.0)
    fill_polygons(pane, around.buildings, BUILDING_FILL, edge=BUILDING_EDGE, edge_px=1.2, z=3.2)
    draw_crowns(pane, crowns)
    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()
