"""A kernel that grows nothing but poles: as quick as can be, and changed by all that may change a grove."""

import numpy as np

from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.growth.grove import DIED, GROWN, NO_ROOM, GrownGrove, season_count

STEP_M = 0.25


def grow_grove(grove, surroundings, traits, config):
    """Grow poles of one internode a season that lean by what stands around; keys decide which die or find no room."""
    seasons = np.minimum(season_count(grove.age_years), 250)
    outcome = np.full(len(grove), GROWN, dtype=np.int8)
    outcome[grove.keys % np.uint64(17) == 0] = DIED
    outcome[grove.keys % np.uint64(19) == 0] = NO_ROOM
    nodes = np.where(outcome == NO_ROOM, 0, seasons)
    first = np.append(0, np.cumsum(nodes + 1))
    node = np.concatenate([np.arange(count + 1) for count in nodes])
    lean = (len(surroundings.neighbour_xyz_m) % 7 + surroundings.solid_top_m.sum() % 5 + len(grove)) / 100.0
    death = np.where(outcome == DIED, (seasons + 1) // 2, 0)
    owner = np.repeat(np.arange(len(grove)), nodes + 1)
    skeletons = Skeletons(
        skeleton_id=np.arange(len(grove), dtype=np.int64),
        first=first,
        seasons=seasons.astype(np.int32),
        tip_radius_m=traits["tip_radius_m"][grove.species],
        pipe_exponent=traits["pipe_exponent"][grove.species],
        parent=(node - 1).astype(np.int32),
        xyz_m=np.column_stack([node * lean, node * 0.0, node * STEP_M]).astype(np.float32),
        order=np.zeros(len(node), dtype=np.uint8),
        birth_season=np.minimum(node, np.where(death > 0, death - 1, 255)[owner]).astype(np.uint8),
        death_season=np.where(outcome[owner] == DIED, death[owner], 0).astype(np.uint8),
    )
    lost = np.where(outcome == DIED, nodes, 0)
    return GrownGrove(
        skeletons=skeletons,
        outcome=outcome,
        death_season=death.astype(np.int32),
        generated=nodes,
        retained=nodes - lost,
        shed=lost,
        pruned=np.zeros_like(nodes),
        season_log=np.zeros((int(seasons.max()), len(grove), 4), dtype=np.float32),
        markers={"alive": 0, "taken": 0, "blocked": 0, "total": 0},
        live_bytes=0,
        grid_bytes=0,
    )
