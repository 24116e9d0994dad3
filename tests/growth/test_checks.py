"""A sceptic's checks of growth, each with its ablation: the mechanism switched off, the same check fails."""

import hashlib
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache

import numpy as np
import pandas as pd
import pytest
import shapely
from shapely import affinity

from benchmarks.open_grown import grow_open
from tests.growth.scenes import LIME, MAPLE, OAK, PRIVET, points, scene, shipped, traits
from tests.reference.growth import SlowGrove
from urbanforest_cli.core.config import Growth, Species
from urbanforest_cli.core.skeleton import measure, radius_m, select, standing
from urbanforest_cli.files.skeletons import write_part
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth import season_kernel, simulate
from urbanforest_cli.growth.grove import GROWN
from urbanforest_cli.growth.light_kernel import CANOPY_M
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import BUD_SUN_SHARE, light_from

EAST, NORTH = 400_000.0, 5_500_000.0
SEEDS = range(8)
AGE = 30.0
SHADOW = Growth(environment="shadow")
NO_TROPISM = {"phototropism": 0.0, "room_attraction": 0.0}
NO_LIGHT = {"leaf_shade": 1e-9}
NO_BUDGET = {"vigour": 1e6, "vigour_max": 1e9}


def whole_sky(around):
    return around._replace(sky=np.full((1, 1, 1), 255, np.uint8))


# radii


@pytest.fixture(scope="module")
def old_pair():
    """A pruned lime and an unpruned maple with much wood lost."""
    grown = scene([(0, 0), (6, 0)], species=[LIME, MAPLE], age=[28, 33], gamma=[0.7, 1.0]).grow()
    assert (grown.shed + grown.pruned > 50).all()
    return grown


def worst_fork(table, pipes):
    """Return the largest relative error of r^n = sum of the children's r^n at forks, from a file's columns alone."""
    radius = table["tip_radius_m"] * pipes ** (1 / table["pipe_exponent"])
    power = radius ** table["pipe_exponent"]
    parent = table["node"] - table["parent_back"]
    born = power[parent >= 0].groupby([table["skeleton_id"], parent]).agg(["sum", "size"])
    own = pd.Series(power.to_numpy(), pd.MultiIndex.from_frame(table[["skeleton_id", "node"]]))
    forks = born[born["size"] > 1]
    own = own.loc[forks.index].to_numpy()
    error = np.abs(own - forks["sum"].to_numpy()) / np.maximum(own, power[power > 0].min())
    return error.max(), len(forks)


def test_radii_of_a_file_obey_da_vinci_at_every_fork(old_pair, tmp_path):
    path = tmp_path / "part.parquet"
    write_part(path, [old_pair.skeletons], {})
    table = pd.read_parquet(path)
    assert table["pipe_exponent"].between(2, 3).all()
    error, forks = worst_fork(table, table["pipes"])
    assert forks > 500
    assert error < 1e-4
    forgetful = table["pipes"].where(table["death_season"] == 0, 0)  # ablation: lost wood not remembered
    assert worst_fork(table, forgetful)[0] > 0.1


def test_no_radius_ever_falls(old_pair):
    skeletons = old_pair.skeletons
    forgotten = 0
    before, before_forgetful = np.zeros(len(skeletons.parent)), np.zeros(len(skeletons.parent))
    for season in range(1, 34):
        end = np.minimum(season, skeletons.seasons)
        now = radius_m(skeletons, end)
        assert (now >= before).all()
        there = standing(skeletons, end)
        forgetful = np.zeros(len(there))
        root = np.repeat(skeletons.first[:-1], skeletons.node_counts())
        for node in np.flatnonzero(there)[::-1]:
            forgetful[node] = max(forgetful[node], 1)
            if skeletons.parent[node] >= 0:
                forgetful[root[node] + skeletons.parent[node]] += forgetful[node]
        forgotten += (there & (forgetful < before_forgetful)).sum()
        before, before_forgetful = now, forgetful
    assert forgotten > 50  # ablation: without memory many would


# walls


