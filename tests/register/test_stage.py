import json
import os
import sqlite3
from contextlib import closing

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box

from tests.register.conftest import write_layer
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import CrsError, InputError, LimitError, OutputExistsError, PartlyDoneError
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.files.geopackage import layer_names
from urbanforest_cli.files.provenance import require_record
from urbanforest_cli.register.stage import stencil_city, stencil_key

WEST, SOUTH = 500_000.0, 5_300_000.0


def lot(i=0, j=0, size=60.0):
    return box(WEST + size * i, SOUTH + size * j, WEST + size * (i + 1), SOUTH + size * (j + 1))


def house(i=0, j=0):
    x, y, _, _ = lot(i, j).bounds
    return box(x + 25, y + 25, x + 35, y + 35)


# what comes out


def test_every_lot_is_a_row_of_lots_and_of_parameters_and_in_active_areas_or_skipped(run, tiny_city):
    register = run(tiny_city)
    lots = register.layer("lots")
    assert lots["lot_id"].tolist()[:3] == ["a", "b", "c"]
    assert set(register.layer("parameters")["lot_id"]) == set(lots["lot_id"])
    assert register.nothing_is_lost()
    assert lots.crs == CRS.from_epsg(32633)
    active = register.layer("active_areas").set_index("lot_id")
    assert lots.set_index("lot_id")["plantable_area_m2"][active.index].tolist() == active["area_m2"].tolist()
    assert lots.set_index("lot_id").loc["c", "area_m2"] == pytest.approx(3600)
    assert register.summary.counts["lots"] == 3


def test_the_users_city_is_only_read(run, tiny_city):
    before = sha256_of(tiny_city), tiny_city.stat().st_mtime_ns, sorted(tiny_city.parent.iterdir())
    run(tiny_city)
    after = [path for path in sorted(tiny_city.parent.iterdir()) if path.name != "out"]
    assert before == (sha256_of(tiny_city), tiny_city.stat().st_mtime_ns, after)


def test_the_users_columns_come_along_and_clashing_names_are_kept_as_source(stencil):
    columns = {
        "owner": ["x", None], "floors": [3, 4], "origin": ["here", "there"], "AREA_M2": [1.5, 2.5],
        "listed": [True, False], "zone": ["Street ", "residential"],
    }  # fmt: skip
    register = stencil(
        [lot(), lot(1)], layers={"sketches": [box(WEST + 5, SOUTH + 5, WEST + 25, SOUTH + 25)]}, **columns
    )
    lots = register.layer("lots").set_index("lot_id")
    assert lots.loc["a", "owner"] == "x"
    assert pd.isna(lots.loc["b", "owner"])
    assert lots.loc[["a", "b"], "floors"].tolist() == [3, 4]
    assert pd.isna(lots.loc["sketch:1", "floors"])
    assert lots.loc[["a", "b"], "source_origin"].tolist() == ["here", "there"]
    assert lots.loc[["a", "b"], "source_AREA_M2"].tolist() == [1.5, 2.5]
    assert lots.loc[["a", "b"], "listed"].tolist() == [True, False]
    assert lots.loc[["a", "b"], "zone"].tolist() == ["street", "residential"]
    assert lots.loc[["a", "b"], "source_zone"].tolist() == ["Street ", "residential"]


def test_buildings_come_along_those_outside_all_lots_too(run, tmp_path):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot()], lot_id=["a"])
    bow_tie = Polygon([(WEST + 100, SOUTH), (WEST + 110, SOUTH + 10), (WEST + 110, SOUTH), (WEST + 100, SOUTH + 10)])
    write_layer(
        city, "buildings", [house(), house(5, 5), bow_tie, None, house(0, 4), house(0, 5)],
        building_id=["own", None, "bow", "gone", "x", "y"], Height_M=[12.5, None, 7.0, 3.0, -2.0, 5000.0],
    )  # fmt: skip
    register = run(city)
    buildings = register.layer("buildings")
    assert buildings["building_id"].tolist() == ["own", "2", "bow", "x", "y"]
    assert buildings["height_m"].fillna(-1).tolist() == [12.5, -1, 7.0, -1, -1]
    assert register.notices.count("W_BUILDING_HEIGHT") == 2
    assert shapely.is_valid(buildings.geometry.to_numpy()).all()
    assert buildings.geometry.area.round(6).tolist() == [100.0, 100.0, 50.0, 100.0, 100.0]
    assert buildings.crs == register.layer("lots").crs


