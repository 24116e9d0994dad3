from __future__ import annotations

import pytest

from tests.regression.judging.made_pairs import disc_pairs
from urbanforest_cli.regression.pair_table import PairTable


@pytest.fixture(scope="session")
def pairs() -> PairTable:
    return disc_pairs(600, seed=1)
