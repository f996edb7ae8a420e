"""Tone curves: conversion of the codes of an image to linear values, which an MTF requires (docs/model.md 7)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.remark import Remark
from matcam.files import tone_curve as srgb
from matcam.files.photographs import Photograph, read_photograph
from matcam.files.tone_curve import checked_curve, curve_through, read_numbers

Tone = str | float | ArrayLike
"""Tone curve of the codes of an image: "linear"; "srgb" (IEC 61966-2-1); a gamma, light = (code / full) ** gamma;
linear values by code, (codes,) or (codes, 3); "auto": selected by `assumed_tone`.
"""


def is_named(tone: Tone, *names: str) -> bool:
    return isinstance(tone, str) and tone in names


def assumed_tone(photograph: Photograph, *, mosaic: bool = False) -> tuple[str, tuple[Remark, ...]]:
    """Select the tone curve for "auto", and create a remark if the tone curve is assumed.

    `mosaic`: whether the image is a mosaic, which is linear, because tone curves are applied after demosaicing.
    """
    if photograph.linear or mosaic:
        return "linear", ()
    bits = 8 * photograph.values.dtype.itemsize
    tone, name = ("srgb", "sRGB") if bits == 8 else ("linear", "linear")
    text = f"no tone curve is specified: {name} is assumed for {bits} bits; give the tone curve (--tone)"
    return tone, (Remark("tone-assumed", text),)


def linear_values(codes: np.ndarray, tone: Tone, channel: int | None = None) -> np.ndarray:
    """Convert codes, (..., 3) or one plane, to linear values.

    Full scale is the largest value of an integer data type, or 1 for floats. `channel`: column of a three-column table that
    applies to this plane. An ArgumentError is raised if the tone curve does not match the image.
    """
    if is_named(tone, "linear"):
        return codes.astype(np.float64)
    if is_named(tone, "srgb"):
        return _by_code(codes, srgb.decoded)
    if isinstance(tone, str) or tone is None:
        raise ArgumentError(
            f"tone must be 'auto', 'linear', 'srgb', a gamma or a table of linear values by code, got {tone!r}"
        )
    if np.ndim(tone) == 0:
        gamma = float(np.asarray(tone, dtype=np.float64))
        # Values outside this range are assumed to be mistakes.
        if not 0.2 <= gamma <= 5:
            raise ArgumentError(f"tone as a gamma must lie in [0.2, 5], got {gamma:g}")
        return _by_code(codes, lambda share: np.maximum(share, 0) ** gamma)
    table = checked_curve(np.asarray(tone, dtype=np.float64))
    if codes.dtype.kind not in "ui":
        raise ArgumentError(f"tone as a table requires an image of whole numbers, got {codes.dtype}")
    if codes.size and codes.max() >= len(table):
        raise ArgumentError(
            f"tone has {len(table)} entries, but the largest code of the image is {codes.max()}: add entries"
        )
    if table.ndim == 1:
        return table[codes]
    if channel is not None:
        return table[codes, channel]
    if codes.ndim < 3 or codes.shape[-1] != 3:
        raise ArgumentError("tone has three columns, but the image has one channel: give a table with one column")
    return np.stack([table[codes[..., i], i] for i in range(3)], axis=-1)


def _by_code(codes: np.ndarray, curve: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    if codes.dtype.kind not in "ui":
        return curve(codes / 1.0)
    full = np.iinfo(codes.dtype).max
    if codes.dtype.kind == "u" and codes.size > full:
        return curve(np.arange(full + 1) / full)[codes]
    return curve(codes / full)


def tone_from_patches(
    image: ArrayLike, patches: Sequence[Sequence[int]], light: ArrayLike, channel: int | None = None
) -> np.ndarray:
    """Measure a tone curve from patches of known linear values (ISO 14524).

    The result contains linear values by code, (codes,). The curve passes through the mean codes of the patches without
    overshoot, and is extrapolated linearly above the brightest patch. An ArgumentError is raised if the curve is not
    monotone, or an argument is invalid.

    `image`: integers, (height, width) or (height, width, 3). `patches`: at least 3 regions (x, y, width, height), px.
    `light`: (n,) linear values of the patches, any unit. `channel`: channel of a colour image; None for the mean of all
    channels.
    """
    codes, values = np.asarray(image), np.asarray(light, dtype=np.float64)
    if codes.dtype.kind not in "ui" or codes.ndim not in (2, 3):
        raise ArgumentError(
            f"image must be whole numbers of shape (height, width[, 3]), got {codes.dtype} {codes.shape}"
        )
    if len(patches) < 3 or values.shape != (len(patches),):
        raise ArgumentError(
            f"a tone curve requires at least 3 patches and one linear value of light for each, got {len(patches)} patches and "
            f"light of shape {values.shape}"
        )
    if not np.isfinite(values).all() or (values < 0).any():
        raise ArgumentError(
            f"light of the patches must be finite and not negative, got {values.min():g} to {values.max():g}"
        )
    means = []
    for x, y, width, height in patches:
        if min(x, y) < 0 or min(width, height) < 2 or x + width > codes.shape[1] or y + height > codes.shape[0]:
            raise ArgumentError(
                f"patch {(x, y, width, height)} must have at least 2 x 2 px and lie inside the image of "
                f"{codes.shape[1]} x {codes.shape[0]} px"
            )
        part = codes[y : y + height, x : x + width]
        means.append(part[..., channel].mean() if part.ndim == 3 and channel is not None else part.mean())
    order = np.argsort(means)
    code, value = np.array(means)[order], values[order]
    if (np.diff(code) < 0.5).any():
        first = int(np.argmax(np.diff(code) < 0.5))
        raise ArgumentError(
            f"two patches have nearly the same code, {code[first]:.1f}: give patches of different codes"
        )
    full = np.iinfo(codes.dtype).max
    slope = (value[-1] - value[-2]) / (code[-1] - code[-2])
    if code[-1] < full:
        code, value = np.append(code, full), np.append(value, value[-1] + slope * (full - code[-1]))
    return curve_through(code, value)


def patch_tone_curve(picture: str | Path, patches: str | Path) -> np.ndarray:
    """Measure the tone curve of each channel of a file.

    `patches`: file with lines "x y width height light"; the region is in px, the light is linear, and "#" begins a
    comment. A FileFormatError is raised if a line is invalid, or no curve can be computed.
    """
    rows = read_numbers(patches, 5)
    image = read_photograph(picture)
    if not np.isfinite(rows).all() or (rows[:, :4] % 1 != 0).any():
        raise FileFormatError(
            f"{patches}: x, y, width and height of a patch must be whole numbers of px, and its light must be finite"
        )
    positions = rows[:, :4].astype(int).tolist()
    try:
        if image.ndim == 2:
            return tone_from_patches(image, positions, rows[:, 4])
        return np.stack([tone_from_patches(image, positions, rows[:, 4], channel) for channel in range(3)], axis=1)
    except ArgumentError as error:
        raise FileFormatError(f"{patches}: {error}") from None
