"""What became of the plants, in numbers: the part of the report that tells of growth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from urbanforest_cli.core.schema import GROW_REASONS
from urbanforest_cli.export.map_layers import SpeciesStyle

Row = dict[str, Any]

FATES = ("unique", "library", "died", "no_room", "unborn", "out_of_focus")
FATE_MEANINGS = {
    "unique": "grown in its own place",
    "library": "stands with a shape of the library: that of a plant of its kind and place, grown alone for many",
    **GROW_REASONS,
}
QUANTILES = {"p10": 0.1, "median": 0.5, "p90": 0.9}
CLASSES = 12
CLASS_STEPS_M = (0.5, 1.0, 2.0, 2.5, 5.0, 10.0, 20.0)  # no skeleton is higher than the largest allows
LIBRARY_FIGURES = {
    "overlap": "share of the two crowns' voxels that both fill, 1 for the same crown",
    "height_error": "difference in height, as a share of the plant's own",
    "crown_radius_error": "difference in crown radius, as a share of the plant's own",
    "crown_volume_error": "difference in crown volume, as a share of the plant's own",
    "crown_shift_m": "distance between the middles of the crowns, m",
}


def sum_up_growth(
    trees: pd.DataFrame,
    species: Sequence[SpeciesStyle],
    counts: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> Row:
    """Sum up grown plants.

    Parameters
    ----------
    trees
        The layer ``trees``.
    species
        Labels and colours, in any order.
    counts, config
        Those of the stage that grew them.
    """
    counts, config = counts or {}, config or {}
    standing = trees[trees["grown"].isin(["unique", "library"])]
    fate = trees["reason"].astype(object).where(trees["reason"].notna(), trees["grown"])
    numbers = fate.value_counts()
    return {
        "environment": (config.get("growth") or {}).get("environment"),
        "detail": counts.get("detail"),
        "year": config.get("year"),
        "plants": len(trees),
        "fates": [
            {"fate": name, "meaning": FATE_MEANINGS[name], "plants": int(numbers.get(name, 0))}
            for name in FATES
        ],
        "internodes": int(standing["internode_count"].sum()),
        "internodes_grown": _account(counts),
        "skeleton_bytes": counts.get("bytes"),
        "species": _sizes(standing, species),
        "heights": _heights(standing),
        "library": _library(counts),
    }  # fmt: skip


def _account(counts: Mapping[str, Any]) -> Row | None:
    """Return the internodes ever grown in skeletons, and what became of them."""
    names = ("generated", "retained", "shed", "pruned")
    if not all(f"internodes_{name}" in counts for name in names):
        return None
    return {name: counts[f"internodes_{name}"] for name in names}


def _sizes(standing: pd.DataFrame, styles: Sequence[SpeciesStyle]) -> list[Row]:
    known = {style.id: style for style in styles}
    rows = []
    for name, group in standing.groupby("species", observed=True):
        style = known.get(str(name))
        stems = group["dbh_m"][group["dbh_m"] > 0]
        rows.append({
            "species": str(name),
            "label": style.label if style else str(name),
            "colour": style.colour if style else "#6f8f5f",
            "habit": str(group["habit"].iloc[0]),
            "plants": len(group),
            "age_median_years": _quantile(group["age_years"], 0.5, 1),
            **{f"height_{key}_m": _quantile(group["height_m"], q) for key, q in QUANTILES.items()},
            **{f"crown_diameter_{key}_m": _quantile(2 * group["crown_radius_m"], q) for key, q in QUANTILES.items()},
            "crown_base_median_m": _quantile(group["crown_base_m"], 0.5),
            "dbh_median_m": _quantile(stems, 0.5, 3),
            "internodes_mean": round(float(group["internode_count"].mean()), 1),
        })  # fmt: skip
    return sorted(rows, key=lambda row: (-row["plants"], row["species"]))


def _quantile(values: pd.Series[Any], share: float, decimals: int = 2) -> float | None:
    return round(float(np.quantile(values.to_numpy(dtype=float), share)), decimals) if len(values) else None


def _heights(standing: pd.DataFrame) -> list[Row]:
    """Count trees and shrubs by classes of height, at most `CLASSES` of them."""
    height = standing["height_m"].to_numpy(dtype=float)
    if not len(height):
        return []
    top = float(height.max())
    step = next((step for step in CLASS_STEPS_M if top < step * CLASSES), CLASS_STEPS_M[-1])
    number = (height / step).astype(np.int64)
    tall = (standing["habit"] == "tree").to_numpy(dtype=bool)
    trees, shrubs = (np.bincount(number[mask], minlength=int(number.max()) + 1) for mask in (tall, ~tall))
    return [
        {"from_m": round(step * row, 2), "to_m": round(step * (row + 1), 2), "trees": int(a), "shrubs": int(b)}
        for row, (a, b) in enumerate(zip(trees, shrubs, strict=True))
    ]


def _library(counts: Mapping[str, Any]) -> Row | None:
    """Return how far plants of the library are from those that grew in their own place, on a sample."""
    if "library_compared" not in counts:
        return None
    return {
        "compared": counts["library_compared"],
        "one_dead": counts.get("library_one_dead", 0),
        "figures": [
            {
                "figure": name,
                "meaning": meaning,
                "median": counts[f"library_{name}_median"],
                "worst_tenth": counts.get(f"library_{name}_worst_tenth"),
            }
            for name, meaning in LIBRARY_FIGURES.items()
            if f"library_{name}_median" in counts
        ],
    }
