"""Executor on a Dask cluster: local workers, or a scheduler at an address. Requires the extra `matcam[scale]`.

The task of a lost worker is given to another worker. A task has failed if more workers are lost during this task than the
setting `distributed.scheduler.allowed-failures` of Dask permits; the default is 3.

Messages of Dask are pickles. Anyone with access to a scheduler or a worker can therefore run code with the rights of the
user who started that process. Local workers listen on this machine alone. An address tls://... uses the certificates of
Dask's configuration (docs/batch.md).

Workers must be able to access the folder of the run and the inputs under the same names. They must also have the same
versions of Python, matcam, Dask and numerical packages. Access to the folder and the versions are checked before any work.
"""

from __future__ import annotations

import ipaddress
import os
import platform
import re
import sys
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

from matcam.batch.executors import Executor, one_core_environment
from matcam.batch.folder import SETTINGS
from matcam.batch.job import Job, Outcome, attempt, failed
from matcam.core import checks
from matcam.core.errors import ArgumentError, MatcamError, described
from matcam.core.jax import use_compilation_cache
from matcam.core.memory import free_for_the_next
from matcam.core.readers.names import is_file
from matcam.core.workspace import Workspace

_PATIENCE = 10.0  # time limit for the answer of a scheduler, s
_OPEN = "MATCAM_OPEN_NETWORK"
_LOCAL = re.compile(r"local:([1-9][0-9]{0,3})")


class ClusterError(MatcamError):
    """Error of a cluster that cannot be reached, or that must not be used."""


@dataclass(frozen=True)
class ClusterExecutor(Executor):
    """Executor on a Dask cluster.

    Attributes:
        address: "local:N" for N workers on this machine, or a scheduler's address.

    Raises:
        ArgumentError: the address is invalid, or Dask is not installed.
    """

    address: str

    def __post_init__(self) -> None:
        if not _LOCAL.fullmatch(self.address) and not re.fullmatch(r"[a-z]+://[^\s/]+:[0-9]{1,5}", self.address):
            raise ArgumentError(
                f"cluster must be local:N or a scheduler's address such as tcp://host:8786, got {self.address!r:.60}"
            )
        checks.extra("a cluster", "scale", "distributed")
        if sys.modules.get("dask", sys) is None:  # hidden by the command line
            del sys.modules["dask"]

    @property
    def is_open(self) -> bool:
        """True if jobs would be sent to another machine without encryption."""
        if _LOCAL.fullmatch(self.address):
            return False
        protocol, _, position = self.address.partition("://")
        host = position.rpartition(":")[0].strip("[]").lower()
        return protocol != "tls" and host != "localhost" and not _is_loopback(host)

    def outcomes(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        """Run jobs, and yield the outcome of each finished job.

        A ClusterError is raised if the scheduler does not answer, if the connection is not encrypted, or if there is no
        worker. It is also raised if a worker has more than one thread, no access to the folder, or versions of packages that
        differ from those of this process.
        """
        from distributed import as_completed

        if not jobs:
            return
        if self.is_open and os.environ.get(_OPEN) != "trusted":
            raise ClusterError(
                f"the connection to scheduler {self.address} is not encrypted, so others in the network could run code on "
                f"your machines: use tls:// with certificates (docs/batch.md), or set {_OPEN}=trusted in a network that you "
                "trust"
            )
        with ExitStack() as stack:
            client = self._client(stack)
            count = _check_workers(client, jobs[0].output.parent)
            waiting = iter(jobs)
            job_of: dict[Any, Job] = {}

            def submit_next() -> Any:
                job = next(waiting, None)
                if job is None:
                    return None
                future = client.submit(_attempt_on_worker, _with_absolute_paths(job), pure=False)
                job_of[future] = job
                return future

            # three submitted tasks per worker: enough that none is idle, and few to store
            first = [submit_next() for _ in range(min(len(jobs), 3 * count))]
            coming = as_completed([future for future in first if future is not None])
            for future in coming:
                job = job_of.pop(future)
                following = submit_next()
                if following is not None:
                    coming.add(following)
                yield _task_outcome(future, job)
                future.release()

    def _client(self, stack: ExitStack) -> Any:
        """Connect to the cluster. A local cluster is closed when `stack` is closed."""
        from distributed import Client, LocalCluster

        local = _LOCAL.fullmatch(self.address)
        scheduler: Any = self.address
        if local:
            scheduler = stack.enter_context(
                LocalCluster(
                    n_workers=int(local[1]),
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    # its web server cannot be disabled, and would be open to all on port 8787
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    env=one_core_environment(),
                    silence_logs="ERROR",
                    memory_limit=0,
                )
            )
        try:
            return stack.enter_context(Client(scheduler, timeout=_PATIENCE))
        except TypeError:  # error of Dask for TLS without a certificate
            raise ClusterError(
                f"scheduler {self.address} cannot be reached without certificates: name them in Dask's configuration "
                "(distributed.comm.tls, docs/batch.md)"
            ) from None
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())
            raise ClusterError(
                f"scheduler {self.address} cannot be reached: {reason:.120}; check the address, and that the scheduler runs"
            ) from None


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a host name
        return False


