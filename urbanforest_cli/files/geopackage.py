"""The register: one GeoPackage, one writer, every write published whole and counted."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import geopandas as gpd
import pandas as pd
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError

from urbanforest_cli.core.errors import BusyError, InputError, OutputError, SchemaError
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.schema import LAYERS, REGISTER_VERSION, check_layer
from urbanforest_cli.files.styles import write_styles

GPKG_VERSION = "1.3"


def honour_source_date() -> None:
    """Let GDAL stamp files with SOURCE_DATE_EPOCH where it is set, so that equal content is equal bytes."""
    if "SOURCE_DATE_EPOCH" in os.environ:
        stamp = timestamp().replace("+00:00", "Z")
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": stamp.replace("Z", ".000Z")})


def timestamp() -> str:
    """Return the present in UTC, or SOURCE_DATE_EPOCH where it is set."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        moment = datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now(UTC)
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(
            "not a number of seconds since 1970", where="environment variable SOURCE_DATE_EPOCH", found=epoch
        ) from error
    return moment.replace(microsecond=0).isoformat()


def write_layers(
    path: Path,
    frames: Mapping[str, pd.DataFrame],
    *,
    fresh: bool = False,
    geometry_types: Mapping[str, str] | None = None,
    drop: Sequence[str] = (),
) -> None:
    """Write layers into a GeoPackage; all others in it stay as they are.

    A copy is changed, counted, synced and renamed over the old file, so that a reader sees the old register or the
    new one. Layers of the register are checked against `core.schema` first.

    Parameters
    ----------
    frames
        A GeoDataFrame for a layer, a DataFrame for a table, by name.
    fresh
        Start from an empty file.
    geometry_types
        Geometry type of layers that are not the register's own, whatever their names; these are not checked.
    drop
        Layers to remove, where they are there: what was made from layers that are written anew.
    """  # fmt: skip
    refuse_sidecars(path)
    for name, frame in frames.items():
        if name in LAYERS and name not in (geometry_types or {}):
            check_layer(frame, name, where=path)
    honour_source_date()
    types = {name: layer.geometry for name, layer in LAYERS.items()} | dict(geometry_types or {})

    def verify(part: Path) -> None:
        check_counts(part, {name: (len(frame), _blank_count(frame)) for name, frame in frames.items()}, shown=path)

    with publish(path, verify=verify) as part:
        if not fresh and path.exists():
            shutil.copyfile(path, part)
            try:
                _drop_layers(part, drop)
            except sqlite3.Error as error:
                raise _write_error(path, error) from error
        for name, frame in frames.items():
            try:
                _write_layer(part, name, frame, types.get(name))
            except (DataSourceError, DataLayerError, RuntimeError) as error:
                raise _write_error(path, error) from error
        try:
            write_styles(part, list(frames))
        except sqlite3.Error as error:
            raise _write_error(path, error) from error


def _blank_count(frame: pd.DataFrame) -> int:
    if not isinstance(frame, gpd.GeoDataFrame):
        return 0
    shapes = frame.geometry.to_numpy()
    return int((shapely.is_missing(shapes) | shapely.is_empty(shapes)).sum())


def _write_layer(part: Path, name: str, frame: pd.DataFrame, geometry_type: str | None) -> None:
    options: dict[str, object] = {"layer": name, "driver": "GPKG"}
    if not part.exists():
        options["dataset_options"] = {"VERSION": GPKG_VERSION, "ADD_GPKG_OGR_CONTENTS": "YES"}
    if isinstance(frame, gpd.GeoDataFrame):
        options |= {"geometry_type": geometry_type, "promote_to_multi": (geometry_type or "").startswith("Multi")}
        options["layer_options"] = {"GEOMETRY_NAME": "geom"}
    pyogrio.write_dataframe(frame, part, use_arrow=True, **options)


