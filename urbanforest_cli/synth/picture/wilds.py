"""Bushes and trees where nobody gardens: on scrub, along tracks and banks, and on land left over in the town."""

from __future__ import annotations

import numpy as np

from urbanforest_cli.synth.lots import Lots
from urbanforest_cli.synth.picture.boxes import clear_of
from urbanforest_cli.synth.picture.country_kernel import SCRUB_BELOW, parcels_at
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.lines import Box, Lines
from urbanforest_cli.synth.picture.looks import LEAVES
from urbanforest_cli.synth.picture.plants import Plants, dressed
from urbanforest_cli.synth.plan import Geometries

_EVERY_M = 7.0
_OFF_LOTS_M, _OFF_CURBS_M, _OFF_WATER_M, _OFF_RAILS_M = 3.0, 6.0, 1.0, 5.5
_IN_SCRUB, _AT_BORDERS, _IN_FIELDS = 0.34, 0.22, 0.004
_BORDER_M = 7.0
_TREE_SHARE = 0.16


def wild_plants(box: Box, lots: Lots, streets: Lines, water: Geometries, rails: Geometries, seed: int) -> Plants:
    """Let plants grow in a box wherever nothing else is."""
    west, south, east, north = box
    cols, rows = int((east - west) / _EVERY_M) + 1, int((north - south) / _EVERY_M) + 1
    number = np.arange(rows * cols)
    draw = Draws(seed, "wild", len(number))
    x = west + (number % cols + draw.uniform("x")) * _EVERY_M
    y = south + (number // cols + draw.uniform("y")) * _EVERY_M
    field, border_m = parcels_at(x, y)
    share = np.where(field < SCRUB_BELOW, _IN_SCRUB, np.where(border_m < _BORDER_M, _AT_BORDERS, _IN_FIELDS))
    chosen = np.flatnonzero(draw.uniform("grows") < share * 2 * draw.uniform("thick"))
    xy = np.column_stack((x, y))[chosen]
    free = clear_of(xy, lots.shapes, _OFF_LOTS_M) & streets.clear_of(xy, _OFF_CURBS_M)
    free &= clear_of(xy, water, _OFF_WATER_M) & clear_of(xy, rails, _OFF_RAILS_M)
    xy = xy[free]
    some = Draws(seed, "wild plant", len(xy))
    tree = some.uniform("tree") < _TREE_SHARE
    radius = np.where(tree, some.uniform("crown", 1.8, 4.6), 0.4 + 1.4 * some.uniform("bush") ** 2)
    height = radius * np.where(tree, some.uniform("tall", 1.5, 2.6), some.uniform("low", 0.8, 1.5))
    return dressed(xy, height, radius, np.where(tree, 0.25, 0.05) * height, some.pick("kind", len(LEAVES)), some)
