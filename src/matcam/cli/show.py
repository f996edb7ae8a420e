"""Output of the commands: results and tables to standard output, progress and remarks to standard error.

Text may come from untrusted files. Therefore control characters are printed as escape sequences, and markup is disabled.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from matcam.cli import activity
from matcam.core.io import plain
from matcam.core.readers.names import UNPRINTABLE, printable

if TYPE_CHECKING:
    from matcam.core.results.summary import Quantity

_SECONDS = 30.0
"""Smallest time between two lines of progress, s, which keeps the log of a long run short."""
_LEAST_WIDTH = 20
"""Smallest width of a table, characters. At a width of 0, Rich prints nothing."""

_broken: list[OSError] = []
"""First error of writing to standard output; empty if there was none."""

_manner: list[tuple[bool, str]] = [(False, "")]
"""Output settings of the running commands, the innermost last: quiet or not, and the name of the schema of their
JSON.
"""

_wordings: list[Callable[[str], str]] = [str]
"""Translations of messages of the library for the running commands, the innermost last."""


@contextlib.contextmanager
def wording(translate: Callable[[str], str]) -> Iterator[None]:
    """Translate all lines and remarks while a command runs.

    Args:
        translate: function that replaces the names of Python arguments in a line by options of the command.
    """
    _wordings.append(translate)
    try:
        yield
    finally:
        _wordings.pop()


def worded(text: str) -> str:
    return "\n".join(map(_wordings[-1], text.split("\n")))


@contextlib.contextmanager
def speaking(*, quiet: bool, schema: str) -> Iterator[None]:
    """Apply the output settings of a command while it runs.

    Args:
        quiet: True to print only JSON on standard output.
        schema: name of the schema of JSON documents; "": the documents do not name one.
    """
    _manner.append((quiet or _manner[-1][0], schema))
    try:
        yield
    finally:
        _manner.pop()


def as_json(result: dict[str, Any]) -> None:
    """Print a result as one JSON document.

    The first entry is the name of the schema, if one is set by `speaking`. NaN and infinity become null.
    """
    named = {"schema": _manner[-1][1], **result} if _manner[-1][1] else result
    text = _laid_out(plain(named))
    # the document contains no control characters except line breaks; other unprintable characters are escaped
    _print("\n".join(re.sub(UNPRINTABLE, lambda found: f"\\u{ord(found[0]):04x}", line) for line in text.split("\n")))


def _laid_out(value: Any, indent: str = "") -> str:
    """Format JSON: one entry per line, and an array of numbers or strings on one line."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        entries = [f"{json.dumps(str(key), ensure_ascii=False)}: {_laid_out(one, inner)}" for key, one in value.items()]
    elif isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        entries = [_laid_out(one, inner) for one in value]
    else:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    lines = ",\n".join(inner + one for one in entries)
    return f"{opening}\n{lines}\n{indent}{closing}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    if _manner[-1][0]:
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    named = Text(printable(title)) if title else None
    drawn = Table(box=box.SIMPLE_HEAD, title=named, title_justify="left", title_style="bold", pad_edge=False)
    for number, name in enumerate(head):
        words = " ".join([name, *(row[number] for row in rows)]).split()
        # words of up to 24 characters are not broken, which is enough for numbers and names of parameters
        least = min(max(map(len, words), default=0), 24)
        drawn.add_column(Text(printable(name)), justify="right" if number else "left", min_width=least)
    for row in rows:
        drawn.add_row(*(Text(printable(cell)) for cell in row))
    with io.StringIO() as drawing:
        console = Console(file=drawing, highlight=False, force_terminal=sys.stdout.isatty(), width=_width())
        # two blanks and a separator for each column
        whole = sum(column.min_width or 0 for column in drawn.columns) + 3 * len(head)
        console.print(drawn, width=max(console.width, whole), crop=False)
        _print("\n".join(line.rstrip() for line in drawing.getvalue().split("\n")), end="")


def quantities(rows: Iterable[Quantity], title: str = "", head: str = "parameter") -> None:
    """Print quantities with their standard deviations as a table."""
    table([head, "value ± std"], [[row.name, row.text] for row in rows], title)


def _width() -> int | None:
    """Determine the width of tables, characters: `_LEAST_WIDTH` if $COLUMNS is smaller, otherwise None (automatic)."""
    stated = os.environ.get("COLUMNS", "")
    return _LEAST_WIDTH if stated.isdigit() and int(stated) < _LEAST_WIDTH else None


