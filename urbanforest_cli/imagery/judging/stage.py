"""``evaluate-coverage``: a model and pairs, or a map and its truth in; scores, and perhaps a page of pictures, out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from urbanforest_cli.core.coverage_model import CoverageModelInfo
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.coverage import CoverageReader, open_coverage
from urbanforest_cli.files.coverage_models import load_coverage_model
from urbanforest_cli.files.coverage_truth import Percent, Window, open_truth, read_points
from urbanforest_cli.files.vectors import split_source
from urbanforest_cli.imagery.inference import CoverageSession
from urbanforest_cli.imagery.judging import over_map, over_pairs
from urbanforest_cli.imagery.judging.baselines import AllCovered
from urbanforest_cli.imagery.judging.bootstrap import LEVEL, RESAMPLES
from urbanforest_cli.imagery.judging.plots import Panel, draw_judgement, png_of
from urbanforest_cli.imagery.judging.results import Judgement
from urbanforest_cli.imagery.judging.scores import NEAR_PX, TRUTH_LEAST_PERCENT
from urbanforest_cli.imagery.judging.selection import PlacedPairs, select_pairs, unseen
from urbanforest_cli.imagery.pairing.stage import read_pairs
from urbanforest_cli.imagery.pairs import PairLabel, PairSet
from urbanforest_cli.imagery.splits import fits

PNG_HEAD = b"\x89PNG\r\n\x1a\n"
RASTER_SUFFIXES = (".tif", ".tiff", ".png", ".jp2")
MAP_THRESHOLD = 0.5


@dataclass
class CoverageSummary(StageSummary):
    """Counts, warnings, the judgement, and what was judged against what (`about`, plain values for JSON)."""

    judgement: Judgement | None = field(default=None, repr=False)
    about: dict[str, Any] = field(default_factory=dict)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        found = self.judgement.as_record() if self.judgement is not None else None
        return {**super().as_record(), "about": self.about, "judgement": found}


@dataclass(frozen=True, kw_only=True)
class PairOptions:
    """How folders of pairs are read, see `pairing.stage.read_pairs`."""

    label: PairLabel = "auto"
    classes: tuple[str, ...] | None = None
    polygons: Path | None = None
    trees: Path | None = None
    palette: Mapping[str, str] | None = None
    assume_crs: str | None = None
    resolution_m: float | None = None


AS_THEY_ARE = PairOptions()


def evaluate_pairs(
    folder: Path,
    *,
    model: Path | None = None,
    reading: PairOptions = AS_THEY_ARE,
    groups: Sequence[str] = (),
    training: Sequence[str] = (),
    threshold: float | None = None,
    plot: Path | None = None,
    seed: int = 0,
    workers: int = 1,
    progress: Progress = silent,
) -> CoverageSummary:
    """Judge a model on pairs of images and truths, beside baselines.

    Parameters
    ----------
    folder, reading
        Pairs, and how they are read.
    model
        ONNX file; None for the one that comes with the program.
    groups
        Patterns of groups or names of pairs that are judged; all where none is given.
    training
        Folders of pairs, or patterns within `folder`, that baselines with something to learn are fitted to, less what
        is judged; they are left out where none is given.
    threshold
        Probability from which on a pixel is covered; the model's own for each class where none is given.
    plot
        PNG to write.
    seed
        Root of the streams that places and pixels are drawn by.
    workers
        Threads; the result is the same for any number.

    Raises
    ------
    InputError
        A file cannot be used, a pattern fits nothing, or model and pairs have no class in common.
    """
    started = time.perf_counter()
    refuse_page_over(plot)
    if not folder.is_dir():
        raise InputError("no such folder of pairs", where=folder, next_step="check the path")
    notices = Notices()
    network = load_coverage_model(model)
    pairs = read_pairs(folder, workers=workers, notices=notices, **vars(reading))
    judged = tuple(name for name in network.info.classes if name in pairs.classes)
    if not judged:
        raise InputError(
            "model and truth have no class in common", where=network.path, found=", ".join(network.info.classes),
            expected=", ".join(pairs.classes), next_step="name what the truth shows with --classes",
        )  # fmt: skip
    patterns = [text for text in training if not text or not Path(text).is_dir()]
    chosen = select_pairs(pairs, groups, patterns, where=folder)
    _note_seen(pairs, chosen.judged, network.info, notices)
    _note_dropped(pairs, chosen.dropped, notices)
    thresholds = [
        network.info.thresholds[network.info.classes.index(name)] if threshold is None else threshold for name in judged
    ]
    session = CoverageSession(network.content, network.info)
    name = network.path.name
    predictors = {name: over_pairs.by_model(session, judged, thresholds)}
    predictors[AllCovered.name] = over_pairs.by_baseline(AllCovered(len(judged)))
    learnt: list[tuple[PairSet, Sequence[int]]] = [(pairs, chosen.training)] if chosen.training else []
    for text in training:
        if text not in patterns:
            others = pairs
            if not Path(text).samefile(folder):
                others = read_pairs(Path(text), workers=workers, notices=notices, **{**vars(reading), "trees": None})
            kept = unseen(others, pairs, chosen.judged, where=text)
            _note_dropped(others, sorted(set(range(len(others))) - set(kept)), notices)
            learnt.append((others, kept))
    if learnt:
        taught = over_pairs.learn(learnt, judged, seed=seed, progress=progress)
        index = taught.green_index()
        predictors[index.name] = over_pairs.by_baseline(index)
        try:
            boosted = taught.boosted_pixels()
            predictors[boosted.name] = over_pairs.by_baseline(boosted)
        except ConfigError as error:
            notices.add("W_NO_BOOSTING", f"baselines left out ({error.what}: {error.next_step})")
    judgement = over_pairs.judge_pairs(
        pairs, chosen.judged, predictors, judged, seed=seed, workers=workers, progress=progress
    )
    if plot is not None:
        panels = over_pairs.panels_of(judgement, pairs, chosen.judged, predictors[name])
        _write_page(plot, judgement, panels, f"{name} on {folder.name or folder}")
    about = {
        "model": {"path": str(network.path), "sha256": network.sha256, "preset": network.info.preset,
                  "classes": list(network.info.classes), "resolution_m": network.info.resolution_m},
        "truth": {"path": str(folder), "label": reading.label},
        "baselines_learnt_from": sum(len(some) for _, some in learnt),
    }  # fmt: skip
    return _summary(judgement, thresholds, about, plot or folder, seed, notices, started)


def evaluate_map(
    coverage: Path,
    *,
    truth: str,
    trees: str | None = None,
    classes: tuple[str, ...] | None = None,
    threshold: float | None = None,
    assume_crs: str | None = None,
    plot: Path | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> CoverageSummary:
    """Judge a coverage map against a mask or polygons.

    Parameters
    ----------
    coverage
        Map of this program or another, see `files.coverage.open_coverage`.
    truth
        Raster of masks or percentages, averaged over the map's pixels where it has others; or ``FILE[:LAYER]`` of
        polygons.
    trees
        ``FILE[:LAYER]`` of points.
    classes
        What polygons show, or which of several classes to judge; polygons show the canopy where none is given.
    threshold
        Share, 0 to 1, from which on the map counts as covered; what the map says of itself, or a half.
    assume_crs
        CRS of files that state none.
    plot, seed
        As of `evaluate_pairs`.

    Raises
    ------
    InputError
        A file cannot be used, map and truth have no class in common, or do not meet.
    """
    started = time.perf_counter()
    refuse_page_over(plot)
    notices = Notices()
    with (
        open_coverage(coverage, assume_crs=assume_crs, notices=notices) as reader,
        open_truth(truth, reader.grid, classes, assume_crs, notices) as (truth_classes, read_truth),
    ):
        judged = tuple(name for name in reader.classes if name in truth_classes and name in (classes or (name,)))
        if not judged:
            raise InputError(
                "map and truth have no class in common", where=coverage, found=", ".join(reader.classes),
                expected=", ".join(truth_classes), next_step="name what the truth shows with --classes",
            )  # fmt: skip
        points = None if trees is None else read_points(trees, reader.grid, assume_crs, notices)
        thresholds = tuple(_own_threshold(reader, name) if threshold is None else threshold for name in judged)

        def read_map(window: Window) -> Percent:
            return reader.read(*window)[[reader.classes.index(name) for name in judged]]

        def read_judged(window: Window) -> Percent:
            return read_truth(window)[[truth_classes.index(name) for name in judged]]

        judgement = over_map.judge_map(reader.grid, coverage.name, read_map, read_judged, judged, thresholds, points,
                                       seed=seed, progress=progress)  # fmt: skip
        if judgement is None:
            raise InputError(
                "map and truth share no known pixel", where=coverage, found=f"truth {truth}",
                next_step="check that both are of the same place, and their CRS (--assume-crs)",
            )  # fmt: skip
        if plot is not None:
            panels = over_map.panels_of(judgement, reader.grid, read_map, read_judged, thresholds, points)
            _write_page(plot, judgement, panels, f"{coverage.name} against {Path(split_source(truth)[0]).name}")
    about = {"map": str(coverage), "truth": {"path": truth}, "trees": trees}
    return _summary(judgement, thresholds, about, plot or coverage, seed, notices, started)


def refuse_page_over(plot: Path | None) -> None:
    """Refuse to write a picture under another kind of name, or over what is no picture."""
    if plot is None:
        return
    if plot.suffix.lower() != ".png":
        raise InputError("the plot is a PNG", where=plot, expected="a name that ends in .png")
    if plot.exists() and not (plot.is_file() and _head(plot) == PNG_HEAD):
        raise OutputExistsError("there is a file already, and no picture", where=plot, next_step="name another")


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(PNG_HEAD))


def _note_seen(pairs: PlacedPairs, judged: Sequence[int], info: CoverageModelInfo, notices: Notices) -> None:
    """Count pairs that the model learnt from or was chosen by, as far as it says which these were."""
    made_from = info.training.get("data")
    if not isinstance(made_from, dict):
        return
    if isinstance(hashes := made_from.get("image_hashes"), list):
        known = {str(one) for one in hashes}
        seen = [pairs.names[index] for index in judged if pairs.content(index) in known]
    elif made_from.get("fingerprint") == pairs.fingerprint:
        held_out = [str(pattern) for pattern in made_from.get("hold_out") or ()]
        seen = [pairs.names[index] for index in judged if not fits(pairs, index, held_out)]
    else:
        return
    notices.add("W_SEEN_IN_TRAINING", "pairs judged that the model was trained or chosen on, whose scores flatter it",
                len(seen), seen[:5])  # fmt: skip


def _note_dropped(pairs: PairSet, dropped: Sequence[int], notices: Notices) -> None:
    notices.add("W_TRAINING_PLACES", "pairs of judged places that baselines did not learn from", len(dropped),
                [pairs.names[index] for index in dropped[:5]])  # fmt: skip


def _own_threshold(reader: CoverageReader, name: str) -> float:
    """Return the share that the model of a map has as its threshold, as the map tells."""
    model = (reader.provenance or {}).get("model")
    found = model.get("thresholds") if isinstance(model, dict) else None
    value = found.get(name) if isinstance(found, dict) else None
    return float(value) if isinstance(value, int | float) and 0 < value < 1 else MAP_THRESHOLD


def _summary(
    judgement: Judgement,
    thresholds: Sequence[float],
    about: Mapping[str, Any],
    output: Path,
    seed: int,
    notices: Notices,
    started: float,
) -> CoverageSummary:
    rules = {"thresholds": dict(zip(judgement.classes, thresholds, strict=True)), "seed": seed,
             "truth_least_percent": TRUTH_LEAST_PERCENT, "tree_near_px": NEAR_PX,
             "interval": {"level": LEVEL, "resamples": RESAMPLES, "over": "places"}}  # fmt: skip
    counts: dict[str, int | float | str] = {"tiles": len(judgement.tiles), "groups": len(judgement.groups)}
    for name, found in judgement.total.items():
        score = found.scores[judgement.judged]
        if score.iou is not None:
            counts[f"{name}_iou"] = round(score.iou, 4)
    return CoverageSummary("evaluate-coverage", output, counts, notices, time.perf_counter() - started,
                           judgement=judgement, about={**about, **rules})  # fmt: skip


def _write_page(path: Path, judgement: Judgement, panels: Mapping[str, Sequence[Panel]], title: str) -> None:
    with publish(path) as part:
        part.write_bytes(png_of(draw_judgement(judgement, panels, title)))
