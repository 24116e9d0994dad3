"""Place plants in a register: files in, files out."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli import __version__
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crown_fit_kernel import fit_kernel
from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.errors import ConfigError, SchemaError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, plugin_prints
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.schema import GROW_LAYERS, SKIP_REASONS
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import layer_names, read_layer, write_layers
from urbanforest_cli.files.provenance import (
    Record,
    note_settled_config,
    provenance_frame,
    read_records,
    require_record,
    stage_key,
)
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.placement.city_wide import place_in_waves
from urbanforest_cli.placement.observed import Observed, apart_from_fixed
from urbanforest_cli.placement.regions import Regions, fill_regions
from urbanforest_cli.placement.seeds import ROUNDING_TOLERATED, Seeds, draw_seeds
from urbanforest_cli.placement.sites import Positions, Sites
from urbanforest_cli.placement.sizes import age_at_height, as_wide_as_seen
from urbanforest_cli.placement.strategies import KERNELS, strategy_named
from urbanforest_cli.placement.thinning import index_within, kept_by_count, kept_by_hash

STAGE = "place"
LOTS_A_BATCH = 4096
REGION = "region"
"""What stands for the strategy of lots that are filled from a coverage map."""
REGIONS_A_BATCH = 256


def place_key(before: str, *, config: Config, seed: int, catalogue: Catalogue) -> str:
    """Return the hash of all that decides this stage's result, `before` being the key of the stage before it."""
    species = json.dumps([_without_growth(asdict(kind)) for kind in catalogue], sort_keys=True)
    return stage_key(
        STAGE,
        config=config,
        seed=seed,
        inputs=[before, species, *plugin_prints()],
        sections=("placement", "coverage", "species"),
    )


def _without_growth(kind: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in kind.items() if name != "growth"}


def place_plants(
    register: Path,
    *,
    config: Config,
    seed: int,
    workers: int = 1,
    previous: Path | None = None,
    progress: Progress = silent,
) -> StageSummary:
    """Fill the active areas of a register with plants.

    Reads layers ``lots``, ``active_areas``, ``parameters`` and, where they are, ``regions`` and ``observed``; writes
    ``plants``, ``placements``, its rows of ``skipped`` and one provenance record. Lots with regions are filled from
    them, all others by their strategies; observed plants stand as they are, positions of strategies keep
    clear of them and crowns of regions are fitted to what they leave bare. The
    result depends on the inputs and the seed alone, not on the order of lots or the number of workers.

    Parameters
    ----------
    previous
        A register of an earlier run: lots for which nothing has changed take their plants from there.

    Raises
    ------
    SchemaError
        A layer is missing or breaks its requirements; the text names the command that writes it.
    ConfigError
        A lot asks for more species than the city has.
    """
    started = time.perf_counter()
    records = read_records(register)
    working = require_record(register, "stencil").working_crs
    before = next(records[name] for name in ("diffuse", "regress", "stencil") if name in records)
    catalogue = load_catalogue(config.species)
    city = _read_city(register, working, catalogue)
    _refuse_more_species_than_there_are(city, catalogue, register)
    salt = place_key("", config=config, seed=seed, catalogue=catalogue)
    city.lot_keys[:] = _lot_keys(city, salt)
    reuse = config.placement.conflict == "lot"
    kept = _previous_plants(previous or register, city) if reuse else None
    todo = np.ones(len(city.lot_ids), dtype=bool) if kept is None else ~np.isin(city.lot_ids, kept.placements["lot_id"])

    fresh = _place(city, np.flatnonzero(todo), config, seed, catalogue, workers, progress)
    plants, placements = _frames(city, fresh, np.flatnonzero(todo), catalogue, working)
    if kept is not None:
        plants, placements = _joined(city, kept, plants, placements)
    skipped = _skipped(register, placements)
    counts: dict[str, int | float | str] = {
        "plants": len(plants),
        "lots_planted": int((placements["plant_count"] > 0).sum()),
        "lots_skipped": len(skipped),
        "lots_reused": int(len(city.lot_ids) - todo.sum()),
    }
    if (from_map := city.strategy == REGION).any():
        counts["lots_from_map"] = int(from_map.sum())
    if len(city.observed):
        counts["plants_observed"] = len(city.observed)
    notices = Notices()
    note_settled_config(records["stencil"], config, notices)
    refused = placements.loc[placements["outcome"] == "too_many_plants", "lot_id"]
    notices.add(
        "W_TOO_MANY_PLANTS",
        f"lots that would hold more than {config.placement.max_plants_per_lot:,} plants, skipped "
        "(split them, or raise placement.max_plants_per_lot)",
        len(refused),
        refused,
    )
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=place_key(before.stage_key, config=config, seed=seed, catalogue=catalogue),
        working_crs=working,
        config=config.model_dump(mode="json", exclude_none=True),
        inputs=[{"name": before.stage, "sha256": before.stage_key}],
        counts={name: count for name, count in counts.items() if name != "lots_reused"},
        notices=notices,
    )
    write_layers(
        register,
        {
            "plants": plants,
            "placements": placements,
            "skipped": skipped,
            "provenance": provenance_frame(register, record, drop=("grow",)),
        },
        drop=GROW_LAYERS,
    )
    return StageSummary(STAGE, register, counts, notices, time.perf_counter() - started)


