"""How large a picture says it is, read from its first bytes: before memory is asked for it."""

from __future__ import annotations

import os
import struct
from pathlib import Path

from matcam.errors import FileFormatError

_SHARE = 0.5  # of the memory, that one decoded picture may take
_MOST_SEGMENTS = 200
_FRAMES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
"""PNG's colour types."""


def check_memory(path: Path, height: int, width: int, channels: int, depth: int) -> None:
    """FileFormatError for a picture, of `depth` bytes to a sample, that does not fit into memory."""
    needed, there = height * width * channels * depth, memory()
    if needed > _SHARE * there:
        raise FileFormatError(
            f"{path}: a picture of {width} x {height} px needs {needed / 2**30:.1f} GiB; of the {there / 2**30:.1f} GiB of "
            f"memory here half may be used"
        )


def memory() -> int:
    """Bytes that this process may use at most."""
    most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        return most if limit == resource.RLIM_INFINITY else min(most, limit)
    except ImportError:  # not a Unix
        return most


def png_size(start: bytes) -> tuple[int, int, int, int]:
    """Height, width, channels, bytes to a sample, from a file's first 26 bytes."""
    width, height, bits, colours = struct.unpack_from(">IIBB", start, 16)
    return height, width, _CHANNELS.get(colours, 4), max(bits // 8, 1)


def jpeg_size(path: Path) -> tuple[int, int, int, int]:
    """The same of a JPEG; zeros where it does not say."""
    with path.open("rb") as file:
        at = 2
        for _ in range(_MOST_SEGMENTS):
            file.seek(at)
            head = file.read(10)
            if len(head) < 10 or head[0] != 0xFF:
                break
            if head[1] in _FRAMES:
                bits, height, width, channels = struct.unpack(">BHHB", head[4:])
                return height, width, channels, max(bits // 8, 1)
            at += 2 + struct.unpack(">H", head[2:4])[0]
    return 0, 0, 0, 0
