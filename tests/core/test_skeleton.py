import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.branching import branching
from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.core.skeleton import (
    POSITION_STEP_M,
    Skeletons,
    concatenate,
    measure,
    no_skeletons,
    pipe_count,
    preorder,
    quantise,
    radius_m,
    select,
    standing,
)

TIP, EXPONENT = 0.01, 2.0


def skeleton(nodes, *, number=1, seasons=4) -> Skeletons:
    """Build a skeleton of rows (parent, xyz, order, birth, death)."""
    parent, xyz, order, birth, death = zip(*nodes, strict=True)
    return Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, len(nodes)]),
        seasons=np.array([seasons], np.int32),
        tip_radius_m=np.array([TIP]),
        pipe_exponent=np.array([EXPONENT]),
        parent=np.array(parent, np.int32),
        xyz_m=np.array(xyz, np.float32),
        order=np.array(order, np.uint8),
        birth_season=np.array(birth, np.uint8),
        death_season=np.array(death, np.uint8),
    )


@pytest.fixture
def bent_skeleton() -> Skeletons:
    """A trunk of four metres; a lost branch at one metre to the west, a living one at two to the east."""
    return skeleton(
        [
            (-1, (0, 0, 0), 0, 0, 0),
            (0, (0, 0, 1), 0, 1, 0),
            (1, (0, 0, 2), 0, 2, 0),
            (1, (-1, 0, 1), 1, 2, 3),
            (2, (0, 0, 3), 0, 3, 0),
            (2, (1, 0.2, 2.5), 1, 3, 0),
            (3, (-2, 0, 1), 1, 3, 3),
            (4, (0, 0, 4), 0, 4, 0),
            (5, (2, 0.5, 3), 1, 4, 0),
        ]
    )


@pytest.fixture(scope="module")
def thicket() -> Skeletons:
    return concatenate([branching(i, 300 + 200 * i, seasons=6 + 7 * i, stems=1 + 2 * (i % 3)) for i in range(6)])


def truncated(skeletons: Skeletons, place: int, season: int) -> Skeletons:
    """Cut one skeleton by hand to what was born by a season, what was lost later put back."""
    one = select(skeletons, [place])
    born = np.flatnonzero(one.birth_season <= season)
    number = np.full(len(one.parent), -1)
    number[born] = np.arange(len(born))
    death = one.death_season[born]
    return replace(
        one,
        first=np.array([0, len(born)]),
        seasons=np.array([season], np.int32),
        parent=np.where(one.parent[born] < 0, -1, number[one.parent[born]]).astype(np.int32),
        xyz_m=one.xyz_m[born],
        order=one.order[born],
        birth_season=one.birth_season[born],
        death_season=np.where(death > season, 0, death).astype(np.uint8),
    )


def test_measures_of_a_plant_known_by_hand(bent_skeleton):
    sizes = {name: values[0] for name, values in measure(bent_skeleton).items()}
    assert sizes["height_m"] == 4
    assert sizes["crown_radius_m"] == pytest.approx(math.hypot(2, 0.5) / 8)
    assert sizes["crown_base_m"] == 2
    assert sizes["dbh_m"] == pytest.approx(2 * TIP * math.sqrt(2)), "two twigs end above 1.3 m"
    assert sizes["internode_count"] == 6


def test_measures_of_its_youth_know_nothing_of_later(bent_skeleton):
    sizes = {name: values[0] for name, values in measure(bent_skeleton, np.array([2])).items()}
    assert sizes["height_m"] == 2
    assert sizes["crown_radius_m"] == pytest.approx(1 / 8)
    assert sizes["crown_base_m"] == 1
    assert sizes["dbh_m"] == pytest.approx(2 * TIP)
    assert sizes["internode_count"] == 3


def test_lost_wood_stays_in_the_radius_and_nowhere_else(bent_skeleton):
    assert pipe_count(bent_skeleton).tolist() == [3, 3, 2, 1, 1, 1, 1, 1, 1]
    assert pipe_count(bent_skeleton, np.array([2])).tolist() == [2, 2, 1, 1, 0, 0, 0, 0, 0]
    assert np.flatnonzero(~standing(bent_skeleton)).tolist() == [3, 6]
    assert radius_m(bent_skeleton)[1] == pytest.approx(TIP * math.sqrt(3))


