"""Export: from a register and its skeletons to the formats that other programs open."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from typing import Any

from urbanforest_cli.core.boxes import Bounds
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.scenery import Scenery
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.scene.buildings import build_buildings
from urbanforest_cli.export.scene.canopy import canopy_rasters
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.scene.ground import build_ground
from urbanforest_cli.export.scene.models import build_scenery
from urbanforest_cli.export.scene.pieces import Piece
from urbanforest_cli.export.scene.prototypes import Prototypes, choose_prototypes
from urbanforest_cli.export.scene.stage import read_city
from urbanforest_cli.export.scene.tables import inventory_table, plant_table, species_categories
from urbanforest_cli.export.scene.tiling import tile_scene
from urbanforest_cli.export.stage import (
    GEOJSON,
    MAP,
    OUTPUTS,
    PAGE,
    REPORT,
    VIEW,
    export_outputs,
    provenance_of,
    write_plants_geojson,
)
from urbanforest_cli.export.view.stage import view_city
from urbanforest_cli.files.canopy import write_canopy
from urbanforest_cli.files.cityjson import write_cityjson
from urbanforest_cli.files.describe import is_output
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.gltf import write_glb
from urbanforest_cli.files.itree import write_itree
from urbanforest_cli.files.manifest import Export, describe_files, is_intact, read_manifest, record_exports
from urbanforest_cli.files.obj import write_species_library
from urbanforest_cli.files.plant_tables import write_plants_gpkg, write_plants_parquet
from urbanforest_cli.files.provenance import require_record, stage_key
from urbanforest_cli.files.tiles3d import write_tiles

STAGE = "export"
CITY_STEPS = 3
TOLD = ("shapes", "outline_error_median", "outline_error_worst_tenth")
TILE_DETAILS = {"point": 1, "billboard": 60, "low": 120}
"""Details of far tiles from coarse to fine, and the most shapes of each."""
CANOPY_COVER = "canopy_cover.tif"
FOREST = "forest.glb"
CITY_OUTPUTS = {
    FOREST: "glb", VIEW: "render", GEOJSON: "geojson", MAP: "map", PAGE: "report", REPORT: "report",
}  # fmt: skip
"""What `populate` writes beside the register, and the format of each."""


@dataclass(frozen=True)
class Wanted:
    """What is to be written, beside what the config says.

    Parameters
    ----------
    bbox
        West, south, east, north in the register's CRS; the whole city if None.
    plain
        glTF without extensions.
    with_surroundings
        Buildings, lots and roads too.
    cell_m
        Of canopy rasters.
    ground_height_m
        Of 3D Tiles, above the ellipsoid of WGS 84.
    """

    bbox: Bounds | None = None
    plain: bool = False
    with_surroundings: bool = True
    cell_m: float = 1.0
    ground_height_m: float = 0.0


@dataclass(frozen=True)
class Format:
    """A format.

    Parameters
    ----------
    name
        Of its file or folder.
    detail, prototypes_max
        How much of plants is drawn, and how many shapes are stored, where nothing else is asked for.
    suffixes
        That a file of another name may have.
    holds
        Of a folder: what it always holds, then patterns of what else may be in it.
    companion
        What the name of a file that belongs to it ends in more.
    second
        Name of a second file.
    """

    name: str
    write: Callable[[Job, Path], None]
    detail: str = ""
    prototypes_max: int = 0
    suffixes: tuple[str, ...] = ()
    holds: tuple[str, ...] = ()
    companion: str = ""
    second: str = ""

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return bool(self.holds)


@dataclass
class Job:
    """One run of `export`: what is read once, whatever the number of formats."""

    register: Path
    config: Config
    seed: int
    wanted: Wanted
    workers: int
    progress: Progress
    notices: Notices = field(default_factory=Notices)
    counts: dict[str, int | float | str] = field(default_factory=dict)
    name: str = ""
    detail: str = ""
    prototypes_max: int = 0
    key: str = ""
    chosen: dict[int, Prototypes] = field(default_factory=dict)
    shown: dict[str, int | float] = field(default_factory=dict)

    @cached_property
    def city(self) -> City:
        """The plants and what stands around them."""
        return read_city(self.register, config=self.config, bbox=self.wanted.bbox)

    @cached_property
    def pieces(self) -> list[Piece]:
        """Buildings and ground, none where they are not wanted."""
        if not self.wanted.with_surroundings:
            return []
        self.tell_of_heights()
        built = build_buildings(self.city)
        self.notices.add("W_BUILDING_SHAPE", "buildings without an area, left out", built.left_out)
        return [*build_ground(self.city), *built.pieces]

    def tell_of_heights(self) -> None:
        """Count the buildings that are drawn as high as the config says."""
        height = self.config.growth.building_height_m
        self.notices.add(
            "W_BUILDING_HEIGHT",
            f"buildings without a height, drawn {height:g} m high",
            self.city.unknown_height_count,
        )

    @property
    def provenance(self) -> dict[str, Any]:
        """What goes into each file."""
        made = provenance_of(self.register, plants=len(self.city.plants), key=self.key)
        return {**made, "format": self.name, **self.options}

    @property
    def options(self) -> dict[str, Any]:
        """What was asked for, as the manifest keeps it."""
        shown = {"detail": self.detail, "prototypes_max": self.prototypes_max, "season": self.config.export.season}
        return (shown if self.detail else {}) | (
            {"bbox": list(self.wanted.bbox)} if self.wanted.bbox is not None else {}
        )

    def prototypes(self, most: int) -> Prototypes:
        """Choose the shapes that a file stores, once for each number, and tell how far plants are from their own."""
        city, count = self.city, most
        if count not in self.chosen:
            self.chosen[count] = choose_prototypes(city.plants, city.skeletons_of, city.season_end, count_max=count)
        found = self.chosen[count]
        self.shown = {"shapes": len(found.skeleton_id)} | {
            name: round(value, 4) for name, value in found.summary().items()
        }
        self.counts |= {name: self.shown[name] for name in TOLD}
        return found

    def scenery(self, detail: str, *, most: int | None = None, bare: bool = False) -> Scenery:
        """Put the scene together at a detail, of `most` shapes if given; `bare` leaves out what is not a plant."""
        chosen = self.prototypes(most or self.prototypes_max)
        return build_scenery(
            self.city,
            chosen,
            detail=detail,
            season=self.config.export.season,
            pieces=() if bare else self.pieces,
            provenance=self.provenance | {"prototypes": self.shown},
        )

    def write(self, name: str, target: Path, key: str) -> None:
        """Write one format, at its own detail where the config names none."""
        form, asked = FORMATS[name], self.config.export
        self.name = name
        self.detail = (asked.detail or form.detail) if form.detail else ""
        self.prototypes_max = (asked.prototypes_max or form.prototypes_max) if form.detail else 0
        self.key = key
        form.write(self, target)

    def zones(self) -> dict[str, str]:
        """Return the zone of each lot."""
        lots = read_layer(self.register, "lots", geometry=False, columns=["lot_id", "zone"])
        return dict(zip(lots["lot_id"], lots["zone"], strict=True))


def _glb(job: Job, path: Path) -> None:
    write_glb(path, job.scenery(job.detail), plain=job.wanted.plain)


def _tiles(job: Job, path: Path) -> None:
    coarser = list(TILE_DETAILS)
    coarser = coarser[: coarser.index(job.detail)] if job.detail in coarser else coarser
    sceneries = {
        detail: job.scenery(detail, most=min(TILE_DETAILS[detail], job.prototypes_max), bare=True) for detail in coarser
    }
    scene = tile_scene(sceneries | {job.detail: job.scenery(job.detail)}, ground_height_m=job.wanted.ground_height_m)
    written = write_tiles(path, scene, provenance=job.provenance)
    job.counts |= {"tiles": written.tiles, "shared_models": written.shared_models}


def _cityjson(job: Job, path: Path) -> None:
    city = job.city
    if job.wanted.with_surroundings:
        job.tell_of_heights()
    buildings = (city.local_shapes(city.buildings), city.building_height_m, city.building_id)
    footprints, heights, ids = buildings if job.wanted.with_surroundings else (None, None, None)
    scenery = job.scenery(job.detail, bare=True)
    write_cityjson(
        path, scenery, title=city.name, footprints=footprints, building_height_m=heights, building_id=ids
    )  # fmt: skip


def _obj(job: Job, path: Path) -> None:
    if job.detail == "point":
        raise InputError("points have no shapes to write as OBJ", where="--detail", next_step="choose another detail")
    write_species_library(path, job.scenery(job.detail, bare=True), crs=job.city.register_crs)


def _geojson(job: Job, path: Path) -> None:
    write_plants_geojson(job.register, path, key=job.key, bbox=job.wanted.bbox)


def _gpkg(job: Job, path: Path) -> None:
    city = job.city
    write_plants_gpkg(
        path, plant_table(city), categories=species_categories(city), provenance=job.provenance
    )  # fmt: skip


def _geoparquet(job: Job, path: Path) -> None:
    write_plants_parquet(path, plant_table(job.city), provenance=job.provenance)


def _itree(job: Job, path: Path) -> None:
    write_itree(path, inventory_table(job.city, zones=job.zones()), provenance=job.provenance)


def _canopy(job: Job, path: Path) -> None:
    canopy = canopy_rasters(job.city, cell_m=job.wanted.cell_m)
    place: dict[str, Any] = {
        "west_m": canopy.west_m, "north_m": canopy.north_m, "cell_m": canopy.cell_m, "crs": job.city.crs,
        "provenance": job.provenance,
    }  # fmt: skip
    write_canopy(path, canopy.top_m, "height", **place)
    write_canopy(path.with_name(CANOPY_COVER), canopy.cover_percent, "cover", **place)


FORMATS: dict[str, Format] = {
    "glb": Format("forest.glb", _glb, "medium", 300, suffixes=(".glb",)),
    "3dtiles": Format("tiles", _tiles, "medium", 300, holds=("tileset.json", "subtrees", "content", "models")),
    "cityjson": Format("forest.city.json", _cityjson, "low", 200, suffixes=(".city.json", ".city.jsonl")),
    "obj": Format("species", _obj, "medium", 80, holds=("placements.csv", "*.obj", "*.mtl", "*.png", "*.json")),
    "geojson": Format("plants.geojson", _geojson, suffixes=(".geojson",)),
    "gpkg": Format("plants.gpkg", _gpkg, suffixes=(".gpkg",)),
    "geoparquet": Format("plants.parquet", _geoparquet, suffixes=(".parquet",)),
    "itree": Format("itree.csv", _itree, suffixes=(".csv",), companion="-metadata.json"),
    "canopy": Format("canopy_height.tif", _canopy, suffixes=(".tif",), second=CANOPY_COVER),
}


def export_formats(
    register: Path,
    formats: Sequence[str],
    *,
    config: Config,
    seed: int,
    wanted: Wanted | None = None,
    path: Path | None = None,
    workers: int = 1,
    progress: Progress = silent,
) -> list[StageSummary]:
    """Write a planted city in some formats beside its register, and name them in exports.json.

    Parameters
    ----------
    register
        Where `grow` has run.
    formats
        Names of `FORMATS`.
    path
        File or folder to write a single format to; its own name beside the register if None.

    Returns
    -------
    One summary a format, which is its stage.

    Raises
    ------
    SchemaError, StaleError
        The register has not grown its plants; the text names the command.
    InputError
        Nothing lies in the box.
    OutputExistsError
        Something else bears the output's name.
    OutputError
        A file could not be written whole.
    """
    if path is not None and (two := [name for name in formats if FORMATS[name].second]):
        raise InputError(
            f"{two[0]} writes two files", where="-o", next_step="leave -o out: they go beside the register"
        )
    job = Job(register, config, seed, wanted or Wanted(), workers, progress)
    growth = require_record(register, "grow").stage_key
    folder = register.parent
    for name in formats:
        _refuse_in_the_way(path or folder / FORMATS[name].name, name, register)
    summaries = []
    for name in formats:
        started = time.perf_counter()
        form = FORMATS[name]
        key = format_key(name, growth, config=config, seed=seed, wanted=job.wanted)
        target = path or folder / form.name
        job.notices, job.counts = Notices(), {}
        progress(f"{STAGE} {name}", 0, 1)
        _tell_of_parts(job, target)
        job.write(name, target, key)
        files = describe_files(target, *([target.with_name(target.name + form.companion)] if form.companion else []))
        found = {target.name: files}
        if form.second:
            found[form.second] = describe_files(folder / form.second)
        if target.parent.resolve() == folder.resolve():
            record_exports(folder, [Export(item, name, key, growth, job.options, its) for item, its in found.items()])
        progress(f"{STAGE} {name}", 1, 1)
        size = sum(state.bytes for its in found.values() for state in its.values())
        counts: dict[str, int | float | str] = {"plants": len(job.city.plants), "bytes": size, **job.counts}
        summaries.append(StageSummary(name, target, counts, job.notices, time.perf_counter() - started))
    return summaries


def _tell_of_parts(job: Job, target: Path) -> None:
    """Count a warning where an output of the whole city gives way to one of a part."""
    before = read_manifest(job.register.parent).get(target.name)
    if job.wanted.bbox is not None and before is not None and "bbox" not in before.options:
        job.notices.add(
            "W_PART", "outputs of the whole city replaced by a part of it (-o names another)", 1, [target.name]
        )


def export_city(
    register: Path,
    out: Path,
    *,
    config: Config,
    seed: int,
    key: str,
    published: Path | None = None,
    summaries: Sequence[Mapping[str, Any]] = (),
    workers: int = 1,
    progress: Progress = silent,
) -> StageSummary:
    """Write what `populate` writes of a planted city: forest.glb, view.png, the plants, the map and the report.

    What a user had written otherwise under one of these names, by `export` or `render`, stays as long as it shows the
    growth in force and is as it was written.

    Parameters
    ----------
    out
        Folder to write to, with the manifest of what is published.
    key, summaries
        As `export_outputs` takes them.
    published
        Folder where earlier outputs lie; `out` if None.

    Raises
    ------
    SchemaError, StaleError
        The register has not grown its plants.
    OutputError
        A file could not be written whole.
    """
    started = time.perf_counter()
    growth = require_record(register, "grow").stage_key
    job = Job(register, config, seed, Wanted(), workers, progress)
    kept = _kept_by_user(published or out, growth)
    progress(STAGE, 0, CITY_STEPS)
    if FOREST not in kept:
        job.write("glb", out / FOREST, key)
    options = {FOREST: job.options}
    progress(STAGE, 1, CITY_STEPS)
    if not len(job.city.plants):
        job.notices.add("W_NO_VIEW", f"{VIEW} not drawn, since no plant stands", 1)
    elif VIEW not in kept:
        size = (config.export.view_width_px, config.export.view_height_px)
        job.name = "render"
        view_city(
            job.city, out / VIEW, size_px=size, season=config.export.season, provenance=job.provenance,
            workers=workers, progress=progress,
        )  # fmt: skip
    progress(STAGE, 2, CITY_STEPS)
    beside = [name for name in (FOREST, VIEW) if (out / name).is_file()]
    flat = export_outputs(register, out, config=config, summaries=summaries, beside=beside, kept=kept, key=key)
    progress(STAGE, CITY_STEPS, CITY_STEPS)
    job.notices.merge(flat.notices)
    written = [*beside, *(name for name in OUTPUTS if name not in kept)]
    told = {"of": sorted({*written, *kept}), "export": config.export.model_dump(mode="json", exclude_none=True)}
    record_exports(
        out,
        [
            Export(name, CITY_OUTPUTS[name], key, growth, options.get(name, {}) | told, describe_files(out / name))
            for name in written
        ],
        remove=set(CITY_OUTPUTS) - set(told["of"]),
    )
    counts: dict[str, int | float | str] = {**flat.counts, **job.counts, "files": len(written)}
    return StageSummary(STAGE, out, counts, job.notices, time.perf_counter() - started)


def _kept_by_user(published: Path, growth: str) -> list[str]:
    """Return which of the city's outputs `export` or `render` wrote last, of this growth, and nothing changed since."""
    exports = read_manifest(published)
    own = [exports[name] for name in CITY_OUTPUTS if name in exports and "of" not in exports[name].options]
    return [export.name for export in own if export.growth == growth and is_intact(published, export)]


