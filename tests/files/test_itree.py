import csv
import json

import numpy as np
import pandas as pd
import pytest

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.csvw import description_path
from urbanforest_cli.files.itree import COLUMNS, read_plants, read_provenance, write_itree

RECORD = {"stage": "export", "seed": "7", "city": "Köln"}
NASTY = ["plain-0", 'quo"te,-1', "new\nline-2", "日本-3", "=1+1-4", " -5", "NA-6", "", "\r-8", "tab\t-9"]


def frame(ids):
    rng = np.random.default_rng(0)
    count = len(ids)
    return pd.DataFrame(
        {
            "ID": np.arange(1, count + 1),
            "User Tree ID": np.array(ids, dtype=object),
            "Species": "Tilia cordata",
            "Common Name": "small-leaved lime",
            "DBH 1 (cm)": rng.uniform(0, 80, count),
            "Total Height (m)": rng.uniform(0, 30, count),
            "Crown Base Height (m)": rng.uniform(0, 3, count),
            "Crown Width (m)": rng.uniform(0, 9, count),
            "Land Use": "Residential",
            "Latitude": rng.uniform(-60, 60, count),
            "Longitude": rng.uniform(-180, 180, count),
        }
    )


def test_plants_come_back_where_they_were_to_a_millimetre_whatever_their_ids(tmp_path):
    table = frame(NASTY)
    write_itree(tmp_path / "itree.csv", table, provenance=RECORD)
    found = read_plants(tmp_path / "itree.csv")
    assert found.plant_id.tolist() == NASTY
    assert found.crs.to_epsg() == 4326
    assert np.abs(found.xyz_m[:, :2] - table[["Longitude", "Latitude"]].to_numpy()).max() <= 0.51e-8
    assert np.abs(found.height_m - table["Total Height (m)"]).max() <= 0.00051
    assert (found.xyz_m[:, 2] == 0).all()


def test_the_first_row_names_ecos_fields_and_ids_are_whole_numbers_above_zero(tmp_path):
    write_itree(tmp_path / "itree.csv", frame(NASTY), provenance=RECORD)
    with (tmp_path / "itree.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(COLUMNS)
    assert [int(row["ID"]) for row in rows] == list(range(1, len(NASTY) + 1))


def test_the_description_says_what_columns_mean_and_keeps_the_provenance(tmp_path):
    path = tmp_path / "itree.csv"
    write_itree(path, frame(NASTY), provenance=RECORD)
    assert read_provenance(path) == RECORD
    beside = json.loads(description_path(path).read_text(encoding="utf-8"))
    assert beside["@context"][0] == "http://www.w3.org/ns/csvw"
    assert beside["url"] == "itree.csv"
    assert [column["titles"] for column in beside["tableSchema"]["columns"]] == list(COLUMNS)


def test_equal_plants_are_equal_bytes(tmp_path):
    texts = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_itree(tmp_path / name / "itree.csv", frame(NASTY), provenance=RECORD)
        texts.append([path.read_bytes() for path in sorted((tmp_path / name).iterdir())])
    assert texts[0] == texts[1]


def test_a_table_changed_since_is_found_out(tmp_path):
    path = tmp_path / "itree.csv"
    write_itree(path, frame(NASTY), provenance=RECORD)
    path.write_bytes(path.read_bytes().replace(b"Tilia", b"Quercus"))
    with pytest.raises(InputError, match="not the one"):
        read_provenance(path)


def test_a_table_without_a_description_says_nothing_of_its_making(tmp_path):
    path = tmp_path / "itree.csv"
    write_itree(path, frame(NASTY), provenance=RECORD)
    description_path(path).unlink()
    assert read_provenance(path) is None


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe\x00",
        b"a,b\n1,2\n",
        b'User Tree ID,Longitude,Latitude,Total Height (m)\n"a,1,2,3\n',
        b"User Tree ID,Longitude,Latitude,Total Height (m)\na,1,2\n",
        b"User Tree ID,Longitude,Latitude,Total Height (m)\na,1,two,3\n",
        b"User Tree ID,Longitude,Latitude,Total Height (m)\na\x00,1,,3\n",
    ],
)
def test_torn_and_foreign_tables_are_refused_in_words(tmp_path, text):
    path = tmp_path / "itree.csv"
    path.write_bytes(text)
    with pytest.raises(InputError, match="not a table of urbanforest"):
        read_plants(path)


def test_a_missing_or_torn_description_or_table_is_refused_in_words(tmp_path):
    with pytest.raises(InputError):
        read_plants(tmp_path / "none.csv")
    for text in ("{", "[" * 100_000, '"text"', "[1]"):
        description_path(tmp_path / "none.csv").write_text(text)
        if text in ('"text"', "[1]"):
            assert read_provenance(tmp_path / "none.csv") is None
        else:
            with pytest.raises(InputError):
                read_provenance(tmp_path / "none.csv")
