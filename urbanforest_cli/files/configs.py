"""Configs: TOML files, environment and options laid over one another and checked whole."""

from __future__ import annotations

import difflib
import json
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

import urbanforest_cli
from urbanforest_cli.core.config import Config, Zone
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.params import STRATEGIES, STRATEGY_LETTERS

ENVIRONMENT_PREFIX = "URBANFOREST_"
CONFIG_BYTES_LIMIT = 1_000_000

Origins = dict[str, str]


def configs_folder() -> Path:
    """Return the folder of shipped configs: inside an installed package, or beside it in a checkout."""
    package = Path(urbanforest_cli.__file__).parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def default_config_path() -> Path:
    """Return the config that holds the values of the zones."""
    return configs_folder() / "default.toml"


@dataclass(frozen=True)
class LoadedConfig:
    """A config and, for each value set somewhere, where it was set last."""

    config: Config
    origins: Origins


def load_config(
    path: Path | None = None,
    *,
    settings: Sequence[str] = (),
    seed: int | None = None,
    known_strategies: Sequence[str] = STRATEGIES,
    environment: Mapping[str, str] | None = None,
    base: Mapping[str, Any] | None = None,
) -> LoadedConfig:
    """Load the config in force: option over environment over file over default.

    A file that has a table ``[zones.default]`` speaks for all zones: shipped tables of zones it does not name are
    left out. A file without one changes only what it names.

    Parameters
    ----------
    path
        A config file, the name of a shipped one (``paper/positional_a``), or None.
    settings
        Options of the form ``rules.building_clearance_m=5``.
    base
        The config that made a register, to go on with instead of the default.

    Raises
    ------
    ConfigError
        With every mistake found, one a line, each with its origin and a suggestion.
    """
    merged = read_toml(default_config_path()) if base is None else deepcopy(dict(base))
    origins = dict.fromkeys(_leaves(merged), "default" if base is None else "register")
    if path is not None:
        path = find_config(path)
        own = read_toml(path)
        zones = own.get("zones")
        if isinstance(zones, dict) and "default" in zones:
            merged["zones"] = {}
            origins = {key: origin for key, origin in origins.items() if not key.startswith("zones.")}
        _lay_over(merged, own, origins, str(path))
    for key, value, origin in _environment_values(os.environ if environment is None else environment):
        _set_dotted(merged, key, value, origins, origin)
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator or not key.strip():
            raise ConfigError(
                "not a setting",
                where="--set",
                found=setting,
                expected="SECTION.KEY=VALUE, for example rules.building_clearance_m=5",
            )
        _set_dotted(merged, key.strip(), _parse_value(text.strip()), origins, "--set")
    if seed is not None:
        merged["seed"] = seed
        origins["seed"] = "--seed"
    return LoadedConfig(_validate(merged, origins, known_strategies), origins)


