"""Executors of the jobs of a run. Each executor runs jobs, and yields the outcome of each finished job."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Generator, Sequence

from matcam.batch.job import Job, Outcome
from matcam.core.threads import ONE_BLAS_THREAD


class Executor(ABC):
    """Executor of the jobs of a run."""

    @abstractmethod
    def outcomes(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        """Run jobs, and yield the outcome of each finished job.

        A job that fails, or kills its worker, does not affect other jobs. Closing the generator ends all work.
        """


def one_core_environment() -> dict[str, str]:
    """List the environment variables that restrict a new process to one core.

    Settings of the user for XLA and memory have priority. Without this restriction, each parallel worker would start a
    thread for every core.
    """
    defaults = {
        # workers compute on their cores; if the user selected a GPU, the first worker must not allocate all of it
        "JAX_PLATFORMS": "cpu",
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "MALLOC_ARENA_MAX": "1",
        # a worker reuses freed memory for its next table, because the system would zero new pages, which is slow
        "MALLOC_MMAP_THRESHOLD_": str(1 << 30),
        "MALLOC_TRIM_THRESHOLD_": str(1 << 32),
    }
    return {
        **{name: os.environ.get(name, value) for name, value in defaults.items()},
        **ONE_BLAS_THREAD,
        "NPROC": "1",  # size of the pools of threads of XLA and matcam
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip(),
    }
