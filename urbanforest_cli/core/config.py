"""The config as one checked object; every mistake of a file is found in one pass.

`configs/default.toml` holds the values of the zones; the defaults here are those of the rules.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model, field_validator, model_validator

from urbanforest_cli.core.params import PARAMETERS, STRATEGY_LETTERS

Metres = Annotated[float, Field(strict=True, ge=0, le=1000, allow_inf_nan=False)]


class Section(BaseModel):
    """A table of the config: unknown keys are refused, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)


class Rules(Section):
    """Planting rules: how far plants stay from what is built (paper, section Planting Rules)."""

    building_clearance_m: Metres = Field(6.0, description="distance of plants from building walls")
    neighbour_buildings: bool = Field(True, description="also keep away from buildings of other lots")
    driveway_clearance_m: Metres = Field(1.5, description="distance from driveways")
    driveway_width_m: Metres = Field(3.0, description="width of a driveway given as a line")
    door_depth_m: Metres = Field(9.0, description="free depth in front of a door, from the wall")
    door_width_m: Metres = Field(3.0, description="free width in front of a door given as a point")
    window_depth_m: Metres = Field(7.5, description="free depth in front of a window, from the wall")
    window_width_m: Metres = Field(2.0, description="free width in front of a window given as a point")
    curb_clearance_m: Metres = Field(0.75, description="distance of plants from the curb, the road's edge")
    sidewalk_width_m: Metres = Field(1.5, description="width kept free beyond the planted strip along a road")
    verge_width_m: Metres = Field(2.5, description="width of the planted strip along a road")
    sight_triangle_m: Metres = Field(9.0, description="leg of the triangle kept free at road intersections")
    road_width_m: Metres = Field(7.0, description="width of a road that states none")
    derive_street_lots: bool = Field(True, description="make street lots from roads where the register has none")
    treeless_road_kinds: tuple[str, ...] = Field(
        ("footway", "path", "steps", "cycleway", "bridleway", "track", "service", "corridor", "platform", "elevator"),
        description="kinds of roads along which no street trees are set",
    )
    obstacle_clearance_m: dict[str, Metres] = Field(
        default_factory=lambda: {
            "default": 1.5,
            "hydrant": 3.0,
            "mast": 3.0,
            "pipe": 2.0,
            "water": 1.0,
            "rail": 6.0,
            "tree": 2.0,
        },
        description="distance from an obstacle, by its kind",
    )
    min_area_m2: Annotated[float, Field(strict=True, ge=0, le=1e6)] = Field(
        1.0, description="smallest piece of ground planted"
    )

    @field_validator("obstacle_clearance_m")
    @classmethod
    def _has_default(cls, value: dict[str, float]) -> dict[str, float]:
        return {"default": 1.5, **value}


class Placement(Section):
    """How the samplers work."""

    radius_law: Literal["kept", "redrawn"] = Field(
        "kept", description="kept: a radius is drawn once and placed where it fits; redrawn: the paper's literal law"
    )
    radius_stop: Literal["mean", "min", "max"] = Field(
        "mean", description="a gap counts as long as a plant of this radius fits in it"
    )
    sigma_is: Literal["variance", "sd"] = Field("variance", description="what radius_variance_m2 means")
    radius_cut_sd: Annotated[float, Field(strict=True, gt=0, le=6)] = Field(
        2.0, description="truncation, in standard deviations"
    )
    radius_min_m: Annotated[float, Field(strict=True, ge=0.1, le=10)] = Field(0.5, description="smallest radius drawn")
    conflict: Literal["lot", "city"] = Field("lot", description="whose plants keep apart: a lot's own, or all")
    density_law: Literal["hash", "exact"] = Field("hash", description="hash: each plant by itself; exact: by count")
    boundary_of: Literal["lot", "area"] = Field("lot", description="whose edge the boundary strategy follows")
    cluster_count: Literal["uniform", "max"] = Field("uniform", description="clusters: 1 to the maximum, or it")
    lattice_phase: Literal["centred", "random"] = Field("centred", description="where the lattice starts")
    max_plants_per_lot: Annotated[int, Field(strict=True, ge=1, le=100_000_000)] = Field(
        250_000, description="a lot that would hold more is skipped"
    )


