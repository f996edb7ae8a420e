"""Series of lit and dark exposures of a uniform field, from which a sensor is characterised.

There are two kinds of folders. The first has a descriptor, a text file in the format of the public EMVA 1288 data sets:

    n 12 640 480                    bits, width, height
    b 40000.0 120.0                 lit: exposure time, ns, and photons per pixel
    i images/b_000_snap_001.png     file, relative to the descriptor; two or more per exposure
    d 40000.0                       dark: exposure time, ns

The second has dark images and lit images. The name of a dark image, or of its folder, begins with "dark" or "bias",
that of a lit image with "flat" or "bright". Exposure times are in the names ("flat_20ms_1.tif") or in the metadata of
the files. The lamp must be constant.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.readers.names import check_within, is_file, is_folder, listed_file
from matcam.core.readers.texts import read_lines
from matcam.files.photographs import PICTURES
from matcam.files.picture_header import read_exif

_UNITS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_KINDS = {"dark": False, "bias": False, "flat": True, "bright": True}
"""True for lit frames and False for dark frames, by the beginning of the name of a file or of its folder."""
_MOST_LINES = 20_000
"""Largest number of lines of a descriptor. It limits the time for checking the paths of the files that the lines name."""


class ExposureSet(NamedTuple):
    """Frames of one exposure.

    Attributes:
        lit: True if the field was lit.
        time: exposure time, s.
        photons: photons per pixel, 0 for dark frames. NaN if the number is unknown; the light is then assumed to be
            proportional to the time.
        files: paths of the frames.
    """

    lit: bool
    time: float
    photons: float
    files: tuple[Path, ...]

    @property
    def name(self) -> str:
        light = f", {self.photons:g} photons" if math.isfinite(self.photons) and self.lit else ""
        return f"{'flat' if self.lit else 'dark'} frames of {self.time:g} s{light}"


@dataclass(frozen=True)
class ExposureSeries:
    """Lit and dark exposures of a uniform field.

    Attributes:
        source: folder or descriptor that was read.
        sets: exposures with their frames; dark exposures first, each kind in ascending order of `light`.
        bits: number of bits of a code; None if it is unknown.
    """

    source: Path
    sets: tuple[ExposureSet, ...]
    bits: int | None

    @property
    def light_unit(self) -> str:
        """Unit of `light`, "photons" or "s"."""
        return "photons" if all(math.isfinite(one.photons) for one in self.sets if one.lit) else "s"

    def light(self, one: ExposureSet) -> float:
        """Return the photons per pixel of an exposure, or the exposure time, s (see `light_unit`)."""
        return one.photons if self.light_unit == "photons" else one.time


def read_exposure_series(path: str | Path) -> ExposureSeries:
    """List the frames of a series of exposures.

    Args:
        path: folder of a series, or descriptor.

    Raises:
        FileFormatError: the path is an image, the folder contains no series or several descriptors, a line of the descriptor
            is wrong, a frame has no exposure time, or there are no lit or no dark frames.
    """
    path = Path(path)
    with reading(path):
        folder = is_folder(path)
    if not folder:
        if path.suffix.lower() in PICTURES:
            raise FileFormatError(
                f"{path}: the input is an image, not a series: give the folder of the frames, or a descriptor file"
            )
        return _described(path)
    texts = [one for one in sorted(path.glob("*.txt")) if _is_descriptor(one)]
    if len(texts) > 1:
        names = ", ".join(one.name for one in texts)
        raise FileFormatError(
            f"{path}: the folder has several descriptors of exposures ({names}): give one of these files"
        )
    return _described(texts[0]) if texts else _listed(path)


def _is_descriptor(path: Path) -> bool:
    try:
        lines = _lines(path)
    except FileFormatError:  # too large, or with lines that are too long
        return False
    return any(re.match(r"n\s+\d+\s+\d+\s+\d+$", line) for _, line in lines[:3])


def _lines(path: Path) -> list[tuple[int, str]]:
    lines = read_lines(path, "a descriptor of exposures")
    numbered = ((number, line.strip()) for number, line in enumerate(lines, 1))
    return [(number, line) for number, line in numbered if line and not line.startswith("#")]


def _described(path: Path) -> ExposureSeries:
    """Read a descriptor of the EMVA 1288 reference data sets."""
    lines = _lines(path)
    if len(lines) > _MOST_LINES:
        raise FileFormatError(
            f"{path}: the file has {len(lines)} lines, but at most {_MOST_LINES} are allowed: use several descriptors"
        )
    bits: int | None = None
    sets: list[ExposureSet] = []
    files: list[list[Path]] = []
    for number, line in lines:
        key, *cells = line.split(None, 1 if line[:1] == "i" else -1)
        try:
            if key == "n" and len(cells) == 3:
                bits = int(cells[0])
                # no code has more than 32 bits
                if not 0 < bits <= 32:
                    raise ValueError
            elif key == "b" and len(cells) == 2:
                sets.append(ExposureSet(True, 1e-9 * _number(cells[0]), _number(cells[1]), ()))
                files.append([])
            elif key == "d" and len(cells) == 1:
                sets.append(ExposureSet(False, 1e-9 * _number(cells[0]), 0.0, ()))
                files.append([])
            elif key == "i" and len(cells) == 1 and sets:
                files[-1].append(listed_file(path.parent, cells[0].replace("\\", "/"), "the descriptor's folder"))
            elif key != "v":
                raise ValueError
        except FileFormatError as error:
            raise FileFormatError(f"{path}: line {number}: {error}") from None
        except ValueError:
            text = "must be n BITS WIDTH HEIGHT, b TIME PHOTONS, d TIME, or i FILE after b or d"
            raise FileFormatError(f"{path}: line {number} {text}, got {line!r:.60}") from None
    return _series(path, [one._replace(files=tuple(of)) for one, of in zip(sets, files, strict=True)], bits)


def _number(cell: str) -> float:
    value = float(cell.replace(",", "."))
    if not 0 <= value < math.inf:
        raise ValueError
    return value


def _listed(folder: Path) -> ExposureSeries:
    found: dict[tuple[bool, str], ExposureSet] = {}
    files = sorted(one for one in folder.rglob("*") if one.suffix.lower() in PICTURES and is_file(one))
    for file in files:
        inside = file.relative_to(folder)
        lit = next(
            (lit for part in inside.parts for begin, lit in _KINDS.items() if part.lower().startswith(begin)), None
        )
        if lit is None:
            continue
        check_within(file, folder)
        words = re.sub(r"[_-]", " ", str(inside))
        stated = re.findall(r"(?<![a-zA-Z0-9.])(\d+(?:\.\d+)?)\s?(ns|us|ms|s)(?![a-zA-Z0-9])", words)
        time = float(stated[-1][0]) * _UNITS[stated[-1][1]] if stated else read_exif(file).time
        if time is None:
            raise FileFormatError(
                f"{file}: the image has no exposure time in its metadata or its name: rename it as in flat_20ms_1.tif"
            )
        # exposure times of one set agree to 6 significant digits
        key = (lit, f"{time:.6g}")
        one = found.setdefault(key, ExposureSet(lit, time, math.nan if lit else 0.0, ()))
        found[key] = one._replace(files=(*one.files, file))
    if not found:
        raise FileFormatError(
            f"{folder}: the folder contains no exposures: give images in dark/ and flat/, images with names that "
            "begin with dark and flat, or a descriptor"
        )
    return _series(folder, found.values(), None)


def _series(path: Path, sets: Iterable[ExposureSet], bits: int | None) -> ExposureSeries:
    found = [one for one in sets if one.files]
    for lit, kind in ((True, "lit"), (False, "dark")):
        if not any(one.lit == lit for one in found):
            raise FileFormatError(f"{path}: the series contains no {kind} exposure: give lit and dark exposures")
    series = ExposureSeries(path, tuple(found), bits)
    return ExposureSeries(path, tuple(sorted(found, key=lambda one: (one.lit, series.light(one), one.time))), bits)
