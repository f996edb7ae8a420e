"""The same jobs on a Dask cluster: workers that it starts here, or a scheduler that runs somewhere. Needs `matcam[scale]`.

What a worker does is `attempted(job)`, as everywhere. A task whose worker is lost is given to another one; where three workers
are lost over the same file, it is that file that failed. Workers must see the run's folder and the inputs under the same
names, and hold the same versions of what computes; both are asked before any work.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from matcam.batch.executors.processes import environment
from matcam.batch.inputs import SETTINGS
from matcam.batch.job import Job, Outcome, attempted
from matcam.core.errors import ArgumentError, MatcamError
from matcam.core.workspace import keep_rules

_COMPARED = ("matcam", "jax", "jaxlib", "numpy", "scipy", "xarray", "distributed")
"""Packages whose versions change numbers, or how jobs travel."""
_PATIENCE = 10.0  # seconds for a scheduler to answer
_AHEAD = 3  # tasks given out for each worker: enough that none waits for the next, and few to hold
_LOCAL = re.compile(r"local:([1-9][0-9]{0,3})")


class ClusterError(MatcamError):
    """A cluster cannot be reached, or not be used as it is."""


def check_address(cluster: str) -> None:
    """ArgumentError for what is neither local:N nor an address, and where dask is not installed."""
    if not _LOCAL.fullmatch(cluster) and not re.fullmatch(r"[a-z]+://[^\s/]+:[0-9]{1,5}", cluster):
        raise ArgumentError(
            f"cluster must be local:N or a scheduler's address such as tcp://host:8786, got {cluster!r:.60}"
        )
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ArgumentError("a cluster needs an extra: pip install 'matcam[scale]'") from None


def outcomes(jobs: Sequence[Job], cluster: str) -> Generator[Outcome]:
    """Do jobs on a cluster; their outcomes as they come. ClusterError where it cannot be reached, or must not be used: the
    scheduler is silent, no worker is there, a version or the files that it sees are not the same."""
    from distributed import as_completed

    if not jobs:
        return
    with ExitStack() as stack:
        client = _client(cluster, stack)
        count = _check_workers(client, jobs[0].output.parent)
        waiting = iter(jobs)
        held: dict[Any, Job] = {}

        def give() -> Any:
            job = next(waiting, None)
            if job is None:
                return None
            future = client.submit(_attempted_there, _anywhere(job), pure=False)
            held[future] = job
            return future

        given = [future for future in (give() for _ in range(min(len(jobs), _AHEAD * count))) if future is not None]
        coming = as_completed(given)
        for future in coming:
            job = held.pop(future)
            following = give()
            if following is not None:
                coming.add(following)
            yield _outcome(future, job)
            future.release()


def _outcome(future: Any, job: Job) -> Outcome:
    """What became of a task."""
    from distributed import KilledWorker

    try:
        return future.result()._replace(source=job.source)
    except KilledWorker as error:
        return Outcome(job.source, 0.0, f"{job.source}: {error.allowed_failures + 1} workers that held it died")
    except CancelledError:
        return Outcome(job.source, 0.0, f"{job.source}: the scheduler was lost, or took the task back")
    except Exception as error:  # where a task cannot even be read by a worker
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return Outcome(job.source, 0.0, f"{job.source}: the cluster failed: {reason}")


def _client(cluster: str, stack: ExitStack) -> Any:
    from distributed import Client, LocalCluster

    local = _LOCAL.fullmatch(cluster)
    address: Any = cluster
    if local:
        address = stack.enter_context(
            LocalCluster(
                n_workers=int(local[1]),
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                env=environment(),
                silence_logs="ERROR",
                memory_limit=0,
            )
        )
    try:
        return stack.enter_context(Client(address, timeout=_PATIENCE))
    except (OSError, TimeoutError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ClusterError(f"scheduler {cluster} cannot be reached within {_PATIENCE:.0f} s: {reason:.120}") from None


def _check_workers(client: Any, folder: Path) -> int:
    """How many workers there are, once it is known that they can do the work."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise ClusterError("the cluster has no worker: start some (dask worker ADDRESS --nthreads 1)") from None
    ours = versions()
    try:
        told_by = client.run(_told, str((folder / SETTINGS).absolute()))
    except Exception as error:  # where a worker cannot even import what it is asked
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise ClusterError(f"the cluster's workers cannot run matcam: {reason:.120}") from None
    for address, told in told_by.items():
        for name, version in ours.items():
            if told["versions"].get(name) != version:
                raise ClusterError(
                    f"worker {address} has {name} {told['versions'].get(name)}, this client {version}: install the same"
                )
        if not told["sees"]:
            raise ClusterError(
                f"worker {address} does not see {folder}: workers need the run's folder under the same name"
            )
    threads = client.nthreads()
    for address, number in threads.items():
        if number != 1:
            raise ClusterError(
                f"worker {address} has {number} threads: a material takes a process of its own (dask worker --nthreads 1 "
                "--nworkers N)"
            )
    return len(threads)


def versions() -> dict[str, str]:
    """Of what must be the same everywhere."""
    found = {"python": platform.python_version().rpartition(".")[0]}
    for name in _COMPARED:
        found[name] = metadata.version(name)
    return found


def _told(path: str) -> dict[str, Any]:
    """A worker's versions, and whether it sees a file."""
    return {"versions": versions(), "sees": Path(path).is_file()}


def _anywhere(job: Job) -> Job:
    """The same, whatever folder a worker stands in."""
    store = job.store and job.store.absolute()
    return replace(job, source=job.source.absolute(), output=job.output.absolute(), store=store)


def _attempted_there(job: Job) -> Outcome:
    """Done by a worker, which may have come up since it was last asked."""
    keep_rules()
    return attempted(job)
