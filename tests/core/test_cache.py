import os
import stat

from urbanforest_cli.core import cache


def test_where_nothing_can_be_written_the_cache_is_a_private_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("MPLCONFIGDIR", "")
    del os.environ["NUMBA_CACHE_DIR"], os.environ["MPLCONFIGDIR"]
    monkeypatch.setattr(cache.os, "access", lambda *arguments: False)
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    cache.ensure_cache_folders()
    folder = os.environ["NUMBA_CACHE_DIR"]
    assert os.environ["MPLCONFIGDIR"] == folder
    assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700


def test_a_folder_that_others_can_write_to_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    planted = tmp_path / f"urbanforest-cache-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    assert cache._private_folder() != planted


def test_a_folder_the_user_named_is_left_alone(monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere")
    cache.ensure_cache_folders()
    assert os.environ["NUMBA_CACHE_DIR"] == "/somewhere"
