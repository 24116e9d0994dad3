"""Known forests reconstructed from their own coverage: `python -m benchmarks.round_trip`.

Cities of `synth` are planted with known parameters, rules and street strips as they are; the crowns are drawn into a
coverage map of 0.6 m, and the forest is made anew out of that map alone: `stencil --coverage`, `regress`, `diffuse`
and `place` with the default config and another seed. The city of "zones" is planted with the default config itself,
that of "ranges" with parameters over the whole ranges of the paper's tables, of which the reconstruction knows nothing.

What is told of both forests, lot by lot:

share
    Covered share of the lot, by crowns of all lots; within 5 points.
plants
    Count of stems, in total and by lot.
same
    Share of lots in which a Kolmogorov-Smirnov test at 5 % of the distances to the nearest neighbour does not tell the
    reconstruction from the truth. It takes both patterns as unrelated, which they are not.
as likely
    Share of lots in which the reconstruction is among what the true model itself gives under other seeds: mean
    distance to the nearest neighbour between the extremes of 39 replications (exact at 5 %, two-sided), L(r) by the
    rank of its largest studentised deviation at any r (global envelope, Myllymaki et al. 2017). Beside it what the
    truth reaches itself.
    Stems of all patterns are moved by up to half a pixel first: streets planted every 9 m have all distances alike
    to the millimetre, which no map of 0.6 m tells.
chamfer
    Root mean square distance from stems of the truth to the nearest of the reconstruction, and back; beside it that
    of a replication.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from urbanforest_cli.context.stage import diffuse_parameters
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.polygon_raster import raster_shares
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.evaluation.chamfer import chamfer
from urbanforest_cli.evaluation.patterns import Patterns
from urbanforest_cli.evaluation.point_patterns import lot_l
from urbanforest_cli.evaluation.two_sample import flip_test
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.coverage import CoverageWriter
from urbanforest_cli.files.geopackage import read_layer
from urbanforest_cli.files.parameter_models import SHIPPED
from urbanforest_cli.files.provenance import require_record
from urbanforest_cli.placement.stage import place_plants
from urbanforest_cli.register.stage import stencil_city
from urbanforest_cli.regression.stage import regress_register
from urbanforest_cli.synth.stage import make_city

Floats = NDArray[np.float64]
PIXEL_M, MARGIN_M = 0.6, 12.0
REPLICATIONS = 39
LEAST_PLANTS = 8
"""Lots with fewer plants, in one forest or the other, say nothing of arrangement."""
TRUTH_SEED, SEED = 1, 2
TILE_PX = 512
ZONES = ("residential", "commercial", "industrial", "street", "other")
FROM_TABLES = ("radius_mean_m", "radius_variance_m2", "density", "boundary_width_m", "cluster_radius_m",
               "cluster_count_max")  # fmt: skip
LEAST = {"density": 0.1, "boundary_width_m": 1.0, "cluster_count_max": 1.0, "radius_mean_m": 1.2}
MOST = {"radius_mean_m": 6.0}
"""Crowns of 10 m and more in gardens would leave a plant or two a lot."""


@dataclass(frozen=True)
class Forest:
    """Plants of a register by lot.

    Parameters
    ----------
    points
        Stems by lot, in the order of the ids.
    shares
        (lots,) covered share, by the crowns of all lots.
    """

    points: Patterns
    shares: Floats


@dataclass(frozen=True)
class Trip:
    """What is told of a truth and its reconstruction."""

    shares: tuple[Floats, Floats]
    counts: tuple[NDArray[np.int64], NDArray[np.int64]]
    judged: NDArray[np.bool_]
    same: NDArray[np.bool_]
    near_likely: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    l_likely: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    chamfer_m: tuple[float, float, float]
    flips: tuple[float, float]
    radius_m: tuple[float, float]

    @property
    def share_within(self) -> float:
        """Share of lots whose covered share is within 5 points, of those that are covered at all."""
        covered = (self.shares[0] > 0) | (self.shares[1] > 0)
        return float((np.abs(self.shares[0] - self.shares[1])[covered] <= 0.05).mean())

    @property
    def count_ratio(self) -> float:
        """Plants of the reconstruction for each of the truth."""
        return float(self.counts[1].sum() / self.counts[0].sum())

    def lines(self) -> list[str]:
        """Return the figures in words."""
        off = self.shares[1] - self.shares[0]
        return [
            f"covered share within 5 points in {self.share_within:.1%} of {int((self.shares[0] > 0).sum())} lots, "
            f"mean error {np.abs(off).mean():.4f}, bias {off.mean():+.4f}, "
            f"correlation {np.corrcoef(*self.shares)[0, 1]:.4f}",
            f"plants {self.counts[0].sum():,} -> {self.counts[1].sum():,} ({self.count_ratio:.3f}), "
            f"correlation by lot {np.corrcoef(*self.counts)[0, 1]:.4f}; mean radius {self.radius_m[0]:.3f} -> "
            f"{self.radius_m[1]:.3f} m",
            f"of {int(self.judged.sum())} lots with {LEAST_PLANTS} plants and more: nearest neighbours the same in "
            f"{self.same.mean():.1%}; as likely under the true model: nearest neighbours "
            f"{self.near_likely[1].mean():.1%} (the truth {self.near_likely[0].mean():.1%}), L "
            f"{self.l_likely[1].mean():.1%} (the truth {self.l_likely[0].mean():.1%})",
            f"chamfer {self.chamfer_m[0]:.2f} m there, {self.chamfer_m[1]:.2f} m back; a replication of the truth "
            f"{self.chamfer_m[2]:.2f} m",
            f"all lots at once (sign flips): nearest neighbours p {self.flips[0]:.3f}, L p {self.flips[1]:.3f}",
        ]


def table_config(seed: int) -> Config:
    """Return a config whose zones take their values from all over the ranges of the paper's tables."""
    rng = np.random.default_rng(seed)
    zones = {}
    for zone in ZONES:
        values = {
            name: rng.uniform(LEAST.get(name, PARAMETERS[name].low), MOST.get(name, PARAMETERS[name].high))
            for name in FROM_TABLES
        }
        values["cluster_count_max"] = float(np.rint(values["cluster_count_max"]))
        values["radius_variance_m2"] = min(values["radius_variance_m2"], (0.4 * values["radius_mean_m"]) ** 2)
        zones[zone] = {"strategy": dict.fromkeys(("random", "boundary", "cluster"), 1.0), **values}
    return Config.model_validate({"zones": zones})


