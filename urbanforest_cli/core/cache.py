"""Where compiled kernels are kept; imports nothing heavy, since it must act before the compiler is loaded."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def ensure_cache_folders() -> None:
    """Give the compiler and matplotlib folders for their caches where the usual ones cannot be written.

    So it is for a service user without a home, in cron or in a container.
    """
    home = os.path.expanduser("~")
    home_cache = os.environ.get("XDG_CACHE_HOME", os.path.join(home, ".cache"))
    writable = any(os.access(folder, os.W_OK) for folder in (home_cache, home))
    if not writable and "MPLCONFIGDIR" not in os.environ:
        os.environ["MPLCONFIGDIR"] = str(_private_folder())
    if not writable and not os.access(Path(__file__).parent, os.W_OK) and "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(_private_folder())


def _private_folder() -> Path:
    """Return a folder that nobody else can write to: what lies in the cache is run."""
    folder = Path(tempfile.gettempdir()) / f"urbanforest-cache-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    state = folder.lstat()
    if stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid() and not state.st_mode & 0o077:
        return folder
    return Path(tempfile.mkdtemp(prefix="urbanforest-cache-"))
