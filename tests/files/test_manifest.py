import json
import os

import pytest

from urbanforest_cli.files.manifest import (
    MANIFEST,
    TORN,
    Export,
    FileState,
    describe_files,
    faults_of,
    is_intact,
    manifest_faults,
    read_manifest,
    record_exports,
)


@pytest.fixture
def out(tmp_path):
    """A folder with a file and a folder of files, both in its manifest."""
    (tmp_path / "forest.glb").write_bytes(b"glTF" * 25)
    for name in ("tileset.json", "content/0.glb", "content/1.glb"):
        (tmp_path / "tiles" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tiles" / name).write_text(f"content of {name}")
    record_exports(tmp_path, [export_of(tmp_path, "forest.glb"), export_of(tmp_path, "tiles")])
    return tmp_path


def export_of(out, name, **values):
    return Export(name, "glb", key="k", growth="g", files=describe_files(out / name), **values)


def faults(out, name):
    export = read_manifest(out)[name]
    found = faults_of(out, export)
    assert is_intact(out, export) == (not found)
    return found


def test_what_is_recorded_is_read_again_and_is_whole(out):
    exports = read_manifest(out)
    assert exports == {name: export_of(out, name) for name in ("forest.glb", "tiles")}
    assert set(exports["forest.glb"].files) == {"forest.glb"}
    assert set(exports["tiles"].files) == {"tiles/tileset.json", "tiles/content/0.glb", "tiles/content/1.glb"}
    assert (exports["forest.glb"].is_folder, exports["tiles"].is_folder) == (False, True)
    assert faults(out, "forest.glb") == faults(out, "tiles") == manifest_faults(out) == []


def test_later_outputs_join_earlier_ones_and_equal_content_is_equal_bytes(out):
    first = (out / MANIFEST).read_bytes()
    (out / "itree.csv").write_text("1")
    record_exports(out, [export_of(out, "itree.csv", options={"bbox": [1, 2, 3, 4]})])
    assert sorted(read_manifest(out)) == ["forest.glb", "itree.csv", "tiles"]
    assert read_manifest(out)["itree.csv"].options == {"bbox": [1, 2, 3, 4]}
    record_exports(out, [], remove=["itree.csv", "never.there"])
    assert (out / MANIFEST).read_bytes() == first
    (out / "forest.glb").write_bytes(b"other")
    record_exports(out, [export_of(out, "forest.glb")])
    assert read_manifest(out)["forest.glb"].files["forest.glb"].bytes == 5


def test_a_missing_a_cut_a_longer_and_a_changed_file_are_told_apart(out):
    path = out / "forest.glb"
    whole = path.read_bytes()
    path.write_bytes(whole[:60])
    assert faults(out, "forest.glb") == ["forest.glb is cut, 60 of 100 bytes"]
    path.write_bytes(whole + b"x")
    assert faults(out, "forest.glb") == ["forest.glb has 101 bytes, 100 were written"]
    path.write_bytes(whole[:50] + bytes([whole[50] ^ 1]) + whole[51:])
    assert faults(out, "forest.glb") == ["forest.glb was changed since it was written"]
    path.unlink()
    assert faults(out, "forest.glb") == ["forest.glb is missing"]
    path.mkdir()
    assert faults(out, "forest.glb") == ["forest.glb is no file"]


def test_in_a_folder_every_file_counts_and_strays_are_told(out):
    (out / "tiles" / "content" / "0.glb").unlink()
    (out / "tiles" / "content" / "9.glb").write_text("stray")
    (out / "tiles" / "more").symlink_to(out)
    assert faults(out, "tiles") == [
        "tiles/content/0.glb is missing",
        "tiles/content/9.glb was not written with the others",
        "tiles/more was not written with the others",
    ]


def test_a_file_in_a_folder_that_became_a_link_or_a_pipe_is_no_file(out):
    for name, make in (("0.glb", lambda path: path.symlink_to(out / "forest.glb")), ("1.glb", os.mkfifo)):
        path = out / "tiles" / "content" / name
        path.unlink()
        make(path)
        assert f"tiles/content/{name} is no file" in faults(out, "tiles")


def test_what_lies_beside_a_file_and_belongs_to_it_counts(out):
    beside = out / "itree.csv-metadata.json"
    for path in (out / "itree.csv", beside):
        path.write_text("x")
    record_exports(out, [Export("itree.csv", "itree", "k", files=describe_files(out / "itree.csv", beside))])
    assert not read_manifest(out)["itree.csv"].is_folder
    assert faults(out, "itree.csv") == []
    beside.unlink()
    assert faults(out, "itree.csv") == ["itree.csv-metadata.json is missing"]


def test_no_manifest_is_no_outputs_and_no_fault(tmp_path):
    assert (read_manifest(tmp_path), manifest_faults(tmp_path)) == ({}, [])


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"exports": 5}', '{"exports": [], "manifest_version": 99}', "[" * 100_000, "\ud800"],
)
def test_a_torn_manifest_is_a_fault_and_is_replaced_by_the_next_record(out, text):
    (out / MANIFEST).write_bytes(text.encode("utf-8", "surrogatepass"))
    assert read_manifest(out) == {}
    assert len(manifest_faults(out)) == 1
    record_exports(out, [export_of(out, "tiles")])
    assert (list(read_manifest(out)), manifest_faults(out)) == (["tiles"], [])


