"""Reading of untrusted text files: JSON, TOML and lines, with limits that are checked before parsing.

A parser takes memory and time for each value and each line, and a file of 9 MB may contain millions of them. Therefore the
numbers of values and lines and the length of a line are limited, in addition to the size of the file. Documents of matcam's
own formats have a version.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.readers.apart import read_apart
from matcam.core.readers.names import printable

if TYPE_CHECKING:
    from pydantic import ValidationError

SMALL_TEXT = 64 << 10
"""Largest size of a text file that is parsed in the process of the caller, bytes.

The values of such a file, at most one for every two bytes, take 20 ms and 4 MiB.
"""
_MOST_VALUES = 250_000
"""Largest number of values in a JSON document: a measured curve of 100,000 samples has 200,000.

A schema may take 5 us to check each value.
"""
_MOST_LINES = 100_000
"""Largest number of lines of a text file: more than the 65,536 codes of a tone curve of 16 bits."""
_LONGEST_LINE = 1000
"""Largest number of characters in a line. A TOML key of a thousand dots takes 1 s to parse, quadratic in its length."""


_PROBLEMS = {
    "extra_forbidden": "unknown field; check its spelling, or remove it",
    "missing": "this field is required",
}
"""Messages by type of pydantic's errors, where pydantic's own text is not plain."""


def read_json(path: str | Path, what: str) -> Any:
    """Read a JSON document.

    `what` is the expected content, such as "a camera profile". A FileFormatError is raised if the file is not JSON, or has more
    than 16 MiB or 250,000 values.
    """
    path = Path(path)
    content = read_apart(f"{__name__}:decode_json", path, what, small=SMALL_TEXT, title=what)
    return json.loads(content.tobytes())


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Read settings in TOML.

    `what` is the expected content, such as "a rig". A FileFormatError is raised if the file is not TOML, or has more than
    64 KiB or a line of more than 1000 bytes.
    """
    import tomllib

    path = Path(path)
    try:
        with reading(path, what):
            text = _checked_text(path, what, SMALL_TEXT).decode("utf-8-sig")
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: the file is not TOML: {_not_utf8(error)}") from None
    except (ValueError, RecursionError) as error:  # an integer with too many digits does not raise TOMLDecodeError
        raise FileFormatError(f"{path}: the file is not TOML: {' '.join(str(error).split())}") from None


def read_lines(path: str | Path, what: str) -> list[str]:
    """Read the lines of a text file, without line ends.

    `what` is the expected content, such as "a table". Bytes that are not UTF-8 are replaced by U+FFFD. A FileFormatError is
    raised if the file has more than 4 MiB or 100,000 lines, or a line of more than 1000 bytes.
    """
    content = read_apart(f"{__name__}:decode_lines", Path(path), what, small=SMALL_TEXT, title=what)
    text = content.tobytes().decode("utf-8-sig", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def decode_json(path: Path, *, title: str) -> np.ndarray:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not a number")

    # a measured curve of 100,000 samples takes 4 MiB
    content = _bytes_of(path, title, 16 << 20)
    values = content.count(b",") + content.count(b"[") + content.count(b"{")
    if values > _MOST_VALUES:
        raise FileFormatError(
            f"{path}: {values} values exceed the limit of {_MOST_VALUES} for {title}: give a file with fewer values"
        )
    try:
        json.loads(content.decode("utf-8"), parse_constant=refuse)
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: the file is not {title}: {_not_utf8(error)}") from None
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: the file is not {title}, because it is not valid JSON: {error}") from None
    return np.frombuffer(content, np.uint8)


def decode_lines(path: Path, *, title: str) -> np.ndarray:
    # 65,536 lines of three numbers take 3 MiB
    return np.frombuffer(_checked_text(path, title, 4 << 20), np.uint8)


def _not_utf8(error: UnicodeDecodeError) -> str:
    return f"byte {error.start} is not UTF-8 text; save the file with the encoding UTF-8"


def _bytes_of(path: Path, what: str, largest: int) -> bytes:
    size = path.stat().st_size
    if size > largest:
        raise FileFormatError(
            f"{path}: {size} bytes exceed the limit of {largest} for {what}: check that the file is {what}, or give a smaller "
            "file"
        )
    with path.open("rb") as file:
        return file.read(size)  # the file may have grown since then


def _checked_text(path: Path, what: str, largest: int) -> bytes:
    content = _bytes_of(path, what, largest)
    lines = content.splitlines()
    if len(lines) > _MOST_LINES:
        raise FileFormatError(
            f"{path}: {len(lines)} lines exceed the limit of {_MOST_LINES} for {what}: give a file with fewer lines"
        )
    for number, line in enumerate(lines, 1):
        if len(line) > _LONGEST_LINE:
            raise FileFormatError(
                f"{path}: line {number} has {len(line)} bytes, but at most {_LONGEST_LINE} are allowed: shorten the line"
            )
    return content


def checked_version(document: Any, where: str | Path, what: str, form: str, versions: Collection[int]) -> int:
    """Check the format and the version of a document of matcam, and return the version.

    The document must have the form {"format": form, "version": one of `versions`, ...}. Otherwise a FileFormatError is raised.
    Its message contains `where`, the location of the document, and `what`, the expected content.
    """
    if not isinstance(document, dict) or document.get("format") != form:
        raise FileFormatError(f'{where}: the document is not {what}: field "format" must be "{form}"')
    version = document.get("version")
    if type(version) is not int or version not in versions:  # True == 1
        raise FileFormatError(
            f"{where}: {form.split()[-1]} version {version!r:.60} is unknown; matcam {metadata.version('matcam')} "
            f"reads version{'s' * (len(versions) > 1)} {', '.join(map(str, versions))}: update matcam, or write the file again"
        )
    return version


def first_problem(error: ValidationError, unnamed: Collection[str] = ()) -> str:
    """Format the first error of a schema on one line.

    The line contains the path of the field. `unnamed` lists parts of paths that are omitted, because they are names of schemas
    and not of fields.
    """
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"] if part not in unnamed)
    if first["type"] in _PROBLEMS:
        problem = _PROBLEMS[first["type"]]
    else:
        text = first["msg"].removeprefix("Value error, ").replace("Input should ", "must ")
        problem = f"{text[0].lower()}{text[1:]}"
    return printable(f"field {field:.100}: {problem}")
