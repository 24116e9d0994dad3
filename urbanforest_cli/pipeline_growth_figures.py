"""Sheets of grown plants, and the paper's growth figures, each plant grown by this program's own model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import shapely
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import Skeletons, concatenate, measure, select
from urbanforest_cli.core.species import Catalogue, Species
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.export.plant_camera import Camera, side_view, view_from, view_onto
from urbanforest_cli.export.plant_looks import look_of
from urbanforest_cli.export.plant_pictures import Backdrop, Scene, render
from urbanforest_cli.export.plant_scene import Standing
from urbanforest_cli.export.plant_sheets import Label, Panel, draw_sheet
from urbanforest_cli.export.plant_town import Faces, build_person, build_slabs
from urbanforest_cli.growth.grove import Grove, season_count
from urbanforest_cli.growth.groves import cut_into_groves
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site
from urbanforest_cli.pipeline_figures import (
    HOUSE_HEIGHT_M,
    HOUSES,
    LOT,
    PAGES,
    Page,
    one,
    plant_lots,
    preset,
    repeated,
    shapes,
)

LATITUDE_DEG = 48.0
AGES_YEARS = (5, 10, 20, 30, 50, 80)
SHEET_PX = 2400
LAWN, PAVING, ASPHALT = (0.57, 0.62, 0.42), (0.73, 0.72, 0.69), (0.58, 0.58, 0.59)
LOT_AROUND = (0.79, 0.79, 0.75)
SKY, HAZE = (0.78, 0.86, 0.93), (0.95, 0.96, 0.96)
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Stand:
    """Plants grown together: positions, species of the catalogue, and what grew, in the same order."""

    catalogue: Catalogue
    xy_m: FloatArray
    species: NDArray[np.int64]
    skeletons: Skeletons

    def seen(self, season_end: NDArray[np.integer] | None = None) -> Standing:
        """Return them as pictures take them, at the end of a season (n,) of each."""
        kinds = list(self.catalogue)
        looks = [look_of(kinds[number]) for number in self.species]
        return Standing(self.skeletons, self.xy_m, looks, season_end)

    def years_ago(self, years: int) -> Standing:
        """Return them as they stood some years before today; those not yet planted are left out."""
        season = self.skeletons.seasons - years
        there = np.flatnonzero(season >= 1)
        part = Stand(self.catalogue, self.xy_m[there], self.species[there], select(self.skeletons, there))
        return part.seen(season[there])


def grow_stand(
    catalogue: Catalogue,
    xy_m: FloatArray,
    species: Sequence[str] | NDArray[np.int64],
    age_years: Sequence[float] | FloatArray,
    *,
    name: str,
    buildings: NDArray[np.object_] | None = None,
    height_m: FloatArray | None = None,
    pruning_factor: float = 1.0,
    clearance_m: float = 0.0,
    apart: bool = False,
    growth: Growth | None = None,
) -> Stand:
    """Grow plants that stand together, or each for itself.

    Parameters
    ----------
    xy_m, species, age_years
        (n,) plants; species as ids or indices into the catalogue.
    name
        Names their random streams.
    buildings, height_m
        What blocks and shades them.
    pruning_factor
        Of all; the boxes that prune lie along x.
    clearance_m
        Height below which branches are lifted.
    apart
        Each grows as if it were alone.
    """
    growth = growth or Growth()
    xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    index = np.array([catalogue.index_of(kind) if isinstance(kind, str) else kind for kind in species], dtype=np.int64)
    age = np.asarray(age_years, dtype=np.float64)
    keys = keys_for(0, "figure", [f"{name}/{number}" for number in range(len(xy))])
    walls = shapes() if buildings is None else buildings
    heights = np.full(len(walls), HOUSE_HEIGHT_M) if height_m is None else np.asarray(height_m, dtype=np.float64)
    factor = np.full(len(xy), pruning_factor)
    light = light_from(LATITUDE_DEG, growth.sun_share)
    traits = traits_table([kind.growth for kind in catalogue])
    if apart:
        growth = growth.model_copy(update={"neighbours": False})
        grove_of = np.arange(len(xy))
    else:
        grove_of = cut_into_groves(np.zeros(len(xy), dtype=np.int64), xy, keys, growth)
    site = Site(Plants(keys, xy, index, age, factor), [kind.open_grown for kind in catalogue], walls, heights, light,
                growth)  # fmt: skip
    parts, order = [], []
    for number in range(int(grove_of.max(initial=-1)) + 1):
        rows = np.flatnonzero(grove_of == number)
        grove = Grove(keys[rows], xy[rows], index[rows], age[rows], factor[rows],
                      np.full(len(rows), clearance_m), np.zeros(len(rows)))  # fmt: skip
        parts.append(grow_grove(grove, site.around(rows), traits, growth).skeletons)
        order.append(rows)
    grown = select(concatenate(parts), np.argsort(np.concatenate(order)) if order else [])
    grown.skeleton_id[:] = np.arange(len(grown))
    return Stand(catalogue, xy, index, grown)


def _row_panel(
    stands: Sequence[Standing], labels: Sequence[tuple[float, str, tuple[str, ...]]], *, width_m: float, above_m: float,
    px_per_m: float, people: Sequence[float] = (), leafy: bool = True, left_m: float = 0.0, below_m: float = 1.2,
    title: str = "", note: str = "", faces: Sequence[Faces] = (), supersampling: int = 3,
) -> Panel:  # fmt: skip
    camera = side_view(left_m, width_m, px_per_m, above_m=above_m, below_m=below_m, pitch_deg=5.0)
    backdrop = Backdrop(ground=(0.74, 0.75, 0.66), ground_middle_m=(left_m + width_m / 2, 0.0),
                        ground_half_m=(width_m / 2, 7.0))  # fmt: skip
    scene = Scene(stands, things=[build_person(x, 0.0) for x in people], leafy=leafy, backdrop=backdrop, faces=faces)
    image = render(scene, camera, supersampling=supersampling)
    base = above_m * px_per_m + 0.75 * px_per_m
    return Panel(image, title=title, note=note, px_per_m=px_per_m,
                 labels=[Label((x - left_m) * px_per_m, base, text, under) for x, text, under in labels])  # fmt: skip


def _sizes(skeletons: Skeletons, *, thickness: bool = True) -> list[tuple[str, ...]]:
    found = measure(skeletons)
    return [(f"{h:.1f} m", f"\u2300 {100 * d:.0f} cm")[: 1 + thickness]
            for h, d in zip(found["height_m"], found["dbh_m"], strict=True)]  # fmt: skip


def _names(kind: Species) -> str:
    return f"{kind.scientific_name}, {kind.common_name}"


def species_sheet(catalogue: Catalogue) -> Figure:
    """Draw every species at six ages, to one scale."""
    px_per_m = SHEET_PX / 144.0
    trees, shrubs = catalogue.trees().ids, catalogue.shrubs().ids
    rows = [_ages_row(catalogue, trees[number : number + 2], px_per_m) for number in range(0, len(trees), 2)]
    rows += [_ages_row(catalogue, shrubs[number : number + 4], px_per_m) for number in range(0, len(shrubs), 4)]
    heading = ("Species by age", "each grown alone, at " + ", ".join(map(str, AGES_YEARS[:-1]))
               + f" and {AGES_YEARS[-1]} years; height and diameter at breast height; all to one scale")  # fmt: skip
    return draw_sheet([[row] for row in rows], heading)


def _ages_row(catalogue: Catalogue, ids: Sequence[str], px_per_m: float) -> Panel:
    """Draw plants of some species in a row, each species from young to old."""
    width_m = SHEET_PX / px_per_m
    species = [kind for kind in ids for _ in AGES_YEARS]
    ages = np.array([age for _ in ids for age in AGES_YEARS], dtype=np.float64)
    lone = grow_stand(catalogue, np.zeros((len(ages), 2)), species, ages, name="ages", apart=True)
    sizes = measure(lone.skeletons)
    radius = np.maximum(sizes["crown_radius_m"] * 1.05, 1.4 if len(ids) > 2 else 2.1)
    gap = (width_m - 2 * radius.sum()) / (len(ages) + 2 * len(ids))
    x = np.cumsum(2 * radius + gap) - radius + gap * (2 * np.repeat(np.arange(len(ids)), len(AGES_YEARS)) + 0.5)
    stand = replace(lone, xy_m=np.column_stack((x, np.zeros(len(x)))))
    notes = _sizes(lone.skeletons, thickness=len(ids) <= 2)
    labels = [(float(at), f"{age:.0f} y", note) for at, age, note in zip(x, ages, notes, strict=True)]
    above = max(float(sizes["height_m"].max()) + 1.5, 4.0)
    below = 7.0 if len(ids) <= 2 else 5.7
    panel = _row_panel([stand.seen()], labels, width_m=width_m, above_m=above, px_per_m=px_per_m,
                       people=[0.8], below_m=below)  # fmt: skip
    middles = x.reshape(len(ids), len(AGES_YEARS)).mean(axis=1) * px_per_m
    names = [Label(float(middle), (above + below - 1.2) * px_per_m, _names(catalogue[kind]))
             for middle, kind in zip(middles, ids, strict=True)]  # fmt: skip
    return replace(panel, labels=[*panel.labels, *names])


def species_winter(catalogue: Catalogue) -> Figure:
    """Draw every species bare, at 30 years; trees to one scale, shrubs to a larger one."""
    rows = []
    for ids, count, width_m in ((catalogue.trees().ids, 3, 48.0), (catalogue.shrubs().ids, 4, 25.0)):
        for number in range(0, len(ids), count):
            rows.append(_winter_row(catalogue, ids[number : number + count], width_m))
    return draw_sheet([[row] for row in rows], ("Species in winter", "grown alone for 30 years, without leaves"))


def _winter_row(catalogue: Catalogue, ids: Sequence[str], width_m: float, age_years: float = 30.0) -> Panel:
    lone = grow_stand(catalogue, np.zeros((len(ids), 2)), ids, [age_years] * len(ids), name="winter", apart=True)
    radius = np.maximum(measure(lone.skeletons)["crown_radius_m"], 0.07 * width_m)
    gap = (0.93 * width_m - 2 * radius.sum()) / len(ids)
    x = 0.07 * width_m + np.cumsum(2 * radius + gap) - radius - gap / 2
    stand = replace(lone, xy_m=np.column_stack((x, np.zeros(len(x)))))
    labels = [(float(at), _names(catalogue[kind]), (", ".join(size),))
              for at, kind, size in zip(x, ids, _sizes(stand.skeletons), strict=True)]  # fmt: skip
    top = float(measure(stand.skeletons)["height_m"].max())
    px_per_m = SHEET_PX / width_m
    return _row_panel([stand.seen()], labels, width_m=width_m, above_m=1.06 * top + 0.5, px_per_m=px_per_m,
                      people=[0.03 * width_m], leafy=False, below_m=70 / px_per_m + 0.8, supersampling=2)  # fmt: skip


def individual_growth(catalogue: Catalogue) -> Figure:
    """Draw the paper's figure: a tree alone, beside another, beside buildings; below, a group among buildings."""
    kind, age = "acer_platanoides", 35.0
    slab = shapely.box(-16.0, 2.5, 14.0, 10.0), shapely.box(-16.0, -12.0, -3.0, 10.0)
    pair = np.array([[-2.4, 0.0], [2.4, 0.0]])
    walls = np.array([shapely.union_all(slab)], dtype=object)
    scenes = (
        ("alone", np.zeros((1, 2)), shapes(), 0.0),
        ("with a neighbour", pair, shapes(), 0.0),
        ("beside buildings", np.zeros((1, 2)), walls, 14.0),
    )
    top = []
    for title, xy, buildings, height in scenes:
        stand = grow_stand(catalogue, xy, [kind] * len(xy), [age] * len(xy), name="individual", buildings=buildings,
                           height_m=np.full(len(buildings), height))  # fmt: skip
        camera = view_from((13.0, -42.0, 5.5), (0.0, 0.0, 7.4), size_px=(780, 760), field_deg=27.0)
        scene = _street_scene([stand.seen()], buildings, np.full(len(buildings), height),
                              people=[(5.5, -5.0)])  # fmt: skip
        sizes = measure(stand.skeletons)
        note = "; ".join(f"{h:.1f} m high, crown {2 * r:.1f} m wide"
                         for h, r in zip(sizes["height_m"], sizes["crown_radius_m"], strict=True))  # fmt: skip
        top.append(Panel(render(scene, camera), title, note))
    heading = ("Individual growth", f"Norway maples, {age:.0f} years; what stands beside a tree shapes it")
    return draw_sheet([top, [_group_panel(catalogue)]], heading)


