"""Bark as shade on a square of a metre that goes on into itself at all sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
Painted = tuple[FloatArray, FloatArray]  # (n, n) shade, 1 on the whole, and (n, n, 3) change of hue

BARK_PX = 256
GREY = np.array([0.97, 1.0, 1.04])


def tiling_noise(rng: np.random.Generator, wide: float, high: float, *, sharp: float = 2.0) -> FloatArray:
    """Return (n, n) noise that tiles, of mean 0 and deviation 1, whose blots are `wide` and `high`, in pixels."""
    n = BARK_PX
    fx, fy = np.abs(np.fft.fftfreq(n))[None, : n // 2 + 1], np.abs(np.fft.fftfreq(n))[:, None]
    away = np.hypot(fx * wide, fy * high)
    band = np.exp(-((2.2 * away) ** sharp)) * np.minimum(4.0 * away, 1.0)
    noise = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n, n))) * band, s=(n, n))
    return np.asarray((noise - noise.mean()) / (noise.std() + 1e-12))


def plates(
    rng: np.random.Generator, count: int, long: float, warp: tuple[tuple[float, float], ...]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Cut the square into uneven plates `long` times as high as wide.

    `warp` holds sizes of blots and by how many pixels they bend the edges.

    Returns
    -------
    (n, n) number of the plate, (n, n) distance to its edge in pixels across the stem
    """
    n = BARK_PX
    columns = max(round(np.sqrt(count * long)), 1)
    rows = max(round(count / columns), 1)
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    x = (i + 0.5 * (j % 2) + rng.uniform(-0.36, 0.36, i.shape)) * n / columns
    y = (j + rng.uniform(-0.42, 0.42, i.shape)) * n / rows
    tree = cKDTree(np.column_stack((x.ravel() % n, (y.ravel() % n) / long)), boxsize=(n, n / long))
    at_x, at_y = np.meshgrid(np.arange(n, dtype=np.float64), np.arange(n, dtype=np.float64))
    for size, by in warp:
        at_x += by * tiling_noise(rng, size, size * min(long, 3.0))
        at_y += by * long * tiling_noise(rng, size, size * min(long, 3.0))
    away, owner = tree.query(np.column_stack((at_x.ravel() % n, (at_y.ravel() % n) / long)), k=2)
    return owner[:, 0].reshape(n, n), (0.5 * (away[:, 1] - away[:, 0])).reshape(n, n)


def fissured(rng: np.random.Generator, *, ridge_px: float, long: float, depth: float) -> Painted:
    """Paint ridges between dark furrows that join and part."""
    count = round(BARK_PX**2 / (ridge_px**2 * long))
    owner, away = plates(rng, count, long, ((4 * ridge_px, 0.35 * ridge_px), (ridge_px, 0.16 * ridge_px)))
    tone = rng.normal(1.0, 0.06, int(owner.max()) + 1)[owner]
    top = 1.0 - np.exp(-((away / (0.17 * ridge_px)) ** 1.5))
    crack = np.exp(-((tiling_noise(rng, 2.0 * ridge_px, 0.8 * ridge_px) / 0.10) ** 2))
    grain = tiling_noise(rng, 3, 8) + 0.6 * tiling_noise(rng, 6, 22)
    shade = (1.0 - depth * (1.0 - top)) * (1.0 - 0.22 * crack * top) * tone * (1.0 + 0.075 * grain)
    shade *= 1.0 + 0.05 * tiling_noise(rng, 70, 90)
    lichen = np.clip(0.5 * tiling_noise(rng, 60, 80), 0, 1)[..., None] * top[..., None]
    hue = 1.0 + 0.6 * (top[..., None] - 0.5) * (GREY - 1.0) + lichen * np.array([-0.06, 0.0, -0.08])
    return shade, hue


