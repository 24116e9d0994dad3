"""Species and ages of plants: shares, bounds and the independence of each plant's draw."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest, spearmanr

from urbanforest_cli.core.habits import TREE, usual_sizes
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.species import Catalogue, Species
from urbanforest_cli.placement.seeds import Seeds, draw_seeds


def make_species(species_id: str, habit: str, lifespan_years: float = 500.0) -> Species:
    return Species(
        id=species_id, scientific_name=species_id, common_name=species_id, habit=habit,
        mature_height_m=10.0, mature_crown_diameter_m=6.0, envelope_radius_m=3.0, lifespan_years=lifespan_years,
        hardiness_zone_min=1, hardiness_zone_max=13, colour="#00ff00", source="made for a test",
        growth=TREE,
        open_grown=usual_sizes("tree", mature_height_m=10.0, mature_crown_diameter_m=6.0, clear_stem_m=2.0),
    )  # fmt: skip


CITY = Catalogue(
    [make_species(f"tree_{letter}", "tree") for letter in "abcdef"]
    + [make_species(f"bush_{letter}", "shrub") for letter in "abcd"]
)
IS_TREE = np.array([item.habit == "tree" for item in CITY])


class Forest:
    """Plants of equal lots, with the seeds drawn for them."""

    def __init__(self, lots: int, plants_each: int, catalogue: Catalogue = CITY, **values: float) -> None:
        self.lots = lots
        self.catalogue = catalogue
        self.keys = keys_for(7, "seeds", [f"L{number}" for number in range(lots)])
        self.site = np.repeat(np.arange(lots), plants_each)
        self.index = np.tile(np.arange(plants_each), lots)
        defaults = {
            "tree_fraction": 0.7, "species_diversity": 0.3, "species_count": 4.0, "age_max_years": 40.0,
            "pruning_factor": 0.9, "radius_mean_m": 3.0, "radius_variance_m2": 0.25,
        }  # fmt: skip
        self.values = {name: np.full(lots, value) for name, value in (defaults | values).items()}
        self.radius_m = np.random.default_rng(1).normal(3.0, 0.5, len(self.site)).clip(2.0, 4.0)

    def draw(self, kept: np.ndarray | slice = slice(None), dominant: str | None = None) -> Seeds:
        return draw_seeds(
            self.site[kept], self.index[kept], self.keys, self.values, self.radius_m[kept], self.catalogue,
            dominant=dominant,
        )  # fmt: skip

    def species_per_lot(self, seeds: Seeds) -> np.ndarray:
        used = np.zeros((self.lots, len(self.catalogue)), dtype=bool)
        used[self.site, seeds.species] = True
        return used

    def share_of_others(self, seeds: Seeds) -> float:
        return float(np.mean(seeds.species != seeds.dominant[self.site]))


def within_binomial_limits(share: float, expected: float, draws: int) -> bool:
    return abs(share - expected) <= 4.5 * np.sqrt(expected * (1 - expected) / draws) + 1e-12


@pytest.mark.parametrize("rho", [0.0, 0.2, 0.5, 0.7, 1.0])
@pytest.mark.parametrize("theta", [0.0, 0.3, 0.6, 1.0])
def test_share_of_trees_is_the_tree_fraction_whatever_the_diversity(rho: float, theta: float) -> None:
    forest = Forest(300, 60, tree_fraction=rho, species_diversity=theta)
    seeds = forest.draw()
    assert within_binomial_limits(float(IS_TREE[seeds.species].mean()), rho, len(forest.site))


@pytest.mark.parametrize(
    ("rho", "theta"), [(1.0, 0.0), (1.0, 0.4), (0.7, 0.3), (0.7, 0.9), (0.5, 0.5), (0.5, 1.0), (0.2, 0.35), (0.0, 0.25)]
)
def test_share_not_of_the_dominant_species_is_the_diversity_where_both_can_hold(rho: float, theta: float) -> None:
    forest = Forest(300, 60, tree_fraction=rho, species_diversity=theta, species_count=6)
    assert within_binomial_limits(forest.share_of_others(forest.draw()), theta, len(forest.site))


@pytest.mark.parametrize(("rho", "theta", "others"), [(0.6, 0.0, 0.4), (0.6, 0.1, 0.4), (0.3, 0.2, 0.3)])
def test_the_tree_fraction_wins_where_the_dominant_species_would_need_both_habits(
    rho: float, theta: float, others: float
) -> None:
    forest = Forest(300, 60, tree_fraction=rho, species_diversity=theta)
    seeds = forest.draw()
    assert within_binomial_limits(forest.share_of_others(seeds), others, len(forest.site))
    assert np.all(IS_TREE[seeds.dominant] == (rho > 0.5))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 10])
def test_a_lot_uses_as_many_species_as_asked(count: int) -> None:
    forest = Forest(60, 400, species_count=count, species_diversity=0.8, tree_fraction=0.6)
    assert np.all(forest.species_per_lot(forest.draw()).sum(axis=1) == count)


def test_species_that_the_dominant_one_leaves_room_for_are_chosen_first() -> None:
    forest = Forest(200, 200, species_count=5, species_diversity=0.6, tree_fraction=0.6)
    seeds = forest.draw()
    assert np.all(forest.species_per_lot(seeds).sum(axis=1) == 5)
    assert set(IS_TREE[seeds.dominant]) == {False, True}


def test_a_lot_of_trees_has_no_more_species_than_there_are_trees() -> None:
    forest = Forest(40, 400, species_count=10, species_diversity=0.8, tree_fraction=1.0)
    used = forest.species_per_lot(forest.draw())
    assert np.all(used.sum(axis=1) == IS_TREE.sum())
    assert not used[:, ~IS_TREE].any()


def test_a_mixed_lot_has_both_habits_from_two_species_on() -> None:
    for count in (2, 3, 4):
        used = Forest(200, 200, species_count=count, tree_fraction=0.5, species_diversity=0.5)
        drawn = used.species_per_lot(used.draw())
        assert np.all(drawn[:, IS_TREE].any(axis=1) & drawn[:, ~IS_TREE].any(axis=1))


def test_one_species_makes_whole_lots_of_trees_as_often_as_the_tree_fraction_says() -> None:
    forest = Forest(4000, 3, species_count=1, tree_fraction=0.3, species_diversity=0.9)
    seeds = forest.draw()
    assert np.array_equal(seeds.species, seeds.dominant[forest.site])
    assert within_binomial_limits(float(IS_TREE[seeds.dominant].mean()), 0.3, forest.lots)


def test_each_species_dominates_equally_often_where_all_may() -> None:
    forest = Forest(6000, 1, tree_fraction=0.5, species_diversity=0.6)
    counts = np.bincount(forest.draw().dominant, minlength=len(CITY))
    assert all(within_binomial_limits(count / 6000, 0.1, 6000) for count in counts)


def test_other_species_of_a_habit_are_equally_common() -> None:
    forest = Forest(2000, 40, species_count=10, tree_fraction=1.0, species_diversity=1.0)
    seeds = forest.draw()
    counts = np.bincount(seeds.species, minlength=len(CITY))[IS_TREE]
    assert np.ptp(counts) < 0.06 * counts.mean()


def test_the_species_of_the_config_dominates_wherever_its_habit_grows() -> None:
    forest = Forest(100, 20, tree_fraction=0.8)
    assert np.all(forest.draw(dominant="tree_c").dominant == CITY.index_of("tree_c"))
    shrubs = Forest(100, 20, tree_fraction=0.0).draw(dominant="tree_c")
    assert not IS_TREE[shrubs.species].any()


def test_a_dominant_species_that_is_not_in_the_catalogue_is_refused() -> None:
    with pytest.raises(ValueError, match="oak"):
        Forest(1, 1).draw(dominant="oak")


@pytest.mark.parametrize("count", [0.0, 0.9, 10.5, 11.0, np.nan])
def test_a_species_count_the_catalogue_cannot_serve_is_refused_not_clamped(count: float) -> None:
    with pytest.raises(ValueError, match="species_count"):
        Forest(2, 3, species_count=count).draw()


def test_rounding_of_averages_changes_nothing() -> None:
    exact = Forest(50, 30, species_count=10, tree_fraction=1.0, species_diversity=0.3)
    blurred = Forest(50, 30, species_count=10 + 1e-9, tree_fraction=1.0 - 1e-9, species_diversity=0.3)
    assert np.array_equal(exact.draw().species, blurred.draw().species)


def test_a_count_between_integers_is_rounded_with_the_probability_of_its_fraction() -> None:
    forest = Forest(1500, 80, species_count=2.25, tree_fraction=1.0, species_diversity=0.5)
    numbers = forest.species_per_lot(forest.draw()).sum(axis=1)
    assert set(numbers) == {2, 3}
    assert within_binomial_limits(float(np.mean(numbers == 3)), 0.25, forest.lots)


def test_ages_are_uniform_up_to_the_highest_and_never_zero() -> None:
    forest = Forest(400, 50, age_max_years=40.0)
    ages = forest.draw().age_years
    assert ages.min() > 0
    assert ages.max() <= 40.0
    assert kstest(ages / 40.0, "uniform").statistic < 0.012


def test_larger_envelopes_are_older() -> None:
    forest = Forest(100, 50)
    assert 0.4 < spearmanr(forest.radius_m, forest.draw().age_years).statistic < 0.75


def test_equal_radii_leave_ages_uniform() -> None:
    forest = Forest(200, 50, radius_variance_m2=0.0)
    assert kstest(forest.draw().age_years / 40.0, "uniform").statistic < 0.02


def test_no_plant_is_older_than_its_species_lives() -> None:
    short = Catalogue([make_species("cherry", "tree", 30.0), make_species("oak", "tree", 500.0)])
    forest = Forest(200, 30, short, age_max_years=100.0, species_count=2, species_diversity=0.5, tree_fraction=1.0)
    seeds = forest.draw()
    assert seeds.age_years[seeds.species == 0].max() <= 30.0
    assert seeds.age_years[seeds.species == 1].max() > 90.0


def test_an_age_limit_of_zero_makes_seedlings() -> None:
    assert np.all(Forest(5, 5, age_max_years=0.0).draw().age_years == 0.0)


def test_a_plant_stays_what_it_is_when_others_are_thinned_away() -> None:
    forest = Forest(50, 40)
    kept = np.random.default_rng(3).random(len(forest.site)) < 0.4
    full, thinned = forest.draw(), forest.draw(kept)
    assert np.array_equal(full.species[kept], thinned.species)
    assert np.array_equal(full.age_years[kept], thinned.age_years)


def test_the_order_and_company_of_lots_do_not_matter() -> None:
    forest = Forest(50, 40)
    full = forest.draw()
    order = np.random.default_rng(3).permutation(50)[:20]
    part = Forest(50, 40)
    part.keys, part.values = forest.keys[order], {name: value[order] for name, value in forest.values.items()}
    part.site, part.index = np.repeat(np.arange(20), 40), np.tile(np.arange(40), 20)
    rows = (order[:, None] * 40 + np.arange(40)).ravel()
    part.radius_m = forest.radius_m[rows]
    assert np.array_equal(part.draw().species, full.species[rows])
    assert np.array_equal(part.draw().age_years, full.age_years[rows])


def test_pruning_is_the_lots_own() -> None:
    assert np.all(Forest(3, 4, pruning_factor=0.25).draw().pruning_factor == 0.25)


def test_a_city_without_shrubs_plants_trees_alone() -> None:
    forest = Forest(50, 20, CITY.trees(), tree_fraction=0.2, species_count=3)
    assert forest.draw().species.max() < 6


def test_no_plants_draw_nothing() -> None:
    assert len(Forest(3, 0).draw().species) == 0
    assert len(Forest(0, 0).draw().dominant) == 0
