"""Writing of captures: a commented template, and the files of a complete capture (read by capture.py)."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.io import all_or_nothing, check_output_folder, make_folder, replacing, write_text
from matcam.files.capture import COLUMNS, KINDS, LIST, SETTINGS

TEMPLATE = """\
# A capture: photographs of a sample under a moved lamp. docs/capture.md explains every field.
# Units are part of the names. A value may have a standard deviation: radius_mm = [25.0, 0.005].
# Delete fields that you do not know: every field given here is used.

format = "matcam capture"
version = 1

[camera]
# profile = "camera.json"            # from `matcam calibrate`: lens and noise; a file in this folder
# cfa = "RGGB"                       # colours of the first 2 x 2 px; omit it for grey images and camera raw
# black_level_dn = 256               # only without dark frames
# accept_processed = false           # true: accept demosaiced or 8-bit images, which are less accurate

[sample]
kind = "sphere"                      # sphere | cylinder | flat
# radius_mm = [25.0, 0.005]
# region_px = [800, 600, 900, 900]   # first column, first row (both even), width, height around the sphere
# strip_rows_px = [[0, 99], [100, 199]]   # of a cylinder: first and last row of each strip of material
# strip_turn_deg = [0.0, 90.0]       # of each strip: angle of its x axis from the circumferential direction towards up
# tilt_deg = [0, 10, 20]             # of a flat sample, for each lamp position: tilt of its normal towards the right
# mm_per_px = 0.02                   # of a flat sample at normal view

[distances]                          # from the sample's centre
# camera_mm = [1200, 5]
# lamp_mm = [700, 10]

[lamp]
# radius_mm = [3.5, 0.05]            # radius of the source disc
motion = "free"                      # arc | free | table
intensity = "constant"               # reference | constant | table
gain_std = 0.005                     # relative standard deviation of the lamp intensity of an image
direction_std_deg = 1.0              # standard deviation of the angles in frames.csv, and of a rotation common to all

# [reference]                        # object of known radiance, in every frame or in separate images
# kind = "diffuse"                   # diffuse: white patch facing the camera | monitor: radiance proportional to the lamp
# reflectance = [0.98, 0.003]        # of a diffuse reference: F is then absolute
# depth_mm = [0, 2]                  # of a diffuse reference: distance from the sphere's centre towards the camera
# region_px = [10, 10, 60, 60]       # first column, first row, width, height, in the whole frame
# apart = false                      # true: separate images in reference/, one or more for each lamp position
# between_std = 0.001                # if apart: relative scatter of the lamp between images of reference and sample

[outline]
field_beyond_deg = 3.0               # angle by which the bright field of outline frames extends beyond the limb
# centre_px = [1250.5, 1049.0]       # without outline frames: column and row of the centre of the outline
# radius_px = [401.2, 0.5]           # radius of the outline
# mask = "mask.png"                  # or an image in this folder with two values: sphere and background
# mask_std_px = 0.5                  # standard deviation of the radius of the mask
"""


def write_template(folder: str | Path, rows: Iterable[Mapping[str, Any]] = (), *, force: bool = False) -> list[Path]:
    """Write a commented capture.toml, a frames.csv, and the folders of the frames.

    Args:
        folder: folder of the capture; it is created.
        rows: lines of frames.csv, each with its values by column. Default: no lines.
        force: True to replace an existing capture.toml and frames.csv. Default: False.

    Returns:
        Paths of the two files.

    Raises:
        OutputError: a file exists and `force` is False, or the folder cannot be written.
    """
    folder = Path(folder)
    check_output_folder(folder)
    texts = {SETTINGS: TEMPLATE, LIST: _table(rows)}
    with all_or_nothing():
        for kind in KINDS:
            make_folder(folder / kind)
        for name, text in texts.items():
            write_text(folder / name, text, force=force)
    return [folder / name for name in texts]


def write_description(
    folder: Path, settings: Mapping[str, Any], rows: Iterable[Mapping[str, Any]], *, force: bool = False
) -> None:
    """Write capture.toml and frames.csv.

    Args:
        folder: folder of the capture.
        settings: tables of capture.toml by name. JSON must be able to represent their values.
        rows: lines of frames.csv, each with its values by column; missing cells are empty.
        force: True to replace existing files. Default: False.
    """
    write_text(folder / SETTINGS, as_toml(settings), force=force)
    write_text(folder / LIST, _table(rows), force=force)


def _table(rows: Iterable[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def write_codes(path: Path, codes: np.ndarray, *, force: bool = False) -> None:
    """Write a frame of integers as an uncompressed 16-bit TIFF.

    Without compression, regions of the frame can be read separately.
    """
    import tifffile

    with replacing(path, force=force) as temporary:
        tifffile.imwrite(temporary, np.asarray(codes, np.uint16), photometric="minisblack")


def as_toml(settings: Mapping[str, Any]) -> str:
    """Format tables of plain values as TOML.

    The values are written as JSON, because the numbers, strings and lists of JSON are valid TOML.
    """
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items() if not isinstance(value, dict)]
    for name, table in settings.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"
