"""What a network is shown: crops of images, turned, mirrored and changed in colour, each drawn by its own stream.

Sample `k` of epoch `e` is the same whatever was shown before it, so that a training that goes on after a stop needs
no memory of its random numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.learning.settings import Jitter, TrainingSettings
from urbanforest_cli.imagery.learning.tiles import CHANNEL_SCALE, Tile, TileLook, at_least, crops_in

STREAM = "train-coverage"
NOISE_VALUES = 1 << 20
LEVELS = 256
GRAYS = (0.2, 0.6)
"""Range of the gray that contrast is changed about, of values from 0 to 1."""
TRANSFER_MOST = 1.3
LEAST_DEVIATION = 0.02
BLUR_MOST_PX = 1.5
ZOOM_MOST = 1.5

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """Images (batch, 3, row, col) from -1 to 1, and truths (batch, class, row, col) in percent or 255."""

    images: Floats
    truths: Bytes


class CropSource:
    """Batches of crops of a set of tiles."""

    def __init__(self, tiles: Sequence[Tile], looks: Sequence[TileLook], settings: TrainingSettings) -> None:
        self._settings = settings
        self._tiles = tiles
        self._owner = np.repeat(
            np.arange(len(tiles)), [crops_in(look.size, settings.crop_px) for look in looks]
        )  # tile of each sample
        self._looks = _by_group(looks)
        self._group = [look.group for look in looks]
        self._order: dict[str, NDArray[np.intp]] = {}
        jitter = settings.jitter
        noise = rng_for(settings.seed, STREAM, "noise").standard_normal(NOISE_VALUES, dtype=np.float32)
        self._noise = noise * np.float32(jitter.noise / (CHANNEL_SCALE / 255.0)) if jitter else None

    @property
    def steps_an_epoch(self) -> int:
        """Return how many full batches an epoch has; at least one, in which samples then repeat."""
        return max(1, len(self._owner) // self._settings.batch)

    def batch(self, epoch: int, step: int) -> Batch:
        """Return one batch of an epoch, both counted from 0."""
        size = self._settings.batch
        return self._gather(f"epoch {epoch}", step * size, size, jitter=self._settings.jitter)

    def plain_batch(self, number: int, size: int) -> Batch:
        """Return a batch in true colours, to take statistics of."""
        return self._gather("statistics", number * size, size, jitter=None)

    def _order_of(self, key: str) -> NDArray[np.intp]:
        """Return which tile each sample of an epoch shows."""
        if key not in self._order:
            self._order = {key: rng_for(self._settings.seed, STREAM, key).permutation(self._owner)}
        return self._order[key]

    def _gather(self, key: str, first: int, count: int, *, jitter: Jitter | None) -> Batch:
        side, order = self._settings.crop_px, self._order_of(key)
        images = np.empty((count, 3, side, side), dtype=np.float32)
        truths = []
        for place in range(count):
            rng = rng_for(self._settings.seed, STREAM, f"{key} {first + place}")
            owner = int(order[(first + place) % len(order)])
            tile = at_least(self._tiles[owner], side)
            taken = side_taken(side, min(tile.rgb.shape[1:]), jitter.zoom if jitter else 0.0, rng)
            row = int(rng.integers(tile.rgb.shape[1] - taken + 1))
            col = int(rng.integers(tile.rgb.shape[2] - taken + 1))
            turn = int(rng.integers(8)) if self._settings.dihedral else 4 * int(rng.integers(2))
            window = (slice(None), slice(row, row + taken), slice(col, col + taken))
            truths.append(nearest(oriented(tile.truth[window], turn), side))
            values = np.tile(np.arange(LEVELS) / (LEVELS - 1.0), (3, 1))
            if jitter is not None:
                values = self._transferred(values, self._group[owner], jitter, rng)
                values = jittered(values, jitter, rng)
            shown = images[place] if taken == side else np.empty((3, taken, taken), dtype=np.float32)
            paint(shown, oriented(tile.rgb[window], turn), (2.0 * values - 1.0).astype(np.float32))
            if taken != side:
                images[place] = interpolated(shown, side)
            if jitter is not None and self._noise is not None:
                blur(images[place], jitter.blur, rng)
                saturate(images[place], float(np.exp(rng.normal(0.0, jitter.saturation))))
                add_noise(images[place], self._noise, int(rng.integers(NOISE_VALUES)))
        return Batch(images, np.stack(truths))

    def _transferred(self, values: Values, group: str, jitter: Jitter, rng: np.random.Generator) -> Values:
        """Move what a group's channels have for mean and deviation some way to what another group's have."""
        share, way = rng.random(), rng.uniform(0.0, TRANSFER_MOST)
        mean, deviation = self._looks[group]
        other_mean, other_deviation = self._looks[sorted(self._looks)[int(rng.integers(len(self._looks)))]]
        if share >= jitter.transfer:
            return values
        scale = (other_deviation / deviation) ** way
        moved: Values = np.clip((values - mean) * scale + mean + way * (other_mean - mean), 0.0, 1.0)
        return moved


def oriented(pixels: Bytes, turn: int) -> Bytes:
    """Return (channel, row, col) turned by `turn % 4` quarters, and mirrored left to right from 4 on."""
    turned = np.rot90(pixels, turn % 4, (1, 2))
    return turned[:, :, ::-1] if turn >= 4 else turned


def jittered(values: Values, jitter: Jitter, rng: np.random.Generator) -> Values:
    """Return (3, 256) values from 0 to 1 after a random gain, exponent, contrast and offset, clipped after each."""
    gain = np.exp(rng.normal(0.0, jitter.gain) + rng.normal(0.0, jitter.channel_gain, (3, 1)))
    exponent, contrast = np.exp(rng.normal(0.0, jitter.gamma)), np.exp(rng.normal(0.0, jitter.contrast))
    gray, offset = rng.uniform(*GRAYS), rng.normal(0.0, jitter.channel_offset, (3, 1))
    shown = np.clip(gain * values, 0.0, 1.0) ** exponent
    result: Values = np.clip(np.clip(gray + (shown - gray) * contrast, 0.0, 1.0) + offset, 0.0, 1.0)
    return result


def paint(into: Floats, pixels: Bytes, table: Floats) -> None:
    """Write each channel's values, looked up in its row of a table, into (3, row, col)."""
    for channel in range(3):
        np.take(table[channel], pixels[channel], out=into[channel], mode="clip")


