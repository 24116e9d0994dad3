import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from pyproj import CRS

from tests.reference.gltf_scenes import cone, properties_of
from urbanforest_cli.core.geodesy import to_enu
from urbanforest_cli.core.scenery import Fixed, Instances, Material, Mesh, Model, Origin, Part, Points, Scenery
from urbanforest_cli.export.scene.tile_cells import EDGE_MAX_M, cut_cells
from urbanforest_cli.export.scene.tile_crowns import WIDTH_MIN, with_solid_crowns
from urbanforest_cli.export.scene.tile_textures import with_small_textures
from urbanforest_cli.export.scene.tiling import tile_scene

ORIGIN = Origin(CRS.from_epsg(25832), 700_000.0, 5_800_000.0)


def picture(side, alpha=255):
    pixels = np.zeros((side, side, 4), np.uint8)
    pixels[:, : side // 2] = (200, 40, 40, alpha)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


def square(side_m, z=0.0, turns=1.0):
    corners = np.array([[0, 0, z], [side_m, 0, z], [side_m, side_m, z], [0, side_m, z]], np.float32)
    uv = np.array([[0, 0], [turns, 0], [turns, turns], [0, turns]], np.float32)
    up = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))
    return Mesh(corners, up, uv, np.full((4, 3), 255, np.uint8), np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def points(count=80):
    rng = np.random.default_rng(2)
    columns = properties_of(count, rng)
    standing = np.column_stack([rng.uniform(-400, 400, (count, 2)), np.zeros(count)])
    colours = np.array([[60, 110, 40], [30, 70, 60]], np.uint8)[rng.integers(0, 2, count)]
    none = Instances(np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool), np.zeros(0))
    return Scenery(ORIGIN, (), (), none, columns, points=Points(standing + 3.0, colours)), standing


def test_solid_crowns_have_the_height_the_width_and_the_colour_of_the_plants():
    scenery, standing = points()
    solid = with_solid_crowns(scenery, standing)
    assert solid.points is None
    assert solid.instances.xyz_m.tolist() == standing.tolist()
    for row, model in enumerate(solid.instances.model):
        part = solid.models[model].parts[0]
        reach = part.mesh.xyz_m * solid.instances.scale[row]
        height, radius = (float(scenery.properties[name].values[row]) for name in ("height_m", "crown_radius_m"))
        assert reach[:, 2].max() == pytest.approx(height, rel=1e-5)
        assert np.hypot(*reach[:, :2].T).max() == pytest.approx(max(radius, WIDTH_MIN * height), rel=0.28)
        greenest = int(np.argmax(scenery.points.rgb[row]))
        assert int(np.argmax(solid.materials[part.material].rgb)) == greenest
    assert len(solid.models) < 30


def test_solid_crowns_are_closed_and_face_outward():
    mesh = with_solid_crowns(*points()).models[0].parts[0].mesh
    corners = mesh.xyz_m[mesh.triangle].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.abs(normal.sum(axis=0)).max() < 1e-6
    assert (np.einsum("ij,ij->i", normal, corners.mean(axis=1) - mesh.xyz_m.mean(axis=0)) > 0).all()
    assert (np.einsum("ij,ij->i", normal, mesh.normal[mesh.triangle[:, 0]]) > 0).all()


def test_points_without_sizes_stay_points():
    scenery, standing = points()
    bare = replace(scenery, properties={"plant_id": scenery.properties["plant_id"]})
    assert with_solid_crowns(bare, standing) is bare


def test_textures_are_halved_to_what_is_seen_of_them():
    model = Model("m", (Part(square(2.0), 0),))
    none = points()[0].instances
    scenery = Scenery(ORIGIN, (Material("a", texture=picture(1024)), Material("b")), (model,), none, {})
    for pixels_per_m, side in ((300.0, 1024), (100.0, 512), (30.0, 128), (1.0, 64)):  # it has 512 texels a metre
        material, plain = with_small_textures(scenery, pixels_per_m)
        assert Image.open(io.BytesIO(material.texture)).size == (side, side)
        assert plain.texture is None


