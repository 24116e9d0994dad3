"""Hold every output of a folder against the register in it."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import rasterio
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import RasterioError

from urbanforest_cli.core.boxes import Bounds, in_box
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import BusyError, InputError, UrbanForestError
from urbanforest_cli.core.placed import COLUMNS, PlacedPlants, standing, stated_columns
from urbanforest_cli.files import cityjson_reader, geojson, gltf_reader, itree, obj, plant_tables, tiles3d_reader
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.geopackage import layer_names, read_layer, refuse_foreign
from urbanforest_cli.files.manifest import MANIFEST, TORN, Export, faults_of, manifest_faults, read_manifest
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.files.register_check import geopackage_faults, part_faults, register_faults, skeleton_faults
from urbanforest_cli.files.skeleton_parts import parts_folder
from urbanforest_cli.files.words import in_words
from urbanforest_cli.verification import verdicts as found
from urbanforest_cli.verification.compare import Comparison, Expected, compare, named
from urbanforest_cli.verification.verdicts import Verdict

REGISTER = "register.gpkg"
CELLS_PER_CROWN = 2.0
AROUND = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)], dtype=np.float64)
READ_ERRORS = (UrbanForestError, OSError, ValueError, sqlite3.Error, RasterioError)


def verify_outputs(out: Path, files: Iterable[Path] = ()) -> list[Verdict]:
    """Hold outputs against the register: those of the manifest, and those found under the names they usually have.

    No run writes to the folder meanwhile; others may verify it.

    Parameters
    ----------
    out
        Folder with a register.gpkg, or the register itself.
    files
        Only these, in the folder or elsewhere.

    Returns
    -------
    The register first, where no files were named, then the others by name.

    Raises
    ------
    InputError
        There is no register, or no such file.
    BusyError
        A run is writing to the folder.
    """
    register = out / REGISTER if out.is_dir() else out
    _refuse_unreadable(register)
    with _undisturbed(register.parent):
        held = _Held(register, read_manifest(register.parent))
        asked = [held.find(path) for path in files]
        verdict, truth = _judge_register(register, held.recorded.get(register.name))
        held.truth = truth
        if asked:
            return [verdict if path.samefile(register) else _judge_asked(path, held) for path in asked]
        there = _names_in(held.folder)
        names = sorted((there | set(held.recorded)) - {register.name})
        others = [_judge(held.folder / name, held) for name in names]
        manifest = _judge_manifest(held.folder, unnamed=there - set(held.recorded))
        return [verdict, *others, *([manifest] if manifest.faults else [])]


def _refuse_unreadable(register: Path) -> None:
    """Refuse what is no register, or damaged so that it does not even say so."""
    try:
        refuse_foreign(register)
    except (ValueError, sqlite3.Error) as error:
        raise InputError(
            "the register cannot be read",
            where=register,
            found=in_words(error),
            next_step="make it again with `urbanforest populate`",
        ) from error


@contextlib.contextmanager
def _undisturbed(folder: Path) -> Iterator[None]:
    """Hold a folder so that no run writes to it, by the lock that those take; others may read it at the same time.

    Raises
    ------
    BusyError
        A run is writing to it.
    """
    with contextlib.ExitStack() as held:
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            held.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BusyError(
                "a run is writing here, so outputs are not all of one kind yet",
                where=folder,
                next_step="wait for it to end, then verify again",
            ) from error
        except OSError:  # a folder or a file system that knows no locks; nothing of it is to be written anyway
            pass
        yield


@dataclass(frozen=True)
class Truth:
    """What the register says.

    Parameters
    ----------
    placed
        Every plant, heights of those that stand.
    stands
        (n,) which of them stand.
    crown_radius_m
        (n,), 0 where nothing stands.
    register_xy
        (n, 2) as the register has them, for boxes that exports were cut to.
    growth
        Stage key of what is shown; empty where nothing has grown.
    is_planted
        Whether plants were placed, be it none.
    """

    placed: Expected
    stands: NDArray[np.bool_]
    crown_radius_m: NDArray[np.float64]
    register_xy: NDArray[np.float64]
    growth: str
    is_planted: bool = True

    def rows(self, *, dead_too: bool, bbox: Bounds | None) -> NDArray[np.int64]:
        """Return the rows that an output should hold."""
        wanted = np.ones(len(self.placed), dtype=bool) if dead_too else self.stands.copy()
        if bbox is not None:
            wanted &= in_box(self.register_xy, bbox)
        return np.flatnonzero(wanted)


@dataclass
class _Held:
    """A folder of outputs while it is looked at: what its manifest and its register say.

    `truth` is None where the register cannot be read.
    """

    register: Path
    recorded: Mapping[str, Export]
    truth: Truth | None = None

    @property
    def folder(self) -> Path:
        """Where the outputs lie."""
        return self.register.parent

    def find(self, path: Path) -> Path:
        """Return where a file that was asked for lies, or should."""
        for place in (path, self.folder / path):
            if place.exists():
                return place
        if str(path) in self.recorded:
            return self.folder / path
        raise InputError("no such output", where=path, found=f"neither there nor in {self.folder}")

    def within(self, path: Path) -> Path | None:
        """Return a file's path from the folder; None for one that lies elsewhere."""
        place = path.parent.resolve() / path.name
        return place.relative_to(self.folder.resolve()) if place.is_relative_to(self.folder.resolve()) else None


