import numpy as np
import pytest

from urbanforest_cli.register import regions_kernel as kernel


def discs_in_cells(discs, height=60, width=80):
    """Cells (height, width) whose centres lie in discs of row, column and radius."""
    row, col = np.mgrid[:height, :width]
    covered = np.zeros((height, width), dtype=bool)
    for r, c, radius in discs:
        covered |= (row - r) ** 2 + (col - c) ** 2 < radius**2
    return covered


def slow_distances(wanted, cap):
    rows, cols = np.nonzero(wanted)
    row, col = np.mgrid[: wanted.shape[0], : wanted.shape[1]]
    if not len(rows):
        return np.full(wanted.shape, (cap + 1) ** 2)
    squared = ((row[..., None] - rows) ** 2 + (col[..., None] - cols) ** 2).min(axis=-1)
    return np.minimum(squared, (cap + 1) ** 2)


def slow_settled(depth, owner):
    """As the rule reads, without ridges: every cell against every disc, twice."""
    height, width = depth.shape
    places = [(i, j) for i in range(height) for j in range(width) if depth[i, j] > 0]
    lost = {}
    for _ in range(2):
        before = dict(lost)
        lost = {
            (i, j): any(
                owner[r, c] >= 0
                and owner[r, c] != owner[i, j]
                and not before.get((r, c), False)
                and (r - i) ** 2 + (c - j) ** 2 <= depth[r, c] ** 2
                and depth[r, c] > kernel.LARGER * depth[i, j]
                for r, c in places
            )
            for i, j in places
        }
    whose = np.full(depth.shape, kernel.NOBODY)
    for i, j in places:
        if owner[i, j] >= 0 and not lost[i, j]:
            whose[i, j] = owner[i, j]
    return whose


def test_distances_are_those_of_the_slow_twin():
    wanted = np.random.default_rng(5).random((40, 50)) < 0.01
    assert (kernel.squared_distances(wanted, 9) == slow_distances(wanted, 9)).all()


def test_depth_is_the_distance_to_open_ground_up_to_the_cap():
    covered = np.zeros((30, 30), dtype=bool)
    covered[5:25, 5:25] = True
    depth = kernel.depths(covered, 8.0)
    assert depth[5, 12] == pytest.approx(0.5)
    assert depth[7, 12] == pytest.approx(2.5)
    assert depth[15, 15] == pytest.approx(8.0)
    assert (depth[~covered] == 0).all()


def test_small_regions_go_and_small_holes_are_filled_but_not_at_the_windows_edge_or_over_unknown_ground():
    percent = np.zeros((30, 30), dtype=np.uint8)
    percent[2:4, 2:4] = 90  # four cells
    percent[0, 10:12] = 90  # two cells at the edge
    percent[10:20, 10:20] = 90
    percent[12, 12] = 0
    percent[15:17, 15:17] = 255
    percent[25, 25] = percent[26, 26] = 90  # they touch at a corner alone
    covered = kernel.cleaned(percent, 50.0, 5)
    assert not covered[2:4, 2:4].any()
    assert not covered[25, 25]
    assert covered[0, 10:12].all()
    assert covered[12, 12]
    assert not covered[15:17, 15:17].any()
    assert covered.sum() == 100 - 4 + 2
    assert kernel.cleaned(percent, 50.0, 4)[2:4, 2:4].all()


def test_a_shape_has_the_cells_whose_centres_it_holds_and_neighbours_share_none():
    left = np.array([(0.0, 0.0), (7.3, 0.0), (4.1, 9.0), (0.0, 9.0), (0.0, 0.0)]) + np.array([1000.0, 2000.0])
    right = np.array([(7.3, 0.0), (12.0, 0.0), (12.0, 9.0), (4.1, 9.0), (7.3, 0.0)]) + np.array([1000.0, 2000.0])
    inside = [np.empty((40, 40), dtype=np.uint8) for _ in range(2)]
    row, col = int(-2009.0 / 0.5) - 4, 1994
    for xy, cells in zip((left, right), inside, strict=True):
        kernel.fill_rings(xy, np.array([0, len(xy)]), 0.5, row, col, cells)
    x, y = (np.arange(40) + col + 0.5) * 0.5, -(np.arange(40) + row + 0.5) * 0.5
    whole = (x[None] > 1000) & (x[None] < 1012) & (y[:, None] > 2000) & (y[:, None] < 2009)
    assert not (inside[0] & inside[1]).any()
    assert ((inside[0] | inside[1]) == whole).all()


