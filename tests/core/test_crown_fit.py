import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.distance import cdist

from tests.reference import crown_fit as reference
from urbanforest_cli.core.crown_fit import fit_crowns
from urbanforest_cli.core.crown_fit_kernel import fit_kernel

CELL = 0.3
SUB = 5


def painted(discs, width_m=30.0, height_m=24.0):
    """Return shares of cells that discs (x, y, radius) cover, y downwards, in metres from the upper left."""
    shape = round(height_m / CELL), round(width_m / CELL)
    part = CELL / SUB
    y, x = (np.mgrid[0 : shape[0] * SUB, 0 : shape[1] * SUB] + 0.5) * part
    mask = np.zeros(x.shape, bool)
    for a, b, r in discs:
        west, north = max(0, int((a - r) / part)), max(0, int((b - r) / part))
        near = slice(north, int((b + r) / part) + 2), slice(west, int((a + r) / part) + 2)
        mask[near] |= (x[near] - a) ** 2 + (y[near] - b) ** 2 <= r * r
    return mask.reshape(shape[0], SUB, shape[1], SUB).mean(axis=(1, 3))


def fitted(covered, stems=None, mean=2.5, variance=0.25, **options):
    """Fit to shares; return (n, 4) x, y, radius, shown, y downwards from the upper left, by place."""
    stems = np.ones(covered.shape, bool) if stems is None else stems
    crowns = fit_crowns(
        covered, stems, x0=100.0, y_top=50.0, pixel_m=CELL, radius_mean_m=mean, radius_variance_m2=variance, **options
    )
    found = np.column_stack([crowns.xy[:, 0] - 100.0, 50.0 - crowns.xy[:, 1], crowns.radius_m, crowns.shown])
    return found[np.lexsort(found.T[::-1])]


def iou(discs, covered):
    again = painted(discs[:, :3], covered.shape[1] * CELL, covered.shape[0] * CELL)
    return np.minimum(again, covered).sum() / np.maximum(again, covered).sum()


def ragged(seed, shape, smooth):
    """Percentages of random blobs with soft rims, some cells not known."""
    rng = np.random.default_rng(seed)
    field = ndimage.gaussian_filter(rng.normal(size=shape), smooth)
    field = 50 + 100 * (field - np.quantile(field, rng.uniform(0.1, 0.8))) / (field.std() + 1e-9)
    percent = np.clip(field, 0, 100).astype(np.uint8)
    percent[rng.random(shape) < 0.01] = 255
    return percent


@pytest.mark.parametrize("smooth", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("seed", range(12))
def test_kernel_is_the_plain_loop(seed, smooth):
    rng = np.random.default_rng(seed)
    percent = ragged(seed, tuple(rng.integers(8, 90, 2)), smooth)
    stems = (ndimage.gaussian_filter(rng.normal(size=percent.shape), 5) > -0.05).astype(np.uint8)
    fixed = np.column_stack([rng.uniform(0, 60, (3, 2)), rng.uniform(2, 9, 3)])[: seed % 4]
    coverage = 1.0 if seed % 3 else rng.uniform(0.2, 0.9)
    law = rng.uniform(2, 9), rng.uniform(0, 4), 2.0, 1.5, 0.25
    arguments = (percent, stems, *law, coverage, np.uint64(rng.integers(2**63)), fixed)
    discs, kinds = fit_kernel(*arguments)
    true_discs, true_kinds = reference.fit(*arguments)
    np.testing.assert_array_equal(kinds, true_kinds)
    np.testing.assert_allclose(discs, true_discs, atol=1e-6)


def test_discs_that_stand_alone_are_recovered():
    true = np.array([[5.1, 5.3, 2.0], [12.03, 6.2, 3.1], [20.44, 5.02, 2.5], [6.3, 17.11, 2.9], [23.2, 17.3, 4.6]])
    found = fitted(painted(true))
    np.testing.assert_allclose(found[:, :2], true[np.lexsort(true.T[::-1]), :2], atol=0.3 * CELL)
    np.testing.assert_allclose(found[:, 2], true[np.lexsort(true.T[::-1]), 2], atol=0.3 * CELL)
    assert found[:, 3].all()


@pytest.mark.parametrize("apart", [1.35, 1.6, 2.0])
def test_discs_that_meet_are_told_apart(apart):
    true = np.array([[8.0, 12.0, 2.5], [8.0 + 2.5 * apart, 12.4, 2.5]])
    found = fitted(painted(true))
    assert len(found) == 2
    np.testing.assert_allclose(found[:, :3], true, atol=CELL)


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_wrong_prior_hardly_matters_where_outlines_show_crowns(factor):
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(4, 56, 6.0), np.arange(4, 44, 6.0))
    true = np.column_stack(
        [(x + rng.uniform(-1.2, 1.2, x.shape)).ravel(), (y + rng.uniform(-1.2, 1.2, y.shape)).ravel()]
    )
    true = np.column_stack([true, rng.normal(2.6, 0.4, len(true))])
    covered = painted(true, 60.0, 48.0)
    found = fitted(covered, mean=2.6 * factor, variance=0.16 * factor)
    assert abs(len(found) / len(true) - 1) < 0.08
    assert iou(found, covered) > 0.96
    near = cdist(true[:, :2], found[:, :2])
    assert np.mean(near.min(axis=1) < 0.5) > 0.9
    assert abs(np.median(found[near.argmin(axis=1), 2] / true[:, 2]) - 1) < 0.02


