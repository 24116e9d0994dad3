"""``evaluate-regression``: parameter models and pairs in; scores, tables and perhaps a page of pictures out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.randomness import key_for, rng_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.parameter_models import ParameterModel, ParameterSession, load_parameter_model
from urbanforest_cli.regression.features import FEATURES, HAND_FEATURES
from urbanforest_cli.regression.judging import probes, zones
from urbanforest_cli.regression.judging.baselines import (
    BOOSTED_ALL,
    BOOSTED_HAND,
    CLOSED_FORM,
    MEAN,
    MeanPredictor,
    fit_boosting,
    fit_closed_form,
    fit_mean,
)
from urbanforest_cli.regression.judging.markdown import as_markdown
from urbanforest_cli.regression.judging.plots import draw_judgement, png_of
from urbanforest_cli.regression.judging.predictions import (
    PRIOR_MEANS,
    PRIOR_SPREADS,
    RANGE,
    Prediction,
    Predictor,
    shares,
)
from urbanforest_cli.regression.judging.results import Judgement, judge
from urbanforest_cli.regression.judging.scores import LEVEL, RESAMPLES, WITHIN
from urbanforest_cli.regression.model_fit import refuse_other_version
from urbanforest_cli.regression.pair_table import PairTable

PNG_HEAD = b"\x89PNG\r\n\x1a\n"
BATCH = 64
RESPONSE_LOTS = 200
ZONES = 400
TURNED = 500


class PairMaker(Protocol):
    """Makes pairs of one design; those of another seed stand on other lots and come from other streams."""

    def __call__(
        self,
        count: int,
        seed: int,
        values: NDArray[np.float64] | None = None,
        strategies: NDArray[np.int8] | None = None,
    ) -> PairTable:
        """Return so many pairs, of values (count, 6) in their units and strategies (count,) where they are given."""
        ...


@dataclass
class RegressionSummary(StageSummary):
    """Counts, warnings, the judgement, and what was judged on what (`about`, plain values for JSON)."""

    judgement: Judgement | None = field(default=None, repr=False)
    about: dict[str, Any] = field(default_factory=dict)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        found = self.judgement.as_record() if self.judgement is not None else None
        return {**super().as_record(), "about": self.about, "judgement": found}


def evaluate_regression(
    make: PairMaker,
    *,
    models: Sequence[Path] = (),
    pairs: int = 2000,
    baseline_pairs: int = 0,
    probed: bool = False,
    design: str = "held-out",
    lots: Sequence[str] = (),
    plot: Path | None = None,
    markdown: Path | None = None,
    seed: int = 0,
    threads: int = 1,
    notices: Notices | None = None,
    progress: Progress = silent,
) -> RegressionSummary:
    """Judge parameter models on fresh pairs, beside a predictor that knows nothing and perhaps learnt baselines.

    Parameters
    ----------
    make
        Makes pairs.
    models
        ONNX files, the one judged first; the one that comes with the program where none is given.
    pairs
        How many to judge on.
    baseline_pairs
        How many more to teach baselines with; none for no such baselines.
    probed
        Whether to raise parameters alone and to pool lots that share them too, on pairs made for that.
    design, lots
        What `make` was told, for titles and records.
    plot, markdown
        PNG and Markdown file to write.
    seed
        Root of the streams of pairs and draws.
    threads
        To run networks in; the result is the same for any number.
    notices
        What `make` counts while pairs are made, for the summary.

    Raises
    ------
    InputError
        A model cannot be used or is for another version, or an output has another kind of name.
    OutputExistsError
        A file is in the way that is no picture or table of this program.
    """
    started = time.perf_counter()
    refuse_outputs(plot, markdown)
    loaded = [load_parameter_model(path) for path in models or (None,)]
    for model in loaded:
        refuse_other_version(model.info, model.path)
    predictors: dict[str, Predictor] = {
        name: by_model(model, threads) for name, model in zip(_names(loaded), loaded, strict=True)
    }
    judged = next(iter(predictors))
    table = make(pairs, key_for(seed, "regression/judging", "judged") >> 1)
    if baseline_pairs:
        predictors |= learnt(make(baseline_pairs, key_for(seed, "regression/judging", "baselines") >> 1), progress)
    else:
        predictors[MEAN] = MeanPredictor(PRIOR_MEANS, PRIOR_SPREADS)
    predictions: dict[str, Prediction] = {}
    for name, predictor in predictors.items():
        progress("Judging predictors", len(predictions), len(predictors))
        predictions[name] = predictor(table)
    judgement = judge(table, predictions, seed=seed)
    judgement = _swapped_and_turned(judgement, predictors, table, seed)
    if probed:
        judgement = _probed(judgement, predictors, make, seed)
    title = f"{judged} on {design} pairs"
    if plot is not None:
        with publish(plot) as part:
            part.write_bytes(png_of(draw_judgement(judgement, predictions[judged], table, title)))
    if markdown is not None:
        with publish(markdown) as part:
            part.write_text(as_markdown(judgement, title[:1].upper() + title[1:]), encoding="utf-8")
    about = {
        "models": [{"path": str(one.path), "sha256": one.sha256, "network": one.info.network} for one in loaded],
        "design": design, "lots": list(lots), "seed": seed, "baselines_learnt_from": baseline_pairs,
        "within": WITHIN, "interval": {"level": LEVEL, "resamples": RESAMPLES, "over": "lots"},
    }  # fmt: skip
    return RegressionSummary(
        "evaluate-regression",
        plot or markdown or loaded[0].path,
        _counts(judgement),
        Notices() if notices is None else notices,
        time.perf_counter() - started,
        judgement=judgement,
        about=about,
    )


def refuse_outputs(plot: Path | None, markdown: Path | None) -> None:
    """Refuse to write under another kind of name, or a picture over what is none.

    Raises
    ------
    InputError
        A name ends otherwise than it should.
    OutputExistsError
        There is something else already.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise InputError("the plot is a PNG", where=plot, expected="a name that ends in .png")
    if markdown is not None and markdown.suffix.lower() != ".md":
        raise InputError("the tables are Markdown", where=markdown, expected="a name that ends in .md")
    if plot is not None and plot.exists() and not (plot.is_file() and _head(plot) == PNG_HEAD):
        raise OutputExistsError("there is a file already, and no picture", where=plot, next_step="name another")
    if markdown is not None and markdown.exists() and not markdown.is_file():
        raise OutputExistsError("there is something already, and no file", where=markdown, next_step="name another")


