"""Words and numbers as pictures and pages show them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


def counted(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def printable(text: str) -> str:
    """Return text without line breaks and control characters."""
    return "".join(letter if letter.isprintable() else " " if letter.isspace() else "\ufffd" for letter in text)


def shortened(text: str, letters: int) -> str:
    """Return text of at most so many letters, cut with an ellipsis."""
    return text if len(text) <= letters else text[: letters - 1].rstrip() + "\u2026"


def place_name(stem: str) -> str:
    """Return a file's name as the name of a place."""
    words = stem.replace("_", " ").strip() or stem
    return words[:1].upper() + words[1:]


def round_length(metres: float) -> float:
    """Return the largest length of 1, 2 or 5 times a power of ten that is no longer than a length."""
    power = 10.0 ** np.floor(np.log10(max(metres, 1e-6)))
    return float(max(step * power for step in (1, 2, 5) if step * power <= metres * (1 + 1e-9)))


def length_text(metres: float, *, unit_of: float) -> str:
    """Return a length in metres, or in kilometres where the length it belongs to is two of them or more."""
    return f"{metres / 1000:g} km" if unit_of >= 2000 else f"{metres:g} m"


@contextmanager
def boxes_for_unknown_letters() -> Iterator[None]:
    """Let letters that the font lacks appear as boxes, without a warning each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .* missing from font")
        yield
