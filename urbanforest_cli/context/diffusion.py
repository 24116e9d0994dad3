"""Context diffusion: a lot's values become a Gaussian-weighted mean over the lots around it (paper, eq. 4).

For a lot L with context radius xi and s = xi * sigma_fraction,

    value(L) = sum of w(d) value(K) / sum of w(d),   w(d) = exp(-d^2 / (2 s^2)),

over the lots K with a centre within xi of L's, L itself included with weight 1. The paper leaves s open and does not
normalise; the mean here is normalised, so that a city of equal values stays as it is. The radius is the *receiving*
lot's, hence weights are not symmetric and totals are not conserved.

Parameters that only some strategies use are averaged over the lots that use them, and only those lots change.
Orientations are averaged as directions of period 90 degrees, for a square lattice turned by 90 degrees is the same
lattice. Counts are averaged as numbers and rounded up or down by chance at the very end, so that their expected
value is the mean.

The kernel walks strips of lots and adds all parameters of a pair in one go; no list of pairs is kept. Terms are
differences to the lot's own value, summed in an order of place alone, so that row order does not matter to the last
bit, and a lot whose whole context agrees keeps its value to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import hash_uniform, keys_for

STRIP_HEIGHT_M = 50.0
REACH_TOLERANCE_M = 1e-3  # a lot at exactly the radius is heard, whatever CRS its coordinates came from
ANGLE_PERIOD_DEG = 90.0
RESULTANT_MIN = 1e-9  # of directions that cancel
SHARED_COLUMNS = 12  # a constant of the kernel: the parameters that all lots use, and room to four
EXPONENT_DEEPEST = 50.0  # exp(-50) is lost beside the lot's own weight of 1
SERIES_REACH = 0.15  # nine terms of the exponential's series are exact to 1e-15 up to here
BLOCK_LOTS = 65_536

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """Which columns the kernel adds up, and which of them go together.

    Group g is the parameters that the strategies `users[g]` use; all lots use group 0. Its columns are `starts[g]` to
    `starts[g + 1]`, and `slots` is the first column of each parameter; an angle takes two.
    """

    users: list[tuple[str, ...]]
    starts: list[int]
    slots: dict[str, int]

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.starts[-1]


def layout() -> Layout:
    """Arrange the parameters of `core.params` by who uses them."""
    everybody = tuple(STRATEGIES)
    users = [everybody, *sorted({p.strategies for p in PARAMETERS.values()} - {everybody})]
    starts, slots, width = [0], {}, 0
    for group in users:
        for parameter in PARAMETERS.values():
            if parameter.strategies == group:
                slots[parameter.name] = width
                width += 2 if parameter.kind == "angle" else 1
        if group == everybody:
            assert width <= SHARED_COLUMNS, "the kernel has a column for every parameter that all lots use"
            width = SHARED_COLUMNS
        starts.append(width)
    return Layout(users, starts, slots)


LAYOUT = layout()


def group_bits(strategies: NDArray[np.object_]) -> Ints:
    """Tell for each lot which groups of parameters it uses, a bit a group; unknown strategies use all."""
    codes, names = pd.factorize(strategies)
    bits = np.zeros(len(names), dtype=np.int64)
    for i, name in enumerate(names):
        for group, users in enumerate(LAYOUT.users):
            if name in users or name not in STRATEGIES:
                bits[i] |= 1 << group
    return np.asarray(bits[codes])


def uses_parameter(bits: Ints, name: str) -> NDArray[np.bool_]:
    """Tell for each lot, by its `group_bits`, whether it uses a parameter."""
    return np.asarray((bits >> LAYOUT.users.index(PARAMETERS[name].strategies)) & 1, dtype=bool)


@dataclass(frozen=True)
class Diffused:
    """Values in force, one array a parameter, and how many lots each lot heard (itself included)."""

    values: dict[str, Floats]
    lot_count: Ints


def diffuse(
    centres_m: Floats,
    values: dict[str, Floats],
    *,
    lot_ids: NDArray[np.object_],
    strategies: NDArray[np.object_],
    seed: int,
    passes: int = 1,
    sigma_fraction: float = 1 / 3,
    scopes: NDArray[np.object_] | None = None,
    progress: Progress = silent,
) -> Diffused:
    """Let lots share their values with the lots around them.

    Every pass writes into a new map and reads the one before; each reaches as far as the lot's *given* context
    radius, which is itself a value that is shared but does not move the reach of later passes.

    Parameters
    ----------
    centres_m
        (n, 2) centres in metres; a lot whose centre is not a number keeps its values and is not heard.
    values
        The parameters of `core.params`, each of shape (n,). They are not changed.
    lot_ids, strategies
        Shape (n,). The ids break ties between lots of one centre and key the rounding of counts.
    seed
        Root of the streams that round counts.
    passes
        How often; 0 gives the values back.
    sigma_fraction
        Standard deviation of the Gaussian as a share of the context radius.
    scopes
        Shape (n,); lots share only with lots of the same scope. All share if None.
    progress
        Told the number of lots done.
    """
    n = len(centres_m)
    lot_count = np.ones(n, dtype=np.int64)
    current = {name: np.array(values[name], dtype=np.float64) for name in PARAMETERS}
    taking_part = np.flatnonzero(np.isfinite(centres_m).all(axis=1))
    if passes == 0 or len(taking_part) == 0:
        return Diffused(current, lot_count)
    bits = group_bits(strategies)
    done, work = 0, passes * len(taking_part)

    def tick(lots: int) -> None:
        nonlocal done
        done += lots
        progress("sharing parameters", done, work)

    for rows in [taking_part] if scopes is None else _split(taking_part, scopes):
        order = rows[_spatial_order(centres_m[rows], lot_ids[rows])]
        reach = np.asarray(values["context_radius_m"], dtype=np.float64)[order]
        lot_count[order] = _diffuse_rows(
            order, centres_m[order], reach, bits[order], current,
            passes=passes, sigma_fraction=sigma_fraction, tick=tick,
        )  # fmt: skip
    keys = keys_for(seed, "diffuse", lot_ids)
    for index, parameter in enumerate(PARAMETERS.values()):
        if parameter.kind == "count":
            column, given = current[parameter.name], values[parameter.name]
            current[parameter.name] = np.where(column == given, given, round_by_chance(column, keys, index))
    return Diffused(current, lot_count)


def round_by_chance(numbers: Floats, keys: NDArray[np.uint64], index: int) -> Floats:
    """Round each number to a neighbouring integer so that its expected value is kept."""
    below = np.floor(numbers)
    chance = hash_uniform(keys, np.full(len(keys), index, dtype=np.int64))
    return np.asarray(below + (chance < numbers - below))


def _split(rows: Ints, scopes: NDArray[np.object_]) -> list[Ints]:
    codes, names = pd.factorize(scopes[rows])
    return [rows[codes == code] for code in range(len(names))]


def _strips(centres_m: Floats) -> Ints:
    return np.floor(centres_m[:, 1] / STRIP_HEIGHT_M).astype(np.int64)


def _spatial_order(centres_m: Floats, lot_ids: NDArray[np.object_]) -> Ints:
    """Return the order by strip, easting, northing and id: one that knows places, not rows."""
    strips = _strips(centres_m)
    order = np.lexsort((centres_m[:, 1], centres_m[:, 0], strips))
    sorted_xy = centres_m[order]
    tied = np.flatnonzero((np.diff(sorted_xy, axis=0) == 0).all(axis=1))
    if len(tied):
        ranks = np.zeros(len(order), dtype=np.int64)
        together = order[np.union1d(tied, tied + 1)]
        ranks[together] = np.unique(lot_ids[together].astype(str), return_inverse=True)[1].reshape(-1)
        order = np.lexsort((ranks, centres_m[:, 1], centres_m[:, 0], strips))
    return np.asarray(order)


def _diffuse_rows(
    order: Ints,
    centres_m: Floats,
    reach_m: Floats,
    bits: Ints,
    values: dict[str, Floats],
    *,
    passes: int,
    sigma_fraction: float,
    tick: Callable[[int], None],
) -> Ints:
    """Diffuse the lots `order`, which lie in spatial order, in place of `values`; return how many lots each heard.

    Everything but `order` and `values` is given in spatial order.
    """
    strip_ids, strip_starts = np.unique(_strips(centres_m), return_index=True)
    strip_ends = np.append(strip_starts, len(order)).astype(np.int64)
    x, y = np.ascontiguousarray(centres_m[:, 0]), np.ascontiguousarray(centres_m[:, 1])
    heard = np.ones(len(order), dtype=np.int64)
    matrix = np.zeros((len(order), LAYOUT.width))
    starts = np.array(LAYOUT.starts, dtype=np.int64)
    for _ in range(passes):
        _pack(order, values, matrix)
        for first in range(0, len(order), BLOCK_LOTS):
            block = slice(first, min(first + BLOCK_LOTS, len(order)))
            change = np.zeros((block.stop - first, LAYOUT.width))
            _diffuse_block(
                x, y, reach_m, sigma_fraction, bits, starts, strip_ids, strip_ends, matrix,
                first, change, heard[block],
            )  # fmt: skip
            _unpack(order[block], matrix[block], change, bits[block], values)
            tick(block.stop - first)
    return heard


def _pack(order: Ints, values: dict[str, Floats], matrix: Floats) -> None:
    """Lay the values side by side, directions as cosine and sine of four times the angle."""
    for name, slot in LAYOUT.slots.items():
        if PARAMETERS[name].kind == "angle":
            phase = np.deg2rad(values[name][order]) * (360.0 / ANGLE_PERIOD_DEG)
            matrix[:, slot], matrix[:, slot + 1] = np.cos(phase), np.sin(phase)
        else:
            matrix[:, slot] = values[name][order]


def _unpack(order: Ints, matrix: Floats, change: Floats, bits: Ints, values: dict[str, Floats]) -> None:
    """Add the changes to the values of lots that use them; where nothing changed the value stays to the last bit."""
    for name, slot in LAYOUT.slots.items():
        own = values[name][order]
        used = uses_parameter(bits, name)
        if PARAMETERS[name].kind == "angle":
            columns = slice(slot, slot + 2)
            fresh = _turned(own, matrix[:, columns], change[:, columns])
            moved = used & change[:, columns].any(axis=1)
        else:
            fresh, moved = own + change[:, slot], used & (change[:, slot] != 0)
        values[name][order] = np.where(moved, fresh, own)


def _turned(own_deg: Floats, own: Floats, change: Floats) -> Floats:
    """Return the mean direction as the turn nearest to the lot's own angle, within 0 to 360 degrees."""
    mean = own + change
    cross = own[:, 0] * mean[:, 1] - own[:, 1] * mean[:, 0]
    dot = own[:, 0] * mean[:, 0] + own[:, 1] * mean[:, 1]
    turned = own_deg + np.rad2deg(np.arctan2(cross, dot)) * (ANGLE_PERIOD_DEG / 360.0)
    turned = np.where(turned < 0, turned + ANGLE_PERIOD_DEG, turned)
    turned = np.where(turned > 360, turned - ANGLE_PERIOD_DEG, turned)
    return np.where(np.hypot(mean[:, 0], mean[:, 1]) > RESULTANT_MIN, turned, own_deg)