def _judge_register(register: Path, export: Export | None) -> tuple[Verdict, Truth | None]:
    """Check the register in itself and return what it says; None where it cannot be read."""
    verdict = Verdict(register.name, found.REGISTER, found.SAME, recorded=export is not None)
    faults: list[str] = []
    try:
        faults += faults_of(register.parent, export) if export is not None else []
        faults += register_faults(register)
        truth = read_truth(register)
    except READ_ERRORS as error:
        return replace(verdict, state=found.UNREADABLE, faults=tuple(faults or [_told(error)])), None
    sound = found.SAME if truth.growth else found.NOT_GROWN if truth.is_planted else found.NOT_PLANTED
    return (
        replace(
            verdict, state=found.DIFFERS if faults else sound, plants=len(truth.placed), faults=tuple(faults)
        ),
        truth,
    )  # fmt: skip


def read_truth(register: Path) -> Truth:
    """Read what a register says of its plants; none where none were placed yet.

    Raises
    ------
    InputError, SchemaError
        Layers are missing or at odds.
    """
    records = read_records(register)
    if "place" not in records:
        return _nothing(next(record.working_crs for record in records.values()))
    working = records["place"].working_crs
    plants = read_layer(register, "plants")
    grown = records.get("grow")
    trees = read_layer(register, "trees") if grown is not None and "trees" in layer_names(register) else None
    if trees is not None:
        if trees["plant_id"].tolist() != plants["plant_id"].tolist():
            raise InputError("layers 'plants' and 'trees' hold other plants", where=register)
        if not np.array_equal(_xy(trees), _xy(plants)):
            raise InputError("layers 'plants' and 'trees' hold plants in other places", where=register)
        if trees["species"].tolist() != plants["species"].tolist():
            raise InputError("layers 'plants' and 'trees' hold plants of other species", where=register)
        assert grown is not None, "trees are read where they have grown"
        if {"name": "place", "sha256": records["place"].stage_key} not in grown.inputs:
            raise InputError("layer 'trees' grew from other plants than those placed last", where=register)
        born = (trees["reason"] != "unborn").to_numpy()
        plants, trees = plants[born], trees[born]
    stands = np.zeros(len(plants), dtype=bool) if trees is None else standing(trees)
    known = plants if trees is None else trees
    return Truth(
        placed=Expected(
            plant_id=plants["plant_id"].to_numpy(dtype=object),
            xy_m=reproject_xy(_xy(plants), CRS.from_user_input(plants.crs), working),
            height_m=np.where(stands, _numbers(trees, "height_m", len(plants)), np.nan),
            crs=working,
            columns=stated_columns({name: known[name] for name in COLUMNS if name in known}),
        ),
        stands=stands,
        crown_radius_m=np.where(stands, _numbers(trees, "crown_radius_m", len(plants)), 0.0),
        register_xy=_xy(plants),
        growth=grown.stage_key if grown is not None else "",
    )


def _nothing(working: CRS) -> Truth:
    """Return what a register without plants says."""
    none, nowhere = np.zeros(0), np.zeros((0, 2))
    placed = Expected(np.zeros(0, dtype=object), nowhere, none, working)
    return Truth(placed, none.astype(bool), none, nowhere, growth="", is_planted=False)


def _xy(frame: Any) -> NDArray[np.float64]:
    return np.asarray(shapely.get_coordinates(frame.geometry.to_numpy()))


def _numbers(trees: pd.DataFrame | None, column: str, count: int) -> NDArray[np.float64]:
    return np.full(count, np.nan) if trees is None else np.asarray(trees[column], dtype=np.float64)


