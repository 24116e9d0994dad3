"""Splits are by place: no place is learnt from and judged by."""

from dataclasses import dataclass

import pytest
from shapely.geometry import box

from urbanforest_cli.imagery.splits import places_of, split


@dataclass
class Names:
    """A set of pairs as far as splits look at it."""

    names: tuple[str, ...]
    places: tuple[str, ...]
    groups: tuple[str, ...]

    def __len__(self):
        return len(self.names)


def city_years(places=20):
    """Every place twice, in two years, and a city of its own."""
    names = [f"rome_{year}_{number}" for year in (2016, 2020) for number in range(places)]
    names += [f"oslo_2020_{number}" for number in range(5)]
    at = [f"rome {number}" for _ in (2016, 2020) for number in range(places)] + [f"oslo {n}" for n in range(5)]
    return Names(tuple(names), tuple(at), tuple(name.rsplit("_", 1)[0] for name in names))


def test_overlapping_footprints_are_one_place_also_by_way_of_others():
    shapes = [box(0, 0, 10, 10), box(8, 0, 18, 10), box(16, 0, 26, 10), box(100, 0, 110, 10), None]
    assert places_of(("d", "b", "c", "a", "e"), shapes) == ("b", "b", "b", "a", "e")


def test_touching_footprints_and_slivers_are_places_of_their_own():
    shapes = [box(0, 0, 10, 10), box(10, 0, 20, 10), box(19.95, 0, 29.95, 10)]
    assert places_of(("a", "b", "c"), shapes) == ("a", "b", "c")


def test_small_image_inside_a_large_one_is_its_place():
    assert places_of(("a", "b"), [box(0, 0, 1000, 1000), box(5, 5, 15, 15)]) == ("a", "a")


def test_no_place_on_the_map_is_a_place_of_its_own():
    assert places_of(("a", "b"), [None, None]) == ("a", "b")
    assert places_of((), []) == ()


@pytest.mark.parametrize("seed", range(5))
def test_no_place_is_in_two_parts_and_no_pair_is_lost(seed):
    pairs = city_years()
    parts = split(pairs, validation_fraction=0.2, hold_out=("oslo_*",), seed=seed)
    sets = [{pairs.places[index] for index in part} for part in (parts.training, parts.validation, parts.held_out)]
    assert len(set().union(*sets)) == sum(map(len, sets))
    every = sorted((*parts.training, *parts.validation, *parts.held_out, *parts.dropped))
    assert every == list(range(len(pairs)))
    assert len(parts.validation) == 8
    assert {pairs.groups[index] for index in parts.held_out} == {"oslo_2020"}


def test_pairs_of_held_out_places_in_other_years_are_dropped():
    pairs = city_years(4)
    parts = split(pairs, validation_fraction=0.0, hold_out=("rome_2016",), seed=0)
    assert {pairs.groups[index] for index in parts.dropped} == {"rome_2020"}
    assert {pairs.groups[index] for index in parts.training} == {"oslo_2020"}


def test_validation_hangs_on_places_alone():
    pairs = city_years()
    turned = Names(pairs.names[::-1], pairs.places[::-1], pairs.groups[::-1])
    first = {pairs.places[index] for index in split(pairs, validation_fraction=0.3, seed=3).validation}
    second = {turned.places[index] for index in split(turned, validation_fraction=0.3, seed=3).validation}
    assert first == second
    other = {pairs.places[index] for index in split(pairs, validation_fraction=0.3, seed=4).validation}
    assert first != other


def test_something_is_left_to_learn_from_and_something_to_validate_by():
    two = Names(("a", "b"), ("a", "b"), ("g", "g"))
    for fraction in (0.01, 1.0):
        parts = split(two, validation_fraction=fraction)
        assert (len(parts.training), len(parts.validation)) == (1, 1)
    one = Names(("a",), ("a",), ("g",))
    assert split(one, validation_fraction=0.5).training == (0,)
