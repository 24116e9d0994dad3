"""Wood of one plant as one reads it: tubes as lists of rings, vectors as arrays. The kernels' judge."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Mesh
from urbanforest_cli.core.skeleton import Skeletons, pipe_count, standing
from urbanforest_cli.export.mesh.levels import BARK_TEXTURE_M, Level

Vector = NDArray[np.float64]
SIDES = (3, 4, 5, 6, 8, 10, 12, 16, 20, 24)


@dataclass
class Ring:
    """A place on a tube's axis; a radius of 0 is a point that closes the tube."""

    place: Vector
    radius: float
    sides: int = 3


@dataclass
class Tube:
    rings: list[Ring]
    girth: float

    def turns(self) -> int:
        return max(1, round(2 * math.pi * self.girth / BARK_TEXTURE_M))


@dataclass
class Drawn:
    """Where the tube passes a node; a ball of radius `room` fits into it there, or the tube ends with a `radius`."""

    place: Vector
    room: float
    is_end: bool = False
    back: Vector = field(default_factory=lambda: np.zeros(3))  # to where branches begin


@dataclass
class Plant:
    """One skeleton at a season, as a tree of nodes."""

    xyz: Vector
    parent: list[int]
    order: list[int]
    stands: list[bool]
    pipes: list[int]
    tip_radius: float
    exponent: float
    children: list[list[int]] = field(default_factory=list)

    def radius(self, i: int) -> float:
        return self.tip_radius * self.pipes[i] ** (1 / self.exponent)

    def thickest(self, nodes: list[int]) -> int | None:
        return min(nodes, key=lambda i: (-self.pipes[i], i), default=None)

    def axis(self, i: int) -> int | None:
        """Return the standing child of the same order."""
        return self.thickest([c for c in self.children[i] if self.order[c] == self.order[i]])

    def place(self, i: int) -> Vector:
        """Return where a node is, half way to the middle of its neighbours on the axis."""
        after = self.axis(i)
        if i == 0 or after is None:
            return self.xyz[i]
        return 0.5 * self.xyz[i] + 0.25 * (self.xyz[self.parent[i]] + self.xyz[after])


def plant_of(skeletons: Skeletons, season: int) -> Plant:
    """Return the only skeleton as a plant."""
    end = np.array([season])
    stands = standing(skeletons, end).tolist()
    parent = skeletons.parent.tolist()
    plant = Plant(
        skeletons.xyz_m.astype(np.float64), parent, skeletons.order.tolist(), stands,
        pipe_count(skeletons, end).tolist(), float(skeletons.tip_radius_m[0]), float(skeletons.pipe_exponent[0]),
    )  # fmt: skip
    plant.children = [[] for _ in parent]
    for i, p in enumerate(parent):
        if p >= 0 and stands[i]:
            plant.children[p].append(i)
    return plant


def wood_by_hand(skeletons: Skeletons, season: int, level: Level) -> Mesh:
    """Return the wood of one skeleton."""
    return mesh_of(tubes_of(plant_of(skeletons, season), level))


def tubes_of(plant: Plant, level: Level) -> list[Tube]:
    """Return the tubes that are drawn, in the order of their first nodes."""
    tubes: list[Tube] = []
    drawn: dict[int, Drawn] = {}
    if not plant.stands[0]:
        return tubes
    for start, below in enumerate(plant.parent):
        if below < 0 or not plant.stands[start] or not is_drawn(plant, start, level):
            continue
        if below > 0 and next_of(plant, below, level) == start:
            continue
        tubes += tube_from(plant, start, level, drawn)
    return tubes


def is_drawn(plant: Plant, i: int, level: Level) -> bool:
    return plant.radius(i) >= min(level.wood_radius_min_m, 0.35 * plant.radius(0))


def next_of(plant: Plant, i: int, level: Level) -> int | None:
    """Return the node that goes on in the same tube: the axis, or a branch with a fourth of the pipes."""
    after = plant.axis(i)
    if after is not None and is_drawn(plant, after, level):
        return after
    after = plant.thickest([c for c in plant.children[i] if is_drawn(plant, c, level)])
    if after is not None and 4 * plant.pipes[after] >= plant.pipes[i]:
        return after
    return None


