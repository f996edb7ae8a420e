r"""Images of 32-bit floats as TIFF and as OpenEXR.

An image has the shape (H, W) or (H, W, channels), for height H and width W, px. Row 0 is on top.

TIFF 6.0 with SampleFormat 3: one page, interleaved channels, compressed by deflate. Three channels are marked as RGB, any
other number as grey with extra samples; the values are linear in both cases.

OpenEXR: one part, scan lines, 32-bit floats, lossless compression. All values are little-endian.

    byte 0  int32   20000630, the magic number
         4  int32   version: low byte 2; bits 0x200 tiles, 0x800 deep data, 0x1000 several parts must be 0
         8  attributes, each: name\0 type\0 int32 size, then its bytes; an empty name ends them
            "channels" chlist: name\0 int32 type (0 uint, 1 half, 2 float) int32 linear int32 x, y sampling; \0 ends
            "compression" uint8; "dataWindow" int32[4]: x and y of the first and of the last pixel
         -  uint64[chunks]   first byte of each chunk of scan lines
         -  chunks: int32 y, int32 size, then as many bytes

Channels: "Y" for (H, W); "R", "G", "B" for three; "C0000", "C0001", ... for any other number (the format keeps them in
alphabetical order). The structure is checked here before the library decodes the file, because the library does not check it.
Decoding runs in a separate process (picture_decoders.py).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.io import reading, replacing
from matcam.core.readers.apart import read_apart
from matcam.core.remark import some_of
from matcam.files.picture_header import LARGEST, check_memory, check_promised, picture_memory

_DECODERS = "matcam.files.picture_decoders"
_MOST_CHANNELS = 4096
_LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32}
"""Number of scan lines per chunk by compression: none, RLE, ZIPS, ZIP, PIZ. Other compressions lose digits of floats."""


def as_float32(picture: ArrayLike) -> np.ndarray:
    """Convert an image to contiguous float32.

    NaN (missing) and infinite values are accepted. An ArgumentError is raised for a wrong shape or wrong labels of the
    channels, for complex numbers or text, and for values beyond float32.
    """
    given = checks.plain_array("picture", picture)
    labels = [str(label) for label in np.atleast_1d(getattr(picture, "coords", {}).get("channel", ()))]
    if labels and labels != list(_names(len(labels))):
        raise ArgumentError(
            f"picture has the channels {', '.join(labels)[:60]}, but must have {', '.join(_names(len(labels)))}"
        )
    if given.dtype.kind not in "fiub":
        raise ArgumentError(f"picture must contain real numbers, got {given.dtype}")
    if given.ndim not in (2, 3) or given.size == 0 or given.size > LARGEST:
        raise ArgumentError(
            f"picture must have shape (H, W) or (H, W, channels) with 1 to {LARGEST} values, got {given.shape}"
        )
    with np.errstate(over="ignore"):
        stored = np.ascontiguousarray(given, dtype=np.float32)
    lost = np.isinf(stored) & np.isfinite(given)
    if np.any(lost):
        raise ArgumentError(f"picture must lie within the range of float32, got {given[lost].flat[0]:g}")
    return stored


def write_float_tiff(path: str | Path, picture: ArrayLike, *, force: bool = False) -> None:
    """Write an image as a TIFF file of 32-bit floats.

    Args:
        path: file to write (.tif).
        picture: linear values, shape (height, width) or (height, width, channels), row 0 on top; missing values are
            NaN.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: the image has another shape or wrong labels of its channels, or its values are not real numbers
            within float32.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_float_tiff(Path(folder) / "a.tif", np.ones((2, 3, 3)))
        ...     matcam.io.read_float_tiff(Path(folder) / "a.tif").shape
        (2, 3, 3)
    """
    import tifffile

    stored = as_float32(picture)
    channels = stored.shape[2] if stored.ndim == 3 else 1
    with replacing(path, force=force) as temporary:
        tifffile.imwrite(
            temporary,
            stored,
            photometric="rgb" if channels == 3 else "minisblack",
            planarconfig="contig" if channels > 1 else None,
            compression="zlib",
        )


def read_float_tiff(path: str | Path) -> np.ndarray:
    """Read an image from a TIFF file of 32-bit floats.

    Args:
        path: TIFF file of one page.

    Returns:
        Values, float32, shape (height, width) or (height, width, channels), row 0 on top.

    Raises:
        FileFormatError: the file is missing or damaged, has several pages or separate planes of colours, or contains
            values other than 32-bit floats.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_float_tiff(Path(folder) / "a.tif", np.full((2, 3), 0.25))
        ...     matcam.io.read_float_tiff(Path(folder) / "a.tif")[0]
        array([0.25, 0.25, 0.25], dtype=float32)
    """
    path = Path(path)
    libraries = ("tifffile", "imagecodecs._zlib")
    return read_apart(f"{_DECODERS}:decode_float_tiff", path, "an image", libraries=libraries, there=picture_memory())


def write_exr(path: str | Path, picture: ArrayLike, *, force: bool = False) -> None:
    """Write an image as an OpenEXR file of 32-bit floats.

    Args:
        path: file to write (.exr).
        picture: linear values, shape (height, width) or (height, width, channels), row 0 on top; missing values are
            NaN.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: the image has another shape or wrong labels of its channels, or its values are not real numbers
            within float32.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_exr(Path(folder) / "a.exr", np.ones((2, 3, 3)))
        ...     matcam.io.read_exr(Path(folder) / "a.exr").shape
        (2, 3, 3)
    """
    _write_channels(path, _planes(picture), force)


def write_exr_layers(path: str | Path, layers: Mapping[str, ArrayLike], *, force: bool = False) -> None:
    """Write several images as layers of one OpenEXR file.

    Viewers show each layer as a group of channels, such as `corrected.R`.

    Args:
        path: file to write (.exr).
        layers: images of the same size by name, (height, width) or (height, width, 3), row 0 on top; missing values are
            NaN.
        force: True to replace an existing file. Default: False.
    """
    channels: dict[str, np.ndarray] = {}
    for layer, picture in layers.items():
        channels |= {f"{layer}.{name}": plane for name, plane in _planes(picture).items()}
    _write_channels(path, channels, force)


def _planes(picture: ArrayLike) -> dict[str, np.ndarray]:
    stored = as_float32(picture)
    names = _names(None if stored.ndim == 2 else stored.shape[2])
    return dict(zip(names, np.moveaxis(np.atleast_3d(stored), -1, 0), strict=True))


def _write_channels(path: str | Path, planes: Mapping[str, np.ndarray], force: bool) -> None:
    import OpenEXR

    channels = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with replacing(path, force=force) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:  # error of the library on a full disk
            reason = " ".join(str(error).split()).rpartition('". ')[2].rstrip(".")
            raise OutputError(f"output {path} cannot be written: {reason:.100}") from None


def read_exr(path: str | Path) -> np.ndarray:
    """Read an image from an OpenEXR file of 32-bit floats.

    Args:
        path: OpenEXR file of one part with scan lines, losslessly compressed.

    Returns:
        Values, float32, shape (height, width) or (height, width, channels), row 0 on top.

    Raises:
        FileFormatError: the file is missing or damaged, or its content is not supported. The message lists the
            supported content.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_exr(Path(folder) / "a.exr", np.full((2, 3), 0.25))
        ...     matcam.io.read_exr(Path(folder) / "a.exr")[0]
        array([0.25, 0.25, 0.25], dtype=float32)
    """
    layers = read_exr_layers(path)
    if list(layers) != [""]:
        raise FileFormatError(
            f"{path}: the file has the layers {some_of(one[:40] for one in layers)}, but must contain one image: store one "
            "layer in a file of its own"
        )
    return layers[""]


def read_exr_layers(path: str | Path) -> dict[str, np.ndarray]:
    """Read the images in the layers of an OpenEXR file of 32-bit floats.

    Args:
        path: OpenEXR file as for `read_exr`, such as `write_exr_layers` writes.

    Returns:
        Images by the name of the layer, float32, (height, width) or (height, width, channels). The name of an image
        without a layer is empty.
    """
    path = Path(path)
    layers, height, width = _checked_header(path)
    channels = [f"{layer}.{name}".removeprefix(".") for layer, names in layers.items() for name in names]
    check_memory(path, height, width, len(channels), 4, picture_memory())
    stored = read_apart(f"{_DECODERS}:decode_exr", path, "an image", libraries=("OpenEXR",), channels=channels)
    if any(stored[name].shape != (height, width) or stored[name].dtype != np.float32 for name in channels):
        raise FileFormatError(
            f"{path}: the OpenEXR file is damaged, because its channels differ from its header: create it again"
        )
    planes = iter([stored[name] for name in channels])
    return {
        layer: next(planes) if names == ("Y",) else np.stack([next(planes) for _ in names], axis=-1)
        for layer, names in layers.items()
    }


def _names(channels: int | None) -> tuple[str, ...]:
    if channels is None:
        return ("Y",)
    return ("R", "G", "B") if channels == 3 else tuple(f"C{i:04}" for i in range(channels))


def _checked_header(path: Path) -> tuple[dict[str, tuple[str, ...]], int, int]:
    """Check the header, and read the names of the channels by layer, the height and the width."""
    try:
        with reading(path, "an image"), path.open("rb") as file:
            size = path.stat().st_size
            head = file.read(min(size, 1 << 20))
            if len(head) < 8 or struct.unpack_from("<i", head)[0] != 20000630:
                raise FileFormatError(f"{path}: the file is not an OpenEXR file: convert it to OpenEXR")
            version = struct.unpack_from("<i", head, 4)[0]
            if version & 0xFF != 2 or version & 0x1A00:
                raise FileFormatError(
                    f"{path}: OpenEXR with tiles, deep data or several parts is not supported: store the image as one part "
                    "with scan lines"
                )
            attributes, start = _attributes(head)
            layers, height, width = _described(path, attributes, size)
            compression = attributes["compression"][0]
            if compression not in _LINES_PER_CHUNK:
                raise FileFormatError(
                    f"{path}: compression {compression} of OpenEXR is not supported: save the image without compression, or "
                    "with RLE, ZIPS, ZIP or PIZ"
                )
            chunks = -(-height // _LINES_PER_CHUNK[compression])
            if start + 8 * chunks > size:
                raise FileFormatError(
                    f"{path}: the file is truncated: its {size} bytes end within the table of {chunks} chunks; copy it again"
                )
            file.seek(start)
            offsets = np.frombuffer(file.read(8 * chunks), "<u8")
            for offset in offsets.tolist():
                if not start + 8 * chunks <= offset <= size - 8:
                    raise FileFormatError(
                        f"{path}: the file is truncated or damaged: a chunk starts at byte {offset} of {size}; copy it again"
                    )
                file.seek(offset + 4)
                length = struct.unpack("<i", file.read(4))[0]
                if not 0 <= length <= size - 8 - offset:
                    raise FileFormatError(
                        f"{path}: the file is truncated or damaged: byte {offset + 4} specifies a chunk of {length} bytes, but "
                        f"the file has {size}; copy it again"
                    )
    except (struct.error, IndexError, KeyError, UnicodeDecodeError):
        raise FileFormatError(f"{path}: the header of the OpenEXR file is damaged: create it again") from None
    return layers, height, width


def _attributes(head: bytes) -> tuple[dict[str, bytes], int]:
    found, at = {}, 8
    while head[at]:
        name, at = _text(head, at)
        _, at = _text(head, at)
        length = struct.unpack_from("<i", head, at)[0]
        at += 4
        if length < 0 or at + length >= len(head):
            raise IndexError
        found[name] = head[at : at + length]
        at += length
    return found, at + 1


def _described(path: Path, attributes: dict[str, bytes], size: int) -> tuple[dict[str, tuple[str, ...]], int, int]:
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    listed, names, at = attributes["channels"], [], 0
    while listed[at]:
        name, at = _text(listed, at)
        kind, _, *sampling = struct.unpack_from("<4i", listed, at)
        at += 16
        if kind != 2:
            stored = {0: "whole numbers", 1: "16-bit floats"}.get(kind, "an unknown type")
            raise FileFormatError(
                f"{path}: channel {name!r:.40} contains {stored}, but only 32-bit floats are supported"
            )
        if sampling != [1, 1]:
            raise FileFormatError(
                f"{path}: channel {name!r:.40} is subsampled, which is not supported: give an image without subsampling"
            )
        names.append(name)
        if len(names) > _MOST_CHANNELS:
            raise FileFormatError(
                f"{path}: the image has more than {_MOST_CHANNELS} channels: give an image with fewer channels"
            )
    listed_names = dict[str, list[str]]()
    for name in names:
        layer, _, own = name.rpartition(".")
        listed_names.setdefault(layer, []).append(own)
    layers = {layer: _names(None if own == ["Y"] else len(own)) for layer, own in listed_names.items()}
    if any(sorted(own) != sorted(layers[layer]) for layer, own in listed_names.items()):
        raise FileFormatError(
            f"{path}: the channels are {some_of(one[:40] for one in names)}, but must be Y, or R, G, B, or C0000, C0001 and "
            "so on"
        )
    check_promised(path, bottom - top + 1, right - left + 1, len(names), size)
    return layers, bottom - top + 1, right - left + 1


def _text(head: bytes, at: int) -> tuple[str, int]:
    end = head.index(b"\0", at, at + 256) if b"\0" in head[at : at + 256] else -1
    if end < 0:
        raise IndexError
    return head[at:end].decode(), end + 1
