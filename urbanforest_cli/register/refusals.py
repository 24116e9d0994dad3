"""What a city lacks: told of, or refused."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.zones import ZONES

Shapes = NDArray[Any]


def note_what_is_missing(
    counts: dict[str, int], zones: NDArray[np.object_], config: Config, notices: Notices, city: Path
) -> None:
    """Tell of what a planner would miss on the map: no buildings, or a zone of the config that no lot is in."""
    if not counts.get("buildings") and len(zones):
        notices.add(
            "W_NO_BUILDINGS", "cities without buildings, their lots planted as if nothing stood there", 1, [city]
        )
    there = set(zones) | set(ZONES) | {"default"}
    for zone in config.zones:
        if zone not in there:
            near = get_close_matches(zone, sorted(set(zones) | set(ZONES)), n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            notices.add("W_ZONE_UNUSED", "zones of the config that no lot is in", 1, [f"{zone}{hint}"])


def refuse_apart(bounds_m: tuple[float, float, float, float], shapes: Shapes, coverage: Path) -> None:
    """Refuse a map that lies beside all lots."""
    if not len(shapes) or shapely.intersects(shapely.box(*bounds_m), shapes).any():
        return
    extents = [
        f"{what} {west:.1f} to {east:.1f} east, {south:.1f} to {north:.1f} north"
        for what, (west, south, east, north) in (("map", bounds_m), ("lots", shapely.total_bounds(shapes)))
    ]
    raise InputError(
        "the coverage map overlaps no lot",
        where=coverage,
        found="; ".join(extents) + " (metres)",
        expected="a map of the same place",
        next_step="check both in a map viewer; a wrong CRS of a file that states none is set with --assume-crs",
    )
