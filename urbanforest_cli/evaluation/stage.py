"""``evaluate``: a register, and real plants or a coverage map, in; an evaluation and perhaps a plot out."""

from __future__ import annotations

import io
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from PIL import Image
from pyproj import CRS

from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.evaluation.agreement.scores import CoverageAgreement
from urbanforest_cli.evaluation.agreement.sets import CrownsOfLots
from urbanforest_cli.evaluation.agreement.stage import judge_coverage
from urbanforest_cli.evaluation.compare import compare_plants
from urbanforest_cli.evaluation.references import KERNELS
from urbanforest_cli.evaluation.results import Evaluation, PlantsOfLots
from urbanforest_cli.evaluation.tile_counts import TileCounts, tile_counts
from urbanforest_cli.files.geopackage import layer_names, read_layer
from urbanforest_cli.files.provenance import Record, read_records, require_record
from urbanforest_cli.files.vectors import list_vector_layers, read_vector, split_source

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_HEAD = b"\x89PNG\r\n\x1a\n"
OBSERVED_LAYER, BUILDINGS_LAYER = "observed_plants", "buildings"
SAME_LOT_M, SAME_LOTS_LEAST = 1.0, 0.9
ORIGINS = ("sketch", "register", "road")  # a plant in two lots belongs to the first of these


GROWN, ENVELOPE = "crowns as they grew", "envelopes of placement"


@dataclass
class EvaluationSummary(StageSummary):
    """Counts, warnings and what was found: against real plants, by tile, and against a coverage map."""

    evaluation: Evaluation | None = field(default=None, repr=False)
    tiles: TileCounts | None = field(default=None, repr=False)
    coverage: CoverageAgreement | None = field(default=None, repr=False)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        parts = {"evaluation": self.evaluation, "tiles": self.tiles, "coverage": self.coverage}
        return {**super().as_record(), **{name: part and part.as_record() for name, part in parts.items()}}


def evaluate_register(
    register: Path,
    *,
    observed: str | None = None,
    buildings: str | None = None,
    replicate: Path | None = None,
    tiles: str | None = None,
    coverage: Path | None = None,
    rules: Path | None = None,
    envelopes: bool = False,
    plot: Path | None = None,
    seed: int = 0,
    min_plants: int = 5,
    max_lots: int = 2000,
    assume_crs: str | None = None,
    progress: Progress = silent,
) -> EvaluationSummary:
    """Judge the plants of a register against real ones, against a coverage map, or both.

    Reads layers ``lots`` and ``plants``, ``trees`` and ``buildings``; writes nothing into the register.

    Parameters
    ----------
    register
        With its plants placed.
    observed, buildings, tiles
        ``FILE`` or ``FILE:LAYER``. Layers ``observed_plants`` and ``buildings`` are taken where none is named;
        buildings come from the file of the observed plants if it holds such a layer, else there are none. Tiles are
        polygons in which observed and placed plants are counted.
    replicate
        Register of the same city under another seed; halves of the model's plants stand in where there is none.
    coverage
        Map that crowns are held against.
    rules
        Register of the same city, planted without the map.
    envelopes
        Hold the envelopes of placement against the map, even where plants have grown.
    plot
        PNG to write.
    seed
        Root of the streams of thinning, references and tests.
    min_plants, max_lots
        Which lots' patterns are compared, see `compare_plants`.
    assume_crs
        CRS of observed plants, or of a map, that state none.
    progress
        Told what is being done.

    Raises
    ------
    SchemaError
        The register has no plants yet; the text names the command that places them.
    InputError
        A file cannot be read, no observed plant lies in a lot, or the map knows nothing of the lots.
    """
    if plot is not None:
        refuse_plot_over(plot)
    if observed is None and (coverage is None or tiles is not None):
        raise InputError("nothing to compare with", where=register, expected="observed plants or a coverage map",
                         next_step="name points with --observed, or a map with --coverage")  # fmt: skip
    started = time.perf_counter()
    notices = Notices()
    stencil = require_record(register, "stencil")
    working = stencil.working_crs
    require_record(register, "place")
    if rules is not None:
        require_record(rules, "place")
        refuse_another_city(rules, register)
    lots = register_lots(register, working)
    summary = EvaluationSummary(stage="evaluate", output=plot or register, notices=notices)
    if observed is not None:
        model = placed_plants(register, lots, working, notices)
        real = real_plants(observed, lots, working, assume_crs, notices)
        again = placed_plants(replicate, lots, working, notices) if replicate is not None else None
        walls = _buildings(buildings, observed, working, notices)
        announce_compile(KERNELS, progress)
        found = compare_plants(
            lots.ids, lots.polygons, model=model, real=real, buildings=walls, replicate=again, seed=seed,
            min_plants=min_plants, max_lots=max_lots, progress=progress,
        )  # fmt: skip
        notices.add("W_LOT_TOO_LARGE", "lots with too many plants to compare their pattern", found.lots_too_large)
        summary.evaluation = found
        summary.counts |= {
            "lots": found.counts.lots,
            "lots_with_real": found.counts.lots_with_real,
            "lots_compared": found.lots_compared,
            "observed_plants": found.counts.real,
            "placed_plants": found.counts.model,
        }
        if tiles is not None:
            squares = _polygons(_read(tiles, "", ("polygon",), None, notices), working)
            summary.tiles = tile_counts(squares, real.xy, model.xy)
    if coverage is not None:
        placed, crowns = placed_crowns(register, lots, working, notices, envelopes=envelopes)
        others = None
        if rules is not None:
            others, theirs = placed_crowns(rules, lots, working, notices, envelopes=envelopes)
            if theirs != crowns:
                placed, crowns = placed_crowns(register, lots, working, notices, envelopes=True)
                others, _ = placed_crowns(rules, lots, working, notices, envelopes=True)
        summary.coverage = judge_coverage(
            coverage, lots.ids, lots.polygons, placed, working=working, settings=_coverage_settings(stencil),
            crowns=crowns, rules=others, buildings=_polygons(_layer(register, "buildings"), working), seed=seed,
            assume_crs=assume_crs, notices=notices, progress=progress,
        )  # fmt: skip
        summary.counts |= {
            "lots": len(lots.ids),
            "lots_against_map": summary.coverage.lots_compared,
            "placed_plants": int((placed.radius_m > 0).sum()),
        }
    if plot is not None:
        _write_plot(plot, _figures(summary, register, observed, coverage))
    summary.seconds = time.perf_counter() - started
    return summary


