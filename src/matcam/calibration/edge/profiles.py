"""Families of lenses with parameters, and their edge profiles for the fit: E, its slope and derivatives over cells.

The edges are the camera's own: closed forms for Gaussians, and for other lenses one fast Fourier transform of the total
MTF, from which cells are interpolated.

`Separable` is a lens behind a pixel of unknown size: diffraction x Gaussian core x square pixel (docs/model.md 7). Core
and pixel differ in the shape of their transforms only, a Gaussian's and a box's fourth cumulants, 2 (half width)^4 / 15
for the pixel. A lens whose core is not quite Gaussian would be fitted as another pixel. Therefore the core may have an
excess kurtosis, with a prior about 0 of a stated width; its uncertainty is part of the errors of core and pixel.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from matcam.calibration.edge.geometry import EdgeCells
from matcam.calibration.edge.maximum_likelihood import Profile
from matcam.camera.camera import Camera
from matcam.camera.kernel import edge_and_slopes
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.halo import HaloOptics
from matcam.camera.optics.optics import Optics
from matcam.camera.optics.pupil import DefocusOptics, DiffractionOptics
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.arrays import changed, fft, jacobian, xp
from matcam.core.arrays.module import Module

if TYPE_CHECKING:
    from matcam.core.jax import jax

_PERIOD = 512  # px: period of the table; a 1/d^2 tail then adds 1e-6 of the step
_PER_PX = 16
_NARROWEST = 0.05  # px: smallest standard deviation of a separable core
KURTOSIS = 0.02
"""Standard deviation of the prior for the excess kurtosis of the core about 0."""


class LensModel(Module):
    """Family of lenses, whose fitted parameters have forms that need no bounds.

    Attributes:
        name: the family's name, as `edge_mtf` takes it.
        names: the parameters' names, as the camera's profile has them: "optics.sigma_px".
        longest: longest step of each parameter.
    """

    name: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    longest: ClassVar[tuple[float, ...]]

    @abstractmethod
    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return the parameters (k,) near a Gaussian lens of ln sigma px."""

    @abstractmethod
    def optics(self, parameters: jax.Array) -> Optics:
        """Return the lens."""

    @abstractmethod
    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return the parameters (k,) in the units of their names."""

    def profile(self, angle: jax.Array, half_width: jax.Array) -> Profile:
        """Return the edge profile at an angle to the grid."""
        return lambda cells, parameters: _tabulated(self, angle, half_width, cells, parameters)

    def mtf(self, parameters: jax.Array, f: jax.Array, angle: jax.Array, half_width: jax.Array) -> jax.Array:
        """Return the total MTF at f cycles/px, signed."""
        return Camera(self.optics(parameters), BoxPixel(half_width)).mtf(f, angle)


class LensAtEdge(NamedTuple):
    """Family of lenses as one edge sees it.

    Attributes:
        lens: the family.
        angle: rad, of the edge's normal to the grid.
        half_width: px, of the pixel.
    """

    lens: LensModel
    angle: jax.Array
    half_width: jax.Array

    @property
    def profile(self) -> Profile:
        """Return the edge profile."""
        return self.lens.profile(self.angle, self.half_width)

    def mtf(self, parameters: jax.Array, f: jax.Array) -> jax.Array:
        """Return the total MTF at f cycles/px, signed."""
        return self.lens.mtf(parameters, f, self.angle, self.half_width)


class Gaussian(LensModel):
    """Gaussian optics. Parameter: ln sigma."""

    name: ClassVar[str] = "gaussian"
    names: ClassVar[tuple[str, ...]] = ("optics.sigma_px",)
    longest: ClassVar[tuple[float, ...]] = (0.7,)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return ln sigma itself."""
        return log_sigma[None]

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return sigma, px."""
        return xp.exp(parameters)

    def optics(self, parameters: jax.Array) -> Optics:
        """Return `GaussianOptics`."""
        return GaussianOptics(xp.exp(parameters[0]))

    def profile(self, angle: jax.Array, half_width: jax.Array) -> Profile:
        """Return a closed form.

        The spread of a cell is exactly one more Gaussian blur.
        """

        def profile(cells: EdgeCells, parameters: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            edge, line, by_log = _gaussian_edge(cells, angle, half_width, parameters[0])
            return edge, line, by_log[None]

        return profile


class GaussianWithHalo(LensModel):
    """Gaussian core and veiling glare.

    Parameters: ln sigma, fraction, ln radius.
    """

    name: ClassVar[str] = "halo"
    names: ClassVar[tuple[str, ...]] = ("optics.core.sigma_px", "optics.fraction", "optics.radius_px")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.03, 0.3)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return a start with little glare, far wider than the core."""
        return xp.stack([log_sigma - 0.03, xp.asarray(0.03), xp.maximum(log_sigma + 1.5, xp.log(12.0))])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return sigma px, fraction, radius px."""
        return xp.stack([xp.exp(parameters[0]), parameters[1], xp.exp(parameters[2])])

    def optics(self, parameters: jax.Array) -> Optics:
        """Return `HaloOptics` around `GaussianOptics`."""
        sigma, fraction, radius = self.numbers(parameters)
        return HaloOptics(GaussianOptics(sigma), fraction, radius)

    def profile(self, angle: jax.Array, half_width: jax.Array) -> Profile:
        """Return a closed form."""

        def profile(cells: EdgeCells, parameters: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            core = _gaussian_edge(cells, angle, half_width, parameters[0])
            halo = _gaussian_edge(cells, angle, half_width, parameters[2])
            fraction = parameters[1]
            edge, line = ((1 - fraction) * c + fraction * h for c, h in zip(core[:2], halo[:2], strict=True))
            return edge, line, xp.stack([(1 - fraction) * core[2], halo[0] - core[0], fraction * halo[2]])

        return profile


class Diffraction(LensModel):
    """Diffraction-limited lens with a fitted f-number. Parameter: ln f_number."""

    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "diffraction"
    names: ClassVar[tuple[str, ...]] = ("optics.f_number",)
    longest: ClassVar[tuple[float, ...]] = (0.5,)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return the Airy pattern with the same core width.

        Its sigma is 0.45 wavelength f_number.
        """
        return (log_sigma - xp.log(0.45 * self.wavelength / self.pixel_pitch))[None]

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return the f-number."""
        return xp.exp(parameters)

    def optics(self, parameters: jax.Array) -> Optics:
        """Return `DiffractionOptics`."""
        return DiffractionOptics(xp.exp(parameters[0]), self.wavelength, self.pixel_pitch)


class Defocus(LensModel):
    """Diffraction and defocus, both fitted. Parameters: ln f_number, blur_diameter."""

    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "defocus"
    names: ClassVar[tuple[str, ...]] = ("optics.f_number", "optics.blur_diameter_px")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.5)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return half of the variance of the blur for each.

        A disc of diameter c has the variance of a Gaussian of c / 4.
        """
        sigma = xp.exp(log_sigma) / xp.sqrt(2.0)
        return xp.stack([xp.log(sigma) - xp.log(0.45 * self.wavelength / self.pixel_pitch), 4 * sigma])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return f-number and blur_diameter in px (its sign has no meaning)."""
        return xp.stack([xp.exp(parameters[0]), xp.abs(parameters[1])])

    def optics(self, parameters: jax.Array) -> Optics:
        """Return `DefocusOptics`."""
        f_number, blur = self.numbers(parameters)
        return DefocusOptics(f_number, self.wavelength, self.pixel_pitch, blur)


class Separable(LensModel):
    """Diffraction x Gaussian core x square pixel.

    Parameters: ln of the standard deviation of core and pixel together (px), which every edge determines well; half
    width of the pixel (px); excess kurtosis of the core.

    Attributes:
        f_number: of the picture; 0: no diffraction.
        wavelength: m.
        pixel_pitch: m.
    """

    f_number: jax.Array
    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "separable"
    names: ClassVar[tuple[str, ...]] = ("optics.sigma_px", "pixel.half_width_px", "kurtosis")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.08, 0.05)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Return a pixel of nearly full width, and a Gaussian core."""
        half = xp.full_like(log_sigma, 0.42)
        return xp.stack([xp.log(xp.exp(2 * log_sigma) + half**2 / 3) / 2, half, xp.zeros_like(half)])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Return sigma px, half width px, kurtosis."""
        return changed(parameters, 0, xp.sqrt(_variance(parameters)))

    def optics(self, parameters: jax.Array) -> Optics:
        """Return the core alone, as a Gaussian."""
        return GaussianOptics(xp.sqrt(_variance(parameters)))

    def mtf(self, parameters: jax.Array, f: jax.Array, angle: jax.Array, half_width: jax.Array) -> jax.Array:
        """Return the total MTF at f cycles/px, signed.

        The half width is the fitted one, not the argument.
        """
        s2 = (2 * xp.pi * f) ** 2 * _variance(parameters)
        # Gram and Charlier's first term; a fourth cumulant in the exponent would grow without bound
        core = xp.exp(-s2 / 2) * (1 + parameters[2] * s2**2 / 24)
        there = self.f_number > 0
        lens = DiffractionOptics(xp.where(there, self.f_number, 1.0), self.wavelength, self.pixel_pitch)
        pixel = BoxPixel(parameters[1])
        box = pixel.mtf(f * xp.cos(angle)) * pixel.mtf(f * xp.sin(angle))
        return core * xp.where(there, lens.mtf(f), 1.0) * box


def check_light(wavelength: float | None, pixel_pitch: float | None) -> None:
    """Raise ArgumentError for a wavelength or a pitch that no camera has, m."""
    if wavelength is not None:
        checks.within("wavelength", wavelength, 1e-9, 1e-3, "m (550 nm is 550e-9)")
    if pixel_pitch is not None:
        checks.within("pixel_pitch", pixel_pitch, 1e-8, 1e-2, "m (5 um is 5e-6)")


@lru_cache
def lens_model(name: str, wavelength: float | None, pixel_pitch: float | None) -> LensModel:
    """Return the family of one of `PARAMETRIC_LENSES`."""
    if name == "gaussian":
        return Gaussian()
    if name == "halo":
        return GaussianWithHalo()
    family = {"diffraction": Diffraction, "defocus": Defocus}[name]
    return family(xp.asarray(wavelength, float), xp.asarray(pixel_pitch, float))


def _gaussian_edge(
    cells: EdgeCells, angle: jax.Array, half_width: jax.Array, log_sigma: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return E, dE/dd and dE/dln(sigma) of a Gaussian lens."""
    sigma = xp.exp(log_sigma)
    wide = xp.sqrt(sigma**2 + cells.spread)
    edge, line, by_wide = edge_and_slopes(cells.distance, angle, half_width, wide)
    return edge, line, by_wide * sigma**2 / wide


