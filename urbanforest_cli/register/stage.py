"""Make a register from a city: files in, files out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import OutputExistsError, PartlyDoneError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.city import KINDS, city_inputs, inputs_beside, read_city, read_known_plants
from urbanforest_cli.files.coverage import open_coverage
from urbanforest_cli.files.coverage_windows import MetricCoverage
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.painted import is_painting, read_painting
from urbanforest_cli.files.provenance import Record, stage_key
from urbanforest_cli.files.vector_formats import vector_format
from urbanforest_cli.files.vectors import read_vector
from urbanforest_cli.register.covered import Filled, fill_from_map, fill_from_paint, nothing_filled, only, owners_of
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
from urbanforest_cli.register.lots import Lots, clean_lots, refuse_doubles
from urbanforest_cli.register.observed import observed_plants_of
from urbanforest_cli.register.packed import give_back
from urbanforest_cli.register.painted import painted_sketches
from urbanforest_cli.register.plantable import Taken
from urbanforest_cli.register.refusals import note_what_is_missing, refuse_apart
from urbanforest_cli.register.regions import KERNELS as REGION_KERNELS
from urbanforest_cli.register.regions import CoveredMap
from urbanforest_cli.register.resolve import resolve_parameters
from urbanforest_cli.register.streets import Roads, Strips
from urbanforest_cli.register.tables import OnDemand, counts_of, tables_of
from urbanforest_cli.register.units import (
    STAGE,
    Units,
    ground_of,
    ground_taken,
    joined,
    sketch_units,
    skipped_units,
    street_units,
    usable_units,
)

SHARE_SPEAKS_FROM = 20
DEFAULT_MAX_BAD_FRACTION = 0.1


def stencil_key(
    city: Path,
    *,
    config: Config,
    seed: int,
    assume_crs: str | None = None,
    lots_layer: str | None = None,
    coverage: Path | None = None,
    sketch: Path | None = None,
    sketch_grid: RasterGrid | None = None,
    keep_observed: bool = False,
) -> str:
    """Return the hash of all that decides this stage's result.

    Raises
    ------
    InputError
        The city is not a file that is read.
    """
    inputs = [f"{item['name']} {item['sha256']}" for item in city_inputs(city)]
    inputs += [f"assume_crs={assume_crs}", f"layer={lots_layer}"]
    for what, path in (("coverage", coverage), ("sketch", sketch)):
        if path is not None:
            inputs += [f"{what} {item['name']} {item['sha256']}" for item in inputs_beside(path)]
    if keep_observed:
        inputs.append("keep_observed")
    filled = coverage is not None or (sketch is not None and is_painting(sketch))
    if sketch_grid is not None and sketch is not None and is_painting(sketch):
        inputs.append(f"sketch_grid={sketch_grid.width_px} {sketch_grid.height_px} {sketch_grid.transform} "
                      f"{sketch_grid.crs.to_wkt()}")  # fmt: skip
    sections = ("rules", "zones", *(["coverage"] if filled else []))
    return stage_key(STAGE, config=config, seed=seed, inputs=inputs, sections=sections)


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
    coverage: Path | None = None,
    sketch: Path | None = None,
    sketch_grid: RasterGrid | None = None,
    keep_observed: bool = False,
    progress: Progress = silent,
) -> StageSummary:
    """Make a register from a city: clean lots, the ground where plants may stand, and each lot's parameters.

    Reads layer ``lots`` (or the only polygon layer of a file without one) and, where they are, ``buildings``,
    ``roads``, ``driveways``, ``entrances``, ``obstacles`` and ``sketches``. Writes a fresh register with ``lots``,
    ``active_areas``, ``regions``, ``parameters``, ``buildings``, ``roads``, ``skipped`` and ``provenance``, in the CRS
    of the lots. Every row of ``lots`` is either in ``active_areas`` or, with a reason, in ``skipped``, or it holds
    known plants; buildings outside all lots are kept.

    With a map, lots that it knows are filled from it (paper, section Learning Plant Placements): their active areas
    are the ground under its vegetation where stems may stand, and ``regions`` has the vegetation itself.

    Parameters
    ----------
    city, register
        Read, and written.
    coverage
        A coverage map, of any resolution, extent and CRS.
    sketch
        Polygons, or a picture in which vegetation is painted; in place of the city's own sketches.
    sketch_grid
        Place of a picture that states none and has its size in pixels; that of the map if None.
    keep_observed
        Write plants of the city's layer ``observed_plants`` to ``observed``, to be kept as they are.

    Raises
    ------
    InputError
        The city cannot be used: no lots, ids that are missing or repeated, parameters outside their limits. The map
        or the sketch cannot, or the map overlaps no lot.
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
    key = stencil_key(
        city, config=config, seed=seed, assume_crs=assume_crs, lots_layer=lots_layer, coverage=coverage, sketch=sketch,
        keep_observed=keep_observed, sketch_grid=sketch_grid,
    )  # fmt: skip
    progress("reading the city", 0, 1)
    frame, layers = read_city(city, assume_crs, lots_layer, notices)
    frame = gpd.GeoDataFrame(plain_columns(frame, LOT_COLUMNS, f"{city} layer 'lots'"), crs=frame.crs)
    known = read_known_plants(city, assume_crs or frame.crs, notices) if keep_observed else None
    if sketch is not None:
        layers["sketches"] = _sketches(sketch, sketch_grid, coverage, assume_crs, frame.crs, config, notices)
    shares = _taken_shares(layers, sketch)
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
    note_what_is_missing(around_counts, lots.zones, config, notices, city)
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
    del around
    give_back()
    usable = usable_units(whole, lots.checked)
    filled = nothing_filled(len(whole.ids))
    if coverage is not None:
        filled = _filled_from(
            coverage, whole, usable, streets.strips, taken, buildings, roads, lots, config, assume_crs, workers,
            notices, progress,
        )  # fmt: skip
    fill_from_paint(filled, whole, shares, buildings.shapes, road_surfaces(roads), config.coverage, workers)
    ground = ground.without(filled.decided)
    observed = None
    if known is not None:
        shapes = only(whole.shapes, usable)
        observed = observed_plants_of(
            known, whole.ids, shapes, whole.origins, project=lots.project, working=lots.working, notices=notices
        )
    kept = np.unique(observed["lot_id"].to_numpy(dtype=object)) if observed is not None else np.empty(0, object)
    mapped = filled.decided, filled.reasons, filled.details
    skipped = skipped_units(whole, lots.checked, ground, taken, mapped, kept)

    progress("writing the register", 0, 1)
    known_count = None if observed is None else len(observed)
    counts = counts_of(whole, ground, filled, skipped, len(attributes), known_count) | around_counts
    summary = StageSummary(STAGE, register, counts, notices)
    record = Record(
        stage=STAGE,
        seed=seed,
        stage_key=key,
        working_crs=lots.working,
        config=config.model_dump(mode="json", exclude_none=True),
        inputs=[*city_inputs(city), *(item for path in (coverage, sketch) if path for item in inputs_beside(path))],
        counts=dict(summary.counts),
        notices=notices,
    )
    tables = tables_of(attributes, whole, ground, filled, skipped, buildings, roads, lots)
    if observed is not None:
        known_plants = observed.set_geometry(gpd.GeoSeries(lots.back(observed.geometry.to_numpy()), crs=lots.crs))
        tables["observed"] = lambda: known_plants
    tables["provenance"] = lambda: pd.DataFrame([record.as_row()])
    write_layers(register, OnDemand(tables), fresh=True)
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


