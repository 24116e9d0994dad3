from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scipy.stats import chisquare, ks_2samp, kstest, truncnorm
from shapely.affinity import translate
from shapely.geometry import GeometryCollection, MultiPolygon, Point, Polygon, box

from tests.reference.poisson_darts import largest_gap, smallest_slack, throw_darts
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.poisson import SampleState, SaturatedSample, sample_saturated
from urbanforest_cli.placement.radius_law import fit_radius_law

MEAN = 3.13
COURTYARD = Polygon(box(0, 0, 30, 22).exterior, [box(8, 6, 21, 15).exterior.coords])
BENT = Polygon([(0, 0), (34, 3), (30, 14), (13, 12), (11, 33), (-3, 29)])
PARTS = MultiPolygon([box(0, 0, 9, 30), box(9.5, 2, 9.7, 28), Polygon([(15, 0), (33, 5), (14, 24)])])
LOTS = np.array([COURTYARD, BENT, PARTS, box(0, 0, 1, 1)], dtype=object)


def keys(count: int, name: str = "test") -> NDArray[np.uint64]:
    return keys_for(0, name, map(str, range(count)))


def sample(areas: object, mean: object = MEAN, variance: object = 0.35, **options: object) -> SaturatedSample:
    array = np.array([areas], dtype=object) if isinstance(areas, shapely.Geometry) else np.asarray(areas, dtype=object)
    options.setdefault("keys", keys(len(array)))
    return sample_saturated(array, mean, variance, **options)  # type: ignore[arg-type]


