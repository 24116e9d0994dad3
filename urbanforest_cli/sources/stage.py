"""Import: whatever people have, made into one city file."""

from __future__ import annotations

import fnmatch
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pydantic import ValidationError
from pyproj import CRS

from urbanforest_cli import __version__
from urbanforest_cli.core.config import Rules
from urbanforest_cli.core.crs import reproject, working_crs
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.zones import FALLBACK_ZONE
from urbanforest_cli.files.configs import configs_folder, read_toml
from urbanforest_cli.files.geopackage import timestamp, write_layers
from urbanforest_cli.files.vectors import list_vector_layers, read_vector, split_source
from urbanforest_cli.sources.derived_lots import derive_lots
from urbanforest_cli.sources.layers import Origin, city_rows, selected, single_trees
from urbanforest_cli.sources.profile import DEFAULT_KINDS, ROLES, LayerRule, Profile, folded
from urbanforest_cli.sources.shapes import first_of_equal
from urbanforest_cli.sources.zoning import covering, majority

GEOMETRY_TYPES = {
    "lots": "MultiPolygon", "buildings": "MultiPolygon", "sketches": "MultiPolygon", "observed_plants": "Point",
    "roads": "Unknown", "driveways": "Unknown", "entrances": "Unknown", "obstacles": "Unknown",
}  # fmt: skip
CITY_LAYERS = tuple(GEOMETRY_TYPES)


@dataclass(frozen=True)
class RoleSource:
    """A file given for one layer of the city, and the columns named for it.

    Parameters
    ----------
    source
        ``FILE`` or ``FILE:LAYER``.
    columns
        Column by use: ``id``, ``zone``, ``height``, ``width``.
    """

    source: str
    columns: Mapping[str, str] = field(default_factory=dict)


@dataclass
class ImportSummary(StageSummary):
    """What an import took, made and left."""

    zones: list[dict[str, object]] = field(default_factory=list)
    taken: list[dict[str, object]] = field(default_factory=list)
    left: list[dict[str, object]] = field(default_factory=list)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        return {**super().as_record(), "zones": self.zones, "taken": self.taken, "left": self.left}


@dataclass
class _Step:
    """One rule applied to one layer of one file."""

    role: str
    rule: LayerRule
    path: Path
    layer: str | None
    options: dict[str, str] = field(default_factory=dict)
    must_hold: bool = False

    @property
    def where(self) -> str:
        return f"{self.path}:{self.layer}" if self.layer else str(self.path)

    @property
    def label(self) -> str:
        return f"{self.path.name}:{self.layer}" if self.layer else self.path.name


def profile_names() -> list[str]:
    """Return the names of the shipped profiles."""
    return sorted(path.stem for path in (configs_folder() / "sources").glob("*.toml"))


def load_profile(name: str) -> Profile:
    """Read a profile: a shipped one by its name, or a mapping file.

    Raises
    ------
    ConfigError
        There is none, or it is wrong; the text lists every mistake.
    """
    shipped = configs_folder() / "sources" / f"{name}.toml"
    path = shipped if name in profile_names() else Path(name)
    if path is not shipped and not path.exists():
        raise ConfigError(
            "no such profile", where=name, expected=f"{', '.join(profile_names())}, or a mapping file",
            next_step="copy one of configs/sources and change it",
        )  # fmt: skip
    try:
        return Profile.model_validate(read_toml(path))
    except ValidationError as error:
        faults = [f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors()]
        raise ConfigError(
            "the profile has mistakes", where=path, found="; ".join(faults), next_step="compare it with configs/sources"
        ) from error


