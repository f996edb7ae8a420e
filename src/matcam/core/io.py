"""Safe writing of files: bytes, columns of text, JSON; and what the names of files and the system's errors become.

A file appears under its final name whole, or not at all, and nothing is destroyed unasked. What the system refuses is said in
one line, the same for every format. JSON is written whole and without NaN. Datasets go into columns of text (CSV) for
spreadsheets and plotting programs.
"""

from __future__ import annotations

import contextlib
import csv
import json
import math
import os
import re
import signal
import stat
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcam.core.errors import FileFormatError, OutputError

if TYPE_CHECKING:
    import xarray as xr

_PICTURES = (".png", ".pdf", ".svg")


def check_output(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Path:
    """Refuse, before any work, an output that could not be written or that would destroy something.

    OutputError where `path` is a folder, has a file as parent, is one of `inputs` (even with `force`), or exists and `force` is
    not set.
    """
    path = Path(path)
    if re.search(UNPRINTABLE, path.name):
        raise OutputError(f"output {printable(str(path))} has a name that is not plain text: choose another")
    for source in inputs:
        if path.exists() and Path(source).exists() and path.samefile(source):
            raise OutputError(f"output {path} is the input itself: choose another name")
    if path.is_dir():
        raise OutputError(f"output {path} is a folder: give a file name inside it")
    for parent in path.parents:
        if parent.exists():
            if not parent.is_dir():
                raise OutputError(f"output {path} cannot be written: {parent} is a file, not a folder")
            break
    if path.exists() and not force:
        raise OutputError(f"output {path} exists: use force=True to replace it")
    return path


def check_picture(path: str | Path, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path:
    """Check an output that is a picture, whose suffix chooses the format, as `check_output` does."""
    path = check_output(path, force=force, inputs=inputs)
    if path.suffix.lower() not in _PICTURES:
        raise OutputError(f"picture {path} must end in {', '.join(_PICTURES)}")
    return path


@contextlib.contextmanager
def replacing(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it becomes `path`, on any exception it vanishes.

    The temporary name keeps the suffix, because writers choose their format by it.
    """
    path = check_output(path, force=force, inputs=inputs)
    staged = _staged.get()
    if staged is not None and path in staged and not force:
        raise OutputError(f"output {path} is asked for twice: give two names")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror}") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; give the result the permissions that an ordinary open() would have given
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        if staged is None:
            temporary.replace(path)
        else:
            if path in staged:
                staged.pop(path).unlink(missing_ok=True)
            staged[path] = temporary
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror or error}") from error
    finally:
        if staged is None or staged.get(path) != temporary:
            temporary.unlink(missing_ok=True)


_staged: ContextVar[dict[Path, Path] | None] = ContextVar("staged", default=None)
"""Name -> temporary file, of the files that are to appear together."""


@contextlib.contextmanager
def all_or_nothing() -> Iterator[None]:
    """Let the files that are written inside appear together at its end, or none of them.

    Inside another, they belong to that one. Files of other threads do not take part.
    """
    if _staged.get() is not None:
        yield
        return
    staged: dict[Path, Path] = {}
    token = _staged.set(staged)
    try:
        yield
        _publish(staged)
    finally:
        _staged.reset(token)
        for temporary in staged.values():
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def one_by_one() -> Iterator[None]:
    """Let each file that is written inside appear at once, as without `all_or_nothing`."""
    token = _staged.set(None)
    try:
        yield
    finally:
        _staged.reset(token)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Let Ctrl-C and the system's wish to end this process wait until a library has done something short.

    For libraries that an exception at the wrong moment leaves with a lock that nobody opens again.
    """
    if threading.current_thread() is not threading.main_thread():  # signals interrupt the main one only
        yield
        return
    waiting: list[tuple[int, Any]] = []
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: handler for number in numbers if callable(handler := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, lambda *heard: waiting.append(heard))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if waiting:
            number, frame = waiting[0]
            handlers[number](number, frame)


def where_written(path: Path) -> Path:
    """Return where the content of an output lies now: under its name, or waiting for it."""
    return (_staged.get() or {}).get(path, path)


def _publish(staged: dict[Path, Path]) -> None:
    """Give all files their names; where one cannot have it, none has, and those that were replaced are back."""
    renamed: list[tuple[Path, Path, Path | None]] = []
    try:
        for path, temporary in staged.items():
            old = temporary.with_name(f"{temporary.name}.old") if path.exists() else None
            renamed.append((path, temporary, old))
            if old is not None:
                with contextlib.suppress(OSError):  # where there are no links, what was replaced is gone
                    os.link(path, old)
            temporary.replace(path)
    except BaseException as error:
        for path, temporary, old in reversed(renamed):
            if temporary.exists():
                continue
            if old is None:
                path.unlink(missing_ok=True)
            elif old.exists():
                old.replace(path)
        if isinstance(error, OSError):
            raise OutputError(f"output {renamed[-1][0]} cannot be written: {error.strerror or error}") from None
        raise
    finally:
        for *_, old in renamed:
            if old is not None:
                old.unlink(missing_ok=True)


@contextlib.contextmanager
def reading(path: Path, what: str = "") -> Iterator[None]:
    """Turn what goes wrong while `path` is opened and read into a FileFormatError that names it.

    `what` says what it should be ("a picture"): then a folder is refused, too.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode) and what:
            raise FileFormatError(f"{path}: is a folder, not {what}")
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # it may have no end, or nobody who writes to it
            raise FileFormatError(f"{path}: is a pipe or a device, not a file: copy what it gives into a file first")
        yield
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from None


UNPRINTABLE = "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
"""Characters that move a terminal's cursor or change its state, and bytes of a name that are no text."""


def printable(text: str) -> str:
    """Return text without characters that a terminal obeys, or that are no characters: each as its escape."""
    return re.sub(UNPRINTABLE, lambda found: found[0].encode("unicode_escape").decode(), text)


def check_name(path: Path) -> None:
    """Refuse an input whose name could not be written down. FileFormatError."""
    if re.search(UNPRINTABLE, path.name):
        raise FileFormatError(f"{printable(str(path))}: its name is not plain text: rename it")


def check_within(path: Path, folder: Path) -> None:
    """Refuse a file of a folder that is a link to elsewhere: who fills a folder must not choose among the reader's files.

    FileFormatError where following the links of `path` leads out of `folder`.
    """
    if path.is_symlink() and not (target := path.resolve()).is_relative_to(folder.resolve()):
        raise FileFormatError(f"{path}: is a link out of its folder, to {target}: name that file itself")


def write_columns(path: str | Path, data: xr.Dataset | dict[str, Sequence[Any]], *, force: bool = False) -> None:
    """Write a Dataset as CSV: one row per grid point, a column per coordinate and variable. Or columns by their names.

    The names of those that have units end in them ("theta_d_rad").
    """
    if isinstance(data, dict):
        columns = {name: _cells(column) for name, column in data.items()}
    else:
        frame = data.to_dataframe().reset_index()
        units = {
            str(n): v.attrs["units"].replace("/", "_per_") for n, v in data.variables.items() if "units" in v.attrs
        }
        columns = {f"{n}_{units[n]}" if n in units else n: _cells(frame[n]) for n in frame.columns}
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*columns.values(), strict=True))
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(text.getvalue().encode())


def _cells(column: Sequence[Any]) -> list[str]:
    """Return the values as text; what is missing is empty."""
    return [("" if one != one else f"{one:.10g}") if isinstance(one, float) else str(one) for one in column]


def user_cache_folder() -> Path:
    """Return the folder for what this user's processes keep: in $XDG_CACHE_HOME where that is set, else the system's own.

    A relative path there is ignored, as the XDG Base Directory Specification requires.
    """
    root = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if root.is_absolute():
        return root / "matcam"
    try:
        if sys.platform == "linux":
            return Path.home() / ".cache" / "matcam"
        import pooch  # a fifth of a second that only programs should cost

        folder = pooch.os_cache("matcam")
    except RuntimeError:  # without a home there is no folder that is this user's alone
        folder = Path()
    return folder if folder.is_absolute() else Path(os.devnull) / "matcam"  # which cannot be made: nothing is kept


def write_json(path: str | Path, document: dict[str, Any], *, force: bool = False) -> None:
    """Write a document, indented for people.

    ValueError or TypeError for what JSON cannot hold, before anything is written; OutputError where it cannot go.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path, force=force) as temporary:
        # what is no text, such as a byte of a file's name, is an escape in JSON, too
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def plain(value: Any) -> Any:
    """Return a result as JSON can hold it: lists, numbers, texts; NaN and infinities become None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
