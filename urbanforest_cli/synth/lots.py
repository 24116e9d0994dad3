"""Lots: blocks cut into rows, rows into lots, with corner, flag and L-shaped ones, enclaves and pieces across a path.

Within a block lots are laid out on its own axes, on which their borders are straight and shared; so neighbours meet
exactly. Lots of blocks at a district's border are cut to it, and what gets too small goes to a neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.blocks import Blocks
from urbanforest_cli.synth.plan import CENTRE, DENSE, GARDEN, INDUSTRIAL, PARK, SUBURB, Floats, Geometries, Plan

Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

PLAIN, FLAG, STEPPED, ACROSS_PATH, ENCLAVE, GREEN, CAMPUS = range(7)
"""What a lot is besides a piece of a row; GREEN and CAMPUS are whole blocks or halves of them."""

#           width, spread of widths, share of blocks with lots at their short ends, share of greens and of campuses
_HABITS = {
    CENTRE: (31.0, 0.30, 0.0, 0.06, 0.03),
    DENSE: (15.5, 0.22, 0.35, 0.035, 0.035),
    SUBURB: (15.4, 0.16, 0.5, 0.03, 0.015),
    GARDEN: (18.5, 0.2, 0.3, 0.03, 0.01),
    INDUSTRIAL: (58.0, 0.35, 0.0, 0.02, 0.0),
    PARK: (200.0, 0.0, 0.0, 1.0, 0.0),
}
_SMALLEST_M2 = 70.0
_POLE_M = 3.8
_PATH_M = 3.0


@dataclass(frozen=True)
class Lots:
    """Lots with what their buildings need to know of them."""

    shapes: Geometries  # (lots,) polygons, rarely multipolygons
    block: Integers  # (lots,)
    use: Integers  # (lots,) of the district
    kind: Integers  # (lots,) PLAIN ... CAMPUS
    site: Floats  # (lots, 4, 2) where to build: front left, front right, back right, back left
    pole: Floats  # (lots, 4, 2) way of a flag lot from the street to the site, NaN elsewhere
    corner: Booleans  # (lots,) stands at the end of its row
    cut: Booleans  # (lots,) was cut to its district

    def take(self, index: NDArray[np.integer] | Booleans) -> Lots:
        """Return some of the lots."""
        return Lots(*(getattr(self, column.name)[index] for column in fields(self)))

    def __len__(self) -> int:
        return len(self.shapes)

    @classmethod
    def joined(cls, parts: list[Lots]) -> Lots:
        """Return the lots of several lists."""
        return cls(*(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls)))


@dataclass(frozen=True)
class _Rows:
    """Strips of a block that one side of a street opens up; a place in it is (s along the street, t away from it)."""

    block: Integers
    origin: Floats  # (rows, 2) in the block's u, v
    along: Floats
    inward: Floats
    length_m: Floats
    depth_m: Floats
    count: Integers  # lots to make

    def points(self, blocks: Blocks, row: Integers, s: Floats, t: Floats) -> Floats:
        """Return (n, k, 2) points of (n,) rows at (n, k) places."""
        uv = (
            self.origin[row][:, None]
            + s[..., None] * self.along[row][:, None]
            + t[..., None] * self.inward[row][:, None]
        )  # fmt: skip
        wide = np.broadcast_to(self.block[row][:, None], s.shape)
        return blocks.at(wide, uv[..., 0], uv[..., 1])

    def boxes(self, blocks: Blocks, row: Integers, s0: Floats, s1: Floats, t0: Any, t1: Any) -> Floats:
        """Return (n, 4, 2) corners of the pieces of rows between s0 and s1, t0 and t1."""
        t0, t1 = np.broadcast_to(t0, s0.shape), np.broadcast_to(t1, s0.shape)
        return self.points(blocks, row, np.stack((s0, s1, s1, s0), 1), np.stack((t0, t0, t1, t1), 1))


def make_lots(blocks: Blocks, plan: Plan, rng: np.random.Generator) -> Lots:
    """Cut all blocks into lots."""
    rows, kind = _make_rows(blocks, rng)
    row = np.repeat(np.arange(len(rows.count)), rows.count)
    spread = np.array([_HABITS[use][1] for use in range(len(_HABITS))])[blocks.use[rows.block[row]]]
    weight = np.exp(rng.normal(0, 1, len(row)) * spread)
    s0, s1 = _shares(row, weight, len(rows.count))
    cut = ~_whole_rows(blocks, plan, rows)[row]
    plain = _whole_lots(blocks, rows, row[~cut], s0[~cut], s1[~cut], kind[row[~cut]], rng)
    bordering = _cut_lots(blocks, plan, rows, row[cut], s0[cut], s1[cut], kind[row[cut]])
    return _with_enclaves(Lots.joined([plain, bordering]), rng)


def _whole_rows(blocks: Blocks, plan: Plan, rows: _Rows) -> Booleans:
    """Tell which rows lie within their district's region."""
    whole = blocks.whole[rows.block]
    row = np.flatnonzero(~whole)
    boxes = shapely.polygons(rows.boxes(blocks, row, np.zeros(len(row)), np.ones(len(row)), 0.0, 1.0))
    whole[row] = shapely.contains_properly(plan.regions[blocks.district[rows.block[row]]], boxes)
    return whole


