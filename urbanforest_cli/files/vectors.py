"""Safe reading of vector files that somebody else made.

A file is a local one of a known format, its layer is never guessed, every row it holds is returned, and whatever a
reader repairs or cannot read is counted.
"""

from __future__ import annotations

import difflib
import json
import sqlite3
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet
import pyogrio
import pyogrio.raw
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.geojson_structure import check_geojson
from urbanforest_cli.files.shapefile_records import damaged_records
from urbanforest_cli.files.vector_crs import crs_of, row_names, settle_crs
from urbanforest_cli.files.vector_formats import (
    GEOJSON,
    GEOPACKAGE,
    GEOPARQUET,
    GML,
    SHAPEFILE,
    VectorFormat,
    split_source,
    vector_format,
)

__all__ = ["list_vector_layers", "read_vector", "split_source"]

POLYGON, LINE, POINT = "polygon", "line", "point"
EXPANDED_LIMIT_BYTES = 8 * 2**30
GML_LIMIT_BYTES = 2 * 2**30

# Everything pyogrio, pyarrow, shapely and sqlite3 raise for a file they cannot read. OSError holds ArrowIOError,
# ValueError holds ArrowInvalid and UnicodeDecodeError, RuntimeError holds pyogrio's own.
_READER_ERRORS = (
    RuntimeError, ValueError, OSError, NotImplementedError, KeyError, IndexError, TypeError, OverflowError, MemoryError,
    pa.ArrowException, shapely.errors.ShapelyError, sqlite3.Error,
)  # fmt: skip
_FLAT_TYPES = {"POLYGON": POLYGON, "CURVEPOLYGON": POLYGON, "SURFACE": POLYGON, "TIN": POLYGON, "TRIANGLE": POLYGON,
               "POLYHEDRALSURFACE": POLYGON, "LINESTRING": LINE, "CURVE": LINE, "CIRCULARSTRING": LINE,
               "COMPOUNDCURVE": LINE, "LINEARRING": LINE, "POINT": POINT}  # fmt: skip
_CURVED_WKB = frozenset(range(8, 15))
_SPATIALITE_TABLES = ("ElementaryGeometries", "KNN", "KNN2", "SpatialIndex")


def list_vector_layers(path: str | Path) -> list[tuple[str, str | None]]:
    """Return the names of a file's layers, each with its geometry type, or None for a table without geometry.

    Raises
    ------
    InputError
        The file is not one that is read.
    """
    path = Path(path)
    form = vector_format(path)
    if form is GEOPARQUET:
        return [(path.stem, "Unknown")]
    with _reader_errors(path, form):
        _check_database(path, form)
        return [
            (str(name), None if kind is None else str(kind)) for name, kind in pyogrio.list_layers(_source(path, form))
        ]


def read_vector(
    path: str | Path,
    *,
    layer: str | None = None,
    columns: Sequence[str] | None = None,
    kinds: Collection[str] = (POLYGON,),
    assume_crs: str | CRS | None = None,
    notices: Notices,
    where_hint: str | None = None,
) -> gpd.GeoDataFrame:
    """Read one layer of a vector file, every row of it.

    Coordinates come back in the file's CRS, x before y, two a position. Rows whose geometry is missing or cannot be
    built are kept with None; coordinates that are not finite are kept for the caller to find (with `shapely.bounds`,
    before any other operation). The index, named ``fid``, numbers the rows as the file does.

    Parameters
    ----------
    layer
        Needed where more than one layer of the kinds wanted is there.
    columns
        Those wanted if present; all by default.
    kinds
        Kinds of geometry wanted: ``polygon``, ``line``, ``point``. Layers of others are not taken unless named, and
        not then either if all they hold is something else.
    assume_crs
        CRS of a file that names none, or whose numbers cannot be in the one it names.
    where_hint
        What messages call the source; the path by default.

    Raises
    ------
    InputError
        The file cannot be used; one line says why.
    CrsError
        No CRS, or one that the numbers contradict.
    LimitError
        More than the limits of this module allow.
    """
    path = Path(path)
    where = where_hint or str(path)
    form = vector_format(path)
    if form is GEOJSON:
        check_geojson(path, notices, assumed=assume_crs is not None)
    with _reader_errors(where, form):
        _check_database(path, form)
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always")
            if form is GEOPARQUET:
                frame, stated = _read_parquet(path, columns, where, notices)
            else:
                layer = _choose_layer(path, form, layer, kinds, where)
                frame, stated = _read_with_gdal(path, form, layer, columns, where, notices)
        _note_remarks(remarks, notices, where)
        crs = settle_crs(frame, stated, assume_crs, where, notices)
        if form is GEOJSON:
            _note_ring_habits(frame["geometry"].to_numpy(), notices, where)
        return gpd.GeoDataFrame(frame.drop(columns="geometry"), geometry=frame["geometry"].to_numpy(), crs=crs)


