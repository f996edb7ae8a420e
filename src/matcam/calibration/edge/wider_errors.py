"""Larger errors of measured edges, from causes other than the noise of their pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.numerics.crossing import first_fall

_LOWEST_BY_GHOST, _FLATTEST = 0.05, 1e-3
"""Frequency below which the effect of a ghost 10 px away on an MTF decreases, cycles/px; smallest slope of an MTF at
one half, px.
"""
_JUMP = 1.5
"""Standard deviations above which the shift of MTF50 from a shifted MTF replaces its standard deviation."""


def with_core_as_total(stack: EdgeStack, which: np.ndarray) -> EdgeStack:
    """Use the MTF without glare as the MTF of some edges.

    `which`: (n,) bool.
    """

    def of(total: np.ndarray, core: np.ndarray) -> np.ndarray:
        return np.where(which.reshape(-1, *[1] * (total.ndim - 1)), core, total)

    names = ("mtf", "mtf_std", "mtf50", "mtf50_std")
    moved: dict[str, Any] = {name: of(getattr(stack, name), getattr(stack, f"core_{name}")) for name in names}
    moved["glare_fraction"] = np.where(which, 0.0, stack.glare_fraction)
    moved["glare_fraction_std"] = np.where(which, 0.0, stack.glare_fraction_std)
    moved["glare_radius"] = np.where(which, np.nan, stack.glare_radius)
    return replace(stack, **moved)


def with_ghosts(stack: EdgeStack, shares: np.ndarray) -> EdgeStack:
    """Increase errors by ghosts far from the edge that may have been fitted as light.

    `shares`: (n,) of the ghosts.
    """
    by = shares[:, None] * np.minimum(stack.frequency / _LOWEST_BY_GHOST, 1.0)

    def half_std(mtf: np.ndarray, half: np.ndarray, std: np.ndarray) -> np.ndarray:
        slope = np.abs(np.gradient(mtf, stack.frequency, axis=-1))
        at = np.clip(np.searchsorted(stack.frequency, np.nan_to_num(half)), 0, stack.frequency.size - 1)
        return np.hypot(std, shares / np.maximum(np.take_along_axis(slope, at[:, None], 1)[:, 0], _FLATTEST))

    return replace(
        stack,
        mtf_std=np.hypot(stack.mtf_std, by),
        mtf50_std=half_std(stack.mtf, stack.mtf50, stack.mtf50_std),
        core_mtf_std=np.hypot(stack.core_mtf_std, by),
        core_mtf50_std=half_std(stack.core_mtf, stack.core_mtf50, stack.core_mtf50_std),
    )


def with_jumps(stack: EdgeStack) -> EdgeStack:
    """Return results with an MTF50 whose error covers the crossings of the MTF plus and minus a standard deviation.

    A ghost makes the MTF wavy. If it is near one half twice, the MTF50 may jump.
    """

    def std(mtf: np.ndarray, mtf_std: np.ndarray, half: np.ndarray, half_std: np.ndarray) -> np.ndarray:
        low, high = (first_fall(stack.frequency, mtf + sign * mtf_std) for sign in (-1, 1))
        reach = np.fmax(half - low, np.where(np.isnan(high), stack.frequency[-1], high) - half)
        return np.where(reach > _JUMP * half_std, reach, half_std)

    return replace(
        stack,
        mtf50_std=std(stack.mtf, stack.mtf_std, stack.mtf50, stack.mtf50_std),
        core_mtf50_std=std(stack.core_mtf, stack.core_mtf_std, stack.core_mtf50, stack.core_mtf50_std),
    )


def widened(stack: EdgeStack, by_part: Mapping[str, np.ndarray]) -> EdgeStack:
    """Return results whose frequencies are unknown by relative shares (n,): of the "lens", "free" estimates, and "glare"."""
    shares = by_part["lens"]
    core = np.hypot(shares, by_part["free"])
    total = np.hypot(core, by_part["glare"])

    def curve(mtf: np.ndarray, std: np.ndarray, by: np.ndarray) -> np.ndarray:
        slope = np.gradient(mtf, stack.frequency, axis=-1)
        return np.hypot(std, by[:, None] * stack.frequency * np.abs(slope))

    def half(value: np.ndarray, std: np.ndarray, by: np.ndarray) -> np.ndarray:
        return np.hypot(std, by * value)

    lens = stack.parametric
    first, box = lens.values[:, 0], lens.half_width**2 / 3
    # the scale applies to the blur of lens and pixel together
    own = shares * (first + box / first if lens.names[0].endswith("sigma_px") else first)
    covariance = lens.covariance.copy()
    covariance[:, 0, 0] += own**2
    return replace(
        stack,
        mtf_std=curve(stack.mtf, stack.mtf_std, total),
        core_mtf_std=curve(stack.core_mtf, stack.core_mtf_std, core),
        mtf50_std=half(stack.mtf50, stack.mtf50_std, total),
        core_mtf50_std=half(stack.core_mtf50, stack.core_mtf50_std, core),
        parametric=replace(
            lens,
            covariance=covariance,
            mtf_std=curve(lens.mtf, lens.mtf_std, shares),
            mtf50_std=half(lens.mtf50, lens.mtf50_std, shares),
        ),
    )
