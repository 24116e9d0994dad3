"""What made an output from what: one record a stage, kept inside the output."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from pyproj import CRS

from urbanforest_cli import __version__
from urbanforest_cli.core.config import Config
from urbanforest_cli.core.errors import InputError, SchemaError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.schema import REGISTER_VERSION
from urbanforest_cli.files.geopackage import is_city, layer_names, read_layer, refuse_foreign, timestamp


@dataclass(frozen=True)
class Record:
    """One stage's record."""

    stage: str
    seed: int
    stage_key: str
    working_crs: CRS
    config: dict[str, object]
    inputs: list[dict[str, str]]
    counts: dict[str, object] = field(default_factory=dict)
    notices: Notices = field(default_factory=Notices)
    program_version: str = __version__

    def as_row(self) -> dict[str, object]:
        """Return the row of the table ``provenance``."""
        return {
            "stage": self.stage,
            "register_version": REGISTER_VERSION,
            "program_version": self.program_version,
            "seed": str(self.seed),
            "stage_key": self.stage_key,
            "working_crs": self.working_crs.to_wkt(),
            "config": json.dumps(self.config, sort_keys=True, ensure_ascii=False),
            "inputs": json.dumps(self.inputs, sort_keys=True, ensure_ascii=False),
            "counts": json.dumps(self.counts, ensure_ascii=False),
            "warnings": json.dumps(self.notices.as_records(), ensure_ascii=False),
            "written_at": timestamp(),
        }


def stage_key(stage: str, *, config: Config, seed: int, inputs: list[str], sections: tuple[str, ...]) -> str:
    """Hash all that decides a stage's result: version, seed, its sections of the config and its inputs' hashes."""
    values: Mapping[str, object] = config.model_dump(mode="json", include=set(sections))
    text = json.dumps([stage, __version__, REGISTER_VERSION, seed, values, inputs], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def read_records(path: Path) -> dict[str, Record]:
    """Read a register's records by stage."""
    if not path.exists():
        return {}
    refuse_foreign(path)
    records = {}
    for row in read_layer(path, "provenance", geometry=False).to_dict("records"):
        records[row["stage"]] = Record(
            stage=row["stage"],
            seed=int(row["seed"]),
            stage_key=row["stage_key"],
            working_crs=CRS.from_wkt(row["working_crs"]),
            config=json.loads(row["config"]),
            inputs=json.loads(row["inputs"]),
            counts=json.loads(row["counts"]),
            notices=Notices.from_records(json.loads(row["warnings"])),
            program_version=row["program_version"],
        )
    return records


def note_settled_config(record: Record, config: Config, notices: Notices) -> None:
    """Count a warning where the config names other rules or zones than those that made the register."""
    now = config.model_dump(mode="json", exclude_none=True)
    if any(now.get(section, {}) != record.config.get(section, {}) for section in ("rules", "zones")):
        notices.add(
            "W_CONFIG_SETTLED",
            "registers made with other [rules] or [zones], which stay in force (`urbanforest stencil` changes them)",
        )


def require_record(path: Path, stage: str) -> Record:
    """Read the record of one stage.

    Raises
    ------
    SchemaError
        The stage has not run.
    """
    refuse_foreign(path)
    records = read_records(path)
    if stage not in records:
        if is_city(records):
            raise InputError(
                "a city, not a register", where=path, next_step=f"plant it with `urbanforest populate {path.name}`"
            )
        raise SchemaError(
            f"stage {stage!r} has not run on this register", where=path, next_step=f"run `urbanforest {stage}` first"
        )
    return records[stage]


def provenance_frame(path: Path, record: Record, *, drop: tuple[str, ...] = ()) -> pd.DataFrame:
    """Return the provenance table with one stage's record replaced and those of later stages dropped."""
    row = pd.DataFrame([record.as_row()])
    if not path.exists() or "provenance" not in layer_names(path):
        return row
    table: pd.DataFrame = read_layer(path, "provenance", geometry=False)
    return pd.concat([table[~table["stage"].isin([record.stage, *drop])], row], ignore_index=True)
