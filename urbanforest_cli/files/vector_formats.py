"""What a file is before anything opens it: a local file, of a format known by name and by first bytes."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.core.errors import InputError

HEAD_BYTES = 4096
_ARCHIVES = (
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"\x1f\x8b",
    b"7z\xbc\xaf\x27\x1c",
    b"Rar!",
    b"BZh",
    b"\xfd7zXZ\x00",
    b"\x28\xb5\x2f\xfd",
)
_GPKG_IDS = (b"GPKG", b"GP10", b"GP11")
_CONVERT = "convert it to GeoPackage with QGIS or ogr2ogr, and give that"


@dataclass(frozen=True)
class VectorFormat:
    """A format that is read.

    Parameters
    ----------
    typed
        Layers say what geometries they hold; if not, any file may hold any mixture.
    """

    name: str
    suffixes: tuple[str, ...]
    typed: bool = True


GEOPACKAGE = VectorFormat("GeoPackage", (".gpkg",))
GEOJSON = VectorFormat("GeoJSON", (".geojson", ".json"), typed=False)
SHAPEFILE = VectorFormat("Shapefile", (".shp",))
FLATGEOBUF = VectorFormat("FlatGeobuf", (".fgb",))
GML = VectorFormat("GML", (".gml",))
FILE_GEODATABASE = VectorFormat("File Geodatabase", (".gdb",))
OSM = VectorFormat("OpenStreetMap", (".osm.pbf", ".pbf", ".osm"))
GEOPARQUET = VectorFormat("GeoParquet", (".parquet", ".geoparquet"))
FORMATS = (GEOPACKAGE, GEOJSON, SHAPEFILE, FLATGEOBUF, GML, FILE_GEODATABASE, OSM, GEOPARQUET)


def split_source(text: str) -> tuple[Path, str | None]:
    """Split ``FILE:LAYER`` into the file and the layer, which is None where none is named.

    A name that exists as a whole is a file, whatever colons it holds.
    """
    refuse_remote(text)
    for place in [len(text)] + [i for i, character in enumerate(text) if character == ":"]:
        if place and os.path.lexists(text[:place]):
            return Path(text[:place]), text[place + 1 :] or None
    path, colon, layer = text.rpartition(":")
    return (Path(path), layer) if colon and Path(path).suffix else (Path(text), None)


def refuse_remote(path: str | Path) -> None:
    """Refuse what GDAL would take for a place on a network, inside an archive or in memory."""
    text = str(path)
    scheme, colon, _ = text.partition(":/")
    if text.startswith("/vsi") or (colon and "/" not in scheme and len(scheme) > 1 and not os.path.lexists(text)):
        raise InputError(
            "only local files are read",
            where=text,
            expected="the path of a file",
            next_step="download or unpack it first",
        )


def vector_format(path: Path) -> VectorFormat:
    """Tell a file's format, by its name and its first bytes, which must agree.

    Raises
    ------
    InputError
        Nothing there, not a regular file, empty, an archive, a file that points to others, an unknown format, or one
        whose content is not what its name says.
    """
    refuse_remote(path)
    mode = _mode(path)
    known = ", ".join(suffix for entry in FORMATS for suffix in entry.suffixes)
    found = next((entry for entry in FORMATS for suffix in entry.suffixes if path.name.lower().endswith(suffix)), None)
    if stat.S_ISDIR(mode):
        if found is FILE_GEODATABASE and (path / "a00000001.gdbtable").is_file():
            return found
        raise InputError("a folder, not a file", where=path, expected=f"a file: {known}, or a folder .gdb")
    if not stat.S_ISREG(mode):
        raise InputError(
            "not a regular file", where=path, found="a pipe, socket or device", expected=f"a file: {known}"
        )
    head = _head(path)
    if not head:
        raise InputError("the file is empty", where=path, found="0 bytes", expected=f"a file: {known}")
    _refuse_indirect(path, head)
    if found is None or found is FILE_GEODATABASE:
        raise InputError(
            "unknown vector format", where=path, found=f"a name ending in {path.suffix or 'nothing'!r}",
            expected=known, next_step=_CONVERT,
        )  # fmt: skip
    content = _content(head, path)
    if content is not found:
        raise InputError(
            f"not a {found.name} file",
            where=path,
            found=f"the content of a {content.name} file" if content else "something else",
            expected=f"what the name {path.suffix!r} says",
            next_step="check how the file was made",
        )
    return found


def _mode(path: Path) -> int:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError as error:
        raise InputError("no such file", where=path, next_step="check the path") from error
    except (OSError, ValueError) as error:  # a loop of links, a folder one may not enter, a name with a null byte
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("the file cannot be reached", where=repr(str(path)), found=reason) from error


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except OSError as error:
        raise InputError("the file cannot be read", where=path, found=error.strerror) from error


def _refuse_indirect(path: Path, head: bytes) -> None:
    """Refuse archives, and files that make a reader open others."""
    if head.startswith(_ARCHIVES) or head[257:262] == b"ustar":
        raise InputError("an archive", where=path, expected="the file inside it", next_step="unpack it first")
    text = head.lower().replace(b"\0", b"")
    if path.suffix.lower() == ".vrt" or b"<ogrvrtdatasource" in text or b"<vrtdataset" in text or b"<gdal_w" in text:
        raise InputError(
            "a virtual dataset, which can point to any file or address, is not read",
            where=path,
            next_step="convert what it points to with ogr2ogr, and give that",
        )
    if text.lstrip().startswith((b"<?xml", b"<!")) and (b"<!doctype" in text or b"<!entity" in text):
        raise InputError("XML with a document type, which can point to other files, is not read", where=path)


def _content(head: bytes, path: Path) -> VectorFormat | None:
    """Tell a format by the first bytes."""
    if head.startswith(b"SQLite format 3\0"):
        return GEOPACKAGE if head[68:72] in _GPKG_IDS else None
    if head.startswith(b"\x00\x00\x27\x0a"):
        return SHAPEFILE
    if head.startswith(b"fgb\x03fgb"):
        return FLATGEOBUF
    if head.startswith(b"PAR1"):
        return GEOPARQUET
    if head[4:15] == b"\x0a\x09OSMHeader"[:11]:
        return OSM
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text.startswith(b"<"):
        if b"<osm" in text:
            return OSM
        return GML if b"opengis.net/gml" in text else None
    if text.startswith(b"{") or path.suffix.lower() in GEOJSON.suffixes:
        return GEOJSON  # whether it really is comes out when its structure is checked
    return None
