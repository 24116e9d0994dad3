import json
import random
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.reference.branching import branching
from urbanforest_cli.core.errors import InputError, OutputError, SchemaError
from urbanforest_cli.core.skeleton import Skeletons, concatenate, no_skeletons, quantise, radius_m, select
from urbanforest_cli.files import skeleton_format
from urbanforest_cli.files import skeletons as files
from urbanforest_cli.files.skeletons import (
    describe,
    iterate_batches,
    read_parts,
    read_provenance,
    read_texts,
    write_part,
)

FIELDS = tuple(Skeletons.__dataclass_fields__)


def same(one: Skeletons, other: Skeletons) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in FIELDS)


@pytest.fixture(scope="module")
def batches() -> list[Skeletons]:
    trees = [branching(i, 200 + 40 * i, seasons=5 + 4 * i, stems=1 + 3 * (i % 2)) for i in range(6)]
    return [concatenate(trees[:3]), trees[3], concatenate(trees[4:])]


@pytest.fixture
def part(tmp_path, batches):
    path = tmp_path / "skeletons" / "part-0000.parquet"
    texts = {"plant_id": {i: f"lot a/{i}" for i in range(6)}, "species": dict.fromkeys(range(5), "Tilia")}
    write_part(path, batches, {"stage": "grow", "seed": "7"}, texts=texts)
    return path


def test_what_is_read_is_what_was_written_on_the_grid(part, batches):
    found = read_parts(part)
    assert same(found, quantise(concatenate(batches)))
    assert same(read_parts(part.parent), found)
    assert [group for _, group, _ in iterate_batches(part)] == [0, 1, 2]
    for (name, group, read), batch in zip(iterate_batches(part.parent), batches, strict=True):
        assert name == part.name
        assert same(read, quantise(batch)), group


def test_writing_what_was_read_gives_the_same_bytes(part, tmp_path):
    texts = {name: read_texts(part, name) for name in ("plant_id", "species")}
    again = tmp_path / "again.parquet"
    write_part(again, (batch for _, _, batch in iterate_batches(part)), {"seed": "7", "stage": "grow"}, texts=texts)
    assert again.read_bytes() == part.read_bytes()


def test_a_table_reader_gets_metres_parents_and_radii_from_the_columns_alone(part, batches):
    table = pd.read_parquet(part)
    truth = quantise(concatenate(batches))
    metres = 0.005 * table[["x_5mm", "y_5mm", "z_5mm"]].to_numpy()
    assert np.abs(metres - truth.xyz_m).max() < 1e-6
    parent = table["node"] - table["parent_back"]
    assert (parent == truth.parent).all()
    radius = table["tip_radius_m"] * table["pipes"] ** (1 / table["pipe_exponent"])
    assert np.allclose(radius, radius_m(truth), rtol=1e-14, atol=0)
    assert (parent < table["node"]).all()
    assert parent[table["node"] == 0].tolist() == [-1] * 6
    for _, rows in table.assign(parent=parent).groupby("skeleton_id"):
        above = rows[rows["node"] > 0].groupby("parent")["pipes"].sum()
        expected = above.reindex(rows["node"], fill_value=0).clip(lower=1)
        assert (rows["pipes"].to_numpy() == expected.to_numpy()).all(), "exact, lost wood included"
    assert set(table.loc[table["skeleton_id"] == 4, "species"]) == {"Tilia"}
    assert table.loc[table["skeleton_id"] == 5, "species"].isna().all()
    assert set(table.loc[table["skeleton_id"] == 5, "plant_id"]) == {"lot a/5"}


def test_the_file_says_how_to_read_it(part):
    record = json.loads(pq.read_metadata(part).metadata[b"urbanforest"])
    assert "parent = node - parent_back" in record["how_to_read"]
    assert "tip_radius_m * pipes" in record["how_to_read"]
    assert set(record["columns"]) == set(pq.read_schema(part).names)
    assert record["provenance"] == read_provenance(part) == {"stage": "grow", "seed": "7"}


def test_describe_counts_what_is_there(part, batches):
    truth = concatenate(batches)
    record = describe(part)
    assert record["skeletons"] == 6
    assert record["internodes"] == len(truth.parent) - 6
    assert record["lost_internodes"] == (truth.death_season > 0).sum()
    assert record["species"] == {"Tilia": 5}
    assert record["seasons"] == 25
    assert record["row_groups"] == 3
    assert record["provenance"] == {"stage": "grow", "seed": "7"}