@dataclass(frozen=True)
class RegisterLots:
    """Lots of a register with their ids, the owner of shared ground first; `index` finds an id's row."""

    ids: NDArray[np.object_]
    polygons: NDArray[np.object_]
    index: pd.Index[str]


def register_lots(register: Path, working: CRS) -> RegisterLots:
    """Read the lots that have a geometry, in metres, sorted by who owns a plant that lies in several."""
    frame = read_layer(register, "lots")
    polygons = reproject(frame.geometry.to_numpy(), _crs_of(frame), working)
    usable = ~(shapely.is_missing(polygons) | shapely.is_empty(polygons))
    rank = frame["origin"].map({name: i for i, name in enumerate(ORIGINS)}).fillna(len(ORIGINS)).to_numpy()
    ids = frame["lot_id"].to_numpy(dtype=object)
    order = np.lexsort((ids.astype(str), rank))
    order = order[usable[order]]
    return RegisterLots(ids[order], polygons[order], pd.Index(ids[order]))


def refuse_another_city(other: Path, register: Path) -> None:
    """Refuse a register whose lots lie elsewhere than those of the same ids do: it is of another city.

    Raises
    ------
    InputError
        Fewer than nine in ten of the lots that both have lie within a metre of one another.
    """
    working = require_record(register, "stencil").working_crs
    one, two = register_lots(register, working), register_lots(other, working)
    rows = two.index.get_indexer(one.index)
    both = np.flatnonzero(rows >= 0)
    apart = shapely.distance(shapely.centroid(one.polygons[both]), shapely.centroid(two.polygons[rows[both]]))
    same = int((apart <= SAME_LOT_M).sum())
    if same < SAME_LOTS_LEAST * max(len(both), 1):
        raise InputError(
            "this is a register of another city",
            where=other,
            found=f"{same} lots in common of {len(one.ids)} in {register} and {len(two.ids)} here",
            expected="the same lots, planted otherwise",
        )


def placed_plants(register: Path, lots: RegisterLots, working: CRS, notices: Notices) -> PlantsOfLots:
    """Read the plants of a register that belong to its lots; others are counted."""
    return _rows_of_lots(read_layer(register, "plants"), lots, working, notices)[0]


