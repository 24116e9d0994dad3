"""The fit of crowns to covered ground as one reads it, with masks of the whole grid: the judge of the kernels."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from urbanforest_cli.core.randomness import hash_uniform

SHOWN, FILLED = 1, 2


def fit(percent, stems, mean, variance, cut_sd, radius_min, overlap, coverage, key, fixed):
    """Take what `fit_kernel` takes; return discs (n, 3) and kinds (n,)."""
    return _Fit(percent, stems, mean, variance, cut_sd, radius_min, overlap, coverage, key, fixed).run()


class _Fit:
    def __init__(self, percent, stems, mean, variance, cut_sd, radius_min, overlap, coverage, key, fixed):
        self.percent, self.stems, self.coverage, self.key = percent, stems.astype(bool), coverage, key
        height, width = percent.shape
        self.y, self.x = np.mgrid[0:height, 0:width] + 0.5
        self.covered = (percent >= 50) & (percent <= 100)
        self.ground = self.covered.copy()
        for x, y, radius in fixed:
            self.ground &= ~self.disc(x, y, radius)
        self.target = coverage * self.covered.sum() - (self.covered & ~self.ground).sum()
        self.mean, self.sd = mean, 1.137 * math.sqrt(variance)
        self.spread = max(min(cut_sd * self.sd, mean - radius_min), 0.0)
        self.most = max(1.25 * mean, mean + self.spread) + 0.5
        self.lobe = max(0.6 * (mean - self.spread), 0.35 * mean)
        self.least = max(0.7, min(radius_min, 0.5 * (mean - self.spread)))
        self.near = 1.0 - overlap
        self.crowns: list[list[float]] = []
        self.kinds: list[int] = []

    def run(self):
        if self.target <= 0:
            return np.empty((0, 3)), np.empty(0, int)
        self.depth = depth(self.ground)
        reach = self.depth[self.stems & self.ground]
        self.largest = min(max(self.most, reach.max(initial=0)), 4 * self.most)
        self.points = self.outline()
        self.taken = np.zeros(self.ground.shape, bool)
        deep = self.depth - 0.5 > self.most
        woods = self.large_crowns(deep)
        closed = np.zeros_like(woods)
        if woods.any():
            closed = ndimage.distance_transform_edt(~woods).round(9) <= self.most
        self.shown_crowns(woods, closed)
        self.move(5)
        if woods.any():
            self.fill_woods(closed)
        for _ in range(2):
            before = len(self.crowns)
            self.fill_gaps()
            self.move(3)
            self.drop_swallowed()
            if len(self.crowns) <= before:
                break
        if self.coverage < 1:
            self.thin()
        self.match_area()
        return np.array(self.crowns).reshape(-1, 3), np.array(self.kinds, int)

    def disc(self, x, y, radius):
        return (self.x - x) ** 2 + (self.y - y) ** 2 <= radius * radius

    def chance(self, stream, index):
        return float(hash_uniform(np.uint64(self.key) ^ np.uint64(stream), np.array([index]))[0])

    def apart(self, x, y, radius, crowns):
        return all(
            (a - x) ** 2 + (b - y) ** 2 >= (self.near * (radius + r)) * (self.near * (radius + r)) for a, b, r in crowns
        )

    def large_crowns(self, deep):
        woods = np.zeros_like(deep)
        parts, count = ndimage.label(deep, np.ones((3, 3)))
        for part in range(1, count + 1):
            mine = parts == part
            room = np.where(mine & self.stems, self.depth, 0.0)
            if not room.any():
                continue
            row, col = np.unravel_index(room.argmax(), room.shape)
            radius = room[row, col] - 0.5
            x, y = col + 0.5, row + 0.5
            ring = self.disc(x, y, 1.15 * radius + 0.5) & ~self.disc(x, y, radius)
            bare = (ring & ~self.ground).sum() / ring.sum() if ring.any() else 0.0
            asked = 0.25 + 0.55 * min(1.5 * (radius / self.most - 1), 1.0)
            round_enough = mine.sum() <= 1.35 * math.pi * (radius - self.most + 1) ** 2
            if self.coverage >= 1 and radius <= self.largest and round_enough and bare >= asked:
                self.add(x, y, radius, SHOWN)
                self.taken |= self.disc(x, y, radius)
            else:
                woods |= mine
        return woods

    def add(self, x, y, radius, kind):
        self.crowns.append([x, y, radius])
        self.kinds.append(kind)

    def ridge(self, depths, allowed, least):
        """Flat indices of stem ground whose disc no neighbour's exceeds by more than .1."""
        room = np.where(self.stems & allowed, depths, 0.0)
        top = ndimage.maximum_filter(room, size=3, mode="constant", cval=0.0)
        return np.flatnonzero(self.stems & allowed & (depths - 0.5 >= least) & (top <= depths + 0.1))

    def shown_crowns(self, woods, closed):
        blobs, _ = ndimage.label(self.ground, np.ones((3, 3)))
        settled = {blobs[int(y), int(x)] for x, y, _ in self.crowns} | set(blobs[woods])
        cells = self.ridge(self.depth, self.ground & ~closed, self.least)
        ranks = np.array([-(self.depth.flat[c] + 0.2 * self.chance(0, c)) for c in cells])
        for cell in cells[np.argsort(ranks, kind="stable")]:
            row, col = divmod(int(cell), self.ground.shape[1])
            x, y, radius, blob = col + 0.5, row + 0.5, self.depth[row, col] - 0.5, blobs[row, col]
            disc = self.disc(x, y, radius)
            if self.taken[row, col] or (radius < self.lobe and blob in settled):
                continue
            if self.apart(x, y, radius, self.crowns) and share(disc, self.ground & ~self.taken) >= 0.55:
                self.add(x, y, radius, SHOWN)
                self.taken |= disc
                settled.add(blob)

    def outline(self):
        """Points where the percentage passes 49.5 between neighbours, one of them free ground."""
        p = np.where(self.percent > 100, 0, self.percent).astype(float)
        points = []
        height, width = p.shape
        for row, col in np.ndindex(height, width):
            for r, c in ((row, col + 1), (row + 1, col)):
                if r >= height or c >= width or self.covered[row, col] == self.covered[r, c]:
                    continue
                if self.ground[row, col] or self.ground[r, c]:
                    t = (49.5 - p[row, col]) / (p[r, c] - p[row, col])
                    points.append((col + 0.5 + t * (c - col), row + 0.5 + t * (r - row)))
        return np.array(points).reshape(-1, 2)

    def move(self, turns):
        if not len(self.points) or not self.crowns:
            return
        start = [list(crown) for crown in self.crowns]
        for _ in range(turns):
            discs = np.array(self.crowns)
            away = np.hypot(*(self.points[:, None] - discs[None, :, :2]).transpose(2, 0, 1))
            off = np.abs(away - discs[:, 2])
            off[off > np.maximum(0.35 * discs[:, 2], 1.5)] = np.inf
            owner = np.where(np.isfinite(off.min(axis=1)), off.argmin(axis=1), -1)
            for k in range(len(self.crowns)):
                mine = (owner == k) & (away[:, k] >= 1e-9)
                if self.kinds[k] == SHOWN and mine.sum() >= 3:
                    self.step(k, start[k], self.points[mine], away[mine, k])

    def step(self, k, start, points, away):
        x, y, radius = self.crowns[k]
        jacobian = np.column_stack([(points - (x, y)) / away[:, None], np.ones(len(points))])
        hold = 0.12 * 8 * radius
        normal = jacobian.T @ jacobian + np.diag([hold, hold, 0.5 * hold])
        dx, dy, dr = np.linalg.solve(normal, jacobian.T @ (away - radius))
        height, width = self.ground.shape
        inside = 0 <= x + dx < width and 0 <= y + dy < height and self.stems[int(y + dy), int(x + dx)]
        if inside and math.hypot(x + dx - start[0], y + dy - start[1]) <= 0.5 * start[2] + 0.5:
            self.crowns[k][:2] = [x + dx, y + dy]
        self.crowns[k][2] = min(max(radius + dr, 0.6 * start[2]), 1.4 * start[2] + 0.5)

    def drawn_radius(self, number):
        for turn in range(16 if self.spread > 0 else 0):
            u, v = (self.chance(0xF112, 64 * number + 2 * turn + i) for i in (0, 1))
            away = self.sd * math.sqrt(-2 * math.log(1 - u)) * math.cos(2 * math.pi * v)
            if abs(away) <= self.spread:
                return self.mean + away
        return self.mean

    def fill_woods(self, closed):
        cells = np.flatnonzero(self.ground & closed & self.stems)
        cells = cells[np.argsort([self.chance(0xF111, c) for c in cells], kind="stable")] if len(cells) else cells
        for drawn in (True, False):
            number = tried = 0
            radius = self.drawn_radius(0) if drawn else self.mean
            for cell in cells:
                row, col = divmod(int(cell), self.ground.shape[1])
                x, y = col + self.chance(0xF113, cell), row + self.chance(0xF114, cell)
                fits = self.depth[row, col] - 0.5 >= 0.85 * radius and self.apart(x, y, radius, self.crowns)
                if fits:
                    self.add(x, y, radius, FILLED)
                tried += 1
                if drawn and (fits or tried == 60):
                    number, tried = number + 1, 0
                    radius = self.drawn_radius(number)

    def fill_gaps(self):
        left = self.ground.copy()
        for x, y, radius in self.crowns:
            left &= ~self.disc(x, y, radius + 0.25)
        depths = depth(left)
        taken = np.zeros_like(left)
        cells = self.ridge(depths, left, self.lobe)
        for cell in cells[np.argsort(-np.round(depths.flat[cells] ** 2), kind="stable")]:
            row, col = divmod(int(cell), left.shape[1])
            x, y, radius = col + 0.5, row + 0.5, min(depths[row, col] - 0.5, self.largest)
            disc = self.disc(x, y, radius)
            if not taken[row, col] and share(disc, left & ~taken) >= 0.45 and self.apart(x, y, radius, self.crowns):
                self.add(x, y, radius, SHOWN)
                taken |= disc

    def drop_swallowed(self):
        def swallowed(i):
            x, y, radius = self.crowns[i]
            return self.kinds[i] == SHOWN and any(
                (r > radius or (r == radius and j < i)) and math.hypot(a - x, b - y) + 0.6 * radius < r
                for j, (a, b, r) in enumerate(self.crowns)
                if j != i
            )

        self.keep([i for i in range(len(self.crowns)) if not swallowed(i)])

    def keep(self, which):
        self.crowns, self.kinds = [self.crowns[i] for i in which], [self.kinds[i] for i in which]

    def thin(self):
        taken, covered, kept = np.zeros_like(self.ground), 0.0, []
        for i in np.argsort([self.chance(0xF115, i) for i in range(len(self.crowns))], kind="stable"):
            disc = self.disc(*self.crowns[i])
            gain = math.pi * self.crowns[i][2] ** 2 * share(disc, self.ground & ~taken)
            if covered + gain > self.target and self.chance(0xF116, i) * gain > self.target - covered:
                break
            kept.append(int(i))
            covered += gain
            taken |= disc
            if covered >= self.target:
                break
        self.keep(sorted(kept))

    def match_area(self):
        """Take the scale at which the discs cover the target, between steps of .0025 by their line."""
        if not self.crowns:
            return
        counted = self.ground | ~self.covered
        reach = np.min([np.hypot(self.x - x, self.y - y) / r for x, y, r in self.crowns], axis=0)[counted]
        totals = [(np.ceil((reach - 0.75) / 0.65 * 260) <= step).sum() for step in range(261)]
        scale = 0.75
        for step in range(1, 261):
            if totals[step - 1] >= self.target:
                break
            over = totals[step] > self.target
            part = (self.target - totals[step - 1]) / (totals[step] - totals[step - 1]) if over else 1.0
            scale = 0.75 + 0.65 * (step - 1 + part) / 260
        for crown in self.crowns:
            crown[2] *= scale


def share(disc, ground):
    return (disc & ground).sum() / disc.sum() if disc.any() else 1.0


def depth(ground):
    """Distance to the nearest cell that is not ground; that of the grid's sides together where there is none."""
    if ground.all():
        return np.full(ground.shape, float(sum(ground.shape)))
    return np.sqrt(np.round(ndimage.distance_transform_edt(ground) ** 2))
