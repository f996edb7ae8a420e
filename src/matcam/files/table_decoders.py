"""Decoders of tables (CSV, RGL, UTIA), which run in a separate process (core/readers/apart.py).

samples.py, rgl.py and utia.py describe the formats. This file imports neither xarray nor JAX, so that the process
starts quickly.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError

HALF = ("theta_h", "theta_d", "phi_d")
PAIR = ("theta_i", "phi_i", "theta_o", "phi_o")
VALUE = "_per_sr"
_UNITS = {"rad": 1.0, "deg": np.pi / 180}
_LINES_AT_ONCE = 1 << 16
_LONGEST_LINE = 16 << 10
"""Largest length of a line of a CSV file, bytes: enough for 450 columns of 25 characters."""

RGL_MAGIC, RGL_VERSION = b"tensor_file\0", b"\1\0"
RGL_TYPES = dict(enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1))
UTIA_SHAPE = (3, 6, 48, 6, 48)
_UTIA_BYTES = 8 * math.prod(UTIA_SHAPE)
"""Size of a UTIA file, bytes. The format has no other property by which a file can be identified."""
_MOST_FIELDS, _MOST_DIMENSIONS = 64, 8


def decode_csv(path: Path) -> dict[str, Any]:
    """Decode a CSV file of BRDF samples.

    The result has `names`, the names of the columns; `scale`, the factor of each column to rad or 1/sr; and `values`,
    the numbers in the file, (lines, columns).
    """
    names, scale = _columns(path)
    _check_lines(path)
    return {"names": names, "scale": scale, "values": _values(path, len(names))}


def decode_columns(path: Path) -> dict[str, Any]:
    """Decode the ranges of the columns of a CSV file.

    The result has `rows`, the number of lines below the names, and `ranges`, the smallest and the largest value of each
    column by name; columns of texts have an empty list.
    """
    import pandas as pd

    _check_lines(path)
    rows, ranges = 0, dict[str, list[float]]()
    try:
        with pd.read_csv(path, chunksize=_LINES_AT_ONCE) as reader:
            for block in reader:
                rows += len(block)
                for name in map(str, block.columns):
                    numbers = block[name].dropna() if block[name].dtype.kind in "iuf" else block[name][:0]
                    known = [*ranges.get(name, []), *map(float, (numbers.min(), numbers.max()) if len(numbers) else ())]
                    ranges[name] = [min(known), max(known)] if known else []
    except (ValueError, pd.errors.ParserError) as error:
        raise FileFormatError(f"{path}: the file is not a CSV file: {' '.join(str(error).split())[:120]}") from None
    return {"rows": rows, "ranges": ranges}


def is_samples(head: str) -> bool:
    """Check whether the first line of a CSV file has only the columns of samples of a BRDF."""
    names = [name.strip() for name in head.lstrip("\ufeff").split(",")]
    return all(name.endswith(VALUE) or name.rpartition("_")[0] in (*HALF, *PAIR) for name in names)


def _check_lines(path: Path) -> None:
    """Reject a line of more than 16 KiB.

    The parser needs much more time and memory for a long line than for many short lines.
    """
    before, number = 0, 1
    with path.open("rb") as file:
        while block := file.read(1 << 16):
            lengths = [len(line) for line in block.split(b"\n")]
            lengths[0] += before
            if max(lengths) > _LONGEST_LINE:
                number += next(k for k, length in enumerate(lengths) if length > _LONGEST_LINE)
                raise FileFormatError(
                    f"{path}: line {number} has more than {_LONGEST_LINE} bytes: give one pair of directions per line"
                )
            before, number = lengths[-1], number + len(lengths) - 1


def _columns(path: Path) -> tuple[list[str], list[float]]:
    with path.open("rb") as file:
        head = file.readline(4096)
    try:
        given = [name.strip() for name in head.decode("utf-8-sig").split(",")]
    except UnicodeDecodeError:
        given = []
    names, scale = [], []
    for name in given:
        angle, _, unit = name.rpartition("_")
        if angle in (*HALF, *PAIR) and unit in _UNITS:
            names.append(angle)
            scale.append(_UNITS[unit])
        elif name.endswith(VALUE) and name != VALUE:
            names.append(name.removesuffix(VALUE))
            scale.append(1.0)
        else:
            raise FileFormatError(
                f"{path}: line 1: column {name!r:.40} is neither an angle (theta_h_rad, ...) nor a channel (R_per_sr, ...); "
                "for a result of matcam, give the .nc file that was written with it"
            )
    if len(set(names)) < len(names) or not (set(HALF) <= set(names) or set(PAIR) <= set(names)):
        raise FileFormatError(
            f"{path}: line 1 must name all of {', '.join(HALF)} or all of {', '.join(PAIR)}, and each column only once"
        )
    if len(names) != len(PAIR if set(PAIR) <= set(names) else HALF) + sum(n.endswith(VALUE) for n in given):
        raise FileFormatError(
            f"{path}: line 1 must name either half and difference angles or the angles of light and view, not both"
        )
    if not any(name.endswith(VALUE) for name in given):
        raise FileFormatError(f"{path}: line 1 must name at least one channel of the BRDF (R_per_sr, ...)")
    return names, scale


def _values(path: Path, columns: int) -> np.ndarray:
    import pandas as pd

    # the default converter of these versions loses the last digit
    old = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    exact: Any = {"float_precision": "round_trip"} if old else {}
    blocks, at = [], 0
    try:
        reader = pd.read_csv(
            path,
            header=None,
            skiprows=1,
            dtype=np.float64,
            chunksize=_LINES_AT_ONCE,
            index_col=False,
            on_bad_lines="error",
            **exact,
        )
        with reader:
            for block in reader:
                if block.shape[1] != columns:
                    raise FileFormatError(
                        f"{path}: line {at + 2} has {block.shape[1]} values, but there are {columns} columns"
                    )
                blocks.append(block.to_numpy())
                at += len(block)
    except pd.errors.EmptyDataError:
        pass
    except (ValueError, pd.errors.ParserError, pd.errors.ParserWarning, OverflowError) as error:
        raise FileFormatError(
            f"{path}: the file cannot be read after line {at + 1}: {' '.join(str(error).split())[:120]}"
        ) from None
    if not blocks:
        raise FileFormatError(f"{path}: the file has no values below the names of the columns: add lines of values")
    return np.concatenate(blocks)


def decode_rgl(path: Path) -> dict[str, np.ndarray]:
    content = path.read_bytes()
    start = len(RGL_MAGIC) + len(RGL_VERSION)
    if content[:start] != RGL_MAGIC + RGL_VERSION:
        raise FileFormatError(
            f"{path}: the file is not an RGL file: its first bytes are {content[:start]!r}, but must be "
            f"{RGL_MAGIC + RGL_VERSION!r}"
        )
    found: dict[str, np.ndarray] = {}
    left = len(content)
    try:
        (count,) = struct.unpack_from("<I", content, start)
        if count > _MOST_FIELDS:
            raise FileFormatError(
                f"{path}: byte {start} specifies {count} fields, but a BRDF has at most {_MOST_FIELDS}: the file is damaged; "
                "copy it again"
            )
        at = start + 4
        for _ in range(count):
            (length,) = struct.unpack_from("<H", content, at)
            name = content[at + 2 : at + 2 + length].decode()
            if not 0 < length <= 64 or not name.isidentifier() or name in found:
                raise FileFormatError(
                    f"{path}: the name of a field at byte {at} is invalid or repeated: the file is damaged; copy it "
                    "again"
                )
            at += 2 + length
            dimensions, code, offset = struct.unpack_from("<HBQ", content, at)
            if dimensions > _MOST_DIMENSIONS or code not in RGL_TYPES:
                raise FileFormatError(
                    f"{path}: field {name} has {dimensions} dimensions and type {code}, but only up to {_MOST_DIMENSIONS} "
                    f"dimensions and the types 1 to {len(RGL_TYPES)} are supported"
                )
            shape = struct.unpack_from(f"<{dimensions}Q", content, at + 11)
            at += 11 + 8 * dimensions
            dtype, values = np.dtype(RGL_TYPES[code]), math.prod(shape)
            left -= values * dtype.itemsize
            if left < 0 or offset + values * dtype.itemsize > len(content):
                raise FileFormatError(
                    f"{path}: the file is truncated or damaged: field {name} has {' x '.join(map(str, shape))} values at "
                    f"byte {offset}, but the file has {len(content)} bytes; copy it again"
                )
            found[name] = np.frombuffer(content, dtype, values, offset).reshape(shape)
    except (struct.error, UnicodeDecodeError):
        raise FileFormatError(f"{path}: the list of fields is damaged: copy the file again") from None
    return found


def decode_utia(path: Path) -> np.ndarray:
    """Decode a UTIA BRDF, 1/sr, (channel, theta_i, phi_i, theta_o, phi_o)."""
    size = path.stat().st_size
    if size != _UTIA_BYTES:
        raise FileFormatError(
            f"{path}: the file has {size} bytes, but a BRDF of UTIA has {_UTIA_BYTES}: copy the file again"
        )
    values = np.fromfile(path, "<f8").reshape(UTIA_SHAPE)
    if not np.isfinite(values).all():
        raise FileFormatError(
            f"{path}: the file has {np.count_nonzero(~np.isfinite(values))} values that are not finite: copy the "
            "file again"
        )
    return values
