"""Usual trees and shrubs grow to the sizes asked for, and are as large by age as is said of them."""

from __future__ import annotations

from dataclasses import fields
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.open_grown import Sizes, grow_open, sizes_at
from urbanforest_cli.core.habits import SHRUB, TREE, usual_growth, usual_sizes
from urbanforest_cli.core.traits import OpenGrown, Traits

Habit = Literal["tree", "shrub"]
MATURE = 60
AGES = (10, 20, 30, MATURE)
REACH: dict[Habit, tuple[float, float]] = {"tree": (4.0, 40.0), "shrub": (0.5, 6.0)}


def sizes_said(habit: Habit, height_m: float, crown_m: float) -> OpenGrown:
    return usual_sizes(
        habit,
        mature_height_m=height_m,
        mature_crown_diameter_m=crown_m,
        clear_stem_m=usual_growth(habit, height_m, crown_m).clear_stem_m,
    )


def grown(habit: Habit, height_m: float, crown_m: float, count: int) -> Sizes:
    said = sizes_said(habit, height_m, crown_m)
    traits = usual_growth(habit, height_m, crown_m)
    return sizes_at(grow_open(f"{habit} {height_m}", traits, said, count=count, age=MATURE), AGES)


def assert_as_asked(habit: Habit, height_m: float, crown_m: float, count: int) -> None:
    sizes, said, ages = (
        grown(habit, height_m, crown_m, count),
        sizes_said(habit, height_m, crown_m),
        np.array(AGES) * 1.0,
    )
    heights, crowns = np.median(sizes.height_m, axis=0), np.median(sizes.crown_diameter_m, axis=0)
    asked = f"{habit} {height_m} m, crown {crown_m} m: grown {heights} and {crowns} m"
    assert heights[-1] == pytest.approx(height_m, rel=0.25), asked
    assert crowns[-1] == pytest.approx(crown_m, rel=0.25), asked
    assert heights == pytest.approx(said.height_at(ages), rel=0.25), asked
    assert crowns[1:] / 2 == pytest.approx(said.crown_radius_at(ages)[1:], rel=0.4), asked


@pytest.mark.parametrize(
    ("habit", "height_m", "crown_m"),
    [("tree", 5.0, 4.0), ("tree", 10.0, 8.0), ("tree", 18.0, 12.0), ("shrub", 0.8, 0.9), ("shrub", 3.5, 3.0)],
)
def test_the_median_plant_reaches_the_mature_size_asked_for(habit: Habit, height_m: float, crown_m: float) -> None:
    assert_as_asked(habit, height_m, crown_m, count=5)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [0.5, 0.6, 0.75, 0.9, 1.05, 1.2])
@pytest.mark.parametrize(
    ("habit", "heights_m"),
    [("tree", (4.0, 5.5, 9.0, 14.0, 18.0, 25.0, 32.0, 40.0)), ("shrub", (0.5, 0.8, 1.3, 2.0, 3.0, 4.2, 6.0))],
)
def test_mature_sizes_are_reached_all_over_the_reach(habit: Habit, heights_m: tuple[float, ...], shape: float) -> None:
    for height_m in heights_m:
        assert_as_asked(habit, height_m, shape * height_m, count=11)


@pytest.mark.parametrize(
    ("habit", "asked", "nearest"),
    [
        ("tree", (90.0, 20.0), (40.0, 20.0)), ("tree", (90.0, 9.0), (40.0, 20.0)), ("tree", (1.0, 30.0), (4.0, 4.8)),
        ("shrub", (0.2, 0.3), (0.5, 0.3)), ("shrub", (9.0, 9.0), (6.0, 7.2)),
    ],
)  # fmt: skip
def test_a_size_out_of_reach_grows_as_the_nearest(
    habit: Habit, asked: tuple[float, float], nearest: tuple[float, float]
) -> None:
    assert usual_growth(habit, *asked) == usual_growth(habit, *nearest)
    assert sizes_said(habit, *asked) == sizes_said(habit, *nearest)


def everywhere(habit: Habit) -> list[tuple[float, float]]:
    return [(h, h * shape) for h in np.geomspace(*REACH[habit], 9).tolist() for shape in (0.3, 0.5, 0.8, 1.0, 1.2, 2.0)]


@pytest.mark.parametrize("habit", ["tree", "shrub"])
def test_traits_stay_within_their_bounds(habit: Habit) -> None:
    for size in everywhere(habit):
        traits = usual_growth(habit, *size)
        for item in fields(Traits):
            low, high = item.metadata["low"], item.metadata["high"]
            assert low <= getattr(traits, item.name) <= high, (size, item.name)


@pytest.mark.parametrize("habit", ["tree", "shrub"])
def test_sizes_by_age_rise_to_the_mature_size(habit: Habit) -> None:
    for height_m, crown_m in everywhere(habit):
        said = sizes_said(habit, height_m, crown_m)
        rises: list[NDArray[np.float64]] = [np.array(said.height_m), np.array(said.crown_radius_m)]
        assert all(np.all(np.diff(sizes) >= 0) for sizes in (*rises, np.array(said.age_years)))
        assert rises[0][-1] == pytest.approx(height_m)
        assert rises[1][-1] == pytest.approx(min(max(crown_m, 0.5 * height_m), 1.2 * height_m) / 2)
        assert np.all(np.array(said.crown_base_m) < np.where(rises[0] > 0, rises[0], 1.0))


@pytest.mark.parametrize("habit", ["tree", "shrub"])
def test_taller_means_longer_internodes_and_narrower_means_slower_branches(habit: Habit) -> None:
    heights = np.geomspace(*REACH[habit], 30).tolist()
    for shape in (0.5, 0.8, 1.2):
        lengths = [usual_growth(habit, h, shape * h).internode_length_m for h in heights]
        assert np.all(np.diff(lengths) > -1e-12)
    for h in heights:
        controls = [usual_growth(habit, h, shape * h).shoot_control for shape in np.linspace(0.5, 1.2, 15)]
        assert np.all(np.diff(controls) <= 1e-12)


def test_a_plant_without_a_stated_crown_is_like_its_model() -> None:
    assert usual_growth("tree", 18.0).internode_length_m == pytest.approx(TREE.internode_length_m, rel=0.05)
    assert usual_growth("tree", 18.0).shoot_control == pytest.approx(TREE.shoot_control, rel=0.05)
    assert usual_growth("shrub", 3.0, 2.8).internode_length_m == pytest.approx(SHRUB.internode_length_m, rel=0.15)
