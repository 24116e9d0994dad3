"""Plants as an inventory for i-Tree Eco v6.

Columns bear the names of Eco's own fields, so that its import wizard (Data > Trees > Import, a complete inventory in
metric units) needs little matching: `ID` must be a whole number above zero, `User Tree ID` takes any text, `Species` a
scientific name; of the rest Eco wants the stem's diameter and predicts what is missing. Fields that nobody measured
(crown light exposure, condition, percent crown missing) are left out: Eco then states its own assumptions.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import CRS

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.placed import PlacedPlants
from urbanforest_cli.core.publish import publish
from urbanforest_cli.files.csvw import read_description, read_table, write_description, write_table

COLUMNS: dict[str, tuple[str, str]] = {
    "ID": ("integer", "whole number above zero: the plant's row"),
    "User Tree ID": ("string", "plant_id, as in every other output"),
    "Species": ("string", "scientific name"),
    "Common Name": ("string", "name in English"),
    "DBH 1 (cm)": ("decimal", "diameter of the stems at 1.3 m (Eco's own breast height is 1.37 m); 0 for plants below"),
    "Total Height (m)": ("decimal", "height of the highest twig"),
    "Crown Base Height (m)": ("decimal", "height of the lowest living branch"),
    "Crown Width (m)": ("decimal", "twice the crown's mean reach over eight directions"),
    "Land Use": ("string", "Eco's class nearest to the zone of the plant's lot"),
    "Latitude": ("decimal", "degrees, WGS 84"),
    "Longitude": ("decimal", "degrees, WGS 84"),
}
"""For each column its type and meaning; the table has those of them that it is given."""

CM_A_METRE = 100.0
DECIMALS = {
    "ID": 0, "DBH 1 (cm)": 1, "Total Height (m)": 3, "Crown Base Height (m)": 3, "Crown Width (m)": 3,
    "Latitude": 8, "Longitude": 8,
}  # fmt: skip


def write_itree(path: Path, frame: pd.DataFrame, *, provenance: Mapping[str, Any]) -> None:
    """Publish an inventory and, beside it, its description with the provenance.

    Parameters
    ----------
    path
        The CSV; the description lies beside it as ``NAME.csv-metadata.json``.
    frame
        A row a plant, columns as in `COLUMNS`.

    Raises
    ------
    OutputError
        It could not be written whole.
    """

    def verify(part: Path) -> None:
        count = len(read_table(part, {"User Tree ID": "text"})["User Tree ID"])
        if count != len(frame):
            raise OutputError("the table was not written whole", where=path, found=f"{count} of {len(frame)} rows")

    with publish(path, verify=verify) as part:
        write_table(part, frame, {name: DECIMALS[name] for name in frame.columns if name in DECIMALS})
    columns = {name: COLUMNS[name] for name in frame.columns}
    write_description(path, columns=columns, about={"provenance": dict(provenance)}, key="User Tree ID")


def read_plants(path: Path) -> PlacedPlants:
    """Read where an inventory says that plants stand.

    Raises
    ------
    InputError
        It is not there, torn, or no inventory of this program; or what lies beside it describes another table.
    """
    read_description(path)
    numbers = ("Longitude", "Latitude", "Total Height (m)", "DBH 1 (cm)", "Crown Base Height (m)", "Crown Width (m)")
    table = read_table(path, {"User Tree ID": "text", **dict.fromkeys(numbers, "number")})
    longitude, latitude, height, stem_cm, base, width = (table[name] for name in numbers)
    sizes = {"dbh_m": stem_cm / CM_A_METRE, "crown_base_m": base, "crown_radius_m": width / 2}
    place = np.column_stack([longitude, latitude, np.zeros(len(longitude))])
    return PlacedPlants(table["User Tree ID"], place, CRS.from_epsg(4326), height, sizes)


def read_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made an inventory from what; None where nothing lies beside it.

    Raises
    ------
    InputError
        What lies beside it is torn, or belongs to another table.
    """
    about = read_description(path)
    found = about.get("provenance") if about else None
    return found if isinstance(found, dict) else None
