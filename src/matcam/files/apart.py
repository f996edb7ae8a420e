"""Read a file in a process of its own, which has limits and can be killed.

Decoders of foreign formats (HDF5, OpenEXR, TIFF, PNG, JPEG, camera raw, Zarr) are large C libraries that trust their input: a
damaged or hostile file makes them crash, hang or fill the memory. So they run apart:

    this process  --request-->  nursery  --fork-->  child (limits, then one decoder, one file)
                  <------------ result: JSON, then arrays as bytes ------------

The nursery is a small Python process without threads, started once; a child of it costs milliseconds. A child may not write
files, and what it answers is JSON and plain numbers: nothing is unpickled. Where a system cannot fork (Windows), each file
has a new process.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import io
import json
import math
import os
import select
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

import numpy as np

from matcam.core import errors
from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.memory import available_memory
from matcam.core.threads import ONE_BLAS_THREAD

_KINDS = "biufcSU"
"""NumPy's kinds of numbers and text that an answer may hold."""
_LONGEST_ANSWER = 64 << 20  # bytes of JSON
_SECONDS, _BYTES_A_SECOND = 10.0, 20e6
"""Processor time that a file may take to be decoded: so many seconds, and one more for so many bytes."""
_PATIENCE = 30.0
"""Wall-clock time over processor time: a busy machine or a slow disk is no fault of the file."""


class Limits(NamedTuple):
    """Say what reading one file may cost.

    Attributes:
        seconds: processor time; None: 10 s, and 1 s more for every 20 MB of the file. Default: None.
        memory: bytes beyond what the decoder's process has at its start; None: half of what is available now. Default: None.
        wall: wall-clock time, s; None: 30 times the processor time. Default: None.
    """

    seconds: float | None = None
    memory: int | None = None
    wall: float | None = None


_NORMAL = Limits()
_limits: ContextVar[Limits | None] = ContextVar("limits", default=_NORMAL)


@contextmanager
def reading_limits(limits: Limits | None) -> Iterator[None]:
    """Read the files opened inside under other limits; None trusts them: they are decoded in this process."""
    token = _limits.set(limits)
    try:
        yield
    finally:
        _limits.reset(token)


def files_are_trusted() -> bool:
    """Tell whether files are decoded in this process, without limits."""
    return _limits.get() is None


def start_reader(modules: Sequence[str]) -> None:
    """Start the process that will read files, in the background, and let it import these modules."""
    if _CAN_FORK and not files_are_trusted():
        with contextlib.suppress(OSError):  # whoever then reads a file will say what is wrong
            ours, theirs = socket.socketpair()
            with ours, theirs:
                _nursery.send({"module": "", "libraries": list(modules)}, theirs)


def read_apart(decoder: str, path: Path, *, libraries: tuple[str, ...] = (), **options: Any) -> Any:
    """Call `decoder` ("package.module:function") on a file in a process of its own.

    `libraries` are those that it imports. Its answer may be made of None, truth values, numbers, text, lists, dicts with text
    keys, and NumPy arrays. FileFormatError, naming the file, where it exceeds a limit or brings its decoder down; the decoder's
    own errors are raised as they are.
    """
    limits = _limits.get()
    module, name = decoder.split(":")
    if limits is None:
        return _call(module, name, path, options)
    seconds = limits.seconds
    if seconds is None:
        with reading(path):
            seconds = _SECONDS + path.stat().st_size / _BYTES_A_SECOND
    wall = _PATIENCE * seconds if limits.wall is None else limits.wall
    # half at most: this process will hold the answer too, and work on it
    memory = limits.memory if limits.memory is not None else available_memory() // 2
    folder = path.anchor or str(Path.cwd())
    request = {"module": module, "name": name, "path": str(path), "folder": folder, "options": options,
               "seconds": seconds, "wall": wall, "memory": memory, "libraries": libraries}  # fmt: skip
    begin = time.monotonic()
    try:
        if not _CAN_FORK:
            return _answer(_from_process(request), path, memory)
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                _nursery.send(request, theirs)
            return _answer(_from_socket(ours, begin + wall + 1.0), path, memory)
    except EOFError:
        taken = time.monotonic() - begin
        if taken >= wall:
            raise FileFormatError(
                f"{path}: reading takes more than {wall:.3g} s: damaged, or on a disk that does not answer"
            ) from None
        if taken >= seconds:
            raise FileFormatError(
                f"{path}: reading takes more than {seconds:.3g} s of processor time: damaged, or made to be slow"
            ) from None
        raise FileFormatError(
            f"{path}: damaged: its decoder crashed, or needs more than {memory / 2**20:.0f} MiB"
        ) from None


