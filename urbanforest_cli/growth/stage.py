"""Grow the plants of a register: files in, files out."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.errors import ConfigError, InputError, StaleError, UrbanForestError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.provenance import (
    Record,
    note_settled_config,
    provenance_frame,
    read_records,
    require_record,
    stage_key,
)
from urbanforest_cli.files.skeleton_parts import (
    GroveStore,
    hash_of,
    part_name,
    parts_are_there,
    parts_folder,
    remove_strays,
    take_part,
)
from urbanforest_cli.files.skeletons import iterate_batches, read_parts, read_provenance, write_part
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth import simulate
from urbanforest_cli.growth.accounts import ACCOUNTED, Accounts, joined, sizes_of
from urbanforest_cli.growth.batches import answers_in_order
from urbanforest_cli.growth.city import City, Ground, Job, job_numbers, part_digest
from urbanforest_cli.growth.detail import (
    Choice,
    Comparison,
    GroveInForce,
    choose_all,
    choose_focus,
    choose_library,
    detail_in_force,
    lots_in_focus,
    stand_of,
)
from urbanforest_cli.growth.grove import season_count
from urbanforest_cli.growth.parts import Grown, PartPlan, collect, grow_job, plan_parts
from urbanforest_cli.growth.shape_error import shape_errors
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.trees import Stand, seasons_shown, tree_columns, tree_counts

STAGE = "grow"
LATITUDE_STEP_DEG = 0.5  # so that a lot more or less does not move the sun of all others

Bounds = tuple[float, float, float, float]
Counts = dict[str, int | float | str]


def grow_key(before: str, *, config: Config, seed: int, catalogue: Catalogue) -> str:
    """Return the hash of all that decides this stage's result, `before` being the key of the stage before it."""
    kinds = json.dumps([[kind.id, asdict(kind.growth), asdict(kind.open_grown)] for kind in catalogue], sort_keys=True)
    return stage_key(STAGE, config=config, seed=seed, inputs=[before, kinds], sections=("growth",))


def grown_key(record: Record) -> str:
    """Return the key of the growth itself, whatever year is shown."""
    return next((item["sha256"] for item in record.inputs if item["name"] == STAGE), record.stage_key)


def shows_year(record: Record, year: int | None) -> bool:
    """Tell whether a register's sizes are those of a year, given as to `show_year`."""
    ago = record.config.get("years_ago", 0)
    if year is None or year < 0:
        return ago == -(year or 0)
    return bool(record.config.get("year", record.counts.get("last_year", -1)) == year)