def import_city(
    sources: Sequence[str],
    output: Path,
    *,
    profile: str | None = None,
    roles: Mapping[str, RoleSource] | None = None,
    assume_crs: str | None = None,
    default_zone: str = FALLBACK_ZONE,
    overwrite: bool = False,
    progress: Progress = silent,
) -> ImportSummary:
    """Make a city file from sources.

    Parameters
    ----------
    sources
        ``FILE`` or ``FILE:LAYER``, read by the profile.
    output
        The city file, published whole or not at all.
    profile
        Name of a shipped mapping file, or the path of one.
    roles
        Files given for single layers of the city: lots, buildings, roads, ... They replace what the profile would
        take for that layer.
    default_zone
        Zone of lots that nothing gives one.

    Raises
    ------
    InputError, CrsError, ConfigError
        A source or the profile cannot be used.
    OutputExistsError
        The output is there, and `overwrite` is not set.
    """
    started = time.perf_counter()
    notices = Notices()
    summary = ImportSummary("import", output, notices=notices)
    rules = load_profile(profile) if profile else Profile()
    roles = roles or {}
    _check_output(output, sources, roles, overwrite)
    if sources and not profile:
        raise ConfigError(
            "sources need a profile that says what they hold", found=", ".join(sources),
            next_step=f"add --profile ({', '.join(profile_names())}), or name each layer: --lots FILE --buildings FILE",
        )  # fmt: skip
    if not sources and not roles:
        raise ConfigError("nothing to import", next_step="give a SOURCE with --profile, or --lots FILE")
    steps = _role_steps(roles) + _profile_steps(sources, rules, set(roles), summary)
    layers = _read(steps, assume_crs, summary, progress)
    _tell_left(summary)
    crs = _city_crs(layers, sources, roles)
    layers = {role: _in_crs(frame, crs) for role, frame in layers.items()}
    if "lots" in layers:
        layers["lots"] = _distinct(layers["lots"], notices)
    else:
        layers["lots"] = _lots_from_streets(layers, notices, progress)
    lots = _zones(layers, default_zone, summary)
    layers["lots"] = lots
    frames: dict[str, pd.DataFrame] = {
        role: layers[role].drop(columns=["zone", "zone_code"], errors="ignore") if role == "buildings" else layers[role]
        for role in CITY_LAYERS
        if role in layers and (len(layers[role]) or role == "lots")
    }
    frames["import_sources"] = _sources_table(summary, profile)
    write_layers(output, frames, fresh=True, geometry_types=GEOMETRY_TYPES)
    summary.counts = {role: len(frames[role]) for role in CITY_LAYERS if role in frames}
    if len(lots) == 0:
        notices.add("W_EMPTY", "city without a usable lot", 1)
    summary.seconds = time.perf_counter() - started
    return summary


def _check_output(output: Path, sources: Sequence[str], roles: Mapping[str, RoleSource], overwrite: bool) -> None:
    for text in [*sources, *(role.source for role in roles.values())]:
        source, _ = split_source(text)
        if source.resolve() == output.resolve() if not output.exists() else _same(source, output):
            raise InputError("the output is one of the sources", where=output, next_step="name another file with -o")
    if output.exists() and not overwrite:
        raise OutputExistsError("the output is there already", where=output, next_step="add --overwrite to replace it")


def _same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except (OSError, ValueError):  # the source is not there, or its name is none; reading it says so
        return False


def _role_steps(roles: Mapping[str, RoleSource]) -> list[_Step]:
    """Turn files named by option into steps."""
    options = {"id": "--lot-id", "zone": "--zone", "height": "--height", "width": "--road-width"}
    steps = []
    for role in ROLES:
        if role not in roles:
            continue
        given = roles[role]
        path, layer = split_source(given.source)
        fields: dict[str, Any] = {"layers": ["*"], **_USUAL_COLUMNS.get(role, {})}
        for use, column in given.columns.items():
            fields["zones" if use == "zone" else use] = (
                [{"column": column, "codes": _ZONE_NAMES}] if use == "zone" else column
            )
        named = {use: options[use] for use in given.columns}
        steps.append(_Step(role, LayerRule.model_validate(fields), path, layer, named, must_hold=True))
    return steps


# What columns mostly bear when nobody says: the names of the city file itself, and the commonest others.
_USUAL_COLUMNS: dict[str, dict[str, Any]] = {
    "lots": {"id": "lot_id", "zones": [{"column": "zone", "codes": {}}]},
    "buildings": {"id": "building_id", "height": ["height_m", "height"], "levels": ["levels", "building:levels"]},
    "roads": {"width": ["width_m", "width"], "kind": ["kind", "highway"]},
    "entrances": {"kind": "kind"},
    "obstacles": {"kind": "kind", "clearance": "clearance_m"},
    "observed_plants": {"species": "species", "height": ["height_m", "height"]},
}
_ZONE_NAMES = {zone: zone for zone in ("residential", "commercial", "industrial", "street", "other")}
_USUAL_COLUMNS["lots"]["zones"][0]["codes"] = _ZONE_NAMES


