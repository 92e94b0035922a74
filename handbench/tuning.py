"""How a process that trains or draws uses its machine."""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache
from typing import Any

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # of mallopt(3)


def tune() -> None:
    """Set this process up for training and drawing; pictures stay the same to the bit. It is not undone.

    glibc keeps freed arrays of up to 32 MB for the next: else every large one is paged in anew, which was 3 ms of a
    training step of 58 ms, and half of the time of the sRGB curve.

    Products of matrices in numpy and scipy stay in the thread that asks for them, unless OPENBLAS_NUM_THREADS says
    otherwise. The other threads of OpenBLAS look out for the next product for some 30 ms after each, on cores that
    rays, shading and networks need: a known pose of `urhand` took 83 instead of 45 ms under a map of many lights.
    """
    if sys.platform == "linux":
        libc = ctypes.CDLL(None)
        if hasattr(libc, "mallopt"):
            libc.mallopt(_MMAP_THRESHOLD, 32 << 20)
            libc.mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        for library in matrix_libraries():
            library.set_num_threads(1)


@cache
def matrix_libraries() -> tuple[Any, ...]:
    """Those that multiply matrices for numpy and scipy, each with `get_num_threads` and `set_num_threads`."""
    import scipy.linalg  # noqa: F401  (its library is another one than numpy's, and only what is loaded is found)
    from threadpoolctl import ThreadpoolController

    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)
