"""The command line: `matcam`. One file per command; each parses, calls the library, shows progress, writes.

Exit codes: 0; 1 some inputs failed; 2 bad input; 70 a fault of ours (with traceback); 130 interrupted.
"""

from __future__ import annotations

import gc
import sys
import traceback
from typing import Any

BAD_INPUT = 2
FAULT = 70
INTERRUPTED = 130
_INTERRUPTION = "interrupted; nothing half-written was left"

OPTIONS = {"force=True": "--force", "fit_camera=True": "--fit-camera"}
"""Arguments that the library's messages name, and the options that they are here."""


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its code."""
    gc.set_threshold(50_000, 20, 50)  # a short life with much importing and tracing: collecting rarely saves a tenth
    try:
        code = _run(arguments)
    except KeyboardInterrupt:  # while the commands themselves were being loaded
        code = _complain(_INTERRUPTION, INTERRUPTED)
    sys.exit(code)


def _run(arguments: list[str] | None) -> int:
    # typer's own handling would print usage errors in boxes and turn interruptions into exit code 1
    import typer

    from matcam.cli.app import app
    from matcam.core.errors import MatcamError

    # typer carries a click of its own, and does not export this one
    usage_error: type[Any] = typer.BadParameter.__mro__[1]

    try:
        result = app(args=arguments, prog_name="matcam", standalone_mode=False)
        if result == INTERRUPTED:  # some versions of typer turn the exception into this
            raise KeyboardInterrupt
    except typer.Exit as exit_:
        return exit_.exit_code
    except usage_error as error:
        context = f" (see {error.ctx.command_path} --help)" if error.ctx else ""
        return _complain(f"{_one_line(error.format_message())}{context}", BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        return _complain(_INTERRUPTION, INTERRUPTED)
    except MatcamError as error:
        return _complain(_in_options(_one_line(str(error))), BAD_INPUT)
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone; Python would complain once more at exit
        return 0
    except MemoryError:
        return _complain("not enough memory", BAD_INPUT)
    except Exception:
        traceback.print_exc()
        return _complain("this is a fault of matcam, not of your input; please report it with the lines above", FAULT)
    return result if isinstance(result, int) else 0


def _complain(message: str, code: int) -> int:
    print(f"matcam: {message}", file=sys.stderr)
    return code


def _in_options(message: str) -> str:
    """Return a library's message in the command line's words."""
    for argument, option in OPTIONS.items():
        message = message.replace(argument, option)
    return message


def _one_line(text: str) -> str:
    return " ".join(text.split())
