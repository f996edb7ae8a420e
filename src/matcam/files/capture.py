"""Reading of a capture: a folder of photographs of a sample under a moved lamp, with a description of the rig.

    capture.toml    description of the rig: units in the names, a value or [value, standard deviation]
    frames.csv      file,lamp,angle_deg,azimuth_deg,exposure,time_s; one line per image, empty where not applicable
    frames/         images of the sample, one for each lamp position and exposure
    dark/           images with the lens covered, for each exposure
    flat/           images of an evenly lit field, pairs of one exposure
    outline/        images of the sample in front of a bright field
    reference/      separate images of a white patch or a monitor, for each lamp position

docs/capture.md lists the fields, and `json_schema()` returns the published schema (docs/capture-v1.schema.json). Invalid
settings raise an error; an unusable image is omitted and listed in `Capture.problems`. Files outside the folder are not
read.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from matcam.core.errors import FileFormatError
from matcam.core.readers.names import check_folder, check_within, is_file, is_folder, is_there, listed_file
from matcam.core.readers.schemas import validated
from matcam.core.readers.texts import checked_version, read_lines, read_toml
from matcam.core.registry import CFAS
from matcam.core.remark import Remark, some_of
from matcam.files.capture_frames import INTENSITY, CaptureFrame, LampGuess, stated_intensity
from matcam.files.capture_settings import CaptureSettings, Stated
from matcam.files.photographs import PICTURES, Photograph, open_photograph

SETTINGS, LIST = "capture.toml", "frames.csv"
KINDS = ("frames", "dark", "flat", "outline", "reference")
COLUMNS = ("file", "lamp", "angle_deg", "azimuth_deg", "exposure", "time_s")
_MOST = 20_000  # lines of frames.csv

Region = tuple[int, int, int, int]
"""Region of a frame: first column, first row, width, height, px."""


@dataclass(frozen=True)
class Capture:
    """Description of a capture, and access to its frames.

    Attributes:
        folder: folder of the capture.
        frames: the usable images, in the order of `frames.csv`.
        lamps: specified lamp positions by name, in the order of `frames.csv`.
        settings: checked content of capture.toml, with all defaults.
        problems: errors of the omitted images, each with its frame.
    """

    folder: Path
    frames: tuple[CaptureFrame, ...]
    lamps: dict[str, LampGuess]
    settings: dict[str, Any]
    problems: tuple[Remark, ...] = ()

    def of(self, kind: str, lamp: str | None = None, exposure: str | None = None) -> list[CaptureFrame]:
        return [
            frame
            for frame in self.frames
            if frame.kind == kind and lamp in (None, frame.lamp) and exposure in (None, frame.exposure)
        ]

    @property
    def exposures(self) -> list[str]:
        times: dict[str, float] = {}
        for frame in self.of("frames"):
            times.setdefault(frame.exposure, frame.time)
        return sorted(times, key=lambda name: (math.isnan(times[name]), times[name]))

    def time(self, exposure: str) -> float:
        """Look up the nominal time of an exposure, s; NaN if it is unknown."""
        return next((f.time for f in self.frames if f.exposure == exposure and not math.isnan(f.time)), math.nan)

    @property
    def profile(self) -> Path | None:
        return self._file("camera", "profile")

    @property
    def mask(self) -> Path | None:
        return self._file("outline", "mask")

    def _file(self, section: str, field: str) -> Path | None:
        name = self.settings[section][field]
        return None if name is None else self.folder / name

    @property
    def circle(self) -> tuple[tuple[float, float], Stated] | None:
        """Centre (column, row) and radius of the sphere's outline, px; None if they are not specified."""
        section = self.settings["outline"]
        if section["radius_px"] is None:
            return None
        column, row = section["centre_px"]
        return (column, row), Stated(*section["radius_px"])

    @property
    def radius_mm(self) -> Stated | None:
        """Radius of the sample, mm; None if it is not specified."""
        return self.stated("radius_mm")

    def stated(self, name: str) -> Stated | None:
        """Look up a value of [sample] by the name of its field; None if it is not specified."""
        return _as_stated(self.settings["sample"][name])

    @property
    def camera_radii(self) -> Stated | None:
        """Distance of the camera from the centre of the sample, in radii of the sample.

        It is None if the distance or the radius is not specified.
        """
        return self._in_radii("camera_mm")

    @property
    def lamp_radii(self) -> Stated | None:
        """Distance of the lamp from the centre of the sample, in radii of the sample.

        It is None if the distance or the radius is not specified.
        """
        return self._in_radii("lamp_mm")

    @property
    def direction_std(self) -> float:
        """Standard deviation of each lamp direction, and of a rotation common to all, rad."""
        return math.radians(self.settings["lamp"]["direction_std_deg"])

    @property
    def reference_region(self) -> Region | None:
        """Region of the reference in every frame.

        It is None if the reference is not in the frames, or if its region is not specified.
        """
        section = self.settings["reference"]
        return None if section is None or section["apart"] else self.reference_position

    @property
    def reference_position(self) -> Region | None:
        """Region of the reference in the images that show it; None if it is not specified.

        These images are the frames of the sample or separate images.
        """
        section = self.settings["reference"]
        return None if section is None or section["region_px"] is None else tuple(section["region_px"])

    @property
    def reference_apart(self) -> bool:
        section = self.settings["reference"]
        return section is not None and bool(section["apart"])

    @property
    def region(self) -> Region | None:
        """Region of the frames that is used; None if the whole frame is used."""
        box = self.settings["sample"]["region_px"]
        return None if box is None else tuple(box)

    def _in_radii(self, name: str) -> Stated | None:
        distance, radius = _as_stated(self.settings["distances"][name]), self.radius_mm
        if distance is None or radius is None:
            return None
        ratio = distance.value / radius.value
        return Stated(ratio, ratio * math.hypot(distance.std / distance.value, radius.std / radius.value))

    def read(self, frame: CaptureFrame, region: Region | None = None) -> Photograph:
        """Read a frame, or a region of it, without conversion.

        Args:
            frame: one of `frames`.
            region: first column, first row, width, height, px. Default: None, the whole frame.

        Returns:
            The image as stored, with metadata.

        Raises:
            FileFormatError: the file is missing, damaged, or outside the folder.
        """
        return open_photograph(_inside(self.folder, frame.file), region)


