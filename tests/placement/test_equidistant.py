import geopandas as gpd
import numpy as np
import pytest
import shapely
from scipy.spatial.distance import pdist
from shapely import affinity

from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.equidistant import equidistant, equidistant_positions
from urbanforest_cli.placement.medial_axis import medial_axes
from urbanforest_cli.placement.sites import Sites

SETTINGS = Placement()
STRIP = shapely.box(0, 0, 200, 12)
T_SHAPE = shapely.Polygon([(0, 0), (60, 0), (60, 10), (35, 10), (35, 50), (25, 50), (25, 10), (0, 10)])
ANNULUS = shapely.Point(0, 0).buffer(20, quad_segs=32).difference(shapely.Point(0, 0).buffer(10, quad_segs=32))


def sites(lots, areas=None, **values):
    lots = np.array(lots, dtype=object)
    ids = np.array([f"lot{i}" for i in range(len(lots))], dtype=object)
    columns = {name: np.full(len(lots), float(values.get(name, p.default))) for name, p in PARAMETERS.items()}
    areas = lots if areas is None else np.array(areas, dtype=object)
    return Sites(lot_ids=ids, keys=keys_for(0, "place", ids), lots=lots, areas=areas, values=columns)


def row(polygon, spacing_m):
    return equidistant_positions(medial_axes(np.array([polygon], dtype=object)), np.array([spacing_m]))[0]


@pytest.mark.parametrize("turn_deg", [0, 17, 33, 61])
def test_row_in_a_strip_is_known_by_hand(turn_deg):
    xy = row(affinity.rotate(STRIP, turn_deg, origin=(0, 0)), 13.0)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    back = xy @ np.array([[c, -s], [s, c]])
    back = back[np.argsort(back[:, 0])]
    assert back == pytest.approx(np.column_stack([9 + 13.0 * np.arange(15), np.full(15, 6.0)]), abs=1e-4)


def test_spacing_that_fits_a_whole_number_of_times_reaches_both_ends():
    xy = row(STRIP, 4.0)
    assert len(xy) == 48
    assert sorted(xy[:, 0])[0] == pytest.approx(6, abs=1e-4)


def test_axis_shorter_than_the_spacing_gets_one_plant_in_its_middle():
    assert row(shapely.box(0, 0, 20, 12), 13.0) == pytest.approx(np.array([[10, 6]]), abs=1e-4)
    assert row(shapely.box(0, 0, 20, 20), 13.0) == pytest.approx(np.array([[10, 10]]), abs=1e-4)


def test_loop_is_filled_evenly_and_its_two_ends_keep_the_spacing():
    xy = row(ANNULUS, 13.0)
    assert len(xy) == 7  # 94.2 m of axis
    turn = np.sort(np.arctan2(xy[:, 1], xy[:, 0]))
    gaps = np.diff(np.append(turn, turn[0] + 2 * np.pi)) * 15
    assert np.sort(gaps)[:6] == pytest.approx(13.0, rel=2e-3)
    assert gaps.max() > 13.0


def test_at_a_junction_only_neighbours_along_a_chain_are_nearer_than_the_spacing():
    xy = row(T_SHAPE, 7.0)
    stem, bar = xy[xy[:, 1] > 10], xy[xy[:, 1] <= 10]
    assert len(stem) >= 5
    assert len(bar) >= 6
    assert pdist(xy).min() > 7.0 / np.sqrt(2)
    assert (np.sort(pdist(xy)) < 6.99).sum() <= 1


def test_both_verges_of_a_street_get_a_row_each_though_they_are_nearer_than_the_spacing():
    line = shapely.LineString([(0, 0), (120, 15), (220, 90)])
    verge = line.buffer(6, cap_style="flat") - line.buffer(3.5, cap_style="flat")
    crossing = shapely.LineString([(60, -50), (60, 80)]).buffer(5)
    street = verge - crossing
    assert len(street.geoms) == 4
    found = equidistant(sites([street], spacing_m=12.0), SETTINGS)
    side = np.array([shapely.distance(p, shapely.points(found.xy)) < 1e-9 for p in street.geoms])
    length = np.array([p.length / 2 - 2.5 for p in street.geoms])
    assert (np.abs(side.sum(axis=1) - length / 12.0) < 1.5).all()
    assert shapely.distance(line, shapely.points(found.xy)) == pytest.approx(4.75, abs=0.02)


