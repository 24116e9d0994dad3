"""What maps are drawn with: panes of ground at one scale, polygons by the thousand, soft shadows.

All lengths on the ground are metres; a pane is a matplotlib axes that fills its share of the picture and whose data
coordinates are easting and northing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

FloatArray = NDArray[np.float64]
Bounds = tuple[float, float, float, float]

VERTICES_A_PATH = 100_000
SHADOW_COLOUR = "#2b2f38"
POINTS_AN_INCH = 72.0


@dataclass(frozen=True)
class Pane:
    """A drawing area: the ground it shows and its scale."""

    axes: Axes
    bounds: Bounds
    px_per_m: float

    @property
    def dpi(self) -> float:
        """Pixels an inch of the figure."""
        return float(self.axes.get_figure(root=True).dpi)  # type: ignore[union-attr]

    def points(self, pixels: float) -> float:
        """Return a length in pixels in points."""
        return pixels * POINTS_AN_INCH / self.dpi

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the pane in pixels."""
        west, south, east, north = self.bounds
        return max(1, round((north - south) * self.px_per_m)), max(1, round((east - west) * self.px_per_m))


def make_pane(figure: Figure, box_px: Bounds, bounds: Bounds, colour: str) -> Pane:
    """Add a pane to a figure.

    Parameters
    ----------
    figure
        Where to add it.
    box_px
        Left, top, width and height within the picture, in pixels from its upper left corner.
    bounds
        Ground to show; widened on both sides to fill the box at one scale.
    colour
        Ground where nothing is drawn.
    """
    left, top, width, height = box_px
    full_width, full_height = figure.get_size_inches() * figure.dpi
    axes = figure.add_axes((left / full_width, 1 - (top + height) / full_height, width / full_width,
                            height / full_height))  # fmt: skip
    west, south, east, north = bounds
    scale = min(width / max(east - west, 1e-9), height / max(north - south, 1e-9))
    middle_x, middle_y = (west + east) / 2, (south + north) / 2
    half_width, half_height = width / scale / 2, height / scale / 2
    shown = (middle_x - half_width, middle_y - half_height, middle_x + half_width, middle_y + half_height)
    axes.set(xlim=(shown[0], shown[2]), ylim=(shown[1], shown[3]), xticks=[], yticks=[], facecolor=colour)
    axes.set_autoscale_on(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return Pane(axes, shown, scale)


def compound_paths(polygons: NDArray[np.object_], *, vertices: int = VERTICES_A_PATH) -> Iterator[Path]:
    """Yield paths that each hold the rings of many polygons, holes running against the shells.

    One path is filled in one go: no seams between neighbours, no double tint where polygons overlap.
    """
    parts = shapely.get_parts(polygons)
    parts = parts[(shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & ~shapely.is_empty(parts)]
    if len(parts) == 0:
        return
    owner = np.repeat(np.arange(len(parts)), shapely.get_num_interior_rings(parts) + 1)
    rings = shapely.get_rings(parts)
    shell = np.r_[True, owner[1:] != owner[:-1]]
    wrong = shapely.is_ccw(rings) != shell
    rings[wrong] = shapely.reverse(rings[wrong])
    xy = shapely.get_coordinates(rings)
    ends = np.cumsum(shapely.get_num_coordinates(rings))
    codes = np.full(len(xy), Path.LINETO, dtype=Path.code_type)
    codes[np.r_[0, ends[:-1]]] = Path.MOVETO
    codes[ends - 1] = Path.CLOSEPOLY
    # A path ends where a polygon does, so that a hole is always in the same path as its shell.
    polygon_ends = ends[np.r_[shell[1:], True]]
    start = 0
    while start < len(xy):
        stop = int(polygon_ends[min(int(np.searchsorted(polygon_ends, start + vertices)), len(polygon_ends) - 1)])
        yield Path(xy[start:stop], codes[start:stop])
        start = stop


def line_paths(lines: NDArray[np.object_], *, vertices: int = VERTICES_A_PATH) -> Iterator[Path]:
    """Yield paths that each hold many lines."""
    parts = shapely.get_parts(lines)
    parts = parts[np.isin(shapely.get_type_id(parts), (1, 2)) & ~shapely.is_empty(parts)]
    if len(parts) == 0:
        return
    xy = shapely.get_coordinates(parts)
    ends = np.cumsum(shapely.get_num_coordinates(parts))
    codes = np.full(len(xy), Path.LINETO, dtype=Path.code_type)
    codes[np.r_[0, ends[:-1]]] = Path.MOVETO
    start = 0
    while start < len(xy):
        stop = int(ends[min(int(np.searchsorted(ends, start + vertices)), len(ends) - 1)])
        yield Path(xy[start:stop], codes[start:stop])
        start = stop


def fill_polygons(
    pane: Pane, polygons: NDArray[np.object_], colour: str, *, edge: str | None = None, edge_px: float = 0.0,
    alpha: float | None = None, z: float = 1.0,
) -> None:  # fmt: skip
    """Fill polygons with one colour, and draw their edges over it where an edge colour is given."""
    for path in compound_paths(shown_polygons(pane, polygons)):
        pane.axes.add_artist(PathPatch(path, facecolor=colour, edgecolor="none", linewidth=0, alpha=alpha, zorder=z))
        if edge is not None and edge_px > 0.05:
            line = PathPatch(path, facecolor="none", edgecolor=edge, linewidth=pane.points(edge_px), alpha=alpha,
                             joinstyle="round", zorder=z + 0.01)  # fmt: skip
            pane.axes.add_artist(line)


def shown_polygons(pane: Pane, polygons: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return those polygons that reach into the pane, without detail below a third of a pixel."""
    if len(polygons) == 0:
        return polygons
    west, south, east, north = shapely.bounds(polygons).T
    pw, ps, pe, pn = pane.bounds
    with np.errstate(invalid="ignore"):
        seen = polygons[(east >= pw) & (west <= pe) & (north >= ps) & (south <= pn)]
    tolerance_m = 0.3 / pane.px_per_m
    return np.asarray(shapely.simplify(seen, tolerance_m, preserve_topology=False)) if tolerance_m > 0.2 else seen


def draw_roads(pane: Pane, roads: NDArray[np.object_], *, fill: str, casing: str, z: float) -> None:
    """Draw surfaces of roads with a fine casing around all of them together."""
    if len(roads) == 0:
        return
    surfaces = shapely.orient_polygons(roads)  # those that overlap are then filled, not cut out
    casing_px = min(1.0, 2.5 * pane.px_per_m)
    fill_polygons(pane, surfaces, casing, edge=casing, edge_px=2 * casing_px, z=z)
    fill_polygons(pane, surfaces, fill, edge=fill, edge_px=0.3, z=z + 0.02)


def cast_shadows(pane: Pane, polygons: NDArray[np.object_], height_m: FloatArray, *, alpha: float, z: float) -> None:
    """Darken the ground to the lower right of buildings, the further the taller they are.

    The shadow is the footprint swept along its way in steps of at most half a building's width, then blurred.
    """
    if len(polygons) == 0 or pane.px_per_m < 0.15:
        return
    length = np.minimum(0.3 * height_m, 8.0)
    swept = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        step = (share * length)[:, None] * np.array([[0.8, -0.6]])
        counts = shapely.get_num_coordinates(polygons)
        moved = shapely.get_coordinates(polygons) + np.repeat(step, counts, axis=0)
        swept.append(shapely.set_coordinates(polygons.copy(), moved))

    def paint(copy: Pane) -> None:
        for part in swept:
            fill_polygons(copy, part, "#000000")

    tint(pane, painted_share(pane, paint), blur_px=0.6 * pane.px_per_m, alpha=alpha, z=z)


def painted_share(pane: Pane, paint: Callable[[Pane], None]) -> FloatArray:
    """Return how much of each pixel is painted black, 0 to 1, at the pane's own size."""
    rows, columns = pane.shape
    figure = Figure(figsize=(columns / 100, rows / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    copy = make_pane(figure, (0, 0, columns, rows), pane.bounds, "#ffffff")
    paint(copy)
    canvas.draw()  # type: ignore[no-untyped-call]
    red = np.asarray(canvas.buffer_rgba())[..., 0]  # type: ignore[no-untyped-call]
    return 1.0 - red.astype(np.float64) / 255


def tint(pane: Pane, mask: FloatArray, *, blur_px: float, alpha: float, z: float) -> None:
    """Lay a shadow over the pane, its strength a share from 0 to 1 for each pixel, blurred."""
    if blur_px > 0.3:
        mask = gaussian_filter(mask, blur_px)
    picture = np.empty((*mask.shape, 4), dtype=np.uint8)
    picture[..., :3] = np.round(255 * np.array(to_rgb(SHADOW_COLOUR)))
    picture[..., 3] = np.round(255 * alpha * np.clip(mask, 0, 1))
    lay_picture(pane, picture, z)


def lay_picture(pane: Pane, picture: NDArray[np.uint8], z: float) -> None:
    """Lay red, green, blue and opacity over the pane, a pixel each, (rows, columns, 4)."""
    west, south, east, north = pane.bounds
    pane.axes.imshow(picture, extent=(west, east, south, north), interpolation="bilinear", zorder=z, aspect="auto")
