import json

import numpy as np
import pandas as pd
import pytest

from urbanforest_cli.core.schema import GROW_REASONS
from urbanforest_cli.export.growth_report import CLASSES, FATES, sum_up_growth
from urbanforest_cli.export.map_layers import SpeciesStyle
from urbanforest_cli.export.page_growth import render_growth


def trees(heights, *, habit="tree", species="oak", grown="unique", reason=None) -> pd.DataFrame:
    heights = np.asarray(heights, dtype=float)
    return pd.DataFrame(
        {
            "species": species, "habit": habit, "age_years": 10.0, "height_m": heights, "crown_radius_m": heights / 4,
            "crown_base_m": heights / 5, "dbh_m": np.where(heights > 1.3, heights / 50, 0.0),
            "internode_count": (100 * heights).astype(int), "grown": grown,
            "reason": np.full(len(heights), reason, dtype=object),
        }
    )  # fmt: skip


def test_every_plant_has_one_fate_and_every_fate_a_meaning():
    parts = [trees([5.0] * 3), trees([4.0] * 2, grown="library")]
    parts += [
        trees([0.0], grown="dead" if reason == "died" else "none", reason=reason)
        for reason in GROW_REASONS
    ]  # fmt: skip
    found = sum_up_growth(pd.concat(parts, ignore_index=True), [])
    assert {row["fate"]: row["plants"] for row in found["fates"]} == dict(zip(FATES, (3, 2, 1, 1, 1, 1), strict=True))
    assert all(row["meaning"] for row in found["fates"])
    assert found["plants"] == 9
    assert sum(row["plants"] for row in found["species"]) == 5


@pytest.mark.parametrize("top", [0.0, 0.3, 5.99, 6.0, 23.9, 24.0, 119.0, 160.0])
def test_classes_of_height_are_few_and_hold_all_that_stand(top):
    heights = np.linspace(0, top, 37)
    both = pd.concat([trees(heights), trees(heights / 2, habit="shrub", species="elder")], ignore_index=True)
    rows = sum_up_growth(both, [])["heights"]
    assert 1 <= len(rows) <= CLASSES
    assert sum(row["trees"] for row in rows) == sum(row["shrubs"] for row in rows) == 37
    step = rows[0]["to_m"]
    for row in rows[:-1]:
        expected = ((heights >= row["from_m"]) & (heights < row["to_m"])).sum()
        assert row["trees"] == expected
        assert row["to_m"] - row["from_m"] == pytest.approx(step, abs=0.02)


def test_sizes_of_a_species_are_quantiles_of_what_stands():
    styles = [SpeciesStyle("oak", "Quercus", "#112233", True)]
    (row,) = sum_up_growth(trees(np.arange(1, 12)), styles)["species"]
    assert (row["label"], row["colour"], row["plants"]) == ("Quercus", "#112233", 11)
    assert (row["height_p10_m"], row["height_median_m"], row["height_p90_m"]) == (2.0, 6.0, 10.0)
    assert row["crown_diameter_median_m"] == 3.0
    assert row["dbh_median_m"] == pytest.approx(np.median(np.arange(2, 12) / 50), abs=1e-3)


def test_nothing_that_stands_is_a_page_too():
    for frame in (trees([]), trees([0.0], grown="none", reason="unborn")):
        found = sum_up_growth(frame, [])
        json.dumps(found, allow_nan=False)
        assert found["species"] == found["heights"] == []
        assert "Nothing stands." in render_growth(found)
    assert render_growth(None) == ""


def test_the_library_is_told_by_the_figures_that_were_counted():
    counts = {"library_compared": 0}
    assert sum_up_growth(trees([3.0]), [], counts)["library"] == {"compared": 0, "one_dead": 0, "figures": []}
    counts = {"library_compared": 5, "library_crown_shift_m_median": 0.4, "library_crown_shift_m_worst_tenth": 1.1}
    found = sum_up_growth(trees([3.0]), [], counts)["library"]
    assert [row["figure"] for row in found["figures"]] == ["crown_shift_m"]
    assert "distance between the middles" in render_growth(sum_up_growth(trees([3.0]), [], counts))


def test_names_from_data_are_escaped():
    page = render_growth(sum_up_growth(trees([3.0], species="<b>oak"), []))
    assert "<b>oak" not in page
    assert "&lt;b&gt;oak" in page
