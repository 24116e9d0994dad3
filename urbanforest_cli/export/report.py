"""What happened, in numbers: the record that report.json holds and report.html shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from urbanforest_cli.core.colours import zone_colour
from urbanforest_cli.core.schema import SKIP_REASONS
from urbanforest_cli.export.growth_report import sum_up_growth
from urbanforest_cli.export.map_layers import RegisterTables, SpeciesStyle, shown_radius_m

SQUARE_METRES_A_HECTARE = 10_000.0
EXAMPLES_SHOWN = 5

Row = dict[str, Any]


def build_report(
    tables: RegisterTables,
    *,
    title: str,
    species: Sequence[SpeciesStyle],
    provenance: Mapping[str, Any],
    stages: Sequence[Mapping[str, Any]],
    config: Mapping[str, Any],
    zone_colours: Mapping[str, str] | None = None,
    growth: Mapping[str, Any] | None = None,
) -> Row:
    """Sum up a planted city.

    Areas are in hectares. The crown share of a zone is the sum of its crowns' circles over the area of its lots:
    where crowns overlap, both count. Crowns are those that grew, or the plants' envelopes where nothing has grown.
    The map share is the share of the lots' ground on which a coverage map shows vegetation, of what the map knows of
    it; None without a map.

    Parameters
    ----------
    tables
        The register.
    title
        Name of the place.
    species
        Labels and colours, in any order.
    provenance
        Program version, seed, CRS and inputs.
    stages
        For each stage its name, seconds (None where they are not told), counts and warnings.
    config
        The config in force.
    zone_colours
        Fills the config chooses.
    growth
        ``counts`` and ``config`` of the stage that grew the plants, where they have grown.
    """
    plants = tables.plants.assign(
        crown_m2=np.pi * shown_radius_m(tables.plants, tables.trees) ** 2,
        is_tree=(tables.plants["habit"] == "tree").to_numpy(dtype=bool),
    )
    a_lot = pd.DataFrame({
        "plants": plants.groupby("lot_id", observed=True).size(),
        "crown_m2": plants.groupby("lot_id", observed=True)["crown_m2"].sum(),
    })  # fmt: skip
    columns = ["lot_id", "zone", "area_m2", "plantable_area_m2", "covered_fraction", "seen_fraction"]
    lots = tables.lots.reindex(columns=columns).merge(a_lot, how="left", left_on="lot_id", right_index=True)
    lots[["plants", "crown_m2"]] = lots[["plants", "crown_m2"]].fillna(0.0)
    lots = lots.merge(tables.parameters[["lot_id", "strategy", "radius_mean_m"]], how="left", on="lot_id")
    return {
        "title": title,
        "headline": _headline(lots, plants, tables.skipped),
        "zones": _zones(lots, zone_colours or {}),
        "strategies": _strategies(lots, tables.placements),
        "species": _species(plants, species),
        "growth": None if tables.trees is None else sum_up_growth(tables.trees, species, **(growth or {})),
        "skipped": _skipped(tables.skipped),
        "stages": [dict(stage) for stage in stages],
        "warnings": [
            {"stage": stage["stage"], **warning} for stage in stages for warning in stage.get("warnings") or ()
        ],
        "config": dict(config),
        "provenance": dict(provenance),
    }


def _headline(lots: pd.DataFrame, plants: pd.DataFrame, skipped: pd.DataFrame) -> Row:
    trees = int(plants["is_tree"].sum())
    return {
        "lots": len(lots),
        "lots_planted": int((lots["plants"] > 0).sum()),
        "lots_skipped": int(skipped["lot_id"].nunique()),
        "plants": len(plants),
        "trees": trees,
        "shrubs": len(plants) - trees,
        "species": int(plants["species"].nunique()),
        **_densities(lots),
    }


def _densities(lots: pd.DataFrame) -> Row:
    area = float(lots["area_m2"].sum())
    plantable = float(lots["plantable_area_m2"].sum())
    plants, crowns = float(lots["plants"].sum()), float(lots["crown_m2"].sum())
    return {
        "area_ha": round(area / SQUARE_METRES_A_HECTARE, 3),
        "plantable_area_ha": round(plantable / SQUARE_METRES_A_HECTARE, 3),
        "plants_per_hectare": _ratio(plants * SQUARE_METRES_A_HECTARE, area, 2),
        "crown_share": _ratio(crowns, area, 4),
        "plantable_share": _ratio(plantable, area, 4),
        "map_share": _map_share(lots),
    }


def _map_share(lots: pd.DataFrame) -> float | None:
    known_m2 = (lots["seen_fraction"].astype(float) * lots["area_m2"]).where(lots["covered_fraction"].notna(), 0.0)
    covered_m2 = (known_m2 * lots["covered_fraction"].astype(float).fillna(0.0)).sum()
    return _ratio(float(covered_m2), float(known_m2.sum()), 4)


def _ratio(part: float, whole: float, decimals: int) -> float | None:
    return round(part / whole, decimals) if whole > 0 else None


def _mean(values: pd.Series[Any], decimals: int = 3) -> float | None:
    mean = float(values.mean()) if len(values) else float("nan")
    return round(mean, decimals) if np.isfinite(mean) else None


def _zones(lots: pd.DataFrame, colours: Mapping[str, str]) -> list[Row]:
    rows = [
        {
            "zone": str(zone),
            "colour": zone_colour(str(zone), colours),
            "lots": len(group),
            "lots_planted": int((group["plants"] > 0).sum()),
            "plants": int(group["plants"].sum()),
            **_densities(group),
        }
        for zone, group in lots.groupby("zone", observed=True)
    ]
    return sorted(rows, key=lambda row: (-row["lots"], row["zone"]))


def _strategies(lots: pd.DataFrame, placements: pd.DataFrame) -> list[Row]:
    joined = lots.merge(
        placements[["lot_id", "position_count", "radius_mean_m"]].rename(columns={"radius_mean_m": "realised_m"}),
        how="left",
        on="lot_id",
    )
    rows = []
    for strategy, group in joined.groupby("strategy", observed=True):
        planted = group[group["plants"] > 0]
        weights = planted["plants"].to_numpy(dtype=float)
        realised = planted["realised_m"].to_numpy(dtype=float)
        known = np.isfinite(realised)
        asked = planted["radius_mean_m"].to_numpy(dtype=float)
        rows.append({
            "strategy": str(strategy),
            "lots": len(group),
            "lots_planted": len(planted),
            "positions": int(group["position_count"].fillna(0).sum()),
            "plants": int(planted["plants"].sum()),
            "plants_per_lot": _mean(planted["plants"], 2),
            "radius_asked_m": _weighted(asked, weights),
            "radius_realised_m": _weighted(realised[known], weights[known]),
        })  # fmt: skip
    return sorted(rows, key=lambda row: (-row["lots"], row["strategy"]))


def _weighted(values: Any, weights: Any) -> float | None:
    return round(float(np.average(values, weights=weights)), 3) if len(values) and weights.sum() > 0 else None


def _species(plants: pd.DataFrame, styles: Sequence[SpeciesStyle]) -> list[Row]:
    known = {style.id: style for style in styles}
    rows = []
    for name, group in plants.groupby("species", observed=True):
        style = known.get(str(name))
        rows.append({
            "species": str(name),
            "label": style.label if style else str(name),
            "colour": style.colour if style else "#6f8f5f",
            "habit": str(group["habit"].iloc[0]),
            "plants": len(group),
            "share": round(len(group) / len(plants), 4),
            "radius_mean_m": _mean(group["envelope_radius_m"], 2),
            "age_mean_years": _mean(group["age_years"], 1),
        })  # fmt: skip
    return sorted(rows, key=lambda row: (-row["plants"], row["species"]))


def _skipped(skipped: pd.DataFrame) -> list[Row]:
    rows = []
    for (reason, stage), group in skipped.groupby(["reason", "stage"], observed=True):
        rows.append({
            "reason": str(reason),
            "meaning": SKIP_REASONS.get(str(reason), ""),
            "stage": str(stage),
            "lots": len(group),
            "examples": [
                {"lot_id": str(lot), "detail": str(detail)}
                for lot, detail in zip(group["lot_id"].head(EXAMPLES_SHOWN), group["detail"].head(EXAMPLES_SHOWN),
                                       strict=True)
            ],
        })  # fmt: skip
    return sorted(rows, key=lambda row: (-row["lots"], row["reason"], row["stage"]))
