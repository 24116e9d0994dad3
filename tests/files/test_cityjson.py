import copy
import json
import os
from dataclasses import replace
from pathlib import Path

import jsonschema_rs
import numpy as np
import pytest
import shapely
from pyproj import CRS

from tests.reference.gltf_scenes import MODELS, cone, scene
from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.scenery import Model, Origin, Part, Property
from urbanforest_cli.files import cityjson, cityjson_text
from urbanforest_cli.files.cityjson import epsg_code, write_cityjson
from urbanforest_cli.files.cityjson_reader import read_plants, read_provenance

SCHEMA = Path(__file__).parents[1] / "reference" / "cityjson.schema.json"
HOUSES = {
    "footprints": np.array(
        [
            shapely.box(0, 0, 10, 5),
            shapely.Polygon(
                [(20, 0), (30, 0), (30, 10), (20, 10)],
                [[(22, 2), (24, 2), (24, 4), (22, 4)], [(26, 6), (26.0001, 6), (26, 6.0001)]],
            ),
            shapely.MultiPolygon([shapely.box(10, 0, 15, 5), shapely.box(40, 40, 50, 50)]),
            shapely.Polygon(),
            shapely.box(0, 0, 0.0001, 5),
        ],
        dtype=object,
    ),
    "building_height_m": np.array([5.0, 8.25, 3.0, 4.0, 4.0]),
    "building_id": np.array(["a", "a", "日本", "empty", "thin"], dtype=object),
}
NAMES = ["forest.city.json", "forest.city.jsonl"]
SPECK = Model("speck", (Part(cone(0.0004, 0.0002, lean=(0.0, 0.0)), 1),))  # its corners are one, in millimetres
OWN_CRS = CRS.from_proj4("+proj=tmerc +lat_0=50.1 +lon_0=14.37 +datum=WGS84 +units=m")


def written(path, content=None, **options):
    content = scene(30, points=4) if content is None else content
    write_cityjson(path, content, **{"title": "Köln", **HOUSES, **options})
    return content


def loaded(path):
    return json.loads(path.read_text(encoding="utf-8"))


def world(template, instance, document):
    """Corners of a plant by the standard: template, matrix, reference point, transform."""
    corners = np.array(document["geometry-templates"]["vertices-templates"])
    faces = np.array(document["geometry-templates"]["templates"][template]["boundaries"]).reshape(-1, 3)
    matrix = np.array(instance["transformationMatrix"]).reshape(4, 4)
    moved = np.column_stack([corners[faces.ravel()], np.ones(faces.size)]) @ matrix.T
    place = np.array(document["vertices"][instance["boundaries"][0]]) * document["transform"]["scale"]
    return (moved[:, :3] + place + document["transform"]["translate"]).reshape(-1, 3, 3)


