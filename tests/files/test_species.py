"""Species files: what ships, what a user adds, and what is said of mistakes."""

from __future__ import annotations

import csv
import os
import tomllib
from itertools import combinations
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from urbanforest_cli.core.config import Species
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.habits import TREE, usual_growth
from urbanforest_cli.core.traits import TRAIT_NAMES
from urbanforest_cli.files.species import load_catalogue, species_folder


def write_species(folder: Path, name: str, **changes: object) -> Path:
    folder.mkdir(exist_ok=True)
    keys: dict[str, object] = {
        "id": name, "scientific_name": "Acer campestre", "common_name": "field maple", "habit": "tree",
        "mature_height_m": 12.0, "mature_crown_diameter_m": 8.0, "envelope_radius_m": 4.0, "lifespan_years": 100,
        "hardiness_zone_min": 5, "hardiness_zone_max": 8, "colour": "#7a9e33", "source": "a test",
    }  # fmt: skip
    keys |= changes
    lines = [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in keys.items()]
    path = folder / f"{name}.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def add_growth(path: Path, *lines: str) -> None:
    path.write_text("\n".join([path.read_text(encoding="utf-8"), "[growth]", *lines]), encoding="utf-8")


def lab(colour: str) -> tuple[float, float, float]:
    """CIE L*a*b* of an sRGB colour, D65."""
    linear = [(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4)
              for c in (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))]  # fmt: skip
    matrix = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))
    xyz = [sum(m * c for m, c in zip(row, linear, strict=True)) for row in matrix]
    fx, fy, fz = (
        t ** (1 / 3) if t > 0.008856 else 7.787 * t + 16 / 116
        for t in (v / w for v, w in zip(xyz, (0.9505, 1.0, 1.089), strict=True))
    )
    return 116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)


def test_six_trees_and_four_shrubs_ship() -> None:
    catalogue = load_catalogue(Species())
    assert (len(catalogue.trees()), len(catalogue.shrubs())) == (6, 4)


def test_shipped_colours_can_be_told_apart() -> None:
    colours = [lab(item.colour) for item in load_catalogue(Species())]
    gaps = [sum((a - b) ** 2 for a, b in zip(x, y, strict=True)) ** 0.5 for x, y in combinations(colours, 2)]
    assert min(gaps) > 20


def test_shipped_envelopes_hold_half_the_crown() -> None:
    for item in load_catalogue(Species()):
        assert item.envelope_radius_m == pytest.approx(item.mature_crown_diameter_m / 2, abs=0.06)


def test_sizes_of_shipped_trees_are_the_medians_they_name() -> None:
    root = os.environ.get("URBANFOREST_REAL_DATA")
    if not root:
        pytest.skip("URBANFOREST_REAL_DATA is not set")
    with (Path(root) / "urban_tree_database" / "utd_raw.csv").open(encoding="latin-1", newline="") as stream:
        records = list(csv.DictReader(stream))
    for item in load_catalogue(Species()).trees():
        oldest = 30 if item.id == "prunus_serrulata" else 40
        old = [r for r in records if r["ScientificName"].strip() == item.scientific_name and r["Age"].strip()]
        old = [r for r in old if float(r["Age"]) >= oldest]
        heights = [float(r["TreeHt (m)"]) for r in old if float(r["TreeHt (m)"]) > 0]
        crowns = [float(r["AvgCdia (m)"]) for r in old if float(r["AvgCdia (m)"]) > 0]
        assert f"{len(old)} records of {item.scientific_name} aged {oldest} years" in item.source
        assert item.mature_height_m == pytest.approx(median(heights), abs=0.06)
        assert item.mature_crown_diameter_m == pytest.approx(median(crowns), abs=0.06)


def test_a_users_species_joins_the_shipped_ones(tmp_path: Path) -> None:
    write_species(tmp_path / "mine", "acer_campestre")
    catalogue = load_catalogue(Species(folder=str(tmp_path / "mine")))
    assert len(catalogue) == 11
    assert catalogue["acer_campestre"].mature_height_m == 12.0


