"""What a camera's software does to a picture of an edge: denoising, sharpening, tone curves, JPEG, demosaicing, coarse codes.

The edges are those of `real_edges`; everything here happens after the light. Imports nothing of the package.
"""

from __future__ import annotations

import imagecodecs
import numpy as np
from scipy.ndimage import convolve, gaussian_filter, median_filter

FULL = 255.0


def bilateral(counts, spatial=1.5, levels=0.1, reach=4):
    """Bilateral filter; `levels`: of the picture's maximum."""
    scale = levels * counts.max()
    padded = np.pad(counts, reach, mode="reflect")
    height, width = counts.shape
    total, weights = np.zeros_like(counts), np.zeros_like(counts)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            other = padded[reach + dy : reach + dy + height, reach + dx : reach + dx + width]
            weight = np.exp(-(dx * dx + dy * dy) / (2 * spatial**2) - ((other - counts) / scale) ** 2 / 2)
            total += weight * other
            weights += weight
    return total / weights


def unsharp(counts, amount, radius=1.0):
    return counts + amount * (counts - gaussian_filter(counts, radius, mode="nearest"))


def median(counts, size=3):
    return median_filter(counts, size, mode="nearest")


def encoded(counts, white):
    """sRGB codes, not rounded (IEC 61966-2-1)."""
    light = np.clip(counts / white, 0, 1)
    return FULL * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def decoded(codes):
    share = np.asarray(codes, float) / FULL
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def jpeg(codes, quality):
    """Codes of a grey picture after JPEG."""
    whole = np.clip(np.rint(codes), 0, FULL).astype(np.uint8)
    return imagecodecs.jpeg8_decode(imagecodecs.jpeg8_encode(whole, level=quality))


def phone(counts, white, quality=90, amount=0.5):
    """Denoised, sharpened, in sRGB, as JPEG, and with the sRGB undone."""
    return decoded(jpeg(encoded(unsharp(bilateral(counts), amount), white), quality))


def demosaiced(counts):
    """A mosaic of a grey scene whose missing greens are the means of their neighbours."""
    there = np.indices(counts.shape).sum(0) % 2 == 0
    around = convolve(np.where(there, counts, 0.0), np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4.0, mode="mirror")
    return np.where(there, counts, around)


def coarse(counts, step):
    return np.floor(counts / step) * step