def _tabulated(
    lens: LensModel, angle: jax.Array, half_width: jax.Array, cells: EdgeCells, parameters: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return E, dE/dd and dE/dparameters of any lens.

    They come from one table over a period.
    """
    count = _PERIOD * _PER_PX
    f = xp.arange(count // 2 + 1) / _PERIOD

    def table(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return E less its ramp, and dE/dd, every sixteenth px."""
        total = lens.mtf(parameters, f, angle, half_width)
        line = fft.irfft(total, count) * _PER_PX
        wave = xp.where(f > 0, total / (2j * xp.pi * xp.where(f > 0, f, 1.0)), 0.0)
        return fft.irfft(wave, count) * _PER_PX, line

    half = xp.sqrt(cells.spread)
    position = xp.stack([cells.distance - half, cells.distance + half]) * _PER_PX
    left = xp.floor(position).astype(int)
    t = position - left
    left, right = left % count, (left + 1) % count

    def over_cells(values: jax.Array, slopes: jax.Array) -> jax.Array:
        """Return the mean over the cell's two points, by cubic Hermite interpolation."""
        slopes = slopes / _PER_PX
        a, b = values[left], values[right]
        cubic = a + (b - a) * t**2 * (3 - 2 * t) + t * (1 - t) * (slopes[left] * (1 - t) - slopes[right] * t)
        return cubic.mean(0)

    (edge, line), (edge_by, line_by) = table(parameters), jacobian(table, parameters)
    ramp = 0.5 + cells.distance / _PERIOD
    level = line - 1 / _PERIOD
    slope = (line[left] * (1 - t) + line[right] * t).mean(0)
    by = xp.stack([over_cells(edge_by[..., k], line_by[..., k]) for k in range(parameters.size)])
    return ramp + over_cells(edge, level), slope, by


def _variance(parameters: jax.Array) -> jax.Array:
    """Return the variance of the core, px^2.

    That of a square along any direction is a third of the square of its half width.
    """
    return xp.maximum(xp.exp(2 * parameters[0]) - parameters[1] ** 2 / 3, _NARROWEST**2)
