"""The search for printed waves, stars and gratings, in a region of an image, and the phase of each at every pixel.

Lines through a star's centre stay lines in any pinhole's image, so brightness changes across them only. The centre is where
the pixels' gradients are all at right angles to the way there. The number of cycles is how often the phase turns along a ring,
whatever perspective does to its speed. Perspective changes the azimuth by a linear map exactly. A lens's distortion adds a
smooth displacement, of which second and third order are kept.

A grating is the strongest peak of the region's spectrum. Its phase is a polynomial of the position.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from matcam.calibration.photograph.linear_image import local_mean, smoothed
from matcam.core.arrays import FloatArray
from matcam.core.errors import FitError
from matcam.numerics.polynomials import plane_orders, plane_powers

MARGIN = 4.0  # px: pixels nearer than this to the border of a grating are affected by its surroundings
_ROUNDS = 12
_CLEAR_IN_RING = 0.5  # share of the power on a ring that its wave must have
_KEPT = 0.8  # relative to the median amplitude of the outer rings
_BAND = 0.35  # share of the cycles: spread of the wave on a ring by perspective
_FINE = 4  # samples of a ring per px
_LOW = (0.03, 0.3)  # cycles/px: rings on which the phase is computed
_WIDE = 50.0  # px: above, perspective and distortion need third order
_UNIT = 100.0  # px of the polynomial of the phase
_CLEAR_IN_SPECTRUM = 30.0  # power of the wave over the median of the spectrum
_ENVELOPE = 0.75  # relative to the median maximum of the amplitude
_NEAR = 0.1  # relative to a stated frequency: search range for the true one
_LONGEST = 2.0  # smallest number of periods in a region


class StarPhase(NamedTuple):
    """Phase of a star at pixels.

    Its 14 parameters are the centre (2), the phase at azimuth 0, a linear map (2), and displacements of second (4) and third
    (5) order across the rays, rad at the outer radius.

    Attributes:
        cycles: number of cycles.
        outer: outer radius, px.
    """

    cycles: int
    outer: float

    @property
    def scale(self) -> FloatArray:
        """Return the changes of the parameters that change phases by 1 rad."""
        return np.array([self.outer / self.cycles / 2] * 2 + [1.0] + [1 / self.cycles] * 2 + [1.0] * 9)

    def at(self, parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the phase at px, rad."""
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
        """Return the parameters for known phases at px.

        phase: (n,) rad, mod 2 pi. centre: first guess, px. shape: first guess of the linear map: without it
        a tilted star of many cycles leads astray.
        """
        size = self.scale

        def residual(p: FloatArray) -> FloatArray:
            return np.mod(self.at(p * size, x, y) - phase + np.pi, 2 * np.pi) - np.pi

        start = np.zeros(size.size)
        start[:2] = np.array(centre) / size[:2]
        start[3:5] = np.array(shape) / size[3:5]
        start[2] = np.angle(np.exp(1j * (phase - self.at(start * size, x, y))).mean())
        return np.asarray(least_squares(residual, start, x_scale=1.0).x * size)


class FoundStar(NamedTuple):
    """Star that was found in an image.

    Attributes:
        phase: its cycles and its outer radius, px.
        parameters: (14,) of `phase`.
        inner: radius beyond which there is nothing but star, px.
    """

    phase: StarPhase
    parameters: FloatArray
    inner: float