class Coverage(Section):
    """How a coverage map is cut into the lots (paper, section Learning Plant Placements)."""

    band: Literal["canopy", "vegetation"] = Field("canopy", description="class of the map that plants stand under")
    threshold_percent: Annotated[float, Field(strict=True, gt=0, le=100)] | None = Field(
        None, description="percentage from which ground counts as covered; what the map itself says, else 50, if unset"
    )
    resolution_m: Annotated[float, Field(strict=True, ge=0.1, le=10)] | None = Field(
        None, description="cell in which regions are cut; the map's own, from 0.25 to 1 m, if unset"
    )
    smallest_region_m2: Annotated[float, Field(strict=True, ge=0, le=1e4)] = Field(
        2.0, description="regions below this are dropped, and holes below it filled"
    )
    wall_clearance_m: Metres = Field(0.5, description="distance of stems from walls in regions: the trees are there")
    road_clearance_m: Metres = Field(0.0, description="distance of stems from road surfaces in regions")
    seen_least: Annotated[float, Field(strict=True, gt=0, le=1)] = Field(
        0.5, description="lots of which the map knows less are not filled from it"
    )
    unseen: Literal["rules", "nothing"] = Field(
        "rules", description="what becomes of lots that the map does not know: planted by their zone's rules, or not"
    )
    crown_overlap: Annotated[float, Field(strict=True, ge=0, le=0.9)] = Field(
        0.25, description="share of the sum of their radii by which crowns in closed canopy may overlap"
    )


class Regression(Section):
    """How parameters are read off coverage."""

    pooling_radius_m: Metres = Field(
        150.0, description="radius in which lots of one zone share what their coverage says, 0 is off"
    )
    zone_spread: Annotated[float, Field(strict=True, gt=0, le=10)] = Field(
        0.25, description="how far lots stray from their zone's values, as a share of the parameter's range"
    )
    known_share: Annotated[float, Field(strict=True, gt=0, le=1)] = Field(
        0.8, description="a value rests on the map where its spread is at most this share of what it is without one"
    )


class Context(Section):
    """Diffusion of parameters between neighbouring lots (paper, equation 4)."""

    passes: Annotated[int, Field(strict=True, ge=0, le=100)] = Field(
        1, description="how often values are diffused, 0 is off"
    )
    sigma_fraction: Annotated[float, Field(strict=True, ge=0.001, le=10)] = Field(
        1 / 3, description="standard deviation of the Gaussian as a share of the context radius"
    )
    scope: Literal["all", "zone", "strategy"] = Field("all", description="which neighbours share their values")


class Species(Section):
    """Which species the city has."""

    names: tuple[str, ...] | None = Field(None, description="species of the city; all of the catalogue if unset")
    folder: str | None = Field(None, description="folder with more species files")
    hardiness_zone: Annotated[int, Field(strict=True, ge=1, le=13)] | None = Field(
        None, description="USDA zone of the city; species that do not live there are left out"
    )
    dominant: str | None = Field(None, description="dominant species everywhere; drawn for each lot if unset")


class Growth(Section):
    """How plants grow (paper, section Developmental Plant Model)."""

    environment: Literal["both", "shadow", "markers"] = Field(
        "both", description="what plants sense: light (shadow), room (markers), or both"
    )
    fate: Literal["borchert_honda", "priority"] = Field(
        "borchert_honda", description="how resource is shared among buds (Palubicki 2009)"
    )
    detail: Literal["auto", "unique", "library"] = Field(
        "auto", description="unique: every plant grown in its place; library: the nearest of a few thousand grown"
    )
    unique_plants_max: Annotated[int, Field(strict=True, ge=0, le=100_000_000)] = Field(
        5000, description="auto grows every plant in its place up to this many, beyond it only those in focus"
    )
    library_size_max: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] = Field(
        2000, description="most skeletons in the library of a city"
    )
    library_sample: Annotated[int, Field(strict=True, ge=0, le=10_000)] = Field(
        40, description="plants grown uniquely beside the library to measure its shape error"
    )
    neighbours: bool = Field(True, description="plants of other lots shade and take room at the border")
    voxel_m: Annotated[float, Field(strict=True, ge=0.1, le=2)] = Field(0.4, description="edge of a shadow voxel")
    shade_depth_voxels: Annotated[int, Field(strict=True, ge=1, le=16)] = Field(
        5, description="depth of the shadow pyramid"
    )
    marker_spacing_m: Annotated[float, Field(strict=True, ge=0.2, le=2)] = Field(0.5, description="one marker a cell")
    marker_range_internodes: Annotated[float, Field(strict=True, ge=2, le=10)] = Field(
        4.0, description="how far a bud perceives markers"
    )
    marker_radius_internodes: Annotated[float, Field(strict=True, ge=0.5, le=6)] = Field(
        2.0, description="markers within this distance of an internode are taken"
    )
    perception_angle_deg: Annotated[float, Field(strict=True, ge=30, le=180)] = Field(
        90.0, description="full angle of a bud's cone of perception"
    )
    building_height_m: Metres = Field(8.0, description="height of a building that states none")
    sun_share: Annotated[float, Field(strict=True, ge=0, le=1)] = Field(
        0.5, description="share of light that comes straight from the sun, the rest from the sky"
    )
    regrow_years: Annotated[int, Field(strict=True, ge=0, le=50)] = Field(
        5, description="years of growth after a plant with pruning_factor below 1 is cut"
    )
    pruning_shape: Literal["box", "ellipsoid"] = Field(
        "box", description="volume a pruned crown is cut to; boxes along a street join into a hedge"
    )
    crown_clearance_m: dict[str, Metres] = Field(
        default_factory=lambda: {"street": 2.5},
        description="height below which branches are lifted, by zone (people and traffic pass below)",
    )
    grove_plants_max: Annotated[int, Field(strict=True, ge=1, le=2000)] = Field(
        48, description="plants grown together; a lot with more is cut into groves"
    )
    grove_length_max_m: Annotated[float, Field(strict=True, ge=10, le=500)] = Field(
        60.0, description="longest side of a grove; a longer lot is cut"
    )

    @model_validator(mode="after")
    def _sees_beyond_what_is_taken(self) -> Growth:
        if self.marker_range_internodes <= self.marker_radius_internodes:
            raise ValueError("marker_range_internodes must exceed marker_radius_internodes, or no bud ever sees room")
        return self


