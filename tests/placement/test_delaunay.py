from fractions import Fraction

import numpy as np
import pytest

from tests.reference.medial_axis import delaunay_triangles
from urbanforest_cli.placement.delaunay import GRID_M, in_circle, insert_point, orientation, start_triangulation


def triangulate(points):
    """Return the triangles the kernel makes of points inserted in their order."""
    x, y = (np.append(column, np.nan) for column in points.T)
    ghost = len(points)
    origin, twin = np.full((2, 8 * ghost + 32), -1, dtype=np.int32)
    start = np.full(ghost + 1, -1, dtype=np.int32)
    stack = np.empty(2 * ghost + 16, dtype=np.int32)
    third = next(c for c in range(2, ghost) if orientation(x[0], y[0], x[1], y[1], x[c], y[c]) != 0)
    count = start_triangulation(x, y, 0, 1, third, ghost, origin, twin, start)
    same = {}
    for p in range(2, ghost):
        if p != third:
            count, same[p] = insert_point(x, y, p, start[0], ghost, origin, twin, start, count, stack)
    used = 4 * np.arange(count)[:, None] + np.arange(3)
    assert (twin[twin[used]] == used).all()
    return [t for t in origin[used] if ghost not in t], same


def snapped(points):
    return np.round(points / GRID_M) * GRID_M


def exact_circle(a, b, c, d):
    rows = []
    for p in (a, b, c):
        px, py = Fraction(float(p[0])) - Fraction(float(d[0])), Fraction(float(p[1])) - Fraction(float(d[1]))
        rows.append((px, py, px * px + py * py))
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = rows
    return a0 * (b1 * c2 - b2 * c1) - a1 * (b0 * c2 - b2 * c0) + a2 * (b0 * c1 - b1 * c0)


def exact_turn(a, b, c):
    ax, ay, bx, by, cx, cy = (Fraction(float(v)) for v in (*a, *b, *c))
    return (ax - cx) * (by - cy) - (ay - cy) * (bx - cx)


def test_kernel_agrees_with_scipy_on_points_in_general_position():
    points = snapped(np.random.default_rng(0).uniform(0, 100, (300, 2)))
    triangles, _ = triangulate(points)
    assert {frozenset(t.tolist()) for t in triangles} == delaunay_triangles(points)


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_no_point_of_a_lattice_lies_in_the_circle_of_a_triangle_though_all_are_ties(turn):
    columns, rows = np.meshgrid(np.arange(7.0), np.arange(6.0))
    lattice = np.column_stack([columns.ravel(), rows.ravel()])
    c, s = np.cos(turn), np.sin(turn)
    points = snapped(1000 + lattice @ np.array([[c, s], [-s, c]]))
    np.random.default_rng(1).shuffle(points)
    triangles, _ = triangulate(points)
    total = sum(exact_turn(*points[t]) / 2 for t in triangles)
    assert all(exact_turn(*points[t]) > 0 for t in triangles)
    assert float(total) == pytest.approx(30.0, abs=1e-5)
    for t in triangles:
        for p in range(len(points)):
            if p not in t:
                assert exact_circle(*points[t], points[p]) <= 0


def test_a_point_given_twice_is_one_vertex():
    points = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [1.0, 1.0], [1.0, 1.0], [4.0, 0.0]])
    _, same = triangulate(points)
    assert same == {3: 3, 4: 3, 5: 1}


def test_points_almost_on_a_line_turn_the_way_they_do():
    rng = np.random.default_rng(2)
    for _ in range(300):
        a, b = snapped(rng.uniform(0, 1e5, (2, 2)))
        c = snapped(a + rng.uniform(0, 1) * (b - a)) + rng.integers(-1, 2, 2) * GRID_M
        assert np.sign(orientation(*a, *b, *c)) == np.sign(float(exact_turn(a, b, c)))


def test_points_almost_on_a_circle_are_told_apart():
    rng = np.random.default_rng(3)
    for _ in range(300):
        centre, radius = rng.uniform(0, 1e3, 2), rng.uniform(1, 100)
        angle = np.sort(rng.uniform(0, 2 * np.pi, 4))
        a, b, c, d = snapped(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        if exact_turn(a, b, c) > 0:
            assert in_circle(*a, *b, *c, *d) == (exact_circle(a, b, c, d) > 0)
