"""Grow a grove: what stands around it becomes grids, its plants grow season by season, skeletons come out.

The developmental model is that of Palubicki et al. 2009 (Self-organizing tree models for image synthesis) with the
species parameters of Stava et al. 2014 (Inverse procedural modelling of trees), as the paper's section Developmental
Plant Model asks: shadow voxels carry light, markers carry room, buildings block and shade.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.growth.grove import (
    COLUMN_M,
    SKY_CELL_M,
    Grove,
    GrownGrove,
    Surroundings,
    TraitsTable,
    season_count,
)
from urbanforest_cli.growth.marker_kernel import NOBODY, marker_jitter
from urbanforest_cli.growth.season_kernel import grow_seasons
from urbanforest_cli.growth.state_kernel import BLOCKED, FREE, RAY_REACH, SHADE_UNIT, TAKEN, Grids, Nodes, Plants

PRUNING_SHAPES = ("box", "ellipsoid")
NEIGHBOUR_LEAF_SHADE, NEIGHBOUR_SHADE_DECAY = 0.045, 1.8  # of plants of other groves, whatever their species
KERNELS = (grow_seasons,)


def grow_grove(grove: Grove, surroundings: Surroundings, traits: TraitsTable, config: Growth) -> GrownGrove:
    """Grow the plants of a grove jointly to their ages.

    The result depends on the arguments alone; each plant's chance is its own key's, so that another order of the
    plants gives each the same skeleton.

    Parameters
    ----------
    grove
        The plants.
    surroundings
        Frame, buildings, light and the plants of other groves.
    traits
        Growth parameters, a row a species.
    config
        Environment, bud fate and pruning.
    """
    order = np.argsort(grove.keys, kind="stable")
    plants = _plants(grove, order, surroundings, config)
    senses_shade = config.environment in ("both", "shadow")
    senses_room = config.environment in ("both", "markers")
    grids = _grids(surroundings, traits, config, senses_shade, senses_room)
    rule = (
        senses_shade,
        senses_room,
        config.fate == "priority",
        float(config.marker_range_internodes),
        float(config.marker_radius_internodes),
        float(np.cos(np.radians(min(config.perception_angle_deg, 180.0) / 2))),
        PRUNING_SHAPES.index(config.pruning_shape),
    )
    nodes, count, log, live_bytes = grow_seasons(
        plants,
        traits,
        grids,
        surroundings.neighbour_xyz_m,
        surroundings.neighbour_season,
        surroundings.neighbour_internodes,
        rule,
    )
    given = np.empty_like(order)
    given[order] = np.arange(len(order))
    skeletons = _skeletons(nodes, count, plants, given, traits)
    generated = plants.node_count[given]
    states = np.bincount(grids.marker, minlength=3) if senses_room else np.zeros(3, dtype=np.int64)
    return GrownGrove(
        skeletons=skeletons,
        outcome=plants.state[given],
        death_season=plants.death[given],
        generated=generated,
        retained=generated - plants.shed[given] - plants.pruned[given],
        shed=plants.shed[given],
        pruned=plants.pruned[given],
        season_log=log[:, given],
        markers={
            "alive": int(states[FREE]),
            "taken": int(states[TAKEN]),
            "blocked": int(states[BLOCKED]),
            "total": len(grids.marker) if senses_room else 0,
        },
        live_bytes=int(live_bytes),
        grid_bytes=sum(grid.nbytes for grid in (grids.shade, grids.marker, grids.near, grids.owner)),
    )


def _plants(grove: Grove, order: NDArray[np.int64], surroundings: Surroundings, config: Growth) -> Plants:
    count = len(grove)
    seasons = season_count(grove.age_years)
    first_year = np.clip(grove.age_years - (seasons - 1), 0.25, 1.0)
    cut = np.where((grove.pruning_factor < 1.0), np.maximum(seasons - config.regrow_years, (seasons + 1) // 2), 0)
    return Plants(
        key=grove.keys[order],
        root_xy=(grove.xy_m[order] - surroundings.origin_m).astype(np.float32),
        species=grove.species[order].astype(np.int64),
        seasons=seasons[order],
        first_year=first_year[order],
        pruning_factor=grove.pruning_factor[order].astype(np.float64),
        clearance=grove.clearance_m[order].astype(np.float64),
        azimuth=grove.row_azimuth_rad[order].astype(np.float64),
        root=np.full(count, -1, dtype=np.int64),
        node_count=np.zeros(count, dtype=np.int64),
        now=np.zeros(count, dtype=np.int64),
        age=np.zeros(count),
        vitality=np.zeros(count),
        grown_at=np.zeros(count, dtype=np.int64),
        years=np.zeros(count),
        dark=np.zeros(count, dtype=np.int64),
        state=np.zeros(count, dtype=np.int8),
        death=np.zeros(count, dtype=np.int32),
        pruned_at=cut[order],
        shed=np.zeros(count, dtype=np.int64),
        pruned=np.zeros(count, dtype=np.int64),
        height=np.zeros(count, dtype=np.float32),
    )


def _grids(
    surroundings: Surroundings, traits: TraitsTable, config: Growth, senses_shade: bool, senses_room: bool
) -> Grids:
    depth = config.shade_depth_voxels
    voxel = config.voxel_m
    layers = np.arange(depth + 1)
    lean = np.rint(layers[:, None] * surroundings.shade_lean[None, :]).astype(np.int64)
    pad = int(max(depth + np.abs(lean).max(), max(RAY_REACH)) + 1)
    size = surroundings.size_m.astype(np.float64)
    counts = np.ceil(size / voxel).astype(np.int64)
    voxels = np.array([counts[2] + 1 + max(RAY_REACH), counts[1] + 2 * pad + 1, counts[0] + 2 * pad + 1])
    cast = traits["leaf_shade"][:, None] * traits["shade_decay"][:, None] ** -layers[None, :]
    others = NEIGHBOUR_LEAF_SHADE * NEIGHBOUR_SHADE_DECAY**-layers
    cast = np.vstack((cast, others))
    cells = np.ceil(size[::-1] / config.marker_spacing_m).astype(np.int64)
    marker_count = int(cells.prod()) if senses_room else 1
    return Grids(
        shade=np.zeros(int(voxels.prod()) if senses_shade else 1, dtype=np.int32),
        voxel_shape=voxels,
        voxel_m=float(voxel),
        pad=pad,
        lean=lean,
        cast=np.rint(cast * SHADE_UNIT).astype(np.int32),
        marker=np.zeros(marker_count, dtype=np.uint8),
        marker_shape=cells,
        marker_m=float(config.marker_spacing_m),
        jitter=marker_jitter(config.marker_spacing_m),
        near=np.full(marker_count, NOBODY, dtype=np.float32),
        owner=np.zeros(marker_count, dtype=np.int32),
        solid_top=surroundings.solid_top_m,
        column_m=COLUMN_M,
        sky=surroundings.sky,
        sky_m=SKY_CELL_M,
        ray=surroundings.ray,
        ray_light=surroundings.ray_light,
        ray_step=_ray_steps(surroundings.ray, voxels),
        size=size,
    )


def _ray_steps(ray: NDArray[np.float32], voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    steps = np.rint(ray[:, None, :].astype(np.float64) * np.array(RAY_REACH)[None, :, None]).astype(np.int64)
    strides = np.array([1, voxels[2], voxels[1] * voxels[2]])
    return np.asarray((steps * strides).sum(axis=2))


def _skeletons(nodes: Nodes, count: int, plants: Plants, given: NDArray[np.int64], traits: TraitsTable) -> Skeletons:
    """Sort internodes by plant, in the order the grove was given; within a plant they stay as they grew."""
    plant = nodes.plant[:count]
    rank = np.empty(len(given), dtype=np.int64)
    rank[given] = np.arange(len(given))
    by_plant = np.argsort(rank[plant], kind="stable")
    parent = nodes.parent[:count][by_plant]
    serial = nodes.serial[:count]
    species = plants.species[given]
    sizes = plants.node_count[given] + 1
    root = plants.root[given]
    xyz = nodes.xyz[:count][by_plant]
    start = np.zeros(len(given) + 1, dtype=np.int64)
    np.cumsum(sizes, out=start[1:])
    xyz -= np.repeat(nodes.xyz[root], sizes, axis=0)
    return Skeletons(
        skeleton_id=np.arange(len(given), dtype=np.int64),
        first=start,
        seasons=plants.seasons[given].astype(np.int32),
        tip_radius_m=traits["tip_radius_m"][species],
        pipe_exponent=traits["pipe_exponent"][species],
        parent=np.where(parent < 0, -1, serial[parent]).astype(np.int32),
        xyz_m=xyz,
        order=nodes.order[:count][by_plant],
        birth_season=nodes.birth[:count][by_plant],
        death_season=nodes.death[:count][by_plant],
    )
