"""A library of plants as Wavefront OBJ: a file a shape, materials and textures shared, and a table of who stands where.

OBJ says nothing of axes; most programs take y for up, and so do these files: x east, y up, z south, metres, the root
collar at 0 0 0. Blender's importer ("Y up, -Z forward") and QGIS' 3D symbols turn them as they should be. The table
`placements.csv` is in map coordinates: x east, y north, z up; to place a model, mirror it (north to south) where
`mirror` is 1, turn it counter-clockwise by `yaw_deg`, scale it and move it.
"""

from __future__ import annotations

import io
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image
from pyproj import CRS
from pyproj.exceptions import CRSError

from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.placed import PlacedPlants, stated_columns
from urbanforest_cli.core.publish import publish_folder
from urbanforest_cli.core.scenery import Material, Model, Points, Scenery
from urbanforest_cli.files.csvw import read_description, read_table, write_description, write_table
from urbanforest_cli.files.flat_colours import srgb
from urbanforest_cli.files.text_kernel import decimal_rows

TABLE = "placements.csv"
MATERIALS = "species.mtl"
POSITION_DECIMALS, TEXTURE_DECIMALS, NORMAL_DECIMALS = 4, 4, 3
METRE_DECIMALS, DEGREE_DECIMALS = 3, 8
UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")
NAME_MAX = 80
COLUMNS: dict[str, tuple[str, str]] = {
    "plant_id": ("string", "plant"),
    "file": ("string", "its shape; empty where it has none"),
    "x": ("decimal", "easting, or longitude, in the CRS of this table"),
    "y": ("decimal", "northing, or latitude, in the CRS of this table"),
    "z": ("decimal", "metres above the ground of the scene"),
    "longitude": ("decimal", "degrees, WGS 84"),
    "latitude": ("decimal", "degrees, WGS 84"),
    "yaw_deg": ("decimal", "counter-clockwise turn seen from above, in the grid of the working CRS"),
    "scale": ("decimal", "factor on the model's size"),
    "mirror": ("integer", "1 where north and south of the model are exchanged before it is turned"),
    "species": ("string", "species identifier"),
    "height_m": ("decimal", "height in metres"),
}


def write_species_library(path: Path, scenery: Scenery, *, crs: CRS) -> None:
    """Publish a folder of OBJ files, their materials and textures, and the table of placements.

    Files are called by the species of the first plant that has the shape and a number. The provenance is in the
    table's description and in the first lines of each OBJ.

    Parameters
    ----------
    path
        The folder.
    scenery
        Models, materials, instances and their properties; what is fixed is not written.
    crs
        What the table's positions are in: that of the register.

    Raises
    ------
    OutputError
        It could not be written whole.
    """
    species = _column(scenery, "species")
    names = _file_names(scenery, species)
    materials = _unique([_safe(material.name) for material in scenery.materials])

    def verify(part: Path) -> None:
        count = len(read_plants(part))
        if count != len(species):
            raise OutputError("the library was not written whole", where=path, found=f"{count} of {len(species)} rows")

    with publish_folder(path, verify=verify) as folder:
        comment = json.dumps(dict(scenery.provenance), ensure_ascii=True, allow_nan=False)
        head = (
            f"# urbanforest: y up, x east, z south, metres, root at 0 0 0\n# provenance {comment}\nmtllib {MATERIALS}\n"
        )
        for model, name in zip(scenery.models, names, strict=True):
            (folder / name).write_bytes(head.encode() + _obj(model, Path(name).stem, materials))
        _write_materials(folder, scenery.materials, materials)
        decimals = DEGREE_DECIMALS if crs.is_geographic else METRE_DECIMALS
        fixed = {"x": decimals, "y": decimals, "z": METRE_DECIMALS, "longitude": DEGREE_DECIMALS,
                 "latitude": DEGREE_DECIMALS, "yaw_deg": 3, "scale": 6, "height_m": 3, "mirror": 0}  # fmt: skip
        write_table(folder / TABLE, _placements(scenery, names, species, crs), fixed)
        about = {"crs_wkt": crs.to_wkt(), "provenance": dict(scenery.provenance)}
        write_description(folder / TABLE, columns=COLUMNS, about=about, key="plant_id")


def _column(scenery: Scenery, name: str) -> NDArray[np.object_]:
    """Return a column of words, one a plant."""
    column = scenery.properties[name]
    if column.type == "enum":
        return np.asarray(np.array(column.names, dtype=object)[column.values])
    return np.asarray(column.values, dtype=object)


def _file_names(scenery: Scenery, species: NDArray[np.object_]) -> list[str]:
    """Return each model's file name; models without a plant are called by their own name."""
    owner = np.full(len(scenery.models), -1, np.int64)
    rows = np.arange(len(scenery.instances))[::-1]
    owner[scenery.instances.model[::-1]] = rows  # the last one written is the first plant
    words = [_safe(str(species[row])) if row >= 0 else _safe(model.name)
             for row, model in zip(owner, scenery.models, strict=True)]  # fmt: skip
    counts: Counter[str] = Counter()
    names = []
    for word in words:
        counts[word.lower()] += 1
        names.append(f"{word}_{counts[word.lower()]}.obj")
    return _unique(names)


def _safe(name: str) -> str:
    """Return a name that is a file name everywhere, and one word in an OBJ."""
    return UNSAFE.sub("_", name).strip("_")[:NAME_MAX] or "model"