def _make_rows(blocks: Blocks, rng: np.random.Generator) -> tuple[_Rows, Integers]:
    """Divide blocks into rows, and say of each row what its lots are."""
    count = len(blocks.district)
    habits = np.array([_HABITS[use] for use in range(len(_HABITS))])[blocks.use]
    width, ends, green, campus = habits[:, 0], habits[:, 2], habits[:, 3], habits[:, 4]
    sides_m = np.linalg.norm(np.roll(blocks.corners, -1, axis=1) - blocks.corners, axis=2)
    length_m, depth_m = (sides_m[:, 0] + sides_m[:, 2]) / 2, (sides_m[:, 1] + sides_m[:, 3]) / 2
    chance = rng.random(count)
    is_green = chance < green
    is_campus = ~is_green & (chance < green + campus)
    divided = ~is_green & ~is_campus
    middle = rng.uniform(0.46, 0.54, count)
    cap_m = rng.uniform(22, 28, count)
    capped = divided & (rng.random(count) < ends) & (length_m > 95)
    cap = np.where(capped, cap_m / length_m, 0.0)
    zero, one = np.zeros(count), np.ones(count)

    def rows_of(chosen: Booleans, origin: Any, along: Any, inward: Any, lot_m: Any, whole: bool = False) -> _Rows:
        index = np.flatnonzero(chosen)
        pairs = [np.column_stack(np.broadcast_arrays(*pair))[index] for pair in (origin, along, inward)]
        scale = np.column_stack((length_m, depth_m))[index]
        row_m, deep_m = np.abs(pairs[1] * scale).sum(axis=1), np.abs(pairs[2] * scale).sum(axis=1)
        number = np.ones(len(index)) if whole else np.maximum(np.rint(row_m / np.broadcast_to(lot_m, count)[index]), 1)
        return _Rows(index, pairs[0], pairs[1], pairs[2], row_m, deep_m, number.astype(np.int64))

    parts = [
        (rows_of(divided, (cap, zero), (1 - 2 * cap, zero), (zero, middle), width), PLAIN),
        (rows_of(divided, (1 - cap, one), (2 * cap - 1, zero), (zero, middle - 1), width), PLAIN),
        (rows_of(capped, (zero, one), (zero, -one), (cap, zero), width), PLAIN),
        (rows_of(capped, (one, zero), (zero, one), (-cap, zero), width), PLAIN),
        (rows_of(is_green, (zero, zero), (one, zero), (zero, one), width, whole=True), GREEN),
        (rows_of(is_campus, (zero, zero), (one, zero), (zero, one), np.maximum(length_m / 2, 1.0)), CAMPUS),
    ]
    rows = _Rows(*(np.concatenate([getattr(part, c.name) for part, _ in parts]) for c in fields(_Rows)))
    return rows, np.repeat([kind for _, kind in parts], [len(part.block) for part, _ in parts])