def _sketches(
    sketch: Path,
    grid: RasterGrid | None,
    coverage: Path | None,
    assume_crs: str | None,
    crs: Any,
    config: Config,
    notices: Notices,
) -> gpd.GeoDataFrame:
    """Read what a person drew: polygons as they are, or what is painted in a picture as polygons."""
    if not is_painting(sketch):
        return read_vector(sketch, assume_crs=assume_crs or crs, notices=notices)
    if grid is None and coverage is not None:
        with open_coverage(coverage, assume_crs=assume_crs, notices=Notices()) as reader:
            grid = reader.grid
    painting = read_painting(sketch, like=grid, assume_crs=assume_crs, notices=notices)
    least_m2 = config.coverage.smallest_region_m2
    return painted_sketches(painting.percent, painting.grid, least_m2=least_m2, notices=notices, where=sketch)


def _taken_shares(layers: dict[str, gpd.GeoDataFrame], sketch: Path | None) -> dict[str, float]:
    """Take the shares of painted sketches out of their layer; return them by the ids of the units they become."""
    if sketch is None or not is_painting(sketch):
        return {}
    frame = layers["sketches"]
    layers["sketches"] = frame.drop(columns="coverage")
    return {f"sketch:{name}": float(share) for name, share in zip(frame["sketch_id"], frame["coverage"], strict=True)}


def _filled_from(
    coverage: Path,
    whole: Units,
    usable: NDArray[np.bool_],
    strips: Strips,
    taken: Taken,
    buildings: Buildings,
    roads: Roads,
    lots: Lots,
    config: Config,
    assume_crs: str | None,
    workers: int,
    notices: Notices,
    progress: Progress,
) -> Filled:
    """Cut a map into the units that have ground of their own.

    Raises
    ------
    InputError
        The map cannot be used, or overlaps no unit.
    """
    settings = config.coverage
    usable = usable & (whole.origins != "sketch")
    with MetricCoverage(
        coverage, working=lots.working, band=settings.band, threshold_percent=settings.threshold_percent,
        resolution_m=settings.resolution_m, assume_crs=assume_crs, notices=notices,
    ) as opened:  # fmt: skip
        refuse_apart(opened.bounds_m, whole.shapes[usable], coverage)
        announce_compile(REGION_KERNELS, progress)
        return fill_from_map(
            whole,
            usable,
            owners_of(whole, strips),
            CoveredMap(opened.read, opened.resolution_m, opened.threshold_percent),
            taken,
            buildings.shapes,
            road_surfaces(roads),
            settings,
            notices,
            workers,
            progress,
        )
