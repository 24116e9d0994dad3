"""Export: from a planted register to the files people open."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli import __version__
from urbanforest_cli.core.boxes import in_box
from urbanforest_cli.core.colours import species_colour, zone_colour
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish, sha256_of, write_text
from urbanforest_cli.core.schema import LAYERS
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.drawing import Bounds
from urbanforest_cli.export.lot_pictures import draw_lots, typical_pictures
from urbanforest_cli.export.map_layers import (
    MapLayers,
    RegisterTables,
    SpeciesStyle,
    ZoneStyle,
    not_grown,
    shown_radius_m,
)
from urbanforest_cli.export.map_picture import draw_map
from urbanforest_cli.export.page import render_html
from urbanforest_cli.export.png import for_page, png_of
from urbanforest_cli.export.report import build_report
from urbanforest_cli.export.text import boxes_for_unknown_letters, place_name
from urbanforest_cli.files.geojson import write_points
from urbanforest_cli.files.geopackage import layer_names, read_layer
from urbanforest_cli.files.provenance import read_records, require_record, stage_key
from urbanforest_cli.files.species import load_catalogue

GEOJSON, MAP, PAGE, REPORT = "plants.geojson", "map.png", "report.html", "report.json"
OUTPUTS = (GEOJSON, MAP, PAGE, REPORT)
VIEW = "view.png"
WGS84 = CRS.from_epsg(4326)
LOTS_PX = 2000
STEPS = len(OUTPUTS)
GROWN_SIZES = ("height_m", "crown_radius_m", "crown_base_m", "dbh_m")


def export_key(place: str, *, config: Config, seed: int) -> str:
    """Return the hash of all that decides the exports: the plants' own key, and how they are shown."""
    return stage_key("export", config=config, seed=seed, inputs=[place], sections=("export", "species", "zones"))


def export_outputs(
    register: Path,
    out: Path,
    *,
    config: Config,
    summaries: Sequence[Mapping[str, Any]] = (),
    beside: Sequence[str] = (),
    kept: Sequence[str] = (),
    key: str = "",
    bbox: Bounds | None = None,
    progress: Progress = silent,
) -> StageSummary:
    """Write plants.geojson, map.png, report.html and report.json.

    Reads layers lots, active_areas, parameters, buildings, roads, plants, placements and skipped, and trees where these
    very plants have grown.
    The report comes last and names the others with their hashes. Where SOURCE_DATE_EPOCH is set, it tells of the
    stages what the register remembers, not how long they took, so that equal content is equal bytes.

    Parameters
    ----------
    register
        Where `place` has run.
    out
        Folder to write to.
    config
        Colours, width of the map.
    summaries
        What the stages before told; what the register remembers of them if empty.
    beside
        Names of files in `out` that the report tells of too; it shows view.png if that is among them.
    kept
        Names of outputs that are not to be written.
    key
        As `export_key` returns it, kept in the report.
    bbox
        West, south, east, north of the part the map shows, in the register's CRS.

    Raises
    ------
    SchemaError
        A layer is missing; the text names the command that writes it.
    OutputError
        A file could not be written whole.
    """
    started = time.perf_counter()
    progress("export", 0, STEPS)
    planted = _read(register, config)
    provenance = provenance_of(register, plants=len(planted.degrees), key=key)
    if GEOJSON not in kept:
        _write_geojson(
            out / GEOJSON, planted.degrees, planted.tables.plants, planted.tables.trees,
            {**provenance, "format": "geojson"},
        )  # fmt: skip
    progress("export", 1, STEPS)
    map_png = png_of(_map(planted, provenance, config, bbox), provenance)
    _write_bytes(out / MAP, map_png)
    progress("export", 2, STEPS)
    report = _report(register, planted, provenance, config, summaries)
    report["export_key"] = key
    report["outputs"] = [
        _output(register),
        *(_output(out / name) for name in (*beside, *(name for name in (GEOJSON, MAP) if name not in kept))),
    ]
    images = {"map": for_page(map_png)}
    if VIEW in beside:
        images["view"] = for_page((out / VIEW).read_bytes())
    pictures = typical_pictures(planted.layers, planted.tables, planted.areas)
    if pictures:
        lots_width_px = min(LOTS_PX, config.export.map_width_px)
        images["lots"] = for_page(png_of(draw_lots(pictures, width_px=lots_width_px)))
    write_text(out / PAGE, render_html(report, images))
    progress("export", 3, STEPS)
    report["outputs"].append(_output(out / PAGE))
    write_text(out / REPORT, json.dumps(report, indent=1, ensure_ascii=True, allow_nan=False) + "\n")
    progress("export", STEPS, STEPS)
    counts: dict[str, int | float | str] = {"plants": len(planted.layers.plant_xy), "files": len(OUTPUTS)}
    return StageSummary("export", out, counts, planted.notices, time.perf_counter() - started)


@dataclass(frozen=True)
class _Planted:
    """A planted city in memory: tables for the report, arrays in metres for the pictures."""

    name: str
    tables: RegisterTables
    layers: MapLayers
    areas: pd.Series[Any]
    degrees: NDArray[np.float64]
    crs: CRS
    working: CRS
    notices: Notices