def test_before_planting_there_is_nothing_to_measure(bent_skeleton):
    for season in (-3, 0):
        assert all(values[0] == 0 for values in measure(bent_skeleton, np.array([season])).values())
    assert standing(bent_skeleton, np.array([0])).tolist() == [True] + [False] * 8
    assert not standing(bent_skeleton, np.array([-1])).any()


def test_a_dead_plant_measures_nothing(bent_skeleton):
    dead = replace(bent_skeleton, death_season=np.where(bent_skeleton.death_season, 3, 4).astype(np.uint8))
    dead.check()
    assert all(values[0] == 0 for values in measure(dead).values())
    assert measure(dead, np.array([3]))["height_m"][0] == 3


def test_breast_height_sums_the_sections_of_all_stems():
    stems = [(-1, (0, 0, 0), 0, 0, 0)]
    for stem in range(3):
        low = len(stems)
        stems += [(0, (0.2 * stem, 0, 1), 0, 1, 0), (low, (0.3 * stem, 0, 2), 0, 2, 0)]
    stems += [(2, (0, 1, 2.5), 1, 3, 0), (2, (0, 0, 2.5), 0, 3, 0)]  # the first stem forks above
    stems += [(1, (0, 1, 1.2), 1, 3, 0), (9, (0, 1, 2), 1, 4, 0)]  # a branch that passes 1.3 m is no stem
    plant = skeleton(stems)
    plant.check()
    assert measure(plant)["dbh_m"][0] == pytest.approx(2 * TIP * math.sqrt(2 + 1 + 1))


def test_a_stem_that_winds_counts_once():
    heights = [0, 1.2, 1.4, 1.2, 1.4, 1.8]
    plant = skeleton([(i - 1, (0, 0, z), 0, i and 1, 0) for i, z in enumerate(heights)])
    assert measure(plant)["dbh_m"][0] == pytest.approx(2 * TIP)


def test_where_the_leader_was_lost_its_thickest_heir_is_measured():
    plant = skeleton(
        [
            (-1, (0, 0, 0), 0, 0, 0),
            (0, (0, 0, 1), 0, 1, 0),
            (1, (0, 0, 1.2), 0, 2, 3),
            (1, (0.2, 0, 2), 1, 2, 0),
            (3, (0.2, 0, 3), 1, 3, 0),
            (3, (0.5, 0, 3), 2, 3, 0),
            (1, (-0.2, 0, 2), 1, 2, 0),
        ]
    )
    assert measure(plant)["dbh_m"][0] == pytest.approx(2 * TIP * math.sqrt(2))


def test_crown_base_passes_over_sprouts_and_takes_the_lowest_real_branch():
    nodes = [(-1, (0, 0, 0), 0, 0, 0)] + [(i, (0, 0, i + 1), 0, 1, 0) for i in range(10)]
    nodes += [(1, (0.1, 0, 1), 1, 2, 0)]  # a sprout at one metre
    for height in (4, 7):
        nodes += [(height, (1, 0, height), 1, 2, 0)]
        nodes += [(len(nodes) - 1 + k, (1 + k, 0, height), 1, 2, 0) for k in range(30)]
    plant = skeleton(nodes)
    plant.check()
    assert measure(plant)["crown_base_m"][0] == 4
    whip = skeleton(nodes[:11])
    assert measure(whip)["crown_base_m"][0] == 0, "no branch, no bole"


def test_crown_base_of_many_small_branches_is_where_they_begin():
    nodes = [(-1, (0, 0, 0), 0, 0, 0)] + [(i, (0, 0, 0.1 * (i + 1)), 0, 1, 0) for i in range(60)]
    nodes += [(i, (1, 0, 0.1 * i), 1, 2, 0) for i in range(20, 60)]
    assert measure(skeleton(nodes))["crown_base_m"][0] == pytest.approx(2), "none of them has 3 % of the internodes"