def _call(module: str, name: str, path: Path, options: dict[str, Any]) -> Any:
    return getattr(importlib.import_module(module), name)(path, **options)


# -- the answer: a length and JSON, in which arrays are {"array": number}, then each array's bytes --------------------------


def _packed(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype == object:
            texts = [v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in array.ravel()]
            return {"texts": texts, "shape": list(array.shape)}
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"values of type {array.dtype} are not supported")
        arrays.append(np.ascontiguousarray(array))
        return {"array": len(arrays) - 1, "type": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, dict):
        return {"dict": {str(key): _packed(v, arrays) for key, v in value.items()}}
    if isinstance(value, list | tuple):
        return {"list": [_packed(v, arrays) for v in value]}
    if value is None or isinstance(value, bool | int | float | str):
        return {"value": value}
    raise TypeError(f"an answer cannot hold {type(value).__name__}")


def _unpacked(value: Any, arrays: list[np.ndarray]) -> Any:
    if "value" in value:
        return value["value"]
    if "dict" in value:
        return {key: _unpacked(v, arrays) for key, v in value["dict"].items()}
    if "list" in value:
        return [_unpacked(v, arrays) for v in value["list"]]
    if "texts" in value:
        return np.array(value["texts"], dtype=str).reshape(value["shape"])
    array = arrays[value["array"]]
    return array[()] if array.ndim == 0 else array


def _layout(value: Any) -> list[tuple[np.dtype, tuple[int, ...]]]:
    """Return the types and shapes of the arrays that a packed answer announces, in their order."""
    if "array" in value:
        return [(np.dtype(value["type"]), tuple(value["shape"]))]
    inside = value.get("dict", {}).values() if "dict" in value else value.get("list", [])
    return [array for v in inside for array in _layout(v)]


def _answer(take: Callable[[int], bytearray], path: Path, memory: int) -> Any:
    """Return the answer that `take` yields piece by piece; EOFError where it ends too early."""
    (length,) = struct.unpack("<Q", take(8))
    if length > _LONGEST_ANSWER:
        raise FileFormatError(f"{path}: its description alone takes {length} bytes: damaged")
    message = json.loads(bytes(take(length)))
    if "error" in message:
        kind = getattr(errors, message["error"], FileFormatError)
        raise kind(message["text"])
    arrays = []
    layout = _layout(message["answer"])
    if sum(dtype.itemsize * math.prod(shape) for dtype, shape in layout) > memory:
        raise FileFormatError(f"{path}: what it holds needs more than {memory / 2**20:.0f} MiB")
    for dtype, shape in layout:
        if dtype.kind not in _KINDS:
            raise FileFormatError(f"{path}: values of type {dtype} are not supported")
        arrays.append(np.frombuffer(take(dtype.itemsize * math.prod(shape)), dtype).reshape(shape))
    return _unpacked(message["answer"], arrays)


def _from_socket(channel: socket.socket, deadline: float) -> Callable[[int], bytearray]:
    def take(size: int) -> bytearray:
        data = bytearray(size)
        view, at = memoryview(data), 0
        while at < size:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([channel], [], [], left)[0]:
                raise EOFError
            count = channel.recv_into(view[at:])
            if not count:
                raise EOFError
            at += count
        return data

    return take


def _from_process(request: dict[str, Any]) -> Callable[[int], bytearray]:
    """Decode in a new process for this file alone: systems that cannot fork."""
    code = "from matcam.files.apart import _serve_standard_streams; _serve_standard_streams()"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], input=json.dumps(request).encode(), stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, timeout=request["wall"] + 5.0, env=_environment(), check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise EOFError from None
    whole = io.BytesIO(done.stdout)

    def take(size: int) -> bytearray:
        data = bytearray(whole.read(size))
        if len(data) < size:
            raise EOFError
        return data

    return take


def _written(write: Callable[[Any], Any], message: dict[str, Any], arrays: list[np.ndarray]) -> None:
    text = json.dumps(message).encode()
    write(struct.pack("<Q", len(text)) + text)
    for array in arrays:
        if array.nbytes:
            write(array.reshape(-1).view(np.uint8).data if array.dtype.kind not in "SU" else array.tobytes())


# -- the child ---------------------------------------------------------------------------------------------------------------


