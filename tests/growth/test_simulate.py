"""The kernels against the readable reference, internode by internode."""

import numpy as np
import pytest
import shapely

from tests.growth.scenes import DOGWOOD, HAZEL, LIME, MAPLE, OAK, PRIVET, scene, traits
from tests.reference.growth import SlowGrove
from urbanforest_cli.core.config import Growth
from urbanforest_cli.growth.grove import COLUMN_M, DIED, GROWN, NO_ROOM
from urbanforest_cli.growth.simulate import grow_grove

WALL = shapely.box(400_003, 5_499_990, 400_009, 5_500_010)


def assert_same_growth(place, rows=None, *, table=None, around=None):
    """Grow a scene both ways and compare; return what grew."""
    table = traits() if table is None else table
    around = place.around(rows) if around is None else around
    grown = grow_grove(place.grove(rows), around, table, place.config)
    slow = SlowGrove(place.grove(rows), around, table, place.config)
    skeletons = grown.skeletons
    for number, plant in enumerate(slow.grow()):
        rows_of = slice(skeletons.first[number], skeletons.first[number + 1])
        nodes = plant.nodes
        assert skeletons.parent[rows_of].tolist() == [-1 if n.parent is None else n.parent.serial for n in nodes]
        for name, wanted in (("birth_season", "birth"), ("death_season", "death"), ("order", "order")):
            assert getattr(skeletons, name)[rows_of].tolist() == [getattr(node, wanted) for node in nodes], name
        offset = np.array([node.place for node in nodes]) - plant.place
        np.testing.assert_allclose(skeletons.xyz_m[rows_of], offset, rtol=0, atol=1e-4)
        assert (grown.outcome[number], grown.death_season[number]) == (plant.outcome, plant.death)
        assert (grown.generated[number], grown.shed[number], grown.pruned[number]) == (
            len(nodes) - 1, plant.shed, plant.pruned,
        )  # fmt: skip
    if slow.senses_room:
        assert grown.markers == slow.room.counts()
    return grown


@pytest.mark.parametrize("fate", ["borchert_honda", "priority"])
@pytest.mark.parametrize("environment", ["both", "shadow", "markers"])
def test_a_tree_alone_grows_as_in_the_reference(environment, fate):
    config = Growth(environment=environment, fate=fate)
    grown = assert_same_growth(scene([(0, 0)], age=8.6, config=config))
    assert grown.generated[0] > 100


def test_two_trees_beside_a_wall_grow_as_in_the_reference():
    place = scene([(0, 0), (0.5, 5)], species=[LIME, MAPLE], age=[10, 6.5], buildings=(WALL,))
    grown = assert_same_growth(place)
    assert (grown.generated > 60).all()
    assert grown.markers["blocked"] > 0


def test_plants_of_a_few_weeks_grow_as_in_the_reference():
    grown = assert_same_growth(scene([(0, 0), (2, 0), (4, 0)], species=[LIME, MAPLE, OAK], age=[0.05, 3.1, 0.6]))
    assert (grown.generated > 0).all()


def test_shrubs_of_many_stems_grow_as_in_the_reference():
    grown = assert_same_growth(scene([(0, 0), (1.5, 0.7)], species=[HAZEL, DOGWOOD], age=[7, 9]))
    assert (grown.generated > 60).all()


@pytest.mark.parametrize("shape", ["box", "ellipsoid"])
def test_pruned_plants_beside_one_let_alone_grow_as_in_the_reference(shape):
    place = scene(
        [(0, 0), (3.5, 1)], species=[LIME, OAK], age=[10, 9], gamma=[0.6, 1.0], clearance=1.5, azimuth=0.4,
        config=Growth(pruning_shape=shape, regrow_years=3),
    )  # fmt: skip
    grown = assert_same_growth(place)
    assert grown.pruned[0] > 20


def test_a_tree_beside_a_plant_of_another_grove_grows_as_in_the_reference():
    place = scene([(0, 0), (4, 0)], species=[LIME, OAK], age=[10, 14])
    assert len(place.around([0]).neighbour_season) > 10
    assert_same_growth(place, rows=[0])


def test_plants_without_light_die_as_in_the_reference_and_keep_what_they_grew():
    place = scene([(0, 0), (4, 0)], species=[LIME, MAPLE], age=[6, 3])
    dark = place.around()._replace(sky=np.zeros((2, 1, 1), np.uint8))
    grown = assert_same_growth(place, around=dark)
    assert grown.outcome.tolist() == [DIED, GROWN]  # the younger still lives on what it brought
    assert grown.death_season.tolist() == [6, 0]
    spots = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (1.0, 2.5, 4.0)], np.float32)
    spots[:, :2] += (place.xy_m[1] - place.around().origin_m).astype(np.float32)
    canopy = place.around()._replace(
        neighbour_xyz_m=spots, neighbour_season=np.full(len(spots), 5, np.int32),
        neighbour_internodes=np.full(len(spots), 300, np.float32),
    )  # fmt: skip
    grown = assert_same_growth(place.but(age_years=np.array([9.0, 8.0])), around=canopy)
    assert grown.outcome.tolist() == [GROWN, DIED]
    assert grown.generated[1] == grown.shed[1] > 3
    assert grown.retained[1] == 0


def test_where_something_is_built_stands_a_root_alone():
    place = scene([(0, 0), (6, 0)], age=5)
    around = place.around()
    columns = np.ceil(around.size_m / COLUMN_M).astype(int)
    top = np.zeros((columns[1], columns[0]), np.float32)
    x, y = ((place.xy_m[1] - around.origin_m) / COLUMN_M).astype(int)
    top[y - 6 : y + 7, x - 6 : x + 7] = 5.0
    grown = assert_same_growth(place, around=around._replace(solid_top_m=top))
    assert grown.outcome.tolist() == [GROWN, NO_ROOM]
    assert grown.skeletons.node_counts()[1] == 1


@pytest.mark.slow
@pytest.mark.parametrize("environment", ["both", "shadow", "markers"])
def test_older_trees_and_a_hedge_grow_as_in_the_reference(environment):
    config = Growth(environment=environment)
    wall = shapely.box(400_004, 5_499_990, 400_009, 5_500_010)
    place = scene([(0, 0), (2, 4)], species=[LIME, MAPLE], age=[28, 15], buildings=(wall,), config=config)
    grown = assert_same_growth(place)
    assert grown.generated[0] > 1500
    hedge = scene([(2.0 * i, 0) for i in range(4)], species=PRIVET, age=[14, 12, 9, 3], gamma=0.7, config=config)
    assert (assert_same_growth(hedge).pruned[:2] > 50).all()
