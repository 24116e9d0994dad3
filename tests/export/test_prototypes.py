from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from urbanforest_cli.core.skeleton import Skeletons, concatenate, select
from urbanforest_cli.export.scene.city import Plants
from urbanforest_cli.export.scene.prototypes import SCALE_LIMITS, choose_prototypes

EVEN = np.full(8, 0.4)
TO_THE_EAST = np.array([0.9, 0.7, 0.3, 0.1, 0.1, 0.1, 0.3, 0.7])
TO_THE_EAST_AND_SOUTH = np.array([0.9, 0.4, 0.1, 0.1, 0.2, 0.3, 0.6, 0.8])
BETWEEN_SECTORS = 0.013  # a twig that lies on the border of two sectors may fall into either


def a_tree(number: int, height_m: float, reach: np.ndarray) -> Skeletons:
    """A trunk, and at three heights eight branches whose lengths are shares of the height."""
    nodes, parents, orders = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.5), (0.0, 0.0, 0.75), (0.0, 0.0, 1.0)], [
        -1, 0, 1, 2, 3,
    ], [0, 0, 0, 0, 0]  # fmt: skip
    for trunk in (1, 2, 3):
        for k in range(8):
            angle = np.pi / 4 * k + BETWEEN_SECTORS
            nodes.append((reach[k] * np.cos(angle), reach[k] * np.sin(angle), nodes[trunk][2] + 0.1))
            parents.append(trunk)
            orders.append(1)
    count = len(nodes)
    return Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, count]),
        seasons=np.array([9], np.int32),
        tip_radius_m=np.array([0.002]),
        pipe_exponent=np.array([2.0]),
        parent=np.array(parents, np.int32),
        xyz_m=(height_m * np.array(nodes)).astype(np.float32),
        order=np.array(orders, np.uint8),
        birth_season=np.r_[0, np.ones(count - 1)].astype(np.uint8),
        death_season=np.zeros(count, np.uint8),
    )


class Library:
    """Skeletons by id, and how many were asked for."""

    def __init__(self, skeletons: Skeletons) -> None:
        self.skeletons, self.asked = skeletons, 0

    def __call__(self, ids: np.ndarray) -> Skeletons:
        self.asked += len(ids)
        order = np.argsort(self.skeletons.skeleton_id)
        return select(self.skeletons, order[np.searchsorted(self.skeletons.skeleton_id, ids, sorter=order)])


def last_season(skeletons: Skeletons) -> np.ndarray:
    return skeletons.seasons