@contextmanager
def _reader_errors(where: object, form: VectorFormat) -> Iterator[None]:
    """Turn what a reader raises into one line."""
    try:
        yield
    except _READER_ERRORS as error:
        text = " ".join(str(error).split())
        raise InputError(
            f"the {form.name} file cannot be read",
            where=where,
            found=text[:300] or type(error).__name__,
            next_step="check that the file is whole; open it in QGIS and save it again",
        ) from error


def _check_database(path: Path, form: VectorFormat) -> None:
    """Refuse a GeoPackage whose pages or records contradict each other."""
    if form is not GEOPACKAGE:
        return
    state = path.stat()
    faults = _database_faults(path, state.st_size, state.st_mtime_ns)
    if faults:
        raise RuntimeError("the database is damaged: " + "; ".join(faults))


@lru_cache(maxsize=16)
def _database_faults(path: Path, size: int, mtime_ns: int) -> tuple[str, ...]:
    """Return what SQLite finds wrong with a file; once for all its layers, as long as it does not change."""
    with closing(_connect(path)) as database:
        return tuple(row[0] for row in database.execute("PRAGMA quick_check(3)") if row[0] != "ok")


def _connect(path: Path) -> sqlite3.Connection:
    """Open a GeoPackage without leaving anything beside it."""
    with path.open("rb") as stream:
        in_wal_mode = stream.read(20)[18:20] == b"\x02\x02"
    alone = not path.with_name(path.name + "-wal").exists()
    options = "mode=ro&immutable=1" if in_wal_mode and alone else "mode=ro"
    database = sqlite3.connect(f"file:{quote(str(path.resolve()))}?{options}", uri=True)
    database.execute("PRAGMA trusted_schema=OFF")
    return database


def _source(path: Path, form: VectorFormat) -> Path | bytes:
    """Return what GDAL is given. GML is handed over as bytes, since GDAL writes its guess of the schema beside it."""
    if form is not GML:
        return path
    if path.stat().st_size > GML_LIMIT_BYTES:
        raise LimitError(
            "the file is too long for GML",
            where=path,
            expected=f"at most {GML_LIMIT_BYTES / 2**30:.0f} GiB",
            next_step="convert it to GeoPackage: ogr2ogr OUT.gpkg IN.gml",
        )
    return path.read_bytes()


def _choose_layer(path: Path, form: VectorFormat, layer: str | None, kinds: Collection[str], where: str) -> str:
    layers = [
        (str(name), None if kind is None else str(kind))
        for name, kind in pyogrio.list_layers(_source(path, form))
        if str(name) not in _SPATIALITE_TABLES
    ]
    spatial = [(name, kind) for name, kind in layers if kind is not None]
    listed = ", ".join(f"{name} ({kind or 'table'})" for name, kind in layers[:20]) or "no layers"
    wanted = " or ".join(kinds)
    if layer is not None:
        if layer not in [name for name, _ in spatial]:
            close = difflib.get_close_matches(layer, [name for name, _ in spatial], n=1)
            raise InputError(
                f"no layer {layer!r}", where=where, found=listed,
                next_step=f"did you mean {close[0]!r}?" if close else "name one of these",
            )  # fmt: skip
        return layer
    fitting = [name for name, kind in spatial if _flat_kind(kind) in kinds]
    fitting = fitting or [name for name, kind in spatial if _flat_kind(kind) is None or not form.typed]
    if len(fitting) == 1:
        return fitting[0]
    if not fitting:
        raise InputError(f"no {wanted} layer", where=where, found=listed, expected=f"a layer of {wanted}s")
    raise InputError(
        "several layers: which one is meant?",
        where=where,
        found=", ".join(fitting[:20]),
        expected=f"one {wanted} layer, or a name",
        next_step=f"name it: {path}:{fitting[0]}",
    )


def _flat_kind(kind: str | None) -> str | None:
    """Return polygon, line or point; None for layers of any type."""
    name = (kind or "").upper().split(" ")[0].removeprefix("MULTI").removeprefix("2.5D")
    return _FLAT_TYPES.get(name)