def find_star(values: FloatArray, cycles: int | None = None) -> FoundStar:
    """Find the star in a region.

    values: (height, width), NaN where there are no data. FitError if there is no star.
    """
    filled = smoothed(values)
    centre = _centre(filled)
    rings = _rings(filled, centre)
    if not rings:
        raise FitError("region contains no Siemens star: no ring shows a regular wave")
    votes: dict[int, float] = {}
    for ring in rings:
        votes[ring.cycles] = votes.get(ring.cycles, 0.0) + ring.share
    winner = max(votes, key=lambda m: votes[m]) if cycles is None else cycles
    agreeing = [ring for ring in rings if ring.cycles == winner]
    if len(agreeing) < 4 or winner < 8:
        raise FitError(
            f"region contains no Siemens star{f' of {cycles} cycles' if cycles else ''}: "
            f"of {len(rings)} rings with a wave {len(agreeing)} agree on {winner} cycles"
        )
    # beyond the rim the wave of a ring is weak, even if the background is empty
    strong = _KEPT * float(np.median([ring.amplitude for ring in agreeing[len(agreeing) // 2 :]]))
    outer = max(ring.radius for ring in agreeing if ring.amplitude > strong)
    agreeing = [ring for ring in agreeing if ring.radius <= outer]
    x, y, phase = (np.concatenate([np.asarray(getattr(ring, n)) for ring in agreeing]) for n in ("x", "y", "phase"))
    wave = StarPhase(winner, outer)
    return FoundStar(wave, wave.parameters_through(x, y, phase, centre), agreeing[0].radius)


class _Ring(NamedTuple):
    """Ring with a wave.

    share: of the ring's power. amplitude: over the ring's mean. phase: (n,) rad at x, y, px.
    """

    radius: float
    cycles: int
    share: float
    amplitude: float
    x: FloatArray
    y: FloatArray
    phase: FloatArray


def _centre(filled: FloatArray) -> tuple[float, float]:
    """Return the point, px, around which all gradients rotate."""
    gy, gx = np.gradient(filled)
    y, x = np.indices(filled.shape).astype(float)
    length = np.hypot(gx, gy)
    nx, ny = gx / np.maximum(length, 1e-300), gy / np.maximum(length, 1e-300)
    strength = np.minimum(length, np.quantile(length, 0.9)) ** 2
    at = np.array([(filled.shape[1] - 1) / 2, (filled.shape[0] - 1) / 2])
    normals, found = np.stack([nx.ravel(), ny.ravel()]), (nx * x + ny * y).ravel()
    scale = max(filled.shape) / 3
    for _ in range(_ROUNDS):
        # gradients in other directions (a rim, another target) get a lower weight
        weight = strength.ravel() / (1 + ((found - at @ normals) / scale) ** 2) ** 2
        normal = (normals * weight) @ normals.T
        if np.linalg.det(normal) <= 1e-12 * np.trace(normal) ** 2:
            raise FitError("region contains no Siemens star: its brightness changes in one direction only")
        at = np.linalg.solve(normal, normals @ (weight * found))
        scale = max(scale * 0.7, 3.0)
    if not (0 <= at[0] < filled.shape[1] and 0 <= at[1] < filled.shape[0]):
        raise FitError("region contains no Siemens star: its rays do not meet inside it")
    return float(at[0]), float(at[1])


def _rings(filled: FloatArray, centre: tuple[float, float]) -> list[_Ring]:
    """Return the rings around a centre with a significant wave."""
    height, width = filled.shape
    most = min(centre[0], centre[1], width - 1 - centre[0], height - 1 - centre[1])
    found = []
    for radius in np.arange(6.0, most, max(1.0, most / 80)):
        count = 2 * int(np.pi * radius * _FINE / 2)
        turn = 2 * np.pi * np.arange(count) / count
        x, y = centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn)
        spectrum = np.fft.rfft(ndimage.map_coordinates(filled, [y, x], order=1))
        power = np.abs(spectrum) ** 2
        low, high = max(6, int(_LOW[0] * 2 * np.pi * radius)), int(_LOW[1] * 2 * np.pi * radius) + 1
        if high - low < 3:
            continue
        peak = low + int(np.argmax(power[low:high]))
        spread = int(max(2, _BAND * peak))
        near = slice(peak - spread, peak + spread + 1)
        band = np.zeros(count, complex)
        band[near] = spectrum[near]
        inside = power[near].sum()
        share = inside / power[3:].sum()
        phase = np.unwrap(np.angle(np.fft.ifft(band)))
        turns = (phase[-1] - phase[0] + np.angle(np.exp(1j * (phase[0] - phase[-1])))) / (2 * np.pi)
        if share > _CLEAR_IN_RING:
            amplitude = 2 * float(np.sqrt(inside) / max(abs(spectrum[0]), 1e-300))
            some = slice(None, None, max(1, count // (4 * peak)))
            found.append(_Ring(float(radius), round(turns), float(share), amplitude, x[some], y[some], phase[some]))
    return found


class GratingPhase(NamedTuple):
    """Phase of a grating at pixels.

    It is a polynomial of second (6 parameters) or third (10) order in the position.

    Attributes:
        middle: (x, y) about which the phase is expanded, px.
        half_extent: half the grating's extent, px.
        order: of the polynomial, 2 or 3.
    """

    middle: tuple[float, float]
    half_extent: float
    order: int

    @property
    def scale(self) -> FloatArray:
        """Return changes of the parameters that turn phases by 1 rad."""
        return np.array([(_UNIT / self.half_extent) ** (i + j) for i, j in plane_orders(self.order)])

    def at(self, parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the phase at px, rad."""
        return np.asarray(self._powers(x, y) @ parameters)

    def parameters_through(self, x: FloatArray, y: FloatArray, phase: FloatArray) -> FloatArray:
        """Return the parameters that give px their known, unwrapped phases."""
        return np.asarray(np.linalg.lstsq(self._powers(x, y), phase, rcond=None)[0], dtype=np.float64)

    def _powers(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the polynomials at px."""
        return plane_powers((x - self.middle[0]) / _UNIT, (y - self.middle[1]) / _UNIT, self.order)


class FoundGrating(NamedTuple):
    """Grating that was found in an image.

    Attributes:
        phase: the polynomial of its phase.
        parameters: (6,) or (10,) of `phase`.
        inside: (height, width) pixels that see nothing else.
    """

    phase: GratingPhase
    parameters: FloatArray
    inside: np.ndarray

    @classmethod
    def through(cls, x: FloatArray, y: FloatArray, phase: FloatArray, inside: np.ndarray) -> FoundGrating:
        """Return the grating with a known phase at some positions.

        x, y: (n,) px. phase: (n,) rad, unwrapped.
        """
        extent = float(np.sqrt(inside.sum()))
        wave = GratingPhase((float(x.mean()), float(y.mean())), extent / 2, 3 if extent > _WIDE else 2)
        return cls(wave, wave.parameters_through(x, y, phase), inside)


def find_grating(values: FloatArray, near: tuple[float, float] | None = None) -> FoundGrating:
    """Find the grating in a region.

    values: (height, width), NaN where there are no data. FitError if there is no grating.
    near: its frequency (fx, fy), cycles/px, roughly, if it may lie beyond Nyquist: the nearest that looks the same is taken.
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
    label, count = ndimage.label(size > _ENVELOPE * np.quantile(size, 0.98))
    if not count:
        raise FitError("region contains no grating: nothing varies in it")
    largest = 1 + int(np.argmax(ndimage.sum_labels(np.ones_like(size), label, np.arange(1, count + 1))))
    inside = ndimage.binary_erosion(
        ndimage.binary_fill_holes(label == largest), iterations=round(MARGIN), border_value=1
    )
    if inside.sum() < 256:
        raise FitError("region contains no grating: nowhere 16 x 16 px of one regular wave")
    start = float(np.angle(envelope[inside].mean()))
    phase = start + 2 * np.pi * (frequency[0] * x + frequency[1] * y)
    return FoundGrating.through(x[inside], y[inside], phase[inside], inside)


def _alias(frequency: FloatArray) -> FloatArray:
    """Return the frequency below Nyquist that gives the same samples on the grid."""
    return np.asarray(frequency - np.round(frequency))


def _strongest(filled: FloatArray, near: tuple[float, float] | None) -> FloatArray:
    """Return (fx, fy) of the strongest wave below Nyquist, cycles/px.

    near: only waves that may have this frequency in truth count.
    """
    height, width = filled.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
    mean = (window * filled).sum() / window.sum()
    # four times as many frequencies as samples: the peak is then known to a small part of a period over the region
    power = np.abs(np.fft.rfft2(window * (filled - mean), (4 * height, 4 * width))) ** 2
    fy, fx = np.fft.fftfreq(4 * height)[:, None], np.fft.rfftfreq(4 * width)[None]
    # borders of what is in the region have power at low frequencies, more than harmonics have at high ones
    power *= np.hypot(fx, fy)
    power[(np.abs(fx) * width < _LONGEST) & (np.abs(fy) * height < _LONGEST)] = 0
    everywhere = np.median(power)
    if near is not None:
        alias = _alias(np.array(near))
        off = [np.hypot(_alias(fx - sign * alias[0]), _alias(fy - sign * alias[1])) for sign in (-1, 1)]
        power[np.minimum(*off) > max(_NEAR * float(np.hypot(*near)), 2 * _LONGEST / min(height, width))] = 0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    if not power[row, column] > _CLEAR_IN_SPECTRUM * everywhere:
        raise FitError("region contains no grating: no frequency stands out")
    return np.array([fx[0, column], fy[row, 0]])
