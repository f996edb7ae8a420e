"""Executor on this machine: processes of one core each.

Each worker process has its own pipe. A worker that is killed while it sends a message therefore does not affect other
workers, and the job of the killed worker is known. In contrast, the workers of `pebble.ProcessPool` share a pipe, so a
killed worker may break or block the entire pool.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from typing import Any

from matcam.batch.executors import Executor, one_core_environment
from matcam.batch.job import Job, Outcome, attempt, failed
from matcam.core.errors import MatcamError, described
from matcam.core.memory import free_for_the_next

# not fork: JAX has threads, and a fork would copy the locks without the threads
_SPAWN = multiprocessing.get_context("spawn")
_READY = "ready"
_STARTS = 4  # number of workers that may die in succession before they are ready
_START_LIMIT = 300.0  # time limit for the imports of a worker, s
_PATIENCE = 10.0  # time limit for a worker to remove its temporary files, s


class WorkerError(MatcamError):
    """Failure to start workers."""


@dataclass(frozen=True)
class ProcessExecutor(Executor):
    """Executor with processes of one core each.

    Attributes:
        count: number of processes.
        time_limit: time after which the worker of a job is killed and the job has failed, s. Default: None, no limit.
    """

    count: int
    time_limit: float | None = None

    def outcomes(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        """Run jobs, and yield the outcome of each finished job. A WorkerError is raised if no worker can be started."""
        waiting = deque(jobs)
        workers: list[_Worker] = []
        failed_starts = _STARTS - 1  # the first start must succeed
        try:
            workers += [_Worker() for _ in range(min(self.count, len(waiting)))]
            while workers:
                for worker in self._next_events(workers):
                    message, job = worker.receive(), worker.job
                    if message is not None:
                        if not worker.ready and message != _READY:
                            raise WorkerError(
                                f"a worker could not be started: {message}; check the installation of matcam and JAX"
                            )
                        if not worker.ready:
                            worker.ready, failed_starts = True, 0
                        worker.send(waiting.popleft() if waiting else None)
                        if job is not None:
                            yield message
                        continue
                    workers.remove(worker)
                    worker.end()
                    failed_starts += not worker.ready
                    if failed_starts >= _STARTS:
                        raise WorkerError(
                            f"a worker could not be started: {worker.death()}; in a script of your own, call "
                            'the run under `if __name__ == "__main__":`, because workers import the script'
                        )
                    if waiting:
                        workers.append(_Worker())
                    if job is not None:
                        yield failed(job.source, f"the worker died ({worker.death()})")
        finally:
            for worker in workers:
                worker.end()

    def _next_events(self, workers: list[_Worker]) -> list[_Worker]:
        limits = {worker: self._limit_of(worker) for worker in workers}
        ends = [worker.started + limit for worker, limit in limits.items() if limit is not None]
        ready = connection.wait(
            [worker.pipe for worker in workers], max(0.0, min(ends) - time.monotonic()) if ends else None
        )
        for worker, limit in limits.items():
            late = limit is not None and time.monotonic() - worker.started >= limit
            if late and worker.pipe not in ready:
                worker.kill(f"no result after {limit:g} s")
        return [worker for worker in workers if worker.pipe in ready]

    def _limit_of(self, worker: _Worker) -> float | None:
        """Select the time limit for the next message of a worker, s; None: no limit, for example for an idle worker."""
        return _START_LIMIT if not worker.ready else self.time_limit if worker.job is not None else None


class _Worker:
    def __init__(self) -> None:
        self.pipe, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=True)
        with _environment(one_core_environment()):
            self.process.start()
        theirs.close()
        self.job: Job | None = None
        self.started = time.monotonic()
        self.ready = False
        self._why_killed = ""

    def send(self, job: Job | None) -> None:
        """Send a job to the worker, or None to end the worker."""
        self.job, self.started = job, time.monotonic()
        with contextlib.suppress(OSError):  # it has died, and the end of its pipe reports it
            self.pipe.send(job)

    def receive(self) -> Any:
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            self.process.join(_PATIENCE)
            return None

    def kill(self, reason: str) -> None:
        """Kill the process. The end of the process then closes its pipe."""
        self._why_killed = reason
        self.process.kill()

    def end(self) -> None:
        """End the process. If it takes more than 10 s to remove its temporary files, it is killed."""
        self.process.terminate()
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.pipe.close()

    def death(self) -> str:
        code = self.process.exitcode
        if self._why_killed:
            return self._why_killed
        if code is not None and code < 0:  # POSIX only: on Windows a killed process has an ordinary exit code
            name = signal.Signals(-code).name
            return f"killed by {name}" + (", possibly because memory was exhausted" if name == "SIGKILL" else "")
        return f"exit code {code}"


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(pipe: connection.Connection) -> None:
    # Ctrl-C reaches the parent, too, which then ends its workers. Windows ends a process without a signal: there
    # the sweep of the next run removes the temporary files of an ended worker.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that temporary files are removed
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        from matcam.core.jax import jnp, use_compilation_cache
        from matcam.core.workspace import Workspace

        use_compilation_cache()
        workspace = Workspace.user()
        jnp.zeros(())  # a missing device should fail at the start, not in each job
    except Exception as error:
        pipe.send(described(error))
        return
    pipe.send(_READY)
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        if job is None:
            return
        pipe.send(attempt(job, workspace))
        free_for_the_next()


def _end_with_parent() -> None:
    """End this worker when its parent dies.

    Without the parent, the result of the worker would be lost, and the next run may process the same file.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