def _read_with_gdal(
    path: Path, form: VectorFormat, layer: str, columns: Sequence[str] | None, where: str, notices: Notices
) -> tuple[pd.DataFrame, CRS | None]:
    # Rows come through Arrow: the other way reads no further than the count a GeoPackage remembers.
    options = {"DOWNLOAD_SCHEMA": "NO"} if form is GML else {}
    wanted = {"layer": layer, "columns": _list(columns), "return_fids": True, **options}
    meta, table = pyogrio.raw.read_arrow(_source(path, form), **wanted)
    try:
        names = table.column_names
    except UnicodeDecodeError:  # in an older encoding, which the file does not state
        meta, table = pyogrio.raw.read_arrow(_source(path, form), encoding="cp1252", **wanted)
        names = table.column_names
        notices.add("W_ENCODING", "texts that are not UTF-8, read as Windows-1252", 1, [f"{where} names of columns"])
    shape_place = names.index(meta["geometry_name"] or "wkb_geometry")
    # The row numbers come first; GeoJSON gives them the name of its property "id".
    fids = table.column(0).to_numpy()
    pieces = table.column(shape_place).to_numpy(zero_copy_only=False)
    frame = _attributes(table.select([i for i in range(1, len(names)) if i != shape_place]), where, notices)
    frame.index = pd.Index(fids, name="fid")
    pieces = _straightened(path, form, layer, pieces, fids, where, notices)
    frame["geometry"] = _build(pieces, fids, where, notices, path if form is SHAPEFILE else None)
    if form is GEOPACKAGE:
        _check_row_count(path, layer, len(frame), where, notices)
    return frame, crs_of(meta["crs"], where)


def _list(columns: Sequence[str] | None) -> list[str] | None:
    return None if columns is None else list(columns)


def _attributes(table: pa.Table, where: str, notices: Notices) -> pd.DataFrame:
    """Turn columns into a frame; whole numbers stay whole beside missing ones, text stays text."""
    series: dict[str, Any] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in series:
            raise InputError("two columns bear one name", where=where, found=name, next_step="rename one of them")
        name = "geometry_column" if name == "geometry" else name
        if pa.types.is_integer(column.type) and column.null_count:
            series[name] = column.to_pandas(types_mapper=_nullable_integer)
        elif pa.types.is_boolean(column.type) and column.null_count:
            series[name] = column.to_pandas(types_mapper=lambda _: pd.BooleanDtype())
        elif pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            series[name] = pd.Series(_texts(column, name, where, notices), dtype=object)
        else:
            series[name] = column.to_pandas()
    return pd.DataFrame(series, index=range(len(table)))


def _nullable_integer(kind: pa.DataType) -> Any:
    return {pa.uint64(): pd.UInt64Dtype()}.get(kind, pd.Int64Dtype())


def _texts(column: pa.ChunkedArray, name: str, where: str, notices: Notices) -> list[str | None]:
    try:
        return list(column.to_pylist())
    except UnicodeDecodeError:
        pieces = column.cast(pa.large_binary() if pa.types.is_large_string(column.type) else pa.binary()).to_pylist()
    texts: list[str | None] = []
    for piece in pieces:
        try:
            texts.append(None if piece is None else piece.decode("utf-8"))
        except UnicodeDecodeError:
            texts.append(piece.decode("cp1252", errors="replace"))
            notices.add("W_ENCODING", "texts that are not UTF-8, read as Windows-1252", 1, [f"{where} {name}"])
    return texts


def _straightened(
    path: Path,
    form: VectorFormat,
    layer: str,
    pieces: NDArray[Any],
    fids: NDArray[np.int64],
    where: str,
    notices: Notices,
) -> NDArray[Any]:
    """Replace curves by their chords; GDAL's steps of 4 degrees keep within 0.06 % of a radius."""
    heads = {piece[:5] for piece in pieces if piece is not None}
    curves = {head for head in heads if _wkb_type(head) in _CURVED_WKB}
    if not curves:
        return pieces
    curved = np.array([piece is not None and piece[:5] in curves for piece in pieces], dtype=bool)
    _, chord_fids, chords, _ = pyogrio.raw.read(
        _source(path, form), layer=layer, columns=[], force_2d=True, return_fids=True, fids=fids[curved]
    )
    by_fid = dict(zip(chord_fids.tolist(), chords, strict=True))
    pieces = pieces.copy()
    pieces[curved] = [by_fid.get(fid) for fid in fids[curved].tolist()]
    notices.add("W_CURVE", "curves replaced by chords", int(curved.sum()), row_names(where, fids[curved]))
    return pieces


def _wkb_type(piece: bytes) -> int:
    number = int.from_bytes(piece[1:5], "little" if piece[:1] == b"\x01" else "big")
    return (number & 0x0FFFFFFF) % 1000


def _build(
    pieces: NDArray[Any], fids: NDArray[np.int64], where: str, notices: Notices, shapefile: Path | None = None
) -> NDArray[Any]:
    """Make 2D geometries from WKB; what cannot be made is None and counted."""
    shapes = shapely.force_2d(shapely.from_wkb(pieces, on_invalid="ignore"))
    given = np.array([piece is not None for piece in pieces], dtype=bool)
    failed = given & shapely.is_missing(shapes)
    notices.add(
        "W_BROKEN_RING", "geometries with an open ring or too few positions, not read", int(failed.sum()),
        row_names(where, fids[failed]),
    )  # fmt: skip
    missing = ~given
    if shapefile is not None and missing.any():
        damaged = missing.copy()
        damaged[missing] = damaged_records(shapefile, fids[missing])
        if damaged.all():
            raise RuntimeError(f"every one of its {len(damaged)} records is damaged")
        notices.add("W_DAMAGED", "damaged records, not read", int(damaged.sum()), row_names(where, fids[damaged]))
        missing &= ~damaged
    notices.add("W_NO_GEOMETRY", "rows without a geometry", int(missing.sum()), row_names(where, fids[missing]))
    return shapes