def _street_scene(
    plants: Sequence[Standing], buildings: NDArray[np.object_], height_m: FloatArray, *,
    people: Sequence[tuple[float, float]] = (), faces: Sequence[Faces] = (), leafy: bool = True,
    middle: tuple[float, float] = (0.0, 0.0), ground: tuple[float, float, float] = LAWN, half_m: float = 220.0,
) -> Scene:  # fmt: skip
    backdrop = Backdrop(SKY, HAZE, ground, middle, (half_m, half_m))
    return Scene(plants, buildings, height_m, faces, [build_person(x, y) for x, y in people], leafy, backdrop)


def _group_panel(catalogue: Catalogue) -> Panel:
    walls = shapes(shapely.box(-34, 8, -12, 20), shapely.box(-6, 10, 14, 22), shapely.box(20, 7, 38, 21),
                   shapely.box(-38, -14, -28, 2))  # fmt: skip
    heights = np.array([16.0, 11.0, 19.0, 12.0])
    xy = np.array([[-23.0, 3.5], [-16.0, 1.0], [-9.0, 5.5], [-3.2, 3.0], [3.0, 5.0], [9.0, 1.5], [15.5, 4.0],
                   [23.0, 2.0], [30.0, 3.0], [-12.5, -5.0], [-1.0, -6.5], [18.0, -4.5]])  # fmt: skip
    kinds = ["tilia_cordata", "acer_platanoides", "platanus_acerifolia", "quercus_rubra", "acer_platanoides",
             "gleditsia_triacanthos", "tilia_cordata", "platanus_acerifolia", "quercus_rubra", "prunus_serrulata",
             "corylus_avellana", "prunus_serrulata"]  # fmt: skip
    ages = [30.0, 38, 26, 34, 22, 30, 36, 40, 28, 22, 14, 18]
    stand = grow_stand(catalogue, xy, kinds, ages, name="group", buildings=walls, height_m=heights)
    camera = view_from((9.0, -62.0, 6.0), (0.0, 2.0, 7.8), size_px=(2396, 780), field_deg=58.0)
    scene = _street_scene([stand.seen()], walls, heights, people=[(4.0, -9.0), (5.0, -9.4), (-19.0, -7.0)])
    return Panel(render(scene, camera), "a group among buildings", "six species of trees and hazel, 14 to 40 years")


