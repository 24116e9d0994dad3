"""Make a register from a city: files in, files out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import is_metric, reproject, utm_crs, working_crs
from urbanforest_cli.core.errors import InputError, OutputExistsError, PartlyDoneError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.schema import LAYERS
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record, stage_key
from urbanforest_cli.files.vector_formats import SHAPEFILE, vector_format
from urbanforest_cli.files.vectors import list_vector_layers, read_vector
from urbanforest_cli.register.cleaning import (
    Checked,
    drop_strays,
    finite,
    first_look,
    overlaps,
    repair,
    shift_west,
    twins,
    unwrap_longitudes,
)
from urbanforest_cli.register.envelope_kernel import KERNELS
from urbanforest_cli.register.envelopes import Ground, Surroundings, Taken, plantable_areas
from urbanforest_cli.register.layers import (
    LOT_COLUMNS,
    SKETCH_COLUMNS,
    as_text,
    plain_columns,
    polygons_in_metres,
    roads_of,
    surroundings_of,
)
from urbanforest_cli.register.resolve import match_zones, resolve_parameters, with_resolved
from urbanforest_cli.register.sketches import density_for_cover, lot_under, numbers_of, stack_sketches
from urbanforest_cli.register.streets import Roads, Strips, join_roads, verge_strips

STAGE = "stencil"
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
SIDECARS = (".shx", ".dbf", ".prj", ".cpg")
OWN_COLUMNS = (*LAYERS[LOTS].columns, "fid", "geom")
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
    ``active_areas``, ``parameters``, ``skipped`` and ``provenance``, in the CRS of the lots. Every row of ``lots``
    is either in ``active_areas`` or, with a reason, in ``skipped``.

    Raises
    ------
    InputError
        The city cannot be used: no lots, ids that are missing or repeated, parameters outside their limits.
    CrsError
        Coordinates cannot be brought to metres.
    LimitError
        A lot has over two million vertices or is over 100 km long.
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
    lots = _clean(frame, config, notices, city)
    progress("reading the city", 1, 1)

    roads = Roads(np.empty(0, object), np.empty(0), np.empty(0, object))
    if "roads" in layers:
        roads = roads_of(layers["roads"], lots.project, config.rules, notices)
    around = surroundings_of(layers, roads, lots.project, config.rules, notices)
    own = frame[[name for name in ("strategy", *PARAMETERS) if name in frame]]
    announce_compile(KERNELS, progress)
    parameters = resolve_parameters(
        own, lots.ids, lots.zones, config, seed=seed, notices=notices, known_strategies=known_strategies, where=city
    )
    units = [_Units(lots.ids, lots.zones, "register", lots.checked.shapes, parameters)]
    streets = _street_units(roads, lots, config, seed, notices, known_strategies)
    sketches = _sketch_units(layers, units[0], lots, config, seed, notices, known_strategies, city)
    units += [streets.units, sketches]
    whole = _joined(units)
    _refuse_doubles(whole.ids, city, "ids of lots, street strips and sketches are not unique")
    taken = _taken(whole, lots, streets.strips, sketches, config, notices)
    ground = _ground(whole, lots.checked, around, taken, config, workers, progress)
    skipped = _skipped(whole, lots.checked, ground, taken)

    progress("writing the register", 0, 1)
    summary = StageSummary(STAGE, register, _counts(whole, ground, skipped, layers, frame), notices)
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
    tables = _tables(frame, whole, ground, skipped, lots)
    write_layers(register, {**tables, "provenance": pd.DataFrame([record.as_row()])}, fresh=True)
    progress("writing the register", 1, 1)
    summary.seconds = time.perf_counter() - started
    refuse_too_many_bad(summary, max_bad_fraction, city)
    return summary


def refuse_too_many_bad(summary: StageSummary, max_bad_fraction: float, city: Path) -> None:
    """Raise `PartlyDoneError` if more of the lots than allowed have no usable geometry."""
    bad, rows = int(summary.counts["lots_bad"]), int(summary.counts["lots"])
    if bad > max_bad_fraction * rows:
        raise PartlyDoneError(
            "done, but too many lots have unusable geometry",
            where=city,
            found=f"{bad} of {rows} lots",
            expected=f"at most {max_bad_fraction:.0%}",
            next_step="see the layer 'skipped' of the register; raise --max-bad to accept them",
        )


def _read(
    city: Path, assume_crs: str | None, lots_layer: str | None, notices: Notices
) -> tuple[gpd.GeoDataFrame, dict[str, gpd.GeoDataFrame]]:
    """Read a city's layers; those that it has beside its lots only if they bear their names."""
    names = [name for name, kind in list_vector_layers(city) if kind is not None]
    if lots_layer is None and LOTS in names:
        lots_layer = LOTS
    if lots_layer is None and not set(names) - set(KINDS):
        raise InputError("no layer 'lots'", where=city, found=", ".join(names) or "no layers")
    frame = read_vector(city, layer=lots_layer, assume_crs=assume_crs, notices=notices)
    frame = gpd.GeoDataFrame(plain_columns(frame, LOT_COLUMNS, f"{city} layer 'lots'"), crs=frame.crs)
    layers = {}
    for name, kinds in KINDS.items():
        if name in names and name != lots_layer and len(names) > 1:
            found = read_vector(
                city, layer=name, kinds=kinds, assume_crs=assume_crs or frame.crs, notices=notices,
                where_hint=f"{city} layer {name!r}",
            )  # fmt: skip
            if len(found):
                layers[name] = found
    return frame, layers


