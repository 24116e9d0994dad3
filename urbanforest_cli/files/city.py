"""A city's file: its lots, what stands on them, and the plants that are known."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import geopandas as gpd

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.files.vector_formats import SHAPEFILE, vector_format
from urbanforest_cli.files.vectors import list_vector_layers, read_vector

LOTS = "lots"
OBSERVED = "observed_plants"
KINDS = {
    "buildings": ("polygon",),
    "roads": ("line", "polygon"),
    "driveways": ("polygon", "line"),
    "entrances": ("point", "line"),
    "obstacles": ("point", "line", "polygon"),
    "sketches": ("polygon",),
}
"""Layers that a city may have beside its lots, and what they hold."""
PLACE_SUFFIXES = (".tfw", ".tifw", ".pgw", ".pngw", ".wld", ".prj")
SIDECARS = (".shx", ".dbf", ".prj", ".cpg")


def city_inputs(city: Path) -> list[dict[str, str]]:
    """Return names and hashes of the files that a city consists of."""
    form = vector_format(city)
    if city.is_dir():
        files = sorted(item for item in city.iterdir() if item.is_file())
    elif form is SHAPEFILE:
        files = [city, *(side for suffix in SIDECARS if (side := city.with_suffix(suffix)).is_file())]
    else:
        files = [city, *(side for side in [city.with_name(city.name + "-wal")] if side.is_file())]
    return [{"name": item.name, "sha256": sha256_of(item)} for item in files]


def inputs_beside(path: Path) -> list[dict[str, str]]:
    """Return names and hashes of a map or a sketch: the file, and what stands beside it and belongs to it.

    Raises
    ------
    InputError
        There is no such file.
    """
    if not path.is_file():
        raise InputError("no such file", where=path, next_step="check the name of the map or the sketch")
    beside = [path.with_name(path.name + ending) for ending in (".aux.xml", "-wal")]
    beside += [path.with_suffix(suffix) for suffix in dict.fromkeys((*PLACE_SUFFIXES, *SIDECARS))]
    files = [path, *(side for side in beside if side.is_file() and side != path)]
    return [{"name": item.name, "sha256": sha256_of(item)} for item in files]


def read_city(
    city: Path, assume_crs: str | None, lots_layer: str | None, notices: Notices
) -> tuple[gpd.GeoDataFrame, dict[str, gpd.GeoDataFrame]]:
    """Read a city's layers; those that it has beside its lots only if they bear their names."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whoever reads the layer counts what is said of it
        kinds_of = {name: kind for name, kind in list_vector_layers(city) if kind is not None}
    names = list(kinds_of)
    plain = {name.casefold(): name for name in reversed(names)}
    if {"lots", "active_areas"} <= set(names):
        raise InputError(
            "this is a register, an output of this program",
            where=city,
            expected="a city: lots and what stands on them",
            next_step="name the city it was made from",
        )
    others = [name for name, kind in kinds_of.items() if name.casefold() not in KINDS and "polygon" in kind.lower()]
    if lots_layer is None and (LOTS in plain or len(others) == 1):
        lots_layer = plain[LOTS] if LOTS in plain else others[0]
    if lots_layer is None and names and not set(names) - set(KINDS):
        raise InputError(
            "no layer 'lots'", where=city, found=", ".join(names), next_step="name the layer of lots with --layer"
        )
    frame = read_vector(city, layer=lots_layer, assume_crs=assume_crs, notices=notices)
    layers = {}
    for name, kinds in KINDS.items():
        if name in plain and plain[name] != lots_layer and len(names) > 1:
            found = read_vector(
                city, layer=plain[name], kinds=kinds, assume_crs=assume_crs or frame.crs, notices=notices,
                where_hint=f"{city} layer {name!r}",
            )  # fmt: skip
            if len(found):
                layers[name] = found
    return frame, layers


def read_known_plants(city: Path, crs: Any, notices: Notices) -> gpd.GeoDataFrame:
    """Read the plants that are to be kept.

    Raises
    ------
    InputError
        The city has no such layer.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = {name.casefold(): name for name, _ in list_vector_layers(city)}
    if OBSERVED not in names:
        raise InputError(
            f"no layer {OBSERVED!r}, so there are no known plants to keep",
            where=city,
            found=", ".join(names.values()),
            next_step="add the layer, or leave --keep-observed away",
        )
    return read_vector(
        city, layer=names[OBSERVED], kinds=("point",), assume_crs=crs, notices=notices,
        where_hint=f"{city} layer {OBSERVED!r}",
    )  # fmt: skip
