"""Gaussian process model of uneven light over the flat sides of an edge, and its comparison with glare.

The model describes light that is not a polynomial of low order. Each side of the edge is averaged over bins of several
px. The bins deviate from two levels times a polynomial of third order. The deviation is light that multiplies the scene
(banding, a penumbra, a near lamp), light that is added to the scene (a glint), glare of the lens, or a distant ghost. Glare
and ghost depend only on the distance from the edge. All are terms of one Gaussian model. The marginal likelihood of the
model determines their scales, and the probabilities of glare and of a ghost (Rasmussen & Williams, Gaussian Processes for
Machine Learning, 2006, ch. 5).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from matcam.core.arrays import FloatArray, first_axis_map
from matcam.numerics.polynomials import plane_powers

EXCLUDED_WIDTHS = 3.5
"""Distance from the edge within which pixels are excluded, in standard deviations of the blur; 1.5 px are added."""
_AMPLITUDES = np.append(0.0, 1e-3 * 2.0 ** np.arange(9))
"""Relative standard deviations of the light that are tested: 0 (even light), and 0.1 to 25 %."""
GLARE_STD = 0.1
"""Prior standard deviation of the share of light in glare, or in a ghost."""
_RADII = 4.0 * 1.5 ** np.arange(9)
"""Standard deviations of the glare that are tested, px."""
_GHOST_WIDTH = 2.0
"""Standard deviation of the rise of a ghost in bins, px: blur and half the side of a bin."""
_NOISES = np.array([1.0, 1.5, 2.5, 4.0])
"""Variances of the bins that are tested, relative to independent noise. They exceed 1 if a filter has correlated the noise."""
_DARKEST = 0.1
"""Smallest factor of the light."""
_FEWEST_BINS = 24
"""Smallest number of bins for the estimate of a light field."""


class GhostShare(NamedTuple):
    """Distant ghost that may have been fitted as light, averaged over all models by their probabilities.

    Attributes:
        share: mean share of the ghost, no unit.
        std: standard deviation of the share, no unit.
        position: mean distance of the ghost from the edge, weighted by the share, px.
        position_std: standard deviation of the distance, px.
    """

    share: float = 0.0
    std: float = 0.0
    position: float = 0.0
    position_std: float = 0.0

    @classmethod
    def of(cls, share: float, square: float, at: float, at_square: float) -> GhostShare:
        """Build the ghost from means over all models.

        Args:
            share: mean share, relative to the step near the edge, which lacks the share of the ghost, no unit.
            square: mean square of this share, no unit.
            at: mean of the share times the position, px.
            at_square: mean of the share times the squared position, px^2.
        """
        position, squared = (one / max(share, 1e-300) for one in (at, at_square))
        # The variance of a position within a step of 1 px is 1/12.
        position_std = float(np.sqrt(max(squared - position**2, 0.0) + 1 / 12))
        std = float(np.sqrt(max(square - share**2, 0.0)))
        return cls(share / (1 + share), std / (1 + share), position, position_std)

    @property
    def rms(self) -> float:
        return float(np.hypot(self.share, self.std))


class LightField(NamedTuple):
    """Residual uneven light of a region, beyond two levels times a polynomial of third order.

    Attributes:
        factor: factor of each pixel (rows, columns).
        addend: addend of each pixel (rows, columns), in the units of the image.
        amplitude: standard deviation of the light over the region, relative to the scene, or to the step if the light is
            added.
        possible: rms of `amplitude` over all models of the light, weighted by their probabilities.
        ghost: ghost that may have been fitted as light.
        unknown: standard deviation of the interpolated light step across the edge, in units of the step of the image.
    """

    factor: FloatArray
    addend: FloatArray
    amplitude: float
    possible: float
    ghost: GhostShare = GhostShare()
    unknown: float = 0.0


class _Bins(NamedTuple):
    """Means of n bins of pixels.

    Attributes:
        x: (n,) mean x, px.
        y: (n,) mean y, px.
        distance: (n,) mean distance from the edge, px; positive on the bright side.
        value: (n,) mean value.
        level: (n,) level of the side of the edge on which the bin lies.
        std: (n,) standard deviation of `value`.
    """

    x: FloatArray
    y: FloatArray
    distance: FloatArray
    value: FloatArray
    level: FloatArray
    std: FloatArray


class _Family(NamedTuple):
    """Models of the light with one correlation length and all amplitudes.

    The data are p independent residuals of n bins after the fit of levels and polynomials.

    Attributes:
        length: correlation length, px.
        adds: whether the light is added to the scene; otherwise it multiplies the scene.
        seen: (n, p) derivatives of the data with respect to the light in each bin.
        power: (p,) eigenvalues of the covariance of the data for light of amplitude 1.
        vectors: (p, p) eigenvectors of this covariance.
        data: (p,) data in the basis of the eigenvectors.
        glares: (radii, p) contributions of glare with a share of 1 to the data, for each radius, in the same basis.
        ghosts: (positions, p) contributions of a ghost with a share of 1 to the data, for each position.
    """

    length: float
    adds: bool
    seen: FloatArray
    power: FloatArray
    vectors: FloatArray
    data: FloatArray
    glares: FloatArray
    ghosts: FloatArray

    def precision(self, amplitude: FloatArray | float, noise: FloatArray | float) -> FloatArray:
        return 1 / (noise + amplitude**2 * self.power)

    def by_share(self, precision: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fit the share of glare or of a ghost, for each of `columns`.

        Returns:
            Share, variance of the share, and logarithm of the factor by which it increases the evidence, each (..., columns).
        """
        score = np.maximum((precision * self.data) @ columns.T, 0.0)
        information = precision @ (columns**2).T + GLARE_STD**-2
        return score / information, 1 / information, (score**2 / information - np.log(information * GLARE_STD**2)) / 2

    def log_evidence(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the evidence of models without glare, with glare, and with a ghost.

        Args:
            positions: positions of a ghost, px.

        Returns:
            Logarithm of the evidence times the prior, (3, amplitudes, noises); and means of share, squared share, and share
            times position and squared position of a ghost in its models, (4, amplitudes, noises).
        """
        precision = self.precision(_AMPLITUDES[:, None, None], _NOISES[:, None])
        without = (np.log(precision) - self.data**2 * precision).sum(-1) / 2
        _, _, by_glare = self.by_share(precision, self.glares)
        share, variance, by_ghost = self.by_share(precision, self.ghosts)
        # the sum over no columns is 0, and its logarithm minus infinity
        glare_gain, ghost_gain = (np.logaddexp.reduce(each, axis=-1) for each in (by_glare, by_ghost))
        counts = np.log([1, len(self.glares), max(len(self.ghosts), 1)])[:, None, None]
        gains = np.stack([np.zeros_like(without), glare_gain, ghost_gain]) - counts
        probability = np.exp(by_ghost - ghost_gain[..., None])
        moments = share, share**2 + variance, share * positions, share * positions**2
        means = [(probability * one).sum(-1) for one in moments]
        # Prior probabilities of glare and of a distant ghost.
        glare, ghost = 0.1, 0.1
        prior = np.log([(1 - glare) * (1 - ghost), glare * (1 - ghost), ghost])[:, None, None]
        # Even light has half of the prior probability.
        uneven = np.log(np.where(_AMPLITUDES > 0, _AMPLITUDES.size - 1, 1))[:, None]
        return prior - uneven + without + gains, np.stack(means)

    def weights(self, amplitude: float, noise: float, glaring: bool) -> FloatArray:
        """Compute the weights of the data (p,) in the posterior mean of the light."""
        precision = self.precision(amplitude, noise)
        shares, _, gains = self.by_share(precision, self.glares)
        k = int(np.argmax(gains))
        share = shares[k] if glaring else 0.0
        return self.vectors @ (precision * (self.data - share * self.glares[k]))


def light_field(
    value: FloatArray,
    x: FloatArray,
    y: FloatArray,
    distance: FloatArray,
    noise: tuple[float, float],
    *,
    blur: float,
    glare: bool,
) -> LightField | None:
    """Estimate the residual uneven light of a region.

    Args:
        value: region (rows, columns), linear, any unit; NaN for missing pixels.
        x: x coordinates of the pixels (rows, columns), px.
        y: y coordinates of the pixels (rows, columns), px.
        distance: distances from the edge (rows, columns), px; positive on the bright side.
        noise: gain and standard deviation of the read noise; the variance of a pixel is gain * value + read^2.
        blur: standard deviation of the line spread function, px.
        glare: whether the fit of the edge has found glare, which must then be compared with uneven light.

    Returns:
        The most probable light; its amplitude is 0 if it is even. None if a polynomial explains the light, or if the region
        has too few usable bins.
    """
    margin = EXCLUDED_WIDTHS * blur + 1.5
    bins = _bins(value, x, y, distance, noise, margin)
    if bins is None:
        return None
    bright = bins.distance > 0
    step = float(bins.level[bright][0] - bins.level[~bright][0])
    scales = [float(np.abs(a).max()) + 1.0 for a in (bins.x, bins.y)]
    smooth = bins.level * _polynomials(bins.x / scales[0], bins.y / scales[1])
    design = np.concatenate([[~bright, bright], smooth]).T / bins.std[:, None]
    scaled, degrees = bins.value / bins.std, len(design) - design.shape[1]
    fitted = np.linalg.qr(design)[0].T @ scaled
    # Even light exceeds the expected chi-square by 3 standard deviations only rarely.
    if not glare and scaled @ scaled - fitted @ fitted < degrees + 3.0 * np.sqrt(2 * degrees):
        return None
    basis = np.linalg.qr(design, mode="complete")[0][:, design.shape[1] :]
    data = basis.T @ scaled
    ghosts = _ghost_positions(bins, margin)
    rises = [*(bins.distance / radius for radius in _RADII), *((bins.distance - at) / _GHOST_WIDTH for at in ghosts)]
    columns = np.stack([(ndtr(rise) - bright) * step / bins.std for rise in rises]) @ basis
    families = _families(bins, basis, data, columns, step)
    found = [family.log_evidence(ghosts) for family in families]
    evidence, means = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))
    probability = np.exp(evidence - evidence.max())
    probability /= probability.sum()
    ghost = GhostShare.of(*(float((probability[2] * one).sum()) for one in means))
    glaring = bool(probability[1].sum() > probability[0].sum())
    # The light is that of the more probable hypothesis, with or without glare. It may include a ghost.
    kind, level, scatter = np.unravel_index(np.argmax(evidence[int(glaring)]), evidence.shape[1:])
    best, power, unexplained = families[kind], float(_AMPLITUDES[level]), float(_NOISES[scatter])
    possible = float(np.sqrt(probability[:2].sum((0, 1, 3)) @ _AMPLITUDES**2 / max(probability[:2].sum(), 1e-300)))
    factor, addend = np.ones_like(value), np.zeros_like(value)
    if not power:
        return LightField(factor, addend, 0.0, possible, ghost)
    weights = best.weights(power, unexplained, glaring)
    light = power**2 * (best.seen @ weights)
    # A correlation with all bins requires a few kB for each pixel, so that few pixels are evaluated at a time.
    at_pixels = lambda x, y: _correlation(x, y, bins, best.length) @ light  # noqa: E731
    field = first_axis_map(at_pixels, (x.ravel(), y.ravel()), 1 << 14).reshape(value.shape)
    # The polynomials are fitted to the bins after subtracting the light.
    by_light = _correlation(bins.x, bins.y, bins, best.length) @ light * (step if best.adds else bins.level)
    left = (bins.value - by_light) / bins.std - unexplained * (basis @ weights)
    strengths = np.linalg.lstsq(design, left, rcond=None)[0][2:]
    strengths[:2] = 0.0  # the linear terms belong to the fit of the edge
    polynomial = np.tensordot(strengths, _polynomials(x / scales[0], y / scales[1]), 1)
    amplitude = float(np.std(field[np.isfinite(value)]))
    unknown = _unknown(bins, best, power, unexplained, (x, y, distance), blur)
    factor = np.maximum(factor + polynomial, _DARKEST)
    if best.adds:
        return LightField(factor, field * step, amplitude, possible, ghost, unknown)
    unknown *= float(bins.level.max()) / step
    return LightField(np.maximum(factor + field, _DARKEST), addend, amplitude, possible, ghost, unknown)


def _ghost_positions(bins: _Bins, margin: float) -> FloatArray:
    """List the positions of a ghost that are tested, px from the edge, at a step of 1 px.

    Closer ghosts are part of the fit of the edge, and farther ones are indistinguishable from another level. `margin`: distance
    from the edge within which pixels are excluded, px.
    """
    near, far = margin + _GHOST_WIDTH, np.minimum([-bins.distance.min(), bins.distance.max()], 40.0) - _GHOST_WIDTH
    return np.concatenate([-np.arange(near, far[0]), np.arange(near, far[1])])


def _polynomials(x: FloatArray, y: FloatArray) -> FloatArray:
    """Compute x, y and their products to third order (9, ...)."""
    return np.moveaxis(plane_powers(x, y, 3)[..., 1:], -1, 0)


def _unknown(
    bins: _Bins, best: _Family, amplitude: float, noise: float, positions: tuple[FloatArray, ...], blur: float
) -> float:
    """Compute the relative standard deviation of the light step across the edge, averaged along the edge.

    `amplitude`: relative standard deviation of the light. `noise`: variance of the bins relative to independent noise.
    `positions`: x, y and distance of all pixels, px.
    """
    x, y, distance = positions
    # In selected rows, use the pixels that are one blur width from the edge on both sides.
    rows = np.linspace(0, len(x) - 1, min(len(x), 40)).astype(int)
    at = [np.abs(distance[rows] - side * blur).argmin(1) for side in (1, -1)]
    px, py = (np.concatenate([a[rows, columns] for columns in at]) for a in (x, y))
    mean = np.repeat([1.0, -1.0], rows.size) / rows.size
    own = _correlation(px, py, bins._replace(x=px, y=py), best.length)
    cross = mean @ _correlation(px, py, bins, best.length) @ best.seen @ best.vectors
    power = amplitude**2
    variance = power * mean @ own @ mean - power**2 * cross**2 @ best.precision(amplitude, noise)
    return float(np.sqrt(max(float(variance), 0.0)))


def _bins(
    value: FloatArray,
    x: FloatArray,
    y: FloatArray,
    distance: FloatArray,
    noise: tuple[float, float],
    margin: float,
) -> _Bins | None:
    flat = np.isfinite(value) & (np.abs(distance) > margin)
    # The number of bins limits the time of the eigenvalue decompositions. Their sides are at least 4 px.
    side = max(4.0, float(np.sqrt(flat.sum() / 220)))
    rows, columns = (np.floor((a - a.min()) / side).astype(int) for a in (y, x))
    at = np.flatnonzero(flat)
    name = np.take((2 * rows + (distance > 0)) * (columns.max() + 1) + columns, at)
    some = np.take(value, at)
    if not some.size:
        return None
    count = np.bincount(name)
    mean = np.bincount(name, some) / np.maximum(count, 1)
    std = np.sqrt(np.maximum(noise[0] * np.maximum(mean, 0) + noise[1] ** 2, 1e-300))
    # The first estimate of each bin is its median, which is robust to dust and hot pixels.
    middle = ndimage.median(some, name, np.arange(count.size))
    # A pixel with a larger deviation than 3.5 standard deviations is excluded.
    used = np.abs(some - middle[name]) < 3.5 * std[name] * (1 + 1 / np.sqrt(count[name]))
    good = np.bincount(name, used) >= np.maximum(0.5 * count, 6)
    if good.sum() < _FEWEST_BINS:
        return None
    n = np.maximum(np.bincount(name, used), 1.0)
    mean_x, mean_y, apart, level = (
        np.bincount(name, used * a)[good] / n[good] for a in (*(np.take(a, at) for a in (x, y, distance)), some)
    )
    bright = apart > 0
    if min(bright.sum(), (~bright).sum()) < _FEWEST_BINS / 4:
        return None
    low, high = (float(np.median(level[part])) for part in (~bright, bright))
    # Causes other than noise have a standard deviation of 5e-4 of the step.
    std = np.hypot(std[good] / np.sqrt(n[good]), 5e-4 * (high - low))
    return _Bins(mean_x, mean_y, apart, level, np.where(bright, high, low), std)


def _families(bins: _Bins, basis: FloatArray, data: FloatArray, columns: FloatArray, step: float) -> list[_Family]:
    """List all models of the light.

    `data`: (p,) residuals of the bins after the fit of levels and polynomials. `columns`: (radii and positions, p)
    contributions of glare, for each radius, and of a ghost, for each position, to these residuals, for a share of 1.
    """
    families = []
    # Correlation lengths of the light, px.
    for length in (8.0, 20.0, 50.0):
        correlation = _correlation(bins.x, bins.y, bins, length)
        for adds in (False, True):
            seen = basis * ((step if adds else bins.level) / bins.std)[:, None]
            power, axes = np.linalg.eigh(seen.T @ correlation @ seen)
            power = np.asarray(np.maximum(power, 0.0), float)
            shares = np.split(columns @ axes, [len(_RADII)])
            families.append(_Family(length, adds, seen, power, axes, axes.T @ data, *shares))
    return families


def _correlation(x: FloatArray, y: FloatArray, bins: _Bins, length: float) -> FloatArray:
    """Evaluate the Matern correlation function of order 3/2 of the light between points and bins, (points, n)."""
    apart = np.sqrt(3 * ((x[:, None] - bins.x) ** 2 + (y[:, None] - bins.y) ** 2)) / length
    return (1 + apart) * np.exp(-apart)
