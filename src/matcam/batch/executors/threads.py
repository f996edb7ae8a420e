"""Materials side by side in this process, their lobes recorded in one program: what a GPU is used for where one is at hand.

The same jobs as everywhere. A fit's search stays on the processor, one thread for each material; what it asks of the operator
is computed together with what the others ask.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from matcam.batch.job import Job, Outcome, attempted
from matcam.core.jax import jax
from matcam.inverse.fit.lobe_slopes import RecordBatch

SEATS = 16
"""Materials at a time: a record of this many fills a GPU, and their tables some GiB of memory."""


def gpu_at_hand() -> bool:
    """Whether JAX computes on a GPU."""
    return jax.default_backend() == "gpu"


def outcomes(jobs: Sequence[Job], seats: int = SEATS) -> Generator[Outcome]:
    """Do jobs in threads, up to `seats` at a time; their outcomes as they come."""
    if not jobs:
        return
    with RecordBatch(min(seats, len(jobs))) as batch:

        def done(job: Job) -> Outcome:
            with batch.serving():
                return attempted(job)

        # what depends on the rig alone is made by the first, and found by the others
        yield done(jobs[0])
        pool = ThreadPoolExecutor(min(seats, len(jobs)))
        try:
            for future in as_completed([pool.submit(done, job) for job in jobs[1:]]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
