"""Light and room around a grove in sets and dictionaries: part of the reference of growth."""

from __future__ import annotations

import math

import numpy as np

from urbanforest_cli.core.config import Growth
from urbanforest_cli.growth.grove import COLUMN_M, SKY_CELL_M, Surroundings, TraitsTable

NEIGHBOUR_LEAF_SHADE, NEIGHBOUR_SHADE_DECAY = 0.045, 1.8  # of plants of other groves
FULL_LIGHT = 4096  # shade counts in whole parts of it
ALL_BITS = 2**64 - 1
CANOPY_M = 2.0  # edge of the cells in which a canopy's leaves are summed
LEAF_M2 = 1.5  # leaf area of an internode for each 1 of its leaf_shade

Point = tuple[float, float, float]
Cell = tuple[int, int, int]


def stored(value: float) -> float:
    """Return a number as the kernels keep it: in 32 bits."""
    return float(np.float32(value))


def stored_point(point: Point) -> Point:
    return (stored(point[0]), stored(point[1]), stored(point[2]))


def mixed(z: int) -> int:
    """Mix 64 bits (finaliser of SplitMix64)."""
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & ALL_BITS
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB & ALL_BITS
    return z ^ (z >> 31)


def uniform(bits: int) -> float:
    return (bits >> 11) * 2.0**-53


def canopy_cell(point: Point) -> Cell:
    return (int(point[0] / CANOPY_M), int(point[1] / CANOPY_M), int(point[2] / CANOPY_M))


class Solids:
    """What is built: heights of columns, and how much of the sky it leaves."""

    def __init__(self, around: Surroundings) -> None:
        self.around = around
        self.none = around.solid_top_m.size == 1

    def holds(self, point: Point) -> bool:
        """Tell whether a point lies inside what is built or 10 cm above it."""
        ix, iy = int(point[0] / COLUMN_M), int(point[1] / COLUMN_M)
        rows, columns = self.around.solid_top_m.shape
        if self.none or not (0 <= ix < columns and 0 <= iy < rows):
            return False
        top = float(self.around.solid_top_m[iy, ix])
        return top > 0 and point[2] < top + 0.1

    def sky_seen(self, point: Point) -> float:
        sky = self.around.sky
        if sky.size == 1:
            return 1.0
        place = [min(max(int(value / SKY_CELL_M), 0), sky.shape[2 - axis] - 1) for axis, value in enumerate(point)]
        return int(sky[place[2], place[1], place[0]]) / 255


class Shade:
    """Shadow pyramids: each leafy internode dims the voxel it is in and (2q + 1) squared ones in each layer q below."""

    def __init__(self, around: Surroundings, traits: TraitsTable, config: Growth) -> None:
        self.around, self.edge = around, config.voxel_m
        layers = range(config.shade_depth_voxels + 1)
        exact = [[row["leaf_shade"] * row["shade_decay"] ** -q for q in layers] for row in traits]
        exact.append([NEIGHBOUR_LEAF_SHADE * NEIGHBOUR_SHADE_DECAY**-q for q in layers])
        self.cast_in_layer = [[round(amount * FULL_LIGHT) for amount in row] for row in exact]
        self.lean = [[round(q * float(lean)) for lean in around.shade_lean] for q in layers]
        self.shade: dict[Cell, int] = {}

    def voxel(self, point: Point) -> Cell:
        return (int(point[0] / self.edge), int(point[1] / self.edge), int(max(point[2], 0.0) / self.edge))

    def cast(self, voxel: Cell, species: int, times: int) -> None:
        for q, amount in enumerate(self.cast_in_layer[species]):
            z = voxel[2] - q
            if z < 0:
                return
            x, y = voxel[0] + self.lean[q][0], voxel[1] + self.lean[q][1]
            for i in range(x - q, x + q + 1):
                for j in range(y - q, y + q + 1):
                    self.shade[i, j, z] = self.shade.get((i, j, z), 0) + times * amount

    def light(self, voxel: Cell, species: int) -> float:
        """Return the light a bud catches: its own internode does not shade it."""
        shade = self.shade.get(voxel, 0) - self.cast_in_layer[species][0]
        return max(1.0 - max(shade, 0) / FULL_LIGHT, 0.0)

    def canopy(self, leafy: list[tuple[Point, int]], others: list[tuple[Point, int]]) -> dict[Cell, float]:
        """Return the light in each cell under leaves, near or high, by Beer and Lambert.

        From the top down each cell has over it the mean of the nine next higher ones, their own leaves and all above.

        Parameters
        ----------
        leafy, others
            Where internodes are, with their species; leafy points of other groves, with the internodes each counts for.
        """
        leaves: dict[Cell, float] = {}
        for point, species in leafy:
            cell = canopy_cell(point)
            leaves[cell] = leaves.get(cell, 0.0) + self.cast_in_layer[species][0]
        for point, internodes in others:
            cell = canopy_cell(point)
            leaves[cell] = leaves.get(cell, 0.0) + internodes * self.cast_in_layer[-1][0]
        nx, ny = (int(size / CANOPY_M) + 1 for size in self.around.size_m[:2].tolist())
        light: dict[Cell, float] = {}
        for z in range(max(cell[2] for cell in leaves) - 1, -1, -1):
            for x, y in [(x, y) for x in range(nx) for y in range(ny)]:
                rows = [[leaves.get((i, j, z + 1), 0.0) for i in (x - 1, x, x + 1)] for j in (y - 1, y, y + 1)]
                over = sum(sum(row) for row in rows)
                if over > 0:
                    light[x, y, z] = math.exp(-LEAF_M2 / (FULL_LIGHT * CANOPY_M * CANOPY_M * 9) * over)
                    leaves[x, y, z] = leaves.get((x, y, z), 0.0) + over / 9
        return light

    def brightest(self, voxel: Cell, eye: Point, facing: Point, solids: Solids) -> Point:
        """Return the mean direction of the light seen in the half space a bud faces, bright directions before dim."""
        total = [0.0, 0.0, 0.0]
        for ray, whole in zip(self.around.ray.tolist(), self.around.ray_light.tolist(), strict=True):
            if sum(a * b for a, b in zip(ray, facing, strict=True)) <= 0:
                continue
            light = 1.0
            for edges in (1, 2, 4):
                x, y, z = (v + round(edges * r) for v, r in zip(voxel, ray, strict=True))
                light *= max(1.0 - self.shade.get((x, y, z), 0) / FULL_LIGHT, 0.05)
            if any(solids.holds(_along(eye, ray, 1.0 + 1.5 * k)) for k in range(8)):
                light = 0.0
            weight = whole * light * light
            total = [t + weight * r for t, r in zip(total, ray, strict=True)]
        length = math.hypot(*total)
        return (total[0] / length, total[1] / length, total[2] / length) if length > 0 else (0.0, 0.0, 0.0)


