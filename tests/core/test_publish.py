import errno
import os
import subprocess
import sys
import time

import pytest

from urbanforest_cli.core import publish as publishing
from urbanforest_cli.core.errors import BusyError, OutputError
from urbanforest_cli.core.publish import folder_lock, publish, publish_folder, sha256_of, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_an_output_appears_whole(tmp_path):
    write_text(tmp_path / "new" / "a.txt", "hello")
    assert (tmp_path / "new" / "a.txt").read_text() == "hello"
    assert names(tmp_path / "new") == ["a.txt"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write_half():
        with publish(path) as part:
            part.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_a_file_found_wanting_is_not_published(tmp_path):
    def verify(part):
        raise OutputError("too short", where=part)

    with pytest.raises(OutputError), publish(tmp_path / "a.txt", verify=verify) as part:
        part.write_text("x")
    assert names(tmp_path) == []


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path):
    with pytest.raises(OutputError, match="MB free") as caught, publish(tmp_path / "a.txt"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert "make room" in str(caught.value)
    with pytest.raises(OutputError) as forbidden, publish(tmp_path / "a.txt"):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))
    assert "make room" not in str(forbidden.value)
    assert "that can be written to" in str(forbidden.value)
    assert caught.value.exit_code == 74
    assert "a.txt" in str(caught.value)


def test_a_second_run_is_refused_and_a_dead_one_is_cleaned_up(tmp_path):
    folder = tmp_path / "out"
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time, pathlib\n"
            "from urbanforest_cli.core.publish import folder_lock, publish\n"
            "folder = pathlib.Path(sys.argv[1])\n"
            "with folder_lock(folder), publish(folder / 'a.txt') as part:\n"
            "    part.write_text('half'); print('held', flush=True); time.sleep(60)\n",
            str(folder),
        ],
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    assert holder.stdout.readline().strip() == b"held"
    with pytest.raises(BusyError) as caught, folder_lock(folder):
        pass
    assert caught.value.exit_code == 75
    holder.kill()
    holder.wait()
    holder.stdout.close()
    time.sleep(0.05)
    assert names(folder) != []
    with folder_lock(folder):
        assert names(folder) == []


def test_a_folder_made_for_a_run_that_wrote_nothing_goes_again(tmp_path):
    with folder_lock(tmp_path / "out"):
        pass
    assert not (tmp_path / "out").exists()


def test_sha256_is_that_of_the_bytes(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256_of(tmp_path / "a").startswith("ba7816bf8f01cfea")


def test_the_part_of_a_run_that_still_works_is_left_alone(tmp_path):
    live = tmp_path / f".urbanforest-part-{os.getppid()}-a.gpkg"
    live.mkdir()
    with folder_lock(tmp_path):
        assert live.exists()


def fill(folder, **texts):
    for name, text in texts.items():
        (folder / "deep").mkdir(parents=True, exist_ok=True)
        (folder / "deep" / name).write_text(text)


def contents(folder):
    return {path.name: path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(params=["exchanged", "put aside"])
def system(request, monkeypatch):
    """A system that exchanges names in one step, and one that cannot."""
    if request.param == "put aside":
        monkeypatch.setattr(publishing, "_exchange", lambda first, second: False)
    return request.param


def test_names_are_exchanged_in_one_step(tmp_path):
    fill(tmp_path / "one", a="1")
    fill(tmp_path / "two", b="2")
    if not publishing._exchange(tmp_path / "one", tmp_path / "two"):
        pytest.skip("this system cannot exchange two names in one step")
    assert (contents(tmp_path / "one"), contents(tmp_path / "two")) == ({"b": "2"}, {"a": "1"})
    assert not publishing._exchange(tmp_path / "one", tmp_path / "nowhere")


def test_a_folder_appears_whole_and_takes_the_place_of_the_old_one(tmp_path, system):
    path = tmp_path / "new" / "tiles"
    with publish_folder(path) as part:
        fill(part, a="first", b="first")
        assert not path.exists()
    assert contents(path) == {"a": "first", "b": "first"}
    with publish_folder(path) as part:
        fill(part, a="second")
        assert contents(path) == {"a": "first", "b": "first"}
    assert contents(path) == {"a": "second"}
    assert names(path.parent) == ["tiles"]


def test_a_folder_takes_the_place_of_a_file_and_of_a_link_without_following_it(tmp_path, system):
    fill(tmp_path / "elsewhere", mine="mine")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "file").write_text("old")
    for name in ("link", "file"):
        with publish_folder(tmp_path / name) as part:
            fill(part, a="new")
        assert contents(tmp_path / name) == {"a": "new"}
        assert not (tmp_path / name).is_symlink()
    assert contents(tmp_path / "elsewhere") == {"mine": "mine"}
    assert names(tmp_path) == ["elsewhere", "file", "link"]


def test_a_folder_half_written_or_found_wanting_leaves_the_old_one_and_nothing_else(tmp_path, system):
    fill(tmp_path / "tiles", a="old")

    def refuse(part):
        raise OutputError("too little", where=part)

    def write(verify=None, stop=False):
        with publish_folder(tmp_path / "tiles", verify=verify) as part:
            fill(part, a="half")
            if stop:
                raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write(stop=True)
    with pytest.raises(OutputError, match="too little"):
        write(refuse)
    assert contents(tmp_path / "tiles") == {"a": "old"}
    assert names(tmp_path) == ["tiles"]


def test_an_old_folder_put_aside_returns_where_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    monkeypatch.setattr(publishing, "_exchange", lambda first, second: False)
    fill(tmp_path / "tiles", a="old")
    rename = os.rename

    def refuse_new(source, target):
        if os.fspath(target) == os.fspath(tmp_path / "tiles") and publishing.REPLACED not in os.fspath(source):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        rename(source, target)

    monkeypatch.setattr(os, "rename", refuse_new)
    with pytest.raises(OutputError, match="tiles"), publish_folder(tmp_path / "tiles") as part:
        fill(part, a="new")
    assert contents(tmp_path / "tiles") == {"a": "old"}
    assert names(tmp_path) == ["tiles"]


KILLED = """
import os, pathlib, signal, sys
from urbanforest_cli.core import publish
out, step = pathlib.Path(sys.argv[1]), sys.argv[2]
rename, exchange = os.rename, publish._exchange

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def dying_rename(source, target):
    if step == "between" and publish.REPLACED not in str(target):
        die()
    rename(source, target)
    if step == "after":
        die()

def dying_exchange(first, second):
    if step == "exchanged":
        exchange(first, second)
        die()
    return False

os.rename, publish._exchange = dying_rename, dying_exchange
with publish.folder_lock(out), publish.publish_folder(out / "tiles") as part:
    (part / "deep").mkdir()
    (part / "deep" / "a").write_text("new")
    if step == "half":
        die()
"""


@pytest.mark.parametrize(
    ("step", "expected"), [("half", "old"), ("between", "old"), ("after", "old"), ("exchanged", "new")]
)
def test_a_run_killed_at_any_step_leaves_old_or_new_once_the_next_one_has_begun(tmp_path, step, expected):
    fill(tmp_path / "tiles", a="old")
    if step == "exchanged" and not publishing._exchange(tmp_path, tmp_path):
        pytest.skip("this system cannot exchange two names in one step")
    outcome = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), step], check=False)
    assert outcome.returncode == -9
    with folder_lock(tmp_path):
        assert contents(tmp_path / "tiles") == {"a": expected}
        assert names(tmp_path) == ["tiles"]