def wall(side: str, away_m: float):
    west, south, east, north = {
        "east": (away_m, -20, away_m + 12, 20), "west": (-away_m - 12, -20, -away_m, 20),
        "north": (-20, away_m, 20, away_m + 12), "south": (-20, -away_m - 12, 20, -away_m),
    }[side]  # fmt: skip
    return shapely.box(EAST + west, NORTH + south, EAST + east, NORTH + north)


@cache
def by_a_wall(side, away_m, ablation="", species=MAPLE, latitude=50.0):
    """Grow one tree a seed beside a wall; return offsets east and north in crown radii, internodes (seeds, 3)."""
    config = SHADOW if ablation == "blocks only" else Growth()
    table = traits(**NO_TROPISM) if ablation in ("blocks only", "no tropism, whole sky") else traits()
    rows = []
    for seed in SEEDS:
        place = scene([(0, 0)], species=species, age=AGE, seed=seed, config=config, latitude_deg=latitude)
        place = place.but(buildings=(wall(side, away_m),) if side else ())
        around = place.around()
        if ablation:
            around = whole_sky(around)
        grown = grow_grove(place.grove(), around, table, config)
        assert grown.outcome[0] == GROWN
        crown = points(grown, 0)
        rows.append((*crown[:, :2].mean(axis=0) / measure(grown.skeletons)["crown_radius_m"][0], grown.retained[0]))
    return np.mean(rows, axis=0)


def test_crowns_grow_away_from_a_wall_the_more_the_nearer_it_is():
    near, middle, far = (-by_a_wall("east", away)[0] for away in (2, 3, 5))
    alone = by_a_wall("", 0)[0]
    assert np.hypot(*by_a_wall("", 0)[:2]) < 0.12
    assert near >= 0.3
    assert middle >= 0.15
    assert near > middle > far > abs(alone)
    # ablation: a wall that only stops what runs into it, neither shading nor sought to be left
    assert -by_a_wall("east", 2, "no tropism, whole sky")[0] < 0.3
    assert -by_a_wall("east", 5, "blocks only")[0] < 0.12


def test_a_wall_in_the_south_takes_more_than_one_in_the_north():
    north, south = by_a_wall("north", 2, species=OAK)[2], by_a_wall("south", 2, species=OAK)[2]
    assert south < 0.95 * north
    mirrored = (
        by_a_wall("north", 2, species=OAK, latitude=-50.0)[2] / by_a_wall("south", 2, species=OAK, latitude=-50.0)[2]
    )
    assert mirrored < 0.95
    # ablation: without the field of open sky it matters little where a wall stands
    blind = by_a_wall("south", 2, "whole sky", species=OAK)[2] / by_a_wall("north", 2, "whole sky", species=OAK)[2]
    assert blind > 0.95
    assert south / north < blind - 0.04


@cache
def lean(species, age, kinds=traits, *, buds_seek="blue light"):
    """Return how far open-grown crowns lean on the mean, in mean crown radii, east and north."""
    offsets, radii = [], []
    for seed in range(12):
        place = scene([(0, 0)], species=species, age=age, seed=seed)
        around = place.around()
        if buds_seek == "all light":
            around = around._replace(ray_light=light_from(50.0, place.config.sun_share / BUD_SUN_SHARE).ray_light)
        grown = grow_grove(place.grove(), around, kinds(), place.config)
        offsets.append(points(grown, 0)[:, :2].mean(axis=0))
        radii.append(measure(grown.skeletons)["crown_radius_m"][0])
    return np.mean(offsets, axis=0) / np.mean(radii)


@pytest.mark.parametrize("species", [LIME, MAPLE, OAK])
def test_crowns_in_the_open_lean_little(species):
    own = lean(species, AGE)
    assert np.hypot(*own) < 0.12
    assert -0.12 < own[1] < -0.03  # toward the sun
    assert lean(species, AGE, buds_seek="all light")[1] < own[1] - 0.02  # ablation: buds drawn to the sun as to the sky


@pytest.mark.slow
@pytest.mark.parametrize("species", [LIME, MAPLE, OAK])
@pytest.mark.parametrize("age", [15.0, 30.0, 50.0])
def test_crowns_of_shipped_species_lean_little(species, age):
    assert np.hypot(*lean(species, age, shipped)) < 0.15