def say(text: str, *, quiet: bool = False, verbatim: bool = False) -> None:
    """Print a line of the result, unless `quiet` is set or the command prints only JSON.

    Names of arguments become names of options, unless `verbatim` is set.
    """
    if not quiet:
        _say(text if verbatim else worded(text))


def notes(texts: Iterable[object]) -> None:
    for text in texts:
        _say(f"note: {worded(str(text))}")


def _say(text: str) -> None:
    if not _manner[-1][0]:
        _print("\n".join(map(printable, text.split("\n"))))


def written(paths: Iterable[object]) -> None:
    say(f"written: {', '.join(map(str, paths))}")


def remark(text: str) -> None:
    activity.clear()
    with contextlib.suppress(OSError):
        print(f"matcam: {printable(worded(text))}", file=sys.stderr)


def _print(text: str, end: str = "\n") -> None:
    """Print to standard output.

    If standard output cannot be written, the command continues, because its files are more important.
    """
    activity.clear()
    if not _broken:
        try:
            print(text, end=end, flush=True)
        except OSError as error:
            _broken.append(error)


def broken_output() -> OSError | None:
    return _broken.pop() if _broken else None


working = activity.doing
"""Show the current step of a command, if standard error is a terminal."""


@contextlib.contextmanager
def _bar(*columns: Any, **options: Any) -> Iterator[Any]:
    from rich import progress as rich
    from rich.console import Console

    shown = rich.TextColumn("{task.description}", markup=False), rich.BarColumn(), *columns
    bar = rich.Progress(*shown, console=Console(stderr=True), disable=not sys.stderr.isatty(), **options)
    with activity.hidden(), bar as progress:
        yield progress


@contextlib.contextmanager
def counting(what: str) -> Iterator[Any]:
    """Show a progress bar on standard error, and yield the function update(done, total), whose arguments are in bytes."""
    from rich import progress as rich

    with _bar(rich.DownloadColumn(), rich.TransferSpeedColumn(), rich.TimeRemainingColumn()) as progress:
        task = progress.add_task(printable(what), total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextlib.contextmanager
def tallying(what: str) -> Iterator[Any]:
    """Show the progress of jobs and the remaining time, and yield the function update(done, total).

    The arguments of this function are numbers of jobs. A bar is written to standard error. If standard error is not a
    terminal, about two lines a minute are written instead.
    """
    from rich import progress as rich

    terminal = sys.stderr.isatty()
    columns = rich.MofNCompleteColumn(), rich.TimeElapsedColumn(), rich.TextColumn("left:"), rich.TimeRemainingColumn()
    with _bar(*columns, speed_estimate_period=3600.0) as progress:
        task = progress.add_task(what, total=None)
        log = _log_lines()
        begun: tuple[int, float] | None = None

        def update(done: int, total: int) -> None:
            nonlocal begun
            now = time.monotonic()
            if begun is None:  # earlier work does not predict the speed
                begun = done, now
                progress.reset(task, completed=done, total=total)
            else:
                progress.update(task, completed=done, total=total)
            if not terminal:
                first, started = begun
                left = (now - started) / (done - first) * (total - done) if done > first else math.nan
                rest = f", {_span(left)} left" if 0 < left < math.inf else ""
                log(f"{what}: {done} of {total}{rest}", done >= total)

        yield update


@contextlib.contextmanager
def stepping() -> Iterator[Any]:
    """Show the steps of long work on standard error, and yield the function update(step, done, total).

    `total` is 0 if the number of parts of a step is unknown. If standard error is not a terminal, at most two lines a minute
    are written.
    """
    log, terminal = _log_lines(), sys.stderr.isatty()

    def update(step: str, done: int, total: int) -> None:
        (activity.rename if terminal else log)(f"{step}: {done} of {total}" if total else step)

    with activity.doing("starting"):
        yield update


def _log_lines() -> Callable[..., None]:
    """Build a function log(line, last) that writes at most two lines a minute to standard error, and the last one."""
    written_at = -math.inf

    def log(line: str, last: bool = False) -> None:
        nonlocal written_at
        now = time.monotonic()
        if last or now - written_at >= _SECONDS:
            written_at = now
            remark(line)

    return log


def _span(seconds: float) -> str:
    """Format a duration, s, in the largest unit in which the number is at least 2, or in seconds."""
    for unit, size in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
