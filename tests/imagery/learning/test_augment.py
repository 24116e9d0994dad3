from dataclasses import replace

import numpy as np
import pytest

from tests.imagery.learning.pairs import Discs
from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.imagery.learning import augment
from urbanforest_cli.imagery.learning.augment import CropSource, oriented
from urbanforest_cli.imagery.learning.settings import SMALL, Jitter
from urbanforest_cli.imagery.learning.tiles import Tile, TileLook, normalised

SETTINGS = replace(SMALL, crop_px=32, load_px=32, batch=4, downs=2)
NO_CHANGE = replace(Jitter().scaled(0.0), transfer=0.0, blur=0.0)


def tiles_and_looks(count=3, side=64, groups=("a", "b")):
    """Tiles whose truth repeats the red channel, so that both can be compared after any turn."""
    rng = np.random.default_rng(1)
    tiles, looks = [], []
    for index in range(count):
        rgb = rng.integers(0, 100, (3, side, side)).astype(np.uint8)
        tiles.append(Tile(str(index), rgb, rgb[:1].copy()))
        group = groups[index % len(groups)]
        looks.append(TileLook(group, (side, side), (0.2, 0.2, 0.2), (0.1, 0.1, 0.1), True))
    return tiles, looks


def source(settings=SETTINGS, **what):
    return CropSource(*tiles_and_looks(**what), settings)


def test_image_and_truth_are_cropped_and_turned_alike():
    batch = source(replace(SETTINGS, jitter=None)).batch(0, 0)
    np.testing.assert_array_equal(batch.images[:, 0], normalised(batch.truths[:, 0]))


def test_a_sample_is_the_same_whatever_was_drawn_before():
    first, second = source(), source()
    for epoch, step in ((0, 0), (0, 1), (1, 2)):
        first.batch(epoch, step)
    late, fresh = first.batch(2, 1), second.batch(2, 1)
    np.testing.assert_array_equal(late.images, fresh.images)
    np.testing.assert_array_equal(late.truths, fresh.truths)


def test_epochs_and_seeds_differ():
    one, other = source(), source(replace(SETTINGS, seed=1))
    assert (one.batch(0, 0).images != one.batch(1, 0).images).any()
    assert (one.batch(0, 0).images != other.batch(0, 0).images).any()


def test_each_epoch_has_an_order_of_its_own():
    made = source(replace(SETTINGS, jitter=None, batch=6), count=6, side=32)
    orders = {tuple(made.batch(epoch, 0).truths.sum(axis=(1, 2, 3)).tolist()) for epoch in range(5)}
    assert len(orders) == 5
    assert len({tuple(sorted(order)) for order in orders}) == 1


def test_an_epoch_has_as_many_crops_as_fit_and_shows_each_tile_alike():
    made = source(replace(SETTINGS, jitter=None))
    assert made.steps_an_epoch == 3 * 4 // 4
    tiles, _ = tiles_and_looks()
    seen = [0, 0, 0]
    for step in range(made.steps_an_epoch):
        for truth in made.batch(0, step).truths:
            for index, tile in enumerate(tiles):
                seen[index] += any(is_within(oriented(truth, turn), tile.truth) for turn in range(8))
    assert seen == [4, 4, 4]


def is_within(part, whole):
    corner = part[0, :4, :4]
    windows = np.lib.stride_tricks.sliding_window_view(whole[0], (4, 4))
    return bool((windows == corner).all(axis=(2, 3)).any())


def test_fewer_crops_than_a_batch_fill_it_with_different_ones():
    made = source(replace(SETTINGS, batch=6), count=1, side=40)
    batch = made.batch(0, 0)
    assert made.steps_an_epoch == 1
    assert len({image.tobytes() for image in batch.images}) == 6


def test_all_eight_orientations_and_no_other_are_shown():
    still = replace(SETTINGS, jitter=None, crop_px=32, load_px=32)
    for dihedral, expected in ((True, 8), (False, 2)):
        made = source(replace(still, dihedral=dihedral), count=1, side=32)
        tile = tiles_and_looks(count=1, side=32)[0][0]
        turns = {oriented(tile.truth, turn).tobytes(): turn for turn in range(8)}
        seen = {turns[made.batch(epoch, 0).truths[0].tobytes()] for epoch in range(60)}
        assert len(seen) == expected
        assert dihedral or seen == {0, 4}


def test_a_tile_smaller_than_a_crop_is_mirrored_and_unknown_around():
    made = source(replace(SETTINGS, jitter=None, dihedral=False), count=1, side=20)
    batch = made.batch(0, 0)
    assert (batch.truths != UNKNOWN).sum() == 4 * 20 * 20
    assert np.isfinite(batch.images).all()
    assert (batch.images < 0).all()  # mirrored values are of the image too, and that is dark