@pytest.mark.parametrize("species", [LIME, OAK])
def test_no_internode_is_inside_a_building(species):
    inside = without = 0
    for seed, turn in enumerate((0, 17, 30, 45)):
        house = affinity.rotate(wall("east", 2), turn, origin=(EAST, NORTH))
        low = affinity.rotate(shapely.box(EAST - 9, NORTH - 3, EAST - 4, NORTH + 4), turn, origin=(EAST, NORTH))
        for buildings in ((house, low), ()):
            place = scene([(0, 0), (-0.5, -7)], species=species, age=AGE, seed=seed, buildings=buildings, height_m=9.0)
            grown = place.grow()
            skeletons = grown.skeletons
            root = np.repeat(skeletons.first[:-1], skeletons.node_counts())
            upper = skeletons.xyz_m + np.repeat(np.column_stack([place.xy_m, [0, 0]]), skeletons.node_counts(), axis=0)
            lower = upper[root + np.maximum(skeletons.parent, 0)]
            found = 0
            for part in (0.25, 0.5, 0.75, 1.0):
                spot = lower + part * (upper - lower)
                in_plan = shapely.contains_xy(house, *spot[:, :2].T) | shapely.contains_xy(low, *spot[:, :2].T)
                found += (in_plan & (spot[:, 2] < 9.0)).sum()
            inside, without = (inside + found, without) if buildings else (inside, without + found)
    assert inside == 0
    assert without > 1000  # ablation: they would be


# neighbours


def voxels(crown, edge_m=0.5):
    return set(map(tuple, np.floor(crown / edge_m).astype(int)))


@cache
def pair(distance_m, species, ablation=""):
    """Return shared voxels joint over those of solo trees overlaid, and how far crowns move apart, in metres."""
    config = SHADOW if ablation == "blind" else Growth()
    table = traits(**NO_LIGHT) if ablation == "blind" else traits()
    together = alone = 0
    moved = []
    for seed in range(3):
        place = scene([(0, 0), (distance_m, 0)], species=species, age=AGE, seed=seed, config=config)
        unseen = place.but(config=config.model_copy(update={"neighbours": False}))
        to_world = [np.append(xy - (EAST, NORTH), 0) for xy in place.xy_m]
        grown = place.grow(table=table)
        joint = [points(grown, k) + to_world[k] for k in (0, 1)]
        if ablation == "other groves":
            joint = [points(place.grow([k], table=table), 0) + to_world[k] for k in (0, 1)]
        if ablation == "other groves unseen":
            joint = [points(unseen.grow([k], table=table), 0) + to_world[k] for k in (0, 1)]
        solo = [points(unseen.grow([k], table=table), 0) + to_world[k] for k in (0, 1)]
        together += len(voxels(joint[0]) & voxels(joint[1]))
        alone += len(voxels(solo[0]) & voxels(solo[1]))
        for k, sign in ((0, -1), (1, 1)):
            moved.append(sign * (joint[k][:, 0].mean() - solo[k][:, 0].mean()))
    return together / alone, float(np.mean(moved))


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_crowns_of_neighbours_keep_apart(species):
    ratios, moves = zip(*(pair(distance, species) for distance in (4.0, 6.0, 9.0)), strict=True)
    assert max(ratios) < 0.15
    assert moves[0] > moves[1] > moves[2] > 0
    blind_ratio, blind_move = pair(4.0, species, "blind")  # ablation: neither light nor room is sensed
    assert blind_ratio > 0.5
    assert abs(blind_move) < 0.1


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_crowns_of_neighbours_in_other_groves_keep_apart_too(species):
    ratio, move = pair(5.0, species, "other groves")
    assert ratio < 0.15
    assert move > 0.3
    assert pair(5.0, species, "other groves unseen") == (1.0, 0.0)


def twigs(grown, plant):
    """Return (n, 3) ends of the living twigs of a plant, relative to it."""
    one = select(grown.skeletons, [plant])
    ends = standing(one, one.seasons)
    ends[0] = False
    ends[one.parent[np.flatnonzero(ends & (one.parent >= 0))]] = False
    return one.xyz_m[ends].astype(float)