def _as_stated(pair: list[float] | None) -> Stated | None:
    return None if pair is None else Stated(*pair)


def read_capture(folder: str | Path) -> Capture:
    """Read the description of a capture, and list its frames.

    No image is decoded. Missing or wrongly described frames are omitted and listed in `problems`.

    Args:
        folder: folder of `capture.toml` and `frames.csv`.

    Returns:
        The capture.

    Raises:
        FileFormatError: a file is missing or invalid, or no frame can be used. The message contains the invalid field.

    Example:
        >>> read_capture("none")
        Traceback (most recent call last):
        ...
        matcam.core.errors.FileFormatError: none: no such folder
    """
    folder = Path(folder)
    check_folder(folder, ": give the folder of a capture")
    if not is_there(folder / SETTINGS):
        raise FileFormatError(
            f"{folder}: the folder has no {SETTINGS}, so it is not a capture: create this file by `matcam capture init`"
        )
    settings = read_settings(folder / SETTINGS)
    if settings["camera"]["profile"] is not None:
        _inside(folder, settings["camera"]["profile"])
    if settings["outline"]["mask"] is not None:
        _inside(folder, settings["outline"]["mask"])
    frames, lamps, problems, named = _listed(folder)
    _check_light(folder, settings, lamps)
    problems += _unlisted(folder, named)
    if not any(frame.kind == "frames" for frame in frames):
        why = f": {problems[0]}" if problems else ": list the frames in this file"
        raise FileFormatError(f"{folder / LIST}: no frame of the sample can be used{why}")
    return Capture(folder, tuple(frames), lamps, settings, tuple(problems))


def _check_light(folder: Path, settings: dict[str, Any], lamps: dict[str, LampGuess]) -> None:
    """Raise FileFormatError if the data contradict the specified source of the lamp intensities."""
    said, path = settings["lamp"]["intensity"], folder / SETTINGS
    lacking = [name for name, guess in lamps.items() if not guess.intensity]
    if said == "reference" and settings["reference"] is None:
        raise FileFormatError(f"{path}: lamp.intensity is {said!r}, but there is no [reference]: add this section")
    if said == "table":
        if lacking:
            raise FileFormatError(
                f"{path}: lamp.intensity is {said!r}, but {LIST} gives no {INTENSITY} of lamp {some_of(lacking, 3)}: fill "
                "in this column"
            )
        if settings["reference"] is not None:
            raise FileFormatError(
                f"{path}: lamp.intensity is {said!r}, but there is also a [reference]: delete this section, or set "
                "lamp.intensity to 'reference'"
            )
    elif len(lacking) < len(lamps):
        raise FileFormatError(
            f"{path}: lamp.intensity is {said!r}, but {LIST} has values in its column {INTENSITY}: set lamp.intensity to "
            "'table', or delete the column"
        )