@dataclass
class _City:
    """The lots that have ground to plant or known plants, in the order of their ids; geometries in metres."""

    crs: CRS
    lot_ids: NDArray[np.object_]
    lots: NDArray[np.object_]
    areas: NDArray[np.object_]
    strategy: NDArray[np.object_]
    values: dict[str, NDArray[np.float64]]
    regions: Regions
    observed: Observed
    prints: list[bytes]
    lot_keys: NDArray[np.object_]


def _read_city(register: Path, working: CRS, catalogue: Catalogue) -> _City:
    there = set(layer_names(register))
    areas = read_layer(register, "active_areas").set_index("lot_id")
    lots = read_layer(register, "lots").set_index("lot_id")
    parameters = read_layer(register, "parameters", geometry=False).set_index("lot_id")
    known = read_layer(register, "observed") if "observed" in there else None
    mapped = read_layer(register, "regions").set_index("lot_id") if "regions" in there else None
    crs = CRS.from_user_input(areas.crs)
    lot_ids = np.array(sorted({*areas.index, *(known["lot_id"] if known is not None else ())}), dtype=object)
    lot_shapes = np.array(lots.geometry.reindex(lot_ids), dtype=object)
    area_shapes = np.array(areas.geometry.reindex(lot_ids), dtype=object)
    area_shapes[shapely.is_missing(area_shapes)] = shapely.MultiPolygon()
    parameters = parameters.reindex(lot_ids)
    values = {name: parameters[name].to_numpy(dtype=np.float64) for name in PARAMETERS}
    strategy = np.array(parameters["strategy"], dtype=object)
    region_shapes = np.full(len(lot_ids), shapely.MultiPolygon(), dtype=object)
    coverage = np.ones(len(lot_ids))
    if mapped is not None:
        rows = pd.Index(lot_ids).get_indexer(mapped.index)
        at, rows = np.flatnonzero(rows >= 0), rows[rows >= 0]
        region_shapes[rows] = mapped.geometry.to_numpy()[at]
        coverage[rows] = mapped["coverage"].to_numpy(dtype=np.float64)[at]
        strategy[rows] = REGION
    observed = Observed.none() if known is None else _observed(known, lot_ids, values, catalogue, working)
    numbers = np.column_stack([*values.values(), coverage])
    shapes = [shapely.to_wkb(item) for item in (area_shapes, lot_shapes, region_shapes)]
    prints = [
        b"\x1f".join((str(name).encode(), row.tobytes(), *wkb, stands))
        for name, row, *wkb, stands in zip(strategy, numbers, *shapes, _prints_of(observed, len(lot_ids)), strict=True)
    ]
    return _City(
        crs=crs,
        lot_ids=lot_ids,
        lots=reproject(lot_shapes, crs, working),
        areas=reproject(area_shapes, crs, working),
        strategy=strategy,
        values=values,
        regions=Regions(reproject(region_shapes, crs, working), coverage),
        observed=observed,
        prints=prints,
        lot_keys=np.empty(len(lot_ids), dtype=object),
    )


