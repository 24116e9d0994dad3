"""The medial axes of many polygons as chains of nodes.

The polygon's edges are sampled, the samples triangulated, and edges are split until each is an edge of the Delaunay
triangulation and no triangle inside has its circumcentre beyond one. The triangles inside are then the nodes of the
axis and the edges they share its edges (Brandt and Algazi 1992).
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.placement.axis_nodes import axis_graph
from urbanforest_cli.placement.axis_samples import (
    FOUND,
    TOO_THIN,
    boundary_samples,
    corners_of_part,
    triangulated,
)
from urbanforest_cli.placement.chain_kernel import chains_of_graph, prune_graph

MIN_WIDTH_M = 0.02
FINE_STEP_M, COARSE_STEP_M = 1.0, 2.0
MAX_SAMPLES = 500_000


@njit(cache=True, nogil=True)
def axes_of_parts(xy, ring_offsets, part_offsets, step, corner_factor, branch_factor):
    """Find the axes of many polygons.

    Parameters
    ----------
    xy, ring_offsets, part_offsets
        (n, 2) coordinates of closed rings, where each ring begins, and at which ring each polygon begins; the first
        ring of a polygon is its shell.
    step
        Distance of samples; 0 for one that fits the polygon's width, which is about twice its area by its perimeter.

    Returns
    -------
    node_xy (m, 2), node_radius (m,), chain_offsets (c + 1,), chain_part (c,), chain_closed (c,), status (parts,)
    """
    parts = len(part_offsets) - 1
    node_xy = np.empty((256, 2))
    radius = np.empty(256)
    offsets = np.zeros(65, dtype=np.int64)
    owner = np.empty(64, dtype=np.int64)
    closed = np.empty(64, dtype=np.bool_)
    status = np.empty(parts, dtype=np.int8)
    nodes = 0
    chains = 0
    for part in range(parts):
        r0, r1 = part_offsets[part], part_offsets[part + 1]
        state, west, south, x, y, r, starts, rings = _axis_of_part(
            xy, ring_offsets, r0, r1, step, corner_factor, branch_factor
        )
        status[part] = state
        more = len(x)
        if nodes + more > len(radius):
            size = max(2 * len(radius), nodes + more)
            wider = np.empty((size, 2))
            wider[:nodes] = node_xy[:nodes]
            node_xy = wider
            longer = np.empty(size)
            longer[:nodes] = radius[:nodes]
            radius = longer
        for i in range(more):
            node_xy[nodes + i, 0] = x[i] + west
            node_xy[nodes + i, 1] = y[i] + south
            radius[nodes + i] = r[i]
        for c in range(len(rings)):
            if chains == len(owner):
                offsets = _grown(offsets, 2 * chains + 1)
                owner = _grown(owner, 2 * chains)
                closed = _grown(closed, 2 * chains)
            owner[chains] = part
            closed[chains] = rings[c]
            offsets[chains + 1] = nodes + starts[c + 1]
            chains += 1
        nodes += more
    return node_xy[:nodes], radius[:nodes], offsets[: chains + 1], owner[:chains], closed[:chains], status


@njit(cache=True, nogil=True)
def _grown(array, size):
    longer = np.empty(size, dtype=array.dtype)
    longer[: len(array)] = array
    return longer


@njit(cache=True, nogil=True)
def _nothing(status):
    none = np.empty(0)
    return status, 0.0, 0.0, none, none, none, np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.bool_)


@njit(cache=True, nogil=True)
def _axis_of_part(xy, ring_offsets, r0, r1, step, corner_factor, branch_factor):
    cx, cy, corner_offsets, west, south, area, perimeter = corners_of_part(xy, ring_offsets, r0, r1)
    if len(cx) < 3 or not (area > 0.0 and perimeter < np.inf) or 2 * area / perimeter < MIN_WIDTH_M:
        return _nothing(TOO_THIN)
    if step <= 0.0:
        step = min(max(FINE_STEP_M, 0.4 * area / perimeter), COARSE_STEP_M)
    step = min(step, 0.9 * area / perimeter)
    step = max(step, perimeter / MAX_SAMPLES)
    sampled, x, y, features, ea, eb, es, edge_count, ring_starts, edges = boundary_samples(cx, cy, corner_offsets, step)
    state, _, edge_count, triangles, origin, twin, edge_at = triangulated(
        x, y, sampled, features, ea, eb, es, edge_count, ring_starts
    )
    if state != FOUND:
        return _nothing(state)
    state, nx, ny, nr, links = axis_graph(x, y, features, es, edge_count, edge_at, triangles, origin, twin, edges)
    if state != FOUND:
        return _nothing(state)
    alive = np.ones(len(nx), dtype=np.bool_)
    prune_graph(nx, ny, nr, links, alive, corner_factor, branch_factor)
    px, py, pr, starts, rings = chains_of_graph(nx, ny, nr, links, alive)
    return FOUND, west, south, px, py, pr, starts, rings
