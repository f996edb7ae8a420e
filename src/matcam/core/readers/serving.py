"""Processes that read files: a fork server starts a child for each file. The child has limits of time and memory."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import select
import signal
import socket
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core import errors
from matcam.core.errors import FileFormatError, one_line
from matcam.core.io import reading
from matcam.core.readers.answers import packed, write_answer
from matcam.core.registry import imported


def decoded(decoder: str, path: Path, options: dict[str, Any], what: str) -> Any:
    """Call a decoder, and convert its errors to FileFormatError.

    A decoder may raise any error for a damaged file. Errors of matcam and a MemoryError are not converted. The message is one
    line that names the file. `what` is the expected content, such as "an image".
    """
    with reading(path, what):
        try:
            return imported(decoder)(path, **options)
        except (errors.MatcamError, MemoryError):
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno:  # an error of the system, and not of a library
                raise
            raise FileFormatError(
                f"{path}: the file is damaged{what and ', or not '}{what}: {one_line(error)}"
            ) from None


def _serve(request: dict[str, Any], write: Callable[[Any], Any]) -> None:
    _limit(request["seconds"], request["wall"], request["memory"])
    arrays: list[np.ndarray] = []
    try:
        os.chdir(request["folder"])  # messages contain the path as the caller gave it
        path = Path(request["path"])
        answer = decoded(request["decoder"], path, request["options"], request["what"])
        message = {"answer": packed(answer, arrays)}
    except errors.MatcamError as error:
        message, arrays = {"error": type(error).__name__, "text": str(error)}, []
    except MemoryError:
        text = f"{request['path']}: reading needs more than {request['memory'] / 2**20:.0f} MiB: give a smaller file"
        message, arrays = {"error": "FileFormatError", "text": text}, []
    except Exception as error:
        text = f"{request['path']}: the file is damaged: {one_line(error)}"  # the answer cannot be packed
        message, arrays = {"error": "FileFormatError", "text": text}, []
    write_answer(write, message, arrays)


def _limit(seconds: float, wall: float, memory: int) -> None:
    try:
        import resource
    except ImportError:  # not a Unix: the caller kills this process
        return
    for timer, number, limit in (
        (signal.ITIMER_PROF, signal.SIGPROF, seconds),
        (signal.ITIMER_REAL, signal.SIGALRM, wall),
    ):
        signal.signal(number, signal.SIG_DFL)
        signal.setitimer(timer, limit)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # a decoder writes no files
    if sys.platform == "linux":
        now = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
        # libraries start one thread per processor; the memory of a file suffices for 16, and each other takes 8 MiB
        most = now + memory + (8 << 20) * max((os.cpu_count() or 1) - 16, 0)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def serve_standard_streams() -> None:
    request = json.loads(sys.stdin.buffer.read())
    _serve(request, sys.stdout.buffer.write)
    sys.stdout.buffer.flush()


def serve_by_forking(number: int) -> None:
    """Fork a child for every request, and report the end of each child.

    `number` is the file descriptor of the socket for the requests. The function returns when the caller closes this socket.
    """
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    woken, waking = socket.socketpair()
    waking.setblocking(False)
    signal.set_wakeup_fd(waking.fileno(), warn_on_full_buffer=False)  # the end of a child ends the select
    requests = socket.socket(fileno=number)
    children: dict[int, socket.socket] = {}
    while True:
        ready = select.select([requests, woken], [], [])[0]
        if woken in ready:
            woken.recv(4096)
            _report_ends(children)
        if requests not in ready:
            continue
        head, descriptors, *_ = socket.recv_fds(requests, 8, 2)
        if len(head) < 8 or len(descriptors) < 2:
            return
        channel, status = (socket.socket(fileno=descriptor) for descriptor in descriptors)
        (length,) = struct.unpack("<Q", head)
        text = bytearray()
        while len(text) < length and (piece := requests.recv(length - len(text))):
            text += piece
        request = json.loads(bytes(text))
        module = request["decoder"].partition(":")[0]
        for name in filter(None, (module, *request["libraries"])):  # once, for all future children
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
        with channel:
            if not module:
                status.close()
            elif child := os.fork():
                children[child] = status
            else:
                signal.set_wakeup_fd(-1)
                for one in (requests, woken, waking, status, *children.values()):
                    one.close()
                _serve_as_child(request, channel)


def _report_ends(children: dict[int, socket.socket]) -> None:
    """Send, for each child that has ended, the number of the signal that ended it, or 0 after a normal exit.

    `children` contains the socket for this number, by process number.
    """
    while children:
        child, status = os.waitpid(-1, os.WNOHANG)
        if not child:
            return
        with children.pop(child) as channel, contextlib.suppress(OSError):  # a reader that has ended requires no report
            channel.sendall(struct.pack("<i", os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0))


def _serve_as_child(request: dict[str, Any], channel: socket.socket) -> None:
    try:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        _serve(request, channel.sendall)
    finally:
        os._exit(0)