def test_a_twig_that_leaves_a_drooping_branch_does_not_begin_the_crown():
    plant = skeleton(
        [
            (-1, (0, 0, 0), 0, 0, 0),
            (0, (0, 0, 3), 0, 1, 0),
            (1, (2, 0, 1), 1, 2, 0),
            (2, (3, 0, 1), 2, 3, 0),
        ]
    )
    assert measure(plant)["crown_base_m"][0] == 3


@pytest.mark.parametrize("turn", [10, 22.5, 35])
def test_crown_radius_is_the_mean_over_eight_sectors(turn):
    lengths = np.array([1.0, 2, 3, 4, 5, 6, 7, 8])
    angles = np.radians(np.arange(8) * 45 + turn)
    tips = [(1, (r * math.cos(a), r * math.sin(a), 5), 1, 2, 0) for r, a in zip(lengths, angles, strict=True)]
    inner = [(1, (0.5 * x, 0.5 * y, 5), 1, 2, 0) for _, (x, y, _), *_ in tips]
    plant = skeleton([(-1, (0, 0, 0), 0, 0, 0), (0, (0, 0, 5), 0, 1, 0), *tips, *inner])
    assert measure(plant)["crown_radius_m"][0] == pytest.approx(lengths.mean())


def test_pipes_agree_with_counting_the_ends_one_by_one(thicket):
    for season_end in (None, thicket.seasons // 2):
        seasons = thicket.seasons if season_end is None else season_end
        expected = np.zeros(len(thicket.parent), int)
        for s, root in enumerate(thicket.first[:-1]):
            born = [i for i in range(root, thicket.first[s + 1]) if thicket.birth_season[i] <= seasons[s]]
            carrying = {root + thicket.parent[i] for i in born if i != root}
            for tip in set(born) - carrying:
                node = tip
                while node != root:
                    expected[node] += 1
                    node = root + thicket.parent[node]
                expected[root] += 1
        assert (pipe_count(thicket, season_end) == expected).all()


def test_radius_never_grows_toward_the_tip_and_sections_add_up(thicket):
    root = np.repeat(thicket.first[:-1], thicket.node_counts())
    inner = np.flatnonzero(thicket.parent >= 0)
    carrier = root[inner] + thicket.parent[inner]
    exponent = 2.2
    for season_end in (None, thicket.seasons // 3):
        radius = radius_m(thicket, season_end)
        assert (radius[inner] <= radius[carrier]).all()
        sections = np.zeros(len(radius))
        np.add.at(sections, carrier, radius[inner] ** exponent)
        forks = sections > 0
        assert radius[forks] ** exponent == pytest.approx(sections[forks])


def test_measures_of_any_season_are_those_of_the_plant_cut_by_hand(thicket):
    for place, last in enumerate(thicket.seasons):
        for season in {1, last // 2, last - 1, last}:
            now = measure(thicket, np.where(np.arange(6) == place, season, 0))
            cut = truncated(thicket, place, season)
            cut.check()
            then = measure(cut)
            assert {name: values[place] for name, values in now.items()} == {k: v[0] for k, v in then.items()}


def test_preorder_goes_up_every_axis_before_its_branches(bent_skeleton, thicket):
    rows = preorder(bent_skeleton)
    assert rows.tolist() == [0, 1, 2, 4, 7, 5, 8, 3, 6]
    for s, root in enumerate(thicket.first[:-1]):
        nodes = preorder(thicket)[root : thicket.first[s + 1]] - root
        assert sorted(nodes) == list(range(len(nodes)))
        path = []
        for node in nodes:  # depth first: a node's parent is on the way from the root to the node before it
            while path and path[-1] != thicket.parent[root + node]:
                path.pop()
            assert path or node == 0
            path.append(node)


def test_of_children_the_axis_comes_first_then_the_oldest():
    plant = skeleton(
        [
            (-1, (0, 0, 0), 0, 0, 0),
            (0, (0, 0, 1), 0, 1, 0),
            (1, (1, 0, 1), 1, 3, 0),
            (1, (0, 1, 1), 1, 2, 0),
            (1, (0, 2, 1), 1, 3, 0),
            (1, (0, 0, 2), 0, 4, 0),
        ]
    )
    assert preorder(plant).tolist() == [0, 1, 5, 3, 2, 4]


def test_quantising_moves_no_node_by_more_than_half_a_step_and_twice_is_once(thicket):
    once = quantise(thicket)
    once.check()
    moved = once.xyz_m - thicket.xyz_m[preorder(thicket)]
    assert np.abs(moved).max() <= POSITION_STEP_M / 2 + 1e-6
    twice = quantise(once)
    assert all((getattr(once, name) == getattr(twice, name)).all() for name in Skeletons.__dataclass_fields__)
    assert (pipe_count(once) == pipe_count(thicket)[preorder(thicket)]).all()
    before, after = measure(thicket), measure(once)
    assert (before["internode_count"] == after["internode_count"]).all()
    assert after["height_m"] == pytest.approx(before["height_m"], abs=POSITION_STEP_M)


def test_selecting_what_was_put_together_gives_back_each(thicket):
    parts = [select(thicket, [place]) for place in range(len(thicket))]
    again = concatenate(parts)
    turned = select(thicket, [5, 0])
    assert turned.skeleton_id.tolist() == [5, 0]
    for name in Skeletons.__dataclass_fields__:
        assert (getattr(again, name) == getattr(thicket, name)).all()
        if name != "first":
            assert (getattr(concatenate([parts[5], parts[0]]), name) == getattr(turned, name)).all()
    assert len(select(thicket, [])) == len(concatenate([])) == len(no_skeletons()) == 0
    no_skeletons().check()
    assert measure(no_skeletons())["height_m"].shape == (0,)


@pytest.mark.parametrize(
    ("field", "row", "value", "text"),
    [
        ("parent", 4, 4, "not below"),
        ("parent", 4, -1, "not below"),
        ("parent", 4, 1 << 30, "not below"),
        ("parent", 0, 0, "roots with a parent"),
        ("birth_season", 4, 1, "before what carries"),
        ("birth_season", 8, 5, "after the last season"),
        ("birth_season", 0, 1, "birth after planting"),
        ("death_season", 8, 3, "before birth"),
        ("death_season", 6, 0, "outlive"),
        ("order", 8, 0, "lower than their parent's"),
        ("xyz_m", 8, (np.nan, 0, 0), "no numbers"),
        ("xyz_m", 8, (0, 0, 400), "too far"),
        ("xyz_m", 0, (0, 0, 0.1), "roots away"),
    ],
)
def test_each_fault_is_named_with_its_place(bent_skeleton, field, row, value, text):
    array = getattr(bent_skeleton, field).copy()
    array[row] = value
    with pytest.raises(SchemaError, match=text) as raised:
        replace(bent_skeleton, **{field: array}).check(where="a.parquet")
    assert f"node {row} of skeleton 1" in str(raised.value)


def test_faults_are_gathered(bent_skeleton):
    bad = replace(
        concatenate([bent_skeleton, bent_skeleton]),
        tip_radius_m=np.array([np.nan, 0.1]),
        pipe_exponent=np.array([2.0, 0.0]),
        seasons=np.array([300, 4], np.int32),
    )
    text = "; ".join(bad.faults())
    for word in ("skeleton_id repeats 1", "tip_radius_m", "pipe_exponent", "seasons leave"):
        assert word in text


def test_arrays_that_do_not_fit_together_are_refused_before_they_are_read(bent_skeleton):
    assert replace(bent_skeleton, order=bent_skeleton.order[:3]).faults()
    assert replace(bent_skeleton, xyz_m=bent_skeleton.xyz_m[:, :2]).faults()
    for first in ([0, 99], [0, 4], [0, 0, 9], [1, 9], [0]):
        assert replace(bent_skeleton, first=np.array(first)).faults()
