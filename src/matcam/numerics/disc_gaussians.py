"""Small uniform disc as a sum of few Gaussians, some of them negative.

After a Gaussian blur, low moments determine the image of a small disc. The sum has the light, the variance and the
fourth moment of the disc. The other parameters minimise the error of the blurred disc: 2e-4 of its value, down to 1e-5
of the central value.
"""

from __future__ import annotations

import numpy as np

LARGEST = 1.5
"""Ratio of the radius of the disc to the standard deviation of the blur up to which the sum has this accuracy."""

DISC_GAUSSIANS = np.array(
    [
        (0.799038483858, 0.018870786688),
        (-29.508005552456, 0.106675044471),
        (39.978695291974, 0.123362285148),
        (-12.406697486619, 0.1572655626945),
        (2.136969263243, 0.1881039562135),
    ]
)
"""Share of the light and variance over the disc's radius squared, of each Gaussian (Gaussians, 2).

They minimise the largest error, relative to the blurred disc and 1e-5 of its middle, for radii of 0.75, 1.1 and 1.5
standard deviations.
"""
