"""Species files: one small TOML a species, in the shipped folder and in one of the user's own."""

from __future__ import annotations

import difflib
import json
import tomllib
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.errors import ConfigError
from urbanforest_cli.core.habits import usual_growth, usual_sizes
from urbanforest_cli.core.species import Catalogue, Species
from urbanforest_cli.core.traits import OpenGrown, Traits
from urbanforest_cli.files.configs import configs_folder

SPECIES_BYTES_LIMIT = 100_000

_Name = Annotated[str, Field(min_length=1, max_length=200)]
_HardinessZone = Annotated[int, Field(ge=1, le=13)]
_STRICT = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True, allow_inf_nan=False)
_Sizes = Annotated[tuple[Annotated[float, Field(strict=True, ge=0, le=130)], ...], Field(min_length=1, max_length=101)]


class OpenGrownTable(BaseModel):
    """The keys of the table growth.open_grown."""

    model_config = _STRICT

    age_years: _Sizes
    height_m: _Sizes
    crown_radius_m: _Sizes
    crown_base_m: _Sizes

    @model_validator(mode="after")
    def _columns_agree(self) -> OpenGrownTable:
        ages = self.age_years
        if ages[0] != 0 or any(later <= age for age, later in pairwise(ages)):
            raise ValueError("age_years must ascend from 0")
        lengths = {name: len(getattr(self, name)) for name in OpenGrownTable.model_fields}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"each key needs as many sizes as there are ages; found {lengths}")
        if any(base > top for base, top in zip(self.crown_base_m, self.height_m, strict=True)):
            raise ValueError("crown_base_m is above height_m")
        return self


def _trait_keys() -> dict[str, Any]:
    """One optional number a trait, within the bounds that the trait declares."""
    keys = {}
    for item in fields(Traits):
        bounds = Field(strict=True, ge=item.metadata["low"], le=item.metadata["high"])
        keys[item.name] = (Annotated[float, bounds] | None, None)
    return keys


GrowthTable = create_model("GrowthTable", __config__=_STRICT, **_trait_keys(), open_grown=(OpenGrownTable | None, None))
GrowthTable.__doc__ = "The keys of the table growth: the traits, each optional, and the sizes they lead to."


class SpeciesFile(BaseModel):
    """The keys of a species file."""

    model_config = _STRICT

    id: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    scientific_name: _Name
    common_name: _Name
    habit: Literal["tree", "shrub"]
    mature_height_m: Annotated[float, Field(gt=0, le=130)]
    mature_crown_diameter_m: Annotated[float, Field(gt=0, le=60)]
    envelope_radius_m: Annotated[float, Field(gt=0, le=50)]
    lifespan_years: Annotated[float, Field(gt=0, le=5000)]
    hardiness_zone_min: _HardinessZone
    hardiness_zone_max: _HardinessZone
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
    source: Annotated[str, Field(min_length=1, max_length=2000)]
    growth: GrowthTable | None = None

    @model_validator(mode="after")
    def _zones_in_order(self) -> SpeciesFile:
        if self.hardiness_zone_min > self.hardiness_zone_max:
            raise ValueError("hardiness_zone_min is above hardiness_zone_max")
        return self


_TABLES: dict[str, type[BaseModel]] = {"": SpeciesFile, "growth": GrowthTable, "growth.open_grown": OpenGrownTable}


def species_folder() -> Path:
    """Return the folder of the shipped species."""
    return configs_folder() / "species"


