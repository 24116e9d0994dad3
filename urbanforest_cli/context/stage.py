"""The stage ``diffuse``: resolved values of a register to values in force."""

from __future__ import annotations

import time
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.context.diffusion import KERNELS, diffuse
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.regressed import Overlay, overlay
from urbanforest_cli.core.schema import RESOLVED_PREFIX
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.provenance import (
    Record,
    note_settled_config,
    provenance_frame,
    read_records,
    require_record,
    stage_key,
)

STAGE = "diffuse"
LATER_STAGES = ("place", "grow", "export")


def diffuse_key(before: str, *, config: Config, seed: int) -> str:
    """Return the hash of all that decides this stage's result, `before` being the key of the stage before it."""
    return stage_key(STAGE, config=config, seed=seed, inputs=[before], sections=("context",))


def diffuse_parameters(register: Path, *, config: Config, seed: int, progress: Progress = silent) -> StageSummary:
    """Let the lots of a register share their parameters with the lots around them.

    Reads layers ``lots``, ``parameters`` (the ``resolved_`` columns, so that it can be run again) and, after
    ``regress``, ``regressed``; writes ``parameters`` and one provenance record, and drops the records of later stages.
    Every lot with a geometry takes part, also those that cannot be planted: they are part of the context. A lot
    without one keeps its values, and so does a sketch, which a person drew. Values read off coverage stay too, for
    they rest on the very place. Neighbours hear of what stays, but it does not give way to them.

    Raises
    ------
    SchemaError
        A layer is missing or breaks its requirements; the text names the command that writes it.
    """
    started = time.perf_counter()
    stencil = require_record(register, "stencil")
    before = read_records(register).get("regress", stencil)
    lots = read_layer(register, "lots")
    parameters = read_layer(register, "parameters", geometry=False)
    centres, zones = _places(lots, parameters["lot_id"], stencil.working_crs)
    notices = Notices()
    note_settled_config(stencil, config, notices)
    placeless = np.flatnonzero(~np.isfinite(centres).all(axis=1))
    examples = parameters["lot_id"].iloc[placeless[:5]]
    notices.add("W_NO_CONTEXT", "lots without a place keep their own values", len(placeless), examples)
    announce_compile(KERNELS, progress)
    strategies = parameters["strategy"].to_numpy(dtype=object)
    resolved = {name: parameters[RESOLVED_PREFIX + name].to_numpy(dtype=np.float64) for name in PARAMETERS}
    start = Overlay(resolved, {name: np.zeros(len(parameters), dtype=bool) for name in PARAMETERS})
    if before is not stencil:
        regressed = read_layer(register, "regressed", geometry=False)
        start = overlay(parameters["lot_id"].to_numpy(dtype=object), resolved, regressed, seed=before.seed)
    diffused = diffuse(
        centres,
        start.values,
        lot_ids=parameters["lot_id"].to_numpy(dtype=object),
        strategies=strategies,
        seed=seed,
        passes=config.context.passes,
        sigma_fraction=config.context.sigma_fraction,
        scopes={"all": None, "zone": zones, "strategy": strategies}[config.context.scope],
        progress=progress,
    )
    changed = np.zeros(len(parameters), dtype=bool)
    drawn = parameters["source"].to_numpy(dtype=object) == "sketch"
    for name, found in diffused.values.items():
        column = np.where(drawn | start.read[name], start.values[name], found)
        parameters[name] = column
        changed |= column != start.values[name]
    parameters["context_lot_count"] = diffused.lot_count
    counts: dict[str, int | float | str] = {
        "lots": len(parameters),
        "lots_changed": int(changed.sum()),
        "passes": config.context.passes,
        "mean_context_lots": float(diffused.lot_count.mean()) if len(parameters) else 0.0,
    }
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=diffuse_key(before.stage_key, config=config, seed=seed),
        working_crs=stencil.working_crs,
        config=config.model_dump(mode="json", include={"context"}),
        inputs=[{"name": before.stage, "stage_key": before.stage_key}],
        counts=dict(counts),
        notices=notices,
    )
    provenance = provenance_frame(register, record, drop=LATER_STAGES)
    write_layers(register, {"parameters": parameters, "provenance": provenance})
    return StageSummary(STAGE, register, counts, notices, time.perf_counter() - started)


def _places(
    lots: gpd.GeoDataFrame, lot_ids: pd.Series[str], working: CRS
) -> tuple[NDArray[np.float64], NDArray[np.object_]]:
    """Return the centroid in the working CRS and the zone of each lot asked for; NaN and "" where there is none."""
    centroids = shapely.centroid(reproject(lots.geometry.to_numpy(), lots.crs, working))
    rows = pd.Index(lots["lot_id"]).get_indexer(pd.Index(lot_ids))
    known = rows >= 0
    centres = np.full((len(lot_ids), 2), np.nan)
    centres[known, 0] = shapely.get_x(centroids)[rows[known]]
    centres[known, 1] = shapely.get_y(centroids)[rows[known]]
    zones = np.full(len(lot_ids), "", dtype=object)
    zones[known] = lots["zone"].to_numpy(dtype=object)[rows[known]]
    return centres, zones