def grow_plants(
    register: Path,
    *,
    config: Config,
    seed: int,
    workers: int = 1,
    focus_lots: Sequence[str] | None = None,
    bbox: Bounds | None = None,
    previous: Path | None = None,
    progress: Progress = silent,
) -> StageSummary:
    """Grow the plants of a register into skeletons.

    Reads layers ``plants``, ``lots`` and ``buildings``; writes ``trees``, ``groves``, ``skeleton_parts``, one
    provenance record and the parts of ``skeletons/`` beside the register, which are there before it names them. The
    result depends on the inputs and the seed alone, not on the order of lots or the number of workers. Groves of
    which nothing has changed are taken from earlier parts.

    Parameters
    ----------
    focus_lots, bbox
        Lots to grow in their own place: by their ids, or those with a plant within west, south, east, north in the
        register's CRS. Where all plants are to grow in their own place, only these lots are grown, and of the others
        what is stored is kept, whatever the settings it grew with.
    previous
        A register of an earlier run, beside whose parts groves may be found too.

    Raises
    ------
    SchemaError
        A layer is missing or breaks its requirements; the text names the command that writes it.
    ConfigError
        The register has plants of a species that is not in the catalogue.
    InputError
        A lot in focus is not there, or no plant is in focus.
    StaleError
        What is to be kept cannot be read.
    """
    started = time.perf_counter()
    place = require_record(register, "place")
    notices = Notices()
    catalogue = load_catalogue(config.species)
    land = _read(register, place.working_crs, config, seed, catalogue, notices)
    focus = lots_in_focus(land.lot_ids, land.plants, focus_lots, bbox)
    store = GroveStore(dict.fromkeys([register, *([previous] if previous is not None else [])]))
    open_grown = [kind.open_grown for kind in catalogue]
    detail = detail_in_force(config.growth, len(land.plants))
    if detail == "library":
        choice = choose_library(land.ground, focus or frozenset(), open_grown)
    elif focus is None:
        choice = choose_all(land.ground)
    else:
        choice = choose_focus(land.ground, focus, _in_force(register, place, store), store)

    grower = _Grower(land, catalogue, seed, store, workers, progress)
    numbers = job_numbers(land.city, choice.jobs)
    parts = grower.grow(plan_parts(choice.jobs, numbers), parts_folder(register))
    accounts = joined([part.accounts for part in parts])
    stand, compared = stand_of(land.ground, choice, numbers, accounts, open_grown)
    columns = tree_columns(stand, accounts, season_count(land.plants["age_years"].to_numpy(dtype=np.float64)))

    key = grow_key(place.stage_key, config=config, seed=seed, catalogue=catalogue)
    if detail == "library" and focus is not None:
        key = stage_key(STAGE, config=config, seed=seed, inputs=[key, *sorted(focus)], sections=())
    elif not choice.whole:
        mixed = part_digest(choice.jobs, numbers)
        key = stage_key(STAGE, config=config, seed=seed, inputs=[key, mixed], sections=())
    counts = _totals(columns, accounts, parts, detail)
    counts["last_year"] = int(season_count(land.plants["age_years"].to_numpy(dtype=np.float64)).max(initial=0))
    if compared is not None:
        counts |= _library_error(parts_folder(register), parts, compared)
    _note_growth(land, columns, choice, notices)
    note_settled_config(read_records(register)["stencil"], config, notices)
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=key,
        working_crs=place.working_crs,
        config=config.model_dump(mode="json", exclude_none=True),
        inputs=[_input_of(place)],
        counts=dict(counts),
        notices=notices,
    )
    _write(register, land.plants, columns, parts, record)
    remove_strays(register)
    counts["groves_reused"] = grower.reused
    told = Notices(notices)
    told.add(
        "W_SKELETONS_CHANGED",
        "parts of skeletons that were removed or changed, or cannot be read, grown again",
        len(store.changed),
        store.changed,
    )
    return StageSummary(STAGE, register, counts, told, time.perf_counter() - started)


@dataclass(frozen=True)
class _Land:
    """What is read of a register: its plants, the same as arrays, and the ground they stand on."""

    plants: gpd.GeoDataFrame
    lot_ids: frozenset[str]
    city: City
    ground: Ground
    heights_unknown: int


def _read(register: Path, working: CRS, config: Config, seed: int, catalogue: Catalogue, notices: Notices) -> _Land:
    plants = read_layer(register, "plants")
    lots = read_layer(register, "lots", geometry=False)
    built = read_layer(register, "buildings")
    crs = CRS.from_user_input(plants.crs)
    file_xy = shapely.get_coordinates(plants.geometry.to_numpy())
    buildings = reproject(built.geometry.to_numpy(), crs, working)
    height_m = built["height_m"].to_numpy(dtype=np.float64, na_value=np.nan)
    species = plants["species"].map({name: row for row, name in enumerate(catalogue.ids)})
    if species.isna().any():
        unknown = sorted(set(plants["species"][species.isna()]))
        raise ConfigError(
            "plants of species that the config does not know",
            where=f"{register}, layer 'plants'",
            found=", ".join(unknown[:10]),
            expected=", ".join(catalogue.ids),
            next_step="name the config that placed them with -c, or run `urbanforest place` with this one",
        )
    zone = plants["lot_id"].map(dict(zip(lots["lot_id"], lots["zone"], strict=True)))
    clearance = zone.map(config.growth.crown_clearance_m).fillna(0.0).to_numpy(dtype=np.float64)
    city = City.of(
        seed=seed,
        plant_id=plants["plant_id"].to_numpy(dtype=object),
        lot_id=plants["lot_id"].to_numpy(dtype=object),
        xy_m=reproject_xy(file_xy, crs, working),
        species=np.asarray(species, dtype=np.int64),
        age_years=plants["age_years"].to_numpy(dtype=np.float64),
        pruning_factor=plants["pruning_factor"].to_numpy(dtype=np.float64),
        clearance_m=np.where(plants["habit"] == "tree", clearance, 0.0),
        buildings=buildings,
    )
    light = light_from(_latitude(file_xy, crs), config.growth.sun_share)
    ground = Ground(city, catalogue, buildings, height_m, light, config.growth)
    lot_ids = frozenset(lots["lot_id"])
    return _Land(plants, lot_ids, city, ground, int((~np.isfinite(height_m)).sum()))


