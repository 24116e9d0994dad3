"""Medial axes of many polygons at once (paper, strategy equidistant)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.placement.axis_kernel import axes_of_parts
from urbanforest_cli.placement.axis_samples import FAILED

CORNER_FACTOR = 2.4
BRANCH_FACTOR = 1.6
MEND_M = 0.01


@dataclass(frozen=True)
class MedialAxes:
    """The axes of a batch of polygons as chains of nodes.

    The chains of a polygon stand together, those of one of its parts together in them, the longest path of a part
    first. A chain that hangs on another starts with the node of the other it hangs on.

    Parameters
    ----------
    xy, radius_m
        (n, 2) nodes in metres, and (n,) the distance of each to the polygon's edge.
    chain_offsets
        (chains + 1,) where each chain's nodes begin. A chain may be one node, as in a square.
    chain_part, chain_site
        (chains,) index of the part of a polygon it belongs to, counted through, and of the polygon, both
        non-decreasing.
    chain_closed
        (chains,) whether the chain is a loop; its first node is repeated at the end.
    failed
        (polygons,) whether a part has no axis because its rings touch themselves in a way that cannot be mended.
    """

    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    chain_offsets: NDArray[np.int64]
    chain_part: NDArray[np.int64]
    chain_site: NDArray[np.int64]
    chain_closed: NDArray[np.bool_]
    failed: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.failed)

    def chain_lengths_m(self) -> NDArray[np.float64]:
        """Return the length of each chain."""
        steps = np.hypot(*np.diff(self.xy, axis=0).T) if len(self.xy) > 1 else np.zeros(0)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        return np.asarray(along[self.chain_offsets[1:] - 1] - along[self.chain_offsets[:-1]])

    def lengths_m(self) -> NDArray[np.float64]:
        """Return the length of each polygon's axis."""
        return np.bincount(self.chain_site, self.chain_lengths_m(), minlength=len(self)).astype(np.float64)


def medial_axes(
    polygons: NDArray[np.object_],
    *,
    step_m: float | None = None,
    corner_factor: float = CORNER_FACTOR,
    branch_factor: float = BRANCH_FACTOR,
) -> MedialAxes:
    """Find the medial axes of polygons in a planar CRS in metres.

    The axis is where a point is as far from two parts of the edge as it can be (Blum 1967; Choi, Choi and Moon
    1997), found from the Voronoi diagram of samples of the edge and exact there where the edge is straight. What
    is thinner than 2 cm has none.

    Parameters
    ----------
    polygons
        (n,) polygons or multipolygons, holes allowed; empty and missing ones have no axis.
    step_m
        Distance of samples, made smaller in narrow polygons; by default a fifth of a polygon's mean width, but 1 to
        2 m where it is wide. Nodes are as exact one way or the other; between them the axis is taken as straight.
    corner_factor
        A branch from a junction, where the largest circle in the polygon has radius R, down to a corner is cut off
        if it is at most so many R long. 2.4 cuts off what runs into corners wider than 49 degrees, so that a row
        ends before the end of a lot, not in a corner of it; 0 keeps all.
    branch_factor
        A branch to another end, where the circle has radius r, is cut off if it is at most so many R - r long.
    """
    parts, part_site = _polygons_in_fixed_order(*shapely.get_parts(polygons, return_index=True))
    choices = float(step_m or 0.0), float(corner_factor), float(branch_factor)
    xy, radius, offsets, part, closed, status = _axes(parts, *choices)
    unsound = np.flatnonzero(status == FAILED)
    if len(unsound):
        # rings that touch or cross themselves within rounding: without what is thinner than 2 cm they do not
        opened = shapely.buffer(shapely.buffer(parts[unsound], -MEND_M, join_style="mitre"), MEND_M, join_style="mitre")
        pieces, piece_part = shapely.get_parts(opened, return_index=True)
        more = _axes(pieces, *choices)
        xy, radius = np.concatenate([xy, more[0]]), np.concatenate([radius, more[1]])
        offsets = np.concatenate([offsets, offsets[-1] + more[2][1:]])
        part, closed = np.concatenate([part, unsound[piece_part[more[3]]]]), np.concatenate([closed, more[4]])
        xy, radius, offsets, part, closed = _sorted_by_part(xy, radius, offsets, part, closed)
        unsound = unsound[np.unique(piece_part[more[5] == FAILED])]
    failed = np.zeros(len(polygons), dtype=bool)
    failed[part_site[unsound]] = True
    return MedialAxes(xy, radius, offsets, part, part_site[part], closed, failed)


def _axes(
    parts: NDArray[np.object_], step_m: float, corner_factor: float, branch_factor: float
) -> tuple[NDArray[Any], ...]:
    rings, ring_part = shapely.get_rings(parts, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    found: tuple[NDArray[Any], ...] = axes_of_parts(
        xy,
        np.searchsorted(ring, np.arange(len(rings) + 1)),
        np.searchsorted(ring_part, np.arange(len(parts) + 1)),
        step_m,
        corner_factor,
        branch_factor,
    )
    return found


def _sorted_by_part(
    xy: NDArray[Any], radius: NDArray[Any], offsets: NDArray[Any], part: NDArray[Any], closed: NDArray[Any]
) -> tuple[NDArray[Any], ...]:
    order = np.argsort(part, kind="stable")
    sizes = np.diff(offsets)[order]
    new_offsets = np.concatenate([[0], np.cumsum(sizes)])
    node = np.arange(new_offsets[-1]) + np.repeat(offsets[:-1][order] - new_offsets[:-1], sizes)
    return xy[node], radius[node], new_offsets, part[order], closed[order]


def _polygons_in_fixed_order(
    parts: NDArray[np.object_], site: NDArray[np.int64]
) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """Take what is polygon, the parts of each sorted from one side to the other.

    So their order in the file does not matter; along that direction no two parts begin at once by design.
    """
    parts, inner = shapely.get_parts(parts, return_index=True)  # multipolygons out of geometry collections
    site = site[inner]
    polygon = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    usable = polygon & ~shapely.is_empty(parts)
    parts, site = parts[usable], site[usable]
    if len(parts) == 0 or np.all(np.diff(site) > 0):
        return parts, site
    xy, owner = shapely.get_coordinates(parts, return_index=True)
    begins = np.full(len(parts), np.inf)
    np.minimum.at(begins, owner, 0.7420 * xy[:, 0] + 0.6704 * xy[:, 1])
    order = np.lexsort((begins, site))
    return parts[order], site[order]
