"""JSON documents on disk: whole, without NaN, and never trusted to be small or sound.

Those of matcam's own formats bear a version.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcam.core.errors import FileFormatError
from matcam.core.io import reading, replacing

if TYPE_CHECKING:
    from pydantic import ValidationError

_LARGEST = 16 << 20  # bytes; a measured curve of 1e5 samples stays far below


def write_json(path: str | Path, document: dict[str, Any], *, force: bool = False) -> None:
    """Write a document, indented for people.

    ValueError or TypeError for what JSON cannot hold, before anything is written; OutputError where it cannot go.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path, force=force) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_json(path: str | Path, what: str) -> Any:
    """Read a document; `what` says what it should be, such as "a camera profile".

    FileFormatError naming the file, where it is not JSON or more than 16 MiB.
    """
    path = Path(path)

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not a number")

    try:
        with reading(path):
            if path.stat().st_size > _LARGEST:
                raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for {what}")
            return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not {what}: {error}") from None


def checked_version(document: Any, where: str | Path, what: str, form: str, versions: Collection[int]) -> int:
    """Return the version of a document of ours: {"format": form, "version": one of `versions`, ...}.

    FileFormatError says `where` it stands, `what` it should be, and the field.
    """
    if not isinstance(document, dict) or document.get("format") != form:
        raise FileFormatError(f'{where}: not {what}: field "format" must be "{form}"')
    version = document.get("version")
    if type(version) is not int or version not in versions:  # True == 1
        raise FileFormatError(
            f"{where}: {form.split()[-1]} version {version!r:.60} is unknown; this matcam ({metadata.version('matcam')}) "
            f"reads version{'s' * (len(versions) > 1)} {' and '.join(map(str, versions))}"
        )
    return version


def first_problem(error: ValidationError, unnamed: Collection[str] = ()) -> str:
    """Return what a schema finds wrong first, in one line that names the field.

    unnamed: parts of the field's place that are no names of fields.
    """
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"] if part not in unnamed)
    return f"field {field:.100}: {first['msg'][0].lower()}{first['msg'][1:]}"


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
