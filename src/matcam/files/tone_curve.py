"""Tone curves: mapping from the codes of an image to linear values.

The transfer function of sRGB (IEC 61966-2-1) converts linear values relative to white to codes relative to full scale.
The module contains this function and its inverse.

Curves as text (OECF tables, ISO 14524):

    one number per line         linear value of code 0, 1, 2, ...
    three numbers per line      linear values for red, green and blue
    two numbers per line        increasing code and its linear value; interpolated between codes without overshoot

Numbers are separated by blanks, commas or semicolons; "#" begins a comment.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers.texts import read_lines

_DEEPEST = 65535  # largest code of an image of 16 bits


def encoded(light: ArrayLike) -> np.ndarray:
    """Convert linear values to sRGB codes. White is 1 on both scales.

    Negative values continue the linear segment of the curve.
    """
    light = np.asarray(light, dtype=np.float64)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def decoded(code: ArrayLike) -> np.ndarray:
    """Convert sRGB codes to linear values, the inverse of `encoded`."""
    code = np.asarray(code, dtype=np.float64)
    return np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0) + 0.055) / 1.055) ** 2.4)


def read_tone_curve(path: str | Path) -> np.ndarray:
    """Read a tone curve: linear values by code, (codes,) or (codes, 3).

    A FileFormatError is raised if the file does not contain a tone curve, or the curve is not monotone.
    """
    values = read_numbers(path)
    try:
        with np.errstate(all="ignore"):  # non-finite or nearly infinite values are rejected
            if values.ndim == 2 and values.shape[1] == 2:
                return curve_through(values[:, 0], values[:, 1])
            return checked_curve(values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values)
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None


def read_numbers(path: str | Path, columns: int | None = None) -> np.ndarray:
    """Read the numbers of a text file, (lines, columns).

    Comments and empty lines are skipped. `columns` is the count of numbers in every line. Default: None, one to three
    numbers, the same count in all lines. A FileFormatError is raised for any other line. Its message contains the file
    and the line.
    """
    path = Path(path)
    lines = read_lines(path, "a tone curve")
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise FileFormatError(f"{path}: line {number}: {line.strip()[:40]!r} must consist of numbers") from None
        if len(words) != (columns or len(rows[0])) or (columns is None and len(words) > 3):
            wanted = columns or "the same count (one, two or three)"
            raise FileFormatError(f"{path}: line {number} has {len(words)} numbers, but every line must have {wanted}")
    return np.array(rows) if rows else np.zeros((0, columns or 1))


def checked_curve(values: np.ndarray) -> np.ndarray:
    """Check a table of linear values by code.

    An ArgumentError is raised if the table is too short, or if its values are not finite, decrease or are all equal.
    """
    if values.ndim not in (1, 2) or len(values) < 2 or (values.ndim == 2 and values.shape[1] != 3):
        raise ArgumentError(
            f"the tone curve must have at least 2 codes with one or three linear values each, got shape {values.shape}"
        )
    if not np.isfinite(values).all():
        raise ArgumentError("the tone curve must contain finite values only")
    falls = (np.diff(values, axis=0) < 0).reshape(len(values) - 1, -1).any(1)
    if falls.any():
        code = int(np.argmax(falls))
        raise ArgumentError(f"the tone curve must not decrease, but it decreases from code {code} to {code + 1}")
    if (values[-1] <= values[0]).any():
        raise ArgumentError("the tone curve must increase, but all codes of a channel have the same linear value")
    return values


def curve_through(codes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate a tone curve, (codes,), through points of code and linear value.

    The curve is extrapolated linearly to code 0. An ArgumentError is raised if there are fewer than two points, if the
    codes do not increase strictly within 0 to 65535, or if the values are not finite or decrease.
    """
    from scipy.interpolate import PchipInterpolator

    if codes.size < 2:
        raise ArgumentError(f"the tone curve must have at least 2 points of code and linear value, got {codes.size}")
    if not (np.diff(codes) > 0).all() or codes[0] < 0 or codes[-1] > _DEEPEST:
        raise ArgumentError(f"the codes of the tone curve must increase strictly and lie in [0, {_DEEPEST}]")
    if not np.isfinite(values).all():
        raise ArgumentError("the tone curve must contain finite values only")
    if (np.diff(values) < 0).any():
        bad = int(np.argmax(np.diff(values) < 0))
        raise ArgumentError(
            f"the tone curve must not decrease, but it decreases from code {codes[bad]:g} to {codes[bad + 1]:g}"
        )
    at = np.arange(int(np.ceil(codes[-1])) + 1)
    try:
        inside = PchipInterpolator(codes, values)(np.clip(at, codes[0], codes[-1]))
    except ValueError:
        raise ArgumentError(
            "the tone curve is too steep for interpolation: give points that are further apart"
        ) from None
    slope = (values[1] - values[0]) / (codes[1] - codes[0])
    return checked_curve(inside + np.minimum(at - codes[0], 0) * slope)
