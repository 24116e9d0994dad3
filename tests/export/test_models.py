from dataclasses import replace

import numpy as np
import pytest

from tests.reference.planted import planted_city
from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.core.scenery import Material, Mesh
from urbanforest_cli.export.scene import models
from urbanforest_cli.export.scene.models import build_scenery
from urbanforest_cli.export.scene.pieces import Piece
from urbanforest_cli.export.scene.prototypes import choose_prototypes
from urbanforest_cli.files.gltf import write_glb
from urbanforest_cli.files.gltf_reader import open_gltf, plants_of


@pytest.fixture(scope="module")
def city():
    return planted_city(12, 4)


def scenery(city, detail="low", season="summer", count_max=100, pieces=()):
    chosen = choose_prototypes(city.plants, city.skeletons_of, city.season_end, count_max=count_max)
    return build_scenery(city, chosen, detail=detail, season=season, pieces=pieces, provenance={"seed": 5})


def test_every_plant_stands_once_in_the_register_s_order(city):
    scene = scenery(city)
    assert len(scene.instances) == len(city.plants)
    assert scene.properties["plant_id"].values.tolist() == city.plants.plant_id.tolist()
    there = scene.instances.xyz_m[:, :2] + [scene.origin.easting_m, scene.origin.northing_m]
    assert np.abs(there - city.plants.xy_m).max() < 1e-6
    assert len(scene.models) == len({*zip(city.plants.species, city.plants.skeleton_id, strict=True)})


def test_a_plant_is_made_of_its_own_species_bark_and_leaves(city):
    scene = scenery(city)
    for plant, number in enumerate(scene.instances.model):
        own = city.species[city.plants.species[plant]].id
        names = {scene.materials[part.material].name for part in scene.models[number].parts}
        assert names == {f"bark of {own}", f"leaves of {own}"}


def test_details_have_ever_more_triangles(city):
    counts = [
        sum(len(part.mesh.triangle) for model in scenery(city, detail).models for part in model.parts)
        for detail in ("billboard", "low", "medium", "high", "full")
    ]
    assert counts == sorted(counts)
    assert counts[0] == 6 * len(scenery(city, "billboard").models)


def test_points_are_no_instances_and_hang_in_the_crown(city):
    scene = scenery(city, "point")
    assert len(scene.instances) == len(scene.models) == 0
    assert len(scene.points) == len(city.plants)
    height = scene.points.xyz_m[:, 2] + city.origin.height_m
    assert (height > city.plants.crown_base_m).all()
    assert (height < city.plants.height_m).all()


def test_in_winter_nothing_bears_leaves(city):
    for model in scenery(city, season="winter").models:
        assert len(model.parts) == 1


def test_properties_are_those_of_the_plants(city):
    found = scenery(city).properties
    species = [found["species"].names[place] for place in found["species"].values]
    assert species == [city.species[row].id for row in city.plants.species]
    habit = [found["habit"].names[place] for place in found["habit"].values]
    assert habit == [city.species[row].habit for row in city.plants.species]
    assert found["height_m"].values == pytest.approx(city.plants.height_m)


@pytest.mark.parametrize(("count", "kept"), [(256, np.uint8), (257, np.uint16), (300, np.uint16)])
def test_any_number_of_species_goes_through_a_file(tmp_path, count, kept):
    city = planted_city(count + 40, 4)
    species = tuple(replace(city.species[0], id=f"species_{number}") for number in range(count))
    grown = np.random.default_rng(3).permutation(len(city.plants)) % count
    city = replace(city, species=species, plants=replace(city.plants, species=grown))
    scene = scenery(city, "point", count_max=2 * count)
    assert scene.properties["species"].values.dtype == kept
    write_glb(tmp_path / "forest.glb", scene)
    found = plants_of(open_gltf(tmp_path / "forest.glb")).columns
    told = dict(zip(found["plant_id"], found["species"], strict=True))
    assert told == {plant: species[row].id for plant, row in zip(city.plants.plant_id, grown, strict=True)}


def test_surroundings_share_materials_that_follow_those_of_plants(city):
    flat = Mesh(np.zeros((3, 3), np.float32), np.ones((3, 3), np.float32), np.zeros((3, 2), np.float32),
                np.zeros((3, 3), np.uint8), np.arange(3, dtype=np.uint32)[None])  # fmt: skip
    wall, road = Material("wall"), Material("road")
    pieces = [Piece("a", flat, wall, (0, 0, 0)), Piece("b", flat, road, (1, 0, 0)), Piece("c", flat, wall, (2, 0, 0))]
    scene = scenery(city, pieces=pieces)
    assert [scene.materials[item.material].name for item in scene.fixed] == ["wall", "road", "wall"]
    assert len(scene.materials) == len(scenery(city).materials) + 2


def test_shapes_that_no_memory_holds_are_refused(city, monkeypatch):
    monkeypatch.setattr(models, "TRIANGLES_MAX", 50)
    with pytest.raises(LimitError, match="triangles"):
        scenery(city, "full")
