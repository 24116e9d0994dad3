"""Judging predictors on pairs of images and truths, one image in memory a thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

import numpy as np

from urbanforest_cli.core.progress import Progress
from urbanforest_cli.imagery.inference import CoverageSession, predict_at
from urbanforest_cli.imagery.judging.baselines import Baseline, BaselineTraining, Image
from urbanforest_cli.imagery.judging.plots import Panel, chosen_tiles
from urbanforest_cli.imagery.judging.results import Judgement, Tile, judge, judge_tile
from urbanforest_cli.imagery.judging.scores import Mask, hard_truth
from urbanforest_cli.imagery.pairs import ImagePair, PairSet

Covers = Callable[[ImagePair], Mask]
"""Tells where the classes judged cover an image, (class, rows, cols)."""


def by_model(session: CoverageSession, classes: Sequence[str], thresholds: Sequence[float]) -> Covers:
    """Return a model as a predictor of some of its classes; a pixel that it says nothing of is not covered."""
    numbers = [session.info.classes.index(name) for name in classes]
    least = np.array(thresholds, dtype=np.float32)[:, None, None]

    def covered(pair: ImagePair) -> Mask:
        return np.asarray(predict_at(session, pair.rgb, pair.valid, pair.resolution_m)[numbers] >= least)

    return covered


def by_baseline(baseline: Baseline) -> Covers:
    """Return a baseline as a predictor."""
    return lambda pair: baseline.covered(pair.rgb, pair.resolution_m)


def judge_pairs(
    pairs: PairSet,
    indices: Sequence[int],
    predictors: Mapping[str, Covers],
    classes: tuple[str, ...],
    *,
    seed: int,
    workers: int,
    progress: Progress,
) -> Judgement:
    """Hold predictors against the truth of pairs.

    Parameters
    ----------
    indices
        Which pairs.
    predictors
        By name, the one judged first.
    classes
        Those judged; all predictors tell them in this order.
    seed, workers, progress
        Root of the streams that places are drawn by, threads to predict in, and who is told.
    """

    def one(index: int) -> Tile:
        pair = pairs[index]
        found = {name: covers(pair) for name, covers in predictors.items()}
        return judge_tile(
            pair.name, pair.place, pair.group, found, truth_of(pair, classes), pair.valid, pair.trees_px
        )  # fmt: skip

    tiles = []
    for tile in _in_threads((partial(one, index) for index in indices), workers):
        tiles.append(tile)
        progress("Judging images", len(tiles), len(indices))
    return judge(tiles, classes, tuple(predictors), seed=seed)


def learn(
    sources: Sequence[tuple[PairSet, Sequence[int]]], classes: tuple[str, ...], *, seed: int, progress: Progress
) -> BaselineTraining:
    """Show pairs, each set with the indices wanted of it, to baselines."""
    total = sum(len(indices) for _, indices in sources)
    training = BaselineTraining(classes, total, seed)
    done = 0
    for number, (pairs, indices) in enumerate(sources):
        for index in indices:
            pair = pairs[index]
            name = f"{number}/{pair.name}"
            training.add(name, pair.rgb, pair.valid, truth_of(pair, classes), pair.resolution_m)
            done += 1
            progress("Teaching baselines", done, total)
    return training


def panels_of(judgement: Judgement, pairs: PairSet, indices: Sequence[int], covers: Covers) -> dict[str, list[Panel]]:
    """Predict the tiles worth showing again, those of each class from best to worst."""
    panels: dict[str, list[Panel]] = {}
    for number, class_name in enumerate(judgement.classes):
        panels[class_name] = []
        for rank, tile, found in chosen_tiles(judgement, class_name):
            pair = pairs[indices[tile]]
            truth, known = hard_truth(truth_of(pair, (class_name,))[0])
            panels[class_name].append(Panel(rank, pair.name, found, pair.rgb, truth, covers(pair)[number],
                                            known & pair.valid, pair.trees_px))  # fmt: skip
    return panels


def truth_of(pair: ImagePair, classes: Sequence[str]) -> Image:
    """Return the truth of some classes in percent, (class, rows, cols)."""
    return np.asarray(pair.truth[[pair.classes.index(name) for name in classes]])


def _in_threads(tasks: Iterable[Callable[[], Tile]], workers: int) -> Iterator[Tile]:
    """Yield results in the order of their tasks, no more than two a thread waiting."""
    with ThreadPoolExecutor(max_workers=workers) as pool:
        waiting: deque[Future[Tile]] = deque()
        try:
            for task in tasks:
                waiting.append(pool.submit(task))
                if len(waiting) >= 2 * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for left in waiting:
                left.cancel()
