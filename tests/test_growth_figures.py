import numpy as np
import pytest
from PIL import Image

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.skeleton import measure
from urbanforest_cli.export.plant_sheets import Panel
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.pipeline_figures import PAGES, render_figures
from urbanforest_cli.pipeline_growth_figures import ALL_PAGES, GROWTH_PAGES, Stand, grow_stand, species_sheet


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(settings.Species())


@pytest.fixture(scope="module")
def stand(catalogue):
    xy = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0]])
    return grow_stand(catalogue, xy, ["tilia_cordata", "quercus_rubra", "corylus_avellana"], [9.0, 4.0, 6.0],
                      name="test")  # fmt: skip


def test_plants_come_back_in_the_order_given(stand, catalogue):
    assert isinstance(stand, Stand)
    assert stand.skeletons.seasons.tolist() == [9, 4, 6]
    assert [catalogue.ids[kind] for kind in stand.species] == ["tilia_cordata", "quercus_rubra", "corylus_avellana"]
    assert stand.skeletons.skeleton_id.tolist() == [0, 1, 2]


def test_apart_grows_each_as_if_it_were_alone(catalogue):
    xy = np.zeros((2, 2))
    both = grow_stand(catalogue, xy, ["tilia_cordata"] * 2, [8.0, 8.0], name="test", apart=True)
    alone = grow_stand(catalogue, xy[:1], ["tilia_cordata"], [8.0], name="test")
    count = alone.skeletons.first[1]
    assert both.skeletons.first[1] == count
    assert (both.skeletons.xyz_m[:count] == alone.skeletons.xyz_m).all()


def test_years_ago_shows_those_planted_by_then_and_smaller(stand):
    today, before = stand.years_ago(0), stand.years_ago(5)
    assert before.xy_m.tolist() == [[0.0, 0.0], [6.0, 5.0]]
    now = measure(today.skeletons, today.season_end)["height_m"][[0, 2]]
    then = measure(before.skeletons, before.season_end)["height_m"]
    assert (then < now).all()
    assert (then > 0).all()


def test_pages_of_growth_come_after_those_of_placement():
    assert list(ALL_PAGES) == [*PAGES, *GROWTH_PAGES]
    assert not set(PAGES) & set(GROWTH_PAGES)


def test_help_names_every_page(runner):
    text = runner("figures", "--help").stdout
    assert all(name in text for name in ALL_PAGES)


@pytest.mark.slow
def test_every_page_of_growth_can_be_drawn(tmp_path):
    render_figures(tmp_path, names=list(GROWTH_PAGES), pages=ALL_PAGES)
    assert {path.stem for path in tmp_path.iterdir()} == set(GROWTH_PAGES)
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            assert picture.width >= 2400


@pytest.mark.slow
def test_the_sheet_shows_every_species_at_every_age_to_one_scale(catalogue, monkeypatch):
    kept = []
    monkeypatch.setattr("urbanforest_cli.pipeline_growth_figures.draw_sheet", lambda rows, heading: kept.extend(rows))
    species_sheet(catalogue)
    panels = [panel for row in kept for panel in row]
    assert all(isinstance(panel, Panel) for panel in panels)
    assert len({panel.px_per_m for panel in panels}) == 1
    texts = [label.text for panel in panels for label in panel.labels]
    assert sum(text.endswith(" y") for text in texts) == 60
    assert sum(kind.scientific_name in text for kind in catalogue for text in texts) == 10