def city_outputs(exports: Mapping[str, Export], key: str) -> list[Export]:
    """Return what one run of `export_city` wrote and kept; nothing where some of it is gone, or has another key."""
    report = exports.get(REPORT)
    names = report.options.get("of") if report is not None else None
    if report is None or report.key != key or not isinstance(names, list):
        return []
    found = [exports[name] for name in names if name in exports]
    fresh = [
        item for item in found
        if item.key == key or ("of" not in item.options and item.growth == report.growth)
    ]  # fmt: skip
    return fresh if len(fresh) == len(names) else []


def format_key(name: str, growth: str, *, config: Config, seed: int, wanted: Wanted) -> str:
    """Return the hash of all that decides one format's content."""
    return stage_key(
        f"export {name}", config=config, seed=seed, inputs=[growth, repr(wanted)], sections=("export", "species")
    )


def _refuse_in_the_way(target: Path, name: str, register: Path) -> None:
    """Refuse to replace anything but an earlier output of the same format, and names that say another format."""
    form = FORMATS[name]
    if form.suffixes and not target.name.casefold().endswith(form.suffixes):
        raise InputError(
            "the output's name says another format",
            where=target,
            expected=f"a name that ends in {' or '.join(form.suffixes)}",
            next_step="name another with -o",
        )
    for path in (target, *([target.with_name(form.second)] if form.second else [])):
        if path.exists():
            _refuse_foreign_output(path, name, register)


def _refuse_foreign_output(target: Path, name: str, register: Path) -> None:
    form = FORMATS[name]
    if target.is_dir() != form.is_folder:
        raise OutputExistsError(
            "the output is a folder" if target.is_dir() else "the output is a file",
            where=target,
            expected="a folder" if form.is_folder else "a file",
            next_step="name another with -o",
        )
    if form.is_folder:
        held = sorted(item.name for item in target.iterdir())
        strange = [item for item in held if not any(fnmatch(item, pattern) for pattern in form.holds)]
        if held and (strange or form.holds[0] not in held):
            raise OutputExistsError(
                "the folder holds other things, which would be lost",
                where=target,
                found=", ".join((strange or held)[:5]),
                expected=f"an empty folder, or an earlier output with {form.holds[0]}",
                next_step="name another with -o",
            )
    elif not is_output(target, name, register.parent):
        raise OutputExistsError(
            "the file is no earlier output of this format, and would be lost",
            where=target,
            next_step="name another with -o, or remove it first",
        )
