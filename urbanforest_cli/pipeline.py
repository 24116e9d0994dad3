"""The stages in order: what is up to date, what to do again, and everything published at the end.

Work is done on a copy of the register in a hidden folder beside the outputs. A run that is stopped leaves the old
outputs as they were and that folder, from which the next run goes on.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.context.stage import diffuse_key, diffuse_parameters
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import EXIT_BAD_INPUT, InputError, OutputExistsError, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import strategy_names
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import folder_lock, output_error
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.formats.stage import CITY_OUTPUTS, export_city
from urbanforest_cli.export.stage import export_key
from urbanforest_cli.files.geopackage import refuse_foreign, refuse_sidecars, row_count
from urbanforest_cli.files.painted import is_painting, read_painting
from urbanforest_cli.files.parameter_models import ParameterModel, load_parameter_model
from urbanforest_cli.files.skeleton_parts import link_parts, remove_strays
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.files.vectors import list_vector_layers
from urbanforest_cli.growth.stage import grow_key, grow_plants, grown_key, show_year
from urbanforest_cli.pipeline_folder import (
    REGISTER,
    WORK_FOLDER,
    bring_manifest,
    clear,
    exports_fresh,
    publish_all,
    records_of,
    remembered,
    skeletons_whole,
    summary_of,
    year_shown,
)
from urbanforest_cli.pipeline_image import (
    COVERAGE,
    Mapping,
    grid_of,
    is_recorded,
    map_record,
    mapping_of,
    refuse_apart,
    refuse_foreign_map,
)
from urbanforest_cli.placement.stage import place_key, place_plants
from urbanforest_cli.register.stage import refuse_too_many_bad, stencil_city, stencil_key
from urbanforest_cli.regression.model_fit import refuse_other_version
from urbanforest_cli.regression.stage import regress_key, regress_register

STAGES = ("cover", "stencil", "regress", "diffuse", "place", "grow", "export")


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
    images: tuple[Path, ...] = ()
    coverage: Path | None = None
    coverage_model: Path | None = None
    parameter_model: Path | None = None
    sketch: Path | None = None
    keep_observed: bool = False

    @property
    def stages(self) -> tuple[str, ...]:
        """Return the stages that it takes, up to the last wanted: images are mapped, and maps read, where given."""
        mapped = bool(self.images) or self.coverage is not None
        without = {"cover"} if not self.images else set()
        without |= {"regress"} if not mapped else set()
        return tuple(stage for stage in STAGES[: STAGES.index(self.until) + 1] if stage not in without)


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
    mapping = _look(request)
    with folder_lock(request.out):
        summaries = _run(request, mapping, progress)
    for summary in summaries:
        if summary.stage == "stencil":
            refuse_too_many_bad(summary, request.max_bad_fraction, request.city)
    return summaries


def plan(request: Request) -> list[dict[str, object]]:
    """Tell what `populate` would do, without doing it."""
    mapping = _look(request)
    keys = stage_keys(request, mapping, _map_there(request, mapping))
    done = _stages_done(request.out / REGISTER, keys, request)
    exported = len(done) == len(_register_stages(request)) and exports_fresh(request.out, keys["export"])
    kept = {*done, *(["cover"] if keys.get("stencil") else []), *(["export"] if exported else [])}
    return [{"stage": stage, "would": "keep" if stage in kept else "run"} for stage in request.stages]


def stage_keys(request: Request, mapping: Mapping | None = None, coverage: Path | None = None) -> dict[str, str]:
    """Return for each stage the hash of all that decides its result.

    Parameters
    ----------
    mapping
        Of the images, where there are any.
    coverage
        The map, where it is there; nothing is done after it where it is not.
    """
    config, seed = request.config, request.seed
    catalogue = load_catalogue(config.species)
    keys = {"cover": mapping.key} if mapping is not None else {}
    if mapping is not None and coverage is None:
        return keys | dict.fromkeys(request.stages[1:], "")
    before = stencil_key(
        request.city,
        config=config,
        seed=seed,
        assume_crs=request.assume_crs,
        lots_layer=request.lots_layer,
        coverage=coverage,
        sketch=request.sketch,
        sketch_grid=_sketch_grid(request, mapping),
        keep_observed=request.keep_observed,
    )
    keys["stencil"] = before
    if "regress" in request.stages:
        model = _parameter_model(request)
        before = keys["regress"] = regress_key(before, config=config, seed=seed, model_sha256=model.sha256)
    diffuse = diffuse_key(before, config=config, seed=seed)
    place = place_key(diffuse, config=config, seed=seed, catalogue=catalogue)
    grow = grow_key(place, config=config, seed=seed, catalogue=catalogue)
    export = export_key(f"{grow} {request.year}", config=config, seed=seed)
    return keys | {"diffuse": diffuse, "place": place, "grow": grow, "export": export}


def _look(request: Request) -> Mapping | None:
    """Refuse what cannot be used before anything slow is done; return how the images are to be mapped."""
    _check(request)
    grid = None
    if request.coverage is not None:
        grid = grid_of(request.coverage, request.assume_crs)
        refuse_apart(request.city, request.lots_layer, request.assume_crs, grid, "map", request.coverage)
    if not request.images:
        return None
    mapping = mapping_of(
        request.images, request.coverage_model, request.city, request.lots_layer, request.assume_crs
    )  # fmt: skip
    if request.sketch is not None and is_painting(request.sketch):
        read_painting(request.sketch, like=mapping.grid, assume_crs=request.assume_crs, notices=Notices())
    elif request.sketch is not None:
        list_vector_layers(request.sketch)
    if "regress" in request.stages:
        _parameter_model(request)
    return mapping


def _parameter_model(request: Request) -> ParameterModel:
    """Return the model that `regress` will use, which must be one of this version."""
    model = load_parameter_model(request.parameter_model)
    refuse_other_version(model.info, model.path)
    return model


def _sketch_grid(request: Request, mapping: Mapping | None) -> RasterGrid | None:
    """Return the place of a painted sketch that has none of its own: that of the image it was painted over."""
    return mapping.grid if mapping is not None else None


def _map_there(request: Request, mapping: Mapping | None) -> Path | None:
    """Return the map in force: the user's, else one of these images that is there whole, of an unfinished run first."""
    if mapping is None:
        return request.coverage
    unfinished, published = request.out / WORK_FOLDER / COVERAGE, request.out / COVERAGE
    if mapping.is_made(unfinished):
        return unfinished
    records = records_of(request.out / REGISTER)
    changed = "cover" in records and not is_recorded(records["cover"], mapping, published)
    return published if mapping.is_made(published) and not changed else None


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
    if request.images:
        refuse_foreign_map(request.out / COVERAGE)