def _profile_steps(sources: Sequence[str], profile: Profile, given: set[str], summary: ImportSummary) -> list[_Step]:
    """Match the layers of the sources with the profile's rules; layers no rule takes are told."""
    steps = []
    for text in sources:
        path, only = split_source(text)
        layers = [name for name, kind in list_vector_layers(path) if kind is not None and only in (None, name)]
        if only is not None and not layers:
            raise InputError(f"no layer {only!r}", where=path, found=", ".join(n for n, _ in list_vector_layers(path)))
        for layer in layers:
            found = [
                _Step(role, rule, path, layer)
                for role in ROLES
                if role not in given
                for rule in profile.rules(role)
                if _named_by(rule, layer, path)
            ]
            steps += found
            if not found:
                summary.left.append(
                    {"source": f"{path.name}:{layer}", "why": "no rule of the profile takes this layer"}
                )
    return steps


def _named_by(rule: LayerRule, layer: str, path: Path) -> bool:
    names = (folded(layer), folded(path.name.split(".")[0]))
    return any(fnmatch.fnmatchcase(name, folded(pattern)) for pattern in rule.layers for name in names)


def _read(
    steps: list[_Step], assume_crs: str | None, summary: ImportSummary, progress: Progress
) -> dict[str, gpd.GeoDataFrame]:
    """Read every step's rows, by role."""
    parts: dict[str, list[gpd.GeoDataFrame]] = {}
    cache: dict[tuple[Path, str | None, tuple[str, ...]], gpd.GeoDataFrame] = {}
    for number, step in enumerate(steps):
        progress("reading sources", number, len(steps))
        if step.rule.fallback and any(len(part) for part in parts.get(step.role, [])):
            continue
        kinds = step.rule.kinds or DEFAULT_KINDS[step.role]
        key = (step.path, step.layer, () if step.layer else kinds)
        if key not in cache:
            cache = {key: read_vector(
                step.path, layer=step.layer, kinds=kinds, assume_crs=assume_crs, notices=summary.notices,
                where_hint=step.where,
            )}  # fmt: skip
        frame = cache[key]
        chosen = selected(frame, step.rule)
        rows = city_rows(step.role, chosen, step.rule, Origin(step.label, step.options), summary.notices)
        used = len(rows)
        if step.role == "observed_plants" and used:
            metric = working_crs(CRS.from_user_input(rows.crs), _bounds(rows), where=step.where)
            rows = _in_crs(single_trees(_in_crs(rows, metric), step.rule, summary.notices), frame.crs)
        if used or step.must_hold:
            parts.setdefault(step.role, []).append(rows)
        summary.taken.append({
            "layer": step.role, "source": step.label, "rows": len(frame), "taken": used, "made": len(rows),
            "path": str(step.path),
        })  # fmt: skip
    progress("reading sources", len(steps), len(steps))
    return {role: _joined(frames) for role, frames in parts.items()}


def _tell_left(summary: ImportSummary) -> None:
    """Keep of what was taken the rules that found rows, and name the layers of which nothing was taken."""
    used = {entry["source"] for entry in summary.taken if entry["taken"]}
    unused = dict.fromkeys(str(entry["source"]) for entry in summary.taken if entry["source"] not in used)
    summary.left = [entry for entry in summary.left if entry["source"] not in used]
    summary.left += [{"source": source, "why": "no row of it is usable, or fits the profile"} for source in unused]
    summary.taken = [entry for entry in summary.taken if entry["taken"]]


def _bounds(frame: gpd.GeoDataFrame) -> tuple[float, float, float, float]:
    bounds = shapely.bounds(frame.geometry.to_numpy())
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    if len(bounds) == 0:
        return (0.0, 0.0, 0.0, 0.0)
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    return float(west), float(south), float(east), float(north)


