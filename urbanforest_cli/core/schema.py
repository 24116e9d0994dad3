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

REGISTER_VERSION = 1
RESOLVED_PREFIX = "resolved_"

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
    "no_position": "the strategy finds no position in the ground that is left",
    "thinned": "the density left no plant standing",
    "too_many_plants": "it would hold more plants than placement.max_plants_per_lot",
    "too_large": "it is longer than 500 km",
}


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
                "covered_fraction": Column("number", "share under vegetation in the image", nullable=True),
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
            "plants", "place", "every plant", geometry="Point",
            columns={
                "plant_id": Column("text", "lot id and number within the lot", unique=True),
                "lot_id": _LOT,
                "species": Column("text", "species identifier"),
                "habit": Column("text", "tree or shrub"),
                "age_years": Column("number", "age", low=0),
                "envelope_radius_m": Column("number", "radius of the room a plant takes", low=0),
                "pruning_factor": Column("number", "crown volume kept, 1 unpruned", low=0, high=1),
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