def _observed(
    frame: gpd.GeoDataFrame,
    lot_ids: NDArray[np.object_],
    values: Mapping[str, NDArray[np.float64]],
    catalogue: Catalogue,
    working: CRS,
) -> Observed:
    frame = frame.sort_values("observed_id", kind="stable")
    lot = pd.Index(lot_ids).get_indexer(pd.Index(frame["lot_id"]))
    order = np.argsort(lot, kind="stable")
    frame, lot = frame.iloc[order], lot[order]
    points = reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), working)
    radius_m = frame["crown_radius_m"].to_numpy(dtype=np.float64, na_value=np.nan, copy=True)
    radius_m = np.where(radius_m > 0, radius_m, values["radius_mean_m"][lot])
    kinds = pd.Index(catalogue.ids).get_indexer(pd.Index(frame["species"].astype(object)))
    height_m = frame["height_m"].to_numpy(dtype=np.float64, na_value=np.nan)
    return Observed(
        frame["observed_id"].to_numpy(dtype=object), lot.astype(np.int64), shapely.get_coordinates(points), radius_m,
        height_m, kinds.astype(np.int64),
    )  # fmt: skip


def _prints_of(observed: Observed, count: int) -> list[bytes]:
    """Return for each lot what its known plants are."""
    prints = [b""] * count
    numbers = np.column_stack((observed.xy, observed.radius_m, observed.height_m, observed.species.astype(np.float64)))
    for row, lot in enumerate(observed.lot):
        prints[lot] += str(observed.ids[row]).encode("utf-8", "surrogatepass") + numbers[row].tobytes()
    return prints


def _refuse_more_species_than_there_are(city: _City, catalogue: Catalogue, register: Path) -> None:
    counts = city.values["species_count"]
    over = np.ceil(counts - ROUNDING_TOLERATED) > len(catalogue)
    if over.any():
        raise ConfigError(
            "a lot asks for more species than the city has",
            where=f"{register}, layer 'parameters'",
            found=f"species_count {counts[over][0]:g} in lot {city.lot_ids[over][0]} and {int(over.sum()) - 1} others",
            expected=f"at most {len(catalogue)}: {', '.join(catalogue.ids)}",
            next_step="lower species_count, or add species to the folder named by species.folder",
        )


def _lot_keys(city: _City, salt: str) -> list[str]:
    start = hashlib.blake2b(f"{__version__}\x1f{salt}".encode(), digest_size=12)
    keys = []
    for lot_id, print_ in zip(city.lot_ids, city.prints, strict=True):
        digest = start.copy()
        digest.update(str(lot_id).encode("utf-8", "surrogatepass"))
        digest.update(print_)
        keys.append(digest.hexdigest())
    return keys


@dataclass
class _Placed:
    """Plants as arrays: lot (index among all), number in the lot, position, radius, what it is; counts by lot."""

    lot: NDArray[np.int64]
    number: NDArray[np.int64]
    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    seeds: Seeds
    position_count: NDArray[np.int64]
    radius_mean_m: NDArray[np.float64]
    radius_variance_m2: NDArray[np.float64]
    refused: NDArray[np.bool_]
    ids: NDArray[np.object_]


def _batches(city: _City, todo: NDArray[np.int64]) -> Iterator[tuple[str, NDArray[np.int64]]]:
    for name in sorted(set(city.strategy[todo])):
        chosen = todo[city.strategy[todo] == name]
        size = REGIONS_A_BATCH if name == REGION else LOTS_A_BATCH
        for start in range(0, len(chosen), size):
            yield name, chosen[start : start + size]


def _place(
    city: _City,
    todo: NDArray[np.int64],
    config: Config,
    seed: int,
    catalogue: Catalogue,
    workers: int,
    progress: Progress,
) -> _Placed:
    keys = keys_for(seed, STAGE, city.lot_ids)
    settings = config.placement
    names = sorted(set(city.strategy[todo]))
    kernels = {**KERNELS, REGION: (fit_kernel,)}
    announce_compile([kernel for name in names for kernel in kernels.get(name, ())], progress)

    def positions_of(batch: tuple[str, NDArray[np.int64]]) -> Positions:
        name, chosen = batch
        sites = Sites(
            lot_ids=city.lot_ids[chosen],
            keys=keys[chosen],
            lots=city.lots[chosen],
            areas=city.areas[chosen],
            values={parameter: column[chosen] for parameter, column in city.values.items()},
        )
        if len(city.observed):
            sites = city.observed.beside(sites, chosen)
        if name == REGION:
            regions = Regions(city.regions.shapes[chosen], city.regions.coverage[chosen])
            found = fill_regions(sites, regions, settings, config.coverage)
        else:
            found = apart_from_fixed(strategy_named(name)(sites, settings), sites)
        return Positions(chosen[found.site], found.xy, found.radius_m, chosen[found.refused])

    found = []
    ruled = np.flatnonzero(city.strategy != REGION)
    in_waves = settings.conflict == "city" and len(ruled) > 0
    batches = list(_batches(city, todo[city.strategy[todo] == REGION] if in_waves else todo))
    with ThreadPoolExecutor(workers) as pool:
        for done, positions in enumerate(pool.map(positions_of, batches), start=1):
            found.append(positions)
            progress("placing plants", done, len(batches))
    if in_waves:
        every = Sites(lot_ids=city.lot_ids, keys=keys, lots=city.lots, areas=city.areas, values=city.values)
        standing = (
            np.concatenate([city.observed.xy, *(positions.xy for positions in found)]),
            np.concatenate([city.observed.radius_m, *(positions.radius_m for positions in found)]),
        )
        found.append(place_in_waves(every, city.strategy, settings, progress, only=ruled, standing=standing))
    return _planted(city, found, city.observed.of_lots(todo), config, seed, catalogue)


