import geopandas as gpd
import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree
from shapely import affinity

from tests.reference.lattice import lattice_by_shapely
from urbanforest_cli.core.config import Placement
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.lattice import CELLS_A_BLOCK, lattice_positions, regular
from urbanforest_cli.placement.sites import Sites

FIELD = shapely.box(0, 0, 40, 30)
LOT = shapely.Polygon([(0, 0), (43, 4), (51, 31), (20, 38), (18, 22), (-4, 19)])


def lattice(lots, cell_m, orientation_deg=0.0, jitter=0.0, areas=None, keys=None, **options):
    lots = np.array(lots, dtype=object)
    areas = lots if areas is None else np.array(areas, dtype=object)
    keys = keys_for(0, "place", [f"lot{i}" for i in range(len(lots))]) if keys is None else keys
    columns = (np.full(len(lots), float(v)) for v in (cell_m, orientation_deg, jitter))
    return lattice_positions(lots, areas, *columns, keys, **options)


def same_set(one, other, tolerance_m=1e-6):
    return len(one) == len(other) and (len(one) == 0 or cKDTree(one).query(other)[0].max() < tolerance_m)


def rotated(xy, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return xy @ np.array([[c, s], [-s, c]])


def random_lots(count, seed=0):
    rng = np.random.default_rng(seed)
    angle = (np.arange(8) + rng.uniform(-0.3, 0.3, (count, 8))) * np.pi / 4
    reach = rng.uniform(0.7, 1.3, (count, 8)) * rng.uniform(8, 30, (count, 1))
    outline = np.stack([reach * np.cos(angle), 0.7 * reach * np.sin(angle)], axis=-1)
    return shapely.polygons(outline + rng.uniform(0, 1000, (count, 1, 2)))


def test_cells_of_a_field_are_known_by_hand():
    u, v = np.meshgrid([5.0, 15, 25, 35], [5.0, 15, 25])
    assert same_set(lattice([FIELD], 10).xy, np.column_stack([u.ravel(), v.ravel()]))


@pytest.mark.parametrize("cell_m", [2.0, 5.0, 9.0])
def test_number_of_plants_is_the_area_over_that_of_a_cell(cell_m):
    lots = random_lots(600)
    found = lattice(lots, cell_m, random_phase=True)
    assert len(found.xy) == pytest.approx(shapely.area(lots).sum() / cell_m**2, rel=0.03)
    sides = np.random.default_rng(2).uniform(10, 60, (2, 600))
    fields = [affinity.rotate(shapely.box(0, 0, a, b), a) for a, b in sides.T]
    assert len(lattice(fields, cell_m).xy) == pytest.approx((sides[0] * sides[1]).sum() / cell_m**2, rel=0.03)


@pytest.mark.parametrize("orientation_deg", [0.0, 27.0])
def test_kernel_agrees_with_slow_twin(orientation_deg):
    lots = random_lots(40, seed=1)
    found = lattice(lots, 4.0, orientation_deg)
    for number, lot in enumerate(lots):
        twin = lattice_by_shapely(lot, lot, 4.0, orientation_deg)
        assert same_set(found.xy[found.site == number], twin)


@pytest.mark.parametrize("turn_deg", [17, 33, 61, 90, 200])
@pytest.mark.parametrize("orientation_deg", [0.0, 20.0])
def test_lattice_turns_with_its_lot(turn_deg, orientation_deg):
    still = lattice([LOT], 4.0, orientation_deg).xy
    turned = lattice([affinity.rotate(LOT, turn_deg, origin=(0, 0))], 4.0, orientation_deg).xy
    assert same_set(rotated(turned, -turn_deg), still)


@pytest.mark.parametrize("options", [{}, {"jitter": 0.7}, {"random_phase": True, "jitter": 0.3}])
def test_orientation_has_a_period_of_90_degrees(options):
    one, other, third = (lattice([LOT, FIELD], 4.0, angle, **options) for angle in (10, 100, 370))
    assert np.array_equal(one.cell, other.cell)
    assert one.xy == pytest.approx(other.xy, abs=1e-9)
    assert one.xy == pytest.approx(third.xy, abs=1e-9)
    assert not same_set(one.xy, lattice([LOT, FIELD], 4.0, 30, **options).xy)


def test_turned_lattice_covers_the_lot_to_its_corners():
    inner = FIELD.buffer(-3)
    for angle in (0, 15, 30, 45, 72):
        found = lattice([FIELD], 2.0, angle).xy
        probes = shapely.get_coordinates(inner)
        assert cKDTree(found).query(probes)[0].max() <= np.sqrt(2) + 1e-6


@pytest.mark.parametrize(
    "lot",
    [shapely.box(0, 0, 30, 30), shapely.Point(0, 0).buffer(20), shapely.Point(0, 0).buffer(20, quad_segs=3), FIELD],
    ids=["square", "disc", "dodecagon", "rectangle"],
)
@pytest.mark.parametrize("options", [{}, {"jitter": 1.0, "random_phase": True}])
def test_ties_between_frames_are_broken_the_same_way_under_noise(lot, options):
    lots = shapely.transform(np.array([lot] * 8, dtype=object), lambda xy: xy + np.array([500_000.0, 4_500_000.0]))
    rng = np.random.default_rng(0)
    shift = rng.uniform(-1e-7, 1e-7, (8, 2))
    noisy = np.array(
        [
            shapely.transform(one, lambda xy, s=s: xy + s + 1e-7 * np.sin(9e4 * xy + 1e9 * s))
            for one, s in zip(lots, shift, strict=True)
        ]
    )
    keys = np.full(8, 5, dtype=np.uint64)
    one, other = (lattice(batch, 4.0, 0.0, keys=keys, **options) for batch in (lots, noisy))
    assert np.array_equal(one.site, other.site)
    assert one.xy == pytest.approx(other.xy, abs=1e-3, rel=0)


@pytest.mark.parametrize("cell_m", [8.0, 10.0, 20 / 3])
def test_sides_of_a_whole_number_of_half_cells_are_no_tie_under_noise(cell_m):
    lots = np.array([shapely.box(0, 0, 40 + d, 20 - d) for d in (-1e-7, 0, 1e-7)], dtype=object)
    counts = np.bincount(lattice(lots, cell_m).site)
    assert len(set(counts)) == 1


def test_jitter_stays_in_the_cell_and_fills_it():
    still, moved = lattice([FIELD], 2.0), lattice([FIELD], 2.0, jitter=1.0)
    shared = {tuple(c): xy for c, xy in zip(still.cell, still.xy, strict=True)}
    offset = np.array([xy - shared[tuple(c)] for c, xy in zip(moved.cell, moved.xy, strict=True)])
    assert np.abs(offset).max() <= 1.0
    assert np.abs(offset.mean(axis=0)).max() < 0.1
    assert offset.std(axis=0) == pytest.approx(2 / np.sqrt(12), rel=0.1)
    half = lattice([FIELD], 2.0, jitter=0.5)
    assert np.abs(np.array([xy - shared[tuple(c)] for c, xy in zip(half.cell, half.xy, strict=True)])).max() <= 0.5


def test_a_cell_s_plant_is_the_same_whichever_other_cells_survive():
    house = shapely.box(10, 10, 25, 22)
    whole = lattice([FIELD], 3.0, jitter=0.8)
    left = lattice([FIELD], 3.0, jitter=0.8, areas=[FIELD - house])
    places = {tuple(c): tuple(xy) for c, xy in zip(whole.cell, whole.xy, strict=True)}
    assert 0 < len(left.xy) < len(whole.xy)
    assert all(places[tuple(c)] == tuple(xy) for c, xy in zip(left.cell, left.xy, strict=True))


def test_plants_stand_a_millimetre_inside_the_ground():
    found = lattice([FIELD], 10.0, areas=[FIELD - shapely.box(0, 0, 15.0005, 30)])
    assert found.xy[:, 0].min() == pytest.approx(25.0)


def test_a_lattice_of_many_blocks_is_the_same_as_of_one(monkeypatch):
    lots = random_lots(30, seed=4)
    one = lattice(lots, 1.0, 12.0, 0.5)
    monkeypatch.setattr("urbanforest_cli.placement.lattice.CELLS_A_BLOCK", 700)
    other = lattice(lots, 1.0, 12.0, 0.5)
    assert CELLS_A_BLOCK > 700
    assert np.array_equal(one.xy, other.xy)
    assert np.array_equal(one.site, other.site)


def test_lots_do_not_depend_on_their_batch():
    lots = random_lots(20, seed=5)
    keys = keys_for(1, "place", [str(i) for i in range(20)])
    together = lattice(lots, 3.0, 5.0, 0.4, keys=keys, random_phase=True)
    for number in (0, 7, 19):
        alone = lattice(lots[number : number + 1], 3.0, 5.0, 0.4, keys=keys[number : number + 1], random_phase=True)
        assert np.array_equal(alone.xy, together.xy[together.site == number])


def test_lots_without_ground_and_without_shape_get_no_plants():
    nothing = [None, shapely.Polygon(), shapely.LineString([(0, 0), (9, 9)]), FIELD]
    found = lattice(nothing, 5.0, areas=[None, FIELD, FIELD, shapely.Polygon()])
    assert len(found.xy) == 0
    assert len(lattice([], 5.0).xy) == 0


def test_strategy_gives_each_plant_a_radius_of_the_law():
    ids = np.array(["a"], dtype=object)
    values = {name: np.array([float(p.default)]) for name, p in PARAMETERS.items()}
    values["grid_size_m"][:] = 1.0
    lot = np.array([shapely.box(0, 0, 100, 100)], dtype=object)
    found = regular(Sites(ids, keys_for(0, "place", ids), lot, lot, values), Placement())
    assert len(found) == 10_000
    assert found.radius_m.mean() == pytest.approx(3.13, rel=0.01)
    assert found.radius_m.var() == pytest.approx(0.35, rel=0.05)


def test_real_lots_get_the_same_lattice_whatever_crs_they_came_in(real_data):
    lots = gpd.read_file(real_data / "nyc_astoria" / "astoria.gpkg").geometry.make_valid()
    straight = np.array(lots.to_crs(32618).values, dtype=object)
    roundabout = np.array(lots.to_crs(4326).to_crs(3857).to_crs(32618).values, dtype=object)
    one, other = (lattice(batch, 5.0, 20.0, 0.5, random_phase=True) for batch in (straight, roundabout))
    assert len(one.xy) == pytest.approx(shapely.area(straight).sum() / 25, rel=0.03)
    assert np.array_equal(one.site, other.site)
    assert np.abs(one.xy - other.xy).max() < 1e-3
