"""Fewer shapes for a file: each plant keeps its own, or takes that of a plant of its species whose crown is most alike.

A shape is told by its height, the base of its crown and how far the crown reaches in eight sectors and three bands, so
that leaning and one-sided crowns keep their side. Another shape may stand for it mirrored, turned by 45 degrees and
scaled to its height. Those that stand for others are chosen one after the other, each the one that lowers the summed
difference over all plants of the city most: more go to species with many plants, large ones, and unlike ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.skeleton import Skeletons, measure
from urbanforest_cli.export.scene import prototypes_kernel as kernel
from urbanforest_cli.export.scene.city import Plants, SkeletonSource

FloatArray = NDArray[np.float64]
SeasonEnd = Callable[[Skeletons], NDArray[np.int32]]
SCALE_LIMITS = (0.6, 1.6)
BASE_WEIGHT, CUT_WEIGHT = 0.5, 1.0  # of a metre of crown base, and of height that the limits of scale leave
SCALE_WEIGHT = 0.04  # of a factor of e in scale, for each metre of height: scaled twigs and leaves look wrong
NEED_EXPONENT = 1.5  # of a difference: above 1, so that no plant is left far off
SIZE_EXPONENT = -0.5  # of height, factor on a difference in metres: half way to counting it as a share of height
HEIGHT_LEAST_M = 0.05
CHOICE_MAX = 1500  # shapes of a species among which representatives are sought; of more, a sample
FIRST_CHUNK, NODES_AT_ONCE = 256, 4_000_000
SAMPLE_DRAW = 1


@dataclass(frozen=True)
class Prototypes:
    """Shapes that a file stores, and how each plant is made of one: mirrored, then turned, then scaled.

    Parameters
    ----------
    skeleton_id, species
        (k,) shapes by species and then id.
    model
        (n,) int32 place of its shape in them.
    yaw_rad, mirror, scale
        (n,) as `Instances` has them.
    outline_error
        (n,) mean over sectors and bands of the difference in reach, as a share of the mean reach of the plant's own
        shape; 0 where it keeps its own.
    height_error
        (n,) difference in height as a share of the own height.
    """

    skeleton_id: NDArray[np.int64]
    species: NDArray[np.int64]
    model: NDArray[np.int32]
    yaw_rad: FloatArray
    mirror: NDArray[np.bool_]
    scale: FloatArray
    outline_error: FloatArray
    height_error: FloatArray

    def summary(self) -> dict[str, float]:
        """Return medians and the values that nine of ten plants are no worse than; zeros where there is no plant."""
        figures: dict[str, float] = {
            "own_shape_fraction": float((self.outline_error == 0).mean()) if len(self) else 1.0
        }
        for name in ("outline_error", "height_error"):
            values = getattr(self, name) if len(self) else np.zeros(1)
            figures[f"{name}_median"] = float(np.median(values))
            figures[f"{name}_worst_tenth"] = float(np.quantile(values, 0.9))
        return figures

    def __len__(self) -> int:
        return len(self.model)


@dataclass(frozen=True)
class _Shapes:
    """Distinct shapes in use: (m,) by species and id; `reach_m` (m, 24), `size_m` (m, 2) height and crown base."""

    skeleton_id: NDArray[np.int64]
    species: NDArray[np.int64]
    count: NDArray[np.int64]
    reach_m: FloatArray
    size_m: FloatArray


def choose_prototypes(
    plants: Plants, skeletons_of: SkeletonSource, season_end: SeasonEnd, *, count_max: int
) -> Prototypes:
    """Choose the shapes that a file stores, and one of them for each plant.

    The result does not depend on the order of plants.

    Parameters
    ----------
    plants
        Those that the file shall hold.
    skeletons_of
        Reads shapes; asked for some thousands at a time, and not at all where all plants keep their own.
    season_end
        Tells the season at which each skeleton is shown, as `City.season_end`.
    count_max
        Most shapes, but at least one for each species that is there.
    """
    pairs, shape = np.unique(np.column_stack([plants.species, plants.skeleton_id]), axis=0, return_inverse=True)
    shape = shape.reshape(-1)
    if len(pairs) <= count_max:
        none = np.zeros(len(plants))
        return Prototypes(
            pairs[:, 1], pairs[:, 0], shape.astype(np.int32), plants.yaw_rad, plants.mirror, plants.scale, none, none
        )
    shapes = _measured(pairs, np.bincount(shape, minlength=len(pairs)), skeletons_of, season_end)
    chosen = choose_shapes(shapes, count_max)
    stand_in, turn = _nearest(shapes, chosen)
    return _placed(plants, shape, shapes, chosen, stand_in, turn)


def _measured(
    pairs: NDArray[np.int64], count: NDArray[np.int64], skeletons_of: SkeletonSource, season_end: SeasonEnd
) -> _Shapes:
    ids, row = np.unique(pairs[:, 1], return_inverse=True)
    reach, size = np.empty((len(ids), kernel.REACHES)), np.empty((len(ids), 2))
    for rows, skeletons in _chunks(ids, skeletons_of):
        season = season_end(skeletons)
        sizes = measure(skeletons, season)
        size[rows] = np.column_stack([sizes["height_m"], sizes["crown_base_m"]])
        reach[rows] = kernel.crown_reaches(
            skeletons.first, skeletons.xyz_m, skeletons.birth_season, skeletons.death_season, season,
            size[rows, 1], size[rows, 0],
        )  # fmt: skip
    return _Shapes(pairs[:, 1], pairs[:, 0], count, reach[row], size[row])


def _chunks(ids: NDArray[np.int64], skeletons_of: SkeletonSource) -> Iterator[tuple[slice, Skeletons]]:
    """Yield skeletons with their rows, so many at a time that about NODES_AT_ONCE nodes are in memory."""
    first, nodes, step = 0, 0, FIRST_CHUNK
    while first < len(ids):
        rows = slice(first, min(first + step, len(ids)))
        skeletons = skeletons_of(ids[rows])
        yield rows, skeletons
        first, nodes = rows.stop, nodes + len(skeletons.parent)
        step = max(int(NODES_AT_ONCE * first / max(nodes, 1)), 1)


def choose_shapes(shapes: _Shapes, count_max: int) -> NDArray[np.int64]:
    """Choose rows of shapes, at least one a species: each next is the one that saves the city's plants most."""
    kinds = [np.flatnonzero(shapes.species == kind) for kind in np.unique(shapes.species)]
    rows = [_sample(shapes, kind) for kind in kinds]
    costs = []
    for places in rows:
        distance, _ = _distances(shapes, places, places)
        visible = np.maximum(shapes.size_m[places, :1], HEIGHT_LEAST_M) ** SIZE_EXPONENT
        costs.append((distance * visible) ** NEED_EXPONENT * shapes.count[places, None])
    nears, gains, chosen = [], [], []
    for places, cost in zip(rows, costs, strict=True):
        total = kernel.summed_costs(cost)
        pick = int(np.flatnonzero(total <= total.min() + kernel.SLACK)[0])
        near = cost[:, pick].copy()
        nears.append(near)
        gains.append(np.maximum(near[:, None] - cost, 0.0).sum(axis=0))
        chosen.append(int(places[pick]))
    best = np.array([gain.max() for gain in gains])
    while len(chosen) < count_max and best.max() > kernel.SLACK:
        kind = int(np.argmax(best))
        pick = int(np.argmax(gains[kind]))
        chosen.append(int(rows[kind][pick]))
        kernel.add_chosen(costs[kind], nears[kind], gains[kind], pick)
        gains[kind][pick] = 0.0
        best[kind] = gains[kind].max()
    return np.sort(np.array(chosen, dtype=np.int64))


