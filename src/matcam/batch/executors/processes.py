"""Keeping a process to one core: workers side by side must not each start a thread for every core.

Workers on this machine: processes of one core each, one job at a time. Where one dies, the file that it held is known.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from multiprocessing import connection
from typing import Any

from matcam.batch.job import Job, Outcome
from matcam.core.errors import MatcamError

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


# not fork: JAX has threads, and a fork would copy their locks without them
_SPAWN = multiprocessing.get_context("spawn")
_READY = "ready"
_PATIENCE = 10.0  # seconds for a worker to put its things away


class WorkerError(MatcamError):
    """Workers cannot be started at all."""


class _Worker:
    """A process, the pipe to it, and the job that it holds."""

    def __init__(self) -> None:
        self.pipe, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=True)
        with inherited():
            self.process.start()
        theirs.close()
        self.job: Job | None = None
        self.ready = False

    def give(self, job: Job | None) -> None:
        self.job = job
        with contextlib.suppress(OSError):  # it has died: its end of the pipe will say so
            self.pipe.send(job)

    def end(self) -> None:
        """Let it put its things away, then see to it that it is gone."""
        self.process.terminate()
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.pipe.close()


def outcomes(jobs: Iterable[Job], count: int) -> Generator[Outcome]:
    """Do jobs in `count` processes; their outcomes as they come. A worker that dies costs the job that it held, no other.
    WorkerError where none could be started."""
    waiting = deque(jobs)
    alive: list[_Worker] = []
    try:
        alive += [_Worker() for _ in range(min(count, len(waiting)))]
        while alive:
            for pipe in connection.wait([worker.pipe for worker in alive]):
                worker = next(worker for worker in alive if worker.pipe is pipe)
                said, done = _heard(worker), worker.job
                if said is not None:
                    if not worker.ready and said != _READY:
                        raise WorkerError(f"a worker could not be started: {said}")
                    worker.ready = True
                    worker.give(waiting.popleft() if waiting else None)
                    if done is not None:
                        yield said
                    continue
                alive.remove(worker)
                worker.end()
                if not worker.ready:
                    raise WorkerError(
                        f"a worker could not be started: {_death(worker.process.exitcode)} (in a script of your own, call "
                        'under `if __name__ == "__main__":`, because workers read the script too)'
                    )
                if waiting:
                    alive.append(_Worker())
                if done is not None:
                    reason = f"{done.source}: the worker that held it died ({_death(worker.process.exitcode)})"
                    yield Outcome(done.source, 0.0, reason)
    finally:
        for worker in alive:
            worker.end()


def _heard(worker: _Worker) -> Any:
    """What a worker says; None where it has gone."""
    try:
        return worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join(_PATIENCE)
        return None


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"killed by {name}" + (": out of memory?" if name == "SIGKILL" else "")
    return f"exit code {code}"


def _serve(pipe: connection.Connection) -> None:
    """A worker's life: jobs until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted too, and says what becomes of us
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that temporary files are put away
    threading.Thread(target=_outlive_nobody, daemon=True).start()
    try:
        from matcam.batch.job import attempted
        from matcam.core.jax import jnp
        from matcam.core.workspace import keep_rules

        keep_rules()
        jnp.zeros(())  # a device that is not there should fail now, and not with each job
    except Exception as error:
        pipe.send(" ".join(f"{type(error).__name__}: {error}".split()))
        return
    pipe.send(_READY)
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        if job is None:
            return
        pipe.send(attempted(job))


def _outlive_nobody() -> None:
    """A worker whose parent was killed ends at once: nobody will hear what it finds, and the next run may do the same file."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