def _shares(row: Integers, weight: Floats, row_count: int) -> tuple[Floats, Floats]:
    """Divide each row's 0 to 1 in proportion to its lots' weights."""
    total = np.bincount(row, weight, minlength=row_count)
    end = np.cumsum(weight)
    before = np.concatenate(([0.0], np.cumsum(total)))[row]
    s1 = (end - before) / total[row]
    last = np.append(row[1:] != row[:-1], True) if len(row) else np.zeros(0, dtype=bool)
    s1[last] = 1.0
    s0 = np.empty_like(s1)
    s0[1:] = s1[:-1]
    s0[np.append(True, row[1:] != row[:-1])[: len(row)]] = 0.0
    return s0, s1


def _ends(row: Integers) -> Booleans:
    first = np.append(True, row[1:] != row[:-1])[: len(row)]
    last = np.append(row[1:] != row[:-1], True)[: len(row)]
    return np.asarray(first | last)


def _no_pole(count: int) -> Floats:
    return np.full((count, 4, 2), np.nan)


def _whole_lots(
    blocks: Blocks, rows: _Rows, row: Integers, s0: Floats, s1: Floats, row_kind: Integers, rng: np.random.Generator
) -> Lots:
    """Make the lots of blocks that nothing cuts; here and there two neighbours share their ground in another way."""
    count = len(row)
    corner = _ends(row)
    chance = rng.random(count)
    width_m = (s1 - s0) * rows.length_m[row]
    number = np.arange(count)
    first = (number % 2 == 0) & (np.append(row[1:] == row[:-1], False)[:count])
    pair_m = width_m + np.append(width_m[1:], 0.0)[:count]
    first &= (row_kind == PLAIN) & (pair_m > 24) & (rows.depth_m[row] > 24)
    flag = first & (chance < 0.08)
    step = first & ~flag & (chance < 0.12)
    second_of_flag, second_of_step = np.append(False, flag[:-1])[:count], np.append(False, step[:-1])[:count]
    paired = flag | step | second_of_flag | second_of_step
    across = ~paired & (row_kind == PLAIN) & (rows.depth_m[row] > 24) & (chance > 0.99)

    kind = row_kind.copy()
    kind[flag] = FLAG
    kind[step | second_of_step] = STEPPED
    kind[across] = ACROSS_PATH
    shapes = np.empty(count, dtype=object)
    site = rows.boxes(blocks, row, s0, s1, 0.0, 1.0)
    pole = _no_pole(count)
    plain = ~paired & ~across
    shapes[plain] = shapely.polygons(site[plain])

    i = np.flatnonzero(flag)  # the lot behind, with its pole at the low end; the one in front follows it
    r, a, b = row[i], s0[i], s1[i + 1]
    p = a + _POLE_M / rows.length_m[r]
    f = rng.uniform(0.5, 0.58, len(i))
    zero, one = np.zeros(len(i)), np.ones(len(i))
    shapes[i] = _polygons(rows, blocks, r, (a, p, p, b, b, a), (zero, zero, f, f, one, one))
    site[i] = rows.boxes(blocks, r, a, b, f, 1.0)
    pole[i] = rows.boxes(blocks, r, a, p, 0.0, f)
    site[i + 1] = rows.boxes(blocks, r, p, b, 0.0, f)
    shapes[i + 1] = shapely.polygons(site[i + 1])

    i = np.flatnonzero(step)
    r, a, b = row[i], s0[i], s1[i + 1]
    f = rng.uniform(0.6, 0.72, len(i))
    low = a + (b - a) * rng.uniform(0.52, 0.62, len(i))
    high = a + (b - a) * rng.uniform(0.34, 0.44, len(i))
    zero, one = np.zeros(len(i)), np.ones(len(i))
    shapes[i] = _polygons(rows, blocks, r, (a, low, low, high, high, a), (zero, zero, f, f, one, one))
    shapes[i + 1] = _polygons(rows, blocks, r, (low, b, b, high, high, low), (zero, zero, one, one, f, f))
    site[i] = rows.boxes(blocks, r, a, low, 0.0, f)
    site[i + 1] = rows.boxes(blocks, r, low, b, 0.0, 1.0)

    i = np.flatnonzero(across)
    f = rng.uniform(0.6, 0.68, len(i))
    site[i] = rows.boxes(blocks, row[i], s0[i], s1[i], 0.0, f)
    behind = rows.boxes(blocks, row[i], s0[i], s1[i], f + _PATH_M / rows.depth_m[row[i]], 1.0)
    if len(i):
        pieces = np.asarray(shapely.polygons(np.stack((site[i], behind), axis=1).reshape(-1, 4, 2)))
        shapes[i] = shapely.multipolygons(pieces, indices=np.repeat(np.arange(len(i)), 2))
    block = rows.block[row]
    return Lots(shapes, block, blocks.use[block], kind, site, pole, corner, np.zeros(count, dtype=bool))


