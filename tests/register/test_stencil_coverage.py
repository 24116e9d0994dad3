import geopandas as gpd
import numpy as np
import pytest
import shapely
from pyproj import CRS
from shapely.geometry import box

from tests.files.rasters import write_raster
from tests.register.conftest import Register, write_layer
from tests.register.covering import SOUTH, WEST, disc, sampled_map, write_map
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.core.schema import check_layer
from urbanforest_cli.files.provenance import require_record
from urbanforest_cli.register import regions
from urbanforest_cli.register.stage import stencil_city, stencil_key

SIZE = 60.0
DISCS = [disc(30, 30, 6), disc(57, 50, 5), disc(100, 20, 4), disc(110, 45, 3), disc(100, 100, 12), disc(30, 150, 2)]
"""The second stands in lot a and reaches over its border by two metres."""


def lot(i=0, j=0):
    return box(WEST + SIZE * i, SOUTH + SIZE * j, WEST + SIZE * (i + 1), SOUTH + SIZE * (j + 1))


def lots(columns=3, rows=3):
    return [lot(i, j) for j in range(rows) for i in range(columns)]


def config(**coverage):
    return Config.model_validate({"coverage": coverage})


def by_lot(frame):
    return frame.set_index("lot_id")


@pytest.fixture
def mapped(stencil, tmp_path):
    """Stencil nine lots a to i with a map of the discs, or of what is given."""

    def make(shapes=None, *, covering=DISCS, path=None, config=None, layers=None, **options):
        path = path or write_map(tmp_path / "coverage.tif", covering)
        columns = {name: options.pop(name) for name in ("zone", "lot_id") if name in options}
        return stencil(shapes or lots(), config=config, layers=layers, options={"coverage": path, **options}, **columns)

    return make


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The register of nine lots and the map of the discs, made once."""
    folder = tmp_path_factory.mktemp("plain")
    city, path = folder / "city.gpkg", folder / "register.gpkg"
    write_layer(city, "lots", lots(), lot_id=list("abcdefghi"))
    coverage = write_map(folder / "coverage.tif", DISCS)
    return Register(path, stencil_city(city, path, config=Config(), seed=1, coverage=coverage))


def test_lots_are_filled_where_the_map_shows_vegetation_or_left_bare(plain):
    register = plain
    check_layer(register.layer("regions"), "regions")
    found = by_lot(register.layer("regions"))
    assert list(found.index) == ["a", "b", "e", "g"]
    assert set(register.layer("active_areas")["kind"]) == {"region"}
    assert register.nothing_is_lost()
    assert {lot_id for lot_id, reason in register.reasons().items() if reason == "bare"} == set("cdfhi")
    assert found.loc["b", "area_m2"] == pytest.approx(np.pi * 25, rel=0.02)
    assert found.loc["b", "region_count"] == 2
    assert (found["coverage"] == 1).all()
    assert register.summary.counts["lots_filled"] == 4
    assert register.summary.counts["lots_bare"] == 5


def test_shares_are_those_of_the_ground(plain):
    table = by_lot(plain.layer("lots"))
    assert (table["seen_fraction"] == 1).all()
    assert table.loc["b", "covered_fraction"] == pytest.approx((np.pi * 25 + _over("b")) / 3600, abs=0.001)
    assert table.loc["e", "covered_fraction"] == pytest.approx(np.pi * 144 / 3600, abs=0.003)
    assert table.loc["i", "covered_fraction"] == 0
    assert table["plantable_area_m2"].to_numpy() == pytest.approx(3600)  # the rules' own, whatever the map shows


def _over(lot_id):
    return shapely.intersection(DISCS[1], lots()["abc".index(lot_id)]).area


def test_a_crown_over_the_border_is_one_lots(plain):
    found = by_lot(plain.layer("regions"))
    whole = np.pi * (36 + 25)
    assert found.loc["a", "area_m2"] == pytest.approx(whole, rel=0.02)
    assert found.loc["a", "inside_m2"] == pytest.approx(whole - _over("b"), rel=0.02)
    assert not shapely.intersects(found.geometry["b"], shapely.buffer(DISCS[1], -1.0))


def test_stems_stand_in_regions_of_their_lot_off_walls_and_roads(mapped):
    wall, road = box(WEST + 24, SOUTH + 20, WEST + 30, SOUTH + 40), box(WEST, SOUTH + 33, WEST + 180, SOUTH + 36)
    values = {"coverage": {"wall_clearance_m": 1.0, "road_clearance_m": 0.5}, "rules": {"derive_street_lots": False}}
    register = mapped(config=Config.model_validate(values), layers={"buildings": [wall], "roads": [road]})
    active, found = by_lot(register.layer("active_areas")), by_lot(register.layer("regions"))
    stems = active.geometry["a"]
    assert stems.distance(wall) > 1.0 - 1e-6
    assert stems.distance(road) > 0.5 - 1e-6
    assert shapely.covers(shapely.buffer(lot(), 1e-6), stems)
    assert shapely.covers(shapely.buffer(found.geometry["a"], 1e-6), stems)
    kept = found.geometry["a"].intersection(lot())
    kept = kept.difference(shapely.buffer(wall, 1.0, quad_segs=32)).difference(shapely.buffer(road, 0.5))
    assert stems.area == pytest.approx(kept.area, rel=0.01)
    assert found.loc["a", "inside_m2"] > stems.area + 30  # the region is what was seen, walls or not


def test_vegetation_over_a_roof_alone_leaves_no_room(mapped):
    register = mapped(
        covering=[disc(30, 30, 4)], layers={"buildings": [box(WEST + 20, SOUTH + 20, WEST + 40, SOUTH + 40)]}
    )
    assert register.reasons()["a"] == "no_room"
    assert len(register.layer("regions")) == 0


def test_regions_of_neighbours_share_no_stem_ground(mapped):
    shapes = [box(WEST + x, SOUTH, WEST + x + 9, SOUTH + 60) for x in range(0, 180, 9)]
    rng = np.random.default_rng(1)
    covering = [disc(*rng.uniform((0, 0), (180, 60)), rng.uniform(1.5, 6)) for _ in range(120)]
    register = mapped(shapes, covering=covering, lot_id=[str(i) for i in range(len(shapes))])
    active, found = register.layer("active_areas").geometry.to_numpy(), register.layer("regions").geometry.to_numpy()
    assert shapely.is_valid(active).all()
    assert shapely.is_valid(found).all()
    one, other = shapely.STRtree(active).query(active, predicate="intersects")
    common = shapely.area(shapely.intersection(active[one], active[other]))[one < other]
    assert common.max(initial=0.0) < 1e-6
    green = shapely.intersection(shapely.union_all(covering), box(WEST, SOUTH, WEST + 180, SOUTH + 60)).area
    assert shapely.union_all(found).area > 0.97 * green  # nobody's loss is everybody's


@pytest.mark.parametrize("workers", [1, 3])
def test_results_depend_neither_on_workers_nor_on_lots_far_off(plain, mapped, workers):
    whole = by_lot(plain.layer("regions"))
    near = by_lot(mapped([lot(), lot(1), lot(0, 1), lot(1, 1)], workers=workers).layer("regions"))
    assert whole.geometry["a"].equals_exact(near.geometry["a"], 0)


@pytest.mark.slow
def test_blocks_and_tiles_change_nothing(mapped, monkeypatch):
    rng = np.random.default_rng(8)
    covering = [disc(*rng.uniform(-10, 190, 2), rng.uniform(1.5, 7)) for _ in range(150)]
    whole = by_lot(mapped(covering=covering).layer("regions"))
    monkeypatch.setattr(regions, "BLOCK_CELLS", 60)
    small = by_lot(mapped(covering=covering).layer("regions"))
    assert all(a.equals_exact(b, 0) for a, b in zip(whole.geometry, small.geometry, strict=True))
    monkeypatch.setattr(regions, "LONG_CELLS", 64)
    monkeypatch.setattr(regions, "TILE_CELLS", 40)
    tiled = by_lot(mapped(covering=covering).layer("regions"))
    apart = shapely.area(shapely.symmetric_difference(whole.geometry.to_numpy(), tiled.geometry.to_numpy()))
    assert (apart < 0.01 * whole["area_m2"] + 0.5).all()
    assert shapely.is_valid(tiled.geometry).all()


@pytest.mark.slow
def test_small_regions_are_dropped(mapped):
    covering = [disc(30, 30, 0.7), disc(100, 30, 1.5)]
    assert list(mapped(covering=covering).layer("regions")["lot_id"]) == ["b"]
    assert list(mapped(covering=covering, config=config(smallest_region_m2=0.5)).layer("regions")["lot_id"]) == [
        "a",
        "b",
    ]
    assert len(mapped(covering=covering, config=config(smallest_region_m2=20.0)).layer("regions")) == 0


def test_sketches_and_smaller_lots_keep_their_ground(mapped):
    drawn, inner = box(WEST + 90, SOUTH + 90, WEST + 100, SOUTH + 120), box(WEST + 30, SOUTH, WEST + 60, SOUTH + 60)
    register = mapped([*lots(), inner], layers={"sketches": [drawn]}, lot_id=[*"abcdefghi", "z"])
    active = by_lot(register.layer("active_areas"))
    assert active.loc["sketch:1", "kind"] == "sketch"
    assert active.geometry["e"].intersection(drawn).area < 1e-6
    assert active.geometry["a"].intersection(inner).area < 1e-6
    assert active.geometry["z"].area > 2 * active.geometry["a"].area
    assert np.isnan(by_lot(register.layer("lots")).loc["sketch:1", "covered_fraction"])


def test_street_strips_are_filled_too(mapped):
    roads = [shapely.LineString([(WEST - 20, SOUTH - 6), (WEST + 200, SOUTH - 6)])]
    register = mapped(covering=[*DISCS, disc(50, -2, 2.5)], layers={"roads": roads})
    strips = register.layer("active_areas")
    strips = strips[strips["lot_id"].str.startswith("road:")]
    assert strips["kind"].tolist() == ["region"]
    assert strips.geometry.iloc[0].distance(shapely.Point(WEST + 50, SOUTH - 2)) < 2.5


# maps of other kinds


@pytest.mark.slow
def test_lots_beyond_the_map_are_planted_by_the_rules_or_not_at_all(mapped, tmp_path):
    path = write_map(tmp_path / "part.tif", DISCS, bounds=(-30, -30, 75, 210))
    register = mapped(path=path)
    kinds = by_lot(register.layer("active_areas"))["kind"]
    assert {lot_id for lot_id, kind in kinds.items() if kind == "lot"} == set("behcfi")
    assert register.notices.count("W_LOTS_UNSEEN") == 6
    assert by_lot(register.layer("lots")).loc["b", "seen_fraction"] == pytest.approx(0.25, abs=0.02)
    strict = mapped(path=path, config=config(unseen="nothing"))
    assert [lot_id for lot_id, reason in strict.reasons().items() if reason == "unseen"] == list("bcefhi")
    half = mapped(path=path, config=config(seen_least=0.2))
    assert half.notices.count("W_LOTS_UNSEEN") == 3


def test_a_map_that_knows_nothing_leaves_all_to_the_rules(mapped, tmp_path):
    path = write_map(tmp_path / "map.tif", [], values=np.full((400, 400), 255, np.uint8))
    register = mapped(path=path)
    assert set(register.layer("active_areas")["kind"]) == {"lot"}
    assert register.notices.count("W_LOTS_UNSEEN") == 9
    assert by_lot(register.layer("lots"))["covered_fraction"].isna().all()


def test_a_map_all_green_fills_every_lot_to_its_border(mapped, tmp_path):
    path = write_map(tmp_path / "map.tif", [], values=np.full((400, 400), 100, np.uint8))
    register = mapped(path=path)
    assert by_lot(register.layer("regions"))["inside_m2"].to_numpy() == pytest.approx(3600, rel=0.001)
    assert by_lot(register.layer("lots"))["covered_fraction"].eq(1).all()


def test_a_map_without_vegetation_leaves_every_lot_bare(mapped):
    register = mapped(covering=[])
    assert set(register.reasons().values()) == {"bare"}
    assert len(register.layer("regions")) == len(register.layer("active_areas")) == 0


def test_a_map_elsewhere_is_refused_with_both_extents(mapped, tmp_path):
    path = write_map(tmp_path / "far.tif", DISCS, bounds=(5000, 5000, 5100, 5100))
    with pytest.raises(InputError, match="overlaps no lot") as caught:
        mapped(path=path)
    for extent in ("505000.0 to 505100.2 east", "500000.0 to 500180.0 east"):
        assert extent in str(caught.value)


def test_a_map_smaller_than_a_lot_or_of_one_pixel_is_taken_for_what_it_is(mapped, tmp_path):
    small = write_map(tmp_path / "small.tif", DISCS, bounds=(20, 20, 44, 44))
    pixel = write_map(
        tmp_path / "pixel.tif", [], bounds=(20, 20, 23, 23), size=3.0, values=np.full((1, 1), 100, np.uint8)
    )
    for path in (small, pixel):
        register = mapped(path=path)
        assert register.notices.count("W_LOTS_UNSEEN") == 9
        assert 0 < by_lot(register.layer("lots")).loc["a", "seen_fraction"] < 0.2


@pytest.mark.parametrize(("crs", "size"), [("EPSG:4326", 6e-6), ("EPSG:3857", 0.9), ("EPSG:25833", 0.6)])
def test_a_map_in_another_crs_gives_the_same_regions(plain, mapped, tmp_path, crs, size):
    same = by_lot(plain.layer("regions"))
    path = sampled_map(tmp_path / "other.tif", DISCS, CRS.from_user_input(crs), size)
    other = by_lot(mapped(path=path).layer("regions"))
    assert list(other.index) == list(same.index)
    big = same["area_m2"] > 20
    assert other["area_m2"][big].to_numpy() == pytest.approx(same["area_m2"][big].to_numpy(), rel=0.03)


@pytest.mark.slow
def test_a_map_half_a_pixel_off_and_of_another_size_gives_the_same_regions(plain, mapped, tmp_path):
    same = by_lot(plain.layer("regions"))
    for shift, size in ((0.3, 0.6), (0.1, 0.4), (0.0, 1.0)):
        path = write_map(
            tmp_path / f"{size}.tif", DISCS, bounds=(shift - 30, shift - 30, shift + 210, shift + 210), size=size
        )
        other = by_lot(mapped(path=path).layer("regions"))
        big = same["area_m2"] > 20
        assert other["area_m2"].reindex(same.index)[big].to_numpy() == pytest.approx(
            same["area_m2"][big].to_numpy(), rel=0.03
        )


def test_lots_in_feet_get_their_regions_in_feet(stencil, tmp_path):
    feet, metres = CRS.from_epsg(2225), CRS.from_epsg(26910)
    shift = np.array([500_000.0 - WEST, 4_300_000.0 - SOUTH])
    there = shapely.transform(np.array([lot(), *DISCS], dtype=object), lambda xy: xy + shift)
    lots_in_feet = reproject(there[:1], metres, feet)
    path = tmp_path / "coverage.tif"
    from tests.register.covering import write_percent
    from urbanforest_cli.core.polygon_raster import raster_shares
    from urbanforest_cli.core.raster_grid import RasterGrid

    west, north = 500_000.0 - 30, 4_300_000.0 + 90
    share = raster_shares(np.array([shapely.union_all(there[1:])], dtype=object), west, north, 0.6, 200, 200)[0]
    grid = RasterGrid(200, 200, (0.6, 0.0, west, 0.0, -0.6, north), metres)
    write_percent(path, np.rint(100 * share).astype(np.uint8), grid)
    register = stencil(list(lots_in_feet), crs="EPSG:2225", options={"coverage": path})
    found = register.layer("regions")
    assert CRS.from_user_input(found.crs) == feet
    assert found["area_m2"].iloc[0] == pytest.approx(np.pi * 61, rel=0.03)
    assert found.geometry.area.iloc[0] == pytest.approx(np.pi * 61 / 0.3048**2, rel=0.03)


# what is recorded, painted and kept


def test_the_key_and_the_record_know_the_map(mapped, tmp_path):
    path = write_map(tmp_path / "coverage.tif", DISCS)
    register = mapped(path=path)
    record = require_record(register.path, "stencil")
    assert {"name": path.name, "sha256": sha256_of(path)} in record.inputs
    city, plain = tmp_path / "city.gpkg", {"config": Config(), "seed": 1}
    keys = [
        stencil_key(city, **plain),
        stencil_key(city, coverage=path, **plain),
        stencil_key(city, coverage=path, config=config(wall_clearance_m=2.0), seed=1),
        stencil_key(city, keep_observed=True, **plain),
    ]
    assert len(set(keys)) == len(keys)
    assert stencil_key(city, config=config(wall_clearance_m=2.0), seed=1) == keys[0]  # no map, no matter
    assert record.stage_key == keys[1]


def test_a_painted_sketch_is_filled_as_shaded_and_the_lot_under_it_keeps_the_rest(stencil, tmp_path):
    gray = np.zeros((1, 300, 300), dtype=np.uint8)
    gray[:, 100:200, 100:200] = 153
    place = (0.6, 0.0, WEST - 30, 0.0, -0.6, SOUTH + 150)
    path = write_raster(tmp_path / "sketch.tif", gray, crs="EPSG:32633", place=place)
    register = stencil(lots(), options={"sketch": path})
    found = by_lot(register.layer("regions"))
    (painted,) = found.index
    assert painted.startswith("sketch:")
    assert found.loc[painted, "coverage"] == pytest.approx(0.6, abs=0.02)
    assert found.loc[painted, "area_m2"] == pytest.approx(3600, rel=0.02)
    active = by_lot(register.layer("active_areas"))
    assert active.loc[painted, "kind"] == "region"
    assert active.geometry["a"].intersection(active.geometry[painted]).area < 1e-6
    assert active.loc["a", "kind"] == "lot"


def test_drawn_polygons_of_a_file_replace_the_citys_own(stencil, tmp_path):
    drawn = tmp_path / "drawn.geojson"
    shape = reproject(
        np.array([box(WEST + 70, SOUTH + 5, WEST + 90, SOUTH + 25)]), CRS.from_epsg(32633), CRS.from_epsg(4326)
    )
    gpd.GeoDataFrame({"strategy": ["regular"]}, geometry=shape, crs=4326).to_file(drawn, driver="GeoJSON")
    own = box(WEST + 5, SOUTH + 5, WEST + 15, SOUTH + 15)
    register = stencil(lots(), layers={"sketches": [own]}, options={"sketch": drawn})
    areas = register.layer("active_areas")
    sketch = areas[areas["kind"] == "sketch"]
    assert len(sketch) == 1
    assert sketch["area_m2"].iloc[0] == pytest.approx(400, rel=0.01)


def test_known_plants_are_written_and_keep_their_lot_out_of_the_skipped(mapped):
    points = [shapely.Point(WEST + 150, SOUTH + 30), shapely.Point(WEST + 30, SOUTH + 31)]
    register = mapped(layers={"observed_plants": points}, keep_observed=True)
    known = register.layer("observed")
    check_layer(known, "observed")
    assert known["lot_id"].tolist() == ["c", "a"]
    assert "c" not in register.reasons()
    assert "i" in register.reasons()
    assert register.summary.counts["observed_kept"] == 2


def test_known_plants_that_are_not_there_cannot_be_kept(mapped):
    with pytest.raises(InputError, match="observed_plants"):
        mapped(keep_observed=True)


def test_without_a_map_nothing_is_known_of_vegetation(stencil):
    register = stencil(lots())
    assert len(register.layer("regions")) == 0
    assert by_lot(register.layer("lots"))["covered_fraction"].isna().all()
    assert "lots_filled" not in register.summary.counts
