"""The mapping file of a source: which layers and columns become which layer of the city, and what a zone code means."""

from __future__ import annotations

import fnmatch
import unicodedata
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

ROLES = ("lots", "zoning", "buildings", "roads", "driveways", "entrances", "obstacles", "sketches", "observed_plants")
Kind = Literal["polygon", "line", "point"]
DEFAULT_KINDS: dict[str, tuple[Kind, ...]] = {
    "lots": ("polygon",),
    "zoning": ("polygon",),
    "buildings": ("polygon",),
    "roads": ("line", "polygon"),
    "driveways": ("polygon", "line"),
    "entrances": ("point", "line"),
    "obstacles": ("point", "line", "polygon"),
    "sketches": ("polygon",),
    "observed_plants": ("point", "line"),
}


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, str | int | float) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_as_list)]
Positive = Annotated[float, Field(gt=0, le=1000)]


def folded(text: object) -> str:
    """Return a text as codes are compared: no accents, no capitals, no blanks at the ends."""
    plain = unicodedata.normalize("NFKD", str(text))
    return "".join(character for character in plain if not unicodedata.combining(character)).casefold().strip()


def code_text(value: object) -> str | None:
    """Return a cell as the text of a code, None where it is empty; 3.0 reads as 3."""
    if value is None or (isinstance(value, float) and value != value):
        return None
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    text = str(value).strip()
    return text if text and text != "<NA>" else None


def matches(text: str | None, patterns: tuple[str, ...]) -> bool:
    """Tell whether a code fits one of the patterns; ``*`` alone means any code, an empty cell fits none."""
    return text is not None and any(fnmatch.fnmatchcase(folded(text), folded(pattern)) for pattern in patterns)


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)


class ZoneCodes(_Table):
    """What the codes of one column mean."""

    column: Names = Field(description="names the column may bear, the first found is taken")
    codes: dict[str, str] = Field(description="code, or a pattern with * and ?, to the name of a zone")

    @cached_property
    def _exact(self) -> dict[str, str]:
        return {folded(code): zone for code, zone in self.codes.items()}

    def zone_of(self, code: str) -> str | None:
        """Return a code's zone: its own entry, else that of the first pattern it fits."""
        text = folded(code)
        if text in self._exact:
            return self._exact[text]
        fitting = (zone for pattern, zone in self._exact.items() if fnmatch.fnmatchcase(text, pattern))
        return next(fitting, None)


class LayerRule(_Table):
    """Which rows of which layers become one layer of the city, and how."""

    layers: Names = Field(description="patterns of layer or file names")
    kinds: tuple[Kind, ...] | None = Field(None, description="kinds of geometry taken")
    where: dict[str, Names] = Field(
        default_factory=dict, description="column, or columns parted by |, to patterns, one of which must fit"
    )
    unless: dict[str, Names] = Field(default_factory=dict, description="the same, none of which may fit")
    fallback: bool = Field(False, description="only where no earlier rule found rows")

    id: Names = Field((), description="column with the identifier")
    zones: tuple[ZoneCodes, ...] = Field((), description="columns with zone codes, in the order they are asked")
    ignore_unknown: bool = Field(False, description="leave rows whose zone codes are not listed")
    height: Names = Field((), description="column with a height")
    height_factor: Positive = Field(1.0, description="metres in one unit of a bare number in that column")
    levels: Names = Field((), description="column with a number of storeys, used where the height is unknown")
    level_height_m: Positive = Field(3.0, description="height of a storey")
    width: Names = Field((), description="column with a width")
    lanes: Names = Field((), description="column with a number of lanes, used where the width is unknown")
    lane_width_m: Positive = Field(3.25, description="width of a lane")
    widths: dict[str, Positive] = Field(default_factory=dict, description="width by kind where the rest is unknown")
    kind: Names = Field((), description="column with the kind")
    kinds_of: dict[str, str] = Field(default_factory=dict, description="kind in the source to kind in the city")
    kind_value: str | None = Field(None, description="kind of all rows")
    clearance: Names = Field((), description="column with a clearance in metres")
    species: Names = Field((), description="column with a species")
    spacing_m: Positive = Field(8.0, description="distance of trees along a row given as a line")
    keep: Names = Field((), description="further columns to keep")


class Profile(_Table):
    """A whole mapping file."""

    title: str = Field("", description="what the source is")
    lots: tuple[LayerRule, ...] = ()
    zoning: tuple[LayerRule, ...] = ()
    buildings: tuple[LayerRule, ...] = ()
    roads: tuple[LayerRule, ...] = ()
    driveways: tuple[LayerRule, ...] = ()
    entrances: tuple[LayerRule, ...] = ()
    obstacles: tuple[LayerRule, ...] = ()
    sketches: tuple[LayerRule, ...] = ()
    observed_plants: tuple[LayerRule, ...] = ()

    def rules(self, role: str) -> tuple[LayerRule, ...]:
        """Return the rules of a layer of the city."""
        found: tuple[LayerRule, ...] = getattr(self, role)
        return found


def zone_by_codes(rule: LayerRule, codes: list[str | None]) -> tuple[str | None, str | None]:
    """Find the zone of one row.

    Parameters
    ----------
    rule
        Whose ``zones`` are asked in their order.
    codes
        The row's code in the column of each of them.

    Returns
    -------
    The zone, None where no code is known; and the code that decided, else the first one there is. Where several
    columns are asked, the code says which: ``landuse=forest``.
    """
    shown = None
    for table, code in zip(rule.zones, codes, strict=True):
        if code is None:
            continue
        named = f"{table.column[0]}={code}" if len(rule.zones) > 1 else code
        zone = table.zone_of(code)
        if zone is not None:
            return zone, named
        shown = shown or named
    return None, shown
