"""Where an output comes from, read out of the output itself."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from urbanforest_cli.core.errors import InputError, UrbanForestError
from urbanforest_cli.files import skeletons
from urbanforest_cli.files.geopackage import layer_names, refuse_foreign
from urbanforest_cli.files.manifest import MANIFEST, manifest_faults, read_manifest
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.files.skeleton_parts import named_parts, parts_folder
from urbanforest_cli.files.words import in_words, kind_of


def is_output(path: Path, form: str, out: Path) -> bool:
    """Tell whether a file is what an earlier run wrote in a format, by the manifest of `out` or by its own word."""
    named = read_manifest(out).get(path.name) if path.parent.resolve() == out.resolve() else None
    if named is not None:
        return named.format == form
    try:
        return describe_output(path).get("format") == form
    except UrbanForestError:
        return False


def describe_output(path: Path) -> dict[str, object]:
    """Return the provenance of a file or a folder this program wrote; of a folder of outputs, that of its register.

    Raises
    ------
    InputError
        It is not there, or carries no provenance of this program.
    """
    if not path.exists():
        raise InputError("no such file", where=path)
    reader = _reader_of(path)
    record = reader(path) if reader else None
    if record is None:
        raise InputError(
            "no provenance of urbanforest inside",
            where=path,
            expected="a register, exports.json, a report, a picture, skeletons, or what `urbanforest export` wrote",
            next_step="name one of these, or the folder that `urbanforest populate` wrote them to",
        )
    return dict(record)


REGISTER = "register.gpkg"


def _reader_of(path: Path) -> Reader | None:
    """Return what reads an output, by its name; of a folder, by what is in it."""
    if path.is_dir():
        inside = next((name for name in FOLDERS if (path / name).is_file()), None)
        return _of_folder if inside == REGISTER else BY_NAME[inside] if inside else None
    name = path.name.casefold()
    ends = (end for end in sorted(BY_NAME, key=len, reverse=True) if name.endswith(end))
    return next((BY_NAME[end] for end in ends), None)


def _of_tiles(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import tiles3d_reader

    return _named(path, tiles3d_reader.read_provenance(path))


def _of_gltf(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import gltf_reader

    return _named(path, gltf_reader.read_provenance(path))


def _of_cityjson(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import cityjson_reader

    return _named(path, cityjson_reader.read_provenance(path))


def _of_library(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import obj

    return _named(path, obj.read_provenance(path if path.is_dir() else path.parent))


def _of_inventory(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import itree

    return _named(path, itree.read_provenance(path))


def _of_raster(path: Path) -> dict[str, object] | None:
    from urbanforest_cli.files import canopy

    return _named(path, canopy.read_provenance(path))


def _of_geopackage(path: Path) -> dict[str, object] | None:
    """Tell of a register, or of exported plants, which have no table of stages but a record of their own."""
    from urbanforest_cli.files import plant_tables

    try:
        refuse_foreign(path)
    except InputError:
        record = plant_tables.read_gpkg_provenance(path)
        if record is None:
            raise
        return _named(path, record)
    return _register(path)


def _of_parquet(path: Path) -> dict[str, object] | None:
    """Tell of skeletons, or of exported plants, which say that they are GeoParquet."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from urbanforest_cli.files import plant_tables

    try:
        is_geographic = b"geo" in (pq.read_schema(path).metadata or {})
    except (OSError, pa.ArrowException):  # told of by what reads it next
        is_geographic = False
    return _named(path, plant_tables.read_parquet_provenance(path)) if is_geographic else skeletons.describe(path)


def _of_folder(path: Path) -> dict[str, object]:
    """Tell of a folder of outputs by its register."""
    return _register(path / REGISTER)


def _of_manifest(path: Path) -> dict[str, object]:
    if faults := manifest_faults(path.parent):
        raise InputError("the list of outputs is torn", where=path, found="; ".join(faults))
    outputs: dict[str, object] = {}
    for name, export in read_manifest(path.parent).items():
        outputs[name] = {
            "format": export.format,
            "key": export.key,
            "growth": export.growth,
            "options": dict(export.options),
            "files": len(export.files),
            "bytes": sum(file.bytes for file in export.files.values()),
        }
    return {"file": path.name, "outputs": outputs}


def _named(path: Path, record: Mapping[str, object] | None) -> dict[str, object] | None:
    return {"file": path.name, **record} if record is not None else None


def _register(path: Path) -> dict[str, object]:
    refuse_foreign(path)
    stages: dict[str, object] = {}
    for name, record in read_records(path).items():
        row = record.as_row()
        stages[name] = {
            "program_version": record.program_version,
            "seed": record.seed,
            "stage_key": record.stage_key,
            "working_crs": record.working_crs.name,
            "inputs": record.inputs,
            "counts": record.counts,
            "warnings": record.notices.as_records(),
            "register_version": row["register_version"],
        }
    found: dict[str, object] = {"file": path.name, "layers": layer_names(path), "stages": stages}
    if parts := named_parts(path):
        found["skeletons"] = {
            "folder": parts_folder(path).name,
            "parts": len(parts),
            "bytes": sum(part.bytes for part in parts.values()),
            "missing_or_changed": sorted(
                name for name, part in parts.items() if not part.is_in(parts_folder(path))
            ),
        }  # fmt: skip
    return found


def _json(path: Path) -> dict[str, object] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError("not readable as JSON", where=path, found=in_words(error)) from error
    record = content.get("provenance") if isinstance(content, dict) else None
    return {"file": path.name, **record} if isinstance(record, dict) else None


def _picture(path: Path) -> dict[str, object] | None:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            text = image.info.get("urbanforest")
    except (UnidentifiedImageError, OSError) as error:
        raise InputError("not readable as a picture", where=path, found=str(error)) from error
    return _within(path, text) if text else None


def _page(path: Path) -> dict[str, object] | None:
    marker = '<script type="application/json" id="urbanforest-provenance">'
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError("the file cannot be read", where=path, found=in_words(error)) from error
    _, is_there, rest = text.partition(marker)
    return _within(path, rest.partition("</script>")[0]) if is_there else None


def _within(path: Path, text: str) -> dict[str, object]:
    """Return the provenance that a picture or a page carries as JSON."""
    try:
        record = json.loads(text)
    except (ValueError, RecursionError, TypeError) as error:
        raise InputError("its provenance is torn", where=path, found=in_words(error)) from error
    if not isinstance(record, dict):
        raise InputError("its provenance is torn", where=path, found=kind_of(record), expected=kind_of({}))
    return {"file": path.name, **record}


Reader = Callable[[Path], Mapping[str, object] | None]
BY_NAME: dict[str, Reader] = {
    ".gpkg": _of_geopackage,
    ".parquet": _of_parquet,
    ".glb": _of_gltf,
    ".city.json": _of_cityjson,
    ".city.jsonl": _of_cityjson,
    ".tif": _of_raster,
    ".csv": _of_inventory,
    "tileset.json": _of_tiles,
    "placements.csv": _of_library,
    MANIFEST: _of_manifest,
    ".geojson": _json,
    ".json": _json,
    ".png": _picture,
    ".html": _page,
}
"""How each kind of file tells of itself, by the end of its name, the longest first."""
FOLDERS = ("tileset.json", "placements.csv", REGISTER)
"""What tells of a folder that holds it, the first that does."""
