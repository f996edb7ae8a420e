"""Safe writing of files (text, CSV, JSON), and messages for errors of the operating system.

A file gets its final name only when it is complete, and no file is overwritten without permission. Errors of the operating
system are converted to one line of text, which is the same for all formats. NaN in JSON documents is an error. Datasets are
written as CSV for spreadsheets and plotting programs.
"""

from __future__ import annotations

import atexit
import contextlib
import csv
import json
import math
import os
import re
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
    """Check that an output can be written without overwriting a file.

    An OutputError is raised if `path` exists and `force` is not set. It is raised even with `force` if `path` is a folder,
    has a file as parent, is one of `inputs`, or has an invalid name. An ArgumentError is raised if `force` is neither True
    nor False.
    """
    path = Path(path)
    if type(force).__name__ not in ("bool", "bool_"):  # also of NumPy; a string would be true
        raise ArgumentError(f"force must be True or False, got {force!r:.60}")
    if re.search(UNPRINTABLE, path.name):
        raise OutputError(f"output {printable(str(path))} has a name that is not plain text: choose another name")
    try:
        _check_position(path, inputs)
        taken = os.path.lexists(path)  # a broken link exists, too
    except OSError as error:  # such as a name that is too long
        raise OutputError(f"output {path!s:.300} cannot be written: {error.strerror}") from None
    if taken and not force:
        raise OutputError(f"output {path} exists: use force=True to replace it")
    return path


def check_outputs(
    paths: Iterable[Path | None], *, force: bool, inputs: Iterable[str | Path] = (), figure: Path | None = None
) -> None:
    """Check all outputs of a command with `check_output`, and that no two are the same file. None: no output.

    `figure` is the path in `paths` that must also satisfy `check_picture`. Default: None, no path.
    """
    checked: set[Path] = set()
    for path in paths:
        if path is None:
            continue
        if path in checked:
            raise OutputError(
                f"output {path} is given twice, or is also written beside another output: choose another name"
            )
        checked.add((check_picture if path == figure else check_output)(path, force=force, inputs=inputs))


def _check_position(path: Path, inputs: Iterable[str | Path]) -> None:
    for source in inputs:
        if path.exists() and Path(source).exists() and path.samefile(source):
            raise OutputError(f"output {path} is the input itself: choose another name for the output")
    if path.is_dir():
        raise OutputError(f"output {path} is a folder: give a file name inside it")
    for parent in path.parents:
        if parent.exists():
            if not parent.is_dir():
                raise OutputError(f"output {path} cannot be written: {parent} is a file, not a folder")
            if not os.access(parent, os.W_OK | os.X_OK):
                raise OutputError(f"output {path} cannot be written: no permission to write into {parent}")
            break


def check_output_folder(path: Path) -> None:
    """Check that a path can be a folder of outputs.

    An OutputError is raised if the path is a file, or if it is invalid or cannot be accessed.
    """
    if is_there(path) and not is_folder(path):
        raise OutputError(f"output {path} is a file: give a folder")
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        raise OutputError(f"output {path!s:.300} cannot be written: {getattr(error, 'strerror', error)}") from None


def check_picture(path: str | Path, *, force: bool, inputs: Iterable[str | Path] = ()) -> Path:
    path = check_output(path, force=force, inputs=inputs)
    if path.suffix.lower() not in _PICTURES:
        raise OutputError(f"output {path} is an image: its name must end in {', '.join(_PICTURES)}")
    return path