def _register_stages(request: Request) -> tuple[str, ...]:
    return tuple(stage for stage in request.stages if stage not in ("cover", "export"))


def _stages_done(register: Path, keys: dict[str, str], request: Request) -> list[str]:
    """Return the first stages that a register holds the wanted result of."""
    records = records_of(register) if register.exists() else {}
    done = []
    for stage in _register_stages(request):
        if stage not in records:
            break
        key = grown_key(records[stage]) if stage == "grow" else records[stage].stage_key
        if key != keys[stage]:
            break
        if stage == "place" and row_count(register, "plants") != records[stage].counts.get("plants"):
            break  # changed by somebody else since
        if stage == "grow" and not skeletons_whole(register, records[stage]):
            break
        done.append(stage)
    return done


def _run(request: Request, mapping: Mapping | None, progress: Progress) -> list[StageSummary]:
    wanted = _register_stages(request)
    published = request.out / REGISTER
    work = request.out / WORK_FOLDER
    coverage = _map_there(request, mapping)
    keys = stage_keys(request, mapping, coverage)
    done = _stages_done(published, keys, request)
    whole = len(done) == len(wanted) and ("grow" not in wanted or year_shown(published, request.year))
    if mapping is not None:
        whole &= coverage == request.out / COVERAGE
    if whole and (request.until != "export" or exports_fresh(request.out, keys["export"])):
        shutil.rmtree(work, ignore_errors=True)
        remove_strays(published)
        kept = _kept_map(request, mapping, progress) | remembered(published, wanted)
        if request.until == "export":
            kept["export"] = StageSummary("export", request.out, up_to_date=True)
        return list(kept.values())

    try:
        covered = {}
        if mapping is not None:
            covered = _cover(request, mapping, coverage, progress)
            coverage = _map_there(request, mapping)
            keys = stage_keys(request, mapping, coverage)
        if wanted:
            register = _work_register(work, published, keys, request, mapping)
            covered |= _run_stages(request, keys, register, mapping, coverage, covered, progress)
        publish_all(work, request.out, request.until, mapped=mapping is not None)
    except UrbanForestError as error:
        if error.exit_code == EXIT_BAD_INPUT:  # the same command would fail again: nothing to go on from
            clear(work, mapping)
        raise
    finally:
        if not (work / REGISTER).exists():
            clear(work, mapping)
    return list(covered.values())