class Export(Section):
    """What is written beside the register."""

    map_width_px: Annotated[int, Field(strict=True, ge=200, le=20000)] = Field(2400, description="width of map.png")
    view_width_px: Annotated[int, Field(strict=True, ge=200, le=8000)] = Field(1600, description="width of view.png")
    view_height_px: Annotated[int, Field(strict=True, ge=200, le=8000)] = Field(1000, description="height of view.png")
    detail: Literal["full", "high", "medium", "low", "billboard", "point"] | None = Field(
        None, description="level of detail of plants in 3D files; each format's own if unset"
    )
    prototypes_max: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] | None = Field(
        None, description="most shapes of plants that a 3D file stores; each format's own if unset"
    )
    season: Literal["spring", "summer", "autumn", "winter"] = Field("summer", description="season that plants show")


_RULE_OVERRIDES: dict[str, Any] = {
    name: (item.rebuild_annotation() | None, Field(None, description=item.description))
    for name, item in Rules.model_fields.items()
    if name not in {"derive_street_lots", "treeless_road_kinds", "obstacle_clearance_m"}
}
ZoneRules = create_model("ZoneRules", __base__=Section, **_RULE_OVERRIDES)


def _zone_fields() -> dict[str, Any]:
    return {
        p.name: (
            Annotated[float, Field(strict=True, ge=p.minimum, le=p.maximum, allow_inf_nan=False)] | None,
            Field(None, description=f"{p.doc} [{p.unit}], paper's {p.symbol}, table range {p.low:g}-{p.high:g}"),
        )
        for p in PARAMETERS.values()
    }


class _ZoneBase(Section):
    strategy: dict[str, float] | None = Field(None, description="strategy names with weights")
    rules: ZoneRules | None = Field(None, description="planting rules of this zone alone")
    colour: str | None = Field(None, pattern=r"^#[0-9a-fA-F]{6}$", description="fill on the map")

    @field_validator("strategy", mode="before")
    @classmethod
    def _weights(cls, value: Any) -> Any:
        if isinstance(value, str):
            value = {value: 1.0}
        if isinstance(value, list):
            value = dict.fromkeys(value, 1.0)
        if isinstance(value, dict):
            value = {STRATEGY_LETTERS.get(str(name), str(name)): weight for name, weight in value.items()}
        return value

    @model_validator(mode="after")
    def _some_weight(self) -> _ZoneBase:
        if self.strategy is not None:
            if not all(0 <= weight <= 1e9 for weight in self.strategy.values()):
                raise ValueError("a strategy weight must be from 0 to 1e9")
            if not sum(self.strategy.values()) > 0:
                raise ValueError("at least one strategy needs a weight above 0")
        return self


Zone = create_model("Zone", __base__=_ZoneBase, **_zone_fields())


class Config(Section):
    """The whole config."""

    seed: Annotated[int, Field(strict=True, ge=0, le=2**63 - 1)] = Field(0, description="root of every random stream")
    rules: Rules = Rules()
    placement: Placement = Placement()
    coverage: Coverage = Coverage()
    regression: Regression = Regression()
    context: Context = Context()
    species: Species = Species()
    growth: Growth = Growth()
    export: Export = Export()
    zones: dict[str, Zone] = Field(default_factory=dict)

    def zone_value(self, zone: str, name: str) -> Any:
        """Return a zone's value of a field: its own, else the default zone's, else the parameter's default."""
        for key in (zone, "default"):
            table = self.zones.get(key)
            value = getattr(table, name, None) if table is not None else None
            if value is not None:
                return value
        return PARAMETERS[name].default if name in PARAMETERS else None

    def zone_rules(self, zone: str) -> Rules:
        """Return the rules in force in a zone."""
        rules = self.rules
        for key in ("default", zone):
            own = getattr(self.zones.get(key), "rules", None)
            if own is not None:
                rules = rules.model_copy(update=own.model_dump(exclude_none=True))
        return rules
