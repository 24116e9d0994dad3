"""OpenStreetMap as GDAL gives it: a few tags as columns, the rest packed into one text."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

import pandas as pd

TAGS_COLUMN = "other_tags"
_PAIR = re.compile(r'"((?:[^"\\]|\\.)*)"\s*=>\s*(?:"((?:[^"\\]|\\.)*)"|NULL)')


@lru_cache(maxsize=4096)
def unpack_tags(text: str) -> dict[str, str]:
    """Read packed tags, ``"height"=>"12","note"=>"a \\"b\\""``, by key."""
    return {_plain(key): _plain(value) for key, value in _PAIR.findall(text)}


def _plain(text: str) -> str:
    return re.sub(r"\\(.)", r"\1", text)


def tag_values(packed: pd.Series[Any], key: str) -> pd.Series[Any]:
    """Return the values of one tag, None where a row does not bear it."""
    mark = f'"{key}"'
    values = [unpack_tags(text).get(key) if isinstance(text, str) and mark in text else None for text in packed]
    return pd.Series(values, index=packed.index, name=key, dtype=object)