def flaking(rng: np.random.Generator) -> Painted:
    """Paint patches as flakes leave them: cream where they fell last, then olive, then grey brown."""
    owner, away = plates(rng, 130, 1.3, ((26, 7.0), (8, 2.0)))
    kind = rng.choice(4, int(owner.max()) + 1, p=(0.30, 0.28, 0.24, 0.18))[owner]
    tones = np.array([1.22, 0.98, 0.80, 0.62])
    hues = np.array([[1.0, 1.0, 0.96], [0.97, 1.01, 0.88], [0.98, 0.99, 0.92], [1.0, 0.95, 0.90]])
    edge = np.exp(-((away / 0.9) ** 2))
    shade = (
        tones[kind] * (1.0 - 0.20 * edge) * (1.0 + 0.04 * tiling_noise(rng, 5, 5) + 0.04 * tiling_noise(rng, 40, 40))
    )
    return shade, hues[kind]


def banded(rng: np.random.Generator) -> Painted:
    """Paint the smooth bark of cherries with level bands and the corky slits through which it breathes."""
    shade = 1.0 + 0.10 * tiling_noise(rng, 120, 9) + 0.05 * tiling_noise(rng, 40, 3)
    slits = np.zeros((BARK_PX, BARK_PX))
    for _ in range(150):
        x, y = rng.integers(0, BARK_PX, 2)
        long, high = int(rng.integers(4, 17)), int(rng.integers(1, 3))
        rows, columns = np.arange(y, y + high) % BARK_PX, np.arange(x, x + long) % BARK_PX
        slits[np.ix_(rows, columns)] = rng.uniform(0.5, 1.0)
    rim = np.roll(slits, 1, axis=0) * (slits == 0)
    shade = shade * (1.0 + 0.45 * slits - 0.25 * rim)
    return shade, 1.0 + slits[..., None] * np.array([0.06, 0.0, -0.08])


def smooth(rng: np.random.Generator) -> Painted:
    """Paint thin bark: soft blots, fine lines along it, and few pale dots."""
    shade = 1.0 + 0.07 * tiling_noise(rng, 50, 90) + 0.05 * tiling_noise(rng, 4, 40) + 0.04 * tiling_noise(rng, 3, 3)
    for _ in range(90):
        x, y = rng.integers(0, BARK_PX, 2)
        shade[np.ix_(np.arange(y, y + 2) % BARK_PX, np.arange(x, x + int(rng.integers(2, 5))) % BARK_PX)] *= 1.22
    return shade, np.ones(3)


def _oak(rng: np.random.Generator) -> Painted:
    return fissured(rng, ridge_px=10, long=6.0, depth=0.58)


def _lime(rng: np.random.Generator) -> Painted:
    return fissured(rng, ridge_px=7, long=6.0, depth=0.50)


def _maple(rng: np.random.Generator) -> Painted:
    return fissured(rng, ridge_px=6, long=4.0, depth=0.50)


def _locust(rng: np.random.Generator) -> Painted:
    return fissured(rng, ridge_px=15, long=4.5, depth=0.62)


BARKS: dict[str, Callable[[np.random.Generator], Painted]] = {
    "acer_platanoides": _maple, "tilia_cordata": _lime, "platanus_acerifolia": flaking, "quercus_rubra": _oak,
    "gleditsia_triacanthos": _locust, "prunus_serrulata": banded, "corylus_avellana": smooth,
    "cornus_sanguinea": smooth, "ligustrum_vulgare": smooth, "syringa_vulgaris": smooth,
}  # fmt: skip


def paint_bark(species_id: str, habit: str, rgb: NDArray[np.floating], rng: np.random.Generator) -> FloatArray:
    """Return (n, n, 3) linear colours, `rgb` on the whole; trees not known have furrows, shrubs a smooth bark."""
    shade, hue = BARKS.get(species_id, _lime if habit == "tree" else smooth)(rng)
    light = np.maximum(shade, 0.05)[..., None] * hue * np.ones(3)
    return np.asarray(np.clip(light / light.mean(axis=(0, 1)) * rgb, 0.0, 1.0))