@contextmanager
def light_of(canopy):
    """Let the seasons run in the interpreter, which calls the compiled rules, with another rule for deep shade."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(season_kernel, "canopy_light", canopy)
        patch.setattr(simulate, "grow_seasons", season_kernel.grow_seasons.py_func)
        yield


def all_light(nodes, live_count, plants, grids, *neighbours):
    return np.ones(tuple(int(side / CANOPY_M) + 1 for side in grids.size[::-1]))


@cache
def stand(spacing_m, species, ablation="", kinds=traits):
    """Return the height below which a tenth of the middle tree's twigs end, and its crown radius, of 9 trees."""
    rows = []
    for seed in range(4):
        cells = [(i, j) for i in (0, 1, -1) for j in (0, 1, -1)]
        place = scene([(i * spacing_m, j * spacing_m) for i, j in cells], species=species, age=AGE, seed=seed)
        with light_of(all_light if ablation == "no deep shade" else season_kernel.canopy_light):
            grown = grow_grove(place.grove(), place.around(), kinds(), Growth())
        rows.append((np.percentile(twigs(grown, 0)[:, 2], 10), measure(grown.skeletons)["crown_radius_m"][0]))
    return np.mean(rows, axis=0)


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_crowns_narrow_in_a_stand(species):
    radius = [stand(spacing, species)[1] for spacing in (12.0, 8.0, 3.0)]
    assert radius[0] > radius[1] > radius[2]
    assert radius[2] < 0.75 * radius[0]


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_crowns_rise_in_a_stand(species):
    base = [stand(spacing, species)[0] for spacing in (12.0, 6.0, 4.0)]
    assert base[2] > 1.25 * base[0]
    assert base[1] > 1.1 * base[0]
    bright = [stand(spacing, species, "no deep shade")[0] for spacing in (12.0, 4.0)]  # ablation: low branches live on
    assert bright[1] < 1.2 * bright[0]
    assert bright[1] / bright[0] < base[2] / base[0] - 0.2


@pytest.mark.slow
@pytest.mark.parametrize("species", [LIME, MAPLE, OAK])
def test_crowns_of_shipped_species_rise_in_a_stand(species):
    base = [stand(spacing, species, kinds=shipped)[0] for spacing in (12.0, 4.0)]
    assert base[1] > 1.1 * base[0]


# pruning

CUT = 25


def pruned_and_not(species, gamma, config, seed):
    """Grow a plant pruned and unpruned in the same surroundings; return both and the cut's volume as middle, half."""
    place = scene([(0, 0)], species=species, age=AGE, seed=seed, gamma=gamma, config=config)
    around = place.around()
    cut = grow_grove(place.grove(), around, traits(), config)
    free = grow_grove(place.but(pruning_factor=np.ones(1)).grove(), around, traits(), config)
    tree = free.skeletons
    lived = (tree.birth_season <= CUT) & ((tree.death_season == 0) | (tree.death_season > CUT))
    bore = (tree.birth_season < CUT) & ((tree.death_season == 0) | (tree.death_season >= CUT)) & (tree.parent >= 0)
    lived[tree.parent[bore]] = False
    ends = tree.xyz_m[lived].astype(float)
    low, high = ends.min(axis=0), ends.max(axis=0)
    low[:2], high[:2] = np.minimum(low[:2], 0) * gamma, np.maximum(high[:2], 0) * gamma
    high[2] = low[2] + gamma * (high[2] - low[2])
    return cut, free, (low + high) / 2, (high - low) / 2


def depth(crown, middle, half):
    """Return how far out points lie in a box, 1 on its walls; what is under it counts by its plan."""
    off = (crown - middle) / half
    off[:, 2] = np.maximum(off[:, 2], 0)
    return np.abs(off).max(axis=1)


