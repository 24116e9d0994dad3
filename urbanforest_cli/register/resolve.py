"""Which zone, strategy and values are in force in each lot: its own column, else its zone's, else the default."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES, STRATEGY_LETTERS, Parameter
from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.schema import RESOLVED_PREFIX
from urbanforest_cli.core.zones import FALLBACK_ZONE, ZONES

FAULTS_SHOWN = 10
DEFAULT_STRATEGY = "random"


def known_zones(config: Config) -> tuple[str, ...]:
    """Return the zones a lot may have: the five, and those of the config."""
    return (*ZONES, *(name for name in config.zones if name not in ZONES and name != "default"))


def match_zones(
    zones: Iterable[Any], ids: Sequence[str] | NDArray[Any], config: Config, notices: Notices
) -> NDArray[np.object_]:
    """Return each lot's zone by its proper name; case and surrounding blanks do not count.

    A lot without a zone, or with one that nobody knows, is of zone ``other``, which is counted.
    """
    names = {name.casefold(): name for name in known_zones(config)}
    codes, uniques = pd.factorize(pd.Series(list(zones), dtype=object), use_na_sentinel=True)
    labels = np.asarray(ids, dtype=object)
    matched = np.full(len(uniques) + 1, FALLBACK_ZONE, dtype=object)
    for code, zone in enumerate(uniques):
        found = names.get(str(zone).strip().casefold())
        if found is not None:
            matched[code] = found
            continue
        rows = codes == code
        if str(zone).strip():
            message = "lots of an unknown zone, taken as 'other'"
            notices.add("W_ZONE_UNKNOWN", message, int(rows.sum()), [repr(str(zone))])
        else:
            codes[rows] = -1
    blank = codes == -1
    notices.add("W_ZONE_MISSING", "lots without a zone, taken as 'other'", int(blank.sum()), labels[blank])
    return np.asarray(matched[codes])


def resolve_parameters(
    own: pd.DataFrame,
    ids: Sequence[str] | NDArray[Any],
    zones: NDArray[np.object_],
    config: Config,
    *,
    seed: int,
    notices: Notices,
    known_strategies: Sequence[str] = STRATEGIES,
    base: pd.DataFrame | None = None,
    source: str = "lot",
    where: object = None,
) -> pd.DataFrame:
    """Return one row a lot: strategy, source, and each parameter's value.

    Parameters
    ----------
    own
        (n rows) columns of the lots that bear a parameter's name, or ``strategy``; an empty cell is not set (nor is
        a NaN, which most files do not tell from it).
    ids, zones
        (n,) each lot's id and matched zone.
    base
        (n rows) rows of an earlier result to start from instead of the zone's values, where ``strategy`` is set.
    source
        What the column ``source`` says where a lot sets anything itself.

    Raises
    ------
    InputError
        A value that is no number or outside its limits, or an unknown strategy; the first ten are shown.
    ConfigError
        The config names a strategy that does not exist.
    """
    labels = np.asarray(ids, dtype=object)
    columns: dict[str, Any] = {"lot_id": labels}
    faults: list[str] = []
    touched = np.zeros(len(labels), dtype=bool)
    strategy = draw_strategies(labels, zones, config, seed=seed, known_strategies=known_strategies)
    based = np.zeros(len(labels), dtype=bool) if base is None else base["strategy"].notna().to_numpy()
    if base is not None:
        strategy[based] = base["strategy"].to_numpy(dtype=object)[based]
    if "strategy" in own:
        chosen, given = _own_strategies(own["strategy"], labels, known_strategies, faults)
        strategy[given] = chosen[given]
        touched |= given
    columns["strategy"] = strategy
    columns["source"] = ""
    for name, parameter in PARAMETERS.items():
        values = _by_zone(zones, name, config)
        if base is not None:
            values[based] = base[name].to_numpy(dtype=np.float64)[based]
        if name in own:
            numbers, given = _own_numbers(own[name], labels, parameter, faults)
            values[given] = numbers[given]
            touched |= given
        columns[name] = values
    if faults:
        more = f"\n            and {len(faults) - FAULTS_SHOWN} more" if len(faults) > FAULTS_SHOWN else ""
        raise InputError(
            "columns that set parameters hold values that cannot be used",
            where=where,
            found="\n            ".join(faults[:FAULTS_SHOWN]) + more,
            next_step="correct them, or leave the cell empty for the value of the lot's zone",
        )
    columns["source"] = np.where(touched, source, "zone").astype(object)
    for name, parameter in PARAMETERS.items():
        outside = (columns[name] < parameter.low) | (columns[name] > parameter.high)
        notices.add(
            f"W_RANGE_{name.upper()}",
            f"lots with {name} outside {parameter.low:g} to {parameter.high:g} {parameter.unit}",
            int(outside.sum()),
            labels[outside],
        )
    return pd.DataFrame(columns)


def with_resolved(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return the register's layer ``parameters`` before any diffusion: values in force equal values resolved."""
    table = parameters.assign(context_lot_count=np.int64(1))
    resolved = table[list(PARAMETERS)].add_prefix(RESOLVED_PREFIX)
    return pd.concat((table[["lot_id", "strategy", "source", "context_lot_count", *PARAMETERS]], resolved), axis=1)


