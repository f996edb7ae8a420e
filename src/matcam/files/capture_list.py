"""The pictures of a capture, one line each: frames.csv (capture.py has the folder).

    file,lamp,angle_deg,azimuth_deg,exposure,time_s     empty where it does not apply

A line that is wrong is left out and named. Nothing outside of the folder is read.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.remark import Remark, some_of
from matcam.files.photographs import PICTURES

LIST = "frames.csv"
KINDS = ("frames", "dark", "flat", "outline", "reference")
COLUMNS = ("file", "lamp", "angle_deg", "azimuth_deg", "exposure", "time_s")
_LARGEST = 4 << 20  # bytes of capture.toml or frames.csv
_MOST = 20_000  # lines of frames.csv
_NAME = re.compile(r"[\w.+-]{1,60}")


class CaptureFrame(NamedTuple):
    """Name one picture of a capture.

    Attributes:
        file: name inside the folder, such as "frames/L05_E2.tif".
        kind: "frames", "dark", "flat", "outline" or "reference": the folder in which it lies.
        lamp: the lamp position; empty where there is none.
        exposure: which exposure; pictures of one exposure share their time.
        time: nominal exposure time, s; NaN: not stated.
    """

    file: str
    kind: str
    lamp: str
    exposure: str
    time: float


class LampGuess(NamedTuple):
    """State where a lamp position is thought to be, seen from the sample's centre.

    Attributes:
        angle: between lamp and optical axis, rad; NaN: not stated.
        azimuth: about the axis from +x (right) towards +y (up), rad; NaN: not stated.
    """

    angle: float
    azimuth: float

    @property
    def direction(self) -> np.ndarray:
        """Return the unit vector (x, y, z) to the lamp; NaN where an angle is not stated."""
        sin = math.sin(self.angle)
        return np.array([sin * math.cos(self.azimuth), sin * math.sin(self.azimuth), math.cos(self.angle)])


def read_text(path: Path) -> str:
    """Return one of the two text files; FileFormatError where it is too large, or lies elsewhere."""
    with reading(path, "a capture"):
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for a capture's description")
        if not path.resolve().is_relative_to(path.parent.resolve()):
            raise FileFormatError(f"{path}: is a link out of its folder: put the file itself there")
        return path.read_text(encoding="utf-8-sig", errors="replace")


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file of the folder; FileFormatError where it leads out of it."""
    pure = PurePosixPath(name)
    path = folder / name
    if pure.is_absolute() or ".." in pure.parts or "\\" in name or re.match(r"[A-Za-z]:", name):
        raise FileFormatError(f"{path}: leads out of the capture's folder: give a name inside it")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FileFormatError(f"{path}: is a link out of the capture's folder: put the file itself there")
    return path


def read_list(folder: Path) -> tuple[list[CaptureFrame], dict[str, LampGuess], list[Remark]]:
    """Return the frames of frames.csv that are there, the lamps, and what is wrong with the others."""
    path = folder / LIST
    reader = csv.reader(io.StringIO(read_text(path)))
    try:
        lines = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise FileFormatError(f"{path}: line {reader.line_num}: {error}") from None
    if not lines or sorted(lines[0][1]) != sorted(COLUMNS):
        got = ",".join(lines[0][1]) if lines else "nothing"
        raise FileFormatError(f"{path}: first line must be {','.join(COLUMNS)}, got {got:.100}")
    if len(lines) > _MOST:
        raise FileFormatError(f"{path}: {len(lines)} lines; a capture has at most {_MOST} frames")
    frames: list[CaptureFrame] = []
    lamps: dict[str, LampGuess] = {}
    problems: list[Remark] = []
    seen: set[str] = set()
    absent: list[str] = []
    header = lines[0][1]
    for number, cells in lines[1:]:
        if len(cells) != len(COLUMNS):
            problems.append(
                Remark("bad-line", f"{path}: line {number} has {len(cells)} cells; {len(COLUMNS)} are read")
            )
            continue
        row = dict(zip(header, cells, strict=True))
        try:
            found = _frame(folder, row, seen, lamps)
        except FileFormatError as error:
            problems.append(Remark("bad-frame", f"{error} (line {number} of {LIST})"))
            continue
        if found is None:
            absent.append(row["file"])
            continue
        frame, guess = found
        seen.add(frame.file)
        frames.append(frame)
        if frame.lamp and guess is not None:
            lamps[frame.lamp] = guess
    if absent:
        where = folder / absent[0] if len(absent) == 1 else f"{folder}: {some_of(absent)}"
        problems.append(Remark("bad-frame", f"{where}: no such file{'s' * (len(absent) > 1)}, though {LIST} lists it"))
    times: dict[str, float] = {}
    for frame in frames:
        if not math.isnan(frame.time) and frame.time != times.setdefault(frame.exposure, frame.time):
            text = f"{folder / frame.file}: exposure {frame.exposure} has {frame.time:g} s here and "
            text += f"{times[frame.exposure]:g} s before: give one name to one exposure"
            problems.append(Remark("times-differ", text))
    return frames, lamps, problems


