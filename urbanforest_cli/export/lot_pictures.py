"""Small multiples: lots side by side, with their ground, buildings and crowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urbanforest_cli.core.colours import mixed
from urbanforest_cli.export.crowns import Crowns, draw_crowns
from urbanforest_cli.export.drawing import Bounds, Pane, cast_shadows, draw_roads, fill_polygons, make_pane
from urbanforest_cli.export.map_layers import MapLayers, RegisterTables
from urbanforest_cli.export.map_page import (
    BUILDING_EDGE,
    BUILDING_FILL,
    DPI,
    GROUND,
    INK,
    PAPER,
    ROAD_CASING,
    ROAD_FILL,
    SOFT_INK,
)
from urbanforest_cli.export.text import counted, printable, round_length, shortened

LOTS_SHOWN = 12
AREA_FILL = "#f3dc8c"
AREA_EDGE = "#c9a53c"
ENVELOPE_FILL = "#8fb3d9"


def _no_shapes() -> NDArray[np.object_]:
    return np.empty(0, dtype=object)


def _no_numbers() -> NDArray[np.float64]:
    return np.empty(0, dtype=np.float64)


@dataclass(frozen=True)
class LotPicture:
    """Some lots, mostly one, and what is on them, in metres.

    Parameters
    ----------
    title, note
        Two lines below the picture.
    lots, colour
        (n,) polygons and their fill.
    labels
        Text in the middle of each crown, or none.
    area
        The ground where plants may stand, or None.
    envelope
        Ground kept free around buildings, or None.
    neighbours, buildings, building_height_m, roads
        What lies around and on the lots.
    """

    title: str
    note: str
    lots: NDArray[np.object_]
    colour: str
    crowns: Crowns
    labels: Sequence[str] = ()
    area: shapely.Geometry | None = None
    envelope: shapely.Geometry | None = None
    neighbours: NDArray[np.object_] = field(default_factory=_no_shapes)
    buildings: NDArray[np.object_] = field(default_factory=_no_shapes)
    building_height_m: NDArray[np.float64] = field(default_factory=_no_numbers)
    roads: NDArray[np.object_] = field(default_factory=_no_shapes)


def typical_lots(frame: pd.DataFrame, count: int = LOTS_SHOWN) -> list[int]:
    """Choose lots that stand for the others.

    Planted lots are grouped by strategy and zone; of a group the lot nearest to the medians of area and number of
    plants, both as logarithms, is the typical one. The largest group of each strategy comes first, then the largest
    of the rest.

    Parameters
    ----------
    frame
        Columns lot_id, strategy, zone, area_m2, plants.
    count
        How many to choose at most.

    Returns
    -------
    Row numbers, ordered by strategy and zone.
    """
    planted = frame.reset_index(drop=True)
    planted = planted[planted["plants"] > 0]
    picks = []
    for (strategy, zone), group in planted.groupby(["strategy", "zone"], observed=True):
        features = np.log1p(group[["area_m2", "plants"]].to_numpy(dtype=float))
        middle = np.median(features, axis=0)
        spread = np.median(np.abs(features - middle), axis=0) + 1e-9
        distance = (((features - middle) / spread) ** 2).sum(axis=1)
        ranked = group.assign(distance=np.round(distance, 9)).sort_values(["distance", "lot_id"])
        picks.append((str(strategy), str(zone), len(group), int(ranked.index[0])))
    picks.sort(key=lambda pick: (-pick[2], pick[0], pick[1]))
    first_of_strategy = list({pick[0]: pick for pick in reversed(picks)}.values())
    others = [pick for pick in picks if pick not in first_of_strategy]
    chosen = (sorted(first_of_strategy, key=lambda pick: -pick[2]) + others)[:count]
    return [pick[3] for pick in sorted(chosen)]


def typical_pictures(layers: MapLayers, tables: RegisterTables, areas: pd.Series[Any]) -> list[LotPicture]:
    """Return pictures of a register's typical lots.

    Parameters
    ----------
    layers, tables
        The same lots and plants, in the same order, as arrays and as tables.
    areas
        The ground of each lot that has any, by lot id.
    """
    crowns = layers.crowns()
    plant_lot = tables.plants["lot_id"].to_numpy(dtype=object)
    frame = tables.lots[["lot_id", "zone", "area_m2"]].merge(
        tables.parameters[["lot_id", "strategy"]], how="left", on="lot_id"
    )
    frame["plants"] = frame["lot_id"].map(tables.plants["lot_id"].value_counts()).fillna(0).astype(int)
    chosen = typical_lots(frame)
    around = shapely.STRtree(layers.lots)
    houses = shapely.STRtree(layers.buildings)
    pictures = []
    for number in chosen:
        row, lot = frame.iloc[number], layers.lots[number]
        view = shapely.box(*shapely.bounds(lot)).buffer(10.0)
        near = houses.query(view, predicate="intersects")
        beside = around.query(view, predicate="intersects")
        pictures.append(
            LotPicture(
                title=f"{row['strategy']}, {row['zone']}",
                note=f"{row['lot_id']}: {counted(int(row['plants']), 'plant')}, {row['area_m2']:,.0f} m\u00b2",
                lots=layers.lots[[number]],
                area=areas.get(row["lot_id"]),
                colour=layers.zones[layers.lot_zone[number]].colour,
                crowns=crowns.chosen(plant_lot == row["lot_id"]),
                neighbours=layers.lots[beside[beside != number]],
                buildings=layers.buildings[near],
                building_height_m=layers.building_height_m[near],
            )
        )
    return pictures


def draw_lots(
    pictures: Sequence[LotPicture],
    *,
    columns: int = 4,
    width_px: int = 2000,
    aspect: float = 1.0,
    heading: tuple[str, str] | None = None,
) -> Figure:
    """Draw pictures side by side, each at its own scale with a scale bar.

    Parameters
    ----------
    pictures
        What to draw, row by row.
    columns
        Pictures a row.
    width_px
        Width of the whole; everything scales with it.
    aspect
        Height of a picture over its width.
    heading
        Title of the page and the line below it; the page then has margins too.
    """
    unit = width_px / 2000
    columns = max(1, min(columns, len(pictures)))
    margin = 80 * unit if heading else 0.0
    gap, foot = 36 * unit, 96 * unit
    head = margin + 120 * unit if heading else 0.0
    side = (width_px - 2 * margin - gap * (columns - 1)) / columns
    lines = -(-len(pictures) // columns)
    height_px = max(1, round(head + lines * (side * aspect + foot) + margin * 0.5))
    figure = Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    canvas = figure.add_axes((0, 0, 1, 1), zorder=10)
    canvas.set(xlim=(0, width_px), ylim=(height_px, 0))
    canvas.axis("off")

    def write(x: float, y: float, text: str, size: float, colour: str, **style: Any) -> None:
        points = size * unit * 72 / DPI
        canvas.text(x, y, printable(text), fontsize=points, color=colour, parse_math=False, **style)

    if heading:
        write(margin, margin, heading[0], 40, INK, va="top", weight="bold")
        write(margin, margin + 62 * unit, heading[1], 21, SOFT_INK, va="top")
    for number, picture in enumerate(pictures):
        line, column = divmod(number, columns)
        left, top = margin + column * (side + gap), head + line * (side * aspect + foot)
        pane = _draw_lot(figure, picture, (left, top, side, side * aspect))
        bottom = top + side * aspect
        title_letters, note_letters = int((0.75 * side / unit) / 14), int((side / unit - 60) / 10.5)
        write(left, bottom + 12 * unit, shortened(picture.title, title_letters), 22, INK, va="top", weight="bold")
        write(left, bottom + 44 * unit, shortened(picture.note, note_letters), 19, SOFT_INK, va="top")
        length_m = round_length(0.2 * side / pane.px_per_m)
        right, y = left + side, bottom + 24 * unit
        canvas.plot([right - length_m * pane.px_per_m, right], [y, y], color=INK, linewidth=2.4 * unit * 72 / DPI,
                    solid_capstyle="butt")  # fmt: skip
        write(right, y + 8 * unit, f"{length_m:g} m", 17, INK, ha="right", va="top")
    return figure


def _draw_lot(figure: Figure, picture: LotPicture, box_px: Bounds) -> Pane:
    west, south, east, north = shapely.total_bounds(picture.lots)
    rim = 0.06 * max(east - west, north - south) + 2.0
    pane = make_pane(figure, box_px, (west - rim, south - rim, east + rim, north + rim), GROUND)
    fill_polygons(pane, picture.neighbours, mixed(GROUND, "#ffffff", 0.45), edge="#dedad1", edge_px=1.0, z=1.0)
    draw_roads(pane, picture.roads, fill=ROAD_FILL, casing=ROAD_CASING, z=1.5)
    fill_polygons(pane, picture.lots, picture.colour, z=2.0)
    if picture.area is not None:
        area = np.array([picture.area], dtype=object)
        fill_polygons(pane, area, AREA_FILL, edge=AREA_EDGE, edge_px=1.2, alpha=0.55, z=2.2)
    if picture.envelope is not None:
        envelope = np.array([picture.envelope], dtype=object)
        fill_polygons(pane, envelope, ENVELOPE_FILL, edge=mixed(ENVELOPE_FILL, INK, 0.3), edge_px=1.2, alpha=0.6, z=2.3)
    fill_polygons(pane, picture.lots, "none", edge=mixed(picture.colour, "#4a463e", 0.7), edge_px=2.6, z=2.5)
    cast_shadows(pane, picture.buildings, picture.building_height_m, alpha=0.26, z=3.0)
    fill_polygons(pane, picture.buildings, BUILDING_FILL, edge=BUILDING_EDGE, edge_px=1.5, z=3.2)
    draw_crowns(pane, picture.crowns)
    for (x, y), radius_m, label in zip(picture.crowns.xy, picture.crowns.radius_m, picture.labels, strict=False):
        pane.axes.text(x, y, printable(label), fontsize=pane.points(0.95 * radius_m * pane.px_per_m), color="#ffffff",
                       ha="center", va="center_baseline", zorder=9, parse_math=False)  # fmt: skip
    return pane
