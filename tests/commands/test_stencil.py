import json

from urbanforest_cli.files.geopackage import layer_names, read_layer


def test_stencil_writes_a_register_and_says_what_it_did(runner, tiny_city, tmp_path):
    register = tmp_path / "out" / "register.gpkg"
    outcome = runner("stencil", tiny_city, "-o", register, "--seed", "5")
    assert outcome.exit_code == 0, outcome.stderr
    assert "3 lots" in outcome.stdout
    assert {"lots", "active_areas", "parameters", "skipped", "provenance"} <= set(layer_names(register))
    assert read_layer(register, "provenance")["seed"].tolist() == ["5"]


def test_stencil_tells_the_same_as_json(runner, tiny_city, tmp_path):
    outcome = runner("stencil", tiny_city, "-o", tmp_path / "register.gpkg", "--json", "-q")
    record = json.loads(outcome.stdout)
    assert record["stage"] == "stencil"
    assert record["counts"]["lots"] == 3


def test_stencil_leaves_a_register_that_is_there_unless_told_otherwise(runner, tiny_city, tmp_path):
    register = tmp_path / "register.gpkg"
    register.write_bytes(b"mine")
    outcome = runner("stencil", tiny_city, "-o", register)
    assert outcome.exit_code == 2
    assert "--overwrite" in outcome.stderr
    assert register.read_bytes() == b"mine"
    assert runner("stencil", tiny_city, "-o", register, "--overwrite").exit_code == 0


def test_too_many_bad_lots_are_exit_code_3_and_the_register_is_written(runner, tmp_path):
    city, register = tmp_path / "city.geojson", tmp_path / "out" / "register.gpkg"
    ring = [[15, 48], [15.001, 48], [15.001, 48.001], [15, 48.001], [15, 48]]
    features = [
        {"type": "Feature", "properties": {"lot_id": name}, "geometry": geometry}
        for name, geometry in (("a", {"type": "Polygon", "coordinates": [ring]}), ("b", None))
    ]
    city.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert runner("stencil", city, "-o", register).exit_code == 0  # of two lots a share says nothing
    outcome = runner("stencil", city, "-o", register, "--overwrite", "--max-bad", "0.1")
    assert outcome.exit_code == 3
    assert "1 of 2 lots" in outcome.stderr
    assert read_layer(register, "skipped")["lot_id"].tolist() == ["b"]
    assert runner("stencil", city, "-o", register, "--overwrite", "--max-bad", "0.5").exit_code == 0


def test_a_city_that_is_none_is_exit_code_2_and_leaves_nothing(runner, tmp_path):
    city = tmp_path / "city.gpkg"
    city.write_bytes(b"not a database")
    outcome = runner("stencil", city, "-o", tmp_path / "out" / "register.gpkg")
    assert outcome.exit_code == 2
    assert "city.gpkg" in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert sorted(tmp_path.iterdir()) == [city]
