"""Decoders that do what damaged files make real ones do."""

import ctypes
import os
import time
from pathlib import Path

import numpy as np

from matcam.core.errors import ArgumentError, FileFormatError


def hang(path: Path):
    time.sleep(1e4)


def end_as(path: Path, *, number: int, once: bool = False):
    """End this process by a signal; once: only the first process that reads the file."""
    if once and path.stat().st_mode & 0o100:
        return "read"
    path.chmod(0o744)
    os.kill(os.getpid(), number)
    return hang(path)


def end_nursery(path: Path, *, number: int):
    if path.stat().st_mode & 0o100:
        return "read"
    path.chmod(0o744)
    os.kill(os.getppid(), number)
    return hang(path)


def long_texts(path: Path):
    return np.array(["x" * (1 << 20), *[""] * (1 << 16)], dtype=object)


def wait(path: Path):
    time.sleep(1.2)
    return "read"


def spin(path: Path):
    while True:
        pass


def crash(path: Path):
    ctypes.string_at(0)


def fill(path: Path):
    return [bytearray(1 << 26) for _ in range(1 << 12)] and None


def write(path: Path):
    Path(f"{path}.written").write_bytes(b"x" * 100)


def refuse(path: Path):
    raise FileFormatError(f"{path}: byte 7 is wrong")


def argue(path: Path):
    raise ArgumentError("sampling must be centre or edge")


def complain(path: Path):
    raise RuntimeError("two\nlines")


def complain_of_the_system(path: Path):
    raise PermissionError(13, "Permission denied", "somewhere")


def complain_as_a_library(path: Path):
    raise OSError("Unable to open file (truncated file: eof = 96)")


def run_out(path: Path):
    raise MemoryError


def pickled(path: Path):
    return {"thing": object()}


def everything(path: Path, *, scale: float = 1.0):
    return {
        "floats": np.arange(12.0).reshape(3, 4) * scale,
        "fortran": np.asfortranarray(np.arange(12).reshape(3, 4)),
        "strided": np.arange(12)[::2],
        "empty": np.zeros((0, 3), np.float32),
        "scalar": np.float64(2.5),
        "flags": np.array([True, False]),
        "text": np.array(["red", "green"]),
        "objects": np.array(["a", "bc"], dtype=object),
        "nothing": None,
        "list": [1, "two", 3.5, float("inf"), [True]],
        "process": os.getpid(),
    }
