"""What commands tell on the way."""

from urbanforest_cli.commands import options


def test_a_log_tells_that_a_task_began_and_only_of_a_long_one_that_it_ended(monkeypatch, capsys):
    lines = options._LogLines()
    for task, steps in {"short": (0.0, 1.0, 2.0), "long": (10.0, 12.0, 50.0, 61.0)}.items():
        for done, now in enumerate(steps):
            monkeypatch.setattr(options.time, "monotonic", lambda now=now: now)
            lines(task, done, len(steps) - 1)
    assert capsys.readouterr().err.splitlines() == ["short ...", "long ...", "long 2 of 3 ...", "long done in 51 s"]
