"""Reads a planted city out of a register, as every export takes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.boxes import Bounds, in_box
from urbanforest_cli.core.colours import zone_colour
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.errors import InputError, StaleError
from urbanforest_cli.core.placed import standing
from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.export.scene.city import City, Plants
from urbanforest_cli.export.stage import city_name
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.provenance import Record, read_records, require_record
from urbanforest_cli.files.skeleton_parts import named_parts, parts_are_there, parts_folder
from urbanforest_cli.files.skeletons import read_parts
from urbanforest_cli.files.species import load_catalogue

ORDERED_BY = {"lots": "lot_id", "buildings": "building_id", "roads": "road_id"}


def read_city(register: Path, *, config: Config, bbox: Bounds | None = None) -> City:
    """Read the plants that stand, what shapes they have, and what stands around them.

    Parameters
    ----------
    register
        Where `grow` has run.
    config
        Species of the city, height of buildings that state none, colours of zones.
    bbox
        West, south, east, north in the register's CRS: only plants, buildings and ground that lie in it, or reach in.

    Raises
    ------
    SchemaError
        A layer is missing; the text names the command that writes it.
    StaleError
        The plants that have grown are not those placed last, or their skeletons are gone.
    InputError
        The box lies beside the city.
    """
    grown = require_record(register, "grow")
    _refuse_stale(register, grown)
    working = grown.working_crs
    trees = read_layer(register, "trees")
    plants = read_layer(register, "plants", geometry=False, columns=["plant_id", "pruning_factor"])
    if trees["plant_id"].tolist() != plants["plant_id"].tolist():
        raise _stale(register)
    register_crs = CRS.from_user_input(trees.crs)
    trees["pruning_factor"] = plants["pruning_factor"].to_numpy()
    trees = gpd.GeoDataFrame(trees[standing(trees)].reset_index(drop=True))
    catalogue = load_catalogue(config.species)
    lots, buildings, roads = (_shapes(register, name, working) for name in ("lots", "buildings", "roads"))
    xy = reproject_xy(shapely.get_coordinates(trees.geometry.to_numpy()), register_crs, working)
    if bbox is not None:
        box = reproject(np.array([shapely.box(*bbox)], dtype=object), register_crs, working)[0]
        inside = in_box(shapely.get_coordinates(trees.geometry.to_numpy()), bbox)
        lots, buildings, roads = (_reaching(frame, box) for frame in (lots, buildings, roads))
        if not inside.any() and not len(lots):
            known = shapely.total_bounds(read_layer(register, "lots").geometry.to_numpy())
            raise InputError(
                "nothing of the city lies in the box",
                where="--bbox",
                found=" ".join(f"{value:.10g}" for value in bbox),
                expected="west south east north within " + " ".join(f"{value:.10g}" for value in known),
                next_step=f"give the box in the CRS of the register, {register_crs.name}",
            )
        trees, xy = gpd.GeoDataFrame(trees[inside].reset_index(drop=True)), xy[inside]
    heights = buildings["height_m"].to_numpy(dtype=np.float64, na_value=np.nan)
    unknown = ~(heights > 0)
    colours = {name: zone.colour for name, zone in config.zones.items() if zone.colour is not None}
    parts = parts_folder(register)
    names = sorted(named_parts(register))

    def skeletons_of(ids: NDArray[np.int64]) -> Skeletons:
        return read_parts([parts / name for name in names], skeleton_ids=ids)

    return City(
        name=city_name(register),
        origin=_origin(working, xy, lots),
        register_crs=register_crs,
        plants=_plants(trees, xy, {item.id: row for row, item in enumerate(catalogue)}, register),
        species=catalogue.species,
        skeletons_of=skeletons_of,
        years_ago=int(str(grown.config.get("years_ago", 0))),
        buildings=buildings.geometry.to_numpy(),
        unknown_height_count=int(unknown.sum()),
        building_height_m=np.where(unknown, config.growth.building_height_m, heights),
        building_id=buildings["building_id"].to_numpy(dtype=object),
        lots=lots.geometry.to_numpy(),
        lot_colour=np.array([zone_colour(str(zone), colours) for zone in lots["zone"]], dtype=object),
        roads=roads.geometry.to_numpy(),
    )


def _refuse_stale(register: Path, grown: Record) -> None:
    placed = {"name": "place", "sha256": read_records(register)["place"].stage_key}
    if placed not in grown.inputs or not parts_are_there(register):
        raise _stale(register)


def _stale(register: Path) -> StaleError:
    return StaleError(
        "the skeletons are not there, or not those of these plants",
        where=register,
        next_step="run `urbanforest grow` again",
    )


def _shapes(register: Path, layer: str, working: CRS) -> gpd.GeoDataFrame:
    frame = read_layer(register, layer)
    if ORDERED_BY[layer] in frame:  # files are then the same for any order of the city's rows
        frame = frame.sort_values(ORDERED_BY[layer], kind="stable")
    moved = reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), working)
    sound = np.isfinite(shapely.bounds(moved)).all(axis=1)
    return gpd.GeoDataFrame(frame.drop(columns=frame.geometry.name)[sound], geometry=moved[sound], crs=working)


def _reaching(frame: gpd.GeoDataFrame, box: shapely.Geometry) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(frame[shapely.intersects(frame.geometry.to_numpy(), box)])


def _origin(working: CRS, xy: NDArray[np.float64], lots: gpd.GeoDataFrame) -> Origin:
    places = xy if len(xy) else shapely.get_coordinates(lots.geometry.to_numpy())
    bounds = np.concatenate([places.min(axis=0), places.max(axis=0)]) if len(places) else np.zeros(4)
    return Origin(working, float(np.rint((bounds[0] + bounds[2]) / 2)), float(np.rint((bounds[1] + bounds[3]) / 2)))


def _plants(trees: pd.DataFrame, xy: NDArray[np.float64], row: dict[str, int], register: Path) -> Plants:
    unknown = sorted(set(trees["species"]) - set(row))
    if unknown:
        raise InputError(
            "species of the register that the config does not know",
            where=register,
            found=", ".join(unknown),
            next_step="name the config that the register was made with (-c)",
        )

    def number(column: str) -> NDArray[np.float64]:
        return np.asarray(trees[column].to_numpy(dtype=np.float64))

    def text(column: str) -> NDArray[Any]:
        return np.asarray(trees[column].to_numpy(dtype=object))

    return Plants(
        plant_id=text("plant_id"),
        lot_id=text("lot_id"),
        species=np.array([row[name] for name in trees["species"]], dtype=np.int64),
        xy_m=xy,
        age_years=number("age_years"),
        height_m=number("height_m"),
        crown_radius_m=number("crown_radius_m"),
        crown_base_m=number("crown_base_m"),
        dbh_m=number("dbh_m"),
        pruning_factor=number("pruning_factor"),
        skeleton_id=trees["skeleton_id"].to_numpy(dtype=np.int64),
        yaw_rad=np.radians(number("yaw_deg")),
        mirror=trees["mirror"].to_numpy(dtype=np.int64) == 1,
        scale=number("scale"),
        is_library=text("grown") == "library",
    )
