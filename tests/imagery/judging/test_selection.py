from __future__ import annotations

import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.imagery.judging.selection import select_pairs


def names(pairs, indices):
    return sorted(pairs.names[index] for index in indices)


def test_without_patterns_all_is_judged_and_nothing_learnt_from(made_pairs):
    chosen = select_pairs(made_pairs, (), (), where="pairs")
    assert (len(chosen.judged), chosen.training, chosen.dropped) == (16, (), ())


def test_what_is_learnt_from_is_not_judged(made_pairs):
    chosen = select_pairs(made_pairs, (), ("north_*",), where="pairs")
    assert names(made_pairs, chosen.judged) == [name for name in sorted(made_pairs.names) if name.startswith("south")]
    assert names(made_pairs, chosen.training) == [name for name in sorted(made_pairs.names) if name.startswith("north")]


def test_another_year_of_a_judged_place_teaches_nothing(made_pairs):
    chosen = select_pairs(made_pairs, ("north_2018_0", "south_2018"), ("*_2020",), where="pairs")
    assert names(made_pairs, chosen.training) == ["north_2020_1", "north_2020_2", "north_2020_3"]
    assert len(chosen.dropped) == 5
    shown = {made_pairs.places[index] for index in chosen.judged}
    assert not shown & {made_pairs.places[index] for index in chosen.training}


def test_a_pattern_that_fits_nothing_names_the_groups(made_pairs):
    with pytest.raises(InputError, match=r"(?s)no pair fits.*sout_\*.*north_2018, north_2020, south_2018"):
        select_pairs(made_pairs, ("sout_*",), (), where="pairs")
    with pytest.raises(InputError, match="no pair fits"):
        select_pairs(made_pairs, (), ("north_*", "east_*"), where="pairs")


def test_nothing_left_to_judge_or_to_learn_is_refused(made_pairs):
    with pytest.raises(InputError, match="no pair is left to judge"):
        select_pairs(made_pairs, ("north_*",), ("north_*",), where="pairs")
    with pytest.raises(InputError, match=r"(?s)nothing to learn from.*8 pairs"):
        select_pairs(made_pairs, (), ("*_2020",), where="pairs")