def test_heights_that_are_text_are_read_where_they_are_numbers(run, tmp_path):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot()], lot_id=["a"])
    write_layer(city, "buildings", [house(), house(1), house(2)], height_m=["9.5", "high", None])
    register = run(city)
    assert register.layer("buildings")["height_m"].fillna(-1).tolist() == [9.5, -1, -1]
    assert register.notices.count("W_BUILDING_HEIGHT") == 1


def test_a_city_without_buildings_has_the_layer_without_rows(stencil):
    assert len(stencil([lot()]).layer("buildings")) == 0


def test_columns_of_any_kind_come_along(tmp_path, run):
    city = tmp_path / "city.geojson"
    ring = [[15, 48], [15.001, 48], [15.001, 48.001], [15, 48.001], [15, 48]]
    properties = {
        "lot_id": "a",
        "tags": ["x", "y"],
        "numbers": [1, 2],
        "nested": {"k": 1},
        "day": "2024-02-29",
        "big": 2**60,
    }
    feature = {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    city.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    row = run(city).lot("a")
    assert json.loads(row["tags"]) == ["x", "y"]
    assert json.loads(row["numbers"]) == [1, 2]
    assert json.loads(row["nested"]) == {"k": 1}
    assert str(row["day"])[:10] == "2024-02-29"
    assert row["big"] == 2**60


def test_the_record_names_inputs_seed_and_working_crs(run, tiny_city):
    register = run(tiny_city, seed=77)
    record = require_record(register.path, "stencil")
    assert record.seed == 77
    assert record.inputs == [{"name": "tiny.gpkg", "sha256": sha256_of(tiny_city)}]
    assert record.stage_key == stencil_key(tiny_city, config=Config(), seed=77)
    assert record.working_crs == CRS.from_epsg(32633)


def test_the_key_changes_with_all_that_decides_the_result_and_with_nothing_else(tiny_city):
    def key(seed=1, **changes):
        crs = changes.pop("assume_crs", None)
        return stencil_key(tiny_city, config=Config.model_validate(changes), seed=seed, assume_crs=crs)

    assert key() == key(placement={"radius_stop": "max"})
    others = [key(2), key(rules={"building_clearance_m": 5}), key(zones={"other": {"density": 0.2}})]
    assert len({key(), *others, key(assume_crs="EPSG:32633")}) == 5


def test_equal_runs_and_any_number_of_workers_give_equal_registers(run, tiny_city):
    def content(workers):
        register = run(tiny_city, workers=workers)
        return [shapely.to_wkb(register.layer(name).geometry.to_numpy()).tolist() for name in ("lots", "active_areas")]

    assert content(1) == content(1) == content(3)


def test_the_order_of_lots_does_not_matter(stencil):
    settings = Config.model_validate({"zones": {"default": {"strategy": {"random": 1, "single": 1, "cluster": 1}}}})
    ids = [str(i) for i in range(12)]
    lots = [lot(i % 4, i // 4) for i in range(12)]
    houses = [house(i, i) for i in range(3)]
    one = stencil(lots, lot_id=ids, layers={"buildings": houses}, config=settings)
    first = one.parameters()["strategy"], one.layer("active_areas").set_index("lot_id")["area_m2"]
    other = stencil(lots[::-1], lot_id=ids[::-1], layers={"buildings": houses}, config=settings)
    assert other.parameters()["strategy"][ids].tolist() == first[0][ids].tolist()
    assert other.layer("active_areas").set_index("lot_id")["area_m2"][ids].tolist() == first[1][ids].tolist()


# roads and streets


def test_street_lots_are_made_from_roads_where_the_register_has_none(run, tiny_city):
    register = run(tiny_city)
    lots = register.layer("lots").set_index("lot_id")
    assert lots.loc["road:1", ["zone", "origin"]].tolist() == ["street", "road"]
    assert register.layer("active_areas").set_index("lot_id").loc["road:1", "kind"] == "road"


def test_no_street_lots_are_made_where_the_register_has_some_or_the_rules_say_no(stencil):
    roads = [LineString([(WEST, SOUTH - 10), (WEST + 200, SOUTH - 10)])]
    street = box(WEST, SOUTH - 20, WEST + 200, SOUTH)
    assert stencil([street], zone=["street"], layers={"roads": roads}).summary.counts["street_lots"] == 0
    square = box(WEST, SOUTH + 100, WEST + 50, SOUTH + 150)
    assert stencil([square], zone=["street"], layers={"roads": roads}).summary.counts["street_lots"] == 1
    never = Config.model_validate({"rules": {"derive_street_lots": False}})
    assert stencil([lot()], layers={"roads": roads}, config=never).summary.counts["street_lots"] == 0
    assert stencil([lot()], layers={"roads": roads}).summary.counts["street_lots"] == 1


def test_lots_that_reach_over_a_road_give_its_corridor_to_the_street(stencil):
    roads = [LineString([(WEST, SOUTH + 60), (WEST + 60, SOUTH + 60)])]
    register = stencil([lot(), lot(0, 1)], layers={"roads": roads})
    areas = register.layer("active_areas").set_index("lot_id").geometry
    assert areas["road:1"].area > 200
    for name in "ab":
        assert areas[name].distance(areas["road:1"]) >= 1.5 - 1e-6
        assert areas[name].distance(roads[0]) >= 3.5 + 0.75 + 2.5 + 1.5 - 1e-6


def test_a_roads_own_id_names_its_street_lot(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot()], lot_id=["a"])
    lines = [LineString([(WEST, SOUTH - d), (WEST + 60, SOUTH - d)]) for d in (20, 60)]
    write_layer(city, "roads", lines, osm_id=["w77", "w5"], width_m=[6.0, None])
    register = run(city)
    assert {"road:w77", "road:w5"} <= set(register.layer("lots")["lot_id"])
    assert register.notices.count("W_ROAD_WIDTH") == 1


# sketches


def sketch_city(tmp_path, sketches, **columns):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot(), lot(1)], lot_id=["a", "b"], zone=["residential", "street"], spacing_m=[5.0, None])
    write_layer(city, "sketches", sketches, **columns)
    return city


