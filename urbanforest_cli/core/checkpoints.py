"""A training between two epochs as bytes: a line that tells what it is, a checksum, and what was packed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

MAGIC = b"urbanforest checkpoint 1\n"
DIGEST_CHARACTERS = 64


def seal(packed: bytes) -> bytes:
    """Put the line and the checksum before what was packed."""
    return MAGIC + hashlib.sha256(packed).hexdigest().encode() + b"\n" + packed


def unseal(content: bytes) -> bytes:
    """Return what was packed.

    Raises
    ------
    ValueError
        It is no checkpoint, or not a whole one.
    """
    if not content.startswith(MAGIC):
        raise ValueError("it does not begin as a checkpoint does")
    start = len(MAGIC) + DIGEST_CHARACTERS + 1
    if hashlib.sha256(content[start:]).hexdigest().encode() + b"\n" != content[len(MAGIC) : start]:
        raise ValueError("its checksum does not fit its content")
    return content[start:]


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Tell which values of two nested tables differ, as `name: before, now`."""
    found = []
    for name in sorted(before.keys() | now.keys()):
        old, new = before.get(name), now.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            found += differences(old, new)
        elif old != new:
            found.append(f"{name} was {_short(old)}, is {_short(new)}")
    return found


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
