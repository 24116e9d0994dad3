"""Khronos' validator and three.js open what `export --to glb` writes."""

import numpy as np
import pytest

from tests.readers.conftest import PROTOTYPES, assert_shows_plants, held_against, urbanforest

pytestmark = pytest.mark.readers

DETAILS = ("full", "high", "medium", "low", "billboard", "point")
KNOWN_INFOS = {
    "UNSUPPORTED_EXTENSION": "it knows none of EXT_mesh_gpu_instancing, EXT_instance_features, EXT_structural_metadata",
    "UNUSED_OBJECT": "so it sees no use of what these name",
    "URI_GLB": "tiles share buffers and textures, which lie beside them",
    "IMAGE_NPOT_DIMENSIONS": "pictures of plants are as large as they need be",
}


@pytest.fixture(scope="module")
def corner(forest):
    """West, south, east, north of a corner of the city with some plants in it."""
    from urbanforest_cli.files.geopackage import read_layer

    west, south, east, north = read_layer(forest / "register.gpkg", "plants").total_bounds
    return west, south, west + (east - west) / 4, south + (north - south) / 4


def test_the_validator_finds_nothing_wrong_with_any_file(node, forest, corner, tmp_path):
    files = [forest / "forest.glb", *sorted((forest / "tiles").rglob("*.glb"))]
    for options in (*(("--detail", detail) for detail in DETAILS), ("--plain", "--detail", "low")):
        files.append(tmp_path / f"{'-'.join(options).strip('-')}.glb")
        urbanforest(
            "export", forest, "--to", "glb", "-o", files[-1], "--prototypes", 8, "--bbox", *corner, *options, "-q"
        )
    reports = node("validate.mjs", files=[str(file) for file in files])
    assert len(reports) == len(files)
    for file, report in reports.items():
        errors, warnings, *_ = report["counts"]
        assert (errors, warnings) == (0, 0), f"{file}: {report['worst']}"
        assert set(report["codes"]) <= set(KNOWN_INFOS), file
        assert report["triangles"] or "point" in file, file


def test_three_shows_as_many_trees_as_the_register_has_each_in_its_place(browser, forest, standing, tmp_path):
    urbanforest(
        "export", forest, "--to", "glb", "--detail", "low", "--prototypes", PROTOTYPES, "-o", tmp_path / "low.glb", "-q"
    )
    answer = browser(
        "open_glb.mjs", folder=str(tmp_path), file="low.glb", picture=str(tmp_path / "three.png"),
        eye=[0, 220, 420], at=[0, 0, 40],
    )  # fmt: skip
    assert answer["told"] == []
    assert answer["drawn_triangles"] > 0
    assert len(answer["rows"]) == len(standing) == len(answer["ids"])
    rows = np.array(answer["rows"])
    x, y, z = rows[:, 1:].T
    place = answer["extras"]["origin"]
    xyz = np.column_stack([x + place["easting_m"], -z + place["northing_m"], y])
    result = held_against(standing, [answer["ids"][int(row)] for row in rows[:, 0]], xyz, standing.crs)
    assert result.faults == ()
    assert_shows_plants(tmp_path / "three.png")


def test_a_plain_file_has_a_node_a_plant_for_readers_without_extensions(browser, forest, corner, tmp_path):
    urbanforest(
        "export",
        forest,
        "--to",
        "glb",
        "--plain",
        "--detail",
        "low",
        "--bbox",
        *corner,
        "-o",
        tmp_path / "plain.glb",
        "-q",
    )
    answer = browser("open_glb.mjs", folder=str(tmp_path), file="plain.glb", eye=[0, 220, 420], at=[0, 0, 40])
    assert answer["rows"] == []
    assert answer["nodes"] > 0
    assert answer["drawn_triangles"] > 0
