"""Overture Maps: values nested in structs and lists."""

from __future__ import annotations

from typing import Any

import pandas as pd


def nested_values(column: pd.Series[Any], path: str) -> pd.Series[Any]:
    """Reach into nested values along a dotted path; a number picks from a list, and a missing step gives None.

    ``width_rules`` with ``0.value`` gives the width of a road's first rule.
    """
    values = [_reach(value, path.split(".")) for value in column]
    return pd.Series(values, index=column.index, name=path, dtype=object)


def _reach(value: Any, steps: list[str]) -> Any:
    for step in steps:
        if isinstance(value, dict):
            value = value.get(step)
        elif step.isdigit() and hasattr(value, "__len__") and not isinstance(value, str):
            value = value[int(step)] if int(step) < len(value) else None
        else:
            return None
    return value
