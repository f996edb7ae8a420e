"""The same jobs on Dask: a real scheduler, real workers, one of them killed; and clusters that must not be used."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time

import dask
import pytest
from distributed import Client

from matcam import rigs
from matcam.batch.executors import cluster
from matcam.batch.executors.cluster import ClusterError, ClusterExecutor
from matcam.batch.run import correct_all
from matcam.core.errors import ArgumentError
from tests.batch import simple
from tests.batch.tables import write_database
from tests.conftest import REPOSITORY


def started(*arguments, **environment):
    paths = os.pathsep.join([str(REPOSITORY / "src"), str(REPOSITORY)])
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *(str(a) for a in arguments)],
        env={**os.environ, "PYTHONPATH": paths, **environment}, **quiet,
    )  # fmt: skip


class Cluster:
    """A scheduler and workers as somebody else would start them."""

    def __init__(self, folder, *more):
        self.folder, self.processes = folder, []
        contact = folder / "scheduler.json"
        self.processes.append(
            started(
                "scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", contact, *more
            )
        )
        while not contact.exists():
            assert self.processes[0].poll() is None
            time.sleep(0.05)
        self.address = json.loads(contact.read_text())["address"]

    def add(self, *more, **environment):
        usual = ("--nthreads", 1, "--no-nanny", "--no-dashboard", "--local-directory", self.folder)
        self.processes.append(started("worker", self.address, *usual, *more, **environment))
        return self.processes[-1]

    def close_last(self):
        process = self.processes.pop()
        process.kill()
        process.wait()

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture
def somewhere(tmp_path):
    made = Cluster(tmp_path)
    yield made
    made.close()


def test_what_is_no_cluster(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    database = write_database(tmp_path / "in", ["a"])
    start = lambda where, **how: correct_all(  # noqa: E731
        [database], rigs.merl(), tmp_path / "out", cluster=where, corrector=simple.brighter, **how
    )
    for where in ("local:0", "local", "here", "tcp://host"):
        with pytest.raises(ArgumentError, match="cluster must be local:N or"):
            start(where)
    with pytest.raises(ArgumentError, match="give one of them"):
        start("local:2", workers=2)
    with pytest.raises(ClusterError, match=r"scheduler tcp://127\.0\.0\.1:9 cannot be reached"):
        start("tcp://127.0.0.1:9")
    assert not list((tmp_path / "out").glob("a.*"))


@pytest.mark.slow
def test_a_worker_is_killed_in_the_middle(somewhere, tmp_path, monkeypatch):
    """Two worker processes; one is killed with a material in its hands. All are corrected, by the other one, and the files are
    those that this machine's own workers write."""
    names = ["a", "b", "c", "d", "e"]
    database, log = write_database(tmp_path / "in", names), tmp_path / "log"
    workers = [somewhere.add(MATCAM_TEST_LOG=str(log)) for _ in range(2)]
    with Client(somewhere.address) as client:
        client.wait_for_workers(2)
    killed = []

    def kill():
        while not log.exists() or not log.read_text():
            time.sleep(0.01)
        killed.append(int(log.read_text().split()[1]))
        os.kill(killed[0], signal.SIGKILL)

    watcher = threading.Thread(target=kill)
    watcher.start()
    heard = []
    done = correct_all(
        [database], rigs.merl(), tmp_path / "out", cluster=somewhere.address, corrector=simple.noted_then_slowly,
        watch=heard.append,
    )  # fmt: skip
    watcher.join()
    assert killed[0] in [worker.pid for worker in workers]
    assert (sorted(p.stem for p in done.corrected), done.failures) == (names, ())
    lines = [line.split() for line in log.read_text().splitlines()]
    assert len(lines) == len(names) + 1  # one of them twice
    assert {int(pid) for _, pid in lines} == {worker.pid for worker in workers}
    correct_all([database], rigs.merl(), tmp_path / "here", workers=1, corrector=simple.noted_then_slowly)
    for name in names:
        assert (tmp_path / "out" / f"{name}.binary").read_bytes() == (tmp_path / "here" / f"{name}.binary").read_bytes()


@pytest.mark.slow
def test_the_scheduler_is_lost_in_the_middle(somewhere, tmp_path):
    """Every material that was not finished is listed; started again elsewhere, the run goes on."""
    names = ["a", "b", "c", "d", "e"]
    database, log, out = write_database(tmp_path / "in", names), tmp_path / "log", tmp_path / "out"
    somewhere.add(MATCAM_TEST_LOG=str(log))

    def kill():
        while not log.exists():
            time.sleep(0.01)
        somewhere.processes[0].kill()

    watcher = threading.Thread(target=kill)
    watcher.start()
    lost = correct_all([database], rigs.merl(), out, cluster=somewhere.address, corrector=simple.noted_then_slowly)
    watcher.join()
    assert sorted(path.stem for path in lost.corrected) + sorted(f.source.stem for f in lost.failures) == names
    assert len(lost.failures) >= 4
    assert all("scheduler was lost" in failure.reason for failure in lost.failures)
    again = correct_all([database], rigs.merl(), out, workers=1, corrector=simple.noted_then_slowly)
    assert sorted(path.stem for path in (*again.kept, *again.corrected)) == names
    assert again.failures == ()


