"""Keeping a process to one core: workers side by side must not each start a thread for every core."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NPROC": "1",  # the size of XLA's pool of threads
}
"""Read by NumPy's BLAS and by XLA when a process loads them."""
_PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
_XLA = "--xla_cpu_multi_thread_eigen=false"


def environment() -> dict[str, str]:
    """Variables of a process that is to use one core, what the user has told XLA kept."""
    shared = os.environ.get(_PREALLOCATE, "false")  # a GPU that workers share must not be taken whole by the first
    return {**ENVIRONMENT, _PREALLOCATE: shared, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {_XLA}".strip()}


@contextlib.contextmanager
def inherited() -> Iterator[None]:
    """Processes started inside use one core each."""
    changed = environment()
    before = {name: os.environ.get(name) for name in changed}
    os.environ.update(changed)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
