"""Chooses by itself where a city is seen from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.export.plant_camera import Camera, view_from
from urbanforest_cli.export.plant_scene import FloatArray
from urbanforest_cli.export.scene.city import City
from urbanforest_cli.export.view.light import Weather
from urbanforest_cli.export.view.light_kernel import raise_faces

Sun = tuple[float, float]
TOP_SUN_DEG: Sun = (315.0, 42.0)  # upper left, as maps have it
SUN_SIDE_DEG, SUN_ELEVATION_DEG = 116.0, 36.0  # the sun stands beside the viewer, a little behind
AZIMUTHS_DEG = [22.5 * number for number in range(16)]
FIELD_DEG = 50.0
PITCH_DEG = 17.0
TOP_SHARE = 0.18  # from the upper edge to the far end of the city, as a share of the picture's height
SHIFT_SHARES = (-0.10, 0.35)  # how far the lens may be shifted for that
FOREGROUND_M = 330.0  # width of the city that a large city's foreground shows
SHARP_SHARE, SHARP_AHEAD = 1.5, -0.02  # width of the finest shadows, and their middle, in widths of the foreground
HAZE_SHARE = 4.0  # haze takes 63 % of the light of what is so many times as far as the foreground
PLACES_MAX = 24
CELL_M = 20.0  # of the grid in which the most interesting part is sought
EYE_M, STREET_FIELD_DEG = 1.7, 62.0
STREET_SUN_SIDE_DEG, STREET_SUN_ELEVATION_DEG = 100.0, 42.0
BACK_M = 25.0  # where there are no roads, the viewer stands so far before the trees
SIGHT_M = 75.0  # so far the road goes on straight
TREE_M = 5.0  # lower plants are no trees of an avenue
ROAD_CELL_M, ROAD_HALF_M = 2.0, 1.5
PLACES_TRIED, TURNS, STANDS_TRIED = 4000, 36, 1500
GROVE_M = 60.0  # width of the part with many trees that is looked at where there are no roads
BOX_FIELD_DEG = 36.0  # of the wider side; a narrower lens keeps near and far edges of a box more alike
BOX_PITCHES_DEG = [float(pitch) for pitch in range(16, 51, 2)]
BOX_STEEP_COST = 0.006  # share of the picture that a degree more of pitch must win
BOX_SHARE = 0.97  # of the picture's width or height that a box takes
BOX_DISTANCES = (0.3, 12.0)  # least and most, in the box's diagonals
SUN_AHEAD_DEG = 60.0  # nearer to the sun's azimuth than this the viewer does not look


@dataclass(frozen=True)
class Shot:
    """A camera and the light that suits it."""

    camera: Camera
    weather: Weather
    on_road: bool = True


def aerial(city: City, *, size_px: tuple[int, int], sun: Sun | None, bounds: FloatArray | None = None) -> Shot:
    """Look obliquely down on the part of the city with the most trees between houses.

    Of many places and directions the one is taken whose picture shows the most crowns and houses and the least of what
    lies outside of the city. Its far edge, or the horizon, lies near the upper edge of the picture. A box instead just
    fills the picture.
    """
    if bounds is not None:
        return _over_box(city, bounds, size_px, sun)
    chart = chart_of(city)
    plants = city.local(city.plants.xy_m)[:, :2]
    low, high = _spread(plants)
    width = min(FOREGROUND_M, max(0.7 * float(max(high - low)), 40.0))
    places = chart.best_places(width)
    turns = AZIMUTHS_DEG if sun is None else [(sun[0] + side) % 360.0 for side in (-SUN_SIDE_DEG, SUN_SIDE_DEG)]
    best, shot = -np.inf, None
    for place in places:
        for azimuth in turns:
            camera = _camera_over(place, azimuth, width, plants, size_px)
            score = chart.worth(camera) - 0.02 * float(np.hypot(*(place - (low + high) / 2))) / width
            if score > best:
                best, shot = score, (camera, place, azimuth)
    assert shot is not None  # there is always a place and a direction
    camera, focus, azimuth = shot
    turn = np.radians(azimuth)
    middle = focus + SHARP_AHEAD * width * np.array([np.sin(turn), np.cos(turn)])
    away = float(np.hypot(*(focus - np.array(camera.eye_m[:2]))))
    place_of_sun = sun or _sun_beside(azimuth)
    weather = Weather(*place_of_sun, (float(middle[0]), float(middle[1])), SHARP_SHARE * width, 1.2 * away,
                      HAZE_SHARE * away)  # fmt: skip
    return Shot(camera, weather)


def _over_box(city: City, bounds: FloatArray, size_px: tuple[int, int], sun: Sun | None) -> Shot:
    """Look along a side of a box, from where it fills most of the picture with the most to be seen."""
    chart = chart_of(city)
    plants = city.local(city.plants.xy_m)[:, :2]
    inside = ((plants >= bounds[:2]) & (plants <= bounds[2:])).all(axis=1)
    high_m = float(np.percentile(city.plants.height_m[inside], 90)) if inside.any() else 0.0
    turns = [turn for turn in (0.0, 90.0, 180.0, 270.0)
             if sun is None or abs((turn - sun[0] + 180.0) % 360.0 - 180.0) > SUN_AHEAD_DEG]  # fmt: skip
    best, found = -np.inf, None
    for azimuth in turns:
        for pitch in BOX_PITCHES_DEG:
            camera, share = _camera_on_box(bounds, high_m, azimuth, pitch, size_px)
            score = share - BOX_STEEP_COST * pitch + 0.5 * chart.worth(camera)
            if score > best:
                best, found = score, camera
    assert found is not None  # of four sides two at least lie off the sun
    turn = np.radians(found.azimuth_deg)
    middle = (bounds[:2] + bounds[2:]) / 2
    deep = float(np.abs((bounds[2:] - bounds[:2]) @ np.array([np.sin(turn), np.cos(turn)])))
    away = float(np.hypot(*(middle - np.array(found.eye_m[:2])))) + deep / 2
    sharp = min(1.1 * float(np.hypot(*(bounds[2:] - bounds[:2]))), SHARP_SHARE * FOREGROUND_M)
    place_of_sun = sun or _sun_beside(found.azimuth_deg)
    return Shot(found, Weather(*place_of_sun, (float(middle[0]), float(middle[1])), sharp, 1.2 * away,
                               HAZE_SHARE * away))  # fmt: skip


def _camera_on_box(
    bounds: FloatArray, high_m: float, azimuth: float, pitch: float, size_px: tuple[int, int]
) -> tuple[Camera, float]:  # fmt: skip
    """Return the nearest camera that has a whole box in its picture, and the share that the box takes of it."""
    west, south, east, north = bounds
    ground = np.array([[west, south, 0.0], [east, south, 0.0], [east, north, 0.0], [west, north, 0.0]])
    points = np.vstack((ground, ground + np.array([0.0, 0.0, high_m])))
    middle = ground.mean(axis=0)
    scale = max(size_px) / 2 / np.tan(np.radians(BOX_FIELD_DEG) / 2)
    half = (size_px[0] / 2, size_px[1] / 2)

    def at(distance: float) -> tuple[Camera, FloatArray]:
        camera = Camera((0.0, 0.0, 0.0), azimuth, pitch, float(scale), size_px, half, True)
        eye = middle + distance * camera.axes[2]
        camera = replace(camera, eye_m=(float(eye[0]), float(eye[1]), float(eye[2])))
        return camera, camera.seen(points)

    diagonal = float(np.hypot(east - west, north - south))
    near, far = (share * diagonal for share in BOX_DISTANCES)
    for _ in range(40):
        distance = (near + far) / 2
        seen = at(distance)[1]
        fits = seen[:, 2].min() > 0.05 * distance and bool(
            (np.ptp(seen[:, :2], axis=0) <= BOX_SHARE * np.array(size_px)).all()
        )
        near, far = (near, distance) if fits else (distance, far)
    camera, seen = at(far)
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    moved = np.array(size_px) / 2 - (low + high) / 2
    share = float(shapely.area(shapely.polygons(seen[:4, :2]))) / (size_px[0] * size_px[1])
    return replace(camera, middle_px=(half[0] + float(moved[0]), half[1] + float(moved[1]))), share


def _sun_beside(azimuth_deg: float) -> Sun:
    """Return a sun in the southern sky that shines from the side."""
    sides = [(azimuth_deg + side) % 360.0 for side in (-SUN_SIDE_DEG, SUN_SIDE_DEG)]
    return min(sides, key=lambda side: abs(side - 180.0)), SUN_ELEVATION_DEG


def _camera_over(
    place: FloatArray, azimuth: float, width: float, plants: FloatArray, size_px: tuple[int, int]
) -> Camera:  # fmt: skip
    """Return the camera that sees a place in its foreground, and the far end of the city near its upper edge."""
    distance = width / 2 / np.tan(np.radians(FIELD_DEG) / 2)
    pitch, turn = np.radians(PITCH_DEG), np.radians(azimuth)
    ahead = np.array([np.sin(turn), np.cos(turn)])
    eye = place - ahead * distance * np.cos(pitch)
    camera = view_from((float(eye[0]), float(eye[1]), float(distance * np.sin(pitch))),
                       (float(place[0]), float(place[1]), 0.0), size_px=size_px, field_deg=FIELD_DEG)  # fmt: skip
    deep = float(np.percentile((plants - eye) @ ahead, 98))
    edge = eye + ahead * max(deep, distance)
    row = float(camera.seen(np.array([[edge[0], edge[1], 0.0]]))[0, 1])
    shift = np.clip(TOP_SHARE - row / size_px[1], *SHIFT_SHARES)
    x, y = camera.middle_px
    return Camera(camera.eye_m, camera.azimuth_deg, camera.pitch_deg, camera.scale_px, camera.size_px,
                  (x, y + float(shift) * size_px[1]), camera.perspective)  # fmt: skip


def _spread(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.asarray(np.percentile(xy, 1, axis=0)), np.asarray(np.percentile(xy, 99, axis=0))


@dataclass(frozen=True)
class Chart:
    """What stands in each cell of a grid over the city: (nx, ny) share under crowns, share built, height of houses."""

    low: FloatArray
    green: FloatArray
    built: FloatArray
    height_m: FloatArray

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
        """Return what stands at places (n, 2), and whether they lie within the city."""
        cell = np.floor((xy - self.low) / CELL_M).astype(int)
        held = np.all((cell >= 0) & (cell < self.green.shape), axis=1)
        i, j = np.where(held[:, None], cell, 0).T
        green, built, height = (np.where(held, grid[i, j], 0.0) for grid in (self.green, self.built, self.height_m))
        near = _averaged(self.green + self.built, 3)
        return green, built, height, held & (near[i, j] > 0.02)

    def best_places(self, width_m: float) -> list[FloatArray]:
        """Return middles of parts as wide as the foreground with many crowns and houses, none near another."""
        span = max(int(0.5 * width_m / CELL_M), 1)
        green, built = _averaged(self.green, span) / span**2, _averaged(self.built, span) / span**2
        score = green * (0.05 + np.sqrt(np.minimum(built, 0.3)))
        found: list[FloatArray] = []
        for flat in np.argsort(-score, axis=None, kind="stable"):
            place = self.low + (np.array(np.unravel_index(flat, score.shape)) + 0.5) * CELL_M
            if all(np.hypot(*(place - other)) > 0.3 * width_m for other in found):
                found.append(place)
                if len(found) == PLACES_MAX:
                    break
        return found

    def worth(self, camera: Camera) -> float:
        """Return how much a picture shows: crowns and houses count for it, what is outside and walls in the way not."""
        width, height = camera.size_px
        x, y = np.meshgrid((np.arange(48) + 0.5) / 48 * width, (np.arange(30) + 0.5) / 30 * height)
        a, b = (x - camera.middle_px[0]) / camera.scale_px, (camera.middle_px[1] - y) / camera.scale_px
        axes = camera.axes
        sight = a.ravel()[:, None] * axes[0] + b.ravel()[:, None] * axes[1] - axes[2]
        down = np.minimum(sight[:, 2], -1e-6)
        ground = np.array(camera.eye_m[:2]) + sight[:, :2] * (-camera.eye_m[2] / down)[:, None]
        green, built, high, inside = self.at(ground)
        weight = np.where(sight[:, 2] < 0, 0.5 + (y / height).ravel(), 0.0)
        low_part = (y / height).ravel() > 0.75
        weight /= max(float(weight.sum()), 1e-9)
        crowns, houses = float(weight @ np.minimum(green, 0.8)), float(weight @ np.minimum(built, 0.5))
        hidden = low_part * np.clip(high / camera.eye_m[2] - 0.12, 0.0, 1.0) * (built > 0.1)
        return crowns + 2.0 * float(np.sqrt(crowns * houses)) - float(weight @ (0.9 * ~inside + 0.5 * hidden))


def chart_of(city: City) -> Chart:
    """Count crowns and houses into cells."""
    plants = city.local(city.plants.xy_m)[:, :2]
    low = plants.min(axis=0) - CELL_M
    shape = tuple(int(n) + 2 for n in (plants.max(axis=0) - low) / CELL_M)

    def counted(xy: FloatArray, amount: FloatArray, largest: bool = False) -> FloatArray:
        cell = np.floor((xy - low) / CELL_M).astype(int)
        held = ((cell >= 0) & (cell < shape)).all(axis=1)
        grid = np.zeros(shape)
        (np.maximum if largest else np.add).at(grid, tuple(cell[held].T), amount[held])
        return grid

    green = counted(plants, np.pi * city.plants.crown_radius_m**2 / CELL_M**2)
    houses = city.local_shapes(city.buildings)
    middle = shapely.get_coordinates(shapely.centroid(houses)).reshape(-1, 2)
    built = counted(middle, shapely.area(houses) / CELL_M**2)
    return Chart(low, green, built, counted(middle, city.building_height_m, largest=True))


def _averaged(grid: FloatArray, width: int) -> FloatArray:
    """Return sums over squares of `width` cells about each cell."""
    for axis in range(2):
        total = np.cumsum(np.pad(grid, [(width // 2 + 1, width) if a == axis else (0, 0) for a in range(2)]), axis=axis)
        index = np.arange(grid.shape[axis])
        grid = np.take(total, index + width, axis=axis) - np.take(total, index, axis=axis)
    return grid


def from_above(city: City, *, size_px: tuple[int, int], sun: Sun | None, bounds: FloatArray | None = None) -> Shot:
    """Look straight down, north up, so that plants or the bounds just fill the picture."""
    if bounds is None:
        plants = city.local(city.plants.xy_m)[:, :2]
        margin = float(city.plants.crown_radius_m.max(initial=0.0)) + 2.0
        bounds = np.concatenate((plants.min(axis=0) - margin, plants.max(axis=0) + margin))
    middle = (bounds[:2] + bounds[2:]) / 2
    scale = float(min(np.array(size_px) / np.maximum(bounds[2:] - bounds[:2], 1.0)))
    camera = Camera((float(middle[0]), float(middle[1]), 0.0), 0.0, 90.0, scale, size_px,
                    (size_px[0] / 2, size_px[1] / 2))  # fmt: skip
    sharp = min(max(size_px) / scale, 900.0) * 1.1
    return Shot(camera, Weather(*(sun or TOP_SUN_DEG), (float(middle[0]), float(middle[1])), sharp))


def in_street(city: City, *, size_px: tuple[int, int], sun: Sun | None, bounds: FloatArray | None = None) -> Shot:
    """Stand on the road with the most trees near and look along it; where there is none, beside trees and houses."""
    plants = city.local(city.plants.xy_m)[:, :2]
    places, turns = _along_roads(city, bounds)
    on_road = len(places) > 0
    if not on_road:
        places, turns = _beside_trees(city, plants, bounds)
    eye, azimuth = _stand(city, plants, places, turns)
    sun = sun or _street_sun(azimuth)
    scale = size_px[0] / 2 / np.tan(np.radians(STREET_FIELD_DEG) / 2)
    camera = Camera((float(eye[0]), float(eye[1]), EYE_M), azimuth, 0.0, float(scale), size_px,
                    (size_px[0] / 2, size_px[1] * 0.64), True)  # fmt: skip
    turn = np.radians(azimuth)
    focus = eye + 40.0 * np.array([np.sin(turn), np.cos(turn)])
    return Shot(camera, Weather(*sun, (float(focus[0]), float(focus[1])), 130.0, 60.0, 900.0), on_road)


def _street_sun(azimuth_deg: float) -> Sun:
    """Return a sun in the southern sky that shines across the street, half against the viewer."""
    sides = [(azimuth_deg + side) % 360.0 for side in (-STREET_SUN_SIDE_DEG, STREET_SUN_SIDE_DEG)]
    return min(sides, key=lambda side: abs(side - 180.0)), STREET_SUN_ELEVATION_DEG


def _stand(
    city: City, plants: FloatArray, places: FloatArray, turns: NDArray[np.float64]
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return at which of some places to stand and which way to look, the azimuth in degrees."""
    trees = city.plants.height_m > TREE_M
    xy, high = (plants[trees], city.plants.height_m[trees]) if trees.any() else (plants, city.plants.height_m)
    houses = city.local_shapes(city.buildings)
    middles, tree = shapely.get_coordinates(shapely.centroid(houses)).reshape(-1, 2), shapely.STRtree(houses)
    best, found = -np.inf, (places[0], float(np.degrees(turns[0])))
    for place, turn in zip(places, turns, strict=True):
        ahead = np.array([np.sin(turn), np.cos(turn)])
        aside = np.array([ahead[1], -ahead[0]])
        deep, side = (xy - place) @ ahead, (xy - place) @ aside
        row = (deep > 5.0) & (deep < SIGHT_M) & (np.abs(side) > 3.0) & (np.abs(side) < 16.0)
        worth = high[row] / (25.0 + deep[row])
        left, right = float(worth[side[row] < 0].sum()), float(worth[side[row] > 0].sum())
        score = (left + right) * (0.4 + min(left, right) / max(left, right, 1e-9))
        in_the_way = (np.hypot(deep, side) < 6.0) | ((deep > 0) & (deep < 30.0) & (np.abs(side) < 3.0))
        score *= 0.6 ** int(in_the_way.sum())
        if len(middles):
            far, wide = (middles - place) @ ahead, np.abs((middles - place) @ aside)
            score *= 0.5 + min(int(((far > 0) & (far < SIGHT_M) & (wide < 45.0)).sum()), 8) / 8
        if score > best and not len(tree.query(shapely.Point(*place).buffer(3.0), predicate="intersects")):
            best, found = score, (place, float(np.degrees(turn) % 360.0))
    return found