@dataclass
class _Lots:
    """A city's lots in metres, and how everything else is brought there."""

    ids: NDArray[np.object_]
    zones: NDArray[np.object_]
    checked: Checked
    crs: CRS
    working: CRS
    unwrapped: bool

    def project(self, frame: gpd.GeoDataFrame) -> Shapes:
        """Return a frame's shapes in the working CRS, None where one has no place there."""
        shapes = np.array(frame.geometry.to_numpy(), dtype=object)
        shapes[~finite(shapes)] = None
        if self.unwrapped and frame.crs.is_geographic:
            shapes = shift_west(shapes)
        shapes = np.array(reproject(shapes, frame.crs, self.working), dtype=object)
        shapes[~finite(shapes)] = None
        return shapes

    def back(self, shapes: Shapes) -> Shapes:
        """Return shapes in the CRS of the file."""
        found = reproject(shapes, self.working, self.crs)
        return shift_west(found) if self.unwrapped else found


def _clean(frame: gpd.GeoDataFrame, config: Config, notices: Notices, city: Path) -> _Lots:
    ids = _lot_ids(frame, notices, city)
    zones = frame["zone"] if "zone" in frame else [None] * len(frame)
    matched = match_zones(zones, ids, config, notices)
    if not len(frame):
        notices.add("W_EMPTY", "layers of lots without a row", 1, [city.name])
    checked = first_look(frame.geometry.to_numpy(), ids, notices, note_missing=False)
    missing = notices.count("W_NO_GEOMETRY") + notices.count("W_OUTSIDE") + notices.count("W_DAMAGED")
    if not missing:  # all that the reader could not build have one cause
        rows = checked.reasons == "no_geometry"
        checked.drop(rows, "broken_ring", "a ring is open or has fewer than four points")
    if len(frame) and (checked.reasons == "not_polygon").all():
        raise InputError("no polygons", where=city, found="points or lines", expected="a layer of polygons as lots")
    crs, unwrapped = CRS.from_user_input(frame.crs), False
    drop_strays(checked, crs, ids, notices)
    if crs.is_geographic:
        checked.shapes, unwrapped = unwrap_longitudes(checked.shapes, ids, notices)
    if checked.usable.any():
        working = working_crs(crs, tuple(shapely.total_bounds(checked.shapes)), where=city)
    else:
        working = crs if is_metric(crs) else utm_crs(0.0, 0.0)
    lots = _Lots(ids, matched, checked, crs, working, False)
    checked.shapes = lots.project(gpd.GeoDataFrame(geometry=checked.shapes, crs=crs))
    lots.unwrapped = unwrapped
    repair(checked, ids, notices)
    return lots


