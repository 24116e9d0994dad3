"""The folder that `populate` writes to: what is in it, what an unfinished run left, and how all is put into place."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from urbanforest_cli.core.errors import UrbanForestError
from urbanforest_cli.core.publish import output_error, sync_file, sync_folder
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.formats.stage import CITY_OUTPUTS, city_outputs
from urbanforest_cli.files.geopackage import row_count
from urbanforest_cli.files.manifest import MANIFEST, is_intact, read_manifest
from urbanforest_cli.files.provenance import Record, read_records
from urbanforest_cli.files.skeleton_parts import move_parts, parts_are_there, parts_folder, remove_strays
from urbanforest_cli.growth.stage import shows_year
from urbanforest_cli.pipeline_image import COVERAGE, Mapping

REGISTER = "register.gpkg"
WORK_FOLDER = ".urbanforest-work"


def records_of(register: Path) -> dict[str, Record]:
    """Return a register's records by stage; none of one that cannot be read."""
    try:
        return read_records(register)
    except UrbanForestError:  # a half-written or foreign copy in the work folder: begin again
        return {}


def year_shown(register: Path, year: int | None) -> bool:
    """Tell whether a register that has grown shows a year."""
    return shows_year(read_records(register)["grow"], year)


def skeletons_whole(register: Path, record: Record) -> bool:
    """Tell whether what a register says of its skeletons still holds."""
    counted = row_count(register, "trees") == record.counts.get("plants")
    return counted and row_count(register, "groves") == record.counts.get("groves") and parts_are_there(register)


def clear(work: Path, mapping: Mapping | None) -> None:
    """Remove what an unfinished run left, but a map of these images, which took long to make."""
    if mapping is None or not mapping.is_made(work / COVERAGE):
        shutil.rmtree(work, ignore_errors=True)
        return
    for path in work.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != COVERAGE:
            path.unlink(missing_ok=True)


def remembered(register: Path, stages: tuple[str, ...], shown: Path | None = None) -> dict[str, StageSummary]:
    """Return summaries of stages that a register holds the result of; `shown` is what they call it."""
    records = read_records(register) if stages else {}
    return {stage: summary_of(records[stage], shown or register) for stage in stages}


def summary_of(record: Record, output: Path) -> StageSummary:
    """Return the summary of a stage that need not run again."""
    counts = {str(name): value for name, value in record.counts.items() if isinstance(value, int | float | str)}
    return StageSummary(record.stage, output, counts, record.notices, up_to_date=True)


def exports_fresh(out: Path, key: str) -> bool:
    """Tell whether every output is there, unchanged since it was written for this key."""
    written = city_outputs(read_manifest(out), key)
    return bool(written) and all(is_intact(out, export) for export in written)


def bring_manifest(out: Path, work: Path) -> None:
    """Take along what the manifest says of outputs that this run does not write."""
    try:
        if (out / MANIFEST).is_file():
            shutil.copyfile(out / MANIFEST, work / MANIFEST)
    except OSError as error:
        raise output_error(work, error) from error


def publish_all(work: Path, out: Path, until: str, *, mapped: bool) -> None:
    """Move all that is ready into place: skeletons before the register that names them, those it names no longer after.

    The manifest is last: it vouches for the others by their hashes. A map is moved where images were mapped.
    """
    names = [*([COVERAGE] if mapped else []), REGISTER, *([*CITY_OUTPUTS, MANIFEST] if until == "export" else [])]
    try:
        there = [name for name in names if (work / name).exists()]
        for name in there:
            sync_file(work / name)
        if REGISTER in there:
            move_parts(work / REGISTER, parts_folder(out / REGISTER))
        for name in there:
            os.replace(work / name, out / name)
        for name in set(CITY_OUTPUTS) - set(read_manifest(out)) if until == "export" else ():
            (out / name).unlink(missing_ok=True)  # what this city has no more
        sync_folder(out)
        remove_strays(out / REGISTER)
        shutil.rmtree(work, ignore_errors=True)
    except OSError as error:
        raise output_error(out, error) from error