def test_a_sketch_is_a_unit_of_its_own_on_ground_taken_from_the_lots(tmp_path, run):
    shape = box(WEST + 40, SOUTH + 10, WEST + 80, SOUTH + 30)
    register = run(sketch_city(tmp_path, [shape], strategy=["single"], density=[0.5]))
    areas = register.layer("active_areas").set_index("lot_id")
    assert areas.loc["sketch:1", "kind"] == "sketch"
    assert areas["area_m2"].to_dict() == pytest.approx({"a": 3200, "b": 3200, "sketch:1": 800})
    values = register.parameters().loc["sketch:1"]
    assert values[["strategy", "source", "density"]].tolist() == ["single", "sketch", 0.5]


def test_a_sketch_takes_what_it_does_not_say_from_the_lot_under_it(tmp_path, run):
    shapes = [box(WEST + 10, SOUTH + 10, WEST + 20, SOUTH + 20), box(WEST + 300, SOUTH, WEST + 330, SOUTH + 30)]
    register = run(sketch_city(tmp_path, shapes, strategy=["equidistant", None]))
    values, lots = register.parameters(), register.layer("lots").set_index("lot_id")
    assert values["spacing_m"][["sketch:1", "sketch:2"]].tolist() == [5.0, PARAMETERS["spacing_m"].default]
    assert lots["zone"][["sketch:1", "sketch:2"]].tolist() == ["residential", "other"]


def test_a_drawn_coverage_becomes_random_plants_of_that_density(tmp_path, run):
    shapes = [box(WEST + 10 * i, SOUTH, WEST + 10 * i + 10, SOUTH + 10) for i in range(3)]
    register = run(sketch_city(tmp_path, shapes, coverage=[0.265, 0.9, None], strategy=[None, "boundary", None]))
    values = register.parameters()
    assert values["density"][[f"sketch:{i}" for i in (1, 2, 3)]].tolist() == pytest.approx([0.5, 1.0, 1.0])
    assert values["strategy"][["sketch:1", "sketch:2"]].tolist() == ["random", "boundary"]


def test_a_lot_wholly_under_a_sketch_is_skipped_with_a_reason(tmp_path, run):
    register = run(sketch_city(tmp_path, [box(WEST - 5, SOUTH - 5, WEST + 65, SOUTH + 65)]))
    assert register.reasons() == {"a": "no_room"}
    assert register.nothing_is_lost()


# geometry of lots, end to end