def _joined(frames: list[gpd.GeoDataFrame]) -> gpd.GeoDataFrame:
    crs = frames[0].crs
    frames = [frames[0]] + [_in_crs(frame, crs) for frame in frames[1:]]
    if len(frames) == 1:
        return frames[0]
    filled = [frame for frame in frames if len(frame)] or frames[:1]
    columns = list(dict.fromkeys(name for frame in filled for name in frame.columns))
    joined = {
        name: np.concatenate([
            frame[name].to_numpy(dtype=object) if name in frame else np.full(len(frame), None) for frame in filled
        ])
        for name in columns
        if name != "geometry"
    }  # fmt: skip
    shapes = np.concatenate([frame.geometry.to_numpy() for frame in filled])
    return gpd.GeoDataFrame(pd.DataFrame(joined).infer_objects(), geometry=shapes, crs=crs)


def _in_crs(frame: gpd.GeoDataFrame, crs: CRS) -> gpd.GeoDataFrame:
    if frame.crs == crs:
        return frame
    shapes = reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), CRS.from_user_input(crs))
    return gpd.GeoDataFrame(frame.drop(columns="geometry"), geometry=shapes, crs=crs)


def _city_crs(layers: dict[str, gpd.GeoDataFrame], sources: Sequence[str], roles: Mapping[str, RoleSource]) -> CRS:
    """Return the CRS of the lots, or of what lots are to be made from."""
    for role in ("lots", "buildings", "roads"):
        if role in layers:
            return CRS.from_user_input(layers[role].crs)
    where = ", ".join([*sources, *(role.source for role in roles.values())])
    raise InputError(
        "neither lots, nor streets and buildings to make them from",
        where=where,
        next_step="name a layer with --lots, or --roads and --buildings; or try another --profile",
    )


def _distinct(lots: gpd.GeoDataFrame, notices: Notices) -> gpd.GeoDataFrame:
    """Keep one lot of those that are the same ground, and give each an identifier of its own."""
    firsts = first_of_equal(lots.geometry.to_numpy())
    dropped = lots["lot_id"].to_numpy()[~firsts]
    notices.add("W_SAME_GROUND", "lots on exactly the ground of another, left out", len(dropped), dropped[:5])
    lots = lots[firsts].reset_index(drop=True)
    names = lots["lot_id"].astype(str).to_numpy(dtype=object)
    repeated = pd.Series(names).duplicated().to_numpy()
    notices.add(
        "W_ID_REPEATED", "lots with the identifier of another, numbered", int(repeated.sum()), names[repeated][:5]
    )
    used = set(names)
    for row in np.flatnonzero(repeated):
        number = 2
        while f"{names[row]}.{number}" in used:
            number += 1
        names[row] = f"{names[row]}.{number}"
        used.add(names[row])
    return lots.assign(lot_id=names)


def _lots_from_streets(layers: dict[str, gpd.GeoDataFrame], notices: Notices, progress: Progress) -> gpd.GeoDataFrame:
    """Make lots where there are none."""
    known = [layers[role] for role in ("roads", "buildings") if role in layers]
    crs = CRS.from_user_input(known[0].crs)
    boxes = np.array([_bounds(frame) for frame in known if len(frame)] or [(0.0, 0.0, 0.0, 0.0)])
    metric = working_crs(crs, (*map(float, boxes[:, :2].min(axis=0)), *map(float, boxes[:, 2:].max(axis=0))))  # type: ignore[arg-type]
    nothing = np.empty(0, dtype=object)
    roads = _in_crs(layers["roads"], metric) if "roads" in layers else None
    shapes = nothing if roads is None else roads.geometry.to_numpy()
    widths = np.empty(0) if roads is None else roads["width_m"].to_numpy(dtype=float, na_value=np.nan)
    lines = np.isin(shapely.get_type_id(shapes), (1, 2, 5)) if len(shapes) else np.zeros(0, dtype=bool)
    buildings = _in_crs(layers["buildings"], metric).geometry.to_numpy() if "buildings" in layers else nothing
    unknown = lines & np.isnan(widths)
    default = Rules().road_width_m
    notices.add("W_ROAD_WIDTH", f"roads without a width, taken as {default:g} m wide", int(unknown.sum()))
    widths = np.where(unknown, default, widths)
    found = derive_lots(
        shapes[lines], widths[lines], shapes[~lines], buildings,
        report=lambda done, total: progress("sharing out blocks", done, total),
    )  # fmt: skip
    notices.add("W_LOTS_DERIVED", "lots made from streets and buildings, as the sources hold none", len(found.shapes))
    notices.add("W_SLIVER", "slivers of ground below 10 m2, left out", found.sliver_count)
    blank = np.full(len(found.shapes), None, dtype=object)
    frame = gpd.GeoDataFrame(
        {"lot_id": found.names, "zone": blank, "zone_code": blank.copy()}, geometry=found.shapes, crs=metric
    )
    return _in_crs(frame, crs)


