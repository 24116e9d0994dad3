"""Numbers as text, fast: rows of decimals between pieces of text, as OBJ and JSON have them by the million."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

DIGITS_MAX = 19
NUMBER_MAX = DIGITS_MAX + 2  # with its sign and point
LARGEST = 2.0**62
ROWS_AT_ONCE = 100_000


def decimal_rows(numbers: NDArray[Any], decimals: int, pieces: Sequence[str]) -> bytes:
    """Return rows of numbers as text.

    Parameters
    ----------
    numbers
        (n, k) whole numbers; floats are taken in steps of 10^-decimals, to the nearest.
    decimals
        Digits after the point, one for all numbers.
    pieces
        k + 1 texts: before the first number of a row, between them, after the last.

    Returns
    -------
    bytes
        Trailing zeros after the point are left out, and the point with them.

    Raises
    ------
    ValueError
        A number is not finite, or too large for its digits.
    """
    encoded = [np.frombuffer(piece.encode(), np.uint8) for piece in pieces]
    offsets = np.concatenate([[0], np.cumsum([len(piece) for piece in encoded])]).astype(np.int64)
    letters = np.concatenate(encoded)
    rows = np.asarray(numbers)
    text = np.empty(min(len(rows), ROWS_AT_ONCE) * (len(letters) + rows.shape[1] * (NUMBER_MAX + decimals)), np.uint8)
    texts = []
    for start in range(0, len(rows), ROWS_AT_ONCE):
        some = _whole(rows[start : start + ROWS_AT_ONCE], decimals)
        texts.append(text[: _fill(some, decimals, letters, offsets, text)].tobytes())
    return b"".join(texts)


def _whole(rows: NDArray[Any], decimals: int) -> NDArray[np.int64]:
    """Return numbers in steps of their last digit."""
    if rows.dtype.kind == "f":
        rows = np.rint(rows * 10.0**decimals)
        if not (np.abs(rows) < LARGEST).all():
            raise ValueError("numbers that cannot be written")
    return np.ascontiguousarray(rows, dtype=np.int64)


@njit(cache=True, nogil=True)
def _fill(rows, decimals, letters, offsets, text):
    digits = np.empty(NUMBER_MAX, np.uint8)
    zero, ten, zero_letter = np.uint64(0), np.uint64(10), np.uint64(48)
    place = 0
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1] + 1):
            for letter in range(offsets[k], offsets[k + 1]):
                text[place] = letters[letter]
                place += 1
            if k == rows.shape[1]:
                continue
            if rows[i, k] < 0:
                text[place] = 45  # minus
                place += 1
            value = np.uint64(abs(rows[i, k]))
            after = decimals
            count = 0
            while value > zero or count <= after:
                above = value // ten
                digit = value - above * ten
                value = above
                if digit == zero and count == 0 and after > 0:
                    after -= 1
                    continue
                digits[count] = np.uint8(zero_letter + digit)
                count += 1
            for number in range(count - 1, -1, -1):
                text[place] = digits[number]
                place += 1
                if number == after and after > 0:
                    text[place] = 46  # point
                    place += 1
    return place
