import numpy as np
import pytest
import shapely

from urbanforest_cli.register import packed as module
from urbanforest_cli.register.packed import PackedShapes, give_back, packed
from urbanforest_cli.register.tables import OnDemand


def discs(count):
    rng = np.random.default_rng(3)
    shapes = shapely.buffer(shapely.points(rng.uniform(4e5, 5e5, (count, 2))), rng.uniform(1, 9, count))
    shapes[::5] = shapely.multipolygons([[shape, shapely.box(0, 0, 1, 1 / 3)] for shape in shapes[::5]])
    shapes[1::7] = None
    return shapes


def test_shapes_come_back_to_the_last_bit_in_any_order(monkeypatch):
    monkeypatch.setattr(module, "AT_A_TIME", 4)
    shapes = discs(40)
    kept = packed(shapes)
    rows = np.random.default_rng(1).permutation(40)[:23]
    assert (shapely.to_wkb(kept.get(rows)) == shapely.to_wkb(shapes[rows])).all()
    assert (kept.missing == shapely.is_missing(shapes)).all()
    assert (kept.area_m2 == np.nan_to_num(shapely.area(shapes))).all()
    assert (kept.part_count == np.where(kept.missing, 0, shapely.get_num_geometries(shapes))).all()
    assert len(kept) == 40


def test_what_is_put_later_holds_and_what_is_dropped_is_gone():
    shapes = discs(10)
    kept = packed(shapes)
    kept.put(np.array([2, 3, 5]), np.array([shapes[0], None, shapes[4]], dtype=object))
    kept.drop(np.array([6]))
    found = kept.get(np.arange(10))
    assert [found[2], found[3], found[5], found[6], found[9]] == [shapes[0], None, shapes[4], None, shapes[9]]
    assert kept.area_m2[3] == kept.area_m2[6] == kept.part_count[6] == 0
    assert kept.area_m2[2] == pytest.approx(shapes[0].area)


def test_nothing_and_no_rows_are_shapes_too():
    kept = PackedShapes(3)
    kept.put(np.empty(0, dtype=np.int64), np.empty(0, dtype=object))
    assert kept.missing.all()
    assert kept.get(np.arange(3)).tolist() == [None] * 3
    assert len(kept.get(np.empty(0, dtype=np.int64))) == 0


def test_memory_is_given_back_where_the_library_can_and_elsewhere_nothing_happens(monkeypatch):
    give_back()
    monkeypatch.setattr(module.sys, "platform", "plan9")
    monkeypatch.setattr(module.ctypes, "CDLL", lambda name: pytest.fail("asked for a library that is not there"))
    give_back()


def test_layers_on_demand_are_made_when_asked_for():
    made = []
    layers = OnDemand({name: lambda name=name: made.append(name) or name for name in ("lots", "regions")})
    assert (list(layers), len(layers), made) == (["lots", "regions"], 2, [])
    assert layers["regions"] == "regions"
    assert made == ["regions"]
