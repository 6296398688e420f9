"""numba's compiler, or a stand-in where it is missing or not wanted.

Without it the kernels run as plain Python, a hundred times slower and to the same digits; the
first use says so. CERTNAV_NO_JIT=1 asks for that. Kernels are compiled on first use and kept in
numba's cache beside the module (or in NUMBA_CACHE_DIR).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

#: Why kernels are not compiled; '' if they are.
WHY_NOT = ""

try:
    if os.environ.get("CERTNAV_NO_JIT", "0") not in ("", "0"):
        raise ImportError("CERTNAV_NO_JIT is set")
    import numba
except ImportError as error:
    WHY_NOT = str(error)

COMPILED = not WHY_NOT


def njit(**options: Any) -> Callable[[Callable], Callable]:
    """Compile a function on its first call, or leave it as it is.

    Parameters
    ----------
    **options
        As for numba's `njit`. Nothing here is called from C, and each wrapper for that takes as
        long to compile as a small kernel.
    """
    if not COMPILED:
        return lambda function: function
    compiled: Callable[[Callable], Callable] = numba.njit(no_cfunc_wrapper=True, **options)
    return compiled


def notice(kernel: Any) -> str:
    """Return what a user has to know before a kernel is called for the first time, or ''."""
    if not COMPILED:
        return f"running without numba ({WHY_NOT}): same result, a hundred times slower"
    source = Path(kernel.py_func.__code__.co_filename)
    name = f"{source.stem}.{kernel.py_func.__name__}-*.nbi"
    kept = Path(kernel.stats.cache_path).glob(name)
    if any(index.stat().st_mtime >= source.stat().st_mtime for index in kept):
        return ""
    return "compiling, once on this machine: some ten seconds more"
