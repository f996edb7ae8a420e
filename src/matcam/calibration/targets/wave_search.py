"""Search for printed waves (stars and gratings) in a region of an image, and their phase at every pixel.

Under perspective, lines through the centre of a star remain lines, and the brightness only changes across them. At the
centre of the star, all lines along which the brightness is constant meet. The number of cycles is the number of phase
revolutions along a ring, which perspective does not change. The effect of perspective on the azimuth is exactly a linear
map. Lens distortion adds a smooth displacement. Its second and third order are modelled.

A grating is the strongest peak of the spectrum of the region. Its phase is a polynomial of the position.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from matcam.calibration.photograph.linear_image import local_mean, smoothed
from matcam.calibration.targets.wave_fit import wrapped
from matcam.core.arrays import FloatArray
from matcam.core.errors import FitError
from matcam.numerics.polynomials import plane_orders, plane_powers

MARGIN = 4.0
"""Distance from the border of a grating or star within which blur mixes it with its surroundings, px."""
_LONGEST = 2.0
"""Smallest number of periods in a region."""


class StarPhase(NamedTuple):
    """Phase of a star at pixels.

    Its 14 parameters are the centre (2), the phase at azimuth 0 (1), a linear map (2), and displacements of second (4)
    and third (5) order across the rays, rad of phase at the outer radius.

    Attributes:
        cycles: number of cycles.
        outer: outer radius, px.
    """

    cycles: int
    outer: float

    @property
    def scale(self) -> FloatArray:
        return np.array([self.outer / self.cycles / 2] * 2 + [1.0] + [1 / self.cycles] * 2 + [1.0] * 9)

    def at(self, parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        x0, y0, turn, e1, e2 = parameters[:5]
        u, v = (x - x0) / self.outer, (y - y0) / self.outer
        azimuth = np.arctan2((1 - e1) * v + e2 * u, (1 + e1) * u + e2 * v)
        c, q = parameters[5:9], parameters[9:]
        uu, uv, vv = u * u, u * v, v * v  # general powers are slow
        square = np.maximum(uu + vv, 1e-12)
        displacement = uu * (c[0] * u + c[1] * v + q[0] * uu + q[1] * uv) + q[2] * uv * uv
        displacement += vv * (c[2] * u + c[3] * v + q[3] * uv + q[4] * vv)
        return self.cycles * azimuth + turn + displacement / square

    def parameters_through(
        self,
        x: FloatArray,
        y: FloatArray,
        phase: FloatArray,
        centre: tuple[float, float],
        shape: tuple[float, float] = (0.0, 0.0),
    ) -> FloatArray:
        """Fit the parameters to known phases at pixel positions.

        `phase`: (n,) phases modulo 2 pi, rad. `centre`: initial centre, px. `shape`: initial linear map, without which the
        fit may fail for a tilted star with many cycles.
        """
        size = self.scale

        def residual(p: FloatArray) -> FloatArray:
            return wrapped(self.at(p * size, x, y) - phase)

        start = np.zeros(size.size)
        start[:2] = np.array(centre) / size[:2]
        start[3:5] = np.array(shape) / size[3:5]
        start[2] = np.angle(np.exp(1j * (phase - self.at(start * size, x, y))).mean())
        return least_squares(residual, start, x_scale=1.0).x * size


class FoundStar(NamedTuple):
    """Star found in an image.

    Attributes:
        phase: phase model with the number of cycles and the outer radius, px.
        parameters: (14,) parameters of `phase`.
        inner: radius beyond which the region contains only the star, px.
    """

    phase: StarPhase
    parameters: FloatArray
    inner: float


def find_star(values: FloatArray, cycles: int | None = None) -> FoundStar:
    """Find the star in a region.

    `values`: (height, width), NaN for missing pixels. `cycles`: number of cycles; None to count the cycles. A FitError
    is raised if there is no star.
    """
    filled = smoothed(values)
    centre = _centre(filled)
    rings = _rings(filled, centre)
    if not rings:
        raise FitError("the region contains no Siemens star: no ring shows a regular wave; give a region of one star")
    votes = np.bincount([max(ring.cycles, 0) for ring in rings], [ring.share for ring in rings])
    winner = int(votes.argmax()) if cycles is None else cycles
    agreeing = [ring for ring in rings if ring.cycles == winner]
    if len(agreeing) < 4 or winner < 8:
        raise FitError(
            f"the region contains no Siemens star{f' of {cycles} cycles' if cycles else ''}: "
            f"{len(agreeing)} of {len(rings)} rings with a regular wave have {winner} cycles, but at least 4 rings must have "
            "the same number of cycles, 8 or more; give a region of one star"
        )
    # Beyond the rim, the amplitude of the wave on a ring is small.
    strong = 0.8 * float(np.median([ring.amplitude for ring in agreeing[len(agreeing) // 2 :]]))
    outer = max(ring.radius for ring in agreeing if ring.amplitude > strong)
    agreeing = [ring for ring in agreeing if ring.radius <= outer]
    x, y, phase = (np.concatenate([np.asarray(getattr(ring, n)) for ring in agreeing]) for n in ("x", "y", "phase"))
    wave = StarPhase(winner, outer)
    return FoundStar(wave, wave.parameters_through(x, y, phase, centre), agreeing[0].radius)


class _Ring(NamedTuple):
    """Ring around the centre of a star, with the sinusoid found on the ring.

    Attributes:
        radius: radius of the ring, px.
        cycles: number of cycles of the sinusoid around the ring.
        share: share of the sinusoid in the power of the ring, no unit.
        amplitude: amplitude of the sinusoid relative to the mean of the ring, no unit.
        x: (n,) columns of positions on the ring, px.
        y: (n,) rows of these positions, px.
        phase: (n,) phase of the sinusoid at these positions, rad.
    """

    radius: float
    cycles: int
    share: float
    amplitude: float
    x: FloatArray
    y: FloatArray
    phase: FloatArray


def _centre(filled: FloatArray) -> tuple[float, float]:
    """Find the centre of a star, px: the intersection of the lines perpendicular to the gradients."""
    gy, gx = np.gradient(filled)
    y, x = np.indices(filled.shape).astype(float)
    length = np.hypot(gx, gy)
    nx, ny = gx / np.maximum(length, 1e-300), gy / np.maximum(length, 1e-300)
    strength = np.minimum(length, np.quantile(length, 0.9)) ** 2
    at = np.array([(filled.shape[1] - 1) / 2, (filled.shape[0] - 1) / 2])
    normals, found = np.stack([nx.ravel(), ny.ravel()]), (nx * x + ny * y).ravel()
    scale = max(filled.shape) / 3
    for _ in range(12):
        # Gradients of other structures (a rim, another target) get less weight.
        weight = strength.ravel() / (1 + ((found - at @ normals) / scale) ** 2) ** 2
        normal = (normals * weight) @ normals.T
        if np.linalg.det(normal) <= 1e-12 * np.trace(normal) ** 2:
            raise FitError(
                "the region contains no Siemens star: the brightness changes in one direction only; give a region of one star"
            )
        at = np.linalg.solve(normal, normals @ (weight * found))
        scale = max(scale * 0.7, 3.0)
    if not (0 <= at[0] < filled.shape[1] and 0 <= at[1] < filled.shape[0]):
        raise FitError(
            "the region contains no Siemens star: the rays do not meet inside the region; give a region of one star"
        )
    return float(at[0]), float(at[1])


def _rings(filled: FloatArray, centre: tuple[float, float]) -> list[_Ring]:
    height, width = filled.shape
    most = min(centre[0], centre[1], width - 1 - centre[0], height - 1 - centre[1])
    found = []
    for radius in np.arange(6.0, most, max(1.0, most / 80)):
        count = 2 * int(2 * np.pi * radius)  # about four samples per px
        turn = 2 * np.pi * np.arange(count) / count
        x, y = centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn)
        spectrum = np.fft.rfft(ndimage.map_coordinates(filled, [y, x], order=1))
        power = np.abs(spectrum) ** 2
        # The phase is computed on rings whose wave has a frequency of 0.03 to 0.3 cycles/px.
        low, high = max(6, int(0.03 * 2 * np.pi * radius)), int(0.3 * 2 * np.pi * radius) + 1
        if high - low < 3:
            continue
        peak = low + int(np.argmax(power[low:high]))
        # Perspective widens the spectrum of the wave on a ring.
        spread = int(max(2, 0.35 * peak))
        near = slice(peak - spread, peak + spread + 1)
        band = np.zeros(count, complex)
        band[near] = spectrum[near]
        inside = power[near].sum()
        share = inside / power[3:].sum()
        phase = np.unwrap(np.angle(np.fft.ifft(band)))
        turns = (phase[-1] - phase[0] + np.angle(np.exp(1j * (phase[0] - phase[-1])))) / (2 * np.pi)
        # At least half of the power on a ring of the star belongs to its wave.
        if share > 0.5:
            amplitude = 2 * float(np.sqrt(inside) / max(abs(spectrum[0]), 1e-300))
            some = slice(None, None, max(1, count // (4 * peak)))
            found.append(_Ring(float(radius), round(turns), float(share), amplitude, x[some], y[some], phase[some]))
    return found


class GratingPhase(NamedTuple):
    """Phase of a grating at pixels, as a polynomial of second (6 parameters) or third (10) order in the position.

    Attributes:
        middle: (x, y) about which the phase is expanded, px.
        half_extent: half the extent of the grating, px; unit of length of the polynomial.
        order: order of the polynomial, 2 or 3.
    """

    middle: tuple[float, float]
    half_extent: float
    order: int

    @property
    def scale(self) -> FloatArray:
        return np.ones(len(plane_orders(self.order)))

    def at(self, parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._powers(x, y) @ parameters

    def parameters_through(self, x: FloatArray, y: FloatArray, phase: FloatArray) -> FloatArray:
        """Fit the parameters to known, unwrapped phases at pixel positions."""
        return np.asarray(np.linalg.lstsq(self._powers(x, y), phase, rcond=None)[0], dtype=np.float64)

    def _powers(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return plane_powers(
            (x - self.middle[0]) / self.half_extent, (y - self.middle[1]) / self.half_extent, self.order
        )


class FoundGrating(NamedTuple):
    """Grating found in an image.

    Attributes:
        phase: phase model.
        parameters: (6,) or (10,) parameters of `phase`.
        inside: (height, width) mask of the pixels that contain only the grating.
    """

    phase: GratingPhase
    parameters: FloatArray
    inside: np.ndarray

    @classmethod
    def through(cls, x: FloatArray, y: FloatArray, phase: FloatArray, inside: np.ndarray) -> FoundGrating:
        """Create the grating with known phases at given positions.

        `x`, `y`: (n,) positions, px. `phase`: (n,) unwrapped phases, rad.
        """
        extent = float(np.sqrt(inside.sum()))
        # For wide gratings, perspective and distortion require a phase of third order.
        wave = GratingPhase((float(x.mean()), float(y.mean())), extent / 2, 3 if extent > 50 else 2)
        return cls(wave, wave.parameters_through(x, y, phase), inside)


def find_grating(values: FloatArray, near: tuple[float, float] | None = None) -> FoundGrating:
    """Find the grating in a region.

    `values`: (height, width), NaN for missing pixels. A FitError is raised if there is no grating. `near`: approximate
    frequency (fx, fy), cycles/px, which may exceed the Nyquist frequency; the nearest alias is selected.
    """
    filled = values if np.isfinite(values).all() else local_mean(values, 0.9)
    frequency = _strongest(filled, near)
    if near is not None:
        shifts = np.stack(np.meshgrid([-2, -1, 0, 1, 2], [-2, -1, 0, 1, 2]), axis=-1).reshape(-1, 2)
        aliases = np.concatenate([shifts + frequency, shifts - frequency])
        frequency = aliases[np.argmin(np.hypot(*(aliases - np.array(near)).T))]
    y, x = np.indices(values.shape).astype(float)
    wave = np.exp(-2j * np.pi * (frequency[0] * x + frequency[1] * y))
    smooth = max(3.0, 0.8 / np.hypot(*_alias(frequency)))
    turned = (filled - filled.mean()) * wave
    envelope = ndimage.gaussian_filter(turned.real, smooth) + 1j * ndimage.gaussian_filter(turned.imag, smooth)
    size = np.abs(envelope)
    # Pixels of the grating have at least 75 % of the amplitude of its strongest pixels.
    label, count = ndimage.label(size > 0.75 * np.quantile(size, 0.98))
    if not count:
        raise FitError("the region contains no grating: the brightness does not vary; give a region of one grating")
    largest = 1 + int(np.argmax(ndimage.sum_labels(np.ones_like(size), label, np.arange(1, count + 1))))
    inside = ndimage.binary_erosion(
        ndimage.binary_fill_holes(label == largest), iterations=round(MARGIN), border_value=1
    )
    if inside.sum() < 256:
        raise FitError(
            "the region contains no grating: fewer than 256 connected px have a regular wave; give a region of one grating"
        )
    start = float(np.angle(envelope[inside].mean()))
    phase = start + 2 * np.pi * (frequency[0] * x + frequency[1] * y)
    return FoundGrating.through(x[inside], y[inside], phase[inside], inside)


def _alias(frequency: FloatArray) -> FloatArray:
    return frequency - np.round(frequency)


def _strongest(filled: FloatArray, near: tuple[float, float] | None) -> FloatArray:
    """Find the frequency (fx, fy) of the strongest wave below the Nyquist frequency, cycles/px.

    `near`: only aliases of frequencies near this frequency are considered.
    """
    height, width = filled.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
    mean = (window * filled).sum() / window.sum()
    # Zero padding by a factor of 4 determines the peak to a small part of a period over the region.
    power = np.abs(np.fft.rfft2(window * (filled - mean), (4 * height, 4 * width))) ** 2
    fy, fx = np.fft.fftfreq(4 * height)[:, None], np.fft.rfftfreq(4 * width)[None]
    # Borders of objects have much power at low frequencies, which this factor suppresses.
    power *= np.hypot(fx, fy)
    power[(np.abs(fx) * width < _LONGEST) & (np.abs(fy) * height < _LONGEST)] = 0
    everywhere = np.median(power)
    if near is not None:
        alias = _alias(np.array(near))
        off = [np.hypot(_alias(fx - sign * alias[0]), _alias(fy - sign * alias[1])) for sign in (-1, 1)]
        # The search range about the given frequency extends by 10 % of this frequency.
        power[np.minimum(*off) > max(0.1 * float(np.hypot(*near)), 2 * _LONGEST / min(height, width))] = 0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    # The power of a wave exceeds the median of the spectrum by a factor of 30; that of noise does not.
    if not power[row, column] > 30 * everywhere:
        raise FitError(
            "the region contains no grating: no regular wave exceeds the noise; give a region of one grating"
        )
    return np.array([fx[0, column], fy[row, 0]])