def test_a_hedge_becomes_a_row_of_crowns():
    covered = np.zeros((40, 200))
    covered[14:26, 10:190] = 1
    found = fitted(covered, mean=2.0)
    assert 11 <= len(found) <= 22
    np.testing.assert_allclose(found[:, 1], 20 * CELL, atol=1.5 * CELL)
    assert found[0, 0] < 10 * CELL + 3
    assert found[-1, 0] > 190 * CELL - 3
    assert (np.diff(found[:, 0]) > 0.6 * 3.4).all()
    assert iou(found, covered) > 0.8


def test_closed_canopy_is_filled_at_random():
    y, x = np.mgrid[0:170, 0:200]
    covered = np.hypot((x - 100) / 90, (y - 85) / 75) <= 1 + 0.08 * np.sin(7 * np.arctan2(y - 85, x - 100))
    one, other = fitted(covered, key=1), fitted(covered, key=2)
    for found in (one, other):
        assert (found[:, 3] == 0).sum() > 25
        assert iou(found, covered.astype(float)) > 0.85
        assert painted(found[:, :3], 60.0, 51.0).sum() == pytest.approx(covered.sum(), rel=0.02)
        inner = found[found[:, 3] == 0]
        scale = cdist(inner[:, :2], inner[:, :2]) / (inner[:, None, 2] + inner[None, :, 2])
        assert scale[~np.eye(len(inner), dtype=bool)].min() > 0.75 / 1.4
        assert np.std(inner[:, 2]) / inner[:, 2].mean() == pytest.approx(0.5 / 2.5, abs=0.08)
    assert np.mean(cdist(one[:, :2], other[:, :2]).min(axis=1) > 0.3) > 0.6
    assert abs(len(one) / len(other) - 1) < 0.15


def test_crowns_of_closed_canopy_do_not_overlap_by_more_than_is_asked():
    covered = np.ones((150, 150), bool)
    for overlap in (0.0, 0.25, 0.4):
        found = fitted(covered, overlap=overlap, coverage=1.0)
        near = cdist(found[:, :2], found[:, :2]) / (found[:, None, 2] + found[None, :, 2])
        near = near[~np.eye(len(found), dtype=bool)].min()
        assert (1 - overlap) / 1.4 <= near + 1e-9
    assert len(fitted(covered, overlap=0.4)) > 1.3 * len(fitted(covered, overlap=0.0))


@pytest.mark.parametrize("seed", range(4))
def test_ragged_ground_is_covered_and_its_area_kept(seed):
    percent = ragged(seed, (150, 150), 8.0)
    known = np.where(percent > 100, 0, percent)
    found = fitted(percent)
    again = painted(found[:, :3], 45.0, 45.0)
    assert (again >= 0.5).sum() == pytest.approx((known >= 50).sum(), rel=0.05)
    assert iou(found, (known >= 50).astype(float)) > 0.78


