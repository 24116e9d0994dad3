import re

from urbanforest_cli.core.colours import mixed, named_colour, species_colour, to_hex, to_rgb, zone_colour
from urbanforest_cli.core.zones import ZONE_COLOURS


def test_chosen_colours_win_over_shipped_ones_and_those_over_made_ones():
    assert zone_colour("street", {"street": "#010203"}) == "#010203"
    assert zone_colour("street") == ZONE_COLOURS["street"]
    assert re.fullmatch("#[0-9a-f]{6}", zone_colour("moat"))


def test_a_made_colour_hangs_on_the_name_alone():
    assert named_colour("elm") == named_colour("elm") != named_colour("oak")


def test_what_is_no_colour_is_not_used():
    assert re.fullmatch("#[0-9a-f]{6}", species_colour("elm", {"elm": "red;}"}))


def test_mixing_goes_from_one_colour_to_the_other():
    assert mixed("#000000", "#ffffff", 0.0) == "#000000"
    assert mixed("#000000", "#ffffff", 1.0) == "#ffffff"
    assert mixed("#000000", "#ffffff", 0.5) == "#808080"


def test_hex_and_rgb_are_inverse():
    assert to_hex(to_rgb("#12ab9f")) == "#12ab9f"
