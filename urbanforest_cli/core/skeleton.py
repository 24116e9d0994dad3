"""Plants as skeletons: flat arrays of internodes with parent pointers, parents first, metres, z up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core import skeleton_kernel
from urbanforest_cli.core.errors import SchemaError

ALIVE = 0
POSITION_STEP_M = 0.005  # grid of positions in files
REACH_M = 163.0  # no plant reaches further from its root; positions in files are 16-bit steps
SEASONS_MAX = 255
PIPE_EXPONENT_MIN, PIPE_EXPONENT_MAX = 1.0, 10.0
MEASURES = ("height_m", "crown_radius_m", "crown_base_m", "dbh_m", "internode_count")


@dataclass(frozen=True)
class Skeletons:
    """Several skeletons in flat arrays; nodes ``first[s]`` to ``first[s + 1]`` are those of skeleton s.

    A node is the upper end of an internode whose lower end is its parent; node 0 of a skeleton is the root collar at
    (0, 0, 0). Seasons count from planting: 1 is a plant's first, `seasons[s]` its last; 0 the planting itself.
    Wood that was lost stays in the arrays with the season of its loss, so that every earlier age, and the radius that
    remembers lost branches, can be read from one run.

    Parameters
    ----------
    skeleton_id
        (s,) unique.
    first
        (s + 1,) offsets.
    seasons
        (s,) how many seasons the plant lived through.
    tip_radius_m, pipe_exponent
        (s,) radius of a twig's end, exponent n of da Vinci's rule.
    parent
        (n,) index within the same skeleton, -1 for the root; always below the node's own.
    xyz_m
        (n, 3) relative to the root.
    order
        (n,) branching order: 0 trunk or stem.
    birth_season, death_season
        (n,) seasons; a death of 0 means alive.
    """

    skeleton_id: NDArray[np.int64]
    first: NDArray[np.int64]
    seasons: NDArray[np.int32]
    tip_radius_m: NDArray[np.float64]
    pipe_exponent: NDArray[np.float64]
    parent: NDArray[np.int32]
    xyz_m: NDArray[np.float32]
    order: NDArray[np.uint8]
    birth_season: NDArray[np.uint8]
    death_season: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.skeleton_id)

    def faults(self) -> list[str]:
        """Say in words all that breaks the requirements above; an empty list if nothing does."""
        found = self._shape_faults()
        if found:
            return found
        found = self._constant_faults()
        counts = skeleton_kernel.count_faults(
            self.first,
            self.seasons,
            self.parent,
            self.xyz_m,
            self.order,
            self.birth_season,
            self.death_season,
            REACH_M,
        )
        for kind, (count, row) in enumerate(counts):
            if count:
                skeleton = int(np.searchsorted(self.first, row, side="right")) - 1
                place = f"node {row - self.first[skeleton]} of skeleton {self.skeleton_id[skeleton]}"
                found.append(f"{skeleton_kernel.FAULTS[kind]}: {count}, the first at {place}")
        return found

    def check(self, *, where: object = None, next_step: str | None = None) -> None:
        """Check the requirements.

        Raises
        ------
        SchemaError
            With every fault found.
        """
        if found := self.faults():
            raise SchemaError(
                "skeletons break their requirements", where=where, found="; ".join(found), next_step=next_step
            )

    def _shape_faults(self) -> list[str]:
        found = []
        plants, nodes = len(self.skeleton_id), len(self.parent)
        for name in ("seasons", "tip_radius_m", "pipe_exponent"):
            if getattr(self, name).shape != (plants,):
                found.append(f"{name} has the shape {getattr(self, name).shape}, not {(plants,)}")
        for name in ("order", "birth_season", "death_season"):
            if getattr(self, name).shape != (nodes,):
                found.append(f"{name} has the shape {getattr(self, name).shape}, not {(nodes,)}")
        if self.xyz_m.shape != (nodes, 3):
            found.append(f"xyz_m has the shape {self.xyz_m.shape}, not {(nodes, 3)}")
        offsets = self.first
        if offsets.shape != (plants + 1,) or offsets[0] != 0 or offsets[-1] != nodes or (np.diff(offsets) < 1).any():
            found.append("offsets do not cut the nodes into skeletons of one node or more")
        return found

    def _constant_faults(self) -> list[str]:
        found = []
        if repeats := len(self.skeleton_id) - len(np.unique(self.skeleton_id)):
            found.append(f"skeleton_id repeats {repeats} values")
        if ((self.seasons < 0) | (self.seasons > SEASONS_MAX)).any():
            found.append(f"seasons leave 0 to {SEASONS_MAX}")
        if not ((self.tip_radius_m > 0) & (self.tip_radius_m <= 1)).all():
            found.append("tip_radius_m leaves 0 to 1")
        if not ((self.pipe_exponent >= PIPE_EXPONENT_MIN) & (self.pipe_exponent <= PIPE_EXPONENT_MAX)).all():
            found.append(f"pipe_exponent leaves {PIPE_EXPONENT_MIN:g} to {PIPE_EXPONENT_MAX:g}")
        return found

    def node_counts(self) -> NDArray[np.int64]:
        """Return (s,) nodes of each skeleton, its root among them."""
        return np.diff(self.first)


def no_skeletons() -> Skeletons:
    """Return none at all."""
    return Skeletons(
        skeleton_id=np.zeros(0, np.int64),
        first=np.zeros(1, np.int64),
        seasons=np.zeros(0, np.int32),
        tip_radius_m=np.zeros(0),
        pipe_exponent=np.zeros(0),
        parent=np.zeros(0, np.int32),
        xyz_m=np.zeros((0, 3), np.float32),
        order=np.zeros(0, np.uint8),
        birth_season=np.zeros(0, np.uint8),
        death_season=np.zeros(0, np.uint8),
    )


PLANT_FIELDS = ("skeleton_id", "seasons", "tip_radius_m", "pipe_exponent")
NODE_FIELDS = ("parent", "xyz_m", "order", "birth_season", "death_season")


def concatenate(parts: Sequence[Skeletons]) -> Skeletons:
    """Put skeletons behind each other."""
    if not parts:
        return no_skeletons()
    counts = np.concatenate([part.node_counts() for part in parts])
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in PLANT_FIELDS + NODE_FIELDS}
    return Skeletons(first=_offsets(counts), **arrays)


def select(skeletons: Skeletons, index: NDArray[np.integer] | Sequence[int]) -> Skeletons:
    """Return the skeletons at these places, in this order."""
    places = np.asarray(index, np.int64).reshape(-1)
    counts = skeletons.node_counts()[places]
    first = _offsets(counts)
    rows = np.arange(first[-1]) + np.repeat(skeletons.first[places] - first[:-1], counts)
    return Skeletons(
        first=first,
        **{name: getattr(skeletons, name)[places] for name in PLANT_FIELDS},
        **{name: getattr(skeletons, name)[rows] for name in NODE_FIELDS},
    )


def _offsets(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(counts, dtype=np.int64)])


def preorder(skeletons: Skeletons) -> NDArray[np.int64]:
    """Return rows of nodes in depth-first order, each axis whole before its branches.

    Of children the one of the lowest order comes first, then the oldest, then the one that came first before.
    """
    return skeleton_kernel.depth_first(skeletons.first, skeletons.parent, skeletons.order, skeletons.birth_season)


def quantise(skeletons: Skeletons) -> Skeletons:
    """Return the skeletons as a file gives them back: nodes in `preorder`, positions on the grid of 5 mm.

    Doing it twice is doing it once.
    """
    rows = preorder(skeletons)
    root = np.repeat(skeletons.first[:-1], skeletons.node_counts())
    place = np.empty(len(rows), np.int64)
    place[rows] = np.arange(len(rows))
    parent = skeletons.parent[rows]  # the root is first in either order, so its -1 stays
    parent = np.where(parent < 0, -1, place[root + np.maximum(parent, 0)] - root).astype(np.int32)
    return replace(
        skeletons,
        parent=parent,
        xyz_m=metres(steps(skeletons.xyz_m[rows])),
        order=skeletons.order[rows],
        birth_season=skeletons.birth_season[rows],
        death_season=skeletons.death_season[rows],
    )


def steps(xyz_m: NDArray[np.floating]) -> NDArray[np.int16]:
    """Return positions in whole steps of 5 mm.

    Raises
    ------
    SchemaError
        Some are no numbers or further than `REACH_M` from the root.
    """
    if not (np.abs(xyz_m) <= REACH_M).all():
        raise SchemaError("positions that are no numbers or too far from the root", expected=f"within {REACH_M:g} m")
    return np.rint(np.asarray(xyz_m, np.float64) / POSITION_STEP_M).astype(np.int16)


def metres(xyz_steps: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return positions in metres."""
    return (xyz_steps * POSITION_STEP_M).astype(np.float32)