def change(out, change_record):
    content = json.loads((out / MANIFEST).read_text())
    change_record(content["exports"])
    (out / MANIFEST).write_text(json.dumps(content))


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "..", ".", "", "a/b", "a\0b", 5, None, ["x"]])
def test_a_name_that_leads_out_of_the_folder_is_a_fault_and_no_output(out, name):
    change(out, lambda exports: exports[0].update(name=name))
    assert list(read_manifest(out)) == ["tiles"]
    assert len(manifest_faults(out)) == 1


@pytest.mark.parametrize(
    "name", ["../forest.glb", "/etc/passwd", "forest.glb", "tiles/../forest.glb", "tiles//a", "tiles/."]
)
def test_a_file_that_lies_elsewhere_is_a_fault_and_no_output(out, name):
    state = {"sha256": "0" * 64, "bytes": 1}
    change(out, lambda exports: exports[1]["files"].update({name: state}))
    assert list(read_manifest(out)) == ["forest.glb"]
    assert len(manifest_faults(out)) == 1


@pytest.mark.parametrize(
    "values",
    [{"files": 5}, {"files": {"forest.glb": 5}}, {"options": []}, {"key": None}, {"growth": 1}, {"format": {}},
     {"files": {"forest.glb": {"sha256": "x", "bytes": 1}}},
     {"files": {"forest.glb": {"sha256": "0" * 64, "bytes": True}}},
     {"files": {"forest.glb": {"sha256": "0" * 64, "bytes": -1}}},
     {"files": {name: {"sha256": "0" * 64, "bytes": 1} for name in ("forest.glb", "forest.glb/a")}}],
)  # fmt: skip
def test_fields_of_a_wrong_kind_are_faults(out, values):
    change(out, lambda exports: exports[0].update(values))
    assert list(read_manifest(out)) == ["tiles"]
    assert len(manifest_faults(out)) == 1


def test_an_output_named_twice_or_no_record_at_all_is_a_fault(out):
    change(out, lambda exports: exports.extend([exports[0], 7, {}]))
    assert sorted(read_manifest(out)) == ["forest.glb", "tiles"]
    assert len(manifest_faults(out)) == 3


def test_an_output_without_files_vouches_for_nothing(out):
    assert not is_intact(out, Export("forest.glb", "glb", "k"))
    assert not is_intact(out, Export("empty", "3dtiles", "k", files={"empty/a": FileState("0" * 64, 0)}))


def test_a_torn_manifest_is_kept_aside_before_it_is_written_anew(out, caplog):
    torn = (out / MANIFEST).read_text()[:-40]
    (out / MANIFEST).write_text(torn)
    record_exports(out, [export_of(out, "forest.glb")])
    assert (out / TORN).read_text() == torn
    assert "kept as exports.json.torn" in caplog.text
    assert (list(read_manifest(out)), manifest_faults(out)) == (["forest.glb"], [])


def test_a_whole_manifest_is_not_kept_aside(out):
    record_exports(out, [export_of(out, "forest.glb")])
    assert not (out / TORN).exists()
