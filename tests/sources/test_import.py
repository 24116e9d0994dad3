"""Import: from what people have to a city file, nothing lost without a word."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from tests.sources.pbf import write_pbf
from urbanforest_cli.core.errors import ConfigError, OutputExistsError, UrbanForestError
from urbanforest_cli.files.configs import configs_folder
from urbanforest_cli.sources.stage import RoleSource, import_city, load_profile, profile_names

METRES = "EPSG:32633"
WEST, SOUTH = 500_000.0, 5_300_000.0


def at(x: float, y: float, width: float = 20.0, depth: float = 20.0) -> Polygon:
    return box(WEST + x, SOUTH + y, WEST + x + width, SOUTH + y + depth)


def line(*corners: tuple[float, float]) -> LineString:
    return LineString([(WEST + x, SOUTH + y) for x, y in corners])


def point(x: float, y: float) -> Point:
    return Point(WEST + x, SOUTH + y)


def frame(shapes: list[Any], crs: str = METRES, **columns: object) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(dict(columns), geometry=shapes, crs=METRES).to_crs(crs)


def write(path: Path, **layers: gpd.GeoDataFrame) -> Path:
    for name, content in layers.items():
        pyogrio.write_dataframe(content, path, layer=name, append=path.exists())
    return path


def layer(city: Path, name: str) -> gpd.GeoDataFrame:
    return pyogrio.read_dataframe(city, layer=name, use_arrow=True)


def layers_of(city: Path) -> set[str]:
    return {str(name) for name in pyogrio.list_layers(city)[:, 0]} - {"layer_styles", "import_sources"}


def zones_under(city: Path, *points: Point) -> list[str]:
    lots = layer(city, "lots").to_crs(METRES)
    return [lots["zone"][lots.contains(place)].item() for place in points]


@pytest.fixture
def city(tmp_path: Path) -> Path:
    return tmp_path / "city.gpkg"


def test_pluto_gives_zones_by_land_use_and_keeps_its_feet(tmp_path: Path, city: Path) -> None:
    uses = ["01", "04", "6", "99", None]
    lots = frame([at(30 * i, 0) for i in range(5)], "EPSG:2263", LandUse=uses, BBL=[4005740001.0 + i for i in range(5)])
    lots = lots.assign(Address="x")
    summary = import_city([str(write(tmp_path / "a.gpkg", MapPLUTO=lots))], city, profile="nyc-pluto")
    found = layer(city, "lots")
    assert found["zone"].tolist() == ["residential", "commercial", "industrial", "other", "other"]
    assert found["lot_id"].tolist() == [str(4005740001 + i) for i in range(5)]
    assert found["zone_code"].fillna("").tolist() == ["01", "04", "6", "99", ""]
    assert found["Address"].tolist() == ["x"] * 5
    assert found.crs == "EPSG:2263"
    assert summary.notices.count("W_ZONE_UNKNOWN") == 1
    assert summary.notices.count("W_ZONE_MISSING") == 1
    assert {(row["code"], row["zone"], row["lots"], row["known"]) for row in summary.zones} >= {
        ("99", "other", 1, False), (None, "other", 1, False), ("01", "residential", 1, True),
    }  # fmt: skip


def test_french_parcels_take_the_zone_of_the_plan_that_covers_them(tmp_path: Path, city: Path) -> None:
    parcels = frame([at(0, 0), at(20, 0), at(40, 0), at(300, 0)], id=["a", "b", "c", "d"])
    plan = frame(
        [at(0, 0, 28, 20), at(28, 0, 40, 20)], LIBELLE=["UH1", "UX2"],
        LIBELONG=["Secteur pavillonnaire", "Zone d'activités"], TYPEZONE=["U", "U"],
    )  # fmt: skip
    trees = frame(
        [line((0, 50), (80, 50)), line((0, 60), (80, 60))], LIBELLE=["Alignement à préserver", "Alignement à créer"]
    )
    source = write(tmp_path / "a.gpkg", parcelles=parcels, zone_urba=plan, prescription_lin=trees)
    summary = import_city([str(source)], city, profile="fr-cadastre")
    lots = layer(city, "lots").set_index("lot_id")
    assert lots["zone"].to_dict() == {"a": "residential", "b": "industrial", "c": "industrial", "d": "other"}
    assert lots["zone_code"]["b"] == "libelong=Zone d'activités"
    observed = layer(city, "observed_plants")
    assert len(observed) == 11
    assert observed.geometry.y.to_numpy() == pytest.approx(SOUTH + 50)
    assert summary.notices.count("W_TREE_ROW") == 11


def osm_corner() -> tuple[dict[int, tuple[float, float, dict[str, str]]], dict[int, tuple[list[int], dict[str, str]]]]:
    """A block of 200 x 100 m between four streets, two houses in it, a park beside them, trees and a hydrant."""
    nodes: dict[int, tuple[float, float, dict[str, str]]] = {}
    ways: dict[int, tuple[list[int], dict[str, str]]] = {}

    def node(x: float, y: float, **tags: str) -> int:
        lon, lat = shapely.get_coordinates(gpd.GeoSeries([point(x, y)], crs=METRES).to_crs(4326).to_numpy())[0]
        nodes[len(nodes) + 1] = (lon, lat, tags)
        return len(nodes)

    def way(*corners: tuple[float, float], closed: bool = False, **tags: str) -> None:
        refs = [node(x, y) for x, y in corners]
        ways[100 + len(ways)] = (
            [*refs, refs[0]] if closed else refs,
            {k.replace("__", ":"): v for k, v in tags.items()},
        )

    way((0, 0), (200, 0), (200, 100), (0, 100), closed=True, highway="residential", lanes="2")
    way((10, 10), (30, 10), (30, 40), (10, 40), closed=True, building="house", building__levels="2")
    way((60, 10), (90, 10), (90, 40), (60, 40), closed=True, building="retail", height="12 m")
    way((100, 0), (200, 0), (200, 100), (100, 100), closed=True, leisure="park")
    way((20, 60), (60, 60), natural="tree_row")
    way((0, 50), (200, 50), highway="footway")
    way((50, 0), (50, 100), highway="residential", tunnel="yes")
    node(150, 50, natural="tree", species="Tilia cordata", height="9")
    node(5, 5, emergency="fire_hydrant")
    node(20, 10, entrance="main")
    return nodes, ways


def test_an_osm_extract_becomes_a_city_with_derived_lots(tmp_path: Path, city: Path) -> None:
    source = tmp_path / "corner.osm.pbf"
    write_pbf(source, *osm_corner())
    summary = import_city([str(source)], city, profile="osm")
    assert layers_of(city) == {"lots", "buildings", "roads", "obstacles", "entrances", "observed_plants"}
    lots = layer(city, "lots").to_crs(METRES)
    assert lots["lot_id"].is_unique
    assert sorted(lots["zone"].unique()) == ["commercial", "other", "residential"]
    buildings = layer(city, "buildings").to_crs(METRES)
    assert sorted(buildings["height_m"]) == [6.0, 12.0]
    # Each building stands in a lot of its own, and the house's lot is for living.
    home = lots[lots.contains(buildings.geometry[buildings["height_m"] == 6.0].iloc[0].centroid)]
    assert home["zone"].tolist() == ["residential"]
    roads = layer(city, "roads")
    assert sorted(roads["width_m"]) == [2.0, 6.5]
    assert layer(city, "obstacles")["kind"].tolist() == ["hydrant"]
    observed = layer(city, "observed_plants")
    assert len(observed) == 7
    assert observed["species"].dropna().tolist() == ["Tilia cordata"]
    assert "W_LOTS_DERIVED" in summary.notices
    assert layer(city, "lots").crs == "EPSG:4326"


def test_osm_layers_in_a_geopackage_do_as_well(tmp_path: Path, city: Path) -> None:
    roads = frame([line((0, 0), (90, 0), (90, 90), (0, 90), (0, 0))], highway=["residential"])
    houses = frame([at(10, 10), at(50, 50)], building=["apartments", "industrial"], levels=["4", None])
    landuse = frame([at(-10, -10, 45, 120)], landuse=["retail"], leisure=[None])
    import_city([str(write(tmp_path / "a.gpkg", osm_roads=roads, osm_buildings=houses, osm_landuse=landuse))], city,
                profile="osm")  # fmt: skip
    assert zones_under(city, point(20, 20), point(60, 60)) == ["commercial", "industrial"]
    assert layer(city, "roads")["width_m"].tolist() == [6.0]
    assert layer(city, "buildings")["height_m"].dropna().tolist() == [12.0]


def bgt(tmp_path: Path, **more: gpd.GeoDataFrame) -> Path:
    history = "eindRegistratie"
    return write(
        tmp_path / "bgt.gpkg",
        pand=frame([at(5, 5, 10, 10), at(40, 5, 10, 10)], lokaalID=["p1", "p2"], **{history: [None, "2020-01-01"]}),
        wegdeel=frame(
            [at(0, -10, 100, 8), at(20, 0, 4, 20), at(0, -12, 100, 2)],
            **{"bgt-functie": ["rijbaan lokale weg", "inrit", "voetpad"], history: [None] * 3},
        ),
        onbegroeidterreindeel=frame(
            [at(0, 0), at(60, 0)], lokaalID=["e1", "v1"],
            **{"bgt-fysiekVoorkomen": ["erf", "gesloten verharding"], history: [None] * 2},
        ),
        begroeidterreindeel=frame(
            [at(30, 0)], lokaalID=["g1"], **{"bgt-fysiekVoorkomen": ["groenvoorziening"], history: [None]}
        ),
        vegetatieobject=frame([point(31, 1), point(32, 1)], **{"plus-type": ["boom", "haag"], history: [None] * 2}),
        paal=frame([point(50, 1)], **{"plus-type": ["lichtmast"], history: [None]}),
        waterdeel=frame([at(0, 60)], **{history: [None]}),
        **more,
    )  # fmt: skip


def test_bgt_without_parcels_takes_yards_and_greens_as_lots(tmp_path: Path, city: Path) -> None:
    import_city([str(bgt(tmp_path))], city, profile="nl-bgt")
    lots = layer(city, "lots").set_index("lot_id")
    assert lots["zone"].to_dict() == {"g1": "other", "e1": "residential"}
    assert len(layer(city, "buildings")) == 1
    assert layer(city, "roads")["kind"].tolist() == ["rijbaan lokale weg"]
    assert len(layer(city, "driveways")) == 1
    assert len(layer(city, "observed_plants")) == 1
    assert sorted(layer(city, "obstacles")["kind"]) == ["mast", "water"]


def test_bgt_with_parcels_takes_them_and_the_zones_of_the_plan(tmp_path: Path, city: Path) -> None:
    parcels = frame([at(0, 0, 30, 30), at(30, 0, 30, 30)], identificatie_lokaal_id=["1", "2"])
    plan = frame([at(-5, -5, 34, 50), at(29, -5, 60, 50)], bestemmingshoofdgroep=["Wonen", "Bedrijventerrein"])
    import_city([str(bgt(tmp_path, perceel=parcels, enkelbestemming=plan))], city, profile="nl-bgt")
    lots = layer(city, "lots").set_index("lot_id")["zone"]
    assert lots["1"] == "residential"
    assert lots["2"] == "industrial"
    assert "e1" not in lots


def test_overture_parquet_with_nested_columns_becomes_a_city(tmp_path: Path, city: Path) -> None:
    wgs = "EPSG:4326"
    streets = frame(
        [line((0, 0), (90, 0), (90, 90), (0, 90), (0, 0)), line((45, 0), (45, 90)), line((0, 45), (90, 45))], wgs,
        subtype=["road", "road", "rail"], **{"class": ["residential", "footway", "tram"]},
        width_rules=[[{"value": 8.0, "between": None}], None, None], names=[{"primary": "A"}, None, None],
    )  # fmt: skip
    streets.to_parquet(tmp_path / "segment.parquet")
    houses = frame(
        [at(10, 10), at(60, 60)], wgs, height=[9.5, None], num_floors=[None, 2], subtype=["residential", None]
    )
    houses.to_parquet(tmp_path / "building.parquet")
    frame([at(35, 35, 80, 80)], wgs, subtype=["developed"], **{"class": ["industrial"]}).to_parquet(
        tmp_path / "land_use.parquet"
    )
    frame([point(20, 70)], wgs, subtype=["tree"], **{"class": ["tree"]}).to_parquet(tmp_path / "land.parquet")
    names = ("segment", "building", "land_use", "land")
    import_city([str(tmp_path / f"{name}.parquet") for name in names], city, profile="overture")
    assert layer(city, "roads")["width_m"].tolist() == [8.0, 2.0]
    assert sorted(layer(city, "buildings")["height_m"]) == [6.0, 9.5]
    assert zones_under(city, point(20, 20), point(70, 70)) == ["residential", "industrial"]
    assert layer(city, "obstacles")["kind"].tolist() == ["rail"]
    assert len(layer(city, "observed_plants")) == 1


def test_layers_named_one_by_one_meet_in_the_crs_of_the_lots(tmp_path: Path, city: Path) -> None:
    lots = write(
        tmp_path / "lots.gpkg", parcels=frame([at(0, 0), at(20, 0)], pid=[2**53 + 1, 7], use=["Commercial", "farm"])
    )
    houses = write(tmp_path / "b.gpkg", a=frame([at(5, 5, 5, 5)], "EPSG:4326", h=["40 ft"]), b=frame([at(0, 0)]))
    roads = write(tmp_path / "r.gpkg", r=frame([line((0, -5), (40, -5))], "EPSG:3857", w=[6]))
    more = write(
        tmp_path / "m.gpkg", doors=frame([point(5, 5)], kind=["door"]),
        pipes=frame([line((0, 1), (9, 1))], kind=["pipe"]),
        drawn=frame([at(1, 1, 3, 3)], strategy=["regular"], grid_size_m=[7.0], author=["me"]),
        trees=frame([shapely.MultiPoint([point(1, 1), point(2, 2)])]), drives=frame([line((1, -5), (1, 5))]),
    )  # fmt: skip
    roles = {
        "lots": RoleSource(str(lots), {"id": "pid", "zone": "use"}),
        "buildings": RoleSource(f"{houses}:a", {"height": "h"}),
        "roads": RoleSource(str(roads), {"width": "w"}),
        "entrances": RoleSource(f"{more}:doors"),
        "obstacles": RoleSource(f"{more}:pipes"),
        "sketches": RoleSource(f"{more}:drawn"),
        "driveways": RoleSource(f"{more}:drives"),
        "observed_plants": RoleSource(f"{more}:trees"),
    }
    import_city([], city, roles=roles)
    assert layers_of(city) == set(roles)
    assert {layer(city, name).crs.to_epsg() for name in roles} == {32633}
    found = layer(city, "lots")
    assert found["lot_id"].tolist() == [str(2**53 + 1), "7"]
    assert found["zone"].tolist() == ["commercial", "other"]
    assert layer(city, "buildings")["height_m"][0] == pytest.approx(12.192)
    assert layer(city, "roads")["width_m"].tolist() == [6.0]
    assert layer(city, "roads").total_bounds == pytest.approx([WEST, SOUTH - 5, WEST + 40, SOUTH - 5], abs=0.01)
    assert layer(city, "sketches").iloc[0][["strategy", "grid_size_m"]].tolist() == ["regular", 7.0]
    assert "author" not in layer(city, "sketches")
    assert len(layer(city, "observed_plants")) == 2


def test_a_layer_given_by_option_replaces_what_the_profile_would_take(tmp_path: Path, city: Path) -> None:
    source = write(tmp_path / "a.gpkg", MapPLUTO=frame([at(0, 0)], landuse=["01"]), mine=frame([at(0, 0), at(20, 0)]))
    import_city([str(source)], city, profile="nyc-pluto", roles={"lots": RoleSource(f"{source}:mine")})
    assert len(layer(city, "lots")) == 2


def test_lots_on_the_same_ground_are_one_and_ids_stay_apart(tmp_path: Path, city: Path) -> None:
    shapes = [at(0, 0), at(0, 0), at(20, 0), at(40, 0), None]
    source = write(tmp_path / "a.gpkg", lots=frame(shapes, pid=["a", "b", "a", None, "z"]))
    summary = import_city([], city, roles={"lots": RoleSource(str(source), {"id": "pid"})})
    assert layer(city, "lots")["lot_id"].tolist() == ["a", "a.2", "row 4"]
    codes = {notice.code: notice.count for notice in summary.notices}
    assert codes["W_SAME_GROUND"] == codes["W_ID_REPEATED"] == codes["W_NO_ID"] == codes["W_NO_GEOMETRY"] == 1


def test_own_parameters_and_plain_columns_of_lots_are_kept(tmp_path: Path, city: Path) -> None:
    lots = frame([at(0, 0)], lot_id=["a"], zone=["residential"], radius_mean_m=[2.5], Zone_Code=["x"], owner=["é"])
    import_city([], city, roles={"lots": RoleSource(str(write(tmp_path / "a.gpkg", l=lots)))})
    found = layer(city, "lots").iloc[0]
    assert found[["lot_id", "zone", "radius_mean_m", "owner"]].tolist() == ["a", "residential", 2.5, "é"]


def test_no_lots_at_all_is_an_empty_city_with_a_warning(tmp_path: Path, city: Path) -> None:
    source = write(tmp_path / "a.gpkg", lots=frame([], pid=np.array([], dtype=str)))
    summary = import_city([], city, roles={"lots": RoleSource(str(source))})
    assert len(layer(city, "lots")) == 0
    assert "W_EMPTY" in summary.notices


def test_the_city_says_what_it_was_made_from(tmp_path: Path, city: Path) -> None:
    source = write(tmp_path / "a.gpkg", MapPLUTO=frame([at(0, 0)], landuse=["01"]), other=frame([at(0, 0)]))
    summary = import_city([str(source)], city, profile="nyc-pluto")
    record = pyogrio.read_dataframe(city, layer="import_sources")
    assert record[["layer", "source", "taken", "profile"]].to_numpy().tolist() == [
        ["lots", "a.gpkg:MapPLUTO", 1, "nyc-pluto"]
    ]
    assert len(record["sha256"][0]) == 64
    assert [entry["source"] for entry in summary.left] == ["a.gpkg:other"]


def refused(reason: str, *arguments: Any, **options: Any) -> UrbanForestError:
    with pytest.raises(UrbanForestError, match=reason) as caught:
        import_city(*arguments, **options)
    return caught.value


def test_what_cannot_be_done_is_said_and_nothing_is_left(tmp_path: Path, city: Path) -> None:
    source = write(tmp_path / "a.gpkg", lots=frame([at(0, 0)], pid=["a"]))
    roles = {"lots": RoleSource(str(source))}
    before = sorted(tmp_path.iterdir())
    refused("need a profile", [str(source)], city)
    refused("nothing to import", [], city)
    refused("no such profile", [str(source)], city, profile="nyc")
    refused("no column 'zone'", [], city, roles={"lots": RoleSource(str(source), {"zone": "zone"})})
    refused("did you mean --lot-id pid", [], city, roles={"lots": RoleSource(str(source), {"id": "pidd"})})
    refused("one of the sources", [], source, roles=roles, overwrite=True)
    refused("neither lots, nor streets", [str(source)], city, profile="overture")
    refused("no layer 'x'", [f"{source}:x"], city, profile="osm")
    refused("no such file", [str(tmp_path / "b.gpkg")], city, profile="osm")
    for name in ("http://example.org/a.gpkg", "/vsicurl/x", "a\0b.gpkg", str(tmp_path)):
        refused("only local|no such|reached|folder", [], city, roles={"lots": RoleSource(name)})
    assert sorted(tmp_path.iterdir()) == before
    import_city([], city, roles=roles)
    assert isinstance(refused("there already", [], city, roles=roles), OutputExistsError)
    import_city([], city, roles=roles, overwrite=True)


@pytest.mark.parametrize("name", ["fr-cadastre", "nl-bgt", "nyc-pluto", "osm", "overture"])
def test_every_shipped_profile_is_sound(name: str) -> None:
    assert name in profile_names()
    profile = load_profile(name)
    zones = {zone for rules in (profile.lots, profile.zoning, profile.buildings) for rule in rules
             for table in rule.zones for zone in table.codes.values()}  # fmt: skip
    assert zones <= {"residential", "commercial", "industrial", "street", "other"}
    assert profile.title


def test_a_profile_of_ones_own_lists_all_its_mistakes(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[[lots]]\nlayer = ["a"]\nlayers = ["a"]\n[[roads]]\nlayers = ["b"]\nlane_width_m = -1\n')
    with pytest.raises(ConfigError) as caught:
        load_profile(str(path))
    assert "lots.0.layer" in str(caught.value)
    assert "roads.0.lane_width_m" in str(caught.value)
    path.write_text((configs_folder() / "sources" / "osm.toml").read_text())
    assert load_profile(str(path)) == load_profile("osm")


def test_the_command_prints_zones_and_json(tmp_path: Path, city: Path, runner: Callable[..., Any]) -> None:
    source = write(tmp_path / "a.gpkg", MapPLUTO=frame([at(0, 0), at(20, 0)], landuse=["01", "77"]))
    shown = runner("import", source, "--profile", "nyc-pluto", "-o", city)
    assert shown.exit_code == 0
    assert "not in the profile" in shown.stdout
    assert "1 of" not in shown.stderr
    again = runner("import", source, "--profile", "nyc-pluto", "-o", city)
    assert again.exit_code == 2
    record = json.loads(runner("import", source, "--profile", "nyc-pluto", "-o", city, "--overwrite", "--json").stdout)
    assert record["counts"] == {"lots": 2}
    assert {row["code"] for row in record["zones"]} == {"01", "77"}
    wrong = runner("import", "--lot-id", "x", "-o", city)
    assert wrong.exit_code == 2
    assert "--lots" in wrong.stderr


def test_options_of_the_command_name_every_layer(tmp_path: Path, city: Path, runner: Callable[..., Any]) -> None:
    source = write(
        tmp_path / "a.gpkg", lots=frame([at(0, 0)], pid=["a"], z=["street"]), b=frame([at(1, 1, 3, 3)], h=[4.0]),
        r=frame([line((0, -5), (20, -5))], w=[5.0]), t=frame([point(1, 1)]),
    )  # fmt: skip
    shown = runner(
        "import", "--lots", f"{source}:lots", "--lot-id", "pid", "--zone", "z", "--buildings", f"{source}:b",
        "--height", "h", "--roads", f"{source}:r", "--road-width", "w", "--observed", f"{source}:t", "-o", city, "-q",
    )  # fmt: skip
    assert (shown.exit_code, shown.stdout) == (0, "")
    assert layers_of(city) == {"lots", "buildings", "roads", "observed_plants"}
    assert layer(city, "lots")["zone"].tolist() == ["street"]


REAL: list[tuple[str, list[str], dict[str, Any], dict[str, tuple[int, int]]]] = [
    ("nyc_astoria/astoria.gpkg", ["{}"], {"profile": "nyc-pluto"}, {"lots": (2195, 2196)}),
    ("bondy/bondy.gpkg", ["{}"], {"profile": "fr-cadastre"}, {"lots": (7124, 7124), "observed_plants": (2000, 3000)}),
    ("del_mar/delmar.gpkg", [], {"roles": {"lots": RoleSource("{}:parcels")}}, {"lots": (1898, 1898)}),
    (
        "tokyo_chiyoda/tokyo_chiyoda.gpkg", ["{}"],
        {"profile": "osm", "roles": {"observed_plants": RoleSource("{}:trees")}},
        {"lots": (3400, 3600), "observed_plants": (1107, 1107)},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "sources", "options", "counts"), REAL, ids=[row[0].split("/")[0] for row in REAL])
def test_real_cities_come_in_with_no_hand_edits(
    name: str,
    sources: list[str],
    options: dict[str, Any],
    counts: dict[str, tuple[int, int]],
    real_data: Path,
    city: Path,
) -> None:
    place = str(real_data / name)
    roles = {role: RoleSource(given.source.format(place)) for role, given in options.get("roles", {}).items()}
    summary = import_city([text.format(place) for text in sources], city, profile=options.get("profile"), roles=roles)
    for role, (least, most) in counts.items():
        assert least <= summary.counts[role] <= most
    lots = layer(city, "lots")
    assert lots["lot_id"].is_unique
    assert lots["zone"].notna().all()
    assert lots.geometry.is_valid.all()
    assert set(lots.geom_type) <= {"Polygon", "MultiPolygon"}
    assert pd.api.types.is_object_dtype(lots["lot_id"]) or pd.api.types.is_string_dtype(lots["lot_id"])


@pytest.mark.slow
def test_santa_monica_gets_a_lot_for_nearly_every_building(real_data: Path, city: Path) -> None:
    place = real_data / "santa_monica" / "santa_monica.gpkg"
    roles = {
        "buildings": RoleSource(f"{place}:buildings", {"height": "height_m"}),
        "roads": RoleSource(f"{place}:street_lines"),
    }
    import_city([], city, roles=roles)
    lots, buildings = layer(city, "lots"), layer(city, "buildings")
    held = shapely.STRtree(lots.geometry.to_numpy()).query(buildings.representative_point().to_numpy(), "intersects")
    assert len(np.unique(held[1])) > 0.95 * len(buildings)
    one, other = shapely.STRtree(lots.geometry.to_numpy()).query(lots.geometry.to_numpy(), predicate="overlaps")
    assert (
        len(one) == 0
        or shapely.area(shapely.intersection(lots.geometry.to_numpy()[one], lots.geometry.to_numpy()[other])).max()
        < 0.1
    )
