"""A city file made in a line, and what `stencil` made of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import pandas as pd
import pyogrio
import pytest

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.files.geopackage import read_layer

CRS = "EPSG:32633"


def write_layer(path: Path, name: str, geometries: list[Any], crs: str | None = CRS, **columns: Any) -> None:
    frame = gpd.GeoDataFrame(columns, geometry=geometries, crs=crs)
    kinds = {shape.geom_type + " Z" * shape.has_z for shape in geometries if shape is not None}
    kind = kinds.pop() if len(kinds) == 1 else "Unknown"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'crs' was not provided")
        pyogrio.write_dataframe(
            frame, path, layer=name, driver="GPKG", geometry_type=kind, layer_options={"GEOMETRY_NAME": "geom"}
        )


@dataclass
class Register:
    path: Path
    summary: StageSummary

    def layer(self, name: str) -> Any:
        return read_layer(self.path, name)

    @property
    def notices(self) -> Notices:
        return self.summary.notices

    def lot(self, lot_id: str) -> Any:
        return self.layer("lots").set_index("lot_id").loc[lot_id]

    def area(self, lot_id: str) -> float:
        """Area of the cleaned lot."""
        return float(self.lot(lot_id)["area_m2"])

    def reasons(self) -> dict[str, str]:
        skipped = self.layer("skipped")
        return dict(zip(skipped["lot_id"], skipped["reason"], strict=True))

    def parameters(self) -> pd.DataFrame:
        return pd.DataFrame(self.layer("parameters")).set_index("lot_id")

    def nothing_is_lost(self) -> bool:
        lots = set(self.layer("lots")["lot_id"])
        active = self.layer("active_areas")["lot_id"].tolist()
        skipped = self.layer("skipped")["lot_id"].tolist()
        return sorted([*active, *skipped]) == sorted(lots)


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Register]:
    """Stencil a city file."""
    from urbanforest_cli.register.stage import stencil_city

    def stencil(city: Path, config: Config | None = None, **options: Any) -> Register:
        path = tmp_path / "out" / "register.gpkg"
        options.setdefault("seed", 1)
        return Register(path, stencil_city(city, path, config=config or Config(), **options))

    return stencil


@pytest.fixture
def stencil(tmp_path: Path, run: Callable[..., Register]) -> Callable[..., Register]:
    """Stencil lots given as shapes; ids are a, b, c, ... unless given."""

    def make(
        geometries: list[Any],
        *,
        crs: str | None = CRS,
        config: Config | None = None,
        layers: dict[str, list[Any]] | None = None,
        options: dict[str, Any] | None = None,
        **columns: Any,
    ) -> Register:
        city = tmp_path / "city.gpkg"
        city.unlink(missing_ok=True)
        columns.setdefault("lot_id", [chr(ord("a") + i) for i in range(len(geometries))])
        write_layer(city, "lots", geometries, crs, **columns)
        for name, shapes in (layers or {}).items():
            write_layer(city, name, shapes, crs)
        return run(city, config, **(options or {}))

    return make