def test_jitter_changes_the_image_within_bounds_and_leaves_the_truth():
    wild_jitter = replace(Jitter().scaled(4.0), zoom=0.0)
    plain, strong = source(replace(SETTINGS, jitter=NO_CHANGE)), source(replace(SETTINGS, jitter=wild_jitter))
    calm, wild = plain.batch(0, 0), strong.batch(0, 0)
    np.testing.assert_array_equal(calm.truths, wild.truths)
    assert np.abs(calm.images - wild.images).mean() > 0.1
    assert wild.images.min() >= -1.0
    assert wild.images.max() <= 1.0


@pytest.mark.parametrize("name", ["gain", "channel_gain", "gamma", "contrast", "saturation", "channel_offset", "noise"])
def test_each_spread_does_something_of_its_own(name):
    still = source(replace(SETTINGS, jitter=NO_CHANGE)).batch(0, 0).images
    moved = source(replace(SETTINGS, jitter=replace(NO_CHANGE, **{name: 0.2}))).batch(0, 0).images
    change = moved - still
    assert np.abs(change).max() > 0.01
    if name == "saturation":
        unclipped = (np.abs(moved) < 1.0).all(axis=1)
        np.testing.assert_allclose(change.mean(axis=1)[unclipped], 0.0, atol=1e-5)
    if name == "noise":
        assert change.std() == pytest.approx(0.4, rel=0.2)  # from -1 to 1, and clipped
    if name == "channel_offset":
        inside = change[0][:, (moved[0] > -0.99).all(axis=0)]
        assert inside.std(axis=1).max() < 0.02


def test_zoom_shows_crops_larger_and_smaller_and_truths_with_them():
    settings = replace(SETTINGS, jitter=replace(NO_CHANGE, zoom=0.3), batch=32)
    batch = source(settings).batch(0, 0)
    still = source(replace(settings, jitter=NO_CHANGE)).batch(0, 0)
    assert batch.images.shape == still.images.shape
    assert batch.truths.shape == still.truths.shape
    assert (batch.images != still.images).any(axis=(1, 2, 3)).mean() > 0.9


def test_zoom_keeps_image_and_truth_over_each_other():
    ramp = np.tile(np.linspace(0.0, 1.0, 90, dtype=np.float32), (3, 90, 1))
    shown = augment.interpolated(ramp, 64)
    truth = augment.nearest((ramp[:1] * 100).astype(np.uint8), 64)
    np.testing.assert_allclose(shown[0] * 100, truth[0], atol=1.7)


def test_blur_takes_detail_and_keeps_the_mean():
    image = np.random.default_rng(0).random((3, 64, 64)).astype(np.float32)
    blurred = image.copy()
    augment.blur(blurred, 1.0, np.random.default_rng(1))
    assert blurred.std() < 0.7 * image.std()
    assert blurred.mean() == pytest.approx(image.mean(), abs=0.01)
    untouched = image.copy()
    augment.blur(untouched, 0.0, np.random.default_rng(1))
    np.testing.assert_array_equal(untouched, image)


def test_without_spread_images_are_in_true_colours():
    jittered = source(replace(SETTINGS, jitter=NO_CHANGE)).batch(0, 0).images
    plain = source(replace(SETTINGS, jitter=None)).batch(0, 0).images
    np.testing.assert_allclose(jittered, plain, atol=1e-6)


def test_transfer_brings_the_colours_of_the_other_group():
    tiles, looks = tiles_and_looks(count=2)
    bright = replace(looks[1], mean=(0.7, 0.2, 0.2))
    settings = replace(SETTINGS, jitter=replace(NO_CHANGE, transfer=1.0), batch=64)
    moved = CropSource(tiles, [looks[0], bright], settings).batch(0, 0).images
    still = CropSource(tiles, [looks[0], bright], replace(settings, jitter=NO_CHANGE)).batch(0, 0).images
    by_channel = np.abs(moved - still).mean(axis=(0, 2, 3))
    assert by_channel[0] > 0.2
    assert by_channel[1:].max() < 1e-6


def test_statistics_are_taken_of_true_colours():
    strong = source(replace(SETTINGS, jitter=Jitter().scaled(4.0)))
    batch = strong.plain_batch(0, 4)
    np.testing.assert_array_equal(batch.images[:, 0], normalised(batch.truths[:, 0]))


def test_discs_are_found_by_their_colour():
    """The stand-in of other tests is learnable, and by no accident of its making."""
    pair = Discs()[0]
    green = pair.rgb[1].astype(int) > pair.rgb[0].astype(int) + 15
    assert (green == (pair.truth[0] > 50)).mean() > 0.8