def load_catalogue(species: settings.Species) -> Catalogue:
    """Load the species of a city: those shipped, those of the user's folder, then the config's choice of them.

    A species of the user's folder replaces a shipped one of the same id.

    Raises
    ------
    ConfigError
        With every mistake found in any file and in the choice, one a line.
    """
    mistakes: list[str] = []
    found = {item.id: item for item in _read_folder(species_folder(), mistakes)}
    if species.folder is not None:
        folder = Path(species.folder).expanduser()
        if folder.is_dir():
            own = _read_folder(folder, mistakes)
            if not own and not mistakes:
                mistakes.append(f"species.folder: no *.toml in {folder}")
            found |= {item.id: item for item in own}
        else:
            mistakes.append(f"species.folder: no such folder {folder}")
    named = [("species.names", name) for name in species.names or ()]
    if species.dominant is not None:
        named.append(("species.dominant", species.dominant))
    for key, name in named:
        if name not in found:
            near = difflib.get_close_matches(name, found, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known species: {', '.join(sorted(found))}"
            mistakes.append(f"{key}: unknown species {name!r}; {hint}")
    if mistakes:
        raise _all_mistakes(mistakes)
    return _choose(Catalogue(found.values()), species)


def _choose(catalogue: Catalogue, species: settings.Species) -> Catalogue:
    chosen = catalogue if species.names is None else catalogue.named(species.names)
    if species.hardiness_zone is not None:
        chosen = chosen.hardy_in(species.hardiness_zone)
    if not len(chosen):
        zone = "" if species.hardiness_zone is None else f" in hardiness zone {species.hardiness_zone}"
        raise _all_mistakes([f"species: none of the species chosen lives{zone}"])
    if species.dominant is not None and species.dominant not in chosen:
        chosen_ids = ", ".join(chosen.ids)
        raise _all_mistakes([f"species.dominant: {species.dominant!r} is not among the city's species: {chosen_ids}"])
    return chosen


def _read_folder(folder: Path, mistakes: list[str]) -> list[Species]:
    read = []
    for path in sorted(folder.glob("*.toml")):
        species = _read_file(path, mistakes)
        if species is not None:
            read.append(species)
    return read


def _read_file(path: Path, mistakes: list[str]) -> Species | None:
    if not path.is_file() or path.stat().st_size > SPECIES_BYTES_LIMIT:
        mistakes.append(f"{path}: not a plain file of at most {SPECIES_BYTES_LIMIT} bytes")
        return None
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        checked = SpeciesFile.model_validate(table)
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError, OSError) as error:
        mistakes.append(f"{path}: not readable as TOML: {error}")
        return None
    except ValidationError as error:
        mistakes += [_mistake(path, item) for item in error.errors(include_url=False)]
        return None
    if checked.id != path.stem:
        mistakes.append(f"{path}: id: must be the file's name {path.stem!r}; found {checked.id!r}")
        return None
    return _species(checked)


def _species(checked: SpeciesFile) -> Species:
    """Build a species; what its file leaves unsaid of its growth is that of a usual tree or shrub of its size."""
    said = {} if checked.growth is None else checked.growth.model_dump(exclude_none=True)
    sizes = said.pop("open_grown", None)
    traits = replace(usual_growth(checked.habit, checked.mature_height_m, checked.mature_crown_diameter_m), **said)
    if sizes is None:
        open_grown = usual_sizes(
            checked.habit,
            mature_height_m=checked.mature_height_m,
            mature_crown_diameter_m=checked.mature_crown_diameter_m,
            clear_stem_m=traits.clear_stem_m,
        )
    else:
        open_grown = OpenGrown(**sizes)
    return Species(**checked.model_dump(exclude={"growth"}), growth=traits, open_grown=open_grown)


def _mistake(path: Path, item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    where = f"{path}: {key}" if key else str(path)
    if item["type"] == "extra_forbidden":
        table = _TABLES[key.rpartition(".")[0]]
        near = difflib.get_close_matches(str(item["loc"][-1]), table.model_fields, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(table.model_fields)}"
        return f"{where}: unknown key; {hint}"
    if item["type"] == "missing":
        return f"{where}: key is missing"
    message = item["msg"].removeprefix("Value error, ")
    found = "" if isinstance(item["input"], dict) else f"; found {json.dumps(item['input'], default=str)[:80]}"
    return f"{where}: {message[0].lower()}{message[1:]}{found}"


def _all_mistakes(mistakes: list[str]) -> ConfigError:
    count = len(mistakes)
    return ConfigError(
        "\n  - ".join([f"{count} {'mistake' if count == 1 else 'mistakes'} in the species:", *mistakes]),
        next_step=f"compare with a species file in {species_folder()}",
    )
