"""Counted warnings: nothing is repaired, dropped or changed without one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

EXAMPLES_KEPT = 5


@dataclass
class Notice:
    """One kind of event, how often it happened and where first."""

    code: str
    message: str
    count: int = 0
    examples: list[str] = field(default_factory=list)

    def line(self) -> str:
        """Return the sentence a user reads."""
        where = f" (first: {', '.join(self.examples)})" if self.examples else ""
        return f"{self.message}: {self.count}{where}"


class Notices:
    """The warnings of a run, one entry a code, in the order they first happened."""

    def __init__(self, notices: Iterable[Notice] = ()) -> None:
        self._by_code: dict[str, Notice] = {}
        for notice in notices:
            self.add(notice.code, notice.message, notice.count, notice.examples)

    def add(self, code: str, message: str, count: int = 1, examples: Iterable[object] = ()) -> None:
        """Count an event; `code` looks like ``W_BOW_TIE``, `message` reads well before a number."""
        if count <= 0:
            return
        notice = self._by_code.setdefault(code, Notice(code, message))
        notice.count += count
        for example in examples:
            if len(notice.examples) >= EXAMPLES_KEPT:
                break
            notice.examples.append(str(example))

    def merge(self, other: Notices) -> None:
        """Add all of another collection."""
        for notice in other:
            self.add(notice.code, notice.message, notice.count, notice.examples)

    def __iter__(self) -> Iterator[Notice]:
        return iter(self._by_code.values())

    def __len__(self) -> int:
        return len(self._by_code)

    def __contains__(self, code: str) -> bool:
        return code in self._by_code

    def count(self, code: str) -> int:
        """Return how often a code was counted."""
        return self._by_code[code].count if code in self._by_code else 0

    def as_records(self) -> list[dict[str, object]]:
        """Return plain records for JSON."""
        return [{"code": n.code, "message": n.message, "count": n.count, "examples": n.examples} for n in self]

    @classmethod
    def from_records(cls, records: Iterable[dict[str, object]]) -> Notices:
        """Rebuild a collection from `as_records`."""
        return cls(
            Notice(str(r["code"]), str(r["message"]), int(str(r["count"])), [str(e) for e in r["examples"]])  # type: ignore[attr-defined]
            for r in records
        )
