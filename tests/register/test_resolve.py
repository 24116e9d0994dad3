import numpy as np
import pandas as pd
import pytest

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.register.resolve import draw_strategies, match_zones, resolve_parameters, with_resolved


def config(**zones):
    return Config.model_validate({"zones": zones})


def resolve(own=None, ids=("a", "b"), zones=None, settings=None, **options):
    zones = np.array(zones or ["residential"] * len(ids), dtype=object)
    own = pd.DataFrame(own or {}, index=range(len(ids)))
    options.setdefault("notices", Notices())
    return resolve_parameters(own, ids, zones, settings or Config(), seed=1, **options)


def test_a_lots_own_column_beats_its_zone_which_beats_the_default():
    settings = config(residential={"density": 0.4}, default={"density": 0.2, "spacing_m": 5.0})
    table = resolve({"density": [0.9, None]}, settings=settings)
    assert table["density"].tolist() == [0.9, 0.4]
    assert table["spacing_m"].tolist() == [5.0, 5.0]
    assert table["radius_mean_m"].tolist() == [PARAMETERS["radius_mean_m"].default] * 2
    assert table["source"].tolist() == ["lot", "zone"]


def test_an_empty_cell_is_the_zones_value():
    for empty in ([None, None], [np.nan, np.nan], pd.array([None, None], dtype="Int64"), ["", None]):
        name = "strategy" if isinstance(empty, list) and empty[0] == "" else "age_max_years"
        assert resolve({name: empty})["source"].tolist() == ["zone", "zone"]


@pytest.mark.parametrize("name", list(PARAMETERS))
@pytest.mark.parametrize("bad", [np.inf, -np.inf, -1.0, "over", "text", True])
def test_a_value_that_cannot_be_used_is_refused_with_lot_column_value_and_range(name, bad):
    parameter = PARAMETERS[name]
    value = parameter.maximum + 1 if bad == "over" else bad
    column = pd.Series([None, value], dtype=object if isinstance(value, str | bool) else float)
    with pytest.raises(InputError) as caught:
        resolve({name: column})
    text = str(caught.value)
    assert "lot b" in text
    assert name in text
    assert str(value) in text
    assert f"{parameter.minimum:g} to {parameter.maximum:g}" in text


def test_a_column_of_true_and_false_is_refused():
    with pytest.raises(InputError, match="density is True"):
        resolve({"density": [True, False]})
    with pytest.raises(InputError, match="density is True"):
        resolve({"density": pd.array([True, None], dtype="boolean")})


def test_a_not_a_number_in_a_text_column_is_refused():
    with pytest.raises(InputError, match="'NaN'"):
        resolve({"density": ["NaN", None]})


def test_all_faults_are_gathered_and_ten_are_shown():
    ids = [f"l{i}" for i in range(30)]
    with pytest.raises(InputError) as caught:
        resolve({"density": [7.0] * 30, "strategy": ["Z"] * 30}, ids=ids)
    text = str(caught.value)
    assert text.count("lot l") == 10
    assert "50 more" in text


def test_a_value_outside_the_papers_table_is_used_and_noticed_once_a_parameter():
    notices = Notices()
    table = resolve({"boundary_width_m": [10.0, 10.0], "cluster_count_max": [18, 2]}, notices=notices)
    assert table["boundary_width_m"].tolist() == [10, 10]
    assert notices.count("W_RANGE_BOUNDARY_WIDTH_M") == 2
    assert notices.count("W_RANGE_CLUSTER_COUNT_MAX") == 1
    assert len(notices) == 2


def test_values_at_the_ends_of_their_ranges_are_accepted_without_a_word():
    notices = Notices()
    zero = {"spacing_m": [0.0, 0.0], "cluster_count_max": [0, 0], "density": [0.0, 0.0], "context_radius_m": [0.0, 300]}
    resolve({**zero, "grid_size_m": [50.0, 50.0]}, notices=notices)
    assert len(notices) == 0


def test_a_variance_that_makes_radii_negative_is_accepted():
    table = resolve({"radius_mean_m": [1.0, 1.0], "radius_variance_m2": [2.0, 2.0]})
    assert table["radius_variance_m2"].tolist() == [2, 2]


def test_an_unknown_strategy_is_refused_listing_the_six():
    with pytest.raises(InputError) as caught:
        resolve({"strategy": ["Q", None]})
    assert all(name in str(caught.value) for name in STRATEGIES)


def test_strategies_are_known_by_name_letter_and_in_any_case():
    table = resolve({"strategy": ["B", " Cluster "]})
    assert table["strategy"].tolist() == ["boundary", "cluster"]


def test_a_strategy_of_an_outside_package_is_known():
    own = {"strategy": ["spiral", None]}
    assert resolve(own, known_strategies=(*STRATEGIES, "spiral"))["strategy"][0] == "spiral"
    with pytest.raises(ConfigError, match="spiral"):
        resolve(settings=config(residential={"strategy": "spiral"}))


def test_strategies_are_drawn_by_weight():
    settings = config(residential={"strategy": {"boundary": 1, "single": 3, "regular": 0}})
    ids = np.array([f"lot{i}" for i in range(4000)], dtype=object)
    drawn = draw_strategies(ids, np.full(4000, "residential", dtype=object), settings, seed=3)
    assert (drawn == "single").mean() == pytest.approx(0.75, abs=0.03)
    assert set(drawn) == {"boundary", "single"}


def test_a_drawn_strategy_depends_on_seed_and_lot_and_not_on_the_order_of_lots_or_weights():
    one = config(other={"strategy": {"random": 1, "cluster": 1}})
    other = config(other={"strategy": {"cluster": 1, "random": 1}})
    ids = np.array([f"lot{i}" for i in range(300)], dtype=object)
    zones = np.full(300, "other", dtype=object)
    drawn = draw_strategies(ids, zones, one, seed=3)
    assert draw_strategies(ids[::-1], zones, other, seed=3)[::-1].tolist() == drawn.tolist()
    assert draw_strategies(ids, zones, one, seed=4).tolist() != drawn.tolist()


def test_zones_are_matched_without_case_and_blanks_and_unknown_ones_are_counted():
    notices = Notices()
    zones = ["Residential ", "STREET", "Résidentiel", None, " ", float("nan"), "residentiel", "park", 7]
    matched = match_zones(zones, [str(i) for i in range(9)], config(park={}), notices)
    assert matched.tolist() == ["residential", "street", *["other"] * 5, "park", "other"]
    assert notices.count("W_ZONE_UNKNOWN") == 3
    assert notices.count("W_ZONE_MISSING") == 3


def test_before_any_diffusion_values_in_force_are_those_resolved():
    table = with_resolved(resolve({"density": [0.9, None]}))
    for name in PARAMETERS:
        assert table[name].tolist() == table[f"resolved_{name}"].tolist()
    assert table["context_lot_count"].tolist() == [1, 1]


def test_values_start_from_a_given_base_where_there_is_one():
    base = resolve({"density": [0.9, 0.8], "strategy": ["single", "single"]}).reindex([1, -1]).reset_index(drop=True)
    table = resolve({"spacing_m": [4.0, None]}, base=base)
    assert table["density"].tolist() == [0.8, 1.0]
    assert table["strategy"].tolist() == ["single", "random"]
    assert table["spacing_m"].tolist() == [4.0, 8.0]
