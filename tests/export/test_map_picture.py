from dataclasses import replace

import numpy as np
import pytest
import shapely

from urbanforest_cli.export.map_layers import MapLayers, SpeciesStyle, ZoneStyle
from urbanforest_cli.export.map_page import SeenCounts
from urbanforest_cli.export.map_picture import draw_map
from urbanforest_cli.export.text import counted, length_text, place_name, printable, round_length, shortened

ZONES = [ZoneStyle("residential", "#ff0000"), ZoneStyle("street", "#00ff00")]
SPECIES = [SpeciesStyle("oak", "Oak", "#0000ff", True), SpeciesStyle("elder", "Elder", "#00ffff", False)]


def layers(width_m: float = 100, height_m: float = 100, plants: int = 4) -> MapLayers:
    half = width_m / 2
    rng = np.random.default_rng(0)
    return MapLayers(
        lots=np.array([shapely.box(0, 0, half, height_m), shapely.box(half, 0, width_m, height_m)], dtype=object),
        lot_zone=np.array([0, 1]),
        zones=ZONES,
        plant_xy=rng.uniform(0, 1, (plants, 2)) * [half, height_m],
        plant_radius_m=np.full(plants, 2.0),
        plant_species=np.arange(plants) % 2,
        species=SPECIES,
        buildings=np.array([shapely.box(half + 5, 5, half + 10, 10)], dtype=object),
        building_height_m=np.array([9.0]),
        roads=np.array([shapely.box(0, -6, width_m, 0)], dtype=object),
    )


def pixels(figure) -> np.ndarray:
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]


def words(figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


@pytest.mark.parametrize(("width_m", "height_m"), [(100, 100), (900, 40), (40, 900), (0.5, 0.5), (90_000, 60_000)])
def test_any_shape_of_city_gives_a_picture_of_the_width_asked_for(width_m, height_m):
    image = pixels(draw_map(layers(width_m, height_m), title="Town", width_px=500))
    assert image.shape[1] == 500
    assert 200 < image.shape[0] < 1500
    assert (image == [255, 0, 0]).all(axis=2).sum() > 20


def test_zones_have_their_colours_in_equal_parts():
    image = pixels(draw_map(layers(plants=0), title="Town", width_px=800))
    red = (image == [255, 0, 0]).all(axis=2).sum()
    green = (image == [0, 255, 0]).all(axis=2).sum()
    assert green / red == pytest.approx(1.0, abs=0.06)


def test_the_scale_bar_is_as_long_as_it_says():
    figure = draw_map(layers(1000, 1000), title="Town", width_px=1200)
    page = figure.axes[0]
    bars = [p for p in page.patches if type(p).__name__ == "Rectangle" and p.get_height() == pytest.approx(6.0)]
    length_px = sum(bar.get_width() for bar in bars)
    metres = float(next(text for text in words(figure) if text.endswith(" m")).split()[0])
    pane = next(axes for axes in figure.axes[1:])
    west, east = pane.get_xlim()
    assert length_px / metres == pytest.approx(pane.get_position().width * 1200 / (east - west), rel=1e-6)


def test_title_and_legend_name_the_counts():
    found = words(draw_map(layers(plants=5), title="Town of $x$", notes=["a note"], width_px=400))
    assert "Town of $x$" in found
    assert "a note" in found
    assert any("2 lots" in text and "5 plants: 3 trees, 2 shrubs" in text and "2 species" in text for text in found)
    assert {"residential", "street", "Oak", "Elder", "buildings"} <= set(found)


def test_what_lots_were_filled_from_is_shown_and_counted():
    plain = layers(plants=0)
    assert "filled from the map" not in words(draw_map(plain, title="Town", width_px=400))
    mapped = replace(plain, regions=np.array([shapely.box(10, 10, 40, 90)], dtype=object))
    figure = draw_map(mapped, title="Town", width_px=400)
    assert "filled from the map" in words(figure)
    green = (pixels(figure) == [0xA9, 0xBD, 0x8C]).all(axis=2).sum()
    red = (pixels(draw_map(plain, title="Town", width_px=400)) == [255, 0, 0]).all(axis=2).sum()
    assert green / red == pytest.approx(30 * 80 / 5000, rel=0.15)
    assert SeenCounts.of(mapped, (60, 0, 100, 100)).region_count == 0


def test_a_part_of_the_city_counts_what_it_shows():
    seen = SeenCounts.of(layers(plants=40), (60, 0, 100, 100))
    assert seen.lots.tolist() == [0, 1]
    assert seen.plants.sum() == 0
    assert seen.building_count == 1


def test_an_empty_city_still_makes_a_picture():
    nothing = np.empty(0, dtype=object)
    empty = MapLayers(nothing, np.zeros(0, int), [], np.zeros((0, 2)), np.zeros(0), np.zeros(0, int), [])
    assert pixels(draw_map(empty, title="Nowhere", width_px=300)).shape[1] == 300


def test_many_species_and_zones_are_summed_up_in_the_legend():
    species = [SpeciesStyle(f"s{i}", f"Species {i}", "#336633", True) for i in range(40)]
    city = layers(plants=0)
    many = MapLayers(city.lots, city.lot_zone, city.zones, np.full((40, 2), 50.0), np.ones(40), np.arange(40), species)
    assert any(text.endswith(" more") for text in words(draw_map(many, title="Town", width_px=400)))


@pytest.mark.parametrize(("metres", "expected"), [(7, 5), (99, 50), (100, 100), (0.3, 0.2), (2600, 2000)])
def test_scale_bars_have_round_lengths(metres, expected):
    assert round_length(metres) == pytest.approx(expected)


def test_lengths_are_told_in_the_unit_of_the_whole():
    assert length_text(1000, unit_of=2000) == "1 km"
    assert length_text(500, unit_of=1000) == "500 m"


def test_words_of_pictures():
    assert counted(1, "tree") == "1 tree"
    assert counted(1200, "species", "species") == "1,200 species"
    assert printable("a\nb\x00c") == "a b\ufffdc"
    assert shortened("abcdef", 4) == "abc\u2026"
    assert place_name("del_mar") == "Del mar"