def pruned(catalogue: Catalogue) -> Figure:
    """Draw street trees pruned to less and less of their crowns: just cut and bare, and regrown; below, a street."""
    kind, age, spacing_m, count = "tilia_cordata", 28.0, 5.0, 5
    growth = Growth()
    rows = []
    for factor in (1.0, 0.85, 0.7, 0.5):
        x = (np.arange(count) + 0.5) * spacing_m
        xy = np.column_stack((x, np.zeros(count)))
        stand = grow_stand(catalogue, xy, [kind] * count, [age] * count, name="pruned", pruning_factor=factor,
                           clearance_m=growth.crown_clearance_m["street"])  # fmt: skip
        width_m, season = count * spacing_m + 8, stand.skeletons.seasons - growth.regrow_years
        above_m = 0.8 + max(float(measure(stand.skeletons, end)["height_m"].max()) for end in (None, season))
        note = f"{growth.regrow_years} years before: just cut" if factor < 1 else f"{growth.regrow_years} years before"
        panel = partial(_row_panel, labels=[], width_m=width_m, left_m=-4.0, above_m=above_m, below_m=1.0,
                        px_per_m=1186 / width_m, people=[-2.5], title=f"\u03b3 {factor:g}",
                        supersampling=2)  # fmt: skip
        bare = panel([stand.seen(season)], leafy=False, note=note)
        leafy = panel([stand.seen()], note=f"{age:.0f} years" + (", regrown" if factor < 1 else ""))
        rows.append([bare, leafy])
    rows.append([_avenue_panel(catalogue)])
    heading = (
        "Pruned trees",
        "a row of limes every 5 m; \u03b3 scales the sides of the box about each grown crown, to which it is cut",
    )
    return draw_sheet(rows, heading)


