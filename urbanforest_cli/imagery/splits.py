"""Which pairs show the same place, and which are learnt from: split by place, never by tile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from urbanforest_cli.core.randomness import key_for
from urbanforest_cli.imagery.pairs import PairSet

SHARED_LEAST = 0.01
"""Share of the smaller footprint from which on an overlap is one, and no touching edge or rounding."""


@dataclass(frozen=True)
class Split:
    """Indices of pairs, each in order.

    Parameters
    ----------
    training, validation
        Learnt from, and looked at while learning.
    held_out
        Fit a pattern; never looked at.
    dropped
        Fit no pattern but show a place of some that do.
    """

    training: tuple[int, ...]
    validation: tuple[int, ...]
    held_out: tuple[int, ...]
    dropped: tuple[int, ...]


def places_of(names: Sequence[str], footprints: Sequence[shapely.Polygon | None]) -> tuple[str, ...]:
    """Return the place of each pair: the alphabetically first name among those whose footprints hang together.

    Footprints hang together where they overlap by more than a hundredth of the smaller, also over others between
    them. Mere neighbours that touch are places of their own, or the blocks of a mosaic would all be one.

    Parameters
    ----------
    names
        Of the pairs, all different.
    footprints
        In one CRS; None for a pair without a place on the map, which is then one of its own.
    """
    shapes = np.array(list(footprints), dtype=object)
    known = np.flatnonzero([shape is not None for shape in footprints])
    tree = shapely.STRtree(shapes[known])
    first, second = (known[found] for found in tree.query(shapes[known], predicate="intersects"))
    area = np.full(len(shapes), np.nan)
    area[known] = shapely.area(shapes[known])
    shared = shapely.area(shapely.intersection(shapes[first], shapes[second]))
    linked = shared > SHARED_LEAST * np.minimum(area[first], area[second])
    links = coo_matrix((np.ones(linked.sum()), (first[linked], second[linked])), shape=(len(names), len(names)))
    _, parts = connected_components(links, directed=False)
    leader: dict[int, str] = {}
    for part, name in zip(parts.tolist(), names, strict=True):
        leader[part] = min(name, leader.get(part, name))
    return tuple(leader[part] for part in parts.tolist())


def split(pairs: PairSet, *, validation_fraction: float, hold_out: Sequence[str] = (), seed: int = 0) -> Split:
    """Part pairs into those learnt from, those to validate by and those held out.

    No place is in two of them. Places are drawn for validation one by one, in an order that hangs on the seed and each
    place's name alone, until the fraction is reached: at least one, and never the last.

    Parameters
    ----------
    validation_fraction
        Of the pairs that are neither held out nor dropped, 0 to 1; with 0 none are.
    hold_out
        Patterns of shells, such as ``rome_*``, which the group or the name of a pair fits.
    """
    held = [fits(pairs, index, hold_out) for index in range(len(pairs))]
    hidden = {pairs.places[index] for index, out in enumerate(held) if out}
    free = [index for index in range(len(pairs)) if not held[index] and pairs.places[index] not in hidden]
    dropped = [index for index in range(len(pairs)) if not held[index] and pairs.places[index] in hidden]
    members: dict[str, list[int]] = {}
    for index in free:
        members.setdefault(pairs.places[index], []).append(index)
    order = sorted(members, key=lambda place: (key_for(seed, "validation places", place), place))
    validation: list[int] = []
    for place in order[:-1]:
        if len(validation) >= validation_fraction * len(free):
            break
        validation += members[place]
    chosen = set(validation)
    return Split(
        training=tuple(index for index in free if index not in chosen),
        validation=tuple(sorted(validation)),
        held_out=tuple(index for index, out in enumerate(held) if out),
        dropped=tuple(dropped),
    )


def fits(pairs: PairSet, index: int, patterns: Sequence[str]) -> bool:
    """Tell whether the group or the name of a pair fits one of some patterns."""
    names = pairs.groups[index], pairs.names[index]
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
