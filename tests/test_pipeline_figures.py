import numpy as np
import pytest
import shapely
from PIL import Image

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.pipeline_figures import (
    HOUSES,
    LOT,
    PAGES,
    one,
    plant_lots,
    preset,
    render_figures,
    repeated,
    shapes,
)


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(settings.Species())


def planting(name, catalogue, buildings=HOUSES, lot=LOT, **changed):
    config, strategy, values = preset(name)
    return plant_lots(one(lot), buildings, strategy, repeated(values, **changed), config=config, catalogue=catalogue)


def test_plants_of_a_band_stand_within_its_width_of_the_edge(catalogue):
    for name, width_m in (("positional_a", 4.0), ("positional_b", 10.0), ("positional_c", 10.0)):
        spots = shapely.points(planting(name, catalogue).crowns.xy)
        assert len(spots) > 5
        assert shapely.distance(spots, LOT.exterior).max() <= width_m


def test_less_density_keeps_some_of_the_same_plants(catalogue):
    low, medium, full = (
        {tuple(xy) for xy in planting(f"positional_{letter}", catalogue).crowns.xy} for letter in "jkl"
    )
    assert low < medium < full


def test_one_cluster_lies_in_one_disc_and_three_do_not(catalogue):
    one_cluster, three = (planting(f"positional_{letter}", catalogue).crowns.xy for letter in "de")
    assert shapely.minimum_bounding_radius(shapely.MultiPoint(one_cluster)) <= 10.0
    assert shapely.minimum_bounding_radius(shapely.MultiPoint(three)) > 20.0


def test_jitter_moves_plants_off_the_lattice_by_its_share_of_a_cell(catalogue):
    lattice = planting("positional_g", catalogue).crowns.xy
    for letter, jitter in (("h", 0.30), ("i", 0.55)):
        moved = planting(f"positional_{letter}", catalogue).crowns.xy
        nearest = np.hypot(*(moved[:, None] - lattice[None]).transpose(2, 0, 1)).min(axis=1)
        inner = nearest[shapely.distance(shapely.points(moved), LOT.exterior) > 9]
        assert 0 < np.median(inner) <= jitter * 9 / np.sqrt(2)


def test_the_envelope_keeps_plants_six_metres_from_walls(catalogue):
    config, strategy, values = preset("positional_l")
    walls = shapely.union_all(HOUSES)
    kept, bare = (
        plant_lots(one(LOT), HOUSES, strategy, repeated(values), config=config, catalogue=catalogue, rules_on=on)
        for on in (True, False)
    )
    assert shapely.distance(shapely.points(kept.crowns.xy), walls).min() >= 6.0
    assert shapely.distance(shapely.points(bare.crowns.xy), walls).min() < 2.0
    assert not shapely.contains(walls, shapely.points(bare.crowns.xy)).any()


def test_as_a_building_grows_clusters_turn_into_a_row_along_the_edge(catalogue):
    lot = shapely.box(0, 0, 88, 76)
    depths = []
    for share in (0.0, 0.5, 0.78):
        house = one(shapely.affinity.scale(lot, share, share)) if share else shapes()
        spots = shapely.points(planting("growth_of_building", catalogue, house, lot).crowns.xy)
        depths.append(shapely.distance(spots, lot.exterior).max())
    assert depths[0] > 25
    assert depths[1] < 18
    assert depths[2] < 6


def test_trees_and_shrubs_are_those_of_the_captions(catalogue):
    shares = [planting(f"structural_{letter}", catalogue).crowns.tall.mean() for letter in "def"]
    assert shares[0] == 0
    assert shares[0] < shares[1] < shares[2]
    species = [len(np.unique(planting(f"structural_{letter}", catalogue).crowns.colour, axis=0)) for letter in "gi"]
    assert species[0] == 1 < species[1]
    oldest = [planting(f"structural_{letter}", catalogue).age_years.max() for letter in "abc"]
    assert oldest[0] < oldest[1] < oldest[2] <= 30


def test_a_page_is_written_whole(tmp_path):
    summary = render_figures(tmp_path / "figures", names=["boundary", "context"])
    assert summary.counts == {"pages": 2}
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["boundary.png", "context.png"]
    for path in (tmp_path / "figures").iterdir():
        with Image.open(path) as picture:
            assert picture.width == 2000


@pytest.mark.slow
def test_every_page_can_be_drawn(tmp_path):
    render_figures(tmp_path)
    assert {path.stem for path in tmp_path.iterdir()} == set(PAGES)


def test_an_unknown_page_is_refused_with_those_there_are(runner, tmp_path):
    with pytest.raises(ConfigError, match="boundary, cluster"):
        render_figures(tmp_path, names=["nonsense"])
    assert runner("figures", "nonsense", "-o", tmp_path).exit_code == 2