def plant_truth(city: Path, register: Path, config: Config) -> None:
    """Plant a city by rules, with parameters known."""
    stencil_city(city, register, config=config, seed=TRUTH_SEED)
    diffuse_parameters(register, config=config, seed=TRUTH_SEED)
    place_plants(register, config=config, seed=TRUTH_SEED)


def reconstruct(city: Path, coverage: Path, register: Path, config: Config, *, regressed: bool) -> None:
    """Plant a city as a coverage map shows."""
    stencil_city(city, register, config=config, seed=SEED, coverage=coverage)
    if regressed:
        regress_register(register, config=config, seed=SEED)
    diffuse_parameters(register, config=config, seed=SEED)
    place_plants(register, config=config, seed=SEED)


def crowns_of(register: Path) -> gpd.GeoDataFrame:
    """Return the plants of a register in metres, with the discs of their crowns in column `crown`."""
    plants = read_layer(register, "plants").to_crs(require_record(register, "stencil").working_crs)
    plants["crown"] = shapely.buffer(plants.geometry.to_numpy(), plants["envelope_radius_m"].to_numpy(), quad_segs=16)
    return plants


def write_coverage(register: Path, path: Path) -> Path:
    """Draw the crowns of a register into a coverage map: exact percentages of each pixel."""
    crowns = crowns_of(register)
    lots = read_layer(register, "lots").to_crs(crowns.crs)
    west, south, east, north = lots.total_bounds + MARGIN_M * np.array([-1, -1, 1, 1])
    width, height = int((east - west) / PIXEL_M), int((north - south) / PIXEL_M)
    grid = RasterGrid(width, height, (PIXEL_M, 0.0, west, 0.0, -PIXEL_M, north), crowns.crs)
    discs = crowns["crown"].to_numpy()
    tree = shapely.STRtree(discs)
    with CoverageWriter(path, grid, ("canopy",), {"format": "cover"}) as out:
        for row in range(0, height, TILE_PX):
            for col in range(0, width, TILE_PX):
                h, w = min(TILE_PX, height - row), min(TILE_PX, width - col)
                x0, y_top = west + col * PIXEL_M, north - row * PIXEL_M
                frame = shapely.box(x0, y_top - h * PIXEL_M, x0 + w * PIXEL_M, y_top)
                union = shapely.union_all(discs[np.sort(tree.query(frame))])
                share = raster_shares(np.array([union], dtype=object), x0, y_top, PIXEL_M, h, w)
                out.write(row, col, np.rint(100 * share).astype(np.uint8))
    return path


