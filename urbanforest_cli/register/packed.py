"""Shapes of many units as bytes: finished polygons wait for the register in a quarter of the memory of geometries."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

AT_A_TIME = 4096
"""Shapes whose bytes are taken out of their blocks together."""

Shapes = NDArray[Any]


class PackedShapes:
    """One polygon or multi-polygon a unit, or none, as well-known binary: coordinates come back to the last bit.

    Those of one call of `put` lie in one block of bytes, so that what was needed to make them can be given back whole.

    Attributes
    ----------
    area_m2
        (n,) area of each, 0 for none.
    part_count
        (n,) polygons that each consists of, 0 for none.
    """

    def __init__(self, count: int) -> None:
        self.area_m2 = np.zeros(count)
        self.part_count = np.zeros(count, dtype=np.int64)
        self._blocks: list[bytes] = []
        self._block = np.full(count, -1, dtype=np.int32)
        self._start = np.zeros(count, dtype=np.int64)
        self._size = np.zeros(count, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._block)

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Return (n,) which units have none."""
        return self._block < 0

    def put(self, rows: NDArray[np.integer], shapes: Shapes) -> None:
        """Set the shapes of some units, None for none."""
        self.drop(rows)
        there = ~shapely.is_missing(shapes)
        rows, shapes = rows[there], shapes[there]
        if not len(rows):
            return
        packed = shapely.to_wkb(shapes)
        size = np.fromiter(map(len, packed), dtype=np.int64, count=len(rows))
        self._block[rows] = len(self._blocks)
        self._start[rows], self._size[rows] = np.cumsum(size) - size, size
        self._blocks.append(b"".join(packed))
        self.area_m2[rows] = shapely.area(shapes)
        self.part_count[rows] = shapely.get_num_geometries(shapes)

    def drop(self, rows: NDArray[np.integer]) -> None:
        """Leave some units without a shape."""
        self._block[rows] = -1
        self.area_m2[rows], self.part_count[rows] = 0.0, 0

    def get(self, rows: NDArray[np.integer]) -> Shapes:
        """Return the shapes of some units, None for none."""
        shapes: Shapes = np.full(len(rows), None, dtype=object)
        there = np.flatnonzero(self._block[rows] >= 0)
        for begin in range(0, len(there), AT_A_TIME):
            some = there[begin : begin + AT_A_TIME]
            block, start = self._block[rows[some]], self._start[rows[some]]
            where = zip(block.tolist(), start.tolist(), (start + self._size[rows[some]]).tolist(), strict=True)
            shapes[some] = shapely.from_wkb([self._blocks[k][first:end] for k, first, end in where])
        return shapes


def give_back() -> None:
    """Give memory that is free back to the system, where libraries can: threads and tables leave it in holes."""
    arrow = sys.modules.get("pyarrow")
    if arrow is not None:
        arrow.default_memory_pool().release_unused()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc has it
        if trim is not None:
            trim(0)


def packed(shapes: Shapes) -> PackedShapes:
    """Return shapes as bytes."""
    result = PackedShapes(len(shapes))
    result.put(np.arange(len(shapes)), shapes)
    return result
