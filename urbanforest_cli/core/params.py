"""The parameters of a procedural placement model, named once for files, options and columns.

Names, symbols and ranges follow tables 1 and 2 of *Procedural Urban Forestry* (Niese et al. 2022).
The table's ranges say where training pairs are drawn from and where a warning begins; the limits
say what is refused, since the paper's own figures leave the ranges (boundary 10 m, 18 clusters).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from hashlib import sha256
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

Kind = Literal["length", "variance", "fraction", "count", "angle", "years"]

STRATEGIES = ("random", "boundary", "cluster", "equidistant", "single", "regular")
ENTRY_POINT_GROUP = "urbanforest.strategies"
STRATEGY_LETTERS = {"R": "random", "B": "boundary", "C": "cluster", "E": "equidistant", "S": "single", "I": "regular"}


def _param(default: float, **meaning: Any) -> Any:
    return field(default=default, metadata=meaning)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementParams:
    """The values of one lot; field names are column names, config keys and option names."""

    radius_mean_m: float = _param(
        3.13, symbol="mu", unit="m", low=1.0, high=10.0, minimum=0.1, maximum=50.0,
        kind="length", doc="mean radius of a plant's envelope",
    )  # fmt: skip
    radius_variance_m2: float = _param(
        0.35, symbol="sigma", unit="m2", low=0.1, high=2.0, minimum=0.0, maximum=100.0,
        kind="variance", doc="variance of the envelope radius",
    )  # fmt: skip
    density: float = _param(
        1.0, symbol="tau", unit="1", low=0.0, high=1.0, minimum=0.0, maximum=1.0,
        kind="fraction", doc="share of the saturated positions that is planted",
    )  # fmt: skip
    boundary_width_m: float = _param(
        4.0, symbol="beta", unit="m", low=0.0, high=5.0, minimum=0.0, maximum=1000.0,
        kind="length", doc="width of the planted band along the lot's edge, inward",
        strategies=("boundary",),
    )  # fmt: skip
    cluster_radius_m: float = _param(
        10.0, symbol="kappa", unit="m", low=1.0, high=20.0, minimum=0.0, maximum=1000.0,
        kind="length", doc="radius of a cluster's disc", strategies=("cluster",),
    )  # fmt: skip
    cluster_count_max: float = _param(
        3, symbol="pi", unit="1", low=0, high=5, minimum=0, maximum=1000,
        kind="count", doc="largest number of clusters in a lot", strategies=("cluster",),
    )  # fmt: skip
    grid_size_m: float = _param(
        9.0, symbol="omega", unit="m", low=5.0, high=50.0, minimum=0.2, maximum=1000.0,
        kind="length", doc="side of a lattice cell", strategies=("regular",),
    )  # fmt: skip
    grid_jitter: float = _param(
        0.0, symbol="psi", unit="1", low=0.0, high=1.0, minimum=0.0, maximum=1.0,
        kind="fraction", doc="share of its cell a lattice plant may wander in",
        strategies=("regular",),
    )  # fmt: skip
    grid_orientation_deg: float = _param(
        0.0, symbol="eta", unit="deg", low=0.0, high=180.0, minimum=0.0, maximum=360.0,
        kind="angle", doc="turn of the lattice against the lot's longer side",
        strategies=("regular",),
    )  # fmt: skip
    spacing_m: float = _param(
        8.0, symbol="delta", unit="m", low=0.0, high=10.0, minimum=0.0, maximum=1000.0,
        kind="length", doc="distance of plants along the medial axis",
        strategies=("equidistant",),
    )  # fmt: skip
    context_radius_m: float = _param(
        60.0, symbol="xi", unit="m", low=0.0, high=300.0, minimum=0.0, maximum=10000.0,
        kind="length", doc="radius in which lots share their values",
    )  # fmt: skip
    age_max_years: float = _param(
        30.0, symbol="alpha", unit="years", low=0.0, high=100.0, minimum=0.0, maximum=1000.0,
        kind="years", doc="oldest a plant may be",
    )  # fmt: skip
    tree_fraction: float = _param(
        0.7, symbol="rho", unit="1", low=0.0, high=1.0, minimum=0.0, maximum=1.0,
        kind="fraction", doc="share of trees: 1 all trees, 0 all shrubs",
    )  # fmt: skip
    species_diversity: float = _param(
        0.3, symbol="theta", unit="1", low=0.0, high=1.0, minimum=0.0, maximum=1.0,
        kind="fraction", doc="share of plants not of the dominant species",
    )  # fmt: skip
    pruning_factor: float = _param(
        1.0, symbol="gamma", unit="1", low=0.0, high=1.0, minimum=0.0, maximum=1.0,
        kind="fraction", doc="scale of the sides of the crown's bounding volume, 1 unpruned",
    )  # fmt: skip
    species_count: float = _param(
        4, symbol="lambda", unit="1", low=1, high=10, minimum=1, maximum=1000,
        kind="count", doc="number of species used in a lot",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Parameter:
    """What is known of one parameter: its meaning, its unit, its range and who uses it."""

    name: str
    symbol: str
    unit: str
    default: float
    low: float
    high: float
    minimum: float
    maximum: float
    kind: Kind
    doc: str
    strategies: tuple[str, ...]


def _glossary() -> Iterator[Parameter]:
    for item in fields(PlacementParams):
        meaning = dict(item.metadata)
        meaning.setdefault("strategies", STRATEGIES)
        yield Parameter(name=item.name, default=float(item.default), **meaning)  # type: ignore[arg-type]


PARAMETERS: dict[str, Parameter] = {parameter.name: parameter for parameter in _glossary()}


def strategy_names() -> tuple[str, ...]:
    """Return the names of all placement strategies, those that other packages bring last."""
    return STRATEGIES + tuple(sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP)))


def plugin_prints() -> list[str]:
    """Return what tells one state of the strategies of other packages from another: version and source of each."""
    prints = []
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        version = point.dist.version if point.dist is not None else ""
        spec = find_spec(point.module.partition(".")[0])  # the top alone: looking further would run its code
        source = Path(spec.origin) if spec is not None and spec.origin else None
        files: list[Path] = []
        if source is not None and source.is_file():
            files = sorted(source.parent.rglob("*.py")) if source.name == "__init__.py" else [source]
        content = sha256(b"".join(sha256(file.read_bytes()).digest() for file in files)).hexdigest()
        prints.append(f"{point.name}={point.value} {version} {content}")
    return prints