def side_taken(side: int, most: int, zoom: float, rng: np.random.Generator) -> int:
    """Draw how many pixels along a side are shown as `side`, at most `most`; the draw is made in any case."""
    factor = math.exp(min(max(zoom * rng.standard_normal(), -math.log(ZOOM_MOST)), math.log(ZOOM_MOST)))
    return min(round(side * factor), most)


def nearest(pixels: Bytes, side: int) -> Bytes:
    """Bring (channel, row, col) to another side; each pixel is that whose middle is nearest."""
    if pixels.shape[1] == side:
        return pixels
    places = ((np.arange(side) + 0.5) * (pixels.shape[1] / side)).astype(np.intp)
    return pixels[:, places[:, None], places]


def interpolated(image: Floats, side: int) -> Floats:
    """Bring a square image (3, row, col) to another side, linearly between the middles of pixels."""
    taken = image.shape[1]
    places = np.clip((np.arange(side) + 0.5) * (taken / side) - 0.5, 0.0, taken - 1.0)
    first = np.minimum(places.astype(np.intp), taken - 2)
    share = (places - first).astype(np.float32)
    weights = np.zeros((side, taken), dtype=np.float32)
    weights[np.arange(side), first] = 1.0 - share
    weights[np.arange(side), first + 1] += share
    return np.asarray(weights @ image @ weights.T, dtype=np.float32)


def blur(image: Floats, share: float, rng: np.random.Generator) -> None:
    """Blur an image in place with a probability, by a Gaussian of a width drawn up to `BLUR_MOST_PX`."""
    drawn, width_px = rng.random(), rng.uniform(0.0, BLUR_MOST_PX)
    if drawn < share:
        for channel in image:
            gaussian_filter(channel, width_px, output=channel, mode="nearest", truncate=3.0)


def saturate(image: Floats, factor: float) -> None:
    """Move each pixel's channels away from their mean by a factor, or toward it, in place."""
    if factor != 1.0:
        mean = image.mean(axis=0)
        image -= mean
        image *= np.float32(factor)
        image += mean


def add_noise(image: Floats, noise: Floats, start: int) -> None:
    """Add a stretch of a long row of noise to an image in place, and clip it to -1 to 1."""
    flat = image.reshape(-1)
    done = 0
    while done < len(flat):
        part = noise[start : start + len(flat) - done]
        flat[done : done + len(part)] += part
        done, start = done + len(part), 0
    np.clip(image, -1.0, 1.0, out=image)


def _by_group(looks: Sequence[TileLook]) -> dict[str, tuple[Values, Values]]:
    """Return mean and deviation of each channel, each (3, 1) of values from 0 to 1, over all images of a group."""
    result = {}
    for group in {look.group for look in looks}:
        alike = [look for look in looks if look.group == group]
        mean = np.mean([look.mean for look in alike], axis=0)
        square = np.mean([np.square(look.deviation) + np.square(look.mean) for look in alike], axis=0)
        deviation = np.sqrt(np.maximum(square - mean**2, LEAST_DEVIATION**2))
        result[group] = (mean[:, None], deviation[:, None])
    return result
