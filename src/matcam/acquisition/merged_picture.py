"""Radiance of the sample under one lamp position, merged from its exposures: the input of a reconstruction."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MergedPicture:
    """Linear radiance under one lamp position on the sensor's own pixels, with noise and clipping.

    Attributes:
        name: name of the lamp position in `frames.csv`.
        values: linear radiance of each pixel, of shape (height, width), in one unit for all images of a capture:
            electrons, or digital numbers, of the reference exposure. The dark level is subtracted. NaN: no value.
        std: standard deviation of `values` due to photon and read noise, same shape and unit.
        clipped: mask of the pixels that were clipped in every exposure, same shape; their true value is at least `values`.
        channel: index into `channels` of each pixel, same shape; mosaics are not interpolated.
        channels: names of the colours, ("R", "G", "B") or ("grey",).
        origin: row and column of the first pixel in the whole frame, px. Default: (0, 0).
    """

    name: str
    values: np.ndarray
    std: np.ndarray
    clipped: np.ndarray
    channel: np.ndarray
    channels: tuple[str, ...]
    origin: tuple[int, int] = (0, 0)