def _in_force(register: Path, place: Record, store: GroveStore) -> list[GroveInForce]:
    """Return the groves that a register names and that lie beside it, if they are those of its plants."""
    record = read_records(register).get(STAGE)
    if record is None or _input_of(place) not in record.inputs:
        return []
    groves = read_layer(register, "groves", geometry=False)
    groves = groves[groves["kind"] == "lot"]
    rows = zip(groves["grove_id"], groves["lot_id"], groves["grow_key"], strict=True)
    found = ((grove, lot, key, store.find(key)) for grove, lot, key in rows)
    return [GroveInForce(grove, lot, stored.ids, key) for grove, lot, key, stored in found if stored is not None]


def _input_of(place: Record) -> dict[str, str]:
    """Return what a record of growth says of the plants it grew."""
    return {"name": "place", "sha256": place.stage_key}


def _latitude(file_xy: NDArray[np.float64], crs: CRS) -> float:
    """Return the latitude of the middle of all plants, in steps; 0 where there is none."""
    if not len(file_xy):
        return 0.0
    middle = (file_xy.min(axis=0) + file_xy.max(axis=0))[None] / 2
    latitude = float(reproject_xy(middle, crs, CRS.from_epsg(4326))[0, 1])
    return float(np.clip(np.round(latitude / LATITUDE_STEP_DEG) * LATITUDE_STEP_DEG, -90.0, 90.0))


@dataclass(frozen=True)
class _Part:
    """A part that is there: its file, its groves as rows of the layer, and the accounts of its plants."""

    name: str
    sha256: str
    bytes: int
    groves: list[dict[str, Any]]
    accounts: Accounts


class _Grower:
    """Grows groves and writes them part by part, taking from earlier parts what is in them."""

    def __init__(
        self, land: _Land, catalogue: Catalogue, seed: int, store: GroveStore, workers: int, progress: Progress
    ) -> None:
        self.land, self.seed, self.store = land, seed, store
        self.workers, self.progress = workers, progress
        self.traits = traits_table([kind.growth for kind in catalogue])
        self.species = np.array(catalogue.ids, dtype=object)
        self._taken: set[str] = set()

    @property
    def reused(self) -> int:
        """How many groves were taken as they are stored."""
        return len(self._taken)

    def grow(self, plans: list[PartPlan], folder: Path) -> list[_Part]:
        """Bring all parts into a folder and return them in their order."""
        stored = [self.store.part(part_name(plan.digest)) for plan in plans]
        missing = [
            question for plan, path in zip(plans, stored, strict=True) if path is None for question in plan.questions()
        ]
        if any(job.grow_key not in self.store for job, _ in missing):
            announce_compile(simulate.KERNELS, self.progress)
        total, done = sum(plan.plant_count for plan in plans), 0
        grown = answers_in_order(missing, self._grown, self.workers)
        parts = []
        for plan, path in zip(plans, stored, strict=True):
            target = folder / part_name(plan.digest)
            if path is None:
                self._write(target, plan, self._told(plan, grown, done, total))
            else:
                self._taken |= {job.grove_id for job in plan.jobs}
                if path != target:
                    take_part(path, target)
            done += plan.plant_count
            self.progress("growing plants", done, total)
            parts.append(_part(target))
        return parts

    def _told(self, plan: PartPlan, grown: Iterator[Grown], done: int, total: int) -> Iterator[Grown]:
        """Pass on the groves of a part, telling of each."""
        for job in plan.jobs:
            yield next(grown)
            done += len(job.rows)
            self.progress("growing plants", done, total)

    def _grown(self, question: tuple[Job, NDArray[np.int64]]) -> Grown:
        """Take a grove from where it is stored, or grow it."""
        job, numbers = question
        if (stored := self.store.find(job.grow_key)) is not None:
            try:
                skeletons = self.store.skeletons(stored)
                accounts = Accounts.from_record(self.store.plants(stored), where=stored.path)
            except UrbanForestError:
                self.store.distrust(stored.path)
            else:
                self._taken.add(job.grove_id)
                return replace(skeletons, skeleton_id=numbers), replace(accounts, skeleton_id=numbers)
        if job.kept:
            raise StaleError(
                "skeletons of lots out of focus, which were to be kept, cannot be read",
                where=f"lot {job.lot_id}",
                next_step="run `urbanforest grow` without --only and --bbox",
            )
        return grow_job(self.land.ground, self.traits, job, numbers)

    def _write(self, target: Path, plan: PartPlan, grown: Iterator[Grown]) -> None:
        content = collect(plan, grown)
        city = self.land.city
        rows = np.concatenate([job.rows for job in plan.jobs])
        ids = np.concatenate(plan.numbers).tolist()
        texts = {
            "plant_id": dict(zip(ids, city.plant_id[rows].tolist(), strict=True)),
            "species": dict(zip(ids, self.species[city.species[rows]].tolist(), strict=True)),
        }
        record = {"stage": STAGE, "seed": self.seed, "groves": content.groves, "plants": content.accounts.as_record()}
        write_part(target, content.groups, record, texts=texts)


