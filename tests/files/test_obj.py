import io
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from pyproj import CRS

from tests.reference.gltf_scenes import MODELS, scene
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.scenery import Model, Property
from urbanforest_cli.files.obj import read_plants, read_provenance, write_species_library

FRENCH = CRS.from_epsg(2154)


def library(path, content=None, crs=FRENCH):
    content = scene(30, points=3) if content is None else content
    write_species_library(path, content, crs=crs)
    return content


def placements(path):
    import csv

    with (path / "placements.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_plants_come_back_where_they_stand_in_the_registers_crs(tmp_path):
    for crs in (FRENCH, CRS.from_epsg(4326), CRS.from_epsg(32631)):
        content = library(tmp_path / "species", crs=crs)
        found = read_plants(tmp_path / "species")
        local = np.concatenate([content.instances.xyz_m, content.points.xyz_m])
        expected = local[:, :2] + [content.origin.easting_m, content.origin.northing_m]
        assert found.crs == crs
        assert np.abs(reproject_xy(found.xyz_m[:, :2], crs, content.origin.crs) - expected).max() < 0.0011
        assert np.abs(found.xyz_m[:, 2] - local[:, 2] - content.origin.height_m).max() <= 0.00051
        assert found.plant_id.tolist() == content.properties["plant_id"].values.tolist()
        assert np.abs(found.height_m - content.properties["height_m"].values).max() <= 0.00051


def test_another_program_counts_the_triangles_of_every_shape(tmp_path):
    folder = tmp_path / "species"
    content = library(folder)
    rows = placements(folder)
    for number, model in enumerate(content.models):
        row = int(np.flatnonzero(content.instances.model == number)[0])
        loaded = trimesh.load_scene(folder / rows[row]["file"])
        assert sum(len(mesh.faces) for mesh in loaded.geometry.values()) == sum(
            len(p.mesh.triangle) for p in model.parts
        )
        assert len(loaded.geometry) == len(model.parts)


def test_shapes_stand_upright_with_y_up_and_their_faces_outward(tmp_path):
    library(tmp_path / "species", scene(4, models=(MODELS[1],)))
    (path,) = (tmp_path / "species").glob("*.obj")
    mesh = trimesh.load_mesh(path, process=False)
    original = MODELS[1].parts[0].mesh
    x, y, z = original.xyz_m.T
    assert np.abs(np.sort(mesh.vertices, axis=0) - np.sort(np.column_stack([x, z, -y]), axis=0)).max() < 1e-4
    drawn = mesh.face_normals
    stated = mesh.vertex_normals[mesh.faces].mean(axis=1)
    assert (np.einsum("ij,ij->i", drawn, stated) > 0.9).all()


def test_a_placed_model_is_the_plant_of_the_scene(tmp_path):
    folder = tmp_path / "species"
    content = library(folder, crs=CRS.from_epsg(32631))
    some = content.instances
    for row, line in enumerate(placements(folder)[: len(some)]):
        shape = trimesh.load_scene(folder / line["file"]).to_geometry()
        east, up, south = shape.vertices.T * float(line["scale"])
        north = south if line["mirror"] == "1" else -south
        turn = np.radians(float(line["yaw_deg"]))
        x = np.cos(turn) * east - np.sin(turn) * north + float(line["x"]) - content.origin.easting_m
        y = np.sin(turn) * east + np.cos(turn) * north + float(line["y"]) - content.origin.northing_m
        corners = np.concatenate([part.mesh.xyz_m for part in content.models[some.model[row]].parts]) * some.scale[row]
        corners[:, 1] *= -1 if some.mirror[row] else 1
        c, s = np.cos(some.yaw_rad[row]), np.sin(some.yaw_rad[row])
        expected = np.column_stack([c * corners[:, 0] - s * corners[:, 1], s * corners[:, 0] + c * corners[:, 1]])
        expected += some.xyz_m[row, :2]
        assert np.abs([x.min() - expected[:, 0].min(), y.max() - expected[:, 1].max()]).max() < 0.002
        assert up.max() == pytest.approx(corners[:, 2].max(), abs=0.001)


def test_texture_coordinates_count_from_below_as_obj_has_them(tmp_path):
    library(tmp_path / "species", scene(3, models=(MODELS[1],)))
    (path,) = (tmp_path / "species").glob("*.obj")
    lines = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("vt ")]
    uv = MODELS[1].parts[0].mesh.uv
    assert np.abs(np.array(lines, dtype=float) - np.column_stack([uv[:, 0], 1 - uv[:, 1]])).max() < 1e-4


def test_every_material_named_is_there_and_leaves_have_their_alpha_as_a_picture(tmp_path):
    folder = tmp_path / "species"
    library(folder)
    text = (folder / "species.mtl").read_text()
    named = {line.split()[1] for line in text.splitlines() if line.startswith("newmtl")}
    used = set()
    for path in folder.glob("*.obj"):
        used |= {line.split()[1] for line in path.read_text().splitlines() if line.startswith("usemtl")}
    assert used <= named
    for line in text.splitlines():
        if line.startswith("map_"):
            assert (folder / line.split()[1]).is_file()
    with Image.open(io.BytesIO((folder / "leaf_alpha.png").read_bytes())) as alpha:
        assert alpha.mode == "LA"
        assert np.asarray(alpha).min() == 255
    assert not (folder / "bark_alpha.png").exists()


def test_names_from_data_never_become_paths(tmp_path):
    nasty = ("../../up", "a/b", "C:\\x", "", "名", "Same", "same", "..")
    content = scene(8, models=tuple(Model(f"m{n}", MODELS[0].parts) for n in range(8)))
    content = replace(
        content,
        instances=replace(content.instances, model=np.arange(8, dtype=np.int32)),
        materials=tuple(replace(item, name=f"../{item.name} x") for item in content.materials),
        properties={**content.properties, "species": Property(np.array(nasty, dtype=object), "text", "")},
    )
    library(tmp_path / "species", content)
    assert [path.name for path in tmp_path.iterdir()] == ["species"]
    names = [path.name for path in (tmp_path / "species").iterdir()]
    assert all(name.isascii() and not name.startswith((".", "-")) for name in names)
    files = [row["file"] for row in placements(tmp_path / "species")]
    assert len({name.lower() for name in files}) == 8


def test_the_provenance_is_beside_the_table_and_in_each_shape(tmp_path):
    folder = tmp_path / "species"
    content = library(folder)
    assert read_provenance(folder) == dict(content.provenance)
    for path in folder.glob("*.obj"):
        line = path.read_text().splitlines()[1]
        assert json.loads(line.removeprefix("# provenance ")) == dict(content.provenance)


def test_equal_scenes_are_equal_bytes(tmp_path):
    for name in ("a", "b"):
        library(tmp_path / name / "species")
    files = [{path.name: path.read_bytes() for path in (tmp_path / name / "species").iterdir()} for name in ("a", "b")]
    assert files[0] == files[1]


def test_a_library_that_lacks_a_file_or_was_changed_is_refused_in_words(tmp_path):
    folder = tmp_path / "species"
    library(folder)
    table = (folder / "placements.csv").read_bytes()
    (folder / "placements.csv").write_bytes(table[: len(table) // 2])
    with pytest.raises(InputError):
        read_plants(folder)
    (folder / "placements.csv").write_bytes(table)
    next(folder.glob("*.obj")).unlink()
    with pytest.raises(InputError, match="not there"):
        read_plants(folder)
    (folder / "placements.csv-metadata.json").unlink()
    with pytest.raises(InputError, match="CRS"):
        read_plants(folder)
    with pytest.raises(InputError):
        read_plants(tmp_path / "none")