def test_rings_in_rings_are_holes():
    outer = np.array([(0, 0), (10, 0), (10, 10), (0, 10), (0, 0)], dtype=float)
    xy = np.concatenate((outer, outer * 0.4 + 3))
    cells = np.empty((12, 12), dtype=np.uint8)
    kernel.fill_rings(xy, np.array([0, 5, 10]), 1.0, -11, -1, cells)
    assert cells.sum() == 100 - 16


@pytest.mark.parametrize("seed", range(4))
def test_settled_cells_are_nearly_those_of_the_slow_twin(seed):
    rng = np.random.default_rng(seed)
    discs = np.column_stack((rng.uniform(5, 35, 9), rng.uniform(5, 35, 9), rng.uniform(2, 7, 9)))
    depth = kernel.depths(discs_in_cells(discs, 40, 40), 10.0)
    owner = np.where(np.arange(40) < 20, 0, 1).astype(np.int32)[None] + np.zeros((40, 1), np.int32)
    owner[30:] = kernel.NOBODY
    fast, slow = kernel.settled(depth, owner, 10.0), slow_settled(depth, owner)
    assert (fast != slow).sum() <= 0.03 * (depth > 0).sum()  # a ridge may hold a little less than all discs on it
    assert (fast[30:] == kernel.NOBODY).all()


def test_a_crown_over_the_border_is_its_owners_and_not_the_neighbours():
    owner = np.where(np.arange(80) < 40, 0, 1).astype(np.int32)[None] + np.zeros((60, 1), np.int32)
    depth = kernel.depths(discs_in_cells([(30, 36, 9.0)]), 10.0)
    whose = kernel.settled(depth, owner, 10.0)
    assert (whose[:, :40][depth[:, :40] > 1.5] == 0).all()
    assert (whose[:, 40:] == 1).sum() <= 0.03 * (depth > 0).sum()


def test_ground_of_nobody_takes_no_fringe():
    owner = np.where(np.arange(80) < 40, 0, kernel.NOBODY).astype(np.int32)[None] + np.zeros((60, 1), np.int32)
    depth = kernel.depths(discs_in_cells([(30, 44, 9.0)]), 10.0)
    whose = kernel.settled(depth, owner, 10.0)
    assert ((whose == 0) == ((depth > 0) & (owner == 0))).all()


@pytest.mark.parametrize("seed", range(6))
def test_covered_ground_of_lots_is_lost_to_nobody(seed):
    """What is somebody's fringe is in a disc about a settled cell of another."""
    rng = np.random.default_rng(seed)
    discs = np.column_stack((rng.uniform(5, 55, 30), rng.uniform(5, 75, 30), rng.uniform(2, 8, 30)))
    depth = kernel.depths(discs_in_cells(discs), 10.0)
    owner = ((np.arange(80) // 9)[None] + 100 * (np.arange(60) // 13)[:, None]).astype(np.int32)
    whose = kernel.settled(depth, owner, 10.0)
    rows, cols = np.nonzero(whose >= 0)
    for i, j in zip(*np.nonzero((depth > 0) & (whose < 0)), strict=True):
        held = (rows - i) ** 2 + (cols - j) ** 2 <= depth[rows, cols] ** 2
        assert (held & (whose[rows, cols] != owner[i, j])).any()


def test_fringe_that_two_lots_reach_has_one_taker_and_it_is_the_one_whose_disc_holds_it_deepest():
    covered = discs_in_cells([(30, 20, 10.0), (30, 37, 10.0)])
    owner = np.full((60, 80), kernel.NOBODY, dtype=np.int32)
    owner[:, 10:24], owner[:, 33:47] = 0, 1
    depth = kernel.depths(covered, 10.0)
    whose = kernel.settled(depth, owner, 10.0)
    taker, first, second = kernel.claims(depth, whose, kernel.reaching(depth, whose, 10.0))
    open_to = covered & (whose < 0)
    for i, j in zip(*np.nonzero(open_to), strict=True):
        over = {}
        for label in (0, 1):
            rows, cols = np.nonzero(whose == label)
            over[label] = (depth[rows, cols] - np.hypot(rows - i, cols - j)).max()
        best = max(over, key=over.get)
        if over[best] > 0.05 and abs(over[0] - over[1]) > 1e-3:
            assert taker[i, j] == best
            assert first[i, j] == pytest.approx(over[best], abs=1e-4)
            assert second[i, j] <= first[i, j]
    fields = []
    for label in (0, 1):
        field = np.empty((60, 80), dtype=np.float32)
        percent = np.where(covered, 100, 0).astype(np.uint8)
        kernel.heights(percent, 50.0, covered, depth, whose, taker, first, second, label, 0, 0, field)
        fields.append(field > 0)
        assert (field != 0).all()
    assert not (fields[0] & fields[1]).any()
    assert ((fields[0] | fields[1]) & covered).sum() > 0.97 * covered.sum()
