"""What makes a grown crown look right, as numbers: how closed it is, how round its top, how straight its trunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.skeleton import Skeletons, measure, pipe_count, standing

TWIG_PIPES = 5  # pictures set leaves on wood that carries no more twig ends than this
SIDES = 24  # half planes that bound a crown's outline
VIEWS = 4  # sides that a crown is looked at from
UPPER_SHARE = 0.85  # of the crown's height, from the top: what is looked at
TOP_SHARE = 0.88  # of the plant's height: what stands above it is the top
SECTORS = 8
CELL_SHARE = 1 / 28  # edge of a cell of the side view, as a share of the plant's height

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Looks:
    """Of each plant (s,) at one age.

    `cover`: share of the convex outline of the leafy crown that twigs cover, in side view, mean of several sides.
    `dome`: mean radius of what stands in the top 12 % of the height, over the crown's radius; an ellipsoid has 0.7.
    `lean`: how far the trunk is from above its foot at a third of the height, as a share of that height.
    """

    cover: Reals
    dome: Reals
    lean: Reals
    height_m: Reals
    internode_count: Reals


def looks_at(skeletons: Skeletons, age: int) -> Looks:
    """Look at plants at an age; where nothing stands, everything is 0."""
    season = np.full(len(skeletons), age, np.int64)
    there = standing(skeletons, season)
    twig = there & (pipe_count(skeletons, season) <= TWIG_PIPES)
    sizes = measure(skeletons, season)
    found = np.zeros((3, len(skeletons)))
    for s in range(len(skeletons)):
        own = slice(skeletons.first[s] + 1, skeletons.first[s + 1])
        points = skeletons.xyz_m[own].astype(np.float64)
        height_m, radius_m = float(sizes["height_m"][s]), float(sizes["crown_radius_m"][s])
        if height_m < 0.5 or radius_m < 0.1:
            continue
        ends = twig[own]
        starts = skeletons.xyz_m[skeletons.first[s] + skeletons.parent[own][ends]]
        found[0, s] = cover(np.vstack((points[ends], 0.5 * (points[ends] + starts))), height_m)
        found[1, s] = sector_radius(points[there[own] & (points[:, 2] >= TOP_SHARE * height_m)]) / radius_m
        trunk = points[there[own] & (skeletons.order[own] == 0)]
        foot = trunk[np.argmin(np.abs(trunk[:, 2] - height_m / 3))]
        found[2, s] = float(np.hypot(foot[0], foot[1])) / (height_m / 3)
    return Looks(*found, sizes["height_m"].astype(float), sizes["internode_count"].astype(float))


def sector_radius(points: Reals) -> float:
    """Return the mean over sectors of the largest distance from the root's vertical; an empty sector counts as 0."""
    sector = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    reach = np.zeros(SECTORS)
    np.maximum.at(reach, sector, np.hypot(points[:, 0], points[:, 1]))
    return float(reach.mean())


def cover(twigs: Reals, height_m: float) -> float:
    """Return the share of the outline of the upper crown, seen from the side, that twigs cover."""
    low = height_m - UPPER_SHARE * (height_m - twigs[:, 2].min(initial=height_m))
    upper = twigs[twigs[:, 2] >= low]
    if len(upper) < SIDES:
        return 0.0
    cell = height_m * CELL_SHARE
    across = np.linspace(0.0, np.pi, VIEWS, endpoint=False)
    normal = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)
    normals = np.column_stack((np.cos(normal), np.sin(normal)))
    shares = []
    for angle in across:
        flat = np.column_stack((upper[:, 0] * np.cos(angle) + upper[:, 1] * np.sin(angle), upper[:, 2])) / cell
        start = np.floor(flat.min(axis=0))
        size = (np.floor(flat.max(axis=0)) - start).astype(int) + 1
        x, z = np.meshgrid(np.arange(size[0]) + start[0] + 0.5, np.arange(size[1]) + start[1] + 0.5, indexing="ij")
        inside = (np.column_stack((x.ravel(), z.ravel())) @ normals.T <= (flat @ normals.T).max(axis=0)).all(axis=1)
        at = (np.floor(flat) - start).astype(int)
        covered = np.bincount(at[:, 0] * size[1] + at[:, 1], minlength=len(inside)) > 0
        shares.append(covered[inside].sum() / max(inside.sum(), 1))
    return float(np.mean(shares))


@dataclass(frozen=True)
class Wanted:
    """What a species should look like, by eye; least or most at 30, 50 and 80 years."""

    cover: float
    dome: float
    internodes: tuple[float, float]
    height_80_m: float


LEAN_MOST = 0.05
OLD_AGES = (30, 50, 80)
WANTED = {
    "acer_platanoides": Wanted(0.94, 0.42, (4000, 6500), 20.0),
    "gleditsia_triacanthos": Wanted(0.86, 0.38, (3500, 6500), 20.0),
    "platanus_acerifolia": Wanted(0.92, 0.40, (4500, 7500), 21.0),
    "prunus_serrulata": Wanted(0.92, 0.48, (3500, 6500), 11.0),
    "quercus_rubra": Wanted(0.93, 0.38, (4500, 7500), 26.0),
    "tilia_cordata": Wanted(0.93, 0.32, (4500, 7500), 21.0),
    "cornus_sanguinea": Wanted(0.74, 0.42, (1000, 2600), 3.9),
    "corylus_avellana": Wanted(0.78, 0.40, (1400, 3000), 7.6),
    "ligustrum_vulgare": Wanted(0.74, 0.42, (1000, 2600), 3.4),
    "syringa_vulgaris": Wanted(0.80, 0.42, (1400, 3000), 7.6),
}


def looks_loss(skeletons: Skeletons, species_id: str, *, lean: bool) -> float:
    """Return the loss of plants grown to 80 years against what their species should look like."""
    if (wanted := WANTED.get(species_id)) is None:
        return 0.0
    loss, counts = 0.0, []
    for age in OLD_AGES:
        looks = looks_at(skeletons, age)
        counts.append(max(float(np.median(looks.internode_count)), 1.0))
        spread = float(np.mean(np.sort(looks.cover)[: max(len(skeletons) // 2, 1)]))  # the worse half
        loss += 3 * (max(wanted.cover - spread, 0) / 0.08) ** 2
        if age > OLD_AGES[0]:
            loss += 3 * (max(wanted.dome - float(np.median(looks.dome)), 0) / 0.08) ** 2
        if lean:
            loss += 1.5 * (max(float(np.median(looks.lean)) - LEAN_MOST, 0) / 0.04) ** 2
    least, most = wanted.internodes
    loss += 60 * max(np.log(least / counts[1]), np.log(counts[1] / most), 0.0) ** 2
    loss += 60 * max(np.log(counts[1] / counts[2]), 0.0) ** 2
    height_m = max(float(np.median(looks.height_m)), 0.1)
    return float(loss + 100 * max(np.log(height_m / wanted.height_80_m), 0.0) ** 2)
