"""Radiance of the sample under one lamp position, merged from its exposures: the input of a reconstruction."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MergedPicture:
    """Linear radiance under one lamp position on the sensor's own pixels, with noise and clipping.

    Attributes:
        name: name of the lamp position in `frames.csv`.
        values: linear radiance of each pixel without the dark level, (height, width); NaN: no value. The unit is the same
            for all images of a capture: electrons or digital numbers (DN) of the reference exposure.
        std: standard deviation of `values` due to photon and read noise, same shape and unit.
        clipped: mask of the pixels that were clipped in every exposure, (height, width). `values` is a lower bound there.
        channel: index of each pixel's colour in `channels`, (height, width); mosaics are not interpolated.
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