def _check_row_count(path: Path, layer: str, count: int, where: str, notices: Notices) -> None:
    quoted = '"' + layer.replace('"', '""') + '"'
    with closing(_connect(path)) as database:
        true = database.execute(f"SELECT count(*) FROM {quoted}").fetchone()[0]
        tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master")}
        cached = None
        if "gpkg_ogr_contents" in tables:
            query = "SELECT feature_count FROM gpkg_ogr_contents WHERE lower(table_name) = lower(?)"
            row = database.execute(query, (layer,)).fetchone()
            cached = row[0] if row else None
    if true != count:
        raise RuntimeError(f"layer {layer!r} holds {true} rows, {count} could be read")
    if isinstance(cached, int) and cached != true:
        text = "layers whose remembered row count is wrong; every row was read"
        notices.add("W_ROW_COUNT", text, 1, [f"{Path(where).name} {layer}: {cached} remembered, {true} there"])


def _read_parquet(
    path: Path, columns: Sequence[str] | None, where: str, notices: Notices
) -> tuple[pd.DataFrame, CRS | None]:
    with path.open("rb") as stream:
        parquet = pyarrow.parquet.ParquetFile(stream)
        expanded = sum(parquet.metadata.row_group(i).total_byte_size for i in range(parquet.num_row_groups))
        if expanded > EXPANDED_LIMIT_BYTES:
            raise LimitError(
                "the file is too large", where=where, found=f"{expanded / 2**30:.1f} GiB unpacked",
                expected=f"at most {EXPANDED_LIMIT_BYTES / 2**30:.0f} GiB", next_step="cut it to the city",
            )  # fmt: skip
        names = parquet.schema_arrow.names
        geo = json.loads((parquet.schema_arrow.metadata or {}).get(b"geo", b"null"))
        if not isinstance(geo, dict):
            raise InputError("Parquet without geometry", where=where, expected="GeoParquet, with a 'geo' entry")
        main = str(geo["primary_column"])
        details = geo["columns"][main]
        if details.get("encoding") != "WKB":
            raise InputError(
                "GeoParquet of an unknown encoding", where=where, found=details.get("encoding"), expected="WKB"
            )
        others = [name for name in names if name not in geo["columns"] and (columns is None or name in columns)]
        table = parquet.read([main, *others])
    fids = np.arange(len(table), dtype=np.int64)
    frame = _attributes(table.select(others), where, notices)
    frame.index = pd.Index(fids, name="fid")
    frame["geometry"] = _build(table.column(main).to_numpy(zero_copy_only=False), fids, where, notices)
    stated = details.get("crs", "OGC:CRS84")
    return frame, None if stated is None else crs_of(stated, where)


def _note_remarks(remarks: list[warnings.WarningMessage], notices: Notices, where: str) -> None:
    texts = dict.fromkeys(" ".join(str(remark.message).split())[:200] for remark in remarks)
    notices.add("W_READER", "remarks of the file's reader", len(texts), [f"{Path(where).name}: {t}" for t in texts])


def _note_ring_habits(shapes: NDArray[Any], notices: Notices, where: str) -> None:
    """Count what GeoJSON forbids or discourages in a polygon but nothing here depends on."""
    parts, owners = shapely.get_parts(shapes, return_index=True)
    polygonal = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    parts, owners = parts[polygonal], owners[polygonal]
    rings, places = shapely.get_rings(parts, return_index=True)
    if len(rings) == 0:
        return
    outer = np.r_[True, places[1:] != places[:-1]]
    xy, place = shapely.get_coordinates(rings, return_index=True)
    finite = np.bincount(place, weights=~np.isfinite(xy).all(axis=1), minlength=len(rings)) == 0
    wrong = np.zeros(len(rings), dtype=bool)
    wrong[finite] = shapely.is_ccw(rings[finite]) != outer[finite]
    doubled = (xy[1:] == xy[:-1]).all(axis=1) & (place[1:] == place[:-1])
    turned, repeated = (np.unique(owners[places[which]]) for which in (wrong, np.unique(place[1:][doubled])))
    name = Path(where).name
    notices.add("W_WINDING", "features whose rings turn the wrong way, which does not matter here", len(turned), [name])
    notices.add("W_REPEATED", "features that repeat a position, which does not matter here", len(repeated), [name])
