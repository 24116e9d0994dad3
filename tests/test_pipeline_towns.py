"""Lots that pairs are made on: each once, each town with chance of its own, and nothing left out in silence."""

from __future__ import annotations

import shutil

import geopandas as gpd
import numpy as np
import pytest
import shapely

from urbanforest_cli import pipeline_towns
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.pipeline_pairs import make_pairs
from urbanforest_cli.pipeline_towns import towns_of

WEST, SOUTH = 500_000.0, 4_000_000.0


@pytest.fixture(autouse=True)
def _few_lots(monkeypatch):
    monkeypatch.setattr(pipeline_towns, "SYNTHETIC_LOTS", 40)
    monkeypatch.setattr(pipeline_towns, "PLAIN_LOTS", 20)


def boxes(east=0.0, sizes=((28, 38),) * 24):
    place = np.arange(len(sizes))
    x, y = WEST + east + 700 * (place % 6), SOUTH + 50 * (place // 6)
    width, height = np.array(sizes, dtype=float).T
    return gpd.GeoDataFrame(geometry=shapely.box(x, y, x + width, y + height), crs="EPSG:32611")


def stored(path, lots, layer="lots"):
    path.parent.mkdir(exist_ok=True)
    lots.to_file(path, layer=layer, driver="GPKG", mode="a" if path.exists() else "w")
    return path


def real_towns(*sources, notices=None):
    towns = towns_of(sources, 1, Notices() if notices is None else notices)[2:]
    assert [town.first for town in towns] == np.cumsum([60, *(len(town.lots) for town in towns)])[:-1].tolist()
    return towns


def test_a_layer_named_twice_is_refused_by_whatever_path(tmp_path, monkeypatch):
    path = stored(tmp_path / "lots.gpkg", boxes())
    (tmp_path / "link.gpkg").symlink_to(path)
    monkeypatch.chdir(tmp_path)
    for other in ("lots.gpkg", "./lots.gpkg", "link.gpkg"):
        with pytest.raises(InputError, match="twice"):
            real_towns(path, other)
    with pytest.raises(InputError, match="twice"):
        real_towns(path, "lots.gpkg:lots")
    with pytest.raises(InputError, match="twice"):
        real_towns(path, shutil.copy(path, tmp_path / "copy.gpkg"))


@pytest.mark.parametrize("crs", ["EPSG:32611", "EPSG:4326", "EPSG:2229", "EPSG:32612"])
def test_lots_that_a_file_before_holds_are_left_out_and_counted(tmp_path, crs):
    first = stored(tmp_path / "a.gpkg", boxes())
    more = gpd.GeoDataFrame(geometry=[*boxes().geometry[:10], *boxes(east=300).geometry[:5]], crs="EPSG:32611")
    notices = Notices()
    one, two = real_towns(first, stored(tmp_path / "b.gpkg", more.to_crs(crs)), notices=notices)
    assert (len(one.lots), len(two.lots)) == (24, 5)
    assert notices.count("W_PAIRS_REPEATED") == 10


def test_a_lot_that_a_file_holds_twice_is_taken_once_and_a_lot_inside_a_lot_stays(tmp_path):
    lots = boxes()
    inner = lots.geometry.iloc[:1].scale(0.8, 0.8)
    twice = gpd.GeoDataFrame(geometry=[*lots.geometry, *lots.geometry[:7], *lots.geometry[:2], *inner], crs=lots.crs)
    notices = Notices()
    (town,) = real_towns(stored(tmp_path / "a.gpkg", twice), notices=notices)
    assert len(town.lots) == 25
    assert notices.count("W_PAIRS_REPEATED") == 9


def test_files_and_layers_of_one_name_have_chance_of_their_own(tmp_path):
    one, two = (stored(tmp_path / name / "register.gpkg", boxes(east)) for name, east in (("x", 0), ("y", 100)))
    stored(one, boxes(200), "parcels")
    pairs = make_pairs(132, lots=[f"{one}:lots", two, f"{one}:parcels"], seed=2)
    real = pairs.take(np.flatnonzero(pairs.lot >= 60))
    assert len(real) == 72
    by_town = real.values[np.argsort(real.lot)].reshape(3, 24, 6)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert (by_town[a, :, 0] != by_town[b, :, 0]).all()


def test_lots_left_out_are_counted_and_a_missing_zone_or_id_is_none_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline_towns, "REAL_LOTS_MOST", 6)
    sizes = [(28, 38)] * 10 + [(5, 5)] * 3 + [(510, 30)] * 2
    path = stored(tmp_path / "a.gpkg", boxes(sizes=sizes))
    notices = Notices()
    (town,) = real_towns(path, notices=notices)
    assert len(town.lots) == 6
    told = {notice.code: (notice.count, notice.examples) for notice in notices}
    assert told == {
        "W_PAIRS_SMALL": (3, [str(path)]),
        "W_PAIRS_LONG": (2, [str(path)]),
        "W_PAIRS_MANY": (4, [str(path)]),
    }
