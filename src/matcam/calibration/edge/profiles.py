"""Lens models, and their edge profiles for the fit: edge response E, slope and derivatives, averaged over bins.

The edge response is that of the camera model. Gaussian lenses have closed forms. For other lenses, the edge response is
computed by a fast Fourier transform of the total MTF, and interpolated at the bins.

`Separable` is a lens combined with a pixel of unknown size: diffraction x Gaussian core x square pixel (docs/model.md
7). Core and pixel can only be distinguished by the shape of their transforms, that is, by the fourth cumulant of the
pixel, -2 (half width)^4 / 15. A core that is not exactly Gaussian would bias the estimate of the pixel. Therefore the
core may have an excess kurtosis, with a prior centred on 0. The uncertainties of core and pixel include the uncertainty
of the kurtosis.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import lru_cache, partial
from typing import TYPE_CHECKING, ClassVar

from matcam.calibration.edge.geometry import EdgeCells
from matcam.calibration.edge.maximum_likelihood import Profile
from matcam.camera.kernel import edge_and_slopes, transfer_along
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

_PERIOD = 512
"""Period of the tabulated edge response, px. The periodic continuation of a 1/d^2 tail then adds 1e-6 of the step."""
_PER_PX = 16
"""Number of samples of the tabulated edge response per px. Cubic interpolation between the samples is then accurate."""
KURTOSIS = 0.02
"""Prior standard deviation of the excess kurtosis of the core of `Separable`. Cores of lenses are nearly Gaussian."""


class LensModel(Module):
    """Lens model with unbounded fit parameters, such as logarithms of positive quantities.

    Attributes:
        name: name of the model, as in `edge_mtf`.
        names: names of the parameters in the camera profile, such as "optics.sigma_px".
        longest: largest step of each parameter in the fit.
    """

    name: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    longest: ClassVar[tuple[float, ...]]

    @abstractmethod
    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Compute initial parameters (k,) from the width of a Gaussian lens. `log_sigma`: ln of the width in px."""

    @abstractmethod
    def optics(self, parameters: jax.Array) -> Optics:
        """Create the optics with fitted parameters (k,)."""

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Convert the parameters (k,), which are logarithms unless a lens defines others, to the units of their names."""
        return xp.exp(parameters)

    def profile(self, angle: jax.Array, half_width: jax.Array) -> Profile:
        """Create the edge profile of the lens.

        `angle`: angle between the edge normal and the grid, rad. `half_width`: half width of the pixel, px.
        """
        return partial(self.response, angle=angle, half_width=half_width)

    def response(
        self, cells: EdgeCells, parameters: jax.Array, angle: jax.Array, half_width: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Evaluate E, dE/dd and dE/dparameters by interpolation in a table over one period."""
        count = _PERIOD * _PER_PX
        f = xp.arange(count // 2 + 1) / _PERIOD

        def table(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Tabulate E minus its linear ramp, and dE/dd, at steps of 1/16 px."""
            total = self.mtf(parameters, f, angle, half_width)
            line = fft.irfft(total, count) * _PER_PX
            wave = xp.where(f > 0, total / (2j * xp.pi * xp.where(f > 0, f, 1.0)), 0.0)
            return fft.irfft(wave, count) * _PER_PX, line

        half = xp.sqrt(cells.spread)
        # The period of the table ends at this distance. Beyond it, the response is assumed to be constant.
        distance = xp.clip(cells.distance, -_PERIOD / 2, _PERIOD / 2)
        position = xp.stack([distance - half, distance + half]) * _PER_PX
        left = xp.floor(position).astype(int)
        t = position - left
        left, right = left % count, (left + 1) % count

        def over_cells(values: jax.Array, slopes: jax.Array) -> jax.Array:
            slopes = slopes / _PER_PX
            a, b = values[left], values[right]
            cubic = a + (b - a) * t**2 * (3 - 2 * t) + t * (1 - t) * (slopes[left] * (1 - t) - slopes[right] * t)
            return cubic.mean(0)

        (edge, line), (edge_by, line_by) = table(parameters), jacobian(table, parameters)
        ramp = 0.5 + distance / _PERIOD
        level = line - 1 / _PERIOD
        slope = (line[left] * (1 - t) + line[right] * t).mean(0)
        by = xp.stack([over_cells(edge_by[..., k], line_by[..., k]) for k in range(parameters.size)])
        return ramp + over_cells(edge, level), slope, by

    def mtf(self, parameters: jax.Array, f: jax.Array, angle: jax.Array, half_width: jax.Array) -> jax.Array:
        """Compute the signed total MTF at f cycles/px."""
        return transfer_along(self.optics(parameters), BoxPixel(half_width), f, angle)


class Gaussian(LensModel):
    """Gaussian optics. Parameter: ln of the standard deviation sigma in px."""

    name: ClassVar[str] = "gaussian"
    names: ClassVar[tuple[str, ...]] = ("optics.sigma_px",)
    longest: ClassVar[tuple[float, ...]] = (0.7,)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        return log_sigma[None]

    def optics(self, parameters: jax.Array) -> Optics:
        return GaussianOptics(xp.exp(parameters[0]))

    def response(
        self, cells: EdgeCells, parameters: jax.Array, angle: jax.Array, half_width: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Evaluate E, dE/dd and dE/dparameters in closed form.

        The variance of the distances in a bin acts as an additional Gaussian blur.
        """
        edge, line, by_log = _gaussian_edge(cells, angle, half_width, parameters[0])
        return edge, line, by_log[None]


class GaussianWithHalo(LensModel):
    """Gaussian core with veiling glare.

    Parameters: ln of the standard deviation sigma of the core in px, share of the light in glare, ln of the standard
    deviation of the glare in px.
    """

    name: ClassVar[str] = "halo"
    names: ClassVar[tuple[str, ...]] = ("optics.core.sigma_px", "optics.fraction", "optics.radius_px")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.03, 0.3)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Compute initial parameters with little glare, which is much wider than the core."""
        return xp.stack([log_sigma - 0.03, xp.asarray(0.03), xp.maximum(log_sigma + 1.5, xp.log(12.0))])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        return xp.stack([xp.exp(parameters[0]), parameters[1], xp.exp(parameters[2])])

    def optics(self, parameters: jax.Array) -> Optics:
        sigma, fraction, radius = self.numbers(parameters)
        return HaloOptics(GaussianOptics(sigma), fraction, radius)

    def response(
        self, cells: EdgeCells, parameters: jax.Array, angle: jax.Array, half_width: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        core, halo = (_gaussian_edge(cells, angle, half_width, parameters[k]) for k in (0, 2))
        fraction = parameters[1]
        edge, line = ((1 - fraction) * c + fraction * h for c, h in zip(core[:2], halo[:2], strict=True))
        return edge, line, xp.stack([(1 - fraction) * core[2], halo[0] - core[0], fraction * halo[2]])


class Diffraction(LensModel):
    """Diffraction-limited lens with a fitted f-number. Parameter: ln of the f-number."""

    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "diffraction"
    names: ClassVar[tuple[str, ...]] = ("optics.f_number",)
    longest: ClassVar[tuple[float, ...]] = (0.5,)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Compute ln of the f-number whose Airy pattern is as wide as the Gaussian: sigma = 0.45 wavelength f_number."""
        return (log_sigma - xp.log(0.45 * self.wavelength / self.pixel_pitch))[None]

    def optics(self, parameters: jax.Array) -> Optics:
        return DiffractionOptics(xp.exp(parameters[0]), self.wavelength, self.pixel_pitch)


class Defocus(LensModel):
    """Lens with fitted diffraction and defocus. Parameters: ln of the f-number, diameter of the blur circle in px."""

    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "defocus"
    names: ClassVar[tuple[str, ...]] = ("optics.f_number", "optics.blur_diameter_px")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.5)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Compute initial parameters that assign half of the variance to diffraction and half to defocus.

        A disc of diameter c has the standard deviation c / 4.
        """
        sigma = xp.exp(log_sigma) / xp.sqrt(2.0)
        return xp.stack([xp.log(sigma) - xp.log(0.45 * self.wavelength / self.pixel_pitch), 4 * sigma])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        """Compute the f-number and the blur diameter (px). The sign of the fitted diameter has no effect."""
        return xp.stack([xp.exp(parameters[0]), xp.abs(parameters[1])])

    def optics(self, parameters: jax.Array) -> Optics:
        f_number, blur = self.numbers(parameters)
        return DefocusOptics(f_number, self.wavelength, self.pixel_pitch, blur)


class Separable(LensModel):
    """Product of diffraction, Gaussian core and square pixel.

    Parameters: ln of the combined standard deviation of core and pixel (px), which every edge determines well; half
    width of the pixel (px); excess kurtosis of the core.

    Attributes:
        f_number: f-number of the lens during the exposure; 0 to neglect diffraction.
        wavelength: wavelength, m.
        pixel_pitch: pixel pitch, m.
    """

    f_number: jax.Array
    wavelength: jax.Array
    pixel_pitch: jax.Array

    name: ClassVar[str] = "separable"
    names: ClassVar[tuple[str, ...]] = ("optics.sigma_px", "pixel.half_width_px", "kurtosis")
    longest: ClassVar[tuple[float, ...]] = (0.3, 0.08, 0.05)

    def start(self, log_sigma: jax.Array) -> jax.Array:
        """Compute initial parameters of a Gaussian core and a pixel that is sensitive over nearly its whole area."""
        half = xp.full_like(log_sigma, 0.42)
        return xp.stack([xp.log(xp.exp(2 * log_sigma) + half**2 / 3) / 2, half, xp.zeros_like(half)])

    def numbers(self, parameters: jax.Array) -> jax.Array:
        return changed(parameters, 0, xp.sqrt(_variance(parameters)))

    def optics(self, parameters: jax.Array) -> Optics:
        """Create Gaussian optics of the core, without diffraction."""
        return GaussianOptics(xp.sqrt(_variance(parameters)))

    def mtf(self, parameters: jax.Array, f: jax.Array, angle: jax.Array, half_width: jax.Array) -> jax.Array:
        """Compute the signed total MTF at f cycles/px.

        The half width of the pixel is a fitted parameter; the argument `half_width` is ignored.
        """
        s2 = (2 * xp.pi * f) ** 2 * _variance(parameters)
        # First term of the Gram-Charlier series. A fourth cumulant in the exponent would be unbounded.
        core = xp.exp(-s2 / 2) * (1 + parameters[2] * s2**2 / 24)
        there = self.f_number > 0
        lens = DiffractionOptics(xp.where(there, self.f_number, 1.0), self.wavelength, self.pixel_pitch)
        pixel = BoxPixel(parameters[1])
        box = pixel.mtf(f * xp.cos(angle)) * pixel.mtf(f * xp.sin(angle))
        return core * xp.where(there, lens.mtf(f), 1.0) * box


def check_light(wavelength: float | None, pixel_pitch: float | None) -> None:
    if wavelength is not None:
        checks.within("wavelength", wavelength, 1e-9, 1e-3, "m (550 nm is 550e-9)")
    if pixel_pitch is not None:
        checks.within("pixel_pitch", pixel_pitch, 1e-8, 1e-2, "m (5 um is 5e-6)")


@lru_cache
def lens_model(name: str, wavelength: float | None, pixel_pitch: float | None) -> LensModel:
    """Create a lens model. `name`: name in `PARAMETRIC_LENSES`. `wavelength`, `pixel_pitch`: m."""
    if name == "gaussian":
        return Gaussian()
    if name == "halo":
        return GaussianWithHalo()
    family = {"diffraction": Diffraction, "defocus": Defocus}[name]
    return family(xp.asarray(wavelength, float), xp.asarray(pixel_pitch, float))


def _gaussian_edge(
    cells: EdgeCells, angle: jax.Array, half_width: jax.Array, log_sigma: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    sigma = xp.exp(log_sigma)
    wide = xp.sqrt(sigma**2 + cells.spread)
    edge, line, by_wide = edge_and_slopes(cells.distance, angle, half_width, wide)
    return edge, line, by_wide * sigma**2 / wide


def _variance(parameters: jax.Array) -> jax.Array:
    """Compute the variance of the core, px^2.

    It is the total variance minus that of the pixel, which is half_width^2 / 3 in all directions.
    """
    # The smallest standard deviation, 0.05 px, keeps the variance of the core positive.
    return xp.maximum(xp.exp(2 * parameters[0]) - parameters[1] ** 2 / 3, 0.05**2)
