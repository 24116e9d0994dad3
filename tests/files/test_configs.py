import json
from pathlib import Path

import pytest

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.zones import ZONES
from urbanforest_cli.files.configs import load_config


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "my.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_zone_has_good_values_out_of_the_box():
    config = load_config(environment={}).config
    for zone in ZONES:
        assert config.zone_value(zone, "strategy")
        for name, parameter in PARAMETERS.items():
            assert parameter.low <= config.zone_value(zone, name) <= parameter.high, (zone, name)


def test_option_beats_environment_beats_file_beats_default(tmp_path):
    path = written(tmp_path, "[rules]\nbuilding_clearance_m = 5.0\ncurb_clearance_m = 1.0\nverge_width_m = 3.0\n")
    loaded = load_config(
        path,
        settings=["rules.building_clearance_m=3"],
        environment={
            "URBANFOREST_RULES__BUILDING_CLEARANCE_M": "4",
            "URBANFOREST_RULES__CURB_CLEARANCE_M": "2",
            "URBANFOREST_POPULATE_SEED": "9",
        },
    )
    rules = loaded.config.rules
    assert (rules.building_clearance_m, rules.curb_clearance_m, rules.verge_width_m) == (3, 2, 3)
    assert rules.driveway_clearance_m == 1.5
    assert loaded.origins["rules.building_clearance_m"] == "--set"
    assert loaded.origins["rules.curb_clearance_m"] == "URBANFOREST_RULES__CURB_CLEARANCE_M"
    assert loaded.origins["rules.verge_width_m"] == str(path)


def test_all_mistakes_are_told_at_once_with_suggestions(tmp_path):
    path = written(
        tmp_path,
        '[rules]\nbuilding_clearence_m = 3\n[zones.residential]\nstrategy = "randm"\ndensity = 4\n'
        "[zones.park]\nradius_mean_m = nan\nspacing_m = true\n[placement]\nradius_law = 'maybe'\n",
    )
    with pytest.raises(ConfigError) as caught:
        load_config(path, environment={})
    text = str(caught.value)
    for piece in (
        "did you mean 'building_clearance_m'?",
        "did you mean 'random'?",
        "zones.residential.density",
        "zones.park.radius_mean_m",
        "zones.park.spacing_m",
        "placement.radius_law",
        str(path),
    ):
        assert piece in text
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("text", ["[rules", "a = 1\na = 2", "x = {", "\x00"])
def test_a_broken_file_is_refused(tmp_path, text):
    with pytest.raises(ConfigError):
        load_config(written(tmp_path, text), environment={})


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "my.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError):
        load_config(path, environment={})


def test_a_missing_file_suggests_shipped_ones():
    with pytest.raises(ConfigError, match="config init"):
        load_config(Path("nowhere.toml"), environment={})


def test_a_default_zone_speaks_for_all_zones_a_named_zone_for_itself(tmp_path):
    all_zones = load_config(written(tmp_path, "[zones.default]\ndensity = 0.1\n"), environment={}).config
    assert {all_zones.zone_value(zone, "density") for zone in ZONES} == {0.1}
    before = load_config(environment={}).config
    one_zone = load_config(written(tmp_path, "[zones.street]\nspacing_m = 5\n"), environment={}).config
    assert one_zone.zone_value("street", "spacing_m") == 5
    assert one_zone.zone_value("street", "radius_mean_m") == before.zone_value("street", "radius_mean_m")
    assert one_zone.zones["residential"] == before.zones["residential"]


def test_strategy_is_a_name_a_list_or_weights(tmp_path):
    for text, expected in (
        ('"B"', {"boundary": 1.0}),
        ('["random", "single"]', {"random": 1.0, "single": 1.0}),
        ("{ random = 2, cluster = 1 }", {"random": 2.0, "cluster": 1.0}),
    ):
        config = load_config(written(tmp_path, f"[zones.default]\nstrategy = {text}\n"), environment={}).config
        assert config.zone_value("other", "strategy") == expected
    for text in ("{ random = -1, cluster = 2 }", "{ random = 0 }"):
        with pytest.raises(ConfigError, match="weight"):
            load_config(written(tmp_path, f"[zones.default]\nstrategy = {text}\n"), environment={})


def test_a_zone_may_change_rules_for_itself(tmp_path):
    config = load_config(written(tmp_path, "[zones.park.rules]\nbuilding_clearance_m = 2\n"), environment={}).config
    assert config.zone_rules("park").building_clearance_m == 2
    assert config.zone_rules("park").driveway_clearance_m == 1.5
    assert config.zone_rules("residential").building_clearance_m == 6


def test_the_schema_tells_the_meaning_of_every_key():
    schema = json.dumps(Config.model_json_schema())
    for parameter in PARAMETERS.values():
        assert parameter.doc in schema
