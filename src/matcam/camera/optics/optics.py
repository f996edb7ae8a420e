"""The lens: its point spread function, before any pixel has integrated it (docs/model.md 2)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.fourier import Rule, line_kernel, panels_for, plane_kernel, reach_of, turns_for
from matcam.core import checks
from matcam.core.jax import jax, jnp


class Optics(eqx.Module):
    """Describe a lens that blurs isotropically and without shift; the pixel is not in it.

    Three kernels are called PSF: the *optical* one (this type), the *pixel response* (`PixelResponse`) and their
    combination, the *effective* one (`Camera`). They are different types so that none can be applied twice.

    Attributes:
        profile_fields: {name with its unit in a camera profile: attribute}, in the order of the constructor's arguments.
    """

    profile_fields: ClassVar[Mapping[str, str]]

    @abstractmethod
    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Return the optical point spread function, 1/px^2; the pixel is not in it.

        It is the light on the sensor, per px^2, of a point of unit light, and integrates to 1. `Camera.psf` has the pixel in
        it.

        Args:
            x: distance from the point's image along the rows, px; broadcasts with y.
            y: distance across the rows, px.

        Raises:
            ArgumentError: a position is not finite.
        """

    @abstractmethod
    def lsf(self, x: ArrayLike) -> jax.Array:
        """Return the optical line spread function, 1/px; the pixel is not in it.

        It is the point spread function, integrated along a line; it integrates to 1.

        Args:
            x: distance from the line's image, px, any shape.

        Raises:
            ArgumentError: x is not finite.
        """

    @abstractmethod
    def mtf(self, f: ArrayLike) -> jax.Array:
        """Return the optical transfer function, signed; the pixel is not in it.

        Args:
            f: frequency, cycles/px, any shape; the value at 0 is 1.

        Raises:
            ArgumentError: f is not finite.
        """

    @abstractmethod
    def band(self) -> float:
        """Return the frequency above which the MTF is 0 to rounding, cycles/px."""

    @abstractmethod
    def rule_on(self, borders: np.ndarray) -> Rule:
        """Return a quadrature over [0, band] on which this MTF is smooth.

        Args:
            borders: limits of its panels, shares of the band, increasing from 0 to 1. No panel of the rule is wider.
        """

    @abstractmethod
    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Return (weight, lens) of the parts that this lens is the sum of.

        A lens of one piece returns itself, with weight 1.
        """

    def frequency_rule(self, panels: int, grade: int = 1) -> Rule:
        """Return a quadrature over [0, band] on evenly graded panels.

        Args:
            panels: number of panels, at least.
            grade: power by which they crowd towards 0. Default: 1, all of one width.
        """
        return self.rule_on(np.linspace(0, 1, panels + 1) ** grade)


def lsf_by_quadrature(optics: Optics, x: ArrayLike) -> jax.Array:
    """Integrate the line spread function of a lens, 1/px, over its MTF."""
    x = checks.number("x", x)
    rule = optics.frequency_rule(panels_for(reach_of(x), optics.band()))
    return line_kernel(rule, lambda f, _: optics.mtf(f), x, jnp.zeros(()))


def psf_by_quadrature(optics: Optics, x: ArrayLike, y: ArrayLike) -> jax.Array:
    """Integrate the point spread function of a lens, 1/px^2, over its MTF."""
    x, y = checks.number("x", x), checks.number("y", y)
    reach, band = reach_of(jnp.hypot(x, y)), optics.band()
    rule = optics.frequency_rule(panels_for(reach, band))
    return plane_kernel(rule, lambda f, _: optics.mtf(f), x, y, turns_for(reach, band))
