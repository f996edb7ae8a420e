"""Diffuse albedo and specular strength of a flat sample, estimated separately at each frequency of the texture.

At each frequency, the spectrum of image k is linear in both maps: transfer_k (white_k diffuse + lobe_k specular) + noise.
With the power of each map as prior variance, the posterior mean is the Wiener estimate. At frequencies that the camera does
not transmit, the posterior variance is that of the prior.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from matcam.reconstruction.flat.flat_stack import FlatStack

RESOLVED = 0.5
"""Smallest share of the prior variance that the images remove at a resolved frequency."""
_BINS = np.geomspace(0.02, 0.35, 13)
_STEEPEST, _FLATTEST = -5.0, 0.0
_NOTHING = 1e-12


class PowerLaw(NamedTuple):
    """Power of a texture: level * (frequency / 0.1)^slope, with the frequency in cycles/px.

    Attributes:
        level: power at 0.1 cycles/px, in the squared unit of the map.
        slope: exponent of the frequency, no unit.
    """

    level: float
    slope: float

    def at(self, radius: np.ndarray) -> np.ndarray:
        """Evaluate the power at frequencies, cycles/px. Frequencies below 0.005 cycles/px have the power at 0.005."""
        return self.level * (np.maximum(radius, 0.005) / 0.1) ** self.slope


class TexturePosterior(NamedTuple):
    """Posterior of the Fourier transforms of both maps.

    The first axis of the arrays is that of the maps, diffuse and specular.

    Attributes:
        estimate: posterior mean, (2, rows, columns).
        variance: posterior variance, same shape.
        by_lens: additional variance due to the uncertainty of the lens, same shape.
        prior: prior variance, same shape.
        laws: prior power law of each map.
    """

    estimate: np.ndarray
    variance: np.ndarray
    by_lens: np.ndarray
    prior: np.ndarray
    laws: tuple[PowerLaw, PowerLaw]

    @property
    def resolved(self) -> np.ndarray:
        """Share of the prior variance that the images remove, (2, rows, columns); 1: known, 0: lost."""
        return 1 - self.variance / np.maximum(self.prior, 1e-300)

    def cutoff(self, frequency: tuple[np.ndarray, np.ndarray], which: int) -> tuple[float, float]:
        """Find the frequencies along the rows and across them up to which a map is resolved, cycles/px.

        A frequency is 0.5 if the map is resolved up to the Nyquist limit.

        Args:
            frequency: frequencies of the grid along the rows and across them, cycles/px.
            which: index of the map; 0: diffuse, 1: specular.
        """
        resolved = self.resolved[which]
        along = _first_lost(np.abs(frequency[0][0]), resolved[0])
        return along, _first_lost(np.abs(frequency[1][:, 0]), resolved[:, 0])


def texture_posterior(stack: FlatStack, weights: np.ndarray, lens_std: float = 0.0) -> TexturePosterior:
    """Compute the posterior of both maps, with prior powers that are fitted to the frequencies above the noise.

    Args:
        stack: images on the texels.
        weights: radiance of the diffuse and of the specular part in each image if both maps are 1, (pictures, 2).
        lens_std: relative standard deviation of the lens width. Default: 0, exact.
    """
    scale = np.abs(weights).max(axis=0)
    loadings = weights / scale
    information, projected = _normal(stack, loadings, stack.noise)
    free = _inverse(information, np.zeros(2))
    estimate = np.einsum("ijyx,jyx->iyx", free, projected)
    radius = stack.radius
    laws = tuple(_power_law(estimate[i], free[i, i].real, radius) for i in range(2))
    prior = np.stack([law.at(radius) for law in laws])
    prior[:, 0, 0] = prior[:, 0, 1]
    # frequencies beyond the band of the sensor alias; they are unknown and are treated as noise
    noise = stack.noise + _folded(stack, loadings, laws)
    information, projected = _normal(stack, loadings, noise)
    covariance = _inverse(information, 1 / np.maximum(prior, _NOTHING * prior.max()))
    estimate = np.einsum("ijyx,jyx->iyx", covariance, projected)
    variance = np.stack([covariance[i, i].real for i in range(2)])
    # change of the estimate if the lens were wider
    doubt = np.einsum("kyx,ki,kj->ijyx", stack.transfer**2 * stack.lens_slope / noise, loadings, loadings)
    moved = lens_std * np.einsum("ijyx,jlyx,lyx->iyx", covariance, doubt, estimate)
    back = scale[:, None, None]
    laws = tuple(PowerLaw(law.level / s**2, law.slope) for law, s in zip(laws, scale, strict=True))
    by_lens = np.abs(moved) ** 2 / back**2
    return TexturePosterior(estimate / back, variance / back**2, by_lens, prior / back**2, laws)  # type: ignore[arg-type]


def _normal(stack: FlatStack, loadings: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    share = stack.transfer / noise
    information = np.einsum("kyx,ki,kj->ijyx", stack.transfer * share, loadings, loadings)
    return information, np.einsum("kyx,ki,kyx->iyx", share, loadings, stack.spectrum)


def _inverse(information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Invert the sums of 2 x 2 information matrices and a diagonal prior.

    The inverse of a sum that is 0 is large, but finite.
    """
    a, b = information[0, 0] + prior[0], information[1, 1] + prior[1]
    c = information[0, 1]
    floor = 1e-12 * max(float(a.max()), float(b.max()), 1e-300)
    a, b = a + floor, b + floor
    determinant = np.maximum(a * b - c**2, floor * np.maximum(a, b))
    return np.stack([np.stack([b, -c]), np.stack([-c, a])]) / determinant


