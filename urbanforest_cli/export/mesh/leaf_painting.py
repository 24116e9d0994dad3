"""Painting leaves: stamps of one blade or one head of flowers, and pictures put together of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter

from urbanforest_cli.export.mesh.leaf_shapes import LeafShape, blade_outline, blade_veins

FloatArray = NDArray[np.float64]
Floats = NDArray[np.float32]

STAMP_PX = 128
FINER = 4  # a stamp is drawn at so many times its size, and averaged
LEAFLET_SIZE = (0.47, 0.135)  # length and width in a compound leaf, in shares of its square
FLORETS = {"corymb": 9, "umbel": 26, "panicle": 46}
STAMP_SHADE = 1.25  # shade that the brightest value of a stamp stands for
PALE = np.array([0.55, 0.58, 0.28], np.float32)  # linear, of veins
SHADOW = 0.3  # a leaf's, on what lies below it
RIM_PX = 14  # how far from a leaf its colour goes on outside


@dataclass(frozen=True)
class Stamp:
    """A blade or a head of flowers on a square: copies at falling sizes; bands are shade, paleness, unused, alpha."""

    sizes: tuple[Image.Image, ...]
    cover: float

    def nearest(self, size_px: float) -> Image.Image:
        """Return the smallest copy that is no coarser than it will be drawn."""
        found = self.sizes[0]
        for copy in self.sizes[1:]:
            if copy.width >= size_px:
                found = copy
        return found


@dataclass(frozen=True)
class Sprig:
    """A leaf in a picture; lengths in shares of the picture's side, y upward.

    Parameters
    ----------
    foot
        Where its stalk meets the blade.
    turn_rad
        Where its tip points: 0 is up, clockwise.
    length, width
        Of the blade as it is seen.
    rgb
        Linear colour.
    is_flower
        Which of two stamps it is.
    """

    foot: tuple[float, float]
    turn_rad: float
    length: float
    width: float
    rgb: FloatArray
    is_flower: bool = False


def _stamp(shade: Floats, pale: Floats, alpha: Floats) -> Stamp:
    """Put bands together; what is clear takes the shade of what is near, so that no rim turns dark or light."""
    near = spread(np.dstack((shade, pale)), alpha)
    bands = np.dstack((near[..., 0] / STAMP_SHADE, near[..., 1], np.zeros_like(alpha), alpha))
    picture = Image.fromarray(np.clip(np.round(255 * bands), 0, 255).astype(np.uint8), "RGBA")
    sizes = [picture]
    while sizes[-1].width > STAMP_PX // 8:
        sizes.append(sizes[-1].reduce(2))
    return Stamp(tuple(sizes), float(alpha.mean()))


def spread(values: NDArray[np.floating], alpha: Floats) -> Floats:
    """Return (h, w, c) values carried on over what is clear, from what is near by, and from the mean far away."""
    weight = np.maximum(alpha, 0.0).astype(np.float32)
    total = values * weight[..., None]
    mean = total.sum(axis=(0, 1)) / max(float(weight.sum()), 1e-6)
    seen = weight.copy()
    size = 1
    while size <= RIM_PX:
        # A clear pixel takes the mean of those around it that have a colour, ring by ring.
        grown_weight, grown_total = seen.copy(), total.copy()
        for axis in (0, 1):
            for step in (-size, size):
                grown_weight += _shifted(seen, step, axis)
                grown_total += _shifted(total, step, axis)
        empty = seen < 1e-3
        seen = np.where(empty, grown_weight, seen)
        total = np.where(empty[..., None], grown_total, total)
        size *= 2
    filled = total / np.maximum(seen, 1e-6)[..., None]
    return np.asarray(np.where(seen[..., None] < 1e-3, mean, filled), dtype=np.float32)


def _shifted(values: Floats, step: int, axis: int) -> Floats:
    out = np.zeros_like(values)
    here: list[slice] = [slice(None)] * values.ndim
    there = here.copy()
    here[axis] = slice(step, None) if step > 0 else slice(None, step)
    there[axis] = slice(None, -step) if step > 0 else slice(-step, None)
    out[tuple(here)] = values[tuple(there)]
    return out


def _drawn(size_px: int) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    picture = Image.new("L", (size_px * FINER, size_px * FINER), 0)
    return picture, ImageDraw.Draw(picture)


def _pixels(points: FloatArray, size_px: int) -> list[tuple[float, float]]:
    return [(float(x) * size_px * FINER, (1.0 - float(y)) * size_px * FINER) for x, y in points]


def _band(picture: Image.Image) -> Floats:
    return np.asarray(picture.reduce(FINER), dtype=np.float32) / np.float32(255)


def blade_stamp(shape: LeafShape, *, hollow: float = 1.0) -> Stamp:
    """Paint one leaf: darker along its edge and between its veins, one half a little brighter than the other.

    `hollow` is how strongly its surface is bent.
    """
    outline, veins = blade_outline(shape), blade_veins(shape)
    if shape.leaflets:
        veins = veins[:1]  # the side veins of leaflets are too fine to be seen
    mask, draw_mask = _drawn(STAMP_PX)
    rib, draw_rib = _drawn(STAMP_PX)
    half, draw_half = _drawn(STAMP_PX)
    for place, turned in _leaflets(shape):
        draw_mask.polygon(_pixels(outline @ turned + place, STAMP_PX), fill=255)
        right = np.concatenate([outline[outline[:, 0] >= 0.5], [[0.5, 0.0]]])
        draw_half.polygon(_pixels(right @ turned + place, STAMP_PX), fill=255)
        size = float(np.linalg.norm(turned[1]))
        for line, width in veins:
            draw_rib.line(_pixels(line @ turned + place, STAMP_PX), fill=255,
                          width=max(round(width * size * STAMP_PX * FINER), 2))  # fmt: skip
    if shape.leaflets:
        stalk = _pixels(np.array([[0.5, 0.0], [0.5, 0.96]]), STAMP_PX)
        for draw in (draw_mask, draw_rib):
            draw.line(stalk, fill=255, width=round(0.016 * STAMP_PX * FINER))
    alpha, vein, bright = _band(mask), _band(rib), _band(half)
    blurred = np.asarray(mask.reduce(FINER).filter(ImageFilter.GaussianBlur(STAMP_PX / 24)), np.float32) / 255
    pillow = np.asarray(rib.reduce(FINER).filter(ImageFilter.GaussianBlur(STAMP_PX / 40)), np.float32) / 255
    inner = np.clip(2.0 * blurred - 1.0, 0, 1)
    shade = 0.86 + 0.10 * inner + hollow * 0.10 * (bright - 0.5) - 0.22 * pillow + 0.30 * vein
    return _stamp(shade.astype(np.float32), vein, alpha)


def _leaflets(shape: LeafShape) -> list[tuple[FloatArray, FloatArray]]:
    """Return where each blade of a leaf lies: an offset, and rows to which its x and y turn."""
    if shape.leaflets == 0:
        return [(np.zeros(2), np.eye(2))]
    length, width = LEAFLET_SIZE
    found = []
    for pair in range(shape.leaflets):
        at = 0.10 + 0.84 * pair / (shape.leaflets - 1)
        size = 1.0 - 0.35 * abs(2 * pair / (shape.leaflets - 1) - 0.9)
        for side in (-1.0, 1.0):
            angle = side * (1.30 - 0.55 * pair / (shape.leaflets - 1))
            ahead, across = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
            turned = np.stack((width * size * across, length * size * ahead))
            found.append((np.array([0.5, at + 0.012 * side]) - 0.5 * turned[0], turned))
    return found


def flower_stamp(kind: str, rng: np.random.Generator) -> Stamp:
    """Paint a head of flowers: few large ones of cherries, a flat head, or a cone."""
    mask, draw_mask = _drawn(STAMP_PX)
    light, draw_light = _drawn(STAMP_PX)
    heart, draw_heart = _drawn(STAMP_PX)
    count = FLORETS[kind]
    petal = {"corymb": 0.105, "umbel": 0.055, "panicle": 0.05}[kind]
    for number in range(count):
        if kind == "panicle":
            y = 0.06 + 0.88 * ((number + 0.5) / count) ** 0.8
            x = 0.5 + 0.40 * (1.05 - y) * rng.uniform(-1, 1)
        else:
            away, angle = 0.36 * np.sqrt((number + 0.5) / count), 2.4 * number
            x, y = 0.5 + away * np.cos(angle), 0.5 + away * np.sin(angle)
        bright = int(200 + 55 * rng.random())
        turn = rng.uniform(0, 2 * np.pi)
        petals = 4 if kind == "panicle" else 5
        for part in range(petals):
            angle = turn + 2 * np.pi * part / petals
            centre = np.array([x + petal * np.cos(angle), y + petal * np.sin(angle)])
            corners = _pixels(np.stack((centre - 0.72 * petal, centre + 0.72 * petal)), STAMP_PX)
            box = (corners[0][0], corners[1][1], corners[1][0], corners[0][1])
            draw_mask.ellipse(box, fill=255)
            draw_light.ellipse(box, fill=bright - 12 * (part % 2), outline=bright - 45)
            draw_heart.ellipse(box, fill=0)
        middle = _pixels(np.array([[x - 0.3 * petal, y - 0.3 * petal], [x + 0.3 * petal, y + 0.3 * petal]]), STAMP_PX)
        draw_heart.ellipse((middle[0][0], middle[1][1], middle[1][0], middle[0][1]), fill=190)
    alpha = _band(mask)
    return _stamp((_band(light) / np.maximum(alpha, 0.05)).clip(0.0, 1.2).astype(np.float32), _band(heart), alpha)


def paint(
    sprigs: Sequence[Sprig], blade: Stamp, flower: Stamp | None, size_px: int, *, stalks: Sequence[FloatArray] = (),
    bark: NDArray[np.floating] | None = None, pale: float = 0.45,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Paint leaves over each other, the first at the back.

    Parameters
    ----------
    stalks
        Lines of (m, 2) points of the twiglets behind them, in the colour `bark`.
    pale
        How far veins are on the way to a pale green.

    Returns
    -------
    (h, w, 3) linear colours, (h, w) alpha
    """
    rgb = np.zeros((size_px, size_px, 3), np.float32)
    alpha = np.zeros((size_px, size_px), np.float32)
    if bark is not None:
        twigs, draw = _drawn(size_px // FINER)
        for line in stalks:
            draw.line(_pixels(line, size_px // FINER), fill=255, width=max(size_px // 110, 1))
        alpha[: twigs.height, : twigs.width] = np.asarray(twigs, np.float32) / 255
        rgb[:] = bark
    for sprig in sprigs:
        _press(rgb, alpha, sprig, _stamp_of(sprig, blade, flower), pale)
    return rgb, alpha


def cover(sprigs: Sequence[Sprig], blade: Stamp, flower: Stamp | None, size_px: int) -> float:
    """Return the share of a picture that leaves cover."""
    seen = Image.new("L", (size_px, size_px), 0)
    for sprig in sprigs:
        copy, box, matrix = _lying(sprig, _stamp_of(sprig, blade, flower), size_px)
        piece = copy.getchannel("A").transform((box[2] - box[0], box[3] - box[1]), Image.Transform.AFFINE, matrix,
                                               Image.Resampling.BILINEAR)  # fmt: skip
        seen.paste(255, box, piece)
    return float(np.asarray(seen, np.float32).mean()) / 255


def _stamp_of(sprig: Sprig, blade: Stamp, flower: Stamp | None) -> Stamp:
    return flower if sprig.is_flower and flower is not None else blade


def _lying(
    sprig: Sprig, stamp: Stamp, size_px: int
) -> tuple[Image.Image, tuple[int, int, int, int], tuple[float, ...]]:
    """Return which copy of a stamp is drawn, into what box of the picture, and the way from there to the stamp.

    What would reach over the picture's edge is moved inward.
    """
    sine, cosine = float(np.sin(sprig.turn_rad)), float(np.cos(sprig.turn_rad))
    wide, long = sprig.width * size_px, sprig.length * size_px
    reach_x, reach_y = 0.5 * (wide * abs(cosine) + long * abs(sine)), 0.5 * (wide * abs(sine) + long * abs(cosine))
    middle_x = sprig.foot[0] * size_px + 0.5 * long * sine
    middle_y = (1.0 - sprig.foot[1]) * size_px - 0.5 * long * cosine
    middle_x = min(max(middle_x, reach_x), max(size_px - reach_x, 0.5 * size_px))
    middle_y = min(max(middle_y, reach_y), max(size_px - reach_y, 0.5 * size_px))
    left, right = max(int(middle_x - reach_x) - 1, 0), min(int(middle_x + reach_x) + 2, size_px)
    top, bottom = max(int(middle_y - reach_y) - 1, 0), min(int(middle_y + reach_y) + 2, size_px)
    copy = stamp.nearest(long)
    dx, dy, half = left - middle_x, top - middle_y, 0.5 * copy.width
    across, ahead = copy.width / max(wide, 1e-6), copy.width / max(long, 1e-6)
    matrix = (cosine * across, sine * across, half + (cosine * dx + sine * dy) * across,
              -sine * ahead, cosine * ahead, half + (cosine * dy - sine * dx) * ahead)  # fmt: skip
    return copy, (left, top, right, bottom), matrix


def _press(rgb: Floats, alpha: Floats, sprig: Sprig, stamp: Stamp, pale: float) -> None:
    """Paint one leaf into a picture, with a soft shadow on what lies below it."""
    copy, (left, top, right, bottom), matrix = _lying(sprig, stamp, len(alpha))
    piece = copy.transform((right - left, bottom - top), Image.Transform.AFFINE, matrix, Image.Resampling.BILINEAR)
    bands = np.asarray(piece, dtype=np.float32) * np.float32(1 / 255)
    there = bands[..., 3]
    colour = sprig.rgb.astype(np.float32) * (bands[..., :1] * np.float32(STAMP_SHADE))
    colour += pale * bands[..., 1:2] * (PALE - colour)
    below = rgb[top:bottom, left:right]
    below[2:] *= 1.0 - np.float32(SHADOW) * there[:-2, :, None]
    # Colours are not mixed with what is clear: a half covered pixel has the whole colour of what covers it.
    seen = alpha[top:bottom, left:right]
    seen += there * (1 - seen)
    below += (colour - below) * (there / np.maximum(seen, np.float32(1e-6)))[..., None]