def _drop_layers(part: Path, names: Sequence[str]) -> None:
    """Remove layers with all that a GeoPackage knows of them; styles that a user saved for them stay."""
    with closing(sqlite3.connect(part)) as register, register:
        tables = {row[0] for row in register.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        listing = ("gpkg_contents", "gpkg_geometry_columns", "gpkg_extensions", "gpkg_ogr_contents")
        for name in tables & set(names):
            for table in (f"rtree_{name}_geom", name):
                if table in tables:
                    quoted = '"' + table.replace('"', '""') + '"'
                    register.execute(f"DROP TABLE {quoted}")
            for table in listing:
                if table in tables:
                    register.execute(f"DELETE FROM {table} WHERE table_name = ?", (name,))


def _write_error(path: Path, error: Exception) -> OutputError:
    free = shutil.disk_usage(path.parent).free / 1e6
    return OutputError(
        "the GeoPackage could not be written; what stood there before is untouched",
        where=path,
        found=f"{error}; {free:.1f} MB free",
        next_step="make room or name another folder with -o, then run the same command again",
    )


def refuse_sidecars(path: Path) -> None:
    """Refuse to replace a GeoPackage that another program has open for writing.

    A new file under the name of an old one beside that one's journal would be read with the old one's pages.
    """
    for suffix in ("-wal", "-journal"):
        sidecar = path.with_name(path.name + suffix)
        if sidecar.exists() and sidecar.stat().st_size > 0:
            raise BusyError(
                "the file is open in another program",
                where=path,
                found=f"unfinished changes in {sidecar.name}",
                next_step="close it there (QGIS: end editing, remove the layer), then run again",
            )


def check_counts(path: Path, counts: Mapping[str, tuple[int, int]], *, shown: Path | None = None) -> None:
    """Check that what was written is there: rows = cached count = spatial index entries, for each layer.

    Parameters
    ----------
    counts
        For each layer the rows expected, and how many of them have no shape to index.

    Raises
    ------
    OutputError
        Rows are missing.
    """
    with closing(sqlite3.connect(path)) as register:
        cached = dict(register.execute("SELECT table_name, feature_count FROM gpkg_ogr_contents"))
        tables = {row[0] for row in register.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        for name, (expected, blank) in counts.items():
            quoted = '"' + name.replace('"', '""') + '"'
            rows = register.execute(f"SELECT count(*) FROM {quoted}").fetchone()[0]
            found = {"rows": rows, "cached count": cached.get(name, rows)}
            if f"rtree_{name}_geom" in tables:
                index = '"' + f"rtree_{name}_geom".replace('"', '""') + '"'
                found["spatial index"] = register.execute(f"SELECT count(*) FROM {index}").fetchone()[0] + blank
            if any(value != expected for value in found.values()):
                raise OutputError(
                    f"layer {name!r} was not written whole",
                    where=shown or path,
                    found=", ".join(f"{key} {value}" for key, value in found.items()),
                    expected=f"{expected} rows",
                    next_step="check the disk, then run the same command again",
                )


def read_layer(
    path: Path, name: str, *, columns: Sequence[str] | None = None, geometry: bool = True, check: bool = True
) -> gpd.GeoDataFrame | pd.DataFrame:
    """Read a layer of a register and check it.

    Raises
    ------
    SchemaError
        The layer is missing, or breaks its requirements; the text names the command that writes it.
    """
    layer = LAYERS.get(name)
    refuse_foreign(path)
    if name not in layer_names(path):
        command = f"urbanforest {layer.command}" if layer else "urbanforest populate"
        raise SchemaError(f"no layer {name!r}", where=path, next_step=f"run `{command}` first")
    frame = pyogrio.read_dataframe(
        path,
        layer=name,
        columns=list(columns) if columns is not None else None,
        read_geometry=geometry and (layer is None or layer.geometry is not None),
        use_arrow=True,
    )
    if frame.empty:  # texts without a row come as arrays without a chunk, which pandas cannot join
        frame = frame.astype({name: object for name in frame.columns if pd.api.types.is_string_dtype(frame[name])})
    if check and layer is not None and columns is None:
        check_layer(frame, name, where=path)
    return frame


def layer_names(path: Path) -> list[str]:
    """Return the names of a register's layers and tables."""
    return [str(name) for name in pyogrio.list_layers(path)[:, 0]]


def row_count(path: Path, name: str) -> int:
    """Count the rows of a layer of a register, by counting them; 0 where there is none."""
    with closing(sqlite3.connect(f"file:{_quoted(path)}?mode=ro", uri=True)) as register:
        try:
            quoted = '"' + name.replace('"', '""') + '"'
            return int(register.execute(f"SELECT count(*) FROM {quoted}").fetchone()[0])
        except sqlite3.Error:
            return 0


def refuse_foreign(path: Path, *, older_too: bool = True) -> None:
    """Refuse a file that is not a register of a version this program knows.

    Parameters
    ----------
    older_too
        Refuse registers of older versions as well; whoever writes all of it again need not.

    Raises
    ------
    InputError
        Not there, not a GeoPackage, or one that somebody else made.
    SchemaError
        A register of another version.
    """
    if not path.is_file():
        raise InputError(
            "no such register",
            where=path,
            next_step="make it with `urbanforest populate CITY.gpkg`, or with `stencil` its first stage alone",
        )
    with path.open("rb") as stream:
        head = stream.read(72)
    if not head.startswith(b"SQLite format 3\0") or head[68:72] not in (b"GPKG", b"GP10"):
        raise InputError("not a GeoPackage", where=path, expected="a register.gpkg written by urbanforest")
    with closing(sqlite3.connect(f"file:{_quoted(path)}?mode=ro", uri=True)) as register:
        try:
            rows = register.execute("SELECT stage, register_version FROM provenance").fetchall()
        except sqlite3.Error as error:
            raise InputError(
                "not a register of urbanforest",
                where=path,
                found=str(error),
                expected="a table 'provenance'",
                next_step="make a register with `urbanforest stencil CITY.gpkg -o REGISTER.gpkg`",
            ) from error
    stages = {stage for stage, _ in rows}
    versions = [] if is_city(stages) else [version for _, version in rows]
    if any(version > REGISTER_VERSION or (older_too and version < REGISTER_VERSION) for version in versions):
        raise SchemaError(
            "the register was written by another version",
            where=path,
            found=f"register version {max(versions)}",
            expected=f"register version {REGISTER_VERSION}",
            next_step="run `urbanforest populate` again, or use the version that wrote it",
        )


def is_city(stages: Collection[str]) -> bool:
    """Tell whether a file with records of these stages is a made-up city, which tells of itself as a register does."""
    return "synth" in stages and "stencil" not in stages


def _quoted(path: Path) -> str:
    from urllib.parse import quote

    return quote(str(path.resolve()))
