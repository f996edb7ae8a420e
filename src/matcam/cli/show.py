"""How commands talk: results and tables on standard output, progress and remarks on standard error."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterator, Sequence
from typing import Any


def as_json(result: Any) -> None:
    """Print a result as one JSON document; what is not a number is null."""
    print(json.dumps(plain(result), indent=2, ensure_ascii=False, allow_nan=False))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table: first column left, the others right."""
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
    """Print a line on standard error: what was left out, what went wrong without ending the work."""
    print(f"matcam: {text}", file=sys.stderr)


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Show on standard error that something is going on, if somebody is watching."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextlib.contextmanager
def counting(what: str) -> Iterator[Any]:
    """A progress bar over bytes on standard error; yields update(done, total)."""
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


def plain(value: Any) -> Any:
    """A result as JSON can hold it: lists, numbers, texts; what is not a number is None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