def new_share(grown):
    there = standing(grown.skeletons)
    there[0] = False
    return (grown.skeletons.birth_season[there] > CUT).mean()


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_a_cut_leaves_nothing_outside_its_volume_and_much_grows_again(species):
    share, shell = [], []
    for seed in range(3):
        cut, free, middle, half = pruned_and_not(species, 0.7, Growth(regrow_years=5), seed)
        right_after = depth(points(cut, 0, season=CUT), middle, half)
        assert len(right_after) > 100
        assert right_after.max() <= 1.0005
        assert depth(points(free, 0, season=CUT), middle, half).max() > 1.3  # ablation: the uncut plant reaches out
        assert cut.pruned[0] > 200
        share.append((new_share(cut), new_share(free)))
        outer = [depth(points(grown, 0), middle, half) for grown in (cut, free)]
        shell.append([((rim > 0.8) & (rim <= 1)).sum() for rim in outer])
        assert np.percentile(outer[0], 99) < 1.8  # how far shoots of five years reach over
    share, shell = np.mean(share, axis=0), np.mean(shell, axis=0)
    assert share[0] >= 1.5 * share[1]
    assert shell[0] > shell[1]


def test_a_pruning_factor_of_one_changes_no_bit():
    for regrow_years in (0, 5, 12):
        config = Growth(regrow_years=regrow_years)
        one = scene([(0, 0), (4, 1)], age=[18, 16], species=[LIME, PRIVET], config=config).grow()
        never = scene([(0, 0), (4, 1)], age=[18, 16], species=[LIME, PRIVET]).grow()
        assert print_of(one.skeletons) == print_of(never.skeletons)
        assert one.pruned.sum() == 0


class NothingReleased(SlowGrove):
    """Pruning without the two rules that let a plant grow again."""

    def release_markers(self):
        pass

    def wake_reserves(self, cut):
        pass


def test_nothing_grows_again_where_a_cut_frees_no_room():
    config = Growth(regrow_years=5)
    place = scene([(0, 0)], species=MAPLE, age=15.0, gamma=0.5, config=config)
    grown = []
    for model in (SlowGrove, NothingReleased):
        plant = model(place.grove(), place.around(), traits(), config).grow()[0]
        grown.append(sum(node.birth > 10 for node in plant.nodes))
    assert len(points(place.grow(), 0)) > 0
    assert grown[1] < 0.67 * grown[0]


# determinism and accounts


def print_of(skeletons):
    digest = hashlib.sha256()
    for name in ("first", "parent", "xyz_m", "order", "birth_season", "death_season"):
        digest.update(np.ascontiguousarray(getattr(skeletons, name)).tobytes())
    return digest.hexdigest()


def small_city(seed=0):
    """Make nine plants in three groves, one of them far off, and a house."""
    xy = [(0, 0), (5, 1), (2, 6), (9, 9), (12, 2), (15, 7), (200, 0), (204, 2), (201, 5)]
    return scene(
        xy, species=[LIME, MAPLE, OAK, PRIVET, LIME, MAPLE, OAK, LIME, PRIVET], age=[20, 17, 14, 8, 11, 18, 16, 12, 6],
        gamma=[1, 0.7, 1, 0.6, 1, 1, 1, 0.8, 1], clearance=2.0, seed=seed,
        buildings=(shapely.box(EAST + 7, NORTH + 2, EAST + 10, NORTH + 6),),
    )  # fmt: skip


GROVES = ([0, 1, 2], [3, 4, 5], [6, 7, 8])


def prints(city, groves=GROVES):
    return [print_of(city.grow(rows).skeletons) for rows in groves]


def city_print():
    """Return the digest of the small city; a fresh process calls it."""
    return " ".join(prints(small_city()))


def test_threads_repeats_and_the_order_of_plants_change_no_bit():
    city = small_city()
    once = prints(city)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda rows: print_of(city.grow(rows).skeletons), GROVES)) == once
    assert prints(city, GROVES[::-1])[::-1] == once
    whole = city.grow(range(6))
    turned = [4, 2, 0, 5, 1, 3]
    other = city.grow(turned)
    for place, row in enumerate(turned):
        assert (points(other, place) == points(whole, row)).all()
    again = city.grow(range(6))
    assert print_of(again.skeletons) == print_of(whole.skeletons)


@pytest.mark.slow
def test_another_process_grows_the_same_bits():
    code = "from tests.growth.test_checks import city_print; print(city_print())"
    found = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(2)]
    assert {run.stdout.strip() for run in found} == {city_print()}


