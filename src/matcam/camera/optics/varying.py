"""Lenses that consist of several lenses: one for each colour, or one for each position in the field."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.optics import Optics, Rule
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class VaryingOptics(Optics):
    """Lens that consists of several lenses, which are evaluated separately."""

    @property
    def isotropic(self) -> bool:
        """False, because the lens consists of several lenses."""
        return False

    @abstractmethod
    def instead(self) -> str:
        """Describe how to select a single lens, for an error message."""

    @property
    @abstractmethod
    def named_lenses(self) -> dict[str, Optics]:
        """Representative single lenses by name."""

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Raise ArgumentError, because each lens has its own kernel.

        Args:
            x: position to the right of the image of the point, px.
            y: position above the image of the point, px.
        """
        raise self._refused("psf")

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Raise ArgumentError, because each lens has its own kernel.

        Args:
            x: distance from the image of the line, px.
        """
        raise self._refused("lsf")

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Raise ArgumentError, because each lens has its own transfer function.

        Args:
            f: frequency, cycles/px.
        """
        raise self._refused("mtf")

    def otf(self, fx: ArrayLike, fy: ArrayLike) -> jax.Array:
        """Raise ArgumentError, because each lens has its own transfer function.

        Args:
            fx: component of the frequency to the right, cycles/px.
            fy: component of the frequency upwards, cycles/px.
        """
        raise self._refused("otf")

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Raise ArgumentError, because each lens has its own quadrature.

        Args:
            borders: limits of panels as shares of the band, no unit.
        """
        raise self._refused("a quadrature")

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Raise ArgumentError, because no single kernel describes the lens."""
        raise self._refused("a kernel")

    def _refused(self, what: str) -> ArgumentError:
        return ArgumentError(
            f"{what} requires a single lens, but {type(self).__name__} consists of several lenses: {self.instead()}"
        )
