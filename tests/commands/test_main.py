import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from urbanforest_cli.main import COMMANDS

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_has_help_with_an_example_and_a_place_in_the_readme(runner, name):
    outcome = runner(name, "--help")
    assert outcome.exit_code == 0
    assert "Example:" in outcome.stdout
    assert f"urbanforest {name}" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom urbanforest_cli.main import guarded\nguarded(['--help'])\n"
        "heavy = {'numpy', 'geopandas', 'numba', 'pydantic', 'shapely', 'matplotlib', 'rich'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr


def test_a_mistyped_command_is_a_usage_error_with_a_suggestion(runner):
    outcome = runner("popluate", "x.gpkg")
    assert outcome.exit_code == 2
    assert "populate" in outcome.stderr


def test_an_unknown_option_is_a_usage_error(runner):
    assert runner("populate", "--nonsense").exit_code == 2


def test_a_missing_file_is_one_message_and_exit_code_2(runner, tmp_path):
    outcome = runner("populate", tmp_path / "nowhere.gpkg", "--json")
    assert outcome.exit_code == 2
    assert "nowhere.gpkg" in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert "nowhere.gpkg" in json.loads(outcome.stdout)["where"]
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_the_program_is_exit_code_1_without_a_traceback(runner, monkeypatch):
    monkeypatch.setattr("urbanforest_cli.files.describe.describe_output", lambda path: 1 / 0)
    outcome = runner("info", "x.gpkg")
    assert outcome.exit_code == 1
    assert "--debug" in outcome.stderr
    with pytest.raises(ZeroDivisionError):
        runner("info", "x.gpkg", "--debug")


def test_a_signal_ends_with_128_plus_its_number_and_leaves_nothing(tiny_city, tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "urbanforest_cli", "populate", str(tiny_city), "-o", str(out), "-v"],
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    if process.returncode == 0:
        pytest.skip("the run was over before the signal came")
    assert process.returncode == 128 + signal.SIGTERM, err
    assert b"Traceback" not in err
    published = [path.name for path in out.iterdir() if not path.name.startswith(".")] if out.exists() else []
    assert published == []


def test_a_reader_that_leaves_is_no_error():
    outcome = subprocess.run(
        f"{sys.executable} -m urbanforest_cli config schema | head -c 10", shell=True, capture_output=True, check=False
    )
    assert b"Traceback" not in outcome.stderr
    assert b"Exception ignored" not in outcome.stderr


def test_the_glossary_lists_every_parameter(runner):
    from urbanforest_cli.core.params import PARAMETERS

    text = runner("info", "--params").stdout
    assert all(name in text for name in PARAMETERS)
    assert [p["name"] for p in json.loads(runner("info", "--params", "--json").stdout)] == list(PARAMETERS)


def test_config_init_show_and_schema(runner, tmp_path):
    path = tmp_path / "my.toml"
    assert runner("config", "init", path).exit_code == 0
    assert runner("config", "init", path).exit_code == 2
    shown = runner("config", "show", "-c", path, "--set", "rules.building_clearance_m=5")
    assert "building_clearance_m = 5" in shown.stdout
    assert "# --set" in shown.stdout
    assert "properties" in json.loads(runner("config", "schema").stdout)
