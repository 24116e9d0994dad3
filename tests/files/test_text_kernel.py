import numpy as np
import pytest

from urbanforest_cli.files import text_kernel
from urbanforest_cli.files.text_kernel import decimal_rows


def test_numbers_read_back_as_they_were_to_the_last_digit():
    rng = np.random.default_rng(0)
    numbers = np.concatenate([rng.uniform(-1e6, 1e6, (500, 3)), rng.uniform(-1e-2, 1e-2, (500, 3)), np.zeros((1, 3))])
    text = decimal_rows(numbers, 4, ["", " ", " ", "\n"]).decode()
    back = np.array([line.split() for line in text.splitlines()], dtype=float)
    assert np.abs(back - numbers).max() <= 0.5001e-4


def test_texts_are_short_and_plain():
    text = decimal_rows(np.array([[1.5, -0.0, 100.0, -0.25, 0.001, 1e-9]]), 3, ["<", *",,,,,", ">"])
    assert text == b"<1.5,0,100,-0.25,0.001,0>"


def test_whole_numbers_are_written_whole_even_the_largest():
    top = 2**62
    assert (
        decimal_rows(np.array([[0, -7, top, -top]]), 0, ["f ", "/", "/", "/", "\n"])
        == f"f 0/-7/{top}/-{top}\n".encode()
    )


def test_no_rows_are_no_text():
    assert decimal_rows(np.zeros((0, 3)), 2, ["a", "b", "c", "d"]) == b""


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e18])
def test_what_cannot_be_written_is_refused(bad):
    with pytest.raises(ValueError, match="cannot be written"):
        decimal_rows(np.array([[bad]]), 3, ["", ""])


def test_batches_make_no_difference(monkeypatch):
    numbers = np.random.default_rng(1).normal(0, 100, (50, 2))
    whole = decimal_rows(numbers, 3, ["(", ",", ")"])
    monkeypatch.setattr(text_kernel, "ROWS_AT_ONCE", 7)
    assert decimal_rows(numbers, 3, ["(", ",", ")"]) == whole
