"""A known forest, drawn as a coverage map and planted again out of that map alone."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from benchmarks.round_trip import compare, round_trip, table_config
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.placement.stage import place_plants

pytestmark = pytest.mark.slow

LOTS, REPLICATIONS = 200, 39


@pytest.fixture(scope="module")
def configs():
    return {"zones": load_config(environment={}).config, "ranges": table_config(1)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("trips")


@pytest.fixture(scope="module", params=["zones", "ranges"])
def trip(request, folder, configs):
    return round_trip(folder, request.param, configs[request.param], lots=LOTS, count=REPLICATIONS)


def test_lots_are_covered_as_they_were(trip):
    assert trip.share_within >= 0.95
    assert np.corrcoef(*trip.shares)[0, 1] > 0.98
    assert abs((trip.shares[1] - trip.shares[0]).mean()) < 0.01


def test_as_many_plants_stand_there(trip):
    assert trip.count_ratio == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(*trip.counts)[0, 1] > 0.98
    assert trip.radius_m[1] == pytest.approx(trip.radius_m[0], rel=0.1)


def test_plants_stand_to_one_another_as_they_did(trip):
    assert trip.judged.sum() >= 15
    assert trip.same.mean() >= 0.8
    assert trip.near_likely[1].mean() >= 0.75
    assert trip.l_likely[1].mean() >= 0.6


def test_plants_stand_where_they_stood(trip):
    there, back, again = trip.chamfer_m
    assert max(there, back) < 0.7 * again


def test_the_true_model_under_another_seed_is_as_likely_and_covers_other_lots(trip, folder, configs):
    """Holds for the judge: what only looks like the truth passes as its like, and fails as its copy."""
    for name, config in configs.items():
        truth, again = folder / f"{name}_truth.gpkg", folder / f"{name}_again.gpkg"
        if not truth.exists():
            continue
        shutil.copy(truth, again)
        place_plants(again, config=config, seed=99)
        other = compare(truth, again, config, count=REPLICATIONS)
        assert other.near_likely[1].mean() > 0.8
        assert other.l_likely[1].mean() > 0.8
        assert other.share_within < 0.8
        assert max(other.chamfer_m[:2]) > 0.7 * other.chamfer_m[2]