def _read(register: Path, config: Config) -> _Planted:
    working = require_record(register, "place").working_crs
    lots = read_layer(register, "lots")
    areas = read_layer(register, "active_areas", columns=["lot_id"])
    crs = CRS.from_user_input(lots.crs)
    names = set(layer_names(register))
    notices = Notices()
    plants, trees = _plants(register, notices)
    tables = RegisterTables(
        lots=pd.DataFrame(lots.drop(columns="geometry")),
        parameters=read_layer(register, "parameters", geometry=False, columns=["lot_id", "strategy", "radius_mean_m"]),
        plants=pd.DataFrame(plants.drop(columns="geometry")),
        placements=read_layer(register, "placements", geometry=False),
        skipped=read_layer(register, "skipped", geometry=False) if "skipped" in names else _empty("skipped"),
        trees=trees,
    )
    file_xy = shapely.get_coordinates(plants.geometry.to_numpy())
    del plants
    zone_code, zone_names = pd.factorize(tables.lots["zone"], sort=True)
    colours = {name: table.colour for name, table in config.zones.items() if table.colour is not None}
    code, styles = _species_styles(tables.plants, config)
    buildings, heights = _buildings(register, crs, working, config)
    roads = reproject(read_layer(register, "roads").geometry.to_numpy(), crs, working)
    layers = MapLayers(
        lots=reproject(lots.geometry.to_numpy(), crs, working),
        lot_zone=np.asarray(zone_code, dtype=np.int64),
        zones=[ZoneStyle(str(name), zone_colour(str(name), colours)) for name in zone_names],
        plant_xy=reproject_xy(file_xy, crs, working),
        plant_radius_m=shown_radius_m(tables.plants, tables.trees),
        plant_species=code,
        species=styles,
        buildings=buildings,
        building_height_m=heights,
        roads=roads,
        regions=reproject(read_layer(register, "regions").geometry.to_numpy(), crs, working)
        if "regions" in names
        else np.empty(0, dtype=object),
    )
    return _Planted(
        name=city_name(register),
        tables=tables,
        layers=layers,
        areas=pd.Series(
            reproject(areas.geometry.to_numpy(), crs, working), index=areas["lot_id"].astype(object), dtype=object
        ),
        degrees=reproject_xy(file_xy, crs, WGS84),
        crs=crs,
        working=working,
        notices=notices,
    )


def _plants(register: Path, notices: Notices) -> tuple[gpd.GeoDataFrame, pd.DataFrame | None]:
    """Read all plants and, where they have grown, what became of them; of an earlier year those planted by then."""
    plants = read_layer(register, "plants")
    trees = _trees(register, plants["plant_id"], notices)
    if trees is None:
        return plants, None
    born = (trees["reason"] != "unborn").to_numpy()
    return gpd.GeoDataFrame(plants[born].reset_index(drop=True)), trees[born].reset_index(drop=True)


def _trees(register: Path, plant_ids: pd.Series[Any], notices: Notices) -> pd.DataFrame | None:
    """Read the layer of grown plants; None where it is not there or not that of the plants placed last."""
    if "trees" not in layer_names(register):
        return None
    records = read_records(register)
    grown = records.get("grow")
    placed = {"name": "place", "sha256": records["place"].stage_key}
    if grown is not None and placed in grown.inputs:
        trees = read_layer(register, "trees", geometry=False)
        if trees["plant_id"].tolist() == plant_ids.tolist():
            return pd.DataFrame(trees)
    notices.add("W_TREES_STALE", "layers of grown plants that are not those placed last, left out; run `grow` again")
    return None


def _empty(layer: str) -> pd.DataFrame:
    return pd.DataFrame({name: pd.Series(dtype=object) for name in LAYERS[layer].columns})


def _species_styles(plants: pd.DataFrame, config: Config) -> tuple[NDArray[np.int64], list[SpeciesStyle]]:
    catalogue = load_catalogue(config.species)
    code, names = pd.factorize(plants["species"], sort=True)
    styles = []
    for number, name in enumerate(map(str, names)):
        if name in catalogue:
            item = catalogue[name]
            styles.append(SpeciesStyle(name, item.scientific_name, item.colour, item.habit == "tree"))
        else:
            habit = plants["habit"].iloc[int(np.argmax(code == number))]
            styles.append(SpeciesStyle(name, name, species_colour(name), habit == "tree"))
    return np.asarray(code, dtype=np.int64), styles


def _buildings(
    register: Path, crs: CRS, working: CRS, config: Config
) -> tuple[NDArray[np.object_], NDArray[np.float64]]:
    frame = read_layer(register, "buildings")
    heights = frame["height_m"].to_numpy(dtype=np.float64, na_value=np.nan)
    known = np.where(heights > 0, heights, config.growth.building_height_m)
    return reproject(frame.geometry.to_numpy(), crs, working), known


def city_name(register: Path) -> str:
    """Return the name of the city that a register was made from."""
    stencil = read_records(register).get("stencil")
    return place_name(Path(stencil.inputs[0]["name"]).stem if stencil and stencil.inputs else register.stem)


