"""Street trees of Chiyoda, Tokyo, grown where they stand: `python -m benchmarks.tokyo_trees`.

No trait is fitted to these trees. They did teach one thing: in a first run limes and planes stood still in the shade of
towers, and the bounds by shade tolerance in `calibrate_growth` date from that, so that heights here are no blind test.

1,107 trees with species, height and crown diameter, and the buildings around them, are read from the folder named by
URBANFOREST_REAL_DATA (Tokyo Metropolitan Government CC BY 4.0, PLATEAU, OpenStreetMap). Their ages and girths are not
known. So a tree is given the age at which an open-grown plant of its species reaches the measured height (1 to 100
years, halves of a year); what then is independent of that choice is the crown diameter, and how far neighbours and
buildings move the height from the one that the age stands for. The other way round, the age from the crown, predicts
heights. Street trees of Tokyo are pruned hard every few years, which is not known tree by tree: growth is told unpruned
and, for comparison, cut to 0.7 of the crown's volume (the paper's hedges).

Matched by genus are planes, cherries, maples, limes and oaks; the pagoda tree by family and habit with the honey
locust. All others (ginkgo first) grow as limes, to stand where they stand as neighbours, and are told apart.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyogrio
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.config import Species as SpeciesChoice
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import measure
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.core.traits import OpenGrown, traits_table
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.grove import OUTCOMES, Grove
from urbanforest_cli.growth.groves import cut_into_groves, row_azimuth
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

LATITUDE_DEG = 35.69
STAND_IN = "tilia_cordata"
MATCHES = {
    "スズカケノキ": ("platanus_acerifolia", "genus"),  # Platanus
    "サクラ": ("prunus_serrulata", "genus"),  # cherries
    "トウカエデ": ("acer_platanoides", "genus"),  # Acer buergerianum
    "ハナノキ": ("acer_platanoides", "genus"),  # Acer pycnanthum
    "シナノキ": ("tilia_cordata", "genus"),  # Tilia japonica
    "オオバボダイジュ": ("tilia_cordata", "genus"),  # Tilia maximowicziana
    "ウバメガシ": ("quercus_rubra", "genus"),  # Quercus phillyraeoides, evergreen
    "シラカシ": ("quercus_rubra", "genus"),  # Quercus myrsinifolia, evergreen
    "エンジュ": ("gleditsia_triacanthos", "family"),  # Styphnolobium japonicum
}
HALF_YEARS = np.arange(1.0, 100.5, 0.5)


@dataclass(frozen=True)
class Trees:
    """What was measured: positions in metres, height and crown diameter in metres, the species each is grown as."""

    xy_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    crown_m: NDArray[np.float64]
    grown_as: NDArray[np.str_]
    match: NDArray[np.str_]


def read(path: Path) -> tuple[Trees, NDArray[np.object_], NDArray[np.float64]]:
    """Return the trees, and polygons and heights of the buildings."""
    frame = pyogrio.read_dataframe(path, layer="trees")
    pairs = [MATCHES.get(name, (STAND_IN, "none")) for name in frame["species"]]
    trees = Trees(
        xy_m=shapely.get_coordinates(frame.geometry.to_numpy()),
        height_m=frame["height"].to_numpy(float),
        crown_m=frame["crownDiameter"].to_numpy(float),
        grown_as=np.array([species for species, _ in pairs]),
        match=np.array([match for _, match in pairs]),
    )
    buildings = pyogrio.read_dataframe(path, layer="buildings")
    return trees, buildings.geometry.to_numpy(), buildings["height"].to_numpy(float)


def age_at(open_grown: OpenGrown, sizes: NDArray[np.float64], *, crown: bool = False) -> NDArray[np.float64]:
    """Return the age at which open-grown plants come nearest to a height, or to a crown diameter."""
    curve = 2 * open_grown.crown_radius_at(HALF_YEARS) if crown else open_grown.height_at(HALF_YEARS)
    return HALF_YEARS[np.abs(np.maximum.accumulate(curve) - sizes[:, None]).argmin(axis=1)]


def grow(
    trees: Trees, ages: NDArray[np.float64], buildings: NDArray[np.object_], building_m: NDArray[np.float64],
    catalogue: Catalogue, pruning_factor: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:  # fmt: skip
    """Grow all trees where they stand; return heights, crown diameters and outcomes."""
    config = Growth()
    count = len(ages)
    keys = keys_for(0, "tokyo", map(str, range(count)))
    species = np.array([catalogue.index_of(name) for name in trees.grown_as])
    factor = np.full(count, pruning_factor)
    plants = Plants(keys=keys, xy_m=trees.xy_m, species=species, age_years=ages, pruning_factor=factor)
    light = light_from(LATITUDE_DEG, config.sun_share)
    site = Site(plants, [kind.open_grown for kind in catalogue], buildings, building_m, light, config)
    lot = np.zeros(count, np.int64)
    azimuth = row_azimuth(trees.xy_m, lot)
    grove_of = cut_into_groves(lot, trees.xy_m, keys, config)
    traits = traits_table([kind.growth for kind in catalogue])
    heights, crowns, outcomes = np.zeros(count), np.zeros(count), np.zeros(count, np.int64)

    def grow_one(number: int) -> None:
        rows = np.flatnonzero(grove_of == number)
        grove = Grove(
            keys=keys[rows], xy_m=trees.xy_m[rows], species=species[rows], age_years=ages[rows],
            pruning_factor=factor[rows], clearance_m=np.zeros(len(rows)), row_azimuth_rad=azimuth[rows],
        )  # fmt: skip
        grown = grow_grove(grove, site.around(rows), traits, config)
        sizes = measure(grown.skeletons)
        heights[rows], crowns[rows] = sizes["height_m"], 2 * sizes["crown_radius_m"]
        outcomes[rows] = grown.outcome

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(grow_one, range(int(grove_of.max()) + 1)))
    return heights, crowns, outcomes


def error(grown: NDArray[np.float64], measured: NDArray[np.float64]) -> str:
    """Return median grown, median measured, median ratio and median absolute error in percent, as one cell."""
    ratio = grown / measured
    middle, wrong = np.median(ratio), np.median(np.abs(ratio - 1))
    return f"{np.median(grown):6.1f} {np.median(measured):5.1f} {middle:5.2f} {wrong:5.0%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=int, default=0, help="grow the first trees only")
    options = parser.parse_args()
    folder = os.environ.get("URBANFOREST_REAL_DATA")
    if not folder:
        sys.exit("URBANFOREST_REAL_DATA is not set: the folder that holds tokyo_chiyoda/tokyo_chiyoda.gpkg")
    trees, buildings, building_m = read(Path(folder) / "tokyo_chiyoda" / "tokyo_chiyoda.gpkg")
    if options.limit:
        rows = slice(options.limit)
        trees = Trees(*(getattr(trees, name)[rows] for name in Trees.__annotations__))
    catalogue = load_catalogue(SpeciesChoice())
    ages, crown_ages = np.zeros(len(trees.xy_m)), np.zeros(len(trees.xy_m))
    from_crown = np.zeros(len(trees.xy_m))
    for kind in catalogue:
        of_kind = trees.grown_as == kind.id
        ages[of_kind] = age_at(kind.open_grown, trees.height_m[of_kind])
        crown_ages[of_kind] = age_at(kind.open_grown, trees.crown_m[of_kind], crown=True)
        from_crown[of_kind] = kind.open_grown.height_at(crown_ages[of_kind])
    start = time.process_time()
    unpruned = grow(trees, ages, buildings, building_m, catalogue, 1.0)
    pruned = grow(trees, ages, buildings, building_m, catalogue, 0.7)
    print(f"{len(ages)} trees grown twice in {time.process_time() - start:.0f} CPU s")
    print("columns: median grown, median measured, median of the ratio, median absolute error")
    groups = [(f"{match}: {name}", (trees.match == match) & (trees.grown_as == name))
              for match in ("genus", "family", "none") for name in catalogue.ids]  # fmt: skip
    groups = [("all matched by genus", trees.match == "genus"), *groups, ("all", np.ones(len(ages), bool))]
    for name, rows in groups:
        if not rows.any():
            continue
        print(f"\n{name}: {rows.sum()} trees, age from height {np.median(ages[rows]):.0f} years in the median")
        print(f"  crown, unpruned, in place    {error(unpruned[1][rows], trees.crown_m[rows])}")
        print(f"  crown, cut to 0.7, in place  {error(pruned[1][rows], trees.crown_m[rows])}")
        print(f"  height, unpruned, in place   {error(unpruned[0][rows], trees.height_m[rows])}")
        print(f"  height from the crown's age  {error(from_crown[rows], trees.height_m[rows])}")
        fates = np.bincount(unpruned[2][rows], minlength=len(OUTCOMES))
        print("  " + ", ".join(f"{count} {fate}" for fate, count in zip(OUTCOMES, fates, strict=True)))


if __name__ == "__main__":
    main()
