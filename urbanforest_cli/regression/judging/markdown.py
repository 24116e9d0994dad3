"""A judgement as Markdown tables, for a model card."""

from __future__ import annotations

from collections.abc import Sequence

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.calibration import LEVELS
from urbanforest_cli.regression.judging.probes import STEPS
from urbanforest_cli.regression.judging.results import Judgement, PredictorScores

SYMBOLS = tuple(PARAMETERS[name].symbol for name in REGRESSED)


def as_markdown(judgement: Judgement, title: str) -> str:
    """Return all tables of a judgement under one heading."""
    parts = [
        f"## {title}",
        f"{judgement.pairs:,} pairs on {judgement.lots:,} lots. Scores are those of the pairs whose strategy uses a "
        "parameter, errors in shares of its range; in brackets what 95 % of draws of other lots give.",
        *_predictors(judgement),
        *_by_visible(judgement),
        *_calibration(judgement),
        *_readings(judgement),
        *_probes(judgement),
        *_zones(judgement),
    ]
    return "\n\n".join(parts) + "\n"


def glossary() -> str:
    """Return one line that tells which symbol is which parameter."""
    return ", ".join(f"{symbol} `{name}`" for symbol, name in zip(SYMBOLS, REGRESSED, strict=True))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return rows under a head, the first column to the left and all others to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _predictors(judgement: Judgement) -> list[str]:
    head = ["", *SYMBOLS, "mean", "strategy"]
    parts = [f"Parameters: {glossary()}."]
    for text, read in (("R2", _r2), ("1 - NMAE", _nmae), ("within 10 % of the range", _within), ("bias", _bias)):
        rows = [[name, *read(found), percent(found.strategy_accuracy)] for name, found in judgement.total.items()]
        parts.append(f"**{text}**\n\n" + table(head, rows))
    rows = []
    for name in judgement.predictors[1:]:
        of = {one.parameter: one for one in judgement.differences if one.against == name}
        cells = [f"{of[key].r2:+.3f} ({of[key].low:+.3f} to {of[key].high:+.3f})" if key in of else ""
                 for key in (*REGRESSED, "mean")]  # fmt: skip
        rows.append([name, *cells])
    if judgement.differences:
        parts.append(f"**R2 of {judgement.judged} less that of others**\n\n" + table(head[:-1], rows))
    return parts


def _r2(found: PredictorScores) -> list[str]:
    def with_limits(value: float | None, low: float | None, high: float | None) -> str:
        return number(value) + (f" ({low:.3f} to {high:.3f})" if low is not None and high is not None else "")

    return [
        *(with_limits(one.r2, one.r2_low, one.r2_high) for one in found.scores.values()),
        with_limits(found.mean_r2, found.mean_r2_low, found.mean_r2_high),
    ]


def _nmae(found: PredictorScores) -> list[str]:
    return [*(number(one.one_less_nmae) for one in found.scores.values()), number(found.mean_one_less_nmae)]


def _within(found: PredictorScores) -> list[str]:
    return [*(percent(one.within) for one in found.scores.values()), percent(found.mean_within)]


def _bias(found: PredictorScores) -> list[str]:
    return [*("" if one.bias is None else f"{one.bias:+.3f}" for one in found.scores.values()), ""]


def _by_visible(judgement: Judgement) -> list[str]:
    parts = []
    for text, of_mean in (("R2", "mean_r2"), ("1 - NMAE", "mean_one_less_nmae")):
        rows = []
        for visible, found in judgement.by_visible.items():
            for name, one in found.items():
                cells = [number(getattr(score, of_mean.removeprefix("mean_"))) for score in one.scores.values()]
                pairs = f"{judgement.pairs_by_visible[visible]:,}"
                rows.append([visible, pairs, name, *cells, number(getattr(one, of_mean)),
                             percent(one.strategy_accuracy)])  # fmt: skip
        head = ["plants", "pairs", "", *SYMBOLS, "mean", "strategy"]
        parts.append(f"**By plants standing in the lot: {text}**\n\n" + table(head, rows))
    return parts


def _calibration(judgement: Judgement) -> list[str]:
    if not judgement.calibration:
        return []
    head = ["", "", *(f"{level:.0%} holds" for level in LEVELS), "worst", "ranks, tenths", "told to found, by fifths"]
    rows = []
    for name, found in judgement.calibration.items():
        for parameter, one in found.items():
            ranks = " ".join(f"{share:.2f}".lstrip("0") for share in one.ranks)
            told = ", ".join(f"{a:.2f} {b:.2f}" for a, b in zip(one.told, one.found, strict=True))
            rows.append([name, PARAMETERS[parameter].symbol, *(percent(share) for share in one.covered),
                         f"{100 * one.worst:.1f}", ranks, told])  # fmt: skip
    text = "**How sure, and how sure it should be**: truths in the central interval of the predicted beta distribution"
    return [f"{text}; ranks of the truth in it (.10 each is right); spread told beside error found.\n\n"
            + table(head, rows)]  # fmt: skip


def _readings(judgement: Judgement) -> list[str]:
    rows = [[text, *(number(value) for value in found.values())] for text, found in judgement.readings.items()]
    return ['**What "95 % accuracy" may mean**\n\n' + table(["", *judgement.predictors], rows)]


def _probes(judgement: Judgement) -> list[str]:
    parts = []
    if judgement.shuffle:
        rows = []
        for name, found in judgement.shuffle.items():
            rows.append([name, "R2", *(number(one.r2) for one in found.values())])
            rows.append([name, "correlation", *(number(one.correlation) for one in found.values())])
        parts.append("**Coverage swapped between lots**: nothing may be left.\n\n" + table(["", "", *SYMBOLS], rows))
    if judgement.turning:
        rows = [["median", *(number(one.median) for one in judgement.turning.values())],
                ["99 %", *(number(one.most) for one in judgement.turning.values())]]  # fmt: skip
        parts.append("**Lots turned and mirrored**: predictions off their mean, in shares of the range.\n\n"
                     + table(["", *SYMBOLS], rows))  # fmt: skip
    if judgement.responses:
        rows = [[PARAMETERS[name].symbol, f"{one.lots:,}", *(number(value) for value in one.predicted),
                 number(one.slope), percent(one.rising)] for name, one in judgement.responses.items()]  # fmt: skip
        head = ["", "lots", *(f"at {step:g}" for step in STEPS), "slope", "rising"]
        parts.append("**One parameter raised on the same lots**: mean prediction, in shares of the range.\n\n"
                     + table(head, rows))  # fmt: skip
    return parts


def _zones(judgement: Judgement) -> list[str]:
    if not judgement.zones:
        return []
    rows = []
    for name, sizes in judgement.zones.items():
        for one in sizes:
            held = "" if one.covered_68 is None else " ".join(f"{share:.2f}" for share in one.covered_68.values())
            rows.append([name, str(one.lots), *(number(value) for value in one.r2.values()), number(one.mean_r2), held])
    head = ["", "lots", *SYMBOLS, "mean", "68 % holds"]
    return ["**Lots that share their parameters, pooled**: R2.\n\n" + table(head, rows)]


def number(value: float | None) -> str:
    """Return a figure with three decimals, or nothing."""
    return "" if value is None else f"{value:.3f}"


def percent(value: float | None) -> str:
    """Return a share as a percentage, or nothing."""
    return "" if value is None else f"{value:.1%}"