def forest_of(register: Path, lot_ids: list[str]) -> Forest:
    """Return the stems of lots, and what of them is under crowns."""
    crowns = crowns_of(register)
    lots = read_layer(register, "lots").set_index("lot_id").loc[lot_ids].geometry.to_crs(crowns.crs).to_numpy()
    discs = crowns["crown"].to_numpy()
    lot, disc = shapely.STRtree(discs).query(lots, predicate="intersects")
    by_lot = np.split(discs[disc], np.searchsorted(lot, np.arange(1, len(lots))))
    unions = np.array([shapely.union_all(part) for part in by_lot], dtype=object)
    shares = shapely.area(shapely.intersection(lots, unions)) / shapely.area(lots)
    return Forest(_points(crowns, lot_ids), np.asarray(shares))


def _points(plants: gpd.GeoDataFrame, lot_ids: list[str]) -> Patterns:
    place = pd.Index(lot_ids).get_indexer(plants["lot_id"])
    order = np.argsort(place, kind="stable")
    order = order[place[order] >= 0]
    starts = np.searchsorted(place[order], np.arange(len(lot_ids) + 1))
    return Patterns(shapely.get_coordinates(plants.geometry.to_numpy()[order]), starts.astype(np.int64))


def replications(register: Path, config: Config, lot_ids: list[str], count: int) -> list[Patterns]:
    """Plant a register anew with other seeds: what its parameters give, chance apart."""
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for number in range(count):
            again = Path(folder) / "again.gpkg"
            shutil.copy(register, again)
            place_plants(again, config=config, seed=1000 + number)
            found.append(_points(read_layer(again, "plants").to_crs(crowns_crs(register)), lot_ids))
    return found


def crowns_crs(register: Path) -> object:
    """Return the CRS in metres of a register."""
    return require_record(register, "stencil").working_crs


def compare(truth: Path, found: Path, config: Config, *, count: int = REPLICATIONS) -> Trip:
    """Hold a reconstruction against the truth, and against what the truth's model gives otherwise."""
    lots = read_layer(truth, "lots")
    lot_ids = sorted(set(lots["lot_id"]) & set(read_layer(found, "lots")["lot_id"]))
    area = lots.set_index("lot_id").loc[lot_ids].to_crs(crowns_crs(truth)).geometry.area.to_numpy()
    mine, its = forest_of(truth, lot_ids), forest_of(found, lot_ids)
    others = replications(truth, config, lot_ids, count)
    counts = np.array([p.counts for p in (mine.points, its.points, *others)])
    judged = (counts[:2] >= LEAST_PLANTS).all(axis=0) & (counts[2:] >= 3).all(axis=0)
    rows = np.flatnonzero(judged)
    rng = np.random.default_rng(0)
    sets = [_blurred(_some(p, rows), rng) for p in (mine.points, its.points, *others)]
    nearest = [p.neighbour_distances(1)[:, 0] for p in sets]
    means = np.array([np.bincount(p.lot, d, len(rows)) / p.counts for p, d in zip(sets, nearest, strict=True)])
    curves = np.array([lot_l(p, area[rows]) for p in sets])
    split = [np.split(d, p.starts[1:-1]) for p, d in zip(sets[:2], nearest[:2], strict=True)]
    same = np.array([ks_2samp(a, b).pvalue > 0.05 for a, b in zip(*split, strict=True)])
    quantiles = [np.array([np.quantile(d, (0.1, 0.25, 0.5, 0.75, 0.9)) for d in part]) for part in split]
    weight = np.sqrt(sets[0].counts)
    both = ((mine.points, its.points), (its.points, mine.points), (mine.points, others[0]))
    planted = (counts[:3] > 0).all(axis=0)
    back = [_some(a, np.flatnonzero(planted)) for pair in both for a in pair]
    plants = [read_layer(path, "plants")["envelope_radius_m"].mean() for path in (truth, found)]
    return Trip(
        shares=(mine.shares, its.shares),
        counts=(mine.points.counts, its.points.counts),
        judged=judged,
        same=same,
        near_likely=(_between(means[0], means[2:]), _between(means[1], means[2:])),
        l_likely=(_in_envelope(curves[0], curves[2:]), _in_envelope(curves[1], curves[2:])),
        chamfer_m=(_rms(*back[:2], area[planted]), _rms(*back[2:4], area[planted]), _rms(*back[4:], area[planted])),
        flips=(
            flip_test(quantiles[1] - quantiles[0], weight, rng).p,
            flip_test(curves[1] - curves[0], weight, rng).p,
        ),
        radius_m=(float(plants[0]), float(plants[1])),
    )


