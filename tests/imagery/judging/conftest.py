"""Pairs made in code: green squares on gray, in two cities and two years."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from urbanforest_cli.imagery.pairs import ImagePair


@dataclass
class MadePairs:
    """Eight places, four a city, each photographed in two years."""

    side: int = 40
    classes: tuple[str, ...] = ("canopy", "vegetation")
    fingerprint: str = "made"
    names: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for city in ("north", "south"):
            for number in range(4):
                for year in (2018, 2020):
                    self.names.append(f"{city}_{year}_{number}")
                    self.places.append(f"{city}_{number}")
                    self.groups.append(f"{city}_{year}")

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> ImagePair:
        rng = np.random.default_rng(index)
        rgb = np.full((3, self.side, self.side), 120.0) + rng.normal(0, 3, (1, self.side, self.side))
        crown, lawn = np.zeros((2, self.side, self.side), bool)
        size = 10 + index % 5
        crown[4 : 4 + size, 4 : 4 + size] = True
        lawn[24:36, 6 : 20 + size] = True
        rgb[:, lawn] = np.array([[80.0], [140.0], [70.0]])
        rgb[:, crown] = np.array([[70.0], [130.0], [60.0]]) * rng.uniform(0.4, 1.6, crown.sum())
        valid = np.ones(crown.shape, bool)
        valid[:, -2:] = False
        truth = np.stack([crown, crown | lawn]) * np.uint8(100)
        return ImagePair(
            name=self.names[index], place=self.places[index], group=self.groups[index],
            rgb=np.clip(np.round(rgb), 0, 255).astype(np.uint8), valid=valid, truth=truth, classes=self.classes,
            resolution_m=(0.6, 0.6), trees_px=np.array([[6.5, 6.5], [30.5, 15.5]]) if index % 2 else None,
        )  # fmt: skip


@pytest.fixture
def made_pairs() -> MadePairs:
    return MadePairs()
