"""The stages in order: what is up to date, what to do again, and everything published at the end.

Work is done on a copy of the register in a hidden folder beside the outputs. A run that is stopped leaves the old
outputs as they were and that folder, from which the next run goes on.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.context.stage import diffuse_key, diffuse_parameters
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import EXIT_BAD_INPUT, InputError, OutputExistsError, UrbanForestError
from urbanforest_cli.core.params import strategy_names
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import folder_lock, output_error, sync_file, sync_folder
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.formats.stage import CITY_OUTPUTS, city_outputs, export_city
from urbanforest_cli.export.stage import export_key
from urbanforest_cli.files.geopackage import refuse_foreign, refuse_sidecars, row_count
from urbanforest_cli.files.manifest import MANIFEST, is_intact, read_manifest
from urbanforest_cli.files.provenance import Record, read_records
from urbanforest_cli.files.skeleton_parts import link_parts, move_parts, parts_are_there, parts_folder, remove_strays
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.stage import grow_key, grow_plants, grown_key, show_year, shows_year
from urbanforest_cli.placement.stage import place_key, place_plants
from urbanforest_cli.register.stage import refuse_too_many_bad, stencil_city, stencil_key

STAGES = ("stencil", "diffuse", "place", "grow", "export")
REGISTER = "register.gpkg"
WORK_FOLDER = ".urbanforest-work"


@dataclass(frozen=True)
class Request:
    """What a user asked for."""

    city: Path
    out: Path
    config: Config
    seed: int
    until: str = "export"
    workers: int = 1
    assume_crs: str | None = None
    lots_layer: str | None = None
    max_bad_fraction: float | None = None
    year: int | None = None


def default_out(city: Path) -> Path:
    """Return the folder that `populate` writes to where none is named: beside the city, named after it."""
    return city.parent / f"{city.stem}-forest"


def populate(request: Request, *, progress: Progress = silent) -> list[StageSummary]:
    """Fill a city with plants and write what people open.

    Stages whose inputs, config, seed and version are those of an earlier run are not run again; of a stage that is,
    only the lots that changed are placed again.

    Returns
    -------
    One summary a stage.

    Raises
    ------
    UrbanForestError
        As the stages say; the outputs of the run before stay as they were.
    PartlyDoneError
        Everything was written, but more lots were unusable than allowed.
    BusyError
        Another run holds the folder.
    """
    _check(request)
    keys = stage_keys(request)
    with folder_lock(request.out):
        summaries = _run(request, keys, progress)
    stencil = next(summary for summary in summaries if summary.stage == "stencil")
    refuse_too_many_bad(stencil, request.max_bad_fraction, request.city)
    return summaries


def plan(request: Request) -> list[dict[str, object]]:
    """Tell what `populate` would do, without doing it."""
    _check(request)
    keys = stage_keys(request)
    done = _stages_done(request.out / REGISTER, keys, request.until)
    fresh = len(done) == len(_register_stages(request.until))
    exported = fresh and _exports_fresh(request.out, keys["export"])
    wanted = STAGES[: STAGES.index(request.until) + 1]
    return [
        {"stage": stage, "would": "keep" if stage in done or (stage == "export" and exported) else "run"}
        for stage in wanted
    ]


def stage_keys(request: Request) -> dict[str, str]:
    """Return for each stage the hash of all that decides its result."""
    catalogue = load_catalogue(request.config.species)
    stencil = stencil_key(
        request.city,
        config=request.config,
        seed=request.seed,
        assume_crs=request.assume_crs,
        lots_layer=request.lots_layer,
    )
    diffuse = diffuse_key(stencil, config=request.config, seed=request.seed)
    place = place_key(diffuse, config=request.config, seed=request.seed, catalogue=catalogue)
    grow = grow_key(place, config=request.config, seed=request.seed, catalogue=catalogue)
    return {
        "stencil": stencil,
        "diffuse": diffuse,
        "place": place,
        "grow": grow,
        "export": export_key(f"{grow} {request.year}", config=request.config, seed=request.seed),
    }


def _check(request: Request) -> None:
    if request.until not in STAGES:
        raise InputError(f"no stage {request.until!r}", expected=", ".join(STAGES))
    out, city = request.out.resolve(), request.city.resolve()
    if out == city:
        raise OutputExistsError("the output is the input itself", where=request.out, next_step="name another with -o")
    if out == city.parent:
        raise OutputExistsError(
            "the output folder is the input's own folder",
            where=request.out,
            next_step="name a folder of its own with -o",
        )
    if out.exists() and not out.is_dir():
        raise OutputExistsError("the output is not a folder", where=request.out, next_step="name another with -o")
    register = request.out / REGISTER
    if register.exists():
        refuse_foreign(register, older_too=False)
        refuse_sidecars(register)
    elif out.is_dir() and (taken := [name for name in (REGISTER, *CITY_OUTPUTS) if (out / name).exists()]):
        raise OutputExistsError(
            f"the folder holds {', '.join(taken)}, but no register of urbanforest",
            where=request.out,
            next_step="name another folder with -o",
        )


def _register_stages(until: str) -> tuple[str, ...]:
    return STAGES[: min(STAGES.index(until) + 1, STAGES.index("export"))]


def _stages_done(register: Path, keys: dict[str, str], until: str) -> list[str]:
    """Return the first stages that a register holds the wanted result of."""
    if not register.exists():
        return []
    try:
        records = read_records(register)
    except UrbanForestError:  # a half-written or foreign copy in the work folder: begin again
        return []
    done = []
    for stage in _register_stages(until):
        if stage not in records:
            break
        key = grown_key(records[stage]) if stage == "grow" else records[stage].stage_key
        if key != keys[stage]:
            break
        if stage == "place" and row_count(register, "plants") != records[stage].counts.get("plants"):
            break  # changed by somebody else since
        if stage == "grow" and not _skeletons_whole(register, records[stage]):
            break
        done.append(stage)
    return done


def _year_shown(register: Path, year: int | None) -> bool:
    return shows_year(read_records(register)["grow"], year)


def _skeletons_whole(register: Path, record: Record) -> bool:
    """Tell whether what a register says of its skeletons still holds."""
    counted = row_count(register, "trees") == record.counts.get("plants")
    return counted and row_count(register, "groves") == record.counts.get("groves") and parts_are_there(register)


def _run(request: Request, keys: dict[str, str], progress: Progress) -> list[StageSummary]:
    wanted = _register_stages(request.until)
    published = request.out / REGISTER
    done = _stages_done(published, keys, request.until)
    work = request.out / WORK_FOLDER
    whole = len(done) == len(wanted) and ("grow" not in wanted or _year_shown(published, request.year))
    if whole and (request.until != "export" or _exports_fresh(request.out, keys["export"])):
        shutil.rmtree(work, ignore_errors=True)
        remove_strays(published)
        kept = _kept(published, wanted)
        if request.until == "export":
            kept["export"] = StageSummary("export", request.out, up_to_date=True)
        return list(kept.values())

    register = _work_register(work, published, keys, request.until)
    try:
        summaries = _run_stages(request, keys, register, progress)
        _publish_all(work, request.out, request.until)
    except UrbanForestError as error:
        if error.exit_code == EXIT_BAD_INPUT:  # the same command would fail again: nothing to go on from
            shutil.rmtree(work, ignore_errors=True)
        raise
    finally:
        if not register.exists():
            shutil.rmtree(work, ignore_errors=True)
    return summaries


def _run_stages(request: Request, keys: dict[str, str], register: Path, progress: Progress) -> list[StageSummary]:
    """Run on the working register all stages that its records do not show as done, and the exports beside it."""
    wanted = _register_stages(request.until)
    published = request.out / REGISTER
    done = _stages_done(register, keys, request.until)
    summaries = _kept(register, tuple(done), shown=published)
    steps: dict[str, Callable[[], StageSummary]] = {
        "stencil": lambda: stencil_city(
            request.city,
            register,
            config=request.config,
            seed=request.seed,
            workers=request.workers,
            assume_crs=request.assume_crs,
            lots_layer=request.lots_layer,
            known_strategies=strategy_names(),
            progress=progress,
        ),
        "diffuse": lambda: diffuse_parameters(register, config=request.config, seed=request.seed, progress=progress),
        "place": lambda: place_plants(
            register,
            config=request.config,
            seed=request.seed,
            workers=request.workers,
            previous=published if published.exists() else None,
            progress=progress,
        ),
        "grow": lambda: grow_plants(
            register,
            config=request.config,
            seed=request.seed,
            workers=request.workers,
            previous=published,
            progress=progress,
        ),
    }
    for stage in wanted:
        if stage not in summaries:
            summary = steps[stage]()
            summary.output = published
            summaries[stage] = summary
    if "grow" in wanted and not _year_shown(register, request.year):
        summaries["grow"] = show_year(register, request.year)
        summaries["grow"].output = published
    if request.until == "export":
        _bring_manifest(request.out, register.parent)
        summaries["export"] = export_city(
            register,
            register.parent,
            config=request.config,
            seed=request.seed,
            key=keys["export"],
            published=request.out,
            summaries=[summary.as_record() for summary in summaries.values()],
            workers=request.workers,
            progress=progress,
        )
        summaries["export"].output = request.out
    return list(summaries.values())


def _work_register(work: Path, published: Path, keys: dict[str, str], until: str) -> Path:
    """Return the register to work on: an unfinished one, a copy of the published one, or a fresh start."""
    register = work / REGISTER
    try:
        work.mkdir(exist_ok=True)
        unfinished = len(_stages_done(register, keys, until))
        kept = _stages_done(published, keys, until)
        if unfinished == 0 or len(kept) > unfinished:
            shutil.rmtree(work)
            work.mkdir()
            if kept:
                shutil.copyfile(published, register)
            if "grow" in kept:
                link_parts(published, register)
    except OSError as error:
        raise output_error(work, error) from error
    return register


def _kept(register: Path, stages: tuple[str, ...], shown: Path | None = None) -> dict[str, StageSummary]:
    records = read_records(register) if stages else {}
    return {stage: _summary_of(records[stage], shown or register) for stage in stages}


def _summary_of(record: Record, output: Path) -> StageSummary:
    counts = {str(name): value for name, value in record.counts.items() if isinstance(value, int | float | str)}
    return StageSummary(record.stage, output, counts, record.notices, up_to_date=True)


def _exports_fresh(out: Path, key: str) -> bool:
    """Tell whether every output is there, unchanged since it was written for this key."""
    written = city_outputs(read_manifest(out), key)
    return bool(written) and all(is_intact(out, export) for export in written)


def _bring_manifest(out: Path, work: Path) -> None:
    """Take along what the manifest says of outputs that this run does not write."""
    try:
        if (out / MANIFEST).is_file():
            shutil.copyfile(out / MANIFEST, work / MANIFEST)
    except OSError as error:
        raise output_error(work, error) from error


def _publish_all(work: Path, out: Path, until: str) -> None:
    """Move all that is ready into place: skeletons before the register that names them, those it names no longer after.

    The manifest is last: it vouches for the others by their hashes.
    """
    names = [REGISTER, *CITY_OUTPUTS, MANIFEST] if until == "export" else [REGISTER]
    try:
        there = [name for name in names if (work / name).exists()]
        for name in there:
            sync_file(work / name)
        move_parts(work / REGISTER, parts_folder(out / REGISTER))
        for name in there:
            os.replace(work / name, out / name)
        for name in set(CITY_OUTPUTS) - set(read_manifest(out)) if until == "export" else ():
            (out / name).unlink(missing_ok=True)  # what this city has no more
        sync_folder(out)
        remove_strays(out / REGISTER)
        shutil.rmtree(work)
    except OSError as error:
        raise output_error(out, error) from error
