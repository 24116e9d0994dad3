"""What is found of each output, and the error that lists all faults with what to do about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.core.errors import UrbanForestError
from urbanforest_cli.verification.compare import MM, counted

FAULTS_SHOWN = 20

SAME, INTACT = "same", "intact"
NOT_GROWN, NOT_PLANTED, UNCHECKED = "not grown", "not planted", "not checked"
STALE, CHANGED, DIFFERS, UNREADABLE, MISSING = "stale", "changed", "differs", "unreadable", "missing"

FORMATS = ("glb", "3dtiles", "cityjson", "obj", "geojson", "gpkg", "geoparquet", "itree", "canopy")
"""What ``urbanforest export --to`` takes."""
OF_POPULATE, OF_RENDER, REGISTER, SKELETONS, MANIFEST = "export", "render", "register", "skeletons", "manifest"
"""Formats of what other commands write."""


@dataclass(frozen=True)
class Verdict:
    """What was found of one output.

    Parameters
    ----------
    name
        In the folder of outputs; as given, for a file elsewhere.
    format
        As ``urbanforest export --to`` calls it, or what the file is.
    state
        same: says what the register says, and is as it was written. intact: holds no plants to compare, is as it was
        written. not checked: nothing tells how it was written, and it holds no plants to compare. not grown, not
        planted: the register is sound, and its plants have not grown, or it has none yet. stale: shows another growth.
        changed: not as it was written. differs: says other things than the register. unreadable, missing.
    plants, largest_distance_m
        None where there are none to count.
    faults
        In words.
    recorded
        Whether the manifest names it, so that a change would have been seen.
    is_part
        Whether it shows a part of the city, a box that was asked for.
    """

    name: str
    format: str
    state: str
    plants: int | None = None
    largest_distance_m: float | None = None
    faults: tuple[str, ...] = ()
    recorded: bool = True
    is_part: bool = False

    def as_record(self) -> dict[str, object]:
        """Return it for ``--json``."""
        distance = self.largest_distance_m
        return {
            "name": self.name,
            "format": self.format,
            "state": self.state,
            "plants": self.plants,
            "largest_distance_mm": None if distance is None else round(distance * MM, 3),
            "recorded": self.recorded,
            "part_of_city": self.is_part,
            "faults": list(self.faults),
        }


class DiffersError(UrbanForestError):
    """Outputs are not what the register says, or not as they were written; the text lists all faults."""

    def __init__(self, out: Path, verdicts: Sequence[Verdict]) -> None:
        self.verdicts = tuple(verdicts)
        faults = [f"{verdict.name}: {fault}" for verdict in verdicts for fault in verdict.faults]
        more = [f"and {len(faults) - FAULTS_SHOWN} more"] if len(faults) > FAULTS_SHOWN else []
        super().__init__(
            f"{counted(len(faults), 'fault')} in {counted(sum(bool(v.faults) for v in verdicts), 'output')}",
            where=out,
            found="\n            ".join([*faults[:FAULTS_SHOWN], *more]),
            next_step=_next_step(verdicts),
        )

    def as_record(self) -> dict[str, object]:
        """Return the verdicts with the error."""
        return super().as_record() | {"outputs": [verdict.as_record() for verdict in self.verdicts]}


def _next_step(verdicts: Sequence[Verdict]) -> str:
    """Name the commands that write again what has faults; where exports.json is lost, all that it no longer names."""
    is_lost = any(verdict.format == MANIFEST and verdict.faults for verdict in verdicts)
    again = {verdict.format for verdict in verdicts if verdict.faults or (is_lost and not verdict.recorded)}
    steps = []
    if again & {OF_POPULATE, REGISTER, SKELETONS, MANIFEST}:
        steps.append("`urbanforest populate` (the register, skeletons, forest.glb, plants.geojson, pictures, report)")
    if formats := [name for name in FORMATS if name in again]:
        steps.append(f"`urbanforest export OUT --to {','.join(formats)}`" + _with_options(verdicts))
    if OF_RENDER in again:
        steps.append("`urbanforest render OUT`")
    if not steps:
        return "name files that this program wrote, or none, to check all in the folder"
    return "write again what has faults: " + ", ".join(steps)


def _with_options(verdicts: Sequence[Verdict]) -> str:
    """Tell that a part of the city, or a file elsewhere, is written again by the options that made it alone."""
    special = any(verdict.faults and (verdict.is_part or not verdict.recorded) for verdict in verdicts)
    return " with the same -o, --bbox and --detail as before" if special else ""


def refuse_faults(out: Path, verdicts: Sequence[Verdict]) -> None:
    """Raise where any output has a fault.

    Raises
    ------
    DiffersError
        With all faults.
    """
    if any(verdict.faults for verdict in verdicts):
        raise DiffersError(out, verdicts)
