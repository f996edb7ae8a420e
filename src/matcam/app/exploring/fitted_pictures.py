"""Images of a reconstruction, from its file and from an opened capture.

The file of the result contains outline, highlights and windows. A window is the fitted part of an image. The photographs
are read from the folder of the capture, only if the user opened that folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from matcam.app.calibrated import drawn_values
from matcam.core.errors import ArgumentError, FileFormatError, MatcamError
from matcam.core.readers.names import is_file
from matcam.files.capture import LIST, SETTINGS, Capture, read_capture

WINDOWS = ("window_recorded", "window_fitted", "window_residual")
_PLACES = (
    "window_left", "window_top", "outline_column", "outline_row", "outline_radius", "highlight_column", "highlight_row",
    "picture_theta_d",
)  # fmt: skip


@dataclass(frozen=True)
class FittedPicture:
    """Image of a reconstruction.

    Attributes:
        name: name of the lamp position.
        theta_d: difference angle at the highlight, rad.
        outline: column, row and radius of the fitted outline, px.
        highlight: column and row of the brightest fitted pixel, px.
        corner: first column and row of the window, px.
        windows: values in the window by the names in `WINDOWS`, (rows, columns) each: recorded and fitted values, in the
            unit of the merged images, and the residual, in standard deviations. NaN: the pixel was not used.
    """

    name: str
    theta_d: float
    outline: tuple[float, float, float]
    highlight: tuple[float, float]
    corner: tuple[float, float]
    windows: dict[str, np.ndarray]


def fitted_pictures(name: str, data: xr.Dataset) -> list[FittedPicture]:
    """Read the images in the file of a reconstruction. The list is empty if the file is not from a reconstruction.

    Args:
        name: name of the file, for messages.
        data: content of the file.

    Raises:
        FileFormatError: the images of the file are inconsistent.
    """
    if WINDOWS[0] not in data:
        return []
    try:
        names = [str(one) for one in data["picture_name"].values.tolist()]
        places = np.stack([np.asarray(data[key].values, dtype=float) for key in _PLACES], axis=-1)
        windows = {key: np.asarray(data[key].values, dtype=np.float32) for key in WINDOWS}
        count, rows, columns = windows[WINDOWS[0]].shape
        # at most 10,000 images are read
        if not (
            1 <= count <= 10_000 and rows > 1 and columns > 1 and len(names) == count
            and places.shape == (count, len(_PLACES)) and np.isfinite(places).all()
            and all(one.shape == (count, rows, columns) for one in windows.values())
        ):  # fmt: skip
            raise ValueError("each image must have one outline, one highlight and one window")
    except (KeyError, ValueError, TypeError) as error:
        raise FileFormatError(
            f"{name}: the images in the file are damaged: {error}; reconstruct the capture again"
        ) from None
    return [
        FittedPicture(
            name, theta_d, (column, row, radius), (x, y), (left, top), {key: one[k] for key, one in windows.items()}
        )
        for k, (name, (left, top, column, row, radius, x, y, theta_d)) in enumerate(
            zip(names, places.tolist(), strict=True)
        )
    ]


def is_capture(path: Path) -> bool:
    return is_file(path / SETTINGS) and is_file(path / LIST)


def opened_captures(paths: Sequence[Path]) -> tuple[list[Capture], list[str]]:
    """Read the captures among the opened folders, without decoding images.

    Returns:
        The captures, and messages about captures that cannot be read.
    """
    found, failures = [], []
    for path in paths:
        if is_capture(path):
            try:
                found.append(read_capture(path))
            except MatcamError as error:
                failures.append(str(error))
    return found, failures


@dataclass(frozen=True)
class Shot:
    """Photograph of a lamp position.

    Attributes:
        label: name of the file in the capture.
        capture: capture that contains the photograph.
        frame: frame of the capture.
    """

    label: str
    capture: Capture
    frame: Any

    def about(self, outline: tuple[float, float, float]) -> tuple[np.ndarray, tuple[float, float, float, float]]:
        """Read the part of the photograph around an outline.

        `outline` contains column, row and radius, px.

        Returns:
            The image, subsampled by `drawn_values`; and its left border, top border, width and height in the photograph, px.

        Raises:
            FileFormatError: the photograph is missing, damaged, or too small for the outline.
        """
        values = self.capture.read(self.frame).values
        height, width = values.shape[:2]
        column, row, radius = outline
        # the displayed area extends 12 % beyond the outline
        reach = 1.12 * radius
        left, right = (int(np.clip(edge, 0, width)) // 2 * 2 for edge in (column - reach, column + reach + 2))
        top, bottom = (int(np.clip(edge, 0, height)) // 2 * 2 for edge in (row - reach, row + reach + 2))
        if right - left < 2 or bottom - top < 2:
            raise FileFormatError(
                f"{self.label}: an image of {width} x {height} px does not contain the fitted outline: open the capture of "
                "this result"
            )
        shown, step = drawn_values(values[top:bottom, left:right], linear=True)
        high, wide = shown.shape
        return shown, (left - 0.5, top - 0.5, wide * step, high * step)


def shots_of(picture: FittedPicture, captures: Sequence[Capture]) -> list[Shot]:
    """Find the photographs with the lamp position of an image in the opened captures.

    The photographs are sorted by exposure time, the longest first.

    Raises:
        ArgumentError: no capture is open.
        FileFormatError: no opened capture contains this lamp position.
    """
    if not captures:
        raise ArgumentError(
            "the photographs are not open: also give the folder of the capture (`matcam app CAPTURE RESULT.nc`)"
        )
    found = [Shot(frame.file, one, frame) for one in captures for frame in one.of("frames", lamp=picture.name)]
    found.sort(key=lambda shot: -np.nan_to_num(shot.frame.time))
    if not found:
        folders = ", ".join(one.folder.name for one in captures)
        raise FileFormatError(
            f"{folders}: there is no photograph of lamp position {picture.name} in the opened captures: open the unchanged "
            "capture of this result"
        )
    return found