def _power_law(estimate: np.ndarray, variance: np.ndarray, radius: np.ndarray) -> PowerLaw:
    rings = []
    for low, high in pairwise(_BINS):
        ring = (radius >= low) & (radius < high)
        if not ring.any():
            continue
        weight = 1 / variance[ring] ** 2
        power = float((weight * (np.abs(estimate[ring]) ** 2 - variance[ring])).sum() / weight.sum())
        noise = float(1 / np.sqrt(weight.sum()) * np.sqrt(2))
        rings.append((np.sqrt(low * high), power, noise, int(ring.sum())))
    # standard deviations by which the power of a bin must exceed its noise
    clear = [(f, p, n) for f, p, noise, n in rings if p > 3.0 * noise]
    if len(clear) < 2:
        level = max(max((p for _, p, *_ in rings), default=0.0), _NOTHING)
        return PowerLaw(level, 0.0)
    f, p, n = map(np.array, zip(*clear, strict=True))
    slope, level = np.polyfit(np.log(f / 0.1), np.log(p), 1, w=np.sqrt(n))
    slope = float(np.clip(slope, _STEEPEST, _FLATTEST))
    level = float(np.average(np.log(p) - slope * np.log(f / 0.1), weights=n))
    return PowerLaw(float(np.exp(level)), slope)


def _folded(stack: FlatStack, loadings: np.ndarray, laws: tuple[PowerLaw, ...]) -> np.ndarray:
    """Compute the aliased power at each frequency of each image, (pictures, rows, columns).

    This power is that of the texture at frequencies beyond the Nyquist limit of the sensor.
    """
    along, across = stack.frequency
    folded = np.zeros(stack.noise.shape)
    for k, tilt in enumerate(stack.tilts):
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                if i == j == 0:
                    continue
                a, b = along + i * np.cos(tilt), across + j
                radius = np.hypot(a, b)
                power = sum(way**2 * law.at(radius) for way, law in zip(loadings[k], laws, strict=True))
                folded[k] += stack.sensor_transfer(k, a, b) ** 2 * power
    return folded


def _first_lost(frequency: np.ndarray, resolved: np.ndarray) -> float:
    order = np.argsort(frequency)
    order = order[frequency[order] > 0]
    lost = np.flatnonzero(resolved[order] < RESOLVED)
    return float(frequency[order[lost[0]]]) if lost.size else 0.5