def _planted(
    city: _City, found: list[Positions], known: Observed, config: Config, seed: int, catalogue: Catalogue
) -> _Placed:
    site = np.concatenate([np.zeros(0, dtype=np.int64), *(positions.site for positions in found)])
    order = np.argsort(site, kind="stable")
    site = site[order]
    xy = np.concatenate([np.zeros((0, 2)), *(positions.xy for positions in found)])[order]
    radius = np.concatenate([np.zeros(0), *(positions.radius_m for positions in found)])[order]
    number = index_within(site)
    count = len(city.lot_ids)
    position_count = np.bincount(site, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(site, radius, minlength=count) / position_count
        variance = np.bincount(site, (radius - mean[site]) ** 2, minlength=count) / (position_count - 1)
    variance[position_count < 2] = np.nan
    thin = kept_by_hash if config.placement.density_law == "hash" else kept_by_count
    density = np.where(city.strategy == REGION, 1.0, city.values["density"])  # the map's gaps are counted already
    kept = thin(site, keys_for(seed, "density", city.lot_ids), density)
    site, number, xy, radius = site[kept], number[kept], xy[kept], radius[kept]
    ids = [f"{city.lot_ids[lot]}-{index}" for lot, index in zip(site, number.tolist(), strict=True)]
    ids += [f"observed:{name}" for name in known.ids]
    order = np.argsort(np.concatenate((site, known.lot)), kind="stable")
    site, number = np.concatenate((site, known.lot))[order], np.concatenate((number, known.numbers()))[order]
    xy, radius = np.concatenate((xy, known.xy))[order], np.concatenate((radius, known.radius_m))[order]
    seeds = draw_seeds(
        site,
        number,
        keys_for(seed, "seeds", city.lot_ids),
        city.values,
        radius,
        catalogue,
        dominant=config.species.dominant,
    )
    mapped = np.flatnonzero(city.strategy[site] == REGION)
    if len(mapped):
        seeds = as_wide_as_seen(seeds, mapped, site, keys_for(seed, "seeds", city.lot_ids), xy, radius, catalogue)
    if len(known):
        seeds = _as_observed(seeds, np.argsort(order)[-len(known) :], known, catalogue)
    refused = np.zeros(count, dtype=bool)
    refused[np.concatenate([np.zeros(0, dtype=np.int64), *(positions.refused for positions in found)])] = True
    position_count = position_count + np.bincount(known.lot, minlength=count)
    return _Placed(
        site, number, xy, radius, seeds, position_count, mean, variance, refused, np.array(ids, dtype=object)[order]
    )


def _as_observed(seeds: Seeds, rows: NDArray[np.int64], observed: Observed, catalogue: Catalogue) -> Seeds:
    """Give known plants their species, and the age at which one of it is as high, where these are known."""
    species, age_years = seeds.species.copy(), seeds.age_years.copy()
    species[rows] = np.where(observed.species >= 0, observed.species, species[rows])
    lifespan_years = np.array([kind.lifespan_years for kind in catalogue], dtype=np.float64)
    known = age_at_height(observed.height_m, species[rows], catalogue)
    age_years[rows] = np.where(np.isfinite(known), known, np.minimum(age_years[rows], lifespan_years[species[rows]]))
    return replace(seeds, species=species, age_years=age_years)


def _frames(
    city: _City, placed: _Placed, todo: NDArray[np.int64], catalogue: Catalogue, working: CRS
) -> tuple[gpd.GeoDataFrame, pd.DataFrame]:
    kinds = list(catalogue)
    names = np.array([kind.id for kind in kinds], dtype=object)
    habits = np.array([kind.habit for kind in kinds], dtype=object)
    lot_ids = city.lot_ids[placed.lot]
    xy = reproject_xy(placed.xy, working, city.crs)
    plants = gpd.GeoDataFrame(
        {
            "plant_id": placed.ids,
            "lot_id": lot_ids,
            "species": names[placed.seeds.species],
            "habit": habits[placed.seeds.species],
            "age_years": np.round(placed.seeds.age_years, 2),
            "envelope_radius_m": np.floor(placed.radius_m * 1e4) / 1e4,  # down, so that no two come to overlap
            "pruning_factor": placed.seeds.pruning_factor,
        },
        geometry=shapely.points(xy),
        crs=city.crs,
    )
    plant_count = np.bincount(placed.lot, minlength=len(city.lot_ids))
    dominant = names[placed.seeds.dominant]
    dominant[plant_count == 0] = None
    outcome = np.select(
        [placed.refused, placed.position_count == 0, plant_count == 0],
        ["too_many_plants", "no_position", "thinned"],
        "planted",
    ).astype(object)
    placements = pd.DataFrame(
        {
            "lot_id": city.lot_ids[todo],
            "outcome": outcome[todo],
            "position_count": placed.position_count[todo],
            "plant_count": plant_count[todo],
            "radius_mean_m": placed.radius_mean_m[todo],
            "radius_variance_m2": placed.radius_variance_m2[todo],
            "dominant_species": dominant[todo],
            "place_key": city.lot_keys[todo],
        }
    )
    return plants, placements


@dataclass
class _Kept:
    plants: gpd.GeoDataFrame
    placements: pd.DataFrame


def _previous_plants(register: Path, city: _City) -> _Kept | None:
    """Return the plants of lots whose key is the one of an earlier run."""
    if not register.exists() or not {"plants", "placements"} <= set(layer_names(register)):
        return None
    try:
        placements = read_layer(register, "placements", geometry=False)
        plants = read_layer(register, "plants")
    except SchemaError:  # another version's, or changed by hand: what is about to be written again is no fault
        return None
    now = pd.Series(city.lot_keys, index=city.lot_ids)
    same = placements["lot_id"].map(now).to_numpy() == placements["place_key"].to_numpy()
    stored = placements["lot_id"].map(plants["lot_id"].value_counts()).fillna(0)
    same &= stored.to_numpy() == placements["plant_count"].to_numpy()  # none lost or added by hand since
    placements = placements[same]
    if placements.empty:
        return None
    return _Kept(plants[plants["lot_id"].isin(placements["lot_id"])], placements)


def _joined(
    city: _City, kept: _Kept, plants: gpd.GeoDataFrame, placements: pd.DataFrame
) -> tuple[gpd.GeoDataFrame, pd.DataFrame]:
    """Put reused and fresh lots together in the order a full run would have."""
    order = pd.Series(np.arange(len(city.lot_ids)), index=city.lot_ids)
    columns = list(plants.columns)
    old = kept.plants[columns]
    every = pd.concat([old.set_crs(plants.crs, allow_override=True), plants], ignore_index=True) if len(plants) else old
    rows = pd.concat([kept.placements[placements.columns], placements], ignore_index=True) if len(placements) else (
        kept.placements[placements.columns]
    )  # fmt: skip
    every = every.iloc[np.argsort(order[every["lot_id"]].to_numpy(), kind="stable")]
    rows = rows.iloc[np.argsort(order[rows["lot_id"]].to_numpy(), kind="stable")]
    return gpd.GeoDataFrame(every.reset_index(drop=True), crs=plants.crs), rows.reset_index(drop=True)


def _skipped(register: Path, placements: pd.DataFrame) -> pd.DataFrame:
    before = read_layer(register, "skipped", geometry=False)
    bare = placements[placements["outcome"] != "planted"]
    reason = bare["outcome"].to_numpy(dtype=object)
    rows = pd.DataFrame(
        {
            "lot_id": bare["lot_id"].to_numpy(dtype=object),
            "stage": STAGE,
            "reason": reason,
            "detail": [SKIP_REASONS[code] for code in reason],
        }
    )
    others = before[before["stage"] != STAGE]
    return pd.concat([others, rows], ignore_index=True) if len(others) else rows