@njit(cache=True, nogil=True)
def _first_at_least(x: Floats, low: int, high: int, target: float) -> int:
    while low < high:
        middle = (low + high) >> 1
        if x[middle] < target:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def _weigh(
    x: Floats, y: Floats, k0: int, k1: int, xi: float, yi: float, squared: float, scale: float, weights: Floats
) -> int:
    """Write exp(scale d^2) of lots k0 to k1 into `weights`, 0 beyond the reach; return how many are within.

    exp(t) = exp(t / 2^m)^(2^m), with m such that nine terms of the series suffice: loops without calls or
    branches, which the compiler turns into vector instructions.
    """
    deepest = max(squared * scale, -EXPONENT_DEEPEST)
    squarings = 0
    while deepest < -SERIES_REACH:
        deepest *= 0.5
        squarings += 1
    shrink = scale * 0.5**squarings
    lowest = -EXPONENT_DEEPEST * 0.5**squarings
    for k in range(k0, k1):
        dx = x[k] - xi
        dy = y[k] - yi
        t = max((dx * dx + dy * dy) * shrink, lowest)
        tail = 1 / 24 + t * (1 / 120 + t * (1 / 720 + t * (1 / 5040 + t * (1 / 40320 + t * (1 / 362880)))))
        weights[k - k0] = 1.0 + t * (1.0 + t * (1 / 2 + t * (1 / 6 + t * tail)))
    for _ in range(squarings):
        for j in range(k1 - k0):
            weights[j] *= weights[j]
    count = 0
    for k in range(k0, k1):
        dx = x[k] - xi
        dy = y[k] - yi
        within = dx * dx + dy * dy <= squared
        weights[k - k0] = weights[k - k0] if within else 0.0
        count += within
    return count


