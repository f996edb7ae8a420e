"""Reading of files in a separate process with limits, the same for all formats.

Decoders of foreign formats (HDF5, OpenEXR, TIFF, PNG, JPEG, camera raw, Zarr) are large C libraries that trust their
input: a damaged or hostile file can make them crash, hang or fill the memory. Parsers of text are safe, but may require
time and memory that grow faster than their file. Files are therefore read in a separate process:

    this process  --request-->  fork server  --fork-->  child (limits, then one decoder, one file)
                  <------------ result: JSON, then arrays as bytes ------------
                  <-- end -------- (end of the child)

The fork server is a small Python process without threads, started once; forking a child takes milliseconds. A child
must not write files, and its answer is JSON and plain numbers, without pickle. On systems without fork (Windows), each
file has a new process. Text files of a few kilobytes are parsed in this process, because their size bounds the cost.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.memory import available_memory
from matcam.core.readers.answers import read_answer
from matcam.core.readers.serving import decoded
from matcam.core.registry import imported
from matcam.core.threads import ONE_BLAS_THREAD

_SERVING = "matcam.core.readers.serving"


class Limits(NamedTuple):
    """Limits of the resources for reading one file.

    Attributes:
        seconds: processor time, s. Default: None, 2 s plus 1 s for every 5 MB of the file.
        memory: memory in addition to that of the process at its start, bytes. Default: None, 512 MiB plus 32 times the size
            of the file, but at most half of the available memory.
        wall: wall-clock time, s. Default: None, 30 times the processor time.
    """

    seconds: float | None = None
    memory: int | None = None
    wall: float | None = None


_NORMAL = Limits()
_limits: ContextVar[Limits | None] = ContextVar("limits", default=_NORMAL)


@contextmanager
def reading_limits(limits: Limits | None) -> Iterator[None]:
    """Use other limits for files that are opened in the block.

    If `limits` is None, the files are trusted and are decoded in this process.
    """
    token = _limits.set(limits)
    try:
        yield
    finally:
        _limits.reset(token)


def files_are_trusted() -> bool:
    return _limits.get() is None


def start_reader(modules: Sequence[str]) -> None:
    if _CAN_FORK and not files_are_trusted():
        with contextlib.suppress(OSError):  # the first file that is read reports the error
            for one in _request({"decoder": "", "libraries": list(modules)})[1:]:
                one.close()


def read_apart(
    decoder: str,
    path: Path,
    what: str = "",
    *,
    libraries: tuple[str, ...] = (),
    small: int = 0,
    size: int | None = None,
    **options: Any,
) -> Any:
    """Call a decoder on a file in a separate process.

    Args:
        decoder: function that reads the file, "package.module:function".
        path: the file.
        what: expected content, such as "an image". Default: "", the path may be a folder.
        libraries: modules that the decoder imports. Default: none.
        small: size of a file, bytes, up to which the decoder is called in this process. It is for decoders whose cost is
            bounded by the size. Default: 0.
        size: size of the content, bytes, from which the limits are computed; required if `path` is a folder. Default:
            None, the size of the file.
        **options: further arguments of the decoder.

    Returns:
        The return value of the decoder: None, truth values, numbers, strings, lists, dicts with string keys, and NumPy arrays.

    Raises:
        FileFormatError: the file is missing or exceeds a limit, or the decoder crashes or raises an error that is not an
            error of matcam.
        MatcamError: errors of matcam that the decoder raises are raised unchanged.
    """
    limits = _limits.get()
    if limits is None:
        try:
            return decoded(decoder, path, options, what)
        except MemoryError:
            raise FileFormatError(
                f"{path}: reading needs more memory than is available: free memory, or give a smaller file"
            ) from None
    with reading(path, what):
        size = path.stat().st_size if size is None else size
        if small and size <= small:
            return imported(decoder)(path, **options)
    # the slowest decoder (PNG) reads 30 MB in 1 s
    seconds = 2.0 + size / 5e6 if limits.seconds is None else limits.seconds
    # the wall-clock time may exceed the processor time, because the machine may be busy, or the disk slow
    wall = 30.0 * seconds if limits.wall is None else limits.wall
    # parsers of text need up to 25 times the size, deflated images 10; at most half of the memory, because this process
    # also requires memory for the answer
    allowed = min((512 << 20) + 32 * size, available_memory() // 2)
    memory = allowed if limits.memory is None else limits.memory
    folder = path.anchor or str(Path.cwd())
    request = {"decoder": decoder, "path": str(path), "folder": folder, "options": options, "what": what,
               "seconds": seconds, "wall": wall, "memory": memory, "libraries": libraries}  # fmt: skip
    for _ in range(_ATTEMPTS):
        try:
            return _answer_to(request, path, memory, wall)
        except _EndedError as end:
            ended_by = end.by
        if ended_by not in _FROM_OUTSIDE:
            break
    raise FileFormatError(f"{path}: {_reason(ended_by, seconds, wall, memory)}")


def _answer_to(request: dict[str, Any], path: Path, memory: int, wall: float) -> Any:
    if not _CAN_FORK:
        return read_answer(_from_process(request), path, memory)
    deadline = time.monotonic() + wall + 1.0
    nursery, channel, status = _request(request)
    with channel, status:
        return read_answer(_from_socket(nursery, channel, status, deadline), path, memory)


class _EndedError(Exception):
    """End of the child before its answer was complete.

    `by` is the number of the signal that ended the child, or 0 after a normal exit. It is None if the fork server has ended or
    stopped, so that the reason is unknown.
    """

    def __init__(self, by: int | None):
        super().__init__(by)
        self.by = by


_ATTEMPTS = 2
"""Number of attempts to read a file whose reader is ended from outside.

