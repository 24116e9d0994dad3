"""Errors a user can cause, each saying what, where, found, expected and the next step."""

from __future__ import annotations

EXIT_INTERNAL = 1
EXIT_BAD_INPUT = 2
EXIT_PARTLY_DONE = 3
EXIT_IO = 74
EXIT_BUSY = 75


class UrbanForestError(Exception):
    """Base of every error this program raises on purpose.

    Parameters
    ----------
    what
        One sentence: what is wrong.
    where
        File, layer, column, row or config key.
    found, expected
        What stands there, and what should.
    next_step
        What to type or change.
    """

    exit_code = EXIT_BAD_INPUT

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        found: object = None,
        expected: object = None,
        next_step: str | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.found = found
        self.expected = expected
        self.next_step = next_step
        super().__init__(self.message())

    def message(self) -> str:
        """Join the five answers into the text a user reads."""
        lines = [f"{self.where}: {self.what}" if self.where is not None else self.what]
        if self.found is not None:
            lines.append(f"  found:    {self.found}")
        if self.expected is not None:
            lines.append(f"  expected: {self.expected}")
        if self.next_step is not None:
            lines.append(f"  next:     {self.next_step}")
        return "\n".join(lines)

    def as_record(self) -> dict[str, object]:
        """Return the same answers for ``--json``."""
        record: dict[str, object] = {"error": type(self).__name__, "what": self.what}
        for name in ("where", "found", "expected", "next_step"):
            value = getattr(self, name)
            if value is not None:
                record[name] = str(value)
        return record


class InputError(UrbanForestError):
    """An input file cannot be used."""


class CrsError(InputError):
    """Coordinates cannot be brought to metres."""


class LimitError(InputError):
    """An input is larger than a stated limit."""


class ConfigError(UrbanForestError):
    """A config, profile or option is wrong; the text lists every mistake found."""


class SchemaError(UrbanForestError):
    """A layer is missing or breaks its requirements; the text names the command that writes it."""


class StaleError(UrbanForestError):
    """An intermediate file belongs to another run or another version."""


class OutputExistsError(UrbanForestError):
    """An output is in the way."""


class PartlyDoneError(UrbanForestError):
    """The run finished, but more lots were bad than the limit allows."""

    exit_code = EXIT_PARTLY_DONE


class OutputError(UrbanForestError):
    """An output could not be written whole; nothing was left under its name."""

    exit_code = EXIT_IO


class BusyError(UrbanForestError):
    """Another run holds the output."""

    exit_code = EXIT_BUSY
