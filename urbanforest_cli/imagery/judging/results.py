"""What judging coverage finds: scores by class, predictor and group, and those of each tile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.judging.bootstrap import LEAST_PLACES, interval, resampled_iou, sums_by_place
from urbanforest_cli.imagery.judging.scores import (
    FIELDS,
    TREE_FIELDS,
    Floats,
    Ints,
    Mask,
    Score,
    confusion,
    hard_truth,
    score,
    tree_hits,
)

TRUTH = "truth"
SHARE_SHOWN_LEAST = 0.01
"""Tiles whose truth covers less than this are not ranked by their IoU, a ratio of two small numbers there."""


@dataclass(frozen=True)
class Tile:
    """One image judged.

    `counts` is (predictor, class, 4) by `scores.FIELDS`; `hits` is (1 + predictor, class, 3) by `scores.TREE_FIELDS`,
    the truth's own first, or None where no trees are annotated.
    """

    name: str
    place: str
    group: str
    counts: Ints
    hits: Ints | None


def judge_tile(
    name: str,
    place: str,
    group: str,
    predictions: Mapping[str, Mask],
    truth: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
    valid: Mask,
    trees_px: Floats | None,
) -> Tile:
    """Count how predictions (class, rows, cols) agree with a truth in percent, where both image and truth are known.

    Parameters
    ----------
    predictions
        By the name of the predictor; all of the truth's classes, in its order.
    truth
        (class, rows, cols) percent, 255 for unknown.
    valid
        (rows, cols) where the image holds something.
    trees_px
        (n, 2) rows and columns, see `scores.tree_hits`.
    """
    covered, known = hard_truth(truth)
    known = known & valid
    counts = [
        [confusion(*layers) for layers in zip(mask, covered, known, strict=True)] for mask in predictions.values()
    ]
    hits = None
    if trees_px is not None:
        masks = [covered, *predictions.values()]
        hits = np.array([[tree_hits(a, b, trees_px) for a, b in zip(m, known, strict=True)] for m in masks])
    return Tile(name, place, group, np.array(counts), hits)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """IoU of the predictor judged less that of another, over the same places drawn."""

    against: str
    iou: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class ClassJudgement:
    """One class over some tiles: the scores of each predictor by its name, the one judged first."""

    tiles: int
    places: int
    scores: dict[str, Score]
    tile_iou_median: float | None
    truth_trees_on: float | None
    differences: list[Difference] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Everything found; groups are in the order of their names, tiles as they came."""

    classes: tuple[str, ...]
    predictors: tuple[str, ...]
    total: dict[str, ClassJudgement]
    groups: dict[str, dict[str, ClassJudgement]]
    tiles: list[Tile] = field(repr=False)

    @property
    def judged(self) -> str:
        """Name of the predictor that the others are beside."""
        return self.predictors[0]

    def ranked(self, class_name: str) -> list[tuple[Tile, float]]:
        """Return tiles with their IoU of the predictor judged, best first; those nearly bare only if all are."""
        number = self.classes.index(class_name)
        scored = [(tile, score(tile.counts[0, number])) for tile in self.tiles]
        usable = [(tile, found) for tile, found in scored if found.iou is not None]
        shown = [(t, s) for t, s in usable if (s.truth_share or 0.0) >= SHARE_SHOWN_LEAST] or usable
        return sorted(((t, s.iou or 0.0) for t, s in shown), key=lambda pair: (-pair[1], pair[0].name))

    def as_record(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            "classes": list(self.classes),
            "predictors": list(self.predictors),
            "total": {name: asdict(found) for name, found in self.total.items()},
            "groups": {
                group: {name: asdict(found) for name, found in classes.items()}
                for group, classes in self.groups.items()
            },
            "tiles": [self._tile_record(tile) for tile in self.tiles],
        }

    def _tile_record(self, tile: Tile) -> dict[str, object]:
        record: dict[str, object] = {"name": tile.name, "place": tile.place, "group": tile.group}
        for number, class_name in enumerate(self.classes):
            hits = tile.hits[1, number] if tile.hits is not None else None
            found = asdict(score(tile.counts[0, number], hits))
            record[class_name] = {key: value for key, value in found.items() if key not in ("iou_low", "iou_high")}
        return record


def judge(tiles: list[Tile], classes: tuple[str, ...], predictors: tuple[str, ...], *, seed: int) -> Judgement:
    """Add up tiles: in all and by group, each class with intervals from drawing places anew.

    Parameters
    ----------
    tiles
        At least one; their predictors and classes in the order named here.
    seed
        Root of the streams that places are drawn by, one a group and class.
    """
    groups = sorted({tile.group for tile in tiles})
    return Judgement(
        classes=classes,
        predictors=predictors,
        total=_judge_group("", tiles, classes, predictors, seed),
        groups={
            group: _judge_group(group, [tile for tile in tiles if tile.group == group], classes, predictors, seed)
            for group in groups
        },
        tiles=tiles,
    )


def _judge_group(
    group: str, tiles: list[Tile], classes: tuple[str, ...], predictors: tuple[str, ...], seed: int
) -> dict[str, ClassJudgement]:
    counts = np.stack([tile.counts for tile in tiles])  # (tile, predictor, class, field)
    none = np.zeros((1 + len(predictors), len(classes), len(TREE_FIELDS)), dtype=np.int64)
    hits = np.sum([none if tile.hits is None else tile.hits for tile in tiles], axis=0)
    by_place = sums_by_place(counts, [tile.place for tile in tiles])
    assert counts.shape[1:] == (len(predictors), len(classes), len(FIELDS)), "tiles are counted for these names"
    found = {}
    for number, class_name in enumerate(classes):
        total = counts[:, :, number].sum(axis=0)
        intervals: list[tuple[float, float] | None] = [None] * len(predictors)
        differences: list[Difference] = []
        if len(by_place) >= LEAST_PLACES:
            drawn = resampled_iou(by_place[:, :, number], rng_for(seed, "judging/places", f"{group}/{class_name}"))
            intervals = [interval(column) for column in drawn.T]
            differences = _differences(total, drawn, predictors)
        scores = [score(*parts) for parts in zip(total, hits[1:, number], intervals, strict=True)]
        own = [one for one in (score(tile.counts[0, number]).iou for tile in tiles) if one is not None]
        trees, on, _ = hits[0, number]
        found[class_name] = ClassJudgement(
            tiles=len(tiles),
            places=len(by_place),
            scores=dict(zip(predictors, scores, strict=True)),
            tile_iou_median=float(np.median(own)) if own else None,
            truth_trees_on=float(on / trees) if trees else None,
            differences=differences,
        )
    return found


def _differences(total: Ints, drawn: Floats, predictors: tuple[str, ...]) -> list[Difference]:
    rows = []
    for number, name in enumerate(predictors[1:], start=1):
        first, other = score(total[0]).iou, score(total[number]).iou
        between = interval(drawn[:, 0] - drawn[:, number])
        if first is not None and other is not None and between is not None:
            rows.append(Difference(against=name, iou=first - other, low=between[0], high=between[1]))
    return rows