def _zones(layers: dict[str, gpd.GeoDataFrame], default_zone: str, summary: ImportSummary) -> gpd.GeoDataFrame:
    """Give every lot a zone: its own code, else the zoning that covers it, else what stands on it, else the default."""
    lots = layers["lots"]
    shapes = lots.geometry.to_numpy()
    zones, codes = lots["zone"].to_numpy(dtype=object).copy(), lots["zone_code"].to_numpy(dtype=object).copy()
    by = np.where([zone is not None for zone in zones], "lot", "").astype(object)
    areas = layers.get("zoning")
    if areas is not None and len(areas):
        open_rows = np.flatnonzero(_is_none(zones))
        hit = covering(shapes[open_rows], areas.geometry.to_numpy())
        rows, hit = open_rows[hit >= 0], hit[hit >= 0]
        zones[rows], codes[rows], by[rows] = areas["zone"].to_numpy()[hit], areas["zone_code"].to_numpy()[hit], "zoning"
    buildings = layers.get("buildings")
    if buildings is not None and "zone" in buildings and len(buildings):
        open_rows = np.flatnonzero(_is_none(zones) & _is_none(codes))
        found = majority(shapes[open_rows], buildings.geometry.to_numpy(), buildings["zone"].to_numpy(dtype=object))
        rows = open_rows[~_is_none(found)]
        zones[rows], codes[rows], by[rows] = found[~_is_none(found)], "buildings", "buildings"
    unknown = _is_none(zones)
    coded = unknown & ~_is_none(codes)
    without = unknown & _is_none(codes)
    zones[coded], zones[without] = FALLBACK_ZONE, default_zone
    ids = lots["lot_id"].to_numpy()
    summary.notices.add(
        "W_ZONE_UNKNOWN",
        f"lots with a zone code that means nothing here, taken as {FALLBACK_ZONE!r}",
        int(coded.sum()),
        sorted({str(code) for code in codes[coded]})[:5],
    )
    summary.notices.add(
        "W_ZONE_MISSING", f"lots without a zone, taken as {default_zone!r}", int(without.sum()), ids[without][:5]
    )
    summary.zones = _code_table(codes, zones, ~unknown)
    return lots.assign(zone=zones, zone_code=codes)


def _code_table(codes: NDArray[Any], zones: NDArray[Any], known: NDArray[np.bool_]) -> list[dict[str, object]]:
    """Count the lots of each code, most first."""
    counted = Counter(
        (None if code is None or code != code else str(code), str(zone), bool(sure))
        for code, zone, sure in zip(codes, zones, known, strict=True)
    )
    rows = sorted(counted.items(), key=lambda item: (-item[1], item[0][1], str(item[0][0])))
    return [{"code": code, "zone": zone, "lots": lots, "known": sure} for (code, zone, sure), lots in rows]


def _is_none(values: NDArray[Any]) -> NDArray[np.bool_]:
    return np.array([value is None or value != value for value in values], dtype=bool)


def _sources_table(summary: ImportSummary, profile: str | None) -> pd.DataFrame:
    """Return the record of what the city was made from."""
    hashes: dict[str, str] = {}
    rows = []
    for entry in summary.taken:
        path = Path(str(entry.pop("path")))
        if path.is_file() and str(path) not in hashes:
            hashes[str(path)] = sha256_of(path)
        rows.append({
            **entry, "sha256": hashes.get(str(path), ""), "profile": profile or "", "program_version": __version__,
            "written_at": timestamp(),
        })  # fmt: skip
    return pd.DataFrame(rows)
