"""Make the peak tables of EPD: `python -m matcam.forward.peaks.build_peak_tables [FILE]`, half a minute (`make tables`).

In units of the optics' sigma, with the kernel k(x) k(y) and a lobe of sizes (b c, b),

    response = 2 pi c integral of rho A(rho; c) exp(-(rho / b)^(2 p)) d rho,

where A is the kernel's mean over the ellipse (c rho cos phi, rho sin phi). A depends on neither b nor p, so one pass over phi
serves a whole plane of the table. Both integrals are trapezoid rules that converge exponentially: over ln rho, and over a
double-exponential grid in phi, which is dense where a long ellipse crosses the kernel.
"""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from matcam.core.io import replacing
from matcam.forward.peaks.peak_tables import FILE, HALF_WIDTHS, POWERS, RATIOS, SIZES

PLANE_SHAPE, LINE_SHAPE = (64, 28, 7, 11), (110, 9, 13)
"""Panels of the spline, and degrees of ln ratio, share and ln power (plus 1)."""
_OVERSAMPLING = 4  # values per panel that the spline is fitted to
_STEP = 0.05  # of ln rho
_PLACE = 2.0**-23  # of a coefficient


class TableAxes(NamedTuple):
    """The variables of a table: ln size, (ln ratio,) share, ln power.

    Attributes:
        limits: ends of their intervals, (variables, 2).
        shape: panels of the spline, and degrees (plus 1) of the polynomials.
    """

    limits: np.ndarray
    shape: tuple[int, ...]

    def panels(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the spline's knots, and the ln sizes that it is fitted to."""
        (low, high), count = self.limits[0], self.shape[0]
        knots = low + (high - low) / count * np.arange(-3, count + 4)
        return knots, np.linspace(low, high, _OVERSAMPLING * count + 1)

    def nodes(self, axis: int) -> np.ndarray:
        """Return Chebyshev's nodes of a variable."""
        low, high = self.limits[axis]
        return (low + high + (high - low) * _unit_nodes(self.shape[axis])) / 2


def build() -> dict[str, np.ndarray]:
    """Return all arrays of the file."""
    shares = np.array([h**2 / (3 + h**2) for h in HALF_WIDTHS])
    plane = TableAxes(np.stack([np.log(SIZES["plane"]), np.log(RATIOS), shares, np.log(POWERS)]), PLANE_SHAPE)
    line = TableAxes(np.stack([np.log(SIZES["line"]), shares, np.log(POWERS)]), LINE_SHAPE)
    in_plane = np.stack(
        [
            np.stack([_plane_excess(plane.panels()[1], ratio, share, plane.nodes(3)) for share in plane.nodes(2)], 1)
            for ratio in np.exp(plane.nodes(1))
        ],
        axis=1,
    )
    in_line = np.stack([_line_excess(line.panels()[1], share, line.nodes(2)) for share in line.nodes(1)], axis=1)
    return {
        "plane": _fit_coefficients(plane, in_plane),
        "plane_limits": plane.limits,
        "line": _fit_coefficients(line, in_line),
        "line_limits": line.limits,
        "error": np.array(
            "relative error of a response: 3e-5 at most in the plane, 1e-5 on the line (tests/forward/test_peak_tables.py)"
        ),
    }


def _plane_excess(ln_size: np.ndarray, ratio: float, share: float, ln_power: np.ndarray) -> np.ndarray:
    """Return G at every ln size (rows) and power (columns)."""
    from scipy.special import gammaln

    half_width = np.sqrt(3 * share / (1 - share))  # in sigma
    power = np.exp(ln_power)
    ln_b = ln_size[:, None] + np.log(1 + half_width**2 / 3) / 2 - gammaln(1 + 1 / power) / 2
    ln_rho = np.arange(ln_b.min() - 14, np.log(3e4), _STEP)
    rho = np.exp(ln_rho)
    weight = 2 * np.pi * ratio * _STEP * rho**2 * _ellipse_means(rho, ratio, half_width)
    ln_peak = np.log(_kernel(np.zeros(()), half_width))
    ln_narrow = np.log(np.pi * ratio) + 2 * ln_b + gammaln(1 + 1 / power) + 2 * ln_peak
    return _logit(ln_rho, weight, ln_b, power) - ln_narrow


def _line_excess(ln_size: np.ndarray, share: float, ln_power: np.ndarray) -> np.ndarray:
    """Return the same in one dimension."""
    from scipy.special import gammaln

    half_width = np.sqrt(3 * share / (1 - share))
    power = np.exp(ln_power)
    ln_integral = ln_size[:, None] + np.log(1 + half_width**2 / 3) / 2
    ln_b = ln_integral - gammaln(1 + 1 / (2 * power))
    ln_rho = np.arange(ln_b.min() - 28, np.log(30.0), _STEP)
    weight = 2 * _STEP * np.exp(ln_rho) * _kernel(np.exp(ln_rho), half_width)
    ln_narrow = np.log(2) + ln_integral + np.log(_kernel(np.zeros(()), half_width))
    return _logit(ln_rho, weight, ln_b, power) - ln_narrow


def _logit(ln_rho: np.ndarray, weight: np.ndarray, ln_b: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Return ln(response / (1 - response)), both without cancellation; the weights sum to 1."""
    result = np.empty_like(ln_b)
    for k, p in enumerate(power):
        exponent = np.exp(2 * p * (ln_rho - ln_b[:, k : k + 1]))
        result[:, k] = np.log(np.exp(-exponent) @ weight) - np.log(-np.expm1(-exponent) @ weight)
    return result


def _kernel(x: np.ndarray, half_width: float) -> np.ndarray:
    """Return the effective kernel in one dimension for sigma = 1 (docs/model.md 2)."""
    from scipy.special import erfc

    return (erfc((x - half_width) / np.sqrt(2)) - erfc((x + half_width) / np.sqrt(2))) / (4 * half_width)


def _ellipse_means(rho: np.ndarray, ratio: float, half_width: float) -> np.ndarray:
    """Return A at every rho."""
    t = np.linspace(-3.2, 3.2, 161)
    u = np.pi / 2 * np.sinh(t)
    # phi in (0, pi / 2), and what is left to pi / 2, without cancellation at either end
    phi, rest = (np.pi / 2 / (1 + np.exp(sign * u)) for sign in (-2, 2))
    weight = (t[1] - t[0]) * 2 * np.cosh(t) * phi * rest
    cos, sin = np.sin(rest), np.sin(phi)
    blocks = np.array_split(rho, max(1, rho.size // 100))
    mean = [
        (_kernel(ratio * r[:, None] * cos, half_width) * _kernel(r[:, None] * sin, half_width)) @ weight for r in blocks
    ]
    return np.concatenate(mean) * 2 / np.pi


def _fit_coefficients(axes: TableAxes, values: np.ndarray) -> np.ndarray:
    """Return the coefficients of the spline (least squares) and of the polynomials (interpolation).

    They are rounded to a fixed place, and float32: the spline errs a hundred times as much, and most bits are zero in the file.
    """
    from scipy.interpolate import make_lsq_spline

    knots, ln_size = axes.panels()
    coefficients = make_lsq_spline(ln_size, values, knots, k=3).c
    for axis, count in enumerate(axes.shape[1:], start=1):
        inverse = np.linalg.inv(chebvander(_unit_nodes(count), count - 1))
        coefficients = np.moveaxis(np.tensordot(inverse, coefficients, (1, axis)), 0, axis)
    return (np.round(coefficients / _PLACE) * _PLACE).astype(np.float32)


def _unit_nodes(count: int) -> np.ndarray:
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def main() -> None:
    """Write the package's file, or the one named on the command line."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(str(resources.files("matcam"))) / FILE
    with replacing(path, force=True) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **build())  # type: ignore[arg-type]
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
