import numpy as np

from urbanforest_cli.core.randomness import hash_uniform, key_for, keys_for, rng_for


def test_keys_in_bulk_are_the_keys_one_by_one():
    items = ["a", "b", "Résidentiel", "\ud800"]
    assert keys_for(3, "place", items).tolist() == [key_for(3, "place", item) for item in items]


def test_a_key_hangs_on_seed_stage_and_item():
    keys = {key_for(s, stage, item) for s in (0, 1) for stage in ("a", "b") for item in ("x", "y")}
    assert len(keys) == 8


def test_streams_are_reproducible_and_distinct():
    assert rng_for(1, "s", "a").random() == rng_for(1, "s", "a").random()
    assert rng_for(1, "s", "a").random() != rng_for(1, "s", "b").random()


def test_hashed_uniforms_are_uniform():
    keys = keys_for(0, "test", [str(i) for i in range(200)])
    u = hash_uniform(np.repeat(keys, 500), np.tile(np.arange(500), 200))
    assert u.min() >= 0
    assert u.max() < 1
    counts = np.histogram(u, bins=50, range=(0, 1))[0]
    chi2 = ((counts - 2000) ** 2 / 2000).sum()
    assert chi2 < 85  # 49 degrees of freedom, p = 0.001
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 0.01
