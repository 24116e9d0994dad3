"""Weak labels: trees are canopy, lawns are not, and what cannot be told is unknown."""

from functools import partial

import numpy as np
import pytest

from urbanforest_cli.core.coverage_model import CLASSES
from urbanforest_cli.imagery.labels import (
    LabelRule,
    LabelSource,
    derive_labels,
    fit_rules,
    ndvi,
    otsu_threshold,
    vegetation_label,
)
from urbanforest_cli.imagery.vegetation_index import ndvi_histogram

SIDE = 160
ALL = np.ones((SIDE, SIDE), bool)


def scene(seed, *, group="town", crowns=14, brightness=1.0, marked=None):
    """Asphalt, two lawns and lumpy crowns with shadows; returns the source, the crowns' mask and the lawns'."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:SIDE, :SIDE]
    bands = np.full((4, SIDE, SIDE), 100.0)
    lawn = (rows // 40 % 2 == 0) & (cols > 20) & (cols < 140)
    bands[:, lawn] = np.array([95, 125, 80, 190.0])[:, None]
    centres = rng.uniform(12, SIDE - 12, (200, 2))
    kept = []
    for centre in centres:
        if len(kept) < crowns and all(np.hypot(*(centre - other)) > 20 for other in kept):
            kept.append(centre)
    crown = np.zeros((SIDE, SIDE), bool)
    for row, col in kept:
        radius = rng.uniform(4, 7)
        shade = np.hypot(rows - row + 4, cols - col + 3) < radius
        bands[:, shade] *= 0.45
    for row, col in kept:
        radius = rng.uniform(4, 7)
        inside = np.hypot(rows - row, cols - col) < radius
        lumps = 1.0 + 0.25 * rng.normal(size=(SIDE, SIDE))
        bands[:, inside] = (np.array([45, 65, 45, 130.0])[:, None] * lumps[None, inside]).clip(8)
        crown |= inside
    bands += rng.normal(0, 2, bands.shape)
    pixels = (bands * brightness).clip(0, 255).astype(np.uint8)
    trees = np.array(kept) + 0.5
    trees = trees if marked is None else trees[:marked]
    source = LabelSource(f"{group}_{seed}", group, pixels[:3], pixels[3], ALL, trees, (0.6, 0.6))
    return source, crown, lawn & ~crown


def test_index_is_the_normalised_difference_and_0_for_black():
    found = ndvi(np.array([[200, 50, 0]], np.uint8), np.array([[50, 200, 0]], np.uint8))
    np.testing.assert_allclose(found, [[0.6, -0.6, 0.0]])


def test_threshold_lies_between_two_clouds_and_histograms_add_up():
    rng = np.random.default_rng(1)
    low, high = rng.normal(-0.1, 0.03, 5000).astype("f4"), rng.normal(0.4, 0.05, 1500).astype("f4")
    parts = sum(ndvi_histogram(part, np.ones(part.shape, bool)) for part in (low, high))
    both = np.concatenate([low, high])
    np.testing.assert_array_equal(parts, ndvi_histogram(both, np.ones(both.shape, bool)))
    assert 0.05 < otsu_threshold(parts) < 0.25


def test_threshold_is_where_the_variance_between_both_sides_is_largest():
    values = np.random.default_rng(2).normal(0.1, 0.3, 4000).clip(-0.99, 0.99).astype("f4")
    found = otsu_threshold(ndvi_histogram(values, np.ones(values.shape, bool)))
    edges = np.arange(1, 512) * 2 / 512 - 1

    def between(edge):
        below = values < edge
        return below.mean() * (1 - below.mean()) * (values[below].mean() - values[~below].mean()) ** 2

    best = max(edges[100:400], key=between)
    assert found == pytest.approx(best, abs=0.02)


def test_threshold_of_one_value_or_none_is_that_value_or_0():
    assert otsu_threshold(np.zeros(512, np.int64)) == 0.0
    one = ndvi_histogram(np.full(9, 0.25, "f4"), np.ones(9, bool))
    assert otsu_threshold(one) == pytest.approx(0.25, abs=0.004)


def test_vegetation_is_even_at_the_threshold_and_unknown_where_there_is_no_image():
    index = np.array([[0.1, 0.13, 0.07, 0.9]], "f4")
    found = vegetation_label(index, 0.1, np.array([[True, True, True, False]]))
    assert found.tolist() == [[50, 73, 27, 255]]


@pytest.fixture(scope="module")
def town():
    scenes = [scene(seed) for seed in range(6)]
    sources = [entry[0] for entry in scenes]
    return scenes, fit_rules(len(sources), sources.__getitem__, canopy=True)["town"]


def test_crowns_are_canopy_and_lawns_are_not(town):
    scenes, rule = town
    ious = []
    for source, crown, lawn in scenes:
        canopy, vegetation = derive_labels(source, rule, CLASSES)
        sure = canopy != 255
        covered = sure & (canopy >= 50)
        ious.append((covered & crown & sure).sum() / ((covered | crown) & sure).sum())
        assert covered[crown & sure].mean() > 0.97
        assert covered[lawn & sure].mean() < 0.1
        assert (vegetation[lawn] >= 50).mean() > 0.95
        assert covered.mean() < 0.3 * (vegetation >= 50).mean()
        assert sure.mean() > 0.98
    assert np.mean(ious) > 0.65


def test_every_marked_tree_is_canopy_also_where_nothing_is_green(town):
    _, rule = town
    source, _, _ = scene(11)
    bare = LabelSource("b", "town", np.full_like(source.rgb, 90), np.full_like(source.nir, 60), ALL,
                       source.trees_px, (0.6, 0.6))  # fmt: skip
    for image in (source, bare):
        canopy = derive_labels(image, rule, ("canopy",))[0]
        at = canopy[tuple(np.floor(image.trees_px).astype(int).T)]
        assert ((at >= 50) & (at <= 100)).all()


def test_tree_that_nobody_marked_is_never_surely_canopy(town):
    _, rule = town
    source, crown, _ = scene(12, marked=0)
    canopy = derive_labels(source, rule, ("canopy",))[0]
    inside = canopy[crown]
    assert ((inside < 50) | (inside == 255)).all()
    assert (inside == 255).mean() > 0.5


def test_canopy_is_unknown_where_nobody_looked_and_both_where_there_is_no_image(town):
    _, rule = town
    source, _, _ = scene(13)
    half = ALL.copy()
    half[:, :80] = False
    hidden = LabelSource("h", "town", source.rgb, source.nir, half, None, (0.6, 0.6))
    canopy, vegetation = derive_labels(hidden, rule, CLASSES)
    assert (canopy == 255).all()
    np.testing.assert_array_equal(vegetation == 255, ~half)
    seen = LabelSource("s", "town", source.rgb, source.nir, half, source.trees_px, (0.6, 0.6))
    assert (derive_labels(seen, rule, ("canopy",))[0][~half] == 255).all()


def test_labels_know_no_order_of_images_and_no_threads(town):
    from concurrent.futures import ThreadPoolExecutor

    scenes, rule = town
    sources = [entry[0] for entry in scenes]
    with ThreadPoolExecutor(3) as pool:
        again = fit_rules(len(sources), sources.__getitem__, canopy=True, mapped=pool.map)["town"]
    backwards = fit_rules(len(sources), sources[::-1].__getitem__, canopy=True)["town"]
    first = derive_labels(sources[0], rule, CLASSES)
    np.testing.assert_array_equal(first, derive_labels(sources[0], again, CLASSES))
    other = derive_labels(sources[0], backwards, CLASSES)
    assert (first != other).mean() < 0.001


def test_groups_have_rules_of_their_own():
    bright, dim = scene(20, group="bright")[0], scene(21, group="dim", brightness=0.6)[0]
    rules = fit_rules(2, [bright, dim].__getitem__, canopy=True)
    assert rules["dim"].median_brightness == pytest.approx(0.6 * rules["bright"].median_brightness, rel=0.05)
    assert rules["bright"].look is not None
    plain = fit_rules(2, [bright, dim].__getitem__, canopy=False)
    assert plain["dim"] == LabelRule(rules["dim"].ndvi_threshold, rules["dim"].median_brightness, None)


def test_gaps_inside_crowns_are_filled_and_gaps_between_them_are_not(town):
    from urbanforest_cli.imagery.crown_regions import Surface, canopy_label

    index = np.full((60, 60), 0.5, "f4")
    index[28:31, 20:22] = -0.3
    index[10:50, 40:60] = -0.3
    surface = Surface(
        index, np.zeros((60, 60, 1), "f4"), np.array([[30.5, 30.5]]), 0.1, (0.6, 0.6), np.ones((60, 60), bool)
    )
    canopy = canopy_label(surface, np.full((60, 60), 6.0, "f4"))
    assert (canopy[28:31, 20:22] == 70).all()
    assert (canopy[20:40, 45:] < 5).all()


@pytest.mark.slow
def test_naip_trees_are_canopy_on_clearly_less_area_than_vegetation(real_data):
    from urbanforest_cli.core.notices import Notices
    from urbanforest_cli.files.image_pair_blocks import ImageOptions, blocks_of, look_at, read_block
    from urbanforest_cli.files.image_pair_layout import list_pairs
    from urbanforest_cli.files.image_pair_trees import trees_by_image, trees_of

    found = list_pairs(real_data / "naip_california", None)
    images = [look_at(entry, ImageOptions(), Notices()) for entry in found.files if entry.group == "palm_springs_2020"]
    trees = trees_by_image(images, None, looked_for=True, assume_crs=None, notices=Notices())

    def source(item):
        (block,) = blocks_of(images[item])
        pixels = read_block(block, ImageOptions(), nir=True)
        return LabelSource(block.name, "palm", pixels.rgb, pixels.nir, pixels.valid, trees_of(block, trees), (0.6, 0.6))

    rule = fit_rules(len(images), source, canopy=True)["palm"]
    labels = list(map(partial(derive_labels, rule=rule, classes=CLASSES), map(source, range(len(images)))))
    at = [label[0][tuple(np.floor(source(item).trees_px).astype(int).T)] for item, label in enumerate(labels)]
    values = np.concatenate(at)
    assert ((values >= 50) & (values <= 100)).mean() >= 0.95
    canopy, vegetation = np.stack(labels, axis=1)
    assert ((canopy >= 50) & (canopy <= 100)).mean() < 0.6 * (vegetation >= 50).mean()
    assert (canopy == 255).mean() < 0.05
