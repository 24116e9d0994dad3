"""What trainings share: the machine they run on, torch settled so that nothing varies, and a state as bytes."""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pickle import UnpicklingError
from typing import Any

import torch


@dataclass(frozen=True)
class Machine:
    """Where a training runs: device, whether products are of bfloat16, and threads on the CPU."""

    device: str
    bf16: bool
    threads: int


def find_machine(device: str, precision: str, threads: int) -> Machine:
    """Settle what is `auto`: a GPU where there is one, bfloat16 where the processor multiplies it.

    Raises
    ------
    ValueError
        A GPU is asked for and none is to be seen.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("PyTorch sees no GPU")
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda":
        able = torch.cuda.is_bf16_supported()
    else:
        checks = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
        able = any(bool(getattr(torch.cpu, name, bool)()) for name in checks)
    return Machine(device, able if precision == "auto" else precision == "bf16", threads)


@contextlib.contextmanager
def settled(machine: Machine) -> Iterator[None]:
    """Set PyTorch's threads and have it take no algorithm whose result varies; put all back afterwards."""
    threads, exact = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    memory: Any = torch.utils.deterministic
    filled = memory.fill_uninitialized_memory
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(machine.threads)
    torch.use_deterministic_algorithms(True)
    memory.fill_uninitialized_memory = False  # nothing here reads any, and it takes a tenth longer
    try:
        with torch.random.fork_rng(devices=range(torch.cuda.device_count()) if machine.device == "cuda" else []):
            yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(exact)
        memory.fill_uninitialized_memory = filled


def version() -> str:
    """Return PyTorch's version."""
    return str(torch.__version__)


def pack(state: dict[str, Any]) -> bytes:
    """Return tensors and plain values as bytes."""
    stream = io.BytesIO()
    torch.save(state, stream)
    return stream.getvalue()


def unpack(content: bytes) -> dict[str, Any]:
    """Read what `pack` returned; nothing but tensors and plain values is made of it.

    Raises
    ------
    ValueError
        It is something else.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except (UnpicklingError, RuntimeError, EOFError, KeyError, TypeError, AttributeError, OSError) as error:
        raise ValueError(str(error).partition("\n")[0]) from error
    if not isinstance(state, dict):
        raise ValueError("it holds no table of values")
    return state
