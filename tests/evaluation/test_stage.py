from __future__ import annotations

import geopandas as gpd
import numpy as np
import pytest
import shapely
from PIL import Image

from urbanforest_cli.core.errors import InputError, SchemaError
from urbanforest_cli.core.publish import sha256_of
from urbanforest_cli.evaluation.stage import assign_to_lots, evaluate_register
from urbanforest_cli.files.geopackage import read_layer, write_layers


def test_real_plants_are_brought_to_the_lots_and_what_is_lost_is_counted(planted):
    register, city = planted
    before = sha256_of(register)
    summary = evaluate_register(register, observed=str(city))
    counts = summary.evaluation.counts
    assert (counts.real, counts.model, counts.model_in_lots_with_real) == (9 * 12, 200, 180)
    assert summary.evaluation.lots_compared == 9
    assert summary.evaluation.building is not None
    assert summary.notices.count("W_OBSERVED_OUTSIDE") == 1
    assert summary.notices.count("W_OBSERVED_EMPTY") == 1
    assert sha256_of(register) == before


def test_layers_and_formats_may_be_named_and_buildings_may_be_missing(planted, tmp_path):
    register, city = planted
    points = gpd.read_file(city, layer="observed_plants").dropna(subset="geometry").to_crs(4326)
    points.to_file(tmp_path / "trees.geojson")
    named = evaluate_register(register, observed=f"{city}:observed_plants", buildings=f"{city}:buildings")
    alone = evaluate_register(register, observed=str(tmp_path / "trees.geojson"))
    assert alone.evaluation.counts == named.evaluation.counts
    assert alone.evaluation.building is None
    assert "W_NO_BUILDINGS" in alone.notices


def test_plot_is_a_picture_of_more_than_one_colour(planted, tmp_path):
    register, city = planted
    plot = tmp_path / "page.png"
    summary = evaluate_register(register, observed=str(city), plot=plot)
    assert summary.output == plot
    with Image.open(plot) as picture:
        assert picture.width > 1000
        assert len(picture.convert("RGB").getcolors(maxcolors=2**24)) > 100
    bare = tmp_path / "bare.png"
    evaluate_register(register, observed=str(city), plot=bare, min_plants=500)
    assert bare.exists()


def test_plants_of_another_place_are_refused_in_one_sentence(planted, tmp_path):
    register, _ = planted
    gpd.GeoDataFrame(geometry=[shapely.Point(2.3, 48.8)], crs=4326).to_file(tmp_path / "paris.geojson")
    with pytest.raises(InputError, match="none of the observed plants lies in a lot"):
        evaluate_register(register, observed=str(tmp_path / "paris.geojson"))


def test_a_register_without_plants_names_the_command(planted):
    register, city = planted
    provenance = read_layer(register, "provenance")
    write_layers(register, {"provenance": provenance[provenance["stage"] != "place"]})
    with pytest.raises(SchemaError, match="urbanforest place"):
        evaluate_register(register, observed=str(city))


def test_a_point_in_several_lots_is_the_first_ones():
    lots = np.array([shapely.box(0, 0, 10, 10), shapely.box(5, 0, 20, 10)], dtype=object)
    xy = np.array([[7.0, 5], [12, 5], [30, 5], [0, 0]])
    assert assign_to_lots(xy, lots).tolist() == [0, 1, -1, 0]
    assert assign_to_lots(xy[:0], lots).tolist() == []


def test_command_prints_tables_and_json(planted, runner):
    import json

    register, city = planted
    text = runner("evaluate", register, "--observed", city)
    assert text.exit_code == 0, text.stderr
    for words in ("Counts", "nearest neighbour", "Chamfer", "0.16", "Score"):
        assert words in text.stdout
    record = json.loads(runner("evaluate", register, "--observed", city, "--json").stdout)
    assert record["evaluation"]["counts"]["real"] == 108
    assert len(record["evaluation"]["l_function"]["difference"]) == len(
        record["evaluation"]["measured_at"]["l_radii_m"]
    )


@pytest.mark.parametrize("name", ["city.gpkg", "notes.png"])
def test_a_plot_is_not_written_over_another_file(tmp_path, name):
    from urbanforest_cli.core.errors import UrbanForestError
    from urbanforest_cli.evaluation.stage import refuse_plot_over

    (tmp_path / name).write_text("mine")
    with pytest.raises(UrbanForestError):
        refuse_plot_over(tmp_path / name)
    refuse_plot_over(tmp_path / "new.png")
