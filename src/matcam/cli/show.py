"""Output of the commands: results and tables to standard output, progress and remarks to standard error."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from matcam.core.io import plain

_SECONDS = 30.0


def as_json(result: Any) -> None:
    """Print a result as one JSON document; NaN and infinity become null."""
    print(json.dumps(plain(result), indent=2, ensure_ascii=False, allow_nan=False))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table, its first column aligned left, the others right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    drawn = Table(
        *(head[:1]), box=box.SIMPLE_HEAD, title=title or None, title_justify="left", title_style="bold", pad_edge=False
    )
    for name in head[1:]:
        drawn.add_column(name, justify="right")
    for row in rows:
        drawn.add_row(*row)
    Console(file=sys.stdout, highlight=False).print(drawn)


def say(text: str, *, quiet: bool = False) -> None:
    """Print a line of the result, unless standard output belongs to JSON."""
    if not quiet:
        print(text)


def remark(text: str) -> None:
    """Print a line to standard error: what was left out, or failed without ending the work."""
    print(f"matcam: {text}", file=sys.stderr)


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Show on standard error that work is in progress, if that is a terminal."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextlib.contextmanager
def counting(what: str) -> Iterator[Any]:
    """Show a progress bar over bytes on standard error; yield update(done, total)."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextlib.contextmanager
def tallying(what: str) -> Iterator[Any]:
    """Show a progress bar over jobs and the time left; yield update(done, total).

    It stands on standard error; if that is no terminal, a line appears there at most twice a minute.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    terminal = sys.stderr.isatty()
    with Progress(
        *columns, console=Console(stderr=True), disable=not terminal, speed_estimate_period=3600.0
    ) as progress:
        task = progress.add_task(what, total=None)
        log = _Log(what)
        begun = False

        def update(done: int, total: int) -> None:
            nonlocal begun
            if begun:
                progress.update(task, completed=done, total=total)
            else:  # what was done before says nothing of the pace
                progress.reset(task, completed=done, total=total)
            begun = True
            if not terminal:
                log.update(done, total)

        yield update


class _Log:
    """Report progress as lines, at most one in half a minute."""

    def __init__(self, what: str):
        self.what, self.started, self.last, self.first = what, time.monotonic(), -math.inf, 0

    def update(self, done: int, total: int) -> None:
        """Report how far the work is, and how long the rest will take at the pace so far."""
        now = time.monotonic()
        if self.last == -math.inf:
            self.first, self.started = done, now
        if now - self.last < _SECONDS and done < total:
            return
        self.last = now
        left = (now - self.started) / (done - self.first) * (total - done) if done > self.first else math.nan
        remark(f"{self.what}: {done} of {total}" + (f", {_span(left)} left" if 0 < left < math.inf else ""))


def _span(seconds: float) -> str:
    """Write a time in the largest unit of which there are at least two."""
    for unit, size in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
