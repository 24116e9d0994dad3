import dataclasses

import numpy as np
import pytest

from tests.reference.tiny_coverage import WIDE_HALO, WIDE_STEP, garden, greenness, greenness_of, info_of, wide
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.imagery.inference import CoverageSession, model_plane, predict_at, predict_window
from urbanforest_cli.imagery.window_cells import fill_unknown, gather


@pytest.fixture(scope="module")
def plain():
    info = info_of()
    return CoverageSession(greenness(info), info)


@pytest.fixture(scope="module")
def looking():
    info = info_of(multiple_px=WIDE_STEP, halo_px=WIDE_HALO)
    return CoverageSession(wide(info), info)


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (33, 7), (530, 3)])
def test_any_size_is_predicted_pixel_by_pixel(plain, size):
    rgb = garden(*size)
    valid = np.random.default_rng(0).random(size) > 0.2
    found = plain.predict(rgb, valid)
    assert found.dtype == np.float32
    assert found[:, valid] == pytest.approx(greenness_of(rgb)[:, valid], abs=1e-5)
    assert np.isnan(found[:, ~valid]).all()


def test_fine_pixels_are_averaged_to_the_cells_of_the_model(plain):
    coarse = garden(40, 30)
    fine = coarse.repeat(3, axis=1).repeat(3, axis=2)
    found = predict_at(plain, fine, np.ones((120, 90), bool), (0.2, 0.2))
    assert found[:, 1::3, 1::3] == pytest.approx(greenness_of(coarse), abs=1e-4)
    between = (found[:, 1:-2:3, 1::3] * 2 + found[:, 4::3, 1::3]) / 3
    assert found[:, 2:-1:3, 1::3] == pytest.approx(between, abs=1e-4)


def test_coarse_pixels_are_interpolated_and_averaged_back(plain):
    rgb = np.full((3, 20, 20), 120, np.uint8)
    rgb[1, :, 10:] = 180
    found = predict_at(plain, rgb, np.ones((20, 20), bool), (1.8, 1.8))
    assert found[:, :, :9] == pytest.approx(0.5, abs=1e-5)
    assert (found[:, :, 11:] > 0.999).all()


def test_pixels_that_are_wide_and_low_are_brought_to_square_cells(plain):
    coarse = garden(20, 30)
    found = predict_at(plain, coarse.repeat(2, axis=1), np.ones((40, 30), bool), (0.6, 0.3))
    assert found.reshape(2, 20, 2, 30).mean(axis=2)[:, 1:-1] == pytest.approx(greenness_of(coarse)[:, 1:-1], abs=0.2)
    assert found.shape == (2, 40, 30)


def windowed(session, rgb, valid, *, core, first=(0, 0), resolution_m=(0.6, 0.6)):
    plane = model_plane(session.info, valid.shape, first, resolution_m)

    def read(rows, cols):
        at = slice(rows.start - first[0], rows.stop - first[0]), slice(cols.start - first[1], cols.stop - first[1])
        return rgb[:, at[0], at[1]], valid[at]

    result = np.full((2, *valid.shape), np.nan, np.float32)
    for rows, cols in plane.windows(core):
        there = np.ix_([0, 1], [row - first[0] for row in rows.write], [col - first[1] for col in cols.write])
        result[there] = predict_window(session, plane, gather(plane, rows, cols, read))
    return result


@pytest.mark.parametrize("resolution_m", [0.6, 0.3, 0.45, 0.9])
@pytest.mark.parametrize("holes", [False, True])
def test_no_way_of_cutting_shows_in_the_result(looking, resolution_m, holes):
    rgb = garden(90, 71)
    valid = np.ones((90, 71), bool)
    if holes:
        valid[20:50, 10:40] = False
        valid[:, 60] = False
    cut = {"resolution_m": (resolution_m, resolution_m)}
    whole = windowed(looking, rgb, valid, core=1000, **cut)
    assert np.nanmax(whole) - np.nanmin(whole) > 0.5
    for core in (8, 36):
        assert windowed(looking, rgb, valid, core=core, **cut) == pytest.approx(whole, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("offset", [(0, 0), (1, 3), (13, 22)])
@pytest.mark.parametrize("resolution_m", [0.6, 0.3, 0.4])
def test_a_part_of_the_image_gives_that_part_of_the_result_but_for_its_border(looking, offset, resolution_m):
    rgb, first = garden(170, 160), (1003, 777)
    valid = np.ones((170, 160), bool)
    cut = {"resolution_m": (resolution_m, resolution_m)}
    whole = windowed(looking, rgb, valid, core=48, first=first, **cut)
    row, col = offset
    part = windowed(
        looking, rgb[:, row:, col:], valid[row:, col:], core=32, first=(1003 + row, 777 + col), **cut
    )  # fmt: skip
    border = round(12 * 0.6 / resolution_m)
    inside = part[:, border:-border, border:-border]
    assert inside == pytest.approx(whole[:, row + border : -border, col + border : -border], abs=1e-6)
    if offset == (1, 3) and resolution_m == 0.6:  # the network does see where tiles begin: anchoring is what helps
        free = windowed(looking, rgb[:, row:, col:], valid[row:, col:], core=32, first=(1003, 777))
        assert np.abs(free[:, border:-border, border:-border] - inside).max() > 0.05


def test_without_its_halo_the_seams_would_show(looking):
    blind = CoverageSession(wide(looking.info), dataclasses.replace(looking.info, halo_px=0))
    rgb, valid = garden(150, 131), np.ones((150, 131), bool)
    apart = np.abs(windowed(blind, rgb, valid, core=32) - windowed(blind, rgb, valid, core=1000))
    assert apart.max() > 0.05


def test_what_is_missing_looks_like_what_is_around_it(looking):
    rgb = np.full((3, 64, 64), 90, np.uint8)
    valid = np.ones((64, 64), bool)
    untouched = looking.predict(rgb, valid)
    valid[20:22, 30:50] = False
    valid[:, 9] = False
    holed = np.where(valid, rgb, 0).astype(np.uint8)
    found = looking.predict(holed, valid)
    assert found[:, valid] == pytest.approx(untouched[:, valid], abs=1e-5)


def test_fill_takes_the_smallest_block_that_knows_and_at_last_the_model_s_mean():
    cells = np.zeros((3, 8, 16), np.float32)
    known = np.zeros((8, 16), bool)
    cells[:, 0, 0], known[0, 0] = 10, True
    cells[:, 3, 3], known[3, 3] = 30, True
    filled = fill_unknown(cells, known, 8, (1.0, 2.0, 3.0))
    assert filled[0, 0, :4].tolist() == [10, 10, 20, 20]
    assert filled[0, 2, :4].tolist() == [20, 20, 30, 30]
    assert filled[0, 7, 7] == 20
    assert filled[:, 0, 15].tolist() == [1, 2, 3]


def test_a_model_that_is_none_or_breaks_its_word_is_refused():
    info = info_of()
    with pytest.raises(InputError, match="runtime does not take"):
        CoverageSession(b"no model", info)
    liar = CoverageSession(greenness(info), dataclasses.replace(info, classes=("canopy",), thresholds=(0.5,)))
    with pytest.raises(InputError, match="another shape"):
        liar.predict(garden(8, 8), np.ones((8, 8), bool))
    odd = CoverageSession(wide(info), info)
    with pytest.raises(InputError, match="another shape"):
        odd.predict(garden(9, 9), np.ones((9, 9), bool))