def tube_from(plant: Plant, start: int, level: Level, drawn: dict[int, Drawn]) -> list[Tube]:
    """Return the tube that begins at a node, or several where it bends too sharply; note where it passes its nodes."""
    from_root = plant.parent[start] == 0
    if from_root:
        girth, rings = foot(plant, start)
    else:
        girth, rings = plant.radius(start), branch_start(plant, start, drawn[plant.parent[start]], level)
    head = len(rings)
    place_of: dict[int, int] = {}
    node: int | None = start
    last = start
    while node is not None:
        place, radius = plant.place(node), plant.radius(node)
        if from_root:
            radius *= flare(place[2], girth)
        if math.dist(place, rings[-1].place) > 5e-4:
            rings.append(Ring(place, radius))
        place_of[node] = len(rings) - 1
        last, node = node, next_of(plant, node, level)
    if len(rings) == head:
        drawn.update({i: Drawn(rings[-1].place, radius, True) for i in place_of})
        return []
    after = plant.axis(last)
    is_cut = after is not None and not is_drawn(plant, after, level)
    bears = any(is_drawn(plant, c, level) for c in plant.children[last])
    thick = rings[-1].radius > 2 * plant.tip_radius and rings[-1].radius > 2 * level.wood_error_m
    is_stump = bears or (thick and not is_cut)
    if is_stump:
        rings += dome(rings[-2], rings[-1])
    else:
        rings[-1].radius = 0.0
    kept = thinned(rings, level.wood_error_m, [0, 1] if from_root or rings[0].radius == 0 else [0])
    sides = 0
    for k in reversed(kept):
        sides = rings[k].sides = max(sides, sides_for(rings[k].radius, level))
    for i, k in place_of.items():
        drawn[i] = drawn_at(rings, kept, k, is_stump, i == last, plant.tip_radius)
    return pieces([rings[k] for k in kept], girth)


def foot(plant: Plant, start: int) -> tuple[float, list[Ring]]:
    """Return a trunk's radius without its flare, and its rings below the first node."""
    radius, place = plant.radius(start), plant.place(start)
    girth = min(max(plant.radius(0), radius), 1.3 * radius)
    rings = [Ring(np.array([0.0, 0.0, z]), 1.5 * girth) for z in (-0.1, 0.0)]
    length = float(np.linalg.norm(place))
    for share in (0.1, 0.25, 0.5):
        t = share * max(6 * girth, 0.05) / length if length > 5e-4 else 1.0
        if t < 0.8:
            rings.append(Ring(t * place, (girth + t * (radius - girth)) * flare(t * place[2], girth)))
    return girth, rings


def flare(z: float, girth: float) -> float:
    return 1 + 0.5 * min(max(1 - z / max(6 * girth, 0.05), 0), 1) ** 3


def branch_start(plant: Plant, start: int, at: Drawn, level: Level) -> list[Ring]:
    """Return the rings of a branch before its first node."""
    radius = plant.radius(start)
    way = plant.place(start) - at.place
    length = float(np.linalg.norm(way))
    width, rings = 1.6 * radius, []
    if at.is_end:
        width = min(width, max(at.room, 0.5 * radius))
        if length > 5e-4:
            rings.append(Ring(at.place - 0.45 * width / length * way, 0.0))
    else:
        width = min(width, 0.9 * at.room / outer(sides_for(width, level)))
    rings.append(Ring(at.place, width))
    if at.is_end or at.room <= 6 * level.wood_error_m:
        return rings
    rings[0].place = at.place + at.back
    clear = 1.5 * at.room + radius
    if length > 1.5 * clear:
        rings.append(Ring(at.place + clear / length * way, 1.1 * radius))
    return rings


def dome(before: Ring, end: Ring) -> list[Ring]:
    way = end.place - before.place
    way = way * end.radius / np.linalg.norm(way)
    return [Ring(end.place + ahead * way, share * end.radius) for ahead, share in ((0.3, 0.7), (0.45, 0.0))]


def thinned(rings: list[Ring], error: float, kept: list[int]) -> list[int]:
    """Return which rings to keep: from each the furthest that leaves all between within the error."""
    while kept[-1] < len(rings) - 1:
        a = kept[-1]
        b = a + 1
        while b < len(rings) - 1 and b - a < 24 and fits(rings[a], rings[a + 1 : b + 1], rings[b + 1], error):
            b += 1
        kept.append(b)
    return kept


