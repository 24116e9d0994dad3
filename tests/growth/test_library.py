"""Which plants stand for which, and how they are turned: slow twins, symmetries, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest

from urbanforest_cli.core.habits import usual_sizes
from urbanforest_cli.growth.library import (
    JITTER_DEG,
    SCALE_LIMITS,
    TURN_SLACK,
    choose,
    describe,
    match,
    placed,
    plan_library,
    share_out,
)
from urbanforest_cli.growth.library_kernel import settle, spread_out

SIZES = [
    usual_sizes("tree", mature_height_m=height, mature_crown_diameter_m=10.0, clear_stem_m=2.0)
    for height in (12.0, 18.0, 25.0)
]


def plants(n=300, seed=1, species=3):
    rng = np.random.default_rng(seed)
    return {
        "openness": rng.uniform(0.1, 1.0, (n, 9)),
        "species": rng.integers(0, species, n),
        "age_years": rng.uniform(0.0, 70.0, n),
        "pruning_factor": np.where(rng.random(n) < 0.4, 1.0, rng.uniform(0.6, 1.0, n)),
        "keys": rng.integers(0, 2**63, n).astype(np.uint64),
        "clearance_m": np.where(rng.random(n) < 0.3, 2.5, 0.0),
        "row_azimuth_rad": rng.uniform(0.0, np.pi, n),
    }


def described(city):
    columns = (city[name] for name in ("openness", "species", "age_years", "pruning_factor"))
    return describe(*columns, SIZES, clearance_m=city["clearance_m"], row_azimuth_rad=city["row_azimuth_rad"])


def alike(city, **changes):
    n = len(city["keys"])
    same = {"age_years": np.full(n, 30.0), "pruning_factor": np.ones(n), "clearance_m": np.zeros(n)}
    return city | {"species": np.zeros(n, dtype=int)} | same | changes


def in_world(openness, yaw_deg, mirror):
    """Turn a plant's sectors by turning points in their midst."""
    around = np.arange(8) * np.pi / 4
    points = placed(
        np.column_stack([np.cos(around), np.sin(around), around]), yaw_deg=yaw_deg, mirror=mirror, scale=1.0
    )
    turned = np.empty(8)
    turned[np.round(np.arctan2(points[:, 1], points[:, 0]) / (np.pi / 4)).astype(int) % 8] = openness[:8]
    return np.append(turned, openness[8])


def nearest_eighth(yaw_deg):
    return np.round(yaw_deg / 45.0) % 8 * 45.0


TURNS = [(45.0 * k, mirror) for mirror in (False, True) for k in range(8)]


def slow_distances(city, i, entries):
    """Return the distance of a plant to each entry in each of 16 turns."""
    features = described(city)
    found = np.full((len(entries), len(TURNS)), np.inf)
    for row, e in enumerate(entries):
        if city["species"][i] != city["species"][e]:
            continue
        for turn, (yaw, mirror) in enumerate(TURNS):
            sectors = in_world(city["openness"][e], yaw, mirror)[:8] - city["openness"][i][:8]
            other = features.others[i] - features.others[e]
            lies = city["row_azimuth_rad"][e] * (-1.0 if mirror else 1.0) + np.radians(yaw)
            across = (1.0 - city["pruning_factor"][i]) * np.sin(2 * (city["row_azimuth_rad"][i] - lies))
            found[row, turn] = np.sqrt((sectors**2).mean() + (other**2).sum() + across**2)
    return found


def test_entries_stand_for_themselves():
    library = plan_library(**plants(), size_max=60, open_grown=SIZES)
    assert len(library.entry) == 60
    np.testing.assert_array_equal(library.of_plant[library.entry], np.arange(60))
    for name, value in (("yaw_deg", 0.0), ("mirror", False), ("scale", 1.0), ("key_distance", 0.0)):
        np.testing.assert_array_equal(getattr(library, name)[library.entry], value)


