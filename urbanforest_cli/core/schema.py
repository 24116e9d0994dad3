"""The layers of a register in words: who writes them, which columns they have and what must hold.

Checked when written and when read; all faults of a layer are gathered and raised once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.core.params import PARAMETERS

if TYPE_CHECKING:
    import pandas as pd

REGISTER_VERSION = 4
OLDEST_YEARS = 5000.0
RESOLVED_PREFIX = "resolved_"
SPREAD_SUFFIX = "_spread"
ORIGIN_SUFFIX = "_from"
REGRESSED = (
    "radius_mean_m", "radius_variance_m2", "density", "boundary_width_m", "cluster_radius_m", "cluster_count_max",
)  # fmt: skip
"""Parameters that are read off coverage, in the order of the network's outputs (paper, Learning Plant Placements)."""

ColumnType = Literal["text", "number", "integer"]

SKIP_REASONS = {
    "no_geometry": "the row has no geometry, or an empty one",
    "not_finite": "a coordinate is not a number or infinite",
    "broken_ring": "a ring is open or has fewer than four points",
    "not_polygon": "a point or a line, no polygon",
    "misplaced": "it lies outside the area of its CRS, or more than 500 km from the others",
    "duplicate": "another lot has the same ground, and is planted",
    "no_area": "the polygon encloses nothing",
    "too_small": "no piece of ground reaches the smallest area planted",
    "no_room": "buildings, driveways and other clearances cover the whole lot",
    "bare": "the coverage map shows no vegetation on it that a plant could stand under",
    "unseen": "the coverage map knows too little of it, and coverage.unseen is nothing",
    "no_position": "the strategy finds no position in the ground that is left",
    "thinned": "the density left no plant standing",
    "too_many_plants": "it would hold more plants than placement.max_plants_per_lot",
    "too_large": "it is longer than 500 km",
}

GROW_REASONS = {
    "died": "it died in the shade of others",
    "no_room": "it stands inside a building, or nothing could grow where it stands",
    "out_of_focus": "only some lots were asked for, and it was not grown before",
    "unborn": "it was not yet planted in the year shown",
}
GROWN = ("unique", "library", "dead", "none")
GROW_LAYERS = ("trees", "groves", "skeleton_parts")


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its type, whether it may be empty, the values it may take."""

    type: ColumnType
    doc: str
    nullable: bool = False
    unique: bool = False
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of the register."""

    name: str
    command: str
    doc: str
    columns: dict[str, Column]
    geometry: str | None = None
    key: str | None = field(default=None)


_LOT = Column("text", "lot the row belongs to")
_VALUES = {
    p.name: Column("number", p.doc, low=p.minimum - 1e-9, high=p.maximum + 1e-9) for p in PARAMETERS.values()
}  # fmt: skip

