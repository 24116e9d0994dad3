"""The map: lots by zone, buildings, roads and every plant, with legend, scale bar and north arrow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from urbanforest_cli.core.colours import mixed
from urbanforest_cli.export.crowns import draw_crowns
from urbanforest_cli.export.drawing import Bounds, Pane, cast_shadows, draw_roads, fill_polygons, make_pane
from urbanforest_cli.export.map_layers import MapLayers
from urbanforest_cli.export.map_page import (
    BUILDING_EDGE,
    BUILDING_FILL,
    GROUND,
    HAIRLINE,
    INK,
    REGION_EDGE,
    REGION_FILL,
    ROAD_CASING,
    ROAD_FILL,
    SOFT_INK,
    Legend,
    Page,
    SeenCounts,
)

STREET_ZONE = "street"


def draw_map(
    layers: MapLayers, *, title: str, notes: Sequence[str] = (), width_px: int = 2400, bbox: Bounds | None = None
) -> Figure:
    """Draw the map of a city.

    Parameters
    ----------
    layers
        What to show.
    title
        Name of the place.
    notes
        Lines for the foot: coordinate system, what made the map.
    width_px
        Width of the picture; everything scales with it.
    bbox
        West, south, east, north of the part to show, in the layers' CRS; all of it if None. Counts are those of
        what is shown.

    Returns
    -------
    A figure with an Agg canvas; its size in inches times its dpi is the picture in pixels.
    """
    shown = bbox or ground_bounds(layers)
    seen = SeenCounts.of(layers, bbox)
    page = Page(width_px, shown, legend_rows=seen.legend_rows())
    figure = page.figure
    page.text(page.margin, page.margin + 34 * page.unit, title, 46, INK, va="center", weight="bold")
    page.text(page.margin, page.margin + 92 * page.unit, seen.sentence(), 23, SOFT_INK, va="center")
    pane = make_pane(figure, page.pane_box, shown, GROUND)
    draw_ground(pane, layers)
    draw_crowns(pane, layers.crowns())
    pane.axes.add_patch(Rectangle((0, 0), 1, 1, transform=pane.axes.transAxes, facecolor="none", edgecolor=HAIRLINE,
                                  linewidth=pane.points(2 * page.unit), zorder=20, clip_on=False))  # fmt: skip
    Legend(page, layers, seen, pane).draw()
    for number, note in enumerate(notes):
        top = page.height_px - page.margin * 0.8 - (len(notes) - 1 - number) * 30 * page.unit
        page.text(page.margin, top, note, 17, SOFT_INK, va="bottom")
    return figure


def ground_bounds(layers: MapLayers) -> Bounds:
    """Return the bounds of the lots and a little around them."""
    if len(layers.lots):
        west, south, east, north = shapely.total_bounds(layers.lots)
    else:
        west = south = east = north = 0.0
    if not np.isfinite([west, south, east, north]).all():
        west = south = east = north = 0.0
    rim = max(0.02 * max(east - west, north - south), 5.0)
    return west - rim, south - rim, east + rim, north + rim


def draw_ground(pane: Pane, layers: MapLayers) -> None:
    """Draw lots by zone, vegetation of a coverage map, roads and buildings."""
    edge_px = lot_edge_px(pane, layers.lots)
    # Roads lie over the street's own lots and under everybody else's.
    order = sorted(range(len(layers.zones)), key=lambda number: layers.zones[number].name != STREET_ZONE)
    for number in order:
        colour = layers.zones[number].colour
        z = 1.0 if layers.zones[number].name == STREET_ZONE else 3.0
        lots = layers.lots[layers.lot_zone == number]
        fill_polygons(pane, lots, colour, edge=mixed(colour, "#6f6a60", 0.32), edge_px=edge_px, z=z)
    draw_roads(pane, layers.roads, fill=ROAD_FILL, casing=ROAD_CASING, z=2.0)
    fill_polygons(pane, layers.regions, REGION_FILL, edge=REGION_EDGE, edge_px=min(1.2, 1.5 * pane.px_per_m), z=3.2)
    cast_shadows(pane, layers.buildings, layers.building_height_m, alpha=0.28, z=3.5)
    building_edge_px = min(1.6, 2.2 * pane.px_per_m) if pane.px_per_m > 0.2 else 0.0
    fill_polygons(pane, layers.buildings, BUILDING_FILL, edge=BUILDING_EDGE, edge_px=building_edge_px, z=4.0)


def lot_edge_px(pane: Pane, lots: NDArray[np.object_]) -> float:
    """Return how wide to draw the lots' edges: none where lots are so small that edges would be all one sees."""
    if len(lots) == 0:
        return 0.0
    side_px = float(np.sqrt(np.median(shapely.area(lots)))) * pane.px_per_m
    return 0.0 if side_px < 7 else min(2.0, side_px / 28)