def test_each_plant_takes_the_nearest_entry_of_its_species():
    city = plants(120)
    library = plan_library(**city, size_max=20, open_grown=SIZES)
    assert (city["species"][library.entry[library.of_plant]] == city["species"]).all()
    for i in set(range(0, 120, 5)) - set(library.entry):
        found = slow_distances(city, i, library.entry)
        turn = TURNS.index((nearest_eighth(library.yaw_deg[i]), library.mirror[i]))
        np.testing.assert_allclose(library.key_distance[i], found[library.of_plant[i], turn])
        assert found[library.of_plant[i]].min() == pytest.approx(found.min())
        assert library.key_distance[i] <= found.min() + TURN_SLACK + 1e-9


@pytest.mark.parametrize(("yaw", "mirror"), TURNS)
def test_a_turned_plant_is_told_the_turn_that_makes_it(yaw, mirror):
    city = alike(plants(2))
    city["openness"][1] = in_world(city["openness"][0], yaw, mirror)
    library = match(described(city), np.array([0]), city["keys"])
    assert (nearest_eighth(library.yaw_deg[1]), library.mirror[1]) == (yaw, mirror)
    assert abs((library.yaw_deg[1] - yaw + 180.0) % 360.0 - 180.0) <= JITTER_DEG
    assert library.key_distance[1] == pytest.approx(0.0, abs=1e-9)


def test_plants_in_the_open_are_turned_all_ways():
    city = alike(plants(400), openness=np.ones((400, 9)))
    library = match(described(city), np.array([0]), city["keys"])
    counts = np.unique(
        np.column_stack([nearest_eighth(library.yaw_deg), library.mirror])[1:], axis=0, return_counts=True
    )[1]
    assert len(counts) == 16
    assert counts.min() > 10


def one_class(n=40):
    city = alike(plants(n))
    features = described(city)
    return city, (features.sectors, features.others, np.array([0]), np.array([n]))


def test_entries_are_chosen_farthest_first():
    city, rows = one_class()
    entries, near = spread_out(*rows, np.array([7]), np.array([6]))
    distance = np.array([slow_distances(city, i, entries).min(axis=1) for i in range(40)])
    assert entries[0] == 7
    for count in range(1, 6):
        gap = distance[:, :count].min(axis=1)
        assert gap[entries[count]] == pytest.approx(gap.max())
    np.testing.assert_allclose(near, distance.min(axis=1), atol=1e-7)


def test_entries_settle_in_the_middle_of_those_they_stand_for():
    city, rows = one_class()
    before, _ = spread_out(*rows, np.array([7]), np.array([4]))
    nearest = np.array([slow_distances(city, i, before).min(axis=1) for i in range(40)]).argmin(axis=1)
    after = before.copy()
    settle(*rows, after, 1, 64)
    for entry, members in ((after[m], np.flatnonzero(nearest == m)) for m in range(4)):
        summed = np.array([slow_distances(city, i, members).min(axis=1) for i in members]).sum(axis=0)
        assert members[summed.argmin()] == entry


def test_a_class_of_one_entry_settles_on_what_is_usual():
    openness = np.full((41, 9), 0.8) + np.random.default_rng(2).normal(0, 0.02, (41, 9))
    openness[:5] = 0.1
    city = alike(plants(41), openness=openness)
    assert choose(described(city), city["keys"], size_max=1)[0] >= 5


def test_rows_know_no_order():
    city = plants(500)
    library = plan_library(**city, size_max=70, open_grown=SIZES)
    order = np.random.default_rng(5).permutation(500)
    other = plan_library(**{name: values[order] for name, values in city.items()}, size_max=70, open_grown=SIZES)
    np.testing.assert_array_equal(city["keys"][library.entry], city["keys"][order][other.entry])
    for name in ("of_plant", "yaw_deg", "mirror", "scale", "key_distance"):
        np.testing.assert_array_equal(getattr(library, name)[order], getattr(other, name))