def test_lots_without_usable_geometry_stay_in_lots_and_are_skipped(stencil):
    register = stencil([lot(), None, Polygon(), Polygon([(WEST, SOUTH), (WEST + 9, SOUTH), (WEST, SOUTH)]), lot(1)])
    assert register.reasons() == {"b": "no_geometry", "c": "no_geometry", "d": "no_area"}
    lots = register.layer("lots").set_index("lot_id")
    assert lots.geometry.isna().tolist() == [False, True, True, True, False]
    assert lots["area_m2"].tolist() == pytest.approx([3600, 0, 0, 0, 3600])
    assert register.nothing_is_lost()


def test_too_many_bad_lots_are_an_error_after_the_register_is_written(stencil):
    lots = [lot(), None, None, lot(1)]
    assert stencil(lots).summary.counts["lots_bad"] == 2
    assert stencil(lots, options={"max_bad_fraction": 0.5}).summary.counts["lots_bad"] == 2
    with pytest.raises(PartlyDoneError, match="2 of 4"):
        stencil(lots, options={"max_bad_fraction": 0.4})


def test_the_register_is_there_when_too_many_lots_are_bad(tmp_path):
    city, register = tmp_path / "city.gpkg", tmp_path / "register.gpkg"
    write_layer(city, "lots", [lot(), None], lot_id=["a", "b"])
    with pytest.raises(PartlyDoneError):
        stencil_city(city, register, config=Config(), seed=1, max_bad_fraction=0.1)
    assert "active_areas" in layer_names(register)


def test_broken_lots_are_repaired_and_counted(stencil):
    bow_tie = Polygon([(WEST, SOUTH), (WEST + 10, SOUTH + 10), (WEST + 10, SOUTH), (WEST, SOUTH + 10)])
    overlapping = MultiPolygon([lot(2), box(WEST + 150, SOUTH, WEST + 210, SOUTH + 60)])
    register = stencil([bow_tie, overlapping])
    assert register.area("a") == pytest.approx(50)
    assert register.area("b") == pytest.approx(5400)
    assert register.notices.count("W_REPAIRED") == 2


def test_heights_of_lots_do_not_matter(stencil):
    register = stencil([Polygon([(x, y, 7.0) for x, y in lot().exterior.coords]), lot(1)])
    assert register.area("a") == pytest.approx(3600)
    assert not register.lot("a").geometry.has_z


def test_a_lot_with_an_unclosed_ring_is_skipped_and_the_others_are_kept(tmp_path, run):
    city = tmp_path / "open.geojson"
    rings = [
        [[15, 48], [15.001, 48], [15.001, 48.001], [15, 48.001], [15, 48]],
        [[15.002, 48], [15.003, 48], [15.003, 48.001]],
    ]
    features = [
        f'{{"type":"Feature","properties":{{"lot_id":"{name}"}},"geometry":{{"type":"Polygon","coordinates":[{ring}]}}}}'
        for name, ring in zip("ab", rings, strict=True)
    ]
    city.write_text(f'{{"type":"FeatureCollection","features":[{",".join(features)}]}}')
    register = run(city)
    assert list(register.reasons()) == ["b"]
    assert register.nothing_is_lost()


def test_lots_among_other_geometries_are_planted_and_the_others_skipped(stencil):
    register = stencil([lot(), Point(WEST, SOUTH), LineString([(WEST, SOUTH), (WEST + 5, SOUTH)])])
    assert register.reasons() == {"b": "not_polygon", "c": "not_polygon"}


def test_a_layer_of_points_or_lines_is_refused(tmp_path, run):
    city = tmp_path / "points.gpkg"
    write_layer(city, "lots", [Point(WEST, SOUTH)], lot_id=["a"])
    with pytest.raises(InputError, match="polygon"):
        run(city)