def _some(points: Patterns, rows: NDArray[np.int64]) -> Patterns:
    return Patterns.of([points.xy[points.starts[i] : points.starts[i + 1]] for i in rows])


def _blurred(points: Patterns, rng: np.random.Generator) -> Patterns:
    """Move points within their pixel."""
    return Patterns(points.xy + rng.uniform(-PIXEL_M / 2, PIXEL_M / 2, points.xy.shape), points.starts)


def _between(value: Floats, others: Floats) -> NDArray[np.bool_]:
    """Tell which values lie within the others' extremes: of n others, a test at 2 / (n + 1)."""
    return np.asarray((value >= others.min(axis=0)) & (value <= others.max(axis=0)))


def _in_envelope(curve: Floats, others: Floats) -> NDArray[np.bool_]:
    """Tell in which lots a curve strays no further than the others do, at 5 %: each measured against all."""
    every = np.concatenate([curve[None], others])
    strays = np.abs((every - every.mean(axis=0)) / every.std(axis=0).clip(1e-9)).max(axis=-1)
    rank = (strays >= strays[0] - 1e-12).sum(axis=0)
    return np.asarray(rank / len(every) > 0.05)


def _rms(source: Patterns, target: Patterns, area_m2: Floats) -> float:
    """Return the root mean square distance in metres over all points."""
    squares = chamfer(source, target, np.ones(len(area_m2)))
    return float(np.sqrt(squares.sum() / source.counts.sum()))


def round_trip(
    folder: Path, name: str, config: Config, *, lots: int, count: int = REPLICATIONS, regressed: bool | None = None
) -> Trip:
    """Make a city, plant it, draw its crowns, plant it from the drawing and compare."""
    city, truth, found = (folder / f"{name}_{part}.gpkg" for part in ("city", "truth", "found"))
    make_city(city, lot_count=lots, seed=7, overwrite=True)
    plant_truth(city, truth, config)
    coverage = write_coverage(truth, folder / f"{name}_coverage.tif")
    default = load_config(environment={}).config
    reconstruct(city, coverage, found, default, regressed=SHIPPED.exists() if regressed is None else regressed)
    return compare(truth, found, config, count=count)


def main() -> None:
    """Run both trips and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lots", type=int, default=600)
    parser.add_argument("--replications", type=int, default=REPLICATIONS)
    parser.add_argument("--work", type=Path, help="keep cities, maps and registers here")
    parser.add_argument("--without-regress", action="store_true")
    arguments = parser.parse_args()
    configs = {"zones": load_config(environment={}).config} | {f"ranges {seed}": table_config(seed) for seed in (1, 2)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.work or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, config in configs.items():
            start = time.perf_counter()
            trip = round_trip(
                folder, name.replace(" ", "_"), config, lots=arguments.lots, count=arguments.replications,
                regressed=False if arguments.without_regress else None,
            )  # fmt: skip
            print(f"\n{name} ({time.perf_counter() - start:.0f} s)")
            print("\n".join(f"  {line}" for line in trip.lines()), flush=True)


if __name__ == "__main__":
    main()