def test_ids_come_in_the_order_asked_for(part, batches):
    assert same(read_parts(part.parent, skeleton_ids=[4, 0]), select(quantise(concatenate(batches)), [4, 0]))
    with pytest.raises(SchemaError, match="1 skeletons are missing") as raised:
        read_parts(part, skeleton_ids=[4, 77])
    assert "no skeleton_id 77" in str(raised.value)


def test_row_groups_are_read_as_named(part, batches):
    assert same(read_parts(part.parent, row_groups={part.name: [2, 1]}), quantise(concatenate(batches[:0:-1])))
    assert len(read_parts(part.parent, row_groups={"part-0009.parquet": [0]})) == 0
    with pytest.raises(SchemaError, match="row group 9 of 3"):
        read_parts(part, row_groups={part.name: [9]})


def test_selected_ids_are_read_past_row_groups_that_are_broken(part, batches):
    content = bytearray(part.read_bytes())
    for number in range(13):  # the ids too: the range in the statistics says where they are
        column = pq.read_metadata(part).row_group(0).column(number)
        content[column.data_page_offset : column.data_page_offset + 8] = bytes(8)
    part.write_bytes(content)
    assert same(read_parts(part, skeleton_ids=[3]), quantise(batches[1]))
    with pytest.raises(SchemaError):
        read_parts(part, skeleton_ids=[0])


def test_internodes_take_less_than_six_bytes(tmp_path):
    trees = [branching(10 + i, 5500, seasons=20 + 30 * i) for i in range(3)]
    path = tmp_path / "part.parquet"
    write_part(path, [concatenate(trees)], {})
    assert describe(path)["bytes_an_internode"] < 6


def test_no_batch_and_an_empty_batch_are_files_too(tmp_path, batches):
    path = tmp_path / "part.parquet"
    write_part(path, [], {})
    assert len(read_parts(path)) == 0
    write_part(path, [batches[1], no_skeletons(), batches[2]], {})
    assert same(read_parts(path, row_groups={path.name: [2]}), quantise(batches[2]))
    assert len(read_parts(path, row_groups={path.name: [1]})) == 0
    assert describe(path)["skeletons"] == 3


def test_batches_that_break_the_rules_leave_the_old_file(part, batches):
    before = part.read_bytes()
    with pytest.raises(SchemaError, match="repeats over batches"):
        write_part(part, [batches[0], batches[1], batches[0]], {})
    with pytest.raises(SchemaError, match="before birth"):
        write_part(part, [replace(batches[1], death_season=np.minimum(batches[1].birth_season, 1))], {})
    assert part.read_bytes() == before
    assert [path.name for path in part.parent.iterdir()] == [part.name]


def test_rows_that_did_not_reach_the_disk_are_noticed(tmp_path, batches, monkeypatch):
    monkeypatch.setattr(files, "_row_counts", lambda path: [1])
    with pytest.raises(OutputError, match="not written whole"):
        write_part(tmp_path / "part.parquet", batches, {})
    assert list(tmp_path.iterdir()) == []


def test_the_same_id_in_two_parts_is_refused(part):
    part.with_name("part-0001.parquet").write_bytes(part.read_bytes())
    with pytest.raises(SchemaError, match="skeleton_id repeats"):
        read_parts(part.parent)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_parts(tmp_path / "part.parquet")
    with pytest.raises(InputError, match="no skeletons in the folder"):
        read_parts(tmp_path)


@pytest.mark.parametrize("share", [0, 0.1, 0.5, 0.9, 0.999])
def test_torn_files_are_refused(part, share):
    content = part.read_bytes()
    part.write_bytes(content[: int(len(content) * share)])
    for reader in (read_parts, describe):
        with pytest.raises(SchemaError, match="not a whole Parquet file"):
            reader(part)


def test_changed_bytes_are_refused_or_make_no_difference(part):
    content, truth = part.read_bytes(), read_parts(part)
    rng = random.Random(5)
    refused = 0
    for attempt in range(300):
        changed = bytearray(content)
        start = len(content) - 4000 if attempt % 2 else 0
        changed[rng.randrange(start, len(content))] ^= 1 << rng.randrange(8)
        part.write_bytes(changed)
        try:
            assert same(read_parts(part), truth)
        except SchemaError:
            refused += 1
    assert refused > 150


