"""Shapes that differ by a known amount, and a slow twin of the voxels."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import shapely

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.habits import usual_growth, usual_sizes
from urbanforest_cli.core.skeleton import Skeletons, concatenate, select
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.growth.grove import Grove
from urbanforest_cli.growth.library import SCALE_LIMITS, placed, plan_library
from urbanforest_cli.growth.openness import openness_of
from urbanforest_cli.growth.shape_error import LEAF_REACH_M, VOXEL_M, filled_voxels, sample_plants, shape_errors
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site


def bush(seed=0, nodes=60, reach=3.0, height=6.0, shift=(0.0, 0.0, 0.0), identity=0):
    """A trunk of two metres and a cloud of branch ends above it."""
    rng = np.random.default_rng(seed)
    cloud = rng.uniform([-reach, -reach, 2.0], [reach, reach, height], (nodes, 3)) + shift
    xyz = np.vstack([[0, 0, 0], [0, 0, 1.0], [0, 0, 2.0], cloud]).astype(np.float32)
    parent = np.r_[-1, 0, 1, np.full(nodes, 2)].astype(np.int32)
    return Skeletons(
        skeleton_id=np.array([identity]),
        first=np.array([0, len(xyz)]),
        seasons=np.array([5], dtype=np.int32),
        tip_radius_m=np.array([0.006]),
        pipe_exponent=np.array([2.2]),
        parent=parent,
        xyz_m=xyz,
        order=np.r_[0, 0, 0, np.ones(nodes)].astype(np.uint8),
        birth_season=np.r_[0, 1, 2, np.full(nodes, 3)].astype(np.uint8),
        death_season=np.zeros(len(xyz), dtype=np.uint8),
    )


def moved(plant, **how):
    return Skeletons(**vars(plant) | {"xyz_m": placed(plant.xyz_m, **how).astype(np.float32)})


def compare(own, entry, yaw_deg=0.0, mirror=False, scale=1.0):
    how = {"yaw_deg": np.array([yaw_deg]), "mirror": np.array([mirror]), "scale": np.array([scale])}
    return shape_errors(own, entry, np.array([0]), **how)


def test_the_same_plant_has_no_error():
    errors = compare(bush(), bush())
    assert errors.overlap[0] == 1.0
    for name in ("height_error", "crown_radius_error", "crown_shift_m", "crown_volume_error"):
        assert getattr(errors, name)[0] == 0.0


def test_the_turn_that_makes_a_plant_has_no_error_and_none_has():
    how = {"yaw_deg": 90.0, "mirror": True, "scale": 1.0}
    own = moved(bush(), **how)
    errors = compare(own, bush(), **how)
    assert errors.overlap[0] > 0.98  # but for rounding at the faces of voxels
    assert errors.crown_radius_error[0] == pytest.approx(0.0, abs=1e-6)
    assert compare(own, bush()).overlap[0] < 0.6


def test_scale_shows_as_error_of_height_radius_and_volume():
    errors = compare(bush(), bush(), scale=1.25)
    assert errors.height_error[0] == pytest.approx(0.25, abs=1e-6)
    assert errors.crown_radius_error[0] == pytest.approx(0.25, abs=1e-6)
    assert errors.crown_volume_error[0] > 0.05
    assert errors.overlap[0] < 0.7


def test_a_crown_shifted_by_two_metres_is_two_metres_away():
    errors = compare(bush(), bush(shift=(2.0, 0.0, 0.0)))
    assert errors.crown_shift_m[0] == pytest.approx(2.0, abs=1e-9)
    far = compare(bush(), bush(shift=(50.0, 0.0, 0.0)))
    assert far.overlap[0] == 0.0


def test_lost_wood_and_bare_trunks_count_for_nothing():
    own, entry = bush(), bush()
    entry.death_season[-20:] = 4
    shorter = bush()
    keep = slice(0, len(shorter.parent) - 20)
    names = ("parent", "xyz_m", "order", "birth_season", "death_season")
    cut = Skeletons(
        **vars(shorter)
        | {name: getattr(shorter, name)[keep] for name in names}
        | {"first": np.array([0, len(shorter.parent) - 20])}
    )
    assert compare(own, entry).overlap[0] == compare(own, cut).overlap[0] < 1.0
    trunks = bush(nodes=1)
    whip = np.array([[0.0, 0.0, 1.0]])
    assert len(filled_voxels(trunks.xyz_m[3:])) < len(filled_voxels(np.vstack([trunks.xyz_m[3:], whip])))
    assert compare(trunks, trunks).overlap[0] == 1.0


def test_a_dead_plant_has_nothing_in_common_with_a_living_one():
    dead = bush()
    dead.death_season[:] = 4
    errors = compare(bush(), dead)
    assert errors.overlap[0] == 0.0
    assert errors.height_error[0] == -1.0
    assert np.isnan(errors.crown_shift_m[0])
    assert compare(dead, dead).overlap[0] == 1.0
    assert "crown_shift_m" not in errors.summary()


def test_voxels_agree_with_a_slow_twin():
    points = np.random.default_rng(4).uniform(-2.0, 2.0, (25, 3))
    filled = set()
    for cell in itertools.product(range(-6, 6), repeat=3):
        low = np.array(cell) * VOXEL_M
        gap = points - np.clip(points, low, low + VOXEL_M)
        if (np.linalg.norm(gap, axis=1) <= LEAF_REACH_M).any():
            filled.add(cell)
    codes = filled_voxels(points)
    cells = np.column_stack([codes >> 40, codes >> 20 & 0xFFFFF, codes & 0xFFFFF]) - (1 << 19)
    assert set(map(tuple, cells.tolist())) == filled


def test_seasons_are_those_asked_for():
    own = bush()
    how = {"yaw_deg": np.zeros(1), "mirror": np.zeros(1, bool), "scale": np.ones(1)}
    young = shape_errors(own, own, np.array([0]), **how, entry_season_end=np.array([2]))
    assert young.height_error[0] == pytest.approx(2.0 / own.xyz_m[:, 2].max() - 1.0)


def test_summary_takes_the_worse_tenth():
    own = concatenate([bush(seed, identity=seed) for seed in range(20)])
    how = {"yaw_deg": np.zeros(20), "mirror": np.zeros(20, bool), "scale": np.linspace(1.0, 1.2, 20)}
    summary = shape_errors(own, own, np.arange(20), **how).summary()
    assert summary["height_error"] == pytest.approx({"median": 0.1, "worst_tenth": 0.18}, abs=1e-6)
    assert summary["overlap"]["worst_tenth"] < summary["overlap"]["median"]


def test_a_sample_hangs_on_keys_alone_and_grows_without_change():
    keys = np.random.default_rng(0).integers(0, 2**63, 500).astype(np.uint64)
    order = np.random.default_rng(1).permutation(500)
    np.testing.assert_array_equal(keys[sample_plants(keys, 40)], keys[order][sample_plants(keys[order], 40)])
    np.testing.assert_array_equal(sample_plants(keys, 40), sample_plants(keys, 90)[:40])
    assert len(sample_plants(keys, 1000)) == 500


def test_entries_of_like_openness_are_nearer_in_shape_than_any_of_their_age():
    rng = np.random.default_rng(11)
    count = 240
    centres = rng.uniform(0.0, 260.0, (60, 2))
    xy = np.repeat(centres, 4, axis=0) + rng.uniform(-6.0, 6.0, (count, 2))
    corner = centres + rng.uniform(4.0, 8.0, (60, 2)) * rng.choice([-1.0, 1.0], (60, 2))
    houses = shapely.box(*corner.T, *(corner + rng.uniform(5.0, 12.0, (60, 2))).T)
    houses = houses[~shapely.intersects(houses, shapely.union_all(shapely.points(xy)).buffer(1.5))]
    plants = Plants(
        keys=rng.integers(0, 2**63, count).astype(np.uint64), xy_m=xy, species=np.zeros(count, dtype=np.int64),
        age_years=rng.uniform(18.0, 26.0, count), pruning_factor=np.ones(count),
    )  # fmt: skip
    sizes = [usual_sizes("tree", mature_height_m=18.0, mature_crown_diameter_m=11.0, clear_stem_m=2.0)]
    site = Site(plants, sizes, houses, np.full(len(houses), 12.0), light_from(50.0, 0.5), Growth())
    traits = traits_table([usual_growth("tree", 18.0)])
    grown = [grow_alone(site, row, traits) for row in range(count)]
    skeletons = concatenate([replace(plant, skeleton_id=np.array([row])) for row, plant in enumerate(grown)])
    columns = (openness_of(site), plants.species, plants.age_years, plants.pruning_factor, plants.keys)
    library = plan_library(*columns, size_max=40, open_grown=sizes)
    others = np.flatnonzero(~np.isin(np.arange(count), library.entry))
    own = select(skeletons, others)
    how = {name: getattr(library, name)[others] for name in ("yaw_deg", "mirror", "scale")}
    like = shape_errors(own, skeletons, library.entry[library.of_plant[others]], **how)
    any_entry = rng.choice(library.entry, len(others))
    scale = np.clip(
        sizes[0].height_at(plants.age_years[others]) / sizes[0].height_at(plants.age_years[any_entry]), *SCALE_LIMITS
    )
    still = {"yaw_deg": np.zeros(len(others)), "mirror": np.zeros(len(others), dtype=bool), "scale": scale}
    random = shape_errors(own, skeletons, any_entry, **still)
    assert like.overlap.mean() > random.overlap.mean() + 0.08
    assert np.nanmedian(like.crown_shift_m) < 0.8 * np.nanmedian(random.crown_shift_m)


def grow_alone(site, row, traits):
    rows, one, none = np.array([row]), site.plants, np.zeros(1)
    grove = Grove(
        keys=one.keys[rows], xy_m=one.xy_m[rows], species=one.species[rows], age_years=one.age_years[rows],
        pruning_factor=one.pruning_factor[rows], clearance_m=none, row_azimuth_rad=none,
    )  # fmt: skip
    return grow_grove(grove, site.around(rows), traits, site.growth).skeletons
