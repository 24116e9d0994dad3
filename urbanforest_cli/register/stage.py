"""Make a register from a city: files in, files out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, OutputExistsError, PartlyDoneError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.zones import ZONES
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record, stage_key
from urbanforest_cli.files.vector_formats import SHAPEFILE, vector_format
from urbanforest_cli.files.vectors import list_vector_layers, read_vector
from urbanforest_cli.register.envelope_kernel import KERNELS
from urbanforest_cli.register.layers import (
    LOT_COLUMNS,
    Buildings,
    buildings_of,
    plain_columns,
    road_surfaces,
    roads_of,
    surroundings_of,
)
from urbanforest_cli.register.lots import Lots, clean_lots, refuse_doubles, user_columns
from urbanforest_cli.register.plantable import Ground
from urbanforest_cli.register.resolve import resolve_parameters, with_resolved
from urbanforest_cli.register.streets import Roads
from urbanforest_cli.register.units import (
    STAGE,
    Units,
    ground_of,
    ground_taken,
    joined,
    sketch_units,
    skipped_units,
    street_units,
)

LOTS = "lots"
KINDS = {
    "buildings": ("polygon",),
    "roads": ("line", "polygon"),
    "driveways": ("polygon", "line"),
    "entrances": ("point", "line"),
    "obstacles": ("point", "line", "polygon"),
    "sketches": ("polygon",),
}
BAD_REASONS = ("no_geometry", "not_finite", "broken_ring", "not_polygon", "misplaced", "no_area")
SHARE_SPEAKS_FROM = 20
DEFAULT_MAX_BAD_FRACTION = 0.1
SIDECARS = (".shx", ".dbf", ".prj", ".cpg")
Shapes = NDArray[Any]


def stencil_key(
    city: Path, *, config: Config, seed: int, assume_crs: str | None = None, lots_layer: str | None = None
) -> str:
    """Return the hash of all that decides this stage's result.

    Raises
    ------
    InputError
        The city is not a file that is read.
    """
    inputs = [f"{item['name']} {item['sha256']}" for item in _inputs(city)]
    return stage_key(
        STAGE,
        config=config,
        seed=seed,
        inputs=[*inputs, f"assume_crs={assume_crs}", f"layer={lots_layer}"],
        sections=("rules", "zones"),
    )


def _inputs(city: Path) -> list[dict[str, str]]:
    """Return names and hashes of the files that a city consists of."""
    form = vector_format(city)
    if city.is_dir():
        files = sorted(item for item in city.iterdir() if item.is_file())
    elif form is SHAPEFILE:
        files = [city, *(side for suffix in SIDECARS if (side := city.with_suffix(suffix)).is_file())]
    else:
        files = [city, *(side for side in [city.with_name(city.name + "-wal")] if side.is_file())]
    return [{"name": item.name, "sha256": sha256_of(item)} for item in files]


def stencil_city(
    city: Path,
    register: Path,
    *,
    config: Config,
    seed: int,
    workers: int = 1,
    assume_crs: str | None = None,
    lots_layer: str | None = None,
    max_bad_fraction: float = 1.0,
    known_strategies: Sequence[str] = STRATEGIES,
    progress: Progress = silent,
) -> StageSummary:
    """Make a register from a city: clean lots, the ground where plants may stand, and each lot's parameters.

    Reads layer ``lots`` (or the only polygon layer of a file without one) and, where they are, ``buildings``,
    ``roads``, ``driveways``, ``entrances``, ``obstacles`` and ``sketches``. Writes a fresh register with ``lots``,
    ``active_areas``, ``parameters``, ``buildings``, ``roads``, ``skipped`` and ``provenance``, in the CRS of the
    lots. Every row of ``lots`` is either in ``active_areas`` or, with a reason, in ``skipped``; buildings outside all
    lots are kept.

    Raises
    ------
    InputError
        The city cannot be used: no lots, ids that are missing or repeated, parameters outside their limits.
    CrsError
        Coordinates cannot be brought to metres.
    LimitError
        A lot has over two million vertices, or all are over 500 km long.
    PartlyDoneError
        The register was written, but more than `max_bad_fraction` of the lots have no usable geometry.
    """
    started = time.perf_counter()
    if register.exists() and city.exists() and register.samefile(city):
        raise OutputExistsError("the output is the input itself", where=register, next_step="name another with -o")
    notices = Notices()
    key = stencil_key(city, config=config, seed=seed, assume_crs=assume_crs, lots_layer=lots_layer)
    progress("reading the city", 0, 1)
    frame, layers = _read(city, assume_crs, lots_layer, notices)
    lots = clean_lots(frame, config, notices, city, typed=vector_format(city).typed)
    attributes = pd.DataFrame(frame.drop(columns=frame.geometry.name))
    del frame
    progress("reading the city", 1, 1)

    roads = Roads(np.empty(0, object), np.empty(0), np.empty(0, object))
    if "roads" in layers:
        roads = roads_of(layers["roads"], lots.project, config.rules, notices)
    buildings = buildings_of(layers.get("buildings"), lots.project, notices)
    around = surroundings_of(layers, buildings.shapes, roads, lots.project, config.rules, notices)
    around_counts = {name: len(layers[name]) for name in KINDS if name in layers and name != "sketches"}
    layers = {name: found for name, found in layers.items() if name == "sketches"}
    _note_what_is_missing(around_counts, lots.zones, config, notices, city)
    own = attributes[[name for name in ("strategy", *PARAMETERS) if name in attributes]]
    announce_compile(KERNELS, progress)
    parameters = resolve_parameters(
        own, lots.ids, lots.zones, config, seed=seed, notices=notices, known_strategies=known_strategies, where=city
    )
    units = [Units(lots.ids, lots.zones, "register", lots.checked.shapes, parameters)]
    streets = street_units(roads, lots, config, seed, notices, known_strategies)
    sketches = sketch_units(layers, units[0], lots, config, seed, notices, known_strategies, city)
    units += [streets.units, sketches]
    whole = joined(units)
    refuse_doubles(whole.ids, city, "ids of lots, street strips and sketches are not unique")
    taken = ground_taken(whole, lots, streets.strips, sketches, config, notices)
    ground = ground_of(whole, lots.checked, around, taken, config, workers, progress)
    skipped = skipped_units(whole, lots.checked, ground, taken)

    progress("writing the register", 0, 1)
    summary = StageSummary(STAGE, register, _counts(whole, ground, skipped, len(attributes)) | around_counts, notices)
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=key,
        working_crs=lots.working,
        config=config.model_dump(mode="json", exclude_none=True),
        inputs=_inputs(city),
        counts=dict(summary.counts),
        notices=notices,
    )
    tables = _tables(attributes, whole, ground, skipped, buildings, roads, lots)
    write_layers(register, {**tables, "provenance": pd.DataFrame([record.as_row()])}, fresh=True)
    progress("writing the register", 1, 1)
    summary.seconds = time.perf_counter() - started
    refuse_too_many_bad(summary, max_bad_fraction, city)
    return summary


def refuse_too_many_bad(summary: StageSummary, max_bad_fraction: float | None, city: Path) -> None:
    """Raise `PartlyDoneError` if more of the lots than allowed have no usable geometry.

    Where no share is given it is 10 %, from 20 lots on: of a handful, a share says nothing.
    """
    bad, rows = int(summary.counts["lots_bad"]), int(summary.counts["lots"])
    if max_bad_fraction is None:
        max_bad_fraction = DEFAULT_MAX_BAD_FRACTION if rows >= SHARE_SPEAKS_FROM else 1.0
    if bad > max_bad_fraction * rows:
        raise PartlyDoneError(
            "done, but too many lots have unusable geometry",
            where=city,
            found=f"{bad} of {rows} lots",
            expected=f"at most {max_bad_fraction:.0%}",
            next_step="see the layer 'skipped' of the register; raise --max-bad to accept them",
        )


def _note_what_is_missing(
    counts: dict[str, int], zones: NDArray[np.object_], config: Config, notices: Notices, city: Path
) -> None:
    """Tell of what a planner would miss on the map: no buildings, or a zone of the config that no lot is in."""
    if not counts.get("buildings") and len(zones):
        notices.add(
            "W_NO_BUILDINGS", "cities without buildings, their lots planted as if nothing stood there", 1, [city]
        )
    there = set(zones) | set(ZONES) | {"default"}
    for zone in config.zones:
        if zone not in there:
            near = get_close_matches(zone, sorted(set(zones) | set(ZONES)), n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            notices.add("W_ZONE_UNUSED", "zones of the config that no lot is in", 1, [f"{zone}{hint}"])


def _read(
    city: Path, assume_crs: str | None, lots_layer: str | None, notices: Notices
) -> tuple[gpd.GeoDataFrame, dict[str, gpd.GeoDataFrame]]:
    """Read a city's layers; those that it has beside its lots only if they bear their names."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whoever reads the layer counts what is said of it
        kinds_of = {name: kind for name, kind in list_vector_layers(city) if kind is not None}
    names = list(kinds_of)
    plain = {name.casefold(): name for name in reversed(names)}
    if {"lots", "active_areas"} <= set(names):
        raise InputError(
            "this is a register, an output of this program",
            where=city,
            expected="a city: lots and what stands on them",
            next_step="name the city it was made from",
        )
    others = [name for name, kind in kinds_of.items() if name.casefold() not in KINDS and "polygon" in kind.lower()]
    if lots_layer is None and (LOTS in plain or len(others) == 1):
        lots_layer = plain[LOTS] if LOTS in plain else others[0]
    if lots_layer is None and names and not set(names) - set(KINDS):
        raise InputError(
            "no layer 'lots'", where=city, found=", ".join(names), next_step="name the layer of lots with --layer"
        )
    frame = read_vector(city, layer=lots_layer, assume_crs=assume_crs, notices=notices)
    frame = gpd.GeoDataFrame(plain_columns(frame, LOT_COLUMNS, f"{city} layer 'lots'"), crs=frame.crs)
    layers = {}
    for name, kinds in KINDS.items():
        if name in plain and plain[name] != lots_layer and len(names) > 1:
            found = read_vector(
                city, layer=plain[name], kinds=kinds, assume_crs=assume_crs or frame.crs, notices=notices,
                where_hint=f"{city} layer {name!r}",
            )  # fmt: skip
            if len(found):
                layers[name] = found
    return frame, layers


