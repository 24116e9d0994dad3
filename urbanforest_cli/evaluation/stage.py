"""``evaluate``: a register and a file of real plants in, an evaluation and perhaps a plot out."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.evaluation.compare import compare_plants
from urbanforest_cli.evaluation.references import KERNELS
from urbanforest_cli.evaluation.results import Evaluation, PlantsOfLots
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.provenance import require_record
from urbanforest_cli.files.vectors import list_vector_layers, read_vector, split_source

PNG_HEAD = b"\x89PNG\r\n\x1a\n"
OBSERVED_LAYER, BUILDINGS_LAYER = "observed_plants", "buildings"
ORIGINS = ("sketch", "register", "road")  # a plant in two lots belongs to the first of these


@dataclass
class EvaluationSummary(StageSummary):
    """Counts, warnings and the evaluation itself."""

    evaluation: Evaluation | None = field(default=None, repr=False)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        found = self.evaluation.as_record() if self.evaluation is not None else None
        return {**super().as_record(), "evaluation": found}


def evaluate_register(
    register: Path,
    *,
    observed: str,
    buildings: str | None = None,
    replicate: Path | None = None,
    plot: Path | None = None,
    seed: int = 0,
    min_plants: int = 5,
    max_lots: int = 2000,
    assume_crs: str | None = None,
    progress: Progress = silent,
) -> EvaluationSummary:
    """Judge the plants of a register against real ones.

    Reads layers ``lots`` and ``plants``; writes nothing into the register.

    Parameters
    ----------
    register
        With its plants placed.
    observed, buildings
        ``FILE`` or ``FILE:LAYER``. Layers ``observed_plants`` and ``buildings`` are taken where none is named;
        buildings come from the file of the observed plants if it holds such a layer, else there are none.
    replicate
        Register of the same city under another seed; halves of the model's plants stand in where there is none.
    plot
        PNG to write.
    seed
        Root of the streams of thinning, references and tests.
    min_plants, max_lots
        Which lots' patterns are compared, see `compare_plants`.
    assume_crs
        CRS of observed plants that state none.
    progress
        Told what is being done.

    Raises
    ------
    SchemaError
        The register has no plants yet; the text names the command that places them.
    InputError
        A file cannot be read, or no observed plant lies in a lot.
    """
    if plot is not None:
        refuse_plot_over(plot)
    started = time.perf_counter()
    notices = Notices()
    working = require_record(register, "stencil").working_crs
    require_record(register, "place")
    lots = _lots(register, working)
    model = _placed(register, lots, working, notices)
    again = _placed(replicate, lots, working, notices) if replicate is not None else None
    real = _observed(observed, lots, working, assume_crs, notices)
    walls = _buildings(buildings, observed, working, notices)
    announce_compile(KERNELS, progress)
    evaluation = compare_plants(
        lots.ids,
        lots.polygons,
        model=model,
        real=real,
        buildings=walls,
        replicate=again,
        seed=seed,
        min_plants=min_plants,
        max_lots=max_lots,
        progress=progress,
    )
    notices.add("W_LOT_TOO_LARGE", "lots with too many plants to compare their pattern", evaluation.lots_too_large)
    if plot is not None:
        _write_plot(plot, evaluation, f"{register.name} against {Path(split_source(observed)[0]).name}")
    counts: dict[str, int | float | str] = {
        "lots": evaluation.counts.lots,
        "lots_with_real": evaluation.counts.lots_with_real,
        "lots_compared": evaluation.lots_compared,
        "observed_plants": evaluation.counts.real,
        "placed_plants": evaluation.counts.model,
    }
    return EvaluationSummary(
        stage="evaluate",
        output=plot or register,
        counts=counts,
        notices=notices,
        seconds=time.perf_counter() - started,
        evaluation=evaluation,
    )


@dataclass(frozen=True)
class _Lots:
    ids: NDArray[np.object_]
    polygons: NDArray[np.object_]
    index: pd.Index[str]


def _lots(register: Path, working: CRS) -> _Lots:
    """Read the lots that have a geometry, sorted by who owns a plant that lies in several."""
    frame = read_layer(register, "lots")
    polygons = reproject(frame.geometry.to_numpy(), _crs_of(frame), working)
    usable = ~(shapely.is_missing(polygons) | shapely.is_empty(polygons))
    rank = frame["origin"].map({name: i for i, name in enumerate(ORIGINS)}).fillna(len(ORIGINS)).to_numpy()
    ids = frame["lot_id"].to_numpy(dtype=object)
    order = np.lexsort((ids.astype(str), rank))
    order = order[usable[order]]
    return _Lots(ids[order], polygons[order], pd.Index(ids[order]))


def _placed(register: Path, lots: _Lots, working: CRS, notices: Notices) -> PlantsOfLots:
    frame = read_layer(register, "plants")
    points = reproject(frame.geometry.to_numpy(), _crs_of(frame), working)
    lot = lots.index.get_indexer(pd.Index(frame["lot_id"]))
    strange = np.flatnonzero(lot < 0)
    notices.add("W_PLANT_WITHOUT_LOT", "placed plants whose lot is not in the register", len(strange),
                frame["lot_id"].iloc[strange[:5]])  # fmt: skip
    known = lot >= 0
    return PlantsOfLots(shapely.get_coordinates(points[known]), lot[known].astype(np.int64))


def _observed(source: str, lots: _Lots, working: CRS, assume_crs: str | None, notices: Notices) -> PlantsOfLots:
    frame = _read(source, OBSERVED_LAYER, ("point",), assume_crs, notices)
    whole = frame.geometry.to_numpy()
    whole = whole[~(shapely.is_missing(whole) | shapely.is_empty(whole))]
    notices.add("W_OBSERVED_EMPTY", "observed plants without a position", len(frame) - len(whole))
    parts = reproject(shapely.get_parts(whole), _crs_of(frame), working)
    xy = shapely.get_coordinates(parts)
    finite = np.isfinite(xy).all(axis=1)
    notices.add("W_OBSERVED_NOT_FINITE", "observed plants whose position is not a number", int((~finite).sum()))
    xy = xy[finite]
    lot = assign_to_lots(xy, lots.polygons)
    outside = int((lot < 0).sum())
    if len(xy) == 0 or outside == len(xy):
        raise InputError(
            "none of the observed plants lies in a lot",
            where=source,
            found=f"{len(xy)} positions, {_extent(xy)}",
            expected=f"some within the register's lots, {_extent(shapely.get_coordinates(lots.polygons))}",
            next_step="check that both are of the same place, and the CRS of the observed plants (--assume-crs)",
        )
    notices.add("W_OBSERVED_OUTSIDE", "observed plants in no lot", outside)
    twins = len(xy) - len(np.unique(xy, axis=0))
    notices.add("W_OBSERVED_TWINS", "observed plants at the very place of another", twins)
    return PlantsOfLots(xy[lot >= 0], lot[lot >= 0])


def assign_to_lots(xy: NDArray[np.float64], lots: NDArray[np.object_]) -> NDArray[np.int64]:
    """Return for each point the first lot it lies in, -1 for none.

    Parameters
    ----------
    xy
        (n, 2) positions.
    lots
        Polygons in the CRS of the positions, the owner of a shared place first.
    """
    found = np.full(len(xy), len(lots), dtype=np.int64)
    point, lot = shapely.STRtree(lots).query(shapely.points(xy), predicate="intersects")
    np.minimum.at(found, point, lot)
    return np.where(found < len(lots), found, -1)


def refuse_plot_over(plot: Path) -> None:
    """Refuse to write a picture under another kind of name, or over what is no picture."""
    if plot.suffix.lower() != ".png":
        raise InputError("the plot is a PNG", where=plot, expected="a name that ends in .png")
    if plot.exists() and (not plot.is_file() or not plot.read_bytes()[:8] == PNG_HEAD):
        raise OutputExistsError("there is a file already, and no picture", where=plot, next_step="name another")


def _buildings(source: str | None, observed: str, working: CRS, notices: Notices) -> NDArray[np.object_] | None:
    if source is None:
        path, _ = split_source(observed)
        if BUILDINGS_LAYER not in dict(list_vector_layers(path)):
            notices.add("W_NO_BUILDINGS", "no buildings known, distances to them are left out", 1, [path.name])
            return None
        source = f"{path}:{BUILDINGS_LAYER}"
    frame = _read(source, BUILDINGS_LAYER, ("polygon",), None, notices)
    shapes = frame.geometry.to_numpy()
    # Rows without a geometry have bounds that are not numbers either.
    shapes = shapes[np.isfinite(shapely.bounds(shapes)).all(axis=1)]
    shapes = reproject(shapes, _crs_of(frame), working)
    broken = ~shapely.is_valid(shapes)
    shapes[broken] = shapely.make_valid(shapes[broken])
    return shapes


def _read(
    source: str, layer: str, kinds: Collection[str], assume_crs: str | None, notices: Notices
) -> gpd.GeoDataFrame:
    path, named = split_source(source)
    if named is None and layer in dict(list_vector_layers(path)):
        named = layer
    frame = read_vector(path, layer=named, columns=(), kinds=kinds, assume_crs=assume_crs, notices=notices)
    dimension = {"point": 0, "line": 1, "polygon": 2}
    there = shapely.get_dimensions(frame.geometry.to_numpy())
    if (there >= 0).any() and not np.isin(there[there >= 0], [dimension[kind] for kind in kinds]).any():
        raise InputError(
            f"no {' or '.join(kinds)} in this layer",
            where=source,
            found=", ".join(sorted(set(frame.geometry.geom_type.dropna()))),
            next_step="name another as FILE:LAYER",
        )
    return frame


def _crs_of(frame: gpd.GeoDataFrame) -> CRS:
    return CRS.from_user_input(frame.crs)


def _extent(xy: NDArray[np.float64]) -> str:
    if len(xy) == 0:
        return "nowhere"
    (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
    return f"x {west:.0f} to {east:.0f} m, y {south:.0f} to {north:.0f} m"


def _write_plot(path: Path, evaluation: Evaluation, title: str) -> None:
    from urbanforest_cli.evaluation.plot import draw_evaluation

    figure = draw_evaluation(evaluation, title)
    with publish(path) as part:
        figure.savefig(part, format="png", metadata={"Software": None})
