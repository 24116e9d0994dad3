"""Plants as tables with all their attributes: a GeoPackage with a QGIS style inside, and GeoParquet."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import geopandas as gpd
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj import CRS
from pyproj.exceptions import CRSError

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.placed import COLUMNS, PlacedPlants, stated_columns
from urbanforest_cli.core.publish import publish
from urbanforest_cli.files.geopackage import check_counts, refuse_sidecars, timestamp, write_layers
from urbanforest_cli.files.styles import write_crowns_style
from urbanforest_cli.files.words import in_words

LAYER = "plants"
PROVENANCE_URI = "https://www.iana.org/assignments/media-types/application/json"
METADATA_DEFINITION = "http://www.geopackage.org/spec131/#extension_metadata"
PARQUET_KEY = b"urbanforest"
GEOPARQUET_VERSION = "1.1.0"
ROW_GROUP = 50_000

_METADATA_TABLES = (
    "CREATE TABLE gpkg_metadata (id INTEGER CONSTRAINT m_pk PRIMARY KEY ASC NOT NULL, "
    "md_scope TEXT NOT NULL DEFAULT 'dataset', md_standard_uri TEXT NOT NULL, "
    "mime_type TEXT NOT NULL DEFAULT 'text/xml', metadata TEXT NOT NULL DEFAULT '')",
    "CREATE TABLE gpkg_metadata_reference (reference_scope TEXT NOT NULL, table_name TEXT, column_name TEXT, "
    "row_id_value INTEGER, timestamp DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), "
    "md_file_id INTEGER NOT NULL, md_parent_id INTEGER, "
    "CONSTRAINT crmr_mfi_fk FOREIGN KEY (md_file_id) REFERENCES gpkg_metadata(id), "
    "CONSTRAINT crmr_mpi_fk FOREIGN KEY (md_parent_id) REFERENCES gpkg_metadata(id))",
    "CREATE TABLE IF NOT EXISTS gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, "
    "definition TEXT NOT NULL, scope TEXT NOT NULL, "
    "CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name))",
)


def write_plants_gpkg(
    path: Path,
    frame: gpd.GeoDataFrame,
    *,
    categories: Sequence[tuple[str, str, str]],
    provenance: Mapping[str, Any],
) -> None:
    """Publish a GeoPackage of one layer, `plants`, that opens styled in QGIS.

    Parameters
    ----------
    frame
        Points with their attributes, `species`, `height_m` and `crown_radius_m` among them.
    categories
        Id, label and colour of each species.
    provenance
        Goes into the file's metadata, as JSON.

    Raises
    ------
    OutputError
        It could not be written whole.
    """
    refuse_sidecars(path)

    def verify(part: Path) -> None:
        check_counts(part, {LAYER: (len(frame), 0)}, shown=path)

    with publish(path, verify=verify) as part:
        write_layers(part, {LAYER: frame}, fresh=True, geometry_types={LAYER: "Point"})
        try:
            write_crowns_style(part, LAYER, categories)
            _write_metadata(part, provenance)
        except sqlite3.Error as error:
            raise OutputError("the GeoPackage could not be written", where=path, found=str(error)) from error


def _write_metadata(path: Path, provenance: Mapping[str, Any]) -> None:
    text = json.dumps(dict(provenance), ensure_ascii=False, allow_nan=False)
    stamp = timestamp().replace("+00:00", ".000Z")
    with closing(sqlite3.connect(path)) as file, file:
        for statement in _METADATA_TABLES:
            file.execute(statement)
        file.execute(
            "INSERT INTO gpkg_metadata VALUES (1, 'dataset', ?, 'application/json', ?)", (PROVENANCE_URI, text)
        )
        file.execute(
            "INSERT INTO gpkg_metadata_reference VALUES ('geopackage', NULL, NULL, NULL, ?, 1, NULL)", (stamp,)
        )
        for table in ("gpkg_metadata", "gpkg_metadata_reference"):
            file.execute(
                "INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_metadata', ?, 'read-write')",
                (table, METADATA_DEFINITION),
            )


def read_gpkg_plants(path: Path) -> PlacedPlants:
    """Read where a GeoPackage says that plants stand.

    Raises
    ------
    InputError
        It is not there, torn, or has no such layer.
    """
    try:
        frame = pyogrio.read_dataframe(path, layer=LAYER, columns=["plant_id", "height_m", *COLUMNS], use_arrow=True)
    except (DataSourceError, DataLayerError, RuntimeError, OSError, ValueError) as error:
        raise _wrong(path, str(error)) from error
    if not isinstance(frame, gpd.GeoDataFrame) or frame.crs is None or not {"plant_id", "height_m"} <= set(frame):
        raise _wrong(path, "no points with plant_id and height_m")
    return _placed(path, frame)


def read_gpkg_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made a GeoPackage of plants from what; None where it does not say.

    Raises
    ------
    InputError
        It is not there, or is no GeoPackage.
    """
    if not path.is_file():
        raise _wrong(path, "no such file")
    with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)) as file:
        try:
            if not file.execute("SELECT count(*) FROM sqlite_master WHERE name = 'gpkg_metadata'").fetchone()[0]:
                return None
            row = file.execute(
                "SELECT metadata FROM gpkg_metadata WHERE md_standard_uri = ? AND mime_type = 'application/json'",
                (PROVENANCE_URI,),
            ).fetchone()
        except sqlite3.Error as error:
            raise _wrong(path, str(error)) from error
    return _record(path, row[0]) if row else None