def _cover(request: Request, mapping: Mapping, coverage: Path | None, progress: Progress) -> dict[str, StageSummary]:
    """Map the images, unless their map is there."""
    if coverage is not None:
        return _kept_map(request, mapping, progress)
    work = request.out / WORK_FOLDER
    try:
        work.mkdir(exist_ok=True)
    except OSError as error:
        raise output_error(work, error) from error
    summary = mapping.make(work / COVERAGE, request.workers, progress)
    summary.output = request.out / COVERAGE
    return {"cover": summary}


def _kept_map(request: Request, mapping: Mapping | None, progress: Progress) -> dict[str, StageSummary]:
    """Return what is remembered of a map that is there, or else seen by looking through it."""
    there = _map_there(request, mapping)
    if mapping is None or there is None:
        return {}
    for register in (request.out / REGISTER, request.out / WORK_FOLDER / REGISTER):
        record = (records_of(register) if register.exists() else {}).get("cover")
        if record is not None and is_recorded(record, mapping, there):
            return {"cover": summary_of(record, request.out / COVERAGE)}
    summary = mapping.make(there, request.workers, progress)
    summary.output = request.out / COVERAGE
    return {"cover": summary}


def _run_stages(
    request: Request,
    keys: dict[str, str],
    register: Path,
    mapping: Mapping | None,
    coverage: Path | None,
    covered: dict[str, StageSummary],
    progress: Progress,
) -> dict[str, StageSummary]:
    """Run on the working register all stages that its records do not show as done, and the exports beside it."""
    wanted = _register_stages(request)
    published = request.out / REGISTER
    done = _stages_done(register, keys, request)
    summaries = remembered(register, tuple(done), shown=published)
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
            coverage=coverage,
            sketch=request.sketch,
            sketch_grid=_sketch_grid(request, mapping),
            keep_observed=request.keep_observed,
            progress=progress,
        ),
        "regress": lambda: regress_register(
            register,
            model=request.parameter_model,
            config=request.config,
            seed=request.seed,
            workers=request.workers,
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
        if stage == "stencil" and mapping is not None and coverage is not None and "cover" not in records_of(register):
            map_record(register, mapping, covered["cover"], coverage, request.seed)
    if "grow" in wanted and not year_shown(register, request.year):
        summaries["grow"] = show_year(register, request.year)
        summaries["grow"].output = published
    if request.until == "export":
        bring_manifest(request.out, register.parent)
        summaries["export"] = export_city(
            register,
            register.parent,
            config=request.config,
            seed=request.seed,
            key=keys["export"],
            published=request.out,
            summaries=[summary.as_record() for summary in (covered | summaries).values()],
            workers=request.workers,
            progress=progress,
        )
        summaries["export"].output = request.out
    return summaries


def _work_register(
    work: Path, published: Path, keys: dict[str, str], request: Request, mapping: Mapping | None
) -> Path:
    """Return the register to work on: an unfinished one, a copy of the published one, or a fresh start."""
    register = work / REGISTER
    try:
        work.mkdir(exist_ok=True)
        unfinished = len(_stages_done(register, keys, request))
        kept = _stages_done(published, keys, request)
        if unfinished == 0 or len(kept) > unfinished:
            clear(work, mapping)
            work.mkdir(exist_ok=True)
            if kept:
                shutil.copyfile(published, register)
            if "grow" in kept:
                link_parts(published, register)
    except OSError as error:
        raise output_error(work, error) from error
    return register