def placed_crowns(
    register: Path, lots: RegisterLots, working: CRS, notices: Notices, *, envelopes: bool = False
) -> tuple[CrownsOfLots, str]:
    """Read the crowns of a register, and say what their radii are.

    As they grew, 0 where nothing stands; the envelopes of placement where these plants have not grown, where only
    some lots were grown, or where they are asked for.
    """
    plants = read_layer(register, "plants")
    found, known = _rows_of_lots(plants, lots, working, notices)
    radius = plants["envelope_radius_m"].to_numpy(dtype=np.float64)
    trees = None if envelopes else _trees(register, plants["plant_id"])
    if trees is not None:
        left_out = (trees["reason"] == "out_of_focus").to_numpy(dtype=bool)
        radius = np.where(left_out, radius, trees["crown_radius_m"].to_numpy(dtype=np.float64))
        notices.add("W_NOT_GROWN", "plants that were not grown, taken by their envelopes", int(left_out.sum()))
    return CrownsOfLots(found, radius[known]), ENVELOPE if trees is None else GROWN


def _trees(register: Path, plant_ids: pd.Series[Any]) -> pd.DataFrame | None:
    """Read what became of the plants; None where it is not known of those placed last."""
    records = read_records(register)
    placed = {"name": "place", "sha256": records["place"].stage_key}
    if "trees" not in layer_names(register) or "grow" not in records or placed not in records["grow"].inputs:
        return None
    trees = read_layer(register, "trees", geometry=False)
    return trees if trees["plant_id"].tolist() == plant_ids.tolist() else None


def _rows_of_lots(
    plants: gpd.GeoDataFrame, lots: RegisterLots, working: CRS, notices: Notices
) -> tuple[PlantsOfLots, NDArray[np.bool_]]:
    """Return the plants whose lot is known, and which rows they are."""
    points = reproject(plants.geometry.to_numpy(), _crs_of(plants), working)
    lot = lots.index.get_indexer(pd.Index(plants["lot_id"]))
    known = lot >= 0
    strange = np.flatnonzero(~known)
    if "W_PLANT_WITHOUT_LOT" not in notices:  # a register may be read twice
        notices.add("W_PLANT_WITHOUT_LOT", "placed plants whose lot is not in the register", len(strange),
                    plants["lot_id"].iloc[strange[:5]])  # fmt: skip
    return PlantsOfLots(shapely.get_coordinates(points[known]), lot[known].astype(np.int64)), known


def _coverage_settings(stencil: Record) -> Mapping[str, object]:
    """Return the section ``coverage`` that the lots were cut with; empty where no map was."""
    settings = stencil.config.get("coverage")
    return settings if isinstance(settings, dict) else {}


def real_plants(
    source: str, lots: RegisterLots, working: CRS, assume_crs: str | None, notices: Notices
) -> PlantsOfLots:
    """Read real plants from ``FILE`` or ``FILE:LAYER`` and give each to its lot; what is lost is counted.

    Raises
    ------
    InputError
        None of them lies in a lot.
    """
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
    return _polygons(_read(source, BUILDINGS_LAYER, ("polygon",), None, notices), working)


def _layer(register: Path, name: str) -> gpd.GeoDataFrame | None:
    return read_layer(register, name) if name in layer_names(register) else None


def _polygons(frame: gpd.GeoDataFrame | None, working: CRS) -> NDArray[np.object_]:
    """Bring polygons to metres, repaired; rows without a geometry are left out."""
    if frame is None:
        return np.empty(0, dtype=object)
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


def _figures(summary: EvaluationSummary, register: Path, observed: str | None, coverage: Path | None) -> list[Figure]:
    from urbanforest_cli.evaluation.agreement.plot import draw_agreement
    from urbanforest_cli.evaluation.plot import draw_evaluation

    figures = []
    if summary.evaluation is not None and observed is not None:
        title = f"{register.name} against {Path(split_source(observed)[0]).name}"
        figures.append(draw_evaluation(summary.evaluation, title))
    if summary.coverage is not None and coverage is not None:
        figures.append(draw_agreement(summary.coverage, f"{register.name} against {coverage.name}"))
    return figures


def _write_plot(path: Path, figures: Sequence[Figure]) -> None:
    """Write one page, or two under one another."""
    pages = []
    for figure in figures:
        stream = io.BytesIO()
        figure.savefig(stream, format="png", metadata={"Software": None})
        pages.append(Image.open(stream).convert("RGB"))
    whole = Image.new("RGB", (max(page.width for page in pages), sum(page.height for page in pages)), "white")
    top = 0
    for page in pages:
        whole.paste(page, (0, top))
        top += page.height
    with publish(path) as part:
        whole.save(part, format="PNG")