@pytest.mark.slow
def test_workers_that_must_not_be_used(somewhere, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_PATIENCE", 20.0)
    database = write_database(tmp_path / "in", ["a"])
    start = lambda: correct_all(  # noqa: E731
        [database], rigs.merl(), tmp_path / "out", cluster=somewhere.address, corrector=simple.brighter
    )
    older = tmp_path / "older.py"
    older.write_text(
        "from importlib import metadata\n"
        "metadata.version = lambda name, real=metadata.version: '0.0.9' if name == 'matcam' else real(name)\n"
    )
    somewhere.add("--preload", older)
    with pytest.raises(
        ClusterError, match=r"has matcam 0\.0\.9, but this process has matcam 0\.1\.0: install the same"
    ):
        start()
    somewhere.close_last()
    somewhere.add("--nthreads", 2)
    with pytest.raises(ClusterError, match="has 2 threads"):
        start()
    somewhere.close_last()
    elsewhere = tmp_path / "elsewhere.py"
    elsewhere.write_text(
        "from pathlib import Path\n"
        "Path.is_file = lambda self, real=Path.is_file: self.name != 'settings.json' and real(self)\n"
    )
    somewhere.add("--preload", elsewhere)
    with pytest.raises(ClusterError, match="cannot access"):
        start()
    assert not list((tmp_path / "out").glob("a.*"))


@pytest.mark.slow
def test_workers_that_it_starts_itself(tmp_path, monkeypatch):
    """And paths that are not from the root."""
    monkeypatch.chdir(tmp_path)
    database = write_database(tmp_path / "in", ["a", "b"])
    (database / "short.binary").write_bytes(b"short")
    done = correct_all(["in"], rigs.merl(), "out", cluster="local:2", corrector=simple.brighter)
    assert (tmp_path / "out" / "a.json").exists()
    assert sorted(path.stem for path in done.corrected) == ["a", "b"]
    assert "short.binary: 5 bytes" in done.failures[0].reason


@pytest.mark.slow
def test_what_is_started_here_listens_here_alone():
    with contextlib.ExitStack() as stack:
        scheduler = ClusterExecutor("local:1")._client(stack).cluster.scheduler
        assert scheduler.address.startswith("tcp://127.0.0.1:")
        listening = [listener.getsockname() for listener in scheduler.http_server._sockets.values()]
        assert {host for host, _ in listening} == {"127.0.0.1"}
        assert 8787 not in {port for _, port in listening}
        assert all(worker.startswith("tcp://127.0.0.1:") for worker in scheduler.workers)


@pytest.mark.slow
def test_a_file_that_kills_every_worker(tmp_path):
    """Dask tries it on several workers; in the end it is listed, and the others are done."""
    database = write_database(tmp_path / "in", ["a", "poison"])
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        done = correct_all([database], rigs.merl(), tmp_path / "out", cluster="local:2", corrector=simple.deadly)
    assert [path.stem for path in done.corrected] == ["a"]
    assert "2 workers died while they ran this job" in done.failures[0].reason


def test_nothing_to_do_needs_no_cluster():
    assert list(ClusterExecutor("tcp://127.0.0.1:9").outcomes([])) == []


def test_an_open_network_is_warned_of(tmp_path, monkeypatch):
    """Whoever listens in on tcp:// to another machine runs code here: pickles are exchanged unprotected."""
    for address, open_ in (("tcp://10.1.2.3:8786", True), ("tcp://cluster.example:8786", True), ("tls://10.1.2.3:8786", False),
                           ("tcp://127.0.0.1:8786", False), ("tcp://localhost:8786", False), ("tcp://[::1]:8786", False),
                           ("local:2", False), ("inproc://10.1.2.3:1", True)):  # fmt: skip
        executor = ClusterExecutor(address)
        assert executor.is_open == open_, address
    monkeypatch.setattr(cluster, "_PATIENCE", 0.3)
    monkeypatch.delenv("MATCAM_OPEN_NETWORK", raising=False)
    with pytest.raises(ClusterError, match=r"tcp://192\.0\.2\.1:9 is not encrypted.*tls://"):
        list(ClusterExecutor("tcp://192.0.2.1:9").outcomes([object()]))
    monkeypatch.setenv("MATCAM_OPEN_NETWORK", "trusted")
    with pytest.raises(ClusterError, match="cannot be reached"):
        list(ClusterExecutor("tcp://192.0.2.1:9").outcomes([object()]))


def _certificates(folder):
    """A certificate that both sides use and trust, by the command `openssl`."""
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=matcam-test",
         "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    return key, certificate


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes certificates with the command openssl")
def test_a_run_over_tls(tmp_path):
    """Scheduler and worker with certificates; without them nobody gets in."""
    key, certificate = _certificates(tmp_path)
    files = ("--tls-ca-file", certificate, "--tls-cert", certificate, "--tls-key", key)
    made = Cluster(tmp_path, "--protocol", "tls", *files)
    try:
        assert made.address.startswith("tls://")
        made.add(*files)
        database = write_database(tmp_path / "in", ["a", "b"])
        start = lambda: correct_all(  # noqa: E731
            [database], rigs.merl(), tmp_path / "out", cluster=made.address, corrector=simple.brighter
        )
        with pytest.raises(ClusterError, match="cannot be reached"):
            start()
        assert not list((tmp_path / "out").glob("a.*"))
        with dask.config.set({
            "distributed.comm.tls.ca-file": str(certificate),
            "distributed.comm.tls.client.cert": str(certificate),
            "distributed.comm.tls.client.key": str(key),
            "distributed.comm.require-encryption": True,
        }):  # fmt: skip
            done = start()
        assert sorted(path.stem for path in done.corrected) == ["a", "b"]
    finally:
        made.close()