def test_a_large_crown_is_one_and_a_park_is_many():
    assert len(fitted(painted([(15, 12, 6.0)]))) == 1
    park = fitted(painted([(35, 35, 30.0)], 70.0, 70.0))
    assert len(park) > 60


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_share_of_the_ground_is_covered(share):
    ratios = []
    covered = np.ones((200, 200), bool)
    for key in range(8):
        found = fitted(covered, coverage=share, key=key)
        ratios.append(painted(found[:, :3], 60.0, 60.0).mean() / share)
    assert np.mean(ratios) == pytest.approx(1, abs=0.04)


def test_crowns_that_stand_are_not_planted_again():
    true = np.array([[6.0, 12.0, 2.5], [15.0, 12.0, 2.5], [24.0, 12.0, 2.5]])
    covered = painted(true)
    given = {"fixed_xy": np.array([[115.0, 38.0]]), "fixed_radius_m": np.array([2.6])}
    found = fitted(covered, **given)
    np.testing.assert_allclose(found[:, :3], true[[0, 2]], atol=CELL)
    assert len(fitted(painted(true[1:2]), **given)) == 0


def test_stems_stand_only_where_they_may():
    percent = ragged(1, (120, 160), 6.0)
    stems = np.zeros(percent.shape, bool)
    stems[20:70, 30:100] = True
    found = fitted(percent, stems)
    assert len(found) > 3
    assert stems[(found[:, 1] / CELL).astype(int), (found[:, 0] / CELL).astype(int)].all()
    assert len(fitted(percent, np.zeros_like(stems))) == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (3, 3), (120, 120)])
def test_grids_of_one_kind(shape):
    some = np.ones(shape, bool)
    assert len(fitted(~some)) == 0
    assert len(fitted(np.full(shape, 255, np.uint8))) == 0
    assert len(fitted(some, coverage=0.0)) == 0
    full = fitted(some)
    assert np.isfinite(full).all()
    assert (full[:, 2] > 0).all()
    assert len(full) >= 1 or shape == (1, 1)


def test_a_covered_cell_is_no_crown_but_a_small_bush_is():
    covered = np.zeros((30, 30), bool)
    covered[12, 17] = True
    assert len(fitted(covered)) == 0
    covered[10:15, 15:20] = True
    assert len(fitted(covered)) == 1


def test_same_input_same_crowns_and_key_matters():
    covered = np.ones((100, 100), bool)
    np.testing.assert_array_equal(fitted(covered, key=7), fitted(covered, key=7))
    assert not np.array_equal(fitted(covered, key=7)[:3], fitted(covered, key=8)[:3])


def test_shares_percentages_and_masks_say_the_same():
    true = painted([(6, 6, 2.5), (14, 9, 3.0)])
    whole = np.round(true * 100).astype(np.uint8)
    np.testing.assert_array_equal(fitted(true), fitted(whole))
    mask = true >= 0.5
    np.testing.assert_array_equal(fitted(mask), fitted(mask.astype(np.uint8) * np.uint8(100)))


def test_turned_ground_has_the_same_crowns_turned():
    covered = painted([(5, 6, 2.5), (9.2, 7, 2.4), (18, 9, 3.1), (22.4, 11, 2.2), (8, 17, 2.7)])
    found = fitted(covered)
    wide, high = covered.shape[1] * CELL, covered.shape[0] * CELL
    for turned, back in (
        (covered[:, ::-1], lambda f: [wide - f[:, 0], f[:, 1], f[:, 2]]),
        (covered[::-1], lambda f: [f[:, 0], high - f[:, 1], f[:, 2]]),
        (covered.T, lambda f: [f[:, 1], f[:, 0], f[:, 2]]),
    ):
        again = np.column_stack(back(fitted(np.ascontiguousarray(turned))))
        assert len(again) == len(found)
        assert cdist(found[:, :3], again).min(axis=1).max() < 0.5 * CELL


def test_cells_of_another_size_give_the_same_crowns():
    true = np.array([[6.0, 6.0, 2.5], [10.3, 6.4, 2.3], [20.0, 14.0, 3.0]])
    covered = painted(true)
    half = covered.reshape(40, 2, 50, 2).mean(axis=(1, 3))
    crowns = fit_crowns(
        half, np.ones(half.shape, bool), x0=0, y_top=0, pixel_m=2 * CELL, radius_mean_m=2.5, radius_variance_m2=0.25
    )
    found = np.column_stack([crowns.xy * (1, -1), crowns.radius_m])
    np.testing.assert_allclose(found[found[:, 0].argsort()], true, atol=0.35)