def test_turning_the_whole_city_changes_no_distance():
    city = plants(200)
    library = plan_library(**city, size_max=30, open_grown=SIZES)
    turned = np.array([in_world(row, 90.0, False) for row in city["openness"]])
    other = plan_library(**city | {"openness": turned}, size_max=30, open_grown=SIZES)
    np.testing.assert_array_equal(library.entry, other.entry)
    np.testing.assert_allclose(library.key_distance, other.key_distance, atol=TURN_SLACK)


def test_a_library_of_all_plants_is_the_plants_themselves():
    city = plants(80)
    library = plan_library(**city, size_max=500, open_grown=SIZES)
    np.testing.assert_array_equal(np.sort(library.entry), np.arange(80))
    np.testing.assert_array_equal(library.key_distance, 0.0)


def test_a_larger_library_is_nearer():
    means = [plan_library(**plants(600), size_max=m, open_grown=SIZES).key_distance.mean() for m in (10, 60, 240)]
    assert means[0] > means[1] > means[2] > 0.0


def test_each_species_has_an_entry_however_small_the_library():
    city = plants(90)
    library = plan_library(**city, size_max=1, open_grown=SIZES)
    np.testing.assert_array_equal(np.sort(city["species"][library.entry]), [0, 1, 2])


def test_no_plants_no_library():
    library = plan_library(**{name: values[:0] for name, values in plants().items()}, size_max=9, open_grown=SIZES)
    assert len(library.entry) == len(library.of_plant) == 0


def test_shares_follow_need_and_leave_no_class_out():
    count, species = np.array([100, 50, 3, 1, 80]), np.array([0, 0, 0, 1, 1])
    budget = share_out(np.array([60.0, 30.0, 9.0, 0.0, 10.0]), count, species, 60)
    assert budget.sum() == 60
    assert (budget <= count).all()
    assert (budget >= 1).all()
    assert budget[0] > budget[1] > budget[4] > budget[3]
    np.testing.assert_array_equal(share_out(np.ones(5), count, species, 3), [1, 1, 0, 0, 1])
    np.testing.assert_array_equal(share_out(np.ones(5), count, species, 1000), count)


def test_scale_is_the_ratio_of_expected_heights_within_limits():
    city = alike(plants(5), age_years=np.array([30.0, 29.0, 0.0, 100.0, 30.0]))
    library = match(described(city), np.array([0]), city["keys"])
    heights = SIZES[0].height_at(city["age_years"])
    np.testing.assert_allclose(library.scale, np.clip(heights / heights[0], *SCALE_LIMITS))
    assert library.scale[2] == SCALE_LIMITS[0]
    assert 0.9 < library.scale[1] < 1.0 == library.scale[4]


def test_pruned_plants_lie_along_their_rows():
    city = alike(plants(200), pruning_factor=np.full(200, 0.7))
    features, rows = described(city), city["row_azimuth_rad"]
    library = match(features, np.arange(30), city["keys"])
    lies = np.degrees(rows[library.entry[library.of_plant]]) * np.where(library.mirror, -1.0, 1.0) + library.yaw_deg
    aside = np.abs((np.degrees(rows) - lies + 45.0) % 90.0 - 45.0)
    assert (aside < 1e-6).mean() > 0.85
    assert np.quantile(aside, 0.9) < 40.0
    loose = match(replace(features, stiffness=np.zeros(200)), np.arange(30), city["keys"])
    assert loose.key_distance.mean() < library.key_distance.mean()


def test_lifted_plants_take_from_lifted_ones():
    clearance = np.where(np.arange(60) % 2 == 0, 2.5, 0.0)
    city = alike(plants(60), openness=np.ones((60, 9)), clearance_m=clearance)
    library = plan_library(**city, size_max=2, open_grown=SIZES)
    np.testing.assert_array_equal(clearance[library.entry[library.of_plant]], clearance)


def test_placed_mirrors_then_turns_then_scales():
    xyz = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(placed(xyz, yaw_deg=90.0, mirror=True, scale=2.0), [[4.0, 2.0, 6.0]])
