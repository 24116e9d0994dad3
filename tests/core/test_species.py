"""The catalogue of species."""

from __future__ import annotations

import pytest

from urbanforest_cli.core.habits import TREE, usual_sizes
from urbanforest_cli.core.species import Catalogue, Species


def make(species_id: str, habit: str = "tree", coldest: int = 3, warmest: int = 8) -> Species:
    return Species(
        id=species_id, scientific_name="", common_name="", habit=habit, mature_height_m=10.0,
        mature_crown_diameter_m=6.0, envelope_radius_m=3.0, lifespan_years=90.0, hardiness_zone_min=coldest,
        hardiness_zone_max=warmest, colour="#112233", source="", growth=TREE,
        open_grown=usual_sizes("tree", mature_height_m=10.0, mature_crown_diameter_m=6.0, clear_stem_m=2.0),
    )  # fmt: skip


def test_species_are_ordered_by_id_whatever_the_order_given() -> None:
    assert Catalogue([make("c"), make("a"), make("b")]).ids == ("a", "b", "c")
    assert Catalogue([make("c"), make("a")]).index_of("c") == 1


def test_trees_and_shrubs_split_the_catalogue() -> None:
    both = Catalogue([make("a"), make("b", "shrub"), make("c")])
    assert (both.trees().ids, both.shrubs().ids) == (("a", "c"), ("b",))


def test_only_species_that_live_in_the_zone_stay() -> None:
    both = Catalogue([make("hardy", coldest=2, warmest=6), make("tender", coldest=8, warmest=11)])
    assert both.hardy_in(2).ids == ("hardy",)
    assert both.hardy_in(11).ids == ("tender",)
    assert both.hardy_in(7).ids == ()


def test_named_species_are_chosen_once_each() -> None:
    assert Catalogue([make("a"), make("b")]).named(["b", "b"]).ids == ("b",)
    with pytest.raises(KeyError):
        Catalogue([make("a")]).named(["z"])


def test_one_id_stands_for_one_species() -> None:
    with pytest.raises(ValueError, match="same id"):
        Catalogue([make("a"), make("a")])
