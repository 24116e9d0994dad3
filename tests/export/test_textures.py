import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from PIL import Image

from urbanforest_cli.core import config as settings
from urbanforest_cli.export.mesh.bark import BARK_PX
from urbanforest_cli.export.mesh.leaf_painting import Sprig, blade_stamp, cover, paint, spread
from urbanforest_cli.export.mesh.leaf_shapes import (
    ATLAS_PX,
    CLUMP_CELLS,
    CLUMP_COVER,
    FLOWER_CELLS,
    LEAF_CELLS,
    LEAF_COVER,
    SHAPES,
    SPRAY_CELLS,
    SPRAY_COVER,
    blade_outline,
    shape_of,
)
from urbanforest_cli.export.mesh.leaves import texture_rgb
from urbanforest_cli.export.mesh.textures import ALPHA_CUTOFF, bark_texture, encoded, few_colours_png, leaf_texture
from urbanforest_cli.export.plant_looks import in_season, look_of
from urbanforest_cli.export.plant_scene import linear
from urbanforest_cli.files.species import load_catalogue

CATALOGUE = load_catalogue(settings.Config().species)
LEAF_BYTES, BARK_BYTES = 120_000, 90_000


@cache
def atlas(species_id, season="summer"):
    species = CATALOGUE[species_id]
    png = leaf_texture(species, look_of(species), season)
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"), np.float64) / 255


def part(picture, cell):
    left, top, right, bottom = (round(edge * ATLAS_PX) for edge in cell)
    return picture[top:bottom, left:right]


@pytest.mark.parametrize("species_id", CATALOGUE.ids)
def test_an_atlas_is_small_and_each_cell_covered_as_cards_count_on(species_id):
    species = CATALOGUE[species_id]
    png = leaf_texture(species, look_of(species), "summer")
    assert len(png) <= LEAF_BYTES
    assert leaf_texture(species, look_of(species), "summer") == png
    picture = atlas(species_id)
    assert picture.shape == (ATLAS_PX, ATLAS_PX, 4)
    for cells, share in ((LEAF_CELLS, LEAF_COVER), (SPRAY_CELLS, SPRAY_COVER), (CLUMP_CELLS, CLUMP_COVER)):
        for cell in cells:
            assert part(picture, cell)[..., 3].mean() == pytest.approx(share, rel=0.05)
            assert (part(picture, cell)[..., 3] > ALPHA_CUTOFF).mean() == pytest.approx(share, rel=0.12)
    inside = np.zeros((ATLAS_PX, ATLAS_PX), bool)
    for cell in (*LEAF_CELLS, *FLOWER_CELLS, *SPRAY_CELLS, *CLUMP_CELLS):
        part(inside, cell)[:] = True
    assert picture[..., 3][~inside].max() == 0


def test_a_species_without_a_shape_gets_a_plain_leaf():
    species = replace(CATALOGUE["tilia_cordata"], id="ginkgo_biloba")
    picture = Image.open(io.BytesIO(leaf_texture(species, look_of(species), "summer"))).convert("RGBA")
    alpha = part(np.asarray(picture, np.float64) / 255, LEAF_CELLS[0])[..., 3]
    assert alpha.mean() == pytest.approx(LEAF_COVER, rel=0.05)
    Image.open(io.BytesIO(bark_texture(species, look_of(species)))).verify()


def test_lobed_leaves_have_bays_and_plain_ones_none():
    def filled(species_id):
        """Return the share of its convex hull that a blade fills."""
        blade = shapely.Polygon(blade_outline(shape_of(species_id)))
        assert blade.is_valid
        return blade.area / blade.convex_hull.area

    bays = {name: filled(name) for name in SHAPES}
    assert max(bays[name] for name in ("acer_platanoides", "platanus_acerifolia", "quercus_rubra")) < 0.85
    assert min(bays[name] for name in ("tilia_cordata", "syringa_vulgaris", "cornus_sanguinea")) > 0.92
    assert bays["quercus_rubra"] < bays["platanus_acerifolia"]
    assert len(blade_outline(SHAPES["corylus_avellana"])) > len(blade_outline(SHAPES["tilia_cordata"]))