def test_a_curved_lot_is_taken_by_its_chords(tmp_path, run):
    city = tmp_path / "curve.gpkg"
    write_layer(city, "lots", [lot(), Point(WEST, SOUTH)], lot_id=["a", "b"])
    radius = 10.0
    points = [(WEST + radius * x, SOUTH + radius * y) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 0))]
    arc = np.array([(1, 8, 5)], dtype=[("order", "u1"), ("type", "<u4"), ("count", "<u4")]).tobytes()
    wkb = b"\x01" + np.array([10, 1], "<u4").tobytes() + arc + np.array(points, "<f8").tobytes()
    header = b"GP\x00\x01" + np.array([32633], "<i4").tobytes()
    with closing(sqlite3.connect(city)) as database, database:
        names = [row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type='trigger'")]
        for name in names:
            database.execute(f'DROP TRIGGER "{name}"')
        database.execute("UPDATE lots SET geom=? WHERE lot_id='a'", (header + wkb,))
    register = run(city)
    assert register.area("a") == pytest.approx(np.pi * radius**2, rel=2e-3)
    assert register.notices.count("W_CURVE") == 1


def test_a_lot_inside_a_building_and_a_lot_that_is_one_are_skipped_for_lack_of_room(stencil):
    inside = box(WEST + 20, SOUTH + 20, WEST + 30, SOUTH + 30)
    register = stencil([inside, lot(3)], layers={"buildings": [lot(), lot(3)]})
    assert register.reasons() == {"a": "no_room", "b": "no_room"}
    assert register.nothing_is_lost()


def test_overlapping_lots_are_counted_and_no_ground_is_planted_twice(stencil):
    register = stencil([box(WEST, SOUTH, WEST + 50, SOUTH + 50), box(WEST + 30, SOUTH, WEST + 90, SOUTH + 50)])
    areas = register.layer("active_areas").set_index("lot_id").geometry
    assert register.notices.count("W_OVERLAP") == 1
    assert areas["a"].intersection(areas["b"]).area < 1e-6
    assert areas["a"].area == pytest.approx(2500)
    assert register.area("b") == pytest.approx(3000)


def test_identical_lots_are_planted_once_and_the_others_say_whose_ground_it_is(stencil):
    register = stencil([lot(), lot(), lot(), lot(1)])
    assert register.reasons() == {"b": "duplicate", "c": "duplicate"}
    assert register.layer("skipped")["detail"].tolist() == ["the same ground as lot a"] * 2
    assert register.notices.count("W_DUPLICATE") == 2
    assert register.nothing_is_lost()


def test_a_lot_across_the_antimeridian_stays_small(stencil):
    crossing = Polygon([(179.9995, 10), (-179.9995, 10), (-179.9995, 10.001), (179.9995, 10.001)])
    register = stencil([crossing, box(-179.999, 10, -179.998, 10.001)], crs="EPSG:4326")
    assert register.area("a") == pytest.approx(109.6 * 110.6, rel=0.01)
    bounds = register.layer("lots").geometry.bounds
    assert (bounds["maxx"] - bounds["minx"]).max() < 0.01
    assert register.notices.count("W_ANTIMERIDIAN") == 1


def test_a_lot_of_a_billionth_of_a_degree_has_no_plants_and_breaks_nothing(stencil):
    register = stencil([box(15, 48, 15 + 1e-9, 48 + 1e-9), box(15.001, 48, 15.002, 48.001)], crs="EPSG:4326")
    assert register.reasons() == {"a": "too_small"}


def test_a_lot_of_a_thousand_kilometres_is_refused_before_placing(stencil):
    with pytest.raises(LimitError, match="too large"):
        stencil([box(0, SOUTH, 1e6, SOUTH + 100)])
    register = stencil([box(0, SOUTH, 1e6, SOUTH + 100), lot()])
    assert register.reasons() == {"a": "too_large"}
    assert register.notices.count("W_TOO_LARGE") == 1


def test_ten_thousand_holes_are_no_trouble(stencil):
    x, y = (values.ravel() for values in np.meshgrid(np.arange(100.0), np.arange(100.0)))
    base = np.column_stack((WEST + 6 * x, SOUTH + 6 * y))
    holes = np.stack([base + 6 * np.array(corner) for corner in [(0.2, 0.2), (0.8, 0.2), (0.5, 0.8)]], axis=1)
    shell = shapely.linearrings([(WEST, SOUTH), (WEST + 600, SOUTH), (WEST + 600, SOUTH + 600), (WEST, SOUTH + 600)])
    register = stencil([shapely.polygons(shell, shapely.linearrings(holes))])
    assert register.area("a") == pytest.approx(360_000 - 10_000 * 0.18 * 36, rel=1e-6)


# coordinate reference systems


def test_coordinates_beyond_all_limits_are_refused(stencil):
    with pytest.raises((LimitError, CrsError)):
        stencil([shapely.transform(lot(), lambda xy: xy + 1e12)])
    with pytest.raises((LimitError, CrsError)):
        stencil([shapely.transform(lot(), lambda xy: xy + 1e9)])


def test_metres_labelled_as_degrees_are_refused(stencil):
    with pytest.raises(CrsError, match="not degrees"):
        stencil([lot()], crs="EPSG:4326")


def test_swapped_latitude_and_longitude_are_refused_where_they_leave_the_earth(stencil):
    with pytest.raises(CrsError):
        stencil([box(35.6, 139.7, 35.601, 139.701)], crs="EPSG:4326")


def test_a_file_without_a_crs_is_refused_unless_one_is_assumed(stencil):
    with pytest.raises(CrsError, match="--assume-crs"):
        stencil([lot()], crs=None)
    assert stencil([lot()], crs=None, options={"assume_crs": "EPSG:32633"}).area("a") == pytest.approx(3600)


def test_a_local_crs_without_a_place_on_earth_is_refused(stencil):
    local = 'ENGCRS["site",EDATUM["site"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
    with pytest.raises(CrsError):
        stencil([lot()], crs=local)


def moved(shapes, crs):
    return list(reproject(np.array(shapes, dtype=object), CRS.from_epsg(32618), CRS.from_user_input(crs)))


@pytest.mark.parametrize("crs", ["EPSG:2263", "EPSG:4326", "EPSG:3857"])
def test_lots_in_feet_degrees_or_web_mercator_have_the_ground_they_have_in_metres(stencil, crs):
    place = np.array(Transformer.from_crs(4326, 32618, always_xy=True).transform(-73.92, 40.77))
    lots = [shapely.transform(lot(i), lambda xy: xy - [WEST, SOUTH] + place) for i in range(2)]
    built = [shapely.transform(house(i), lambda xy: xy - [WEST, SOUTH] + place) for i in range(2)]
    metres = stencil(lots, crs="EPSG:32618", layers={"buildings": built}).layer("active_areas")
    other = stencil(moved(lots, crs), crs=crs, layers={"buildings": moved(built, crs)})
    areas = other.layer("active_areas")
    assert areas.crs == CRS.from_user_input(crs)
    working = require_record(other.path, "stencil").working_crs
    back = reproject(areas.geometry.to_numpy(), areas.crs, working)
    scale = 1.0 if working == CRS.from_epsg(32618) else shapely.area(back).sum() / metres.geometry.area.sum()
    assert scale == pytest.approx(1.0, abs=2e-3)
    assert shapely.area(back) == pytest.approx(metres.geometry.area.to_numpy() * scale, rel=1e-4)
    if scale == 1.0:
        assert shapely.hausdorff_distance(back, metres.geometry.to_numpy()).max() < 1e-3


# ids, zones, columns, layers


def test_repeated_ids_are_refused_listing_the_first_five(stencil):
    with pytest.raises(InputError) as caught:
        stencil([lot(i) for i in range(14)], lot_id=[*"aabbccddeeffgg"])
    text = str(caught.value)
    assert "'a', 'b', 'c', 'd', 'e', ..." in text
    assert "'f'" not in text


@pytest.mark.parametrize("missing", [None, "", "  "])
def test_missing_ids_are_refused(stencil, missing):
    with pytest.raises(InputError, match="without an id"):
        stencil([lot(), lot(1)], lot_id=["a", missing])


def test_ids_come_back_exactly_as_text(stencil):
    register = stencil([lot(), lot(1)], lot_id=[2**53 + 1, 7])
    assert register.layer("lots")["lot_id"].tolist() == ["9007199254740993", "7"]
    register = stencil([lot(), lot(1)], lot_id=["007", "7"])
    assert register.layer("lots")["lot_id"].tolist() == ["007", "7"]


def test_lots_without_ids_are_numbered_by_their_rows(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "parcels", [lot(), lot(1)])
    register = run(city)
    assert register.layer("lots")["lot_id"].tolist() == ["1", "2"]
    assert register.notices.count("W_NO_LOT_ID") == 1
    assert register.notices.count("W_ZONE_MISSING") == 2
    assert register.layer("lots")["zone"].tolist() == ["other", "other"]


def test_unknown_zones_become_other_and_are_counted(stencil):
    zones = ["Residential ", "Résidentiel", None, "commercial"]
    register = stencil([lot(i) for i in range(4)], zone=zones)
    assert register.layer("lots")["zone"].tolist() == ["residential", "other", "other", "commercial"]
    assert register.notices.count("W_ZONE_UNKNOWN") == 1
    assert register.notices.count("W_ZONE_MISSING") == 1


NAUGHTY = [
    "'; DROP TABLE lots;--", '"', "../../etc/passwd", "/absolute", "\n", "😍", "﷽", "ก็็็็", "NULL", "nan", "-0", "1e5",
    "%s%n", "<script>", "\u202e", "x" * 3000, "undefined", "$(touch x)", "\ufeff", "a\tb",
]  # fmt: skip


def test_strange_texts_as_ids_and_zones_come_back_exactly_and_name_no_file(stencil, tmp_path):
    ids = [text if text.strip() else f"id{text}" for text in NAUGHTY]
    register = stencil([lot(i) for i in range(len(ids))], lot_id=ids, zone=NAUGHTY)
    assert register.layer("lots")["lot_id"].tolist() == ids
    assert register.layer("lots")["source_zone"].tolist() == NAUGHTY
    assert {path.name for path in tmp_path.iterdir()} == {"city.gpkg", "out"}
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["register.gpkg"]


def test_overrides_that_cannot_be_used_are_refused_with_the_lot_and_nothing_is_written(stencil, tmp_path):
    with pytest.raises(InputError, match=r"lot b: density is 1\.5"):
        stencil([lot(), lot(1)], density=[0.5, 1.5])
    assert not (tmp_path / "out" / "register.gpkg").exists()


def test_overrides_beat_the_zone(stencil):
    register = stencil([lot(), lot(1)], spacing_m=[13.0, None], strategy=["E", None])
    values = register.parameters()
    assert values["spacing_m"].tolist() == [13.0, PARAMETERS["spacing_m"].default]
    assert values["strategy"].tolist() == ["equidistant", "random"]
    assert values["source"].tolist() == ["lot", "zone"]
    assert register.notices.count("W_RANGE_SPACING_M") == 1


def test_of_two_polygon_layers_one_must_be_named(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "one", [lot()], lot_id=["a"])
    write_layer(city, "two", [lot()], lot_id=["b"])
    with pytest.raises(InputError, match="several layers"):
        run(city)
    assert run(city, lots_layer="two").layer("lots")["lot_id"].tolist() == ["b"]


def test_the_only_polygon_layer_is_taken_as_lots_unless_it_is_something_else(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "buildings", [lot()])
    with pytest.raises(InputError, match="no layer 'lots'"):
        run(city)


def test_a_lone_layer_beside_those_of_a_city_is_taken_as_lots(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "parcels", [lot()], lot_id=["a"])
    write_layer(city, "buildings", [house()])
    register = run(city)
    assert register.layer("lots")["lot_id"].tolist() == ["a"]
    assert register.layer("active_areas")["area_m2"][0] < 3600 - 100


def test_columns_that_differ_by_case_alone_are_refused(tmp_path, run):
    city = tmp_path / "city.geojson"
    ring = [[15, 48], [15.001, 48], [15.001, 48.001], [15, 48.001], [15, 48]]
    geometry = f'"geometry":{{"type":"Polygon","coordinates":[{ring}]}}'
    city.write_text(
        '{"type":"FeatureCollection","features":[{"type":"Feature","properties":{"Zone":"a","zone":"b"},'
        + geometry
        + "}]}"
    )
    with pytest.raises(InputError, match="case alone"):
        run(city)


def test_known_columns_are_found_in_any_case(stencil):
    register = stencil([lot()], lot_id=["a"], ZONE=["street"], Density=[0.25])
    assert register.layer("lots")["zone"].tolist() == ["street"]
    assert register.parameters()["density"].tolist() == [0.25]


def test_a_city_without_a_lot_gives_an_empty_register(stencil):
    register = stencil([], lot_id=np.array([], dtype=object))
    assert register.notices.count("W_EMPTY") == 1
    for name in ("lots", "active_areas", "parameters", "skipped"):
        assert len(register.layer(name)) == 0


@pytest.mark.parametrize("name", ["lots.geojson", "lots.shp", "lots.fgb", "lots.parquet"])
def test_a_bare_file_of_lots_is_a_city(tmp_path, run, name):
    path = tmp_path / name
    frame = gpd.GeoDataFrame({"lot_id": ["a", "b"]}, geometry=[lot(), lot(1)], crs="EPSG:32633").to_crs(4326)
    if name.endswith("parquet"):
        frame.to_parquet(path)
    else:
        pyogrio.write_dataframe(frame, path)
    register = run(path)
    assert sorted(register.layer("lots")["lot_id"]) == ["a", "b"]
    assert register.area("a") == pytest.approx(3600, rel=1e-6)


# the things around lots


def test_broken_buildings_are_repaired_or_left_out_and_counted(tmp_path, run):
    x, y = WEST + 25, SOUTH + 25
    bow_tie = Polygon([(x, y), (x + 10, y + 10), (x + 10, y), (x, y + 10)])
    register = None
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot()], lot_id=["a"])
    write_layer(city, "buildings", [bow_tie, None])
    register = run(city)
    assert register.notices.count("W_REPAIRED") == 1
    assert register.layer("active_areas")["area_m2"][0] < 3600 - 50


