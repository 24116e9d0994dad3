"""Random branching plants of realistic statistics, for tests of what is done with skeletons; nobody's growth model."""

from __future__ import annotations

import numpy as np

from urbanforest_cli.core.skeleton import Skeletons

INTERNODE_M = 0.3
TURN = 0.07  # standard deviation, about 4 degrees, of each component of an internode's direction
LOST = 0.4  # share of internodes on wood that is lost before the end


def branching(number: int, internodes: int, *, seasons: int = 40, stems: int = 1, seed: int = 0) -> Skeletons:
    """Grow one plant in the order of its births, parents first, with about that many internodes in all."""
    rng = np.random.default_rng([seed, number])
    parent, xyz, order, birth = [-1], [np.zeros(3)], [0], [0]
    tips = []
    for stem in range(stems):
        lean = 0.4 if stems > 1 else 0.0
        angle = 2 * np.pi * stem / stems
        tips.append((0, np.array([lean * np.cos(angle), lean * np.sin(angle), 1.0]), 0))
    for season in range(1, seasons + 1):
        rest = (internodes - len(parent)) / max(1, seasons - season + 1)
        flush = min(1.0, rest / max(1, len(tips)))
        grown = []
        for node, direction, rank in tips:
            if rng.random() > flush and rank:
                if rng.random() > 0.3:
                    grown.append((node, direction, rank))
                continue
            last = node
            length = INTERNODE_M * rng.uniform(0.5, 1.0) * 0.9**rank
            for _ in range(1 + (rng.random() < 0.6) + (rank == 0 and rng.random() < 0.5)):
                direction = direction + rng.normal(0, TURN, 3) + [0, 0, 0.03]
                direction = direction / np.linalg.norm(direction)
                parent.append(last)
                xyz.append(xyz[last] + length * direction)
                order.append(rank)
                birth.append(season)
                last = len(parent) - 1
                if rng.random() < 0.7 and rank < 8:
                    side = np.cross(direction, rng.normal(size=3))
                    side = direction + side / np.linalg.norm(side)
                    grown.append((last, side / np.linalg.norm(side), rank + 1))
            grown.append((last, direction, rank))
        tips = grown
    return _lose(number, parent, xyz, order, birth, seasons, rng)


def _lose(number, parent, xyz, order, birth, seasons, rng) -> Skeletons:
    """Shed whole branches, small ones rather than large, until a share of the internodes is lost."""
    count = len(parent)
    above = np.ones(count, int)
    for node in range(count - 1, 0, -1):
        above[parent[node]] += above[node]
    death = np.zeros(count, int)
    children = [[] for _ in parent]
    for node in range(1, count):
        children[parent[node]].append(node)
    starts = [n for n in range(1, count) if order[n] > order[parent[n]] and above[n] < 0.03 * count + 2]
    rng.shuffle(starts)
    for start in starts:
        if (death > 0).mean() >= LOST:
            break
        season = int(rng.integers(birth[start], seasons + 1))
        stack = [start]
        while stack:
            node = stack.pop()
            if death[node] == 0 or death[node] > season:
                death[node] = season
                stack += children[node]
    birth = np.where(death > 0, np.minimum(birth, death), birth)  # nothing is born on wood already lost
    return Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, count]),
        seasons=np.array([seasons], np.int32),
        tip_radius_m=np.array([0.006]),
        pipe_exponent=np.array([2.2]),
        parent=np.array(parent, np.int32),
        xyz_m=np.array(xyz, np.float32),
        order=np.array(order, np.uint8),
        birth_season=birth.astype(np.uint8),
        death_season=death.astype(np.uint8),
    )
