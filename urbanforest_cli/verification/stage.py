"""Hold every output of a folder against the register in it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Mapping, Sequence
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

from urbanforest_cli.core.crs import reproject, reproject_xy
from urbanforest_cli.core.errors import InputError, UrbanForestError
from urbanforest_cli.core.placed import PlacedPlants
from urbanforest_cli.files import cityjson_reader, geojson, gltf_reader, itree, obj, plant_tables, tiles3d_reader
from urbanforest_cli.files.geopackage import layer_names, read_layer, refuse_foreign
from urbanforest_cli.files.manifest import Export, faults_of, manifest_faults, read_manifest
from urbanforest_cli.files.provenance import read_records
from urbanforest_cli.files.register_check import geopackage_faults, register_faults
from urbanforest_cli.verification.compare import MM, Expected, compare, counted, named

REGISTER = "register.gpkg"
STANDING = ("unique", "library")
FAULTS_SHOWN = 20
CELLS_PER_CROWN = 2.0
AROUND = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)], dtype=np.float64)
READ_ERRORS = (UrbanForestError, OSError, ValueError, sqlite3.Error, RasterioError)

SAME, STALE, CHANGED, DIFFERS, UNREADABLE = "same", "stale", "changed", "differs", "unreadable"
INTACT = "intact"


@dataclass(frozen=True)
class Verdict:
    """What was found of one output.

    Parameters
    ----------
    name
        In the folder of outputs; as given, for a file elsewhere.
    format
        As ``urbanforest export --to`` calls it, or what the file is.
    state
        same: says what the register says, and is as it was written. intact: holds no plants to compare, is as it was
        written. stale: shows an earlier growth. changed: not as it was written. differs: says other things than the
        register. unreadable.
    plants, largest_distance_m
        None where there are none to count.
    faults
        In words.
    recorded
        Whether the manifest names it, so that a change would have been seen.
    """

    name: str
    format: str
    state: str
    plants: int | None = None
    largest_distance_m: float | None = None
    faults: tuple[str, ...] = ()
    recorded: bool = True

    def as_record(self) -> dict[str, object]:
        """Return it for ``--json``."""
        distance = self.largest_distance_m
        return {
            "name": self.name,
            "format": self.format,
            "state": self.state,
            "plants": self.plants,
            "largest_distance_mm": None if distance is None else round(distance * MM, 3),
            "recorded": self.recorded,
            "faults": list(self.faults),
        }


class DiffersError(UrbanForestError):
    """Outputs are not what the register says, or not as they were written; the text lists all faults."""

    def __init__(self, out: Path, verdicts: Sequence[Verdict]) -> None:
        self.verdicts = tuple(verdicts)
        faults = [f"{verdict.name}: {fault}" for verdict in verdicts for fault in verdict.faults]
        more = [f"and {len(faults) - FAULTS_SHOWN} more"] if len(faults) > FAULTS_SHOWN else []
        super().__init__(
            f"{counted(len(faults), 'fault')} in {counted(sum(bool(v.faults) for v in verdicts), 'output')}",
            where=out,
            found="\n            ".join([*faults[:FAULTS_SHOWN], *more]),
            next_step="write them again with `urbanforest export`, the register with `urbanforest populate`",
        )

    def as_record(self) -> dict[str, object]:
        """Return the verdicts with the error."""
        return super().as_record() | {"outputs": [verdict.as_record() for verdict in self.verdicts]}


def verify_outputs(out: Path, files: Iterable[Path] = ()) -> list[Verdict]:
    """Hold outputs against the register: those of the manifest, and those found under the names they usually have.

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
    """
    register = out / REGISTER if out.is_dir() else out
    refuse_foreign(register)
    folder = register.parent
    asked = [_asked(folder, path) for path in files]
    recorded = read_manifest(folder)
    verdict, truth = _judge_register(register, recorded.get(register.name))
    if asked:
        return [_judge(path, recorded, folder, truth) for path in asked]
    found = {name for name in _usual_names(folder) if (folder / name).exists()}
    names = sorted((found | set(recorded)) - {register.name})
    torn = [Verdict("exports.json", "manifest", CHANGED, faults=tuple(manifest_faults(folder)))]
    return [verdict, *(_judge(folder / name, recorded, folder, truth) for name in names), *filter(_is_faulty, torn)]


def refuse_faults(out: Path, verdicts: Sequence[Verdict]) -> None:
    """Raise where any output has a fault.

    Raises
    ------
    DiffersError
        With all faults.
    """
    if any(map(_is_faulty, verdicts)):
        raise DiffersError(out, verdicts)


def _is_faulty(verdict: Verdict) -> bool:
    return bool(verdict.faults)


def _asked(folder: Path, path: Path) -> Path:
    for place in (path, folder / path):
        if place.exists():
            return place
    raise InputError("no such output", where=path, found=f"neither there nor in {folder}")


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
    register_crs
        For boxes that exports were cut to.
    growth
        Stage key of what is shown.
    """

    placed: Expected
    stands: NDArray[np.bool_]
    crown_radius_m: NDArray[np.float64]
    register_crs: CRS
    growth: str

    def rows(self, *, dead_too: bool, bbox: Any) -> NDArray[np.int64]:
        """Return the rows that an output should hold."""
        wanted = np.ones(len(self.placed), dtype=bool) if dead_too else self.stands.copy()
        if bbox is not None:
            west, south, east, north = map(float, bbox)
            box: NDArray[Any] = np.array([shapely.box(west, south, east, north)], dtype=np.object_)
            wanted &= shapely.contains_xy(reproject(box, self.register_crs, self.placed.crs)[0], self.placed.xy_m)
        return np.flatnonzero(wanted)


