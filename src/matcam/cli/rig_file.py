"""Rig file, `--rig rig.toml`: values that are the defaults of the options of a command.

    schema = "matcam-rig-1"
    camera = "camera.json"      # a profile beside the file: a name without folders

    [sample]
    shape = "sphere"            # sphere, cylinder or flat
    radius_px = 400             # of the limb in the image
    radius_mm = 25              # if given, the distance of the lamp is in mm

    [lens]
    distance = 30               # of the camera, in radii of the sample
    glare = 0.001               # share of the light in a halo
    glare_radius_px = 30

    [lamp]
    radius_deg = 0.25           # angular radius of the source disc
    distance = 700              # from the centre of the sample, in radii of the sample, or in mm
    azimuth_deg = 30            # of the lamp about the optical axis, in the images behind a table

    [table]
    cell = "nearest"            # lookup of cells in pixels: nearest, bilinear or mean
    phase_px = [0.1, -0.3]      # offset (x, y) of the pixel centres from the centre of the sphere

All entries except `schema` may be omitted. An option of the command line overrides the file. Entries that a command does not
support are errors, except those of `table`, which do not concern a command that reads no table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers.names import is_link, printable

SCHEMA = "matcam-rig-1"

_KEYS = {
    ("camera",): "camera",
    ("sample", "shape"): "sample",
    ("sample", "radius_px"): "radius",
    ("sample", "radius_mm"): "sample_mm",
    ("lens", "distance"): "distance",
    ("lens", "glare"): "glare",
    ("lens", "glare_radius_px"): "glare_radius",
    ("lamp", "radius_deg"): "lamp",
    ("lamp", "distance"): "lamp_distance",
    ("lamp", "azimuth_deg"): "azimuth",
    ("table", "cell"): "cell",
    ("table", "phase_px"): "phase",
}
"""Entries of the file, and the parameters of commands that they set."""


def read_rig_file(path: Path, known: set[str], command: str) -> dict[str, Any]:
    """Read the values of a rig file for the parameters of a command.

    Args:
        path: the file (TOML).
        known: parameters of the command.
        command: name of the command, for messages.

    Returns:
        Value by the name of the parameter.

    Raises:
        FileFormatError: the file is not a rig file, or has an unknown entry or an invalid value.
        ArgumentError: the command has no parameter for an entry.
    """
    entries = _entries(path)
    values = {}
    for keys, value in entries.items():
        where = ".".join(keys)
        if keys not in _KEYS:
            raise FileFormatError(
                f"{path}: unknown entry {printable(where):.60}; the entries of a rig file are "
                f"{', '.join('.'.join(k) for k in _KEYS)}"
            )
        if _KEYS[keys] not in known:
            # every command without an option for the shape assumes a sphere
            if keys[0] == "table" or (keys, value) == (("sample", "shape"), "sphere"):
                _value(path, keys, value)
                continue
            raise ArgumentError(f"{path}: matcam {command} does not support {where}: remove it from the file")
        values[_KEYS[keys]] = _value(path, keys, value)
    return values


def _entries(path: Path) -> dict[tuple[str, ...], Any]:
    from matcam.core.readers.texts import read_toml  # loads NumPy, which the help does not require

    document = read_toml(path, "a rig")
    if document.pop("schema", None) != SCHEMA:
        raise FileFormatError(f'{path}: the file is not a rig file, which must contain schema = "{SCHEMA}"')
    found: dict[tuple[str, ...], Any] = {}
    for key, value in document.items():
        if isinstance(value, dict):
            found |= {(key, inner): one for inner, one in value.items()}
        else:
            found[(key,)] = value
    return found


def _value(path: Path, keys: tuple[str, ...], value: Any) -> Any:
    where = ".".join(keys)
    if keys == ("table", "phase_px"):
        if not isinstance(value, list) or len(value) != 2 or not all(_is_number(one) for one in value):
            raise FileFormatError(f"{path}: {where} must be two numbers, got {value!r:.60}")
        return [float(one) for one in value]
    if keys in (("camera",), ("sample", "shape"), ("table", "cell")):
        if not isinstance(value, str):
            raise FileFormatError(f"{path}: {where} must be a string, got {value!r:.60}")
        if keys != ("camera",):
            return value
        if Path(value).name != value or is_link(path.parent / value):
            raise FileFormatError(
                f"{path}: camera must be the name of a profile in the folder of this file, not a path or a link, got "
                f"{value!r:.60}"
            )
        return path.parent / value
    if not _is_number(value):
        raise FileFormatError(f"{path}: {where} must be a number, got {value!r:.60}")
    return float(value)


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, int | float) and abs(value) < 1e300
