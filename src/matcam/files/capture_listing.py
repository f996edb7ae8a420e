"""List of a capture from a folder of photographs: names, lamp positions, exposures and their times.

Images in the folder itself, or in its subfolder frames/, are images of the sample. Images in dark/, flat/, outline/ and
reference/ are of the kind of their folder. Exposure times are read from the metadata of the files. Directions of the
lamp are read from a light position file.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import ArgumentError, MatcamError, OutputError
from matcam.core.io import all_or_nothing, replacing
from matcam.core.readers.names import check_folder, is_file, is_folder, is_there
from matcam.core.remark import some_of
from matcam.files.capture import KINDS
from matcam.files.light_positions import LightPosition, are_unit_vectors, read_light_positions
from matcam.files.photographs import PICTURES, open_photograph
from matcam.files.picture_header import read_exif

_SPLIT = re.compile(r"(?P<lamp>.+)[_-](?P<exposure>[^_-]+)")


@dataclass
class Listing:
    """List of the images of a capture.

    Attributes:
        rows: lines of frames.csv, each with its values by column.
        copies: dict from the path of an image to its name in the capture.
        notes: remarks, and fields to fill in.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    copies: dict[Path, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def copy_to(self, folder: Path, *, force: bool = False) -> None:
        """Copy the images into the folder of the capture.

        Images that are already in their positions are not copied.

        Args:
            folder: folder of the capture.
            force: True to replace existing files that have the name of a copy. Default: False.

        Raises:
            OutputError: another file with the name of a copy exists and `force` is False, or a file cannot be written.
        """
        wanted = [(source, folder / name) for source, name in self.copies.items()]
        wanted = [(source, target) for source, target in wanted if source.resolve() != target.resolve()]
        taken = [target.name for _, target in wanted if is_there(target)]
        if taken and not force:
            raise OutputError(f"output {folder} already has {some_of(taken)}: use force=True to replace existing files")
        with all_or_nothing():
            for source, target in wanted:
                with replacing(target, force=force) as temporary:
                    shutil.copy2(source, temporary)


def list_photographs(source: str | Path, light_positions: str | Path | None = None) -> Listing:
    """List the photographs of a folder as a capture.

    Photographs of one lamp position are grouped by the first of these criteria that applies: the light position file;
    names that end in the exposure, such as "L01_E1"; exposure times that repeat from one lamp position to the next.
    Otherwise each photograph has its own lamp position.

    Args:
        source: folder of photographs.
        light_positions: `.lp` file with the lamp of each photograph. Default: None, the `.lp` file in the folder, if
            there is one.

    Returns:
        The list of images.

    Raises:
        ArgumentError: the folder contains no photograph of the sample, or several light position files.
        FileFormatError: the folder is missing, or the light position file is invalid.
    """
    source = Path(source)
    check_folder(source)
    found = {kind: _pictures(source / kind) for kind in KINDS}
    found["frames"] = sorted([*_pictures(source), *found["frames"]], key=_in_order)
    if not found["frames"]:
        text = f"{source}: the folder contains no photograph of the sample ({', '.join(PICTURES[:6])} or camera raw)"
        raise ArgumentError(text)
    listing = Listing()
    others = [
        path.name for path in _files(source) if path.suffix.lower() not in (*PICTURES, ".lp", ".csv", ".toml", ".json")
    ]
    if others:
        listing.notes.append(f"{some_of(others)}: the format is not supported; convert the images to TIFF or PNG")
    times = {path: read_exif(path).time for paths in found.values() for path in paths}
    names = _exposure_names([time for time in times.values() if time is not None])
    positions = _light_positions(source, light_positions)
    lamps = _lamp_names(found["frames"], times, positions)
    directions = {} if positions is None else {one.file.lower(): one for one in positions}
    of_lamp = {lamp: one for path, (lamp, _) in lamps.items() if (one := _matching(path, directions)) is not None}
    by_suffix = {suffix for _, suffix in lamps.values()}
    for kind in KINDS:
        for path in found[kind]:
            lamp, suffix = lamps.get(path, ("", ""))
            ending = _SPLIT.fullmatch(path.stem)
            if kind != "frames" and ending is not None and ending["exposure"] in by_suffix:
                suffix = ending["exposure"]
            row: dict[str, Any] = {"file": f"{kind}/{path.name}", "lamp": lamp}
            time = times[path]
            least, name = (None, suffix or "E1") if time is None else _exposure(time, names)
            row |= {"exposure": name, "time_s": "" if least is None else f"{least:.6g}"}
            position = _matching(path, directions) or of_lamp.get(lamp) if kind == "frames" else None
            if position is not None:
                angle, azimuth = np.degrees(position.angles)
                row |= {"angle_deg": f"{angle:.4f}", "azimuth_deg": f"{azimuth + 0.0:.4f}"}
            listing.rows.append(row)
            listing.copies[path] = row["file"]
    listing.notes += _notes(found, times, positions, listing.rows)
    return listing


def _files(folder: Path) -> list[Path]:
    if not is_folder(folder):
        return []
    return [path for path in folder.iterdir() if is_file(path) and not path.name.startswith(".")]


def _pictures(folder: Path) -> list[Path]:
    return sorted((path for path in _files(folder) if path.suffix.lower() in PICTURES), key=_in_order)


def _in_order(path: Path) -> list[tuple[int, int, str]]:
    """Compute a sort key that orders image 2 before image 10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]


def _exposure_names(times: Sequence[float]) -> list[tuple[float, str]]:
    """Compute the smallest time, s, and the name of each exposure, in ascending order of the times."""
    least: list[float] = []
    for time in sorted(times):
        # times with a ratio below 1.1 belong to one exposure; steps of a third of a stop have a ratio of 1.26
        if not least or time > 1.1 * least[-1]:
            least.append(time)
    return [(time, f"E{number}") for number, time in enumerate(least, 1)]


def _exposure(time: float, names: Sequence[tuple[float, str]]) -> tuple[float, str]:
    return [one for one in names if one[0] <= time][-1]


def _light_positions(source: Path, path: str | Path | None) -> list[LightPosition] | None:
    if path is not None:
        return read_light_positions(path)
    found = sorted(one for one in _files(source) if one.suffix.lower() == ".lp")
    if len(found) > 1:
        names = ", ".join(one.name for one in found)
        raise ArgumentError(f"{source}: the folder has several light position files ({names}): name one with --lamps")
    return read_light_positions(found[0]) if found else None


def _matching(path: Path, directions: dict[str, LightPosition]) -> LightPosition | None:
    """Find the light position of a photograph by its file name.

    The name without suffix suffices, because files are often converted. The result is None if no name matches.
    """
    if path.name.lower() in directions:
        return directions[path.name.lower()]
    stem = path.stem.lower()
    return next((one for name, one in directions.items() if Path(name).stem == stem), None)


def _lamp_names(
    frames: Sequence[Path], times: dict[Path, float | None], positions: list[LightPosition] | None
) -> dict[Path, tuple[str, str]]:
    """Find the names of the lamp position and of the exposure of each photograph.

    The name of the exposure is "" if the file name does not contain it.
    """
    by_name = {one.file.lower(): one for one in positions or ()}
    stated = {path: one for path in frames if (one := _matching(path, by_name)) is not None}
    if stated and len(stated) == len(frames):  # some light position files list one photograph per lamp position
        seen: list[np.ndarray] = []
        found = {}
        for path, one in stated.items():
            towards = one.position / np.linalg.norm(one.position)
            # directions that differ by less than 0.01 degrees belong to one lamp position
            same = [k for k, other in enumerate(seen) if np.linalg.norm(towards - other) < math.radians(0.01)]
            if not same:
                seen.append(towards)
            found[path] = (same or [len(seen) - 1])[0]
        return _named(frames, found, len(seen))
    parts = {path: _SPLIT.fullmatch(path.stem) for path in frames}
    if all(parts.values()):
        pairs = {path: (part["lamp"], part["exposure"]) for path, part in parts.items() if part}
        lamps, exposures = ({pair[k] for pair in pairs.values()} for k in (0, 1))
        whole = len(set(pairs.values())) == len(frames) == len(lamps) * len(exposures)
        if whole and len(lamps) > 1 and 1 < len(exposures) <= 12:
            return pairs
    number, used, at = -1, set[str](), {}
    names = _exposure_names([time for path in frames if (time := times[path]) is not None])
    for path in frames:
        time = times[path]
        name = "" if time is None else _exposure(time, names)[1]
        if number < 0 or len(names) < 2 or not name or name in used:
            number, used = number + 1, set()
        used.add(name)
        at[path] = number
    return _named(frames, at, number + 1)


def _named(frames: Sequence[Path], at: dict[Path, int], count: int) -> dict[Path, tuple[str, str]]:
    digits = max(2, len(str(count)))
    return {path: (f"L{at[path] + 1:0{digits}d}" if path in at else "", "") for path in frames}


def _kind_notes(path: Path) -> list[str]:
    try:
        values = open_photograph(path).values
    except MatcamError as error:
        return [str(error)]
    what = ["has 8 bits"] if values.dtype == np.uint8 else []
    what += ["is in full colour"] if values.ndim == 3 else []
    if not what:
        return []
    text = f"{path.name}: the image {' and '.join(what)}; raw frames are more accurate. "
    text += "Set camera.accept_processed = true to use it"
    return [text + (', and camera.tone = "srgb" if it is not linear' if what[0] == "has 8 bits" else "")]


def _notes(
    found: dict[str, list[Path]],
    times: dict[Path, float | None],
    positions: list[LightPosition] | None,
    rows: list[dict[str, Any]],
) -> list[str]:
    notes = []
    lamps = {row["lamp"] for row in rows if row["lamp"]}
    exposures = {row["exposure"] for row in rows if row["file"].startswith("frames/")}
    notes.append(
        f"images of the sample: {len(found['frames'])}; lamp positions: {len(lamps)}; exposures: {len(exposures)}"
    )
    notes += _kind_notes(found["frames"][0])
    unknown = [path.name for path, time in times.items() if time is None]
    if unknown:
        notes.append(f"{some_of(unknown)}: the metadata contain no exposure time; fill in time_s, or leave it empty")
    if positions is None:
        notes.append(
            "angle_deg and azimuth_deg are empty: fill them in, or give a light position file (.lp) with --lamps"
        )
    else:
        lost = [row["file"] for row in rows if row["file"].startswith("frames/") and not row.get("angle_deg")]
        if lost:
            notes.append(f"{some_of(lost)}: not in the light position file; fill in lamp and angles")
        if not are_unit_vectors(positions):
            length = float(np.median([np.linalg.norm(one.position) for one in positions]))
            notes.append(
                f"the light position file contains positions at {length:.4g} of its units from the centre: give this "
                "distance in mm as distances.lamp_mm in capture.toml"
            )
    missing = [kind for kind in ("dark", "outline") if not found[kind]]
    if missing:
        notes.append(
            f"no images in {' and '.join(f'{kind}/' for kind in missing)}: docs/capture.md describes their purpose"
        )
    return notes