def test_a_smaller_texture_keeps_its_colour_and_its_share_of_clear_texels():
    model = Model("m", (Part(square(2.0), 0),))
    scenery = Scenery(ORIGIN, (Material("a", texture=picture(256)),), (model,), points()[0].instances, {})
    small = np.asarray(Image.open(io.BytesIO(with_small_textures(scenery, 1.0)[0].texture)).convert("RGBA"))
    opaque = small[..., 3] == 255
    assert opaque.mean() == 0.5
    assert np.unique(small[opaque], axis=0).tolist() == [[200, 40, 40, 255]]


def test_coarser_details_tell_less_and_stand_where_the_finest_do():
    scenery, standing = points()
    count = len(standing)
    rng = np.random.default_rng(3)
    instances = Instances(
        np.zeros(count, np.int32), standing, rng.uniform(0, 6, count), rng.random(count) < 0.5, np.ones(count)
    )
    fine = replace(
        scenery, points=None, instances=instances, materials=(Material("a"),), models=(Model("m", (Part(cone(), 0),)),)
    )
    tiled = tile_scene({"point": scenery, "medium": fine})
    assert list(tiled.sceneries["point"].properties) == ["plant_id", "species", "height_m"]
    assert list(tiled.sceneries["medium"].properties) == list(fine.properties)
    for name in ("point", "medium"):
        assert np.abs(tiled.sceneries[name].instances.xyz_m - to_enu(ORIGIN, standing)).max() < 1e-9
        assert not tiled.sceneries[name].instances.mirror.any()
    numbers = tiled.sceneries["medium"].instances.model
    assert (numbers == instances.mirror).all()
    plain, mirrored = tiled.models_of("medium", np.array([0, 1]))
    assert np.array_equal(mirrored.parts[0].mesh.xyz_m, plain.parts[0].mesh.xyz_m * np.float32([1, -1, 1]))
    corners = mirrored.parts[0].mesh.xyz_m[mirrored.parts[0].mesh.triangle]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    shown = mirrored.parts[0].mesh.normal[mirrored.parts[0].mesh.triangle[:, 0]]
    assert (np.einsum("ij,ij->i", faces, shown) > 0).all()


def test_turns_follow_the_grid_so_that_a_crown_points_the_same_way_on_earth():
    scenery, standing = points(3)
    yaw = np.array([0.0, 1.0, -2.0])
    instances = Instances(np.zeros(3, np.int32), standing, yaw, np.zeros(3, bool), np.ones(3))
    fine = replace(
        scenery, points=None, instances=instances, materials=(Material("a"),), models=(Model("m", (Part(cone(), 0),)),)
    )
    turned = tile_scene({"medium": fine}).sceneries["medium"].instances
    ahead = standing + 5.0 * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(3)])
    along = to_enu(ORIGIN, ahead) - to_enu(ORIGIN, standing)
    off = np.arctan2(along[:, 1], along[:, 0]) - turned.yaw_rad
    assert np.abs((off + np.pi) % (2 * np.pi) - np.pi).max() < 1e-5


def test_large_ground_is_cut_so_that_it_follows_the_earth():
    cells = cut_cells([Fixed("ground", square(3000.0), 0, (-1500.0, -1500.0, 0.0))], ORIGIN)
    area, beside = 0.0, 0.0
    for cell in cells:
        assert not cell.buildings
        for piece in cell.ground:
            corners = piece.mesh.xyz_m.astype(np.float64)[piece.mesh.triangle] + piece.centre_m
            edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
            assert edges.max() <= EDGE_MAX_M * 1.001
            area += (
                0.5
                * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
            )
            middle = corners.mean(axis=1)
            beside = max(beside, np.abs(middle[:, 2] + (middle[:, :2] ** 2).sum(axis=1) / (2 * 6.385e6)).max())
    assert area == pytest.approx(3000.0**2, rel=1e-3)
    assert beside < 5e-3
    assert len({(cell.x, cell.y) for cell in cells}) == len(cells) >= 36


def test_roofs_are_buildings_however_flat():
    pieces = [Fixed("roof", square(9.0, z=8.0), 0), Fixed("raised", square(9.0), 0, (0.0, 0.0, 5.0))]
    cells = cut_cells([*pieces, Fixed("lawn", square(9.0), 1)], ORIGIN)
    assert [(len(cell.ground), len(cell.buildings)) for cell in cells] == [(1, 1)]
    assert len(cells[0].buildings[0].mesh.triangle) == 4