def read_settings(path: Path) -> dict[str, Any]:
    """Read and check a `capture.toml`. The message of a FileFormatError contains the invalid field."""
    check_within(path, path.parent)
    document = read_toml(path, "a capture")
    checked_version(document, path, "a capture", "matcam capture", (1,))
    settings = validated(CaptureSettings, document, path).model_dump()
    radius = settings["sample"]["radius_mm"]
    for name, distance in settings["distances"].items():
        if radius is not None and distance is not None and not distance[0] > radius[0]:
            text = f"must exceed the radius of the sample, {radius[0]:g} mm, got {distance[0]:g} mm"
            raise FileFormatError(f"{path}: field distances.{name}: {text}")
    cfa = settings["camera"]["cfa"]
    if cfa is not None and cfa not in CFAS:
        raise FileFormatError(f"{path}: field camera.cfa: must be one of {', '.join(CFAS)}, got {cfa!r:.20}")
    return settings


def json_schema() -> dict[str, Any]:
    return CaptureSettings.model_json_schema()


def _inside(folder: Path, name: str) -> Path:
    """Resolve the name of a file. A FileFormatError is raised if the file is outside the folder."""
    return listed_file(folder, name, "the capture's folder")


def _listed(folder: Path) -> tuple[list[CaptureFrame], dict[str, LampGuess], list[Remark], set[str]]:
    """Read frames.csv: the existing frames, the lamps, errors of the other frames, and the names of all files."""
    path = folder / LIST
    check_within(path, folder)
    reader = csv.reader(f"{line}\n" for line in read_lines(path, "the list of a capture"))
    try:
        lines = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise FileFormatError(
            f"{path}: line {reader.line_num} cannot be read as comma-separated values: {error}"
        ) from None
    if not lines or sorted(set(lines[0][1]) - {INTENSITY}) != sorted(COLUMNS):
        got = " ".join(",".join(lines[0][1]).split()) if lines else "nothing"  # a quoted cell may have many lines
        raise FileFormatError(
            f"{path}: the first line must be {','.join(COLUMNS)}, in any order and with or without {INTENSITY}, got {got:.100}"
        )
    if len(lines) > _MOST:
        raise FileFormatError(
            f"{path}: the list has {len(lines)} lines, but at most {_MOST} are allowed: split the capture into several folders"
        )
    frames: list[CaptureFrame] = []
    lamps: dict[str, LampGuess] = {}
    problems: list[Remark] = []
    seen: set[str] = set()
    named: set[str] = set()
    absent: list[str] = []
    wide: list[tuple[int, CaptureFrame, LampGuess]] = []
    header = lines[0][1]
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            problems.append(
                Remark("bad-line", f"{path}: line {number} has {len(cells)} cells, but must have {len(header)}")
            )
            continue
        row = dict(zip(header, cells, strict=True))
        named.add(str(PurePosixPath(row["file"])))
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
        if guess is not None and not (math.isnan(guess.angle) or 0 <= guess.angle <= math.pi):
            wide.append((number, frame, guess))
            continue
        frames.append(frame)
        if frame.lamp and guess is not None:
            lamps[frame.lamp] = guess
    problems += _wide_angles(folder, wide, lamps)
    if absent:
        where = folder / absent[0] if len(absent) == 1 else f"{folder}: {some_of(absent)}"
        files, entries, them = ("files", "lines", "them") if len(absent) > 1 else ("file", "line", "it")
        text = (
            f"{where}: no such {files}, but {LIST} lists {them}: add the {files}, or delete the {entries} of the list"
        )
        problems.append(Remark("bad-frame", text))
    times: dict[str, float] = {}
    for frame in frames:
        if not math.isnan(frame.time) and frame.time != times.setdefault(frame.exposure, frame.time):
            text = f"{folder / frame.file}: exposure {frame.exposure} has {frame.time:g} s here and "
            text += f"{times[frame.exposure]:g} s in an earlier line: give each exposure its own name"
            problems.append(Remark("times-differ", text))
    return frames, lamps, problems, named