def standing(skeletons: Skeletons, season_end: NDArray[np.integer] | None = None) -> NDArray[np.bool_]:
    """Tell of each node whether it stood at the end of a season (s,), by default the last."""
    season = np.repeat(_season_end(skeletons, season_end), skeletons.node_counts())
    lost = (skeletons.death_season != ALIVE) & (skeletons.death_season <= season)
    there: NDArray[np.bool_] = (skeletons.birth_season <= season) & ~lost
    return there


def pipe_count(skeletons: Skeletons, season_end: NDArray[np.integer] | None = None) -> NDArray[np.int32]:
    """Count the twig ends at or above each node, among nodes born by the end of a season (s,), by default the last.

    Lost wood counts as long as the plant lives: that is how a trunk remembers it. At every node this is the larger of
    1 and the sum over its children; 0 at nodes not yet born.
    """
    season = _season_end(skeletons, season_end)
    return skeleton_kernel.count_pipes(skeletons.first, skeletons.parent, skeletons.birth_season, season)


def radius_m(skeletons: Skeletons, season_end: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
    """Return the radius of each internode by da Vinci's rule, at the end of a season (s,); 0 at nodes not yet born.

    A branch has the section of its parts: r^n = sum of r_i^n, so that r = tip_radius_m * pipes^(1/n).
    """
    counts = skeletons.node_counts()
    pipes = pipe_count(skeletons, season_end).astype(np.float64)
    return np.repeat(skeletons.tip_radius_m, counts) * pipes ** np.repeat(1.0 / skeletons.pipe_exponent, counts)


def measure(
    skeletons: Skeletons, season_end: NDArray[np.integer] | None = None
) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
    """Measure plants as they stood at the end of a season (s,), by default the last; all zero where nothing stood.

    Returns
    -------
    dict of (s,) arrays
        `height_m` of the highest node; `crown_radius_m`, mean over eight sectors of the largest distance of a node
        from the root's vertical; `crown_base_m`, the lowest height at which a branch leaves the trunk or a stem that
        bears 3 % of the standing internodes (half of the largest branch where none has 3 %); `dbh_m`, the diameter
        at 1.3 m of a circle with the section of all stems (where none of them is that high, of the thickest branch
        that is); `internode_count` of standing internodes.
    """
    sizes = skeleton_kernel.measure_all(
        skeletons.first,
        skeletons.parent,
        skeletons.xyz_m,
        skeletons.order,
        skeletons.birth_season,
        skeletons.death_season,
        skeletons.tip_radius_m,
        skeletons.pipe_exponent,
        _season_end(skeletons, season_end),
    )
    measures: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
        name: sizes[:, column].copy() for column, name in enumerate(MEASURES)
    }
    measures["internode_count"] = sizes[:, skeleton_kernel.INTERNODES].astype(np.int64)
    return measures


def _season_end(skeletons: Skeletons, season_end: NDArray[np.integer] | None) -> NDArray[np.int32]:
    return skeletons.seasons if season_end is None else np.asarray(season_end, np.int32)
