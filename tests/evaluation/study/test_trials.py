"""Which lots are shown and beside what."""

import numpy as np
import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.evaluation.study.trials import REAL, Design, choose_lots, design, sizes_by_room


def test_lots_of_all_sizes_are_shown():
    counts = np.arange(400)[:, None] * [1, 1]
    rows = choose_lots([f"lot {n}" for n in range(400)], counts, count=20, min_plants=5, seed=0)
    shown = np.sort(counts[rows, 0])
    assert len(set(rows)) == 20
    assert shown.min() >= 5
    assert np.abs(shown - np.linspace(5, 400, 20)).max() < 40


def test_the_choice_hangs_on_the_seed_and_not_on_the_order_of_lots():
    ids = [f"lot {n}" for n in range(300)]
    counts = np.random.default_rng(2).integers(0, 60, (300, 2))
    turned = np.random.default_rng(3).permutation(300)
    first = {ids[row] for row in choose_lots(ids, counts, count=12, min_plants=3, seed=0)}
    again = {
        ids[turned[row]]
        for row in choose_lots([ids[n] for n in turned], counts[turned], count=12, min_plants=3, seed=0)
    }
    other = {ids[row] for row in choose_lots(ids, counts, count=12, min_plants=3, seed=1)}
    assert first == again != other


def test_a_lot_with_too_few_plants_in_any_set_is_not_shown():
    counts = np.array([[9, 1], [9, 9], [1, 9]])
    assert choose_lots(["a", "b", "c"], counts, count=5, min_plants=4, seed=0) == [1]
    with pytest.raises(InputError, match="no lot can be shown"):
        choose_lots(["a", "b", "c"], counts, count=5, min_plants=10, seed=0)


def test_every_lot_is_paired_with_every_category_and_names_tell_nothing():
    plan = design(["a", "b"], ["placed", "random"], seed=0, fingerprint="x")
    assert {(trial.lot_id, trial.category) for trial in plan.trials} == {
        (lot, category) for lot in "ab" for category in ("placed", "random")
    }
    assert len({picture.name for picture in plan.pictures}) == 6
    real = {picture.name for picture in plan.pictures if picture.category == REAL}
    assert {trial.real for trial in plan.trials} == real
    assert [picture.name for picture in plan.pictures] == sorted(picture.name for picture in plan.pictures)


def test_a_design_comes_back_from_its_record_and_a_broken_one_does_not():
    plan = design(["a", "b"], ["placed"], seed=0, fingerprint="x")
    assert Design.from_record(plan.as_record()) == plan
    record = plan.as_record()
    record["trials"][0]["real"] = "nobody"
    with pytest.raises(ValueError, match="not there"):
        Design.from_record(record)


def test_plants_with_more_room_get_larger_crowns():
    xy = np.array([[0, 0], [1, 0], [50, 0], [54, 0], [200, 0]], float)
    pool = np.linspace(1, 5, 40)
    sizes = pool[sizes_by_room(xy, pool, np.random.default_rng(0))]
    assert max(sizes[:2]) <= min(sizes[2:4]) <= max(sizes[2:4]) <= sizes[4]
