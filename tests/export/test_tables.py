import numpy as np

from tests.reference.planted import planted_city
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.zones import ZONES
from urbanforest_cli.export.scene.tables import LAND_USES, WGS84, inventory_table, plant_table, species_categories


def test_plants_stand_where_they_stood_in_the_register_even_in_feet():
    for crs in ("EPSG:32633", "EPSG:4326", "EPSG:2263"):
        city = planted_city(register_crs=crs)
        frame = plant_table(city)
        assert frame.crs.to_string() == crs
        xy = np.column_stack([frame.geometry.x, frame.geometry.y])
        if crs != "EPSG:2263":  # that one lies on another continent, and is only good for its units
            assert np.abs(reproject_xy(xy, city.register_crs, city.crs) - city.plants.xy_m).max() < 1e-3
        assert np.isfinite(xy).all()


def test_the_table_has_the_columns_of_every_output_in_the_registers_order():
    city = planted_city()
    frame = plant_table(city)
    shared = [
        "plant_id",
        "lot_id",
        "species",
        "habit",
        "age_years",
        "height_m",
        "crown_radius_m",
        "crown_base_m",
        "dbh_m",
    ]
    assert set(shared) <= set(frame.columns)
    assert frame["plant_id"].tolist() == city.plants.plant_id.tolist()
    assert frame["species"].tolist() == [city.species[row].id for row in city.plants.species]
    assert np.abs(frame["height_m"] - city.plants.height_m).max() <= 0.00051
    assert frame["yaw_deg"].between(0, 360).all()
    assert set(frame["mirror"]) == {0, 1}


def test_the_inventory_gives_diameters_in_centimetres_and_degrees_on_wgs84():
    city = planted_city()
    frame = inventory_table(city)
    assert frame["ID"].tolist() == list(range(1, 13))
    assert np.allclose(frame["DBH 1 (cm)"], 100 * city.plants.dbh_m)
    assert np.allclose(frame["Crown Width (m)"], 2 * city.plants.crown_radius_m)
    back = reproject_xy(frame[["Longitude", "Latitude"]].to_numpy(), WGS84, city.crs)
    assert np.abs(back - city.plants.xy_m).max() < 1e-3
    assert "Land Use" not in frame.columns


def test_land_use_comes_from_the_zone_of_the_lot():
    city = planted_city()
    zones = {"lot 0": "residential", "lot 1": "industrial", "lot 2": "a zone of their own"}
    frame = inventory_table(city, zones=zones)
    expected = ["Residential"] * 3 + ["Commercial/Industrial"] * 3 + ["Other"] * 6
    assert frame["Land Use"].tolist() == expected
    assert set(LAND_USES) == set(ZONES)


def test_every_species_has_a_label_and_a_colour():
    city = planted_city()
    categories = species_categories(city)
    assert [item[0] for item in categories] == [item.id for item in city.species]
    assert all("(" in label and colour.startswith("#") for _, label, colour in categories)
