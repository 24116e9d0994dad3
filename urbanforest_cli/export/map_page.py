"""The page around a map: its size, title, legend, scale bar and north arrow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from numpy.typing import NDArray

from urbanforest_cli.core.colours import mixed
from urbanforest_cli.export.drawing import Bounds, Pane
from urbanforest_cli.export.map_layers import MapLayers
from urbanforest_cli.export.text import counted, length_text, printable, round_length, shortened

DPI = 200
PAPER = "#fcfbf8"
GROUND = "#f1efe9"
INK = "#2d3136"
SOFT_INK = "#7b7f82"
HAIRLINE = "#d8d4cb"
ROAD_FILL = "#fffefc"
ROAD_CASING = "#dcd8cf"
BUILDING_FILL = "#fbfaf8"
BUILDING_EDGE = "#aaa69d"
REGION_FILL = "#a9bd8c"
REGION_EDGE = "#7d9a5c"
SPECIES_SHOWN = 14
ZONES_SHOWN = 9
WIDEST, TALLEST = 3.4, 0.62


@dataclass(frozen=True)
class SeenCounts:
    """How many lots a zone, plants a species, trees, buildings and lots filled from a coverage map are shown."""

    lots: NDArray[np.int64]
    plants: NDArray[np.int64]
    tree_count: int
    building_count: int
    region_count: int

    @classmethod
    def of(cls, layers: MapLayers, bbox: Bounds | None) -> SeenCounts:
        """Count what lies in bounds, or all."""
        zone, species, building_count = layers.lot_zone, layers.plant_species, len(layers.buildings)
        region_count = len(layers.regions)
        if bbox is not None:
            west, south, east, north = bbox
            box = shapely.box(*bbox)
            zone = zone[shapely.intersects(layers.lots, box)]
            building_count = int(shapely.intersects(layers.buildings, box).sum())
            region_count = int(shapely.intersects(layers.regions, box).sum())
            x, y = layers.plant_xy[:, 0], layers.plant_xy[:, 1]
            species = species[(x >= west) & (x <= east) & (y >= south) & (y <= north)]
        plants = np.bincount(species, minlength=len(layers.species))
        tall = np.array([item.tall for item in layers.species], dtype=bool)
        return cls(np.bincount(zone, minlength=len(layers.zones)), plants, int(plants[tall].sum()),
                   building_count, region_count)  # fmt: skip

    def legend_rows(self) -> int:
        """Return how many rows a legend of two columns of species takes."""
        zones = int((self.lots > 0).sum()) + (self.building_count > 0) + (self.region_count > 0)
        species = min(int((self.plants > 0).sum()), SPECIES_SHOWN)
        return max(min(zones, ZONES_SHOWN), -(-species // 2), 4)

    def sentence(self) -> str:
        """Return the line under the title."""
        plants = int(self.plants.sum())
        parts = [
            counted(int(self.lots.sum()), "lot"),
            f"{counted(plants, 'plant')}: {counted(self.tree_count, 'tree')}, "
            f"{counted(plants - self.tree_count, 'shrub')}",
            counted(int((self.plants > 0).sum()), "species", "species"),
        ]
        return "   \u00b7   ".join(parts)


class Page:
    """Size and layout of the picture, in pixels from its upper left corner."""

    def __init__(self, width_px: int, bounds: Bounds, *, legend_rows: int) -> None:
        self.unit = width_px / 2400
        self.row = 42 * self.unit
        self.margin = 96 * self.unit
        west, south, east, north = bounds
        aspect = float(np.clip((east - west) / max(north - south, 1e-9), TALLEST, WIDEST))
        self.legend_below = aspect >= 1.2
        top = self.margin + 150 * self.unit
        foot = 150 * self.unit
        inner = width_px - 2 * self.margin
        if self.legend_below:
            height = inner / aspect
            legend_height = 60 * self.unit + legend_rows * self.row
            self.pane_box: Bounds = (self.margin, top, inner, height)
            self.legend_box: Bounds = (self.margin, top + height + 44 * self.unit, inner, legend_height)
            self.height_px = round(top + height + legend_height + foot + 40 * self.unit)
        else:
            legend_width = 520 * self.unit
            width = inner - legend_width - 64 * self.unit
            height = max(width / aspect, 1250 * self.unit)
            self.pane_box = (self.margin, top, width, height)
            self.legend_box = (self.margin + width + 64 * self.unit, top, legend_width, height)
            self.height_px = round(top + height + foot)
        self.width_px = width_px
        self.figure = Figure(figsize=(width_px / DPI, self.height_px / DPI), dpi=DPI, facecolor=PAPER)
        FigureCanvasAgg(self.figure)
        # One axes over the whole page, in pixels from the upper left, for legend and marks.
        self.canvas = self.figure.add_axes((0, 0, 1, 1), zorder=10)
        self.canvas.set(xlim=(0, width_px), ylim=(self.height_px, 0))
        self.canvas.axis("off")
        self.canvas.patch.set_visible(False)

    def text(self, x: float, y: float, text: str, size: float, colour: str, **style: object) -> None:
        """Write text; `size` is its height in pixels of a page 2400 wide."""
        points = size * self.unit * 72 / DPI
        self.canvas.text(x, y, printable(text), fontsize=points, color=colour, parse_math=False, **style)  # type: ignore[arg-type]


class Legend:
    """Zones, species, north arrow and scale bar: below the map or at its right."""

    def __init__(self, page: Page, layers: MapLayers, seen: SeenCounts, pane: Pane) -> None:
        self.page, self.layers, self.seen, self.pane = page, layers, seen, pane
        self.row = page.row

    def draw(self) -> None:
        """Draw it all."""
        unit = self.page.unit
        left, top, width, height = self.page.legend_box
        if self.page.legend_below:
            rows = round((height - 60 * unit) / self.row)
            self._zones(left, top, 430 * unit, rows)
            self._species(left + 520 * unit, top, 470 * unit, rows, columns=2)
            self._north(left + width - 34 * unit, top + 70 * unit)
            self._scale_bar(left + width - 520 * unit, top + height - 56 * unit, 520 * unit, right=True)
        else:
            used = self._zones(left, top, width, ZONES_SHOWN)
            self._species(left, used + 40 * unit, width, SPECIES_SHOWN, columns=1)
            self._north(left + 34 * unit, top + height - 190 * unit)
            self._scale_bar(left, top + height - 40 * unit, width, right=False)

    def _heading(self, left: float, top: float, text: str) -> float:
        self.page.text(left, top, text.upper(), 18, SOFT_INK, va="top", weight="bold")
        return top + 56 * self.page.unit

    def _zones(self, left: float, top: float, width: float, rows: int) -> float:
        y = self._heading(left, top, "Zones, lots")
        unit = self.page.unit
        order = [n for n in np.argsort(-self.seen.lots, kind="stable") if self.seen.lots[n] > 0]
        for number in order[:rows]:
            zone = self.layers.zones[number]
            self._box(left, y, zone.colour, mixed(zone.colour, "#6f6a60", 0.45))
            self._row(left + 62 * unit, left + width, y, zone.name, int(self.seen.lots[number]))
            y += self.row
        for label, fill, edge, count in (
            ("filled from the map", REGION_FILL, REGION_EDGE, self.seen.region_count),
            ("buildings", BUILDING_FILL, BUILDING_EDGE, self.seen.building_count),
        ):
            if count:
                self._box(left, y, fill, edge)
                self._row(left + 62 * unit, left + width, y, label, count)
                y += self.row
        return y

    def _box(self, left: float, y: float, fill: str, edge: str) -> None:
        unit = self.page.unit
        box = Rectangle((left, y - 14 * unit), 42 * unit, 28 * unit, facecolor=fill, edgecolor=edge,
                        linewidth=self.pane.points(1.5 * unit))  # fmt: skip
        self.page.canvas.add_patch(box)

    def _species(self, left: float, top: float, width: float, rows: int, *, columns: int) -> None:
        y0 = self._heading(left, top, "Species, plants")
        unit = self.page.unit
        order = [n for n in np.argsort(-self.seen.plants, kind="stable") if self.seen.plants[n] > 0]
        places = min(SPECIES_SHOWN, rows * columns)
        rest = order[places:] if len(order) <= places else order[places - 1 :]
        for place, number in enumerate(order[: len(order) - len(rest)]):
            item = self.layers.species[number]
            column, line = divmod(place, -(-min(places, len(order)) // columns))
            x, y = left + column * (width + 70 * unit), y0 + line * self.row
            radius = (17 if item.tall else 11) * unit
            crown = Circle((x + 18 * unit, y), radius, facecolor=item.colour, linewidth=self.pane.points(1.5 * unit),
                           edgecolor=mixed(item.colour, "#000000", 0.38))  # fmt: skip
            self.page.canvas.add_patch(crown)
            self._row(x + 52 * unit, x + width, y, item.label, int(self.seen.plants[number]))
        if rest:
            column, line = divmod(places - 1, -(-places // columns))
            x, y = left + column * (width + 70 * unit), y0 + line * self.row
            self._row(x + 52 * unit, x + width, y, f"{len(rest)} more", int(self.seen.plants[rest].sum()))
        if not order:
            self.page.text(left, y0, "none", 21, SOFT_INK, va="center")

    def _row(self, left: float, right: float, y: float, label: str, count: int) -> None:
        self.page.text(left, y, shortened(label, 27), 21, INK, va="center_baseline")
        self.page.text(right, y, f"{count:,}", 21, SOFT_INK, va="center_baseline", ha="right")

    def _north(self, x: float, y: float) -> None:
        unit = self.page.unit
        for side, colour in ((-1, INK), (1, PAPER)):
            half = Polygon([(x, y - 46 * unit), (x + side * 22 * unit, y + 30 * unit), (x, y + 14 * unit)],
                           facecolor=colour, edgecolor=INK, linewidth=self.pane.points(1.6 * unit),
                           joinstyle="miter")  # fmt: skip
            self.page.canvas.add_patch(half)
        self.page.text(x, y - 56 * unit, "N", 22, INK, va="bottom", ha="center", weight="bold")

    def _scale_bar(self, left: float, y: float, width: float, *, right: bool) -> None:
        unit, scale = self.page.unit, self.pane.px_per_m
        length_m = round_length(0.8 * width / scale)
        length = length_m * scale
        x = left + width - length if right else left
        for number in range(4):
            part = Rectangle(
                (x + number * length / 4, y),
                length / 4,
                12 * unit,
                edgecolor=INK,
                facecolor=INK if number % 2 == 0 else PAPER,
                linewidth=self.pane.points(1.4 * unit),
            )
            self.page.canvas.add_patch(part)
        for share in (0.0, 0.5, 1.0):
            text = length_text(share * length_m, unit_of=length_m)
            text = text if share == 1 else text.split()[0]
            align = "left" if share == 0 else "right" if share == 1 else "center"
            self.page.text(x + share * length, y + 26 * unit, text, 19, INK, va="top", ha=align)
