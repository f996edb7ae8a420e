"""Executors: who does the jobs of a run. Each takes jobs and yields their outcomes as they come."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Generator, Sequence

from matcam.batch.job import Job, Outcome
from matcam.core.threads import ONE_BLAS_THREAD

_ONE_CORE = {**ONE_BLAS_THREAD, "NPROC": "1"}  # NPROC is the size of XLA's pool of threads
"""Read by NumPy's BLAS and by XLA when a process loads them."""
_KEPT_MEMORY = {
    "MALLOC_ARENA_MAX": "1",
    # the next table needs what this one has freed: from the system each page comes cleared, a tenth of a worker's time
    "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 32),
}
"""Read by the C library; what the user has set stays."""
_PLATFORMS = "JAX_PLATFORMS"
_PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
_XLA = "--xla_cpu_multi_thread_eigen=false"


class Executor(ABC):
    """Do the jobs of a run."""

    @abstractmethod
    def outcomes(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        """Do jobs and yield their outcomes as they come.

        A job that fails, or takes its worker with it, costs no other job. Closing the generator ends all work.
        """


def one_core_environment() -> dict[str, str]:
    """Return variables that keep a new process to one core, and keep what the user has set for XLA and memory.

    Workers side by side must not each start a thread for every core.
    """
    # workers compute on their cores; where the user has named a GPU, the first must not take it whole
    platforms = os.environ.get(_PLATFORMS, "cpu")
    shared = os.environ.get(_PREALLOCATE, "false")
    memory = {name: os.environ.get(name, value) for name, value in _KEPT_MEMORY.items()}
    return {
        **_ONE_CORE,
        **memory,
        _PLATFORMS: platforms,
        _PREALLOCATE: shared,
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {_XLA}".strip(),
    }
