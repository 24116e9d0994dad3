"""Columns by many names, and the numbers people write in them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.sources.columns import find_column, metres, require_column
from urbanforest_cli.sources.osm import unpack_tags
from urbanforest_cli.sources.profile import LayerRule, ZoneCodes, code_text, folded, matches, zone_by_codes


def test_a_column_is_found_whatever_its_capitals_hyphens_and_underscores() -> None:
    frame = pd.DataFrame({"bgt-functie": ["a"], "LandUse": ["01"], "building:levels": [3]})
    assert find_column(frame, ("bgt_functie",)).tolist() == ["a"]
    assert find_column(frame, ("none", "landuse")).tolist() == ["01"]
    assert find_column(frame, ("building_levels",)).tolist() == [3]
    assert find_column(frame, ("zone",)) is None


def test_the_first_name_found_wins() -> None:
    frame = pd.DataFrame({"b": [2], "a": [1]})
    assert find_column(frame, ("a", "b")).tolist() == [1]


def test_packed_tags_are_columns_too() -> None:
    frame = pd.DataFrame({"other_tags": ['"height"=>"12 m","note"=>"a \\"b\\", c"', None]})
    assert find_column(frame, ("height",)).tolist() == ["12 m", None]
    assert unpack_tags(frame["other_tags"][0])["note"] == 'a "b", c'


def test_nested_values_are_reached_by_a_dotted_path() -> None:
    frame = pd.DataFrame({"width_rules": [[{"value": 7.5}], [], None], "names": [{"primary": "x"}, None, {}]})
    assert find_column(frame, ("width_rules.0.value",)).tolist() == [7.5, None, None]
    assert find_column(frame, ("names.primary",)).tolist() == ["x", None, None]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("12", 12.0), ("12 m", 12.0), ("12,5", 12.5), ("~9", 9.0), ("40 ft", 12.192), ("39'4\"", 11.9888), ("250cm", 2.5)],
)
def test_lengths_as_people_write_them(text: str, expected: float) -> None:
    values, bad = metres(pd.Series([text], dtype=object))
    assert values[0] == pytest.approx(expected)
    assert not bad[0]


def test_what_is_no_length_is_unknown_and_counted() -> None:
    values, bad = metres(pd.Series(["tall", "-3", "0", "inf", None, "", "nan"], dtype=object))
    assert np.isnan(values).all()
    assert bad.tolist() == [True, True, True, True, False, False, True]


def test_bare_numbers_are_scaled_by_their_unit() -> None:
    assert metres(pd.Series([10.0, np.nan, -1.0]), 0.3048)[0][0] == pytest.approx(3.048)
    assert metres(pd.Series(["10", "10 m"], dtype=object), 0.3048)[0].tolist() == pytest.approx([3.048, 10.0])


def test_a_missing_column_is_told_with_the_nearest_one() -> None:
    with pytest.raises(InputError, match="did you mean --height heigth"):
        require_column(pd.DataFrame({"heigth": [1]}), ("height",), where="a.gpkg", option="--height")


def test_codes_compare_without_accents_capitals_and_blanks() -> None:
    assert folded(" Résidentiel ") == "residentiel"
    assert matches("Zone d'Activités", ("*activite*",))
    assert not matches(None, ("*",))
    assert code_text(3.0) == "3"
    assert code_text(float("nan")) is None
    assert code_text("  ") is None


def test_an_exact_code_beats_a_pattern_and_patterns_go_in_order() -> None:
    codes = ZoneCodes(column="z", codes={"U*": "residential", "UX*": "industrial", "UE": "other"})
    assert codes.zone_of("ue") == "other"
    assert codes.zone_of("UX1") == "residential"
    assert codes.zone_of("N") is None


def test_columns_are_asked_in_order_and_the_code_names_its_column() -> None:
    rule = LayerRule(
        layers="*",
        zones=(
            ZoneCodes(column="landuse", codes={"retail": "commercial"}),
            ZoneCodes(column="leisure", codes={"park": "other"}),
        ),
    )
    assert zone_by_codes(rule, ["forest", "park"]) == ("other", "leisure=park")
    assert zone_by_codes(rule, ["forest", None]) == (None, "landuse=forest")
    assert zone_by_codes(rule, [None, None]) == (None, None)