def test_files_of_others_are_refused(tmp_path, part):
    foreign = tmp_path / "foreign.parquet"
    pd.DataFrame({"node": [0, 1]}).to_parquet(foreign)
    with pytest.raises(SchemaError, match="not a file of skeletons"):
        read_parts(foreign)
    foreign.write_text("x,y\n1,2\n")
    with pytest.raises(SchemaError, match="not a whole Parquet file"):
        describe(foreign)
    table = pq.read_table(part)
    for record in (b"{}", b"[1]", b"\xff", b"7", json.dumps({"format": skeleton_format.FORMAT}).encode()):
        pq.write_table(table.replace_schema_metadata({b"urbanforest": record}), foreign)
        with pytest.raises(SchemaError, match="not a file of skeletons"):
            read_parts(foreign)
    newer = {"format": skeleton_format.FORMAT, "format_version": 99, "provenance": {}}
    pq.write_table(table.replace_schema_metadata({b"urbanforest": json.dumps(newer).encode()}), foreign)
    with pytest.raises(SchemaError, match="another version"):
        read_parts(foreign)


def rewritten(part, change, tmp_path):
    """Change a part's table by other means, keeping its record."""
    table = pq.read_table(part)
    record = pq.read_metadata(part).metadata[b"urbanforest"]
    path = tmp_path / "changed.parquet"
    pq.write_table(change(table).replace_schema_metadata({b"urbanforest": record}), path)
    return path


def with_value(name, row, value):
    def change(table):
        values = table[name].to_pylist()
        values[row] = value
        kind = pa.int64() if pa.types.is_integer(table[name].type) else table[name].type
        return table.set_column(table.schema.get_field_index(name), name, pa.array(values, kind))

    return change


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (with_value("parent_back", 5, 0), "not below their node"),
        (with_value("parent_back", 5, -3), "not below their node"),
        (with_value("parent_back", 5, 6), "not below their node"),
        (with_value("parent_back", 5, 2**31 - 1), "not below their node"),
        (with_value("parent_back", 5, -(2**31)), "not below their node"),
        (with_value("parent_back", 0, 2), "roots with a parent"),
        (with_value("parent_back", 5, 2**40), "is int64, not int32"),
        (with_value("x_5mm", 5, 40_000), "is int64, not int16"),
        (with_value("x_5mm", 0, 1), "roots away"),
        (with_value("z_5mm", 5, None), "is empty in 1 rows"),
        (with_value("node", 0, 1), "does not start with a root"),
        (with_value("node", 5, 7), "not numbered in a row"),
        (with_value("node", 5, -1), "not numbered in a row"),
        (with_value("skeleton_id", 5, 99), "changes within a skeleton"),
        (with_value("tip_radius_m", 5, 0.5), "changes within a skeleton"),
        (with_value("pipe_exponent", 5, float("nan")), "changes within a skeleton"),
        (with_value("seasons", 5, 200), "changes within a skeleton"),
        (with_value("birth_season", 5, 200), "after the last season"),
        (with_value("pipes", 5, 1_000_000), "sum over children"),
        (lambda table: table.drop_columns(["pipes"]), "column 'pipes' is missing"),
        (lambda table: table.slice(3), "does not start with a root"),
        (lambda table: table.slice(0, 50), "sum over children"),
        (lambda table: pa.concat_tables([table, table]), "skeleton_id repeats"),
    ],
)
def test_tables_changed_by_other_programs_are_refused(part, tmp_path, change, text):
    with pytest.raises(SchemaError, match=text):
        read_parts(rewritten(part, change, tmp_path))


def test_tables_rewritten_with_wider_numbers_are_read(part, tmp_path):
    path = rewritten(part, lambda table: table.set_column(1, "node", table["node"].cast(pa.int64())), tmp_path)
    assert same(read_parts(path), read_parts(part))


def test_claims_of_more_nodes_than_a_batch_has_are_refused_before_reading(part, monkeypatch):
    monkeypatch.setattr(skeleton_format, "NODES_MAX", 300)
    with pytest.raises(SchemaError, match="claims"):
        read_parts(part)