def _lot_ids(frame: gpd.GeoDataFrame, notices: Notices, city: Path) -> NDArray[np.object_]:
    if "lot_id" not in frame:
        notices.add("W_NO_LOT_ID", "layers of lots without a column lot_id, numbered by their rows", 1, [city.name])
        return as_text(pd.Series(frame.index))
    ids = as_text(frame["lot_id"])
    blank = np.array([lot_id is None or not lot_id.strip() for lot_id in ids], dtype=bool)
    if blank.any():
        raise InputError(
            "lots without an id",
            where=f"{city} column lot_id",
            found=f"{blank.sum()} empty cells, first in row {frame.index[blank][0]}",
            expected="an id in every row, or no column lot_id at all",
        )
    _refuse_doubles(ids, city, "lot_id is not unique")
    return ids


def _refuse_doubles(ids: NDArray[np.object_], city: Path, what: str) -> None:
    doubles = pd.Series(ids)[pd.Series(ids).duplicated()].unique()
    if len(doubles):
        shown = ", ".join(repr(str(item)) for item in doubles[:5])
        raise InputError(
            what,
            where=f"{city} column lot_id",
            found=f"{len(doubles)} ids more than once: {shown}" + (", ..." if len(doubles) > 5 else ""),
            expected="an id of its own for every lot",
        )


@dataclass
class _Units:
    """Placement units of one origin: lots, street strips or sketches."""

    ids: NDArray[np.object_]
    zones: NDArray[np.object_]
    origin: str | NDArray[np.object_]
    shapes: Shapes
    parameters: pd.DataFrame

    @property
    def origins(self) -> NDArray[np.object_]:
        """Return the origin of each."""
        return np.full(len(self.ids), self.origin, dtype=object) if isinstance(self.origin, str) else self.origin


@dataclass
class _Streets:
    units: _Units
    strips: Strips


def _joined(units: Sequence[_Units]) -> _Units:
    used = [part for part in units if len(part.ids)] or [units[0]]
    return _Units(
        np.concatenate([part.ids for part in used]),
        np.concatenate([part.zones for part in used]),
        np.concatenate([part.origins for part in used]),
        np.concatenate([part.shapes for part in used]),
        pd.concat([part.parameters for part in used], ignore_index=True) if len(used) > 1 else used[0].parameters,
    )


def _street_units(
    roads: Roads, lots: _Lots, config: Config, seed: int, notices: Notices, known: Sequence[str]
) -> _Streets:
    """Derive street strips where roads are and no lot is a street."""
    rules = config.zone_rules("street")
    strips = Strips(np.empty(0, object), np.empty(0, object), np.empty(0, object))
    if rules.derive_street_lots and len(roads.shapes) and not (lots.zones == "street").any():
        strips = verge_strips(join_roads(roads), rules, lots.checked.shapes)
    there = ~shapely.is_missing(strips.shapes)
    ids = np.array([f"road:{road}" for road in strips.ids[there]], dtype=object)
    zones = np.full(len(ids), "street", dtype=object)
    parameters = resolve_parameters(
        pd.DataFrame(index=range(len(ids))), ids, zones, config, seed=seed, notices=notices, known_strategies=known
    )
    return _Streets(_Units(ids, zones, "road", strips.shapes[there], parameters), strips)


