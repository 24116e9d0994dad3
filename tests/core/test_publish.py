import errno
import os
import subprocess
import sys
import time

import pytest

from urbanforest_cli.core.errors import BusyError, OutputError
from urbanforest_cli.core.publish import folder_lock, publish, sha256_of, write_text


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