def draw_strategies(
    ids: NDArray[np.object_],
    zones: NDArray[np.object_],
    config: Config,
    *,
    seed: int,
    known_strategies: Sequence[str] = STRATEGIES,
) -> NDArray[np.object_]:
    """Draw each lot's strategy by the weights of its zone, from a stream keyed by the lot's id.

    Raises
    ------
    ConfigError
        A weight is given to a strategy that does not exist.
    """
    drawn = np.full(len(ids), DEFAULT_STRATEGY, dtype=object)
    ranks = {name: rank for rank, name in enumerate(STRATEGIES)}
    for zone in sorted(set(zones)):
        weights = config.zone_value(zone, "strategy") or {DEFAULT_STRATEGY: 1.0}
        names = sorted(weights, key=lambda name: (ranks.get(name, len(ranks)), name))
        unknown = [name for name in names if name not in known_strategies]
        if unknown:
            raise ConfigError(
                "unknown strategy",
                where=f"zones.{zone}.strategy",
                found=", ".join(repr(name) for name in unknown),
                expected=", ".join(known_strategies),
            )
        rows = np.flatnonzero(zones == zone)
        if len(names) == 1:
            drawn[rows] = names[0]
            continue
        shares = np.cumsum([weights[name] for name in names])
        keys = keys_for(seed, "strategy", ids[rows])
        uniform = hash_uniform(keys, np.zeros(len(rows), dtype=np.int64)) * shares[-1]
        drawn[rows] = np.asarray(names, dtype=object)[np.searchsorted(shares, uniform, side="right")]
    return drawn


def _by_zone(zones: NDArray[np.object_], name: str, config: Config) -> NDArray[np.float64]:
    codes, uniques = pd.factorize(zones)
    return np.array([float(config.zone_value(zone, name)) for zone in uniques], dtype=np.float64)[codes]


def _own_strategies(
    column: pd.Series[Any], labels: NDArray[np.object_], known: Sequence[str], faults: list[str]
) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    given = column.notna().to_numpy() & (column.astype(str).str.strip() != "").to_numpy()
    names = {name.casefold(): name for name in known} | {k.casefold(): v for k, v in STRATEGY_LETTERS.items()}
    chosen = np.full(len(labels), "", dtype=object)
    for row in np.flatnonzero(given):
        text = str(column.iloc[row]).strip()
        if text.casefold() in names:
            chosen[row] = names[text.casefold()]
        else:
            faults.append(f"lot {labels[row]}: strategy is {text!r}, not one of {', '.join(known)}")
    return chosen, given


def _own_numbers(
    column: pd.Series[Any], labels: NDArray[np.object_], parameter: Parameter, faults: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    given = column.notna().to_numpy(copy=True)
    numbers = np.full(len(labels), np.nan)
    if pd.api.types.is_bool_dtype(column.dtype) or not pd.api.types.is_numeric_dtype(column.dtype):
        for row in np.flatnonzero(given):
            value = column.iloc[row]
            if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool | np.bool_):
                numbers[row] = float(value)
            else:
                faults.append(_fault(labels[row], parameter, value))
                given[row] = False
    else:
        numbers[given] = column[given].to_numpy(dtype=np.float64, na_value=np.nan)
    for row in np.flatnonzero(given & ~((numbers >= parameter.minimum) & (numbers <= parameter.maximum))):
        faults.append(_fault(labels[row], parameter, numbers[row]))
    return numbers, given


def _fault(label: str, parameter: Parameter, value: object) -> str:
    shown = repr(value) if isinstance(value, str) else str(value)
    return f"lot {label}: {parameter.name} is {shown}, not a number from {parameter.minimum:g} to {parameter.maximum:g}"