def per_area(found: SaturatedSample, count: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    return [(found.xy[found.site == i], found.radius_m[found.site == i]) for i in range(count)]


@pytest.mark.parametrize("law", ["kept", "redrawn"])
@pytest.mark.parametrize("stop", ["mean", "min", "max"])
@pytest.mark.parametrize("variance", [0.0, 0.35, 2.0])
def test_discs_are_apart_and_inside_and_leave_no_gap_of_the_stop_radius(law: str, stop: str, variance: float) -> None:
    found = sample(LOTS, variance=variance, radius_law=law, radius_stop=stop)
    width = float(fit_radius_law(MEAN, variance).width_m)
    limit = MEAN + {"mean": 0.0, "min": -width, "max": width}[stop]
    for area, (xy, radius) in zip(LOTS, per_area(found, len(LOTS)), strict=True):
        assert smallest_slack(xy, radius) >= 0
        assert (shapely.contains_xy(area, xy[:, 0], xy[:, 1])).all()
        assert shapely.distance(shapely.points(xy), area.boundary).min() >= 0.001
        assert largest_gap(area, xy, radius) < limit
        assert radius.min() >= MEAN - width - 1e-12
        assert radius.max() <= MEAN + width + 1e-12
    assert (found.state == SampleState.SATURATED).all()
    assert found.unresolved_area_m2.max() < 1e-2


@pytest.mark.parametrize("variance", [0.35, 1.0, 2.0])
def test_kept_radii_of_a_large_lot_have_the_mean_and_variance_asked_for(variance: float) -> None:
    found = sample(box(0, 0, 150, 150), variance=variance)
    assert len(found.site) > 350
    assert found.radius_m.mean() == pytest.approx(MEAN, rel=0.03)
    assert found.radius_m.var() == pytest.approx(variance, rel=0.15)


@pytest.mark.parametrize(("mean", "variance"), [(1.0, 0.05), (6.0, 2.0), (10.0, 1.0)])
def test_kept_radii_are_right_at_other_scales_too(mean: float, variance: float) -> None:
    found = sample(box(0, 0, 45 * mean, 45 * mean), mean, variance)
    assert found.radius_m.mean() == pytest.approx(mean, rel=0.03)
    assert found.radius_m.var() == pytest.approx(variance, rel=0.15)


@pytest.mark.parametrize(("side", "count"), [(1.0, 4000), (8.0, 1500), (12.0, 1000), (20.0, 400)])
@pytest.mark.parametrize("variance", [0.35, 2.0])
def test_kept_radii_of_many_small_lots_together_are_unbiased(side: float, count: int, variance: float) -> None:
    found = sample([box(0, 0, side, side)] * count, variance=variance)
    error = np.sqrt(variance / len(found.site))
    assert abs(found.radius_m.mean() - MEAN) < 4 * error
    assert found.radius_m.var() == pytest.approx(variance, rel=0.2)


def test_kept_radii_follow_the_cut_normal_law_nearly() -> None:
    found = sample(box(0, 0, 220, 220), variance=0.35)
    law = fit_radius_law(MEAN, 0.35)
    cut = float(law.width_m / law.scale_m)
    assert kstest(found.radius_m, truncnorm(-cut, cut, MEAN, law.scale_m).cdf).statistic < 0.08


def test_radii_drawn_to_the_largest_stop_are_independent_draws_of_the_law() -> None:
    law = fit_radius_law(MEAN, 0.35)
    cut = float(law.width_m / law.scale_m)
    for name in ("kept", "redrawn"):
        found = sample(box(0, 0, 200, 200), radius_stop="max", radius_law=name)
        assert kstest(found.radius_m, truncnorm(-cut, cut, MEAN, law.scale_m).cdf).pvalue > 0.001


def test_kept_radii_are_not_sorted_by_place() -> None:
    found = sample(box(0, 0, 200, 200), variance=1.0)
    quarter = (found.xy[:, 0] > 100) * 2 + (found.xy[:, 1] > 100)
    edge = shapely.distance(shapely.points(found.xy), box(0, 0, 200, 200).boundary) < 10
    means = [found.radius_m[quarter == k].mean() for k in range(4)] + [found.radius_m[edge].mean()]
    assert np.ptp(means) < 0.45


def test_equal_discs_cover_what_random_sequential_adsorption_covers() -> None:
    side = 300.0
    found = sample(box(0, 0, side, side), variance=0.0)
    core = (np.abs(found.xy - side / 2) < side / 2 - 4 * MEAN).all(axis=1)  # the edge is denser
    coverage = core.sum() * np.pi * MEAN**2 / (side - 8 * MEAN) ** 2
    assert coverage == pytest.approx(0.547, abs=0.008)
    assert (found.radius_m == MEAN).all()


@pytest.mark.parametrize("stop", ["min", "mean"])
def test_redrawn_law_is_that_of_plain_darts(stop: str) -> None:
    area, runs, plants = COURTYARD, 400, 6
    law = fit_radius_law(MEAN, 0.35)
    limit = MEAN - float(law.width_m) if stop == "min" else MEAN
    rng = np.random.default_rng(5)
    slow = np.stack(
        [
            throw_darts(
                area, mean_m=MEAN, parent_sd_m=float(law.scale_m), width_m=float(law.width_m), plants=plants,
                rng=rng, stop_m=limit,
            )
            for _ in range(runs)
        ]
    )  # fmt: skip
    found = sample([area] * runs, radius_law="redrawn", radius_stop=stop)
    fast = np.stack([np.column_stack([xy[:plants], r[:plants]]) for xy, r in per_area(found, runs)])
    for rank, column in itertools.product((0, 3, 5), range(3)):
        assert ks_2samp(slow[:, rank, column], fast[:, rank, column]).pvalue > 0.001


@pytest.mark.parametrize("law", ["kept", "redrawn"])
def test_first_plant_is_uniform_in_the_area(law: str) -> None:
    area = box(0, 0, 30, 30).difference(box(10, 10, 20, 20))
    found = sample([area] * 1600, radius_law=law, radius_stop="mean", variance=0.0)
    first = found.xy[np.searchsorted(found.site, np.arange(1600))]
    square = (first // 10).astype(int)
    counts = np.bincount(square[:, 0] * 3 + square[:, 1], minlength=9)
    assert counts[4] == 0
    assert chisquare(np.delete(counts, 4)).pvalue > 0.001


def test_kept_pattern_is_as_even_as_that_of_darts() -> None:
    square = box(0, 0, 150, 150)
    kept, redrawn = sample(square, variance=0.1), sample(square, variance=0.1, radius_law="redrawn")
    nearest = []
    for found in (kept, redrawn):
        distance = np.hypot(*(found.xy[:, None] - found.xy[None]).T)
        np.fill_diagonal(distance, np.inf)
        nearest.append(distance.min(axis=0))
    assert np.median(nearest[0]) == pytest.approx(np.median(nearest[1]), rel=0.03)
    assert len(kept.site) == pytest.approx(len(redrawn.site), rel=0.04)


def test_a_lot_gets_the_same_plants_in_any_batch() -> None:
    stream = keys(len(LOTS))
    together = sample(LOTS, keys=stream)
    backward = sample(LOTS[::-1], keys=stream[::-1])
    for i, (xy, radius) in enumerate(per_area(together, len(LOTS))):
        alone = sample(LOTS[i], keys=stream[i : i + 1])
        other_xy, other_radius = per_area(backward, len(LOTS))[len(LOTS) - 1 - i]
        assert np.array_equal(alone.xy, xy)
        assert np.array_equal(alone.radius_m, radius)
        assert np.array_equal(other_xy, xy)
        assert np.array_equal(other_radius, radius)


def test_plants_move_with_their_lot() -> None:
    here, far = sample(LOTS), sample([translate(lot, 583_123.4567, 4_507_987.6543) for lot in LOTS])
    assert np.allclose(far.xy - (583_123.4567, 4_507_987.6543), here.xy, atol=1e-6)
    assert np.allclose(far.radius_m, here.radius_m, atol=1e-9)


def test_noise_of_reprojection_does_not_change_the_plants() -> None:
    rng = np.random.default_rng(0)

    def jitter(xy: NDArray[np.float64]) -> NDArray[np.float64]:
        noise = rng.uniform(-1e-7, 1e-7, xy.shape)
        _, first = np.unique(xy, axis=0, return_inverse=True)  # a ring's last vertex moves with its first
        return xy + noise[first.ravel()]

    noisy = [shapely.transform(lot, jitter) for lot in LOTS]
    exact, found = sample(LOTS), sample(noisy)
    assert np.allclose(found.xy, exact.xy, atol=1e-6)
    assert np.allclose(found.radius_m, exact.radius_m, atol=1e-6)


def test_order_of_rings_and_vertices_does_not_matter() -> None:
    def turned(ring: shapely.LinearRing, by: int) -> list[tuple[float, ...]]:
        corners = list(ring.coords)[:-1]
        corners = (corners[by:] + corners[:by])[::-1]
        return [*corners, corners[0]]

    def rewritten(polygon: Polygon) -> Polygon:
        return Polygon(turned(polygon.exterior, 2), [turned(ring, 1) for ring in polygon.interiors])

    parts = MultiPolygon([rewritten(part) for part in reversed(PARTS.geoms)])
    rewritten_lots = [rewritten(COURTYARD), rewritten(BENT), parts, rewritten(LOTS[3])]
    one, other = sample(LOTS), sample(rewritten_lots)
    assert np.allclose(one.xy, other.xy, atol=1e-9)
    assert np.allclose(one.radius_m, other.radius_m, atol=1e-9)


def test_plants_keep_off_discs_that_stand_already() -> None:
    fixed = np.array([[10.0, 10.0], [28.0, 12.0], [-4.0, 5.0], [500.0, 500.0]])
    radius = np.array([9.0, 2.0, 3.5, 1.0])
    lots = np.array([box(0, 0, 30, 25), box(0, 0, 30, 25)], dtype=object)
    found = sample(
        lots, fixed_xy=fixed, fixed_radius_m=radius, fixed_offsets=np.array([0, 4, 4]), keys=keys(1).repeat(2)
    )
    (xy, r), (free_xy, free_r) = per_area(found, 2)
    assert smallest_slack(np.vstack([xy, fixed]), np.concatenate([r, radius])) >= 0
    assert largest_gap(lots[0], np.vstack([xy, fixed]), np.concatenate([r, radius])) < MEAN
    assert len(free_xy) > len(xy)
    assert np.array_equal(free_r, sample(lots[1], keys=keys(1)).radius_m)


def test_a_lot_under_a_fixed_disc_is_empty() -> None:
    found = sample(
        box(0, 0, 5, 5),
        fixed_xy=np.array([[2.0, 2.0]]),
        fixed_radius_m=np.array([20.0]),
        fixed_offsets=np.array([0, 1]),
    )
    assert len(found.site) == 0
    assert found.state.tolist() == [SampleState.EMPTY]


@pytest.mark.parametrize("law", ["kept", "redrawn"])
def test_tiny_ground_gets_one_plant_and_no_ground_gets_none(law: str) -> None:
    areas = [
        box(0, 0, 0.05, 0.05),
        Polygon(),
        None,
        Point(0, 0),
        box(0, 0, 0.0005, 5),
        MultiPolygon(),
        box(0, 0, 4, 0.004),
    ]
    found = sample(areas, radius_law=law)
    assert found.site.tolist() == [0, 6]
    assert found.state.tolist() == [0, 1, 1, 1, 1, 1, 0]


def test_no_areas_give_no_plants() -> None:
    found = sample([], mean=np.zeros(0), variance=np.zeros(0))
    assert found.xy.shape == (0, 2)
    assert len(found.state) == 0


def test_polygons_of_a_collection_are_planted() -> None:
    mixed = GeometryCollection([Point(1, 1), box(0, 0, 2, 2), MultiPolygon([box(20, 0, 22, 2), box(40, 0, 42, 2)])])
    assert len(sample(mixed).site) == 3


def test_a_lot_over_the_limit_of_plants_is_refused_and_others_are_not() -> None:
    areas = np.array([box(0, 0, 100, 100), box(0, 0, 10, 10), box(0, 0, 20_000, 20_000)], dtype=object)
    found = sample(areas, max_plants=100)
    assert found.state.tolist() == [SampleState.REFUSED, SampleState.SATURATED, SampleState.REFUSED]
    assert set(found.site) == {1}
    exact = len(sample(areas[0], keys=keys(3)[:1]).site)
    assert sample(areas[0], keys=keys(3)[:1], max_plants=exact).state.tolist() == [SampleState.SATURATED]
    assert sample(areas[0], keys=keys(3)[:1], max_plants=exact - 1).state.tolist() == [SampleState.REFUSED]


def test_spikes_and_slivers_do_not_hold_plants_outside() -> None:
    spiked = Polygon([(0, 0), (20, 0), (20, 10), (60, 10), (20, 10 + 1e-9), (20, 20), (0, 20)])
    inward = Polygon([(0, 0), (20, 0), (20, 10), (5, 10), (20, 10 + 1e-9), (20, 20), (0, 20)])
    for area in (spiked, inward):
        found = sample(area)
        assert shapely.contains_xy(box(0, 0, 20, 20), found.xy[:, 0], found.xy[:, 1]).all()
        assert largest_gap(box(0, 0, 20, 20), found.xy, found.radius_m, edge_m=0.01) < MEAN


def test_rings_of_many_vertices_and_many_holes_are_right() -> None:
    angle = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    reach = 40 * (1 + 0.2 * np.sin(7 * angle) + 0.002 * np.random.default_rng(0).uniform(-1, 1, angle.size))
    ring = Polygon(reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    middles = np.stack(np.meshgrid(np.arange(2.0, 60, 4), np.arange(2.0, 60, 4)), axis=-1).reshape(-1, 2)
    holes = [shapely.get_coordinates(Point(xy).buffer(1.2, quad_segs=4).exterior) for xy in middles]
    sieve = Polygon(box(0, 0, 60, 60).exterior, holes)
    for area in (ring, sieve):
        found = sample(area)
        assert shapely.contains_xy(area, found.xy[:, 0], found.xy[:, 1]).all()
        assert smallest_slack(found.xy, found.radius_m) >= 0
        assert largest_gap(area, found.xy, found.radius_m, step_m=0.2) < MEAN


def test_law_has_the_moments_asked_for_and_is_uniform_where_they_cannot_be_had() -> None:
    law = fit_radius_law([3.13, 3.13, 1.0, 0.3, 5.0], [0.35, 2.0, 2.0, 1.0, 0.0])
    assert law.variance_m2[:2] == pytest.approx([0.35, 2.0], rel=1e-9)
    assert law.variance_m2[2:] == pytest.approx([0.25 / 3, 0.0, 0.0], rel=1e-4)
    assert law.width_m[1:] == pytest.approx([2.63, 0.5, 0.0, 0.0])
    for width, scale, variance in zip(law.width_m[:3], law.scale_m[:3], law.variance_m2[:3], strict=True):
        assert truncnorm(-width / scale, width / scale, scale=scale).var() == pytest.approx(variance, rel=1e-4)
    assert fit_radius_law(3.13, 0.5, sigma_is="sd").variance_m2 == pytest.approx(0.25)


def test_real_lots_are_saturated_without_overlap(real_data: object) -> None:
    import geopandas as gpd

    lots = gpd.read_file(f"{real_data}/nyc_astoria/astoria.gpkg").to_crs(32618).geometry.to_numpy()
    lots = shapely.make_valid(lots)
    cores = shapely.buffer(shapely.buffer(lots, -5.0), 2.0)
    areas = np.where(np.arange(len(lots)) % 2 == 0, lots, shapely.difference(lots, cores))[::20]
    found = sample(areas)
    for area, (xy, radius) in zip(areas, per_area(found, len(areas)), strict=True):
        if shapely.area(area) < 1e-4:
            continue
        assert len(xy) > 0
        assert smallest_slack(xy, radius) >= 0
        assert shapely.contains_xy(area, xy[:, 0], xy[:, 1]).all()
        assert largest_gap(area, xy, radius) < MEAN
    assert found.radius_m.mean() == pytest.approx(MEAN, rel=0.03)
