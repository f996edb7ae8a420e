"""Lens limited by its pupil: diffraction at a circular aperture, in focus and out of focus.

In focus the lens is diffraction-limited. Out of focus the pupil has a quadratic phase error.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.optics import Optics, Rule, piecewise_rule, reach_of
from matcam.core import checks
from matcam.core.arrays import compiled_by_jax, first_axis_map, is_concrete, xp
from matcam.core.arrays.elementary import plane_length
from matcam.numerics.jinc import jinc

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_TRACED_CIRCLE = 256.0  # largest blur_diameter * cutoff that is resolved for traced parameters


class DiffractionOptics(Optics):
    """Diffraction-limited lens with a circular pupil.

    The MTF ends at pixel_pitch / (wavelength f_number) cycles/px.

    Args:
        f_number: working f-number, no unit, positive.
        wavelength: wavelength of the light, m, 1e-9 to 1e-3 (550 nm is 550e-9).
        pixel_pitch: distance between neighbouring pixels, m, 1e-8 to 1e-2 (5 um is 5e-6).

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        Goodman, Introduction to Fourier Optics, 6.3.2.

    Example:
        >>> lens = matcam.DiffractionOptics(f_number=8.0, wavelength=550e-9, pixel_pitch=5e-6)
        >>> round(float(lens.cutoff), 4)
        1.1364
    """

    f_number: jax.Array
    wavelength: jax.Array
    pixel_pitch: jax.Array

    profile_fields = MappingProxyType(
        {
            "f_number": "f_number",
            "wavelength_m": "wavelength",
            "pixel_pitch_m": "pixel_pitch",
        }
    )

    def __init__(self, f_number: ArrayLike, wavelength: ArrayLike, pixel_pitch: ArrayLike):
        self.f_number = checks.scalar("f_number", checks.positive("f_number", f_number))
        self.wavelength = checks.scalar(
            "wavelength", checks.within("wavelength", wavelength, 1e-9, 1e-3, "m (550 nm is 550e-9)")
        )
        self.pixel_pitch = checks.scalar(
            "pixel_pitch", checks.within("pixel_pitch", pixel_pitch, 1e-8, 1e-2, "m (5 um is 5e-6)")
        )

    @property
    def cutoff(self) -> jax.Array:
        """Frequency at which the MTF reaches 0, cycles/px."""
        return self.pixel_pitch / (self.wavelength * self.f_number)

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the Airy pattern, 1/px^2, without the pixel.

        It is (pi cutoff^2 / 4) [2 J1(v) / v]^2, where J1 is the Bessel function, v = pi cutoff r, and r = sqrt(x^2 + y^2) is
        the distance from the image of the point, px.
        """
        r = plane_length(*checks.broadcastable(x=x, y=y))
        return xp.pi / 4 * self.cutoff**2 * jinc(xp.pi * self.cutoff * r, np.pi * reach_of(r) * self.band()) ** 2

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the transfer function, without the pixel.

        It is (2 / pi) [acos nu - nu sqrt(1 - nu^2)], nu = f / cutoff (Goodman 6-31), and 0 beyond the cutoff.
        """
        nu = xp.abs(checks.number("f", f)) / self.cutoff
        inside = nu < 1
        nu = xp.where(inside, nu, 0.5)  # keeps the gradient finite at and beyond the cutoff
        return xp.where(inside, 2 / xp.pi * (xp.arccos(nu) - nu * xp.sqrt(1 - nu**2)), 0.0)

    def band(self) -> float:
        """Compute the cutoff, cycles/px."""
        # a traced lens is assumed to have a cutoff of 8 cycles/px
        return float(self.cutoff) if is_concrete(self.cutoff) else 8.0

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build a quadrature on panels of a variable t.

        The frequency is f = cutoff t (2 - t). Near the cutoff the MTF varies as (1 - f / cutoff)^(3/2) = (1 - t)^3, which
        is a polynomial in t.
        """
        unit = piecewise_rule(1 - np.sqrt(1 - borders))
        t = unit.frequency
        return Rule(self.cutoff * t * (2 - t), self.cutoff * unit.weight * 2 * (1 - t))


