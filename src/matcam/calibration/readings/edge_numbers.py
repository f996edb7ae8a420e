"""Scalar metrics of a measured edge: frequency at a given MTF, MTF at a given frequency, and rise distance."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.edge.free_curve import SampledCurve, line_width
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.numerics.crossing import first_fall

LEVELS = (0.5, 0.3, 0.2, 0.1)
"""Levels of the MTF whose frequencies are reported. MTF50 and MTF10 are the most common metrics of sharpness."""


class EdgeNumber(NamedTuple):
    """Value and its standard deviation.

    Attributes:
        value: measured value, in the unit that the measuring function documents.
        std: standard deviation of `value`, in the same unit.

    Example:
        >>> matcam.calibration.EdgeNumber(0.31, 0.01).value
        0.31
    """

    value: float
    std: float


def level_frequency(edge: EdgeMTF, level: float) -> EdgeNumber:
    """Find the frequency at which an MTF falls to a level.

    Args:
        edge: result of `edge_mtf`.
        level: level of the MTF, in (0, 1) (no unit).

    Returns:
        Lowest such frequency and its standard deviation, cycles/px; NaN if the MTF does not fall to the level.

    Raises:
        ArgumentError: `edge` is not a result of `edge_mtf`, or `level` is out of range.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> edge = matcam.edge_mtf(100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y))))
        >>> found = matcam.calibration.level_frequency(edge, 0.1)
        >>> round(found.value, 2)
        0.46
    """
    checks.instance("edge", edge, EdgeMTF)
    checks.scalar("level", checks.within("level", level, 0, 1, open_low=True, open_high=True))
    if level == LEVELS[0]:
        return EdgeNumber(edge.mtf50, edge.mtf50_std)
    value = float(first_fall(edge.frequency, edge.mtf, level))
    if np.isnan(value):
        return EdgeNumber(np.nan, np.nan)
    k = int(np.searchsorted(edge.frequency, value))
    slope = float(edge.mtf[k] - edge.mtf[k - 1]) / float(edge.frequency[k] - edge.frequency[k - 1])
    return EdgeNumber(value, float(np.interp(value, edge.frequency, edge.mtf_std)) / abs(slope))


def mtf_at(edge: EdgeMTF, frequency: ArrayLike) -> SampledCurve:
    """Interpolate the MTF of an edge.

    Args:
        edge: result of `edge_mtf`.
        frequency: frequencies along the normal, 0 to 1.25 cycles/px, any shape.

    Returns:
        MTF and its standard deviation, with the shape of `frequency` (no unit).

    Raises:
        ArgumentError: `edge` is not a result of `edge_mtf`, or a frequency is out of range.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> edge = matcam.edge_mtf(100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y))))
        >>> round(float(matcam.calibration.mtf_at(edge, 0.25).value), 2)
        0.42
    """
    checks.instance("edge", edge, EdgeMTF)
    at: FloatArray = np.asarray(checks.number("frequency", frequency))
    checks.within("frequency", at, 0, 1.25, "cycles/px")  # the tabulated range
    return SampledCurve(*(np.interp(at, edge.frequency, curve) for curve in (edge.mtf, edge.mtf_std)))


def rise_distance(edge: EdgeMTF) -> EdgeNumber:
    """Measure the 10 % to 90 % rise distance of an edge.

    Args:
        edge: result of `edge_mtf`.

    Returns:
        Distance along the normal and its standard deviation, px; NaN if the edge response does not reach 10 % and 90 %.

    Raises:
        ArgumentError: `edge` is not a result of `edge_mtf`.

    Source:
        ISO 12233, which reports this distance as an alternative to the edge-based spatial frequency response.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> edge = matcam.edge_mtf(100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y))))
        >>> round(matcam.calibration.rise_distance(edge).value, 1)
        2.2
    """
    checks.instance("edge", edge, EdgeMTF)
    extent = 6 * float(line_width(edge.fits.free.shape))
    distance = np.linspace(-extent, extent, 512)
    value, std = rise(distance, edge.esf(distance))
    # causes other than noise, such as processing, change the scale of the rise distance and of MTF50 alike
    return EdgeNumber(value, float(np.fmax(std, value * edge.mtf50_std / edge.mtf50)))


def _passage(position: FloatArray, response: SampledCurve, level: float, side: int) -> EdgeNumber:
    """Find the position at which an edge response crosses a level, by linear interpolation.

    The search starts at the middle of the edge. The result is NaN if the response does not cross the level. `position`:
    ascending positions (n,). `response`: edge response (n,), 0 to 1. `side`: -1 for the dark side, 1 for the bright side.
    """
    value = response.value
    outwards = np.arange(int(np.argmin(np.abs(value - 0.5))), value.size if side > 0 else -1, side)
    k = int(np.argmax(side * (value[outwards] - level) >= 0))
    if not k:
        return EdgeNumber(np.nan, np.nan)
    before, after = outwards[k - 1], outwards[k]
    slope = (value[after] - value[before]) / (position[after] - position[before])
    place = position[before] + (level - value[before]) / slope
    return EdgeNumber(float(place), float(response.std[after] / slope))


def rise(position: FloatArray, response: SampledCurve) -> EdgeNumber:
    """Measure the 10 % to 90 % rise distance of an edge response.

    The result and its standard deviation are in the unit of the positions. They are NaN if the response does not reach
    10 % and 90 %.

    Args:
        position: positions (n,), ascending.
        response: edge response at these positions, 0 to 1, (n,).
    """
    low, high = (_passage(position, response, level, side) for level, side in ((0.1, -1), (0.9, 1)))
    return EdgeNumber(high.value - low.value, float(np.hypot(low.std, high.std)))


def readings(edge: EdgeMTF, frequencies: FloatArray | tuple[float, ...] = ()) -> dict[str, Any]:
    """Compute the scalar metrics that are usually reported for an edge.

    Args:
        edge: result of `edge_mtf`.
        frequencies: frequencies at which the MTF is computed, cycles/px. Default: (), no frequencies.

    Returns:
        Values by name, with units in the names: MTF50, MTF30, MTF20, MTF10, the rise distance, and the MTF at
        `frequencies`. Each value has a standard deviation of the same unit.
    """
    found: dict[str, Any] = {}
    for level in LEVELS:
        name = f"mtf{100 * level:.0f}"
        found[f"{name}_cycles_per_px"], found[f"{name}_std"] = level_frequency(edge, level)
    found["rise_10_90_px"], found["rise_10_90_std"] = rise_distance(edge)
    for frequency in frequencies:
        value, std = mtf_at(edge, frequency)
        found[f"mtf_at_{frequency:g}"], found[f"mtf_at_{frequency:g}_std"] = float(value), float(std)
    return found