def _polygons(rows: _Rows, blocks: Blocks, row: Integers, s: tuple[Floats, ...], t: tuple[Floats, ...]) -> Geometries:
    return np.asarray(shapely.polygons(rows.points(blocks, row, np.stack(s, 1), np.stack(t, 1))))


def _cut_lots(
    blocks: Blocks, plan: Plan, rows: _Rows, row: Integers, s0: Floats, s1: Floats, row_kind: Integers
) -> Lots:
    """Cut the lots of bordering blocks to their district; one left too small is joined to its larger neighbour."""
    nominal_m2 = rows.length_m[row] * rows.depth_m[row] * (s1 - s0)
    regions = plan.regions[blocks.district[rows.block[row]]]
    shapes = np.empty(len(row), dtype=object)
    stale = np.ones(len(row), dtype=bool)
    for _ in range(3):
        shapes[stale] = shapely.intersection(
            shapely.polygons(rows.boxes(blocks, row[stale], s0[stale], s1[stale], 0.0, 1.0)), regions[stale]
        )
        area = shapely.area(shapes)
        stale = np.zeros(len(row), dtype=bool)
        small = (area < 0.55 * nominal_m2) & (row_kind == PLAIN)
        before = np.append(False, row[1:] == row[:-1])[: len(row)]
        after = np.append(row[1:] == row[:-1], False)[: len(row)]
        area_before = np.where(before, np.append(0.0, area[:-1])[: len(row)], -1.0)
        area_after = np.where(after, np.append(area[1:], 0.0)[: len(row)], -1.0)
        target = np.arange(len(row)) + np.where(area_before >= area_after, -1, 1)
        joins = np.flatnonzero(small & (before | after) & (area > 0))
        joins = joins[(area[target[joins]] > area[joins]) & ~small[target[joins]]]
        if not len(joins):
            break
        np.minimum.at(s0, target[joins], s0[joins])
        np.maximum.at(s1, target[joins], s1[joins])
        stale[target[joins]] = True
        keep = np.ones(len(row), dtype=bool)
        keep[joins] = False
        row, row_kind, s0, s1, nominal_m2 = row[keep], row_kind[keep], s0[keep], s1[keep], nominal_m2[keep]
        regions, shapes, stale = regions[keep], shapes[keep], stale[keep]
    if stale.any():
        shapes[stale] = shapely.intersection(
            shapely.polygons(rows.boxes(blocks, row[stale], s0[stale], s1[stale], 0.0, 1.0)), regions[stale]
        )
    pieces, of = shapely.get_parts(shapes, return_index=True)
    good = (shapely.get_type_id(pieces) == 3) & (shapely.area(pieces) >= _SMALLEST_M2)
    good &= shapely.area(pieces) > 1.6 * shapely.length(pieces)  # no slivers
    pieces, of = pieces[good], of[good]
    block = rows.block[row[of]]
    site = rows.boxes(blocks, row[of], s0[of], s1[of], 0.0, 1.0)
    cut = shapely.area(pieces) < 0.999 * shapely.area(shapely.polygons(site))
    return Lots(
        pieces, block, blocks.use[block], row_kind[of], site, _no_pole(len(of)), _ends(row)[of], np.asarray(cut)
    )