@dataclass(frozen=True)
class _Kind:
    """What is known of a kind of output.

    Parameters
    ----------
    format
        As ``urbanforest export --to`` calls it.
    read
        Reads its plants.
    dead_too
        Whether it holds plants that do not stand as well.
    on_ground
        Whether it states heights of feet, which are 0; not where plants are drawn as points.
    """

    format: str
    read: Callable[[Path], PlacedPlants]
    dead_too: bool = False
    on_ground: bool = False


KINDS: Mapping[str, _Kind] = {
    ".glb": _Kind("glb", gltf_reader.read_plants, on_ground=True),
    ".city.json": _Kind("cityjson", cityjson_reader.read_plants, on_ground=True),
    ".city.jsonl": _Kind("cityjson", cityjson_reader.read_plants, on_ground=True),
    ".geojson": _Kind("geojson", geojson.read_plants, dead_too=True),
    ".gpkg": _Kind("gpkg", plant_tables.read_gpkg_plants),
    ".parquet": _Kind("geoparquet", plant_tables.read_parquet_plants),
    ".csv": _Kind("itree", itree.read_plants),
    "tileset.json": _Kind("3dtiles", tiles3d_reader.read_plants, on_ground=True),
    "placements.csv": _Kind("obj", lambda path: obj.read_plants(path.parent), on_ground=True),
}
"""By the end of the file's name; a folder is what the file of that name in it is."""
FOLDERS = ("tileset.json", "placements.csv")
CANOPY = (".tif", ".tiff")
DESCRIPTION = "-metadata.json"
"""What the name of a table's description ends in more; reading the table holds it against that."""
USUAL = (
    "forest.glb", "tiles", "forest.city.json", "plants.geojson", "plants.gpkg", "plants.parquet", "itree.csv",
    "species", "canopy_height.tif", "canopy_cover.tif",
)  # fmt: skip
WITHOUT_PLANTS = {
    "view.png": found.OF_POPULATE, "map.png": found.OF_POPULATE, "report.html": found.OF_POPULATE,
    "report.json": found.OF_POPULATE, "street.png": found.OF_RENDER, "top.png": found.OF_RENDER,
}  # fmt: skip
"""Names of pictures and pages, and what writes them."""
PATTERNS = ("*.glb", "*.city.json", "*.city.jsonl")
INSIDE = {"tiles": ("tileset.json", "content", "subtrees"), "species": ("placements.csv", "species.mtl")}
"""What a folder must hold, and what tells that it held that."""


def _names_in(folder: Path) -> set[str]:
    """Return the names of all that looks like an output of this program."""
    there = {name for name in (*USUAL, *WITHOUT_PLANTS) if (folder / name).exists()}
    there -= {name for name in INSIDE if not any((folder / name / item).exists() for item in INSIDE[name])}
    others = {path.name for pattern in PATTERNS for path in folder.glob(pattern)}
    return there | others | {path.name for path in folder.glob("*.png") if _provenance(path)}


def _kind_of(path: Path) -> tuple[_Kind, Path] | None:
    """Return what an output is and the file to read; None for what holds no plants."""
    if path.is_dir():
        inside = next((path / name for name in FOLDERS if (path / name).is_file()), None)
        return (KINDS[inside.name], inside) if inside else None
    ends = sorted((end for end in KINDS if path.name.casefold().endswith(end)), key=len)
    return (KINDS[ends[-1]], path) if ends else None


def _format_of(path: Path, kind: tuple[_Kind, Path] | None) -> str:
    """Return the format of an output that the manifest does not name."""
    if kind is not None:
        return kind[0].format
    if path.suffix.casefold() in CANOPY:
        return "canopy"
    unnamed = found.OF_RENDER if path.suffix.casefold() == ".png" and _provenance(path) else ""
    return WITHOUT_PLANTS.get(path.name, unnamed) or path.suffix.removeprefix(".")


def _provenance(path: Path) -> dict[str, Any]:
    """Return what an output says of how it was made; empty where it says nothing that can be read."""
    try:
        return describe_output(path)
    except READ_ERRORS:
        return {}


