"""JSON documents on disk: whole, without NaN, and never trusted to be small or sound."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matcam.atomic import replacing
from matcam.errors import FileFormatError

_LARGEST = 16 << 20  # bytes; a measured curve of 1e5 samples stays far below


def write_json(path: str | Path, document: dict[str, Any], *, force: bool = False) -> None:
    """Write a document, indented for people. ValueError or TypeError for what JSON cannot hold, before anything is
    written; OutputError where it cannot go."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_json(path: str | Path, what: str) -> Any:
    """Read a document. FileFormatError naming the file, where that is not JSON or more than 16 MiB; `what`: it should
    be, e.g. "a camera profile"."""
    path = Path(path)

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not a number")

    try:
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for {what}")
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not {what}: {error}") from None
