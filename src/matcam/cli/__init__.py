"""Command line `matcam`. The module of a command parses options, calls the library and writes the results.

Exit codes: 0 success; 1 some inputs failed; 2 bad input; 70 internal error, with a traceback; 130 interrupted by Ctrl-C (143
by SIGTERM, 129 by SIGHUP).
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from matcam.core.errors import MatcamError
from matcam.core.threads import use_one_blas_thread, use_one_heap

BAD_INPUT = 2
FAULT = 70
INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    # garbage collection is rare, because it would only slow down a short process with many imports and traces
    gc.set_threshold(50_000, 20, 50)
    use_one_blas_thread()
    use_one_heap()
    sys.stdout, sys.stderr = (stream or _nowhere() for stream in (sys.stdout, sys.stderr))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a locale without a degree sign prints an escape sequence
            stream.reconfigure(errors="backslashreplace")
    _end_on_signals()
    warnings.formatwarning = _warning_as_line
    try:
        with without_dask():
            code = _run(arguments)
    except KeyboardInterrupt:  # during the import of the commands
        code = _interrupted()
    if error := _unwritable():
        code = _output_failed(error, code)
    sys.exit(code)


@contextlib.contextmanager
def without_dask() -> Iterator[None]:
    """Hide Dask from imports, unless it is already imported or a cluster requires it.

    xarray imports Dask, if it is installed, to check the types of arrays. The import is slow, and all arrays of the commands
    are those of NumPy.
    """
    if "xarray" not in sys.modules:  # xarray checks once whether Dask is installed
        sys.modules.setdefault("dask", None)  # type: ignore[arg-type]
    try:
        yield
    finally:
        if sys.modules.get("dask", sys) is None:
            del sys.modules["dask"]


_ended_by: list[int] = []
"""Signals that requested the end of this process, in the order of arrival; empty if there was none."""


def _end_on_signals() -> None:
    """Treat SIGTERM and SIGHUP as Ctrl-C, so that incomplete files are removed."""

    def end(number: int, frame: Any) -> None:
        _ended_by.append(number)
        raise KeyboardInterrupt

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if (
            number is not None and signal.getsignal(number) == signal.SIG_DFL
        ):  # a signal that nohup ignores stays ignored
            signal.signal(number, end)


def _warning_as_line(message: Any, *where: Any, **line: Any) -> str:
    from matcam.core.readers.names import printable

    return f"matcam: {printable(_one_line(str(message)))}\n"


def _interrupted() -> int:
    options: Any = sys.modules.get("matcam.cli.options")  # the commands may still be loading
    late = options is not None and options.files_are_written()
    written = "interrupted after the files were written; they are complete"
    message = written if late else "interrupted; no incomplete file was left"
    return _complain(message, 128 + _ended_by[0] if _ended_by else INTERRUPTED)


def _unwritable() -> OSError | None:
    try:
        sys.stdout.flush()
    except OSError as error:
        return error
    return None


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8")


def _output_failed(error: OSError, code: int) -> int:
    """Report that standard output cannot be written, and return the exit code.

    A closed pipe is not a failure: in this case the result is `code`, and nothing is reported.
    """
    sys.stdout = _nowhere()  # Python would report the error again at exit
    if isinstance(error, BrokenPipeError):
        return code
    return _complain(f"standard output cannot be written: {error.strerror}", BAD_INPUT)


def _run(arguments: list[str] | None) -> int:
    # typer's own handling would print usage errors in boxes and turn interruptions into exit code 1
    import typer

    from matcam.cli.app import app
    from matcam.cli.show import broken_output

    # typer contains its own copy of click, and does not export this exception
    usage_error: type[Any] = typer.BadParameter.__mro__[1]

    try:
        result = app(args=arguments, prog_name="matcam", standalone_mode=False)
        if result == INTERRUPTED:  # some versions of typer convert the exception to this
            raise KeyboardInterrupt
    except typer.Exit as exit_:
        return exit_.exit_code
    except usage_error as error:
        context = f" (see {error.ctx.command_path} --help)" if error.ctx else ""
        return _complain(f"{_one_line(error.format_message())}{_hint(error)}{context}", BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        return _interrupted()
    except MatcamError as error:
        return _complain(_one_line(str(error)), BAD_INPUT)
    except BrokenPipeError as error:
        return _output_failed(error, 0)
    except MemoryError:
        return _complain("not enough memory: give smaller inputs, or close other programs", BAD_INPUT)
    except SystemExit:  # Rich raises this if the pipe that reads the help is closed
        return 0
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None:  # typer wrote the help to standard output
            return _output_failed(error, 0)
        traceback.print_exc()
        return _complain("this is a fault of matcam, not of your input; please report it with the lines above", FAULT)
    code = result if isinstance(result, int) else 0
    broken = broken_output()
    return code if broken is None else _output_failed(broken, code)


def _hint(error: Any) -> str:
    """Suggest what was meant by a usage error.

    Commands of groups may have been given without the group, such as `matcam merl` instead of `matcam data merl`. A negative
    number is read as an option.
    """
    if re.search(r"No such option: -\.?\d", error.format_message()):
        return ". A word that starts with a minus sign is read as an option: give a number that is not negative"
    from matcam.cli.app import app

    found = [
        f"matcam {group.name} {command.name}"
        for group in app.registered_groups
        for command in group.typer_instance.registered_commands  # type: ignore[union-attr]
        if f"No such command '{command.name}'" in error.format_message()
    ]
    return f" Did you mean {' or '.join(found)}?" if found else ""


def _complain(message: str, code: int) -> int:
    from matcam.core.readers.names import printable

    with contextlib.suppress(OSError):
        print(f"matcam: {printable(message)}", file=sys.stderr)
    return code


def _one_line(text: str) -> str:
    return " ".join(text.split())