def _unique(names: Sequence[str]) -> list[str]:
    """Return names that differ even where capitals are not told apart."""
    seen: set[str] = set()
    found = []
    for name in names:
        stem, dot, end = name.partition(".")
        number, candidate = 1, name
        while candidate.lower() in seen:
            number += 1
            candidate = f"{stem}_{number}{dot}{end}"
        seen.add(candidate.lower())
        found.append(candidate)
    return found


def _obj(model: Model, name: str, materials: Sequence[str]) -> bytes:
    texts = [f"o {name}\n".encode()]
    first = 1
    for part in model.parts:
        mesh = part.mesh
        texture = np.column_stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]])
        corner = np.repeat(mesh.triangle.astype(np.int64) + first, 3, axis=1)
        texts += [
            decimal_rows(_y_up(mesh.xyz_m), POSITION_DECIMALS, ["v ", " ", " ", "\n"]),
            decimal_rows(texture, TEXTURE_DECIMALS, ["vt ", " ", "\n"]),
            decimal_rows(_y_up(mesh.normal), NORMAL_DECIMALS, ["vn ", " ", " ", "\n"]),
            f"usemtl {materials[part.material]}\n".encode(),
            decimal_rows(corner, 0, ["f ", *["/", "/", " "] * 2, "/", "/", "\n"]),
        ]
        first += len(mesh.xyz_m)
    return b"".join(texts)


def _y_up(xyz: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.column_stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]]).astype(np.float64)


def _write_materials(folder: Path, materials: Sequence[Material], names: Sequence[str]) -> None:
    lines = []
    for material, name in zip(materials, names, strict=True):
        red, green, blue = (f"{value:.4g}" for value in srgb(np.array(material.rgb)))
        lines += [f"newmtl {name}", f"Ka {red} {green} {blue}", f"Kd {red} {green} {blue}", "Ks 0 0 0", "illum 1"]
        if material.texture is not None:
            (folder / f"{name}.png").write_bytes(material.texture)
            lines.append(f"map_Kd {name}.png")
        if material.texture is not None and material.alpha_cutoff is not None:
            (folder / f"{name}_alpha.png").write_bytes(_alpha(material.texture))
            lines.append(f"map_d {name}_alpha.png")
        lines.append("")
    (folder / MATERIALS).write_text("\n".join(lines), encoding="utf-8")


def _alpha(png: bytes) -> bytes:
    """Return a picture's alpha as brightness and as alpha: programs differ in which of them they take for `map_d`."""
    with Image.open(io.BytesIO(png)) as picture:
        alpha = picture.convert("RGBA").getchannel("A")
    stream = io.BytesIO()
    Image.merge("LA", (alpha, alpha)).save(stream, format="png", compress_level=9)
    return stream.getvalue()


def _placements(
    scenery: Scenery, names: Sequence[str], species: NDArray[np.object_], crs: CRS
) -> pd.DataFrame:  # fmt: skip
    some, origin = scenery.instances, scenery.origin
    points = scenery.points or Points(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    bare = len(points)
    local = np.concatenate([some.xyz_m, points.xyz_m])
    working = local[:, :2] + [origin.easting_m, origin.northing_m]
    xy = reproject_xy(working, origin.crs, crs)
    degrees = reproject_xy(working, origin.crs, CRS.from_epsg(4326))
    files = np.array([*names, ""], dtype=object)[np.pad(some.model.astype(np.int64), (0, bare), constant_values=-1)]
    columns = {
        "plant_id": _column(scenery, "plant_id"),
        "file": files,
        "x": xy[:, 0],
        "y": xy[:, 1],
        "z": local[:, 2] + origin.height_m,
        "longitude": degrees[:, 0],
        "latitude": degrees[:, 1],
        "yaw_deg": np.pad(np.degrees(some.yaw_rad) % 360.0, (0, bare)),
        "scale": np.pad(some.scale, (0, bare), constant_values=1.0),
        "mirror": np.pad(some.mirror.astype(np.float64), (0, bare)),
        "species": species,
        "height_m": scenery.properties["height_m"].values.astype(np.float64),
    }
    return pd.DataFrame({name: columns[name] for name in COLUMNS})


def read_plants(path: Path) -> PlacedPlants:
    """Read where a library's table says that plants stand.

    Raises
    ------
    InputError
        The table or a file that it names is not there, or torn.
    """
    table = path / TABLE
    numbers = ("x", "y", "z", "height_m")
    words = ("plant_id", "file", "species")
    columns = read_table(table, {**dict.fromkeys(words, "text"), **dict.fromkeys(numbers, "number")})
    about = read_description(table)
    if about is None:
        raise _wrong(table, "nothing beside it that names its CRS")
    there = {item.name for item in path.iterdir() if item.is_file()} | {""}
    missing = sorted(set(columns["file"].tolist()) - there)
    if missing:
        raise _wrong(table, f"{len(missing)} files that are not there, the first {missing[0]!r}")
    try:
        crs = CRS.from_wkt(about["crs_wkt"])
    except (KeyError, TypeError, CRSError) as error:
        raise _wrong(table, f"its CRS: {error}") from error
    x, y, z, height = (columns[name] for name in numbers)
    return PlacedPlants(
        columns["plant_id"], np.column_stack([x, y, z]), crs, height, stated_columns({"species": columns["species"]})
    )


def read_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made a library from what; None where it does not say.

    Raises
    ------
    InputError
        What describes its table is torn, or belongs to another table.
    """
    about: Mapping[str, Any] | None = read_description(path / TABLE)
    found = about.get("provenance") if about else None
    return found if isinstance(found, dict) else None


def _wrong(path: Path, found: str) -> InputError:
    return InputError(
        "not a library of urbanforest, or not a whole one", where=path, found=found,
        next_step="run `urbanforest export` again",
    )  # fmt: skip
