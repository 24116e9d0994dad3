"""Small planted cities for tests of exports: crooked plants with a few branches, placed every way."""

import numpy as np
from pyproj import CRS

from urbanforest_cli.core.config import Species as SpeciesConfig
from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.skeleton import Skeletons, measure, select
from urbanforest_cli.export.scene.city import City, Plants
from urbanforest_cli.files.species import load_catalogue

SEASONS = 9


def crooked(count, rng):
    """Skeletons of a trunk and three branches, some twigs of which were lost."""
    parts = []
    for number in range(count):
        trunk = np.cumsum(rng.normal([0.05, 0.02, 0.8], [0.1, 0.1, 0.1], (6, 3)), axis=0)
        xyz, parent, order = [np.zeros(3), *trunk], [-1, *range(6)], [0] * 7
        for base in (3, 4, 5):
            way = rng.normal([0.6, 0.0, 0.3], 0.4, 3)
            for step in range(3):
                parent.append(base if step == 0 else len(xyz) - 1)
                xyz.append(xyz[parent[-1]] + way / 2)
                order.append(1)
        birth = np.array([0, 1, 2, 3, 4, 5, 6, *[6, 7, 8] * 3])
        death = np.zeros(len(xyz), np.uint8)
        if number % 2:
            death[-1] = SEASONS
        parts.append((np.array(xyz), parent, order, birth, death))
    first = np.concatenate([[0], np.cumsum([len(part[1]) for part in parts])])
    return Skeletons(
        skeleton_id=np.arange(count) * 3 + 5,
        first=first.astype(np.int64),
        seasons=np.full(count, SEASONS, np.int32),
        tip_radius_m=np.full(count, 0.004),
        pipe_exponent=np.full(count, 2.3),
        parent=np.concatenate([part[1] for part in parts]).astype(np.int32),
        xyz_m=np.concatenate([part[0] for part in parts]).astype(np.float32),
        order=np.concatenate([part[2] for part in parts]).astype(np.uint8),
        birth_season=np.concatenate([part[3] for part in parts]).astype(np.uint8),
        death_season=np.concatenate([part[4] for part in parts]).astype(np.uint8),
    )


def planted_city(count=12, shapes=4, *, size_m=30.0, register_crs="EPSG:32633", seed=5, scaled=True):
    """A city of plants at random in a square, which share a few shapes."""
    rng = np.random.default_rng(seed)
    skeletons = crooked(shapes, rng)
    species = load_catalogue(SpeciesConfig()).species
    shape = rng.integers(0, shapes, count)
    scale = rng.uniform(0.8, 1.2, count) if scaled else np.ones(count)
    sizes = measure(skeletons)
    origin = Origin(CRS.from_epsg(32633), 459_008.0, 5_548_994.0)
    plants = Plants(
        plant_id=np.array([f"lot {n // 3}-{n}" for n in range(count)], dtype=object),
        lot_id=np.array([f"lot {n // 3}" for n in range(count)], dtype=object),
        species=rng.integers(0, len(species), shapes)[shape],
        xy_m=rng.uniform(0, size_m, (count, 2)) + np.array([origin.easting_m, origin.northing_m]),
        age_years=np.full(count, float(SEASONS)),
        **{name: sizes[name][shape] * scale for name in ("height_m", "crown_radius_m", "crown_base_m", "dbh_m")},
        pruning_factor=np.ones(count),
        skeleton_id=skeletons.skeleton_id[shape],
        yaw_rad=rng.uniform(0, 2 * np.pi, count),
        mirror=rng.random(count) < 0.5,
        scale=scale,
        is_library=np.ones(count, dtype=bool),
    )
    places = {int(name): row for row, name in enumerate(skeletons.skeleton_id)}
    none = np.zeros(0, dtype=object)
    return City(
        name="Testburg", origin=origin, register_crs=CRS.from_user_input(register_crs), plants=plants, species=species,
        skeletons_of=lambda ids: select(skeletons, [places[int(name)] for name in ids]), years_ago=0,
        buildings=none, building_height_m=np.zeros(0), building_id=none, lots=none, lot_colour=none, roads=none,
    )  # fmt: skip
