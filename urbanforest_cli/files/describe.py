"""Where an output comes from, read out of the output itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files import skeletons
from urbanforest_cli.files.geopackage import layer_names, refuse_foreign
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.files.skeleton_parts import named_parts, parts_folder

HEAD_BYTES = 65536


def describe_output(path: Path) -> dict[str, object]:
    """Return the provenance of a file this program wrote.

    Raises
    ------
    InputError
        The file is not there, or carries no provenance of this program.
    """
    if not path.is_file():
        raise InputError("no such file", where=path)
    reader = READERS.get(path.suffix.lower())
    record = reader(path) if reader else None
    if record is None:
        raise InputError(
            "no provenance of urbanforest inside",
            where=path,
            expected="a register, skeletons (.parquet), plants.geojson, report.json, report.html or a picture "
            "written by urbanforest",
        )
    return record


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


def _skeletons(path: Path) -> dict[str, object]:
    return skeletons.describe(path)


def _json(path: Path) -> dict[str, object] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError("not readable as JSON", where=path, found=str(error)) from error
    record = content.get("provenance") if isinstance(content, dict) else None
    return {"file": path.name, **record} if isinstance(record, dict) else None


def _picture(path: Path) -> dict[str, object] | None:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            text = image.info.get("urbanforest")
    except (UnidentifiedImageError, OSError) as error:
        raise InputError("not readable as a picture", where=path, found=str(error)) from error
    return {"file": path.name, **json.loads(text)} if text else None


def _page(path: Path) -> dict[str, object] | None:
    marker = '<script type="application/json" id="urbanforest-provenance">'
    text = path.read_text(encoding="utf-8", errors="replace")
    start = text.find(marker)
    if start < 0:
        return None
    record = json.loads(text[start + len(marker) : text.index("</script>", start)])
    return {"file": path.name, **record}


READERS: dict[str, Callable[[Path], dict[str, object] | None]] = {
    ".gpkg": _register,
    ".parquet": _skeletons,
    ".geojson": _json,
    ".json": _json,
    ".png": _picture,
    ".html": _page,
}
"""How each kind of file tells of itself, by its suffix."""
