"""A coverage map's pixels brought to square cells in metres."""

from __future__ import annotations

from numba import njit

UNKNOWN = 255
KNOWN_LEAST = 0.5
"""A cell is known where at least this share of it is."""


@njit(cache=True, nogil=True, error_model="numpy")
def brought_to_cells(pixels, first_row, first_col, nodes, step, row_off, col_off, cells):
    """Average pixels over cells; a cell finer than the pixels is interpolated linearly between them.

    Each cell is averaged over its own width, at least a pixel wide, about its own centre, so that its value depends
    on nothing but where it lies.

    Parameters
    ----------
    pixels
        (h, w) uint8 percentages of a window of the map, 255 where unknown.
    first_row, first_col
        Row and column of the window in the map; beyond the window nothing is known.
    nodes
        (n, m, 2) float64: row and column in the map of every `step`-th corner of cells.
    row_off, col_off
        Row and column of the first cell, counted from the first node.
    cells
        (h, w) uint8, filled.
    """
    height, width = cells.shape
    rows, cols = pixels.shape
    for i in range(height):
        v = (row_off + i + 0.5) / step
        node_row = int(v)
        v -= node_row
        for j in range(width):
            u = (col_off + j + 0.5) / step
            node_col = int(u)
            u -= node_col
            r00, c00 = nodes[node_row, node_col, 0], nodes[node_row, node_col, 1]
            r01, c01 = nodes[node_row, node_col + 1, 0], nodes[node_row, node_col + 1, 1]
            r10, c10 = nodes[node_row + 1, node_col, 0], nodes[node_row + 1, node_col, 1]
            r11, c11 = nodes[node_row + 1, node_col + 1, 0], nodes[node_row + 1, node_col + 1, 1]
            row = (1 - v) * ((1 - u) * r00 + u * r01) + v * ((1 - u) * r10 + u * r11)
            col = (1 - v) * ((1 - u) * c00 + u * c01) + v * ((1 - u) * c10 + u * c11)
            if not (-1.0 < row - first_row < rows + 1.0 and -1.0 < col - first_col < cols + 1.0):
                cells[i, j] = UNKNOWN
                continue
            high = (((r10 - r00) ** 2 + (r01 - r00) ** 2) ** 0.5) / step
            wide = (((c10 - c00) ** 2 + (c01 - c00) ** 2) ** 0.5) / step
            cells[i, j] = _average(pixels, row - first_row, col - first_col, max(high, 1.0), max(wide, 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def _average(pixels, row, col, high, wide):
    """Return the mean over a box about a place, in pixels."""
    rows, cols = pixels.shape
    top, bottom = row - 0.5 * high, row + 0.5 * high
    left, right = col - 0.5 * wide, col + 0.5 * wide
    total, weight = 0.0, 0.0
    for r in range(max(int(top), 0), min(int(bottom) + 1, rows)):
        along = min(bottom, r + 1.0) - max(top, float(r))
        if along <= 0.0:
            continue
        for c in range(max(int(left), 0), min(int(right) + 1, cols)):
            value = pixels[r, c]
            if value == UNKNOWN:
                continue
            share = along * (min(right, c + 1.0) - max(left, float(c)))
            if share > 0.0:
                total += share * value
                weight += share
    if weight < KNOWN_LEAST * high * wide * (1.0 - 1e-6):
        return UNKNOWN
    return int(total / weight + 0.5)