class DefocusOptics(Optics):
    """Lens with diffraction and defocus, without other aberrations.

    If the distance between sensor and focus is dz, m, the diameter of the circle of confusion is
    blur_diameter = dz / (f_number pixel_pitch), px. The wavefront error at the edge of the pupil is then
    W020 = dz / (8 f_number^2) = blur_diameter pixel_pitch / (8 f_number), m.

    The MTF is signed: where it is negative, bright and dark are exchanged (spurious resolution).

    Args:
        f_number: working f-number, no unit, positive.
        wavelength: wavelength of the light, m, 1e-9 to 1e-3.
        pixel_pitch: distance between neighbouring pixels, m, 1e-8 to 1e-2.
        blur_diameter: diameter of the geometric circle of confusion, px, [0, 1000]; 0 is equivalent to
            `DiffractionOptics`.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        Hopkins (1955), Proc. R. Soc. A 231, 91.

    Example:
        >>> sharp = matcam.DiffractionOptics(8.0, 550e-9, 5e-6)
        >>> soft = matcam.DefocusOptics(8.0, 550e-9, 5e-6, blur_diameter=3.0)
        >>> float(soft.mtf(0.2)) < float(sharp.mtf(0.2))
        True
    """

    focused: DiffractionOptics
    blur_diameter: jax.Array

    profile_fields = MappingProxyType(
        {
            "f_number": "focused.f_number",
            "wavelength_m": "focused.wavelength",
            "pixel_pitch_m": "focused.pixel_pitch",
            "blur_diameter_px": "blur_diameter",
        }
    )

    def __init__(self, f_number: ArrayLike, wavelength: ArrayLike, pixel_pitch: ArrayLike, blur_diameter: ArrayLike):
        self.focused = DiffractionOptics(f_number, wavelength, pixel_pitch)
        # circles of confusion up to 1000 px are accepted
        self.blur_diameter = checks.scalar(
            "blur_diameter", checks.within("blur_diameter", blur_diameter, 0, 1000.0, "px")
        )

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed transfer function, without the pixel.

        It is (4 / pi) times the integral from nu to 1 of cos(pi c f (u - nu)) sqrt(1 - u^2) du, where nu = f / cutoff and
        c = blur_diameter. This is the normalised autocorrelation of the pupil function at a shift of 2 nu pupil radii.
        The phase difference of the two shifted pupils is pi c f u at the position u along the shift, in radii of the
        pupil.

        If a parameter is traced, the size of the quadrature is fixed in advance, and the result is NaN where
        blur_diameter * cutoff exceeds 256.
        """
        frequency = xp.abs(checks.number("f", f))
        cutoff = self.focused.cutoff
        known = is_concrete(self.blur_diameter) and is_concrete(cutoff)
        circle = float(self.blur_diameter * cutoff) if known else _TRACED_CIRCLE
        # in u = cos t the cosine has at most 0.23 c cutoff periods: three per panel
        rule = piecewise_rule(np.linspace(0, 1, 3 + int(0.08 * circle)))
        values = _overlap(frequency, cutoff, self.blur_diameter, *(xp.asarray(a) for a in rule))
        return values if known else xp.where(self.blur_diameter * cutoff > _TRACED_CIRCLE, xp.nan, values)

    def band(self) -> float:
        """Compute the diffraction cutoff, cycles/px."""
        return self.focused.band()

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build the quadrature of the focused lens on finer panels.

        The panels resolve the oscillations exp(i pi blur_diameter f) of the transfer function.
        """
        known = is_concrete(self.blur_diameter)
        circle = float(self.blur_diameter) * self.band() if known else _TRACED_CIRCLE
        return self.focused.rule_on(np.union1d(borders, np.linspace(0, 1, 2 + int(np.ceil(circle / 2)))))


@compiled_by_jax
def _overlap(
    f: jax.Array, cutoff: jax.Array, blur_diameter: jax.Array, share: jax.Array, weight: jax.Array
) -> jax.Array:
    def at(frequency: jax.Array) -> jax.Array:
        nu = frequency / cutoff
        inside = nu < 1
        nu = xp.where(inside, nu, 0.5)  # keeps the gradient finite at and beyond the cutoff
        end = xp.arccos(nu)
        t = end[:, None] * share
        wave = xp.cos(xp.pi * blur_diameter * frequency[:, None] * (xp.cos(t) - nu[:, None]))
        return xp.where(inside, 4 / xp.pi * end * ((wave * xp.sin(t) ** 2) @ weight), 0.0)

    # 1024 frequencies are evaluated at once, which limits memory
    return first_axis_map(at, (f.ravel(),), 1024).reshape(f.shape)