def _with_enclaves(lots: Lots, rng: np.random.Generator) -> Lots:
    """Take a small lot, a substation or a pumping house, out of the ground of some large ones."""
    chance = rng.random(len(lots))
    large = (lots.kind == PLAIN) & ~lots.cut & (shapely.area(lots.shapes) > 1000) & (chance < 0.08)
    index = np.flatnonzero(large)
    s, t = rng.uniform(0.58, 0.7, len(index)), rng.uniform(0.6, 0.7, len(index))
    side_s, side_t = rng.uniform(0.14, 0.2, len(index)), rng.uniform(0.14, 0.2, len(index))
    inner = np.stack(
        [
            _within(lots.site[index], s, t),
            _within(lots.site[index], s + side_s, t),
            _within(lots.site[index], s + side_s, t + side_t),
            _within(lots.site[index], s, t + side_t),
        ],
        axis=1,
    )
    if not len(index):
        return lots
    enclaves = np.asarray(shapely.polygons(inner))
    shapes = lots.shapes.copy()
    shapes[index] = shapely.difference(shapes[index], enclaves)
    small = Lots(
        enclaves, lots.block[index], lots.use[index], np.full(len(index), ENCLAVE), inner, _no_pole(len(index)),
        np.zeros(len(index), dtype=bool), np.zeros(len(index), dtype=bool),
    )  # fmt: skip
    return Lots.joined([replace(lots, shapes=shapes), small])


def _within(site: Floats, s: Floats, t: Floats) -> Floats:
    s, t = s[:, None], t[:, None]
    return np.asarray((site[:, 0] * (1 - s) + site[:, 1] * s) * (1 - t) + (site[:, 3] * (1 - s) + site[:, 2] * s) * t)


def dig_ponds(lots: Lots, rng: np.random.Generator) -> tuple[Lots, Geometries]:
    """Dig a pond into some of the greens; the lots get a hole, and the ponds come back."""
    area = shapely.area(lots.shapes)
    green = ((lots.kind == GREEN) | (lots.use == PARK)) & (area > 2500) & (rng.random(len(lots)) < 0.85)
    index = np.flatnonzero(green)
    middle = shapely.get_coordinates(shapely.point_on_surface(lots.shapes[index]))
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    radius_m = np.sqrt(area[index])[:, None] * rng.uniform(0.10, 0.16, len(index))[:, None]
    waves = rng.uniform(0, 2 * np.pi, (2, len(index), 1))
    radius_m = radius_m * (1 + 0.22 * np.sin(2 * angles + waves[0]) + 0.10 * np.sin(3 * angles + waves[1]))
    shore = middle[:, None] + radius_m[..., None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    ponds = np.asarray(shapely.polygons(shore)) if len(index) else np.empty(0, dtype=object)
    inside = shapely.contains_properly(lots.shapes[index], ponds)
    shapes = lots.shapes.copy()
    shapes[index[inside]] = shapely.difference(shapes[index[inside]], ponds[inside])
    return replace(lots, shapes=shapes), ponds[inside]


def nearest_lots(lots: Lots, blocks: Blocks, count: int) -> tuple[Lots, Blocks]:
    """Keep exactly `count` lots: whole blocks from the centre outwards, and of the last one what is needed.

    The lots come back ordered by block, and only blocks that have lots.
    """
    distance_m = np.hypot(*blocks.centres().T)
    nearest = np.lexsort((np.arange(len(lots)), lots.block, distance_m[lots.block]))[:count]
    kept = lots.take(nearest[np.lexsort((nearest, lots.block[nearest]))])
    used, block = np.unique(kept.block, return_inverse=True)
    return replace(kept, block=block), blocks.take(used)
