"""Status line on the terminal: current step of a command, elapsed time, and duration of the last run.

The line appears within a second, during imports, compilation and fits. Printed output replaces it temporarily.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matcam.core.io import user_cache_folder, write_text
from matcam.core.readers.names import printable

_FIRST, _EACH = 0.8, 0.25  # delay before the line appears, and interval between its updates, s
_LONG = 10.0
"""Elapsed time from which the line shows the duration of the last run, s. A shorter command needs no estimate."""
_SIGNS = "|/-\\"
_CLEAR = "\r\033[2K"


class Activity:
    """Status line of one command."""

    def __init__(self, name: str):
        self.name, self.started = name, time.monotonic()
        self.doing = [f"{name}: starting"]
        self._last = _durations().get(name)
        self._new = not user_cache_folder().exists()
        self._lock, self._ended = threading.RLock(), threading.Event()
        self._drawn, self._hidden = False, 0
        self._thread = threading.Thread(target=self._draw_on, daemon=True)
        self._thread.start()

    def clear(self) -> None:
        with self._lock:
            if len(self.doing) == 1:
                self.doing[0] = ""
            self._wipe()

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        with self._lock:
            self._hidden += 1
            self._wipe()
        try:
            yield
        finally:
            with self._lock:
                self._hidden -= 1

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        self._wipe()
        took = time.monotonic() - self.started
        if took > _LONG / 2:
            _remember(self.name, took)

    def line(self) -> str:
        took = time.monotonic() - self.started
        text = f"{self.doing[-1]} {took:.0f} s"
        if took >= _LONG and self._last is not None:
            text += f" (last run: {self._last:.0f} s)"
        if self._new and "jax" in sys.modules:
            text += "; first run on this machine: programs are compiled and stored"
        return text

    def _draw_on(self) -> None:
        wait = _FIRST
        turn = 0
        while not self._ended.wait(wait):
            wait, turn = _EACH, turn + 1
            with self._lock:
                if self.doing[-1] and not self._hidden:
                    width = shutil.get_terminal_size().columns - 3
                    self._write(f"{_CLEAR}{_SIGNS[turn % len(_SIGNS)]} {printable(self.line())[:width]}")
                    self._drawn = True

    def _wipe(self) -> None:
        if self._drawn:
            self._write(_CLEAR)
            self._drawn = False

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # the terminal was closed
            sys.stderr.write(text)
            sys.stderr.flush()


_shown: list[Activity] = []


@contextlib.contextmanager
def shown(name: str) -> Iterator[None]:
    if _shown or not sys.stderr.isatty():
        yield
        return
    _shown.append(Activity(name))
    try:
        yield
    finally:
        _shown.pop().end()


@contextlib.contextmanager
def doing(what: str) -> Iterator[None]:
    if not _shown:
        yield
        return
    _shown[-1].doing.append(what)
    try:
        yield
    finally:
        _shown[-1].doing.pop()


def rename(what: str) -> None:
    if _shown:
        _shown[-1].doing[-1] = what


def clear() -> None:
    if _shown:
        _shown[-1].clear()


def hidden() -> contextlib.AbstractContextManager[Any]:
    return _shown[-1].hidden() if _shown else contextlib.nullcontext()


def _durations() -> dict[str, float]:
    try:
        known = json.loads(_path().read_text(encoding="utf-8"))
        return {str(name): float(took) for name, took in known.items()}
    except (OSError, ValueError, TypeError, AttributeError):  # a missing or damaged file
        return {}


def _remember(name: str, took: float) -> None:
    with contextlib.suppress(Exception):  # failure to write the file is not an error
        _path().parent.mkdir(parents=True, exist_ok=True)
        write_text(_path(), json.dumps(_durations() | {name: round(took, 1)}), force=True)


def _path() -> Path:
    return user_cache_folder() / "durations.json"
