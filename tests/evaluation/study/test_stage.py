"""The kit on disk: what raters get, what they send back, what is refused."""

import json
import re

import pytest

from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.evaluation.study.page import ANSWERS_FORMAT
from urbanforest_cli.evaluation.study.stage import refuse_other_folder, score_study, write_study
from urbanforest_cli.evaluation.study.trials import design

PNG = b"\x89PNG\r\n\x1a\n and so on"


@pytest.fixture
def plan():
    return design(["lot </script> 1", "lot 2", "lot 3"], ["placed", "random"], seed=0, fingerprint="x")


@pytest.fixture
def study(plan, tmp_path):
    folder = tmp_path / "study"
    write_study(folder, plan, {item.name: PNG for item in plan.pictures}, title="Which <one>?", made_of={"seed": 0})
    return folder


def sitting(plan, folder, name, choose, **changes):
    """Answer every question; `choose` tells for a trial whether the other planting is taken."""
    answers = [
        {
            "trial_id": trial.trial_id,
            "left": trial.real,
            "right": trial.other,
            "choice": "right" if choose(trial) else "left",
            "milliseconds": 2000,
        }
        for trial in plan.trials
    ]
    record = {"format": ANSWERS_FORMAT, "study_id": plan.study_id, "rater": name, "run": name, "answers": answers}
    path = folder / f"answers-{name}.json"
    path.write_text(json.dumps(record | changes))
    return path


def test_the_page_holds_all_and_tells_nothing(study, plan):
    page = (study / "questionnaire.html").read_text()
    shown = json.loads(re.search(r'id="study">(.*?)</script>', page).group(1))
    assert {trial[0] for trial in shown["trials"]} == {trial.trial_id for trial in plan.trials}
    pictures = json.loads(re.search(r'id="pictures">(.*?)</script>', page).group(1))
    assert set(pictures) == {picture.name for picture in plan.pictures}
    assert all(value.startswith("data:image/png;base64,") for value in pictures.values())
    for secret in ("placed", "random positions", "lot 2", "Which <one>"):
        assert secret not in page
    assert not re.search(r'(src|href)="?(http|//)', page)
    # The side by name, not by truth: real pictures come first about as often as second.
    first = [trial[1] for trial in shown["trials"]]
    assert first == [min(trial[1:]) for trial in shown["trials"]]


def test_answers_become_preferences(study, plan, tmp_path):
    folder = tmp_path / "answers"
    folder.mkdir()
    sitting(plan, folder, "ann", lambda trial: trial.category == "placed")
    sitting(plan, folder, "bob", lambda trial: False)
    summary = score_study(study, [folder])
    share = {item.category: item.share for item in summary.score.preferences}
    assert share == {"placed": 0.5, "random": 0.0}
    assert summary.counts["answers"] == 12
    assert not list(summary.notices)


def test_a_sitting_saved_twice_counts_once(study, plan, tmp_path):
    one = sitting(plan, tmp_path, "ann", lambda trial: trial.category == "placed")
    two = tmp_path / "answers-again.json"
    record = json.loads(one.read_text())
    two.write_text(json.dumps(record | {"answers": record["answers"][:2]}))
    for files in ([one, two], [two, one]):
        summary = score_study(study, files)
        assert summary.counts["answers"] == 6
        assert [notice.code for notice in summary.notices] == ["W_ANSWERS_TWICE"]


def test_haste_and_gaps_are_told(study, plan, tmp_path):
    path = sitting(plan, tmp_path, "ann", lambda trial: True)
    record = json.loads(path.read_text())
    record["answers"] = record["answers"][:-2]
    record["answers"][0]["milliseconds"] = 12
    path.write_text(json.dumps(record))
    codes = {notice.code: notice.count for notice in score_study(study, [path]).notices}
    assert codes == {"W_HASTY": 1, "W_UNANSWERED": 2, "W_INATTENTIVE": 1}


@pytest.mark.parametrize(
    "changes",
    [
        {"study_id": "of another"},
        {"format": "else"},
        {"answers": [{"trial_id": "0000", "left": "x", "right": "y", "choice": "left"}]},
        {"answers": ["left"]},
        {"answers": [{"trial_id": "9999", "choice": "left"}]},
        {"answers": []},
        {"answers": 5},
        {"answers": None},
        {"run": None},
        {"run": ["ann"]},
        {"answers": [{"trial_id": "0000", "left": [1], "right": {}, "choice": ["left"]}]},
    ],
)
def test_other_answers_are_refused(study, plan, tmp_path, changes):
    path = sitting(plan, tmp_path, "ann", lambda trial: True, **changes)
    with pytest.raises(InputError):
        score_study(study, [path])


def test_files_that_are_nothing_of_the_kind_are_refused(study, tmp_path):
    broken = tmp_path / "broken.json"
    broken.write_text("[" * 100_000)
    for path in (broken, tmp_path / "none.json", study / "questionnaire.html"):
        with pytest.raises(InputError):
            score_study(study, [path])
    with pytest.raises(InputError, match=r"another kind|no JSON|no such"):
        score_study(broken, [broken])


def test_nothing_but_a_study_is_written_over(study, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"cat")
    for overwrite in (False, True):
        with pytest.raises(OutputExistsError):
            refuse_other_folder(tmp_path / "photos", overwrite)
    with pytest.raises(OutputExistsError, match="a study already"):
        refuse_other_folder(study, False)
    refuse_other_folder(study, True)
    refuse_other_folder(tmp_path / "fresh", False)
