"""Registers planted: lots filled from a coverage map, known plants kept, lots that did not change left alone."""

from __future__ import annotations

import shutil
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pytest
import shapely
from shapely.geometry import Point, box

from tests.register.covering import SOUTH, WEST, disc, write_map
from urbanforest_cli.core.config import Config, Species
from urbanforest_cli.core.schema import LAYERS, check_layer
from urbanforest_cli.files.geopackage import read_layer, write_layers
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.placement import stage
from urbanforest_cli.placement.stage import place_key, place_plants
from urbanforest_cli.register.stage import stencil_city

CRS = "EPSG:32633"
SIZE = 60.0
IDS = "abcdefghi"
APART = [(15, 15, 3.0), (40, 12, 4.0), (45, 45, 5.0), (12, 45, 2.0)]
WOOD = box(WEST + 65, SOUTH + 5, WEST + 118, SOUTH + 55)
HOUSE = box(WEST + 60, SOUTH + 120, WEST + 120, SOUTH + 180)
UNSEEN = box(WEST + 120, SOUTH - 5, WEST + 220, SOUTH + 200)
STRATEGY = ["random", "random", "random", "random", "random", "boundary", "random", "random", "regular"]
"""Lots a (crowns apart), b (wood) and e (one crown over the border of d) are seen; d and g are bare, h is all house;
the map does not know c, f and i."""
KNOWN = {
    "1": (15, 15, 6.0, None, None), "2": (90, 30, 9.0, 12.0, "acer_platanoides"), "3": (150, 30, 8.0, None, "no_tree"),
    "4": (130, 66, None, None, None), "5": (150, 150, 5.0, 7.0, None), "6": (30, 150, 4.0, None, None),
    "7": (90, 150, 4.0, None, None), "8": (150, 122, 9.0, None, None),
}  # fmt: skip
"""Id: east, north, crown diameter, height, species; in a, b, c, f, i, g (bare), h (all house) and i (at its border)."""


def lots():
    return [box(WEST + SIZE * i, SOUTH + SIZE * j, WEST + SIZE * (i + 1), SOUTH + SIZE * (j + 1))
            for j in range(3) for i in range(3)]  # fmt: skip


def crowns():
    return [*(disc(*item) for item in APART), WOOD, disc(62, 90, 4), disc(90, 90, 6), disc(80, 70, 3)]


def config(conflict="lot", **sections):
    zone = {"radius_mean_m": 2.5, "density": 0.6, "grid_size_m": 7.0}
    return Config.model_validate(
        {"zones": {"default": zone}, "rules": {"derive_street_lots": False}, "context": {"passes": 0},
         "placement": {"conflict": conflict}, **sections}
    )  # fmt: skip


SETTINGS = config()