def write_plants_parquet(path: Path, frame: gpd.GeoDataFrame, *, provenance: Mapping[str, Any]) -> None:
    """Publish plants as GeoParquet 1.1: points as WKB, a box a row to filter by, row groups of 50,000 in their order.

    Parameters
    ----------
    frame
        Points with their attributes.
    provenance
        Goes into the file's metadata under the key ``urbanforest``, as JSON.

    Raises
    ------
    OutputError
        It could not be written whole.
    """
    shapes = frame.geometry.to_numpy()
    xy = shapely.get_coordinates(shapes)
    attributes = frame.drop(columns=frame.geometry.name)
    table = pa.Table.from_pandas(attributes, preserve_index=False).replace_schema_metadata(None)
    table = table.append_column("geometry", pa.array(shapely.to_wkb(shapes, byte_order=1), pa.binary()))
    corners = [pa.array(xy[:, axis]) for axis in (0, 1, 0, 1)]
    names = ["xmin", "ymin", "xmax", "ymax"]
    table = table.append_column("bbox", pa.StructArray.from_arrays(corners, names=names))
    metadata = {
        b"geo": json.dumps(_geo(frame.crs, xy)).encode(),
        PARQUET_KEY: json.dumps(dict(provenance), ensure_ascii=False, allow_nan=False).encode(),
    }

    def verify(part: Path) -> None:
        count = pq.read_metadata(part).num_rows
        if count != len(frame):
            raise OutputError("the table was not written whole", where=path, found=f"{count} of {len(frame)} rows")

    with publish(path, verify=verify) as part:
        pq.write_table(table.replace_schema_metadata(metadata), part, compression="zstd", row_group_size=ROW_GROUP)


def _geo(crs: CRS, xy: np.ndarray) -> dict[str, Any]:
    column: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": ["Point"],
        "crs": crs.to_json_dict(),
        "covering": {"bbox": {corner: ["bbox", corner] for corner in ("xmin", "ymin", "xmax", "ymax")}},
    }
    if len(xy):
        column["bbox"] = [float(value) for value in (*xy.min(axis=0), *xy.max(axis=0))]
    return {"version": GEOPARQUET_VERSION, "primary_column": "geometry", "columns": {"geometry": column}}


def read_parquet_plants(path: Path) -> PlacedPlants:
    """Read where a GeoParquet says that plants stand.

    Raises
    ------
    InputError
        It is not there, torn, or not of this program.
    """
    try:
        with pq.ParquetFile(path) as file:
            table = file.read(columns=["plant_id", "height_m", *COLUMNS, "geometry"])
            geo = json.loads((file.schema_arrow.metadata or {})[b"geo"])
        crs = CRS.from_json_dict(geo["columns"]["geometry"]["crs"])
        frame = gpd.GeoDataFrame(
            {"plant_id": table["plant_id"].to_pylist(), "height_m": table["height_m"].to_numpy()}
            | {name: table[name].to_pylist() for name in COLUMNS if name in table.column_names},
            geometry=shapely.from_wkb(table["geometry"].to_numpy()),
            crs=crs,
        )
    except (OSError, pa.ArrowException, CRSError, shapely.errors.ShapelyError) as error:
        raise _wrong(path, str(error)) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _wrong(path, in_words(error)) from error
    return _placed(path, frame)


def read_parquet_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made a GeoParquet from what; None where it does not say.

    Raises
    ------
    InputError
        It is not there, torn, or no Parquet.
    """
    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, pa.ArrowException) as error:
        raise _wrong(path, str(error)) from error
    text = metadata.get(PARQUET_KEY)
    return _record(path, text) if text else None


def _placed(path: Path, frame: gpd.GeoDataFrame) -> PlacedPlants:
    shapes = frame.geometry.to_numpy()
    if (shapely.get_type_id(shapes) != shapely.GeometryType.POINT).any():
        raise _wrong(path, "geometries that are no points")
    try:
        height = frame["height_m"].to_numpy(dtype=np.float64)
        columns = stated_columns({name: frame[name] for name in COLUMNS if name in frame})
    except (TypeError, ValueError) as error:
        raise _wrong(path, f"sizes: {in_words(error)}") from error
    ids = frame["plant_id"].astype(object).to_numpy()
    if not all(isinstance(item, str) for item in ids):
        raise _wrong(path, "plants without a plant_id")
    xyz = np.column_stack([shapely.get_coordinates(shapes).reshape(-1, 2), np.zeros(len(shapes))])
    return PlacedPlants(ids, xyz, CRS.from_user_input(frame.crs), height, columns)


def _record(path: Path, text: str | bytes) -> dict[str, Any] | None:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _wrong(path, str(error)) from error
    return found if isinstance(found, dict) else None


def _wrong(path: Path, found: str) -> InputError:
    return InputError(
        "not plants of urbanforest, or not a whole file", where=path, found=found,
        next_step="run `urbanforest export` again",
    )  # fmt: skip