def _beside_trees(
    city: City, plants: FloatArray, bounds: FloatArray | None
) -> tuple[FloatArray, NDArray[np.float64]]:  # fmt: skip
    """Return (n, 2) places around the parts with the most trees and houses, and (n,) ways to look at them."""
    middles = [place for place in chart_of(city).best_places(GROVE_M)
               if bounds is None or bool(((place >= bounds[:2]) & (place <= bounds[2:])).all())]  # fmt: skip
    if not middles:
        held = np.ones(len(plants), bool) if bounds is None else (
            ((plants >= bounds[:2]) & (plants <= bounds[2:])).all(axis=1))  # fmt: skip
        middles = [np.median(plants[held] if held.any() else plants, axis=0)]
    turns = np.tile(np.arange(TURNS) * 2 * np.pi / TURNS, len(middles))
    back = BACK_M * np.column_stack((np.sin(turns), np.cos(turns)))
    return np.repeat(np.array(middles), TURNS, axis=0) - back, turns


def _along_roads(city: City, bounds: FloatArray | None) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return (n, 2) places in the middle of roads and (n,) ways along them, in radians from north over east.

    From each place the road goes on straight ahead; of all there are, some thousand are taken.
    """
    roads = city.local_shapes(city.roads)
    xy = shapely.get_coordinates(roads)
    if not len(xy):
        return np.empty((0, 2)), np.empty(0)
    low = xy.min(axis=0) - ROAD_CELL_M
    wide, high = (int(n) + 2 for n in (xy.max(axis=0) - low) / ROAD_CELL_M)
    road = np.zeros((high, wide), np.float32)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(roads))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    flat = np.concatenate((corners, np.ones((len(corners), 3, 1))), axis=2)
    raise_faces(road, low, ROAD_CELL_M, np.zeros(2), flat)

    def on_road(places: FloatArray) -> NDArray[np.bool_]:
        i, j = np.floor((places - low) / ROAD_CELL_M).astype(int).T
        held = (i >= 0) & (j >= 0) & (i < wide) & (j < high)
        return np.asarray(held & (road[np.where(held, j, 0), np.where(held, i, 0)] > 0))

    j, i = np.nonzero(road > 0)
    places = low + (np.column_stack((i, j)) + 0.5) * ROAD_CELL_M
    if bounds is not None:
        places = places[((places >= bounds[:2]) & (places <= bounds[2:])).all(axis=1)]
    places = places[:: max(len(places) // PLACES_TRIED, 1)]
    turns = np.arange(TURNS) * 2 * np.pi / TURNS
    spot, turn = (part.ravel() for part in np.meshgrid(np.arange(len(places)), turns, indexing="ij"))
    ahead = np.column_stack((np.sin(turn), np.cos(turn)))
    aside = np.column_stack((ahead[:, 1], -ahead[:, 0]))
    straight = np.ones(len(spot), dtype=bool)
    for deep in np.arange(0.0, SIGHT_M, 6.0):
        for side in (-ROAD_HALF_M, ROAD_HALF_M):
            rows = np.flatnonzero(straight)
            straight[rows] = on_road(places[spot[rows]] + deep * ahead[rows] + side * aside[rows])
    rows = np.flatnonzero(straight)
    rows = rows[:: max(len(rows) // STANDS_TRIED, 1)]
    return places[spot[rows]], np.asarray(turn[rows], dtype=np.float64)
