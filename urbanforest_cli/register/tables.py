"""The layers of a register as frames, and what is counted of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from urbanforest_cli.register.covered import Filled
from urbanforest_cli.register.layers import Buildings, road_surfaces
from urbanforest_cli.register.lots import Lots, user_columns
from urbanforest_cli.register.packed import give_back
from urbanforest_cli.register.resolve import with_resolved
from urbanforest_cli.register.streets import Roads
from urbanforest_cli.register.units import Plantable, Units

BAD_REASONS = ("no_geometry", "not_finite", "broken_ring", "not_polygon", "misplaced", "no_area")


class OnDemand(Mapping[str, pd.DataFrame]):
    """Layers that are made when they are asked for, each time, so that few are there at a time.

    Whoever goes through them holds the last while the next is made: small layers stand between large ones.
    """

    def __init__(self, makers: Mapping[str, Callable[[], pd.DataFrame]]) -> None:
        self._makers = makers

    def __getitem__(self, name: str) -> pd.DataFrame:
        give_back()
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def counts_of(
    whole: Units, ground: Plantable, filled: Filled, skipped: pd.DataFrame, row_count: int, observed: int | None
) -> dict[str, int | float | str]:
    """Return what is told of a register.

    Parameters
    ----------
    row_count
        Rows of the city's layer of lots.
    observed
        Known plants that are kept; None where none were asked for.
    """
    origins = whole.origins
    counts: dict[str, int | float | str] = {
        "lots": row_count,
        "lots_bad": int(skipped["reason"].isin(BAD_REASONS).sum()),
        "lots_skipped": len(skipped),
        "active_areas": int((~np.where(filled.decided, filled.stems.missing, ground.areas.missing)).sum()),
        "street_lots": int((origins == "road").sum()),
        "sketches": int((origins == "sketch").sum()),
        "pieces_dropped": int(ground.dropped_parts.sum()),
        "area_m2": round(float(np.nansum(shapely.area(whole.shapes[origins == "register"]))), 1),
        "plantable_area_m2": round(float(ground.area_m2.sum()), 1),
    }
    if filled.decided.any():
        counts |= {
            "lots_filled": int((~filled.regions.missing).sum()),
            "lots_bare": int((filled.reasons == "bare").sum()),
            "regions": int(filled.regions.part_count.sum()),
            "regions_area_m2": round(float(filled.regions.area_m2.sum()), 1),
        }
    if observed is not None:
        counts["observed_kept"] = observed
    return counts


def tables_of(
    attributes: pd.DataFrame,
    whole: Units,
    ground: Plantable,
    filled: Filled,
    skipped: pd.DataFrame,
    buildings: Buildings,
    roads: Roads,
    lots: Lots,
) -> dict[str, Callable[[], pd.DataFrame]]:
    """Return what makes the layers that this stage writes, but for known plants and the record."""
    register_lots = pd.DataFrame(
        {
            "lot_id": whole.ids,
            "zone": whole.zones,
            "origin": whole.origins,
            "area_m2": np.nan_to_num(shapely.area(whole.shapes)),
            "plantable_area_m2": ground.area_m2,
            "covered_fraction": filled.covered_fraction,
            "seen_fraction": filled.seen_fraction,
            **user_columns(attributes, len(whole.ids), lots),
        }
    )
    built = pd.DataFrame({"building_id": buildings.ids, "height_m": buildings.height_m})
    surfaces = pd.DataFrame({"road_id": roads.ids.astype(str), "width_m": roads.widths_m})
    return {
        "lots": lambda: gpd.GeoDataFrame(register_lots, geometry=lots.back(whole.shapes), crs=lots.crs),
        "active_areas": lambda: _active_areas(whole, ground, filled, lots),
        "parameters": lambda: with_resolved(whole.parameters)[~shapely.is_missing(whole.shapes)],
        "regions": lambda: _regions(whole, filled, lots),
        "buildings": lambda: gpd.GeoDataFrame(built, geometry=lots.back(buildings.shapes), crs=lots.crs),
        "roads": lambda: gpd.GeoDataFrame(surfaces, geometry=lots.back(road_surfaces(roads)), crs=lots.crs),
        "skipped": lambda: skipped,
    }


def _active_areas(whole: Units, ground: Plantable, filled: Filled, lots: Lots) -> gpd.GeoDataFrame:
    """Return where plants may stand: by the map where it decides, by the rules elsewhere."""
    decided = filled.decided
    rows = np.flatnonzero(~np.where(decided, filled.stems.missing, ground.areas.missing))
    shapes = np.full(len(rows), None, dtype=object)
    shapes[decided[rows]] = filled.stems.get(rows[decided[rows]])
    shapes[~decided[rows]] = ground.areas.get(rows[~decided[rows]])
    kinds = np.where(whole.origins == "register", "lot", whole.origins)
    kinds[decided] = "region"
    return gpd.GeoDataFrame(
        {
            "lot_id": whole.ids[rows],
            "kind": kinds[rows],
            "area_m2": np.where(decided, filled.stems.area_m2, ground.areas.area_m2)[rows],
        },
        geometry=lots.back(shapes),
        crs=lots.crs,
    )


def _regions(whole: Units, filled: Filled, lots: Lots) -> gpd.GeoDataFrame:
    rows = np.flatnonzero(~filled.regions.missing)
    return gpd.GeoDataFrame(
        {
            "lot_id": whole.ids[rows],
            "area_m2": filled.regions.area_m2[rows],
            "inside_m2": filled.inside_m2[rows],
            "region_count": filled.regions.part_count[rows],
            "coverage": filled.coverage[rows],
        },
        geometry=lots.back(filled.regions.get(rows)),
        crs=lots.crs,
    )
