"""In a child process of a reader: fresh memory is filled, then it does what it should."""

import ctypes
import importlib
from typing import Any

from virtual_sensor.medium.imports import convert  # noqa: F401, once, before children are forked

M_PERTURB, M_MMAP_THRESHOLD = -6, -3  # glibc's mallopt


def fill_memory(byte: int) -> None:
    """Let fresh memory hold this byte, and large blocks of it be fresh too."""
    libc = ctypes.CDLL(None)
    libc.mallopt(M_PERTURB, byte)
    libc.mallopt(M_MMAP_THRESHOLD, 1 << 29)  # else pages of the kernel, which are all zero


def filled(byte: int, target: str, *arguments: Any, **more: Any) -> Any:
    """Call a function, as `run_in_child` was asked to."""
    fill_memory(byte)
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)(*arguments, **more)