def _part(path: Path) -> _Part:
    """Return what is known of a part that is there."""
    record = read_provenance(path)
    accounts = Accounts.from_record(record["plants"], where=path)
    groves = [{**grove, "part": path.name} for grove in record["groves"]]
    return _Part(path.name, hash_of(path), path.stat().st_size, groves, accounts)


def _write(
    register: Path, plants: gpd.GeoDataFrame, columns: dict[str, Any], parts: list[_Part], record: Record
) -> None:
    groves = pd.DataFrame(
        [grove for part in parts for grove in part.groves],
        columns=["grove_id", "lot_id", "kind", "plant_count", "part", "row_group", "grow_key"],
    )
    files = pd.DataFrame(
        {
            "part": np.array([part.name for part in parts], dtype=object),
            "sha256": np.array([part.sha256 for part in parts], dtype=object),
            "bytes": np.array([part.bytes for part in parts], dtype=np.int64),
            "skeleton_count": np.array([len(part.accounts) for part in parts], dtype=np.int64),
            "internode_count": np.array([part.accounts.generated.sum() for part in parts], dtype=np.int64),
        }
    )
    frames = {"trees": _trees(plants, columns), "groves": groves, "skeleton_parts": files}
    write_layers(register, {**frames, "provenance": provenance_frame(register, record, drop=("export",))})


def _trees(plants: gpd.GeoDataFrame, columns: dict[str, Any]) -> gpd.GeoDataFrame:
    own = ["plant_id", "lot_id", "species", "habit", "age_years"]
    return gpd.GeoDataFrame(
        {**{name: plants[name].to_numpy() for name in own}, **columns},
        geometry=plants.geometry.to_numpy(),
        crs=plants.crs,
    )


def _totals(columns: dict[str, Any], accounts: Accounts, parts: list[_Part], detail: str) -> Counts:
    return {
        "plants": len(columns["grown"]),
        "detail": detail,
        **tree_counts(columns),
        "groves": sum(len(part.groves) for part in parts),
        **{f"internodes_{name}": int(getattr(accounts, name).sum()) for name in ACCOUNTED},
        "parts": len(parts),
        "bytes": sum(part.bytes for part in parts),
    }


def _note_growth(land: _Land, columns: dict[str, Any], choice: Choice, notices: Notices) -> None:
    height = land.ground.growth.building_height_m
    notices.add(
        "W_BUILDING_HEIGHT_UNKNOWN", f"buildings without a height, taken as {height:g} m high", land.heights_unknown
    )
    ids = land.plants["plant_id"].to_numpy(dtype=object)
    for reason, text in (
        ("no_room", "plants inside or hard by a building, which did not grow"),
        ("out_of_focus", "plants of lots that were not asked for and had not grown before"),
    ):
        rows = np.flatnonzero(columns["reason"] == reason)
        notices.add(f"W_{reason.upper()}", text, len(rows), ids[rows[:5]])
    kept = [plant for job in choice.jobs if job.kept for plant in land.city.plant_id[job.rows].tolist()]
    text = "plants of lots that were not asked for, kept as they grew before, with other settings or surroundings"
    notices.add("W_KEPT_AS_GROWN", text, len(kept), kept[:5])


def _library_error(folder: Path, parts: list[_Part], compared: Comparison) -> Counts:
    """Hold what plants would have from the library against how they grew in their own place."""
    counts: Counts = {"library_compared": len(compared), "library_one_dead": compared.one_dead}
    if not len(compared):
        return counts
    entry_id, entry = np.unique(compared.entry_id, return_inverse=True)
    own = _skeletons(folder, parts, compared.own_id)
    entries = _skeletons(folder, parts, entry_id)
    errors = shape_errors(
        own, entries, entry, yaw_deg=compared.yaw_deg, mirror=compared.mirror, scale=compared.scale
    ).summary()
    return counts | {
        f"library_{figure}_{name}": round(value, 3) for figure, pair in errors.items() for name, value in pair.items()
    }