def _judge_register(register: Path, export: Export | None) -> tuple[Verdict, Truth | None]:
    """Check the register in itself and return what it says; None where it cannot be read."""
    verdict = Verdict(register.name, "register", SAME, recorded=export is not None)
    faults: list[str] = []
    try:
        faults += _integrity(register.parent, export)
        faults += register_faults(register)
        truth = read_truth(register)
    except READ_ERRORS as error:
        return replace(verdict, state=UNREADABLE, faults=tuple(faults or [_told(error)])), None
    return replace(verdict, state=DIFFERS if faults else SAME, plants=len(truth.placed), faults=tuple(faults)), truth


def read_truth(register: Path) -> Truth:
    """Read what a register says of its plants.

    Raises
    ------
    InputError, SchemaError
        Nothing was planted, or layers are missing or at odds.
    """
    records = read_records(register)
    if "place" not in records:
        raise InputError("nothing was planted", where=register, next_step="run `urbanforest populate`")
    working = records["place"].working_crs
    plants = read_layer(register, "plants")
    grown = records.get("grow")
    trees = read_layer(register, "trees") if grown is not None and "trees" in layer_names(register) else None
    if trees is not None:
        if trees["plant_id"].tolist() != plants["plant_id"].tolist():
            raise InputError("layers 'plants' and 'trees' hold other plants", where=register)
        if not np.array_equal(_xy(trees), _xy(plants)):
            raise InputError("layers 'plants' and 'trees' hold plants in other places", where=register)
        born = (trees["reason"] != "unborn").to_numpy()
        plants, trees = plants[born], trees[born]
    stands = np.zeros(len(plants), dtype=bool) if trees is None else _stands(trees)
    register_crs = CRS.from_user_input(plants.crs)
    return Truth(
        placed=Expected(
            plant_id=plants["plant_id"].to_numpy(dtype=object),
            xy_m=reproject_xy(_xy(plants), register_crs, working),
            height_m=np.where(stands, _numbers(trees, "height_m", len(plants)), np.nan),
            crs=working,
        ),
        stands=stands,
        crown_radius_m=np.where(stands, _numbers(trees, "crown_radius_m", len(plants)), 0.0),
        register_crs=register_crs,
        growth=grown.stage_key if grown is not None else "",
    )


def _stands(trees: pd.DataFrame) -> NDArray[np.bool_]:
    stands = trees["grown"].isin(STANDING) & (trees["height_m"] > 0) & trees["skeleton_id"].notna()
    return np.asarray(stands & trees["reason"].isna(), dtype=bool)


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
USUAL = (
    "forest.glb", "tiles", "forest.city.json", "plants.geojson", "plants.gpkg", "plants.parquet", "itree.csv",
    "species", "canopy_height.tif", "canopy_cover.tif",
)  # fmt: skip


def _usual_names(folder: Path) -> list[str]:
    others = (path.name for pattern in ("*.glb", "*.city.json", "*.city.jsonl") for path in folder.glob(pattern))
    return [*USUAL, *others]


def _kind_of(path: Path) -> tuple[_Kind, Path] | None:
    """Return what an output is and the file to read; None for what holds no plants."""
    if path.is_dir():
        inside = next((path / name for name in FOLDERS if (path / name).is_file()), None)
        return (KINDS[inside.name], inside) if inside else None
    ends = sorted((end for end in KINDS if path.name.casefold().endswith(end)), key=len)
    return (KINDS[ends[-1]], path) if ends else None


def _judge(path: Path, recorded: Mapping[str, Export], folder: Path, truth: Truth | None) -> Verdict:
    inside = path.absolute().parent == folder.absolute()
    export = recorded.get(path.name) if inside else None
    name = path.name if inside else str(path)
    kind = _kind_of(path)
    format_ = export.format if export else kind[0].format if kind else path.suffix.removeprefix(".")
    verdict = Verdict(name, format_, INTACT, recorded=export is not None)
    changes = _integrity(folder, export)
    stale = export is not None and truth is not None and export.growth not in ("", truth.growth)
    if stale:
        changes.append("shows an earlier growth than the register")
    if truth is not None and not stale and path.exists():
        options = export.options if export else {}
        verdict = _compare(verdict, path, kind, truth, options)
    worst = CHANGED if changes and not stale else STALE if stale else verdict.state
    return replace(verdict, state=worst, faults=(*changes, *verdict.faults))


def _integrity(folder: Path, export: Export | None) -> list[str]:
    return faults_of(folder, export) if export is not None else []


def _compare(
    verdict: Verdict, path: Path, kind: tuple[_Kind, Path] | None, truth: Truth, options: Mapping[str, Any]
) -> Verdict:
    """Compare what an output says with the register."""
    try:
        if path.suffix.casefold() in CANOPY:
            faults = _canopy_faults(path, truth, options.get("bbox"))
            return replace(verdict, state=DIFFERS if faults else SAME, faults=tuple(faults))
        if kind is None:
            return verdict
        reader, file = kind
        rows = truth.rows(dead_too=reader.dead_too, bbox=options.get("bbox"))
        as_points = options.get("detail") == "point"
        faults = geopackage_faults(file) if file.suffix == ".gpkg" else []
        found = compare(reader.read(file), truth.placed.take(rows), on_ground=reader.on_ground and not as_points)
    except READ_ERRORS as error:
        return replace(verdict, state=UNREADABLE, faults=(_told(error),))
    return replace(
        verdict,
        state=DIFFERS if faults or found.faults else SAME,
        plants=found.plants,
        largest_distance_m=found.largest_distance_m,
        faults=(*faults, *found.faults),
    )


def _canopy_faults(path: Path, truth: Truth, bbox: Any) -> list[str]:
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
    return f"cannot be read: {error}"
