"""Lenses with aberrations by brute force: the pupil's integral for the spread of a point, sums over normals for pictures.

Imports nothing of the package. Zernike terms in polar coordinates (Noll 1976, table I), waves rms. The pupil by Gauss-Legendre
on its chords: a wave exp(2 pi i p . x) is a product there, so that a whole grid of places is sums along chords and over them.
The picture of a pixel is the integral of a quintic spline through the spread, which ends at a frequency, over the pixel.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from tests.oracle.sphere_record import _reflected


class Pupil(NamedTuple):
    """cutoff: wavelength and f-number, cycles/px. Coefficients, waves rms; of a pair the cosine's first."""

    cutoff: float
    defocus: float = 0.0
    astigmatism: tuple = (0.0, 0.0)
    coma: tuple = (0.0, 0.0)
    trefoil: tuple = (0.0, 0.0)
    spherical: float = 0.0


def waves(pupil, x, y):
    """Error of the wavefront at places of the unit disc, waves."""
    r, t = np.hypot(x, y), np.arctan2(y, x)
    return (
        pupil.defocus * np.sqrt(3) * (2 * r**2 - 1)
        + np.sqrt(6) * r**2 * (pupil.astigmatism[0] * np.cos(2 * t) + pupil.astigmatism[1] * np.sin(2 * t))
        + np.sqrt(8) * (3 * r**3 - 2 * r) * (pupil.coma[0] * np.cos(t) + pupil.coma[1] * np.sin(t))
        + np.sqrt(8) * r**3 * (pupil.trefoil[0] * np.cos(3 * t) + pupil.trefoil[1] * np.sin(3 * t))
        + pupil.spherical * np.sqrt(5) * (6 * r**4 - 6 * r**2 + 1)
    )


def spread(pupil, x, y):
    """Light per px^2 at columns x (n,) and rows y (m,), px upwards: (m, n). Light goes down the wavefront's slope."""
    half = pupil.cutoff / 2
    nodes = 40 + int(4 * np.pi * half * max(np.abs(x).max(), np.abs(y).max()) / np.pi)  # two to a period
    node, weight = np.polynomial.legendre.leggauss(nodes)
    at_x, share_x = np.sin(np.pi / 2 * node), np.pi / 2 * weight * np.cos(np.pi / 2 * node) ** 2
    by_chord = np.empty((len(y), nodes), complex)
    for k, one in enumerate(at_x):
        at_y = np.sqrt(1 - one**2) * node
        chord = weight / np.pi * np.exp(2j * np.pi * waves(pupil, one, at_y))
        by_chord[:, k] = np.exp(2j * np.pi * half * np.outer(y, at_y)) @ chord
    wave = (by_chord * share_x) @ np.exp(2j * np.pi * half * np.outer(at_x, x))
    return np.pi * half**2 * np.abs(wave) ** 2


def otf(pupil, fx, fy, nodes=120):
    """Transfer function at one frequency: the plane integral over the overlap of two discs, on chords along the shift."""
    nu, turn = np.hypot(fx, fy) / pupil.cutoff, np.arctan2(fy, fx)
    if nu >= 1:
        return 0.0
    node, weight = np.polynomial.legendre.leggauss(nodes)
    v = np.sqrt(1 - nu**2) * np.sin(np.pi / 2 * node)
    dv = np.sqrt(1 - nu**2) * np.pi / 2 * np.cos(np.pi / 2 * node) * weight
    reach = np.sqrt(1 - v**2) - nu
    u = reach[:, None] * node

    def at(shift):
        along = u + shift
        return waves(
            pupil, along * np.cos(turn) - v[:, None] * np.sin(turn), along * np.sin(turn) + v[:, None] * np.cos(turn)
        )

    inner = (np.exp(2j * np.pi * (at(nu) - at(-nu))) * weight).sum(1) * reach
    return (dv * inner).sum() / np.pi


def seen_by_pixel(pupil, reach, half_width=0.5):
    """Function of offsets (pixel from the point, px: right, up) up to `reach`: a pixel's reading of a point, 1/px^2."""
    step = 1 / (9 * max(pupil.cutoff, 1.0))
    line = np.arange(-np.ceil((reach + 1) / step), np.ceil((reach + 1) / step) + 1) * step
    values = spread(pupil, line, line)
    inner = line[np.abs(line) <= reach]
    for axis in (0, 1):
        whole = make_interp_spline(line, values, k=5, axis=axis).antiderivative()
        values = (whole(inner + half_width) - whole(inner - half_width)) / (2 * half_width)
        if axis == 0:
            values = values.reshape(inner.size, line.size)
    spline = RectBivariateSpline(inner, inner, values, kx=5, ky=5)
    return lambda x, y: spline.ev(y, x)


def sphere_pixels(x, y, lamp, surface, pupil, radius, fine=1):
    """Radiance of pixels at x, y px (up) of a sphere before a distant camera and lamp: the sum over its visible, lit normals.

    lamp: direction (3,). The normals by Gauss-Legendre in the angle from the axis, evenly round it.
    """
    kernel = seen_by_pixel(pupil, radius + np.max(np.hypot(x, y)) + 2)
    node, weight = np.polynomial.legendre.leggauss(240 * fine)
    theta, d_theta = np.pi / 4 * (1 + node), np.pi / 4 * weight
    phi = 2 * np.pi * np.arange(480 * fine) / (480 * fine)
    normal = np.stack(
        [np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi), np.cos(theta)[:, None] + 0 * phi]
    )
    cos_i = np.tensordot(np.asarray(lamp), normal, 1)
    view = np.zeros_like(normal)
    view[2] = 1
    with np.errstate(divide="ignore", invalid="ignore"):
        light = _reflected(surface, normal, np.asarray(lamp), view, cos_i, normal[2])
    share = radius**2 * (np.sin(theta) * d_theta)[:, None] * (2 * np.pi / phi.size)
    light = np.where(cos_i > 0, light * share, 0.0)
    lit = light > 0
    at_x, at_y, light = radius * normal[0][lit], radius * normal[1][lit], light[lit]
    return np.array([(kernel(one - at_x, two - at_y) * light).sum() for one, two in zip(x, y, strict=True)])
