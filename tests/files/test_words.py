import json
from pathlib import Path

import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files import cityjson_reader, geojson, tiles3d_reader
from urbanforest_cli.files.gltf_reader import open_gltf
from urbanforest_cli.files.words import in_words, kind_of

CAUSES = {
    "no whole JSON": lambda: json.loads("{"),
    "no UTF-8 text, byte 1": lambda: b"a\xff".decode(),
    "'features' is missing": lambda: {}["features"],
    "a list is shorter than it should be": lambda: [][0],
    "a value is of another kind than it should be": lambda: len(None),
    "a number beyond all bounds": lambda: float(10**400),
    "No such file": lambda: Path("/nowhere/at/all").read_text(),
    "not 3 of them": lambda: (_ for _ in ()).throw(ValueError("not 3 of them")),
}


@pytest.mark.parametrize("words", CAUSES)
def test_what_a_reader_stumbles_over_is_told_without_names_of_python(words):
    with pytest.raises(Exception) as caught:  # noqa: PT011
        CAUSES[words]()
    told = in_words(caught.value)
    assert told.startswith(words)
    assert "Error" not in told


def test_values_of_json_are_called_as_json_calls_them():
    values = ({}, [], "a", True, 1, 1.5, None)
    expected = ["an object", "a list", "text", "true or false", "a number", "a number", "nothing"]
    assert [kind_of(value) for value in values] == expected


READERS = {
    "a.city.json": cityjson_reader.read_plants,
    "b.city.json": cityjson_reader.read_provenance,
    "plants.geojson": geojson.read_plants,
    "tileset.json": tiles3d_reader.read_plants,
    "a.gltf": open_gltf,
}


@pytest.mark.parametrize(
    "text", ["{", "[]", "null", "{}", '{"features": 5}', '{"asset": null}', '{"type": "CityJSON"}']
)
@pytest.mark.parametrize("name", READERS)
def test_no_reader_of_json_tells_of_python(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    try:
        READERS[name](tmp_path / name)
    except InputError as caught:
        told = caught.message()
    else:
        told = ""
    assert not any(word in told for word in ("Error", "NoneType", "dict", "indices"))
