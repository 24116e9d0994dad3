"""One plant grown by itself, written as a skeleton and drawn as a picture."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli import __version__
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.kernels import announce_compile
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.export.plant_camera import view_onto
from urbanforest_cli.export.plant_looks import look_of
from urbanforest_cli.export.plant_pictures import Backdrop, Scene, render
from urbanforest_cli.export.plant_scene import Standing
from urbanforest_cli.export.plant_sheets import Panel, draw_sheet
from urbanforest_cli.export.plant_town import build_person
from urbanforest_cli.export.png import png_of
from urbanforest_cli.export.text import counted
from urbanforest_cli.files.skeletons import write_part
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.alone import Company, Neighbour, Wall, compass, grow_alone, species_named
from urbanforest_cli.growth.grove import OUTCOMES
from urbanforest_cli.growth.simulate import KERNELS

SKELETON, PICTURE = ".parquet", ".png"
PICTURE_PX = (1400, 1300)
WINDS = ("north", "northeast", "east", "southeast", "south", "southwest", "west", "northwest")
SIZES = ("height_m", "crown_radius_m", "crown_base_m", "dbh_m", "internode_count")
GROUND, SKY, HAZE = (0.57, 0.62, 0.42), (0.78, 0.86, 0.93), (0.95, 0.96, 0.96)


@dataclass(frozen=True)
class Request:
    """What a user asked for: a plant, what stands beside it, and the files to write."""

    species: str
    age_years: float
    config: Config
    seed: int
    outputs: Sequence[Path] = ()
    walls: Sequence[Wall] = ()
    neighbours: Sequence[Neighbour] = ()
    pruning_factor: float = 1.0
    latitude_deg: float = 48.0
    overwrite: bool = False


def grow_one(request: Request, *, progress: Progress = silent) -> tuple[StageSummary, list[str]]:
    """Grow one plant and write what was asked for.

    Returns
    -------
    A summary, its counts those of the plant itself, and a line of words for each plant.

    Raises
    ------
    InputError
        Something cannot be grown, or a file cannot be told by its name.
    OutputExistsError
        A file is there already.
    """
    started = time.perf_counter()
    _check(request)
    catalogue = load_catalogue(request.config.species)
    species_named(catalogue, request.species)  # before a minute of compiling
    announce_compile(KERNELS, progress)
    company = grow_alone(
        catalogue,
        request.species,
        request.age_years,
        growth=request.config.growth,
        walls=request.walls,
        neighbours=request.neighbours,
        pruning_factor=request.pruning_factor,
        latitude_deg=request.latitude_deg,
        seed=request.seed,
    )
    record = _record(request, company)
    for path in request.outputs:
        if path.suffix.lower() == SKELETON:
            texts = {
                "plant_id": dict(enumerate(company.names)),
                "species": dict(enumerate(kind.id for kind in company.species)),
            }
            write_part(path, [company.skeletons], record, texts=texts)
        else:
            with publish(path) as part:
                part.write_bytes(_picture(request, company, record))
    counts: dict[str, int | float | str] = {
        name: record[name] for name in ("species", "age_years", "outcome", *SIZES, "neighbours", "walls")
    }
    output = request.outputs[0] if request.outputs else Path()
    summary = StageSummary("grow", output, counts, seconds=time.perf_counter() - started)
    return summary, [_sentence(company, number) for number in range(len(company))]


def _check(request: Request) -> None:
    for path in request.outputs:
        if path.suffix.lower() not in (SKELETON, PICTURE):
            raise InputError(
                "no kind of file that one plant can be written to", where=path,
                expected="a name that ends with .parquet (skeleton) or .png (picture)",
            )  # fmt: skip
        if path.is_dir():
            raise OutputExistsError("a folder of that name is there", where=path, next_step="name another with -o")
        if path.exists() and not request.overwrite:
            raise OutputExistsError(
                "the file is there already", where=path, next_step="name another with -o, or add --overwrite"
            )


def _record(request: Request, company: Company) -> dict[str, Any]:
    """Return what the files say of themselves."""
    accounts = company.accounts
    plants = [
        {
            "plant_id": company.names[row],
            "species": company.species[row].id,
            "age_years": float(company.age_years[row]),
            "x_m": round(float(company.xy_m[row, 0]), 3),
            "y_m": round(float(company.xy_m[row, 1]), 3),
            "outcome": OUTCOMES[int(accounts.outcome[row])],
            **{name: accounts.columns()[name][row].item() for name in SIZES},
        }
        for row in range(len(company))
    ]
    own = {name: value for name, value in plants[0].items() if name not in ("plant_id", "x_m", "y_m")}
    return {
        "stage": "grow",
        "program": "urbanforest",
        "program_version": __version__,
        "seed": request.seed,
        **own,
        "latitude_deg": request.latitude_deg,
        "pruning_factor": request.pruning_factor,
        "environment": request.config.growth.environment,
        "walls": " ".join(wall.text() for wall in request.walls),
        "neighbours": " ".join(item.text() for item in request.neighbours),
        "plants": plants,
        "growth": request.config.growth.model_dump(mode="json"),
    }


def _sentence(company: Company, row: int) -> str:
    """Tell of one plant in words."""
    kind, accounts = company.species[row], company.accounts
    who = f"{kind.scientific_name} ({kind.common_name}), {company.age_years[row]:g} years"
    outcome = OUTCOMES[int(accounts.outcome[row])]
    if outcome != "grown":
        died = f"died in its season {accounts.death_season[row]}"
        return f"{who}: {died if outcome == 'died' else 'found no room'}"
    words = f"{_length(accounts.height_m[row])} high, crown {_length(2 * accounts.crown_radius_m[row])} wide"
    if accounts.dbh_m[row] > 0:
        words += f", {100 * accounts.dbh_m[row]:.0f} cm thick at 1.3 m"
    return f"{who}: {words}, {counted(int(accounts.internode_count[row]), 'internode')}"


def _length(metres: float) -> str:
    return f"{metres:.1f} m" if metres >= 1 else f"{100 * metres:.0f} cm"


def _picture(request: Request, company: Company, record: dict[str, Any]) -> bytes:
    """Draw the plants and walls with a person for scale."""
    looks = [look_of(kind) for kind in company.species]
    azimuth = _viewing_azimuth(request)
    person = _room_for_person(company, azimuth)
    scene = Scene(
        [Standing(company.skeletons, company.xy_m, looks)], company.walls, company.wall_height_m,
        things=[build_person(*place) for place in person],
        backdrop=Backdrop(SKY, HAZE, GROUND, (0.0, 0.0), (220.0, 220.0)),
    )  # fmt: skip
    ends = [[x + sway, y + sway, z] for x, y in person for sway in (-0.35, 0.35) for z in (0.0, 1.9)]
    points = np.vstack([_corners(company), np.array(ends).reshape(-1, 3)])
    tall = float(np.ptp(points[:, 2]))
    camera = view_onto(
        points, azimuth_deg=azimuth, pitch_deg=5.0, distance_m=max(2.6 * tall, 3 * float(np.ptp(points[:, :2])), 12.0),
        size_px=PICTURE_PX, margin_px=60.0,
    )  # fmt: skip
    lines = [_sentence(company, row).split(": ", 1) for row in range(len(company))]
    beside = [f"{len(request.walls)} walls"] if len(request.walls) > 1 else ["a wall"] * len(request.walls)
    beside += [company.species[row].common_name for row in range(1, len(company))]
    place = "beside " + ", ".join(beside) if beside else "alone"
    towards = f"looking {WINDS[round(azimuth / 45.0) % 8]}"
    image = render(scene, camera, supersampling=2, sun=_afternoon_sun(request.latitude_deg))
    panel = Panel(image, title=f"{place}, {towards}", note=f"seed {request.seed}")
    return png_of(draw_sheet([[panel]], (lines[0][0], lines[0][1])), record)


def _corners(company: Company) -> NDArray[np.float64]:
    """Return points (n, 3) that a picture must show: the plants from root to top, and as much of the walls."""
    sizes, points = company.accounts, []
    for at, radius, height in zip(company.xy_m, sizes.crown_radius_m, sizes.height_m, strict=True):
        radius, height = max(float(radius), 1.0), max(float(height), 1.9)
        rim = at + 1.05 * radius * np.array([compass(1.0, angle) for angle in range(0, 360, 30)])
        points += [np.column_stack((rim, np.full(len(rim), share * height))) for share in (0.3, 0.8)]
        points.append(np.array([[*at, -0.04 * height], [*at, 1.03 * height]]))
    return np.vstack(points)


def _room_for_person(company: Company, looking_deg: float) -> list[tuple[float, float]]:
    """Return a place for a person to the left or right of the plant, none where walls are on both sides."""
    away = 0.9 * float(company.accounts.crown_radius_m[0]) + 1.0
    free = []
    for side in (-90.0, 90.0):
        place = compass(away, looking_deg + side)
        way = shapely.LineString([[0.0, 0.0], (1.2 * place).tolist()])
        if not any(shapely.intersects(wall, way) for wall in company.walls):
            gap = min((float(np.hypot(*(place - at))) for at in company.xy_m[1:]), default=np.inf)
            free.append((-gap, side, (float(place[0]), float(place[1]))))
    return [min(free)[2]] if free else []


def _afternoon_sun(latitude_deg: float) -> tuple[float, float, float]:
    """Return a direction toward the sun: from the equator's side and somewhat from the west, as light is reckoned."""
    return (-0.45, -0.75 if latitude_deg >= 0 else 0.75, 0.8)


def _viewing_azimuth(request: Request) -> float:
    """Return the direction to look in: neighbours and walls beside the plant rather than before it."""
    beside = [item.azimuth_deg for item in request.neighbours]
    walls = [item.azimuth_deg for item in request.walls]

    def in_the_way(looking_deg: float) -> float:
        from_eye = looking_deg + 180.0  # the viewer stands there, seen from the plant
        faults = [abs(np.cos(np.radians(azimuth - from_eye)) + 0.2) for azimuth in beside]
        for azimuth in walls:
            before = np.cos(np.radians(azimuth - from_eye))
            faults.append(abs(before + 0.35) + (2.0 if before > 0.3 else 0.0))
        return round(float(max(faults, default=0.0)), 6)

    return float(min(range(0, 360, 15), key=lambda angle: (in_the_way(angle), min(angle, 360 - angle), angle)))
