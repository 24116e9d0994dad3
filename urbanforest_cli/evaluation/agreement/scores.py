"""How far crowns and a coverage map agree, over lots, with what chance leaves open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.evaluation.agreement.sets import PLACED
from urbanforest_cli.evaluation.agreement.tally import Tally

Floats = NDArray[np.float64]

NEAR = 0.05
"""Lots whose covered share is met within five points are near."""
ROUNDS = 999
LEVEL = 0.95
KNOWN_LEAST = 0.5
"""Lots of which the map knows less are left out."""
LOTS_FOR_INTERVALS = 2


@dataclass(frozen=True)
class Estimate:
    """A value, and the interval that holds it in 95 of 100 draws of as many lots; None where it cannot be told."""

    value: float | None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Agreement:
    """One set of crowns against the map.

    Parameters
    ----------
    name
        Of the set.
    plants
        That stand in the lots compared.
    error_mean
        Mean over lots of |share under crowns - share covered|.
    near_share
        Share of lots where that is at most `NEAR`.
    bias
        Mean of share under crowns - share covered.
    correlation
        Pearson's, of both shares over lots.
    iou
        Ground under crowns and covered, over ground under crowns or covered, all lots together, in whole cells: those
        of which half or more is under crowns.
    total_ratio, percent_ratio
        Ground under crowns over ground covered; over what the map's percentages add up to.
    """

    name: str
    plants: int
    error_mean: Estimate
    near_share: Estimate
    bias: Estimate
    correlation: Estimate
    iou: Estimate
    total_ratio: Estimate
    percent_ratio: Estimate


@dataclass(frozen=True)
class Gain:
    """How much better the placed crowns are than another set; positive is better, over the same draws of lots."""

    over: str
    error_mean: Estimate
    correlation: Estimate
    iou: Estimate


@dataclass(frozen=True)
class Shares:
    """Of the lots compared, (n,): area of what is known, share covered, and share under crowns of each set."""

    lot: NDArray[np.int64]
    known_m2: Floats
    covered: Floats
    crowns: Mapping[str, Floats]


@dataclass(frozen=True)
class CoverageAgreement:
    """Everything that is found."""

    crowns: str
    lots: int
    lots_compared: int
    lots_unknown: int
    threshold_percent: float
    cell_m: float
    known_ha: float
    covered_ha: float
    sets: Sequence[Agreement]
    gains: Sequence[Gain]
    shares: Shares = field(repr=False)

    def as_record(self) -> dict[str, object]:
        """Return plain values for JSON, without those of single lots."""
        return asdict(self, dict_factory=_without_shares)


def _without_shares(items: list[tuple[str, object]]) -> dict[str, object]:
    return {name: value for name, value in items if name != "shares"}


def score_agreement(
    areas: Tally,
    plants: Mapping[str, NDArray[np.int64]],
    rng: np.random.Generator,
    *,
    crowns: str,
    threshold_percent: float,
    cell_m: float,
    rounds: int = ROUNDS,
) -> CoverageAgreement:
    """Score sets of crowns against the map, the first of them being the one that is judged.

    Lots of which the map knows less than `KNOWN_LEAST` are left out. Intervals are percentiles of a bootstrap over
    lots; all sets see the same draws.

    Parameters
    ----------
    areas
        By lot.
    plants
        (lots,) plants of each set in every lot.
    crowns
        What the radii are, in words.
    """
    used = np.flatnonzero(areas.known_m2 >= KNOWN_LEAST * np.maximum(areas.whole_m2, 1e-9))
    known = areas.known_m2[used]
    covered = areas.covered_m2[used]
    names = list(areas.crown_m2)
    columns = {name: _columns(areas, name, used) for name in names}
    drawn = _draws(np.concatenate(list(columns.values()), axis=1), rng, rounds)
    width = len(next(iter(columns.values()))[0]) if len(used) else 0
    found, draws = {}, {}
    for place, name in enumerate(names):
        part = slice(place * width, (place + 1) * width)
        found[name] = _measures(columns[name].sum(axis=0)[None]) if len(used) else {}
        draws[name] = _measures(drawn[:, part]) if len(drawn) else {}
    sets = [
        Agreement(name, int(plants[name][used].sum()), **{
            measure: _estimate(found[name].get(measure), draws[name].get(measure)) for measure in MEASURES
        })
        for name in names
    ]  # fmt: skip
    gain = partial(_gain, found, draws)
    crown = {name: areas.crown_m2[name][used] for name in names}
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = Shares(used, known, covered / known, {name: crown[name] / known for name in names})
    return CoverageAgreement(
        crowns=crowns,
        lots=len(areas.known_m2),
        lots_compared=len(used),
        lots_unknown=len(areas.known_m2) - len(used),
        threshold_percent=threshold_percent,
        cell_m=cell_m,
        known_ha=float(known.sum() / 1e4),
        covered_ha=float(covered.sum() / 1e4),
        sets=sets,
        gains=[
            Gain(name, gain(name, "error_mean", -1.0), gain(name, "correlation", 1.0), gain(name, "iou", 1.0))
            for name in names
            if name != PLACED
        ],
        shares=shares,
    )


MEASURES = ("error_mean", "near_share", "bias", "correlation", "iou", "total_ratio", "percent_ratio")


def _columns(areas: Tally, name: str, used: NDArray[np.int64]) -> Floats:
    """Return what is summed over lots, (lots, 13): every measure is made of sums."""
    known = np.maximum(areas.known_m2[used], 1e-9)
    covered, crown = areas.covered_m2[used], areas.crown_m2[name][used]
    half, both = areas.half_m2[name][used], areas.both_m2[name][used]
    x, y = covered / known, crown / known
    error = y - x
    near = np.abs(error) <= NEAR + 1e-12
    return np.column_stack(
        (np.ones(len(used)), np.abs(error), near, error, x, y, x * x, y * y, x * y, both, half + covered - both, crown,
         covered, areas.percent_m2[used])
    )  # fmt: skip


def _measures(sums: Floats) -> dict[str, Floats]:
    """Return every measure of each row of sums, not a number where it cannot be told."""
    count, absolute, near, error, x, y, xx, yy, xy, both, either, crown, covered, percent = sums.T
    with np.errstate(invalid="ignore", divide="ignore"):
        spread_x, spread_y = xx - x * x / count, yy - y * y / count
        flat = (spread_x <= 1e-9 * count) | (spread_y <= 1e-9 * count)
        return {
            "error_mean": absolute / count,
            "near_share": near / count,
            "bias": error / count,
            "correlation": np.where(flat, np.nan, (xy - x * y / count) / np.sqrt(np.maximum(spread_x * spread_y, 0))),
            "iou": both / either,
            "total_ratio": crown / covered,
            "percent_ratio": crown / percent,
        }


def _draws(columns: Floats, rng: np.random.Generator, rounds: int) -> Floats:
    """Return sums over lots drawn with replacement, (rounds, columns)."""
    count = len(columns)
    if count < LOTS_FOR_INTERVALS:
        return np.zeros((0, columns.shape[1]))
    return np.array(
        [
            np.bincount(rng.integers(0, count, count), minlength=count).astype(np.float64) @ columns
            for _ in range(rounds)
        ]
    )


def _estimate(value: Floats | None, draws: Floats | None) -> Estimate:
    if value is None or not np.isfinite(value[0]):
        return Estimate(None)
    if draws is None or not np.isfinite(draws).any():
        return Estimate(float(value[0]))
    low, high = np.nanquantile(draws, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Estimate(float(value[0]), float(low), float(high))


def _gain(
    found: Mapping[str, Mapping[str, Floats]], draws: Mapping[str, Mapping[str, Floats]], over: str, measure: str,
    sign: float,
) -> Estimate:  # fmt: skip
    if measure not in found[over]:
        return Estimate(None)
    value = sign * (found[PLACED][measure] - found[over][measure])
    drawn = sign * (draws[PLACED][measure] - draws[over][measure]) if measure in draws[over] else None
    return _estimate(value, drawn)