def _wide_angles(
    folder: Path, wide: list[tuple[int, CaptureFrame, LampGuess]], lamps: dict[str, LampGuess]
) -> list[Remark]:
    """Build one remark on all angles outside [0, 180] degrees.

    The remark suggests an exchange if all azimuths are valid angles. Equal azimuths are those of lamps on an arc, whose
    angles were measured with a sign.

    Args:
        folder: folder of the capture.
        wide: number, frame and direction of each line with such an angle.
        lamps: lamps of the other lines.
    """
    if not wide:
        return []
    number, frame, guess = wide[0]
    where, line = folder / (frame.file if len(wide) == 1 else LIST), f"line {number} of {LIST}"
    text = f"{where}: angle_deg, from the axis towards the camera, must lie in [0, 180] degrees, got "
    text += f"{math.degrees(guess.angle):.6g} ({line if len(wide) == 1 else f'{line}, the first of {len(wide)} such lines'})"
    azimuths = {one.azimuth for one in (*lamps.values(), *(guess for _, _, guess in wide))}
    if len(azimuths) > 1 and all(0 <= one <= math.pi for one in azimuths):
        text += "; all lines are valid if angle_deg and azimuth_deg are exchanged: check these columns"
        return [Remark("table-exchanged", text)]
    return [Remark("bad-frame", text)]


def _frame(
    folder: Path, row: dict[str, str], seen: set[str], lamps: dict[str, LampGuess]
) -> tuple[CaptureFrame, LampGuess | None] | None:
    """Parse the frame and the lamp of one line.

    The result is None if the file is missing. A FileFormatError is raised if the line cannot be used.
    """
    name = row["file"]
    path = _inside(folder, name)
    kind = PurePosixPath(name).parts[0]
    if kind not in KINDS or len(PurePosixPath(name).parts) != 2:
        raise FileFormatError(f"{path}: the file must lie in one of the folders {', '.join(KINDS)}")
    if name in seen:
        raise FileFormatError(f"{path}: the file is listed twice: delete one of the lines")
    if not is_file(path):
        return None
    if path.suffix.lower() not in PICTURES:
        raise FileFormatError(f"{path}: the suffix is not that of a supported image: convert the file to TIFF or PNG")
    values = {}
    for column in ("angle_deg", "azimuth_deg", "time_s"):
        try:
            values[column] = float(row[column]) if row[column] else math.nan
        except ValueError:
            raise FileFormatError(f"{path}: {column} must be a number, got {row[column]!r:.20}") from None
        if row[column] and not (math.isfinite(values[column]) and (column != "time_s" or values[column] > 0)):
            above = " and above 0" if column == "time_s" else ""
            raise FileFormatError(
                f"{path}: {column} must be finite{above}, got {row[column]:.20}: leave the cell empty if it is unknown"
            )
    for column in ("lamp", "exposure"):
        if row[column] and not re.fullmatch(r"[\w.+-]{1,60}", row[column]):
            raise FileFormatError(
                f"{path}: {column} must consist of letters, digits and . + - _, at most 60 in all, got {row[column]!r:.20}"
            )
    lamp, guess = row["lamp"], None
    if kind == "frames":
        if not lamp or not row["exposure"]:
            raise FileFormatError(f"{path}: a frame must have a lamp and an exposure: fill them in")
        light = stated_intensity(path, row.get(INTENSITY, ""))
        guess = LampGuess(math.radians(values["angle_deg"]), math.radians(values["azimuth_deg"]), light)
        known = lamps.get(lamp)
        if known is not None and any(abs(a - b) > 1e-9 for a, b in zip(known[:2], guess[:2], strict=True)):
            raise FileFormatError(
                f"{path}: lamp {lamp} has a different position from that in an earlier line: use a different lamp "
                "name for each position"
            )
        if known is not None and known.intensity != guess.intensity:
            raise FileFormatError(
                f"{path}: lamp {lamp} has a different intensity from that in an earlier line: give one value for each lamp"
            )
        if known is not None:  # an empty cell does not replace a value
            angle, azimuth = (new if math.isfinite(new) else old for old, new in zip(known[:2], guess[:2], strict=True))
            guess = guess._replace(angle=angle, azimuth=azimuth)
    return CaptureFrame(name, kind, lamp, row["exposure"], values["time_s"]), guess


def _unlisted(folder: Path, named: set[str]) -> list[Remark]:
    extra: list[str] = []
    for kind in KINDS:
        position = folder / kind
        if not is_folder(position) or not position.resolve().is_relative_to(folder.resolve()):
            continue
        for path in sorted(position.iterdir()):
            name = f"{kind}/{path.name}"
            if path.suffix.lower() in PICTURES and name not in named:
                extra.append(name)
    if not extra:
        return []
    if len(extra) == 1:
        text = f"{folder / extra[0]}: the file is not listed in {LIST} and was not read"
    else:
        text = f"{folder}: {len(extra)} files are not listed in {LIST} and were not read: {some_of(extra)}"
    return [Remark("unlisted-frame", text)]