def _sketch_units(
    layers: dict[str, gpd.GeoDataFrame],
    lot_units: _Units,
    lots: _Lots,
    config: Config,
    seed: int,
    notices: Notices,
    known: Sequence[str],
    city: Path,
) -> _Units:
    """Make a placement unit of every sketch: its own values, else those of the lot under it, else its zone's."""
    frame = layers.get("sketches", gpd.GeoDataFrame(geometry=[], crs=lots.crs))
    where = f"{city} layer 'sketches'"
    frame = gpd.GeoDataFrame(plain_columns(frame, SKETCH_COLUMNS, where), crs=frame.crs)
    shapes = polygons_in_metres(frame, "sketches", lots.project, notices)
    numbers = as_text(frame["sketch_id"] if "sketch_id" in frame else pd.Series(frame.index, dtype=object))
    shapes = stack_sketches(shapes, numbers)
    there = ~shapely.is_missing(shapes)
    frame, shapes = frame[there].reset_index(drop=True), shapes[there]
    ids = np.array([f"sketch:{number}" for number in numbers[there]], dtype=object)
    under = lot_under(shapes, lots.checked.shapes)
    base = lot_units.parameters.reindex(under).reset_index(drop=True)
    stated = frame["zone"] if "zone" in frame else pd.Series([None] * len(frame), dtype=object)
    below = [lots.zones[row] if row >= 0 else "other" for row in under]
    zones = match_zones(stated.where(stated.notna(), below), ids, config, notices)
    own = frame[[name for name in ("strategy", *PARAMETERS) if name in frame]].copy()
    if "coverage" in frame:
        own = _with_coverage(own, numbers_of(frame["coverage"], ids, where))
    parameters = resolve_parameters(
        own, ids, zones, config, seed=seed, notices=notices, known_strategies=known, base=base, source="sketch",
        where=where,
    )  # fmt: skip
    parameters["source"] = "sketch"
    return _Units(ids, zones, "sketch", shapes, parameters)


def _with_coverage(own: pd.DataFrame, coverage: NDArray[np.float64]) -> pd.DataFrame:
    """Return own values with those that a coverage stands for, where the sketch does not state them itself."""
    given = ~np.isnan(coverage)
    strategy = own["strategy"].astype(object) if "strategy" in own else pd.Series([None] * len(own), dtype=object)
    density = own["density"] if "density" in own else pd.Series(np.full(len(own), np.nan))
    fill = given & density.isna().to_numpy()
    return own.assign(
        strategy=strategy.mask(given & strategy.isna().to_numpy(), "random"),
        density=density.mask(fill, density_for_cover(coverage)) if fill.any() else density,
    )


def _taken(whole: _Units, lots: _Lots, strips: Strips, sketches: _Units, config: Config, notices: Notices) -> Taken:
    """Find the ground that units leave to others: lots to smaller lots, to sketches and to road corridors."""
    count = len(lots.ids)
    shapes = lots.checked.shapes
    same = twins(shapes, lots.ids)
    doubles = same >= 0
    for row in np.flatnonzero(doubles):
        lots.checked.reasons[row] = "duplicate"
        lots.checked.details[row] = f"the same ground as lot {lots.ids[same[row]]}"
    message = "lots on the same ground as another, planted once"
    notices.add("W_DUPLICATE", message, int(doubles.sum()), lots.ids[doubles])
    singles = shapes.copy()
    singles[doubles] = None
    giving, keeping = overlaps(singles, lots.ids, least_m2=config.rules.min_area_m2)
    notices.add(
        "W_OVERLAP",
        "pairs of lots that overlap; the smaller keeps the ground",
        len(giving),
        [f"{lots.ids[a]} and {lots.ids[b]}" for a, b in zip(giving[:5], keeping[:5], strict=True)],
    )
    pairs = [(giving, shapes[keeping])]
    for givers, takers in (
        (np.arange(count), strips.corridors),
        (np.flatnonzero(whole.origins != "sketch"), sketches.shapes),
    ):
        giver, taker = shapely.STRtree(takers).query(whole.shapes[givers], predicate="intersects")
        order = np.lexsort((taker, giver))
        pairs.append((givers[giver[order]], takers[taker[order]]))
    return Taken(np.concatenate([pair[0] for pair in pairs]), np.concatenate([pair[1] for pair in pairs]))


def _ground(
    whole: _Units,
    checked: Checked,
    around: Surroundings,
    taken: Taken,
    config: Config,
    workers: int,
    progress: Progress,
) -> Ground:
    wanted = ~shapely.is_missing(whole.shapes)
    wanted[: len(checked.reasons)] &= checked.reasons == ""
    rows = np.flatnonzero(wanted)
    found = plantable_areas(
        whole.shapes[rows],
        whole.zones[rows],
        around,
        config.zone_rules,
        taken=taken.within(rows),
        workers=workers,
        report=lambda done, total: progress("cutting envelopes out of lots", done, total),
    )
    areas = np.full(len(whole.ids), None, dtype=object)
    dropped = np.zeros(len(whole.ids), dtype=np.int64)
    areas[rows], dropped[rows] = found.areas, found.dropped_parts
    return Ground(areas, dropped)


