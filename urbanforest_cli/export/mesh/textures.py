"""Textures made by the program: an atlas of a species' leaves, and its bark; the same bytes each time."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.core.species import Species
from urbanforest_cli.export.mesh import leaf_shapes as shapes
from urbanforest_cli.export.mesh.bark import paint_bark
from urbanforest_cli.export.mesh.leaf_painting import Sprig, Stamp, blade_stamp, flower_stamp, paint, spread
from urbanforest_cli.export.mesh.leaf_painting import cover as covered
from urbanforest_cli.export.mesh.leaves import blossom_share, texture_rgb
from urbanforest_cli.export.plant_looks import Season, in_season
from urbanforest_cli.export.plant_scene import Look, linear

FloatArray = NDArray[np.float64]
Floats = NDArray[np.float32]

ALPHA_CUTOFF = 0.3  # below the mean alpha of each cell: crowns far away, seen in coarse mip levels, do not dissolve
FINER = 2  # pictures are painted at so many times their size, and averaged
FLOWER_KINDS = {"prunus_serrulata": "corymb", "cornus_sanguinea": "umbel"}
SPRAY_TRIES, TRY_PX = 5, 96
LEAF_COLOURS = (16, 8, 8, 8, 8, 8, 80)  # of a palette, from clear to opaque
GOLDEN_RAD = 2.4  # what lies around a middle at steps of this angle lies evenly
BARK_COLOURS = 96
VARIETY = 0.55  # how far leaves of one picture differ, of the way from young to old


def leaf_texture(species: Species, look: Look, season: Season) -> bytes:
    """Paint a species' leaves in a season: PNG with alpha, cells as in `leaf_shapes`; clear in winter.

    Parameters
    ----------
    species
        Gives the outline of leaves; those of a species that is not known are egg-shaped.
    look
        Colours and size of leaves.
    season
        Flowers are among them in spring.
    """
    size = shapes.ATLAS_PX
    look = in_season(look, season)
    rgb = np.broadcast_to(texture_rgb(look).astype(np.float32), (size, size, 3)).copy()
    alpha = np.zeros((size, size), np.float32)
    if season == "winter":
        return few_colours_png(rgb, alpha, LEAF_COLOURS)
    rng = rng_for(0, "leaf texture", f"{species.id} {season}")
    painter = _Painter(species, look, rng)
    for cell in shapes.LEAF_CELLS:
        _put(rgb, alpha, cell, painter.leaf)
    for cell in shapes.FLOWER_CELLS:
        _put(rgb, alpha, cell, painter.leaf if painter.flower is None else painter.flowers)
    for cell in shapes.SPRAY_CELLS:
        _put(rgb, alpha, cell, painter.spray)
    for cell in shapes.CLUMP_CELLS:
        _put(rgb, alpha, cell, painter.clump)
    return few_colours_png(rgb, alpha, LEAF_COLOURS)


class _Painter:
    """Paints the cells of one species."""

    def __init__(self, species: Species, look: Look, rng: np.random.Generator) -> None:
        self.shape = shapes.shape_of(species.id)
        self.look, self.rng = look, rng
        self.blade = blade_stamp(self.shape)
        self.flower: Stamp | None = None
        self.petal = np.zeros(3)
        if look.blossom is not None:
            self.flower = flower_stamp(FLOWER_KINDS.get(species.id, "panicle"), rng)
            self.petal = np.minimum(linear(look.blossom) * 1.05, 1.0)
        self.base = texture_rgb(look)
        old, young = linear(look.leaf), linear(look.leaf_young)
        change = old / np.maximum(young, 1e-6)
        self.older = change / change.max()  # hue of old leaves beside young ones, as bright
        self.aspect = look.blade_m[1] / look.blade_m[0]
        self.bark = linear(look.bark)

    def colour(self, bright: float) -> FloatArray:
        """Return the colour of some leaf."""
        toward_old = 1.0 + VARIETY * self.rng.random() * (self.older - 1.0)
        return np.asarray(self.base * toward_old * bright)

    def leaf(self, size_px: int) -> tuple[Floats, Floats]:
        """Paint one leaf alone, as large as gives its cell the cover that cards count on."""
        sprig = Sprig((0.5, 0.0), 0.0, 1.0, 1.0, self.base * self.rng.uniform(0.94, 1.04))
        return self._fit_alone(sprig, self.blade, size_px)

    def flowers(self, size_px: int) -> tuple[Floats, Floats]:
        """Paint one head of flowers."""
        assert self.flower is not None  # asked by the caller
        sprig = Sprig((0.5, 0.0), 0.0, 1.0, 1.0, self.petal, is_flower=True)
        return self._fit_alone(sprig, self.flower, size_px)

    def _fit_alone(self, sprig: Sprig, stamp: Stamp, size_px: int) -> tuple[Floats, Floats]:
        share = min(float(np.sqrt(shapes.LEAF_COVER / stamp.cover)), 1.0)
        sprig = replace(sprig, foot=(0.5, 0.5 * (1.0 - share)), length=share, width=share)
        return paint([sprig], self.blade, self.flower, size_px, pale=0.3)

    def spray(self, size_px: int) -> tuple[Floats, Floats]:
        """Paint a twiglet and its leaves, held apart so that each gets light."""
        count, bend = shapes.SPRAY_LEAVES, self.rng.uniform(-0.06, 0.06)
        stem = _curve(np.array([0.5, 0.0]), np.array([0.5 + bend, 0.35]), np.array([0.5 - bend, 0.66]))
        plan = []
        turn_to = self.rng.uniform(0, 2 * np.pi)
        for number in range(count):
            away, angle = np.sqrt((number + 0.5) / count), GOLDEN_RAD * number + turn_to
            centre = np.array([0.5 + 0.40 * away * np.cos(angle), 0.52 + 0.40 * away * np.sin(angle)])
            centre += self.rng.normal(0, 0.02, 2)
            joint = _at(stem, float(np.clip((centre[1] - 0.22) / 0.55, 0.25, 1.0)))
            turn = float(np.arctan2(*(centre - joint + (0.0, 0.06)))) + self.rng.normal(0, 0.25)
            plan.append((centre, joint, turn, self.rng.uniform(0.85, 1.12), self.rng.uniform(0.72, 1.0)))
        order = self.rng.permutation(count)
        marks = self._marks([0.78 + 0.26 * rank / count for rank in range(count)])
        stalks = [stem] + [np.stack((joint, centre)) for centre, joint, *_ in plan]

        def sprigs(length: float) -> list[Sprig]:
            found = []
            for (rgb, is_flower), index in zip(marks, order, strict=True):
                centre, _, turn, size, slant = plan[index]
                foot = centre - 0.5 * size * length * np.array([np.sin(turn), np.cos(turn)])
                found.append(self._sprig(foot, turn, size * length, slant, rgb, is_flower))
            return found

        return self._fit(sprigs, shapes.SPRAY_COVER, size_px, stalks)

    def clump(self, size_px: int) -> tuple[Floats, Floats]:
        """Paint the end of a branch with its sprays: leaves in lumps, dark below and behind, bright above."""
        lumps = np.array([(0.5, 0.16, 0.15), (0.27, 0.34, 0.20), (0.72, 0.33, 0.21), (0.5, 0.5, 0.24),
                          (0.22, 0.64, 0.17), (0.78, 0.63, 0.18), (0.40, 0.80, 0.17), (0.64, 0.82, 0.15)])  # fmt: skip
        lumps[:, :2] += self.rng.normal(0, 0.03, (len(lumps), 2))
        share = lumps[:, 2] ** 2 / (lumps[:, 2] ** 2).sum()
        plan = []
        for (x, y, radius), portion in zip(lumps, share, strict=True):
            number = max(round(portion * shapes.CLUMP_LEAVES), 1)
            for k in range(number):
                away, angle = radius * np.sqrt((k + 0.5) / number), GOLDEN_RAD * k + x
                foot = np.array([x + away * np.cos(angle), y + away * np.sin(angle)])
                outward = np.arctan2(foot[0] - 0.5, foot[1] - 0.15)
                turn = outward + self.rng.normal(0, 0.7)
                lit = 0.60 + 0.28 * foot[1] + 0.20 * (foot[1] - y) / radius + self.rng.normal(0, 0.06)
                plan.append((foot, turn, self.rng.uniform(0.8, 1.15), self.rng.uniform(0.55, 1.0), lit))
        plan.sort(key=lambda item: item[4])
        if self.flower is not None:  # those in front come last, so all are mixed
            plan = [plan[place] for place in self.rng.permutation(len(plan))]
        marks = self._marks([float(np.clip(item[4], 0.5, 1.1)) for item in plan])
        stems = [_curve(np.array([0.5, 0.0]), np.array([0.5, 0.25]), lump[:2]) for lump in lumps]

        def sprigs(length: float) -> list[Sprig]:
            return [self._sprig(foot - 0.5 * size * length * np.array([np.sin(turn), np.cos(turn)]), turn,
                                size * length, slant, *mark)
                    for (foot, turn, size, slant, _), mark in zip(plan, marks, strict=True)]  # fmt: skip

        return self._fit(sprigs, shapes.CLUMP_COVER, size_px, stems)

    def _marks(self, bright: Sequence[float]) -> list[tuple[FloatArray, bool]]:
        """Return the colour of each leaf of a picture, and whether it is a flower; flowers come last, in front."""
        share = blossom_share(self.look) if self.flower is not None else 0.0
        flowers = max(round(share * len(bright)), 1) if share > 0.0 else 0
        leaves = [(self.colour(level), False) for level in bright[: len(bright) - flowers]]
        return leaves + [(self.petal * min(level + 0.1, 1.0), True) for level in bright[len(bright) - flowers :]]

    def _sprig(
        self, foot: FloatArray, turn: float, length: float, slant: float, rgb: FloatArray, is_flower: bool
    ) -> Sprig:
        """Return a leaf seen at a slant, or flowers about as large as one."""
        across = float(np.sqrt(self.aspect)) if is_flower else self.aspect
        size = float(np.sqrt(self.aspect)) if is_flower else 1.0
        return Sprig((float(foot[0]), float(foot[1])), turn, size * length, size * across * length * slant, rgb,
                     is_flower)  # fmt: skip

    def _fit(
        self, sprigs: Callable[[float], list[Sprig]], cover: float, size_px: int, stalks: list[FloatArray]
    ) -> tuple[Floats, Floats]:
        """Paint with leaves of the length that covers the wanted share of the picture."""
        length = 0.3
        for _ in range(SPRAY_TRIES):
            found = covered(sprigs(length), self.blade, self.flower, TRY_PX)
            length *= float(np.clip((cover / found) ** 0.7, 0.5, 2.0))
        return paint(sprigs(length), self.blade, self.flower, size_px, stalks=stalks, bark=self.bark)


def _curve(start: FloatArray, middle: FloatArray, end: FloatArray) -> FloatArray:
    t = np.linspace(0, 1, 9)[:, None]
    return np.asarray((1 - t) ** 2 * start + 2 * t * (1 - t) * middle + t**2 * end)


def _at(line: FloatArray, share: float) -> FloatArray:
    run = np.linspace(0, 1, len(line))
    return np.array([np.interp(share, run, line[:, c]) for c in range(2)])


def _put(
    rgb: Floats, alpha: Floats, cell: shapes.Cell, picture: Callable[[int], tuple[Floats, Floats]]
) -> None:  # fmt: skip
    """Paint a picture and set it into its cell, its colour carried on over what is clear."""
    left, top, right, bottom = (round(edge * shapes.ATLAS_PX) for edge in cell)
    size = right - left
    large, cover = picture(size * FINER)
    there = cover.reshape(size, FINER, size, FINER)
    total = (large * cover[..., None]).reshape(size, FINER, size, FINER, 3).mean(axis=(1, 3))
    mean = there.mean(axis=(1, 3))
    rim = round(shapes.PAD * shapes.ATLAS_PX)
    wide = np.pad(mean, rim)
    colour = spread(np.pad(total / np.maximum(mean, 1e-6)[..., None], ((rim, rim), (rim, rim), (0, 0))), wide)
    box = (slice(top - rim, bottom + rim), slice(left - rim, right + rim))
    rgb[box], alpha[box] = colour, wide


def encoded(light: NDArray[np.floating]) -> FloatArray:
    """Return linear light as sRGB."""
    value = np.clip(np.asarray(light, np.float64), 0.0, 1.0)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


SRGB_OF_ROOT = np.round(255 * encoded(np.linspace(0.0, 1.0, 4096) ** 2)).astype(np.uint8)  # of square roots of light


def few_colours_png(rgb: Floats, alpha: Floats, colours: tuple[int, ...]) -> bytes:
    """Return a picture, linear, as PNG of so many colours for each step of alpha, from clear to opaque."""
    root = np.sqrt(np.clip(rgb, 0.0, 1.0).reshape(-1, 3), dtype=np.float32)
    colour = SRGB_OF_ROOT[(root * (len(SRGB_OF_ROOT) - 1) + 0.5).astype(np.int32)]
    step = np.round(alpha.ravel() * (len(colours) - 1)).astype(np.int64)
    index = np.zeros(len(colour), np.uint8)
    palette, clearness, used = [], [], 0
    for level, most in enumerate(colours):
        rows = np.flatnonzero(step == level)
        if len(rows) == 0:
            continue
        how = Image.Quantize.MAXCOVERAGE if level == len(colours) - 1 else Image.Quantize.MEDIANCUT
        part = Image.fromarray(colour[rows][None], "RGB").quantize(most, how, dither=Image.Dither.NONE)
        number = np.asarray(part)[0]
        shades = np.array(part.getpalette(), np.uint8).reshape(-1, 3)[: int(number.max()) + 1]
        index[rows] = number + used
        palette.append(shades)
        clearness += [round(255 * level / (len(colours) - 1))] * len(shades)
        used += len(shades)
    picture = Image.fromarray(index.reshape(alpha.shape), "P")
    picture.putpalette(np.concatenate(palette).tobytes())
    stream = io.BytesIO()
    picture.save(stream, format="PNG", transparency=bytes(clearness), compress_level=9, optimize=True)
    return stream.getvalue()


def bark_texture(species: Species, look: Look) -> bytes:
    """Paint a metre of a species' bark: PNG that tiles to all sides, upward on the stem being up."""
    rgb = paint_bark(species.id, species.habit, linear(look.bark), rng_for(0, "bark texture", species.id))
    picture = Image.fromarray(np.round(255 * encoded(rgb)).astype(np.uint8), "RGB")
    stream = io.BytesIO()
    reduced = picture.quantize(BARK_COLOURS, Image.Quantize.MEDIANCUT, kmeans=0, dither=Image.Dither.NONE)
    reduced.save(stream, format="PNG", compress_level=9, optimize=True)
    return stream.getvalue()