LAYERS: dict[str, Layer] = {
    layer.name: layer
    for layer in (
        Layer(
            "lots", "stencil", "cleaned lots, street strips made from roads, and sketches", geometry="MultiPolygon",
            columns={
                "lot_id": Column("text", "the lot's own id, as text", unique=True),
                "zone": Column("text", "functional zone"),
                "origin": Column("text", "register, road or sketch"),
                "area_m2": Column("number", "area", low=0),
                "plantable_area_m2": Column("number", "area left after all clearances", low=0),
                "covered_fraction": Column(
                    "number", "share under vegetation in the coverage map, of what the map knows; empty without a map",
                    nullable=True, low=0, high=1,
                ),
                "seen_fraction": Column(
                    "number", "share of the lot that the coverage map knows; empty without a map",
                    nullable=True, low=0, high=1,
                ),
            },
        ),
        Layer(
            "active_areas", "stencil", "where plants may stand", geometry="MultiPolygon",
            columns={
                "lot_id": _LOT,
                "kind": Column("text", "lot, road, sketch or region"),
                "area_m2": Column("number", "area", low=0),
            },
        ),
        Layer(
            "regions", "stencil", "vegetation of a coverage map, by the lot that its crowns belong to",
            geometry="MultiPolygon",
            columns={
                "lot_id": Column("text", "lot; only those filled from the map or from a painted sketch", unique=True),
                "area_m2": Column("number", "area, with what reaches over the lot's border", low=0),
                "inside_m2": Column("number", "area inside the lot", low=0),
                "region_count": Column("integer", "separate regions", low=1),
                "coverage": Column("number", "share of the region that crowns shall cover", low=0, high=1),
            },
        ),
        Layer(
            "observed", "stencil", "known plants that are kept as they are", geometry="Point",
            columns={
                "observed_id": Column("text", "the plant's own id, or its row in the city's layer", unique=True),
                "lot_id": _LOT,
                "crown_radius_m": Column("number", "radius of the crown, empty where unknown", nullable=True, low=0),
                "height_m": Column("number", "height, empty where unknown", nullable=True, low=0),
                "species": Column("text", "species identifier, empty where unknown", nullable=True),
            },
        ),
        Layer(
            "regressed", "regress", "one row a lot: what its coverage says of its parameters, and how surely",
            columns={
                "lot_id": Column("text", "lot", unique=True),
                "strategy": Column("text", "strategy that the coverage looks most like"),
                "strategy_share": Column("number", "how sure that is", low=0, high=1),
                "visible_plants": Column("number", "plants that can be told apart in the coverage", low=0),
                "pooled_lots": Column("integer", "lots whose coverage spoke, itself included", low=0),
                **{name: _VALUES[name] for name in REGRESSED},
                **{
                    name + SPREAD_SUFFIX: Column("number", f"standard deviation of {name}, in its unit", low=0)
                    for name in REGRESSED
                },
                **{
                    name + ORIGIN_SUFFIX: Column(
                        "text", "what the value rests on: map, neighbourhood, zone, or own: a column or a sketch"
                    )
                    for name in REGRESSED
                },
            },
        ),
        Layer(
            "parameters", "stencil", "one row a lot: values in force, and as resolved before any diffusion",
            columns={
                "lot_id": Column("text", "lot", unique=True),
                "strategy": Column("text", "placement strategy"),
                "source": Column("text", "zone, lot, sketch or regressed: where the resolved values come from"),
                "context_lot_count": Column("integer", "lots that shared their values, itself included", low=0),
                **_VALUES,
                **{RESOLVED_PREFIX + name: column for name, column in _VALUES.items()},
            },
        ),
        Layer(
            "buildings", "stencil", "cleaned buildings, those outside all lots too", geometry="MultiPolygon",
            columns={
                "building_id": Column("text", "the building's own id, or its row in the city's layer"),
                "height_m": Column("number", "height of the walls, empty where unknown", nullable=True, low=0),
            },
        ),
        Layer(
            "roads", "stencil", "surfaces of roads, lines widened to their width", geometry="MultiPolygon",
            columns={
                "road_id": Column("text", "the road's own id, or its row in the city's layer"),
                "width_m": Column("number", "width, 0 of a road that came as a polygon", low=0),
            },
        ),
        Layer(
            "plants", "place", "every plant", geometry="Point",
            columns={
                "plant_id": Column("text", "lot id and number within the lot", unique=True),
                "lot_id": _LOT,
                "species": Column("text", "species identifier"),
                "habit": Column("text", "tree or shrub"),
                "age_years": Column("number", "age", low=0, high=OLDEST_YEARS),
                "envelope_radius_m": Column("number", "radius of the room a plant takes", low=0),
                "pruning_factor": Column("number", "scale of the sides of the crown's box, 1 unpruned", low=0, high=1),
            },
        ),
        Layer(
            "placements", "place", "one row a lot: what the sampler did",
            columns={
                "lot_id": Column("text", "lot", unique=True),
                "outcome": Column("text", "planted, or the reason why not"),
                "position_count": Column("integer", "positions before thinning by density", low=0),
                "plant_count": Column("integer", "plants", low=0),
                "radius_mean_m": Column("number", "realised mean envelope radius", nullable=True),
                "radius_variance_m2": Column("number", "realised variance of the envelope radius", nullable=True),
                "dominant_species": Column("text", "dominant species of the lot", nullable=True),
                "place_key": Column("text", "hash of all that decided this lot's plants"),
            },
        ),
        Layer(
            "trees", "grow", "what became of every plant, in the order of layer plants", geometry="Point",
            columns={
                "plant_id": Column("text", "plant", unique=True),
                "lot_id": _LOT,
                "species": Column("text", "species identifier"),
                "habit": Column("text", "tree or shrub"),
                "age_years": Column("number", "age", low=0, high=OLDEST_YEARS),
                "height_m": Column("number", "height, 0 where nothing stands", low=0),
                "crown_radius_m": Column("number", "mean reach of the crown over eight sectors", low=0),
                "crown_base_m": Column("number", "height of the lowest living branch", low=0),
                "dbh_m": Column("number", "diameter of the stems at 1.3 m, 0 for plants below", low=0),
                "internode_count": Column("integer", "standing internodes", low=0),
                "skeleton_id": Column("integer", "skeleton in the parts of skeletons/, empty for none", nullable=True),
                "grown": Column("text", "unique, library, dead or none"),
                "reason": Column("text", "why a plant is dead or has no skeleton, a code", nullable=True),
                "key_distance": Column("number", "from the library's skeleton to the plant's own place", nullable=True),
                "yaw_deg": Column("number", "turn of the skeleton, counter-clockwise", low=0, high=360),
                "mirror": Column("integer", "1 where north is mirrored before the skeleton is turned", low=0, high=1),
                "scale": Column("number", "factor on the skeleton's size", low=0),
            },
        ),
        Layer(
            "groves", "grow", "plants that grew together, and where their skeletons are",
            columns={
                "grove_id": Column("text", "lot id and number within the lot, or library and the plant", unique=True),
                "lot_id": _LOT,
                "kind": Column("text", "lot: grown for themselves; library: a plant grown to stand for many"),
                "plant_count": Column("integer", "plants", low=1),
                "part": Column("text", "file in skeletons/"),
                "row_group": Column("integer", "row group of that file", low=0),
                "grow_key": Column("text", "hash of all that decided these skeletons"),
            },
        ),
        Layer(
            "skeleton_parts", "grow", "files of skeletons/ that belong to this register",
            columns={
                "part": Column("text", "file name", unique=True),
                "sha256": Column("text", "SHA-256 of the file"),
                "bytes": Column("integer", "size of the file", low=1),
                "skeleton_count": Column("integer", "skeletons", low=0),
                "internode_count": Column("integer", "internodes, lost ones included", low=0),
            },
        ),
        Layer(
            "skipped", "stencil", "every lot without plants and why",
            columns={
                "lot_id": Column("text", "lot"),
                "stage": Column("text", "stage that skipped it"),
                "reason": Column("text", "code"),
                "detail": Column("text", "in words"),
            },
        ),
        Layer(
            "provenance", "stencil", "one row a stage: what made it from what",
            columns={
                "stage": Column("text", "stage", unique=True),
                "register_version": Column("integer", "version of this schema"),
                "program_version": Column("text", "version of urbanforest"),
                "seed": Column("text", "root of the random streams"),
                "stage_key": Column("text", "hash of all that decided the stage's result"),
                "working_crs": Column("text", "CRS in metres the work was done in, WKT"),
                "config": Column("text", "config in force, JSON"),
                "inputs": Column("text", "names and SHA-256 of the inputs, JSON"),
                "counts": Column("text", "counts, JSON"),
                "warnings": Column("text", "counted warnings, JSON"),
                "written_at": Column("text", "UTC time"),
            },
        ),
    )
}  # fmt: skip


