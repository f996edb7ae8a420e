"""Light position files (`.lp`) of reflectance transformation imaging: lamp position of each photograph.

The first line is the number of lines that follow. Each line has a file name and x, y, z of the lamp relative to the
sample's centre: x right, y up, z towards the camera. Vectors have unit length, or the length is the distance of the lamp
in any unit (RTIBuilder, Cultural Heritage Imaging; relight, Visual Computing Lab of CNR).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.io import write_text
from matcam.core.readers.texts import read_lines


class LightPosition(NamedTuple):
    """Position of the lamp in one photograph.

    Attributes:
        file: name of the photograph, without folders.
        position: x, y, z relative to the sample's centre, in the unit of the file, (3,).

    Example:
        >>> at = matcam.io.LightPosition("IMG_1.tif", np.array([0.0, 0.5, 0.5]))
        >>> np.degrees(at.angles)
        array([45., 90.])
    """

    file: str
    position: np.ndarray

    @property
    def angles(self) -> tuple[float, float]:
        """Angle from the optical axis, and azimuth, rad.

        The azimuth is from +x towards +y.
        """
        x, y, z = self.position
        return math.atan2(math.hypot(x, y), z), math.atan2(y, x)


def read_light_positions(path: str | Path) -> list[LightPosition]:
    """Read a light position file.

    Args:
        path: file to read.

    Returns:
        One position per photograph, in the order of the file.

    Raises:
        FileFormatError: the file is missing, its first line is not the number of the other lines, or a line is wrong.
            The message contains the wrong line.

    Example:
        >>> positions = matcam.io.read_light_positions("lamps.lp")  # doctest: +SKIP
        >>> positions[0].file, np.degrees(positions[0].angles)  # doctest: +SKIP
    """
    path = Path(path)
    lines = read_lines(path, "a light position file")
    numbered = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    head = numbered[0][1] if numbered else "nothing"
    if not head.isdecimal():
        raise FileFormatError(f"{path}: the first line must be the number of photographs, got {head!r:.40}")
    if int(head) != len(numbered) - 1:
        raise FileFormatError(
            f"{path}: the first line specifies {int(head)} photographs, but {len(numbered) - 1} lines follow: correct the "
            "number"
        )
    return [_position(path, number, line) for number, line in numbered[1:]]


def write_light_positions(path: str | Path, positions: Sequence[LightPosition], *, force: bool = False) -> None:
    """Write a light position file.

    Args:
        path: file to write (.lp).
        positions: positions of the lamp in each photograph.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: there is no position, an entry is not a `LightPosition`, a position is not three finite numbers
            or is 0, or a name is empty, or has line breaks or outer blanks.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile, pathlib
        >>> at = matcam.io.LightPosition("IMG_1.tif", np.array([0.0, 0.6, 0.8]))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "lamps.lp")
        ...     matcam.io.write_light_positions(path, [at])
        ...     path.read_text().splitlines()
        ['1', 'IMG_1.tif 0.0 0.6 0.8']
    """
    positions = checks.instances("positions", positions, LightPosition)
    checks.flag("force", force)
    if not positions:
        raise ArgumentError("positions must contain at least one LightPosition")
    for one in positions:
        vector = np.asarray(one.position, dtype=float)
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise ArgumentError(f"position of {one.file} must be three finite numbers, not all 0, got {one.position}")
        if len(one.file.splitlines()) != 1 or one.file != one.file.strip():
            raise ArgumentError(
                f"file of a light position must be one line without blanks at its ends, got {one.file!r}"
            )
    lines = [f"{one.file} {' '.join(repr(float(axis)) for axis in one.position)}" for one in positions]
    write_text(path, "\n".join([str(len(lines)), *lines]) + "\n", force=force)


def are_unit_vectors(positions: list[LightPosition]) -> bool:
    """Check whether all positions have unit length, within 2 %.

    Such positions are directions without distances.
    """
    # files are rounded to two or more digits
    return all(abs(float(np.linalg.norm(one.position)) - 1) < 0.02 for one in positions)


def _position(path: Path, number: int, line: str) -> LightPosition:
    name, *cells = line.rsplit(None, 3)  # a name may contain blanks
    try:
        position = np.array([float(cell) for cell in cells])
    except ValueError:
        position = np.full(3, math.nan)
    if position.shape != (3,) or not np.isfinite(position).all() or not 0 < float(np.linalg.norm(position)) < math.inf:
        raise FileFormatError(f"{path}: line {number} must be a file name and x, y, z of its lamp, got {line!r:.60}")
    return LightPosition(name.strip('"').replace("\\", "/").rsplit("/", 1)[-1], position)
