"""Compiled kernels, announced when they have to be compiled first."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from urbanforest_cli.core.progress import Progress


def announce_compile(kernels: Sequence[Any], progress: Progress) -> None:
    """Say that kernels are about to be compiled, if they are not in the cache."""
    if not all(_is_cached(kernel) for kernel in kernels):
        progress("compiling kernels (once per version, about a minute)", 0, 1)


def _is_cached(kernel: Any) -> bool:
    source = Path(inspect.getfile(kernel.py_func))
    folder = Path(kernel.stats.cache_path)
    indices = list(folder.glob(f"{source.stem}.{kernel.py_func.__qualname__}-*.nbi"))
    return any(index.stat().st_mtime >= source.stat().st_mtime for index in indices)