def plants_of(skeleton_id: np.ndarray, species: np.ndarray | None = None) -> Plants:
    count = len(skeleton_id)
    zero = np.zeros(count)
    text = np.array([f"p{i}" for i in range(count)], dtype=object)
    return Plants(
        plant_id=text, lot_id=text, species=np.zeros(count, np.int64) if species is None else species,
        xy_m=np.zeros((count, 2)), age_years=zero, height_m=zero, crown_radius_m=zero, crown_base_m=zero, dbh_m=zero,
        pruning_factor=zero + 1, skeleton_id=np.asarray(skeleton_id), yaw_rad=zero, mirror=np.zeros(count, bool),
        scale=zero + 1, is_library=np.zeros(count, bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def town() -> tuple[Plants, Library]:
    """Four hundred plants of three species with ninety shapes, some of them turned, mirrored and scaled."""
    rng = np.random.default_rng(5)
    trees = [a_tree(1000 + 7 * i, rng.uniform(3, 15), rng.uniform(0.1, 0.6, 8)) for i in range(90)]
    shape = rng.integers(0, 90, 400)
    shape[:90] = np.arange(90)
    plants = replace(
        plants_of(1000 + 7 * shape, shape % 3), yaw_rad=rng.uniform(0, 2 * np.pi, 400), mirror=rng.random(400) < 0.5,
        scale=rng.uniform(0.8, 1.2, 400),
    )  # fmt: skip
    return plants, Library(concatenate(trees))


def seen_from_above(skeletons: Skeletons, yaw: float, mirror: bool, scale: float) -> np.ndarray:
    x, y, z = (scale * skeletons.xyz_m.astype(np.float64)).T
    y = -y if mirror else y
    return np.column_stack([x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw), z])


def test_where_all_shapes_may_stay_each_plant_keeps_its_own_and_none_is_read(town) -> None:
    plants, library = town
    library.asked = 0
    found = choose_prototypes(plants, library, last_season, count_max=90)
    assert library.asked == 0
    assert (found.skeleton_id[found.model] == plants.skeleton_id).all()
    assert (found.yaw_rad == plants.yaw_rad).all()
    assert (found.mirror == plants.mirror).all()
    assert (found.scale == plants.scale).all()
    assert found.summary() == {
        "own_shape_fraction": 1.0, "outline_error_median": 0.0, "outline_error_worst_tenth": 0.0,
        "height_error_median": 0.0, "height_error_worst_tenth": 0.0,
    }  # fmt: skip


def test_more_shapes_lower_the_error_and_no_more_are_used_than_allowed(town) -> None:
    plants, library = town
    errors, chosen = [], set()
    for count_max in (3, 8, 20, 45, 80):
        found = choose_prototypes(plants, library, last_season, count_max=count_max)
        assert len(found.skeleton_id) == count_max
        assert set(found.model) == set(range(count_max))
        assert chosen <= set(found.skeleton_id)  # those chosen first stay
        chosen = set(found.skeleton_id)
        errors.append(found.outline_error.mean())
    assert all(a > b for a, b in pairwise(errors))
    assert errors[-1] < 0.25 * errors[0]


def test_no_plant_takes_the_shape_of_another_species(town) -> None:
    plants, library = town
    for count_max in (1, 10):
        found = choose_prototypes(plants, library, last_season, count_max=count_max)
        assert (found.species[found.model] == plants.species).all()
        of_shape = dict(zip(plants.skeleton_id, plants.species, strict=True))
        assert [of_shape[number] for number in found.skeleton_id] == found.species.tolist()
    assert len(choose_prototypes(plants, library, last_season, count_max=1).skeleton_id) == 3


def test_a_shape_that_two_species_share_is_kept_for_each_of_them() -> None:
    plants = plants_of(np.array([4, 4, 5]), np.array([0, 1, 1]))
    found = choose_prototypes(plants, Library(a_tree(4, 5.0, EVEN)), last_season, count_max=3)
    assert (found.species[found.model] == plants.species).all()
    assert (found.skeleton_id[found.model] == plants.skeleton_id).all()


def test_rows_in_another_order_give_the_same_bits(town) -> None:
    plants, library = town
    order = np.random.default_rng(1).permutation(len(plants))
    a = choose_prototypes(plants, library, last_season, count_max=17)
    b = choose_prototypes(plants.take(order), library, last_season, count_max=17)
    assert (a.skeleton_id == b.skeleton_id).all()
    for name in ("model", "yaw_rad", "mirror", "scale", "outline_error", "height_error"):
        assert (getattr(a, name)[order] == getattr(b, name)).all(), name


def test_plants_keep_their_height(town) -> None:
    plants, library = town
    found = choose_prototypes(plants, library, last_season, count_max=12)
    tall = {int(k): library(np.array([k])).xyz_m[:, 2].max() for k in np.unique(plants.skeleton_id)}
    own = plants.scale * [tall[k] for k in plants.skeleton_id]
    drawn = found.scale * [tall[k] for k in found.skeleton_id[found.model]]
    free = (found.scale > SCALE_LIMITS[0]) & (found.scale < SCALE_LIMITS[1])
    assert free.mean() > 0.8
    np.testing.assert_allclose(drawn[free], own[free], rtol=1e-6)
    np.testing.assert_allclose(found.height_error, np.abs(drawn / own - 1), atol=1e-6)


def test_a_one_sided_crown_is_drawn_by_a_one_sided_crown_on_the_same_side() -> None:
    sides = [np.roll(TO_THE_EAST, k) for k in range(8)]
    trees = [a_tree(0, 8.0, EVEN), a_tree(1, 8.0, TO_THE_EAST), *(a_tree(10 + k, 8.0, s) for k, s in enumerate(sides))]
    library = Library(concatenate(trees))
    plants = plants_of(np.array([0, 0, 0, 0, 1, 1, *range(10, 18)]))
    found = choose_prototypes(plants, library, last_season, count_max=2)
    assert found.outline_error.max() < 1e-6
    assert (found.skeleton_id[found.model[:4]] == 0).all()
    for row in range(4, len(plants)):
        own = library(plants.skeleton_id[row : row + 1]).xyz_m
        shape = library(found.skeleton_id[found.model[row : row + 1]])
        drawn = seen_from_above(shape, found.yaw_rad[row], found.mirror[row], found.scale[row])
        np.testing.assert_allclose(drawn.mean(axis=0), own.mean(axis=0), atol=0.15)


@pytest.mark.parametrize("mirror", [False, True])
def test_plants_that_are_turned_and_mirrored_are_drawn_as_they_stand(mirror) -> None:
    """The shape with the image in a mirror, turned: whichever is kept gives the outline of both."""
    image = np.roll(TO_THE_EAST_AND_SOUTH[np.r_[0, 7:0:-1]], 3)
    library = Library(concatenate([a_tree(1, 8.0, TO_THE_EAST_AND_SOUTH), a_tree(2, 10.0, image)]))
    plants = replace(
        plants_of(np.array([1, 2, 2])), yaw_rad=np.array([0.3, 1.1, 4.0]), mirror=np.array([False, mirror, mirror]),
        scale=np.array([1.1, 0.9, 1.0]),
    )  # fmt: skip
    found = choose_prototypes(plants, library, last_season, count_max=1)
    assert found.outline_error.max() < 1e-6
    for row in range(3):
        own = seen_from_above(
            library(plants.skeleton_id[row : row + 1]), plants.yaw_rad[row], plants.mirror[row], plants.scale[row]
        )
        drawn = seen_from_above(
            library(found.skeleton_id[found.model[row : row + 1]]), found.yaw_rad[row], found.mirror[row],
            found.scale[row],
        )  # fmt: skip
        np.testing.assert_allclose(drawn.mean(axis=0), own.mean(axis=0), atol=0.05)


def test_the_told_error_is_the_difference_of_reaches_by_hand() -> None:
    library = Library(concatenate([a_tree(1, 10.0, EVEN), a_tree(2, 10.0, 1.5 * EVEN)]))
    found = choose_prototypes(plants_of(np.array([1, 1, 2])), library, last_season, count_max=1)
    assert found.skeleton_id.tolist() == [1]
    np.testing.assert_allclose(found.outline_error, [0.0, 0.0, 1.0 - 1.0 / 1.5], rtol=1e-5)
    assert (found.height_error == 0).all()
    assert found.summary()["own_shape_fraction"] == pytest.approx(2 / 3)


def test_skeletons_are_read_by_parts_and_the_result_is_the_same(town, monkeypatch) -> None:
    plants, library = town
    whole = choose_prototypes(plants, library, last_season, count_max=9)
    monkeypatch.setattr("urbanforest_cli.export.scene.prototypes.FIRST_CHUNK", 4)
    monkeypatch.setattr("urbanforest_cli.export.scene.prototypes.NODES_AT_ONCE", 200)
    library.asked, largest = 0, []

    def few(ids: np.ndarray) -> Skeletons:
        largest.append(len(ids))
        return library(ids)

    parts = choose_prototypes(plants, few, last_season, count_max=9)
    assert library.asked == 90
    assert max(largest) <= 200 // 29 + 1
    assert (parts.model == whole.model).all()
    assert (parts.outline_error == whole.outline_error).all()


def test_a_sample_speaks_for_many_shapes(town, monkeypatch) -> None:
    plants, library = town
    monkeypatch.setattr("urbanforest_cli.export.scene.prototypes.CHOICE_MAX", 12)
    few = choose_prototypes(plants, library, last_season, count_max=9)
    assert len(few.skeleton_id) == 9
    assert (few.species[few.model] == plants.species).all()


def test_shapes_that_do_not_stand_yet_and_towns_without_plants_are_no_trouble() -> None:
    library = Library(concatenate([a_tree(1, 10.0, EVEN), a_tree(2, 10.0, 1.5 * EVEN)]))

    def before_planting(skeletons: Skeletons) -> np.ndarray:
        return np.zeros(len(skeletons), np.int32)

    found = choose_prototypes(plants_of(np.array([1, 2])), library, before_planting, count_max=1)
    assert (found.scale == 1).all()
    assert (found.outline_error == 0).all()
    none = choose_prototypes(plants_of(np.zeros(0, np.int64)), library, last_season, count_max=1)
    assert len(none) == 0
    assert none.summary()["outline_error_median"] == 0.0
