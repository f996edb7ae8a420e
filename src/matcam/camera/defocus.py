"""A perfect lens out of focus: diffraction at a circular pupil that carries a quadratic error of phase."""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import is_concrete, jax, jnp
from matcam.camera.diffraction import DiffractionOptics
from matcam.camera.fourier import Rule, piecewise_rule
from matcam.camera.optics import Optics, lsf_by_quadrature, psf_by_quadrature

_WIDEST = 1000.0  # px
_TRACED_CIRCLE = 256.0  # blur_diameter * cutoff that is resolved where the numbers are not known yet
_FREQUENCIES_AT_ONCE = 1024


class DefocusOptics(Optics):
    """Incoherent circular pupil, free of aberrations but for defocus (Hopkins 1955, Proc. R. Soc. A 231, 91).

    f_number, wavelength, pixel_pitch: as `DiffractionOptics`. blur_diameter: of the geometric circle of confusion, px,
    [0, 1000]; 0 is `DiffractionOptics`. A sensor that is dz m from the focus sees a circle of
    blur_diameter = dz / (f_number pixel_pitch), the wavefront's error at the pupil's edge is
    W020 = dz / (8 f_number^2) = blur_diameter pixel_pitch / (8 f_number), m.

    The MTF is signed: where it is negative, bright and dark have changed places (spurious resolution).
    """

    focused: DiffractionOptics
    blur_diameter: jax.Array

    def __init__(self, f_number: ArrayLike, wavelength: ArrayLike, pixel_pitch: ArrayLike, blur_diameter: ArrayLike):
        self.focused = DiffractionOptics(f_number, wavelength, pixel_pitch)
        self.blur_diameter = checks.scalar(
            "blur_diameter", checks.within("blur_diameter", blur_diameter, 0, _WIDEST, "px")
        )

    @property
    def wavefront_error(self) -> jax.Array:
        """W020, the defocus at the pupil's edge, m."""
        lens = self.focused
        return self.blur_diameter * lens.pixel_pitch / (8 * lens.f_number)

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Point spread function, 1/px^2, by quadrature over the MTF."""
        return psf_by_quadrature(self, x, y)

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Line spread function, 1/px, by quadrature over the MTF."""
        return lsf_by_quadrature(self, x)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """(4 / pi) integral from nu to 1 of cos(pi c f (u - nu)) sqrt(1 - u^2) du, nu = f / cutoff, c = blur_diameter.

        That is the pupil's autocorrelation: the product of the pupil with itself, shifted by 2 nu, keeps of the
        quadratic phase the linear term 8 pi W020 nu u / wavelength = pi c f u. NaN for traced numbers whose
        c * cutoff exceeds 256, because the quadrature's size is fixed before they are known.
        """
        f = jnp.abs(checks.number("f", f))
        cutoff = self.focused.cutoff
        known = is_concrete(self.blur_diameter) and is_concrete(cutoff)
        circle = float(self.blur_diameter * cutoff) if known else _TRACED_CIRCLE
        # in u = cos t the cosine runs through at most 0.23 c cutoff periods: three to a panel
        rule = piecewise_rule(np.linspace(0, 1, 3 + int(0.08 * circle)))
        values = _overlap(f, cutoff, self.blur_diameter, *(jnp.asarray(a) for a in rule))
        return values if known else jnp.where(self.blur_diameter * cutoff > _TRACED_CIRCLE, jnp.nan, values)

    def band(self) -> float:
        """The diffraction cutoff, cycles/px."""
        return self.focused.band()

    def rule_on(self, borders: np.ndarray) -> Rule:
        """That of the focused lens, with panels that resolve the circle's oscillations, exp(i pi c f), too."""
        known = is_concrete(self.blur_diameter)
        circle = float(self.blur_diameter) * self.band() if known else _TRACED_CIRCLE
        return self.focused.rule_on(np.union1d(borders, np.linspace(0, 1, 2 + int(np.ceil(circle / 2)))))

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Itself."""
        return ((jnp.ones(()), self),)

    def __repr__(self) -> str:
        lens = self.focused
        return (
            f"DefocusOptics(f_number={lens.f_number!s}, wavelength={lens.wavelength!s}, "
            f"pixel_pitch={lens.pixel_pitch!s}, blur_diameter={self.blur_diameter!s})"
        )


@jax.jit
def _overlap(
    f: jax.Array, cutoff: jax.Array, blur_diameter: jax.Array, share: jax.Array, weight: jax.Array
) -> jax.Array:
    def at(frequency: jax.Array) -> jax.Array:
        nu = frequency / cutoff
        inside = nu < 1
        nu = jnp.where(inside, nu, 0.5)  # keeps the gradient finite at and beyond the cutoff
        end = jnp.arccos(nu)
        t = end * share
        wave = jnp.cos(jnp.pi * blur_diameter * frequency * (jnp.cos(t) - nu))
        return jnp.where(inside, 4 / jnp.pi * end * ((wave * jnp.sin(t) ** 2) @ weight), 0.0)

    return jax.lax.map(at, f.ravel(), batch_size=_FREQUENCIES_AT_ONCE).reshape(f.shape)
