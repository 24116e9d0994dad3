"""Judging a finished map block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.judging.baselines import ALL
from urbanforest_cli.imagery.judging.plots import Panel, chosen_tiles
from urbanforest_cli.imagery.judging.results import Judgement, Tile, judge, judge_tile
from urbanforest_cli.imagery.judging.scores import Floats, hard_truth

Percent = NDArray[np.uint8]
Window = tuple[int, int, int, int]
"""First row and column, rows and columns."""
Reads = Callable[[Window], Percent]
"""Returns (class, rows, cols) percentages of a window of the map, 255 where unknown."""
BLOCK_PX = 256


def blocks(grid: RasterGrid) -> Iterator[Window]:
    """Yield windows that cover a grid, `BLOCK_PX` high and wide but for the last."""
    for row in range(0, grid.height_px, BLOCK_PX):
        for col in range(0, grid.width_px, BLOCK_PX):
            yield row, col, min(BLOCK_PX, grid.height_px - row), min(BLOCK_PX, grid.width_px - col)


def judge_map(
    grid: RasterGrid,
    name: str,
    read_map: Reads,
    read_truth: Reads,
    classes: tuple[str, ...],
    thresholds: tuple[float, ...],
    trees_px: Floats | None,
    *,
    seed: int,
    progress: Progress,
) -> Judgement | None:
    """Hold a map against its truth; None where there is no pixel that both know.

    Parameters
    ----------
    grid, name
        Of the map; the name is what tables call it.
    read_map, read_truth
        Of `classes`, on the pixels of `grid`.
    thresholds
        Shares, 0 to 1, from which on each class counts as covered.
    trees_px
        (n, 2) rows and columns on the map.
    seed, progress
        Root of the streams that blocks are drawn by, and who is told.
    """
    windows = list(blocks(grid))
    least = _least(thresholds)
    tiles: list[Tile] = []
    for done, window in enumerate(windows, start=1):
        values, truth = read_map(window), read_truth(window)
        truth = np.where(values == UNKNOWN, UNKNOWN, truth).astype(np.uint8)
        if (truth != UNKNOWN).any():
            found = {name: values >= least, ALL: np.ones(values.shape, dtype=np.bool_)}
            place = f"row {window[0]} column {window[1]}"
            trees = None if trees_px is None else _within(trees_px, window)
            tiles.append(judge_tile(place, place, name, found, truth, np.ones(truth.shape[1:], np.bool_), trees))
        progress("Judging the map", done, len(windows))
    return judge(tiles, classes, (name, ALL), seed=seed) if tiles else None


def panels_of(
    judgement: Judgement,
    grid: RasterGrid,
    read_map: Reads,
    read_truth: Reads,
    thresholds: tuple[float, ...],
    trees_px: Floats | None,
) -> dict[str, list[Panel]]:
    """Read the blocks worth showing again, those of each class from best to worst."""
    by_name = {f"row {window[0]} column {window[1]}": window for window in blocks(grid)}
    least = _least(thresholds)
    panels: dict[str, list[Panel]] = {}
    for number, class_name in enumerate(judgement.classes):
        panels[class_name] = []
        for rank, tile, found in chosen_tiles(judgement, class_name):
            name = judgement.tiles[tile].name
            values, truth = (read(by_name[name])[number] for read in (read_map, read_truth))
            covered, known = hard_truth(truth)
            trees = None if trees_px is None else _within(trees_px, by_name[name])
            panels[class_name].append(Panel(rank, name, found, None, covered, values >= least[number],
                                            known & (values != UNKNOWN), trees))  # fmt: skip
    return panels


def _least(thresholds: tuple[float, ...]) -> NDArray[np.float64]:
    return np.array([round(100 * value, 6) for value in thresholds])[:, None, None]  # 100 * 0.55 is more than 55


def _within(trees_px: Floats, window: Window) -> Floats:
    row, col, rows, cols = window
    inside = (trees_px >= (row, col)).all(axis=1) & (trees_px < (row + rows, col + cols)).all(axis=1)
    return np.asarray(trees_px[inside] - (row, col))