def _skeletons(folder: Path, parts: list[_Part], ids: NDArray[np.int64]) -> Skeletons:
    """Read skeletons by their numbers, in that order, opening only the row groups they are in."""
    groups: dict[str, list[int]] = {}
    for part in parts:
        counts = [grove["plant_count"] for grove in part.groves]
        row_group = np.repeat([grove["row_group"] for grove in part.groves], counts)
        if len(wanted := np.unique(row_group[np.isin(part.accounts.skeleton_id, ids)])):
            groups[part.name] = wanted.tolist()
    return read_parts([folder / name for name in groups], skeleton_ids=ids, row_groups=groups)


def show_year(register: Path, year: int | None) -> StageSummary:
    """Tell the sizes of a year from the skeletons that are there, growing nothing.

    Parameters
    ----------
    year
        From 0, the planting of the oldest plant; below 0, years before today; None for today.

    Raises
    ------
    InputError
        The year is outside the city's life.
    StaleError
        The skeletons are not there or not those of the plants.
    """
    started = time.perf_counter()
    place = require_record(register, "place")
    record = read_records(register).get(STAGE)
    fits = record is not None and _input_of(place) in record.inputs
    if record is None or not fits or not parts_are_there(register):
        raise StaleError(
            "the skeletons are not there, or not those of these plants",
            where=register,
            next_step="run `urbanforest grow` without --year first",
        )
    plants = read_layer(register, "plants")
    trees = read_layer(register, "trees", geometry=False)
    if trees["plant_id"].tolist() != plants["plant_id"].tolist():
        raise StaleError(
            "layers 'trees' and 'plants' do not hold the same plants",
            where=register,
            next_step="run `urbanforest grow` without --year first",
        )
    seasons = season_count(plants["age_years"].to_numpy(dtype=np.float64))
    newest = int(seasons.max(initial=0))
    city_year = newest if year is None else (year if year >= 0 else newest + year)
    if not 0 <= city_year <= newest:
        raise InputError(
            "a year outside the life of the city",
            where="--year",
            found=year,
            expected=f"0 to {newest}, or -{newest} to -1 for years before today",
        )
    folder = parts_folder(register)
    parts = [_part(folder / name) for name in read_layer(register, "skeleton_parts", geometry=False)["part"]]
    accounts = joined([part.accounts for part in parts])
    ago = newest - city_year
    sizes = None
    if ago:
        told = [
            sizes_of(batch, seasons_shown(batch.seasons.astype(np.int64), ago))
            for _, _, batch in iterate_batches([folder / part.name for part in parts])
        ]
        sizes = {name: np.concatenate([one[name] for one in told]) for name in told[0]} if told else None
    library_ids = _library_ids(parts)
    columns = tree_columns(Stand.read(trees, library_ids), accounts, seasons, years_ago=ago, sizes=sizes)
    detail = str(record.counts.get("detail", "unique"))
    shown_at = {"year": city_year, "years_ago": ago} if ago else {}
    counts = {name: value for name, value in record.counts.items() if name != "year"}
    counts |= {**_totals(columns, accounts, parts, detail), **({"year": city_year} if ago else {})}
    base = grown_key(record)
    shown = Record(
        stage=STAGE,
        seed=record.seed,
        stage_key=stage_key(STAGE, config=Config(), seed=record.seed, inputs=[base, f"year={ago}"], sections=())
        if ago
        else base,
        working_crs=record.working_crs,
        config={name: value for name, value in record.config.items() if name not in ("year", "years_ago")} | shown_at,
        inputs=[_input_of(place), {"name": STAGE, "sha256": base}],
        counts=counts,
        notices=record.notices,
    )
    frames = {"trees": _trees(plants, columns), "provenance": provenance_frame(register, shown, drop=("export",))}
    write_layers(register, frames)
    told_counts = {name: value for name, value in counts.items() if isinstance(value, int | float | str)}
    return StageSummary(STAGE, register, told_counts, record.notices, time.perf_counter() - started)


def _library_ids(parts: list[_Part]) -> NDArray[np.int64]:
    """Return the numbers of the library's skeletons."""
    ids: list[NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
    for part in parts:
        counts = [grove["plant_count"] for grove in part.groves]
        library = np.repeat([grove["kind"] == "library" for grove in part.groves], counts)
        ids.append(part.accounts.skeleton_id[library.astype(bool)])
    return np.concatenate(ids)
