"""The paper's placement figures, made by this program's own strategies, one page a figure.

The lots are drawn by hand after the paper's pictures; the values are those of the presets in ``configs/paper``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urbanforest_cli import __version__
from urbanforest_cli.context.diffusion import diffuse
from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.zones import ZONE_COLOURS
from urbanforest_cli.export.crowns import Crowns
from urbanforest_cli.export.lot_pictures import LotPicture, draw_lots
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.placement.seeds import draw_seeds
from urbanforest_cli.placement.sites import Sites
from urbanforest_cli.placement.strategies import boundary_bands, cluster_areas, strategy_named
from urbanforest_cli.placement.thinning import index_within, kept_by_hash
from urbanforest_cli.register.plantable import Surroundings, plantable_areas

Shapes = NDArray[np.object_]
Values = dict[str, NDArray[np.float64]]

PAGE_PX = 2000
HOUSE_HEIGHT_M = 8.0
DOMINANT = "platanus_acerifolia"


@dataclass(frozen=True)
class Planting:
    """Lots filled by one strategy.

    Parameters
    ----------
    lots, ground
        (n,) polygons, and what the planting rules leave of them; empty where nothing is left.
    active
        The part of the ground that the strategy plants, or None where it plants along lines or on a lattice.
    crowns
        What stands there.
    species, age_years
        Of each plant; species as an index into the catalogue.
    """

    lots: Shapes
    ground: Shapes
    active: shapely.Geometry | None
    crowns: Crowns
    species: NDArray[np.int64]
    age_years: NDArray[np.float64]


def plant_lots(
    lots: Shapes,
    buildings: Shapes,
    strategy: str,
    values: Values,
    *,
    config: Config,
    catalogue: Catalogue,
    rules_on: bool = True,
) -> Planting:
    """Fill lots as the stages do, without files between.

    Parameters
    ----------
    lots, buildings
        Polygons in metres.
    strategy
        Of all lots.
    values
        (n,) a parameter.
    config
        Rules, sampler and seed.
    catalogue
        Species to choose from.
    rules_on
        Keep the distances of the planting rules; otherwise buildings alone are left out.
    """
    around = Surroundings(buildings=buildings)
    rules = config.rules if rules_on else config.rules.model_copy(update={"building_clearance_m": 0.0})
    ground = plantable_areas(lots, np.full(len(lots), "default", dtype=object), around, lambda zone: rules).areas
    ground[shapely.is_missing(ground)] = shapely.MultiPolygon()
    names = np.array([f"figure:{number}" for number in range(len(lots))], dtype=object)
    sites = Sites(names, keys_for(config.seed, "place", names), lots, ground, values)
    found = strategy_named(strategy)(sites, config.placement)
    number = index_within(found.site)
    kept = kept_by_hash(found.site, keys_for(config.seed, "density", names), values["density"])
    site, number, xy, radius = found.site[kept], number[kept], found.xy[kept], found.radius_m[kept]
    seeds = draw_seeds(site, number, keys_for(config.seed, "seeds", names), values, radius, catalogue,
                       dominant=DOMINANT)  # fmt: skip
    colours = np.array([to_rgb(kind.colour) for kind in catalogue])
    trees = np.array([kind.habit == "tree" for kind in catalogue])
    crowns = Crowns(xy, radius, colours[seeds.species], trees[seeds.species])
    return Planting(lots, ground, _active(sites, strategy, config), crowns, seeds.species, seeds.age_years)


def _active(sites: Sites, strategy: str, config: Config) -> shapely.Geometry | None:
    areas: Mapping[str, Callable[[], Shapes]] = {
        "random": lambda: sites.areas,
        "single": lambda: sites.areas,
        "boundary": lambda: boundary_bands(sites.lots, sites.areas, sites.values["boundary_width_m"],
                                           edge_of=config.placement.boundary_of),
        "cluster": lambda: cluster_areas(sites, config.placement),
    }  # fmt: skip
    return shapely.union_all(areas[strategy]()) if strategy in areas else None


def preset(name: str) -> tuple[Config, str, dict[str, float]]:
    """Load a preset of ``configs/paper``: its config, strategy and values."""
    config = load_config(Path("paper") / name, environment={}).config
    (strategy,) = config.zone_value("default", "strategy")
    return config, strategy, {key: float(config.zone_value("default", key)) for key in PARAMETERS}


def repeated(values: Mapping[str, float], count: int = 1, **changed: float) -> Values:
    """Return one value a lot for each parameter."""
    return {name: np.full(count, value, dtype=np.float64) for name, value in {**values, **changed}.items()}


def one(polygon: shapely.Geometry) -> Shapes:
    """Return an array of one shape."""
    return np.array([polygon], dtype=object)


def shapes(*polygons: shapely.Geometry) -> Shapes:
    """Return an array of shapes."""
    return np.array(polygons, dtype=object)


LOT = shapely.Polygon([(0, 6), (48, 0), (97, 9), (104, 60), (62, 78), (8, 70)])
HOUSES = shapes(
    shapely.Polygon([(24, 24), (46, 21), (47.4, 31), (37.5, 32.4), (38.6, 40.4), (26.6, 42)]),
    shapely.Polygon([(66, 36), (82, 33), (84, 45), (68, 48)]),
)


def _picture(planting: Planting, title: str, note: str, buildings: Shapes, *, zone: str = "residential",
             show_ground: bool = True, **more: object) -> LotPicture:  # fmt: skip
    return LotPicture(
        title=title, note=note, lots=planting.lots, colour=ZONE_COLOURS[zone], crowns=planting.crowns,
        area=planting.active if show_ground else None, buildings=buildings,
        building_height_m=np.full(len(buildings), HOUSE_HEIGHT_M), **more,  # type: ignore[arg-type]
    )  # fmt: skip


def _note(values: Mapping[str, float], names: Sequence[str]) -> str:
    return ", ".join(f"{PARAMETERS[name].symbol} {values[name]:g}" for name in names)


def _presets_page(catalogue: Catalogue, panels: Sequence[tuple[str, str, Sequence[str]]], heading: tuple[str, str],
                  *, columns: int = 3) -> Figure:  # fmt: skip
    pictures = []
    for name, title, symbols in panels:
        config, strategy, values = preset(name)
        planting = plant_lots(one(LOT), HOUSES, strategy, repeated(values), config=config, catalogue=catalogue)
        count = len(planting.crowns)
        pictures.append(_picture(planting, title, f"{_note(values, symbols)}: {count} plants", HOUSES))
    return draw_lots(pictures, columns=columns, width_px=PAGE_PX, aspect=0.76, heading=heading)


def boundary_page(catalogue: Catalogue) -> Figure:
    """Draw the boundary strategy: a narrow band, a wide one, a thinner one."""
    symbols = ("boundary_width_m", "density")
    panels = [("positional_a", "a  narrow band", symbols), ("positional_b", "b  wide band", symbols),
              ("positional_c", "c  less dense", symbols)]  # fmt: skip
    return _presets_page(catalogue, panels, ("Boundary", "plants in a band along the lot's edge"))


def cluster_page(catalogue: Catalogue) -> Figure:
    """Draw the cluster strategy: one cluster, several, larger ones."""
    symbols = ("cluster_radius_m", "cluster_count_max")
    panels = [("positional_d", "d  one cluster", symbols), ("positional_e", "e  three clusters", symbols),
              ("positional_f", "f  larger clusters", symbols)]  # fmt: skip
    return _presets_page(catalogue, panels, ("Cluster", "plants in discs around random places of the lot"))


def regular_page(catalogue: Catalogue) -> Figure:
    """Draw the regular strategy: no jitter, some, much."""
    symbols = ("grid_size_m", "grid_orientation_deg", "grid_jitter")
    panels = [("positional_g", "g  no jitter", symbols), ("positional_h", "h  medium jitter", symbols),
              ("positional_i", "i  high jitter", symbols)]  # fmt: skip
    return _presets_page(catalogue, panels, ("Regular", "plants on a lattice turned against the lot"))


def random_page(catalogue: Catalogue) -> Figure:
    """Draw the random strategy: low, medium and full density."""
    symbols = ("radius_mean_m", "radius_variance_m2", "density")
    panels = [("positional_j", "j  low density", symbols), ("positional_k", "k  medium density", symbols),
              ("positional_l", "l  full density", symbols)]  # fmt: skip
    return _presets_page(catalogue, panels, ("Random", "a saturated sample of the lot, thinned by density"))


def structural_page(catalogue: Catalogue) -> Figure:
    """Draw the rows of age, trees against shrubs, and diversity of species."""
    rows = (("abc", ("young", "middle-aged", "old"), ("age_max_years",)),
            ("def", ("only shrubs", "some trees", "half trees"), ("tree_fraction",)),
            ("ghi", ("one species", "some others", "more others"), ("species_diversity", "tree_fraction")))  # fmt: skip
    panels = [(f"structural_{letter}", f"{letter}  {title}", symbols)
              for letters, titles, symbols in rows for letter, title in zip(letters, titles, strict=True)]  # fmt: skip
    pictures = []
    for name, title, symbols in panels:
        config, strategy, values = preset(name)
        planting = plant_lots(one(LOT), HOUSES, strategy, repeated(values), config=config, catalogue=catalogue)
        ages = [f"{age:.0f}" for age in planting.age_years] if "age_max_years" in symbols else []
        picture = _picture(planting, title, f"{_note(values, symbols)}: {len(planting.crowns)} plants", HOUSES,
                           show_ground=False, labels=ages)  # fmt: skip
        pictures.append(picture)
    heading = ("Age, habit, diversity", "numbers are ages in years, colours species; a circle is the room of a plant")
    return draw_lots(pictures, columns=3, width_px=PAGE_PX, aspect=0.76, heading=heading)


def envelope_page(catalogue: Catalogue) -> Figure:
    """Draw a lot with and without the building envelope."""
    config, strategy, values = preset("positional_l")
    pictures = []
    for rules_on, title, note in (
        (True, "with the envelope", f"plants keep {config.rules.building_clearance_m:g} m from walls"),
        (False, "without it", "plants stand up to the walls"),
    ):
        planting = plant_lots(one(LOT), HOUSES, strategy, repeated(values), config=config, catalogue=catalogue,
                              rules_on=rules_on)  # fmt: skip
        kept_free = shapely.difference(LOT, shapely.union_all(planting.ground)) if rules_on else None
        pictures.append(_picture(planting, title, note, HOUSES, show_ground=False, envelope=kept_free))
    heading = ("Building envelope", "blue: ground that the planting rules keep free")
    return draw_lots(pictures, columns=2, width_px=PAGE_PX, aspect=0.76, heading=heading)


def context_page(catalogue: Catalogue) -> Figure:
    """Draw two arrangements of lots whose values differ, with context off (top) and on (bottom)."""
    config, strategy, values = preset("positional_g")
    reach_m = 180.0
    scenes = (_rows_of_lots(), _blocks_of_lots())
    pictures = []
    for on in (False, True):
        for lots, mean_m, variance_m2 in scenes:
            given = repeated(values, len(lots), context_radius_m=reach_m, grid_orientation_deg=0.0, tree_fraction=1.0,
                             species_diversity=0.0)  # fmt: skip
            given |= {"radius_mean_m": mean_m, "radius_variance_m2": variance_m2}
            names = np.array([f"figure:{number}" for number in range(len(lots))], dtype=object)
            centres = shapely.get_coordinates(shapely.centroid(lots))
            strategies = np.full(len(lots), strategy, dtype=object)
            in_force = diffuse(centres, given, lot_ids=names, strategies=strategies, seed=config.seed,
                               passes=int(on)).values  # fmt: skip
            planting = plant_lots(lots, shapes(), strategy, in_force, config=config, catalogue=catalogue)
            low, high = in_force["radius_mean_m"].min(), in_force["radius_mean_m"].max()
            title = f"context radius {reach_m:g} m" if on else "no context"
            pictures.append(_picture(planting, title, f"mean radius {low:.1f} to {high:.1f} m", shapes()))
    heading = ("Context", "lots of different mean and variance; neighbours share their values in the lower row")
    return draw_lots(pictures, columns=2, width_px=PAGE_PX, aspect=0.62, heading=heading)


def _rows_of_lots() -> tuple[Shapes, NDArray[np.float64], NDArray[np.float64]]:
    """Return two rows of equal lots, small plants on the left, large ones on the right."""
    lots = [shapely.box(x, y, x + 42, y + 62) for y in (0, 74) for x in range(0, 264, 44)]
    large = np.array([lot.centroid.x > 132 for lot in lots])
    return np.array(lots, dtype=object), np.where(large, 4.2, 1.6), np.where(large, 0.1, 0.6)


def _blocks_of_lots() -> tuple[Shapes, NDArray[np.float64], NDArray[np.float64]]:
    """Return uneven lots, with three kinds of values in turn."""
    edges_x, edges_y = (0.0, 58.0, 100.0, 161.0, 214.0, 262.0), (0.0, 52.0, 88.0, 138.0)
    lots = []
    for row in range(3):
        for column in range(5):
            bend = 7.0 * np.sin(1.3 * row + 0.9 * column)
            west, east = edges_x[column] + 1, edges_x[column + 1] - 1
            south, north = edges_y[row] + 1, edges_y[row + 1] - 1
            lots.append(shapely.Polygon([(west, south + 0.2 * bend), (east, south), (east, north), (west, north)]))
    kind = np.arange(len(lots)) * 2 % 3
    return np.array(lots, dtype=object), np.array([1.5, 2.8, 4.3])[kind], np.array([0.1, 0.8, 0.3])[kind]


def growth_page(catalogue: Catalogue) -> Figure:
    """Draw clusters that fill a lot, and what is left of them as a building grows."""
    config, strategy, values = preset("growth_of_building")
    lot = shapely.box(0, 0, 88, 76)
    pictures = []
    for number, share in enumerate((0.0, 0.3, 0.5, 0.65, 0.78)):
        house = shapely.affinity.scale(lot, share, share, origin="centroid")
        buildings = one(house) if share else shapes()
        planting = plant_lots(one(lot), buildings, strategy, repeated(values), config=config, catalogue=catalogue)
        note = f"{100 * share * share:.0f} % built: {len(planting.crowns)} plants"
        pictures.append(_picture(planting, "abcde"[number], note, buildings))
    heading = ("Growth of a building", _note(values, ("cluster_radius_m", "cluster_count_max", "radius_mean_m")))
    return draw_lots(pictures, columns=5, width_px=PAGE_PX, aspect=0.9, heading=heading)


def vegetation_lots_page(catalogue: Catalogue) -> Figure:
    """Draw residential, park and commercial lots and a street, by the default values of their zones."""
    config = load_config(environment={}, seed=7, settings=["placement.cluster_count=max"]).config
    estate = shapely.Polygon([(0, 0), (120, 4), (126, 84), (4, 90)])
    homes = shapes(*(shapely.box(x, y, x + 13, y + 10) for x, y in ((20, 18), (54, 20), (90, 22), (24, 58), (60, 60),
                                                                    (94, 58))))  # fmt: skip
    pond = shapely.Point(78, 52).buffer(17)
    park = shapely.difference(shapely.Polygon([(0, 8), (70, 0), (150, 14), (156, 88), (90, 108), (6, 96)]), pond)
    hall = shapes(shapely.box(30, 30, 86, 62))
    scenes = (
        ("residential", "residential", estate, homes, None, ("boundary", "random", "cluster", "regular")),
        ("park", "other", park, shapes(), pond, ("boundary", "random", "cluster", "regular")),
        ("commercial", "commercial", shapely.box(0, 0, 120, 90), hall, None, ("boundary", "cluster", "regular")),
    )
    pictures = []
    for kind, zone, lot, buildings, water, strategies in scenes:
        values = {key: float(config.zone_value(zone, key)) for key in PARAMETERS}
        given = repeated(values, density=0.9, cluster_radius_m=15.0, cluster_count_max=4.0, boundary_width_m=5.0)
        for strategy in strategies:
            planting = plant_lots(one(lot), buildings, strategy, given, config=config, catalogue=catalogue)
            note = f"{len(planting.crowns)} plants"
            pictures.append(_picture(planting, f"{kind}, {strategy}", note, buildings, zone=zone, show_ground=False,
                                     envelope=water))  # fmt: skip
    pictures.append(_street_picture(config, catalogue))
    heading = ("Zones and strategies", "a residential lot, a park, a commercial lot; a street with a tree every 13 m")
    return draw_lots(pictures, columns=4, width_px=PAGE_PX, aspect=0.76, heading=heading)


def _street_picture(config: Config, catalogue: Catalogue) -> LotPicture:
    """Draw a crossing with strips of trees at both sides of each street, placed along their medial axes."""
    lines = shapes(shapely.LineString([(0, 40), (60, 46), (130, 44)]), shapely.LineString([(64, 0), (64, 95)]))
    carriageway = shapely.union_all(shapely.buffer(lines, 4.5 + 0.75))
    planted = shapely.difference(shapely.union_all(shapely.buffer(lines, 4.5 + 4.0)), carriageway)
    roads = shapely.buffer(lines, 4.5)
    strips: Shapes = shapely.get_parts(shapely.intersection(planted, shapely.box(2, 2, 126, 93)))
    values = {key: float(config.zone_value("street", key)) for key in PARAMETERS}
    given = repeated(values, len(strips), spacing_m=13.0, density=1.0)
    planting = plant_lots(strips, shapes(), "equidistant", given, config=config, catalogue=catalogue)
    note = f"{len(planting.crowns)} plants, delta 13"
    return _picture(planting, "street, equidistant", note, shapes(), zone="street", roads=roads)


Page = Callable[[Catalogue], Figure]

PAGES: dict[str, Page] = {
    "boundary": boundary_page,
    "cluster": cluster_page,
    "regular": regular_page,
    "random": random_page,
    "structural": structural_page,
    "envelope": envelope_page,
    "context": context_page,
    "growth_of_building": growth_page,
    "vegetation_lots": vegetation_lots_page,
}


def render_figures(
    out: Path, *, names: Sequence[str] = (), pages: Mapping[str, Page] = PAGES, progress: Progress = silent
) -> StageSummary:
    """Write the pages named, or all of `pages`, as PNG files into a folder.

    Raises
    ------
    ConfigError
        There is no page of that name.
    OutputError
        A page could not be written.
    """
    started = time.perf_counter()
    unknown = [name for name in names if name not in pages]
    if unknown:
        raise ConfigError(f"no figure {unknown[0]!r}", expected=", ".join(pages))
    catalogue = load_catalogue(load_config(environment={}).config.species)
    wanted = list(names) or list(pages)
    for number, name in enumerate(wanted):
        progress("figures", number, len(wanted))
        figure = pages[name](catalogue)
        with publish(out / f"{name}.png") as part:
            figure.savefig(part, dpi=figure.dpi, metadata={"Software": f"urbanforest {__version__}"})
    progress("figures", len(wanted), len(wanted))
    return StageSummary("figures", out, {"pages": len(wanted)}, seconds=time.perf_counter() - started)
