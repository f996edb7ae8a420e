"""First estimate of the curve of an edge and of the light of its rows, without a model of the light.

In each row, the edge is located where the means of a few pixels on both sides differ most. The levels of each row are
estimated independently. Therefore light that decreases by half along the edge, or a shadow across the edge, does not
shift the estimate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.calibration.edge.geometry import (
    CURVE,
    AlignedRows,
    Rows,
    aligned_rows,
    edge_position,
)
from matcam.core.arrays import linalg, repeated, xp

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

_HALF_WINDOW = 8
"""Distance from the edge within which the samples of a row determine the position of the edge, px."""
_MARGIN = 3
"""Distance to the border of the region within which the edge of a row is ignored, in samples.

It is also the smallest number of samples on each side of a step.
"""


def find_curve(rows: Rows) -> tuple[jax.Array, jax.Array]:
    """Estimate the coefficients (CURVE,) of a first curve, and count the rows that the edge crosses.

    The error of the curve is a few hundredths of a px. A model of the blur is not required. The edge of a row is placed
    at the position of an ideal step whose pixel values have the same sum as those of the row near the edge. Unlike the
    centroid of the derivative, this position does not amplify noise. A straight line through the largest steps is fitted
    first. Then the positions near this line are refined.
    """
    found, crossing = _largest_steps(rows)

    def closer(at: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        line = _polynomial(rows.powers[:2], found, at[1])
        off = xp.abs(found - edge_position(line, rows.powers))
        # A row is an outlier if its distance from the line exceeds the mean distance by more than 3 px.
        return line, crossing * (off < 3.0 + (at[1] * off).sum() / xp.maximum(at[1].sum(), 1))

    line, _ = repeated(4, closer, (xp.zeros(2), crossing))
    aligned = in_even_rows(aligned_rows(rows, line))
    middle, half_window = aligned.value.shape[1] // 2, _HALF_WINDOW // rows.step
    near = slice(max(middle - half_window, 0), middle + half_window + 1)
    low, high = side_levels(aligned)
    # Near a border of the region, a row has fewer samples on one side.
    span, there = aligned.value[:, near], aligned.valid[:, near]
    x = aligned.x[:, near]
    bright = (there * (span - low[:, None])).sum(1) / (high - low) * rows.step
    last = xp.max(xp.where(there > 0, x, -xp.inf), axis=1)
    found = xp.where(there.sum(1) > 0, last, 0.0) + rows.step / 2 - bright
    margin = _MARGIN * rows.step
    position = edge_position(line, rows.powers)
    first = xp.min(xp.where(there > 0, x, xp.inf), axis=1)
    gaps = (there.sum(1) - 1) * rows.step < last - first
    whole = (first <= position - margin) & (last >= position + margin) & ~gaps
    off = xp.abs(found - position)
    weight = (whole & (off < _HALF_WINDOW / 2)).astype(float)
    return _polynomial(rows.powers[:CURVE], found, weight), whole.sum()


def side_levels(aligned: AlignedRows) -> tuple[jax.Array, jax.Array]:
    """Estimate the dark and the bright level (rows,) a few px from the edge, as linear functions of y.

    The light changes little over this distance, and the blur is negligible there.
    """
    low, high = _polynomial(aligned.powers[:2], *_sides(aligned)) @ aligned.powers[:2]
    return low, high


def in_even_rows(aligned: AlignedRows) -> AlignedRows:
    """Divide the rows by the nonlinear part of their light.

    The fit of the edge includes the linear part. The light is modelled as a polynomial in y that is fitted to the means of both
    sides. Its order, up to 10, minimises the Bayesian information criterion (Schwarz 1978). If the order is 1, the rows are
    unchanged.
    """
    means, counts = _sides(aligned)
    weight = (counts > 0).all(0).astype(float)
    level = xp.where(weight > 0, means.mean(0), 0.0)
    powers = aligned.powers
    normal = (powers * weight) @ powers.T + 1e-9 * np.eye(len(powers))
    root = linalg.cholesky(normal)
    # Component of each order that is orthogonal to the lower orders.
    own = linalg.solve(root, powers)
    share = own @ (weight * level)
    count = xp.maximum(weight.sum(), 2.0)
    left = xp.maximum((weight * level**2).sum() - xp.cumsum(share**2), 1e-12 * (weight * level**2).sum() + 1e-300)
    order = np.arange(len(powers))
    cost = xp.where((order >= 1) & (order <= count / 6), count * xp.log(left / count) + order * xp.log(count), xp.inf)
    best = xp.maximum(xp.argmin(cost), 1)
    line = share[:2] @ own[:2]
    full = (share * (order <= best)) @ own
    light = xp.where((best > 1) & (line > 0), full / xp.where(line > 0, line, 1.0), 1.0)
    # The light of a row differs from the linear part of the light by at most a factor of 5.
    light = xp.clip(light, 0.2, 5.0)
    return aligned._replace(value=aligned.value / light[:, None], light=light)


def _sides(aligned: AlignedRows) -> tuple[jax.Array, jax.Array]:
    """Compute the means and the numbers of samples on the dark and on the bright side of the edge, (2, rows) each."""
    middle, half_window = aligned.value.shape[1] // 2, _HALF_WINDOW // aligned.step
    near, outer = half_window // 2, 2 * half_window
    parts = slice(max(middle - outer, 0), middle - near), slice(middle + near + 1, middle + outer + 1)
    # Missing samples are 0.
    total, count = (xp.stack([a[:, part].sum(1) for part in parts]) for a in (aligned.value, aligned.valid))
    return total / xp.maximum(count, 1.0), count


def _largest_steps(rows: Rows) -> tuple[jax.Array, jax.Array]:
    """Find the position of the largest upward step in each row (rows,), px.

    The second array is 1 for rows with an edge, else 0.
    """
    width = rows.value.shape[1]
    half_window = max(min(_HALF_WINDOW // rows.step, width // 4), _MARGIN)
    there = xp.isfinite(rows.value)

    # The step between columns k - 1 and k is the mean of the window on the right minus the mean of the window on the left.
    # The windows are clipped at the borders.
    def windows(a: jax.Array) -> tuple[jax.Array, jax.Array]:
        padded = xp.pad(a, ((0, 0), (half_window, half_window)))
        total = sum(padded[:, k : k + width + half_window + 1] for k in range(half_window))
        return total[:, 1:width], total[:, half_window + 1 : half_window + width]

    before, after = windows(there.astype(float))
    dark, bright = (
        total / xp.maximum(count, 1.0)
        for total, count in zip(windows(xp.where(there, rows.value, 0.0)), (before, after), strict=True)
    )
    # Means of fewer samples have more noise.
    sure = 2 / (1 / xp.maximum(before, 1e-9) + 1 / xp.maximum(after, 1e-9))
    enough = (before >= _MARGIN) & (after >= _MARGIN)
    step = xp.where(enough, (bright - dark) * xp.sqrt(sure), -xp.inf)
    best = xp.argmax(step, axis=1)
    at = lambda a: xp.take_along_axis(a, best[:, None], axis=1)[:, 0]  # noqa: E731
    size = (at(bright) - at(dark)) / xp.maximum(xp.abs(at(bright)) + xp.abs(at(dark)), 1e-300)
    shown = xp.isfinite(at(step)) & (size > 0)
    some = shown.any()
    usual = xp.where(some, xp.nanmedian(xp.where(shown | ~some, size, xp.nan)), xp.nan)
    position = rows.start + (best + 0.5) * rows.step
    # Steps below 0.4 of the median step may be noise.
    return xp.asarray(position), (shown & (size > 0.4 * usual)).astype(float)


def _polynomial(powers: jax.Array, x: AnyArray, weight: jax.Array) -> jax.Array:
    """Fit the coefficients (..., k) of Legendre polynomials (k, rows) to x (..., rows) by weighted least squares."""
    weighted = powers * weight[..., None, :]
    # The prior for the orders above 2 (the bow) has the precision of 0.02 rows.
    stiff = np.diag(np.where(np.arange(len(powers)) < 3, 1e-9, 0.02))
    return linalg.solve(weighted @ powers.T + stiff, weighted @ x[..., None])[..., 0]
