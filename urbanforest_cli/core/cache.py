"""Where compiled kernels are kept; imports nothing heavy, since it must act before the compiler is loaded."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def ensure_cache_folder() -> None:
    """Give the compiler a folder for its cache where neither the package nor the home folder can be written."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    package = Path(__file__).parent
    home_cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    for folder in (package, home_cache, Path.home()):
        if folder.is_dir() and os.access(folder, os.W_OK):
            return
    os.environ["NUMBA_CACHE_DIR"] = str(_private_folder())


def _private_folder() -> Path:
    """Return a folder that nobody else can write to: what lies in the cache is run."""
    folder = Path(tempfile.gettempdir()) / f"urbanforest-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    state = folder.lstat()
    if stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o077:
        return folder
    return Path(tempfile.mkdtemp(prefix="urbanforest-kernels-"))
