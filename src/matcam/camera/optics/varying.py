"""Lenses that are several: another one for each colour, or for each place of the field."""

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
    """Lens that is no single one: what a single one answers is asked of its parts."""

    @property
    def isotropic(self) -> bool:
        """Tell that it is not one lens."""
        return False

    @abstractmethod
    def instead(self) -> str:
        """Return what to ask instead, for a message."""

    @property
    @abstractmethod
    def named_lenses(self) -> dict[str, Optics]:
        """Return single lenses that stand for it, by what they are called."""

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Refuse: each of its lenses has its own.

        Args:
            x: px.
            y: px.
        """
        raise self._refused("psf")

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Refuse: each of its lenses has its own.

        Args:
            x: px.
        """
        raise self._refused("lsf")

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Refuse: each of its lenses has its own.

        Args:
            f: cycles/px.
        """
        raise self._refused("mtf")

    def otf(self, fx: ArrayLike, fy: ArrayLike) -> jax.Array:
        """Refuse: each of its lenses has its own.

        Args:
            fx: cycles/px.
            fy: cycles/px.
        """
        raise self._refused("otf")

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Refuse: each of its lenses has its own.

        Args:
            borders: shares of the band.
        """
        raise self._refused("a quadrature")

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """Refuse: it is no sum of its lenses."""
        raise self._refused("a kernel")

    def _refused(self, what: str) -> ArgumentError:
        return ArgumentError(f"{what} needs one lens, {type(self).__name__} is several: {self.instead()}")