def fits(a: Ring, between: list[Ring], b: Ring, error: float) -> bool:
    way = b.place - a.place
    square = float(way @ way)
    if square < 5e-4**2:
        return False
    for ring in between:
        t = float((ring.place - a.place) @ way) / square
        beside = float(np.linalg.norm(ring.place - a.place - t * way))
        if not 0 <= t <= 1 or beside > error or abs(a.radius + t * (b.radius - a.radius) - ring.radius) > error:
            return False
    return True


def sides_for(radius: float, level: Level) -> int:
    """Return the fewest sides whose middles lie within the error of the circle."""
    least, most = level.sides
    allowed = sorted({least, most} | {n for n in SIDES if least <= n <= most})
    return next((n for n in allowed if radius <= level.wood_error_m / (1 - inner(n))), allowed[-1])


def outer(sides: int) -> float:
    return math.pi / sides / math.sin(math.pi / sides)


def inner(sides: int) -> float:
    return math.pi / sides / math.tan(math.pi / sides)


def drawn_at(rings: list[Ring], kept: list[int], k: int, is_stump: bool, is_last: bool, tip: float) -> Drawn:
    """Return where the line through the kept rings passes that of a node."""
    segment = max((s for s in range(len(kept) - 1) if kept[s] <= k), default=0)
    a, b = rings[kept[segment]], rings[kept[segment + 1]]
    way = b.place - a.place
    t = min(max(float((rings[k].place - a.place) @ way / (way @ way)), 0.0), 1.0)
    place, radius = a.place + t * way, a.radius + t * (b.radius - a.radius)
    slope = (b.radius - a.radius) / float(np.linalg.norm(way))
    room = radius * inner(min(a.sides, b.sides)) / math.sqrt(1 + slope**2)
    if is_stump and is_last:
        return Drawn(place, max(radius, rings[k].radius), True)
    if room < 5e-4:
        return Drawn(place, tip, True)
    if is_stump and segment >= len(kept) - 3 and math.dist(place, rings[-1].place) < room:
        return Drawn(place, radius, True)
    if k == kept[segment] and segment > 0 and breaks(rings[kept[segment - 1]], a, b):
        return Drawn(place, radius, True)
    before = a
    if k == kept[segment] and segment > 0:
        before = rings[kept[segment - 1]]
        way, t = a.place - before.place, 1.0
        slope = (a.radius - before.radius) / float(np.linalg.norm(way))
    length = float(np.linalg.norm(way))
    back = min(0.6 * room, 0.7 * t * length)
    fewest = min(rings[kept[max(segment - 1, 0)]].sides, b.sides)
    room = min(room, inner(fewest) * (radius - back * slope) / math.sqrt(1 + slope**2))
    return Drawn(place, room, back=-back / length * way)


def breaks(a: Ring, b: Ring, c: Ring) -> bool:
    """Tell whether a mitre at b would take more than 0.45 of the shorter of the ways to a and c."""
    before, after = b.place - a.place, c.place - b.place
    lengths = float(np.linalg.norm(before)), float(np.linalg.norm(after))
    cosine = min(float(before @ after) / lengths[0] / lengths[1], 1.0)
    if cosine < -0.99:
        return True
    return b.radius * math.sqrt((1 - cosine) / (1 + cosine)) > 0.45 * min(lengths)


def pieces(rings: list[Ring], girth: float) -> list[Tube]:
    """Cut a tube where it bends too sharply, and close the ends."""
    tubes = [Tube([], girth)]
    for k, ring in enumerate(rings):
        if 0 < k < len(rings) - 1 and ring.radius > 0 and rings[k - 1].radius > 0:
            before, after = rings[k - 1], rings[k + 1]
            if breaks(before, ring, after):
                tubes[-1].rings += [ring, cap(ring, before)]
                tubes.append(Tube([cap(ring, after)], girth))
        tubes[-1].rings.append(ring)
    return tubes


def cap(ring: Ring, away_from: Ring) -> Ring:
    way = ring.place - away_from.place
    return replace(ring, place=ring.place + 0.45 * ring.radius * way / np.linalg.norm(way), radius=0.0)


