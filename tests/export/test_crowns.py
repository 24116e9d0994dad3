import numpy as np
import pytest
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from urbanforest_cli.export import crowns as crowns_module
from urbanforest_cli.export.crowns import Crowns, draw_crowns
from urbanforest_cli.export.drawing import fill_polygons, make_pane, painted_share


def pane_of(width_px: int, bounds, height_px: int | None = None):
    height_px = height_px or width_px
    figure = Figure(figsize=(width_px / 100, height_px / 100), dpi=100)
    FigureCanvasAgg(figure)
    return make_pane(figure, (0, 0, width_px, height_px), bounds, "#ffffff")


def picture(pane) -> np.ndarray:
    canvas = pane.axes.get_figure().canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(float)


def black(xy, radius_m, tall=True) -> Crowns:
    xy = np.asarray(xy, dtype=float).reshape(-1, 2)
    radius = np.broadcast_to(np.asarray(radius_m, dtype=float), len(xy)).copy()
    return Crowns(xy, radius, np.zeros((len(xy), 3)), np.full(len(xy), tall))


@pytest.mark.parametrize("radius_m", [0.2, 0.4, 1.0, 3.0, 12.0])
def test_a_crown_covers_its_true_area_and_stands_in_its_place(radius_m):
    """On white paper at 10 px a metre the darkness adds up to the circle's area, its rim included."""
    pane = pane_of(400, (0, 0, 40, 40))
    draw_crowns(pane, black([[17, 23]], radius_m), shadows=False)
    dark = (255 - picture(pane).mean(axis=2)) / 255 > 0.3
    reach = radius_m * 10
    rows, columns = np.nonzero(dark)
    assert dark.sum() == pytest.approx(np.pi * reach**2, rel=0.03, abs=2.2 * np.pi * reach * 0.35)
    assert columns.mean() + 0.5 == pytest.approx(170, abs=0.5)
    assert rows.mean() + 0.5 == pytest.approx(400 - 230, abs=0.5)
    assert columns.max() - columns.min() + 1 == pytest.approx(2 * reach, abs=1.5)


def test_crowns_below_a_pixel_darken_by_the_share_they_cover():
    pane = pane_of(100, (0, 0, 100, 100))
    rng = np.random.default_rng(0)
    spots = rng.uniform(0, 100, (20_000, 2))
    draw_crowns(pane, black(spots, 0.2), shadows=False)
    share = 1 - picture(pane).mean() / 255
    cover = 2 * np.pi * 0.2**2
    assert share == pytest.approx(-np.expm1(-1.5 * cover), abs=0.03)


def test_trees_lie_over_shrubs_whatever_their_order():
    pane = pane_of(100, (0, 0, 10, 10))
    colour = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    draw_crowns(
        pane, Crowns(np.full((2, 2), 5.0), np.array([2.0, 3.0]), colour, np.array([True, False])), shadows=False
    )
    middle = picture(pane)[50, 50]
    assert middle[0] > 200 > middle[2]


def test_plants_outside_the_pane_are_not_drawn_but_crowns_that_reach_in_are():
    crowns = black([[-1, 5], [-20, 5], [5, 5]], 2.0)
    assert len(crowns.seen_in((0, 0, 10, 10))) == 2


def test_every_size_class_draws_all_its_crowns(monkeypatch):
    drawn = []
    real = crowns_module._draw_discs
    monkeypatch.setattr(crowns_module, "_draw_discs", lambda p, c, z, **k: (drawn.append(len(c)), real(p, c, z, **k)))
    tinted = []
    monkeypatch.setattr(crowns_module, "_draw_density", lambda p, c, z: tinted.append(len(c)))
    rng = np.random.default_rng(1)
    radius = np.geomspace(0.01, 8, 200)
    draw_crowns(pane_of(200, (0, 0, 100, 100)), black(rng.uniform(10, 90, (200, 2)), radius), shadows=False)
    assert sum(drawn) + sum(tinted) == 200


def test_holes_stay_empty_and_overlaps_are_not_tinted_twice():
    ring = shapely.difference(shapely.box(0, 0, 10, 10), shapely.box(4, 4, 6, 6))
    pane = pane_of(100, (0, 0, 20, 10), 50)

    def paint(copy):
        fill_polygons(
            copy, np.array([ring, shapely.reverse(ring), shapely.box(8, 0, 14, 10)], dtype=object), "#000000", alpha=0.5
        )

    share = painted_share(pane, paint)
    assert share[25, 25] == 0
    assert share[25, 10] == pytest.approx(0.5, abs=0.01)
    assert share[25, 45] == pytest.approx(0.5, abs=0.01)
    assert share.sum() == pytest.approx(0.5 * (140 - 4) * 25, rel=0.01)


def test_neighbours_of_one_colour_show_no_seam():
    squares = [shapely.box(x, y, x + 1.37, y + 1.37) for x in np.arange(8) * 1.37 for y in np.arange(8) * 1.37]
    pane = pane_of(200, (1, 1, 10, 10))
    share = painted_share(pane, lambda copy: fill_polygons(copy, np.array(squares, dtype=object), "#000000"))
    assert share.min() > 0.99