def check_layer(frame: pd.DataFrame, name: str, *, where: object = None) -> None:
    """Check a frame against its layer's requirements.

    Raises
    ------
    SchemaError
        With every fault found, one a line.
    """
    layer = LAYERS[name]
    faults = [f"column {column!r} is missing" for column in layer.columns if column not in frame.columns]
    for column, rule in layer.columns.items():
        if column in frame.columns:
            faults += [f"column {column!r} {fault}" for fault in _column_faults(frame[column], rule)]
    if faults:
        raise SchemaError(
            f"layer {name!r} breaks its requirements",
            where=where,
            found="; ".join(faults[:10]) + (f"; and {len(faults) - 10} more" if len(faults) > 10 else ""),
            next_step=f"write it again with `urbanforest {layer.command}`",
        )


def _column_faults(values: pd.Series[Any], rule: Column) -> list[str]:
    faults = []
    missing = int(values.isna().sum())
    if missing and not rule.nullable:
        faults.append(f"is empty in {missing} rows")
    if rule.unique and (doubles := int(values.duplicated().sum())):
        faults.append(f"repeats {doubles} values")
    if rule.type != "text" and len(values):
        try:
            numbers = values.to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError):
            return [*faults, "holds text where numbers belong"]
        outside = int(((numbers < rule.low) | (numbers > rule.high)).sum())
        if outside:
            faults.append(f"leaves {rule.low:g} to {rule.high:g} in {outside} rows")
    return faults
