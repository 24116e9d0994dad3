"""CesiumJS and 3d-tiles-renderer open what `export --to 3dtiles` writes."""

import numpy as np
import pytest
from pyproj import CRS
from scipy.spatial import KDTree

from tests.readers.conftest import assert_shows_plants, held_against, pixels_of
from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.files.geopackage import read_layer

pytestmark = pytest.mark.readers

EARTH_CENTRED = CRS.from_epsg(4978)
SHOWN_HEIGHT_M = 5.0
FINEST_ERROR_PX = 0.01
HEIGHT_ROUNDING_M = 0.001
ORANGE_SHARE = 0.001


@pytest.fixture(scope="module")
def alone(standing):
    """Row of the plant furthest from all others among those tall enough to be hit."""
    apart = KDTree(standing.xy_m).query(standing.xy_m, k=2)[0][:, 1]
    return int(np.argmax(np.where(standing.height_m > SHOWN_HEIGHT_M, apart, 0)))


def test_a_tree_picked_in_cesium_tells_its_id_and_height(browser, forest, standing, alone, tmp_path):
    longitude, latitude = reproject_xy(standing.xy_m[[alone]], standing.crs, CRS.from_epsg(4326))[0].tolist()
    answer = browser(
        "open_tiles_cesium.mjs", folder=str(forest), tileset="tiles/tileset.json", longitude=longitude,
        latitude=latitude, height=float(standing.height_m[alone]), picture=str(tmp_path / "cesium.png"),
    )  # fmt: skip
    assert answer["failures"] == []
    tree = read_layer(forest / "register.gpkg", "trees").set_index("plant_id")
    wanted = standing.plant_id[alone]
    picked = [found for found in answer["picks"] if found["plant_id"] == wanted]
    assert picked, f"{wanted} was not among {answer['picks']}"
    for found in answer["picks"]:
        row = tree.loc[found["plant_id"]]
        assert found["height_m"] == pytest.approx(row["height_m"], abs=HEIGHT_ROUNDING_M)
    assert picked[0]["lot_id"] == tree.loc[wanted, "lot_id"]
    red, green, blue = pixels_of(tmp_path / "cesium.png").T
    assert np.mean((red > green + 15) & (green > blue)) > ORANGE_SHARE  # a style by height paints the tree picked


def test_all_leaves_in_3d_tiles_renderer_hold_every_plant_once_in_its_place(browser, forest, standing, tmp_path):
    answer = browser(
        "open_tiles.mjs", folder=str(forest), tileset="tiles/tileset.json", error_px=FINEST_ERROR_PX, distance=1.0,
    )  # fmt: skip
    assert answer["failures"] == []
    ids = [plant for plant, *_ in answer["plants"]]
    result = held_against(standing, ids, [place for _, *place in answer["plants"]], EARTH_CENTRED)
    assert result.faults == ()
    assert result.plants == len(standing)


def test_from_afar_fewer_tiles_are_shown_and_they_show_plants(browser, forest, tmp_path):
    answer = browser(
        "open_tiles.mjs", folder=str(forest), tileset="tiles/tileset.json", error_px=16, distance=1.2,
        picture=str(tmp_path / "tiles.png"),
    )  # fmt: skip
    assert answer["failures"] == []
    assert answer["shown"] > 0
    assert_shows_plants(tmp_path / "tiles.png")
