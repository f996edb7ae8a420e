"""Materials side by side in this process, their lobes recorded in one program: for a GPU.

A fit's search stays on the processor, in one thread for each material; what the searches ask of the operator within a
millisecond is computed together.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

from matcam.batch.executors import Executor
from matcam.batch.job import Job, Outcome, attempt
from matcam.core.jax import jax
from matcam.inverse.fit.lobe_slopes import RecordBatch


@dataclass(frozen=True)
class ThreadExecutor(Executor):
    """Do jobs in threads of this process.

    Attributes:
        seats: materials at a time. Sixteen records fill a GPU, and their tables take some GiB of memory.
    """

    seats: int = 16

    def outcomes(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        """Do jobs and yield their outcomes as they come."""
        if not jobs:
            return
        seats = min(self.seats, len(jobs))
        with RecordBatch(seats) as batch:

            def attempt_in_batch(job: Job) -> Outcome:
                with batch.serving():
                    return attempt(job)

            # what depends on the rig alone is computed by the first, and found by the others
            yield attempt_in_batch(jobs[0])
            pool = ThreadPoolExecutor(seats)
            try:
                for future in as_completed([pool.submit(attempt_in_batch, job) for job in jobs[1:]]):
                    yield future.result()
            finally:
                pool.shutdown(cancel_futures=True)


def has_gpu() -> bool:
    """Tell whether JAX computes on a GPU."""
    return jax.default_backend() == "gpu"
