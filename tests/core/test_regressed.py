from __future__ import annotations

import numpy as np
import pandas as pd

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.regressed import overlay
from urbanforest_cli.core.schema import ORIGIN_SUFFIX, REGRESSED

LOTS = 2000
IDS = np.array([f"lot {i}" for i in range(LOTS)], dtype=object)
RESOLVED = {p.name: np.full(LOTS, p.default) for p in PARAMETERS.values()}


def regressed(origin="map"):
    values = {"radius_mean_m": 5.0, "density": 0.5, "cluster_count_max": 2.3}
    columns = {name: values.get(name, 1.0) for name in REGRESSED}
    return pd.DataFrame({"lot_id": IDS} | columns | {name + ORIGIN_SUFFIX: origin for name in REGRESSED})


def test_values_read_come_in_force_and_others_stay():
    found = overlay(IDS, RESOLVED, regressed(), seed=1)
    assert (found.values["radius_mean_m"] == 5).all()
    assert found.read["radius_mean_m"].all()
    assert (found.values["spacing_m"] == RESOLVED["spacing_m"]).all()
    assert not found.read["spacing_m"].any()


def test_values_of_zones_and_own_columns_and_lots_that_it_lacks_stay():
    for origin in ("zone", "own"):
        found = overlay(IDS, RESOLVED, regressed(origin), seed=1)
        assert not found.any_read.any()
        assert all((found.values[name] == RESOLVED[name]).all() for name in PARAMETERS)
    some = overlay(IDS, RESOLVED, regressed().iloc[::2], seed=1)
    assert (some.values["radius_mean_m"][:4] == [5, 3.13, 5, 3.13]).all()
    assert not overlay(IDS, RESOLVED, regressed().iloc[:0], seed=1).any_read.any()


def test_counts_are_whole_and_right_on_average_in_any_order():
    found = overlay(IDS, RESOLVED, regressed(), seed=1).values["cluster_count_max"]
    assert set(found) == {2.0, 3.0}
    assert abs(found.mean() - 2.3) < 0.05
    mixed = overlay(IDS, RESOLVED, regressed().sample(frac=1, random_state=1), seed=1)
    assert (mixed.values["cluster_count_max"] == found).all()


def test_what_was_given_is_not_changed():
    before = RESOLVED["density"].copy()
    overlay(IDS, RESOLVED, regressed(), seed=1)
    assert (RESOLVED["density"] == before).all()