def _avenue_panel(catalogue: Catalogue) -> Panel:
    """Draw a street with two rows of trees cut to hedges."""
    x = np.arange(-15.0, 65.0, 5.0)
    xy = np.vstack((np.column_stack((x, np.full(len(x), 8.0))), np.column_stack((x, np.full(len(x), -8.0)))))
    walls = shapely.box(np.repeat([-40, -18, 2, 24, 46], 2), np.tile([15, -26], 5), np.repeat([-20, 0, 21, 43, 66], 2),
                        np.tile([26, -15], 5))  # fmt: skip
    heights = np.array([12.0, 14, 15, 11, 12, 15, 17, 12, 13, 16])
    stand = grow_stand(catalogue, xy, ["tilia_cordata"] * len(xy), np.full(len(xy), 26.0), name="avenue",
                       pruning_factor=0.7, clearance_m=Growth().crown_clearance_m["street"], buildings=walls,
                       height_m=heights)  # fmt: skip
    walk = build_slabs(shapes(shapely.box(-60, -12.0, 140, 12.0)), z_m=0.015, rgb=PAVING)
    road = build_slabs(shapes(shapely.box(-60, -5.5, 140, 5.5)), z_m=0.03, rgb=ASPHALT)
    people = [(-12.0, 10.5), (-11.4, 10.9), (2.0, -7.4), (21.0, 7.0)]
    scene = _street_scene([stand.seen()], walls, heights, faces=[walk, road], people=people)
    camera = view_from((-62.0, -2.4, 5.0), (20.0, 0.2, 7.0), size_px=(2400, 960), field_deg=44.0)
    return Panel(
        render(scene, camera), "a street, \u03b3 0.7", "limes, 26 years, cut 5 years ago, lifted over the road"
    )