def _counts(
    whole: Units,
    ground: Ground,
    skipped: pd.DataFrame,
    row_count: int,
) -> dict[str, int | float | str]:
    origins = whole.origins
    return {
        "lots": row_count,
        "lots_bad": int(skipped["reason"].isin(BAD_REASONS).sum()),
        "lots_skipped": len(skipped),
        "active_areas": int((~shapely.is_missing(ground.areas)).sum()),
        "street_lots": int((origins == "road").sum()),
        "sketches": int((origins == "sketch").sum()),
        "pieces_dropped": int(ground.dropped_parts.sum()),
        "area_m2": round(float(np.nansum(shapely.area(whole.shapes[origins == "register"]))), 1),
        "plantable_area_m2": round(float(np.nansum(shapely.area(ground.areas))), 1),
    }


def _tables(
    attributes: pd.DataFrame,
    whole: Units,
    ground: Ground,
    skipped: pd.DataFrame,
    buildings: Buildings,
    roads: Roads,
    lots: Lots,
) -> dict[str, pd.DataFrame]:
    areas = ground.areas
    there = ~shapely.is_missing(areas)
    plantable = np.nan_to_num(shapely.area(areas))
    register_lots = gpd.GeoDataFrame(
        {
            "lot_id": whole.ids,
            "zone": whole.zones,
            "origin": whole.origins,
            "area_m2": np.nan_to_num(shapely.area(whole.shapes)),
            "plantable_area_m2": plantable,
            "covered_fraction": np.nan,
            **user_columns(attributes, len(whole.ids), lots),
        },
        geometry=lots.back(whole.shapes),
        crs=lots.crs,
    )
    kinds = np.where(whole.origins == "register", "lot", whole.origins)
    active = gpd.GeoDataFrame(
        {"lot_id": whole.ids[there], "kind": kinds[there], "area_m2": plantable[there]},
        geometry=lots.back(areas[there]),
        crs=lots.crs,
    )
    parameters = with_resolved(whole.parameters)[~shapely.is_missing(whole.shapes)]
    built = gpd.GeoDataFrame(
        {"building_id": buildings.ids, "height_m": buildings.height_m},
        geometry=lots.back(buildings.shapes),
        crs=lots.crs,
    )
    surfaces = gpd.GeoDataFrame(
        {"road_id": roads.ids.astype(str), "width_m": roads.widths_m},
        geometry=lots.back(road_surfaces(roads)),
        crs=lots.crs,
    )
    return {
        "lots": register_lots,
        "active_areas": active,
        "parameters": parameters,
        "buildings": built,
        "roads": surfaces,
        "skipped": skipped,
    }
