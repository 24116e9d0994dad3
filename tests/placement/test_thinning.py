import numpy as np
import pytest

from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.thinning import index_within, kept_by_count, kept_by_hash

KEYS = keys_for(1, "density", [str(i) for i in range(400)])
SITE = np.repeat(np.arange(400), 25)


@pytest.mark.parametrize("thin", [kept_by_hash, kept_by_count])
def test_plants_of_a_lower_density_are_among_those_of_a_higher(thin):
    before = np.zeros(len(SITE), dtype=bool)
    for tau in (0.0, 0.2, 0.21, 0.5, 0.9, 1.0):
        kept = thin(SITE, KEYS, np.full(400, tau))
        assert not (before & ~kept).any()
        before = kept


@pytest.mark.parametrize("thin", [kept_by_hash, kept_by_count])
def test_density_one_keeps_all_and_zero_none(thin):
    assert thin(SITE, KEYS, np.ones(400)).all()
    assert not thin(SITE, KEYS, np.zeros(400)).any()


def test_hashing_keeps_the_share_on_average_and_counting_in_every_lot():
    tau = np.full(400, 0.3)
    share = kept_by_hash(SITE, KEYS, tau).mean()
    assert abs(share - 0.3) < 4 * np.sqrt(0.3 * 0.7 / len(SITE))
    counts = np.bincount(SITE, kept_by_count(SITE, KEYS, tau), minlength=400)
    assert set(counts) == {7, 8}
    assert abs(counts.mean() - 7.5) < 0.15


def test_a_lot_is_thinned_alike_whatever_lots_stand_beside_it():
    alone = kept_by_hash(np.zeros(25, dtype=np.int64), KEYS[7:8], np.array([0.5]))
    among = kept_by_hash(SITE, KEYS, np.full(400, 0.5))[SITE == 7]
    assert (alone == among).all()


def test_positions_are_numbered_within_their_lot():
    assert index_within(np.array([0, 0, 2, 2, 2, 5])).tolist() == [0, 1, 0, 1, 2, 0]
    assert index_within(np.zeros(0, dtype=np.int64)).tolist() == []
