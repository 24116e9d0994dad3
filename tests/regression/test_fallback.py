from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import Evidence
from urbanforest_cli.regression.fallback import MAP, NEIGHBOURHOOD, OWN, ZONE, settle
from urbanforest_cli.regression.pooling import Pooled
from urbanforest_cli.regression.shares import Ranges

RANGES = Ranges((1, 0.1, 0, 0, 1, 0), (10, 2, 1, 5, 20, 5))
VARIANCE = REGRESSED.index("radius_variance_m2")
GIVEN = np.array([[3.0, 0.5, 1.0, 12.0, 8.0, 3.0]])


def settled(alone, together, heard=5, visible=20.0, own=False, spoke=True):
    shape = (1, len(REGRESSED))
    pooled = Pooled(
        np.full(shape, 0.5), np.full(shape, 0.1), np.full(shape, alone), np.full(shape, together),
        np.array([heard]), {},
    )  # fmt: skip
    evidence = Evidence(
        np.full(shape, float(spoke)), np.full(shape, float(spoke)), np.full((1, 3), 1 / 3), np.array([visible])
    )
    return settle(pooled, evidence, GIVEN, np.full(shape, own), RANGES, known_share=0.8, zone_spread=0.25)


@pytest.mark.parametrize(
    ("case", "origin"),
    [
        ({"alone": 0.75, "together": 0.5}, MAP),
        ({"alone": 0.85, "together": 0.5}, NEIGHBOURHOOD),
        ({"alone": 0.85, "together": 0.85}, ZONE),
        ({"alone": 0.85, "together": 0.5, "heard": 0}, ZONE),
        ({"alone": 0.75, "together": 0.5, "own": True}, OWN),
        ({"alone": 0.75, "together": 0.95, "spoke": False}, ZONE),
    ],
)
def test_what_a_value_rests_on(case, origin):
    assert set(settled(**case).origins[0]) == {origin}


def test_of_few_plants_the_variance_rests_on_the_neighbourhood_at_best():
    assert settled(0.5, 0.5, visible=8.0).origins[0, VARIANCE] == MAP
    assert settled(0.5, 0.5, visible=7.0).origins[0, VARIANCE] == NEIGHBOURHOOD
    assert settled(0.5, 0.5, visible=7.0, heard=0).origins[0, VARIANCE] == ZONE
    assert settled(0.5, 0.5, visible=7.0).origins[0, 0] == MAP


def test_values_of_the_zone_and_of_the_lot_itself_stay_even_outside_the_range():
    assert settled(0.95, 0.95).values.tolist() == GIVEN.tolist()
    assert settled(0.5, 0.5, own=True).values.tolist() == GIVEN.tolist()
    assert (settled(0.5, 0.5, own=True).spreads == 0).all()
    np.testing.assert_allclose(settled(0.95, 0.95).spreads[0, :5], 0.25 * np.array([9, 1.9, 1, 5, 19]))


def test_values_read_are_in_units():
    np.testing.assert_allclose(settled(0.5, 0.5).values, [[5.5, 1.05, 0.5, 2.5, 10.5, 2.5]])
    np.testing.assert_allclose(settled(0.5, 0.5).spreads[0, :5], 0.1 * np.array([9, 1.9, 1, 5, 19]))
