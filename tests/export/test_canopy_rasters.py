import re
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.canopy import press
from tests.reference.planted import planted_city
from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.export.scene import canopy
from urbanforest_cli.export.scene.canopy import canopy_rasters, leaf_reach_m


def turned(points, plant, city):
    """Twigs of a plant where they stand, one after the other."""
    plants = city.plants
    x, y, z = points.T * plants.scale[plant]
    y = -y if plants.mirror[plant] else y
    c, s = np.cos(plants.yaw_rad[plant]), np.sin(plants.yaw_rad[plant])
    return np.column_stack([c * x - s * y + plants.xy_m[plant, 0], s * x + c * y + plants.xy_m[plant, 1], z])


def all_twigs(city):
    """Places of all twigs and how far their leaves reach."""
    places, reach = [], []
    for plant in range(len(city.plants)):
        skeleton = city.skeletons_of(city.plants.skeleton_id[plant : plant + 1])
        there = (skeleton.death_season == 0) & (skeleton.parent >= 0)
        tip = skeleton.xyz_m[there].astype(float)
        middle = (tip + skeleton.xyz_m[skeleton.parent[there]]) / 2
        places.append(turned(np.concatenate([tip, middle]), plant, city))
        reach += [leaf_reach_m(city.species[city.plants.species[plant]])] * (2 * len(tip))
    return np.concatenate(places), np.array(reach)


def test_kernel_agrees_with_its_slow_twin():
    city = planted_city(9, size_m=12.0)
    found = canopy_rasters(city, cell_m=0.7)
    places, reach = all_twigs(city)
    places = np.column_stack([places[:, 0] - found.west_m, found.north_m - places[:, 1], places[:, 2]])
    rows, cols = found.top_m.shape
    top, count = press(places, reach, rows, cols, 0.7)
    assert count.max() > 40
    assert np.abs(found.top_m - top).max() <= 0.0051
    assert np.abs(found.cover_percent - count / 0.64).max() <= 0.51
    assert ((found.cover_percent > 0) == (count > 0)).all()


def test_a_tree_is_as_high_as_the_register_says():
    city = planted_city(1, 1)
    found = canopy_rasters(city, cell_m=0.5)
    assert found.top_m.max() == pytest.approx(city.plants.height_m[0], abs=0.0051)


def test_nothing_of_a_tree_is_lost_at_the_edges():
    for seed in range(5):
        city = planted_city(4, seed=seed)
        found = canopy_rasters(city, cell_m=1.0)
        edges = [found.cover_percent[side].max() for side in ((0,), (-1,), (slice(None), 0), (slice(None), -1))]
        assert max(edges) == 0
        assert found.west_m % 1.0 == 0
        assert found.north_m % 1.0 == 0


@pytest.mark.parametrize(("name", "value"), [("BAND_CELLS", 90), ("SHAPES_AT_ONCE", 1)])
def test_neither_bands_nor_batches_make_a_difference(name, value, monkeypatch):
    city = planted_city(20, 5)
    whole = canopy_rasters(city)
    monkeypatch.setattr(canopy, name, value)
    cut = canopy_rasters(city)
    assert (whole.top_m == cut.top_m).all()
    assert (whole.cover_percent == cut.cover_percent).all()


def test_heights_are_zero_where_nothing_covers_the_ground():
    found = canopy_rasters(planted_city(12))
    bare = found.cover_percent == 0
    assert bare.any()
    assert not bare.all()
    assert (found.top_m[bare] == 0).all()
    assert found.cover_percent.max() <= 100


def test_an_earlier_year_shows_the_smaller_plants_of_that_year():
    city = planted_city(3)
    now, before = canopy_rasters(city), canopy_rasters(replace(city, years_ago=6))
    assert 0 < before.top_m.max() < 0.7 * now.top_m.max()
    assert before.cover_percent.sum() < now.cover_percent.sum()


def test_a_city_without_plants_has_a_raster_of_nothing():
    city = planted_city(3)
    none = canopy_rasters(replace(city, plants=city.plants.take(np.zeros(0, np.int64))))
    assert none.top_m.shape == (1, 1)
    assert none.cover_percent.sum() == 0


def test_cells_too_small_for_the_city_are_refused_with_a_way_out():
    with pytest.raises(LimitError, match="too large") as told:
        canopy_rasters(planted_city(3, size_m=5000.0), cell_m=0.05)
    assert told.value.expected == "at most 200,000,000 cells"
    assert "larger cells" in told.value.next_step
    assert "--bbox" in told.value.next_step


def test_the_largest_raster_allowed_is_made(monkeypatch):
    city = planted_city(3)
    monkeypatch.setattr(canopy, "CELL_LIMIT", 1)
    with pytest.raises(LimitError) as told:
        canopy_rasters(city)
    rows, cols = map(int, re.findall(r"\d+", told.value.found)[:2])
    monkeypatch.setattr(canopy, "CELL_LIMIT", rows * cols - 1)
    with pytest.raises(LimitError):
        canopy_rasters(city)
    monkeypatch.setattr(canopy, "CELL_LIMIT", rows * cols)
    assert canopy_rasters(city).top_m.base.shape == (rows, cols)


def test_a_raster_takes_few_bytes_a_cell(monkeypatch):
    city = planted_city(8, 2, size_m=300.0)
    canopy_rasters(city)
    monkeypatch.setattr(canopy, "BAND_CELLS", 300_000)
    tracemalloc.start()
    try:
        found = canopy_rasters(city, cell_m=0.2)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    cells = found.top_m.base.size  # before bare edges were taken off
    assert cells > 1_000_000
    assert 5 * cells < peak < 8 * cells
