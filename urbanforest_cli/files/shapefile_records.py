"""Which records of a shapefile are damaged, as opposed to empty; GDAL returns nothing for both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_HEADER_BYTES = 100
_NULL_SHAPE = 0
_WITH_PARTS = (3, 5, 13, 15, 23, 25, 31)


def damaged_records(path: Path, records: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which of the records named hold a shape that could not be read.

    Parameters
    ----------
    records
        Numbers of records, from 0, for which a reader returned no geometry.
    """
    index = next((p for s in (".shx", ".SHX") if (p := path.with_suffix(s)).is_file()), None)
    if index is None or len(records) == 0:
        return np.zeros(len(records), dtype=bool)
    entries = np.fromfile(index, dtype=">i4", offset=_HEADER_BYTES).astype(np.int64)
    offsets = entries[: len(entries) // 2 * 2].reshape(-1, 2)[:, 0] * 2
    content = np.memmap(path, dtype=np.uint8, mode="r")
    damaged = np.zeros(len(records), dtype=bool)
    for place, record in enumerate(records):
        start = int(offsets[record]) + 8 if 0 <= record < len(offsets) else -1
        if not 0 <= start <= len(content) - 4:
            damaged[place] = True
            continue
        kind = int(content[start : start + 4].view("<i4")[0])
        parts = content[start + 36 : start + 40]
        no_parts = kind in _WITH_PARTS and len(parts) == 4 and int(parts.view("<i4")[0]) == 0
        damaged[place] = kind != _NULL_SHAPE and not no_parts
    return damaged
