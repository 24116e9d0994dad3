"""What a reader says of a file that is not what it should be, in words for people who never saw the program."""

from __future__ import annotations

import json

JSON_KINDS = {dict: "an object", list: "a list", str: "text", bool: "true or false", int: "a number", float: "a number"}


def in_words(error: Exception) -> str:
    """Say what is wrong with a file that made a reader stumble; errors that a reader words itself stay as they are."""
    if isinstance(error, json.JSONDecodeError):
        return f"no whole JSON, {error}"
    if isinstance(error, UnicodeDecodeError):
        return f"no UTF-8 text, byte {error.start}"
    if isinstance(error, KeyError):
        return f"{str(error.args[0])[:50]!r} is missing" if error.args else "something is missing"
    if isinstance(error, IndexError):
        return "a list is shorter than it should be"
    if isinstance(error, RecursionError):
        return "values too deep in one another"
    if isinstance(error, OverflowError):
        return "a number beyond all bounds"
    if isinstance(error, TypeError | AttributeError):
        return "a value is of another kind than it should be"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error)


def kind_of(value: object) -> str:
    """Say what a value of JSON is."""
    return JSON_KINDS.get(type(value), "nothing")