def write_register(folder, *, keep=False, covering=None, known=None, mapped=True):
    city, path = folder / "city.gpkg", folder / "register.gpkg"
    layers = {
        "lots": gpd.GeoDataFrame(
            {"lot_id": list(IDS), "zone": "default", "strategy": STRATEGY}, geometry=lots(), crs=CRS
        ),
        "buildings": gpd.GeoDataFrame({"height_m": [6.0]}, geometry=[HOUSE], crs=CRS),
    }
    if keep:
        rows = KNOWN if known is None else known
        names = ("crown_diameter_m", "height_m", "species")
        layers["observed_plants"] = gpd.GeoDataFrame(
            {"id": list(rows), **{name: [row[2 + k] for row in rows.values()] for k, name in enumerate(names)}},
            geometry=[Point(WEST + row[0], SOUTH + row[1]) for row in rows.values()], crs=CRS,
        )  # fmt: skip
    write_layers(city, layers, fresh=True, geometry_types={n: str(f.geom_type.iloc[0]) for n, f in layers.items()})
    shown = crowns() if covering is None else covering
    coverage = write_map(folder / "coverage.tif", shown, unknown=UNSEEN) if mapped else None
    stencil_city(city, path, config=config(), seed=1, coverage=coverage, keep_observed=keep)
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return write_register(tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def keeping(tmp_path_factory):
    return write_register(tmp_path_factory.mktemp("keeping"), keep=True)


@pytest.fixture(scope="module")
def by_rules(tmp_path_factory):
    return write_register(tmp_path_factory.mktemp("rules"), keep=True, mapped=False)


class Placed:
    def __init__(self, path, summary):
        self.path, self.summary = path, summary
        self.plants = read_layer(path, "plants")
        self.placements = read_layer(path, "placements").set_index("lot_id")
        for name in ("plants", "placements", "skipped"):
            check_layer(read_layer(path, name), name)

    def of(self, lot_id):
        return self.plants[self.plants["lot_id"] == lot_id]

    def union(self, lot_ids=IDS):
        rows = self.plants[self.plants["lot_id"].isin(list(lot_ids))]
        return shapely.union_all(shapely.buffer(rows.geometry.to_numpy(), rows["envelope_radius_m"].to_numpy()))

    @property
    def observed(self):
        return self.plants[self.plants["plant_id"].str.startswith("observed:")].set_index("plant_id")

    def same_as(self, other, lot_ids=IDS):
        mine, its = (p.plants[p.plants["lot_id"].isin(list(lot_ids))].reset_index(drop=True) for p in (self, other))
        return mine.equals(its)


@pytest.fixture
def place(tmp_path):
    """Plant a copy of a register."""
    made = []

    def run(register, *, seed=1, workers=1, config=SETTINGS, **options):
        path = tmp_path / f"{len(made)}.gpkg"
        made.append(path)
        shutil.copy(register, path)
        return Placed(path, place_plants(path, config=config, seed=seed, workers=workers, **options))

    return run


def set_column(register, layer, column, lot_id, value):
    frame = read_layer(register, layer)
    frame.loc[frame["lot_id"] == lot_id, column] = value
    write_layers(
        register, {layer: frame}, geometry_types={layer: LAYERS[layer].geometry} if "geometry" in frame else {}
    )


def test_lots_are_covered_as_the_map_shows(plain, place):
    found = place(plain)
    regions = read_layer(plain, "regions").set_index("lot_id")
    assert sorted(regions.index) == list("abe")
    assert found.summary.counts["lots_from_map"] == 3
    for lot_id in regions.index:
        here = found.union(lot_id)
        assert here.area == pytest.approx(regions.loc[lot_id, "area_m2"], rel=0.05)
        assert shapely.intersection(here, regions.geometry[lot_id]).area > 0.88 * here.area
    assert [found.placements.loc[lot_id, "plant_count"] for lot_id in "ae"] == [4, 3]
    for x, y, radius in APART:
        nearest = found.of("a").geometry.distance(Point(WEST + x, SOUTH + y))
        assert nearest.min() < 0.25
        assert found.of("a").loc[nearest.idxmin(), "envelope_radius_m"] == pytest.approx(radius, abs=0.2)
    assert found.of("d").empty
    assert found.of("g").empty
    assert (found.placements.loc[list("cfi"), "plant_count"] > 3).all()  # not known: planted by rules
    assert "plants_observed" not in found.summary.counts


def test_ids_are_lot_and_number_and_stems_stand_in_their_ground(plain, place):
    found = place(plain)
    areas = read_layer(plain, "active_areas").set_index("lot_id").geometry
    for lot_id in "abe":
        rows = found.of(lot_id)
        assert rows["plant_id"].tolist() == [f"{lot_id}-{i}" for i in range(len(rows))]
        assert shapely.covers(areas[lot_id], rows.geometry.to_numpy()).all()
        assert shapely.covers(lots()[IDS.index(lot_id)], rows.geometry.to_numpy()).all()


def test_density_does_not_thin_what_the_map_shows(plain, place, tmp_path):
    before = place(plain)
    sparse = tmp_path / "sparse.gpkg"
    shutil.copy(plain, sparse)
    for lot_id in "abc":
        set_column(sparse, "parameters", "density", lot_id, 0.05)
    after = place(sparse)
    assert after.same_as(before, "abe")
    assert len(after.of("c")) < 0.3 * len(before.of("c"))
    assert (after.placements.loc[list("ab"), "outcome"] == "planted").all()


def test_workers_and_batches_change_nothing(keeping, place, monkeypatch):
    first = place(keeping)
    monkeypatch.setattr(stage, "REGIONS_A_BATCH", 1)
    monkeypatch.setattr(stage, "LOTS_A_BATCH", 2)
    assert place(keeping, workers=3).same_as(first)


def test_a_seed_varies_closed_canopy_and_not_what_the_map_decides(plain, place):
    first, other = place(plain, seed=1), place(plain, seed=2)
    mine, its = (sorted((round(p.x, 2), round(p.y, 2)) for p in found.of("b").geometry) for found in (first, other))
    assert not set(mine) & set(its)
    assert len(mine) == pytest.approx(len(its), rel=0.25)
    for lot_id in "ae":
        apart = [found.of(lot_id).geometry for found in (first, other)]
        assert max(apart[1].distance(point).min() for point in apart[0]) < 0.1


def test_only_lots_whose_region_changed_are_planted_again(plain, place, tmp_path):
    first = place(plain)
    covering = crowns()
    covering[0] = disc(15, 15, 3.6)
    changed = write_register(tmp_path, covering=covering)
    again = place(changed, previous=first.path)
    assert again.summary.counts["lots_reused"] == len(first.placements) - 1
    assert again.same_as(first, "bcdefghi")
    assert again.of("a")["envelope_radius_m"].max() == pytest.approx(5.0, abs=0.2)
    assert not again.same_as(first, "a")
    assert again.same_as(place(changed))  # as if nothing had been planted before
    assert place(plain, previous=first.path).summary.counts["lots_reused"] == len(first.placements)


def test_a_share_to_be_covered_changes_its_lot_alone(plain, place, tmp_path):
    first = place(plain)
    half = tmp_path / "half.gpkg"
    shutil.copy(plain, half)
    set_column(half, "regions", "coverage", "b", 0.5)
    again = place(half, previous=first.path)
    assert again.summary.counts["lots_reused"] == len(first.placements) - 1
    assert again.union("b").area == pytest.approx(0.5 * WOOD.area, rel=0.1)
    assert again.same_as(first, "acdefghi")


def test_a_region_that_changes_beyond_the_lot_changes_its_lot_alone(plain, place, tmp_path):
    first = place(plain)
    wider = tmp_path / "wider.gpkg"
    shutil.copy(plain, wider)
    whole = read_layer(wider, "regions").set_index("lot_id").geometry["b"]
    set_column(wider, "regions", "geometry", "b", shapely.MultiPolygon([whole.union(box(*WOOD.bounds).buffer(8))]))
    again = place(wider, previous=first.path)
    assert again.summary.counts["lots_reused"] == len(first.placements) - 1
    assert again.union("b").area > 1.1 * first.union("b").area
    assert again.same_as(first, "acdefghi")


def test_settings_of_coverage_and_sizes_of_species_decide_the_result():
    catalogue = load_catalogue(Species())
    key = place_key("", config=config(), seed=1, catalogue=catalogue)
    assert key == place_key("", config=config(), seed=1, catalogue=catalogue)
    assert key != place_key("", config=config(coverage={"crown_overlap": 0.4}), seed=1, catalogue=catalogue)

    def with_first(**changes):
        return replace(catalogue, species=(replace(catalogue.species[0], **changes), *catalogue.species[1:]))

    first = catalogue.species[0]
    wider = replace(first.open_grown, crown_radius_m=tuple(1.1 * r for r in first.open_grown.crown_radius_m))
    assert key != place_key("", config=config(), seed=1, catalogue=with_first(open_grown=wider))
    slower = replace(first.growth, internode_length_m=first.growth.internode_length_m * 0.9)
    assert key == place_key("", config=config(), seed=1, catalogue=with_first(growth=slower))


def test_too_many_plants_in_a_region_are_refused_and_counted(plain, place):
    found = place(plain, config=config(placement={"max_plants_per_lot": 12}))
    assert found.placements.loc["b", "outcome"] == "too_many_plants"
    assert found.of("b").empty
    assert found.placements.loc["a", "plant_count"] == 4
    skipped = read_layer(found.path, "skipped").set_index("lot_id")["reason"]
    assert skipped["b"] == "too_many_plants"
    assert "b" in str(found.summary.notices.as_records())


def test_known_plants_stand_as_they_are(keeping, place):
    found = place(keeping)
    known = found.observed
    assert sorted(known.index) == [f"observed:{i}" for i in range(1, 9)]
    assert found.summary.counts["plants_observed"] == 8
    for name, (x, y, diameter, _, _) in KNOWN.items():
        row = known.loc[f"observed:{name}"]
        assert row.geometry.distance(Point(WEST + x, SOUTH + y)) < 1e-6
        assert row["envelope_radius_m"] == pytest.approx(2.5 if diameter is None else diameter / 2)  # else the mean
    assert known["lot_id"].tolist() == ["a", "b", "c", "f", "g", "h", "i", "i"]
    assert found.plants["plant_id"].is_unique


def test_known_plants_have_their_species_and_the_age_of_their_height(keeping, place):
    known = place(keeping).observed
    kinds = {kind.id: kind for kind in load_catalogue(Species())}
    assert known.loc["observed:2", "species"] == "acer_platanoides"
    for name, height in (("2", 12.0), ("5", 7.0)):
        row = known.loc[f"observed:{name}"]
        kind = kinds[row["species"]]
        reached = kind.open_grown.height_at(np.array([row["age_years"]]))[0]
        assert reached == pytest.approx(min(height, max(kind.open_grown.height_m)), abs=0.6)
    assert known.loc["observed:3", "species"] in kinds  # not in the catalogue: drawn
    assert (known["age_years"] <= known["species"].map(lambda name: kinds[name].lifespan_years)).all()


def test_plants_of_regions_are_of_the_age_that_makes_them_as_wide(plain, place):
    kinds = {kind.id: kind for kind in load_catalogue(Species())}
    rows = place(plain).of("a")
    assert len(rows) == 4
    for _, row in rows.iterrows():
        alone = kinds[row["species"]].open_grown.crown_radius_at(np.array([row["age_years"]]))[0]
        assert alone == pytest.approx(row["envelope_radius_m"], rel=0.25)


def apart_from_known(found, lot_ids, of=None):
    """The least gap between known plants and the others of some lots, envelope to envelope."""
    known = found.observed if of is None else found.observed.loc[[f"observed:{name}" for name in of]]
    gaps = []
    for lot_id in lot_ids:
        others = found.of(lot_id)
        others = others[~others["plant_id"].str.startswith("observed:")]
        assert len(others), lot_id
        mine = known if of is not None else known[known["lot_id"] == lot_id]
        gaps += [float(others.geometry.distance(row.geometry).sub(others["envelope_radius_m"]).min()
                       - row["envelope_radius_m"]) for _, row in mine.iterrows()]  # fmt: skip
    return min(gaps)


def test_others_keep_clear_of_known_plants(keeping, by_rules, place):
    mapped, ruled = place(keeping), place(by_rules)
    assert apart_from_known(mapped, "cfi") >= 0
    assert apart_from_known(ruled, "abcfgi") >= 0
    assert len(mapped.of("a")) == 4  # the one that is known is not planted a second time
    stems = mapped.of("b")[~mapped.of("b")["plant_id"].str.startswith("observed:")]
    assert stems.geometry.distance(Point(WEST + 90, SOUTH + 30)).min() > 4.5
    both = shapely.union(mapped.union("b"), Point(WEST + 90, SOUTH + 30).buffer(4.5))
    assert both.area == pytest.approx(WOOD.area, rel=0.05)


def test_nothing_meets_plants_of_other_lots_where_the_city_keeps_apart(keeping, by_rules, place):
    for register in (keeping, by_rules):
        found = place(register, config=config(conflict="city"))
        assert len(found.observed) == 8
        rows = found.plants[~found.plants["plant_id"].str.startswith("observed:")]
        filled = set(read_layer(register, "regions")["lot_id"]) if register is keeping else set()
        for lot_id in set(rows["lot_id"]) - filled:
            mine, others = found.of(lot_id), found.plants[found.plants["lot_id"] != lot_id]
            mine = mine[mine["plant_id"].isin(rows["plant_id"])]
            gap = shapely.distance(mine.geometry.to_numpy()[:, None], others.geometry.to_numpy()[None])
            gap -= mine["envelope_radius_m"].to_numpy()[:, None] + others["envelope_radius_m"].to_numpy()[None]
            assert gap.min() >= -1e-6, lot_id
        assert apart_from_known(found, "i", of=["5", "8"]) >= 0
    assert place(by_rules, config=config(conflict="city"), workers=3).same_as(found)


def test_lots_with_known_plants_and_no_ground_hold_those_alone(keeping, place):
    found = place(keeping)
    assert found.of("g")["plant_id"].tolist() == ["observed:6"]
    assert found.of("h")["plant_id"].tolist() == ["observed:7"]
    assert found.placements.loc[["g", "h"], ["outcome", "position_count", "plant_count"]].to_numpy().tolist() == [
        ["planted", 1, 1], ["planted", 1, 1]
    ]  # fmt: skip
    skipped = read_layer(found.path, "skipped")["lot_id"].tolist()
    assert not {"g", "h"} & set(skipped)
    assert sorted([*skipped, *found.placements.index]) == list(IDS)


@pytest.mark.parametrize(
    ("column", "value"), [("crown_radius_m", 4.0), ("height_m", 9.0), ("species", "tilia_cordata")]
)
def test_a_known_plant_that_changes_changes_its_lot_alone(keeping, place, tmp_path, column, value):
    first = place(keeping)
    changed = tmp_path / "changed.gpkg"
    shutil.copy(keeping, changed)
    set_column(changed, "observed", column, "b", value)
    again = place(changed, previous=first.path)
    assert again.summary.counts["lots_reused"] == len(first.placements) - 1
    assert again.same_as(first, "acdefghi")
    assert not again.same_as(first, "b")
    assert again.same_as(place(changed))


def test_a_known_plant_changes_no_other_lot(keeping, plain, place):
    with_known, without = place(keeping), place(plain)
    assert with_known.same_as(without, "e")
    drawn = with_known.of("c"), without.of("c")
    shared = set(drawn[0]["plant_id"]) & set(drawn[1]["plant_id"])
    assert shared