class Room:
    """Markers, one in each cell of a grid over the world: free until an internode comes near."""

    def __init__(self, around: Surroundings, solids: Solids, config: Growth) -> None:
        self.edge = config.marker_spacing_m
        self.cells = [math.ceil(size / self.edge) for size in around.size_m]
        self.half_cone = math.cos(math.radians(min(config.perception_angle_deg, 180.0) / 2))
        self.known: dict[Cell, Point] = {}
        self.taken: set[Cell] = set()
        self.blocked = set() if solids.none else {cell for cell in self._all() if solids.holds(self.marker(cell))}

    def _all(self) -> list[Cell]:
        nx, ny, nz = self.cells
        return [(x, y, z) for z in range(nz) for y in range(ny) for x in range(nx)]

    def marker(self, cell: Cell) -> Point:
        """Return where the marker of a cell is; it repeats every 16 cells of the world."""
        x, y, z = cell
        number = ((z % 16) * 16 + y % 16) * 16 + x % 16
        shift = [uniform(mixed((number * 3 + axis + 1) * 0x9E3779B97F4A7C15 & ALL_BITS)) for axis in range(3)]
        return tuple(c * self.edge + stored(self.edge * s) for c, s in zip(cell, shift, strict=True))  # type: ignore[return-value]

    def near(self, point: Point, radius: float) -> list[tuple[Cell, Point]]:
        """List the cells whose markers are within a radius, and the way to each; z slowest, x fastest."""
        found = []
        low = [max(int((point[k] - radius) / self.edge), 0) for k in range(3)]
        high = [min(int((point[k] + radius) / self.edge) + 1, self.cells[k]) for k in range(3)]
        for z in range(low[2], high[2]):
            for y in range(low[1], high[1]):
                for x in range(low[0], high[0]):
                    mx, my, mz = self.marker_of(x, y, z)
                    way = (mx - point[0], my - point[1], mz - point[2])
                    if way[0] * way[0] + way[1] * way[1] + way[2] * way[2] < radius * radius:
                        found.append(((x, y, z), way))
        return found

    def marker_of(self, x: int, y: int, z: int) -> Point:
        if (x, y, z) not in self.known:
            self.known[x, y, z] = self.marker((x, y, z))
        return self.known[x, y, z]

    def take(self, point: Point, radius: float) -> None:
        self.taken.update(cell for cell, _ in self.near(point, radius) if cell not in self.blocked)

    def release(self, point: Point, radius: float) -> None:
        self.taken.difference_update(cell for cell, _ in self.near(point, radius))

    def perceive(self, buds: list[tuple[Point, Point, float]]) -> list[tuple[Point, int]]:
        """Return for each bud (place, direction, range) the mean direction of its own markers and how many it sees.

        Of those that see a marker it belongs to the nearest.
        """
        seen: list[list[tuple[Cell, Point]]] = []
        nearest: dict[Cell, tuple[float, int]] = {}
        for number, (place, direction, radius) in enumerate(buds):
            mine: list[tuple[Cell, Point]] = []
            for cell, way in self.near(place, radius):
                if cell in self.taken or cell in self.blocked:
                    continue
                square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
                ahead = way[0] * direction[0] + way[1] * direction[1] + way[2] * direction[2]
                if ahead <= 0 or ahead * ahead < self.half_cone * self.half_cone * square:
                    continue
                length = math.sqrt(square) + 1e-9
                mine.append((cell, stored_point((way[0] / length, way[1] / length, way[2] / length))))
                if cell not in nearest or square < nearest[cell][0]:
                    nearest[cell] = (stored(square), number)
            seen.append(mine)
        views = []
        for number, mine in enumerate(seen):
            own = [way for cell, way in mine if nearest[cell][1] == number]
            sums = [sum(way[axis] for way in own) for axis in range(3)]
            length = math.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
            scale = 1.0 / length if length > 1e-6 else 0.0
            views.append((stored_point((sums[0] * scale, sums[1] * scale, sums[2] * scale)), len(mine)))
        return views

    def counts(self) -> dict[str, int]:
        total = math.prod(self.cells)
        taken, blocked = len(self.taken), len(self.blocked)
        return {"alive": total - taken - blocked, "taken": taken, "blocked": blocked, "total": total}


def _along(eye: Point, ray: list[float], length: float) -> Point:
    return (eye[0] + ray[0] * length, eye[1] + ray[1] * length, eye[2] + ray[2] * length)