def _serve(request: dict[str, Any], write: Callable[[Any], Any]) -> None:
    """Decode one file under its limits, and write the answer."""
    _limit(request["seconds"], request["wall"], request["memory"])
    arrays: list[np.ndarray] = []
    try:
        os.chdir(request["folder"])  # the caller's: messages name the file as it does
        answer = _call(request["module"], request["name"], Path(request["path"]), request["options"])
        message = {"answer": _packed(answer, arrays)}
    except errors.MatcamError as error:
        message, arrays = {"error": type(error).__name__, "text": str(error)}, []
    except MemoryError:
        text = f"{request['path']}: reading needs more than {request['memory'] / 2**20:.0f} MiB"
        message, arrays = {"error": "FileFormatError", "text": text}, []
    except Exception as error:
        text = f"{request['path']}: damaged: {' '.join(str(error).split())[:120] or type(error).__name__}"
        message, arrays = {"error": "FileFormatError", "text": text}, []
    _written(write, message, arrays)


def _limit(seconds: float, wall: float, memory: int) -> None:
    try:
        import resource
        import signal
    except ImportError:  # not a Unix: the reader of the answer kills this process
        return
    for timer, number, limit in (
        (signal.ITIMER_PROF, signal.SIGPROF, seconds),
        (signal.ITIMER_REAL, signal.SIGALRM, wall),
    ):
        signal.signal(number, signal.SIG_DFL)
        signal.setitimer(timer, limit)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # a decoder writes nothing
    if sys.platform == "linux":
        now = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (now + memory, now + memory))


# -- the nursery -------------------------------------------------------------------------------------------------------------

_CAN_FORK = hasattr(os, "fork") and hasattr(socket, "send_fds")


class _Nursery:
    """The process that forks, and the socket to it."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None
        self.owner = 0
        self.channel: socket.socket | None = None

    def _start(self) -> socket.socket:
        alive = self.process is not None and self.process.poll() is None
        if self.channel is None or not alive or self.owner != os.getpid():
            self._stop()
            ours, theirs = socket.socketpair()
            with theirs:
                code = f"from matcam.files.apart import _serve_by_forking; _serve_by_forking({theirs.fileno()})"
                self.process = subprocess.Popen(
                    [sys.executable, "-c", code], pass_fds=[theirs.fileno()], env=_environment(), start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
            self.channel, self.owner = ours, os.getpid()
        return self.channel

    def _stop(self) -> None:
        if self.channel is not None:
            self.channel.close()
        if self.process is not None and self.owner == os.getpid():  # not if this process is itself a fork
            self.process.kill()
            self.process.wait()
        self.channel = self.process = None

    def stop(self) -> None:
        """End it; the next file starts another."""
        with self.lock:
            self._stop()

    def send(self, request: dict[str, Any], channel: socket.socket) -> None:
        """Pass a request on, with the socket on which it is to be answered."""
        text = json.dumps(request).encode()
        with self.lock:
            for attempt in (1, 2):  # it may have been killed since the last file
                try:
                    to = self._start()
                    socket.send_fds(to, [struct.pack("<Q", len(text))], [channel.fileno()])
                    to.sendall(text)
                    return
                except OSError:
                    self._stop()
                    if attempt == 2:
                        raise


_nursery = _Nursery()
atexit.register(_nursery.stop)


def _environment() -> dict[str, str]:
    # a process that has threads must not fork
    return {**os.environ, **ONE_BLAS_THREAD, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


def _serve_standard_streams() -> None:
    request = json.loads(sys.stdin.buffer.read())
    _serve(request, sys.stdout.buffer.write)
    sys.stdout.buffer.flush()


def _serve_by_forking(number: int) -> None:
    """Fork a child for every request that comes, until there will be no more."""
    import signal

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the children
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests = socket.socket(fileno=number)
    while True:
        head, descriptors, *_ = socket.recv_fds(requests, 8, 1)
        if len(head) < 8 or not descriptors:
            return
        (length,) = struct.unpack("<Q", head)
        text = bytearray()
        while len(text) < length and (piece := requests.recv(length - len(text))):
            text += piece
        request = json.loads(bytes(text))
        for name in filter(None, (request["module"], *request["libraries"])):  # once, for all children to come
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
        if request["module"] and os.fork() == 0:
            requests.close()
            try:
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                with socket.socket(fileno=descriptors[0]) as channel:
                    _serve(request, channel.sendall)
            finally:
                os._exit(0)
        os.close(descriptors[0])
