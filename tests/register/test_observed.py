import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS
from shapely.geometry import MultiPoint, Point, box

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.schema import check_layer
from urbanforest_cli.register.observed import first_at_place, observed_plants_of, unit_of

UTM = CRS.from_epsg(32633)
LOTS = [box(0, 0, 10, 10), box(10, 0, 30, 10), box(12, 2, 16, 6), None, box(0, -4, 30, 0)]
IDS = np.array(["a", "b", "sketch:1", "broken", "road:7"], dtype=object)
ORIGINS = np.array(["register", "register", "sketch", "register", "road"], dtype=object)


def shapes(items):
    column = np.empty(len(items), dtype=object)
    column[:] = items
    return column


def observed(points, crs=UTM, **columns):
    notices = Notices()
    frame = gpd.GeoDataFrame(columns, geometry=shapes(points), crs=crs)
    found = observed_plants_of(
        frame, IDS, shapes(LOTS), ORIGINS,
        project=lambda frame: np.array(frame.geometry.to_crs(UTM), dtype=object), working=UTM, notices=notices,
    )  # fmt: skip
    check_layer(found, "observed")
    return found, notices


def test_a_plant_belongs_to_the_sketch_over_a_lot_and_to_the_lot_before_its_road():
    found, notices = observed([Point(5, 5), Point(20, 5), Point(14, 4), Point(15, -2), Point(5, 0)])
    assert found["lot_id"].tolist() == ["a", "b", "sketch:1", "road:7", "a"]
    assert "W_OBSERVED_OUTSIDE" not in notices


def test_of_two_lots_on_one_ground_the_smaller_has_the_plant():
    lots = shapes([box(0, 0, 30, 30), box(0, 0, 10, 10)])
    points = shapes([Point(5, 5), Point(20, 20), Point(50, 50)])
    assert unit_of(points, lots, np.array(["register"] * 2, dtype=object)).tolist() == [1, 0, -1]


def test_plants_outside_all_lots_and_twins_are_left_out_and_counted():
    found, notices = observed([Point(5, 5), Point(5, 5.004), Point(90, 5), None, Point(5, 5.3)])
    assert found["observed_id"].tolist() == ["0", "4"]
    assert notices.count("W_OBSERVED_OUTSIDE") == 1
    assert notices.count("W_OBSERVED_TWINS") == 1
    assert notices.count("W_OBSERVED_EMPTY") == 1


@pytest.mark.parametrize(
    ("column", "radius_m"),
    [("crown_diameter_m", 2.0), ("crownDiameter", 2.0), ("Crown_Radius_M", 4.0), ("diameter_crown", 2.0)],
)
def test_crowns_are_known_by_the_names_that_inventories_give_them(column, radius_m):
    found, notices = observed([Point(5, 5), Point(7, 5)], **{column: [4.0, np.nan]})
    assert found["crown_radius_m"].tolist()[:1] == [radius_m]
    assert np.isnan(found["crown_radius_m"].iloc[1])
    assert notices.count("W_OBSERVED_CROWN") == 1


def test_a_radius_is_believed_before_a_diameter():
    found, _ = observed([Point(5, 5), Point(7, 5)], crown_diameter_m=[4.0, 6.0], crown_radius_m=[1.5, None])
    assert found["crown_radius_m"].tolist() == [1.5, 3.0]


def test_sizes_that_no_plant_has_are_unknown_and_counted():
    found, notices = observed([Point(x, 5) for x in (1, 2, 3, 4, 5)], height=[-1.0, 0.0, 500.0, np.inf, 12.0])
    assert np.isnan(found["height_m"].iloc[:4]).all()
    assert found["height_m"].iloc[4] == 12.0
    assert notices.count("W_OBSERVED_SIZE") == 4


def test_sizes_written_as_text_are_read_and_words_are_not():
    found, notices = observed([Point(5, 5), Point(7, 5)], height_m=["7.5", "tall"])
    assert found["height_m"].iloc[0] == 7.5
    assert notices.count("W_OBSERVED_SIZE") == 1


def test_species_become_identifiers():
    found, _ = observed([Point(x, 5) for x in (1, 2, 3)], species=["Tilia cordata ", None, "acer_platanoides"])
    assert found["species"].dropna().tolist() == ["tilia_cordata", "acer_platanoides"]
    assert found["species"].isna().tolist() == [False, True, False]


def test_ids_are_the_plants_own_where_each_has_one():
    points = [Point(1, 5), Point(2, 5)]
    assert observed(points, id=[7.0, 9.0])[0]["observed_id"].tolist() == ["7", "9"]
    assert observed(points, id=[7, 7])[0]["observed_id"].tolist() == ["0", "1"]
    assert observed(points, tree_id=["x", None])[0]["observed_id"].tolist() == ["0", "1"]
    mixed = pd.Series([1, "1"], dtype=object)
    assert observed(points, id=mixed)[0]["observed_id"].tolist() == ["0", "1"]


def test_points_of_one_row_are_plants_of_their_own():
    found, _ = observed([MultiPoint([(1, 1), (2, 2)]), Point(3, 3)])
    assert found["observed_id"].tolist() == ["0", "0.1", "1"]
    assert shapely.get_coordinates(found.geometry.to_numpy()).tolist() == [[1, 1], [2, 2], [3, 3]]


def test_plants_in_degrees_come_out_in_metres():
    place = gpd.GeoSeries([Point(500_005, 5)], crs=UTM)
    notices = Notices()
    frame = gpd.GeoDataFrame(geometry=place.to_crs(4326))
    found = observed_plants_of(
        frame, IDS[:1], shapes([box(500_000, 0, 500_010, 10)]), ORIGINS[:1],
        project=lambda frame: np.array(frame.geometry.to_crs(UTM), dtype=object), working=UTM, notices=notices,
    )  # fmt: skip
    assert found.geometry.iloc[0].distance(place.iloc[0]) < 1e-6


def test_a_city_without_lots_or_plants_has_none():
    assert len(observed([])[0]) == 0
    assert unit_of(shapes([Point(0, 0)]), shapes([]), shapes([])).tolist() == [-1]


def test_the_first_of_each_place_counts():
    assert first_at_place(np.array([[0.0, 0], [1, 1], [0, 0.001]])).tolist() == [True, True, False]
