"""Plants seen from above: crowns at their true radius, or a tint where they are smaller than a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib.collections import PathCollection
from matplotlib.path import Path
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from urbanforest_cli.export.drawing import Bounds, FloatArray, Pane, lay_picture, painted_share, tint

SMALLEST_CROWN_PX = 0.7
RIMMED_CROWN_PX = 2.5
SHADED_CROWN_PX = 7.0
CROWN_OPACITY = 0.94


@dataclass(frozen=True)
class Crowns:
    """Plants seen from above.

    Parameters
    ----------
    xy
        (n, 2) easting and northing.
    radius_m
        (n,)
    colour
        (n, 3) red, green and blue from 0 to 1.
    tall
        (n,) whether the plant is a tree, drawn over all shrubs.
    """

    xy: FloatArray
    radius_m: FloatArray
    colour: FloatArray
    tall: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.xy)

    def chosen(self, mask: NDArray[np.bool_]) -> Crowns:
        """Return the plants of a mask."""
        return Crowns(self.xy[mask], self.radius_m[mask], self.colour[mask], self.tall[mask])

    def seen_in(self, bounds: Bounds) -> Crowns:
        """Return the plants whose crowns reach into bounds."""
        west, south, east, north = bounds
        x, y, r = self.xy[:, 0], self.xy[:, 1], self.radius_m
        return self.chosen((x + r >= west) & (x - r <= east) & (y + r >= south) & (y - r <= north))


def draw_crowns(pane: Pane, crowns: Crowns, *, z: float = 5.0, shadows: bool = True) -> None:
    """Draw plants as crowns of their true radius: shrubs first, then trees, small ones under large ones.

    Crowns under a pixel become a tint whose strength is the share of the pixel they cover.
    """
    crowns = crowns.seen_in(pane.bounds)
    radius_px = crowns.radius_m * pane.px_per_m
    for level, tall in enumerate((False, True)):
        group = crowns.tall == tall
        fine = group & (radius_px < SMALLEST_CROWN_PX)
        _draw_density(pane, crowns.chosen(fine), z + level)
        body = crowns.chosen(group & ~fine)
        if len(body) == 0:
            continue
        if shadows and pane.px_per_m >= 0.6:
            _cast_crowns(pane, body, 0.30 if tall else 0.16, z + level + 0.1)
        order = np.lexsort((body.xy[:, 0], -body.xy[:, 1], body.radius_m))
        body = Crowns(body.xy[order], body.radius_m[order], body.colour[order], body.tall[order])
        size = body.radius_m * pane.px_per_m
        _draw_discs(pane, body.chosen(size < RIMMED_CROWN_PX), z + level + 0.2, rim=False, shaded=False)
        middle = (size >= RIMMED_CROWN_PX) & (size < SHADED_CROWN_PX)
        _draw_discs(pane, body.chosen(middle), z + level + 0.3, rim=True, shaded=False)
        _draw_discs(pane, body.chosen(size >= SHADED_CROWN_PX), z + level + 0.4, rim=True, shaded=True)


def _cast_crowns(pane: Pane, crowns: Crowns, alpha: float, z: float) -> None:
    moved = crowns.xy + (0.42 * crowns.radius_m)[:, None] * np.array([[0.8, -0.6]])
    black = Crowns(moved, crowns.radius_m, np.zeros((len(crowns), 3)), crowns.tall)
    mask = painted_share(pane, lambda copy: _draw_discs(copy, black, 1.0, rim=False, shaded=False, opacity=1.0))
    tint(pane, mask, blur_px=0.35 * pane.px_per_m, alpha=alpha, z=z)


def _draw_discs(
    pane: Pane, crowns: Crowns, z: float, *, rim: bool, shaded: bool, opacity: float = CROWN_OPACITY
) -> None:
    if len(crowns) == 0:
        return
    radius_px = crowns.radius_m * pane.px_per_m
    # Layers of a crown lie next to one another in the list, so that a crown drawn later covers all of an earlier one.
    layers = [(np.zeros(2), 1.0, 0.0, opacity)]
    if shaded:
        layers += [(np.array([-0.16, 0.13]), 0.70, 0.10, 0.6), (np.array([-0.27, 0.23]), 0.38, 0.20, 0.35)]
    count = len(layers)
    offsets = np.empty((len(crowns) * count, 2))
    sizes = np.empty(len(crowns) * count)
    faces = np.empty((len(crowns) * count, 4))
    for number, (shift, share, lightened, strength) in enumerate(layers):
        offsets[number::count] = crowns.xy + crowns.radius_m[:, None] * shift
        sizes[number::count] = pane.points(radius_px * share) ** 2  # type: ignore[arg-type]
        faces[number::count, :3] = crowns.colour + (1 - crowns.colour) * lightened
        faces[number::count, 3] = strength
    edges = np.zeros_like(faces)
    widths = np.zeros(len(offsets))
    if rim:
        edges[::count, :3] = crowns.colour * 0.62
        edges[::count, 3] = 0.85
        # The rim lies inside the crown, so that the crown keeps its radius.
        width_px = np.clip(0.07 * radius_px, 0.35, 2.2)
        widths[::count] = pane.points(width_px)  # type: ignore[arg-type]
        sizes[::count] = pane.points(radius_px - width_px / 2) ** 2  # type: ignore[arg-type]
    outline = _outline(10 if radius_px.max() < RIMMED_CROWN_PX else 22 if radius_px.max() < 20 else 64)
    collection = PathCollection([outline], sizes=sizes, offsets=offsets, offset_transform=pane.axes.transData,
                                facecolors=faces, edgecolors=edges if rim else "none", linewidths=widths,
                                zorder=z)  # fmt: skip
    collection.set_transform(IdentityTransform())
    pane.axes.add_collection(collection, autolim=False)


@cache
def _outline(corners: int) -> Path:
    """Return a regular polygon of the area of the unit circle."""
    angle = np.linspace(0, 2 * np.pi, corners + 1)
    radius = np.sqrt(2 * np.pi / (corners * np.sin(2 * np.pi / corners)))
    return Path(radius * np.column_stack((np.cos(angle), np.sin(angle))), closed=True)


def _draw_density(pane: Pane, crowns: Crowns, z: float) -> None:
    """Tint each pixel by the crowns in it: mean colour, opacity 1 - exp(-1.5 cover).

    The factor makes up for the rims and shadows by which larger crowns stand out.
    """
    if len(crowns) == 0:
        return
    west, _, _, north = pane.bounds
    rows, columns = pane.shape
    column = np.clip((crowns.xy[:, 0] - west) * pane.px_per_m, 0, columns - 1).astype(np.int64)
    row = np.clip((north - crowns.xy[:, 1]) * pane.px_per_m, 0, rows - 1).astype(np.int64)
    pixel = row * columns + column
    cover = np.pi * (crowns.radius_m * pane.px_per_m) ** 2
    total = np.bincount(pixel, weights=cover, minlength=rows * columns)
    picture = np.zeros((rows * columns, 4), dtype=np.uint8)
    some = total > 0
    for band in range(3):
        tint = np.bincount(pixel, weights=cover * crowns.colour[:, band], minlength=rows * columns)
        picture[some, band] = np.round(255 * tint[some] / total[some])
    picture[:, 3] = np.round(255 * -np.expm1(-1.5 * total))
    lay_picture(pane, picture.reshape(rows, columns, 4), z)