def find_config(path: Path) -> Path:
    """Return a config file: as given, or by its name among the shipped ones."""
    shipped = configs_folder() / path.with_suffix(".toml")
    if not path.exists() and not path.is_absolute() and ".." not in path.parts and shipped.is_file():
        return shipped
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    ConfigError
        It is not there, not a plain file, too large, not UTF-8 or not TOML.
    """
    if not path.is_file():
        names = sorted(str(p.relative_to(configs_folder()).with_suffix("")) for p in configs_folder().glob("*/*.toml"))
        near = difflib.get_close_matches(str(path), names, n=3)
        raise ConfigError(
            "no such file" if not path.exists() else "not a plain file",
            where=path,
            next_step=f"did you mean {', '.join(near)}?" if near else "write one with `urbanforest config init`",
        )
    if path.stat().st_size > CONFIG_BYTES_LIMIT:
        raise ConfigError("too large for a config", where=path, expected=f"at most {CONFIG_BYTES_LIMIT} bytes")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(
            "not readable as TOML", where=path, found=str(error), next_step="see `urbanforest config show` for the form"
        ) from error
    except OSError as error:
        raise InputError("cannot be read", where=path, found=error.strerror) from error


def _leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield prefix + key


def _lay_over(base: dict[str, Any], over: Mapping[str, Any], origins: Origins, origin: str, prefix: str = "") -> None:
    for key, value in over.items():
        replaced = prefix.startswith("zones.") and key == "strategy"
        if isinstance(value, dict) and isinstance(base.get(key), dict) and not replaced:
            _lay_over(base[key], value, origins, origin, f"{prefix}{key}.")
        else:
            base[key] = value
            for name in [name for name in origins if name == prefix + key or name.startswith(f"{prefix}{key}.")]:
                del origins[name]
            origins.update(dict.fromkeys(_leaves({key: value}, prefix), origin))


def _set_dotted(table: dict[str, Any], key: str, value: Any, origins: Origins, origin: str) -> None:
    nested: dict[str, Any] = {}
    inner = nested
    *parents, last = key.split(".")
    for parent in parents:
        inner = inner.setdefault(parent, {})
    inner[last] = value
    _lay_over(table, nested, origins, origin)


def _environment_values(environment: Mapping[str, str]) -> Iterator[tuple[str, Any, str]]:
    sections = {name.upper() for name in Config.model_fields}
    for name in sorted(environment):
        if not name.startswith(ENVIRONMENT_PREFIX):
            continue
        parts = name.removeprefix(ENVIRONMENT_PREFIX).split("__")
        if parts[0] in sections and (len(parts) > 1 or parts[0] == "SEED"):
            yield ".".join(parts).lower(), _parse_value(environment[name]), name


def _parse_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _validate(merged: dict[str, Any], origins: Origins, known_strategies: Sequence[str]) -> Config:
    mistakes = _unknown_strategies(merged.get("zones"), known_strategies)
    try:
        config = Config.model_validate(merged)
    except ValidationError as error:
        mistakes += [_mistake(item, origins) for item in error.errors(include_url=False)]
        raise _all_mistakes(mistakes) from error
    if mistakes:
        raise _all_mistakes(mistakes)
    return config


def _unknown_strategies(zones: Any, known: Sequence[str]) -> list[str]:
    mistakes = []
    for zone, table in zones.items() if isinstance(zones, dict) else ():
        named = table.get("strategy") if isinstance(table, dict) else None
        names = [named] if isinstance(named, str) else list(named) if isinstance(named, list | dict) else []
        for name in names:
            if name not in known and name not in STRATEGY_LETTERS:
                near = difflib.get_close_matches(str(name), known, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                mistakes.append(f"zones.{zone}.strategy: unknown strategy {name!r}; there are {', '.join(known)}{hint}")
    return mistakes


def _mistake(item: Any, origins: Origins) -> str:
    location = [str(part) for part in item["loc"]]
    key = ".".join(location)
    origin = next((where for name, where in origins.items() if name == key or name.startswith(f"{key}.")), None)
    if origin is None:
        origin = next((where for name, where in origins.items() if key.startswith(f"{name}.")), "config")
    if item["type"] == "extra_forbidden":
        known = _known_keys(location[:-1])
        near = difflib.get_close_matches(location[-1], known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(known)}"
        return f"{key}: unknown key ({origin}); {hint}"
    shown = json.dumps(item["input"], default=str)
    return f"{key}: {item['msg'][0].lower()}{item['msg'][1:]} ({origin}); found {shown[:80]}"


def _known_keys(location: Sequence[str]) -> list[str]:
    model: type[BaseModel] = Config
    for part in location:
        if part == "zones" and model is Config:
            model = Zone
            continue
        field = model.model_fields.get(part)
        annotation = field.annotation if field is not None else None
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), model)
    return list(model.model_fields)


def _all_mistakes(mistakes: list[str]) -> ConfigError:
    count = len(mistakes)
    return ConfigError(
        "\n  - ".join([f"{count} {'mistake' if count == 1 else 'mistakes'} in the config:", *mistakes]),
        next_step="see all keys with `urbanforest config schema`, all values with `urbanforest config show`",
    )