def by_model(model: ParameterModel, threads: int = 1) -> Predictor:
    """Return a model as a predictor of pairs."""
    session = ParameterSession(model.content, model.info)
    columns = [FEATURES.index(name) for name in model.info.features]
    order = [model.info.parameters.index(name) for name in REGRESSED]

    def run(some: PairTable) -> tuple[NDArray[np.float64], ...]:
        return session.predict(some.windows, some.pixel_m, np.ascontiguousarray(some.features[:, columns]))

    def predict(table: PairTable) -> Prediction:
        filled = np.arange(-(-len(table) // BATCH) * BATCH) % len(table)  # the network always runs on whole batches
        with ThreadPoolExecutor(threads) as pool:
            parts = list(pool.map(run, (table.take(rows) for rows in filled.reshape(-1, BATCH))))
        values, spreads, strategy = (np.concatenate(some)[: len(table)] for some in zip(*parts, strict=True))
        return Prediction(shares(values[:, order]), spreads[:, order].astype(np.float64) / RANGE,
                          strategy.astype(np.float64))  # fmt: skip

    return predict


def learnt(table: PairTable, progress: Progress = silent) -> dict[str, Predictor]:
    """Return baselines taught with pairs, the simplest first."""
    fits: Mapping[str, Any] = {
        MEAN: fit_mean,
        CLOSED_FORM: fit_closed_form,
        BOOSTED_HAND: lambda pairs: fit_boosting(pairs, len(HAND_FEATURES)),
        BOOSTED_ALL: lambda pairs: fit_boosting(pairs, len(FEATURES)),
    }
    found: dict[str, Predictor] = {}
    for name, fit in fits.items():
        found[name] = fit(table)
        progress("Teaching baselines", len(found), len(fits))
    return found


def _swapped_and_turned(
    judgement: Judgement, predictors: Mapping[str, Predictor], table: PairTable, seed: int
) -> Judgement:
    kept = [FEATURES.index(name) for name in probes.LOT_FEATURES]
    swapped = probes.shuffled(table, kept, rng_for(seed, "regression/judging/shuffle", ""))
    some = table.take(np.arange(min(TURNED, len(table))))
    return replace(
        judgement,
        shuffle={name: probes.shuffle_scores(predict(swapped), swapped) for name, predict in predictors.items()},
        turning=probes.turning(predictors[judgement.judged], some),
    )


def _probed(judgement: Judgement, predictors: Mapping[str, Predictor], make: PairMaker, seed: int) -> Judgement:
    on_same_lots = key_for(seed, "regression/judging", "responses") >> 1
    found = probes.responses(
        predictors[judgement.judged],
        lambda values, strategies: make(len(values), on_same_lots, values, strategies),
        RESPONSE_LOTS,
        rng_for(seed, "regression/judging/responses", ""),
    )
    values, strategies = zones.drawn_zones(ZONES, rng_for(seed, "regression/judging/zones", ""))
    shared = make(len(values), key_for(seed, "regression/judging", "zones") >> 1, values, strategies)
    said = {name: predict(shared) for name, predict in predictors.items() if name != MEAN}
    cells = rng_for(seed, "regression/judging/zones", "cells")
    pooled = zones.zone_poolings(said, shares(shared.values), shared.used, cells)
    return replace(judgement, responses=found, zones=pooled)


def _names(models: Sequence[ParameterModel]) -> list[str]:
    stems = [model.path.stem for model in models]
    return [
        stem if stems.count(stem) == 1 else f"{stem} {stems[: number + 1].count(stem)}"
        for number, stem in enumerate(stems)
    ]


def _counts(judgement: Judgement) -> dict[str, int | float | str]:
    found = judgement.total[judgement.judged]
    counts: dict[str, int | float | str] = {"pairs": judgement.pairs, "lots": judgement.lots}
    for name, score in found.scores.items():
        if score.r2 is not None:
            counts[f"{name}_r2"] = round(score.r2, 4)
    if found.mean_r2 is not None:
        counts["mean_r2"] = round(found.mean_r2, 4)
    return counts


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(PNG_HEAD))