@njit(cache=True, nogil=True)
def _add_shared(values: Floats, k0: int, k1: int, weights: Floats, own: Floats, total: Floats) -> float:
    """Add the weighted differences of the columns that all lots use; return the sum of weights."""
    weight = 0.0
    for k in range(k0, k1):
        w = weights[k - k0]
        weight += w
        for c in range(SHARED_COLUMNS):
            total[c] += w * (values[k, c] - own[c])
    return weight


@njit(cache=True, nogil=True)
def _add_group(
    values: Floats, k0: int, k1: int, weights: Floats, own: Floats, total: Floats,
    bits: Ints, bit: int, first: int, last: int,
) -> float:  # fmt: skip
    """Add the weighted differences of one group's columns over the lots that use it; return their weight."""
    weight = 0.0
    for k in range(k0, k1):
        if bits[k] & bit and weights[k - k0] > 0.0:
            w = weights[k - k0]
            weight += w
            for c in range(first, last):
                total[c] += w * (values[k, c] - own[c])
    return weight


@njit(cache=True, nogil=True)
def _diffuse_block(
    x: Floats,
    y: Floats,
    reach_m: Floats,
    sigma_fraction: float,
    bits: Ints,
    starts: Ints,
    strip_ids: Ints,
    strip_ends: Ints,
    values: Floats,
    first: int,
    change: Floats,
    heard: Ints,
) -> None:
    """Write the change of the values of some lots, `first` and those after it, among all lots in spatial order.

    `values` has shape (lots, columns), `change` (some lots, columns); columns `starts[g]` to `starts[g + 1]` belong
    to group g, and those a lot does not use are written as 0.
    """
    groups = len(starts) - 1
    total = np.empty(values.shape[1])
    own = np.empty(values.shape[1])
    group_weight = np.empty(groups)
    weights = np.empty(np.max(np.diff(strip_ends)))
    strip_of_lot = 0
    for i in range(first, first + len(change)):
        while strip_ends[strip_of_lot + 1] <= i:
            strip_of_lot += 1
        total[:] = 0.0
        group_weight[:] = 0.0
        count = 0
        if reach_m[i] > 0.0:
            own[:] = values[i]
            radius = reach_m[i] + REACH_TOLERANCE_M
            squared = radius * radius
            sigma = reach_m[i] * sigma_fraction
            scale = -0.5 / (sigma * sigma)
            lowest = int(np.floor((y[i] - radius) / STRIP_HEIGHT_M))
            highest = int(np.floor((y[i] + radius) / STRIP_HEIGHT_M))
            strip = strip_of_lot
            while strip > 0 and strip_ids[strip - 1] >= lowest:
                strip -= 1
            while strip < len(strip_ids) and strip_ids[strip] <= highest:
                above = strip_ids[strip] * STRIP_HEIGHT_M - y[i]
                gap = max(above, -above - STRIP_HEIGHT_M, 0.0)
                half = np.sqrt(max(squared - gap * gap, 0.0)) + REACH_TOLERANCE_M
                k0 = _first_at_least(x, strip_ends[strip], strip_ends[strip + 1], x[i] - half)
                k1 = _first_at_least(x, k0, strip_ends[strip + 1], x[i] + half)
                count += _weigh(x, y, k0, k1, x[i], y[i], squared, scale, weights)
                group_weight[0] += _add_shared(values, k0, k1, weights, own, total)
                for group in range(1, groups):
                    bit = 1 << group
                    if bits[i] & bit:
                        group_weight[group] += _add_group(
                            values, k0, k1, weights, own, total, bits, bit, starts[group], starts[group + 1]
                        )
                strip += 1
        heard[i - first] = max(count, 1)
        for group in range(groups):
            for c in range(starts[group], starts[group + 1]):
                change[i - first, c] = total[c] / group_weight[group] if group_weight[group] > 0.0 else 0.0


KERNELS = (_diffuse_block,)
