import numpy as np
import pandas as pd
import shapely

from urbanforest_cli.export.crowns import Crowns
from urbanforest_cli.export.lot_pictures import LotPicture, draw_lots, typical_lots

NO_CROWNS = Crowns(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 3)), np.zeros(0, dtype=bool))


def frame(rows):
    return pd.DataFrame(rows, columns=["lot_id", "strategy", "zone", "area_m2", "plants"])


def test_the_typical_lot_is_the_one_in_the_middle_of_its_group():
    rows = [(f"l{i}", "random", "residential", 100.0 * 2**i, 2**i) for i in range(7)]
    assert typical_lots(frame(rows)) == [3]


def test_lots_without_plants_are_not_shown():
    assert typical_lots(frame([("a", "random", "other", 100.0, 0)])) == []


def test_each_strategy_is_shown_before_any_is_shown_twice():
    rows = [(f"r{zone}{i}", "random", f"zone{zone}", 100.0, 5) for zone in range(9) for i in range(5)]
    rows += [("s", "single", "zone0", 100.0, 1), ("b", "boundary", "zone0", 100.0, 9)]
    chosen = frame(rows).iloc[typical_lots(frame(rows), 4)]
    assert len(chosen) == 4
    assert set(chosen["strategy"]) == {"random", "single", "boundary"}


def test_the_choice_does_not_hang_on_the_order_of_lots():
    rng = np.random.default_rng(3)
    table = frame([(f"l{i:02}", "random", "other", float(rng.integers(1, 4)) * 100, int(rng.integers(1, 4)))
                   for i in range(40)])  # fmt: skip
    shuffled = table.sample(frac=1, random_state=1)
    assert (
        table.iloc[typical_lots(table)]["lot_id"].tolist() == shuffled.iloc[typical_lots(shuffled)]["lot_id"].tolist()
    )


def test_pictures_stand_in_rows_of_the_columns_asked_for():
    lot = np.array([shapely.box(0, 0, 10, 10)], dtype=object)
    pictures = [LotPicture(f"t{i}", "note", lot, "#ff0000", NO_CROWNS, area=shapely.box(1, 1, 9, 9)) for i in range(5)]
    figure = draw_lots(pictures, columns=2, width_px=400, heading=("Heading", "below"))
    panes = figure.axes[1:]
    assert len(panes) == 5
    assert len({round(pane.get_position().x0, 4) for pane in panes}) == 2
    assert len({round(pane.get_position().y0, 4) for pane in panes}) == 3
    assert {text.get_text() for text in figure.axes[0].texts} >= {"Heading", "below", "t0", "t4"}
