from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.imagery.learning.pairs import Discs
from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.imagery.learning import tiles as module
from urbanforest_cli.imagery.learning.tiles import Tile, Tiles, crops_in, fitted, tile_of

ONE = Fraction(1)


def test_a_pair_of_the_models_resolution_is_taken_as_it_is():
    pair = Discs()[0]
    tile = tile_of(pair, 0.6, ONE)
    np.testing.assert_array_equal(tile.rgb, pair.rgb)
    np.testing.assert_array_equal(tile.truth, pair.truth)


def test_what_the_image_does_not_hold_is_unknown_and_medium_gray():
    valid = np.ones((64, 64), bool)
    valid[:10] = False
    tile = tile_of(replace(Discs()[0], valid=valid), 0.6, ONE)
    assert (tile.truth[:, :10] == UNKNOWN).all()
    assert (tile.rgb[:, :10] == 127).all()
    assert (tile.truth[:, 10:] != UNKNOWN).all()


def test_finer_pairs_are_averaged_and_keep_their_area():
    pair = replace(Discs()[0], resolution_m=(0.2, 0.3))
    tile = tile_of(pair, 0.6, ONE)
    assert tile.rgb.shape == (3, 32, 22)
    assert tile.truth.mean() == pytest.approx(pair.truth.mean(), rel=0.05)
    assert ((tile.truth > 0) & (tile.truth < 100)).any()


def test_unknown_truth_has_no_part_in_an_average():
    pair = Discs(classes=("canopy",))[0]
    truth = np.full((1, 64, 64), 40, np.uint8)
    truth[:, :, 0] = UNKNOWN
    truth[:, :2] = UNKNOWN
    tile = tile_of(replace(pair, truth=truth, resolution_m=(0.3, 0.3)), 0.6, ONE)
    assert (tile.truth[0, 0] == UNKNOWN).all()
    assert (tile.truth[0, 1:] == 40).all()


def test_an_image_of_256_is_enlarged_to_286_as_published():
    tile = tile_of(Discs(side_px=256)[0], 0.6, Fraction(286, 256))
    assert tile.rgb.shape == (3, 286, 286)


def test_tiles_are_read_once_while_they_fit(monkeypatch):
    reads = []

    class Counted(Discs):
        def __getitem__(self, index):
            reads.append(index)
            return super().__getitem__(index)

    tiles = Tiles(Counted(), [1, 4], 0.6, ONE)
    assert [tiles[0].name, tiles[1].name, tiles[0].name] == ["town_2020_1", "town_2018_4", "town_2020_1"]
    assert tiles[1:][0].name == "town_2018_4"
    assert reads == [1, 4]
    monkeypatch.setattr(module, "BYTES_KEPT", 0)
    forgetful = Tiles(Counted(), [2], 0.6, ONE)
    assert forgetful[0] is not forgetful[0]
    assert reads == [1, 4, 2, 2]


def test_a_look_tells_colours_size_and_whether_anything_is_known():
    tiles = Tiles(Discs(unknown=(1,)), [0, 1], 0.6, ONE)
    first, second = tiles.look(0), tiles.look(1)
    assert (first.group, first.size, first.known, second.known) == ("town_2018", (64, 64), True, False)
    assert first.mean == pytest.approx(tiles[0].rgb.mean(axis=(1, 2)) / 255)
    assert first.deviation == pytest.approx(tiles[0].rgb.std(axis=(1, 2)) / 255)


@pytest.mark.parametrize(
    ("size", "multiple", "expected"),
    [((64, 64), 32, (64, 64)), ((60, 64), 32, (64, 64)), ((286, 286), 256, (256, 256)), ((20, 300), 32, (32, 320))],
)
def test_sides_become_multiples_by_what_loses_least(size, multiple, expected):
    rgb = np.arange(size[0] * size[1] * 3, dtype=np.uint32).astype(np.uint8).reshape(3, *size)
    tile = fitted(Tile("x", rgb, np.zeros((1, *size), np.uint8)), multiple)
    assert tile.rgb.shape[1:] == tile.truth.shape[1:] == expected
    assert (tile.truth == 0).sum() == min(size[0] * size[1], expected[0] * expected[1])


def test_crops_of_a_tile_have_its_area():
    assert [crops_in(size, 128) for size in ((256, 256), (512, 512), (100, 100), (286, 286))] == [4, 16, 1, 5]
