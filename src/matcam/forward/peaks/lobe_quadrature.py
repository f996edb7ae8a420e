"""Record of any lobe through any single lens, by one integral over frequencies (docs/model.md 4).

    record = integral of transfer(f) spectrum(f) discs(f) exp(2 pi i f x) df

Here f is the frequency and x is the offset from the peak, both vectors in the plane of the sensor. The factor discs(f) is
the product of the Fourier transforms of the discs of lamp and lens, which are uniform ellipses.

The nodes are polar, a product of frequencies and azimuths. The panels of the frequencies become narrower towards f = 0,
where the spectra of broad lobes are concentrated. The azimuths become denser towards the short axis of the lobe. They cover a
quarter of the plane, because the spectra of lobe and discs are symmetric about the plane of incidence. The transfer function
is not symmetric, because the plane of incidence rotates with the lamp, and because lenses may have aberrations. It is therefore
evaluated at the azimuths phi and -phi. At opposite frequencies it is complex conjugate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core.arrays import constant, first_axis_map, is_concrete, xp
from matcam.forward.peaks.disc_points import DiscPoints, Discs, disc_sizes, mean_over_discs
from matcam.forward.peaks.lobe_spectrum import LobeSpectrum, lobe_spectrum
from matcam.numerics.approximation import nodes_between
from matcam.numerics.jinc import jinc

if TYPE_CHECKING:
    from matcam.camera.optics.optics import Rule
    from matcam.core.jax import AnyArray, jax
    from matcam.material.ndf.distribution import NDF
    from matcam.rigs import Rig

_VALUES = 1 << 19
"""Largest number of values of an integrand that are stored at a time, which take 4 MiB."""
_GRADE = 2.0
"""Ratio of the frequencies at the ends of a panel. The spectrum of a flat-topped lobe has two oscillations in a panel."""
_MOST_PANELS = 28
"""Number of panels towards 0 if the size of the lobe is traced inside `jax.jit`. It suffices for lobes up to 1e5 px."""
_FLATTEST = 1e-3
"""Product of the end of the first panel and the size of the lobe. Below it the spectrum is quadratic in frequency."""
_AZIMUTHS = 28
"""Number of nodes in a quarter turn. The error is 1e-9 for lobes that are 600 times as long as wide."""
_SHORTEST = 1.7e-3
"""Ratio of the axes of a lobe that is assumed inside `jax.jit`. It is the ratio on a sphere at a viewing angle of 89.9 degrees.
"""
_UNKNOWN_REACH = 8.0
"""Distance of a position from the peak that is assumed inside `jax.jit`, px."""
_CHEBYSHEV = 64
"""Number of lengths of the lobe between which records are interpolated, if only the length varies between slices. The error
is 1e-9.
"""

Positions = tuple["jax.Array", "jax.Array"]
"""Offsets from the peak, px, (slices, points) each: towards the limb, and perpendicular to this direction."""


def plane_record(rig: Rig, ndf: NDF, theta: jax.Array, positions: Positions | None) -> jax.Array:
    """Compute the record of a lobe divided by the true peak, (slices, points).

    Args:
        rig: the rig.
        ndf: the lobe.
        theta: viewing angles of the peak, rad, (slices,).
        positions: offsets of the points of the record from the peak; None: one point at the peak.
    """
    scale_x, scale_y = rig.px_per_rad(theta)
    uniform = xp.isinf(scale_x) | xp.isinf(scale_y)
    scale_x, scale_y = xp.where(uniform, 1.0, scale_x), xp.where(uniform, 1.0, scale_y)
    discs = disc_sizes(rig, theta)
    nodes = _polar_nodes(rig, ndf, (scale_x, scale_y), discs, positions)
    given = (scale_x, scale_y, *(discs[:3] if discs else ()), *(positions or ()))
    if discs is None and positions is None and _only_length_varies(scale_x, scale_y):
        records = _interpolated(nodes, scale_x, scale_y[:1])
    else:
        records = first_axis_map(nodes.at, given, nodes.together)
    return xp.where(uniform[:, None], 1.0, records)


def line_record(rig: Rig, ndf: NDF, theta: jax.Array, one_plane: bool) -> jax.Array:
    """Compute the one-dimensional record at the peak divided by the true peak, (slices,).

    Args:
        rig: the rig.
        ndf: the lobe.
        theta: viewing angles of the peak, rad, (slices,).
        one_plane: True if the normals lie in one plane, as on a cylinder. A source disc then rotates the half vector out of
            this plane.
    """
    discs = disc_sizes(rig, theta)
    if discs is None or not one_plane:
        return _line(rig, ndf, theta, discs, None)[:, 0]

    def mean(slices: np.ndarray, points: DiscPoints) -> jax.Array:
        return _line(rig, ndf, theta[slices], None, points) @ points.share

    return mean_over_discs(rig, theta, mean, ndf.roughness)


def _line(rig: Rig, ndf: NDF, theta: jax.Array, discs: Discs | None, points: DiscPoints | None) -> jax.Array:
    """Compute the record in one dimension, (slices, points), at the peak or at the points of discs about the peak."""
    scale = rig.px_per_rad(theta)[0]
    uniform = xp.isinf(scale)
    scale = xp.where(uniform, 1.0, scale)
    reach = _largest(*((points.x,) if points else ()), *(discs[:3] if discs else ()))
    rule = _frequencies(rig, ndf, scale, reach)
    f = xp.asarray(rule.frequency)
    turn = rig.azimuths()
    transfer = rig.camera.transfer(f * xp.cos(turn), f * xp.sin(turn))
    amplitude = 2 * xp.asarray(rule.weight) * transfer * _of_jitter(rig, f)
    ln_k, through = xp.log(2 * np.pi * f), None if points else lobe_spectrum(ndf, 1)

    def at(scale: jax.Array, *more: jax.Array) -> jax.Array:
        ln_scaled = (ln_k + xp.log(scale)[:, None])[:, None]
        if through is None:
            x, aside = more
            spectrum = lobe_spectrum(ndf, 1, aside).at(xp.broadcast_to(ln_scaled, (*x.shape, f.size)))
            waves = _waves(amplitude, 2 * np.pi * f * x[..., None])
        else:
            spectrum, waves = through.at(ln_scaled), xp.real(amplitude)
            for size in more:
                waves = waves * jinc(2 * np.pi * f * size[:, None, None], 2 * np.pi * reach * optics.band())
        return scale[:, None] * xp.sum(spectrum * waves, axis=-1)

    optics = rig.camera.optics
    given = (points.x, points.aside) if points else (discs.lamp_x, discs.lens) if discs else ()
    together = max(1, _VALUES // (16 * f.size * (points.x.shape[1] if points else 1)))
    return xp.where(uniform[:, None], 1.0, first_axis_map(at, (scale, *given), together))


class _PolarNodes(NamedTuple):
    """Nodes in a quarter of the plane of frequencies.

    Attributes:
        spectrum: spectrum of the lobe.
        frequency: frequencies, cycles/px, (frequencies, 1).
        cos: cosines of the azimuths, (azimuths,).
        sin: sines of the azimuths, (azimuths,).
        amplitude: transfer function times the weights of two opposite quarters, at the azimuths and at their mirror images,
            (2, frequencies, azimuths).
        discs: True if lamp or lens has a disc.
        largest: largest argument of `jinc`: 2 pi times the cutoff of the lens, cycles/px, times the largest radius, px.
        together: number of slices that are computed at a time.
    """

    spectrum: LobeSpectrum
    frequency: jax.Array
    cos: np.ndarray
    sin: np.ndarray
    amplitude: jax.Array
    discs: bool
    largest: float
    together: int

    def at(self, scale_x: jax.Array, scale_y: jax.Array, *more: jax.Array) -> jax.Array:
        """Compute the record of slices, (slices, points).

        Args:
            scale_x: scale of the image of the lobe towards the limb, px per unit of the coordinate of the lobe, (slices,).
            scale_y: scale perpendicular to this direction, px per unit of the coordinate of the lobe, (slices,).
            more: half axes of the discs, if any, px, and offsets of the points of the record from the peak, if any, px.
        """
        stretch = (scale_x[:, None] * self.cos) ** 2 + (scale_y[:, None] * self.sin) ** 2
        ln_k = xp.log(2 * np.pi * self.frequency) + xp.log(stretch)[:, None] / 2
        spectra = self.spectrum.at(ln_k) * (scale_x * scale_y)[:, None, None]
        turns = 2 * np.pi * self.frequency
        if self.discs:
            lamp_x, lamp_y, lens = (size[:, None, None] for size in more[:3])
            lamp = turns * xp.sqrt((lamp_x * self.cos) ** 2 + (lamp_y * self.sin) ** 2)
            spectra = spectra * jinc(lamp, self.largest) * jinc(turns * lens, self.largest)
        positions = more[3:] if self.discs else more
        if not positions:
            return xp.sum(spectra * xp.real(self.amplitude).sum(0), axis=(1, 2))[:, None]
        along, across = (
            turns * axis * at[..., None, None] for axis, at in zip((self.cos, self.sin), positions, strict=True)
        )
        waves = _waves(self.amplitude[0], along + across) + _waves(self.amplitude[1], along - across)
        return xp.sum(spectra[:, None] * waves, axis=(2, 3))


def _waves(amplitude: jax.Array, phase: jax.Array) -> jax.Array:
    """Compute the real part of amplitude * exp(i phase). phase: rad."""
    return xp.real(amplitude) * xp.cos(phase) - xp.imag(amplitude) * xp.sin(phase)


def _polar_nodes(
    rig: Rig, ndf: NDF, scales: tuple[jax.Array, jax.Array], discs: Discs | None, positions: Positions | None
) -> _PolarNodes:
    of_discs = _largest(*discs[:3]) if discs else 0.0
    reach = of_discs + _largest(*(positions or ()))
    rule = _frequencies(rig, ndf, xp.maximum(*scales), reach)
    ratio = constant(xp.min(scales[0] / scales[1]))
    short = float(np.clip(ratio, 1e-6, 1)) if is_concrete(ratio) else _SHORTEST
    # phi = short sinh v: a spectrum varies on the scale `short` near phi = 0, and on the scale 1 elsewhere
    band = rig.camera.optics.band()
    v, weight = nodes_between(np.zeros(()), np.arcsinh(np.pi / 2 / short), _AZIMUTHS + int(4 * reach * band))
    phi = short * np.sinh(v)
    f = xp.asarray(rule.frequency)[:, None]
    area = 2 * xp.asarray(rule.weight)[:, None] * f * (weight * short * np.cosh(v)) * _of_jitter(rig, f)
    turn = rig.azimuths() + np.stack([phi, -phi])[:, None]
    amplitude = area * rig.camera.transfer(f * xp.cos(turn), f * xp.sin(turn))
    together = max(1, _VALUES // (area.size * (1 if positions is None else positions[0].shape[1])))
    largest = 2 * np.pi * of_discs * band
    return _PolarNodes(
        lobe_spectrum(ndf, 2), f, np.cos(phi), np.sin(phi), amplitude, discs is not None, largest, together
    )


def _frequencies(rig: Rig, ndf: NDF, scale: jax.Array, reach: float) -> Rule:
    """Build a quadrature rule for the band of the lens. The rule resolves a lobe of any size.

    scale: px per unit of the lobe's coordinate. reach: largest distance of a record from the peak, px.
    """
    optics = rig.camera.optics
    size = constant(xp.max(scale * ndf.roughness)) * optics.band() / _FLATTEST
    panels = _MOST_PANELS
    if is_concrete(size):
        panels = int(np.clip(np.ceil(np.log(max(float(size), 1.0)) / np.log(_GRADE)), 1, 2 * _MOST_PANELS))
    even = np.linspace(0, 1, 3 + int(np.ceil((1 + reach) * optics.band())))
    return optics.rule_on(np.union1d(even, _GRADE ** -np.arange(panels, 0, -1.0)))


def _of_jitter(rig: Rig, frequency: AnyArray) -> jax.Array:
    """Compute the transfer function of the registration jitter. frequency: cycles/px."""
    return xp.exp(-2 * (np.pi * frequency * rig.jitter) ** 2)


def _largest(*lengths: jax.Array) -> float:
    """Compute the largest absolute length, px. Traced lengths are assumed to be `_UNKNOWN_REACH`."""
    known = [constant(length) for length in lengths]
    return max((float(xp.max(xp.abs(a))) if is_concrete(a) else _UNKNOWN_REACH for a in known), default=0.0)


def _only_length_varies(scale_x: jax.Array, scale_y: jax.Array) -> bool:
    """Check whether more than `_CHEBYSHEV` slices differ only in a concrete `scale_x`, as on a distant sphere."""
    if scale_x.size <= _CHEBYSHEV or not all(isinstance(scale, np.ndarray) for scale in (scale_x, scale_y)):
        return False
    return bool(np.all(scale_y == scale_y[0]) and np.ptp(scale_x) > 0)


def _interpolated(nodes: _PolarNodes, scale_x: np.ndarray, scale_y: np.ndarray) -> np.ndarray:
    """Interpolate the records at many peaks, (slices, 1).

    The records are computed at Chebyshev nodes in the logarithm of `scale_x`.
    """
    domain = np.log([scale_x.min(), scale_x.max()])
    unit = np.polynomial.chebyshev.chebpts1(_CHEBYSHEV)
    length = np.exp(domain.mean() + np.ptp(domain) / 2 * unit)
    records = first_axis_map(nodes.at, (length, np.full_like(length, scale_y[0])), nodes.together)[:, 0]
    basis = np.polynomial.chebyshev.chebvander(unit, _CHEBYSHEV - 1)
    position = (2 * np.log(scale_x) - domain.sum()) / np.ptp(domain)
    shares = np.polynomial.chebyshev.chebvander(position, _CHEBYSHEV - 1) @ np.linalg.inv(basis)
    return (shares @ records)[:, None]