@pytest.mark.parametrize("season", ["spring", "summer", "autumn"])
def test_colours_go_on_outside_the_leaf_so_that_no_rim_shows(season):
    for species_id in ("acer_platanoides", "prunus_serrulata"):
        picture = atlas(species_id, season)
        size = ATLAS_PX // 4
        rows = picture.reshape(size, 4, size, 4, 4)
        alpha = rows[..., 3].mean(axis=(1, 3))
        # A coarse mip level of the colours alone, where some of a leaf is seen, beside the leaf's own colour there.
        coarse = rows[..., :3].mean(axis=(1, 3))
        own = (rows[..., :3] * rows[..., 3:]).sum(axis=(1, 3)) / np.maximum(rows[..., 3:].sum(axis=(1, 3)), 1e-6)
        edge = (alpha > 0.2) & (alpha < 0.8)
        assert np.abs(coarse - own)[edge].mean() < 0.04
        assert np.abs((coarse - own)[edge].mean(axis=0)).max() < 0.02


def test_leaves_are_painted_near_the_tone_that_tints_bring_down():
    for species_id in CATALOGUE.ids:
        look = in_season(look_of(CATALOGUE[species_id]), "summer")
        for cell in (*LEAF_CELLS, *SPRAY_CELLS):
            shown = part(atlas(species_id), cell)
            mean = linear(shown[shown[..., 3] > 0.9][:, :3]).mean(axis=0)
            np.testing.assert_allclose(mean, texture_rgb(look), rtol=0.3)


def test_flowers_are_painted_in_spring():
    cherry, maple = atlas("prunus_serrulata", "spring"), atlas("acer_platanoides", "spring")
    for cell in FLOWER_CELLS:
        head = part(cherry, cell)
        assert head[..., 3].mean() > 0.3
        red, green, blue = head[head[..., 3] > 0.9][:, :3].mean(axis=0)
        assert red > blue > green > 0.6
        for without in (maple, atlas("prunus_serrulata")):
            red, green, blue = part(without, cell)[part(without, cell)[..., 3] > 0.9][:, :3].mean(axis=0)
            assert green > 1.05 * max(red, blue)
    spray = part(cherry, SPRAY_CELLS[0])
    pink = (spray[..., 2] > spray[..., 1]) & (spray[..., 3] > 0.9)
    assert 0.4 < pink.sum() / (spray[..., 3] > 0.9).sum() < 0.95


@pytest.mark.parametrize("season", ["spring", "summer"])
@pytest.mark.parametrize("species_id", CATALOGUE.ids)
def test_crowns_far_away_do_not_dissolve(species_id, season):
    alpha = atlas(species_id, season)[..., 3]
    for cell in (*SPRAY_CELLS, *CLUMP_CELLS, *LEAF_CELLS):
        seen = (part(alpha, cell) > ALPHA_CUTOFF).mean()
        left, top, right, bottom = cell
        for size in (2, 4, 8, 16, 32, 64):  # of the pixels of a mip level, each the mean of a square
            count = ATLAS_PX // size
            coarse = alpha.reshape(count, size, count, size).mean(axis=(1, 3))
            own = coarse[round(top * count) : round(bottom * count), round(left * count) : round(right * count)]
            assert (own > ALPHA_CUTOFF).mean() >= 0.8 * seen
    quarters = alpha.reshape(2, ATLAS_PX // 2, 2, ATLAS_PX // 2).mean(axis=(1, 3))
    assert quarters.min() > ALPHA_CUTOFF


def test_an_atlas_of_winter_is_clear():
    assert atlas("acer_platanoides", "winter")[..., 3].max() == 0


def bark(species_id):
    species = CATALOGUE[species_id]
    png = bark_texture(species, look_of(species))
    assert len(png) <= BARK_BYTES
    assert bark_texture(species, look_of(species)) == png
    return linear(np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.float64) / 255)


