"""Where a Siemens star lies in a picture: its centre, the number of its cycles, and the phase of every pixel.

Lines through a star's centre stay lines in any pinhole's picture, so brightness changes across them only: the centre is where
the pixels' gradients are all at right angles to the way there. The number of cycles is how often the phase turns along a
ring, whatever perspective does to its speed. Perspective changes the azimuth by a linear map exactly; what a lens's
distortion adds is a smooth displacement, of which second and third order are kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from matcam.calibration.smoothing import smoothed
from matcam.calibration.wave_fit import Array
from matcam.errors import FitError

PARAMETERS = 14
_ROUNDS = 12
_CLEAR = 0.5  # share of a ring's power that its wave must have
_KEPT = 0.8  # of the outer rings' usual amplitude
_BAND = 0.35  # of the cycles: how far perspective may spread a ring's wave
_FINE = 4  # samples of a ring per px
_LOW = (0.03, 0.3)  # cycles/px: rings on which the phase is looked at


class FoundStar(NamedTuple):
    """A star in a picture, px."""

    parameters: Array
    """(14,) of `phase_of`."""
    cycles: int
    inner: float
    outer: float
    """Radii between which there is nothing but star."""


def phase_of(parameters: Array, x: Array, y: Array, cycles: int, outer: float) -> Array:
    """Phase, rad, at px: parameters are centre (2), phase at azimuth 0, linear map (2), displacements of second (4) and
    third (5) order across the rays, rad at the outer radius."""
    x0, y0, turn, e1, e2 = parameters[:5]
    u, v = (x - x0) / outer, (y - y0) / outer
    azimuth = np.arctan2((1 - e1) * v + e2 * u, (1 + e1) * u + e2 * v)
    c, q = parameters[5:9], parameters[9:]
    uu, uv, vv = u * u, u * v, v * v  # powers as such are slow
    square = np.maximum(uu + vv, 1e-12)
    bent = uu * (c[0] * u + c[1] * v + q[0] * uu + q[1] * uv) + q[2] * uv * uv
    bent += vv * (c[2] * u + c[3] * v + q[3] * uv + q[4] * vv)
    return cycles * azimuth + turn + bent / square


def scales(cycles: int, outer: float) -> Array:
    """Changes of the parameters that turn the phase by about 1 rad."""
    return np.array([outer / cycles / 2] * 2 + [1.0] + [1 / cycles] * 2 + [1.0] * 9)


def from_points(x: Array, y: Array, phase: Array, cycles: int, centre: tuple[float, float], outer: float) -> Array:
    """The parameters that give px their known phases, mod 2 pi."""
    size = scales(cycles, outer)

    def residual(p: Array) -> Array:
        return np.mod(phase_of(p * size, x, y, cycles, outer) - phase + np.pi, 2 * np.pi) - np.pi

    start = np.zeros(PARAMETERS)
    start[:2] = np.array(centre) / size[:2]
    turn = np.angle(np.exp(1j * (phase - phase_of(start * size, x, y, cycles, outer))).mean())
    start[2] = turn
    return np.asarray(least_squares(residual, start, x_scale=1.0).x * size)


def find_star(values: Array, cycles: int | None = None) -> FoundStar:
    """The star in a region (height, width), NaN where there are no data. FitError where there is none."""
    # what is missing is filled by its neighbours
    filled = smoothed(values, 0.7 if np.isfinite(values).mean() > 0.9 else 1.2)
    centre = _centre(filled)
    rings = _rings(filled, centre)
    if not rings:
        raise FitError("region holds no Siemens star: no ring shows a regular wave")
    votes: dict[int, float] = {}
    for ring in rings:
        votes[ring.cycles] = votes.get(ring.cycles, 0.0) + ring.share
    winner = max(votes, key=lambda m: votes[m]) if cycles is None else cycles
    agreeing = [ring for ring in rings if ring.cycles == winner]
    if len(agreeing) < 4 or winner < 8:
        raise FitError(
            f"region holds no Siemens star{f' of {cycles} cycles' if cycles else ''}: "
            f"of {len(rings)} rings with a wave {len(agreeing)} agree on {winner} cycles"
        )
    # beyond the rim a ring's wave is weak, though nothing else may be there
    strong = _KEPT * float(np.median([ring.amplitude for ring in agreeing[len(agreeing) // 2 :]]))
    outer = max(ring.radius for ring in agreeing if ring.amplitude > strong)
    agreeing = [ring for ring in agreeing if ring.radius <= outer]
    x, y, phase = (np.concatenate([np.asarray(getattr(ring, n)) for ring in agreeing]) for n in ("x", "y", "phase"))
    parameters = from_points(x, y, phase, winner, centre, outer)
    return FoundStar(parameters, winner, agreeing[0].radius, outer)


class _Ring(NamedTuple):
    radius: float
    cycles: int
    share: float
    amplitude: float
    """Of its wave, relative to its mean."""
    x: Array
    y: Array
    phase: Array


def _centre(filled: Array) -> tuple[float, float]:
    gy, gx = np.gradient(filled)
    y, x = np.indices(filled.shape).astype(float)
    length = np.hypot(gx, gy)
    nx, ny = gx / np.maximum(length, 1e-300), gy / np.maximum(length, 1e-300)
    strength = np.minimum(length, np.quantile(length, 0.9)) ** 2
    at = np.array([(filled.shape[1] - 1) / 2, (filled.shape[0] - 1) / 2])
    reach = max(filled.shape) / 3
    for _ in range(_ROUNDS):
        off = nx * (x - at[0]) + ny * (y - at[1])
        # gradients that point elsewhere (a rim, another target) lose their say
        weight = strength / (1 + (off / reach) ** 2) ** 2
        normal = np.array([[(weight * nx * nx).sum(), (weight * nx * ny).sum()], [0, (weight * ny * ny).sum()]])
        normal[1, 0] = normal[0, 1]
        if np.linalg.det(normal) <= 1e-12 * np.trace(normal) ** 2:
            raise FitError("region holds no Siemens star: its brightness changes in one direction only")
        found = nx * x + ny * y
        at = np.linalg.solve(normal, np.array([(weight * nx * found).sum(), (weight * ny * found).sum()]))
        reach = max(reach * 0.7, 3.0)
    if not (0 <= at[0] < filled.shape[1] and 0 <= at[1] < filled.shape[0]):
        raise FitError("region holds no Siemens star: its rays do not meet inside it")
    return float(at[0]), float(at[1])


def _rings(filled: Array, centre: tuple[float, float]) -> list[_Ring]:
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
        band = np.zeros(count, complex)
        band[peak - spread : peak + spread + 1] = spectrum[peak - spread : peak + spread + 1]
        share = power[peak - spread : peak + spread + 1].sum() / power[3:].sum()
        phase = np.unwrap(np.angle(np.fft.ifft(band)))
        turns = (phase[-1] - phase[0] + np.angle(np.exp(1j * (phase[0] - phase[-1])))) / (2 * np.pi)
        if share > _CLEAR:
            inside = power[peak - spread : peak + spread + 1].sum()
            amplitude = 2 * float(np.sqrt(inside) / max(abs(spectrum[0]), 1e-300))
            some = slice(None, None, max(1, count // (4 * peak)))
            found.append(_Ring(float(radius), round(turns), float(share), amplitude, x[some], y[some], phase[some]))
    return found
