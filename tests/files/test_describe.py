import numpy as np
import pandas as pd
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pyproj import CRS

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.files.describe import describe_output
from urbanforest_cli.files.geopackage import write_layers
from urbanforest_cli.files.provenance import Record
from urbanforest_cli.files.skeleton_parts import hash_of, part_name
from urbanforest_cli.files.skeletons import write_part

PART = part_name("0" * 24)


@pytest.fixture
def register(tmp_path):
    """A register that names one part with a pole of two internodes."""
    part = tmp_path / "skeletons" / PART
    pole = Skeletons(
        skeleton_id=np.array([5]), first=np.array([0, 3]), seasons=np.array([2], np.int32),
        tip_radius_m=np.array([0.01]), pipe_exponent=np.array([2.0]), parent=np.array([-1, 0, 1], np.int32),
        xyz_m=np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2]], np.float32), order=np.zeros(3, np.uint8),
        birth_season=np.array([0, 1, 2], np.uint8), death_season=np.zeros(3, np.uint8),
    )  # fmt: skip
    write_part(part, [pole], {"stage": "grow", "seed": 3, "plants": {"skeleton_id": [5]}})
    files = pd.DataFrame({"part": [PART], "sha256": [hash_of(part)], "bytes": [part.stat().st_size],
                          "skeleton_count": [1], "internode_count": [2]})  # fmt: skip
    records = [
        Record("stencil", 3, "s", CRS.from_epsg(32633), {}, []),
        Record("grow", 3, "k", CRS.from_epsg(32633), {}, [], counts={"plants": 1, "unique": 1}),
    ]
    path = tmp_path / "register.gpkg"
    write_layers(path, {"skeleton_parts": files, "provenance": pd.DataFrame([r.as_row() for r in records])}, fresh=True)
    return path


def test_a_register_tells_of_its_skeletons_and_whether_they_are_there(register):
    record = describe_output(register)
    part = register.parent / "skeletons" / PART
    assert record["stages"]["grow"]["counts"] == {"plants": 1, "unique": 1}
    assert record["skeletons"] == {
        "folder": "skeletons", "parts": 1, "bytes": part.stat().st_size, "missing_or_changed": [],
    }  # fmt: skip
    part.unlink()
    assert describe_output(register)["skeletons"]["missing_or_changed"] == [PART]


def test_a_part_tells_what_it_holds(register):
    record = describe_output(register.parent / "skeletons" / PART)
    assert (record["skeletons"], record["internodes"], record["seasons"]) == (1, 2, 2)
    assert record["provenance"] == {"stage": "grow", "seed": 3}
    assert "parent = node - parent_back" in record["how_to_read"]


def test_a_file_of_another_kind_is_told_what_is_expected(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(InputError, match="skeletons"):
        describe_output(path)


def test_a_folder_of_outputs_is_told_by_its_register(register, runner):
    assert describe_output(register.parent) == describe_output(register)
    assert "stage_key: k" in runner("info", register.parent).stdout


def test_a_folder_without_a_register_is_told_what_to_name(tmp_path):
    with pytest.raises(InputError) as caught:
        describe_output(tmp_path)
    assert "folder that `urbanforest populate` wrote" in caught.value.next_step


@pytest.mark.parametrize("text", ["{", "[1]", "5", "[" * 100_000])
def test_a_torn_provenance_is_told_of_pictures_and_pages(tmp_path, text):
    about = PngInfo()
    about.add_text("urbanforest", text)
    Image.new("RGB", (2, 2)).save(tmp_path / "map.png", pnginfo=about)
    (tmp_path / "report.html").write_text(
        f'<script type="application/json" id="urbanforest-provenance">{text}</script>'
    )  # fmt: skip
    for name in ("map.png", "report.html"):
        with pytest.raises(InputError, match="its provenance is torn"):
            describe_output(tmp_path / name)
