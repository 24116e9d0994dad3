import sys

import numpy as np
import pytest
import shapely

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES, strategy_names
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.city_wide import place_in_waves
from urbanforest_cli.placement.sites import Sites
from urbanforest_cli.placement.strategies import (
    BUILT_IN,
    boundary_bands,
    cluster_areas,
    strategy_named,
)

SETTINGS = Placement()
SQUARE = shapely.box(0, 0, 60, 60)
HOUSE = shapely.box(22, 22, 38, 36).buffer(6)


def sites(lots, areas=None, **values):
    lots = np.array(lots, dtype=object)
    ids = np.array([f"lot{i}" for i in range(len(lots))], dtype=object)
    columns = {name: np.full(len(lots), float(values.get(name, p.default))) for name, p in PARAMETERS.items()}
    areas = lots if areas is None else np.array(areas, dtype=object)
    return Sites(lot_ids=ids, keys=keys_for(0, "place", ids), lots=lots, areas=areas, values=columns)


def slack(xy, radius):
    gap = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) - radius[:, None] - radius[None]
    return gap[np.triu_indices(len(radius), 1)].min()


@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_keeps_its_plants_in_the_ground(name):
    long = shapely.box(0, 0, 160, 60)
    batch = sites([long] * 4, [long.difference(HOUSE)] * 4)
    found = strategy_named(name)(batch, SETTINGS)
    assert len(found) >= 4
    assert (np.diff(found.site) >= 0).all()
    shrunk = batch.areas[0].buffer(-0.0009)
    assert shapely.contains_xy(shrunk, found.xy[:, 0], found.xy[:, 1]).all()


@pytest.mark.parametrize("name", STRATEGIES)
def test_a_lot_is_planted_alike_whatever_lots_stand_beside_it(name):
    lots = [shapely.box(200 * i, 0, 200 * i + 160, 60) for i in range(3)]
    together = sites(lots)
    alone = sites(lots[1:2])
    alone.keys[:] = together.keys[1]
    found, single = strategy_named(name)(together, SETTINGS), strategy_named(name)(alone, SETTINGS)
    assert np.array_equal(found.xy[found.site == 1], single.xy)


def test_the_band_of_a_square_has_the_area_known_by_hand():
    lots = np.array([SQUARE] * 4, dtype=object)
    width = np.array([0.0, 4.0, 10.0, 45.0])
    bands = boundary_bands(lots, lots, width)
    assert np.allclose(shapely.area(bands), [0, 4 * 4 * 56, 4 * 10 * 50, 3600])


def test_the_band_follows_the_lot_and_not_the_house():
    area = SQUARE.difference(HOUSE)
    lots, areas = np.array([SQUARE], dtype=object), np.array([area], dtype=object)
    of_lot = boundary_bands(lots, areas, np.array([4.0]))[0]
    of_area = boundary_bands(lots, areas, np.array([4.0]), edge_of="area")[0]
    assert of_lot.distance(HOUSE) > 1
    assert of_area.distance(HOUSE) == 0
    courtyard = np.array([SQUARE.difference(shapely.box(25, 25, 35, 35))], dtype=object)
    assert boundary_bands(courtyard, courtyard, np.array([4.0]))[0].area == pytest.approx(4 * 4 * 56)


def test_boundary_plants_stand_within_the_band():
    found = BUILT_IN["boundary"](sites([SQUARE] * 3, boundary_width_m=5), SETTINGS)
    edge = shapely.distance(SQUARE.boundary, shapely.points(found.xy))
    assert edge.max() <= 5
    assert len(BUILT_IN["boundary"](sites([SQUARE], boundary_width_m=0), SETTINGS)) == 0


def test_clusters_are_discs_in_the_ground_and_no_more_than_the_most():
    batch = sites([shapely.box(0, 0, 400, 400)] * 60, cluster_count_max=3, cluster_radius_m=6)
    areas = cluster_areas(batch, SETTINGS)
    discs = shapely.area(areas) / (np.pi * 36)
    assert discs.max() <= 3.0001
    counts = np.array([shapely.get_num_geometries(area) for area in areas])
    assert set(counts) == {1, 2, 3}
    exactly = cluster_areas(batch, Placement(cluster_count="max"))
    assert np.median([shapely.get_num_geometries(area) for area in exactly]) == 3
    assert shapely.is_empty(cluster_areas(sites([SQUARE], cluster_count_max=0), SETTINGS)).all()


def test_single_sets_one_plant_uniformly():
    found = BUILT_IN["single"](sites([SQUARE] * 3000), SETTINGS)
    assert found.site.tolist() == list(range(3000))
    counts = np.histogram2d(found.xy[:, 0], found.xy[:, 1], bins=5, range=[[0, 60], [0, 60]])[0]
    assert ((counts - 120) ** 2 / 120).sum() < 51  # 24 degrees of freedom, p = 0.001


