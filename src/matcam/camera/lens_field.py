"""Variation of a lens over the field: radial distortion, and blur that grows from the centre."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError


class Coefficient(NamedTuple):
    """Coefficient of the variation of a lens over the field.

    Attributes:
        value: coefficient, no unit. Default: 0.
        std: standard deviation of the coefficient, no unit. Default: 0, exact.

    Example:
        >>> matcam.camera.Coefficient(-0.01, 0.001).std
        0.001
    """

    value: float = 0.0
    std: float = 0.0


_NONE = Coefficient()


@dataclass(frozen=True)
class LensField:
    """Distortion and blur of a lens over the field.

    A position at rho units from the centre is imaged at rho (1 + k1 rho^2 + k2 rho^4). The width of the blur is multiplied
    by 1 + growth (rho^2 - rho0^2), where rho0 = holds_at / unit.

    Attributes:
        centre: column and row of the centre of distortion, px.
        unit: unit of rho, px. `calibrate` uses half the diagonal of the image.
        k1: radial distortion of third order, no unit. Default: 0, exact.
        k2: radial distortion of fifth order, no unit. Default: 0, exact.
        growth: relative growth of the width of the blur with rho^2, no unit. Default: 0, exact.
        holds_at: distance from the centre at which the lens of the profile applies, px. Default: 0.

    Example:
        >>> field = matcam.camera.LensField((500.0, 400.0), 640.0, matcam.camera.Coefficient(0.01, 0.001))
        >>> column, row = field.seen_at(1000.0, 400.0)
        >>> round(float(column), 3), round(float(field.true_position(column, row)[0]), 6)
        (1003.052, 1000.0)
    """

    centre: tuple[float, float]
    unit: float
    k1: Coefficient = _NONE
    k2: Coefficient = _NONE
    growth: Coefficient = _NONE
    holds_at: float = 0.0

    def __post_init__(self) -> None:
        if checks.number("centre_px", self.centre).shape != (2,):
            raise ArgumentError(f"centre_px must be (column, row), got {self.centre!r:.60}")
        checks.scalar("unit_px", checks.within("unit_px", self.unit, 0, np.inf, "px", open_low=True, open_high=True))
        checks.scalar("holds_at_px", checks.within("holds_at_px", self.holds_at, 0, np.inf, "px", open_high=True))
        for name in ("k1", "k2", "growth"):
            if checks.plain_array(name, given := getattr(self, name)).shape != (2,):
                raise ArgumentError(f"{name} must be (value, standard deviation), got {given!r:.60}")
            value, std = given
            checks.within(name, value, -0.5, 0.5)
            checks.within(f"standard deviation of {name}", std, 0, np.inf, open_high=True)
            object.__setattr__(self, name, Coefficient(value, std))
        rho2 = np.linspace(0, 1.5, 30)
        if np.any(1 + 3 * self.k1.value * rho2 + 5 * self.k2.value * rho2**2 <= 0.1):
            raise ArgumentError(
                "the distortion is not monotonic: the derivative of rho (1 + k1 rho^2 + k2 rho^4) must exceed 0.1 up to "
                "rho = 1.2, where rho is the distance from the centre divided by unit_px: give smaller coefficients k1 and k2"
            )

    def wider(self, factor: float) -> LensField:
        """Build a field with a larger uncertainty of the distortion.

        Args:
            factor: factor of the standard deviation of k1, no unit.
        """
        return replace(self, k1=Coefficient(self.k1.value, self.k1.std * factor))

    def seen_at(self, column: ArrayLike, row: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Map undistorted positions to distorted ones, px.

        Args:
            column: undistorted column, px; broadcasts with row.
            row: undistorted row, px.
        """
        x, y, rho2 = self._from_centre(column, row)
        scale = 1 + self.k1.value * rho2 + self.k2.value * rho2**2
        return self.centre[0] + x * scale, self.centre[1] + y * scale

    def true_position(self, column: ArrayLike, row: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Map distorted positions to undistorted ones, px.

        Args:
            column: distorted column, px; broadcasts with row. Beyond 1.5 units from the centre, the ratio of
                undistorted to distorted distance at 1.5 units is used.
            row: distorted row, px.
        """
        x, y, seen2 = self._from_centre(column, row)
        seen = np.minimum(np.sqrt(seen2), 1.5)
        rho = seen.copy()
        for _ in range(20):  # Newton steps
            rho2 = rho**2
            off = rho * (1 + self.k1.value * rho2 + self.k2.value * rho2**2) - seen
            rho -= off / (1 + 3 * self.k1.value * rho2 + 5 * self.k2.value * rho2**2)
            if np.all(np.abs(off) < 1e-13):
                break
        scale = np.where(seen > 0, rho / np.where(seen > 0, seen, 1.0), 1.0)
        return self.centre[0] + x * scale, self.centre[1] + y * scale

    def stretch(self, column: float, row: float) -> np.ndarray:
        """Compute the derivatives of distorted with respect to undistorted positions, (2, 2).

        Args:
            column: undistorted column, px.
            row: undistorted row, px.
        """
        x, y, rho2 = self._from_centre(column, row)
        scale = 1 + self.k1.value * rho2 + self.k2.value * rho2**2
        growing = 2 * (self.k1.value + 2 * self.k2.value * rho2) / self.unit**2
        return np.asarray(scale * np.eye(2) + growing * np.outer([x, y], [x, y]))

    def blur_scale(self, column: float, row: float) -> float:
        """Compute the relative width of the blur at a position, no unit.

        The result is limited to [0.2, 5].

        Args:
            column: undistorted column, px.
            row: undistorted row, px.
        """
        return float(np.clip(1 + self.growth.value * self.beyond(column, row), 0.2, 5.0))

    def beyond(self, column: float, row: float) -> float:
        """Compute rho^2 - rho0^2 of a position, no unit.

        Args:
            column: undistorted column, px.
            row: undistorted row, px.
        """
        return float(self._from_centre(column, row)[2] - (self.holds_at / self.unit) ** 2)

    def seen_circle(self, column: float, row: float, radius: float) -> tuple[float, float, float]:
        """Compute the distorted image of a circle: centre and radius, px.

        Args:
            column: undistorted column of the centre, px.
            row: undistorted row of the centre, px.
            radius: undistorted radius, px.
        """
        return _circle_through(*self.seen_at(*_on_circle(column, row, radius)))

    def true_circle(self, column: float, row: float, radius: float) -> tuple[float, float, float]:
        """Compute a circle from its distorted image: centre and radius, px.

        Args:
            column: distorted column of the centre, px.
            row: distorted row of the centre, px.
            radius: distorted radius, px.
        """
        return _circle_through(*self.true_position(*_on_circle(column, row, radius)))

    def _from_centre(self, column: ArrayLike, row: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y = np.asarray(column, float) - self.centre[0], np.asarray(row, float) - self.centre[1]
        return x, y, (x**2 + y**2) / self.unit**2


def _on_circle(column: float, row: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    turn = 2 * np.pi * np.arange(72) / 72
    return column + radius * np.cos(turn), row + radius * np.sin(turn)


def _circle_through(column: np.ndarray, row: np.ndarray) -> tuple[float, float, float]:
    """Fit a circle by least squares to positions at nearly equal azimuths."""
    terms = np.column_stack([column, row, np.ones_like(column)])
    a, b, c = np.linalg.lstsq(terms, column**2 + row**2, rcond=None)[0]
    return float(a / 2), float(b / 2), float(np.sqrt(c + (a**2 + b**2) / 4))
