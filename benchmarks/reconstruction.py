"""Real places planted from their own coverage, beside rules alone: `python -m benchmarks.reconstruction [SITE]...`.

Sites are read from the folder named by URBANFOREST_REAL_DATA; what is made goes to `--work`. For each, a city and a
coverage map are made out of what the site has; `populate --until place` runs once with the map (or image) and once
by the rules of the zones alone; `evaluate` holds both against the map, and against known trees where there are any.

del_mar
    5,094 rows of parcels (doubles left to the program) and the canopy polygons as a map of 0.6 m.
santa_monica
    Blocks out of street lines, cut with 52 aerial tiles, as lots; buildings; annotated trees; the coverage model finds
    the vegetation.
harlem, kronenhuset, torggatan
    Canopy heights over 2 m of a raster as the map, squares of 40 m as lots, buildings out of the land cover.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import rasterio
import rasterio.features
import shapely
from rasterio.enums import Resampling

CANOPY_FROM_M = 2.0
BUILDING = 2  # land cover class of the UMEP rasters
SQUARE_M = 40.0
MAP_M = 0.6
LEAST_PIECE_M2 = 100.0
FINER = 4


@dataclass(frozen=True)
class Site:
    """A city, and what says where its vegetation is.

    Parameters
    ----------
    options
        Of `populate`, naming the map or the image.
    observed, tiles
        ``FILE:LAYER`` of known trees, and of the areas they are counted in.
    """

    city: Path
    options: tuple[str, ...]
    observed: str | None = None
    tiles: str | None = None
    judge: tuple[str, ...] = field(default=())


def del_mar(data: Path, work: Path) -> Site:
    """Parcels and canopy polygons."""
    source = data / "del_mar" / "delmar.gpkg"
    parcels, canopy = _layers(source, "parcel", "canop")
    city, coverage = work / "city.gpkg", work / "map.tif"
    parcels = parcels[[parcels.geometry.name]].drop_duplicates().reset_index(drop=True)
    parcels["lot_id"], parcels["zone"] = [f"p{row}" for row in parcels.index], "residential"
    parcels.to_file(city, layer="lots")
    write_shares(coverage, canopy.geometry.to_numpy(), canopy.total_bounds, canopy.crs, MAP_M)
    return Site(city, ("--coverage", str(coverage)), judge=("--coverage", str(coverage)))


def santa_monica(data: Path, work: Path) -> Site:
    """Blocks, buildings, aerial tiles and annotated trees."""
    source = data / "santa_monica" / "santa_monica.gpkg"
    streets, buildings, tiles = (
        gpd.read_file(source, layer=name) for name in ("street_lines", "buildings", "naip_tiles")
    )
    tiles = tiles[tiles["in_building_cover"].astype(bool)].reset_index(drop=True)
    blocks = shapely.get_parts(shapely.polygonize(shapely.get_parts(shapely.node(
        shapely.union_all(streets.geometry.to_numpy())))))  # fmt: skip
    squares = tiles.geometry.to_numpy()
    tile, block = shapely.STRtree(blocks).query(squares, predicate="intersects")
    pieces, piece = shapely.get_parts(shapely.intersection(squares[tile], blocks[block]), return_index=True)
    used = (shapely.get_dimensions(pieces) == 2) & (shapely.area(pieces) >= LEAST_PIECE_M2)
    ids = [f"{tiles['tile'][tile[row]]} block {block[row]} {number}" for number, row in enumerate(piece)]
    lots = gpd.GeoDataFrame({"lot_id": np.array(ids)[used], "zone": "residential"}, geometry=pieces[used],
                            crs=streets.crs)  # fmt: skip
    city = work / "city.gpkg"
    lots.to_file(city, layer="lots")
    buildings.to_file(city, layer="buildings")
    tiles.to_file(city, layer="tiles")
    folder = data / "naip_california"
    images, points = [], []
    for name in tiles["tile"]:
        image = next((folder / "images").glob(f"{Path(str(name)).stem}.*"))
        images.append(image)
        trees = folder / "trees" / f"{image.stem}.json"
        if trees.exists():
            points.append(gpd.read_file(trees).to_crs(tiles.crs))
    pd.concat(points, ignore_index=True)[["geometry"]].to_file(city, layer="observed_plants")
    options = tuple(text for image in images for text in ("--image", str(image)))
    return Site(city, options, f"{city}:observed_plants", f"{city}:tiles")


def _umep(canopy: str, ground: str, surface: str, cover: str) -> Callable[[Path, Path], Site]:
    def prepare(data: Path, work: Path) -> Site:
        folder = data / "canopy_rasters"
        with rasterio.open(folder / canopy) as file:
            heights = file.read(1, masked=True).filled(0.0)
            place, crs, bounds = file.transform, file.crs, file.bounds
            shape = file.shape
        classes, base, top = (_onto(folder / name, shape, place, crs) for name in (cover, ground, surface))
        coverage, city = work / "map.tif", work / "city.gpkg"
        _write(coverage, np.where(heights > CANOPY_FROM_M, 100, 0).astype(np.uint8), place, crs)
        built = (np.rint(classes) == BUILDING).astype(np.uint8)
        shapes = [shapely.geometry.shape(item) for item, value in
                  rasterio.features.shapes(built, mask=built > 0, transform=place) if value]  # fmt: skip
        high = [_height(shape, top - base, place) for shape in shapes]
        gpd.GeoDataFrame({"height_m": high}, geometry=shapes, crs=crs).to_file(city, layer="buildings")
        west, south, east, north = bounds
        xs, ys = np.arange(west, east - 1, SQUARE_M), np.arange(south, north - 1, SQUARE_M)
        x, y = (axis.ravel() for axis in np.meshgrid(xs, ys))
        squares = shapely.box(x, y, np.minimum(x + SQUARE_M, east), np.minimum(y + SQUARE_M, north))
        lots = gpd.GeoDataFrame({"lot_id": [f"s{row}" for row in range(len(squares))], "zone": "other"},
                                geometry=squares, crs=crs)  # fmt: skip
        lots.to_file(city, layer="lots")
        return Site(city, ("--coverage", str(coverage)), judge=("--coverage", str(coverage)))

    return prepare


SITES: dict[str, Callable[[Path, Path], Site]] = {
    "del_mar": del_mar,
    "santa_monica": santa_monica,
    "harlem": _umep(*(f"nyc_ccny/ccny_{name}_1m.tif" for name in ("cdsm", "dem", "dsm", "lc"))),
    "kronenhuset": _umep(
        *(f"gothenburg_kronenhuset/{name}.tif" for name in ("CDSM_KRbig", "DEM_KRbig", "DSM_KRbig", "landcover"))
    ),
    "torggatan": _umep(*(f"gothenburg_torggatan/torgg_{name}.tif" for name in ("cdsm", "dem", "dsm", "lc"))),
}


def write_shares(path: Path, shapes: np.ndarray, bounds: np.ndarray, crs: object, pixel_m: float) -> None:
    """Write polygons as a map: the percentage of each pixel under them."""
    west, south, east, north = bounds
    width, height = int((east - west) / pixel_m) + 20, int((north - south) / pixel_m) + 20
    place = rasterio.Affine(pixel_m, 0, west - 10 * pixel_m, 0, -pixel_m, north + 10 * pixel_m)
    fine = place * rasterio.Affine.scale(1 / FINER)
    shares = np.zeros((height, width), np.uint8)
    rows = 512
    tree = shapely.STRtree(shapes)
    for row in range(0, height, rows):
        count = min(rows, height - row)
        part = fine * rasterio.Affine.translation(0, row * FINER)
        box = shapely.box(*rasterio.transform.array_bounds(count, width, place * rasterio.Affine.translation(0, row)))
        near = shapes[np.sort(tree.query(box))]
        if len(near):
            mask = rasterio.features.rasterize(near, (count * FINER, width * FINER), transform=part, dtype=np.uint8)
            parts = mask.reshape(count, FINER, width, FINER).mean(axis=(1, 3))
            shares[row : row + count] = np.rint(100 * parts).astype(np.uint8)
    _write(path, shares, place, crs)


def _write(path: Path, percent: np.ndarray, place: rasterio.Affine, crs: object) -> None:
    height, width = percent.shape
    with rasterio.open(path, "w", driver="GTiff", height=height, width=width, count=1, dtype="uint8", nodata=255,
                       crs=crs, transform=place, compress="deflate", tiled=True) as file:  # fmt: skip
        file.write(percent, 1)
        file.set_band_description(1, "canopy")
        file.set_band_unit(1, "percent")


def _layers(source: Path, *parts: str) -> list[gpd.GeoDataFrame]:
    names = [str(name) for name in gpd.list_layers(source)["name"]]
    return [gpd.read_file(source, layer=next(name for name in names if part in name.lower())) for part in parts]


def _onto(path: Path, shape: tuple[int, int], place: rasterio.Affine, crs: object) -> np.ndarray:
    from rasterio.warp import reproject

    values = np.zeros(shape, np.float32)
    with rasterio.open(path) as file:
        reproject(rasterio.band(file, 1), values, dst_transform=place, dst_crs=crs, resampling=Resampling.nearest)
    return values


def _height(shape: shapely.Geometry, above: np.ndarray, place: rasterio.Affine) -> float:
    inside = rasterio.features.rasterize([shape], above.shape, transform=place, dtype=np.uint8) > 0
    return float(np.clip(np.median(above[inside]), 3.0, 200.0)) if inside.any() else 8.0


def urbanforest(*arguments: object) -> str:
    """Run the program and return what it prints; what it complains of goes through."""
    command = [sys.executable, "-m", "urbanforest_cli", *map(str, arguments)]
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE).stdout


def measure(name: str, data: Path, work: Path) -> dict[str, object]:
    """Plant a site from its map and by rules alone; return what `evaluate` says."""
    work.mkdir(parents=True, exist_ok=True)
    site = SITES[name](data, work)
    urbanforest("populate", site.city, "-o", work / "map", *site.options, "--until", "place", "-q")
    urbanforest("populate", site.city, "-o", work / "rules", "--until", "place", "-q")
    judge = site.judge or ("--coverage", str(work / "map" / "coverage.tif"))
    known = ("--observed", site.observed) if site.observed else ()
    tiles = ("--tiles", site.tiles) if site.tiles else ()
    told = urbanforest("evaluate", work / "map", *judge, *known, *tiles, "--rules", work / "rules", "--json")
    found: dict[str, object] = json.loads(told)
    (work / "evaluation.json").write_text(told)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", nargs="*", choices=[*SITES, []], help="all if none is named")
    parser.add_argument("--work", type=Path, default=Path("reconstruction"), help="folder to write to")
    arguments = parser.parse_args()
    data = os.environ.get("URBANFOREST_REAL_DATA")
    if not data:
        sys.exit("URBANFOREST_REAL_DATA names no folder of real data")
    for name in arguments.site or SITES:
        print(f"\n== {name}", flush=True)
        print(json.dumps(measure(name, Path(data), arguments.work / name), indent=1))


if __name__ == "__main__":
    main()