def volume(triangles):
    centre = triangles.reshape(-1, 3).mean(axis=0)
    a, b, c = np.moveaxis(triangles - centre, 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("name", NAMES)
def test_plants_come_back_where_they_stand_to_a_millimetre(tmp_path, name):
    content = written(tmp_path / name)
    found = read_plants(tmp_path / name)
    place = [content.origin.easting_m, content.origin.northing_m, content.origin.height_m]
    expected = np.concatenate([content.instances.xyz_m, content.points.xyz_m]) + place
    assert found.plant_id.tolist() == content.properties["plant_id"].values.tolist()
    assert np.abs(found.xyz_m - expected).max() <= 0.00051
    assert np.abs(found.height_m - content.properties["height_m"].values).max() <= 0.00051
    assert found.crs.to_epsg() == 32631
    assert read_provenance(tmp_path / name) == {"stage": "export", "seed": "7"}


def scenes():
    yield from (scene(30, points=4), scene(5, scaled=False), scene(0), scene(0, points=3))
    yield from (scene(9, models=(MODELS[1], SPECK)), scene(3, models=(SPECK,)))
    yield replace(scene(30), origin=Origin(OWN_CRS, 10.0, 20.0))


def mistaken(document):
    """Copies of a document, each with a mistake."""
    for spoil in (
        lambda document, plant, geometry: geometry["transformationMatrix"].pop(),
        lambda document, plant, geometry: geometry.pop("transformationMatrix"),
        lambda document, plant, geometry: geometry["transformationMatrix"].__setitem__(0, "1.0"),
        lambda document, plant, geometry: plant.update(type="SolitaryVegetation"),
        lambda document, plant, geometry: document["geometry-templates"]["templates"][0].update(lod=2),
    ):
        broken = copy.deepcopy(document)
        plant = next(iter(broken["CityObjects"].values()))
        spoil(broken, plant, plant["geometry"][0])
        yield broken


def assert_all_are_valid(check, folder):
    for number, content in enumerate(scenes()):
        path = folder / f"{number}.city.json"
        written(path, content)
        check.validate(loaded(path))
    assert [check.is_valid(broken) for broken in mistaken(loaded(folder / "0.city.json"))] == [False] * 5


def test_every_file_is_what_the_standard_asks_for(tmp_path):
    check = jsonschema_rs.validator_for(loaded(SCHEMA))
    assert_all_are_valid(check, tmp_path)
    broken = loaded(tmp_path / "0.city.json")
    broken["metadata"]["urbanforest"] = broken.pop("urbanforest")  # 2.0.0 has no names but its own there
    assert not check.is_valid(broken)


def test_the_official_schema_passes_where_it_is_at_hand(tmp_path):
    if "URBANFOREST_CITYJSON_SCHEMA" not in os.environ:
        pytest.skip("URBANFOREST_CITYJSON_SCHEMA is not set: it names cityjson.min.schema.json of version 2.0")
    schema = loaded(Path(os.environ["URBANFOREST_CITYJSON_SCHEMA"]))
    assert_all_are_valid(jsonschema_rs.validator_for(schema), tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_a_plant_smaller_than_a_millimetre_is_a_point_where_it_stands(tmp_path, name):
    content = written(tmp_path / name, scene(6, models=(SPECK,)))
    lines = (tmp_path / name).read_text(encoding="utf-8").splitlines()
    shapes = json.loads(lines[0] if name.endswith("l") else "".join(lines))["geometry-templates"]
    assert {template["type"] for template in shapes["templates"]} == {"MultiPoint"}
    assert all(shapes["vertices-templates"][template["boundaries"][0]] == [0, 0, 0] for template in shapes["templates"])
    place = [content.origin.easting_m, content.origin.northing_m, content.origin.height_m]
    assert np.abs(read_plants(tmp_path / name).xyz_m - content.instances.xyz_m - place).max() <= 0.00051


def test_another_program_reads_both_forms_and_finds_everything(tmp_path):
    import cityjson_lib

    for name in NAMES:
        content = written(tmp_path / name)
    whole = cityjson_lib.CityModel.parse_document_bytes((tmp_path / NAMES[0]).read_bytes()).summary()
    stream = cityjson_lib.merge_feature_stream_bytes((tmp_path / NAMES[1]).read_bytes()).summary()
    kinds = len(set(zip(content.instances.model.tolist(), content.instances.mirror.tolist(), strict=True)))
    for found in (whole, stream):
        assert found.cityobject_count == 34 + 3
        assert found.geometry_template_count == kinds
        assert found.material_count == len(content.materials)


def test_templates_matrices_and_places_give_the_corners_of_the_scene(tmp_path):
    content = written(tmp_path / "forest.city.json")
    document = loaded(tmp_path / "forest.city.json")
    some = content.instances
    for row in range(len(some)):
        key = content.properties["plant_id"].values[row]
        instance = document["CityObjects"][key]["geometry"][0]
        found = world(instance["template"], instance, document)
        corners = np.concatenate(
            [part.mesh.xyz_m[part.mesh.triangle] for part in content.models[some.model[row]].parts]
        )
        x, y, z = np.moveaxis(corners.astype(float) * some.scale[row], 2, 0)
        y = -y if some.mirror[row] else y
        c, s = np.cos(some.yaw_rad[row]), np.sin(some.yaw_rad[row])
        expected = np.stack([c * x - s * y, s * x + c * y, z], axis=2) + some.xyz_m[row]
        expected += [content.origin.easting_m, content.origin.northing_m, content.origin.height_m]
        # a mirrored template is turned round: compare the corners of each face as sets, by their mean and spread
        assert np.abs(found.mean(axis=1) - expected.mean(axis=1)).max() < 0.003
        assert np.abs(np.ptp(found, axis=1) - np.ptp(expected, axis=1)).max() < 0.004


def test_no_plant_shows_its_inside_even_when_mirrored(tmp_path):
    content = written(tmp_path / "forest.city.json", scene(40, models=(MODELS[1],)))
    document = loaded(tmp_path / "forest.city.json")
    assert content.instances.mirror.any()
    assert len(document["geometry-templates"]["templates"]) == 2
    for key in content.properties["plant_id"].values:
        instance = document["CityObjects"][key]["geometry"][0]
        assert volume(world(instance["template"], instance, document)) > 0


def test_each_corner_of_a_template_is_stored_once_and_used(tmp_path):
    written(tmp_path / "forest.city.json")
    shapes = loaded(tmp_path / "forest.city.json")["geometry-templates"]
    used = {corner for template in shapes["templates"] for face in template["boundaries"] for corner in face[0]}
    assert used == set(range(len(shapes["vertices-templates"])))
    for template in shapes["templates"]:
        own = sorted({corner for face in template["boundaries"] for corner in face[0]})
        corners = [tuple(shapes["vertices-templates"][corner]) for corner in own]
        assert len(set(corners)) == len(corners)


def test_attributes_bear_the_names_of_every_output_and_those_of_citygml(tmp_path):
    content = written(tmp_path / "forest.city.json")
    first = loaded(tmp_path / "forest.city.json")["CityObjects"][content.properties["plant_id"].values[0]]
    found = first["attributes"]
    assert first["type"] == "SolitaryVegetationObject"
    assert found["height"] == found["height_m"]
    assert found["trunkDiameter"] == found["dbh_m"]
    assert found["crownDiameter"] == pytest.approx(2 * found["crown_radius_m"], abs=0.0011)
    assert found["species"] in ("Tilia", "Quercus", "Acer")
    assert set(content.properties) - {"plant_id"} <= set(found)


def faces_of(building, document):
    geometry = building["geometry"][0]
    surfaces = geometry["boundaries"][0] if geometry["type"] == "Solid" else geometry["boundaries"]
    corners = np.array(document["vertices"]) * 0.001
    return [[corners[ring] for ring in surface] for surface in surfaces]


def signed(rings):
    """Area times normal of a face, holes taken off."""
    return sum(np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0) / 2 for ring in rings)


def test_buildings_are_closed_blocks_that_face_outward(tmp_path):
    written(tmp_path / "forest.city.json")
    document = loaded(tmp_path / "forest.city.json")
    houses = [item for item in document["CityObjects"].values() if item["type"] == "Building"]
    assert [house["attributes"]["building_id"] for house in houses] == ["a", "a", "日本"]
    assert [house["geometry"][0]["type"] for house in houses] == ["Solid", "Solid", "MultiSurface"]
    for house, area, height in zip(houses, [50.0, 96.0, 125.0], [5.0, 8.25, 3.0], strict=True):
        faces = faces_of(house, document)
        assert np.abs(sum(signed(rings) for rings in faces)).max() < 1e-6  # closed
        assert sum(np.dot(rings[0][0], signed(rings)) for rings in faces) / 3 == pytest.approx(area * height)
        values = house["geometry"][0]["semantics"]["values"]
        values = values[0] if house["geometry"][0]["type"] == "Solid" else values
        assert len(values) == len(faces)
        for kind, rings in zip(values, faces, strict=True):
            up = signed(rings)[2]
            assert (up < 0, up > 0, up == 0)[kind]


def test_buildings_share_the_corners_where_they_touch(tmp_path):
    written(tmp_path / "forest.city.json")
    vertices = [tuple(vertex) for vertex in loaded(tmp_path / "forest.city.json")["vertices"]]
    assert len(set(vertices)) == len(vertices)


def test_the_extent_holds_every_corner(tmp_path):
    content = written(tmp_path / "forest.city.json", scene(30))
    document = loaded(tmp_path / "forest.city.json")
    extent = np.array(document["metadata"]["geographicalExtent"])
    corners = []
    for key in content.properties["plant_id"].values:
        instance = document["CityObjects"][key]["geometry"][0]
        corners.append(world(instance["template"], instance, document).reshape(-1, 3))
    every = np.concatenate(corners)
    assert (every.min(axis=0) >= extent[:3] - 0.002).all()
    assert (every.max(axis=0) <= extent[3:] + 0.002).all()
    assert (extent[3:] - extent[:3] < 650).all()


def test_a_crs_without_a_code_has_no_reference_system_but_its_wkt(tmp_path):
    content = replace(scene(3), origin=Origin(OWN_CRS, 10.0, 20.0))
    written(tmp_path / "forest.city.json", content)
    metadata = loaded(tmp_path / "forest.city.json")["metadata"]
    assert "referenceSystem" not in metadata
    assert read_plants(tmp_path / "forest.city.json").crs == OWN_CRS


def test_a_code_is_given_only_to_a_crs_that_is_the_very_same():
    assert epsg_code(CRS.from_epsg(2154)) == 2154
    assert epsg_code(CRS.from_wkt(CRS.from_epsg(32633).to_wkt())) == 32633
    assert epsg_code(CRS.from_proj4("+proj=utm +zone=33 +ellps=bessel +units=m")) is None


@pytest.mark.parametrize("name", NAMES)
def test_any_text_comes_back_exactly(tmp_path, name):
    nasty = [
        'quo"te',
        "back\\slash",
        "new\nline",
        "%s%d%%",
        "日本😀",
        "@",
        "\u2028",
        "</script>",
        '{"type":"Building"',
        "",
    ]
    content = scene(len(nasty))
    ids = np.array(nasty, dtype=object)
    properties = {**content.properties, "plant_id": Property(ids, "text", ""), "lot_id": Property(ids, "text", "")}
    written(tmp_path / name, replace(content, properties=properties))
    assert read_plants(tmp_path / name).plant_id.tolist() == nasty
    if name.endswith("json"):
        assert [
            item["attributes"]["lot_id"] for item in list(loaded(tmp_path / name)["CityObjects"].values())[:10]
        ] == nasty


@pytest.mark.parametrize("name", NAMES)
def test_chunks_make_no_difference_and_equal_scenes_are_equal_bytes(tmp_path, monkeypatch, name):
    (tmp_path / "cut").mkdir()
    written(tmp_path / name)
    monkeypatch.setattr(cityjson_text, "CHUNK_ROWS", 7)
    monkeypatch.setattr(cityjson, "READ_BYTES", 50)
    written(tmp_path / "cut" / name)
    assert (tmp_path / name).read_bytes() == (tmp_path / "cut" / name).read_bytes()


def test_plants_that_share_an_id_are_refused(tmp_path):
    content = scene(3)
    ids = np.array(["a", "b", "a"], dtype=object)
    with pytest.raises(OutputError, match="share a plant_id"):
        written(
            tmp_path / "f.city.json",
            replace(content, properties={**content.properties, "plant_id": Property(ids, "text", "")}),
        )
    assert list(tmp_path.iterdir()) == []


def test_a_file_written_anew_by_another_program_is_read_as_well(tmp_path):
    path = tmp_path / "forest.city.json"
    written(path)
    before = read_plants(path)
    for indent in (None, 2):
        path.write_text(json.dumps(loaded(path), indent=indent), encoding="utf-8")
        after = read_plants(path)
        assert (after.xyz_m == before.xyz_m).all()
        assert read_provenance(path) == {"stage": "export", "seed": "7"}


@pytest.mark.parametrize("name", NAMES)
def test_a_file_torn_anywhere_is_refused_in_words(tmp_path, name):
    path = tmp_path / name
    written(path, scene(6, points=2))
    whole = path.read_bytes()
    for cut in [0, 1, 20, *range(100, len(whole), 211), len(whole) - 1]:
        if name.endswith("l") and whole[cut - 1 : cut] == b"\n":
            continue  # a sequence has no end of its own
        path.write_bytes(whole[:cut])
        with pytest.raises(InputError, match="not a CityJSON of urbanforest"):
            read_plants(path)


def spoil(document, number):
    first = next(iter(document["CityObjects"].values()))
    geometry = first["geometry"][0]
    steps = [
        lambda: geometry.update(template=99),
        lambda: geometry.update(boundaries=[10**6]),
        lambda: geometry.update(boundaries=[-1]),
        lambda: geometry.update(boundaries=[]),
        lambda: geometry.update(boundaries=[True]),
        lambda: geometry.update(transformationMatrix=[1.0]),
        lambda: geometry.update(type="Solid"),
        lambda: first.pop("geometry"),
        lambda: first.pop("type"),
        lambda: first.update(attributes={"height_m": "tall"}),
        lambda: document.pop("transform"),
        lambda: document["transform"].update(scale=[1, 2]),
        lambda: document["transform"].update(translate=[float("nan")] * 3),
        lambda: document.update(metadata={}, urbanforest={}),
        lambda: document["metadata"].update(referenceSystem="https://www.opengis.net/def/crs/EPSG/0/99999999"),
        lambda: document.update(vertices=[[10**400, 0, 0]] * 60),
        lambda: document.update(CityObjects=[1, 2]),
        lambda: document.update(type="Feature"),
    ]
    if number < len(steps):
        steps[number]()
    return number < len(steps)


def test_hostile_files_are_refused_in_words(tmp_path):
    path = tmp_path / "forest.city.json"
    written(path)
    document, number = loaded(path), 0
    while spoil(spoiled := copy.deepcopy(document), number):
        path.write_text(json.dumps(spoiled), encoding="utf-8")
        with pytest.raises(InputError, match="not a CityJSON of urbanforest"):
            read_plants(path)
        number += 1
    for text in (b"", b"[" * 200_000, b"\xff\xfe", b"12", b'{"type":"CityJSON",\n', b"null\n"):
        path.write_bytes(text)
        with pytest.raises(InputError):
            read_plants(path)
        if not text.startswith(b"{"):
            with pytest.raises(InputError):
                read_provenance(path)
    with pytest.raises(InputError):
        read_plants(tmp_path / "none.city.json")


def test_a_feature_of_a_sequence_has_its_own_vertices(tmp_path):
    path = tmp_path / "forest.city.jsonl"
    written(path, scene(6))
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([lines[0], lines[1].replace('"boundaries":[0]', '"boundaries":[1]'), *lines[2:]]))
    with pytest.raises(InputError, match="vertex"):
        read_plants(path)


def test_colours_of_materials_are_those_that_their_pictures_show(tmp_path):
    written(tmp_path / "forest.city.json")
    colours = {
        item["name"]: item["diffuseColor"] for item in loaded(tmp_path / "forest.city.json")["appearance"]["materials"]
    }
    assert colours["leaf"] == pytest.approx([90 / 255, 140 / 255, 60 / 255], abs=0.002)
    assert colours["bark"][0] < 120 / 255