def test_axis_is_that_of_the_lot_and_plants_stand_only_in_the_ground_left():
    house = shapely.box(60, 3, 140, 12)
    found = equidistant(sites([STRIP], [STRIP - house], spacing_m=13.0), SETTINGS)
    whole = row(STRIP, 13.0)
    expected = whole[(whole[:, 0] < 60) | (whole[:, 0] > 140)]
    assert found.xy == pytest.approx(expected)


def test_radius_of_a_plant_does_not_change_when_ground_elsewhere_is_built_on():
    areas = STRIP, STRIP - shapely.box(0, 0, 60, 12)
    open_, built = (equidistant(sites([STRIP], [area], spacing_m=13.0), SETTINGS) for area in areas)
    assert np.array_equal(open_.radius_m[-len(built) :], built.radius_m)


def test_spacing_of_zero_is_twice_the_smallest_radius():
    found = equidistant(sites([STRIP], spacing_m=0.0), SETTINGS)
    assert len(found) == 189
    assert np.diff(np.sort(found.xy[:, 0])) == pytest.approx(2 * SETTINGS.radius_min_m)


def test_positions_hang_on_the_lot_alone():
    lots = [affinity.rotate(T_SHAPE, 20 * i) for i in range(6)] + [ANNULUS, STRIP]
    together = sites(lots, spacing_m=6.0)
    found = equidistant(together, SETTINGS)
    assert (np.diff(found.site) >= 0).all()
    for number in (0, 6, 7):
        alone = sites(lots[number : number + 1], spacing_m=6.0)
        alone.keys[:] = together.keys[number]
        one = equidistant(alone, SETTINGS)
        assert np.array_equal(one.xy, found.xy[found.site == number])
        assert np.array_equal(one.radius_m, found.radius_m[found.site == number])


def test_noise_of_a_reprojection_changes_no_row():
    lots = [affinity.rotate(T_SHAPE, 20 * i, origin=(0, 0)) for i in range(6)] + [ANNULUS, STRIP]
    lots = shapely.transform(np.array(lots, dtype=object), lambda xy: xy + np.array([400_000.1, 5e6]))
    noisy = shapely.transform(lots, lambda xy: xy + 1e-7 * np.sin(1e5 * xy + 3e4 * xy[:, ::-1]))
    one, other = (equidistant(sites(batch, spacing_m=5.0), SETTINGS) for batch in (lots, noisy))
    assert np.array_equal(one.site, other.site)
    assert one.xy == pytest.approx(other.xy, abs=1e-3, rel=0)


def test_lots_without_an_axis_get_no_plants():
    found = equidistant(sites([shapely.box(0, 0, 50, 0.001), shapely.Polygon(), STRIP]), SETTINGS)
    assert set(found.site) == {2}
    assert len(equidistant(sites([shapely.Polygon()]), SETTINGS)) == 0


def test_real_lots_get_the_same_rows_whatever_crs_they_came_in(real_data):
    lots = gpd.read_file(real_data / "nyc_astoria" / "astoria.gpkg").geometry.make_valid()
    straight = np.array(lots.to_crs(32618).values, dtype=object)
    roundabout = np.array(lots.to_crs(4326).to_crs(3857).to_crs(32618).values, dtype=object)
    one, other = (equidistant(sites(batch), SETTINGS) for batch in (straight, roundabout))
    assert len(one) > 5000
    assert np.array_equal(one.site, other.site)
    assert np.abs(one.xy - other.xy).max() < 1e-3
    assert not medial_axes(straight).failed.any()


def test_real_verges_are_planted_in_their_middle(real_data):
    roads = gpd.read_file(real_data / "bondy" / "bondy.gpkg", layer="osm_roads").to_crs(2154).geometry.values
    verges = np.array(shapely.difference(shapely.buffer(roads, 6), shapely.buffer(roads, 3.5)), dtype=object)
    found = equidistant(sites(verges), SETTINGS)
    assert len(found) == pytest.approx(shapely.length(verges).sum() / 2 / 8, rel=0.05)
    apart = shapely.distance(np.array(roads)[found.site], shapely.points(found.xy))
    assert np.median(apart) == pytest.approx(4.75, abs=0.01)
    assert (np.abs(apart - 4.75) < 0.3).mean() > 0.97
