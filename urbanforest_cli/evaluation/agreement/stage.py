"""A coverage map and crowns in, their agreement out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.coverage_model import CANOPY
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.evaluation.agreement.scores import CoverageAgreement, score_agreement
from urbanforest_cli.evaluation.agreement.sets import (
    PLACED,
    RANDOM,
    RULES,
    SHUFFLED,
    CrownsOfLots,
    random_crowns,
    shuffled_crowns,
)
from urbanforest_cli.evaluation.agreement.tally import KERNELS, tally
from urbanforest_cli.evaluation.compare import open_ground
from urbanforest_cli.files.coverage_windows import MetricCoverage


def judge_coverage(
    path: Path,
    ids: NDArray[np.object_],
    lots: NDArray[np.object_],
    placed: CrownsOfLots,
    *,
    working: CRS,
    settings: Mapping[str, object],
    crowns: str,
    rules: CrownsOfLots | None = None,
    buildings: NDArray[np.object_] | None = None,
    seed: int = 0,
    assume_crs: str | None = None,
    notices: Notices,
    progress: Progress = silent,
) -> CoverageAgreement:
    """Hold crowns against a coverage map, beside crowns that know less.

    Parameters
    ----------
    path
        Of the map, in any CRS and resolution.
    ids, lots
        (lots,) names and polygons in metres.
    placed, rules
        The crowns that are judged, and those placed without the map, of the same lots.
    working
        CRS of all of them.
    settings
        Section ``coverage`` of the config that the lots were cut with, if it names band, threshold or cell.
    crowns
        What the radii are, in words.
    buildings
        Polygons in metres, kept free by crowns at random.

    Raises
    ------
    InputError
        No map, or none of the lots' ground.
    """
    announce_compile(KERNELS, progress)
    sets = {PLACED: placed}
    if rules is not None:
        sets[RULES] = rules
    sets[SHUFFLED] = shuffled_crowns(placed, lots, ids, seed)
    sets[RANDOM] = random_crowns(placed, open_ground(lots, buildings), ids, seed)
    with MetricCoverage(
        path,
        working=working,
        band=str(settings.get("band") or CANOPY),
        threshold_percent=_number(settings.get("threshold_percent")),
        resolution_m=_number(settings.get("resolution_m")),
        assume_crs=assume_crs,
        notices=notices,
    ) as coverage:
        areas = tally(
            lots, sets, coverage.read, cell_m=coverage.resolution_m, threshold_percent=coverage.threshold_percent,
            bounds_m=coverage.bounds_m, progress=progress,
        )  # fmt: skip
        bounds, threshold, cell_m = coverage.bounds_m, coverage.threshold_percent, coverage.resolution_m
    if not (areas.known_m2 > 0).any():
        raise InputError(
            "the map knows nothing of the lots",
            where=path,
            found=f"a map of {_extent(bounds)}",
            expected=f"one of the register's lots, {_extent(shapely.total_bounds(lots))}",
            next_step="check that both are of the same place, and the CRS of the map (--assume-crs)",
        )
    plants = {name: np.bincount(one.plants.lot[one.radius_m > 0], minlength=len(lots)) for name, one in sets.items()}
    found = score_agreement(
        areas, plants, rng_for(seed, "evaluate", "coverage"), crowns=crowns, threshold_percent=threshold, cell_m=cell_m
    )
    notices.add("W_LOTS_UNSEEN", "lots of which the map knows less than half, not compared with it", found.lots_unknown)
    return found


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _extent(bounds: tuple[float, float, float, float] | NDArray[np.float64]) -> str:
    west, south, east, north = bounds
    return f"x {west:.0f} to {east:.0f} m, y {south:.0f} to {north:.0f} m"
