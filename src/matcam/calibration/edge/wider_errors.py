"""Increase of the standard deviations of measured edges for causes other than pixel noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.calibration.edge.parametric_result import with_scale_error
from matcam.numerics.crossing import first_fall


def with_core_as_total(stack: EdgeStack, which: np.ndarray) -> EdgeStack:
    """Replace the MTF of selected edges with the MTF without glare, and set the glare of these edges to 0.

    `which`: mask (n,) of the selected edges.
    """
    names = ("mtf", "mtf_std", "mtf50", "mtf50_std")
    moved: dict[str, Any] = {name: getattr(stack, name).copy() for name in names}
    for name, column in moved.items():
        column[which] = getattr(stack, f"core_{name}")[which]
    moved["glare_fraction"] = np.where(which, 0.0, stack.glare_fraction)
    moved["glare_fraction_std"] = np.where(which, 0.0, stack.glare_fraction_std)
    moved["glare_radius"] = np.where(which, np.nan, stack.glare_radius)
    return replace(stack, **moved)


def with_ghosts(stack: EdgeStack, shares: np.ndarray, positions: np.ndarray) -> EdgeStack:
    """Include ghosts that were removed as uneven light in the model-free MTFs.

    Args:
        stack: results of n edges.
        shares: shares of the ghosts (n,), no unit.
        positions: distances of the ghosts from the edges (n,), px.
    """
    f, moved = stack.frequency, dict[str, Any]()
    apart = np.cos(2 * np.pi * f * positions[:, None])
    loss = np.sqrt(1 - 2 * (shares * (1 - shares))[:, None] * (1 - apart))
    for name in ("mtf", "core_mtf"):
        mtf, half = getattr(stack, name) * loss, getattr(stack, f"{name}50")
        moved |= {name: mtf, f"{name}50": np.where(shares > 0, first_fall(f, mtf), half)}
    return replace(stack, **moved)


def widened(
    stack: EdgeStack, by_part: Mapping[str, np.ndarray], ghosts: np.ndarray, distances: np.ndarray
) -> EdgeStack:
    """Include an uncertain frequency scale and possible ghosts in the standard deviations of a stack.

    Args:
        stack: results of n edges.
        by_part: relative standard deviations (n,) of the frequency scale. "lens" applies to all estimates, "free" only
            to the model-free estimates, and "glare" only to the model-free MTF with glare. The standard deviations that
            apply to the same estimate are added in quadrature.
        ghosts: standard deviations (n,) of the shares of distant ghosts that may have been fitted as uneven light.
        distances: standard deviations (n,) of the distances of these ghosts times their shares, px.
    """
    lens, shares = stack.parametric, by_part["lens"]
    covariance = with_scale_error(lens.covariance, lens.values, lens.names, lens.half_width, shares)
    core = np.hypot(shares, by_part["free"])
    # The effect of a ghost decreases below 0.05 cycles/px, the frequency of a ghost at a distance of 10 px.
    f = stack.frequency
    by_ghost = ghosts[:, None] * np.minimum(f / 0.05, 1.0)
    by_ghost = np.hypot(by_ghost, 2 * np.pi * f * distances[:, None] * stack.mtf)
    free = _errors(stack, "mtf", np.hypot(core, by_part["glare"]), by_ghost)
    free |= _errors(stack, "core_mtf", core, by_ghost)
    mtf_std = np.hypot(lens.mtf_std, shares[:, None] * _by_scale(stack.frequency, lens.mtf))
    mtf50_std = np.hypot(lens.mtf50_std, shares * lens.mtf50)
    parametric = replace(lens, covariance=covariance, mtf_std=mtf_std, mtf50_std=mtf50_std)
    return replace(stack, parametric=parametric, **free)


def _by_scale(frequency: np.ndarray, mtf: np.ndarray) -> np.ndarray:
    """Compute the absolute derivative of an MTF with respect to the logarithm of the frequency."""
    return frequency * np.abs(np.gradient(mtf, frequency, axis=-1))


def _errors(stack: EdgeStack, name: str, share: np.ndarray, by_ghost: np.ndarray) -> dict[str, Any]:
    """Compute the standard deviations of an MTF and of its MTF50.

    A ghost makes the MTF oscillate. If the MTF is close to one half at two frequencies, a small error of the MTF may
    change MTF50 discontinuously. Therefore MTF50 is also computed for the MTF plus and minus one and two standard
    deviations, and the largest change per standard deviation is used.
    """
    f, mtf, half = stack.frequency, getattr(stack, name), getattr(stack, f"{name}50")
    by_scale = _by_scale(f, mtf)
    std = np.sqrt(getattr(stack, f"{name}_std") ** 2 + (share[:, None] * by_scale) ** 2 + by_ghost**2)
    at = np.clip(np.searchsorted(f, np.nan_to_num(half)), 1, f.size - 1)
    slope = np.take_along_axis(by_scale, at[:, None], 1)[:, 0] / f[at]
    # The smallest slope prevents a division by zero.
    ghost = np.take_along_axis(by_ghost, at[:, None], 1)[:, 0] / np.maximum(slope, 1e-3)
    half_std = np.sqrt(getattr(stack, f"{name}50_std") ** 2 + (share * half) ** 2 + ghost**2)
    changes = [half_std]
    for steps in (1, 2):
        low, high = (first_fall(f, mtf + sign * std) for sign in (-steps, steps))
        changes.append(np.fmax(half - low, np.where(np.isnan(high), f[-1], high) - half) / steps)
    return {f"{name}_std": std, f"{name}50_std": np.fmax.reduce(changes)}
