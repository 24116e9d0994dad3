"""``study`` and ``study-score``: plantings of lots in, a kit out; answers in, preferences out."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from urbanforest_cli import __version__
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.publish import publish_folder
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.evaluation.study.page import ANSWERS_FORMAT, render_questionnaire
from urbanforest_cli.evaluation.study.score import Answers, StudyScore, joined, score_answers
from urbanforest_cli.evaluation.study.trials import Design

KEY, QUESTIONNAIRE, PICTURES = "key.json", "questionnaire.html", "pictures"
KEY_FORMAT = "urbanforest-study"
ANSWERS_BYTES_MAX = 16 << 20
HASTE_MS = 300
"""Answers faster than this are not looks; they are counted, not dropped."""


@dataclass
class StudySummary(StageSummary):
    """Counts, warnings and, of answers, the score."""

    score: StudyScore | None = field(default=None, repr=False)

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        return {**super().as_record(), "score": self.score.as_record() if self.score is not None else None}


def refuse_other_folder(folder: Path, overwrite: bool) -> None:
    """Refuse to write a study over anything but a study, and over one only if asked to."""
    if not folder.exists():
        return
    if not folder.is_dir() or not ((folder / KEY).is_file() or not any(folder.iterdir())):
        raise OutputExistsError("there is something else already", where=folder, next_step="name another with -o")
    if (folder / KEY).is_file() and not overwrite:
        raise OutputExistsError(
            "there is a study already", where=folder, next_step="name another with -o, or add --overwrite"
        )


def write_study(
    folder: Path, design: Design, pictures: Mapping[str, bytes], *, title: str, made_of: Mapping[str, Any]
) -> None:
    """Write a kit: the questionnaire, its pictures, and the key that tells which of them are real.

    Parameters
    ----------
    pictures
        PNG by picture name.
    made_of
        What the key says of inputs.
    """
    key = {
        "format": KEY_FORMAT,
        "program_version": __version__,
        "made_of": dict(made_of),
        **design.as_record(),
    }
    with publish_folder(folder) as part:
        (part / PICTURES).mkdir()
        for picture in design.pictures:
            (part / PICTURES / f"{picture.name}.png").write_bytes(pictures[picture.name])
        (part / QUESTIONNAIRE).write_text(render_questionnaire(design, pictures, title), encoding="utf-8")
        (part / KEY).write_text(json.dumps(key, indent=1, ensure_ascii=True), encoding="utf-8")


def score_study(study: Path, answers: Sequence[Path], *, seed: int = 0) -> StudySummary:
    """Score the answers to a study.

    Parameters
    ----------
    study
        The kit's folder, or its key.
    answers
        Files that the questionnaire saved, or folders of them.

    Raises
    ------
    InputError
        The kit or a file of answers cannot be read, or belongs to another study.
    """
    started = time.perf_counter()
    notices = Notices()
    key = study / KEY if study.is_dir() else study
    design = _read_key(key)
    files = list(_files(answers))
    if not files:
        raise InputError("no answers", where=", ".join(map(str, answers)), expected="files answers-*.json")
    parts: list[Answers] = []
    seen: dict[str, tuple[Path, dict[str, Any]]] = {}
    for file in files:
        record = _read_json(file, ANSWERS_FORMAT, "answers saved by the questionnaire")
        run = record.get("run")
        if not isinstance(run, str) or not isinstance(record.get("answers"), list):
            raise InputError("this file was not saved by the questionnaire", where=file, expected="a run and answers")
        if run in seen:
            notices.add("W_ANSWERS_TWICE", "files of a sitting that another file tells whole", 1, [file.name])
            if len(record["answers"]) <= len(seen[run][1]["answers"]):
                continue
        seen[run] = (file, record)
    for file, record in seen.values():
        parts.append(_answers_of(record, design, file, notices))
    every = joined(parts)
    if not len(every.rater):
        raise InputError("no answers", where=", ".join(str(file) for file in files), found="files without any")
    score = score_answers(every, seed=seed)
    notices.add(
        "W_INATTENTIVE",
        "raters who preferred random positions to real ones at least half the time, counted all the same",
        len(score.inattentive),
        score.inattentive,
    )
    counts: dict[str, int | float | str] = {
        "answers": len(every.rater),
        "raters": len(set(every.rater)),
        "lots": len(set(every.lot)),
        "trials": len(design.trials),
    }
    return StudySummary("study-score", key, counts, notices, time.perf_counter() - started, score=score)


def _read_key(path: Path) -> Design:
    record = _read_json(path, KEY_FORMAT, "the key.json of a study")
    try:
        return Design.from_record(record)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "this is not the key of a study", where=path, found=str(error), next_step="name the folder of the study"
        ) from error


def _files(answers: Iterable[Path]) -> Iterable[Path]:
    for path in answers:
        yield from sorted(path.glob("*.json")) if path.is_dir() else [path]


def _read_json(path: Path, form: str, expected: str) -> dict[str, Any]:
    try:
        if not path.is_file() or path.stat().st_size > ANSWERS_BYTES_MAX:
            raise InputError("no such file, or none of a sensible size", where=path, expected=expected)
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError("this is no JSON", where=path, found=str(error), expected=expected) from error
    if not isinstance(record, dict) or record.get("format") != form:
        raise InputError("this is another kind of file", where=path, expected=expected)
    return record


def _answers_of(record: Mapping[str, Any], design: Design, file: Path, notices: Notices) -> Answers:
    if record.get("study_id") != design.study_id:
        raise InputError(
            "these answers are to another study",
            where=file,
            found=str(record.get("study_id")),
            expected=design.study_id,
            next_step="name the folder of the study they were given to",
        )
    trials = {trial.trial_id: trial for trial in design.trials}
    rows: dict[str, tuple[str, str, bool, bool]] = {}
    hasty = 0
    for item in record["answers"]:
        told = item if isinstance(item, dict) else {}
        left, right, choice = (told.get(name) for name in ("left", "right", "choice"))
        trial = trials.get(str(told.get("trial_id")))
        if (
            trial is None
            or choice not in ("left", "right")
            or [left, right]
            not in (
                [trial.real, trial.other],
                [trial.other, trial.real],
            )
        ):
            raise InputError(
                "an answer that this study did not ask for",
                where=file,
                found=json.dumps(item)[:200],
                next_step="leave this file out, or ask its rater again",
            )
        milliseconds = item.get("milliseconds")
        hasty += isinstance(milliseconds, int | float) and milliseconds < HASTE_MS
        rows[trial.trial_id] = (
            trial.lot_id,
            trial.category,
            (left if choice == "left" else right) == trial.other,
            choice == "left",
        )
    notices.add("W_HASTY", f"answers given within {HASTE_MS} ms, counted all the same", int(hasty), [file.name])
    short = len(design.trials) - len(rows)
    notices.add("W_UNANSWERED", "questions that a rater left out", short, [file.name] if short else [])
    rater, run = record.get("rater"), record["run"]
    rater = run if rater in (None, run) else f"{rater} {run}"
    values = list(rows.values())
    return Answers(
        np.full(len(values), str(rater), dtype=object),
        np.array([row[0] for row in values], dtype=object),
        np.array([row[1] for row in values], dtype=object),
        np.array([row[2] for row in values], dtype=bool),
        np.array([row[3] for row in values], dtype=bool),
    )
