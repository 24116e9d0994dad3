"""Import: whatever people have, made into one city file."""

from __future__ import annotations

import fnmatch
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import geopandas as gpd
import pandas as pd
from pydantic import ValidationError
from pyproj import CRS

from urbanforest_cli import __version__
from urbanforest_cli.core.crs import working_crs
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.zones import FALLBACK_ZONE, ZONES
from urbanforest_cli.files.configs import configs_folder, read_toml
from urbanforest_cli.files.geopackage import timestamp, write_layers
from urbanforest_cli.files.vectors import list_vector_layers, read_vector, split_source
from urbanforest_cli.sources.city import (
    city_crs,
    distinct_lots,
    extent_of,
    give_zones,
    in_crs,
    join_rows,
    lots_from_streets,
)
from urbanforest_cli.sources.layers import Origin, city_rows, selected, single_trees
from urbanforest_cli.sources.profile import DEFAULT_KINDS, ROLES, LayerRule, Profile, folded

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
    crs = city_crs(layers, where=", ".join([*sources, *(role.source for role in roles.values())]))
    layers = {role: in_crs(frame, crs) for role, frame in layers.items()}
    if "lots" in layers:
        layers["lots"] = distinct_lots(layers["lots"], notices)
    else:
        layers["lots"] = lots_from_streets(layers, notices, progress)
    lots, summary.zones = give_zones(layers, default_zone, notices)
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
        if output.exists() and _same(source, output):
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


_ZONE_NAMES = {zone: zone for zone in ZONES}
# What columns mostly bear when nobody says: the names of the city file itself, and the commonest others.
_USUAL_COLUMNS: dict[str, dict[str, Any]] = {
    "lots": {"id": "lot_id", "zones": [{"column": "zone", "codes": _ZONE_NAMES}]},
    "buildings": {"id": "building_id", "height": ["height_m", "height"], "levels": ["levels", "building:levels"]},
    "roads": {"width": ["width_m", "width"], "kind": ["kind", "highway"]},
    "entrances": {"kind": "kind"},
    "obstacles": {"kind": "kind", "clearance": "clearance_m"},
    "observed_plants": {"species": "species", "height": ["height_m", "height"]},
}


def _profile_steps(sources: Sequence[str], profile: Profile, given: set[str], summary: ImportSummary) -> list[_Step]:
    """Match the layers of the sources with the profile's rules; layers no rule takes are told."""
    steps = []
    for text in sources:
        path, only = split_source(text)
        spatial = [name for name, kind in list_vector_layers(path) if kind is not None]
        if only is not None and only not in spatial:
            raise InputError(f"no layer {only!r}", where=path, found=", ".join(spatial))
        # The name of a file says what its layer holds, if it is the only one.
        title = path.name.split(".")[0] if len(spatial) == 1 else None
        for layer in [name for name in spatial if only in (None, name)]:
            found = [
                _Step(role, rule, path, layer)
                for role in ROLES
                if role not in given
                for rule in profile.rules(role)
                if _named_by(rule, layer, title)
            ]
            steps += found
            if not found:
                summary.left.append(
                    {"source": f"{path.name}:{layer}", "why": "no rule of the profile takes this layer"}
                )
    return sorted(steps, key=lambda step: step.rule.fallback)  # what stands in for others comes after them


def _named_by(rule: LayerRule, layer: str, title: str | None) -> bool:
    names = [folded(name) for name in (layer, title) if name is not None]
    return any(fnmatch.fnmatchcase(name, folded(pattern)) for pattern in rule.layers for name in names)


def _read(
    steps: list[_Step], assume_crs: str | None, summary: ImportSummary, progress: Progress
) -> dict[str, gpd.GeoDataFrame]:
    """Read every step's rows, by role."""
    parts: dict[str, list[gpd.GeoDataFrame]] = {}
    cache: dict[tuple[Path, str | None, tuple[str, ...]], gpd.GeoDataFrame] = {}
    told = set()
    found = set()
    for number, step in enumerate(steps):
        progress("reading sources", number, len(steps))
        if step.rule.fallback and step.role in found:
            continue
        kinds = step.rule.kinds or DEFAULT_KINDS[step.role]
        key = (step.path, step.layer, () if step.layer else kinds)
        if key not in cache:
            notices = Notices() if key in told else summary.notices  # a file read again says nothing new
            told.add(key)
            frame = read_vector(
                step.path,
                layer=step.layer,
                kinds=kinds,
                assume_crs=assume_crs,
                notices=notices,
                where_hint=step.where,
            )
            cache = {key: frame}  # one at a time, since layers may be large
        frame = cache[key]
        chosen = selected(frame, step.rule)
        rows = city_rows(step.role, chosen, step.rule, Origin(step.label, step.options), summary.notices)
        used = len(rows)
        if step.role == "observed_plants" and used:
            metric = working_crs(CRS.from_user_input(rows.crs), extent_of(rows), where=step.where)
            rows = in_crs(single_trees(in_crs(rows, metric), step.rule, summary.notices), frame.crs)
        if used and not step.rule.fallback:
            found.add(step.role)
        if used or step.must_hold:
            parts.setdefault(step.role, []).append(rows)
        summary.taken.append({
            "layer": step.role, "source": step.label, "rows": len(frame), "taken": used, "made": len(rows),
            "path": str(step.path),
        })  # fmt: skip
    progress("reading sources", len(steps), len(steps))
    return {role: join_rows(frames) for role, frames in parts.items()}


def _tell_left(summary: ImportSummary) -> None:
    """Keep of what was taken the rules that found rows, and name the layers of which nothing was taken."""
    used = {entry["source"] for entry in summary.taken if entry["taken"]}
    unused = dict.fromkeys(str(entry["source"]) for entry in summary.taken if entry["source"] not in used)
    summary.left = [entry for entry in summary.left if entry["source"] not in used]
    summary.left += [{"source": source, "why": "no row of it is usable, or fits the profile"} for source in unused]
    summary.taken = [entry for entry in summary.taken if entry["taken"]]


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
