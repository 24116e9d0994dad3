from __future__ import annotations

import json

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.tile_counts import tile_counts

TILES = np.array([shapely.box(10 * i, 0, 10 * i + 10, 10) for i in range(4)], dtype=object)


def plants(*counts):
    return np.array([(10 * tile + 5, 5.0) for tile, count in enumerate(counts) for _ in range(count)]).reshape(-1, 2)


def test_counts_and_what_they_say_are_reckoned_by_hand():
    found = tile_counts(TILES, plants(4, 2, 1, 0), plants(3, 4, 1, 5))
    assert (found.tiles, found.tiles_with_real) == (4, 3)
    assert found.real == [4, 2, 1, 0]
    assert found.model == [3, 4, 1, 5]
    assert found.ratio == pytest.approx(8 / 7)
    assert found.error_mean == pytest.approx(1.0)
    assert found.correlation == pytest.approx(np.corrcoef([4, 2, 1], [3, 4, 1])[0, 1])
    assert found.rank_correlation == pytest.approx(0.5)
    json.dumps(found.as_record(), allow_nan=False)


def test_without_real_plants_nothing_is_said():
    found = tile_counts(TILES, plants(), plants(1, 1))
    assert found.model == [1, 1, 0, 0]
    assert found.ratio is None
    assert tile_counts(TILES, plants(2), plants(2)).correlation is None
    assert tile_counts(TILES[:0], plants(1), plants(1)).tiles == 0
