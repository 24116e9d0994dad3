import numpy as np
import pytest
import shapely

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.skeleton import standing
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.alone import THE_PLANT, Neighbour, Wall, compass, grow_alone, species_named

GROWTH = settings.Growth()


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(settings.Species())


def grown(catalogue, species="tilia_cordata", age=12.0, **around):
    return grow_alone(catalogue, species, age, growth=GROWTH, **around)


def crown_middle(company, plant=0):
    """East and north of the middle of a plant's standing wood, from its root."""
    skeletons = company.skeletons
    rows = slice(skeletons.first[plant], skeletons.first[plant + 1])
    return skeletons.xyz_m[rows][standing(skeletons)[rows]][:, :2].mean(axis=0)


def test_a_compass_goes_from_north_by_east():
    for azimuth, expected in ((0, (0, 2)), (90, (2, 0)), (180, (0, -2)), (270, (-2, 0)), (-90, (-2, 0))):
        np.testing.assert_allclose(compass(2.0, azimuth), expected, atol=1e-12)


def test_the_face_of_a_wall_is_as_far_as_told():
    for azimuth in (0, 37, 90, 200, 315):
        footprint = Wall(3.0, azimuth).footprint()
        assert footprint.is_valid
        assert shapely.distance(footprint, shapely.Point(0, 0)) == pytest.approx(3.0)
        assert footprint.area == pytest.approx(20.0)
        assert shapely.intersects(footprint, shapely.Point(*compass(3.5, azimuth)))


def test_a_species_goes_by_its_id_its_scientific_and_its_common_name(catalogue):
    for name in ("tilia_cordata", " Tilia Cordata ", "small-leaved LIME"):
        assert species_named(catalogue, name).id == "tilia_cordata"


@pytest.mark.parametrize(("name", "near"), [("lime", "tilia_cordata"), ("acer_platanodes", "acer_platanoides")])
def test_an_unknown_species_is_told_with_the_nearest(catalogue, name, near):
    with pytest.raises(InputError, match=f"did you mean '{near}'"):
        species_named(catalogue, name)


def test_a_species_like_none_is_told_with_all_there_are(catalogue):
    with pytest.raises(InputError, match="syringa_vulgaris") as refusal:
        species_named(catalogue, "xyz")
    assert "did you mean" not in str(refusal.value)


@pytest.mark.parametrize("age", [0.0, 0.4, 1.0, 3.5, 60.0])
def test_a_plant_of_any_age_grows(catalogue, age):
    company = grown(catalogue, age=age)
    company.skeletons.check()
    assert len(company) == 1
    assert company.accounts.height_m[0] > 0
    assert company.accounts.internode_count[0] == company.accounts.retained[0] > 0


def test_the_same_seed_grows_the_same_and_another_another(catalogue):
    one, same, other = (grown(catalogue, seed=seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.skeletons.xyz_m, same.skeletons.xyz_m)
    np.testing.assert_array_equal(one.skeletons.parent, same.skeletons.parent)
    assert not np.array_equal(one.skeletons.xyz_m, other.skeletons.xyz_m)


@pytest.mark.parametrize("azimuth", [0, 90, 180, 270])
def test_a_wall_pushes_the_crown_away_and_holds_no_wood(catalogue, azimuth):
    company = grown(catalogue, age=20, walls=[Wall(2.0, azimuth, 15.0)])
    free = grown(catalogue, age=20)
    assert (crown_middle(company) - crown_middle(free)) @ compass(1.0, azimuth) < -0.3
    points = shapely.points(company.skeletons.xyz_m[:, :2].astype(float))
    low = company.skeletons.xyz_m[:, 2] < 15.0
    assert not (shapely.contains(company.walls[0], points) & low).any()


def test_a_wall_without_a_height_is_as_high_as_the_config_says(catalogue):
    assert grown(catalogue, age=1, walls=[Wall(2, 0), Wall(2, 90, 4)]).wall_height_m.tolist() == [
        GROWTH.building_height_m,
        4.0,
    ]


def test_plants_side_by_side_lean_apart_and_come_in_the_order_told(catalogue):
    beside = [Neighbour("acer_platanoides", 3.0, 90), Neighbour("Common hazel", 4.0, 180, 6.0)]
    company = grown(catalogue, age=20, neighbours=beside)
    assert company.names == (THE_PLANT, "neighbour-1", "neighbour-2")
    assert [kind.id for kind in company.species] == ["tilia_cordata", "acer_platanoides", "corylus_avellana"]
    assert company.age_years.tolist() == [20, 20, 6]
    assert company.skeletons.seasons.tolist() == [20, 20, 6]
    np.testing.assert_allclose(company.xy_m, [[0, 0], [3, 0], [0, -4]], atol=1e-12)
    free = crown_middle(grown(catalogue, age=20))
    assert crown_middle(company)[0] - free[0] < -0.2
    assert crown_middle(company, 1)[0] > 0.2


def test_a_pruned_plant_is_smaller(catalogue):
    full, cut = (grown(catalogue, age=25, pruning_factor=factor) for factor in (1.0, 0.6))
    assert cut.accounts.height_m[0] < full.accounts.height_m[0]
    assert cut.accounts.pruned[0] > 0 == full.accounts.pruned[0]


@pytest.mark.parametrize(
    ("around", "told"),
    [
        ({"age": -1.0}, "--age"),
        ({"age": 251.0}, "0 to 250"),
        ({"age": float("nan")}, "--age"),
        ({"walls": [Wall(0.0, 90)]}, "--wall 0@90"),
        ({"walls": [Wall(3, 90, 0.0)]}, "--wall 3@90x0"),
        ({"walls": [Wall(float("inf"), 90)]}, "distance of a wall"),
        ({"neighbours": [Neighbour("tilia_cordata", 0.0, 0)]}, "--neighbour tilia_cordata@0,0"),
        ({"neighbours": [Neighbour("tilia_cordata", 4.0, 0, -3)]}, "--neighbour tilia_cordata@4,0,-3"),
        ({"neighbours": [Neighbour("oka", 4.0, 0)]}, "no species 'oka'"),
        ({"neighbours": [Neighbour("tilia_cordata", 400.0, 0)]}, "0.1 to 60"),
        ({"neighbours": [Neighbour("tilia_cordata", 1.0 + n, 0) for n in range(25)]}, "number of neighbours"),
        ({"neighbours": [Neighbour("tilia_cordata", 4.5, 0)], "walls": [Wall(4, 0)]}, "would stand in a wall"),
        ({"pruning_factor": 1.5}, "--pruning"),
        ({"latitude_deg": 91.0}, "--latitude"),
    ],
)
def test_what_cannot_be_grown_is_refused_by_the_name_of_its_option(catalogue, around, told):
    with pytest.raises(InputError, match=told.replace("(", r"\(")):
        grown(catalogue, **around)