def test_another_seed_of_one_plant_changes_its_own_grove_alone():
    city = small_city()
    keys = city.keys.copy()
    keys[1] += np.uint64(1)
    before, after = prints(city), prints(city.but(keys=keys))
    assert [a == b for a, b in zip(before, after, strict=True)] == [False, True, True]


def test_internodes_and_markers_are_all_accounted_for():
    city = small_city()
    for rows in GROVES:
        grown = city.grow(rows)
        tree = grown.skeletons
        assert (grown.generated == grown.retained + grown.shed + grown.pruned).all()
        assert grown.generated.sum() == len(tree.parent) - len(rows)
        owner = np.repeat(np.arange(len(rows)), tree.node_counts())
        alive = (tree.death_season == 0) & (tree.parent >= 0)
        assert np.bincount(owner[alive], minlength=len(rows)).tolist() == grown.retained.tolist()
        markers = grown.markers
        assert markers["alive"] + markers["taken"] + markers["blocked"] == markers["total"]
        assert markers["taken"] > 0
        assert np.isfinite(tree.xyz_m).all()
        assert (grown.outcome == GROWN).all()
        # the log of the grove's seasons says the same, plant by plant and season by season
        late = grown.season_log.shape[0] - tree.seasons
        for plant in range(len(rows)):
            mine = owner == plant
            born = np.bincount(tree.birth_season[mine & (tree.parent >= 0)], minlength=tree.seasons[plant] + 1)[1:]
            lost = np.bincount(tree.death_season[mine & (tree.death_season > 0)], minlength=tree.seasons[plant] + 1)[1:]
            assert grown.season_log[late[plant] :, plant, 2].tolist() == born.tolist()
            assert grown.season_log[late[plant] :, plant, 3].tolist() == lost.tolist()


@pytest.mark.parametrize("species", [LIME, MAPLE, OAK])
def test_every_tree_in_the_open_lives(species):
    """Some lose their leading bud while small: that takes no tree's life."""
    for death in (0.003, 0.3):
        for seed in range(12):
            grown = scene([(0, 0)], species=species, age=14.0, seed=seed).grow(table=traits(apical_bud_death=death))
            assert grown.outcome[0] == GROWN
            assert measure(grown.skeletons)["height_m"][0] > 1.5
            assert grown.retained[0] > 20


@pytest.mark.slow
def test_no_tree_in_the_open_is_stripped_to_a_stump():
    trees = [kind for kind in load_catalogue(Species()) if kind.habit == "tree"]
    assert len(trees) == 6
    for kind in trees:
        grown = grow_open(kind.id, kind.growth, kind.open_grown, count=40, age=25)
        count = measure(grown)["internode_count"]
        assert count.min() > 0.2 * np.median(count), kind.id


def new_a_season(table, age):
    place = scene([(0, 0)], species=LIME, age=age)
    return place.grow(table=table).season_log[:, 0, 2]


def test_new_internodes_become_fewer_as_the_volume_fills():
    log = new_a_season(traits(), 25.0)
    assert log[-3:].mean() < 0.8 * log.max()
    free = new_a_season(traits(**NO_BUDGET, **NO_LIGHT, shoot_aging=1.0), 9.0)  # ablation: no limit but room
    assert free[-1] == free.max()


# apical control


@cache
def height(share, species, ablation=""):
    """Return the height of young trees with one share of the axis throughout."""
    table = traits(apical_control_young=share, apical_control_old=share, **(NO_BUDGET if ablation else {}))
    grown = [scene([(0, 0)], species=species, age=20.0, seed=seed).grow(table=table) for seed in range(4)]
    return np.mean([measure(tree.skeletons)["height_m"][0] for tree in grown])


@pytest.mark.parametrize("species", [LIME, MAPLE])
def test_apical_control_makes_trees_tall(species):
    heights = [height(share, species) for share in (0.46, 0.5, 0.54)]
    assert heights[0] < heights[1] < heights[2]
    assert heights[0] < 0.9 * heights[2]
    # ablation: where every bud has vigour enough, sharing it out means nothing
    assert height(0.46, species, "no budget") == pytest.approx(height(0.54, species, "no budget"), rel=1e-6)