@dataclass(frozen=True)
class _Asked:
    """How an output was asked for: as the manifest says, or the output itself where that does not name it.

    Parameters
    ----------
    growth
        Stage key of the growth shown, empty for plants that had not grown; None where nothing tells.
    bbox
        What it was cut to, as it is stated.
    as_points
        Whether each plant is a point in its crown.
    """

    growth: str | None
    bbox: object
    as_points: bool

    @classmethod
    def of(cls, path: Path, export: Export | None) -> _Asked:
        """Read it."""
        if export is not None:
            return cls(export.growth or None, export.options.get("bbox"), export.options.get("detail") == "point")
        record = _provenance(path)
        stages = record.get("stage_keys")
        growth = str(stages.get("grow", "")) if isinstance(stages, dict) else None
        return cls(growth, record.get("bbox"), record.get("detail") == "point")

    def box(self) -> Bounds | None:
        """Return the box; raise ValueError where it is none."""
        if self.bbox is None:
            return None
        sides = self.bbox if isinstance(self.bbox, list) else []
        if len(sides) != 4 or not all(type(side) in (int, float) and math.isfinite(side) for side in sides):
            raise ValueError("the box that it says it was cut to is not four numbers")
        west, south, east, north = map(float, sides)
        return west, south, east, north


def _judge_manifest(folder: Path, unnamed: Collection[str] = ()) -> Verdict:
    """Check the list of outputs; that there is none, or that it was torn, is a fault where it leaves outputs out."""
    verdict = Verdict(MANIFEST, found.MANIFEST, found.INTACT)
    if (folder / MANIFEST).exists():
        faults = manifest_faults(folder)
        if unnamed and (folder / TORN).exists():
            faults.append(f"it was torn once, and no longer names {', '.join(sorted(unnamed))}; {TORN} is what it was")
        return replace(verdict, state=found.CHANGED, faults=tuple(faults)) if faults else verdict
    if not unnamed:
        return verdict
    fault = f"{MANIFEST} is missing: nothing tells how the files here were written, so a change of them is not seen"
    return replace(verdict, state=found.MISSING, faults=(fault,))


def _judge_asked(path: Path, held: _Held) -> Verdict:
    """Judge what was asked for by name: what cannot be checked is a fault."""
    table = path.with_name(path.name.removesuffix(DESCRIPTION))
    if table != path and table.is_file() and held.within(path) is None:
        path = table
    within = held.within(path)
    parts = parts_folder(held.register).name
    if within is not None:
        name = within.as_posix()
        if name == MANIFEST:
            return _judge_manifest(held.folder)
        if within.parts[0] == parts and len(within.parts) <= 2:
            return _judge_skeletons(path, name, held)
        owner = next(
            (export for export in held.recorded.values() if name in export.files and name != export.name), None
        )
        if owner is not None and within.name in FOLDERS:
            path = held.folder / owner.name
        elif owner is not None:
            return _judge_one_of(owner, name, held)
    verdict = _judge(path, held)
    if verdict.faults or verdict.state != found.UNCHECKED:
        return verdict
    is_known = path.name in WITHOUT_PLANTS or _provenance(path)
    why = f"{MANIFEST} does not name it, and it holds no plants to compare" if is_known else "no output of urbanforest"
    return replace(verdict, faults=(f"cannot be checked: {why}",))


def _judge_skeletons(path: Path, name: str, held: _Held) -> Verdict:
    """Judge the folder of skeletons, or one part in it, by the hashes in the register."""
    verdict = Verdict(name, found.SKELETONS, found.INTACT)
    try:
        faults = skeleton_faults(held.register) if path.is_dir() else part_faults(held.register, path)
    except READ_ERRORS as error:
        return replace(verdict, state=found.UNREADABLE, faults=(_told(error),))
    return replace(verdict, state=found.CHANGED if faults else found.INTACT, faults=tuple(faults))


def _judge_one_of(owner: Export, name: str, held: _Held) -> Verdict:
    """Judge one file of an output that has several, by its hash."""
    faults = tuple(faults_of(held.folder, replace(owner, name=name, files={name: owner.files[name]})))
    return Verdict(name, owner.format, found.CHANGED if faults else found.INTACT, faults=faults)


def _judge(path: Path, held: _Held) -> Verdict:
    """Judge an output: whether it is as it was written, shows this growth, and says what the register says."""
    within = held.within(path)
    is_inside = within is not None and len(within.parts) == 1
    export = held.recorded.get(path.name) if is_inside else None
    kind = _kind_of(path)
    asked = _Asked.of(path, export)
    verdict = Verdict(
        name=path.name if is_inside else str(path),
        format=export.format if export else _format_of(path, kind),
        state=found.INTACT if export else found.UNCHECKED,
        recorded=export is not None,
        is_part=asked.bbox is not None,
    )
    changes = faults_of(held.folder, export) if export is not None else []
    if stale := _stale_faults(asked, kind, path, held.truth):
        return replace(verdict, state=found.STALE, faults=(*changes, *stale))
    if kind is None and path.name in INSIDE and path.is_dir() and not changes:
        changes.append(f"{path.name}/{INSIDE[path.name][0]} is missing")
    if held.truth is not None and path.exists():
        verdict = _compare(verdict, path, kind, held.truth, asked)
    return replace(verdict, state=found.CHANGED if changes else verdict.state, faults=(*changes, *verdict.faults))


