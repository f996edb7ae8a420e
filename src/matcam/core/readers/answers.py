"""Encoding of the answers of reading processes.

An answer consists of the length of a JSON document, the document, and the bytes of each array. The document refers to the
arrays by number.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core import errors
from matcam.core.errors import FileFormatError

_KINDS = "biufcSU"
"""Kinds of NumPy data types that an answer may contain: numbers and strings."""


def packed(value: Any, arrays: list[np.ndarray]) -> Any:
    """Convert an answer to types of JSON, and append the arrays in the answer to `arrays`.

    A TypeError is raised for a type that an answer cannot contain (see `read_apart`).
    """
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind in "OT":  # strings of variable length
            texts = [v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in array.ravel()]
            # each string gets the length of the longest, so that the memory limit applies here and not in the caller
            array = np.array(texts, dtype=str).reshape(array.shape)
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"values of type {array.dtype} are not supported")
        arrays.append(np.ascontiguousarray(array))
        return {"array": len(arrays) - 1, "type": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, dict):
        return {"dict": {str(key): packed(v, arrays) for key, v in value.items()}}
    if isinstance(value, list | tuple):
        return {"list": [packed(v, arrays) for v in value]}
    if value is None or isinstance(value, bool | int | float | str):
        return {"value": value}
    raise TypeError(f"an answer cannot contain {type(value).__name__}")


def _unpacked(value: Any, arrays: list[np.ndarray]) -> Any:
    if "value" in value:
        return value["value"]
    if "dict" in value:
        return {key: _unpacked(v, arrays) for key, v in value["dict"].items()}
    if "list" in value:
        return [_unpacked(v, arrays) for v in value["list"]]
    array = arrays[value["array"]]
    return array[()] if array.ndim == 0 else array


def _layout(value: Any) -> list[tuple[np.dtype, tuple[int, ...]]]:
    if "array" in value:
        return [(np.dtype(value["type"]), tuple(value["shape"]))]
    inside = value.get("dict", {}).values() if "dict" in value else value.get("list", [])
    return [array for v in inside for array in _layout(v)]


def read_answer(take: Callable[[int], bytearray], path: Path, memory: int) -> Any:
    """Read an answer piece by piece.

    take(count) returns the next `count` bytes. `memory` is the largest allowed total size of the arrays, bytes. Errors of
    matcam in the reading process are raised again. A FileFormatError is raised if the answer is too large or invalid.
    """
    (length,) = struct.unpack("<Q", take(8))
    # more than 64 MiB of JSON indicate damage
    if length > (64 << 20):
        raise FileFormatError(
            f"{path}: the metadata take {length} bytes, more than 64 MiB: the file is damaged; create it again"
        )
    message = json.loads(bytes(take(length)))
    if "error" in message:
        kind = getattr(errors, message["error"], FileFormatError)
        raise kind(message["text"])
    arrays = []
    layout = _layout(message["answer"])
    if sum(dtype.itemsize * math.prod(shape) for dtype, shape in layout) > memory:
        raise FileFormatError(
            f"{path}: the content exceeds the memory limit of {memory / 2**20:.0f} MiB for this file: free memory, or give "
            "a smaller file"
        )
    for dtype, shape in layout:
        if dtype.kind not in _KINDS:
            raise FileFormatError(
                f"{path}: values of type {dtype} are not supported: give a file that contains only numbers and text"
            )
        arrays.append(np.frombuffer(take(dtype.itemsize * math.prod(shape)), dtype).reshape(shape))
    return _unpacked(message["answer"], arrays)


def write_answer(write: Callable[[Any], Any], message: dict[str, Any], arrays: list[np.ndarray]) -> None:
    text = json.dumps(message).encode()
    write(struct.pack("<Q", len(text)) + text)
    for array in arrays:
        if array.nbytes:
            write(array.reshape(-1).view(np.uint8).data if array.dtype.kind not in "SU" else array.tobytes())
