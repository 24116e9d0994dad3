"""Pairs in memory: green discs on gray ground, the discs being what is to be found."""

from dataclasses import dataclass

import numpy as np

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.pairs import ImagePair


@dataclass
class Discs:
    """So many pairs of one group each second; the truth's bands are all alike."""

    count: int = 6
    side_px: int = 64
    classes: tuple[str, ...] = ("canopy", "vegetation")
    fingerprint: str = "discs"
    resolution_m: tuple[float, float] = (0.6, 0.6)
    unknown: tuple[int, ...] = ()

    @property
    def names(self):
        return [f"town_{2018 + 2 * (index % 2)}_{index}" for index in range(self.count)]

    @property
    def places(self):
        return [str(index) for index in range(self.count)]

    @property
    def groups(self):
        return [name.rpartition("_")[0] for name in self.names]

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        rng = rng_for(0, "discs", str(index))
        side = self.side_px
        rows, cols = np.mgrid[:side, :side] + 0.5
        covered = np.zeros((side, side), bool)
        for row, col, radius in rng.uniform((0, 0, 4), (side, side, 10), (8, 3)):
            covered |= (rows - row) ** 2 + (cols - col) ** 2 < radius**2
        colours = np.where(covered, np.array((70, 110, 60))[:, None, None], np.array((130, 125, 120))[:, None, None])
        rgb = np.clip(colours + rng.normal(0, 12, (3, side, side)), 0, 255).astype(np.uint8)
        truth = np.repeat((100 * covered).astype(np.uint8)[None], len(self.classes), axis=0)
        if index in self.unknown:
            truth[:] = 255
        return ImagePair(
            self.names[index], self.places[index], self.groups[index], rgb, np.ones((side, side), bool), truth,
            self.classes, self.resolution_m, None,
        )  # fmt: skip