def _sample(shapes: _Shapes, places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return at most CHOICE_MAX of some shapes, drawn by their ids."""
    if len(places) <= CHOICE_MAX:
        return places
    draw = hash_uniform(shapes.skeleton_id[places].astype(np.uint64), np.full(len(places), SAMPLE_DRAW))
    return np.sort(places[np.lexsort((places, draw))[:CHOICE_MAX]])


def _distances(
    shapes: _Shapes, places: NDArray[np.int64], others: NDArray[np.int64]
) -> tuple[FloatArray, NDArray[np.uint8]]:
    distance, turn = kernel.distances(
        shapes.reach_m[places], shapes.size_m[places], shapes.reach_m[others], shapes.size_m[others],
        np.array([BASE_WEIGHT, CUT_WEIGHT, SCALE_WEIGHT]), np.array(SCALE_LIMITS),
    )  # fmt: skip
    return distance, turn


def _nearest(shapes: _Shapes, chosen: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (m,) which of the chosen stands for each shape, and how it is turned."""
    stand_in, turn = np.empty((2, len(shapes.species)), dtype=np.int64)
    for kind in np.unique(shapes.species):
        mine, theirs = (np.flatnonzero(species == kind) for species in (shapes.species, shapes.species[chosen]))
        distance, turns = _distances(shapes, mine, chosen[theirs])
        best = np.argmin(distance, axis=1)
        stand_in[mine], turn[mine] = theirs[best], turns[np.arange(len(mine)), best]
    stand_in[chosen], turn[chosen] = np.arange(len(chosen)), 0
    return stand_in, turn


def _placed(
    plants: Plants,
    shape: NDArray[np.int64],
    shapes: _Shapes,
    chosen: NDArray[np.int64],
    stand_in: NDArray[np.int64],
    turn: NDArray[np.int64],
) -> Prototypes:
    model, turns = stand_in[shape], turn[shape]
    own = chosen[model] == shape
    height, height_there = shapes.size_m[shape, 0], shapes.size_m[chosen[model], 0]
    stands = (height > 0) & (height_there > 0)
    ratio = np.divide(height, height_there, out=np.ones(len(plants)), where=stands)
    scale = np.where(own, plants.scale, np.clip(plants.scale * ratio, *SCALE_LIMITS))
    angle = np.radians(360.0 / kernel.SECTORS) * (turns % kernel.SECTORS)
    yaw = np.where(own, plants.yaw_rad, (plants.yaw_rad + np.where(plants.mirror, -angle, angle)) % (2 * np.pi))
    outline = kernel.outline_errors(
        shape, model, turns, plants.scale, scale, shapes.reach_m, shapes.reach_m[chosen]
    )  # fmt: skip
    tall = plants.scale * height
    short = np.abs(scale * height_there - tall)
    return Prototypes(
        skeleton_id=shapes.skeleton_id[chosen],
        species=shapes.species[chosen],
        model=model.astype(np.int32),
        yaw_rad=yaw,
        mirror=plants.mirror ^ (turns >= kernel.SECTORS),
        scale=scale,
        outline_error=np.where(own, 0.0, outline),
        height_error=np.where(own, 0.0, np.divide(short, tall, out=np.zeros(len(plants)), where=tall > 0)),
    )