def mesh_of(tubes: list[Tube]) -> Mesh:
    """Return tubes as triangles."""
    xyz: list[Vector] = []
    normals: list[Vector] = []
    uv: list[tuple[float, float]] = []
    tint: list[int] = []
    triangles: list[tuple[int, int, int]] = []
    for tube in tubes:
        rings = [replace(r, place=r.place.astype(np.float32).astype(np.float64)) for r in tube.rings]
        for ring, beside in ((rings[0], rings[1]), (rings[-1], rings[-2])):
            if ring.radius == 0:
                ring.sides = beside.sides
        lengths = [math.dist(a.place, b.place) for a, b in pairwise(rings)]
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        before: list[int] = []
        for k, (ring, (u, w, t)) in enumerate(zip(rings, frames(rings), strict=True)):
            a, b = max(k - 1, 0), min(k + 1, len(rings) - 1)
            slope = (rings[b].radius - rings[a].radius) / (along[b] - along[a])
            n, point = ring.sides, ring.radius == 0
            corners = list(range(len(xyz), len(xyz) + n + (not point)))
            for j in range(len(corners)):
                share = (j + 0.5) / n if point else j / n
                out = math.cos(2 * math.pi * share) * u + math.sin(2 * math.pi * share) * w
                xyz.append(ring.place + ring.radius * outer(n) * out)
                normals.append((out - slope * t) / math.sqrt(1 + slope**2))
                uv.append((share * tube.turns(), along[k] / BARK_TEXTURE_M))
                tint.append(255 - int(60 * min(max(1 - ring.place[2] / 0.8, 0), 1) + 0.5))
            if before:
                triangles += strip(before, rings[k - 1].radius == 0, corners, point)
            before = corners
    return Mesh(
        np.array(xyz).reshape(-1, 3), np.array(normals).reshape(-1, 3), np.array(uv).reshape(-1, 2),
        np.repeat(np.array(tint, np.uint8), 3).reshape(-1, 3), np.array(triangles, np.uint32).reshape(-1, 3),
    )  # fmt: skip


def frames(rings: list[Ring]) -> list[tuple[Vector, Vector, Vector]]:
    """Return two vectors across and one along at each ring, that turn about the axis as little as can be.

    Double reflection: Wang, Juettler, Zheng, Liu 2008, Computation of Rotation Minimizing Frames, table 1.
    """
    ways = [b.place - a.place for a, b in pairwise(rings)]
    ways = [way / np.linalg.norm(way) for way in ways]
    tangents = [ways[0], *(a + b for a, b in pairwise(ways)), ways[-1]]
    tangents = [t / np.linalg.norm(t) for t in tangents]
    u = np.cross(tangents[0], [1.0, 0, 0] if abs(tangents[0][0]) < 0.7 else [0, 1.0, 0])
    u /= np.linalg.norm(u)
    found = [(u, np.cross(tangents[0], u), tangents[0])]
    for way, t, after in zip(ways, tangents, tangents[1:], strict=False):
        u_mirrored, t_mirrored = (x - 2 * (way @ x) * way for x in (u, t))
        second = after - t_mirrored
        if second @ second > 1e-20:
            u_mirrored = u_mirrored - 2 * (second @ u_mirrored) / (second @ second) * second
        u = u_mirrored
        found.append((u, np.cross(after, u), after))
    return found


def strip(low: list[int], low_is_point: bool, high: list[int], high_is_point: bool) -> list[tuple[int, int, int]]:
    """Return the triangles between two rings, counter-clockwise from outside."""
    if low_is_point:
        return [(low[j], high[j + 1], high[j]) for j in range(len(high) - 1)]
    if high_is_point:
        return [(low[j], low[j + 1], high[j]) for j in range(len(low) - 1)]
    n, m = len(low) - 1, len(high) - 1
    i = j = 0
    triangles = []
    while i < n or j < m:  # the side whose middle comes first
        if j == m or (i < n and (2 * i + 1) * m <= (2 * j + 1) * n):
            triangles.append((low[i], low[i + 1], high[j]))
            i += 1
        else:
            triangles.append((low[i], high[j + 1], high[j]))
            j += 1
    return triangles
