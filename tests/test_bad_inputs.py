"""Bad inputs that nobody of this project wrote, and what a good program does with each."""

from __future__ import annotations

import csv
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from urbanforest_cli.core.errors import EXIT_BAD_INPUT, UrbanForestError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.configs import load_config
from urbanforest_cli.files.vectors import read_vector
from urbanforest_cli.pipeline import Request, populate
from urbanforest_cli.sources.stage import RoleSource, import_city

KINDS = {"geojson", "gpkg", "shp", "sqlite", "vrt"}
ASSUMED_CRS = "EPSG:32631"
LONGEST_S = 5.0
ALWAYS_TOLD = {"W_ZONE_MISSING", "W_NO_LOT_ID"}  # none of these files has zones or ids of lots


@dataclass(frozen=True)
class Case:
    """A file, what is expected of it, and the CRS to assume."""

    path: Path
    expected: str
    assume_crs: str | None

    def agrees(self, outcome: str) -> bool:
        """Tell whether an outcome is the one expected; a warning more than expected does no harm."""
        return outcome == self.expected or (self.expected == "accept" and outcome == "repair")


def cases(folder: Path) -> Iterator[Case]:
    """Read the index. A shapefile without .prj is tried as it is, and again with an assumed CRS.

    With one, those that were to be refused for the lack of it are not expected to be refused any more.
    """
    with (folder / "index.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            if row["kind"] not in KINDS or row["role"] != "input":
                continue
            path = folder / row["file"]
            yield Case(path, row["expected"], None)
            if row["kind"] == "shp" and not path.with_suffix(".prj").exists():
                yield Case(path, "repair" if row["code"] == "E_CRS" else row["expected"], ASSUMED_CRS)


def judged(folder: Path, work: Callable[[Case], Notices]) -> tuple[int, list[str]]:
    """Run all cases; return how many there are, and a line for each that does not agree."""
    before = sorted(folder.rglob("*"))
    count, disagreements = 0, []
    for case in cases(folder):
        count += 1
        started = time.process_time()
        try:
            told = {notice.code for notice in work(case)} - ALWAYS_TOLD
            outcome = "repair" if told else "accept"
        except UrbanForestError as error:
            outcome = "reject"
            if error.exit_code != EXIT_BAD_INPUT or case.path.name not in str(error):
                outcome = f"reject with exit code {error.exit_code}: {error}"
        except Exception as error:  # noqa: BLE001 whatever else comes out of a library is what this test looks for
            outcome = f"{type(error).__name__}: {error}"
        spent = time.process_time() - started
        if not case.agrees(outcome) or spent > LONGEST_S:
            disagreements.append(f"{case.path.name} ({case.assume_crs}): {case.expected}, not {outcome}, {spent:.1f} s")
    assert sorted(folder.rglob("*")) == before, "a file was left beside the inputs"
    return count, disagreements


def test_reading_does_with_each_vector_file_what_the_index_says(bad_inputs: Path) -> None:
    def work(case: Case) -> Notices:
        notices = Notices()
        read_vector(case.path, assume_crs=case.assume_crs, notices=notices)
        return notices

    count, disagreements = judged(bad_inputs, work)
    # Broken rings and wrong kinds of geometry are for the caller to find, so reading alone may not see them.
    blind = [line for line in disagreements if "repair, not accept" in line]
    assert count > 0
    assert not [line for line in disagreements if line not in blind], "\n".join(disagreements)


def test_import_does_with_each_vector_file_what_the_index_says(bad_inputs: Path, tmp_path: Path) -> None:
    output = tmp_path / "city.gpkg"

    def work(case: Case) -> Notices:
        output.unlink(missing_ok=True)
        try:
            roles = {"lots": RoleSource(str(case.path))}
            return import_city([], output, roles=roles, assume_crs=case.assume_crs, default_zone="residential").notices
        finally:
            left = [entry.name for entry in tmp_path.iterdir()]
            assert left in ([], [output.name]), left

    count, disagreements = judged(bad_inputs, work)
    # The index calls a polygon with two sound holes a case for repair; here it is a lot with two holes.
    disagreements = [line for line in disagreements if not line.startswith("problematic_holes.geojson")]
    assert count > 0
    assert len(disagreements) <= count // 100, f"{len(disagreements)} of {count}\n" + "\n".join(disagreements)


def test_populate_does_with_each_vector_file_what_the_index_says(bad_inputs: Path, tmp_path: Path) -> None:
    config = load_config(environment={}).config

    def work(case: Case) -> Notices:
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        request = Request(
            city=case.path,
            out=out,
            config=config,
            seed=0,
            until="place",
            assume_crs=case.assume_crs,
        )
        try:
            return populate(request)[0].notices
        finally:
            left = sorted(entry.name for entry in out.iterdir()) if out.exists() else []
            assert left in ([], ["register.gpkg"]), left

    count, disagreements = judged(bad_inputs, work)
    disagreements = [line for line in disagreements if not line.startswith("problematic_holes.geojson")]
    assert count > 0
    assert len(disagreements) <= count // 100, f"{len(disagreements)} of {count}\n" + "\n".join(disagreements)
