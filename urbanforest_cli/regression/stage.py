"""The stage ``regress``: what the coverage of each lot says of its parameters, files in, files out."""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.lot_windows import Surroundings, lot_windows
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.parameter_model import STRATEGIES_READ, ParameterModelInfo
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.regressed import overlay
from urbanforest_cli.core.schema import ORIGIN_SUFFIX, REGRESSED, RESOLVED_PREFIX, SPREAD_SUFFIX
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import layer_names, read_layer, write_layers
from urbanforest_cli.files.parameter_models import ParameterSession, load_parameter_model
from urbanforest_cli.files.provenance import Record, note_settled_config, provenance_frame, require_record, stage_key
from urbanforest_cli.regression.evidence import Evidence, joined, without_the_unknowable
from urbanforest_cli.regression.fallback import MAP, NEIGHBOURHOOD, OWN, ZONE, Settled, settle
from urbanforest_cli.regression.model_fit import refuse_other_version
from urbanforest_cli.regression.pooling import Pooled, pool
from urbanforest_cli.regression.pooling_kernel import KERNELS
from urbanforest_cli.regression.reading import Network, bare_shares, ranges_of, read_windows

STAGE = "regress"
LATER_STAGES = ("diffuse", "place", "grow", "export")
LOTS_A_BATCH = 512
Shapes = NDArray[Any]


def regress_key(before: str, *, config: Config, seed: int, model_sha256: str) -> str:
    """Return the hash of all that decides this stage's result, `before` being the key of the stage before it."""
    inputs = [before, model_sha256, f"seen_least={config.coverage.seen_least}"]
    return stage_key(STAGE, config=config, seed=seed, inputs=inputs, sections=("regression",))


def regress_register(
    register: Path,
    *,
    model: Path | None = None,
    config: Config,
    seed: int,
    workers: int = 1,
    progress: Progress = silent,
) -> StageSummary:
    """Read parameters of placement off the coverage of each lot, and say how sure they are.

    Reads layers ``lots``, ``regions``, ``buildings`` and ``parameters``; writes ``regressed`` and ``parameters``, in
    which values that rest on the map or on the neighbourhood (`regression.fallback`) are in force, and one provenance
    record; drops the records of later stages. Resolved values are read, so that it can be run again. Lots that the map
    does not know hear what their neighbourhood says. Sketches and values of a lot's own columns stay. The strategy
    that the coverage looks like is written down and changes nothing: regions take the place of a strategy (paper,
    section Learning Plant Placements). The result is the same for any number of workers.

    Parameters
    ----------
    model
        Parameter model; the one that comes with the program by default.

    Raises
    ------
    InputError
        The register was made without a coverage map, or the model cannot be used or is for another version.
    SchemaError
        A layer is missing or breaks its requirements; the text names the command that writes it.
    """
    started = time.perf_counter()
    stencil = require_record(register, "stencil")
    lots, parameters, regions = _read(register)
    loaded = load_parameter_model(model)
    refuse_other_version(loaded.info, loaded.path)
    notices = Notices()
    note_settled_config(stencil, config, notices)
    announce_compile(KERNELS, progress)
    shapes = reproject(lots.geometry.to_numpy(), CRS.from_user_input(lots.crs), stencil.working_crs)
    ranges = ranges_of(loaded.info)
    drawn = lots["origin"].to_numpy(dtype=object) == "sketch"
    seen = ~drawn & (lots["seen_fraction"].fillna(0.0).to_numpy(dtype=np.float64) >= config.coverage.seen_least)
    evidence = _evidence(
        ParameterSession(loaded.content, loaded.info), loaded.info, _only(shapes, seen),
        _around(regions, stencil.working_crs), _around(read_layer(register, "buildings"), stencil.working_crs), workers,
        progress,
    )  # fmt: skip
    given = parameters[[RESOLVED_PREFIX + name for name in REGRESSED]].to_numpy(dtype=np.float64)
    middles = shapely.centroid(shapes)
    centres = np.column_stack((shapely.get_x(middles), shapely.get_y(middles)))
    pooled = pool(
        centres, lots["zone"].to_numpy(dtype=object), lots["lot_id"].to_numpy(dtype=object), evidence,
        ranges.shares(given), radius_m=config.regression.pooling_radius_m, zone_spread=config.regression.zone_spread,
    )  # fmt: skip
    settled = settle(
        pooled, evidence, given, _own(lots, drawn), ranges,
        known_share=config.regression.known_share, zone_spread=config.regression.zone_spread,
    )  # fmt: skip
    regressed = _frame(lots, evidence, pooled, settled)
    parameters = _in_force(parameters, regressed, lots, drawn, seed)
    counts = _counts(settled, seen)
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=regress_key(stencil.stage_key, config=config, seed=seed, model_sha256=loaded.sha256),
        working_crs=stencil.working_crs,
        config=config.model_dump(mode="json", include={"regression"}),
        inputs=[
            {"name": "stencil", "stage_key": stencil.stage_key},
            {"name": loaded.path.name, "sha256": loaded.sha256},
        ],
        counts=dict(counts),
        notices=notices,
    )
    provenance = provenance_frame(register, record, drop=LATER_STAGES)
    write_layers(register, {"regressed": regressed, "parameters": parameters, "provenance": provenance})
    return StageSummary(STAGE, register, counts, notices, time.perf_counter() - started)


