"""docs/growth.md says what the code says."""

import json
import re
from dataclasses import fields
from pathlib import Path

import pytest

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.schema import GROW_REASONS
from urbanforest_cli.core.traits import Traits
from urbanforest_cli.files.skeleton_format import COLUMNS, TEXTS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def page():
    return (ROOT / "docs" / "growth.md").read_text(encoding="utf-8")


def rows(page: str, heading: str) -> dict[str, list[str]]:
    """Return the rows of the first table after a heading, by their first cell."""
    section = page[page.index(f"\n## {heading}\n") :]
    table = re.search(r"(?:^\|.*\n)+", section, re.MULTILINE).group()
    cells = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table.splitlines()[2:]]
    return {row[0].strip("`"): row[1:] for row in cells}


def test_every_trait_is_told_with_its_symbol_and_meaning(page):
    told = rows(page, "Traits of a species")
    assert list(told) == [item.name for item in fields(Traits)]
    for item in fields(Traits):
        symbol, limits, meaning = told[item.name]
        assert (symbol, meaning) == (item.metadata["symbol"], item.metadata["doc"])
        assert f"{item.metadata['high']:g}" in limits


def test_every_setting_is_told_with_its_default_and_meaning(page):
    told = rows(page, "Settings")
    assert list(told) == list(Growth.model_fields)
    for name, item in Growth.model_fields.items():
        assert told[name][1] == item.description
        default = item.get_default(call_default_factory=True)
        if isinstance(default, int | float) and not isinstance(default, bool):
            assert float(told[name][0]) == default


def test_every_column_of_a_skeleton_file_is_told(page):
    told = rows(page, "Files")
    assert {name: row[1] for name, row in told.items()} == {name: c.doc for name, c in (COLUMNS | TEXTS).items()}


def test_every_reason_for_a_plant_without_a_skeleton_is_told(page):
    assert set(re.findall(r"\| (?:dead|none) \| (\w+) \|", page)) == set(GROW_REASONS)


def test_the_example_for_pandas_runs_on_a_plant_of_its_own(page, runner, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    outcome = runner("grow", "--one", "tilia_cordata", "--age", 14, "--neighbour", "corylus_avellana@4,0", "-o",
                     "tree.parquet", "--json")  # fmt: skip
    assert outcome.exit_code == 0, outcome.stderr
    example = re.search(r"```python\n(.*?)```", page, re.DOTALL).group(1)
    names: dict[str, object] = {}
    exec(example, names)
    now, then = map(float, re.findall(r"[\d.]+(?= m high| m ten)", capsys.readouterr().out))
    assert now == pytest.approx(json.loads(outcome.stdout)["counts"]["height_m"], abs=0.051)
    assert 0.3 < then < now
    assert names["parent"].iloc[0] == -1
    assert (names["parent"].iloc[1:] >= 0).all()
    assert 0.02 < names["radius_m"].max() < 0.5


@pytest.mark.parametrize("command", ["grow", "grow --one"])
def test_examples_on_the_page_and_in_the_readme_are_told(command):
    for path in (ROOT / "README.md", ROOT / "docs" / "growth.md"):
        assert f"urbanforest {command} " in path.read_text(encoding="utf-8")