def test_a_users_species_replaces_a_shipped_one_of_its_id(tmp_path: Path) -> None:
    write_species(tmp_path / "mine", "tilia_cordata", mature_height_m=99.0)
    catalogue = load_catalogue(Species(folder=str(tmp_path / "mine")))
    assert len(catalogue) == 10
    assert catalogue["tilia_cordata"].mature_height_m == 99.0


def test_the_config_chooses_species_by_name_and_hardiness() -> None:
    assert load_catalogue(Species(names=("tilia_cordata", "quercus_rubra"))).ids == ("quercus_rubra", "tilia_cordata")
    cold = load_catalogue(Species(hardiness_zone=3))
    assert "tilia_cordata" in cold
    assert "platanus_acerifolia" not in cold


def test_every_mistake_of_every_file_is_told_at_once_with_file_and_key(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    write_species(folder, "oak", hieght_m=3.0, colour="green", hardiness_zone_min=9)
    write_species(folder, "elm", habit="herb", lifespan_years=-4)
    write_species(folder, "ash", id="fraxinus")
    (folder / "lime.toml").write_text("id = ", encoding="utf-8")
    (folder / "fir.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError) as caught:
        load_catalogue(Species(folder=str(folder)))
    text = str(caught.value)
    for file, key in (
        ("oak.toml", "hieght_m: unknown key"), ("oak.toml", "colour"), ("elm.toml", "habit"),
        ("elm.toml", "lifespan_years"), ("ash.toml", "id: must be the file's name"), ("lime.toml", "not readable"),
        ("fir.toml", "not readable"),
    ):  # fmt: skip
        assert any(file in line and key in line for line in text.splitlines()), (file, key)


def test_a_mistyped_key_is_met_with_the_right_one(tmp_path: Path) -> None:
    write_species(tmp_path / "mine", "oak", mature_hieght_m=3.0)
    with pytest.raises(ConfigError, match="did you mean 'mature_height_m'"):
        load_catalogue(Species(folder=str(tmp_path / "mine")))


def test_a_missing_key_and_swapped_zones_are_told(tmp_path: Path) -> None:
    path = write_species(tmp_path / "mine", "oak", hardiness_zone_min=9, hardiness_zone_max=4)
    with pytest.raises(ConfigError, match="hardiness_zone_min is above"):
        load_catalogue(Species(folder=str(path.parent)))
    path.write_text(path.read_text(encoding="utf-8").replace("source", "#"), encoding="utf-8")
    with pytest.raises(ConfigError, match="source: key is missing"):
        load_catalogue(Species(folder=str(path.parent)))


def test_a_mistyped_species_is_met_with_the_right_one() -> None:
    with pytest.raises(ConfigError, match="did you mean 'tilia_cordata'"):
        load_catalogue(Species(names=("tilia_cordta",)))


def test_a_dominant_species_that_was_not_chosen_is_refused() -> None:
    with pytest.raises(ConfigError, match="not among the city's species"):
        load_catalogue(Species(names=("tilia_cordata",), dominant="quercus_rubra"))


def test_a_zone_where_nothing_lives_is_an_error() -> None:
    with pytest.raises(ConfigError, match="hardiness zone 13"):
        load_catalogue(Species(hardiness_zone=13))


def test_a_folder_that_is_not_there_or_empty_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        load_catalogue(Species(folder=str(tmp_path / "nowhere")))
    with pytest.raises(ConfigError, match=r"no \*\.toml"):
        load_catalogue(Species(folder=str(tmp_path)))


def test_every_shipped_file_is_named_after_its_id() -> None:
    assert {path.stem for path in species_folder().glob("*.toml")} == set(load_catalogue(Species()).ids)


def test_shipped_species_state_every_trait_and_their_sizes_to_old_age() -> None:
    for path in species_folder().glob("*.toml"):
        growth = tomllib.loads(path.read_text(encoding="utf-8"))["growth"]
        assert set(growth) == {*TRAIT_NAMES, "open_grown"}, path.name
        assert growth["open_grown"]["age_years"][-1] >= 100, path.name


def test_shipped_shrubs_have_several_stems_and_trees_one() -> None:
    for item in load_catalogue(Species()):
        assert (item.growth.stem_count > 1) == (item.habit == "shrub"), item.id


def test_a_species_without_growth_grows_as_a_usual_plant_of_its_habit_and_size(tmp_path: Path) -> None:
    write_species(tmp_path / "mine", "acer_campestre", mature_height_m=12.0, mature_crown_diameter_m=9.0)
    write_species(tmp_path / "mine", "rosa_canina", habit="shrub", mature_height_m=2.0, mature_crown_diameter_m=1.5)
    catalogue = load_catalogue(Species(folder=str(tmp_path / "mine")))
    tree, shrub = catalogue["acer_campestre"], catalogue["rosa_canina"]
    assert tree.growth == usual_growth("tree", 12.0, 9.0)
    assert shrub.growth == usual_growth("shrub", 2.0, 1.5)
    assert tree.open_grown.height_at(np.array([0.0, 60.0])) == pytest.approx([0.36, 12.0], abs=0.1)
    assert shrub.open_grown.crown_radius_at(np.array([60.0])) == pytest.approx([0.75])


def test_a_file_may_name_some_traits_and_leave_the_rest_to_its_habit(tmp_path: Path) -> None:
    path = write_species(tmp_path / "mine", "acer_campestre")
    add_growth(path, "branch_angle_deg = 60", "clear_stem_m = 0.5")
    tree = load_catalogue(Species(folder=str(path.parent)))["acer_campestre"]
    assert (tree.growth.branch_angle_deg, tree.growth.pipe_exponent) == (60.0, TREE.pipe_exponent)
    assert max(tree.open_grown.crown_base_m) == 0.5


def test_every_mistake_of_growth_is_told_with_its_key(tmp_path: Path) -> None:
    path = write_species(tmp_path / "mine", "acer_campestre", colour="green")
    add_growth(
        path, "pipe_exponent = 4", 'vigour = "high"', "branch_angel_deg = 40", "[growth.open_grown]",
        "age_years = [0, 10]", "height_m = [1, -2]", "crown_radius_m = [1, 2]", "crown_bas_m = [0, 0]",
    )  # fmt: skip
    with pytest.raises(ConfigError) as caught:
        load_catalogue(Species(folder=str(path.parent)))
    text = str(caught.value)
    for words in (
        "colour: ", "growth.pipe_exponent: input should be less than or equal to 3; found 4", "growth.vigour: ",
        "growth.branch_angel_deg: unknown key; did you mean 'branch_angle_deg'?", "growth.open_grown.height_m.1: ",
        "growth.open_grown.crown_base_m: key is missing",
        "growth.open_grown.crown_bas_m: unknown key; did you mean 'crown_base_m'?",
    ):  # fmt: skip
        assert words in text, (words, text)


@pytest.mark.parametrize(
    ("ages", "bases", "words"),
    [
        ("[1, 10]", "[0, 0]", "age_years must ascend from 0"),
        ("[0, 10, 10]", "[0, 0]", "age_years must ascend from 0"),
        ("[0, 10, 20]", "[0, 0]", "each key needs as many sizes as there are ages"),
        ("[0, 10]", "[0, 9]", "crown_base_m is above height_m"),
    ],
)
def test_sizes_by_age_that_contradict_each_other_are_refused(tmp_path: Path, ages: str, bases: str, words: str) -> None:
    path = write_species(tmp_path / "mine", "acer_campestre")
    sizes = (f"age_years = {ages}", "height_m = [1, 8]", "crown_radius_m = [1, 2]", f"crown_base_m = {bases}")
    add_growth(path, "[growth.open_grown]", *sizes)
    with pytest.raises(ConfigError, match=words):
        load_catalogue(Species(folder=str(path.parent)))
