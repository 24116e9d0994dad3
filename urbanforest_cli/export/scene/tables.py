"""A planted city as tables: a row a plant, columns named as in every other output."""

from __future__ import annotations

from collections.abc import Mapping

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.export.scene.city import City

CM_A_METRE = 100.0
WGS84 = CRS.from_epsg(4326)

LAND_USES = {
    "residential": "Residential",
    "commercial": "Commercial/Industrial",
    "industrial": "Commercial/Industrial",
    "street": "Transportation",
    "other": "Other",
}
"""For each zone the class of land use that i-Tree Eco knows; a zone of the user's own is `Other`."""


def plant_table(city: City) -> gpd.GeoDataFrame:
    """Return the plants as points in the register's CRS, in the register's order.

    Numbers are rounded as a register's reader would want them: sizes to millimetres, turns to thousandths of a degree.
    """
    plants = city.plants
    xy = reproject_xy(plants.xy_m, city.crs, city.register_crs)
    habit, scientific, common = _of_species(city)
    columns = {
        "plant_id": plants.plant_id,
        "lot_id": plants.lot_id,
        "species": np.array([item.id for item in city.species], dtype=object)[plants.species],
        "scientific_name": scientific,
        "common_name": common,
        "habit": habit,
        "age_years": np.round(plants.age_years, 3),
        "height_m": np.round(plants.height_m, 3),
        "crown_radius_m": np.round(plants.crown_radius_m, 3),
        "crown_base_m": np.round(plants.crown_base_m, 3),
        "dbh_m": np.round(plants.dbh_m, 4),
        "pruning_factor": np.round(plants.pruning_factor, 4),
        "grown": np.where(plants.is_library, "library", "unique").astype(object),
        "skeleton_id": plants.skeleton_id,
        "yaw_deg": np.round(np.degrees(plants.yaw_rad) % 360.0, 3),
        "mirror": plants.mirror.astype(np.int64),
        "scale": np.round(plants.scale, 6),
    }
    return gpd.GeoDataFrame(columns, geometry=shapely.points(xy), crs=city.register_crs)


def inventory_table(city: City, *, zones: Mapping[str, str] | None = None) -> pd.DataFrame:
    """Return the plants as i-Tree Eco's fields.

    Parameters
    ----------
    zones
        Zone of each lot by lot_id, from which the land use comes; without it there is no such column.
    """
    plants = city.plants
    degrees = reproject_xy(plants.xy_m, city.crs, WGS84)
    _, scientific, common = _of_species(city)
    frame = pd.DataFrame(
        {
            "ID": np.arange(1, len(plants) + 1),
            "User Tree ID": plants.plant_id,
            "Species": scientific,
            "Common Name": common,
            "DBH 1 (cm)": CM_A_METRE * plants.dbh_m,
            "Total Height (m)": plants.height_m,
            "Crown Base Height (m)": plants.crown_base_m,
            "Crown Width (m)": 2.0 * plants.crown_radius_m,
            "Latitude": degrees[:, 1],
            "Longitude": degrees[:, 0],
        }
    )
    if zones is not None:
        uses = [LAND_USES.get(zones.get(lot, ""), LAND_USES["other"]) for lot in plants.lot_id]
        frame.insert(list(frame.columns).index("Latitude"), "Land Use", np.array(uses, dtype=object))
    return frame


def species_categories(city: City) -> list[tuple[str, str, str]]:
    """Return id, label and colour of each species, as styles take them."""
    return [(item.id, f"{item.scientific_name} ({item.common_name})", item.colour) for item in city.species]


def _of_species(city: City) -> tuple[NDArray[np.object_], NDArray[np.object_], NDArray[np.object_]]:
    """Return (n,) habit, scientific and common name of each plant."""
    words = np.array([(s.habit, s.scientific_name, s.common_name) for s in city.species], dtype=object).reshape(-1, 3)
    found = words[city.plants.species]
    return found[:, 0], found[:, 1], found[:, 2]