A file that fills the memory of the machine ends both attempts.
"""
_OUT_OF_TIME = getattr(signal, "SIGPROF", -1), getattr(signal, "SIGALRM", -1)
_FROM_OUTSIDE = None, getattr(signal, "SIGKILL", -1), signal.SIGTERM
"""Reasons for the end of a child that the file does not cause: lack of memory, or a signal from a user."""


def _reason(ended_by: int | None, seconds: float, wall: float, memory: int) -> str:
    if ended_by in _FROM_OUTSIDE:
        return "the reading process was ended from outside, twice: free memory and try again"
    if ended_by == _OUT_OF_TIME[0]:
        return (
            f"reading takes more than {seconds:.3g} s of processor time: the file is damaged, or was crafted to be slow"
        )
    if ended_by == _OUT_OF_TIME[1]:
        return f"reading takes more than {wall:.3g} s: the file is damaged, or on a disk that does not respond"
    return f"the file is damaged: its decoder crashed, or needs more than {memory / 2**20:.0f} MiB"


def _from_socket(
    nursery: subprocess.Popen[bytes], channel: socket.socket, status: socket.socket, deadline: float
) -> Callable[[int], bytearray]:
    def end() -> _EndedError:
        while not (ready := select.select([status], [], [], _A_MOMENT)[0]) and _is_running(nursery):
            pass
        said = status.recv(4) if ready else b""
        return _EndedError(struct.unpack("<i", said)[0] if len(said) == 4 else None)

    def take(size: int) -> bytearray:
        data = bytearray(size)
        view, at = memoryview(data), 0
        while at < size:
            left = deadline - time.monotonic()
            if left <= 0:
                raise _EndedError(_OUT_OF_TIME[1])
            ready = select.select([channel, status], [], [], min(left, _A_MOMENT))[0]
            if not ready:
                if not _is_running(nursery):
                    raise _EndedError(None)
                continue
            count = (
                channel.recv_into(view[at:]) if channel in ready else 0
            )  # data that were sent before the end have priority
            if not count:
                raise end()
            at += count
        return data

    return take


def _from_process(request: dict[str, Any]) -> Callable[[int], bytearray]:
    """Read a file in a new process for this file alone, on systems without fork. The result is `take` of `read_answer`."""
    code = f"from {_SERVING} import serve_standard_streams; serve_standard_streams()"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], input=json.dumps(request).encode(), stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, timeout=request["wall"] + 5.0, env=_environment(), check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise _EndedError(_OUT_OF_TIME[1]) from None
    whole = io.BytesIO(done.stdout)

    def take(size: int) -> bytearray:
        data = bytearray(whole.read(size))
        if len(data) < size:
            raise _EndedError(max(-done.returncode, 0))
        return data

    return take


# -- the fork server
# -------------------------------------------------------------------------------------------------------------

_CAN_FORK = hasattr(os, "fork") and hasattr(socket, "send_fds")


_A_MOMENT = 1.0
"""Interval of the checks of the fork server, s: hardly noticeable for a user."""


def _is_running(process: subprocess.Popen[bytes]) -> bool:
    if process.poll() is not None:
        return False
    if not hasattr(os, "waitid"):
        return True
    with contextlib.suppress(ChildProcessError):
        return os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is None
    return False


class _Nursery:
    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Reset this object after a fork of this process.

        The new process must not share the fork server, or a lock that another thread may hold.
        """
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None
        self.channel: socket.socket | None = None

    def _started(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        if self.process is None or self.channel is None or not _is_running(self.process):
            self._stop()
            ours, theirs = socket.socketpair()
            with theirs:
                code = f"from {_SERVING} import serve_by_forking; serve_by_forking({theirs.fileno()})"
                self.process = subprocess.Popen(
                    [sys.executable, "-c", code], pass_fds=[theirs.fileno()], env=_environment(), start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
            self.channel = ours
        return self.process, self.channel

    def _stop(self) -> None:
        if self.channel is not None:
            self.channel.close()
        if self.process is not None:
            self.process.kill()
            self.process.wait()
        self.channel = self.process = None

    def stop(self) -> None:
        with self.lock:
            self._stop()

    def send(self, request: dict[str, Any], *sockets: socket.socket) -> subprocess.Popen[bytes]:
        """Send a request to the fork server, and return the process of the fork server.

        `sockets` are the socket for the answer and the socket for the signal that ended the child.
        """
        text = json.dumps(request).encode()
        with self.lock:
            for attempt in range(1, _ATTEMPTS + 1):  # the fork server may have ended since the last file
                try:
                    process, channel = self._started()
                    socket.send_fds(channel, [struct.pack("<Q", len(text))], [one.fileno() for one in sockets])
                    channel.sendall(text)
                except OSError:
                    self._stop()
                    if attempt == _ATTEMPTS:
                        raise
                else:
                    break
        return process


_nursery = _Nursery()
atexit.register(_nursery.stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_nursery.forget)


def _request(request: dict[str, Any]) -> tuple[subprocess.Popen[bytes], socket.socket, socket.socket]:
    channel, its_channel = socket.socketpair()
    status, its_status = socket.socketpair()
    with its_channel, its_status:
        try:
            return _nursery.send(request, its_channel, its_status), channel, status
        except OSError:
            channel.close()
            status.close()
            raise


def _environment() -> dict[str, str]:
    # a process with threads must not fork; a heap for each thread would take address space, which is limited
    return {
        **os.environ,
        **ONE_BLAS_THREAD,
        "MALLOC_ARENA_MAX": "1",
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
    }
