"""GeoJSON of plants as points (RFC 7946): longitude and latitude, seven decimals, one feature a line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from json.encoder import encode_basestring
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.placed import COLUMNS, PlacedPlants, stated_columns
from urbanforest_cli.core.publish import publish
from urbanforest_cli.files.words import in_words

CHUNK_ROWS = 50_000
FEATURE = '{"type":"Feature","geometry":{"type":"Point","coordinates":[%.7f,%.7f]},"properties":{'
NUMBER_DECIMALS = 3


def write_points(
    path: Path, degrees: NDArray[np.float64], properties: pd.DataFrame, *, members: Mapping[str, object] | None = None
) -> None:
    """Publish points with their properties.

    Numbers are rounded to three decimals (millimetres, thousandths); text may hold anything.

    Parameters
    ----------
    path
        The file to write.
    degrees
        (n, 2) longitude and latitude on WGS 84, all finite.
    properties
        A column a property, n rows.
    members
        Foreign members of the collection, for example its provenance.

    Raises
    ------
    OutputError
        The file could not be written whole.
    """

    def verify(part: Path) -> None:
        count = _feature_lines(part)
        if count != len(degrees):
            raise OutputError(
                "the GeoJSON was not written whole", where=path, found=f"{count} features",
                expected=f"{len(degrees)}", next_step="check the disk, then run the same command again",
            )  # fmt: skip

    with publish(path, verify=verify) as part, part.open("wb") as stream:
        _write_collection(stream, degrees, properties, members or {})


def _write_collection(
    stream: BinaryIO, degrees: NDArray[np.float64], properties: pd.DataFrame, members: Mapping[str, object]
) -> None:
    head: dict[str, object] = {"type": "FeatureCollection"}
    if len(degrees):
        head["bbox"] = bounding_box(degrees)
    head |= members
    text = json.dumps(head, ensure_ascii=False, allow_nan=False)
    stream.write(f'{text[:-1]}, "features": ['.encode("utf-8", "backslashreplace"))
    separator = "\n"
    for start in range(0, len(degrees), CHUNK_ROWS):
        lines = feature_lines(degrees[start : start + CHUNK_ROWS], properties.iloc[start : start + CHUNK_ROWS])
        # A lone surrogate has no UTF-8; the backslash form that stands in for it is its JSON escape as well.
        stream.write((separator + ",\n".join(lines)).encode("utf-8", "backslashreplace"))
        separator = ",\n"
    stream.write(b"\n]}\n")


def feature_lines(degrees: NDArray[np.float64], properties: pd.DataFrame) -> Iterator[str]:
    """Yield one feature a point, as JSON text."""
    names = [json.dumps(str(name), ensure_ascii=False).replace("%", "%%") for name in properties.columns]
    template = FEATURE + ",".join(f"{name}:%s" for name in names) + "}}"
    columns = [_json_texts(properties.iloc[:, number]) for number in range(properties.shape[1])]
    rounded = np.round(degrees, 7) + 0.0  # no negative zero
    return map(template.__mod__, zip(rounded[:, 0].tolist(), rounded[:, 1].tolist(), *columns, strict=True))


def _json_texts(values: pd.Series[Any]) -> list[str]:
    if values.dtype.kind in "iu":
        return list(map(str, values.tolist()))
    if values.dtype.kind == "f":
        numbers = np.round(values.to_numpy(dtype=float), NUMBER_DECIMALS) + 0.0
        texts = list(map(repr, numbers.tolist()))
        for row in np.flatnonzero(~np.isfinite(numbers)):
            texts[row] = "null"
        return texts
    if values.dtype.kind == "b":
        return ["true" if value else "false" for value in values.tolist()]
    missing = values.isna().to_numpy()
    texts = list(map(encode_basestring, map(str, values.tolist())))
    for row in np.flatnonzero(missing):
        texts[row] = "null"
    return texts


def bounding_box(degrees: NDArray[np.float64]) -> list[float]:
    """Return west, south, east, north; west above east where the points lie on both sides of longitude 180.

    Points further apart than half the globe are taken to straddle that line (RFC 7946, section 5.2).
    """
    longitude, latitude = degrees[:, 0], degrees[:, 1]
    west, east = longitude.min(), longitude.max()
    if east - west > 180:
        west, east = longitude[longitude > 0].min(), longitude[longitude < 0].max()
    return [round(float(value), 7) for value in (west, latitude.min(), east, latitude.max())]


def read_plants(path: Path) -> PlacedPlants:
    """Read the plants of a plants.geojson; those that do not stand have no height.

    Raises
    ------
    InputError
        Not there, or not a collection of points with plant ids.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        features = content["features"]
        ids = [feature["properties"]["plant_id"] for feature in features]
        places = [feature["geometry"]["coordinates"][:2] for feature in features]
        heights = [feature["properties"].get("height_m") for feature in features]
        names = {name for feature in features for name in COLUMNS if name in feature["properties"]}
        columns = stated_columns({name: [item["properties"].get(name) for item in features] for name in names})
        degrees = np.array(places, dtype=np.float64).reshape(len(ids), 2)
        height_m = np.array(heights, dtype=np.float64)
    except OSError as error:
        raise InputError("the file cannot be read", where=path, found=error.strerror) from error
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            "not a whole GeoJSON of plants", where=path, found=in_words(error),
            expected="a collection of points with plant_id", next_step="export it again",
        ) from error  # fmt: skip
    return PlacedPlants(
        plant_id=np.array([str(name) for name in ids], dtype=object),
        xyz_m=np.column_stack([degrees, np.zeros(len(degrees))]),
        crs=CRS.from_epsg(4326),
        height_m=height_m,
        columns=columns,
    )


def _feature_lines(path: Path) -> int:
    count, tail = 0, b""
    with path.open("rb") as stream:
        while chunk := stream.read(1 << 22):
            count += (tail + chunk).count(b'\n{"type":"Feature"')
            # Enough to find a start cut in two, too little to hold a whole one.
            tail = (tail + chunk)[-len(b'\n{"type":"Feature"') + 1 :]
    return count if tail.endswith(b"\n]}\n") else -1
