"""Every row of the paper's appendix table is a config, transcribed here once more from the table."""

import pytest

from urbanforest_cli.files.configs import configs_folder, load_config

COLUMNS = ("mu", "sigma", "tau", "beta", "kappa", "pi", "omega", "psi", "eta", "alpha", "rho", "theta", "lambda")
NAMES = ("radius_mean_m", "radius_variance_m2", "density", "boundary_width_m", "cluster_radius_m", "cluster_count_max",
         "grid_size_m", "grid_jitter", "grid_orientation_deg", "age_max_years", "tree_fraction", "species_diversity",
         "species_count")  # fmt: skip

# figure, strategy, then the columns in the table's order; "-" is an empty cell
TABLE = """
positional_a B 3.13 0.35 1.0 4.0  - - - - - - - - -
positional_b B 3.13 0.35 0.8 10.0 - - - - - - - - -
positional_c B 3.13 0.35 0.4 10.0 - - - - - - - - -
positional_d C 3.13 0.35 1.0 - 10.0 1 - - - - - - -
positional_e C 3.13 0.35 1.0 - 10.0 3 - - - - - - -
positional_f C 3.13 0.35 1.0 - 15.0 3 - - - - - - -
positional_g I 3.13 0.00 1.0 - - - 9.0 0.00 30 - - - -
positional_h I 3.13 0.00 1.0 - - - 9.0 0.30 30 - - - -
positional_i I 3.13 0.00 1.0 - - - 9.0 0.55 30 - - - -
positional_j R 3.13 0.35 0.2 - - - - - - - - - -
positional_k R 3.13 0.35 0.4 - - - - - - - - - -
positional_l R 3.13 0.35 1.0 - - - - - - - - - -
structural_a R 3.4 0.15 0.2 - - - - - - 14 0.0 0.0 4
structural_b R 3.4 0.15 0.2 - - - - - - 20 0.0 0.0 4
structural_c R 3.4 0.15 0.2 - - - - - - 30 0.0 0.0 4
structural_d B 2.2 0.0 0.9 10 - - - - - 20 1.0 0.0 4
structural_e B 2.2 0.0 0.9 10 - - - - - 20 0.7 0.0 -
structural_f B 2.2 0.0 0.9 10 - - - - - 20 0.5 0.0 4
structural_g C 3.2 0.25 1.0 - 10.0 3 - - - 16 0.0 0.0 4
structural_h C 3.2 0.25 1.0 - 10.0 3 - - - 16 0.1 0.3 4
structural_i C 3.2 0.25 1.0 - 10.0 3 - - - 16 0.2 0.4 4
growth_of_building C 3.5 0.35 1.0 - 20.0 18 - - - 16 0.0 0.0 1
"""
ROWS = [line.split() for line in TABLE.strip().splitlines()]
LETTERS = {"R": "random", "B": "boundary", "C": "cluster", "I": "regular"}


def test_there_is_a_preset_for_each_row_and_no_other():
    assert sorted(path.stem for path in (configs_folder() / "paper").glob("*.toml")) == sorted(row[0] for row in ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_preset_holds_the_values_of_its_row(row):
    figure, letter, *cells = row
    config = load_config(configs_folder() / "paper" / f"{figure}.toml", environment={}).config
    assert set(config.zones) == {"default"}
    table = config.zones["default"]
    assert table.strategy == {LETTERS[letter]: 1.0}
    for symbol, name, cell in zip(COLUMNS, NAMES, cells, strict=True):
        expected = None if cell == "-" else float(cell)
        if symbol == "rho" and expected is not None:
            expected = 1.0 - expected  # the printed column is the share of shrubs, as its figure's caption shows
        value = getattr(table, name)
        assert value == (expected if expected is None else pytest.approx(expected)), name
