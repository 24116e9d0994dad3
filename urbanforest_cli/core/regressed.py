"""Values read off coverage, laid over those that zones and lots set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.schema import ORIGIN_SUFFIX, REGRESSED

READ_OFF = ("map", "neighbourhood")


@dataclass(frozen=True)
class Overlay:
    """Values of all parameters, one array a parameter, and which of them were read off coverage."""

    values: dict[str, NDArray[np.float64]]
    read: dict[str, NDArray[np.bool_]]

    @property
    def any_read(self) -> NDArray[np.bool_]:
        """Which lots have a value that was."""
        return np.asarray(np.logical_or.reduce(list(self.read.values())))


def overlay(
    lot_ids: NDArray[np.object_], resolved: Mapping[str, NDArray[np.float64]], regressed: pd.DataFrame, *, seed: int
) -> Overlay:
    """Put the values that rest on the map or on a neighbourhood in place of resolved ones.

    Counts are rounded up or down by chance, so that their expected value is what was read.

    Parameters
    ----------
    lot_ids
        (n,) lots that the resolved values belong to.
    regressed
        Layer ``regressed``, in any order; lots that it lacks keep their values.
    seed
        Root of the streams that round counts.
    """
    rows = pd.Index(regressed["lot_id"]).get_indexer(pd.Index(lot_ids))
    there = rows >= 0
    keys = keys_for(seed, "regress", lot_ids)
    values = {name: np.array(column, dtype=np.float64) for name, column in resolved.items()}
    read = {name: np.zeros(len(lot_ids), dtype=bool) for name in values}
    for index, name in enumerate(REGRESSED):
        if regressed.empty:
            break
        found = regressed[name].to_numpy(dtype=np.float64)[rows]
        if PARAMETERS[name].kind == "count":
            below = np.floor(found)
            found = below + (hash_uniform(keys, np.full(len(keys), index, dtype=np.int64)) < found - below)
        read[name] = there & np.isin(regressed[name + ORIGIN_SUFFIX].to_numpy(dtype=object)[rows], READ_OFF)
        values[name] = np.where(read[name], found, values[name])
    return Overlay(values, read)
