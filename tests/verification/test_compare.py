import dataclasses

import numpy as np
import pytest
from pyproj import CRS, Transformer

from urbanforest_cli.core.placed import PlacedPlants
from urbanforest_cli.verification.compare import Expected, compare

UTM = CRS.from_epsg(32633)
COUNT = 200


@pytest.fixture
def expected():
    rng = np.random.default_rng(1)
    return Expected(
        plant_id=np.array([f"lot-{number}" for number in range(COUNT)], dtype=object),
        xy_m=np.array([500_000.0, 5_300_000.0]) + rng.uniform(0, 900, (COUNT, 2)),
        height_m=rng.uniform(2, 25, COUNT),
        crs=UTM,
    )


def stated(expected, crs=UTM, **values):
    xyz = np.column_stack([expected.xy_m, np.zeros(len(expected))])
    if crs != UTM:
        change = Transformer.from_crs(UTM.to_3d(), crs, always_xy=True)
        xyz = np.column_stack(change.transform(*xyz.T))
    fields = {"plant_id": expected.plant_id.copy(), "xyz_m": xyz, "crs": crs, "height_m": expected.height_m.copy()}
    return PlacedPlants(**fields | values)


def only_fault(found, expected, **options):
    (fault,) = compare(found, expected, **options).faults
    return fault


@pytest.mark.parametrize("code", [32633, 4326, 4979, 4978, 3035, 2263])
def test_the_same_plants_in_any_crs_and_any_order_are_the_same(expected, code):
    found = stated(expected, CRS.from_epsg(code))
    turned = np.arange(COUNT)[::-1]
    found = PlacedPlants(found.plant_id[turned], found.xyz_m[turned], found.crs, found.height_m[turned])
    result = compare(found, expected)
    assert (result.plants, result.faults) == (COUNT, ())
    assert result.largest_distance_m < 0.001


def test_a_plant_moved_by_two_centimetres_is_named_with_its_distance(expected):
    found = stated(expected)
    found.xyz_m[7, 0] += 0.02
    found.xyz_m[8, 1] += 0.009
    result = compare(found, expected)
    assert result.faults == ("1 plant elsewhere (lot-7 by 20.0 mm)",)
    assert result.largest_distance_m == pytest.approx(0.02, abs=1e-6)


def test_a_plant_moved_by_two_centimetres_is_found_through_degrees(expected):
    found = stated(expected, CRS.from_epsg(4326))
    found.xyz_m[7, 1] += 0.02 / 111_200
    assert "lot-7 by 20" in only_fault(found, expected)


def test_the_furthest_are_named_first_and_the_rest_counted(expected):
    found = stated(expected)
    found.xyz_m[:5, 0] += [0.02, 0.5, 0.03, 0.04, 90]
    fault = only_fault(found, expected)
    assert fault == "5 plants elsewhere (lot-4 by 90000.0 mm, lot-1 by 500.0 mm, lot-3 by 40.0 mm and 2 more)"


def test_a_place_that_is_no_number_is_elsewhere(expected):
    found = stated(expected)
    found.xyz_m[3] = np.nan
    assert only_fault(found, expected).startswith("1 plant elsewhere (lot-3")


def test_a_changed_id_is_one_missing_and_one_too_many(expected):
    found = stated(expected)
    found.plant_id[5] = "lot-five"
    assert compare(found, expected).faults == (
        "1 plant missing (lot-5)",
        "1 plant not in the register (lot-five)",
    )


def test_ids_exchanged_between_two_plants_are_both_elsewhere(expected):
    found = stated(expected)
    found.plant_id[[0, 1]] = found.plant_id[[1, 0]]
    assert compare(found, expected).faults[0].startswith("2 plants elsewhere")


def test_a_dropped_plant_is_missing(expected):
    found = stated(expected.take(np.arange(COUNT) != 9))
    result = compare(found, expected)
    assert (result.plants, result.faults) == (COUNT - 1, ("1 plant missing (lot-9)",))


def test_plants_doubled_are_named_once_each_even_where_they_are_no_plants(expected):
    rows = np.concatenate([np.arange(COUNT), [4, 4, 6]])
    found = stated(expected.take(rows))
    assert only_fault(found, expected) == "2 plants there more than once (lot-4, lot-6)"


def test_an_output_that_states_heights_does_so_for_all_that_stand_and_for_no_other(expected):
    found = stated(expected)
    found.height_m[3] += 0.02
    found.height_m[4] = np.nan
    expected.height_m[5] = np.nan
    assert compare(found, expected).faults == (
        "1 plant of another height (lot-3 by 20.0 mm)",
        "1 plant without a height (lot-4)",
        "1 plant with a height though nothing stands there (lot-5)",
    )
    assert compare(stated(expected, height_m=np.full(COUNT, np.nan)), expected).faults == ()


@pytest.mark.parametrize(
    ("column", "value", "other", "fault"),
    [
        ("species", "ulmus_minor", "acer_rubrum", "of another species (lot-3 is acer_rubrum, not ulmus_minor)"),
        ("lot_id", "a", None, "of another lot (lot-3 is none, not a)"),
        ("age_years", 20.0, 21.0, "of another age (lot-3 has 21, not 20)"),
        ("crown_radius_m", 2.0, 2.02, "of another crown radius (lot-3 has 2.02, not 2)"),
        ("crown_base_m", 2.0, np.nan, "of another crown base (lot-3 has nan, not 2)"),
        ("dbh_m", 0.2, 0.1985, "of another diameter (lot-3 has 0.1985, not 0.2)"),
    ],
)
def test_what_else_an_output_states_is_compared(expected, column, value, other, fault):
    kind = object if isinstance(value, str) else float
    known = dataclasses.replace(expected, columns={column: np.full(COUNT, value, dtype=kind)})
    found = stated(expected, columns={column: np.full(COUNT, value, dtype=kind)})
    assert compare(found, known).faults == ()
    assert compare(stated(expected), known).faults == ()
    found.columns[column][3] = other
    assert only_fault(found, known) == f"1 plant {fault}"


def test_points_stand_anywhere_between_foot_and_top(expected):
    found = stated(expected)
    found.xyz_m[:, 2] = expected.height_m / 2
    assert compare(found, expected, in_crown=True).faults == ()
    found.xyz_m[3, 2] = -0.5
    found.xyz_m[4, 2] = expected.height_m[4] + 0.25
    fault = only_fault(found, expected, in_crown=True)
    assert fault == "2 plants off the ground (lot-3 by 500.0 mm, lot-4 by 250.0 mm)"


def test_plants_that_the_register_holds_and_that_should_not_be_there_are_told_apart(expected):
    found = stated(expected)
    faults = compare(found, expected.take(np.arange(2, COUNT)), left_out=np.array(["lot-0"], dtype=object)).faults
    assert faults == (
        "1 plant not in the register (lot-1)",
        "1 plant dead, or outside its box (lot-0)",
    )


def test_feet_off_the_ground_count_where_they_should_stand_on_it(expected):
    found = stated(expected)
    found.xyz_m[3, 2] = -0.5
    assert compare(found, expected).faults == ()
    assert only_fault(found, expected, on_ground=True) == "1 plant off the ground (lot-3 by 500.0 mm)"


def test_nothing_stated_is_all_missing_and_nothing_expected_is_all_too_many(expected):
    none = expected.take(np.zeros(0, dtype=np.int64))
    assert compare(stated(none), expected).faults == ("200 plants missing (lot-0, lot-1, lot-2 and 197 more)",)
    assert only_fault(stated(expected), none).startswith("200 plants not in the register")
    assert compare(stated(none, CRS.from_epsg(4326)), none).faults == ()
