from fractions import Fraction

import numpy as np
import pytest
from pyproj import CRS

from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.windows import Axis, first_pixel, mirrored, plane_of

RATIOS = [Fraction(1), Fraction(2), Fraction(5, 3), Fraction(11), Fraction(4, 5), Fraction(1, 3)]


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("first", [0, 5, 1_000_003, -17])
@pytest.mark.parametrize("length", [1, 2, 97, 640])
@pytest.mark.parametrize("core", [8, 24, 1000])
def test_every_pixel_is_given_by_one_window_that_has_what_it_needs(ratio, first, length, core):
    axis = Axis(first, length, ratio, step=8, halo=8)
    spans = axis.spans(core)
    assert [pixel for span in spans for pixel in span.write] == list(axis.pixels)
    assert len({len(span.tile) for span in spans}) == 1
    for span in spans:
        assert span.tile.start % 8 == len(span.tile) % 8 == 0
        assert set(mirrored(span.tile, axis.cells).tolist()) <= set(span.cells)
        assert set(span.read) <= set(axis.pixels)
        by = axis.to_pixels(span)
        assert by is None or 0 <= by.index.min() <= by.index.max() < len(span.tile)
        centres = [(pixel + 0.5) / ratio for pixel in (span.write[0], span.write[-1])]
        assert span.tile.start + 8 <= min(centres) <= max(centres) <= span.tile.stop - 8


@pytest.mark.parametrize("ratio", RATIOS)
def test_cells_are_made_from_the_pixels_read(ratio):
    axis = Axis(3, 400, ratio, step=8, halo=16)
    for span in axis.spans(40):
        for piece in axis.pieces(span.cells, 50):
            read = axis.read_for(piece)
            assert set(read) <= set(span.read)
            for cell in (piece[0], piece[-1]):
                assert read.start <= max(cell * ratio, 3)
                assert min((cell + 1) * ratio, 403) <= read.stop


def test_a_part_is_cut_out_of_the_same_cells():
    axis = Axis(100, 5000, Fraction(2), step=32, halo=32)
    spans = axis.spans(64, range(1000, 1500))
    assert [pixel for span in spans for pixel in span.write] == list(range(1000, 1500))
    assert all(span.tile.start % 32 == 0 for span in spans)
    assert len(spans) < 6


def test_mirrors_at_the_outermost_as_often_as_it_takes():
    assert mirrored(range(-3, 7), range(4)).tolist() == [3, 2, 1, 0, 1, 2, 3, 2, 1, 0]
    assert mirrored(range(-2, 4), range(1, 2)).tolist() == [1] * 6
    assert set(mirrored(range(-500, 500), range(10, 13)).tolist()) == {10, 11, 12}


def test_parts_of_a_raster_know_which_of_its_pixels_they_have():
    rng = np.random.default_rng(0)
    for size in (0.6, 0.3, 1 / 3, 0.6000000000000106, 2e-6):
        for fraction in (0.0, 0.5, 0.25, 0.9999999):
            place = (rng.integers(1_000, 500_000) + fraction) * size
            grid = RasterGrid(5000, 5000, (size, 0.0, place, 0.0, -size, 8 * place), CRS.from_epsg(32633))
            row, col = first_pixel(grid)
            for part_row, part_col in rng.integers(0, 5000, (20, 2)):
                part = grid.window(int(part_row), int(part_col), 10, 10)
                assert first_pixel(part) == (row + part_row, col + part_col)


def test_halos_are_whole_steps_and_one_more_where_pixels_are_not_cells():
    square = plane_of((100, 100), (0, 0), (0.5405, 0.5375), cell_m=0.6, multiple_px=32, halo_px=40)
    assert square.rows.ratio == square.cols.ratio
    plane = plane_of((100, 100), (0, 0), (0.6, 0.3), cell_m=0.6, multiple_px=32, halo_px=40)
    assert (plane.cols.ratio, plane.cols.halo, plane.rows.ratio, plane.rows.halo) == (1, 64, 2, 96)
    assert plane_of((9, 9), (0, 0), (0.3, 0.3), cell_m=0.6, multiple_px=4, halo_px=0).rows.halo == 4
    assert plane_of((9, 9), (0, 0), (0.6, 0.6), cell_m=0.6, multiple_px=4, halo_px=0).rows.halo == 0