def test_layers_in_another_crs_are_brought_to_the_lots(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot()], lot_id=["a"])
    degrees = reproject(np.array([house()], dtype=object), CRS.from_epsg(32633), CRS.from_epsg(4326))
    write_layer(city, "buildings", list(degrees), crs="EPSG:4326")
    area = run(city).layer("active_areas").geometry[0]
    assert area.distance(house()) == pytest.approx(6.0, abs=0.01)


def test_all_layers_of_a_city_take_their_part(tmp_path, run):
    city = tmp_path / "city.gpkg"
    write_layer(city, "lots", [lot(), lot(1)], lot_id=["a", "b"], zone=["residential", "residential"])
    write_layer(city, "buildings", [house()])
    write_layer(city, "driveways", [LineString([(WEST + 10, SOUTH - 5), (WEST + 10, SOUTH + 20)])])
    write_layer(city, "entrances", [Point(WEST + 30, SOUTH + 25), Point(WEST + 100, SOUTH)], kind=["door", "hatch"])
    write_layer(city, "obstacles", [Point(WEST + 50, SOUTH + 50)], kind=["hydrant"])
    register = run(city)
    area = register.layer("active_areas").geometry[0]
    assert not area.intersects(Point(WEST + 30, SOUTH + 17))
    assert not area.intersects(Point(WEST + 12.9, SOUTH + 10))
    assert area.distance(Point(WEST + 50, SOUTH + 50)) == pytest.approx(3.0, abs=0.01)
    assert register.notices.count("W_ENTRANCE_KIND") == 1
    assert register.notices.count("W_ENTRANCE_ALONE") == 1
    assert register.summary.counts["entrances"] == 2


