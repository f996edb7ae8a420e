"""Safe writing of files: bytes, columns of text, JSON; and what the names of files and the system's errors become.

A file appears under its final name whole, or not at all, and nothing is destroyed unasked. What the system refuses is said in
one line, the same for every format. JSON is written whole and without NaN. Datasets go into columns of text (CSV) for
spreadsheets and plotting programs.
"""

from __future__ import annotations

import atexit
import contextlib
import csv
import json
import math
import os
import re
import secrets
import signal
import stat
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.readers.names import UNPRINTABLE, is_folder, is_there, printable

if TYPE_CHECKING:
    import xarray as xr

_PICTURES = (".png", ".pdf", ".svg")


def check_output(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Path:
    """Refuse, before any work, an output that could not be written or that would destroy something.

    OutputError where `path` is a folder, has a file as parent, is one of `inputs` (even with `force`), or exists and `force` is
    not set; ArgumentError where `force` is neither True nor False.
    """
    path = Path(path)
    if type(force).__name__ not in ("bool", "bool_"):  # NumPy's, too; a text would count as True
        raise ArgumentError(f"force must be True or False, got {force!r:.60}")
    if re.search(UNPRINTABLE, path.name):
        raise OutputError(f"output {printable(str(path))} has a name that is not plain text: choose another")
    try:
        _check_place(path, inputs)
        taken = os.path.lexists(path)  # a link is there even where it leads nowhere
    except OSError as error:  # such as a name that is too long
        raise OutputError(f"output {path!s:.300} cannot be written: {error.strerror}") from None
    if taken and not force:
        raise OutputError(f"output {path} exists: use force=True to replace it")
    return path


def _check_place(path: Path, inputs: Iterable[str | Path]) -> None:
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


def check_output_folder(path: Path) -> None:
    """Refuse, before any work, a folder for outputs that is a file or cannot be made. OutputError."""
    if is_there(path) and not is_folder(path):
        raise OutputError(f"output {path} is a file: give a folder")
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        raise OutputError(f"output {path!s:.300} cannot be written: {getattr(error, 'strerror', error)}") from None


def check_picture(path: str | Path, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path:
    """Check an output that is a picture, whose suffix chooses the format, as `check_output` does."""
    path = check_output(path, force=force, inputs=inputs)
    if path.suffix.lower() not in _PICTURES:
        raise OutputError(f"picture {path} must end in {', '.join(_PICTURES)}")
    return path


class Outputs:
    """Files that are to appear together, and the folders that were made for them.

    Attributes:
        staged: name of each file -> the temporary file that has its content.
        are_published: whether files have appeared under their names.
    """

    def __init__(self) -> None:
        self.staged: dict[Path, Path] = {}
        self.are_published = False
        self._temporaries: list[Path] = []
        self._folders: list[Path] = []
        self._process = os.getpid()

    def make_folder(self, path: Path) -> None:
        """Make a folder and those above it. OSError if that fails."""
        for folder in (*reversed(path.parents), path):
            with uninterrupted():
                if not folder.exists():
                    folder.mkdir(exist_ok=True)
                    self._folders.append(folder)

    def temporary(self, path: Path) -> Path:
        """Make an empty file beside `path`. OSError if that fails."""
        stem = path.stem if len(os.fsencode(path.name)) <= _LONGEST_NAME else path.stem[: _LONGEST_NAME // 8]
        while True:
            temporary = path.with_name(f".{stem}-{secrets.token_hex(4)}{path.suffix}")
            self._temporaries.append(temporary)  # before it is there: an interruption may come at any time
            try:
                temporary.open("x").close()
            except FileExistsError:
                self._temporaries.pop()
            else:
                return temporary

    def publish(self) -> None:
        """Give all files their names; where one cannot have it, none has, and those that were replaced are back."""
        renamed: list[tuple[Path, Path, Path | None]] = []
        several = len(self.staged) > 1
        try:
            for path, temporary in self.staged.items():
                old = temporary.with_name(f"{temporary.name}.old") if several and os.path.lexists(path) else None
                renamed.append((path, temporary, old))
                if old is not None:
                    with contextlib.suppress(OSError):  # where there are no links, what was replaced is gone
                        os.link(path, old, follow_symlinks=False)
                temporary.replace(path)
        except BaseException as error:
            for path, temporary, old in reversed(renamed):
                if temporary.exists():
                    continue
                if old is None:
                    path.unlink(missing_ok=True)
                elif os.path.lexists(old):
                    old.replace(path)
            if isinstance(error, OSError):
                raise OutputError(f"output {renamed[-1][0]} cannot be written: {error.strerror or error}") from None
            raise
        finally:
            for *_, old in renamed:
                if old is not None:
                    old.unlink(missing_ok=True)
        self._folders.clear()
        self.are_published = bool(self.staged)

    def discard(self) -> None:
        """Remove what has not got its name. Nothing in a fork of the process that made it."""
        if self._process != os.getpid():
            return
        for temporary in self._temporaries:
            temporary.unlink(missing_ok=True)
        for folder in reversed(self._folders):
            with contextlib.suppress(OSError):  # others have put something there
                folder.rmdir()


_LONGEST_NAME = 240
"""Bytes of a file's name to which what makes it temporary can be added: file systems allow 255."""
_outputs: ContextVar[Outputs | None] = ContextVar("outputs", default=None)
_unfinished: set[Outputs] = set()
"""What an interruption between two statements has left to be removed when the process ends."""


@atexit.register
def _discard_unfinished() -> None:
    for outputs in tuple(_unfinished):
        outputs.discard()


@contextlib.contextmanager
def replacing(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it becomes `path`, on any exception it vanishes.

    The temporary name keeps the suffix, because writers choose their format by it.
    """
    path = check_output(path, force=force, inputs=inputs)
    try:
        with all_or_nothing() as outputs:
            if path in outputs.staged and not force:
                raise OutputError(f"output {path} is asked for twice: give two names")
            outputs.make_folder(path.parent)
            temporary = outputs.temporary(path)
            yield temporary
            outputs.staged[path] = temporary
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def all_or_nothing() -> Iterator[Outputs]:
    """Let the files that are written inside appear together at its end, or none of them.

    Inside another, they belong to that one. Files of other threads do not take part. An interruption while they appear waits
    until all have appeared.
    """
    outer = _outputs.get()
    if outer is not None:
        yield outer
        return
    with uninterrupted() as waiting:
        outputs = Outputs()
        _unfinished.add(outputs)
        token = _outputs.set(outputs)
        try:
            with waiting.lifted():
                yield outputs
            outputs.publish()
        finally:
            waiting.is_lifted = False
            _outputs.reset(token)
            outputs.discard()
            _unfinished.discard(outputs)


@contextlib.contextmanager
def one_by_one() -> Iterator[None]:
    """Let each file that is written inside appear at once, as without `all_or_nothing`."""
    token = _outputs.set(None)
    try:
        yield
    finally:
        _outputs.reset(token)


class _Waiting:
    """Signals that wait until something short is done.

    Attributes:
        is_lifted: whether signals take effect at once.
    """

    def __init__(self) -> None:
        self.is_lifted = False
        self.signals: list[tuple[int, Any]] = []

    @contextlib.contextmanager
    def lifted(self) -> Iterator[None]:
        """Let signals take effect at once in the block."""
        self.is_lifted = True
        try:
            yield
        finally:
            self.is_lifted = False


@contextlib.contextmanager
def uninterrupted() -> Iterator[_Waiting]:
    """Let Ctrl-C and the system's wish to end this process wait until something short is done.

    For libraries that an exception at the wrong moment leaves with a lock that nobody opens again, and for files that appear
    together.
    """
    waiting = _Waiting()
    if threading.current_thread() is not threading.main_thread():  # signals interrupt the main one only
        yield waiting
        return
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: handler for number in numbers if callable(handler := signal.getsignal(number))}

    def wait(number: int, frame: Any) -> None:
        if waiting.is_lifted:
            handlers[number](number, frame)
        else:
            waiting.signals.append((number, frame))

    def restore(number: int, handler: Any) -> None:
        if signal.getsignal(number) is wait:  # what the block has put in its place stays
            signal.signal(number, handler)

    try:
        with contextlib.ExitStack() as restored:  # it restores all, even if a signal interrupts it
            for number, handler in handlers.items():
                restored.callback(restore, number, handler)
                signal.signal(number, wait)
            yield waiting
    finally:
        if waiting.signals:
            number, frame = waiting.signals[0]
            handlers[number](number, frame)


def make_folder(path: Path) -> None:
    """Make a folder for outputs; it vanishes again where they do not appear. OutputError if that fails."""
    try:
        with all_or_nothing() as outputs:
            outputs.make_folder(path)
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror}") from None


def where_written(path: Path) -> Path:
    """Return where the content of an output lies now: under its name, or waiting for it."""
    outputs = _outputs.get()
    return path if outputs is None else outputs.staged.get(path, path)


@contextlib.contextmanager
def reading(path: Path, what: str = "") -> Iterator[None]:
    """Turn what goes wrong while `path` is opened and read into a FileFormatError that names it.

    `what` says what it should be ("a picture"): then a folder is refused, too.
    """
    if "\0" in str(path):
        raise FileFormatError(f"{printable(str(path))}: is no name of a file")
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


def write_columns(path: str | Path, data: xr.Dataset | dict[str, Sequence[Any]], *, force: bool = False) -> None:
    """Write a Dataset as CSV: one row per grid point, a column per coordinate and variable. Or columns by their names.

    The names of those that have units end in them ("theta_d_rad").
    """
    if isinstance(data, dict):
        columns = {name: _cells(column) for name, column in data.items()}
    else:
        given: Any = data
        if not callable(getattr(given, "to_dataframe", None)):
            raise ArgumentError(f"data must be an xarray.Dataset or columns by name, got {type(given).__name__}")
        frame = data.to_dataframe().reset_index()
        units = {
            str(n): v.attrs["units"].replace("/", "_per_")
            for n, v in data.variables.items()
            if v.attrs.get("units", "1") != "1"
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
            folder = Path.home() / ".cache" / "matcam"
        else:
            import pooch  # a fifth of a second that only programs should cost

            folder = Path(pooch.os_cache("matcam"))
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