def _skipped(whole: _Units, checked: Checked, ground: Ground, taken: Taken) -> pd.DataFrame:
    reasons = np.full(len(whole.ids), "", dtype=object)
    details = np.full(len(whole.ids), "", dtype=object)
    reasons[: len(checked.reasons)] = checked.reasons
    details[: len(checked.details)] = checked.details
    bare = shapely.is_missing(ground.areas) & (reasons == "")
    gave = np.isin(np.arange(len(whole.ids)), taken.lots)
    for rows, reason, detail in (
        (bare & (ground.dropped_parts > 0), "too_small", "only pieces smaller or thinner than those planted are left"),
        (bare & (ground.dropped_parts == 0) & gave, "no_room", "envelopes, sketches, streets or other lots cover it"),
        (bare & (ground.dropped_parts == 0) & ~gave, "no_room", "envelopes of what is built cover the whole lot"),
    ):
        reasons[rows], details[rows] = reason, detail
    rows = reasons != ""
    return pd.DataFrame(
        {"lot_id": whole.ids[rows], "stage": STAGE, "reason": reasons[rows], "detail": details[rows]}, dtype=object
    )


def _counts(
    whole: _Units,
    ground: Ground,
    skipped: pd.DataFrame,
    layers: dict[str, gpd.GeoDataFrame],
    frame: gpd.GeoDataFrame,
) -> dict[str, int | float | str]:
    origins = whole.origins
    counts: dict[str, int | float | str] = {
        "lots": len(frame),
        "lots_bad": int(skipped["reason"].isin(BAD_REASONS).sum()),
        "lots_skipped": len(skipped),
        "active_areas": int((~shapely.is_missing(ground.areas)).sum()),
        "street_lots": int((origins == "road").sum()),
        "sketches": int((origins == "sketch").sum()),
        "pieces_dropped": int(ground.dropped_parts.sum()),
        "area_m2": round(float(np.nansum(shapely.area(whole.shapes[origins == "register"]))), 1),
        "plantable_area_m2": round(float(np.nansum(shapely.area(ground.areas))), 1),
    }
    return counts | {name: len(layers[name]) for name in KINDS if name in layers and name != "sketches"}


def _tables(
    frame: gpd.GeoDataFrame, whole: _Units, ground: Ground, skipped: pd.DataFrame, lots: _Lots
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
            **_user_columns(frame, whole, lots),
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
    return {"lots": register_lots, "active_areas": active, "parameters": parameters, "skipped": skipped}


def _user_columns(frame: gpd.GeoDataFrame, whole: _Units, lots: _Lots) -> dict[str, Any]:
    """Return the city's own columns, one row a unit; those whose names the register needs are ``source_``."""
    columns: dict[str, Any] = {}
    others = frame.drop(columns=[frame.geometry.name, "lot_id"], errors="ignore")
    taken = {name.casefold() for name in OWN_COLUMNS} | {str(name).casefold() for name in others.columns}
    for name in others.columns:
        column = others[name].reset_index(drop=True)
        if name == "zone" and (column.astype(object) == pd.Series(lots.zones)).all():
            continue
        if pd.api.types.is_bool_dtype(column.dtype):
            column = column.astype("boolean")
        elif pd.api.types.is_integer_dtype(column.dtype) and isinstance(column.dtype, np.dtype):
            column = column.astype("UInt64" if column.dtype == np.uint64 else "Int64")
        label = str(name)
        if label.casefold() in {own.casefold() for own in OWN_COLUMNS}:
            label = f"source_{label}"
            while label.casefold() in taken:
                label = f"source_{label}"
            taken.add(label.casefold())
        columns[label] = column.reindex(range(len(whole.ids)))
    return columns