# files that are none


def test_a_folder_a_pipe_a_device_a_loop_and_an_empty_file_are_refused_at_once(tmp_path, run):
    pipe, loop, empty, folder = (tmp_path / name for name in ("pipe.gpkg", "loop.gpkg", "empty.gpkg", "folder.gpkg"))
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    empty.touch()
    folder.mkdir()
    device = tmp_path / "zero.gpkg"
    device.symlink_to("/dev/zero")
    for path in (pipe, loop, empty, folder, device, tmp_path / "absent.gpkg"):
        with pytest.raises(InputError):
            run(path)
    assert not (tmp_path / "out").exists()


def test_the_input_is_never_the_output(tiny_city):
    before = sha256_of(tiny_city)
    with pytest.raises(OutputExistsError):
        stencil_city(tiny_city, tiny_city, config=Config(), seed=1)
    assert sha256_of(tiny_city) == before


# real cities


def test_every_lot_of_astoria_is_planted_or_skipped(real_data, run):
    register = run(real_data / "nyc_astoria" / "astoria.gpkg")
    assert register.summary.counts["lots"] == 2196
    assert register.nothing_is_lost()
    assert register.layer("lots").crs == CRS.from_epsg(2263)
    assert register.summary.counts["area_m2"] == pytest.approx(1_067_221, rel=1e-3)


def test_stacked_parcels_of_del_mar_are_planted_once(real_data, run):
    register = run(real_data / "del_mar" / "delmar.gpkg", lots_layer="parcels")
    assert register.nothing_is_lost()
    assert sum(reason == "duplicate" for reason in register.reasons().values()) > 2500
    areas = register.layer("active_areas").geometry.to_numpy()
    assert shapely.area(areas).sum() == pytest.approx(shapely.area(shapely.union_all(areas)), rel=2e-3)