def _frame(
    folder: Path, row: dict[str, str], seen: set[str], lamps: dict[str, LampGuess]
) -> tuple[CaptureFrame, LampGuess | None] | None:
    """Return one line's frame and lamp; None where there is no such file, FileFormatError where it cannot be used."""
    name = row["file"]
    if not name or not name.isprintable() or len(name) > 200:
        raise FileFormatError(f"{folder}: frame {name[:40]!r} has no name that is plain text")
    path = inside(folder, name)
    kind = PurePosixPath(name).parts[0]
    if kind not in KINDS or len(PurePosixPath(name).parts) != 2:
        raise FileFormatError(f"{path}: lies in none of {', '.join(KINDS)}")
    if name in seen:
        raise FileFormatError(f"{path}: is listed twice")
    if not path.is_file():
        return None
    if path.suffix.lower() not in PICTURES:
        raise FileFormatError(f"{path}: is no picture by its suffix")
    values = {}
    for column in ("angle_deg", "azimuth_deg", "time_s"):
        try:
            values[column] = float(row[column]) if row[column] else math.nan
        except ValueError:
            raise FileFormatError(f"{path}: {column} must be a number, got {row[column]!r:.20}") from None
        if math.isinf(values[column]) or (column == "time_s" and values[column] <= 0):
            raise FileFormatError(f"{path}: {column} must be finite and, if a time, above 0, got {row[column]:.20}")
    for column in ("lamp", "exposure"):
        if row[column] and not _NAME.fullmatch(row[column]):
            raise FileFormatError(f"{path}: {column} must be letters, digits, . + - _, got {row[column]!r:.20}")
    lamp, guess = row["lamp"], None
    if kind == "frames":
        if not lamp or not row["exposure"]:
            raise FileFormatError(f"{path}: a frame needs its lamp and its exposure")
        if not (math.isnan(values["angle_deg"]) or 0 <= values["angle_deg"] <= 180):
            raise FileFormatError(f"{path}: angle_deg must lie in [0, 180], got {row['angle_deg']:.20}")
        guess = LampGuess(math.radians(values["angle_deg"]), math.radians(values["azimuth_deg"]))
        known = lamps.get(lamp)
        if known is not None and not np.allclose(known, guess, atol=1e-9, rtol=0, equal_nan=True):
            raise FileFormatError(f"{path}: lamp {lamp} is stated at another place than before")
    return CaptureFrame(name, kind, lamp, row["exposure"], values["time_s"]), guess


def unlisted(folder: Path, frames: Iterable[CaptureFrame], problems: Iterable[Remark]) -> list[Remark]:
    """Name the pictures of the folder that frames.csv does not list."""
    listed = {frame.file for frame in frames}
    texts = " ".join(str(problem) for problem in problems)
    extra: list[str] = []
    for kind in KINDS:
        place = folder / kind
        if not place.is_dir() or not place.resolve().is_relative_to(folder.resolve()):
            continue
        for path in sorted(place.iterdir()):
            name = f"{kind}/{path.name}"
            if path.suffix.lower() in PICTURES and name not in listed and str(path) not in texts:
                extra.append(name)
    if not extra:
        return []
    if len(extra) == 1:
        text = f"{folder / extra[0]}: is not listed in {LIST} and was not read"
    else:
        text = f"{folder}: {len(extra)} files are not listed in {LIST} and were not read: {some_of(extra)}"
    return [Remark("unlisted-frame", text)]