def provenance_of(register: Path, *, plants: int, key: str) -> dict[str, Any]:
    """Return what an export carries: program, seed, hashes of the stages and inputs, year if one is shown."""
    records = read_records(register)
    place = records["place"]
    year = records["grow"].config.get("year") if "grow" in records else None
    crs = CRS.from_user_input(read_layer(register, "lots", columns=["lot_id"]).crs)
    return {
        "program": "urbanforest",
        "program_version": __version__,
        "seed": place.seed,
        "export_key": key,
        "stage_keys": {stage: record.stage_key for stage, record in records.items()},
        "working_crs": place.working_crs.name,
        "register_crs": crs.name,
        "inputs": records["stencil"].inputs if "stencil" in records else [],
        "plants": plants,
        **({"year": year} if year is not None else {}),
    }


def write_plants_geojson(register: Path, path: Path, *, key: str, bbox: Bounds | None = None) -> None:
    """Write all plants of a register, those that died too, as GeoJSON.

    Parameters
    ----------
    key
        Kept in the file's provenance.
    bbox
        West, south, east, north in the register's CRS; only plants in it.

    Raises
    ------
    SchemaError
        A layer is missing; the text names the command that writes it.
    """
    plants, trees = _plants(register, Notices())
    crs, xy = CRS.from_user_input(plants.crs), shapely.get_coordinates(plants.geometry.to_numpy())
    if bbox is not None:
        inside = in_box(xy, bbox)
        plants, xy = gpd.GeoDataFrame(plants[inside].reset_index(drop=True)), xy[inside]
        trees = trees[inside].reset_index(drop=True) if trees is not None else None
    provenance = {**provenance_of(register, plants=len(plants), key=key), "format": "geojson"}
    if bbox is not None:
        provenance["bbox"] = list(bbox)
    properties = pd.DataFrame(plants.drop(columns="geometry"))
    _write_geojson(path, reproject_xy(xy, crs, WGS84), properties, trees, provenance)


def _write_geojson(
    path: Path,
    degrees: NDArray[np.float64],
    properties: pd.DataFrame,
    trees: pd.DataFrame | None,
    provenance: Mapping[str, Any],
) -> None:
    if trees is not None:
        sizes = trees[list(GROWN_SIZES)].copy()
        sizes.loc[not_grown(trees)] = np.nan
        properties = pd.concat([properties, sizes, trees[["grown", "reason"]]], axis=1)
    write_points(path, degrees, properties, members={"provenance": dict(provenance)})


def _map(planted: _Planted, provenance: Mapping[str, Any], config: Config, bbox: Bounds | None) -> Figure:
    shown = None
    if bbox is not None:
        moved = reproject(np.array([shapely.box(*bbox)], dtype=object), planted.crs, planted.working)
        west, south, east, north = map(float, shapely.bounds(moved[0]))
        shown = (west, south, east, north)
    with boxes_for_unknown_letters():
        return draw_map(
            planted.layers, title=planted.name, notes=_notes(planted, provenance),
            width_px=config.export.map_width_px, bbox=shown,
        )  # fmt: skip


def _notes(planted: _Planted, provenance: Mapping[str, Any]) -> list[str]:
    code = planted.working.to_authority()
    crs = planted.working.name + (f" ({':'.join(code)})" if code else "")
    sources = ", ".join(f"{item['name']} ({item.get('sha256', '')[:12]})" for item in provenance["inputs"][:3])
    crowns = "crowns are drawn at their true radius"
    if planted.tables.trees is not None:
        year = provenance.get("year")
        crowns = "crowns are drawn as they grew" + (f", in year {year}" if year is not None else "")
    return [
        f"{crs}; north is grid north; {crowns}",
        f"urbanforest {__version__}, seed {provenance['seed']}" + (f", from {sources}" if sources else ""),
    ]


def _write_bytes(path: Path, content: bytes) -> None:
    with publish(path) as part:
        part.write_bytes(content)


def _report(
    register: Path,
    planted: _Planted,
    provenance: Mapping[str, Any],
    config: Config,
    summaries: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    stages: list[dict[str, Any]] = [dict(summary) for summary in summaries]
    if not stages or "SOURCE_DATE_EPOCH" in os.environ:
        stages = [
            {"stage": record.stage, "counts": record.counts, "warnings": record.notices.as_records()}
            for record in read_records(register).values()
        ]
    for stage in stages:
        stage.pop("output", None)
    grown = read_records(register).get("grow") if planted.tables.trees is not None else None
    return build_report(
        planted.tables,
        growth=None if grown is None else {"counts": grown.counts, "config": grown.config},
        title=planted.name,
        species=planted.layers.species,
        provenance=provenance,
        stages=stages,
        config=config.model_dump(mode="json", exclude_none=True),
        zone_colours={zone.name: zone.colour for zone in planted.layers.zones},
    )


def _output(path: Path) -> dict[str, Any]:
    return {"name": path.name, "sha256": sha256_of(path), "bytes": path.stat().st_size}
