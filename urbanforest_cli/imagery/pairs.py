"""Images with their truth, as everything that learns from or is judged by them sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

PairLabel = Literal["auto", "masks", "ndvi", "polygons", "side-by-side"]
PAIR_LABELS: tuple[PairLabel, ...] = ("auto", "masks", "ndvi", "polygons", "side-by-side")
"""Where a truth comes from: files of masks, near infrared and tree points, polygons, the right half of each image."""


@dataclass(frozen=True)
class ImagePair:
    """An image and what covers it.

    Parameters
    ----------
    name
        Its own, made of the file's and, for a block of a large image, of the block's first row and column.
    place
        The same for all pairs whose footprints overlap: those of several years, most often.
    group
        City and flight: the file's name without the number at its end, or its folder.
    rgb
        uint8 (3, row, col).
    valid
        bool (row, col), false where the image holds nothing.
    truth
        uint8 (class, row, col), percent, 255 where unknown.
    classes
        Names of the truth's bands.
    resolution_m
        Width and height of a pixel on the ground.
    trees_px
        float64 (n, 2), row and column of every tree from the outer corner of the first pixel, so that the whole part
        is the pixel it lies in; None where nobody looked for trees, empty where there are none.
    """

    name: str
    place: str
    group: str
    rgb: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    truth: NDArray[np.uint8]
    classes: tuple[str, ...]
    resolution_m: tuple[float, float]
    trees_px: NDArray[np.float64] | None


def content_of(rgb: NDArray[np.uint8]) -> str:
    """Return a hash of an image (3, row, col), by which it is known under any name and with any truth."""
    return sha256(f"{rgb.shape}".encode() + rgb.tobytes()).hexdigest()[:16]


class PairSet(Protocol):
    """Pairs in a fixed order; names, places and groups are known without reading a pixel."""

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the truth's bands."""

    @property
    def names(self) -> Sequence[str]:
        """Of each pair, all different."""

    @property
    def places(self) -> Sequence[str]:
        """Of each pair."""

    @property
    def groups(self) -> Sequence[str]:
        """Of each pair."""

    @property
    def fingerprint(self) -> str:
        """Hash of all that decides the pairs: names, contents of files, options."""

    def __len__(self) -> int:
        """Return how many pairs there are."""

    def __getitem__(self, index: int) -> ImagePair:
        """Read a pair; from any thread."""