def _read(register: Path) -> tuple[gpd.GeoDataFrame, pd.DataFrame, gpd.GeoDataFrame]:
    """Return the lots that have parameters, their parameters row by row, and the regions."""
    lots = read_layer(register, "lots")
    if "regions" not in layer_names(register) or lots["seen_fraction"].isna().all():
        raise InputError(
            "the register was made without a coverage map",
            where=register,
            expected="lots of which a map knows some share",
            next_step="make it with `urbanforest stencil CITY.gpkg --coverage coverage.tif`",
        )
    regions = read_layer(register, "regions")
    parameters = read_layer(register, "parameters", geometry=False).reset_index(drop=True)
    lots = lots.set_index("lot_id").reindex(parameters["lot_id"]).reset_index()
    return lots.fillna({"zone": ""}), parameters, regions


def _only(shapes: Shapes, chosen: NDArray[np.bool_]) -> Shapes:
    """Return the shapes chosen, None in place of the others."""
    some = np.full(len(shapes), None, dtype=object)
    some[chosen] = shapes[chosen]
    return some


def _around(layer: gpd.GeoDataFrame, working: CRS) -> Surroundings:
    return Surroundings(reproject(layer.geometry.to_numpy(), CRS.from_user_input(layer.crs), working))


def _evidence(
    network: Network,
    info: ParameterModelInfo,
    shapes: Shapes,
    vegetation: Surroundings,
    buildings: Surroundings,
    workers: int,
    progress: Progress,
) -> Evidence:
    """Read what the coverage of lots says; nothing for those without a shape."""
    there = ~shapely.is_missing(shapes)

    def read(start: int) -> Evidence:
        batch = slice(start, start + LOTS_A_BATCH)
        windows = lot_windows(shapes[batch], vegetation, buildings)
        evidence, density = read_windows(network, info, windows, len(shapes[batch]))
        bare = bare_shares(windows, len(shapes[batch]))
        return without_the_unknowable(evidence, seen=there[batch], density_read=density, bare_share=bare)

    parts = []
    with ThreadPoolExecutor(workers) as pool_of_threads:
        for evidence in pool_of_threads.map(read, range(0, len(shapes), LOTS_A_BATCH)):
            parts.append(evidence)
            progress("reading coverage", min(len(parts) * LOTS_A_BATCH, len(shapes)), len(shapes))
    return joined(parts)


def _own(lots: gpd.GeoDataFrame, drawn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which values a person set for that very lot, (lot, parameter)."""
    return np.column_stack([drawn | _given(lots, name) for name in REGRESSED])


def _given(lots: gpd.GeoDataFrame, name: str) -> NDArray[np.bool_]:
    """Tell in which lots a column of the city that sets a parameter is filled in."""
    if name not in lots:
        return np.zeros(len(lots), dtype=bool)
    filled: pd.Series[bool] = lots[name].notna() & (lots[name].astype(str).str.strip() != "")
    return filled.to_numpy()


def _frame(lots: gpd.GeoDataFrame, evidence: Evidence, pooled: Pooled, settled: Settled) -> pd.DataFrame:
    likeliest = evidence.strategy.argmax(axis=1)
    columns: dict[str, Any] = {
        "lot_id": lots["lot_id"].to_numpy(dtype=object),
        "strategy": np.array(STRATEGIES_READ, dtype=object)[likeliest],
        "strategy_share": np.round(evidence.strategy.max(axis=1), 4),
        "visible_plants": evidence.visible,
        "pooled_lots": pooled.heard + evidence.spoke.any(axis=1),
    }
    for suffix, found in (("", settled.values), (SPREAD_SUFFIX, settled.spreads), (ORIGIN_SUFFIX, settled.origins)):
        columns |= {name + suffix: found[:, column] for column, name in enumerate(REGRESSED)}
    return pd.DataFrame(columns)


def _in_force(
    parameters: pd.DataFrame, regressed: pd.DataFrame, lots: gpd.GeoDataFrame, drawn: NDArray[np.bool_], seed: int
) -> pd.DataFrame:
    """Return the layer ``parameters`` with values read off coverage in force, before any diffusion."""
    resolved = {name: parameters[RESOLVED_PREFIX + name].to_numpy(dtype=np.float64) for name in PARAMETERS}
    overlaid = overlay(parameters["lot_id"].to_numpy(dtype=object), resolved, regressed, seed=seed)
    by_lot = np.logical_or.reduce([_given(lots, name) for name in ("strategy", *PARAMETERS)])
    source = np.select([drawn, overlaid.any_read, by_lot], ["sketch", "regressed", "lot"], "zone").astype(object)
    return parameters.assign(source=source, context_lot_count=np.int64(1), **overlaid.values)


def _counts(settled: Settled, seen: NDArray[np.bool_]) -> dict[str, int | float | str]:
    """Count lots and what their values rest on."""
    found = Counter(settled.origins.ravel().tolist())
    return {
        "lots": len(seen),
        "lots_seen": int(seen.sum()),
        "lots_read": int((settled.origins == MAP).any(axis=1).sum()),
        "values_from_map": found[MAP],
        "values_from_neighbourhood": found[NEIGHBOURHOOD],
        "values_from_zone": found[ZONE],
        "values_own": found[OWN],
    }