class Outputs:
    """Output files that get their final names together, and the folders created for them.

    Attributes:
        staged: path of the temporary file with the content, by final path.
        are_published: True if at least one file was written and all files have their final names.
    """

    def __init__(self) -> None:
        self.staged: dict[Path, Path] = {}
        self.are_published = False
        self._temporaries: list[Path] = []
        self._folders: list[Path] = []
        self._process = os.getpid()

    def make_folder(self, path: Path) -> None:
        """Create a folder and its parents. An OSError is raised if a folder cannot be created."""
        for folder in (*reversed(path.parents), path):
            with uninterrupted():
                if not folder.exists():
                    folder.mkdir(exist_ok=True)
                    self._folders.append(folder)

    def temporary(self, path: Path) -> Path:
        """Create an empty file beside `path`, and return its path. An OSError is raised if it cannot be created."""
        stem = path.stem if len(os.fsencode(path.name)) <= _LONGEST_NAME else path.stem[: _LONGEST_NAME // 8]
        while True:
            temporary = path.with_name(f".{stem}-{os.urandom(4).hex()}{path.suffix}")
            self._temporaries.append(
                temporary
            )  # registered before it exists, because an interruption may come at any time
            try:
                temporary.open("x").close()
            except FileExistsError:
                self._temporaries.pop()
            else:
                return temporary

    def publish(self) -> None:
        """Rename all files to their final names.

        If a file cannot be renamed, no file keeps its final name, the replaced files are restored, and an OutputError is
        raised. On file systems without links, replaced files cannot be restored.
        """
        renamed: list[tuple[Path, Path, Path | None]] = []
        several = len(self.staged) > 1
        try:
            for path, temporary in self.staged.items():
                old = temporary.with_name(f"{temporary.name}.old") if several and os.path.lexists(path) else None
                renamed.append((path, temporary, old))
                if old is not None:
                    with contextlib.suppress(
                        OSError
                    ):  # where links are not supported, replaced files cannot be restored
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
        """Remove the files that do not have their final names, and the folders created for them.

        This has no effect in a fork of the process that created the files.
        """
        if self._process != os.getpid():
            return
        for temporary in self._temporaries:
            temporary.unlink(missing_ok=True)
        for folder in reversed(self._folders):
            with contextlib.suppress(OSError):  # another process has put files there
                folder.rmdir()


_LONGEST_NAME = 240
"""Longest name of a file, bytes, to which the suffix of a temporary file can be added: file systems allow 255."""
_outputs: ContextVar[Outputs | None] = ContextVar("outputs", default=None)
_unfinished: set[Outputs] = set()
"""Outputs that are not published yet. Those that remain after an interruption are removed at the end of the process."""


@atexit.register
def _discard_unfinished() -> None:
    for outputs in tuple(_unfinished):
        outputs.discard()


@contextlib.contextmanager
def replacing(path: str | Path, *, force: bool = False) -> Iterator[Path]:
    """Yield the path of an empty temporary file, which gets the name `path` after the block.

    Inside `all_or_nothing`, the file gets this name at the end of the outer block. After an exception the temporary
    file is removed. It is in the same folder as `path` and has the same suffix, because the suffix determines the format.
    """
    path = check_output(path, force=force)
    try:
        with all_or_nothing() as outputs:
            if path in outputs.staged and not force:
                raise OutputError(f"output {path} is given twice: give two names")
            outputs.make_folder(path.parent)
            temporary = outputs.temporary(path)
            yield temporary
            outputs.staged[path] = temporary
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def all_or_nothing() -> Iterator[Outputs]:
    """Rename all files of the block to their final names together, at the end of the block.

    After an exception no file gets its final name. A nested block is part of the outer block. Files that other threads write
    are not included. A termination signal during the renaming is delayed until all files are renamed.
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
    """Rename each file in the block to its final name as soon as it is complete, even inside `all_or_nothing`."""
    token = _outputs.set(None)
    try:
        yield
    finally:
        _outputs.reset(token)


class _Waiting:
    """Signals that are delayed during a short operation.

    Attributes:
        is_lifted: True if signals take effect immediately.
    """

    def __init__(self) -> None:
        self.is_lifted = False
        self.signals: list[tuple[int, Any]] = []

    @contextlib.contextmanager
    def lifted(self) -> Iterator[None]:
        self.is_lifted = True
        try:
            yield
        finally:
            self.is_lifted = False


@contextlib.contextmanager
def uninterrupted() -> Iterator[_Waiting]:
    """Delay Ctrl-C and termination signals until the end of the block.

    An exception at the wrong moment could leave a library locked, or only some files of a group renamed. The function has
    no effect outside the main thread, because signals interrupt only the main thread.
    """
    waiting = _Waiting()
    if threading.current_thread() is not threading.main_thread():  # signals interrupt only the main thread
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
        if signal.getsignal(number) is wait:  # handlers that the block has set are kept
            signal.signal(number, handler)

    try:
        with contextlib.ExitStack() as restored:  # restores all handlers, even after an interruption
            for number, handler in handlers.items():
                restored.callback(restore, number, handler)
                signal.signal(number, wait)
            yield waiting
    finally:
        if waiting.signals:
            number, frame = waiting.signals[0]
            handlers[number](number, frame)


def make_folder(path: Path) -> None:
    """Create a folder for outputs.

    Inside `all_or_nothing`, the folder is removed if the outputs do not get their final names. An OutputError is raised if the
    folder cannot be created.
    """
    try:
        with all_or_nothing() as outputs:
            outputs.make_folder(path)
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror}") from None


def where_written(path: Path) -> Path:
    """Return the path at which the content of an output can be read.

    Before the file gets its final name, this is the path of the temporary file; afterwards it is `path`.
    """
    outputs = _outputs.get()
    return path if outputs is None else outputs.staged.get(path, path)


@contextlib.contextmanager
def reading(path: Path, what: str = "") -> Iterator[None]:
    """Convert OSErrors in the block to a FileFormatError whose message contains `path`.

    A FileFormatError is also raised if `path` is a pipe or a device. `what` is the expected content, such as "an image". A
    folder causes the same error unless `what` is empty.
    """
    if "\0" in str(path):
        raise FileFormatError(f"{printable(str(path))}: the path is not valid: remove the null character")
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode) and what:
            raise FileFormatError(f"{path}: the input is a folder, not {what}")
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # a pipe may have no end, or no writer
            raise FileFormatError(f"{path}: the input is a pipe or a device: copy its content to a file first")
        yield
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from None


def write_columns(path: str | Path, data: xr.Dataset | dict[str, Sequence[Any]], *, force: bool = False) -> None:
    """Write columns, or a Dataset, as CSV.

    A Dataset becomes one row per grid point, and one column per coordinate and variable. The name of the column of a variable
    with a unit ends in this unit ("theta_d_rad").
    """
    if isinstance(data, dict):
        columns = {name: _cells(column) for name, column in data.items()}
    else:
        given: Any = data
        if not callable(getattr(given, "to_dataframe", None)):
            raise ArgumentError(f"data must be an xarray.Dataset or a dict of columns, got {type(given).__name__}")
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
    return [("" if one != one else f"{one:.10g}") if isinstance(one, float) else str(one) for one in column]


def user_cache_folder() -> Path:
    """Return the cache folder of this user.

    It is in $XDG_CACHE_HOME if this variable is an absolute path, and otherwise in the usual cache folder of the operating
    system. For a user without a home folder, the result is a path that cannot be created, so there is no cache.
    """
    root = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if root.is_absolute():
        return root / "matcam"
    try:
        if sys.platform == "linux":
            folder = Path.home() / ".cache" / "matcam"
        else:
            import pooch  # imported only if required, because the import is slow

            folder = Path(pooch.os_cache("matcam"))
    except RuntimeError:  # a user without a home has no private folder
        folder = Path()
    return folder if folder.is_absolute() else Path(os.devnull) / "matcam"  # a path that cannot be created: no cache


def write_json(path: str | Path, document: dict[str, Any], *, force: bool = False) -> None:
    """Write a document as indented JSON.

    For values that JSON cannot represent, a ValueError or TypeError is raised, and nothing is written. An OutputError is
    raised if the file cannot be written.
    """
    # bytes that are not text, as in names of files, are escaped in JSON, too
    write_text(path, json_text(document), force=force, errors="backslashreplace")


def json_text(document: dict[str, Any]) -> str:
    """Format a document as indented JSON.

    A ValueError or TypeError is raised for values that JSON cannot represent.
    """
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_text(path: str | Path, text: str, *, force: bool = False, errors: str = "strict") -> None:
    """Write text in UTF-8.

    `errors` specifies the treatment of characters that UTF-8 cannot encode, as for `open`.
    """
    with replacing(path, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8", errors=errors)


def plain(value: Any) -> Any:
    """Convert a result to dicts, lists, numbers and strings, as JSON requires.

    NaN and infinities become None. Objects with a method `to_dict` are converted by this method.
    """
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