def versions() -> dict[str, str]:
    found = {"python": platform.python_version().rpartition(".")[0]}
    # packages whose versions affect results, or the serialisation of jobs
    for name in ("matcam", "jax", "jaxlib", "numpy", "scipy", "xarray", "distributed"):
        found[name] = metadata.version(name)
    return found


def _task_outcome(future: Any, job: Job) -> Outcome:
    from distributed import KilledWorker

    try:
        return future.result()._replace(source=job.source)
    except KilledWorker as error:
        return failed(job.source, f"{error.allowed_failures + 1} workers died while they ran this job")
    except CancelledError:
        return failed(job.source, "the scheduler was lost, or cancelled the task: start the run again")
    except Exception as error:  # a worker may even fail to read a task
        reason = described(error)
        return failed(job.source, f"the cluster failed: {reason}")


def _check_workers(client: Any, folder: Path) -> int:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise ClusterError("the cluster has no worker: start at least one (dask worker ADDRESS --nthreads 1)") from None
    ours = versions()
    try:
        reports = client.run(_worker_report, str((folder / SETTINGS).absolute()))
    except Exception as error:  # a worker may even fail to import the function
        reason = described(error)
        raise ClusterError(
            f"the workers of the cluster cannot run matcam: {reason:.120}; install matcam on each worker"
        ) from None
    for address, report in reports.items():
        for name, version in ours.items():
            if report["versions"].get(name) != version:
                raise ClusterError(
                    f"worker {address} has {name} {report['versions'].get(name)}, but this process has {name} {version}: "
                    "install the same version"
                )
        if not report["sees"]:
            raise ClusterError(
                f"worker {address} cannot access {folder}: make this folder available to all workers under the same name"
            )
    threads = client.nthreads()
    for address, number in threads.items():
        if number != 1:
            raise ClusterError(
                f"worker {address} has {number} threads, but each material needs its own process: start one-thread "
                "workers (dask worker --nthreads 1 --nworkers N)"
            )
    return len(threads)


def _worker_report(path: str) -> dict[str, Any]:
    return {"versions": versions(), "sees": is_file(Path(path))}


def _with_absolute_paths(job: Job) -> Job:
    """Replace the paths of a job by absolute paths, which are valid in any working folder."""
    row = job.row and job.row._replace(store=job.row.store.absolute())
    return replace(job, source=job.source.absolute(), output=job.output.absolute(), row=row)


def _attempt_on_worker(job: Job) -> Outcome:
    use_compilation_cache()
    try:
        return attempt(job, Workspace.user())
    finally:
        free_for_the_next()