@pytest.mark.parametrize("species_id", CATALOGUE.ids)
def test_bark_tiles_and_has_its_species_colour(species_id):
    picture = bark(species_id)
    assert picture.shape == (BARK_PX, BARK_PX, 3)
    np.testing.assert_allclose(picture.mean(axis=(0, 1)), linear(look_of(CATALOGUE[species_id]).bark), rtol=0.06)
    for axis in (0, 1):
        steps = np.abs(np.diff(picture, axis=axis)).mean(axis=(1 - axis, 2))
        seam = np.abs(np.take(picture, 0, axis=axis) - np.take(picture, -1, axis=axis)).mean()
        assert seam <= steps.max()


def test_bark_runs_along_oaks_and_around_cherries():
    def rough(picture, axis):
        return np.abs(np.diff(picture.mean(axis=2), axis=axis)).mean()

    oak, cherry = bark("quercus_rubra"), bark("prunus_serrulata")
    assert rough(oak, 1) > 1.5 * rough(oak, 0)
    assert rough(cherry, 0) > 1.5 * rough(cherry, 1)
    plane, hazel = (bark(name).mean(axis=2) for name in ("platanus_acerifolia", "corylus_avellana"))
    assert plane.std() / plane.mean() > 1.5 * hazel.std() / hazel.mean()


def test_a_painted_leaf_lies_where_it_was_put():
    blade = blade_stamp(SHAPES["tilia_cordata"])
    sprig = Sprig((0.5, 0.5), np.pi / 2, 0.4, 0.3, np.array([0.2, 0.4, 0.1]))
    rgb, alpha = paint([sprig], blade, None, 200)
    rows, columns = np.nonzero(alpha > 0.5)
    # Its tip points to the right: from the middle to 0.9 of the width, and 0.15 up and down.
    assert abs(columns.min() - 100) <= 3
    assert abs(columns.max() - 180) <= 3
    assert abs(rows.min() - 70) <= 4
    assert abs(rows.max() - 130) <= 4
    assert cover([sprig], blade, None, 200) == pytest.approx(alpha.mean(), rel=0.02)
    assert rgb[alpha > 0.99].mean(axis=0)[1] == pytest.approx(0.4, rel=0.2)
    # What would lie over the edge is moved inward, whole.
    moved = paint([replace(sprig, foot=(0.9, 0.5))], blade, None, 200)[1]
    assert moved.sum() == pytest.approx(alpha.sum(), rel=0.03)


def test_spreading_keeps_colours_and_fills_what_is_clear():
    colour = np.zeros((40, 40, 3), np.float32)
    colour[10:20, 10:20] = (0.2, 0.5, 0.1)
    alpha = np.zeros((40, 40), np.float32)
    alpha[10:20, 10:20] = 1
    np.testing.assert_allclose(spread(colour, alpha), np.broadcast_to((0.2, 0.5, 0.1), (40, 40, 3)), atol=1e-5)


def test_a_picture_of_few_colours_keeps_them():
    rgb, alpha = np.zeros((16, 16, 3), np.float32), np.ones((16, 16), np.float32)
    rgb[:8], rgb[8:] = linear((0.8, 0.2, 0.1)), linear((0.1, 0.6, 0.3))
    alpha[:, :4] = 0
    shown = np.asarray(Image.open(io.BytesIO(few_colours_png(rgb, alpha, (8, 8, 8)))).convert("RGBA"))
    np.testing.assert_allclose(shown[2, 10], (204, 51, 26, 255), atol=2)
    np.testing.assert_allclose(shown[12, 10], (26, 153, 76, 255), atol=2)
    assert shown[:, :4, 3].max() == 0
    np.testing.assert_allclose(encoded(linear(np.linspace(0, 1, 50))), np.linspace(0, 1, 50), atol=1e-9)
