"""A line on the terminal that shows what a command is doing, for how long, and how long it took last time.

It appears within a second, whatever the command does: imports, a compilation, a fit. What is printed meanwhile takes its place,
and it comes back.
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

from matcam.core.io import replacing, user_cache_folder
from matcam.core.readers.names import printable

_FIRST, _EACH = 0.8, 0.25  # s: when the line appears, and how often it is drawn
_LONG = 10.0
"""Seconds from which the line shows how long the command took last time."""
_SIGNS = "|/-\\"
_DURATIONS = "durations.json"
_CLEAR = "\r\033[2K"


class Activity:
    """The line of one command."""

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
        """Take the line away, so that something can be printed; what follows a result needs no line but its own."""
        with self._lock:
            if len(self.doing) == 1:
                self.doing[0] = ""
            self._wipe()

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Show no line while something else draws on the terminal."""
        with self._lock:
            self._hidden += 1
            self._wipe()
        try:
            yield
        finally:
            with self._lock:
                self._hidden -= 1

    def end(self) -> None:
        """Take the line away, and remember how long the command took."""
        self._ended.set()
        self._thread.join()
        self._wipe()
        took = time.monotonic() - self.started
        if took > _LONG / 2:
            _remember(self.name, took)

    def line(self) -> str:
        """Return what is shown now."""
        took = time.monotonic() - self.started
        text = f"{self.doing[-1]} {took:.0f} s"
        if took >= _LONG and self._last is not None:
            text += f" (last time {self._last:.0f} s in all)"
        if self._new and "jax" in sys.modules:
            text += "; first run on this machine: programs are prepared once"
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
        with contextlib.suppress(OSError, ValueError):  # a terminal that has gone
            sys.stderr.write(text)
            sys.stderr.flush()


_shown: list[Activity] = []


@contextlib.contextmanager
def shown(name: str) -> Iterator[None]:
    """Show a command's line while it runs, if standard error is a terminal."""
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
    """Name what a command is doing."""
    if not _shown:
        yield
        return
    _shown[-1].doing.append(what)
    try:
        yield
    finally:
        _shown[-1].doing.pop()


def rename(what: str) -> None:
    """Give what a command is doing another name."""
    if _shown:
        _shown[-1].doing[-1] = what


def clear() -> None:
    """Make room for something that is printed."""
    if _shown:
        _shown[-1].clear()


def hidden() -> contextlib.AbstractContextManager[Any]:
    """Make room for something that draws on the terminal."""
    return _shown[-1].hidden() if _shown else contextlib.nullcontext()


def _durations() -> dict[str, float]:
    """Return how long commands took last, s."""
    try:
        known = json.loads(_path().read_text(encoding="utf-8"))
        return {str(name): float(took) for name, took in known.items()}
    except (OSError, ValueError, TypeError, AttributeError):  # there is none, or a damaged one
        return {}


def _remember(name: str, took: float) -> None:
    with contextlib.suppress(Exception):  # a command does not fail for it
        _path().parent.mkdir(parents=True, exist_ok=True)
        with replacing(_path(), force=True) as temporary:
            temporary.write_text(json.dumps(_durations() | {name: round(took, 1)}), encoding="utf-8")


def _path() -> Path:
    return user_cache_folder() / _DURATIONS