def test_across_lot_borders_plants_may_touch_by_default_and_may_not_by_option():
    lots = [shapely.box(20 * i, 20 * j, 20 * i + 20, 20 * j + 20) for i in range(5) for j in range(5)]
    batch = sites(lots)
    names = np.array(["random", "boundary", "regular", "single", "cluster"] * 5, dtype=object)
    found = place_in_waves(batch, names, SETTINGS)
    assert slack(found.xy, found.radius_m) >= 0
    by_lot = BUILT_IN["random"](batch, SETTINGS)
    assert slack(by_lot.xy, by_lot.radius_m) < 0


def test_city_wide_placement_knows_no_order_of_lots():
    lots = [shapely.box(20 * i, 0, 20 * i + 20, 20) for i in range(12)]
    batch = sites(lots)
    names = np.array(["random"] * 12, dtype=object)
    one = place_in_waves(batch, names, SETTINGS)
    turned = Sites(
        lot_ids=batch.lot_ids[::-1],
        keys=batch.keys[::-1],
        lots=batch.lots[::-1],
        areas=batch.areas[::-1],
        values=batch.values,
    )
    two = place_in_waves(turned, names, SETTINGS)
    assert np.allclose(one.xy[one.site == 4], two.xy[two.site == 7], atol=1e-9)


@pytest.mark.parametrize("name", ["random", "regular", "equidistant"])
def test_a_lot_over_the_limit_is_left_out_and_the_others_are_planted(name):
    lots = [shapely.box(0, 0, 2000, 200), shapely.box(3000, 0, 3060, 30)]
    found = BUILT_IN[name](sites(lots, spacing_m=4), Placement(max_plants_per_lot=100))
    assert found.refused.tolist() == [0]
    assert set(found.site) == {1}


def test_an_unknown_strategy_lists_the_six():
    with pytest.raises(ConfigError) as caught:
        strategy_named("randm")
    assert all(name in str(caught.value) for name in STRATEGIES)


@pytest.fixture
def orchard(tmp_path, monkeypatch):
    """The worked example of docs/strategies.md, installed as a package of somebody else's."""
    from pathlib import Path

    page = (Path(__file__).parents[2] / "docs" / "strategies.md").read_text(encoding="utf-8")
    source = page.split("```python\n")[1].split("```")[0]
    (tmp_path / "orchard.py").write_text(source, encoding="utf-8")
    info = tmp_path / "orchard-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: orchard\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[urbanforest.strategies]\norchard = orchard:orchard\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("orchard", None)


def test_a_strategy_of_another_package_is_used_from_a_config(orchard, tiny_city, tmp_path, runner):
    assert "orchard" in strategy_names()
    config = tmp_path / "my.toml"
    config.write_text('[zones.default]\nstrategy = "orchard"\nradius_mean_m = 3.0\ndensity = 1.0\n', encoding="utf-8")
    outcome = runner(
        "populate", tiny_city, "-o", tmp_path / "out", "-c", config, "--until", "place",
        "--set", "rules.derive_street_lots=false", "--set", "context.passes=0", "-q",
    )  # fmt: skip
    assert outcome.exit_code == 0, outcome.stderr
    from urbanforest_cli.files.geopackage import read_layer

    plants = read_layer(tmp_path / "out" / "register.gpkg", "plants")
    third = plants[plants["lot_id"] == "c"]
    assert len(third) == 100
    assert set(np.round(np.diff(np.unique(np.round(third.geometry.x, 3))), 3)) == {6.0}


def test_without_that_package_the_config_is_refused(tiny_city, tmp_path, runner):
    config = tmp_path / "my.toml"
    config.write_text('[zones.default]\nstrategy = "orchard"\n', encoding="utf-8")
    outcome = runner("populate", tiny_city, "-o", tmp_path / "out", "-c", config)
    assert outcome.exit_code == 2
    assert "orchard" in outcome.stderr
    assert not (tmp_path / "out").exists()


def test_a_plug_in_that_changes_is_noticed(orchard):
    from urbanforest_cli.core.params import plugin_prints

    before = plugin_prints()
    (orchard / "orchard.py").write_text("def orchard(lot, area, values, rng):\n    return [], []\n")
    assert plugin_prints() != before


@pytest.mark.parametrize("body", ["raise ValueError('boom')", "return [1, 2, 3]", "return [[1, 1]], float('nan')"])
def test_a_plug_in_that_fails_is_named_with_the_lot(body):
    from urbanforest_cli.placement.strategies import lot_by_lot

    scope: dict = {}
    exec(f"def place(lot, area, values, rng):\n    {body}\n", scope)
    with pytest.raises(ConfigError, match="lot lot0: strategy 'theirs'"):
        lot_by_lot(scope["place"], "theirs")(sites([SQUARE]), SETTINGS)
