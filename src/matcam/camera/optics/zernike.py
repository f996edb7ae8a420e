"""Lens with aberrations as Zernike terms: defocus, astigmatism, coma, trefoil, spherical aberration.

In the image, x points to the right and y upwards. The transfer function is complex and depends on the direction.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from matcam.camera.optics.optics import Optics, Rule, line_kernel, panels_for, reach_of
from matcam.camera.optics.pupil import DiffractionOptics
from matcam.camera.optics.wavefront import (
    LARGEST_PHASE,
    amplitude,
    from_table,
    overlap,
    overlap_order,
    overlap_table,
    phase_of,
    pupil_sizes,
    wavefront,
)
from matcam.core import checks
from matcam.core.arrays import constant, is_concrete, xp
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax

_MOST_DIRECTLY = 4096
"""Largest number of frequencies that are computed by separate quadratures. More frequencies are interpolated in a table."""
_FARTHEST = 200.0  # largest distance at which the PSF is integrated, in units of 2 / (cutoff frequency)


class ZernikeOptics(Optics):
    """Lens with diffraction and low-order aberrations of a circular pupil.

    A coefficient is the rms of its term over the pupil, in waves of `wavelength`. The terms are numbered and normalised
    according to Noll; OSA and ISO 24157 use the same normalisation. The terms are functions of rho, the distance from
    the centre of the pupil in radii of the pupil, and of t, the angle from +x towards +y.

    Light from a part of the pupil where the wavefront has a slope of g waves per pupil radius is displaced by
    -2 f_number wavelength g, m. Piston and tilt are omitted, because they do not blur. Coma includes its balancing tilt:
    the sharpest part of the image of a point is not shifted, and the centroid is shifted by
    -4 sqrt(2) coma f_number wavelength, m.

    Args:
        f_number: working f-number, no unit, positive.
        wavelength: wavelength of the light, m, 1e-9 to 1e-3.
        pixel_pitch: distance between neighbouring pixels, m, 1e-8 to 1e-2.
        defocus: coefficient of sqrt(3) (2 rho^2 - 1), term 4, waves rms. Default: 0. If the sensor is a distance dz, m,
            behind the focus, the coefficient is dz / (16 sqrt(3) f_number^2 wavelength).
        astigmatism: (along x, along the diagonal), coefficients of sqrt(6) rho^2 (cos 2t, sin 2t), terms 6 and 5, waves
            rms. Default: (0, 0).
        coma: (x, y), coefficients of sqrt(8) (3 rho^3 - 2 rho) (cos t, sin t), terms 8 and 7, waves rms.
            Default: (0, 0).
        trefoil: (x, y), coefficients of sqrt(8) rho^3 (cos 3t, sin 3t), terms 10 and 9, waves rms. Default: (0, 0).
        spherical: coefficient of sqrt(5) (6 rho^4 - 6 rho^2 + 1), term 11, waves rms. Default: 0.

    Raises:
        ArgumentError: a parameter is out of range or not finite, coefficients seem to be in metres, or the total wavefront
            error may exceed 2.5 waves at a point of the pupil.

    Source:
        Noll (1976), J. Opt. Soc. Am. 66, 207; Goodman, Introduction to Fourier Optics, 6.4.

    Example:
        >>> lens = matcam.ZernikeOptics(8.0, 550e-9, 5e-6, coma=(0.1, 0.0))
        >>> [round(float(lens.mtf(0.4, angle)), 3) for angle in (0.0, np.pi / 2)]
        [0.274, 0.396]
    """

    focused: DiffractionOptics
    defocus: jax.Array
    astigmatism: jax.Array
    coma: jax.Array
    trefoil: jax.Array
    spherical: jax.Array

    profile_fields = MappingProxyType(
        {
            "f_number": "focused.f_number",
            "wavelength_m": "focused.wavelength",
            "pixel_pitch_m": "focused.pixel_pitch",
            "defocus_waves": "defocus",
            "astigmatism_waves": "astigmatism",
            "coma_waves": "coma",
            "trefoil_waves": "trefoil",
            "spherical_waves": "spherical",
        }
    )

    def __init__(
        self,
        f_number: ArrayLike,
        wavelength: ArrayLike,
        pixel_pitch: ArrayLike,
        defocus: ArrayLike = 0.0,
        astigmatism: Any = (0.0, 0.0),
        coma: Any = (0.0, 0.0),
        trefoil: Any = (0.0, 0.0),
        spherical: ArrayLike = 0.0,
    ):
        self.focused = DiffractionOptics(f_number, wavelength, pixel_pitch)
        self.defocus = checks.scalar("defocus", _waves("defocus", defocus))
        self.astigmatism = _pair("astigmatism", astigmatism)
        self.coma = _pair("coma", coma)
        self.trefoil = _pair("trefoil", trefoil)
        self.spherical = checks.scalar("spherical", _waves("spherical", spherical))
        _refuse_metres(self.terms, self.focused.wavelength)
        check_phase(self.terms)

    @property
    def cutoff(self) -> jax.Array:
        """Frequency at which the transfer function reaches 0, cycles/px."""
        return self.focused.cutoff

    @property
    def isotropic(self) -> bool:
        """False, because the blur of most aberrations depends on the direction."""
        return False

    @property
    def terms(self) -> jax.Array:
        """Coefficients of the Zernike terms, waves rms, shape (8,).

        The order is defocus, astigmatism, coma, trefoil, spherical aberration. Astigmatism, coma and trefoil have two
        coefficients each.
        """
        alone = self.defocus[None], self.spherical[None]
        return xp.concatenate([alone[0], self.astigmatism, self.coma, self.trefoil, alone[1]])

    def wavefront(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Evaluate the wavefront error at a position of the pupil, waves.

        Args:
            x: position to the right, in radii of the pupil; broadcasts with y.
            y: position upwards, in radii of the pupil.

        Raises:
            ArgumentError: a position is not finite.
        """
        return wavefront(self.terms, *xp.broadcast_arrays(*checks.broadcastable(x=x, y=y)))

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the point spread function, 1/px^2, without the pixel.

        It is (pi cutoff^2 / 4) |a|^2. The amplitude a is the mean of exp(2 pi i (W + cutoff p . (x, y) / 2)) over the pupil,
        where W is the wavefront error, waves, at the position p in the pupil, in radii of the pupil.

        Args:
            x: position to the right of the image of the point, px; broadcasts with y. Its modulus is at most
                400 / cutoff.
            y: position above the image of the point, px. Its modulus is at most 400 / cutoff.

        Raises:
            ArgumentError: a position is not finite, or too distant.
        """
        right, up = xp.broadcast_arrays(*checks.broadcastable(x=x, y=y))
        scale = self.cutoff / 2
        reach = reach_of(right, up) * self.band() / 2
        if reach > _FARTHEST:
            raise ArgumentError(
                f"x and y must lie within {2 * _FARTHEST / self.band():.0f} px of the image of the point, which is the range "
                f"of the quadrature, got {reach_of(right, up):g} px"
            )
        sizes = pupil_sizes(self._phase(), np.sqrt(2) * reach)
        wave = amplitude(self.terms, scale * right.ravel(), scale * up.ravel(), sizes)
        return (xp.pi * scale**2 * (wave.real**2 + wave.imag**2)).reshape(right.shape)

    def lsf(self, x: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Compute the line spread function, 1/px, by quadrature, without the pixel.

        Args:
            x: distance from the image of the line, px; broadcasts with angle.
            angle: direction of the normal of the line, from +x towards +y, rad. Default: 0, a line along y.
        """
        at, direction = checks.broadcastable(x=x, angle=angle)
        rule = self.frequency_rule(panels_for(reach_of(at), self.band()))
        return line_kernel(rule, self._along, at, direction)

    def mtf(self, f: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Compute the modulus of the transfer function, without the pixel.

        Args:
            f: frequency, cycles/px; broadcasts with angle.
            angle: direction of the frequency, from +x towards +y, rad. Default: 0.
        """
        return xp.abs(self._along(*checks.broadcastable(f=f, angle=angle)))

    def otf(self, fx: ArrayLike, fy: ArrayLike) -> jax.Array:
        """Compute the complex transfer function in the plane, without the pixel.

        It is the integral of psf(x, y) exp(-2 pi i (fx x + fy y)) over x and y. It is computed as the autocorrelation of
        the pupil function, by Gauss-Legendre quadrature over the overlap of two shifted discs. The error is below 1e-8. If
        there are more than 4096 frequencies, the transfer function is interpolated, and the error is below 1e-6.
        """
        right, up = xp.broadcast_arrays(*checks.broadcastable(fx=fx, fy=fy))
        nu = xp.hypot(right, up) / self.cutoff
        inside = nu < 1
        end = xp.arccos(xp.where(inside, nu, 0.5)).ravel()
        angle = xp.arctan2(xp.where(nu > 0, up, 0.0), xp.where(nu > 0, right, 1.0)).ravel()
        phase = self._phase()
        if end.size > _MOST_DIRECTLY:
            values = from_table(overlap_table(self.terms, phase), phase, end, angle)
        else:
            values = overlap(self.terms, end, angle, overlap_order(phase))
        return xp.where(inside, values.reshape(nu.shape), 0.0)

    def band(self) -> float:
        """Compute the cutoff, cycles/px."""
        return self.focused.band()

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build the quadrature of the diffraction-limited lens on finer panels.

        The panels resolve the phase of the aberrations.
        """
        return self.focused.rule_on(np.union1d(borders, np.linspace(0, 1, 2 + self._phase() // 3)))

    def _along(self, f: jax.Array, angle: jax.Array) -> jax.Array:
        return self.otf(f * xp.cos(angle), f * xp.sin(angle))

    def _phase(self) -> int:
        terms = constant(self.terms)
        # traced coefficients are assumed to have the largest wavefront error
        return phase_of(np.asarray(terms)) if is_concrete(terms) else LARGEST_PHASE


def _waves(name: str, value: Any) -> jax.Array:
    return checks.within(name, value, -5.0, 5.0, "waves rms (50 nm at 550 nm are 0.091)")


def _pair(name: str, value: Any) -> jax.Array:
    if isinstance(value, tuple | list) and not all(map(is_concrete, value)):
        value = xp.stack([xp.asarray(one, dtype=xp.float64) for one in value])
    pair = _waves(name, value)
    if pair.shape != (2,):
        raise ArgumentError(f"{name} must be two numbers in waves rms, got an array of shape {pair.shape}")
    return pair


def _refuse_metres(terms: jax.Array, wavelength: jax.Array) -> None:
    if not is_concrete(terms):
        return
    largest = float(np.max(np.abs(terms)))
    # aberrations below 1e-5 waves rms are invisible, so the value is probably in metres
    if 0 < largest < 1e-5:
        waves = f": {largest:g} m are {largest / float(wavelength):.3g} waves" if is_concrete(wavelength) else ""
        raise ArgumentError(
            f"coefficients must be waves rms, not metres, but the largest modulus is {largest:g}{waves}; "
            "give 0 for no aberration"
        )


def check_phase(terms: AnyArray) -> None:
    """Check that the quadratures are accurate for given aberrations.

    Args:
        terms: coefficients in the order of `ZernikeOptics.terms`, (8,), waves rms.

    Raises:
        ArgumentError: the bound of the wavefront error exceeds `LARGEST_PHASE`.
    """
    phase = phase_of(np.asarray(terms)) if is_concrete(terms) else 0
    if phase > LARGEST_PHASE:
        raise ArgumentError(
            f"the wavefront error is up to {phase / 2 / np.pi:.1f} waves, more than the limit of "
            f"{LARGEST_PHASE / 2 / np.pi:.1f}: for defocus alone use DefocusOptics, otherwise give smaller coefficients"
        )