def _lot_camera(size_px: tuple[int, int]) -> Camera:
    corners = shapely.get_coordinates(LOT.buffer(4.0))
    points = np.vstack([np.column_stack((corners, np.full(len(corners), z))) for z in (0.0, 11.0)])
    return view_onto(points, azimuth_deg=-9.0, pitch_deg=36.0, distance_m=135.0, size_px=size_px)


def _lot_faces(lot: shapely.Geometry) -> list[Faces]:
    return [build_slabs(one(shapely.buffer(lot, 0.9)), z_m=0.02, rgb=PAVING),
            build_slabs(one(lot), z_m=0.04, rgb=LAWN)]  # fmt: skip


def _lot_picture(plants: Standing) -> NDArray[np.uint8]:
    scene = _street_scene([plants], HOUSES, np.full(len(HOUSES), HOUSE_HEIGHT_M), faces=_lot_faces(LOT),
                          middle=(52.0, 39.0), ground=LOT_AROUND)  # fmt: skip
    return render(scene, _lot_camera((780, 480)))


def _grown_lot(catalogue: Catalogue, name: str, **changed: float) -> tuple[Stand, Mapping[str, float], FloatArray]:
    config, strategy, values = preset(name)
    values = {**values, **changed}
    planting = plant_lots(one(LOT), HOUSES, strategy, repeated(values), config=config, catalogue=catalogue)
    stand = grow_stand(catalogue, planting.crowns.xy, planting.species, planting.age_years, name=name,
                       buildings=HOUSES, growth=config.growth)  # fmt: skip
    return stand, values, planting.age_years


def structural_growth(catalogue: Catalogue) -> Figure:
    """Draw the paper's rows of age, trees against shrubs, and diversity, with grown plants."""
    rows = []
    captions = (("abc", ("young", "middle-aged", "old"), "\u03b1 {age_max_years:g}"),
                ("def", ("only shrubs", "some trees", "half trees"), "\u03c1 {tree_fraction:g}"),
                ("ghi", ("one species", "some others", "more others"), "\u03b8 {species_diversity:g}"))  # fmt: skip
    for letters, titles, note in captions:
        row = []
        for letter, title in zip(letters, titles, strict=True):
            stand, values, _ = _grown_lot(catalogue, f"structural_{letter}")
            row.append(
                Panel(
                    _lot_picture(stand.seen()),
                    f"{letter}  {title}",
                    f"{note.format(**values)}: {len(stand.species)} plants",
                )
            )
        rows.append(row)
    heading = ("Age, habit, diversity", "the paper's structural parameters on one lot; each plant grown in its place")
    return draw_sheet(rows, heading)


def growth_years(catalogue: Catalogue) -> Figure:
    """Draw a lot at several years, all read from one run by the seasons in which wood grew and was lost."""
    stand, _, ages = _grown_lot(catalogue, "structural_f", age_max_years=60.0, density=0.5, species_diversity=0.5)
    oldest = int(season_count(ages).max())
    panels = []
    for year in np.linspace(oldest / 6, oldest, 6).round().astype(int):
        plants = stand.years_ago(oldest - int(year))
        note = f"{len(plants.xy_m)} of {len(stand.species)} planted"
        panels.append(Panel(_lot_picture(plants), f"year {year}", note))
    return draw_sheet(
        [panels[:3], panels[3:]],
        ("A lot over the years", "one run; plants are planted so that all reach their ages today"),
    )


GROWTH_PAGES: dict[str, Page] = {
    "species_sheet": species_sheet,
    "species_winter": species_winter,
    "individual_growth": individual_growth,
    "pruned": pruned,
    "structural_growth": structural_growth,
    "growth_years": growth_years,
}
ALL_PAGES: dict[str, Page] = PAGES | GROWTH_PAGES
