"""The species of a city: what a plant may be, and how large it becomes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

from urbanforest_cli.core.traits import OpenGrown, Traits

Habit = Literal["tree", "shrub"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Species:
    """One species; mature sizes are those of a plant in a town, `open_grown` those its own growth leads to."""

    id: str
    scientific_name: str
    common_name: str
    habit: Habit
    mature_height_m: float
    mature_crown_diameter_m: float
    envelope_radius_m: float
    lifespan_years: float
    hardiness_zone_min: int
    hardiness_zone_max: int
    colour: str
    source: str
    growth: Traits
    open_grown: OpenGrown

    def lives_in(self, hardiness_zone: int) -> bool:
        """Tell whether the species lives in a USDA hardiness zone."""
        return self.hardiness_zone_min <= hardiness_zone <= self.hardiness_zone_max


@dataclass(frozen=True)
class Catalogue:
    """The species of a city, ordered by id; a species' place in that order is its index."""

    species: tuple[Species, ...]
    _index: dict[str, int] = field(init=False, repr=False, compare=False)

    def __init__(self, species: Iterable[Species]) -> None:
        ordered = tuple(sorted(species, key=lambda item: item.id))
        index = {item.id: number for number, item in enumerate(ordered)}
        if len(index) != len(ordered):
            raise ValueError("two species of a catalogue have the same id")
        object.__setattr__(self, "species", ordered)
        object.__setattr__(self, "_index", index)

    def __len__(self) -> int:
        return len(self.species)

    def __iter__(self) -> Iterator[Species]:
        return iter(self.species)

    def __contains__(self, species_id: object) -> bool:
        return species_id in self._index

    def __getitem__(self, species_id: str) -> Species:
        return self.species[self._index[species_id]]

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids in order."""
        return tuple(item.id for item in self.species)

    def index_of(self, species_id: str) -> int:
        """Return the index of a species; KeyError where there is none of that id."""
        return self._index[species_id]

    def trees(self) -> Catalogue:
        """Return the trees alone."""
        return Catalogue(item for item in self.species if item.habit == "tree")

    def shrubs(self) -> Catalogue:
        """Return the shrubs alone."""
        return Catalogue(item for item in self.species if item.habit == "shrub")

    def hardy_in(self, hardiness_zone: int) -> Catalogue:
        """Return the species that live in a USDA hardiness zone."""
        return Catalogue(item for item in self.species if item.lives_in(hardiness_zone))

    def named(self, ids: Iterable[str]) -> Catalogue:
        """Return the species of the ids given; KeyError where one is missing."""
        return Catalogue(self[species_id] for species_id in dict.fromkeys(ids))