def _stale_faults(asked: _Asked, kind: tuple[_Kind, Path] | None, path: Path, truth: Truth | None) -> list[str]:
    """Tell that an output shows another growth than the register; then there is nothing to compare."""
    if truth is None or (asked.growth is None and not path.exists()):
        return []
    grew = asked.growth or (asked.growth is None and _needs_growth(kind, path))
    if not truth.growth and grew:
        state = "its plants have not grown" if truth.is_planted else "no plants were placed"
        return [f"shows plants that grew, and the register says that {state}"]
    if asked.growth is not None and asked.growth != truth.growth:
        return ["shows another growth than the register" if asked.growth else "shows the plants before they grew"]
    return []


def _needs_growth(kind: tuple[_Kind, Path] | None, path: Path) -> bool:
    return path.suffix.casefold() in CANOPY if kind is None else not kind[0].dead_too


def _compare(
    verdict: Verdict, path: Path, kind: tuple[_Kind, Path] | None, truth: Truth, asked: _Asked
) -> Verdict:  # fmt: skip
    """Compare what an output says with the register."""
    try:
        box = asked.box()
        if path.suffix.casefold() in CANOPY:
            faults = _canopy_faults(path, truth, box)
            return replace(verdict, state=found.DIFFERS if faults else found.SAME, faults=tuple(faults))
        if kind is None:
            return verdict
        reader, file = kind
        faults = geopackage_faults(file) if file.suffix == ".gpkg" else []
        compared = _compare_plants(reader, reader.read(file), truth, box, as_points=asked.as_points)
    except READ_ERRORS as error:
        return replace(verdict, state=found.UNREADABLE, faults=(_told(error),))
    return replace(
        verdict,
        state=found.DIFFERS if faults or compared.faults else found.SAME,
        plants=compared.plants,
        largest_distance_m=compared.largest_distance_m,
        faults=(*faults, *compared.faults),
    )


def _compare_plants(
    reader: _Kind, stated: PlacedPlants, truth: Truth, box: Bounds | None, *, as_points: bool
) -> Comparison:
    """Compare plants with those that an output of this kind, cut to this box, should hold."""
    rows = truth.rows(dead_too=reader.dead_too, bbox=box)
    compared = compare(
        stated,
        truth.placed.take(rows),
        on_ground=reader.on_ground and not as_points,
        in_crown=reader.on_ground and as_points,
        left_out=np.delete(truth.placed.plant_id, rows),
    )
    if truth.stands[rows].any() and len(stated) and not (stated.height_m > 0).any():
        return replace(compared, faults=(*compared.faults, "states no heights"))
    return compared


def _canopy_faults(path: Path, truth: Truth, bbox: Bounds | None) -> list[str]:
    """Return where a raster has no crown though a plant with a crown of several cells stands there."""
    rows = truth.rows(dead_too=False, bbox=bbox)
    with rasterio.open(path, driver="GTiff") as raster:
        if raster.crs is None:
            return ["has no CRS"]
        xy = reproject_xy(truth.placed.xy_m[rows], truth.placed.crs, CRS.from_wkt(raster.crs.to_wkt()))
        bounds = raster.bounds
        inside = (xy >= (bounds.left, bounds.bottom)).all(axis=1) & (xy < (bounds.right, bounds.top)).all(axis=1)
        faults = named("outside the raster", truth.placed.plant_id[rows[~inside]])
        cell = max(map(abs, raster.res))
        large = inside & (truth.crown_radius_m[rows] >= CELLS_PER_CROWN * cell)
        reach = truth.crown_radius_m[rows[large], None, None] * AROUND / 2
        places = (xy[large, None, :] + reach).reshape(-1, 2)
        values = [value.filled(0)[0] for value in raster.sample(places, indexes=1, masked=True)]
    bare = ~(np.array(values).reshape(-1, len(AROUND)) > 0).any(axis=1)
    return [*faults, *named("without a crown in the raster", truth.placed.plant_id[rows[large][bare]])]


def _told(error: Exception) -> str:
    if isinstance(error, UrbanForestError):
        return error.what + (f": {error.found}" if error.found is not None else "")
    if isinstance(error, RasterioError):
        return f"cannot be read: {error.__cause__ or error}"
    return f"cannot be read: {in_words(error)}"
